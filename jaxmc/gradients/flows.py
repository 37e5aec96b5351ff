"""How a sampled direction moves with the scene: flows that keep a sample at its place on what it has met.

A sample is drawn with all parameters held, then evaluated again with the scene in motion. On flat faces, and inside
spheres, it stays at its material point; on a sphere seen from outside it keeps its place in the cone of the sphere; a
direction to the sky stays. So the edge of what is in front moves along with its own samples, and what is left to an
integral over edges is only what lies behind them.
"""

import dataclasses
from contextvars import ContextVar
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport.flats import FlatLight
from ..transport.lookups import SELECT_LIMIT
from ..transport.primitives import is_concrete
from ..transport.vec import Vec3, cross, dot, larger, smaller, where
from ..transport.warps import grazing

# Whether the derivative of many samples is swept back at once.
sweeps: ContextVar[bool] = ContextVar("sweeps", default=False)
GRAZE = 64.0  # times the rounding error of a cosine: below that rounding is a percent of it or more
GRAIN = 1e-7  # of the squared cosine of a sphere's cone: below that it is rounding


class Faces(NamedTuple):
    """The faces of a scene as arrays, one number of each for every face: points of a flat one are
    ``center + half_u * u + half_v * v``; those of a sphere have a ``radius``, which is 0 for flat ones.
    """

    center: Vec3
    half_u: Vec3
    half_v: Vec3
    radius: Any

    def at(self, face):
        """Return the numbers of one face, or of a fixed array of them."""
        return one_of(self, face)


def one_of(tree, index):
    """Return row ``index`` of every array in a tree; ``index`` may also be an array of known integers."""
    if is_concrete(index):
        return jax.tree.map(lambda x: x[index], tree)
    return table(tree).at(index)


@partial(jax.tree_util.register_dataclass, data_fields=["rows", "matrix", "numbers"], meta_fields=["faces"])
@dataclasses.dataclass(frozen=True)
class Table:
    """Arrays ``rows`` in a tree, over the faces that have these numbers. Where derivatives are swept back, ``matrix``
    has them all, one number of a face to a row, and ``numbers`` what they are now.
    """

    rows: Any
    faces: tuple[int, ...]
    matrix: Any = None
    numbers: Any = None

    def at(self, face):
        """Return what a face has; if it is none of them anything, and its derivative is 0.

        A traced number compares with all: the derivative of a gather is a scatter, which is slow, and which XLA:CPU of
        jaxlib 0.10.2 fails to compile in some loops. What one sweep adds up over many samples is a matrix product.
        """
        here = jnp.asarray(self.faces) == face
        if self.matrix is None:
            return jax.tree.map(lambda x: jnp.sum(jnp.where(here, x, 0.0)), self.rows)
        value = [self._chosen(face, here, x) for x in self.numbers]
        moving = self.matrix @ here.astype(self.matrix.dtype)
        # A split is put together again on the way back, where slices would be added up.
        moving = [x[0] for x in jax.lax.split(moving, [1] * len(value))]
        return jax.tree.unflatten(jax.tree.structure(self.rows), attach(value, moving))

    def _chosen(self, face, here, x):
        if not isinstance(x, tuple):
            return jnp.sum(jnp.where(here, x, 0.0))
        value = x[0]
        for i, number in zip(self.faces[1:], x[1:]):
            value = jnp.where(face == i, number, value)
        return value


def table(tree, faces=None) -> Table:
    """Return arrays over faces, to look up those of one of ``faces``; of any without."""
    tree = jax.tree.map(partial(jnp.asarray, dtype=float), tree)
    if faces is None:
        faces = tuple(range(len(jax.tree.leaves(tree)[0])))
    else:
        tree = jax.tree.map(lambda x: x[np.array(faces)], tree)
    if not sweeps.get():
        return Table(tree, faces)
    leaves, few = jax.tree.leaves(tree), len(faces) <= SELECT_LIMIT
    return Table(tree, faces, jnp.stack(leaves), [tuple(still(x)) if few else still(x) for x in leaves])


def table_of_faces(outlines) -> Faces:
    """Return the table of outlines as ``geometry.build`` makes them."""
    zero = Vec3(0.0, 0.0, 0.0)
    rows = [
        Faces(o.center, o.half_u, o.half_v, 0.0) if isinstance(o, FlatLight) else Faces(o.center, zero, zero, o.radius)
        for o in outlines
    ]
    return stacked(rows)


