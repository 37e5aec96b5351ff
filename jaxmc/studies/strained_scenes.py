"""Scenes that strain the arithmetic: each family with its exact value and what is promised of it in float32.

``EPS`` is the rounding of float32. Directions and coordinates have that error, relative to the size of the scene: so
what depends on a part of relative size s can be known to about EPS / s, and no better.
"""

import math
from functools import partial

import numpy as np

from ..integration.integrand import Integrand
from ..transport.integrands import irradiance, radiance
from ..transport.materials import Diffuse, Mirror
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene
from .stress import Case

EPS = 2.0**-23
PROMISE = 1e-5
BLACK, GREY = Diffuse(0.0), Diffuse(0.5)
ORIGIN, Z = np.zeros(3), (0.0, 0.0, 1.0)
TURN = np.linalg.qr(np.array([[3.0, 1.0, 2.0], [1.0, -2.0, 1.0], [2.0, 1.0, -3.0]]))[0]  # no axis lies along another
DRIFT = np.array([1.0, -0.7, 0.4])  # the way in which scenes are moved

# ------------------------------------------------------------------------------------------------ closed forms


def under_sphere(emission, center, radius, normal=Z) -> float:
    """Return the irradiance at the origin from a sphere above the horizon: that of a point source in its centre."""
    distance = np.linalg.norm(center)
    return float(math.pi * emission * (radius / distance) ** 2 * (np.dot(center, normal) / distance))


def under_quad(emission, corner, u, v, normal=Z) -> float:
    """Return the irradiance at the origin from a parallelogram above the horizon (Lambert, Photometria, 1760)."""
    a, u, v, normal = (np.asarray(x, np.longdouble) for x in (corner, u, v, normal))
    total = np.longdouble(0.0)
    for edge in (u, v, -u, -v):
        # Cross a corner with the edge, not with the next corner: a small light would lose its digits.
        across = np.cross(a, edge)
        length = np.sqrt(across @ across)
        total += np.arctan2(length, a @ (a + edge)) * (across @ normal) / length
        a = a + edge
    return float(emission / 2 * abs(total))


# ------------------------------------------------------------------------------------------------ scale and place


def _place(scale, moved, point):
    return scale * (np.asarray(point, float) + moved * DRIFT)


BALL = np.array([0.9, 0.4, 1.5])
CORNER, EDGE_U, EDGE_V = np.array([0.5, -0.3, 1.2]), np.array([-0.2, 0.7, 0.4]), np.array([0.8, 0.3, 0.1])


def sphere_lamp(scale=1.0, moved=0.0, radius=0.5, emission=10.0) -> Integrand:
    lamp = Sphere(_place(scale, moved, BALL), scale * radius, BLACK, emission)
    return irradiance(Scene([lamp]), _place(scale, moved, ORIGIN), Z, bounces=0, lights="nee")


def quad_lamp(scale=1.0, moved=0.0, size=1.0, emission=5.0) -> Integrand:
    lamp = Quad(_place(scale, moved, CORNER), scale * size * EDGE_U, scale * size * EDGE_V, BLACK, emission)
    return irradiance(Scene([lamp]), _place(scale, moved, ORIGIN), Z, bounces=0, lights="mis")


def apart(distance) -> Integrand:
    """Return the irradiance from a lamp in a scene whose other part lies far away."""
    lamp, other = Quad(_place(1.0, distance, CORNER), EDGE_U, EDGE_V, BLACK, 5.0), _place(1.0, -distance, BALL)
    scene = Scene([lamp, Sphere(other, 0.5, BLACK)])
    return irradiance(scene, _place(1.0, distance, ORIGIN), Z, bounces=0, lights="mis")


def room(scale=1.0, moved=0.0, turn=TURN) -> Integrand:
    """Return the radiance in a closed room with a lamp under its ceiling and a ball on its floor."""

    def place(*point):
        return _place(scale, moved, turn @ np.array(point, float))

    lamp = Quad(place(0.3, 0.3, 0.99), scale * turn @ (0.0, 0.4, 0.0), scale * turn @ (0.4, 0.0, 0.0), BLACK, 5.0)
    ball = Sphere(place(0.35, 0.4, 0.25), 0.25 * scale, Diffuse(0.7))
    walls = [Quad(place(*corner), scale * turn @ u, scale * turn @ v, GREY) for corner, u, v in cube()]
    return radiance(Scene([*walls, lamp, ball]), place(0.5, 0.9, 0.5), turn @ (-0.2, -0.7, -0.3), bounces=3)


def cube() -> list:
    """Return corner and edges of the six faces of the unit cube, which look inward."""
    o, x, y, z = np.zeros(3), *np.eye(3)
    return [(o, y, z), (o, z, x), (o, x, y), (x, z, y), (y, x, z), (z, y, x)]


