"""Irradiance at a point from one uniform diffuse light, seen directly and perhaps cut by the horizon; its solid angle.

The receiver is a lone point at the origin with normal +z (or ``normal``); lights are black, so nothing else reflects.
The arguments are those of the closed form, with the same names, so ``derivatives`` is keyed by them. ``emission`` is a
radiance [W/m^2/sr]; vectors have shape (3,).

With lights="none" and directions="cosine" a sample is pi times the radiance that its ray meets: a discrete law, whose
variance and kurtosis are exact. So are those of uniform directions and of light sampling, as long as the horizon does
not cut the light.
"""

import functools
import math

import numpy as np

import jaxmc as mc
from analytic_scenes import irradiance as closed_form
from analytic_scenes import laws, moving
from analytic_scenes.lone_receiver import (
    POLYGON_SOURCE,
    SPHERE_SOURCE,
    UP,
    black_disk,
    black_quad,
    black_sphere,
    described,
    law_of_hits,
    law_of_lamp,
    plate_view,
    receiver_scene,
    unit,
    vertices,
)
from analytic_scenes.scene import AnalyticScene, closed_form_scene
from analytic_scenes.sensors import scalar_irradiance


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 6."""
    wall = {"corner": (-4.0, -12.0, -2.0), "edge_u": (0.0, 24.0, 0.0), "edge_v": (20.0, 0.0, 11.0)}
    near = {"corner": (-1.0, -0.8, 0.6), "edge_u": (0.0, 1.6, 0.0), "edge_v": (2.0, 0.0, 0.4)}
    return (
        sphere_light(),
        sphere_light(radius=2.0 * math.sin(1.4), theta=0.3, lights="none"),
        sphere_light(radius=1.2, lights="none", directions="uniform"),
        rectangle_light(),
        rectangle_light(**wall, normal=UP, lights="none"),
        rectangle_light(**near, normal=UP, lights="none", directions="uniform"),
        disk_light(),
        disk_light(radius=1.5, height=0.6, lights="none"),
        light_solid_angle(),
    )


def sphere_light(
    emission: float = 10.0,
    radius: float = 0.5,
    distance: float = 2.0,
    theta: float = 0.6,
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the irradiance from a sphere whose centre lies at ``distance`` and at angle ``theta`` from the normal.

    The horizon may cut the sphere. Raises ``ValueError`` where the receiver is not outside the sphere.
    """
    if not 0 < radius < distance:
        raise ValueError(f"the receiver must be outside the sphere: 0 < radius < distance; got {radius} and {distance}")
    center = (distance * math.sin(theta), 0.0, distance * math.cos(theta))
    strategy = {"bounces": 0, "directions": directions, "lights": lights}
    reach = math.asin(radius / distance)
    nodes = laws.sphere_nodes(center, radius) if theta + reach <= math.pi / 2 else None
    return receiver_scene(
        f"sphere light, {_cut(abs(theta - math.pi / 2) < reach)}{described(strategy)}",
        closed_form.sphere_irradiance,
        {"emission": emission, "radius": radius, "distance": distance, "theta": theta},
        [black_sphere(center, radius, emission)],
        SPHERE_SOURCE,
        geometry=f"A sphere of radius {radius:g} shines on a point at distance {distance:g} from its centre, "
        f"{math.degrees(theta):.4g} degrees off the normal.",
        law=lambda exact: law_of_lamp(strategy, exact, emission, nodes),
        strategy=strategy,
        view=plate_view([black_sphere(center, radius, emission)], size=distance + radius),
    )


