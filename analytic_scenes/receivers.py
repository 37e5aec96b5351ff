"""Receivers of some extent: integrands of the irradiance in the mean over a surface.

Two coordinates place a point on the receiver, the rest sample the light or a direction. A receiver is a function
``place(u1, u2, *shape) -> (point, normal)`` that is uniform by area.
"""

import dataclasses
import math
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.cavity import Walk, everywhere, inside_cap
from jaxmc.transport.vec import Vec3, cross, normalize
from jaxmc.transport.warps import sample_cosine_hemisphere, sincos_2pi

PLACE = ("receiver: first", "receiver: second")
DIRECTION = ("direction: polar", "direction: azimuth")
UP = (0.0, 0.0, 1.0)


def mean_over(primitives, place: Callable, shape, lights: str = "nee", *, bounces: int = 0) -> mc.Integrand:
    """Return the irradiance from the lights among ``primitives`` in the mean over the receiver ``place(.., *shape)``.

    The items of ``shape`` are numbers and vectors of shape (3,). Options as in ``mc.irradiance``.
    """
    shape = tuple(Vec3(*map(float, item)) if np.ndim(item) else float(item) for item in shape)
    fixed = mc.irradiance(mc.Scene(primitives), (0.0, 0.0, 0.0), UP, bounces=bounces, lights=lights)
    fn = _MeanIrradiance(fixed.fn, place)
    return mc.Integrand(fn, fixed.dim + 2, (fixed.params[0], shape), lazy=True, labels=(*PLACE, *fixed.labels))


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


def on_quad(u1, u2, corner: Vec3, edge_u: Vec3, edge_v: Vec3):
    """Return a point of a parallelogram and its normal, along cross(edge_u, edge_v)."""
    return corner + edge_u * u1 + edge_v * u2, normalize(cross(edge_u, edge_v))


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


class _After:
    """The coordinates of a point after the first ``skip``."""

    def __init__(self, u, skip):
        self.u, self.skip = u, skip

    def __getitem__(self, k):
        return self.u[k + self.skip]


@dataclasses.dataclass(frozen=True)
class _MeanIrradiance:
    """Irradiance at a point that the first two coordinates place; ``at_point`` is the function of ``mc.irradiance``."""

    at_point: Callable
    place: Callable

    def __call__(self, u, scene, shape):
        point, normal = self.place(u[0], u[1], *shape)
        return self.at_point(_After(u, 2), scene, point, normal)


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
