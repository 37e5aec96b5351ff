"""Diffuse surfaces under one light: a floor point under an orb or a ceiling lamp, a rectangle of floor, a distant sun.

Floors are z = 0. ``emission`` and ``sky`` are radiances [W/m^2/sr], ``power`` is that of a whole lamp [W]. Arguments
are those of the closed forms below, with the same names, so ``derivatives`` is keyed by them. Lights are black.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import laws
from analytic_scenes.irradiance import corner_rectangle_irradiance, rectangle_solid_angle
from analytic_scenes.lone_receiver import (
    SPHERE_SOURCE,
    UP,
    black_quad,
    black_sphere,
    described,
    law_of_lamp,
    plate_view,
)
from analytic_scenes.scene import AnalyticScene, closed_form_scene
from analytic_scenes.sensors import mean_irradiance, mean_radiance, on_parallelogram

SUN = 1e-3  # angular radius of the distant light; its size and its distance change the answer by 1e-6 of it


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 4."""
    low = {"radius": 0.9, "height": 1.0, "offset": 0.8}
    return (
        sphere_light_over_rectangle(),
        orb_over_floor(),
        orb_over_floor(sky=0.0, **low, lights="none"),
        orb_over_floor(**low, lights="none", directions="uniform"),
        ceiling_lamp(),
        ceiling_lamp(side=6.0, lights="none"),
        ceiling_lamp(side=6.0, lights="none", directions="uniform"),
        ball_in_sunlight(),
    )


def rectangle_under_sphere(emission, radius, height, x0, x1, y0, y1):
    """Mean irradiance on the floor [x0, x1] x [y0, y1] from a sphere at ``height`` >= ``radius`` above the origin.

    A sphere above the horizon acts as a point source of intensity pi emission radius^2, so the flux is that intensity
    times the solid angle of the rectangle.
    """
    solid_angle = rectangle_solid_angle(x0, x1, y0, y1, height)
    return jnp.pi * emission * radius**2 * solid_angle / ((x1 - x0) * (y1 - y0))


def floor_under_orb(emission, sky, radius, height, offset, albedo):
    """Radiance of a floor point at ``offset`` from below a sphere, under a sky that the sphere hides in part."""
    share = radius**2 * height / (height**2 + offset**2) ** 1.5
    return albedo * (sky + (emission - sky) * share)


def floor_under_ceiling_lamp(power, side, height, albedo):
    """Radiance of the floor point below the middle of a square lamp that emits ``power`` downward.

    Source: ``corner_rectangle_irradiance``, four times.
    """
    emission = power / (jnp.pi * side**2)
    return albedo / jnp.pi * 4 * corner_rectangle_irradiance(emission, side / 2, side / 2, height)


def ball_phase_law(irradiance, albedo, phase):
    """Mean radiance of the disk of a diffuse ball; ``phase`` is the angle between sun and eye seen from the ball.

    ``irradiance`` is that of the sun on a surface that faces it. Source: Lambert, Photometria (1760).
    """
    return 2 * albedo * irradiance / (3 * jnp.pi**2) * (jnp.sin(phase) + (jnp.pi - phase) * jnp.cos(phase))


