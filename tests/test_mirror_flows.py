"""Samples seen in plane mirrors stay on what these show: flows against differences of the geometry in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmc.gradients.flows import Faces
from jaxmc.gradients.mirrors import Shown, flow_through
from jaxmc.transport.hits import Hit
from jaxmc.transport.vec import Vec3

STEP = 1e-4
SIZE = 30  # numbers of three faces and a point


def scene(rng):
    """Return two mirrors that face each other at a slant and a sheet, as rows (center, half_u, half_v), and a point."""
    rows = np.array([
        [[0.0, 1.0, 0.6], [0.7, 0.1, 0.0], [0.0, -0.1, 0.5]],
        [[0.1, -0.6, 1.6], [0.1, 0.1, 0.7], [0.6, 0.0, 0.1]],
        [[-0.2, 0.5, 2.6], [0.7, 0.2, 0.1], [0.1, 0.3, 0.6]],
    ])  # fmt: skip
    return rows + rng.uniform(-0.05, 0.05, rows.shape), rng.uniform(-0.1, 0.1, 3)


def mirrored(row, p, is_point):
    normal = np.cross(row[1], row[2])
    normal /= np.linalg.norm(normal)
    return p - 2.0 * (normal @ (p - row[0] if is_point else p)) * normal


def seen(numbers, u, v, count):
    """Return the directions from a point to a place on the sheet over ``count`` mirrors, one for each part of the way,
    the lengths of these parts, and the solid angle to a unit of (u, v)."""
    rows, point = numbers[:27].reshape(3, 3, 3), numbers[27:]
    target = rows[2, 0] + rows[2, 1] * u + rows[2, 2] * v
    images = [point]
    for row in rows[:count]:
        images.append(mirrored(row, images[-1], True))
    offset = target - images[-1]
    length = np.linalg.norm(offset)
    ways = [offset / length]
    for row in rows[:count][::-1]:
        ways.insert(0, mirrored(row, ways[0], False))
    upto = [0.0]
    for row, image, way in zip(rows, images, ways[:count]):
        normal = np.cross(row[1], row[2])
        upto.append(normal @ (row[0] - image) / (normal @ way))
    area = np.cross(rows[2, 1], rows[2, 2])
    return ways, np.diff([*upto, length]), abs(area @ ways[-1]) / length**2


def as_vec(x):
    return Vec3(*x)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("seed", range(2))
def test_samples_stay_on_what_mirrors_show(count, seed):
    rng = np.random.default_rng([11, seed])
    rows, point = scene(rng)
    at_rest, (u, v) = np.concatenate([rows.ravel(), point]), rng.uniform(-0.5, 0.5, 2)
    ways, lengths, _ = seen(at_rest, u, v, count)
    assert np.all(lengths > 0.0)
    last = [1, 2] if count == 2 else [2]
    chain = [
        Shown(True, as_vec(way), Hit(length, face)) for way, length, face in zip(ways[1:], lengths[1:], last)
    ]  # fmt: skip

    def flowed(numbers):
        table = numbers[:27].reshape(3, 3, 3)
        faces = [Faces(*(as_vec(x) for x in row), 0.0) for row in table]

        def face_at(face):
            return jax.tree.map(lambda *x: sum(jnp.where(face == i, a, 0.0) for i, a in enumerate(x)), *faces)

        moved = flow_through(face_at, Hit(lengths[0], 0), as_vec(numbers[27:]), as_vec(ways[0]), chain)
        return jnp.stack([*moved.wi, *moved.point, moved.ratio])

    def exact(numbers):
        ways, lengths, angle = seen(numbers, u, v, count)
        return np.array([*ways[0], *(numbers[27:] + ways[0] * lengths[0]), angle])

    found = np.asarray(jax.jacfwd(flowed)(jnp.asarray(at_rest, float)))
    differences = np.stack([
        (exact(at_rest + step) - exact(at_rest - step)) / (2.0 * STEP) for step in STEP * np.eye(SIZE)
    ], 1)  # fmt: skip
    value = exact(at_rest)
    differences[-1] /= value[-1]
    assert np.allclose(np.asarray(flowed(jnp.asarray(at_rest, float))), [*value[:-1], 1.0], atol=1e-5)
    assert np.allclose(found, differences, atol=3e-4 * np.abs(differences).max(1, keepdims=True))
