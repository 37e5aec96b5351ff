"""Lights that something hides in part: the integrand jumps, and its derivatives live on the edges of shadows.

The receiver is a lone point at the origin with ``normal``, of any length; lights and blockers are black. The horizon
may cut the light, and the blocker may hide any part of it: all, none, an edge, a corner, the middle. ``emission`` is a
radiance [W/m^2/sr]; a quad light emits on the side of cross(edge_u, edge_v). Arguments are those of the closed forms,
with the same names.

With lights="none" and directions="cosine" variance and kurtosis are exact; with light sampling they are not known.
Every function raises ``ValueError`` where the blocker is not between the receiver and the light.
"""

import functools

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import laws
from analytic_scenes.caps import caps_irradiance, caps_overlap, parallelogram_caps, sphere_caps
from analytic_scenes.irradiance import parallelogram_irradiance, sphere_at_irradiance
from analytic_scenes.lone_receiver import (
    ORIGIN,
    UP,
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

SOURCE = "boundary integral of the visible part; Arvo, Applications of irradiance tensors (1995)"


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 6."""
    small = {"center": (0.3, 0.2, 3.0), "radius": 0.6, "blocker_center": (0.35, -0.05, 1.5), "blocker_radius": 0.25}
    return (
        rectangle_behind_rectangle(),
        rectangle_behind_rectangle(lights="nee"),
        sphere_behind_sphere(),
        sphere_behind_sphere(5.0, **small, lights="nee"),
        sphere_behind_rectangle(),
        rectangle_behind_sphere(),
        eclipsed_solid_angle(),
    )


def sphere_behind_sphere_irradiance(emission, center, radius, blocker_center, blocker_radius, normal=UP):
    """Irradiance from a sphere that another one hides in part. Source: ``caps_irradiance``."""
    hidden = jnp.concatenate([sphere_caps(center, radius), sphere_caps(blocker_center, blocker_radius)])
    return sphere_at_irradiance(emission, center, radius, normal) - emission * caps_irradiance(hidden, _unit(normal))


def sphere_behind_rectangle_irradiance(
    emission, center, radius, blocker_corner, blocker_edge_u, blocker_edge_v, normal=UP
):
    """Irradiance from a sphere that a parallelogram hides in part. Source: ``caps_irradiance``."""
    blocker = parallelogram_caps(blocker_corner, blocker_edge_u, blocker_edge_v)
    hidden = jnp.concatenate([sphere_caps(center, radius), blocker])
    return sphere_at_irradiance(emission, center, radius, normal) - emission * caps_irradiance(hidden, _unit(normal))


def rectangle_behind_sphere_irradiance(emission, corner, edge_u, edge_v, blocker_center, blocker_radius, normal=UP):
    """Irradiance from a parallelogram that a sphere hides in part. Source: ``caps_irradiance``."""
    hidden = jnp.concatenate([parallelogram_caps(corner, edge_u, edge_v), sphere_caps(blocker_center, blocker_radius)])
    whole = parallelogram_irradiance(emission, corner, edge_u, edge_v, normal)
    return whole - emission * caps_irradiance(hidden, _unit(normal))


def rectangle_behind_rectangle_irradiance(
    emission, corner, edge_u, edge_v, blocker_corner, blocker_edge_u, blocker_edge_v, normal=UP
):
    """Irradiance from a parallelogram that another one hides in part. Source: ``caps_irradiance``."""
    blocker = parallelogram_caps(blocker_corner, blocker_edge_u, blocker_edge_v)
    hidden = jnp.concatenate([parallelogram_caps(corner, edge_u, edge_v), blocker])
    whole = parallelogram_irradiance(emission, corner, edge_u, edge_v, normal)
    return whole - emission * caps_irradiance(hidden, _unit(normal))


def eclipsed_sphere_solid_angle(center, radius, blocker_center, blocker_radius):
    """Solid angle [sr] of the part of a sphere that another one leaves to be seen. Source: Mazonka (2012)."""
    light, blocker = sphere_caps(center, radius)[0], sphere_caps(blocker_center, blocker_radius)[0]
    return 2 * jnp.pi * (1 - light[3]) - caps_overlap(light, blocker)


def sphere_behind_sphere(
    emission: float = 5.0,
    center=(0.3, 0.2, 2.0),
    radius: float = 1.2,
    blocker_center=(0.3, -0.2, 0.55),
    blocker_radius: float = 0.2,
    normal=UP,
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere that another sphere eclipses: in part, in the middle, or wholly."""
    light, blocker = black_sphere(center, radius, emission), black_sphere(blocker_center, blocker_radius)
    arguments = {"center": center, "radius": radius}
    arguments |= {"blocker_center": blocker_center, "blocker_radius": blocker_radius}
    return _shadow_scene("sphere light", "a sphere", sphere_behind_sphere_irradiance, arguments, light, blocker,
                         emission, normal, lights)  # fmt: skip


def sphere_behind_rectangle(
    emission: float = 5.0,
    center=(0.2, 0.1, 2.0),
    radius: float = 1.2,
    blocker_corner=(0.15, -0.5, 0.5),
    blocker_edge_u=(1.0, 0.2, 0.1),
    blocker_edge_v=(-0.1, 0.6, 0.0),
    normal=UP,
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere behind a parallelogram, whose edges and corners cut it."""
    light = black_sphere(center, radius, emission)
    blocker = black_quad(blocker_corner, blocker_edge_u, blocker_edge_v)
    arguments = {"center": center, "radius": radius} | _blocker(blocker)
    return _shadow_scene("sphere light", "a rectangle", sphere_behind_rectangle_irradiance, arguments, light, blocker,
                         emission, normal, lights)  # fmt: skip


def rectangle_behind_sphere(
    emission: float = 5.0,
    corner=(-1.5, -1.2, 1.2),
    edge_u=(0.0, 2.4, 0.0),
    edge_v=(3.0, 0.0, 0.0),
    blocker_center=(0.5, 0.4, 0.6),
    blocker_radius: float = 0.3,
    normal=UP,
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a parallelogram behind a sphere, that hides its middle, an edge or a corner."""
    light, blocker = black_quad(corner, edge_u, edge_v, emission), black_sphere(blocker_center, blocker_radius)
    arguments = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    arguments |= {"blocker_center": blocker_center, "blocker_radius": blocker_radius}
    return _shadow_scene("rectangle light", "a sphere", rectangle_behind_sphere_irradiance, arguments, light, blocker,
                         emission, normal, lights)  # fmt: skip


def rectangle_behind_rectangle(
    emission: float = 5.0,
    corner=(-1.5, -1.2, 1.5),
    edge_u=(0.0, 2.4, 0.0),
    edge_v=(3.0, 0.0, 0.0),
    blocker_corner=(0.1, -1.5, 1.0),
    blocker_edge_u=(3.0, 0.0, 0.0),
    blocker_edge_v=(0.0, 3.0, 0.0),
    normal=UP,
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a parallelogram behind another; by default one edge of it hides half of the light.

    With lights="nee" no sampled point depends on the blocker, so the derivative with respect to it is all edge.
    """
    light = black_quad(corner, edge_u, edge_v, emission)
    blocker = black_quad(blocker_corner, blocker_edge_u, blocker_edge_v)
    arguments = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v} | _blocker(blocker)
    return _shadow_scene("rectangle light", "a rectangle", rectangle_behind_rectangle_irradiance, arguments, light,
                         blocker, emission, normal, lights)  # fmt: skip


def eclipsed_solid_angle(
    center=(0.3, 0.2, 2.0), radius: float = 1.2, blocker_center=(0.3, -0.2, 0.55), blocker_radius: float = 0.2
) -> AnalyticScene:
    """Return the solid angle [sr] of what an eclipse leaves of a sphere, by uniform directions of a hemisphere."""
    light, blocker = black_sphere(center, radius, 1.0), black_sphere(blocker_center, blocker_radius)
    _check_between(light, blocker)
    return closed_form_scene(
        "solid angle of an eclipsed sphere",
        eclipsed_sphere_solid_angle,
        {"center": center, "radius": radius, "blocker_center": blocker_center, "blocker_radius": blocker_radius},
        scalar_irradiance(mc.Scene([light, blocker]), ORIGIN, center),
        "Mazonka, Solid angle of conical surfaces, polyhedral cones, and intersecting spherical caps (2012)",
        geometry="A black sphere hides a part of a sphere of radiance 1; directions are not weighted by the cosine.",
        law=lambda exact: laws.scaled(law_of_hits((exact / 2.0, 1.0)), 2.0),
        view=plate_view([light, blocker]),
    )


def _shadow_scene(what, by, formula, arguments, light, blocker, emission, normal, lights):
    _check_between(light, blocker)
    strategy = {"bounces": 0, "directions": "cosine", "lights": lights}
    return receiver_scene(
        f"{what} behind {by}, {described(strategy)}",
        formula,
        {"emission": emission, **arguments},
        [light, blocker],
        SOURCE,
        geometry=f"A black {by.removeprefix('a ')} stands between a {what} and a point, and hides a part of the light.",
        law=lambda exact: law_of_lamp(strategy, exact, emission, None),
        strategy=strategy,
        constants={"normal": unit(normal)},
        normal=normal,
        view=plate_view([light, blocker], normal, eye=(0.5, -2.0, 0.3)),
    )


def _blocker(quad):
    return {"blocker_corner": quad.corner, "blocker_edge_u": quad.edge_u, "blocker_edge_v": quad.edge_v}


def _check_between(light, blocker):
    """Raise ``ValueError`` unless every ray that meets both meets the blocker first.

    That is so if the plane of a quad parts them, or if two spheres are disjoint and the origin's power with respect to
    the blocker, the product of a ray's distances to it, is the smaller one.
    """
    if isinstance(light, mc.Quad) and _heights(light, ORIGIN) <= 0:
        raise ValueError("the light must face the receiver: exchange edge_u and edge_v")
    if isinstance(blocker, mc.Quad) and _heights(blocker, ORIGIN) == 0:
        raise ValueError("the blocker is seen edge-on, so it hides nothing; turn it")
    if isinstance(blocker, mc.Sphere) and np.linalg.norm(blocker.center) <= blocker.radius:
        raise ValueError("the receiver must be outside the blocker")
    quads = [p for p in (light, blocker) if isinstance(p, mc.Quad)]
    if not quads:
        to_light, to_blocker = (np.linalg.norm(s.center) ** 2 - s.radius**2 for s in (light, blocker))
        apart = np.linalg.norm(np.subtract(light.center, blocker.center)) > light.radius + blocker.radius
        between = apart and 0 < to_blocker < to_light
    else:
        between = any(_parts(quad, light, blocker) for quad in quads)
    if not between:
        raise ValueError("the blocker must be between the receiver and the light, and touch neither; move it")


def _parts(quad, light, blocker):
    """Return whether the plane of ``quad``, one of the two, has the light on it or behind it and the blocker before."""
    side = np.sign(_heights(quad, ORIGIN))
    far = quad is light or np.all(side * _heights(quad, light) < 0)
    return side != 0 and far and (quad is blocker or np.all(side * _heights(quad, blocker) > 0))


def _heights(quad, other):
    """Return the heights over the plane of ``quad`` of the extreme points of a quad, a sphere or a point."""
    normal = unit(np.cross(quad.edge_u, quad.edge_v))
    if isinstance(other, mc.Sphere):
        return (np.subtract(other.center, quad.corner)) @ normal + np.array([-other.radius, other.radius])
    points = vertices(other.corner, other.edge_u, other.edge_v) if isinstance(other, mc.Quad) else np.asarray(other)
    return (points - quad.corner) @ normal


def _unit(vector):
    vector = jnp.asarray(vector, float)
    return vector / jnp.sqrt(vector @ vector)
