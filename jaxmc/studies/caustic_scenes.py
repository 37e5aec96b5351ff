"""Caustics of one small light: through a glass ball, and off a curved mirror; and photons, which find them at once.

The floor is z = 0. A camera without a body looks straight down at a square of it, so pixels are squares of floor.
Lights of all sizes have the same power.
"""

import dataclasses
import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.draw import draw
from ..integration.integrand import Integrand
from ..transport import rays
from ..transport.bsdfs import kinds_of, sample_bsdf
from ..transport.camera import Camera, PinholeCamera
from ..transport.hits import Hit, closest_hit, surface_at
from ..transport.materials import Dielectric, Diffuse, Mirror
from ..transport.primitives import Quad, Sphere
from ..transport.rays import ray
from ..transport.scene import Scene
from ..transport.vec import Vec3, dot, normalize, where
from ..transport.warps import sincos_2pi

EXTENT = 4.0  # of each scene: sizes of lights are in units of it
POWER = 60.0
ALBEDO = 0.8
FACETS = 32
FLOOR = 0  # the number of the floor's face


@dataclasses.dataclass(frozen=True)
class CausticScene:
    """A scene with a caustic.

    Attributes:
        scene, camera: what there is, and the view of a square of floor.
        light: centre and radius of its spherical light.
        aim: a rectangle (corner, edge_u, edge_v) through which all light passes that takes part in the caustic.
        window: centre and side of the square of floor that the camera sees.
        bounces: scattering events of its paths.
    """

    scene: Scene
    camera: Camera
    light: tuple[tuple[float, float, float], float]
    aim: tuple[Any, Any, Any]
    window: tuple[tuple[float, float], float]
    bounces: int


def glass_ball(size, width=64) -> CausticScene:
    """Return a glass ball over a floor under a light whose radius is ``size`` times the extent of the scene."""
    center, radius, light = (0.0, 0.0, 1.0), 0.6, (0.5, 0.0, 3.5)
    ball = Sphere(center, radius, Dielectric(1.5))
    aim = (-0.62, -0.62, 1.62), (1.3, 0.0, 0.0), (0.0, 1.24, 0.0)
    return _caustic([ball], light, size, aim, ((-0.2, 0.0), 0.8), 0.3, 5, width)


def curved_mirror(size, width=64) -> CausticScene:
    """Return half a ring of upright mirrors, which stand on a floor and see a light whose radius is ``size`` times the
    extent of the scene.
    """
    edges = np.linspace(-0.55 * math.pi, 0.55 * math.pi, FACETS + 1)
    corners = np.stack([np.cos(edges), np.sin(edges), 0.0 * edges], -1)
    wall = [Quad(a, b - a, (0.0, 0.0, 0.5), Mirror(0.95)) for a, b in itertools.pairwise(corners)]
    aim = (-0.2, -1.02, 0.0), (0.0, 2.04, 0.0), (0.0, 0.0, 1.2)
    return _caustic(wall, (-2.2, 0.3, 1.6), size, aim, ((0.2, 0.0), 1.1), 2.5, 4, width)


def _caustic(specular, place, size, aim, window, eye, bounces, width):
    if not 0.0 < size <= 0.2:
        raise ValueError(f"the size of the light must lie in (0, 0.2], in units of the scene; got {size!r}")
    radius = size * EXTENT
    emission = POWER / (4.0 * math.pi**2 * radius**2)
    floor = Quad((-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), Diffuse(ALBEDO))
    light = Sphere(place, radius, Diffuse(0.0), emission)
    (x, y), side = window
    fov = 2.0 * math.degrees(math.atan(0.5 * side / eye))
    camera = PinholeCamera((x, y, eye), (x, y, 0.0), up=(0.0, 1.0, 0.0), fov=fov, width=width, height=width)
    return CausticScene(Scene([floor, *specular, light]), camera, (place, radius), aim, window, bounces)