def stacked(rows):
    """Return trees of numbers as one tree of arrays, of NumPy where all numbers are known."""

    def stack(*x):
        return np.array(x, jnp.result_type(float)) if is_concrete(x) else jnp.stack([jnp.asarray(v, float) for v in x])

    return jax.tree.map(stack, *rows)


def still(tree):
    """Return values that count as constants for derivatives."""
    return jax.tree.map(jax.lax.stop_gradient, tree)


def attach(value, moving):
    """Return ``value`` with the derivative of ``moving``, whose own value is not computed; both may be trees."""
    return jax.tree.map(_attach, value, moving)


@jax.custom_jvp
def _attach(value, moving):
    # A choice that the compiler takes: the result then has the batch axes of both.
    return jnp.where(True, value, jnp.asarray(moving, jnp.result_type(value)))


@_attach.defjvp
def _attach_derivative(values, tangents):
    out = _attach(*values)
    return out, jnp.asarray(tangents[1], out.dtype)


def motion(v):
    """Return 0 with the derivative of ``v``."""
    return attach(jax.tree.map(jnp.zeros_like, v), v)


class Flowed(NamedTuple):
    """A sample that moves with the scene: its point, the direction to it, and its solid angle over what it was."""

    point: Vec3
    wi: Vec3
    ratio: Any


def flow(face: Faces, point: Vec3, wi: Vec3, distance, own=False, flat=False) -> Flowed:
    """Return how a sample on a face, seen from ``point``, moves; ``own``: the point lies on that face, as it may on the
    inside of a sphere; ``flat``: it is known to be no sphere.

    ``wi`` and ``distance`` say where the sample is; both count as constants. The direction is equal to ``wi``, the
    ratio to 1; their derivatives are those of the flow, written out: sums of what moves times what is known.
    """
    wi, distance = still(wi), still(distance)
    start, fixed = still(point), still(face)
    if flat:
        return _pinned(face, fixed, point, wi, distance, flat)
    to_center = fixed.center - start
    outside = (fixed.radius > 0.0) & (dot(to_center, to_center) > fixed.radius * fixed.radius) & ~jnp.asarray(own)
    pinned, in_cone = _pinned(face, fixed, point, wi, distance), _in_cone(face, fixed, point, wi, distance, outside)
    return Flowed(*(where(outside, a, b) for a, b in zip(in_cone, pinned)))


def _pinned(face, fixed, point, wi, distance, flat=False):
    """Keep the sample at its material point: its solid angle goes as area times cosine over squared distance."""
    target = still(point) + wi * distance
    offset = target - fixed.center
    across = cross(fixed.half_u, fixed.half_v)
    inverse = reciprocal(dot(across, across))
    u, v = dot(cross(offset, fixed.half_v), across) * inverse, dot(cross(fixed.half_u, offset), across) * inverse
    place, normal = face.center + face.half_u * u + face.half_v * v, across
    if not flat:
        is_sphere, outward = fixed.radius > 0.0, offset * reciprocal(fixed.radius)
        place = place + outward * jnp.where(is_sphere, face.radius, 0.0)
        normal = where(is_sphere, outward, across)
    to, near = place - point, 1.0 / distance
    along = dot(wi, to) * near
    # The logarithm of cosine and area: of (half_u x half_v) . to, of a sphere's radius^2 outward . to.
    height = reciprocal(dot(normal, wi) * distance)
    area = dot(face.half_u, cross(fixed.half_v, wi)) + dot(face.half_v, cross(wi, fixed.half_u))
    area = area * (height * distance)
    if not flat:
        area = jnp.where(is_sphere, 2.0 * face.radius * reciprocal(fixed.radius), area)
    log_ratio = area + dot(normal, to) * height - 3.0 * along
    return Flowed(attach(target, place), attach(wi, to * near - wi * along), attach(jnp.ones_like(distance), log_ratio))