def sphere_light_over_rectangle(
    emission: float = 10.0,
    radius: float = 0.4,
    height: float = 1.5,
    x0: float = 0.2,
    x1: float = 1.4,
    y0: float = -0.5,
    y1: float = 0.7,
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the mean irradiance on a rectangle of floor from a sphere above the origin: four dimensions.

    Raises ``ValueError`` where the sphere cuts the floor or the rectangle has no area.
    """
    _check_above(radius, height)
    if not (x0 < x1 and y0 < y1):
        raise ValueError(f"a rectangle with x0 < x1 and y0 < y1 is needed; got [{x0}, {x1}] x [{y0}, {y1}]")
    light = black_sphere((0.0, 0.0, height), radius, emission)
    rectangle = (x0, y0, 0.0), (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0)
    strategy = {"bounces": 0, "directions": directions, "lights": lights}

    def of_cones(order):
        points, shares = laws.rectangle_points(x0, x1, y0, y1, order)
        cones = [laws.sphere_nodes((-x, -y, height), radius) for x, y in points]
        cosines, solid_angles = np.stack([c.directions[:, 2] for c in cones]), [c.solid_angles.sum() for c in cones]
        values = emission * cosines * np.reshape(solid_angles, (-1, 1))
        return laws.law_of_values([np.outer(shares, cones[0].shares)], [values])

    def law(exact):
        return laws.converged(of_cones, 12) if lights == "nee" else law_of_lamp(strategy, exact, emission, None)

    return closed_form_scene(
        f"sphere light over a rectangle, {described(strategy)}",
        rectangle_under_sphere,
        {"emission": emission, "radius": radius, "height": height, "x0": x0, "x1": x1, "y0": y0, "y1": y1},
        mean_irradiance(mc.Scene([light]), on_parallelogram, rectangle, **strategy),
        "elementary: the sphere is a point source; " + SPHERE_SOURCE,
        geometry="A sphere hangs over a floor; the irradiance is averaged over a rectangle, as a pixel does.",
        law=law,
        view=plate_view([light], size=1.5 * height),
    )


def orb_over_floor(
    emission: float = 10.0,
    sky: float = 0.5,
    radius: float = 0.5,
    height: float = 2.0,
    offset: float = 1.0,
    albedo: float = 0.8,
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the radiance of a floor point at ``offset`` from below a luminous sphere, under a uniform sky.

    Raises ``ValueError`` where the sphere cuts the floor or touches the point.
    """
    _check_above(radius, height)
    distance = math.hypot(height, offset)
    if distance <= radius:
        raise ValueError(f"the floor point must be outside the sphere; got radius {radius} and distance {distance}")
    light = black_sphere((0.0, 0.0, height), radius, emission)
    strategy = {"bounces": 1, "directions": directions, "lights": lights}

    def law(exact):
        orb, open_sky = laws.sphere_nodes((-offset, 0.0, height), radius), laws.cap_nodes(UP, math.pi / 2)
        around = [(open_sky, sky), (laws.without(orb), sky)]
        if lights == "mis":
            return None
        if lights == "none":
            return laws.scaled(laws.law_of_directions(directions, UP, [*around, (orb, emission)]), albedo / math.pi)
        parts = laws.law_of_light(UP, orb, emission), laws.law_of_directions(directions, UP, around)
        return laws.scaled(laws.independent_sum(*parts), albedo / math.pi)

    return closed_form_scene(
        f"orb over a floor, {'dark' if sky == 0 else 'bright'} sky, {described(strategy)}",
        floor_under_orb,
        {"emission": emission, "sky": sky, "radius": radius, "height": height, "offset": offset, "albedo": albedo},
        _seen_from_above([light], sky, albedo, (offset, 0.0, 0.0), (distance - radius) / 2, strategy),
        "complement of the sky that the sphere hides; " + SPHERE_SOURCE,
        geometry="A luminous sphere hangs over a diffuse floor under a uniform sky; a floor point is seen from above.",
        law=law,
        view=plate_view([light], sky=sky, size=height + radius),
    )


def ceiling_lamp(
    power: float = 4.0,
    side: float = 2.0,
    height: float = 2.0,
    albedo: float = 0.75,
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the radiance of the floor point below the middle of a square lamp that emits ``power`` downward.

    The smaller the lamp, the brighter: by directions the variance grows as side^-2, by light sampling it vanishes.
    """
    emission = power / (math.pi * side**2)
    quad = {"corner": (-side / 2, -side / 2, height), "edge_u": (0.0, side, 0.0), "edge_v": (side, 0.0, 0.0)}
    lamp = black_quad(**quad, emission=emission)
    strategy = {"bounces": 1, "directions": directions, "lights": lights}

    def law(exact):
        received = math.pi / albedo * exact
        known = laws.of_parallelogram(lambda nodes: law_of_lamp(strategy, received, emission, nodes), **quad)
        return known and laws.scaled(known, albedo / math.pi)

    return closed_form_scene(
        f"ceiling lamp of side {side:g}, {described(strategy)}",
        floor_under_ceiling_lamp,
        {"power": power, "side": side, "height": height, "albedo": albedo},
        _seen_from_above([lamp], None, albedo, (0.0, 0.0, 0.0), height / 2, strategy),
        "Howell's catalog, configuration B-3",
        geometry="A square lamp of fixed power in the ceiling; the floor point below its middle is seen from above.",
        law=law,
        view=plate_view([lamp], size=1.5 * height),
    )


def ball_in_sunlight(irradiance: float = 3.0, albedo: float = 0.7, phase: float = math.pi / 3) -> AnalyticScene:
    """Return the mean radiance of the disk of a diffuse ball in the light of a distant sun.

    The sun is a sphere of angular radius 1e-3 far away, so ``tolerance`` is 1e-5. Raises ``ValueError`` for a phase
    outside [0, pi).
    """
    if not 0 <= phase < math.pi:
        raise ValueError(f"the phase must lie in [0, pi); got {phase}")
    far = 1e7
    sun = black_sphere((far * math.sin(phase), 0.0, far * math.cos(phase)), far * SUN, irradiance / (math.pi * SUN**2))
    scene = mc.Scene([mc.Sphere((0.0, 0.0, 0.0), 1.0, mc.Diffuse(albedo)), sun])

    def law(exact):
        # A point of the disk with normal n takes the share n.eye / pi of the hemisphere that the eye sees.
        toward_sun = (math.sin(phase), 0.0, math.cos(phase))
        normals, solid_angles, _ = laws.lune_nodes(UP, toward_sun)
        return laws.law_of_values(
            [solid_angles * (normals @ UP) / math.pi], [albedo * irradiance / math.pi * (normals @ toward_sun)]
        )

    return closed_form_scene(
        "diffuse ball in sunlight",
        ball_phase_law,
        {"irradiance": irradiance, "albedo": albedo, "phase": phase},
        mean_radiance(scene, (0.0, 0.0, 3.0), 1.0, (0.0, 0.0, -1.0), bounces=1, lights="nee"),
        "Lambert, Photometria (1760)",
        geometry="A diffuse ball in the light of a distant sun; an orthographic pixel covers exactly its disk.",
        law=law,
        view=lambda: (scene, mc.PinholeCamera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), fov=24.0, width=96, height=96)),
        tolerance=1e-5,
    )


def _check_above(radius, height):
    if not 0 < radius <= height:
        raise ValueError(f"the sphere must be above the floor: 0 < radius <= height; got {radius} and {height}")


def _seen_from_above(primitives, sky, albedo, point, height, strategy):
    """Return the radiance of a floor point seen from ``height`` straight above; its floor is as small as you like."""
    floor = mc.Quad(np.asarray(point) - (1.0, 1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), mc.Diffuse(albedo))
    scene = mc.Scene([*primitives, floor], sky)
    return mc.radiance(scene, (point[0], point[1], height), (0.0, 0.0, -1.0), **strategy)
