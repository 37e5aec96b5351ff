"""Closed rooms for random walks, and what three ways to keep a ray from its own surface make of them."""

import numpy as np

from ..transport.camera import PinholeCamera
from ..transport.materials import Diffuse, Mirror
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene
from . import walks
from .strained_scenes import BLACK, TURN, cube

EPSILON = 1e-4  # the constant offset: a common default
WAYS = {"ours": walks.ours, f"offset {EPSILON:g}": walks.Offset(EPSILON), "own left out": walks.exclusion}
PICTURES = {  # title: way to find hits, and size of the scene
    "ours, at any size": (walks.ours, 1.0),
    f"offset {EPSILON:g}, scene of size 4e-4: leaks": (walks.Offset(EPSILON), 4e-4),
    f"offset {EPSILON:g}, scene of size 1e4: acne": (walks.Offset(EPSILON), 1e4),
    "own primitive left out: the dome leaks": (walks.exclusion, 1.0),
}
WHITE, TOWARD = Diffuse(1.0), (0.3, 0.4, 0.5)


def rooms() -> dict[str, tuple]:
    """Return closed white rooms by name, each as a scene, a point inside, a direction, and the way in which directions
    are drawn.
    """

    def ball(material):
        return Scene([Sphere((0.1, 0.2, 0.3), 0.7, material, inward=True)]), (0.2, 0.3, 0.1), TOWARD

    return {
        "box, cosine": (*box(np.eye(3)), "cosine"),
        "box, uniform": (*box(np.eye(3)), "uniform"),
        "box, turned, far away, uniform": (*box(TURN, np.array([1000.0, -373.0, 121.0])), "uniform"),
        "box, turned, filled, uniform": (*box(TURN, filled=True), "uniform"),
        "sphere, cosine": (*ball(WHITE), "cosine"),
        "sphere, uniform": (*ball(WHITE), "uniform"),
        "sphere of mirror": (*ball(Mirror(1.0)), "cosine"),
    }


def pierced_room() -> tuple:
    """Return a closed box with balls through its walls, as ``rooms`` does: surfaces that cut each other."""
    walls = [Quad(TURN @ c, TURN @ u, TURN @ v, WHITE) for c, u, v in cube()]
    balls = [Sphere(TURN @ (0.95, 0.7, 0.2), 0.1, WHITE), Sphere(TURN @ (0.5, 0.5, 0.0), 0.2, Mirror(1.0))]
    return Scene([*walls, *balls]), TURN @ (0.5, 0.5, 0.6), TOWARD, "uniform"


def box(turn, shift=0.0, filled=False):
    """Return a box; ``filled`` puts a ball on its floor, a mirror ball in the air, a plate 1e-4 under its ceiling."""

    def place(*point):
        return turn @ np.array(point) + shift

    things = [Quad(turn @ c + shift, turn @ u, turn @ v, WHITE) for c, u, v in cube()]
    if filled:
        things += [
            Sphere(place(0.3, 0.3, 0.25), 0.25, WHITE),
            Sphere(place(0.8, 0.7, 0.3), 0.15, Mirror(1.0)),
            Quad(place(0.3, 0.3, 0.9999), turn @ (0.0, 0.4, 0.0), turn @ (0.4, 0.0, 0.0), WHITE),
        ]
    return Scene(things), place(0.5, 0.5, 0.6), TOWARD


def rates(way, size, events, key=0) -> dict:
    """Return the counts of walks in a box of a given ``size`` with two balls on its floor."""
    turn = size * TURN
    balls = [Sphere(turn @ (0.35, 0.3, 0.25), 0.25 * size, WHITE), Sphere(turn @ (0.75, 0.7, 0.1), 0.1 * size, WHITE)]
    scene = Scene([*(Quad(turn @ c, turn @ u, turn @ v, WHITE) for c, u, v in cube()), *balls])
    return _count(way, scene, turn @ (0.5, 0.5, 0.6), events, key)


def dome(way, events, key=0) -> dict:
    """Return the counts of walks inside a sphere."""
    scene, start, *_ = rooms()["sphere, uniform"]
    return _count(way, scene, start, events, key)


def _count(way, scene, start, events, key):
    scene = scene if way is walks.ours else walks.bare(scene)
    return walks.count(scene, start, TOWARD, "uniform", next_hit=way, events=events, bounces=100, key=key)


def picture(way, size, spp, key=0) -> np.ndarray:
    """Render a ball and a lamp in a closed dome with a bright sky outside, which nobody should see."""
    turn = size * TURN
    scene = Scene(
        [
            Sphere((0.0, 0.0, 0.0), 2.0 * size, Diffuse(0.7), inward=True),
            Quad(turn @ (-2.0, -2.0, -0.6), turn @ (4.0, 0.0, 0.0), turn @ (0.0, 4.0, 0.0), Diffuse(0.7)),
            Sphere(turn @ (-0.35, 0.1, -0.1), 0.5 * size, Diffuse(0.9)),
            Quad(turn @ (-0.6, -0.6, 1.3), turn @ (0.0, 1.2, 0.0), turn @ (1.2, 0.0, 0.0), BLACK, 4.0),
        ],
        sky=1.0,
    )
    camera = PinholeCamera(turn @ (0.2, -1.7, 0.15), turn @ (-0.05, 0.0, -0.15), TURN[:, 2], 60, 120, 90)
    scene = scene if way is walks.ours else walks.bare(scene)
    return walks.picture(scene, camera, next_hit=way, spp=spp, key=key)
