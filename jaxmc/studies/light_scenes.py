"""Small scenes for the study of light sampling, each with what is known of it."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..integration.integrand import Integrand
from ..transport.camera import PinholeCamera
from ..transport.integrands import Film, through_film
from ..transport.materials import Diffuse
from ..transport.paths import trace
from ..transport.primitives import Box, Quad, Sphere
from ..transport.scene import Scene
from ..transport.strategy import Strategy

UP = (0.0, 0.0, 1.0)
BLACK = Diffuse(0.0)
FURNACE_ALBEDO = 0.6
LAMPS = (  # x, y, height, radius and emission: a strong one far away, weak ones near the floor
    (0.0, 0.0, 4.0, 0.40, 60.0),
    (-2.4, -0.6, 0.5, 0.08, 12.0),
    (-1.2, 0.7, 0.4, 0.06, 20.0),
    (0.3, -0.8, 0.5, 0.08, 10.0),
    (1.4, 0.6, 0.4, 0.05, 30.0),
    (2.5, -0.4, 0.6, 0.10, 8.0),
)
PLACES = {"near a weak lamp": (-1.1, 0.6), "between the lamps": (0.9, 0.0), "at the edge": (3.2, 1.2)}


def furnace(albedo):
    """Return the inside of a diffuse sphere that emits 1 everywhere, and a camera within."""
    wall = Sphere((0.0, 0.0, 0.0), 2.0, Diffuse(albedo), 1.0, inward=True)
    return Scene([wall]), PinholeCamera((0.2, 0.1, 0.3), (1.0, 0.2, 0.1), fov=60, width=16, height=16)


def closed_room(albedo=0.7):
    """Return a closed grey room with a ball and a lamp below the ceiling, and a camera inside."""
    lamp = Quad((-0.3, 0.98, -0.3), (0.6, 0.0, 0.0), (0.0, 0.0, 0.6), BLACK, 10.0)
    ball = Sphere((0.4, -0.6, -0.4), 0.4, Diffuse(albedo))
    scene = Scene([Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), material=Diffuse(albedo), inward=True), lamp, ball])
    return scene, PinholeCamera((0.0, 0.0, 0.95), (0.0, 0.0, 0.0), fov=80, width=96, height=96)


def lamps_over_floor(width=96, height=64):
    """Return a floor under the ``LAMPS``, and a camera that sees the floor between them."""
    floor = Quad((-4.0, -4.0, 0.0), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0), Diffuse(0.8))
    camera = PinholeCamera((0.0, -5.0, 3.2), (0.0, -0.1, 0.2), up=UP, fov=42, width=width, height=height)
    return Scene([floor, *_balls()]), camera


def lamps_alone():
    """Return the ``LAMPS`` without their floor, for a receiver on it."""
    return Scene(_balls())


def _balls():
    return [Sphere((x, y, z), radius, BLACK, emission) for x, y, z, radius, emission in LAMPS]


def irradiance_of_lamps(place) -> np.ndarray:
    """Return the irradiance on the floor at (x, y) from each of the ``LAMPS``: pi Le (r / d)^2 cos, as each is whole
    above the horizon. Source: a sphere shines as a point of intensity pi Le r^2.
    """
    x, y, z, radius, emission = np.array(LAMPS).T
    squared = (x - place[0]) ** 2 + (y - place[1]) ** 2 + z**2
    return np.pi * emission * radius**2 * z / squared**1.5


def power_of_lamps() -> np.ndarray:
    """Return the share of each lamp in the power of all."""
    *_, radius, emission = np.array(LAMPS).T
    power = emission * radius**2
    return power / power.sum()


def facing_plates():
    """Return a bright plate over a receiver at the origin, a wall that ends near it, and a lamp that shines up only:
    the receiver gets light by one scattering event alone.
    """
    return Scene(
        [
            Quad((-2.0, -2.0, 2.5), (0.0, 4.0, 0.0), (4.0, 0.0, 0.0), Diffuse(0.8)),
            Quad((1.5, -2.0, -0.5), (0.0, 4.0, 0.0), (0.0, 0.0, 2.5), Diffuse(0.7)),
            Quad((-0.5, -0.5, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), BLACK, 3.0),
        ]
    )


def events(scene, camera, *, bounces, **options: Any) -> Integrand:
    """Return how many rays a path takes after the camera's, as an integrand; options as ``mc.path_integrand``."""
    return through_film(_Events, scene, camera, Strategy(bounces, **options))


class _Events(Film):
    def __call__(self, u, scene, camera, pixel=None):
        start = self.start(u, scene, camera, pixel)
        # A path that roulette has ended has no surface at its next event.
        _, seen = trace(
            scene, self.strategy, u, 2, start, lambda surface, after: jnp.where(surface.face >= 0, 1.0, 0.0)
        )
        return jnp.sum(seen)
