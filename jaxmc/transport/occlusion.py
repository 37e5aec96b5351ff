"""Ambient occlusion: how much of a white sky the visible surfaces see, as nested integrals or as one."""

import dataclasses
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.counts import positive
from ..integration.integrand import Integrand
from . import rays
from .bsdfs import sample_diffuse
from .camera import Camera
from .hits import closest_hit, surface_at, unoccluded
from .integrands import Film, through_film
from .primitives import is_number
from .scene import Scene
from .strategy import Strategy


def ambient_occlusion(scene: Scene, camera: Camera, *, directions=1, reach=np.inf) -> Integrand:
    """Return the mean ambient occlusion of an image as an integrand: 1 where nothing is near, 0 in a closed corner.

    It is the share of the hemisphere over a visible point, weighted by the cosine, in which no surface lies within
    ``reach``; 1 where the camera sees no surface. Two coordinates are the film position, and each direction takes two.

    With ``directions=1`` it is one flat integral over four coordinates, which evenly spread points fill as a whole.
    With more, each film position is shared by so many directions: the two nested integrals of a renderer with two
    knobs, one for film samples and one for directions. Both have the same mean.

    Args:
        scene: what is there; materials and lights do not matter.
        camera: where it is seen from.
        directions: so many for each film position.
        reach: length of the rays; infinite by default.

    Raises:
        ValueError: a number of directions that is not a positive integer, or a reach that is not positive.
    """
    count = positive("directions", directions)
    if not (is_number(reach) and reach > 0.0):
        raise ValueError(f"reach must be a positive length, got {reach!r}")
    labels = tuple(f"direction {k + 1}: {word}" for k in range(count) for word in ("polar", "azimuth"))
    kind = partial(_Occlusion, directions=count, reach=float(reach))
    return through_film(kind, scene, camera, Strategy(0), labels)


@dataclasses.dataclass(frozen=True)
class _Occlusion(Film):
    directions: int
    reach: float

    def __call__(self, u, scene, camera, pixel=None):
        start = self.start(u, scene, camera, pixel)
        hit = closest_hit(scene, start)
        surface, first = surface_at(scene, start, hit), self.first(camera, pixel)

        def add(free, k):
            wi, _, _ = sample_diffuse("cosine", surface.normal, u[first + 2 * k], u[first + 2 * k + 1])
            is_free = unoccluded(scene, rays.ray(surface.point, wi), self.reach, surface.face, None, anywhere=True)
            return free + jnp.where(is_free, 1.0 / self.directions, 0.0), None

        free, _ = lax.scan(add, jnp.zeros(()), jnp.arange(self.directions))
        return jnp.where(hit.face >= 0, free, 1.0)
