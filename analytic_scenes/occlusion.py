"""Ambient occlusion: the share of a uniform sky that a point sees, weighted by the cosine, beside spheres and quads.

The receiver is a lone point at the origin with normal +z (or ``normal``) under a sky of radiance 1/pi, so its
irradiance is the share: 1 is open, 0 is closed. A sample by cosine-distributed directions is 1 or 0. Blockers are
black; the horizon may cut them. Arguments are those of the closed forms, with the same names.

Where a ray may be at most ``max_distance`` long to be blocked, the sky is a glowing sphere of that radius about the
receiver: what is beyond it hides nothing.
"""

import functools
import math

import numpy as np

import jaxmc as mc
from analytic_scenes import laws, sky_shares
from analytic_scenes.lone_receiver import (
    ORIGIN,
    UP,
    black_quad,
    black_sphere,
    law_of_hits,
    plate_view,
    receiver_scene,
    unit,
    vertices,
)
from analytic_scenes.scene import AnalyticScene, closed_form_scene
from analytic_scenes.sensors import scalar_irradiance

WHITE = sky_shares.WHITE
SOURCE = "complement of the irradiance from the blocker; "


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        open_beside_sphere(),
        open_beside_sphere(directions="uniform"),
        open_beside_sphere(radius=1.2, theta=math.radians(80.0)),
        open_beside_sphere_within(),
        open_solid_angle_beside_sphere(),
        open_under_two_spheres(),
        open_under_rectangle(),
        open_beside_wall_within(),
        open_in_corner_within(),
        open_pixel_under_sphere(),
    )


def open_beside_sphere(
    radius: float = 1.0, distance: float = 1.5, theta: float = 0.7, *, directions: str = "cosine"
) -> AnalyticScene:
    """Return the share of the sky beside a sphere, seen whole or cut by the horizon."""
    center = _center(radius, distance, theta)
    reach = math.asin(radius / distance)

    def law(exact):
        if directions == "cosine":
            return law_of_hits((exact, WHITE))
        if theta + reach > math.pi / 2:
            return None
        pieces = [(laws.cap_nodes(UP, math.pi / 2), WHITE), (laws.without(laws.sphere_nodes(center, radius)), WHITE)]
        return laws.law_of_directions(directions, UP, pieces)

    is_cut = abs(theta - math.pi / 2) < reach
    return _open_scene(
        f"ambient occlusion by a sphere, {'cut by the horizon, ' if is_cut else ''}{directions} directions",
        sky_shares.beside_sphere,
        {"radius": radius, "distance": distance, "theta": theta},
        [black_sphere(center, radius)],
        "Howell's catalog, section B",
        "A black sphere hides a part of a uniform sky.",
        law=law,
        directions=directions,
    )


def open_beside_sphere_within(
    radius: float = 0.8, distance: float = math.sqrt(5.0), theta: float = math.atan(0.5), max_distance: float = 1.7
) -> AnalyticScene:
    """Return the share of the sky beside a sphere that counts as far as ``max_distance`` > 0 reaches."""
    center = _center(radius, distance, theta)
    return _open_scene(
        "ambient occlusion by a sphere in part within reach",
        sky_shares.beside_sphere_within,
        {"radius": radius, "distance": distance, "theta": theta, "max_distance": max_distance},
        [black_sphere(center, radius)],
        "law of cosines; Howell's catalog, section B",
        f"A black sphere hides a part of a uniform sky, as far as rays of length {max_distance:g} reach it.",
        max_distance=max_distance,
    )


