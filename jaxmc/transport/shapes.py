"""Sphere and parallelogram: closest hit, shadow test and light sampling, written for one ray.

No start offsets. A ray that leaves a primitive knows which one (``own``): a parallelogram is not hit again from its own
plane, a sphere only at its other root, which is known in closed form and which only a ray that goes inward has: so no
sampled direction may lie closer to the tangent plane than rounding tells, see ``warps.grazing``. Distances are infinite
where a ray misses.

Components that are zero by construction are ``None`` in a ``QuadShape``: they take part in no arithmetic, so a wall
that is parallel to an axis costs a third of a tilted one.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .derivatives import product, quotient, reciprocal, root
from .vec import Vec3, dot, frame, larger, smaller
from .warps import sincos_2pi


class Ray(NamedTuple):
    """A half line: ``direction`` has unit length, ``inverse`` holds the reciprocals of its components."""

    origin: Vec3
    direction: Vec3
    inverse: Vec3


def ray(origin, direction):
    """Return the ray from ``origin`` along the unit vector ``direction``."""
    return Ray(origin, direction, Vec3(*map(reciprocal, direction)))


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["normal", "offset", "row_u", "offset_u", "row_v", "offset_v", "limit"],
    meta_fields=["axis"],
)
@dataclasses.dataclass(frozen=True)
class QuadShape:
    """A parallelogram as three rows: a point p has height ``normal . p - offset`` over it and the coordinates
    ``row_u . p - offset_u`` and ``row_v . p - offset_v``, which run from -1 to 1 inside.

    ``limit`` is 1 plus the rounding error of a hit in these coordinates, so that no ray slips between two quads that
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


class SphereShape(NamedTuple):
    """A sphere. ``power`` is that of the origin, |center|^2 - radius^2, and only kept for a sphere far larger than what
    happens near it: there the distance to its centre has lost the digits that matter.
    """

    center: Vec3
    radius: Any
    power: Any = None


def intersect_quad(quad: QuadShape, ray: Ray, own):
    """Return the distance to a parallelogram, infinite for a miss; ``own``: the ray starts on it."""
    if quad.axis is None:
        height = quad.offset - _sparse_dot(quad.normal, ray.origin)
        distance = quotient(height, _sparse_dot(quad.normal, ray.direction))
    else:
        distance = product(quad.offset - ray.origin[quad.axis], ray.inverse[quad.axis])
    u = _row(quad.row_u, quad.offset_u, ray, distance)
    v = _row(quad.row_v, quad.offset_v, ray, distance)
    hit = (distance > 0.0) & (larger(jnp.abs(u), jnp.abs(v)) <= quad.limit) & jnp.logical_not(own)
    return jnp.where(hit, distance, jnp.inf)


def is_on_quad(quad: QuadShape, point):
    """Return whether a point lies on a parallelogram, to rounding."""
    terms = [a * b for a, b in zip(quad.normal, point) if a is not None] if quad.axis is None else [point[quad.axis]]
    height = sum(terms) - quad.offset
    u = _sparse_dot(quad.row_u, point) - (0.0 if quad.offset_u is None else quad.offset_u)
    v = _sparse_dot(quad.row_v, point) - (0.0 if quad.offset_v is None else quad.offset_v)
    return _is_rounding(height, [quad.offset, *terms]) & (jnp.maximum(jnp.abs(u), jnp.abs(v)) <= quad.limit)


def is_on_sphere(sphere: SphereShape, point):
    """Return whether a point lies on a sphere, to rounding."""
    if sphere.power is not None:
        return _is_rounding(_power(sphere, point) / (2.0 * sphere.radius), [*point])
    to_center = sphere.center - point
    height = jnp.sqrt(dot(to_center, to_center)) - sphere.radius
    return _is_rounding(height, [sphere.radius, *sphere.center, *point])


def _is_rounding(height, terms):
    return jnp.abs(height) <= 8.0 * float(jnp.finfo(jnp.result_type(float)).eps) * sum(map(jnp.abs, terms))


def _row(row, offset, ray, distance):
    at_origin = _sparse_dot(row, ray.origin)
    at_origin = at_origin if offset is None else at_origin - offset
    return at_origin + distance * _sparse_dot(row, ray.direction)


def _sparse_dot(row, v):
    terms = [a * b for a, b in zip(row, v, strict=True) if a is not None]
    return sum(terms[1:], terms[0])


def intersect_sphere(sphere: SphereShape, ray: Ray, own):
    """Return the distance to a sphere, infinite for a miss; ``own``: the ray starts on it."""
    to_center = sphere.center - ray.origin
    nearest = dot(to_center, ray.direction)
    near, far = _roots(sphere, ray, to_center, nearest)
    distance = jnp.where(near > 0.0, near, far)
    # From its own surface the other end of the chord is twice as far as the centre's foot point.
    distance = jnp.where(own, 2.0 * nearest, distance)
    return jnp.where(distance > 0.0, distance, jnp.inf)


def _roots(sphere, ray, to_center, nearest):
    """Return both distances at which a line meets a sphere, the smaller first; NaN for a miss.

    The discriminant is taken from the point of the line nearest to the centre, which keeps it accurate for a small
    sphere far away; for a large one nearby the root next to 0 comes from the product of both, which is the power of
    the ray's origin (Haines et al. 2019, Ray Tracing Gems, chapter 7).
    """
    offset = to_center - ray.direction * nearest
    half_chord = root(sphere.radius * sphere.radius - dot(offset, offset))
    if sphere.power is None:
        return nearest - half_chord, nearest + half_chord
    outer = nearest + jnp.where(nearest < 0.0, -half_chord, half_chord)
    inner = quotient(_power(sphere, ray.origin), outer)
    return smaller(inner, outer), larger(inner, outer)


