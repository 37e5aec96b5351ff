"""Closed forms of the share of a uniform sky that a receiver sees beside spheres and parallelograms.

The share is weighted by the cosine: 1 is open, 0 is closed. Everything is written with ``jax.numpy``, so ``jax.grad``
gives true derivatives, moving edges included. The receiver stands at the origin with normal +z.
"""

import jax
import jax.numpy as jnp

from analytic_scenes.caps import caps_irradiance, sphere_caps
from analytic_scenes.irradiance import (
    polygon_irradiance,
    rectangle_solid_angle,
    sphere_at_irradiance,
    sphere_irradiance,
)

UP = (0.0, 0.0, 1.0)
WHITE = 1.0 / jnp.pi  # radiance of a sky that makes an open receiver's irradiance 1


def beside_sphere(radius, distance, theta):
    """Share of the sky beside a sphere whose centre is at ``distance`` and at ``theta`` from the normal."""
    return 1.0 - sphere_irradiance(WHITE, radius, distance, theta)


def beside_sphere_within(radius, distance, theta, max_distance):
    """The same where blockers count up to ``max_distance`` only: they fill a smaller cone, by the law of cosines."""
    tangent2 = distance**2 - radius**2
    cosine = (distance**2 + max_distance**2 - radius**2) / (2.0 * distance * max_distance)
    reached = jnp.sqrt(jnp.maximum(1.0 - jnp.minimum(cosine, 1.0) ** 2, 1e-30))
    sine = jnp.where(max_distance**2 < tangent2, reached, radius / distance)
    return jnp.where(max_distance > distance - radius, 1.0 - sphere_irradiance(WHITE, sine, 1.0, theta), 1.0)


def solid_angle_beside_sphere(radius, distance):
    """Solid angle [sr] of the upper half of the sky that a sphere wholly above the horizon leaves open."""
    return 2.0 * jnp.pi * jnp.sqrt(1.0 - (radius / distance) ** 2)


def under_two_spheres(center_1, radius_1, center_2, radius_2):
    """Share of the sky under two spheres that may hide each other in part. Source: ``caps_irradiance``."""
    both = jnp.concatenate([sphere_caps(center_1, radius_1), sphere_caps(center_2, radius_2)])
    alone = sphere_at_irradiance(WHITE, center_1, radius_1) + sphere_at_irradiance(WHITE, center_2, radius_2)
    return 1.0 - alone + WHITE * caps_irradiance(both, jnp.asarray(UP))


def under_parallelogram(corner, edge_u, edge_v, normal=UP):
    """Share of the sky beside or under a parallelogram. Source: ``polygon_irradiance``."""
    corner, u, v = (jnp.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    return 1.0 - polygon_irradiance(WHITE, jnp.stack([corner, corner + u, corner + u + v, corner + v]), normal)


def beside_wall_within(distance, max_distance):
    """Share of the sky at ``distance`` from a wall, blockers counting up to ``max_distance``.

    The wall is larger than that. By Nusselt's analog it hides a segment of the unit disk.
    """
    return 1.0 - _segment(distance / max_distance) / jnp.pi


def in_corner_within(distance_a, distance_b, max_distance):
    """Share of the sky in the corner of two large walls, blockers counting up to ``max_distance``.

    Nusselt's analog: two segments of the unit disk less what they share. The edge of the walls is in reach:
    distance_a^2 + distance_b^2 < max_distance^2.
    """
    a, b = distance_a / max_distance, distance_b / max_distance
    shared = (jnp.arccos(b) - jnp.arcsin(a) - a * jnp.sqrt(1.0 - a**2) - b * jnp.sqrt(1.0 - b**2)) / 2.0 + a * b
    return 1.0 - (_segment(a) + _segment(b) - shared) / jnp.pi


def pixel_under_sphere(radius, height, x, y, side):
    """Mean share of the sky on the square of ``side`` about the floor point (x, y), under a sphere above the origin."""
    half = side / 2.0
    return 1.0 - radius**2 * rectangle_solid_angle(x - half, x + half, y - half, y + half, height) / side**2


def _segment(height) -> jax.Array:
    """Area of the segment that a chord at ``height`` from its centre cuts off the unit disk."""
    return jnp.arccos(height) - height * jnp.sqrt(1.0 - height**2)