def open_solid_angle_beside_sphere(radius: float = 0.8, distance: float = 1.5, theta: float = 0.4) -> AnalyticScene:
    """Return the solid angle [sr] of open sky above a sphere, by directions that are uniform above the horizon.

    Raises ``ValueError`` where the horizon cuts the sphere: it must lie above it.
    """
    center = _center(radius, distance, theta)
    if theta + math.asin(radius / distance) > math.pi / 2:
        raise ValueError(f"the sphere must be above the horizon; got {radius=}, {distance=}, {theta=}")
    blocker = black_sphere(center, radius)
    return closed_form_scene(
        "open solid angle beside a sphere",
        sky_shares.solid_angle_beside_sphere,
        {"radius": radius, "distance": distance},
        scalar_irradiance(mc.Scene([blocker], sky=1.0), ORIGIN, UP),
        "elementary: the cone of a sphere",
        geometry="A black sphere hides a part of the upper half of the sky; directions are not weighted by the cosine.",
        law=lambda exact: laws.scaled(law_of_hits((exact / 2.0, 1.0)), 2.0),
        view=plate_view([blocker], sky=1.0, size=distance + radius),
    )


def open_under_two_spheres(
    center_1=(0.6, 0.1, 1.5), radius_1: float = 0.7, center_2=(-0.5, 0.2, 2.0), radius_2: float = 0.9
) -> AnalyticScene:
    """Return the share of the sky under two spheres; they may hide each other, and the horizon may cut them."""
    spheres = [(center_1, radius_1), (center_2, radius_2)]
    for center, radius in spheres:
        _center(radius, float(np.linalg.norm(center)), 0.0)
    return _open_scene(
        "ambient occlusion by two spheres",
        sky_shares.under_two_spheres,
        {"center_1": center_1, "radius_1": radius_1, "center_2": center_2, "radius_2": radius_2},
        [black_sphere(*sphere) for sphere in spheres],
        "Mazonka, Solid angle of conical surfaces, polyhedral cones, and intersecting spherical caps (2012)",
        "Two black spheres hide a uniform sky, one of them a part of the other too.",
    )


