"""The scenes of the studies and benchmarks, each with the camera that looks at it."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

from .transport.camera import Camera, PinholeCamera
from .transport.materials import Diffuse, Mirror
from .transport.primitives import Quad, Sphere
from .transport.scene import Scene

WHITE, RED, GREEN = (0.73, 0.73, 0.73), (0.65, 0.05, 0.05), (0.12, 0.45, 0.15)


class Parts(NamedTuple):
    """What a scene is built from; ``view`` holds the arguments of ``PinholeCamera``, the size of the image aside."""

    primitives: list[Quad | Sphere]
    view: dict[str, Any]


def _build(parts, width, height):
    return Scene(parts.primitives), PinholeCamera(**parts.view, width=width, height=height)


def _room(low, high, left, right, rest, front=False):
    """Return the walls of a room from corner ``low`` to corner ``high``; the front, toward +z, only where asked."""
    x, y, z = low
    w, h, d = (b - a for a, b in zip(low, high, strict=True))
    walls = [
        Quad((x, y, z + d), (w, 0, 0), (0, 0, -d), rest),  # floor
        Quad((x, y + h, z), (w, 0, 0), (0, 0, d), rest),  # ceiling
        Quad((x, y, z), (w, 0, 0), (0, h, 0), rest),  # back
        Quad((x, y, z + d), (0, 0, -d), (0, h, 0), left),
        Quad((x + w, y, z), (0, 0, d), (0, h, 0), right),
    ]
    return walls + ([Quad((x + w, y, z + d), (-w, 0, 0), (0, h, 0), rest)] if front else [])


def _lamp(center, half, emission, albedo=0.0):
    """Return a square lamp that shines down."""
    x, y, z = center
    return Quad((x - half, y, z - half), (2 * half, 0, 0), (0, 0, 2 * half), Diffuse(albedo), emission)


def cornell_box(width=256, height=256) -> tuple[Scene, Camera]:
    """Return the Cornell box of the throughput benchmark: five walls, a lamp, two diffuse spheres."""
    return _build(cornell_box_parts(), width, height)


def cornell_box_parts() -> Parts:
    """Return the primitives of ``cornell_box`` and its view, to be built by another renderer too."""
    white = Diffuse(WHITE)
    walls = _room((-1, -1, -1), (1, 1, 1), Diffuse(RED), Diffuse(GREEN), white)
    spheres = [Sphere((-0.4, -0.65, -0.3), 0.35, white), Sphere((0.4, -0.65, 0.3), 0.35, white)]
    view = {"origin": (0, 0, 3.9), "target": (0, 0, 0), "up": (0, 1, 0), "fov": 40}
    return Parts([*walls, _lamp((0, 0.99, 0), 0.25, 15.0), *spheres], view)


def mirror_box(mirror=True, width=192, height=128) -> tuple[Scene, Camera]:
    """Return a box with a green sphere and a second sphere, a mirror or white, lit by one small, strong light.

    The light, of emission 500, lies at the ceiling above the picture's upper edge, so that the camera does not see it
    directly. After the box of M. Pharr, "Ignoring the Inconvenient When Tracing Rays" (Haines and Akenine-Moeller,
    Ray Tracing Gems, 2019, chapter 17), which gives no coordinates: these are our own.
    """
    return _build(mirror_box_parts(mirror), width, height)


def mirror_box_parts(mirror=True) -> Parts:
    """Return the primitives of ``mirror_box`` and its view, to be built by another renderer too."""
    white = Diffuse(0.7)
    walls = _room((-1.5, -1, -1), (1.5, 1, 3), white, white, white, front=True)
    spheres = [
        Sphere((-0.65, -0.55, 0.0), 0.45, Diffuse((0.2, 0.6, 0.2))),
        Sphere((0.65, -0.55, 0.0), 0.45, Mirror(0.95) if mirror else white),
    ]
    view = {"origin": (0, -0.1, 2.9), "target": (0, -0.25, 0), "up": (0, 1, 0), "fov": 42}
    return Parts([*walls, _lamp((0.0, 0.995, 0.4), 0.06, 500.0), *spheres], view)


def sparkle_box(width=128, height=128) -> tuple[Scene, Camera]:
    """Return an open Cornell-like box with a lamp 0.001 below its ceiling: a path that enters the gap bounces for long.

    Ceiling and lamp reflect nearly everything, so that throughput grows fastest in the gap.
    """
    bright, rest = Diffuse(0.99), Diffuse(0.75)
    walls = _room((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), Diffuse(RED), Diffuse(GREEN), rest)
    walls[1] = dataclasses.replace(walls[1], material=bright)
    camera = PinholeCamera((0, 0, 1.9), (0, 0, 0), fov=40, width=width, height=height)
    return Scene([*walls, _lamp((0.0, 0.499, 0.0), 0.25, 8.0, 0.99)]), camera


def closed_sparkle_box(albedo, width=128, height=128) -> tuple[Scene, Camera]:
    """Return the box of ``sparkle_box`` with its front closed and one albedo everywhere, seen from inside.

    No path escapes: throughput after k uniformly drawn directions is a product of k independent factors.
    """
    white = Diffuse(albedo)
    walls = _room((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), white, white, white, front=True)
    camera = PinholeCamera((0, 0, 0.45), (0, 0, 0), fov=80, width=width, height=height)
    return Scene([*walls, _lamp((0.0, 0.499, 0.0), 0.25, 8.0, albedo)]), camera


# Scenes that the command line knows by name; each makes a scene and its camera.
SCENES = {
    "cornell-box": cornell_box,
    "mirror-box": mirror_box,
    "mirror-box-diffuse": partial(mirror_box, mirror=False),
    "sparkle-box": sparkle_box,
    "closed-sparkle-box": partial(closed_sparkle_box, albedo=0.95),
}
