"""Looking inside an image: for each pixel what its rays meet, how long its paths are, how noisy it is, what it costs.

Each function returns an array, row by row from the top left, for ``plot`` to draw.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from ..integration.counts import positive
from ..integration.driver import integrate_each
from ..integration.moments import Moments
from ..integration.samplers import Independent
from .camera import Camera
from .images import render
from .integrands import Film, through_film
from .intersection import intersect
from .materials import luminance
from .paths import trace
from .primitives import is_number
from .scene import Scene
from .strategy import Strategy

RAYS = 1 << 17  # that are followed at once
FIREFLY = 16.0  # one such sample makes a pixel of 16 samples brighter by display white


def view_normals(scene: Scene, camera: Camera) -> np.ndarray:
    """Return the unit normal, on the side of the eye, of what the ray through the middle of each pixel meets.

    Shape ``(height, width, 3)``; (0, 0, 0) where it meets nothing. As a colour: ``0.5 * normal + 0.5``.

    Raises:
        ValueError: a scene or camera that is none.
    """
    hit, normal = _first_hits(scene, camera, "normal")
    return np.where(hit[..., None], normal, 0.0)


def view_depth(scene: Scene, camera: Camera) -> np.ndarray:
    """Return the distance from the eye, along the ray through the middle of each pixel, of what that meets.

    Shape ``(height, width)``, in the scene's units; infinite where it meets nothing.

    Raises:
        ValueError: a scene or camera that is none.
    """
    return _first_hits(scene, camera, "distance")[1]


def _first_hits(scene, camera, name):
    """Return which pixels meet anything, and one field of the ``Intersection`` of each, in float32."""
    through_film(Film, scene, camera, Strategy(0))  # checks scene and camera
    origin = np.array(camera.origin, float)
    count, hits, values = camera.width * camera.height, [], []
    for first in range(0, count, RAYS):
        number = np.arange(first, min(first + RAYS, count))
        s, t = (number % camera.width + 0.5) / camera.width, (number // camera.width + 0.5) / camera.height
        direction = np.array(camera.forward)
        direction = direction + np.outer(2 * s - 1, np.array(camera.right)) + np.outer(2 * t - 1, np.array(camera.down))
        found = intersect(scene, np.broadcast_to(origin, direction.shape), direction)
        hits.append(np.asarray(found.primitive) >= 0)
        values.append(np.asarray(getattr(found, name)))
    shape = camera.height, camera.width
    values = np.concatenate(values)
    return np.concatenate(hits).reshape(shape), values.reshape(*shape, *values.shape[1:])


def view_bounces(
    scene: Scene, camera: Camera, *, spp=16, bounces=5, key=0, sampler=Independent(), progress=None, **options
) -> np.ndarray:  # fmt: skip
    """Return the mean number of scattering events of the paths of each pixel, shape ``(height, width)``.

    Paths are those of ``render`` with the same arguments. A path ends where it leaves the scene, by roulette, after
    ``bounces`` events, and where it carries no light any more: the event at a black surface is its last.

    Raises:
        ValueError, TypeError: as ``render``.
    """
    integrand = through_film(_Events, scene, camera, Strategy(bounces, **options))
    estimate = integrate_each(
        integrand, camera.width * camera.height, n=positive("spp", spp), key=key, sampler=sampler, progress=progress
    )
    return np.asarray(estimate.mean).reshape(camera.height, camera.width)


class _Events(Film):
    """The number of scattering events of the paths of a film."""

    def __call__(self, u, scene, camera, pixel=None):
        def observe(surface, after):
            return surface.face >= 0, luminance(after.beta) > 0.0

        _, seen = trace(
            scene, self.strategy, u, self.first(camera, pixel), self.start(u, scene, camera, pixel), observe
        )
        if seen is None:
            return jnp.zeros(())
        met, carries = seen
        # Light is carried to an event if it was carried from the one before.
        return jnp.sum(met & jnp.roll(carries, 1).at[0].set(True)).astype(float)


def view_variance(scene: Scene, camera: Camera, *, spp=64, **options) -> np.ndarray:
    """Return the relative variance of the luminance of one sample of each pixel, shape ``(height, width)``.

    That is variance / mean^2, estimated from ``spp`` samples: a pixel whose error is to be a fraction r of its mean
    wants it divided by r^2 independent samples. NaN where the mean is 0. Arguments and errors as in ``render``.
    """
    moments = render(scene, camera, spp=spp, **options, tallies={"luminance": Moments(luminance, 2)})["luminance"][0]
    mean, variance = moments.mean[..., 0], moments.variance[..., 0]
    return np.divide(variance, mean**2, out=np.full_like(mean, np.nan), where=mean != 0.0)


def view_fireflies(scene: Scene, camera: Camera, *, spp=64, threshold=FIREFLY, **options) -> np.ndarray:
    """Return how many of the samples of each pixel are fireflies, shape ``(height, width)``, integers.

    A firefly is a sample whose luminance is at least ``threshold``; by default one that makes a pixel of 16 samples
    brighter by display white, 1. Arguments and errors as in ``render``, and ValueError for a threshold that is not
    positive and finite.
    """
    if not (is_number(threshold) and 0.0 < threshold < np.inf):
        raise ValueError(f"threshold must be a positive luminance, got {threshold!r}")
    tallies = {"fireflies": Moments(_AtLeast(float(threshold)), 2)}
    moments = render(scene, camera, spp=spp, **options, tallies=tallies)["fireflies"][0]
    return np.rint(moments.mean[..., 0] * moments.n[..., 0]).astype(int)


@dataclasses.dataclass(frozen=True)
class _AtLeast:
    """1 for values whose luminance is at least ``threshold``, else 0."""

    threshold: float

    def __call__(self, value):
        return (luminance(value) >= self.threshold).astype(value.dtype)


def view_time(scene: Scene, camera: Camera, *, spp=64, tile=32, rounds=3, **options) -> np.ndarray:
    """Return the seconds that one sample takes in the region around each pixel, shape ``(height, width)``.

    The image is rendered tile by tile, ``spp`` samples in each of its pixels, on one core at a time where there are
    cores; a pixel gets the wall time of its tile over the samples in it, the best of a few rounds. It is a measurement:
    it holds the cost of starting a render, a few milliseconds for each tile, and what else the machine did. On a CPU
    paths of one scene cost nearly the same wherever they start: all take all bounces, side by side.

    Args:
        tile: its width and height in pixels; those at the right and at the bottom are smaller.
        rounds: how often each tile is timed, 2 or more, since the first time compiles.
        options: as in ``render``.

    Raises:
        ValueError, TypeError: as ``render``, or a tile or number of rounds out of range.
    """
    tile, rounds = positive("tile", tile), positive("rounds", rounds)
    if rounds < 2:
        raise ValueError("rounds must be 2 or more, got 1: the first time compiles")
    through_film(Film, scene, camera, Strategy(0))  # checks scene and camera
    seconds = np.full((camera.height, camera.width), np.inf)
    for _ in range(rounds):
        for top in range(0, camera.height, tile):
            for left in range(0, camera.width, tile):
                part = crop(camera, left, top, tile, tile)
                estimate = render(scene, part, spp=spp, **options)
                region = seconds[top : top + tile, left : left + tile]
                np.minimum(region, estimate.seconds / (estimate.n * region.size), out=region)
    return seconds


def crop(camera: Camera, left: int, top: int, width: int, height: int) -> Camera:
    """Return the camera that sees a rectangle of the pixels of another, cut off at its right and lower border."""
    width, height = min(width, camera.width - left), min(height, camera.height - top)
    # The middle and the half width and height of the rectangle, in units of those of the image.
    x, y = (2 * left + width) / camera.width - 1.0, (2 * top + height) / camera.height - 1.0
    return dataclasses.replace(
        camera,
        forward=camera.forward + camera.right * x + camera.down * y,
        right=camera.right * (width / camera.width),
        down=camera.down * (height / camera.height),
        width=width,
        height=height,
    )


def resized(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera with another number of pixels and the same vertical field of view."""
    for name, value in (("width", width), ("height", height)):
        positive(name, value, most=1 << 15)
    right = camera.right * (width / height * camera.height / camera.width)
    return dataclasses.replace(camera, right=right, width=int(width), height=int(height))
