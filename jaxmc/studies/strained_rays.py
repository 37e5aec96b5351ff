"""Rays and coordinates at their limits: edges and corners, grazing angles, the ends of the unit interval, overflow."""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from ..integration.draw import draw
from ..integration.driver import integrate
from ..transport import warps
from ..transport.camera import PinholeCamera
from ..transport.integrands import irradiance, path_integrand
from ..transport.intersection import intersect
from ..transport.materials import Diffuse, Mirror
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene
from .strained_scenes import BLACK, FOOT, GREY, TURN, UP, Z, cube
from .stress import common_points, in_both

LAST = 1.0 - 2.0**-24  # the largest float32 below 1


class Edges(NamedTuple):
    """Rays aimed at edges and corners of a closed box: how many, from where, and how many slipped through."""

    rays: int
    start: str
    slipped: int


def edges(n, seed=0) -> list[Edges]:
    """Return how many of n rays slip through a closed, turned box with a ball inside: from inside, and from outside at
    3, 300 and 30,000 times its size; one in ten is aimed at a corner.
    """
    middle, rng = FOOT + 0.5, np.random.default_rng(seed)
    walls = [Quad(TURN @ (c - 0.5) + middle, TURN @ u, TURN @ v, GREY) for c, u, v in cube()]
    scene = Scene([*walls, Sphere(middle, 0.45, GREY)])
    target, found = _on_edges(n, rng) @ TURN.T, []
    for far in (0.0, 3.0, 300.0, 30_000.0):
        if far:
            direction = rng.normal(size=(n, 3))
            start = target - far * direction / np.linalg.norm(direction, axis=1)[:, None]
        else:
            start = rng.uniform(-0.499, 0.499, (n, 3)) @ TURN.T
            direction = target - start
        met = np.asarray(intersect(scene, start + middle, direction).primitive)
        # From outside only the ball inside tells; from inside, nothing at all.
        slipped = (met == 6) if far else (met < 0)
        found.append(Edges(n, f"{far:g} away" if far else "inside", int(slipped.sum())))
    return found


def _on_edges(n, rng):
    """Return random points on the edges of the cube around the origin, one in ten a corner, shape (n, 3)."""
    axis, along = rng.integers(0, 3, n), rng.uniform(-0.5, 0.5, n)
    points = rng.integers(0, 2, (n, 3)) - 0.5
    points[np.arange(n), axis] = np.where(rng.uniform(size=n) < 0.1, points[np.arange(n), axis], along)
    return points


def grazing(sine, n=4096, seed=0) -> dict[bool, float]:
    """Return the largest relative error of the distance to a plane that rays meet at an angle of such a sine, by
    whether the arithmetic is float64.
    """
    angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, n)[:, None]
    level = np.cos(angle) * TURN[0] + np.sin(angle) * TURN[1]
    direction = np.sqrt(1.0 - sine * sine) * level - sine * UP
    size, errors = 4.0 / sine, {}
    for wide in (False, True):
        with jax.enable_x64(wide):
            plane = Quad(-0.5 * size * (TURN[0] + TURN[1]), size * TURN[0], size * TURN[1], GREY)
            distance = np.asarray(intersect(Scene([plane]), np.tile(UP, (n, 1)), direction).distance, np.float64)
        errors[wide] = float(np.abs(distance * sine - 1.0).max())
    return errors


def limits(dim, n, seed=0) -> np.ndarray:
    """Return points, shape (m, dim), with every coordinate at 0 and at the last number below 1: all of them, each by
    itself, and in n random mixtures.
    """
    rng = np.random.default_rng(seed)
    ends, alone = np.float32([0.0, LAST]), common_points(2 * dim, dim, seed)
    for k in range(dim):
        alone[2 * k : 2 * k + 2, k] = ends
    whole = np.repeat(ends[:, None], dim, axis=1)
    mixed = np.where(rng.uniform(size=(n, dim)) < 0.5, ends[rng.integers(0, 2, (n, dim))], common_points(n, dim, seed))
    return np.concatenate([whole, alone, ends[rng.integers(0, 2, (n, dim))], mixed]).astype(np.float32)


def gallery() -> tuple[Scene, object]:
    """Return a turned, coloured room with every kind of surface and light, under a sky, and a camera."""
    walls = [Quad(TURN @ c, TURN @ u, TURN @ v, GREY) for c, u, v in cube()[:2]]
    lamp = Quad(TURN @ (0.3, 0.3, 0.95), TURN @ (0.0, 0.3, 0.0), TURN @ (0.3, 0.0, 0.0), Diffuse((0.1, 0.5, 0.9)), 4.0)
    balls = [
        Sphere(TURN @ (0.25, 0.3, 0.2), 0.2, Mirror(0.9)), Sphere(TURN @ (0.7, 0.3, 0.3), 0.1, GREY, (5.0, 1.0, 2.0)),
        Sphere(TURN @ (0.5, 0.5, 0.5), 9.0, GREY, 0.1, inward=True),
    ]  # fmt: skip
    camera = PinholeCamera(TURN @ (0.5, 0.8, 0.6), TURN @ (0.4, 0.2, 0.3), TURN[2], fov=70, width=8, height=8)
    return Scene([*walls, lamp, *balls], sky=(0.2, 0.3, 0.5)), camera


def at_limits(n=256) -> dict[str, tuple[int, int]]:
    """Return how many values of the gallery's path integrands, and of the warps, are wrong at the ends of the unit
    interval, and of how many: not finite, negative, or a direction that is not a unit vector above its surface.
    """
    found = {}
    for lights, directions in (("mis", "cosine"), ("none", "uniform")):
        paths = path_integrand(*gallery(), bounces=4, directions=directions, lights=lights)
        values = np.asarray(paths.batch(limits(paths.dim, n)), np.float64)
        found[f"paths, {lights}, {directions}"] = int((~(np.isfinite(values) & (values >= 0.0))).sum()), values.size
    u = np.stack(np.meshgrid([0.0, 2.0**-33, 0.5, LAST], [0.0, 2.0**-33, 0.25, 0.5, 0.75, LAST])).reshape(2, -1)
    for warp in (warps.sample_cosine_hemisphere, warps.sample_uniform_hemisphere):
        wi = np.stack(np.broadcast_arrays(*warp(*u.astype(np.float32)))).astype(np.float64)
        wrong = ~((np.abs((wi**2).sum(0) - 1.0) < 1e-6) & (wi[2] > 0.0))
        found[warp.__name__] = int(wrong.sum()), wrong.size
    return found


def overflow(n=1 << 14) -> dict[str, int]:
    """Return how many of the first n samples of a light of radiance 3e38 lie beyond float32 by float64's account, how
    many float32 makes infinite or NaN, and how many the estimate reports.
    """
    make = partial(_blinding, 3e38)
    with jax.enable_x64(False):
        samples, reported = draw(make(), n=n), integrate(make(), n=n).nonfinite
    _, wide = in_both(make, samples.u)
    return {
        "beyond float32": int((wide > float(np.finfo(np.float32).max)).sum()),
        "infinite": int(np.isinf(samples.value).sum()),
        "NaN": int(np.isnan(samples.value).sum()),
        "reported": int(reported),
    }


def _blinding(emission):
    """Return the irradiance from a lamp so near that some samples are larger than its radiance, others smaller."""
    lamp = Quad((-0.4, -0.4, 0.3), (0.0, 0.8, 0.0), (0.8, 0.0, 0.0), BLACK, emission)
    return irradiance(Scene([lamp]), np.zeros(3), Z, bounces=0, lights="nee")
