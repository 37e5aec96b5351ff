"""What a ray can meet, of whatever kind: one function for each question, which asks the module of the kind.

A shape has one face, or six if it is a box. A face is what a ray can leave without meeting it again.
"""

import jax.numpy as jnp

from . import boxes, flats, spheres
from .boxes import BoxShape
from .flats import FlatLight, FlatShape
from .rays import LightSample, Ray
from .rectangles import inverse_pdf_rectangle_light, rectangle_light, sample_rectangle_light
from .spheres import SphereShape
from .vec import dot, where

Shape = SphereShape | FlatShape | BoxShape


def faces(shape: Shape) -> int:
    """Return how many faces a shape has."""
    return 6 if isinstance(shape, BoxShape) else 1


def intersect(shape: Shape, first, ray: Ray, own, is_own):
    """Return the distance to a shape, infinite for a miss, and the number of the face there.

    ``first`` is the number of the shape's first face, ``own`` that of the face on which the ray starts. ``is_own`` says
    that it starts on this shape or on its plane.
    """
    if isinstance(shape, BoxShape):
        distance, face = boxes.intersect(shape, ray, own - first)
        return distance, face + first
    kind = flats if isinstance(shape, FlatShape) else spheres
    return kind.intersect(shape, ray, is_own), first


def blocks(shape: Shape, first, ray: Ray, length, own, is_own, empty=False):
    """Return whether a shape cuts the first ``length`` of a ray; arguments as in ``intersect``.

    ``empty`` says that no ray starts or ends inside a sphere.
    """
    if isinstance(shape, SphereShape):
        return spheres.blocks(shape, ray, length, is_own, empty)
    return intersect(shape, first, ray, own, is_own)[0] < length


def face_at(shape: Shape, point):
    """Return the number, counted from the shape's first, of the face on which a point lies, to rounding, or -1."""
    if isinstance(shape, BoxShape):
        return boxes.face_at(shape, point)
    kind = flats if isinstance(shape, FlatShape) else spheres
    return jnp.where(kind.is_on(shape, point), 0, -1)


def sample_light(light, point, own, u1, u2, by: str) -> LightSample:
    """Sample a direction from ``point`` toward a light; ``by``: the option ``light_points`` of ``PathOptions``."""
    if isinstance(light, FlatLight):
        if by == "solid angle" and light.rectangle:
            return LightSample(*sample_rectangle_light(_rectangle(light, point), point, own, u1, u2))
        return flats.sample(light, point, own, u1, u2)
    return (spheres.sample_by_area if by == "area" else spheres.sample)(light, point, own, u1, u2)


def inverse_pdf(light, point, wi, distance, by: str):
    """Return 1 / density per solid angle of ``sample_light`` for a hit of the light, 0 where it does not shine."""
    if isinstance(light, FlatLight):
        if by == "solid angle" and light.rectangle:
            return inverse_pdf_rectangle_light(_rectangle(light, point), point)
        return flats.inverse_pdf(light, point, wi, distance)
    return (spheres.inverse_pdf_by_area if by == "area" else spheres.inverse_pdf)(light, point, wi, distance)


def _rectangle(light: FlatLight, point):
    """Return a rectangle as seen from a point, which is on its bright side if it has two."""
    normal = light.normal
    if light.two_sided:
        normal = where(dot(normal, light.center - point) > 0.0, -normal, normal)
    return rectangle_light(light.center, light.half_u, light.half_v, normal)
