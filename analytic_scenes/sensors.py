"""What a scene is asked for beyond one point or one ray: means over receivers and over directions, as integrands.

Two coordinates place the receiver or the ray, those of ``mc.irradiance`` and ``mc.radiance`` follow.
"""

import dataclasses
import math
from collections.abc import Callable

import jax.numpy as jnp

import jaxmc as mc
from jaxmc.transport.vec import Vec3, cross, frame, normalize
from jaxmc.transport.warps import sample_uniform_hemisphere, sincos_2pi

UP = (0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


def mean_irradiance(scene: mc.Scene, place: Callable, shape, **strategy) -> mc.Integrand:
    """Return the mean irradiance on a receiver, as an integrand; options of ``mc.irradiance``.

    ``place(u1, u2, *shape) -> (point, normal)`` is uniform by area; the items of ``shape`` are numbers and vectors of
    shape (3,). The receiver is no part of the scene. One that lies on a primitive, to rounding, is not shadowed by it.
    """
    at_point = mc.irradiance(scene, ORIGIN, UP, **strategy)
    return _placed(at_point, at_point.dim, place, shape, "receiver")


def mean_radiance(scene: mc.Scene, center, radius: float, direction, **strategy) -> mc.Integrand:
    """Return the mean radiance that arrives through a disk along parallel rays; options of ``mc.radiance``.

    The rays start on the disk about ``center``, perpendicular to ``direction``, and go along it: the pixel of an
    orthographic camera.
    """
    along_ray = mc.radiance(scene, ORIGIN, direction, **strategy)
    dim = along_ray.dim if strategy["bounces"] else 0
    return _placed(along_ray, dim, through_disk, (center, direction, radius), "film")


def scalar_irradiance(scene: mc.Scene, point, normal) -> mc.Integrand:
    """Return the radiance integrated over the hemisphere about ``normal``, without the cosine, by uniform directions.

    Of a light with radiance 1 that is its solid angle [sr].
    """
    along_ray = mc.radiance(scene, ORIGIN, UP, bounces=0)
    return _placed(along_ray, 0, upward, (point, normal), "direction").map(_of_hemisphere)


def on_parallelogram(u1, u2, corner: Vec3, edge_u: Vec3, edge_v: Vec3):
    """Return a point of a parallelogram, uniform by area, and its unit normal."""
    return corner + edge_u * u1 + edge_v * u2, normalize(cross(edge_u, edge_v))


def through_disk(u1, u2, center: Vec3, direction: Vec3, radius):
    """Return a point of a disk, uniform by area, and the unit vector along its axis."""
    axis = normalize(direction)
    tangent, bitangent = frame(axis)
    sine, cosine = sincos_2pi(u2)
    distance = radius * jnp.sqrt(u1)
    return center + tangent * (distance * cosine) + bitangent * (distance * sine), axis


def upward(u1, u2, point: Vec3, normal: Vec3):
    """Return a point and a direction that is uniform on the hemisphere about ``normal``."""
    axis = normalize(normal)
    tangent, bitangent = frame(axis)
    local = sample_uniform_hemisphere(u1, u2)
    return point, tangent * local.x + bitangent * local.y + axis * local.z


def _of_hemisphere(mean):
    return 2.0 * math.pi * mean


def _placed(integrand, dim, place, shape, word):
    shape = tuple(Vec3(*map(float, item)) if hasattr(item, "__len__") else float(item) for item in shape)
    labels = (f"{word}: first", f"{word}: second", *(integrand.labels if dim else ()))
    return mc.Integrand(_Placed(integrand.fn, place), dim + 2, (integrand.params[0], shape), lazy=True, labels=labels)


class _After:
    """The coordinates of a point after its first two."""

    def __init__(self, u):
        self.u = u

    def __getitem__(self, k):
        return self.u[k + 2]


@dataclasses.dataclass(frozen=True)
class _Placed:
    """``fn`` of ``mc.irradiance`` or ``mc.radiance`` where the first two coordinates put it."""

    fn: Callable
    place: Callable

    def __call__(self, u, scene, shape):
        point, direction = self.place(u[0], u[1], *shape)
        return self.fn(_After(u), scene, scene.local(point), direction)
