"""Autopsy of a firefly: its path, what it depends on, and which decisions would have to be drawn better."""

from typing import NamedTuple

import numpy as np

from ..integration.samplers import Independent
from ..integration.spike import Spike, spike
from .camera import Camera
from .debug import Path, replay
from .facts import axes_of
from .integrands import path_integrand
from .materials import luminance
from .primitives import Box, Disk, Quad, Sphere, Triangle
from .scene import Scene

ROUND = np.linspace(0.0, 2.0 * np.pi, 65)


class Autopsy(NamedTuple):
    """One sample of an image: its ``path``, the ``spike`` of luminance that it lies on, and the ``points`` of the path
    from the eye to what brought most light, shape (m, 3), with the ``kinds`` of its events: the points but for the
    eye's, and the light's where a ray has met it."""

    path: Path
    spike: Spike
    points: np.ndarray
    kinds: tuple[str, ...]

    @property
    def unlikely(self) -> str:
        """What the narrowest coordinate decides: drawing it better makes such samples likely, and smaller."""
        return self.spike.labels[int(self.spike.order[0])]

    def __str__(self):
        return f"{self.path}\n\n{self.spike}\nmost unlikely: {self.unlikely}"


def autopsy(
    scene: Scene, camera: Camera, index, *, key=0, sampler=Independent(), points=None, **options
) -> Autopsy:  # fmt: skip
    """Return the path of a sample of ``render`` and the gradient of its log luminance with respect to its coordinates.

    Arguments and errors as in ``replay`` and ``spike``: a sample without light has no spike. ``plot.path_in_scene``
    draws the path.
    """
    path = replay(scene, camera, index, key=key, sampler=sampler, points=points, **options)
    if not isinstance(path, Path):
        raise ValueError(f"an autopsy is of one sample, got the indices {index!r}")
    item = path.pixel[1] * camera.width + path.pixel[0]
    integrand = path_integrand(scene, camera, **options)
    if not camera.antialias:
        # The samples of such an image have no film coordinates.
        labels = (*integrand.labels[2:], "unused", "unused")
        integrand = type(integrand)(integrand.fn, integrand.dim, integrand.params, integrand.lazy, labels)
    found = spike(integrand, index, key=key, sampler=sampler, points=points, of=luminance, item=item)
    return Autopsy(path, found, *_way(camera, path))


def _way(camera, path):
    """Return points and kinds of the events of a path, up to what brought most light."""
    gained = [v.gained for v in path.vertices]
    last = int(np.argmax(gained)) if gained and max(gained) > 0.0 else len(gained) - 1
    points = [np.array(camera.origin, float), *(v.point for v in path.vertices[: last + 1])]
    if path.vertices and path.vertices[last].met == "light":
        points.append(path.vertices[last].reached)
    return np.array(points), tuple(v.kind for v in path.vertices[: last + 1])


def outlines(scene: Scene, plane=(0, 1)) -> list[np.ndarray]:
    """Return the outlines of a scene's primitives, seen along an axis: closed lines of shape (n, 2).

    Args:
        plane: the two axes that are kept: (0, 1) is the view from the front, (0, 2) from above.

    Raises:
        ValueError: a scene that went through a transformation of JAX.
    """
    i, j = plane
    return [line[:, [i, j]] for p in scene.as_given()[0] for line in _lines(p, i, j)]


def _lines(p, i, j):
    if isinstance(p, Sphere):
        circle = np.tile(np.array(p.center, float), (len(ROUND), 1))
        circle[:, i] += float(p.radius) * np.cos(ROUND)
        circle[:, j] += float(p.radius) * np.sin(ROUND)
        return [circle]
    if isinstance(p, Quad):
        a, u, v = (np.array(x, float) for x in (p.corner, p.edge_u, p.edge_v))
        return [np.array([a, a + u, a + u + v, a + v, a])]
    if isinstance(p, Triangle):
        return [np.array([p.a, p.b, p.c, p.a], float)]
    if isinstance(p, Disk):
        _, u, v = map(np.array, axes_of(p))
        return [np.array(p.center, float) + np.outer(np.cos(ROUND), u) + np.outer(np.sin(ROUND), v)]
    assert isinstance(p, Box)
    x, y, z = 0.5 * np.array(p.size, float)[:, None] * np.array(p.axes, float)
    center = np.array(p.center, float)
    faces = [center + s * z + np.array([-x - y, x - y, x + y, y - x, -x - y]) for s in (-1.0, 1.0)]
    return [*faces, *(np.array([a, b]) for a, b in zip(*faces))]
