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
from .flows import Faces, Flowed, attach, carried, distance_to, flow, reciprocal, still, turning_at

IN_A_ROW = 2  # plane mirrors that are looked through, one after the other


class Mirrors(NamedTuple):
    """The faces that are plane mirrors, and how many in a row a direction is followed through."""

    faces: tuple[int, ...] = ()
    in_a_row: int = 0


class Shown(NamedTuple):
    """What a ray meets after a plane mirror, at rest: whether it met one, the direction from it, and what that hits."""

    there: Any
    wi: Vec3
    hit: Hit


class Plane(NamedTuple):
    """A plane, by a point of it and its unit normal."""

    point: Vec3
    normal: Vec3


def mirrors_of(scene, bounces) -> Mirrors:
    """Return the plane mirrors of a scene, as it was made."""
    primitives, _ = scene.as_given()
    faces = tuple(i for i in scene.mirrors if not isinstance(primitives[scene.owner[i]], Sphere))
    return Mirrors(faces, min(IN_A_ROW, len(faces), bounces))


def is_one_of(faces: tuple[int, ...], face):
    """Return whether a face is one of some known ones."""
    there = jnp.zeros((), bool)
    for i in faces:
        there = there | (face == i)
    return there


def look_through(rest, mirrors: Mirrors, onward: Ray, hit: Hit) -> tuple[Shown, ...]:
    """Return what a ray that has met something sees in that, where it is a mirror, and in the mirrors seen there."""
    chain = []
    for _ in range(mirrors.in_a_row):
        there, surface = is_one_of(mirrors.faces, hit.face), surface_at(rest, onward, hit)
        onward = ray(surface.point, reflect(onward.direction, surface.normal))
        seen = closest_hit(rest, onward, hit.face)
        hit = seen._replace(face=jnp.where(there, seen.face, -1))
        chain.append(Shown(there, onward.direction, hit))
    return tuple(chain)


def flow_through(face_at, hit: Hit, point: Vec3, wi: Vec3, chain: tuple[Shown, ...], flat=False) -> Flowed:
    """Return how a sample moves that ``point`` sees along ``wi`` in a mirror, which is ``hit``: it stays on what that
    shows, as ``look_through`` has found it.

    ``face_at`` looks up a face in motion. What the sky shows keeps its direction. The result has the point on the first
    mirror and the direction to that.
    """
    distance, mirror = distance_to(hit), face_at(hit.face)
    # Unfold the way: the images of the point one after the other, and where the last mirror is met.
    seen_from, corner, toward, length, planes, face = point, still(point), still(wi), 0.0, [], mirror
    for shown in chain:
        step = jnp.where(shown.there, distance_to(hit), 0.0)
        planes.append(plane_of(face))
        seen_from = where(shown.there, image(planes[-1], seen_from), seen_from)
        corner, length = corner + toward * step, length + step
        toward = where(shown.there, still(shown.wi), toward)
        hit = Hit(*(jnp.where(shown.there, a, b) for a, b in zip(shown.hit, hit)))
        face = face_at(hit.face)
    free, length = hit.face < 0, length + distance_to(hit)
    moved = flow(face, seen_from, toward, length, is_within(still(face), corner), flat)
    seen = where(free, toward, moved.wi)
    for shown, plane in zip(reversed(chain), reversed(planes)):
        seen = where(shown.there, reflected(plane, seen), seen)
    first = attach(wi, seen)
    return Flowed(carried(mirror, point, first, distance), first, jnp.where(free, 1.0, moved.ratio))


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