def rectangle_light(
    emission: float = 5.0,
    corner=(0.5, -0.3, 1.2),
    edge_u=(-0.2, 0.7, 0.4),
    edge_v=(0.8, 0.3, 0.1),
    normal=(0.2, 0.1, 1.0),
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the irradiance from any parallelogram on a receiver with ``normal`` (of any length).

    The light emits on the side of cross(edge_u, edge_v); the horizon of the receiver may cut it.
    """
    normal = unit(normal)
    light = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    heights = vertices(**light) @ normal
    strategy = {"bounces": 0, "directions": directions, "lights": lights}
    facing = np.cross(edge_u, edge_v) @ np.asarray(corner) < 0

    def law(exact):
        if heights.min() < 0 or not facing:
            return law_of_lamp(strategy, exact, emission, None)
        return laws.of_parallelogram(lambda nodes: law_of_lamp(strategy, exact, emission, nodes, normal), **light)

    return receiver_scene(
        f"rectangle light, {_cut(heights.min() < 0 < heights.max())}{described(strategy)}",
        closed_form.parallelogram_irradiance,
        {"emission": emission, **light},
        [black_quad(**light, emission=emission)],
        POLYGON_SOURCE,
        geometry="A parallelogram at any angle shines on a point; it emits on one side.",
        law=law,
        constants={"normal": normal},
        normal=normal,
        strategy=strategy,
        view=plate_view([black_quad(**light, emission=emission)], normal, size=float(np.abs(vertices(**light)).max())),
    )


def disk_light(
    emission: float = 5.0,
    radius: float = 0.5,
    height: float = 2.0,
    offset: float = 0.7,
    *,
    directions: str = "cosine",
    lights: str = "nee",
) -> AnalyticScene:
    """Return the irradiance from a level disk that shines down, its centre at ``height`` and ``offset`` to the side.

    Raises ``ValueError`` where it is not above the receiver.
    """
    if not (height > 0 and radius > 0):
        raise ValueError(f"the disk must be above the receiver: height, radius > 0; got {height} and {radius}")
    strategy = {"bounces": 0, "directions": directions, "lights": lights}
    light = black_disk((offset, 0.0, height), (0.0, 0.0, -1.0), radius, emission)

    def law(exact):
        return laws.converged(
            lambda order: law_of_lamp(strategy, exact, emission, laws.disk_nodes(radius, height, offset, order)), 32
        )

    return receiver_scene(
        f"disk light, {described(strategy)}",
        moving.disk_over_receiver,
        {"emission": emission, "radius": radius, "height": height, "offset": offset},
        [light],
        "Howell, A catalog of radiation heat transfer configuration factors, section B-14",
        geometry=f"A level disk of radius {radius:g} shines down on a point {height:g} below it, {offset:g} off its "
        "axis.",
        law=law,
        strategy=strategy,
        view=plate_view([light], size=max(height, abs(offset) + radius)),
    )


def light_solid_angle(
    corner=(-0.5, -0.3, 0.7), edge_u=(0.0, 0.6, 0.0), edge_v=(1.0, 0.0, 0.0), normal=UP
) -> AnalyticScene:
    """Return the solid angle [sr] of a parallelogram, by directions that are uniform above the horizon.

    Raises ``ValueError`` where the horizon of the receiver, whose ``normal`` has any length, cuts it.
    """
    outline = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    if (vertices(**outline) @ unit(normal)).min() < 0:
        raise ValueError(f"the parallelogram must be above the horizon; got {outline} and normal {normal}")
    # It emits on both sides: there are two lights back to back.
    turned = {"corner": corner, "edge_u": edge_v, "edge_v": edge_u}
    facing = outline if np.cross(edge_u, edge_v) @ np.asarray(corner) < 0 else turned
    light = black_quad(**facing, emission=1.0)
    return closed_form_scene(
        "solid angle of a rectangle",
        closed_form.parallelogram_solid_angle,
        outline,
        scalar_irradiance(mc.Scene([light]), (0.0, 0.0, 0.0), normal),
        "van Oosterom and Strackee, The solid angle of a plane triangle (1983)",
        geometry="A parallelogram of radiance 1 and a point from which it is seen whole.",
        law=lambda exact: laws.scaled(law_of_hits((exact / 2.0, 1.0)), 2.0),
        view=plate_view([light], normal, size=float(np.abs(vertices(**outline)).max())),
    )


def _cut(is_cut):
    return "cut by the horizon, " if is_cut else ""
