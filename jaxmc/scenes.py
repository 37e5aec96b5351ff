"""The scenes of the studies and benchmarks, each with the camera that looks at it."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .transport.camera import Camera, PinholeCamera
from .transport.materials import Dielectric, Diffuse, Mirror
from .transport.primitives import Box, Primitive, Quad, Sphere, Triangle
from .transport.scene import Scene

WHITE, RED, GREEN = (0.73, 0.73, 0.73), (0.65, 0.05, 0.05), (0.12, 0.45, 0.15)


class Parts(NamedTuple):
    """What a scene is built from; ``view`` holds the arguments of ``PinholeCamera``, the size of the image aside."""

    primitives: list[Primitive]
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


def cornell_glass(width=256, height=256) -> tuple[Scene, Camera]:
    """Return the Cornell box with one sphere of mirror and one of glass."""
    parts = cornell_box_parts()
    *room, left, right = parts.primitives
    spheres = [dataclasses.replace(left, material=Mirror(0.9)), dataclasses.replace(right, material=Dielectric(1.5))]
    return _build(Parts([*room, *spheres], parts.view), width, height)


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


def orb(sky=False, width=128, height=128) -> tuple[Scene, Camera]:
    """Return a small bright orb over a floor with a clay ball, in the dark or under a blue ``sky``."""
    things = [
        Quad((-30, 0, 30), (60, 0, 0), (0, 0, -60), Diffuse(0.7)),
        Sphere((-0.9, 0.5, -0.5), 0.5, Diffuse((0.7, 0.35, 0.2))),
        Sphere((0.4, 0.9, 0.0), 0.12, Diffuse(0.0), emission=25.0),
    ]
    camera = PinholeCamera((0, 1.5, 5.0), (-0.1, 0.6, 0), fov=40, width=width, height=height)
    return Scene(things, sky=(0.3, 0.5, 0.9) if sky else None), camera


BUILDS = ("triangles", "quads", "boxes")


def cornell_blocks(ceiling=False, build="boxes", width=128, height=128) -> tuple[Scene, Camera]:
    """Return the Cornell box with two turned blocks on its floor, lit by a small bright lamp or by its whole ceiling.

    Both lights emit the same power. With ``ceiling`` the light is one of the five walls, and the scene consists of 30
    triangles, of 15 quads, or of 5 quads and 2 boxes; a small lamp is one quad or two triangles more.

    Args:
        ceiling: whether the whole ceiling shines.
        build: "triangles", "quads" or "boxes": what the same surfaces are made of. Boxes have a bottom face too, on the
            floor, which nothing can see.
        width, height: of the image in pixels.

    Raises:
        ValueError: another ``build``.
    """
    if build not in BUILDS:
        raise ValueError(f"build must be one of {', '.join(BUILDS)}, got {build!r}")
    white, half, emission = Diffuse(WHITE), 0.25, 15.0
    quads = _room((-1, -1, -1), (1, 1, 1), Diffuse(RED), Diffuse(GREEN), white)
    if ceiling:
        quads[1] = dataclasses.replace(quads[1], material=Diffuse(0.0), emission=emission * half**2)
    else:
        quads.append(_lamp((0, 0.99, 0), half, emission))
    blocks = [_block((-0.36, -0.4, -0.3), (0.6, 1.2, 0.6), 18.0), _block((0.36, -0.7, 0.3), (0.6, 0.6, 0.6), -18.0)]
    parts: list[Primitive] = [*quads, *blocks]
    if build != "boxes":
        parts = [*quads, *(side for block in blocks for side in _sides(block))]
    if build == "triangles":
        parts = [half for quad in parts for half in _halves(quad)]
    camera = PinholeCamera((0, 0, 3.9), (0, 0, 0), fov=40, width=width, height=height)
    return Scene(parts), camera


def _block(center, size, degrees):
    """Return a white box, turned about the vertical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return Box(center, size, ((c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c)), Diffuse(WHITE))


def _sides(box):
    """Return the faces of a box as quads, its bottom left out."""
    x, y, z = np.array(box.size)[:, None] * np.array(box.axes)
    low = np.array(box.center) - 0.5 * (x + y + z)
    places = [(low + y, z, x), (low, z, y), (low + x, y, z), (low, y, x), (low + z, x, y)]
    return [Quad(*place, box.material) for place in places]


def _halves(quad):
    """Return the two triangles of a quad."""
    a, u, v = (np.array(x, np.float64) for x in (quad.corner, quad.edge_u, quad.edge_v))
    corners = [(a, a + u, a + u + v), (a, a + u + v, a + v)]
    return [Triangle(*three, quad.material, quad.emission) for three in corners]


def many_spheres(count, width=128, height=128, seed=0) -> tuple[Scene, Camera]:
    """Return ``count`` diffuse spheres of one size at random places in the unit cube, under a sky; they may overlap."""
    centers = np.random.default_rng(seed).uniform(0.1, 0.9, (count, 3))
    spheres = [Sphere(center, 0.3 / count ** (1 / 3), Diffuse(0.5)) for center in centers]
    camera = PinholeCamera((0.5, 0.5, 2.5), (0.5, 0.5, 0.5), fov=40, width=width, height=height)
    return Scene(spheres, sky=1.0), camera


# Scenes that the command line knows by name; each makes a scene and its camera.
SCENES = {
    "cornell-box": cornell_box,
    "cornell-blocks": cornell_blocks,
    "cornell-blocks-ceiling": partial(cornell_blocks, ceiling=True),
    "mirror-box": mirror_box,
    "mirror-box-diffuse": partial(mirror_box, mirror=False),
    "sparkle-box": sparkle_box,
    "closed-sparkle-box": partial(closed_sparkle_box, albedo=0.95),
    "orb": orb,
    "orb-sky": partial(orb, sky=True),
    "many-spheres": partial(many_spheres, 100),
}