def scale_and_place() -> list[Case]:
    """Return scenes scaled by 1e-6 to 1e6, and moved by 1 to 1e6 times their own size."""
    kinds = [
        ("sphere lamp", sphere_lamp, under_sphere(10.0, BALL, 0.5)),
        ("quad lamp", quad_lamp, under_quad(5.0, CORNER, EDGE_U, EDGE_V)),
        ("room", room, room),
    ]
    cases = []
    for name, make, exact in kinds:
        for x in (1.3e-6, 1.3e-3, 1.3, 1.3e3, 1.3e6):
            cases.append(Case("scaled", f"{name}: x {x:g}", x, partial(make, x), exact, PROMISE))
        for x in (1.3, 1.3e1, 1.3e2, 1.3e3, 1.3e4, 1.3e5, 1.3e6):
            cases.append(Case("moved", f"{name}: + {x:g}", x, partial(make, 1.0, x), exact, PROMISE))
    for x in (1.3, 1.3e1, 1.3e2, 1.3e3, 1.3e4, 1.3e5):
        cases.append(
            Case("apart", f"quad lamp: other part {2 * x:g} away", x, partial(apart, x), kinds[1][2], PROMISE + EPS * x)
        )
    return cases


# ------------------------------------------------------------------------------------------------ sizes of spheres

UP, FOOT = TURN[2], np.array([0.1, 0.2, -0.1])
LAMP, EYE = TURN.T @ (0.3, -0.2, 1.5), TURN.T @ (0.4, 0.1, 1.0)
LIT = under_sphere(10.0, LAMP, 0.25, UP) * 0.5 / math.pi


def ground(radius) -> Integrand:
    """Return the radiance of a sphere of any size under a lamp; the ray meets it where its normal is ``UP``."""
    sphere, lamp = Sphere(FOOT - radius * UP, radius, GREY), Sphere(FOOT + LAMP, 0.25, BLACK, 10.0)
    return radiance(Scene([sphere, lamp]), FOOT + EYE, -EYE, bounces=1, lights="nee")


def over_ground(radius) -> Integrand:
    """Return the radiance of a ball that floats over a ground, which must not shade it."""
    top = FOOT + 0.25 * UP
    ball, lamp = Sphere(top - 0.1 * UP, 0.1, GREY), Sphere(top + LAMP, 0.25, BLACK, 10.0)
    scene = Scene([ball, lamp, Sphere(FOOT - radius * UP, radius, BLACK)])
    return radiance(scene, top + EYE, -EYE, bounces=1, lights="nee")


def spheres() -> list[Case]:
    """Return spheres of 1e-4 to 1e6 times the scene: as what is lit, as the ground below it, as the lamp."""
    cases = []
    for x in (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6):
        # One ray meets a small sphere: its direction moves the point by EPS, the normal by EPS / radius.
        cases.append(Case("sphere", f"lit sphere: radius {x:g}", x, partial(ground, x), LIT, max(PROMISE, 4 * EPS / x)))
    for x in (1e0, 1e2, 1e4, 1e6):
        cases.append(Case("sphere", f"ball over a ground: radius {x:g}", x, partial(over_ground, x), LIT, PROMISE))
    return cases


# ------------------------------------------------------------------------------------------------ lights


def edge_on(height, plane) -> Integrand:
    """Return the irradiance from a lamp whose plane passes the receiver at ``height``."""
    corner, u, v = _edge_on(height, plane)
    return irradiance(Scene([Quad(corner, u, v, BLACK, 5.0)]), ORIGIN, Z, bounces=0, lights="mis")


UPRIGHT = np.array([0.0, 0.7, 0.4]), np.array([0.0, 0.3, 0.8])
TILTED = EDGE_U, EDGE_V


def _edge_on(height, plane):
    u, v = plane
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    return v + 0.3 * u - height * normal, u, v


def lights() -> list[Case]:
    """Return lights of 1e-1 to 1e-6 of their distance; lights seen from 1e-1 to 1e-6 over their plane, and on it."""
    cases = []
    for x in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        ball, quad = under_sphere(10.0, BALL, x), under_quad(5.0, CORNER, x * EDGE_U, x * EDGE_V)
        cases += [
            Case("small light", f"sphere: size {x:g}", x, partial(sphere_lamp, radius=x), ball, PROMISE),
            Case("small light", f"quad: size {x:g}", x, partial(quad_lamp, size=x), quad, PROMISE),
        ]
    full = under_quad(5.0, *_edge_on(0.5, TILTED))
    for name, plane, limit in (("upright", UPRIGHT, 0.0), ("tilted", TILTED, 2.0)):
        for x in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
            exact, promise = under_quad(5.0, *_edge_on(x, plane)), max(PROMISE, limit * EPS / x)
            cases.append(
                Case("edge-on", f"{name}: {x:g} over its plane", x, partial(edge_on, x, plane), exact, promise)
            )
        cases.append(Case("edge-on", f"{name}: on its plane", 0.0, partial(edge_on, 0.0, plane), 0.0, PROMISE, full))
    return cases


# ------------------------------------------------------------------------------------------------ touching surfaces


