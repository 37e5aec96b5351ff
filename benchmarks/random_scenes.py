"""Random scenes for the comparison with another renderer: rich, and physically sensible.

Nothing overlaps but a core inside a glass ball, no two faces lie in one plane, glass encloses a volume, and lights are
not tiny, so that every pixel has a variance.
"""

from typing import NamedTuple

import numpy as np

import jaxmc as mc
from jaxmc.transport.camera import Camera

WIDTH, HEIGHT, BOUNCES = 64, 48, 6
SETTINGS = ("ground", "box room", "sky", "quad room", "dome", "ground at night")
PICKS = ("uniform", "power", "distance")
ROOM, REACH = 2.6, 1.9  # half the size of a room; objects lie within this distance from the middle


class RandomScene(NamedTuple):
    """A scene, a camera, and the options of ``mc.render`` with which it is rendered."""

    name: str
    scene: mc.Scene
    camera: Camera
    options: dict


def random_scene(number) -> RandomScene:
    """Return scene ``number``, always the same one."""
    rng = np.random.default_rng([2024, number])
    setting = SETTINGS[number % len(SETTINGS)]
    around, sky = surroundings(rng, setting)
    balls = places(rng, int(rng.integers(4, 8)))
    shining = setting != "sky"
    inside = [p for i, ball in enumerate(balls) for p in thing(rng, *ball, is_light=shining and i < rng.integers(1, 4))]
    options: dict = {"bounces": BOUNCES, "pick": PICKS[number % 3], "sample_sky": bool(sky) and number % 4 < 2}
    if number % 3 == 2:
        options["roulette"] = mc.Roulette(after=2)
    is_room = "room" in setting
    towards = direction(rng)
    towards[1] = abs(towards[1]) * 0.7 - 0.2
    distance = rng.uniform(2.1, 2.3) if is_room else rng.uniform(4.2, 4.8)
    origin = towards / np.linalg.norm(towards) * distance
    camera = mc.PinholeCamera(
        origin, rng.uniform(-0.3, 0.3, 3), fov=float(rng.uniform(*((70, 85) if is_room else (32, 38)))), width=WIDTH,
        height=HEIGHT,
    )  # fmt: skip
    return RandomScene(f"{number}: {setting}", mc.Scene([*around, *inside], sky), camera, options)


def surroundings(rng, setting):
    """Return what is around the objects, and the sky."""
    if setting == "sky":
        return [], color(rng, 0.4, 1.5)
    if setting == "dome":
        return [mc.Sphere((0, 0, 0), 6.0, mc.Diffuse(color(rng, 0.1, 0.5)), color(rng, 0.2, 0.8), inward=True)], None
    if setting.startswith("ground"):
        ground = mc.Quad((-6, -2, -6), (0.5, 0, 12), (12, 0, 0.5), mc.Diffuse(color(rng, 0.2, 0.8)))
        return [ground], None if "night" in setting else color(rng, 0.2, 1.0)
    a, height = ROOM, ROOM - 0.06
    lamp = mc.Quad((-1, height, -0.7), (2, 0, 0.3), (0.2, 0, 1.4), mc.Diffuse(color(rng, 0.1, 0.6)), color(rng, 2, 5))
    if setting == "box room":
        glow = color(rng, 0.02, 0.1) if rng.random() < 0.5 else None
        return [
            mc.Box((0, 0, 0), [2 * a] * 3, material=mc.Diffuse(color(rng, 0.2, 0.8)), emission=glow, inward=True),
            lamp,
        ], None
    walls = []
    for k in range(3):
        for sign in (-1, 1):
            corner, u, v = sign * a * np.eye(3)[k], np.eye(3)[k - 2], np.eye(3)[k - 1]
            material = mc.Diffuse(color(rng, 0.2, 0.8)) if k else rough(rng)
            walls.append(mc.Quad(corner - a * (u + v), 2 * a * u, 2 * a * v, material))
    return [*walls, lamp], None


def places(rng, count):
    """Return balls, (centre, radius), that do not overlap."""
    found = []
    while len(found) < count:
        radius = rng.uniform(0.35, 0.75)
        center = direction(rng) * rng.uniform(0, 1) ** (1 / 3) * (REACH - radius)
        if all(np.linalg.norm(center - c) > radius + r + 0.02 for c, r in found):
            found.append((center, radius))
    return found


def thing(rng, center, radius, is_light):
    """Return primitives within a ball: one, or a glass ball with something in it."""
    surface: dict = {"material": material(rng)}
    if is_light:
        surface = {"material": mc.Diffuse(color(rng, 0.0, 0.6)), "emission": color(rng, 1.0, 5.0)}
    kind = rng.integers(4)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if kind < 2 and not is_light and rng.random() < 0.45:
        surface = {"material": mc.Dielectric(rng.uniform(1.2, 1.9))}
    if kind == 0:
        glass = surface["material"]
        core = []
        if isinstance(glass, mc.Dielectric) and rng.random() < 0.6:
            # A core of another material, or a bubble of air.
            inner = mc.Dielectric(1 / glass.ior) if rng.random() < 0.5 else material(rng)
            core = [mc.Sphere(center + 0.2 * radius * axes[0], rng.uniform(0.3, 0.7) * radius, inner)]
        return [mc.Sphere(center, radius, **surface), *core]
    if kind == 1:
        size = rng.uniform(0.5, 1.0, 3)
        return [mc.Box(center, 2 * radius * size / np.linalg.norm(size), axes, **surface)]
    if kind == 2:
        u, v = radius * axes[0], radius * (rng.uniform(-0.3, 0.3) * axes[0] + rng.uniform(0.5, 0.9) * axes[1])
        return [mc.Quad(center - 0.5 * (u + v), u, v, **surface)]
    angles = rng.uniform(0, 0.9) + np.array([0.0, 2.1, 4.2]) + rng.uniform(-0.4, 0.4, 3)
    corners = [center + radius * (np.cos(a) * axes[0] + np.sin(a) * axes[1]) for a in angles]
    return [mc.Triangle(*corners, **surface)]


def material(rng):
    """Return a material that is not glass."""
    chance = rng.random()
    if chance < 0.4:
        return mc.Diffuse(color(rng, 0.1, 0.9))
    return mc.Mirror(color(rng, 0.6, 1.0)) if chance < 0.55 else rough(rng)


def rough(rng):
    alpha = float(np.exp(rng.uniform(np.log(0.03), np.log(0.9))))
    if rng.random() < 0.5:
        return mc.RoughConductor(alpha, color(rng, 0.5, 1.0))
    return mc.RoughConductor(alpha, color(rng, 0.8, 1.0), eta=color(rng, 0.15, 1.5), k=color(rng, 2.0, 4.0))


def color(rng, low, high):
    return tuple(rng.uniform(low, high, 3).tolist())


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
