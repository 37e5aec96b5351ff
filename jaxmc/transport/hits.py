"""Where a ray ends, what stands in its way, and the surface that it meets."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from . import shapes
from .scene import Scene
from .shapes import Ray
from .vec import Vec3, dot, smaller, where


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
        return shapes.intersect_quad(scene.quads[i], ray, own == i)
    return shapes.intersect_sphere(scene.spheres[i], ray, own == i)


def primitive_at(scene: Scene, point):
    """Return the primitive on which a point lies, to rounding, or ``scene.size``, which no primitive has."""
    found = scene.size
    for i in range(scene.size):
        quad, sphere = scene.quads[i], scene.spheres[i]
        on = shapes.is_on_sphere(sphere, point) if quad is None else shapes.is_on_quad(quad, point)
        found = jnp.where(on, i, found)
    return found


def unoccluded(scene: Scene, ray: Ray, length, own, target, anywhere=False):
    """Return whether no primitive but ``own`` and ``target`` cuts the first ``length`` of the ray.

    ``anywhere`` says that the ray need not start on a primitive, so that facts about the scene's points do not help.
    """
    free = True
    for i in range(scene.size) if anywhere else scene.casters:
        if scene.lights == (i,):
            continue  # the only light is always the target
        if scene.shapes[i] == "quad":
            blocked = shapes.intersect_quad(scene.quads[i], ray, own == i) < length
        else:
            empty = i in scene.empty and not anywhere
            blocked = shapes.sphere_blocks(scene.spheres[i], ray, length, own == i, empty)
        free = free & ~(blocked & (target != i)) if i in scene.lights else free & ~blocked
    return free


def surface_at(scene: Scene, ray: Ray, hit: Hit) -> Surface:
    """Return the surface that a ray has hit."""
    i = hit.primitive
    point = ray.origin + ray.direction * jnp.where(i >= 0, hit.distance, 0.0)
    at = partial(jax.tree.map, lambda table: table.at(i), is_leaf=lambda x: hasattr(x, "group"))
    offset = point - at(scene.anchor)
    normal = at(scene.normal)
    if scene.inverse_radius is not None:
        # One Newton step for 1 / |offset| from 1 / radius; inverse_radius is 0 on quads and negative where the
        # normal points inward.
        inverse = at(scene.inverse_radius)
        normal = normal + offset * (inverse * (1.5 - 0.5 * dot(offset, offset) * inverse * inverse))
    # Draw the hit into its quad by the rounding error, along the quad, so that it lies within neighbouring walls.
    point = point - offset * at(scene.inset)
    return Surface(point, where(dot(normal, ray.direction) > 0.0, -normal, normal), at(scene.reflectance), i)
