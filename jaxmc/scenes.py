"""The scenes of the studies and benchmarks, each with the camera that looks at it."""

from .transport.camera import Camera, PinholeCamera
from .transport.materials import Diffuse, Mirror
from .transport.primitives import Quad, Sphere
from .transport.scene import Scene

WHITE, RED, GREEN = (0.73, 0.73, 0.73), (0.65, 0.05, 0.05), (0.12, 0.45, 0.15)


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
    white = Diffuse(WHITE)
    walls = _room((-1, -1, -1), (1, 1, 1), Diffuse(RED), Diffuse(GREEN), white)
    spheres = [Sphere((-0.4, -0.65, -0.3), 0.35, white), Sphere((0.4, -0.65, 0.3), 0.35, white)]
    camera = PinholeCamera((0, 0, 3.9), (0, 0, 0), fov=40, width=width, height=height)
    return Scene([*walls, _lamp((0, 0.99, 0), 0.25, 15.0), *spheres]), camera


def mirror_box(mirror=True, width=240, height=160) -> tuple[Scene, Camera]:
    """Return a box with a green sphere and a second sphere, a mirror or white, lit by one small, strong light.

    The light, of emission 500, lies at the ceiling above the picture's upper edge, so that the camera does not see it
    directly. After the box of M. Pharr, "Ignoring the Inconvenient When Tracing Rays" (Haines and Akenine-Moeller,
    Ray Tracing Gems, 2019, chapter 17), which gives no coordinates: these are our own.
    """
    white = Diffuse(0.7)
    walls = _room((-1.5, -1, -1), (1.5, 1, 3), white, white, white, front=True)
    spheres = [
        Sphere((-0.65, -0.55, 0.0), 0.45, Diffuse((0.2, 0.6, 0.2))),
        Sphere((0.65, -0.55, 0.0), 0.45, Mirror(0.95) if mirror else white),
    ]
    camera = PinholeCamera((0, -0.1, 2.9), (0, -0.25, 0), fov=42, width=width, height=height)
    return Scene([*walls, _lamp((0.0, 0.995, 0.4), 0.06, 500.0), *spheres]), camera


def sparkle_box(albedo=0.95, closed=False, width=128, height=128) -> tuple[Scene, Camera]:
    """Return a white box with a lamp 0.001 below its ceiling: a path that enters the gap bounces there for long.

    The front is open, and the camera looks in from outside. ``closed`` adds the front wall and puts the camera inside:
    then no path escapes, and the throughput after k uniformly drawn directions is a product of k independent factors.
    """
    white = Diffuse(albedo)
    walls = _room((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), white, white, white, front=closed)
    origin = (0, 0, 0.45) if closed else (0, 0, 1.9)
    camera = PinholeCamera(origin, (0, 0, 0), fov=80 if closed else 40, width=width, height=height)
    return Scene([*walls, _lamp((0.0, 0.499, 0.0), 0.25, 4.0, albedo)]), camera
