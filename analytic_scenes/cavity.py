"""A walk inside a hollow diffuse sphere whose wall may emit and reflect otherwise from place to place.

The kernel cos cos'/(pi r^2) between two points of a sphere of radius R is 1/(4 pi R^2), whatever the points are. So
with cosine-distributed directions every hit is uniform on the sphere and independent of all others, and any map of
emission and albedo has exact answers. ``mc.Sphere`` is of one colour, so the walk stands here: a ray, the other end of
its chord, a new direction.

Maps are functions ``map(direction, *parameters)`` of the unit vector from the centre to a point of the wall.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jax import lax

import jaxmc as mc
from jaxmc.transport import rays, spheres
from jaxmc.transport.bsdfs import sample_diffuse
from jaxmc.transport.vec import Vec3, normalize


@dataclasses.dataclass(frozen=True)
class Walk:
    """What a path collects that starts at a point of the wall.

    Called as ``walk(u, first, start, radius, survival, lamp, paint)``, where coordinates from ``first`` on feed it.

    bounces     number of scattering events
    emission    map of the radiance that the wall emits; its parameters are ``lamp``
    albedo      map of the albedo; its parameters are ``paint``
    directions  "cosine" or "uniform"
    fewest      light that was scattered fewer times is left out
    guaranteed  the first events without Russian roulette; None for no roulette
    """

    bounces: int
    emission: Callable
    albedo: Callable
    directions: str = "cosine"
    fewest: int = 0
    guaranteed: int | None = None

    def coordinates(self) -> tuple[str, ...]:
        """Return what the coordinates of one scattering event decide."""
        return (*(("survival",) if self.guaranteed is not None else ()), "direction: polar", "direction: azimuth")

    def __call__(self, u, first, start: Vec3, radius, survival, lamp, paint):
        sphere = spheres.SphereShape(Vec3(0.0, 0.0, 0.0), radius)
        stride = len(self.coordinates())

        def event(state, k):
            place, beta, collected = state
            coordinate = first + stride * k
            beta = beta * self.albedo(place, *paint)
            if self.guaranteed is not None:
                chance = jnp.where(k < self.guaranteed, 1.0, survival)
                beta = jnp.where(u[coordinate] < chance, beta / chance, 0.0)
                coordinate = coordinate + 1
            wi, _, weight = sample_diffuse(self.directions, -place, u[coordinate], u[coordinate + 1])
            ray = rays.ray(place * radius, wi)
            place = normalize(ray.origin + wi * spheres.intersect(sphere, ray, True))
            beta = beta * weight
            seen = jnp.where(k + 1 >= self.fewest, beta * self.emission(place, *lamp), 0.0)
            return (place, beta, collected + seen), None

        first_seen = self.emission(start, *lamp) if self.fewest == 0 else 0.0
        state = (Vec3(*map(jnp.asarray, start)), jnp.ones(()), jnp.asarray(first_seen, float))
        return state[2] if self.bounces == 0 else lax.scan(event, state, jnp.arange(self.bounces))[0][2]


@dataclasses.dataclass(frozen=True)
class _FromOnePlace:
    walk: Walk

    def __call__(self, u, start, radius, survival, lamp, paint):
        return self.walk(u, 0, start, radius, survival, lamp, paint)


def wall_radiance(walk: Walk, start, *, radius=2.0, survival=1.0, lamp=(), paint=()) -> mc.Integrand:
    """Return the radiance that leaves the wall at the unit vector ``start``, shape (3,), from the centre."""
    labels = tuple(f"event {k + 1}, {word}" for k in range(walk.bounces) for word in walk.coordinates()) or ("unused",)
    start = Vec3(*(float(x) for x in start))
    params = (start, radius, survival, tuple(lamp), tuple(paint))
    return mc.Integrand(_FromOnePlace(walk), len(labels), params, lazy=True, labels=labels)


def everywhere(place, value):
    """Map of one value."""
    return value


def inside_cap(place, inside, outside, cos_half_angle):
    """Map of one value in the cap about +z, and another on the rest of the sphere."""
    return jnp.where(place.z > cos_half_angle, inside, outside)


def quadratic(place, value, slope):
    """Map of ``value`` (1 + ``slope`` z^2)."""
    return value * (1.0 + slope * place.z * place.z)


def lit_by_a_point(place, power, offset, radius, albedo):
    """Map of the light that a diffuse wall reflects from an isotropic point of ``power`` at height ``offset``.

    It counts as emission: a point light is seen in one way only, so there is nothing to sample.
    """
    squared = radius * radius + offset * offset - 2.0 * radius * offset * place.z
    cosine_times_distance = radius - offset * place.z
    irradiance = power / (4.0 * jnp.pi) * cosine_times_distance / (squared * jnp.sqrt(squared))
    return albedo / jnp.pi * irradiance