def gap(width) -> Integrand:
    """Return the radiance of a ceiling over a small lamp that shines at it from ``width`` below."""
    over = FOOT + UP
    side = 2.0 * width
    corner, u, v = _in_gap(width)
    lamp = Quad(over + corner, u, v, BLACK, 5.0)
    ceiling = Quad(over - 0.4 * TURN[0] - 0.7 * TURN[1], TURN[1], TURN[0], GREY)
    ball = Sphere(FOOT, 0.3, GREY)
    start = 1.5 * side * TURN[0] - 0.5 * width * UP
    return radiance(Scene([ceiling, lamp, ball]), over + start, -start, bounces=1, lights="mis")


def _in_gap(width):
    u, v = 2.0 * width * TURN[0], 2.0 * width * TURN[1]
    u, v = (u, v) if np.cross(u, v) @ UP > 0 else (v, u)
    return -width * UP - 0.5 * (u + v), u, v


def flush(turn) -> Integrand:
    """Return the irradiance from a lamp in the plane of a ceiling, of which it covers a part."""
    place = partial(np.matmul, turn)
    ceiling = Quad(place((-1.0, -1.2, 1.0)), place((0.0, 2.0, 0.0)), place((2.0, 0.0, 0.0)), GREY)
    lamp = Quad(place((-0.3, -0.2, 1.0)), place((0.0, 0.7, 0.0)), place((0.6, 0.0, 0.0)), BLACK, 5.0)
    ball = Sphere(place((0.9, 0.9, 0.6)), 0.1, GREY)
    return irradiance(Scene([ceiling, lamp, ball]), ORIGIN, turn @ Z, bounces=0, lights="none")


def shell() -> Integrand:
    """Return the irradiance from a spherical lamp that coincides with a black sphere."""
    lamp, twin = Sphere(BALL, 0.5, BLACK, 10.0), Sphere(BALL, 0.5, BLACK)
    return irradiance(Scene([twin, lamp]), ORIGIN, Z, bounces=0, lights="mis")


def resting_ball(distance) -> Integrand:
    """Return the irradiance from a white sky next to a black ball of radius 1/2 that rests on the receiver's plane."""
    ball = Sphere(distance * TURN[0] + 0.5 * UP, 0.5, BLACK)
    return irradiance(Scene([ball], sky=1.0), ORIGIN, UP, bounces=0, lights="none")


def touching() -> list[Case]:
    """Return surfaces 1e-2 to 1e-6 apart, touching and coincident ones."""
    cases = []
    for x in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        exact = under_quad(5.0, *_in_gap(x), -UP) * 0.5 / math.pi
        cases.append(
            Case("gap", f"lamp under a ceiling: {x:g} below", x, partial(gap, x), exact, max(PROMISE, 4 * EPS / x))
        )
    lamp = under_quad(5.0, (-0.3, -0.2, 1.0), (0.0, 0.7, 0.0), (0.6, 0.0, 0.0))
    for name, turn in (("upright", np.eye(3)), ("tilted", TURN)):
        cases.append(Case("coincident", f"lamp in a ceiling: {name}", 0.0, partial(flush, turn), lamp, PROMISE))
    cases.append(Case("coincident", "lamp on a black sphere", 0.0, shell, under_sphere(10.0, BALL, 0.5), PROMISE))
    for x in (1.0, 0.1):
        exact = math.pi * (1.0 - (0.25 / (0.25 + x * x)) ** 1.5)
        cases.append(
            Case("touching", f"beside a resting ball: {x:g} away", x, partial(resting_ball, x), exact, PROMISE)
        )
    return cases


# ------------------------------------------------------------------------------------------------ long and bright


def furnace(kind, albedo, bounces=1000) -> Integrand:
    """Return the radiance in a closed room in which every surface shines; a mirror is a sphere."""
    if kind == "box":
        walls = [Quad(TURN @ c, TURN @ u, TURN @ v, Diffuse(albedo), 1.0) for c, u, v in cube()]
        start = TURN @ (0.3, 0.6, 0.4)
    else:
        material = Mirror(albedo) if kind == "mirror" else Diffuse(albedo)
        walls, start = [Sphere(FOOT, 0.7, material, 1.0, inward=True)], FOOT + 0.3 * LAMP / np.linalg.norm(LAMP)
    return radiance(Scene(walls), start, EYE, bounces=bounces, lights="none")


def long_and_bright() -> list[Case]:
    """Return paths of 1000 events, and lights of extreme emission."""
    cases = []
    for kind in ("sphere", "box", "mirror"):
        for x in (0.999, 1.0):
            exact = sum(x**k for k in range(1001))
            cases.append(Case("1000 events", f"{kind}: albedo {x:g}", x, partial(furnace, kind, x), exact, PROMISE))
    for x in (1e-30, 1e30):
        ball, quad = under_sphere(x, BALL, 0.5), under_quad(x, CORNER, EDGE_U, EDGE_V)
        cases += [
            Case("emission", f"sphere: emission {x:g}", x, partial(sphere_lamp, emission=x), ball, PROMISE),
            Case("emission", f"quad: emission {x:g}", x, partial(quad_lamp, emission=x), quad, PROMISE),
        ]
    return cases


def all_cases() -> list[Case]:
    """Return every case of this module."""
    return [*scale_and_place(), *spheres(), *lights(), *touching(), *long_and_bright()]
