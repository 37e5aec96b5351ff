"""Enclosures whose radiance is exact although their surfaces differ: thermal equilibrium, two-surface rooms, open sky.

Scattering events are counted from the camera; "at most n" is part of the closed forms, so no path has to be endless.
"""

import dataclasses
import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxmc as mc
from analytic_scenes.chains import hemisphere_moments, path_moments
from analytic_scenes.furnace import enough_bounces, inward_cube, looking_along
from analytic_scenes.laws import Law
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis
from jaxmc.transport import rays
from jaxmc.transport.hits import surface_at
from jaxmc.transport.paths import trace

PLATE = 1e5  # half the side of a plate; one event in about 1e10 leaves the gap of width 1 between two
RADIOSITY_SOURCE = "radiosity of two surfaces; view factors: Howell, A catalog of configuration factors, section C"


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        kirchhoff_room(),
        kirchhoff_room(lights="mis"),
        ball_under_sky(),
        ball_under_sky(directions="uniform"),
        concentric_spheres(),
        concentric_spheres(lights="mis"),
        parallel_plates(),
        parallel_plates(directions="uniform"),
    )


def kirchhoff_room(
    radiance: float = 1.0,
    albedos=(0.2, 0.9, 0.5, 0.7, 0.35, 0.8),
    ball: float = 0.6,
    mirror: float = 0.9,
    bounces: int = 3,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the radiance in a room at thermal equilibrium: every surface emits ``radiance`` times its absorptance.

    The unit cube has faces of six ``albedos``, at x = 0, y = 0, z = 0, x = 1, y = 1, z = 1; in it stand a diffuse
    sphere of albedo ``ball`` and a mirror sphere of reflectance ``mirror``. The radiance is the same along every ray
    (Kirchhoff's law). The last vertex of a path reflects that radiance instead of going on, so any number of
    ``bounces`` from 1 on is exact. With directions="cosine" and lights="none" every path returns it: the variance is 0.
    Raises ``ValueError`` for bounces < 1.
    """
    if bounces < 1:
        raise ValueError(f"the walk needs at least 1 bounce; got bounces={bounces}")
    surfaces = [mc.Diffuse(albedo) for albedo in albedos]
    faces = inward_cube(surfaces, [radiance * (1.0 - albedo) for albedo in albedos])
    balls = [
        mc.Sphere((0.3, 0.35, 0.25), 0.2, mc.Diffuse(ball), radiance * (1.0 - ball)),
        mc.Sphere((0.68, 0.6, 0.65), 0.25, mc.Mirror(mirror), radiance * (1.0 - mirror)),
    ]
    scene = mc.Scene([*faces, *balls])
    ray = (0.1, 0.9, 0.2), (0.58, -0.35, 0.4)
    walk = mc.radiance(scene, *ray, bounces=bounces, directions=directions, lights=lights)
    return closed_form_scene(
        f"Kirchhoff room, {directions} directions, lights={lights}",
        equilibrium_radiance,
        {"radiance": radiance, "albedos": albedos, "ball": ball, "mirror": mirror},
        dataclasses.replace(walk, fn=_KnownAtTheEnd(walk.fn.strategy), params=(*walk.params, radiance)),
        "Kirchhoff's law of thermal radiation; Helmholtz reciprocity",
        law=lambda _: Law(0.0, None) if (directions, lights) == ("cosine", "none") else None,
        geometry="The unit cube with six albedos; in it a diffuse and a mirror sphere. All emit B (1 - reflectance).",
        view=lambda: (scene, looking_along(*ray)),
    )


def equilibrium_radiance(radiance, albedos, ball, mirror):
    """Return the radiance at thermal equilibrium: ``radiance``, whatever the reflectances are.

    Its derivatives hold for emissions tied to the reflectances, Le = B (1 - rho).
    """
    return radiance + 0.0 * (jnp.sum(jnp.asarray(albedos)) + ball + mirror)


@dataclasses.dataclass(frozen=True)
class _KnownAtTheEnd:
    """Radiance along a ray of a path whose last vertex reflects a known radiance that arrives from everywhere."""

    strategy: Any

    def __call__(self, u, scene, origin, direction, incident):
        def reflected(_, state):
            last = surface_at(scene, state.ray, state.hit)
            return jnp.where(state.hit.face >= 0, state.beta * last.reflectance * incident, 0.0)

        start = rays.ray(scene.local(origin), direction)
        collected, ends = trace(scene, self.strategy, u, 0, start, reflected)
        return collected + jnp.asarray(ends)[-1]


def ball_under_sky(
    albedo: float = 0.65, sky: float = 2.0, radius: float = 0.7, bounces: int = 2, directions: str = "cosine"
) -> AnalyticScene:
    """Return the radiance of a diffuse sphere under a constant sky: ``albedo`` times ``sky`` at every point of it.

    What scatters off a convex body escapes, so any number of ``bounces`` from 1 on is exact. The variance is 0 for
    cosine directions; for uniform ones a sample is 2 albedo sky cos with cos uniform.
    """
    if bounces < 1:
        raise ValueError(f"light from the sky needs at least 1 bounce to reach the camera; got bounces={bounces}")
    scene = mc.Scene([mc.Sphere((0.3, 0.2, -0.1), radius, mc.Diffuse(albedo))], sky=sky)
    origin = np.array((3.0, 1.0, 2.0))
    direction = (0.3, 0.2, -0.1) - origin + (0.0, 0.4 * radius, 0.0)
    moments = sky ** np.arange(1, 5) * hemisphere_moments(directions, albedo)
    return closed_form_scene(
        f"ball under a constant sky, {directions} directions",
        sky_on_convex_radiance,
        {"albedo": albedo, "sky": sky},
        mc.radiance(scene, origin, direction, bounces=bounces, directions=directions, lights="none"),
        "irradiance pi L of an open hemisphere under constant radiance L",
        law=lambda _: Law(*variance_and_kurtosis(moments)),
        geometry=f"A diffuse sphere of radius {radius:g} alone under a sky that is the same everywhere.",
        view=lambda: (scene, looking_along(tuple(origin.tolist()), direction, fov=40.0)),
    )


def sky_on_convex_radiance(albedo, sky):
    """Return the radiance of a convex diffuse body under a constant sky."""
    return albedo * sky


def concentric_spheres(
    inner_radius: float = 1.0,
    outer_radius: float = 2.0,
    inner_emission: float = 1.0,
    outer_emission: float = 0.5,
    inner_albedo: float = 0.5,
    outer_albedo: float = 0.7,
    bounces: int | None = 3,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the radiance of the wall of a sphere in which a smaller sphere hangs at the centre; both may emit.

    bounces     number of scattering events, or None for enough of them to leave out less than 1e-9
    directions  "cosine" or "uniform"; the variance is exact for both with lights="none"
    lights      with "nee" and "mis" only the mean is exact
    Raises ``ValueError`` unless 0 < inner_radius < outer_radius, and for bounces=None with an albedo of 1.
    """
    if not 0 < inner_radius < outer_radius:
        raise ValueError(f"0 < inner_radius < outer_radius is needed; got {inner_radius} and {outer_radius}")
    bounces = enough_bounces(max(inner_albedo, outer_albedo)) if bounces is None else bounces
    center = (0.0, 0.0, 0.0)
    scene = mc.Scene(
        [
            mc.Sphere(center, inner_radius, mc.Diffuse(inner_albedo), inner_emission),
            mc.Sphere(center, outer_radius, mc.Diffuse(outer_albedo), outer_emission, inward=True),
        ]
    )
    middle = (inner_radius + outer_radius) / 2
    ray = (middle, 0.0, 0.0), (0.5, 0.3, 0.8)
    # A direction from the wall meets the inner sphere where its sine is below the ratio of the radii.
    edge = math.sqrt(1 - (inner_radius / outer_radius) ** 2)
    out = hemisphere_moments(directions, inner_albedo)
    back = hemisphere_moments(directions, outer_albedo, low=edge)
    along = hemisphere_moments(directions, outer_albedo, high=edge)
    weights = np.stack([np.stack([0 * out, out], axis=-1), np.stack([back, along], axis=-1)], axis=1)
    arguments = {"inner_radius": inner_radius, "outer_radius": outer_radius, "inner_emission": inner_emission} | {
        "outer_emission": outer_emission, "inner_albedo": inner_albedo, "outer_albedo": outer_albedo
    }  # fmt: skip
    return _two_surfaces(
        f"concentric spheres, {directions} directions, lights={lights}",
        mc.radiance(scene, *ray, bounces=bounces, directions=directions, lights=lights),
        functools.partial(concentric_spheres_radiance, bounces=bounces),
        arguments,
        path_moments([inner_emission, outer_emission], weights, bounces)[:, 1] if lights == "none" else None,
        f"A diffuse sphere of radius {inner_radius:g} at the centre of a diffuse hollow sphere of radius "
        f"{outer_radius:g}; the ray ends on the outer wall.",
        lambda: (scene, looking_along((middle, 0.0, 0.0), (-1.0, 2.0, 0.3))),
    )


def parallel_plates(
    emission: float = 1.0,
    other_emission: float = 0.25,
    albedo: float = 0.9,
    other_albedo: float = 0.4,
    bounces: int | None = 4,
    directions: str = "cosine",
) -> AnalyticScene:
    """Return the radiance of the first of two endless parallel plates, each of one emission and albedo.

    The plates are squares of side 2e5 at distance 1, of which less than 1e-9 a bounce is lost. With cosine directions
    every path returns the same; with uniform ones all moments are exact. ``bounces`` is that of ``concentric_spheres``.
    """
    bounces = enough_bounces(math.sqrt(albedo * other_albedo)) if bounces is None else bounces
    scene = mc.Scene(plates(mc.Diffuse(albedo), mc.Diffuse(other_albedo), emission, other_emission))
    ray = (0.2, -0.1, 0.6), (0.3, 0.2, -0.9)
    there, back = hemisphere_moments(directions, albedo), hemisphere_moments(directions, other_albedo)
    weights = np.stack([np.stack([0 * there, there], axis=-1), np.stack([back, 0 * back], axis=-1)], axis=1)
    return _two_surfaces(
        f"parallel plates, {directions} directions",
        mc.radiance(scene, *ray, bounces=bounces, directions=directions, lights="none"),
        functools.partial(parallel_plates_radiance, bounces=bounces),
        {"emission": emission, "other_emission": other_emission, "albedo": albedo, "other_albedo": other_albedo},
        path_moments([emission, other_emission], weights, bounces)[:, 0],
        "Two endless diffuse plates, z = 0 and z = 1, that face each other; the ray ends on the one at z = 0.",
        lambda: (scene, looking_along((0.0, 0.0, 0.5), (1.0, 0.0, 0.0))),
    )


def plates(material, other_material, emission=None, other_emission=None) -> list[mc.Quad]:
    """Return two squares at z = 0 and z = 1 that face each other, so large that they are endless to 1e-9 an event."""
    corner, side = (-PLATE, -PLATE), 2 * PLATE
    below = mc.Quad((*corner, 0.0), (side, 0.0, 0.0), (0.0, side, 0.0), material, emission)
    above = mc.Quad((*corner, 1.0), (0.0, side, 0.0), (side, 0.0, 0.0), other_material, other_emission)
    return [below, above]


def concentric_spheres_radiance(
    inner_radius, outer_radius, inner_emission, outer_emission, inner_albedo, outer_albedo, bounces
):
    """Return the radiance of the outer of two concentric spheres after at most ``bounces`` events; math.inf is allowed.

    All that leaves the inner sphere meets the outer one; of what leaves the outer one, (r/R)^2 meets the inner.
    """
    toward_inner = (inner_radius / outer_radius) ** 2
    return _two_surface_radiance(
        (outer_emission, inner_emission), (outer_albedo, inner_albedo), 1.0 - toward_inner, toward_inner, bounces
    )


def parallel_plates_radiance(emission, other_emission, albedo, other_albedo, bounces):
    """Return the radiance of the first of two endless plates after at most ``bounces`` events; math.inf is allowed."""
    return _two_surface_radiance((emission, other_emission), (albedo, other_albedo), 0.0, 1.0, bounces)


def _two_surface_radiance(emissions, albedos, to_itself, to_other, bounces):
    """Return the radiance of a surface that sees itself and another one, which sees only the first."""
    (emission, other_emission), (albedo, other_albedo) = emissions, albedos
    if bounces == math.inf:
        sent = emission + albedo * to_other * other_emission
        return sent / (1.0 - albedo * to_itself - albedo * other_albedo * to_other)

    def event(radiances, _):
        radiance, other_radiance = radiances
        arriving = to_itself * radiance + to_other * other_radiance
        return (emission + albedo * arriving, other_emission + other_albedo * radiance), None

    emitted = jnp.asarray(emission, float), jnp.asarray(other_emission, float)
    return lax.scan(event, emitted, length=bounces)[0][0]


def _two_surfaces(name, integrand, formula, arguments, moments, geometry, view):
    def law(_):
        return None if moments is None else Law(*variance_and_kurtosis(moments))

    return closed_form_scene(
        name, formula, arguments, integrand, RADIOSITY_SOURCE, geometry=geometry, law=law, view=view
    )
