"""Where a ray ends, what stands in its way, and the surface that it meets."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from . import boxes, shape_tables, shapes
from .boxes import BoxShape
from .derivatives import root
from .primitives import is_concrete
from .rays import Ray
from .scene import Scene
from .vec import Vec3, dot, larger, smaller, where
from .warps import grazing


class Hit(NamedTuple):
    """Where a ray ends: ``face`` is -1 and ``distance`` infinite where it leaves the scene."""

    distance: Any
    face: Any


class Surface(NamedTuple):
    """A point to scatter at; the unit normal is on the side that the path came from.

    ``behind`` says that this is the back of the face; None where nobody asks.
    """

    point: Vec3
    normal: Vec3
    reflectance: Any
    face: Any
    behind: Any = None


def closest_hit(scene: Scene, ray: Ray, own=-1) -> Hit:
    """Return the closest hit of one ray that starts on face ``own`` (-1: on none)."""
    found = []
    for i, s in zip(scene.first, scene.shapes):
        distance, face = shapes.intersect(s, i, ray, own, scene.is_same(own, i))
        # Of a box ask for the face only where it is the closest.
        found.append((distance, i if isinstance(s, BoxShape) else face))
    distance, face = jnp.inf, -1
    if found:
        # Keep all distances, then compare: two wide kernels instead of a chain of masks.
        (distance, face), *others = found
        for other, _ in others:
            distance = smaller(distance, other)
        for other, its_face in others:
            face = jnp.where(other == distance, its_face, face)
        face = _face_of_box(scene, ray, own, face)
    for table in scene.tables:
        best = jnp.asarray(distance, float), jnp.asarray(face, jnp.int32)
        distance, face = shape_tables.nearest(table, ray, own, scene.plane_of(own), best)
    return Hit(distance, jnp.where(distance < jnp.inf, face, -1)) if found or scene.tables else Hit(jnp.inf, -1)


def _face_of_box(scene, ray, own, face):
    """Return the face that a ray has met, where ``face`` is the first one of a box; else ``face``."""
    found = [(i, s) for i, s in zip(scene.first, scene.shapes) if isinstance(s, BoxShape)]
    if not found:
        return face
    (first, box), *others = found
    is_box = face == first
    for i, other in others:
        is_other = face == i
        box = boxes.either(is_other, other, box)
        first, is_box = jnp.where(is_other, i, first), is_box | is_other
    return jnp.where(is_box, first + boxes.intersect(box, ray, own - first)[1], face)


def approach(scene: Scene, ray: Ray) -> tuple[Ray, Any]:
    """Return the ray from a start near the scene, and how far that is along it.

    The digits that a far start costs are then lost once, and alike for all faces: none slips between them.
    """
    squared = dot(ray.origin, ray.origin)
    if is_concrete((squared, scene.reach)):
        ahead = max(float(squared) ** 0.5 - 2.0 * float(scene.reach), 0.0)
    else:
        ahead = larger(root(squared) - 2.0 * scene.reach, 0.0)
    return Ray(ray.origin + ray.direction * ahead, ray.direction, ray.inverse), ahead


def face_at(scene: Scene, point):
    """Return the face on which a point lies, to rounding, or ``scene.size``, which no face has."""
    found = scene.size
    for first, shape in zip(scene.first, scene.shapes):
        face = shapes.face_at(shape, point)
        found = jnp.where(face >= 0, first + face, found)
    for table in scene.tables:
        found = shape_tables.face_at(table, point, jnp.asarray(found, jnp.int32))
    return found


def unoccluded(scene: Scene, ray: Ray, length, own, target, anywhere=False):
    """Return whether nothing but the faces ``own`` and ``target`` cuts the first ``length`` of the ray.

    ``target`` is the face of a light, or None where the ray goes to the sky. ``anywhere`` says that the ray need not
    start and end on faces, so that facts about the scene's points do not help.
    """
    free = True
    for first, shape in zip(scene.first, scene.shapes):
        faces = range(first, first + shapes.faces(shape))
        if not anywhere and not any(face in scene.casters for face in faces):
            continue
        targets = set() if target is None else _lights_on(scene, faces)
        is_box = isinstance(shape, BoxShape)
        if targets and targets == set(scene.lights) and not is_box:
            continue  # the target is always on it
        empty = first in scene.empty and not anywhere
        if targets and is_box:
            # A box hides its own far sides.
            distance, face = shapes.intersect(shape, first, ray, own, False)
            blocked = distance < length
            for one in faces:
                blocked = blocked & ~((face == one) & scene.is_same(target, one))
        else:
            blocked = shapes.blocks(shape, first, ray, length, own, scene.is_same(own, first), empty)
            if targets:
                blocked = blocked & ~scene.is_same(target, first)
        free = free & ~blocked
    for table in scene.tables:
        aim = -2 if target is None else target
        planes = scene.plane_of(own), scene.plane_of(aim)
        free = free & ~shape_tables.blocks(table, ray, length, own, planes[0], aim, planes[1], anywhere)
    return free


def _lights_on(scene, faces):
    return {light for face in faces for light in scene.lights if light in (face, *scene.twins[face])}


def surface_at(scene: Scene, ray: Ray, hit: Hit) -> Surface:
    """Return the surface that a ray has hit."""
    i = hit.face
    point = ray.origin + ray.direction * jnp.where(i >= 0, hit.distance, 0.0)
    anchor, normal = at(scene.anchor, i), at(scene.normal, i)
    offset = point - anchor
    if scene.tight:
        # Draw the hit onto its plane.
        offset = offset - normal * dot(normal, offset)
        point = anchor + offset
    # Draw the hit into its face by the rounding error, along the face, so that it lies within neighbouring walls.
    point = point - offset * at(scene.inset, i)
    if scene.inverse_radius is not None:
        # One Newton step for 1 / |offset| from 1 / radius; inverse_radius is 0 on flat faces and negative where the
        # normal points inward.
        inverse = at(scene.inverse_radius, i)
        normal = normal + offset * (inverse * (1.5 - 0.5 * dot(offset, offset) * inverse * inverse))
    # At the rim of a sphere rounding must not decide the side: half of ``grazing`` is less than any ray inside has.
    back = dot(normal, ray.direction) > 0.5 * grazing()
    return Surface(
        point, where(back, -normal, normal), at(scene.reflectance, i), i, back if scene.dielectrics else None
    )


def at(table, i):
    """Return the values of face ``i`` in a ``Lookup`` or a tree of them."""
    return jax.tree.map(lambda one: one.at(i), table, is_leaf=lambda x: hasattr(x, "group"))