def _in_cone(face, fixed, point, wi, distance, outside):
    """Keep the sample at its share s of 1 - cos within the cone of a sphere, and at its azimuth.

    With 1 - cos = s m, m that of the cone: m goes as sin^2 / (2 cos) of the cone's angle; the azimuth follows the axis
    as a rigid rotation does; and the hit is the near root, without the square root of a difference at the rim.
    """
    moving, to = face.center - point, where(outside, fixed.center - still(point), Vec3(1.0, 0.0, 0.0))
    inverse = 1.0 / jnp.sqrt(dot(to, to))
    axis, sine = to * inverse, jnp.where(outside, fixed.radius, 0.5) * inverse
    # A point that rounding leaves outside of the sphere by a hair sees a half space.
    cosine = jnp.sqrt(larger(1.0 - sine * sine, GRAIN))
    most = sine * sine / (1.0 + cosine)
    apart = wi - axis
    share = smaller(0.5 * dot(apart, apart) / most, 1.0)
    height = share * most
    aside = wi - axis * dot(wi, axis)
    squared = dot(aside, aside)
    aside = aside * jnp.where(squared > 0.0, 1.0 / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0)
    # Of the axis, of m and of s m.
    along = dot(axis, moving)
    turn = (moving - axis * along) * inverse
    widening = (face.radius - along * sine) * (sine * inverse) / cosine
    rising = widening * share
    lean = jnp.sqrt(height * (2.0 - height))
    outward = rising * ((1.0 - height) * reciprocal(lean)) * jnp.where(squared > 0.0, 1.0, 0.0)
    turned = turn * (1.0 - height) - axis * rising + aside * outward - axis * (dot(aside, turn) * lean)
    # Of the distance, (1 - s m) - chord times that of the centre.
    rest = larger((2.0 - most) - height, 0.0)
    open_ = jnp.sqrt(1.0 - share)
    chord = jnp.sqrt(most * rest) * open_
    narrowing = (widening * rest - most * (widening + rising)) * (0.5 * open_ * reciprocal(jnp.sqrt(most * rest)))
    length = along * ((1.0 - height) - chord) - (rising + narrowing) * (1.0 / inverse)
    place = point + turned * distance + wi * length
    target = still(point) + wi * distance
    return Flowed(attach(target, place), attach(wi, turned), attach(jnp.ones_like(distance), widening / most))


def distance_to(hit):
    """Return how far a hit is, 1 where there is none."""
    return jnp.where(hit.face >= 0, hit.distance, 1.0)


def reciprocal(x):
    """Return 1 / x, 0 where x is 0."""
    return jnp.where(x != 0.0, 1.0 / jnp.where(x != 0.0, x, 1.0), 0.0)


def carried(face: Faces, point: Vec3, wi: Vec3, distance) -> Vec3:
    """Return where a ray that moves meets a face, ``distance`` away now; derivatives are those of the meeting point.

    Where the ray grazes the face they grow as the meeting point moves, up to where rounding hides by how much.
    """
    fixed, place = still(face), point + wi * still(distance)
    is_sphere = fixed.radius > 0.0
    outward = (still(place) - fixed.center) * (1.0 / jnp.where(is_sphere, fixed.radius, 1.0))
    normal = where(is_sphere, outward, cross(face.half_u, face.half_v))
    gap = dot(normal, face.center - place) + jnp.where(is_sphere, face.radius, 0.0)
    speed, fixed_normal = still(dot(normal, wi)), still(normal)
    least = GRAZE * grazing() * jnp.sqrt(dot(fixed_normal, fixed_normal))
    speed = jnp.where(jnp.abs(speed) < least, jnp.where(speed > 0.0, least, -least), speed)
    return place + still(wi) * (motion(gap) / jnp.where(speed != 0.0, speed, 1.0))


def turning_at(face: Faces, point: Vec3, wi: Vec3) -> Vec3:
    """Return 0, with the derivative of a face's unit normal at a point of it, on the side that ``wi`` comes from."""
    normal = where(still(face.radius) > 0.0, point - face.center, cross(face.half_u, face.half_v))
    fixed = still(normal)
    size = reciprocal(jnp.sqrt(larger(dot(fixed, fixed), 0.0)))
    size = jnp.where(dot(fixed, still(wi)) > 0.0, -size, size)
    unit, turned = fixed * size, normal * size
    return motion(turned - unit * dot(unit, turned))


def ratio(x):
    """Return ``x`` over its own value: 1, with the logarithmic derivative of ``x``; plain 1 where that is 0."""
    fixed = still(x)
    return attach(jnp.ones_like(fixed), x * reciprocal(fixed))