def photons(caustic: CausticScene) -> Integrand:
    """Return where a photon lands on the floor after at least one mirror or glass, and its flux: (x, y, flux), flux 0
    where it does not.

    It starts on the light, uniformly by area, and passes a uniform point of ``aim``: four coordinates, then two for
    each event. It meets as many surfaces as the light of a path of ``bounces`` events does before the floor.
    """
    events = caustic.bounces - 1
    labels = ("light: first", "light: second", "aim: first", "aim: second")
    labels += tuple(f"event {k + 1}: {word}" for k in range(events) for word in ("polar", "azimuth"))
    given = caustic.scene, caustic.light, tuple(np.asarray(v, float) for v in caustic.aim)
    return Integrand(_Photon(events), len(labels), given, lazy=True, labels=labels)


@dataclasses.dataclass(frozen=True)
class _Photon:
    events: int

    def __call__(self, u, scene, light, aim):
        (center, radius), (corner, edge_u, edge_v) = light, (Vec3(*v) for v in aim)
        # Start on the light and aim at the rectangle: flux is radiance times cos cos / r^2 over both densities by area.
        height, (sine, cosine) = 1.0 - 2.0 * u[0], sincos_2pi(u[1])
        across = jnp.sqrt(jnp.maximum(1.0 - height * height, 0.0))
        normal = Vec3(across * cosine, across * sine, height)
        start = Vec3(*center) + normal * radius
        to = corner + edge_u * u[2] + edge_v * u[3] - start
        area = Vec3(*jnp.cross(jnp.stack(edge_u), jnp.stack(edge_v)))
        squared = dot(to, to)
        wi = normalize(to)
        cosines = jnp.maximum(dot(normal, wi), 0.0) * jnp.abs(dot(area, wi))
        # Emission times the light's area is power / pi.
        flux = POWER / math.pi * cosines / squared
        first = ray(start, wi)
        hit = closest_hit(scene, first, scene.lights[0])
        state = first, Hit(hit.distance, jnp.asarray(hit.face)), flux, jnp.zeros((), bool)

        def event(state, k):
            path, hit, flux, specular = state
            surface = surface_at(scene, path, hit)
            kinds = kinds_of(scene, surface)
            wi, _, weight = sample_bsdf(scene, "bsdf", surface, kinds, path.direction, u[4 + 2 * k], u[5 + 2 * k])
            moves = kinds.specular & (hit.face >= 0)
            onward = rays.ray(surface.point, wi)
            after = closest_hit(scene, onward, surface.face)
            onward = rays.Ray(*(where(moves, a, b) if isinstance(a, Vec3) else a for a, b in zip(onward, path)))
            hit = Hit(*(jnp.where(moves, a, b) for a, b in zip(after, hit)))
            flux = flux * jnp.where(moves, surface.reflectance * weight, 1.0)
            return (onward, hit, flux, specular | moves), None

        (path, hit, flux, specular), _ = lax.scan(event, state, jnp.arange(self.events))
        point = surface_at(scene, path, hit).point
        return jnp.stack([point.x, point.y, jnp.where(specular & (hit.face == FLOOR), flux, 0.0)])


def caustic_by_photons(caustic: CausticScene, n, key=0):
    """Return the radiance of the caustic in each pixel by ``n`` photons, and its standard error, both (height, width).

    Light that reaches the floor without mirror or glass is left out.
    """
    (x, y), side = caustic.window
    width = caustic.camera.width
    x_edges, y_edges = (np.linspace(c - side / 2, c + side / 2, width + 1) for c in (x, y))
    sums = np.zeros((2, width, width))
    for k in range(max(1, n >> 20)):
        found = draw(photons(caustic), n=min(n, 1 << 20), key=(key << 12) + k)
        lands = np.asarray(found.value, np.float64)
        for power in (1, 2):
            sums[power - 1] += np.histogram2d(
                lands[:, 1], lands[:, 0], (y_edges, x_edges), weights=lands[:, 2] ** power
            )[0]
    drawn = max(1, n >> 20) * min(n, 1 << 20)
    scale = ALBEDO / math.pi / (side / width) ** 2
    mean, square = sums / drawn
    # The first row of a picture is the one with the largest y.
    return mean[::-1] * scale, np.sqrt(np.maximum(square - mean**2, 0.0) / drawn)[::-1] * scale