def open_under_rectangle(
    corner=(-0.4, -0.5, 0.9), edge_u=(1.2, 0.0, 0.0), edge_v=(0.0, 1.1, 0.0), normal=UP
) -> AnalyticScene:
    """Return the share of the sky beside or under any parallelogram: a ceiling, a wall, cut by the horizon or not."""
    normal, blocker = unit(normal), {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    return _open_scene(
        "ambient occlusion by a rectangle",
        sky_shares.under_parallelogram,
        blocker,
        [black_quad(**blocker)],
        "Lambert, Photometria (1760)",
        "A black parallelogram at any angle hides a part of a uniform sky.",
        constants={"normal": normal},
        normal=normal,
        size=float(np.abs(vertices(**blocker)).max()),
    )


def open_beside_wall_within(distance: float = 0.7, max_distance: float = 1.6) -> AnalyticScene:
    """Return the share of the sky beside a large wall that counts as far as ``max_distance`` > ``distance`` reaches."""
    if not 0 < distance < max_distance:
        raise ValueError(f"the wall must be in reach: 0 < distance < max_distance; got {distance} and {max_distance}")
    return _open_scene(
        "ambient occlusion by a wall within reach",
        sky_shares.beside_wall_within,
        {"distance": distance, "max_distance": max_distance},
        [_wall((-1.0, 0.0), distance, max_distance)],
        "Nusselt (1928): the projection of the hidden part onto the unit disk",
        f"A wall that is larger than rays of length {max_distance:g} reach hides a part of a uniform sky.",
        max_distance=max_distance,
    )


def open_in_corner_within(distance_a: float = 0.7, distance_b: float = 0.4, max_distance: float = 1.6) -> AnalyticScene:
    """Return the share of the sky in the corner of two large walls that count as far as ``max_distance`` reaches.

    Raises ``ValueError`` where the edge between the walls is out of reach.
    """
    if not (min(distance_a, distance_b) > 0 and math.hypot(distance_a, distance_b) < max_distance):
        raise ValueError(f"the corner must be in reach; got {distance_a=}, {distance_b=}, {max_distance=}")
    return _open_scene(
        "ambient occlusion in a corner within reach",
        sky_shares.in_corner_within,
        {"distance_a": distance_a, "distance_b": distance_b, "max_distance": max_distance},
        [_wall((-1.0, 0.0), distance_a, max_distance), _wall((0.0, -1.0), distance_b, max_distance)],
        "Nusselt (1928): the projection of the hidden part onto the unit disk",
        f"Two walls at right angles, larger than rays of length {max_distance:g} reach, hide a part of a uniform sky.",
        max_distance=max_distance,
    )


def open_pixel_under_sphere(
    radius: float = 0.8, height: float = 2.0, x: float = 1.2, y: float = 0.1, side: float = 0.6
) -> AnalyticScene:
    """Return the radiance of a square pixel of a white floor under a sphere and a sky of radiance 1: four dimensions.

    A pinhole camera looks straight down from below the sphere, so film and floor correspond linearly.
    Raises ``ValueError`` where the sphere is not above the floor.
    """
    if not 0 < radius < height:
        raise ValueError(f"the sphere must be above the floor: 0 < radius < height; got {radius} and {height}")
    eye = min(side, (height - radius) / 2.0)
    blocker = black_sphere((0.0, 0.0, height), radius)
    floor = mc.Quad((x - side, y - side, 0.0), (2 * side, 0.0, 0.0), (0.0, 2 * side, 0.0), mc.Diffuse(1.0))
    scene = mc.Scene([blocker, floor], sky=1.0)
    fov = 2.0 * math.degrees(math.atan(side / 2.0 / eye))
    camera = mc.PinholeCamera((x, y, eye), (x, y, 0.0), up=(0.0, 1.0, 0.0), fov=fov, width=1, height=1)
    return closed_form_scene(
        "ambient occlusion of a pixel under a sphere",
        sky_shares.pixel_under_sphere,
        {"radius": radius, "height": height, "x": x, "y": y, "side": side},
        mc.path_integrand(scene, camera, bounces=1, lights="none"),
        SOURCE + "the sphere is a point source, its flux a solid angle",
        geometry="A black sphere hangs over a white floor under a uniform sky; a camera sees a square pixel of it.",
        law=lambda exact: law_of_hits((exact, WHITE)),
        view=plate_view([blocker], sky=1.0, size=height + radius),
    )


def _open_scene(
    name, formula, arguments, blockers, source, geometry, *, law=None, directions="cosine", max_distance=None,
    constants=None, normal=UP, size=3.0,
):  # fmt: skip
    """Return the share of a sky of radiance 1/pi, or of a shell of it at ``max_distance``, that blockers leave open."""
    shell = [] if max_distance is None else [mc.Sphere(ORIGIN, max_distance, mc.Diffuse(0.0), WHITE, inward=True)]
    return receiver_scene(
        name,
        formula,
        arguments,
        [*blockers, *shell],
        SOURCE + source,
        geometry=geometry,
        law=law or (lambda exact: law_of_hits((exact, WHITE))),
        strategy={"bounces": 0, "directions": directions, "lights": "none"},
        constants=constants,
        normal=normal,
        sky=None if shell else WHITE,
        view=plate_view(blockers, normal, sky=WHITE, size=size),
    )


def _center(radius, distance, theta):
    if not 0 < radius < distance:
        raise ValueError(f"the receiver must be outside the sphere: 0 < radius < distance; got {radius} and {distance}")
    return (distance * math.sin(theta), 0.0, distance * math.cos(theta))


def _wall(toward, distance, reach):
    """Return an upright wall larger than ``reach``, at ``distance`` in the horizontal direction ``toward``."""
    out, side = np.array([*toward, 0.0]), np.array([-toward[1], toward[0], 0.0])
    return black_quad(distance * out - 2.0 * reach * side - (0.0, 0.0, reach), 4.0 * reach * side, (0, 0, 3.0 * reach))
