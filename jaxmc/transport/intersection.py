"""Closest hits of arrays of rays: where arrays of shape (n, 3) become components, and nowhere deeper."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .hits import approach, closest_hit, surface_at
from .rays import ray
from .scene import Scene
from .vec import Vec3, normalize


class Intersection(NamedTuple):
    """Closest hits: ``primitive`` (n,) is -1 and ``distance`` (n,) infinite for a miss; ``point`` and ``normal`` are
    (n, 3), the normal on the side of the ray's origin. Primitives are numbered as they were given to the scene."""

    distance: jax.Array
    primitive: jax.Array
    point: jax.Array
    normal: jax.Array


def intersect(scene: Scene, origins, directions) -> Intersection:
    """Return the closest hits of rays: ``origins`` and ``directions`` of shape (n, 3), directions of any length.

    Raises:
        ValueError: arrays of other shapes, or a scene that is none.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, made by mc.Scene([...]), got {scene!r}")
    if np.shape(origins) != np.shape(directions) or np.shape(origins)[1:] != (3,):
        raise ValueError(f"rays must be two arrays of shape (n, 3), got {np.shape(origins)} and {np.shape(directions)}")
    return _intersect(scene, jnp.asarray(scene.local(origins), float), jnp.asarray(directions, float))


@jax.jit
def _intersect(scene, origins, directions):
    def one(origin, direction):
        start, ahead = approach(scene, ray(Vec3(*origin), normalize(Vec3(*direction))))
        hit = closest_hit(scene, start)
        surface = surface_at(scene, start, hit)
        point, normal = jnp.stack(surface.point) + scene.middle, jnp.stack(surface.normal)
        return Intersection(hit.distance + ahead, scene.primitive_of(hit.face), point, normal)

    return jax.vmap(one)(origins, directions)
