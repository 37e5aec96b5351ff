"""Receivers of some extent, for ``sensors.mean_irradiance``, and means over disks and caps by directions.

A receiver is a function ``place(u1, u2, *shape) -> (point, normal)`` that is uniform by area.
"""

import dataclasses
import math

import jax.numpy as jnp

import jaxmc as mc
from analytic_scenes.cavity import Walk, everywhere, inside_cap
from jaxmc.transport.vec import Vec3
from jaxmc.transport.warps import sample_cosine_hemisphere, sincos_2pi

PLACE = ("receiver: first", "receiver: second")
DIRECTION = ("direction: polar", "direction: azimuth")
UP = (0.0, 0.0, 1.0)


def disk_to_disk(radius: float, other_radius: float, distance: float, emission: float) -> mc.Integrand:
    """Return the irradiance on a disk from a parallel one on its axis, in the mean, by cosine-distributed directions.

    A sample is pi times ``emission`` where the direction meets the other disk, else 0.
    """
    params = (radius, other_radius, distance, emission)
    return mc.Integrand(_disk_to_disk, 4, params, lazy=True, labels=(*PLACE, *DIRECTION))


def cap_to_cap(half_angle: float, other_half_angle: float, emission: float) -> mc.Integrand:
    """Return the irradiance on the cap about -z of a hollow sphere from the cap about +z, in the mean.

    A sample is pi times ``emission`` where a cosine-distributed direction meets the other cap, else 0.
    """
    fn = _FromCap(Walk(1, inside_cap, everywhere, fewest=1))
    params = (math.cos(half_angle), (emission, 0.0, math.cos(other_half_angle)))
    return mc.Integrand(fn, 4, params, lazy=True, labels=(*PLACE, *DIRECTION))


def on_disk(u1, u2, center: Vec3, radius):
    """Return a point of a horizontal disk and its normal +z."""
    sine, cosine = sincos_2pi(u2)
    distance = radius * jnp.sqrt(u1)
    return center + Vec3(distance * cosine, distance * sine, 0.0), Vec3(*map(jnp.asarray, UP))


def on_sphere(u1, u2, center: Vec3, radius, side):
    """Return a point of a sphere and its normal: outward for ``side`` 1, inward for -1."""
    out = _in_cap(u1, u2, -1.0)
    return center + out * radius, out * side


def _in_cap(u1, u2, cos_half_angle):
    """Return a unit vector in the cap about +z, uniform by area: its height is, too."""
    height = 1.0 - u1 * (1.0 - cos_half_angle)
    sine, cosine = sincos_2pi(u2)
    across = jnp.sqrt(jnp.maximum(1.0 - height * height, 0.0))
    return Vec3(across * cosine, across * sine, height)


@dataclasses.dataclass(frozen=True)
class _FromCap:
    """Irradiance in a hollow sphere at a place in the cap about -z."""

    walk: Walk

    def __call__(self, u, cos_half_angle, lamp):
        start = -_in_cap(u[0], u[1], cos_half_angle)
        return jnp.pi * self.walk(u, 2, start, 1.0, 1.0, lamp, (1.0,))


def _disk_to_disk(u, radius, other_radius, distance, emission):
    point, _ = on_disk(u[0], u[1], Vec3(0.0, 0.0, 0.0), radius)
    wi = sample_cosine_hemisphere(u[2], u[3])
    # Compare where the ray meets the light's plane, with both sides times wi.z.
    x, y = point.x * wi.z + wi.x * distance, point.y * wi.z + wi.y * distance
    return jnp.where(x * x + y * y < (other_radius * wi.z) ** 2, jnp.pi * emission, 0.0)
