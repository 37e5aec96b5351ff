"""Glass and water: smooth interfaces at which a path chooses between reflection and refraction by Fresnel's equations.

A path follows one of the two at every hit, so one sample takes few values, and its law is exact; "at most ``bounces``
events" is part of the closed forms. Light is not polarised, also between two hits. ``sky`` is a radiance [W/m^2/sr].
"""

import functools
import math

import jax.numpy as jnp

import jaxmc as mc
from analytic_scenes.fresnel_values import dielectric_reflectance, diffuse_internal_reflectance, irradiance_under_water
from analytic_scenes.furnace import looking_along
from analytic_scenes.laws import law_of_values
from analytic_scenes.lone_receiver import BLACK, ORIGIN, UP
from analytic_scenes.scene import AnalyticScene, closed_form_scene, value_of

WIDE = 1e4  # half the side of plates and waters: one part in 1e8 of the light at a distance of 1 comes past them
BELOW = {"bounces": 1, "directions": "bsdf", "lights": "none"}


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 2."""
    return (glass_ball(), glass_plate(), coated_floor(), under_water())


def glass_ball_radiance(ior, offset, sky, bounces):
    """Radiance of a clear ball under a sky, after at most ``bounces`` events; it approaches that of the sky.

    By reversibility every hit inside reflects as much as the first one outside.
    """
    one = dielectric_reflectance(ior, jnp.arcsin(offset))
    return sky * (1.0 - (1.0 - one) * one ** (bounces - 1))


def glass_ball(ior: float = 1.5, offset: float = 0.8, sky: float = 2.0, bounces: int = 2) -> AnalyticScene:
    """Return the radiance of a clear ball at ``offset`` radii from the middle of its image; it would be invisible.

    Raises ``ValueError`` for ``offset`` outside [0, 1) and bounces < 1.
    """
    _check(offset, 1.0, "offset", bounces)
    scene = mc.Scene([mc.Sphere(ORIGIN, 0.7, mc.Dielectric(ior))], sky)
    ray = (0.7 * offset, 0.0, 3.0), (0.0, 0.0, -1.0)
    return closed_form_scene(
        "glass ball under a constant sky",
        glass_ball_radiance,
        {"ior": ior, "offset": offset, "sky": sky},
        _walk(scene, ray, bounces),
        "geometric series; reversibility of light",
        geometry="A clear ball alone under a sky that is the same everywhere; a path must end after few events.",
        law=lambda exact: law_of_values([exact / sky], [sky]),
        constants={"bounces": bounces},
        view=lambda: (scene, looking_along((0.0, -3.0, 0.5), (0.0, 3.0, -0.5), fov=40.0)),
    )


def glass_plate_radiance(ior, theta, sky, bounces):
    """Radiance reflected by a plate over black, after at most ``bounces`` events: two for every turn inside."""
    one = dielectric_reflectance(ior, theta)
    turns = (bounces - 1) // 2
    return sky * one * (1.0 + (1.0 - one) * (1.0 - one ** (2 * turns)) / (1.0 + one))


def glass_plate(ior: float = 1.5, theta: float = 1.3, sky: float = 2.0, bounces: int = 9) -> AnalyticScene:
    """Return the radiance of a plate of glass over black ground under a sky, ``theta`` [rad] from its normal.

    It approaches ``fresnel_values.slab_reflectance``. Raises ``ValueError`` for ``theta`` outside [0, pi / 2) and
    bounces < 1.
    """
    _check(theta, math.pi / 2, "theta", bounces)
    glass = mc.Dielectric(ior)
    scene = mc.Scene([_level(0.0, glass), _level(-1.0, glass, down=True), _level(-2.0, BLACK)], sky)
    ray = _ray_at(theta)
    return closed_form_scene(
        "glass plate over black",
        glass_plate_radiance,
        {"ior": ior, "theta": theta, "sky": sky},
        _walk(scene, ray, bounces),
        "geometric series (Stokes 1862)",
        geometry="A plate of glass over black ground, under a sky that is the same everywhere.",
        law=lambda exact: law_of_values([exact / sky], [sky]),
        constants={"bounces": bounces},
        view=lambda: (scene, looking_along(*ray, fov=40.0)),
    )


def coated_floor_radiance(ior, albedo, theta, sky, bounces):
    """Radiance of a diffuse floor under glass, after at most ``bounces`` events: two for every hit of the floor."""
    one, inside = dielectric_reflectance(ior, theta), diffuse_internal_reflectance(ior)
    hits = (bounces - 1) // 2
    series = albedo * (1.0 - (albedo * inside) ** hits) / (1.0 - albedo * inside)
    return sky * (one + (1.0 - one) * (1.0 - inside) * series)


def coated_floor(
    ior: float = 1.5, albedo: float = 0.7, theta: float = math.pi / 3, sky: float = 2.0, bounces: int = 9
) -> AnalyticScene:
    """Return the radiance of a diffuse floor under a smooth coat of glass and a sky, ``theta`` [rad] from the normal.

    It approaches ``fresnel_values.coated_directional_albedo`` (Saunderson 1942). A sample is the sky's radiance times
    the albedo to the power of the hits of the floor. Raises ``ValueError`` as ``glass_plate``.
    """
    _check(theta, math.pi / 2, "theta", bounces)
    scene = mc.Scene([_level(0.0, mc.Dielectric(ior)), _level(-1.0, mc.Diffuse(albedo))], sky)
    ray = _ray_at(theta)

    def law(_):
        one = value_of(dielectric_reflectance, {"ior": ior, "theta": theta})
        inside = value_of(diffuse_internal_reflectance, {"ior": ior})
        hits = range((bounces - 1) // 2)
        chances = [(1.0 - one) * (1.0 - inside) * inside**k for k in hits]
        return law_of_values([one, *chances], [sky, *(sky * albedo ** (k + 1) for k in hits)])

    return closed_form_scene(
        "diffuse floor under glass",
        coated_floor_radiance,
        {"ior": ior, "albedo": albedo, "theta": theta, "sky": sky},
        _walk(scene, ray, bounces),
        "Saunderson 1942; Walsh 1926",
        geometry="A diffuse floor under a coat of glass, under a sky that is the same everywhere.",
        law=law,
        constants={"bounces": bounces},
        view=lambda: (scene, looking_along(*ray, fov=40.0)),
        tolerance=1e-8,
    )


def under_water(ior: float = 1.333, radiance: float = 2.0) -> AnalyticScene:
    """Return the irradiance on a receiver under calm water: a sky of ``radiance`` seen through Snell's window.

    All around the window is the reflection of a black bottom. Radiance inside is ior^2 times that outside.
    """
    scene = mc.Scene([_level(1.0, mc.Dielectric(ior)), _level(-1.0, BLACK)], radiance)
    inside = math.pi * ior**2 * radiance
    return closed_form_scene(
        "receiver under water",
        irradiance_under_water,
        {"ior": ior, "radiance": radiance},
        mc.irradiance(scene, ORIGIN, UP, **BELOW),
        "conservation of energy; Walsh 1926",
        geometry="A receiver under water above a black bottom, under a sky that is the same everywhere.",
        law=lambda exact: law_of_values([exact / inside], [inside]),
        view=lambda: (scene, looking_along((0.0, 0.0, 0.0), (0.0, 0.2, 1.0))),
        tolerance=1e-8,
    )


def _level(height, material, down=False):
    """Return a wide level quad whose normal points up, or ``down``."""
    edges = (2 * WIDE, 0.0, 0.0), (0.0, 2 * WIDE, 0.0)
    return mc.Quad((-WIDE, -WIDE, height), *(edges[::-1] if down else edges), material)


def _ray_at(theta):
    """Return the ray that comes down to the origin at ``theta`` from the vertical."""
    sine, cosine = math.sin(theta), math.cos(theta)
    return (-sine, 0.0, cosine), (sine, 0.0, -cosine)


def _walk(scene, ray, bounces):
    return mc.radiance(scene, *ray, bounces=bounces, directions="bsdf", lights="none")


def _check(value, end, name, bounces):
    if not 0.0 <= value < end:
        raise ValueError(f"{name} must be in [0, {end:.6g}), got {value}")
    if bounces < 1:
        raise ValueError(f"light from the sky needs at least 1 bounce to reach the camera; got bounces={bounces}")
