"""Where a ray ends, what stands in its way, and the surface that it meets."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from . import shapes
from .derivatives import root
from .primitives import is_concrete
from .scene import Scene
from .shapes import Ray
from .vec import Vec3, dot, larger, smaller, where
from .warps import grazing


class Hit(NamedTuple):
    """Where a ray ends: ``primitive`` is -1 and ``distance`` infinite where it leaves the scene."""

    distance: Any
    primitive: Any


class Surface(NamedTuple):
    """A point to scatter at; the unit normal is on the side that the path came from."""

    point: Vec3
    normal: Vec3
    reflectance: Any
    primitive: Any


def closest_hit(scene: Scene, ray: Ray, own=-1) -> Hit:
    """Return the closest hit of one ray that starts on primitive ``own`` (-1: on none)."""
    distances = [_distance(scene, i, ray, own) for i in range(scene.size)]
    if not distances:
        return Hit(jnp.inf, -1)
    # Keep all distances, then compare: two wide kernels instead of a chain of masks.
    nearest = distances[0]
    for distance in distances[1:]:
        nearest = smaller(nearest, distance)
    primitive = 0
    for i, distance in enumerate(distances[1:], 1):
        primitive = jnp.where(distance == nearest, i, primitive)
    return Hit(nearest, jnp.where(nearest < jnp.inf, primitive, -1))


def _distance(scene, i, ray, own):
    if scene.shapes[i] == "quad":
        return shapes.intersect_quad(scene.quads[i], ray, is_same(scene, own, i))
    return shapes.intersect_sphere(scene.spheres[i], ray, is_same(scene, own, i))


def is_same(scene, own, i):
    """Return whether primitive ``own`` is ``i`` or lies on the same plane or sphere."""
    same = own == i
    for twin in scene.twins[i]:
        same = same | (own == twin)
    return same


def approach(scene: Scene, ray: Ray) -> tuple[Ray, Any]:
    """Return the ray from a start near the scene, and how far that is along it.

    The digits that a far start costs are then lost once, and alike for all primitives: none slips between them.
    """
    squared = dot(ray.origin, ray.origin)
    if is_concrete((squared, scene.reach)):
        ahead = max(float(squared) ** 0.5 - 2.0 * float(scene.reach), 0.0)
    else:
        ahead = larger(root(squared) - 2.0 * scene.reach, 0.0)
    return Ray(ray.origin + ray.direction * ahead, ray.direction, ray.inverse), ahead


def primitive_at(scene: Scene, point):
    """Return the primitive on which a point lies, to rounding, or ``scene.size``, which no primitive has."""
    found = scene.size
    for i in range(scene.size):
        quad, sphere = scene.quads[i], scene.spheres[i]
        on = shapes.is_on_sphere(sphere, point) if quad is None else shapes.is_on_quad(quad, point)
        found = jnp.where(on, i, found)
    return found


def _at(table, i):
    return jax.tree.map(lambda one: one.at(i), table, is_leaf=lambda x: hasattr(x, "group"))


def unoccluded(scene: Scene, ray: Ray, length, own, target, anywhere=False):
    """Return whether no primitive but ``own`` and ``target`` cuts the first ``length`` of the ray.

    ``anywhere`` says that the ray need not start on a primitive, so that facts about the scene's points do not help.
    """
    free = True
    for i in range(scene.size) if anywhere else scene.casters:
        targets = [light for light in scene.lights if light == i or light in scene.twins[i]]
        if targets and scene.lights == (targets[0],):
            continue  # the only light is always the target
        if scene.shapes[i] == "quad":
            blocked = shapes.intersect_quad(scene.quads[i], ray, is_same(scene, own, i)) < length
        else:
            empty = i in scene.empty and not anywhere
            blocked = shapes.sphere_blocks(scene.spheres[i], ray, length, is_same(scene, own, i), empty)
        free = free & ~(blocked & ~is_same(scene, target, i)) if targets else free & ~blocked
    return free


def surface_at(scene: Scene, ray: Ray, hit: Hit) -> Surface:
    """Return the surface that a ray has hit."""
    i = hit.primitive
    point = ray.origin + ray.direction * jnp.where(i >= 0, hit.distance, 0.0)
    anchor, normal = _at(scene.anchor, i), _at(scene.normal, i)
    offset = point - anchor
    if scene.tight:
        # Draw the hit onto its plane.
        offset = offset - normal * dot(normal, offset)
        point = anchor + offset
    # Draw the hit into its quad by the rounding error, along the quad, so that it lies within neighbouring walls.
    point = point - offset * _at(scene.inset, i)
    if scene.inverse_radius is not None:
        # One Newton step for 1 / |offset| from 1 / radius; inverse_radius is 0 on quads and negative where the
        # normal points inward.
        inverse = _at(scene.inverse_radius, i)
        normal = normal + offset * (inverse * (1.5 - 0.5 * dot(offset, offset) * inverse * inverse))
    # At the rim of a sphere rounding must not decide the side: half of ``grazing`` is less than any ray inside has.
    back = dot(normal, ray.direction) > 0.5 * grazing()
    return Surface(point, where(back, -normal, normal), _at(scene.reflectance, i), i)
