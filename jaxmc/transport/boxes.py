"""Boxes of any orientation: closest hit, written for one ray.

Six faces count as one shape, so a box is watertight by itself: a ray that goes in comes out. Faces are numbered
``2 * axis`` on the negative side of the box's own axis, ``2 * axis + 1`` on the positive side.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from .derivatives import product, reciprocal
from .rays import Ray, is_rounding, row_at, sparse_dot
from .vec import Vec3, larger, smaller


class BoxShape(NamedTuple):
    """A box as three rows: coordinate k of a point p is ``rows[k] . p - offsets[k]``, which runs from -1 to 1 inside.
    Components that are zero by construction are None.
    """

    rows: tuple[Any, Any, Any]
    offsets: tuple[Any, Any, Any]


def intersect(box: BoxShape, ray: Ray, own) -> tuple[Any, Any]:
    """Return the distance to a box, infinite for a miss, and the face there; ``own`` is the face that the ray starts
    on, any other number if it starts elsewhere. From inside, and inward from a face, the ray meets the far side.

    Source: the slabs of Kay and Kajiya 1986.
    """
    slabs = [_slab(row, offset, ray) for row, offset in zip(box.rows, box.offsets)]
    lows, highs, backward = zip(*slabs)
    near, far = larger(larger(lows[0], lows[1]), lows[2]), smaller(smaller(highs[0], highs[1]), highs[2])
    inward = outward = False
    for k in range(3):
        front = jnp.where(backward[k], 2 * k + 1, 2 * k)
        inward, outward = inward | (own == front), outward | (own == 4 * k + 1 - front)
    outside = (near > 0.0) & jnp.logical_not(inward)
    # A ray that goes inward cannot miss, even where rounding has put its start beyond an edge.
    hit = inward | ((near <= far) & (far > 0.0) & jnp.logical_not(outward))
    met = jnp.where(outside, near, far)
    face = 0
    for k in range(3):
        face_k = jnp.where(outside == backward[k], 2 * k + 1, 2 * k)
        face = face_k if k == 0 else jnp.where(jnp.where(outside, lows[k], highs[k]) == met, face_k, face)
    return jnp.where(hit, larger(met, 0.0), jnp.inf), face


def _slab(row, offset, ray):
    """Return where a line enters and leaves the space between two faces, and whether it goes from plus to minus."""
    start = row_at(row, offset, ray.origin)
    speed = sparse_dot(row, ray.direction)
    inverse = reciprocal(speed)
    minus, plus = product(-1.0 - start, inverse), product(1.0 - start, inverse)
    return smaller(plus, minus), larger(plus, minus), speed < 0.0


def either(condition, one: BoxShape, other: BoxShape) -> BoxShape:
    """Return ``one`` where the condition holds, else ``other``."""

    def choose(a, b):
        return (
            None if a is None and b is None else jnp.where(condition, 0.0 if a is None else a, 0.0 if b is None else b)
        )

    rows = tuple(Vec3(*map(choose, a, b)) for a, b in zip(one.rows, other.rows))
    return BoxShape(rows, tuple(map(choose, one.offsets, other.offsets)))


def face_at(box: BoxShape, point):
    """Return the face on which a point lies, to rounding, or -1."""
    found = -1
    for k, (row, offset) in enumerate(zip(box.rows, box.offsets)):
        value = row_at(row, offset, point)
        terms = [1.0, 0.0 if offset is None else offset, *(a * b for a, b in zip(row, point) if a is not None)]
        others = [row_at(r, o, point) for j, (r, o) in enumerate(zip(box.rows, box.offsets)) if j != k]
        inside = (jnp.abs(others[0]) <= 1.0) & (jnp.abs(others[1]) <= 1.0)
        for side, sign in enumerate((-1.0, 1.0)):
            found = jnp.where(inside & is_rounding(value - sign, terms), 2 * k + side, found)
    return found
