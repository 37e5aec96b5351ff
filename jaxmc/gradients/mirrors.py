"""What plane mirrors show, in motion: a drawn direction keeps in place what it sees in a mirror, not a point on that.

Seen from a point's own image behind the mirror, what the mirror shows lies straight ahead. So the flow is that of a
direct sight, and derivatives do not grow where the mirror is near, as those of a ray that is pinned on it do. At the
mirror's own edges what is shown moves against the frame: there, what lies in front counts as what lies behind does.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ..transport.bsdfs import reflect
from ..transport.hits import Hit, closest_hit, surface_at
from ..transport.primitives import Sphere
from ..transport.rays import Ray, ray
from ..transport.vec import Vec3, cross, dot, where
from .flows import Faces, Flowed, attach, carried, flow, reciprocal, still, turning_at


class Shown(NamedTuple):
    """What a ray meets after a plane mirror, at rest: whether it met one, the direction from it, and what that hits."""

    there: Any
    wi: Vec3
    hit: Hit


class Plane(NamedTuple):
    """A plane, by a point of it and its unit normal."""

    point: Vec3
    normal: Vec3


def plane_mirrors(scene) -> tuple[int, ...]:
    """Return the faces of a scene, as it was made, that are plane mirrors."""
    primitives, _ = scene.as_given()
    return tuple(i for i in scene.mirrors if not isinstance(primitives[scene.owner[i]], Sphere))


def is_one_of(faces: tuple[int, ...], face):
    """Return whether a face is one of some known ones."""
    there = jnp.zeros((), bool)
    for i in faces:
        there = there | (face == i)
    return there


def look_through(rest, mirrors, onward: Ray, hit: Hit) -> Shown | None:
    """Return what a ray that has met something sees in it, if that is one of ``mirrors``; None without any."""
    if not mirrors:
        return None
    there, surface = is_one_of(mirrors, hit.face), surface_at(rest, onward, hit)
    wi = reflect(onward.direction, surface.normal)
    shown = closest_hit(rest, ray(surface.point, wi), hit.face)
    return Shown(there, wi, shown._replace(face=jnp.where(there, shown.face, -1)))


def flow_through(mirror: Faces, face: Faces, point: Vec3, wi: Vec3, distance, shown: Shown, flat=False) -> Flowed:
    """Return how a sample moves that ``point`` sees in a mirror, ``distance`` away: it stays on what the mirror shows.

    ``face`` is what is shown; what the sky shows keeps its direction. The result has the point on the mirror and the
    direction to that.
    """
    plane, free = plane_of(mirror), shown.hit.face < 0
    within = is_within(still(face), still(point) + still(wi) * still(distance))
    length = distance + jnp.where(free, 1.0, shown.hit.distance)
    moved = flow(face, image(plane, point), shown.wi, length, within, flat)
    toward = attach(wi, reflected(plane, where(free, still(shown.wi), moved.wi)))
    return Flowed(carried(mirror, point, toward, distance), toward, jnp.where(free, 1.0, moved.ratio))


def is_within(face: Faces, point: Vec3):
    """Return whether a point lies inside of a sphere, whose surface then is its far side."""
    offset = point - face.center
    return dot(offset, offset) < face.radius * face.radius


def plane_of(face: Faces) -> Plane:
    """Return the plane of a flat face."""
    across = still(cross(face.half_u, face.half_v))
    normal = across * reciprocal(jnp.sqrt(dot(across, across)))
    return Plane(face.center, attach(normal, turning_at(face, face.center, -normal)))


def image(plane: Plane, point: Vec3) -> Vec3:
    """Return the mirror image of a point."""
    return point - plane.normal * (2.0 * dot(plane.normal, point - plane.point))


def reflected(plane: Plane, direction: Vec3) -> Vec3:
    """Return the mirror image of a direction."""
    return direction - plane.normal * (2.0 * dot(plane.normal, direction))
