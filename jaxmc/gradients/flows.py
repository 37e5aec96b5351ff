"""How a sampled direction moves with the scene: flows that keep a sample at its place on what it has met.

A sample is drawn with all parameters held, then evaluated again with the scene in motion. On flat faces, and inside
spheres, it stays at its material point; on a sphere seen from outside it keeps its place in the cone of the sphere; a
direction to the sky stays. So the edge of what is in front moves along with its own samples, and what is left to an
integral over edges is only what lies behind them.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport.flats import FlatLight
from ..transport.primitives import is_concrete
from ..transport.vec import Vec3, cross, dot, normalize, smaller, where


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
    """Return row ``index`` of every array in a tree; ``index`` may also be an array of known integers.

    A traced index compares with all of them: the derivative of a gather is a scatter, which is slow, and which XLA:CPU
    of jaxlib 0.10.2 fails to compile in some loops.
    """
    if is_concrete(index):
        return jax.tree.map(lambda x: x[index], tree)
    return jax.tree.map(lambda x: jnp.sum(jnp.where(jnp.arange(len(x)) == index, x, 0.0)), tree)


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


def flow(face: Faces, point: Vec3, wi: Vec3, distance) -> Flowed:
    """Return how a sample on a face, seen from ``point``, moves.

    ``wi`` and ``distance`` say where the sample is; both count as constants. The direction is equal to ``wi``, the
    ratio to 1; their derivatives are those of the flow.
    """
    wi, distance = still(wi), still(distance)
    start, fixed = still(point), still(face)
    to_center = fixed.center - start
    outside = (fixed.radius > 0.0) & (dot(to_center, to_center) > fixed.radius * fixed.radius)
    pinned, in_cone = _pinned(face, fixed, point, wi, distance), _in_cone(face, point, wi, distance, outside)
    return Flowed(*(where(outside, a, b) for a, b in zip(in_cone, pinned)))


def _pinned(face, fixed, point, wi, distance):
    """Keep the sample at its material point: its solid angle goes as area times cosine over squared distance."""
    target = still(point) + wi * distance
    offset = target - fixed.center
    across = cross(fixed.half_u, fixed.half_v)
    squared = dot(across, across)
    inverse = 1.0 / jnp.where(squared > 0.0, squared, 1.0)
    u, v = dot(cross(offset, fixed.half_v), across) * inverse, dot(cross(fixed.half_u, offset), across) * inverse
    is_sphere = fixed.radius > 0.0
    outward = offset * (1.0 / jnp.where(is_sphere, fixed.radius, 1.0))
    moved = motion(face.center) + motion(face.half_u) * u + motion(face.half_v) * v
    place = target + moved + outward * jnp.where(is_sphere, motion(face.radius), 0.0)
    to = place - point
    normal = where(is_sphere, outward * (face.radius * face.radius), cross(face.half_u, face.half_v))
    length = dot(to, to)
    return Flowed(place, attach(wi, normalize(to)), ratio(dot(normal, to) / (length * jnp.sqrt(length))))


def _in_cone(face, point, wi, distance, outside):
    """Keep the sample at its share s of 1 - cos within the cone of a sphere, and at its azimuth, to first order."""
    moving = where(outside, face.center - point, Vec3(1.0, 0.0, 0.0))
    radius = jnp.where(outside, face.radius, 0.5)
    axis, most = _cone(moving, radius)
    first, first_most = _cone(still(moving), still(radius))
    apart = wi - first
    share = smaller(0.5 * dot(apart, apart) / first_most, 1.0)
    aside = wi - first * dot(wi, first)
    squared = dot(aside, aside)
    known = squared > 0.0
    aside = where(known, aside * (1.0 / jnp.sqrt(jnp.where(known, squared, 1.0))), Vec3(0.0, 0.0, 0.0))
    height = share * most
    sine = jnp.sqrt(jnp.where(known, height * (2.0 - height), 1.0))
    # The azimuth follows the axis as a rigid rotation does.
    upright = aside - axis * dot(aside, axis)
    upright = normalize(where(known, upright, Vec3(1.0, 0.0, 0.0)))
    wi = attach(wi, axis * (1.0 - height) + upright * jnp.where(known, sine, 0.0))
    # The near root, without the square root of a difference at the rim.
    chord = jnp.sqrt(most * ((2.0 - most) - height)) * jnp.sqrt(1.0 - share)
    length = attach(distance, jnp.sqrt(dot(moving, moving)) * ((1.0 - height) - chord))
    return Flowed(point + wi * length, wi, ratio(most))


def carried(face: Faces, point: Vec3, wi: Vec3, distance) -> Vec3:
    """Return where a ray that moves meets a face, ``distance`` away now; derivatives are those of the meeting point.

    Where the ray grazes the face they grow without bound, as the meeting point does move without bound.
    """
    fixed, place = still(face), point + wi * still(distance)
    is_sphere = fixed.radius > 0.0
    outward = (still(place) - fixed.center) * (1.0 / jnp.where(is_sphere, fixed.radius, 1.0))
    normal = where(is_sphere, outward, cross(face.half_u, face.half_v))
    gap = dot(normal, face.center - place) + jnp.where(is_sphere, face.radius, 0.0)
    speed = still(dot(normal, wi))
    return place + still(wi) * (motion(gap) / jnp.where(speed != 0.0, speed, 1.0))


def normal_at(face: Faces, point: Vec3, normal: Vec3) -> Vec3:
    """Return the unit normal of a face at a point of it; ``normal`` is what it is now, on either side."""
    is_sphere = still(face.radius) > 0.0
    across = where(is_sphere, point - face.center, cross(face.half_u, face.half_v))
    known = still(dot(across, across)) > 0.0
    across = normalize(where(known, across, Vec3(0.0, 0.0, 1.0)))
    side = jnp.where(dot(still(across), still(normal)) < 0.0, -1.0, 1.0)
    return attach(still(normal), across * jnp.where(known, side, 0.0))


def _cone(to_center, radius):
    """Return the axis of a sphere's cone, and 1 - cos of its half angle."""
    squared = dot(to_center, to_center)
    sine2 = radius * radius / squared
    return to_center * (1.0 / jnp.sqrt(squared)), sine2 / (1.0 + jnp.sqrt(1.0 - sine2))


def ratio(x):
    """Return ``x`` over its own value: 1, with the logarithmic derivative of ``x``; plain 1 where that is 0."""
    fixed = still(x)
    inverse = jnp.where(fixed != 0.0, 1.0 / jnp.where(fixed != 0.0, fixed, 1.0), 0.0)
    return attach(jnp.ones_like(fixed), x * inverse)
