"""Spheres: closest hit, shadow test and light sampling by solid angle, written for one ray."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .derivatives import quotient, root
from .rays import LightSample, Ray, is_rounding, ray
from .vec import Vec3, dot, frame, larger, smaller
from .warps import sincos_2pi


class SphereShape(NamedTuple):
    """A sphere. ``power`` is that of the origin, |center|^2 - radius^2, and only kept for a sphere far larger than what
    happens near it: there the distance to its centre has lost the digits that matter.
    """

    center: Vec3
    radius: Any
    power: Any = None


def intersect(sphere: SphereShape, ray: Ray, own):
    """Return the distance to a sphere, infinite for a miss; ``own``: the ray starts on it."""
    to_center = sphere.center - ray.origin
    nearest = dot(to_center, ray.direction)
    near, far = _roots(sphere, ray, to_center, nearest)
    distance = jnp.where(near > 0.0, near, far)
    # From its own surface the other end of the chord is twice as far as the centre's foot point.
    distance = jnp.where(own, 2.0 * nearest, distance)
    return jnp.where(distance > 0.0, distance, jnp.inf)


def is_on(sphere: SphereShape, point):
    """Return whether a point lies on a sphere, to rounding."""
    if sphere.power is not None:
        return is_rounding(_power(sphere, point) / (2.0 * sphere.radius), [*point])
    to_center = sphere.center - point
    height = jnp.sqrt(dot(to_center, to_center)) - sphere.radius
    return is_rounding(height, [sphere.radius, *sphere.center, *point])


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


def blocks(sphere: SphereShape, ray: Ray, length, own, empty=False):
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


@partial(jax.tree_util.register_dataclass, data_fields=["sphere"], meta_fields=["inward"])
@dataclasses.dataclass(frozen=True)
class SphereLight:
    """What sampling a sphere by solid angle needs; ``inward``: it shines on what is inside it."""

    sphere: SphereShape
    inward: bool


def sample(light: SphereLight, point, own, u1, u2) -> LightSample:
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
    nearest = dot(to_center, wi)
    near, far = _roots(light.sphere, ray(point, wi), to_center, nearest)
    distance = far if light.inward else near
    # Rounding makes some rays at the rim miss: they end where the sphere is nearest to them.
    distance = jnp.where(distance == distance, distance, nearest)
    # From the outer face of a sphere that shines inward no direction leads into it.
    visible = visible & ((nearest > 0.0) | jnp.logical_not(own)) if light.inward else visible
    return LightSample(wi, distance, jnp.where(visible, 2.0 * np.pi * one_minus_cos, 0.0))


def inverse_pdf(light: SphereLight, point, wi, distance):
    """Return 1 / density per solid angle of ``sample`` from ``point``, 0 where its inside is dark."""
    to_center = light.sphere.center - point
    # A hit of the inside tells that the point is inside.
    one_minus_cos, visible = _cone(light, point, dot(to_center, to_center), light.inward)
    falling = dot(to_center - wi * distance, wi)
    return jnp.where(visible & (falling < 0.0 if light.inward else falling > 0.0), 2.0 * np.pi * one_minus_cos, 0.0)


def point_by_area(sphere: SphereShape, u1, u2):
    """Return a point of a sphere drawn uniformly by area, and the normal there, away from the centre."""
    radius = 2.0 * root(larger(u1 * (1.0 - u1), 0.0))
    sine, cosine = sincos_2pi(u2)
    normal = Vec3(radius * cosine, radius * sine, 1.0 - 2.0 * u1)
    return sphere.center + normal * sphere.radius, normal


def sample_by_area(light: SphereLight, point, own, u1, u2) -> LightSample:
    """Sample a point of a sphere uniformly by area, seen from ``point``; ``own``: that is on the sphere.

    Points on the far side waste a sample.
    """
    target, normal = point_by_area(light.sphere, u1, u2)
    to_light = target - point
    squared = dot(to_light, to_light)
    inverse = jnp.sqrt(1.0 / squared)
    wi = to_light * inverse
    return LightSample(wi, squared * inverse, _inverse_pdf_by_area(light, point, own, dot(normal, wi), inverse))


def inverse_pdf_by_area(light: SphereLight, point, wi, distance):
    """Return 1 / density per solid angle of ``sample_by_area``, 0 where the light does not shine."""
    normal = (point + wi * distance - light.sphere.center) * (1.0 / light.sphere.radius)
    # A hit of the inside tells that the point is inside.
    return _inverse_pdf_by_area(light, point, light.inward, dot(normal, wi), 1.0 / distance)


def _inverse_pdf_by_area(light, point, own, cosine, inverse_distance):
    """Return area times cosine over squared distance; ``cosine`` is that of the outer normal and wi."""
    area = 4.0 * np.pi * light.sphere.radius * light.sphere.radius
    if light.inward:
        to_center = light.sphere.center - point
        visible = own | (dot(to_center, to_center) < light.sphere.radius * light.sphere.radius)
    else:
        cosine, visible = -cosine, jnp.logical_not(own)
    return jnp.where(visible, larger(cosine, 0.0) * area * (inverse_distance * inverse_distance), 0.0)


def _cone(light, point, squared, own):
    """Return 1 - cos of the cone's half angle (2 for an inward light), and whether the light can be seen."""
    r2 = light.sphere.radius * light.sphere.radius
    if light.inward:
        return 2.0, own | (squared < r2)
    sin2 = r2 / squared
    cos2 = 1.0 - sin2 if light.sphere.power is None else _power(light.sphere, point) / squared
    return sin2 / (1.0 + root(jnp.maximum(cos2, 0.0))), (cos2 > 0.0) & jnp.logical_not(own)
