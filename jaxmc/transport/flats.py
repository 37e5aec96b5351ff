"""Flat faces, parallelograms, triangles and disks: closest hit and light sampling, written for one ray.

Components that are zero by construction are ``None`` in a ``FlatShape``: they take part in no arithmetic, so a wall
that is parallel to an axis costs a third of a tilted one.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from .derivatives import product, quotient, root
from .rays import LightSample, Ray, is_rounding, row_at, sparse_dot
from .vec import Vec3, dot, larger
from .warps import sincos_2pi


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["normal", "offset", "row_u", "offset_u", "row_v", "offset_v", "limit"],
    meta_fields=["axis", "triangle", "disk"],
)
@dataclasses.dataclass(frozen=True)
class FlatShape:
    """A parallelogram, or a part of one, as three rows: a point p has height ``normal . p - offset`` over it and the
    coordinates u = ``row_u . p - offset_u`` and v = ``row_v . p - offset_v``. Inside a parallelogram these run from -1
    to 1; inside a triangle, which is the half that has the parallelogram's first corner, u + v <= 0 as well; inside a
    disk, which a square holds, u^2 + v^2 <= 1.

    ``limit`` is 1 plus the rounding error of a hit in these coordinates, so that no ray slips between two faces that
    share an edge. ``axis`` is the axis that the normal is parallel to, or None; then ``normal`` is not used.
    """

    normal: Vec3
    offset: Any
    row_u: Vec3
    offset_u: Any
    row_v: Vec3
    offset_v: Any
    limit: Any
    axis: int | None
    triangle: bool = False
    disk: bool = False

    def holds(self, u, v):
        """Return whether a point of the plane with coordinates (u, v) lies inside."""
        if self.disk:
            return u * u + v * v <= self.limit * self.limit
        if self.triangle:
            return larger(larger(-u, -v), u + v + 1.0) <= self.limit
        return larger(jnp.abs(u), jnp.abs(v)) <= self.limit


def intersect(flat: FlatShape, ray: Ray, own):
    """Return the distance to a flat face, infinite for a miss; ``own``: the ray starts on it."""
    if flat.axis is None:
        height = flat.offset - sparse_dot(flat.normal, ray.origin)
        distance = quotient(height, sparse_dot(flat.normal, ray.direction))
    else:
        distance = product(flat.offset - ray.origin[flat.axis], ray.inverse[flat.axis])
    u = row_at(flat.row_u, flat.offset_u, ray.origin) + distance * sparse_dot(flat.row_u, ray.direction)
    v = row_at(flat.row_v, flat.offset_v, ray.origin) + distance * sparse_dot(flat.row_v, ray.direction)
    hit = (distance > 0.0) & flat.holds(u, v) & jnp.logical_not(own)
    return jnp.where(hit, distance, jnp.inf)


def is_on(flat: FlatShape, point):
    """Return whether a point lies on a flat face, to rounding."""
    terms = [a * b for a, b in zip(flat.normal, point) if a is not None] if flat.axis is None else [point[flat.axis]]
    height = sum(terms) - flat.offset
    inside = flat.holds(row_at(flat.row_u, flat.offset_u, point), row_at(flat.row_v, flat.offset_v, point))
    return is_rounding(height, [flat.offset, *terms]) & inside


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["center", "half_u", "half_v", "normal", "area"],
    meta_fields=["triangle", "two_sided", "rectangle", "disk"],
)
@dataclasses.dataclass(frozen=True)
class FlatLight:
    """What sampling a flat face needs. Its points are ``center + half_u * u + half_v * v`` with coordinates as in
    ``FlatShape``; ``two_sided``: it shines to both sides, not only to that of its normal; ``rectangle``: its edges are
    known to be perpendicular.
    """

    center: Vec3
    half_u: Vec3
    half_v: Vec3
    normal: Vec3
    area: Any
    triangle: bool = False
    two_sided: bool = False
    rectangle: bool = False
    disk: bool = False

    @property
    def centroid(self):
        """The mean of its points."""
        return self.center - (self.half_u + self.half_v) * (1.0 / 3.0) if self.triangle else self.center

    def shining_to_both_sides(self):
        return dataclasses.replace(self, two_sided=True)

    def cosine(self, wi):
        """Return the cosine at the light for a direction toward it, 0 where it does not shine."""
        cosine = dot(self.normal, wi)
        return jnp.abs(cosine) if self.two_sided else larger(-cosine, 0.0)


def point_on(light: FlatLight, u1, u2) -> Vec3:
    """Return a point of a flat face drawn uniformly: its density is 1 / area, per area."""
    u, v = _coordinates(light, u1, u2)
    return light.center + light.half_u * u + light.half_v * v


def _coordinates(light, u1, u2):
    if light.disk:
        # The square root makes rings of equal area.
        distance = root(u1)
        sine, cosine = sincos_2pi(u2)
        return distance * cosine, distance * sine
    if not light.triangle:
        return 2.0 * u1 - 1.0, 2.0 * u2 - 1.0
    # The square root makes strips of equal area.
    strip = root(u1)
    return 2.0 * strip * (1.0 - u2) - 1.0, 2.0 * strip * u2 - 1.0


def sample(light: FlatLight, point, own, u1, u2) -> LightSample:
    """Sample a point of a flat face uniformly by area, seen from ``point``; ``own``: that lies in its plane, from which
    it cannot be seen.
    """
    to_light = point_on(light, u1, u2) - point
    squared = dot(to_light, to_light)
    inverse = jnp.sqrt(1.0 / squared)
    wi = to_light * inverse
    inverse_pdf = light.cosine(wi) * light.area * (inverse * inverse)
    return LightSample(wi, squared * inverse, jnp.where(own, 0.0, inverse_pdf))


def inverse_pdf(light: FlatLight, point, wi, distance):
    """Return 1 / density per solid angle of ``sample`` for a hit of the light, 0 where it does not shine."""
    return light.cosine(wi) * light.area / (distance * distance)