def _power(sphere, point):
    """Return the power of a point, the product of its distances to a sphere along any line, without cancellation."""
    return dot(point, point) - 2.0 * dot(sphere.center, point) + sphere.power


def sphere_blocks(sphere: SphereShape, ray: Ray, length, own, empty=False):
    """Return whether a sphere cuts the first ``length`` of a ray; needs no root and no division.

    ``empty`` says that no ray starts or ends inside the sphere.
    """
    r2 = sphere.radius * sphere.radius
    to_center = sphere.center - ray.origin
    nearest = dot(to_center, ray.direction)
    along = smaller(larger(nearest, 0.0), length)
    if sphere.power is not None:
        start = _power(sphere, ray.origin)
        inside, end_inside = start < 0.0, start + length * (length - 2.0 * nearest) < 0.0
        crosses = start + along * (along - 2.0 * nearest) < 0.0
        crosses = crosses & ~(inside & end_inside)
    else:
        foot = to_center - ray.direction * along
        crosses = dot(foot, foot) < r2
        if not empty:
            # A segment inside the sphere from end to end does not cross its surface.
            end = to_center - ray.direction * length
            crosses = crosses & ~((dot(to_center, to_center) < r2) & (dot(end, end) < r2))
    return jnp.where(own, (nearest > 0.0) & (2.0 * nearest < length), crosses)


class LightSample(NamedTuple):
    """A direction toward a light: distance, cosine at the light (0 where it shines away) and inverse density.

    ``inverse_pdf`` is 1 / density per solid angle, 0 where the light cannot be seen; never infinite.
    """

    wi: Vec3
    distance: Any
    inverse_pdf: Any


class QuadLight(NamedTuple):
    """What sampling a parallelogram by area needs."""

    center: Vec3
    half_u: Vec3
    half_v: Vec3
    normal: Vec3
    area: Any


def sample_quad_light(light: QuadLight, point, own, u1, u2) -> LightSample:
    """Sample a point of the parallelogram uniformly by area, seen from ``point``; ``own``: that lies in its plane, from
    which it cannot be seen.
    """
    target = light.center + light.half_u * (2.0 * u1 - 1.0) + light.half_v * (2.0 * u2 - 1.0)
    to_light = target - point
    squared = dot(to_light, to_light)
    inverse = jnp.sqrt(1.0 / squared)
    wi = to_light * inverse
    cos_light = larger(-dot(light.normal, wi), 0.0)
    inverse_pdf = cos_light * light.area * (inverse * inverse)
    return LightSample(wi, squared * inverse, jnp.where(own, 0.0, inverse_pdf))


def inverse_pdf_quad_light(light: QuadLight, point, wi, distance):
    """Return 1 / density per solid angle of ``sample_quad_light`` for a hit of the light, 0 from behind."""
    return larger(-dot(light.normal, wi), 0.0) * light.area / (distance * distance)


@partial(jax.tree_util.register_dataclass, data_fields=["sphere"], meta_fields=["inward"])
@dataclasses.dataclass(frozen=True)
class SphereLight:
    """What sampling a sphere by solid angle needs; ``inward``: it shines on what is inside it."""

    sphere: SphereShape
    inward: bool


def sample_sphere_light(light: SphereLight, point, own, u1, u2) -> LightSample:
    """Sample a direction uniformly in the cone of the sphere, or over all directions from inside it.

    ``own``: the point is on the sphere. Source: Shirley, Wang & Zimmerman 1996; pbrt, section 6.2.4.
    """
    to_center = light.sphere.center - point
    squared = dot(to_center, to_center)
    one_minus_cos, visible = _cone(light, point, squared, own)
    z = 1.0 - u1 * one_minus_cos
    radius = root(jnp.maximum(u1 * one_minus_cos * (1.0 + z), 0.0))
    sine, cosine = sincos_2pi(u2)
    wi = Vec3(radius * cosine, radius * sine, z)
    if not light.inward:
        axis = to_center * jnp.sqrt(1.0 / squared)
        tangent, bitangent = frame(axis)
        wi = tangent * wi.x + bitangent * wi.y + axis * wi.z
    near, far = _roots(light.sphere, ray(point, wi), to_center, dot(to_center, wi))
    distance = far if light.inward else near
    # Rounding makes some rays at the rim miss: they end where the sphere is nearest to them.
    distance = jnp.where(distance == distance, distance, dot(to_center, wi))
    return LightSample(wi, distance, jnp.where(visible, 2.0 * np.pi * one_minus_cos, 0.0))


def inverse_pdf_sphere_light(light: SphereLight, point, wi, distance):
    """Return 1 / density per solid angle of ``sample_sphere_light`` from ``point``, 0 where its inside is dark."""
    to_center = light.sphere.center - point
    # A hit of the inside tells that the point is inside.
    one_minus_cos, visible = _cone(light, point, dot(to_center, to_center), light.inward)
    falling = dot(to_center - wi * distance, wi)
    return jnp.where(visible & (falling < 0.0 if light.inward else falling > 0.0), 2.0 * np.pi * one_minus_cos, 0.0)


def _cone(light, point, squared, own):
    """Return 1 - cos of the cone's half angle (2 for an inward light), and whether the light can be seen."""
    r2 = light.sphere.radius * light.sphere.radius
    if light.inward:
        return 2.0, own | (squared < r2)
    sin2 = r2 / squared
    cos2 = 1.0 - sin2 if light.sphere.power is None else _power(light.sphere, point) / squared
    return sin2 / (1.0 + root(jnp.maximum(cos2, 0.0))), (cos2 > 0.0) & jnp.logical_not(own)
