"""Rays, and what is common to all shapes that they meet.

No start offsets. A ray that leaves a face knows which one (``own``): a flat face is not hit again from its own plane, a
sphere only at its other root, which is known in closed form and which only a ray that goes inward has, a box on another
face. So no sampled direction may lie closer to the tangent plane than rounding tells, see ``warps.grazing``. Distances
are infinite where a ray misses.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from .derivatives import reciprocal
from .vec import Vec3


class Ray(NamedTuple):
    """A half line: ``direction`` has unit length, ``inverse`` holds the reciprocals of its components."""

    origin: Vec3
    direction: Vec3
    inverse: Vec3


def ray(origin, direction):
    """Return the ray from ``origin`` along the unit vector ``direction``."""
    return Ray(origin, direction, Vec3(*map(reciprocal, direction)))


class LightSample(NamedTuple):
    """A direction toward a light: distance, cosine at the light (0 where it shines away) and inverse density.

    ``inverse_pdf`` is 1 / density per solid angle, 0 where the light cannot be seen; never infinite.
    """

    wi: Vec3
    distance: Any
    inverse_pdf: Any


def sparse_dot(row, v):
    """Return the scalar product; components of ``row`` that are zero by construction are None and cost nothing."""
    terms = [a * b for a, b in zip(row, v, strict=True) if a is not None]
    return sum(terms[1:], terms[0])


def row_at(row, offset, point):
    """Return ``row . point - offset``, either with parts that are None for 0."""
    value = sparse_dot(row, point)
    return value if offset is None else value - offset


def is_rounding(height, terms):
    """Return whether a sum of ``terms`` is 0 to rounding."""
    return jnp.abs(height) <= 8.0 * float(jnp.finfo(jnp.result_type(float)).eps) * sum(map(jnp.abs, terms))
