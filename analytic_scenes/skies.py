"""Diffuse surfaces under a sky whose radiance is a polynomial in z, the cosine of the angle from the zenith +z.

``horizon`` is the radiance at z = 0 [W/m^2/sr] and ``slope`` relative: L = horizon (1 + slope z). The zonal skies are
L = constant + linear z + quadratic P2(z), over and under the horizon. Arguments are those of the closed forms, with
the same names. Samples vary little: the variances are exact.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import laws
from analytic_scenes.lone_receiver import UP, black_sphere, plate_view, receiver_scene
from analytic_scenes.scene import AnalyticScene, closed_form_scene
from analytic_scenes.sensors import mean_radiance

SLOPE_SOURCE = "Moon and Spencer, Illumination from a non-uniform sky (1942); Steven and Unsworth (1979)"
ZONAL_SOURCE = "Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps (2001)"


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        tilted_under_sky(),
        tilted_under_sky(tilt=0.0, directions="uniform"),
        sphere_in_sky(),
        ball_under_zonal_sky(),
        disk_of_ball_under_zonal_sky(),
    )


def tilted_irradiance(horizon, slope, tilt):
    """Irradiance on a surface tilted by ``tilt`` in [0, pi] from the horizontal, the ground being black.

    At tilt 0 it is pi horizon (1 + 2 slope / 3); the overcast sky of the CIE has slope 2.
    Source: Moon and Spencer (1942); equal to the formula of Steven and Unsworth (1979).
    """
    uniform = jnp.pi * (1 + jnp.cos(tilt)) / 2
    return horizon * (uniform + 2 * slope / 3 * ((jnp.pi - tilt) * jnp.cos(tilt) + jnp.sin(tilt)))


def irradiance_beside_sphere(horizon, slope, radius, height, offset):
    """Irradiance on the floor at ``offset`` from below a black sphere, whose centre is at ``height`` >= ``radius``.

    What the sphere hides follows from the moments of its cone: int cos = pi sin(s)^2 cos(t) and, with c = cos(s),
    int cos^2 = 2 pi [cos(t)^2 (1 - c^3)/3 + sin(t)^2 ((1 - c) - (1 - c^3)/3)/2].
    """
    distance2 = height**2 + offset**2
    cos2 = height**2 / distance2
    c = jnp.sqrt(1 - radius**2 / distance2)
    first = jnp.pi * radius**2 / distance2 * jnp.sqrt(cos2)
    third = (1 - c**3) / 3
    second = 2 * jnp.pi * (cos2 * third + (1 - cos2) / 2 * ((1 - c) - third))
    return tilted_irradiance(horizon, slope, 0.0) - horizon * (first + slope * second)


def zonal_radiance(constant, linear, quadratic, albedo, polar):
    """Radiance of a convex diffuse object where its normal is at ``polar`` [rad] from the zenith.

    A cosine lobe weights the degrees 0, 1 and 2 by 1, 2/3 and 1/4. Source: Ramamoorthi and Hanrahan (2001).
    """
    z = jnp.cos(polar)
    return albedo * (constant + 2 / 3 * linear * z + 1 / 4 * quadratic * (3 * z**2 - 1) / 2)


def zonal_disk_radiance(constant, linear, quadratic, albedo, polar):
    """Mean radiance of the disk of a diffuse ball seen from a direction at ``polar`` [rad] from the zenith.

    The normals of the disk are cosine-distributed about the direction to the eye, which weights the degrees once more.
    """
    return zonal_radiance(constant, 2 / 3 * linear, 1 / 4 * quadratic, albedo, polar)


def tilted_under_sky(
    horizon: float = 2.0, slope: float = 1.5, tilt: float = math.pi / 3, *, directions: str = "cosine"
) -> AnalyticScene:
    """Return the irradiance on a tilted surface under a linear sky over a black ground.

    Raises ``ValueError`` for a tilt outside [0, pi] and for a slope below -1, where the zenith would be darker than 0.
    """
    if not 0 <= tilt <= math.pi:
        raise ValueError(f"the tilt must lie in [0, pi]; got {tilt}")
    normal = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    sky = mc.GradientSky((horizon, horizon * slope), up=UP, ground=0.0)

    def law(exact):
        lune = laws.lune_nodes(normal, UP)
        return laws.law_of_directions(directions, normal, [(lune, horizon * (1 + slope * lune.directions[:, 2]))])

    return receiver_scene(
        f"surface tilted by {math.degrees(tilt):.3g} degrees under a linear sky, {directions} directions",
        tilted_irradiance,
        {"horizon": horizon, "slope": slope, "tilt": tilt},
        [],
        SLOPE_SOURCE,
        geometry="A tilted surface under a sky that is linear in the cosine of the angle from the zenith.",
        law=law,
        strategy={"bounces": 0, "directions": directions, "lights": "none"},
        normal=normal,
        sky=sky,
        view=plate_view([], normal, sky=sky, size=1.0, eye=(0.8, -3.0, 1.0)),
    )


def sphere_in_sky(
    horizon: float = 2.0,
    slope: float = 1.5,
    radius: float = 0.8,
    height: float = 2.0,
    offset: float = 1.0,
    *,
    directions: str = "cosine",
) -> AnalyticScene:
    """Return the irradiance on a floor point under a linear sky with a black sphere in the way.

    Raises ``ValueError`` where the sphere cuts the floor or touches the point.
    """
    if not 0 < radius <= height or math.hypot(height, offset) <= radius:
        raise ValueError(f"the sphere must be above the floor and off the point; got {radius=}, {height=}, {offset=}")
    blocker = black_sphere((-offset, 0.0, height), radius)
    sky = mc.GradientSky((horizon, horizon * slope), up=UP, ground=0.0)

    def law(exact):
        hemisphere, cone = laws.cap_nodes(UP, math.pi / 2), laws.without(laws.sphere_nodes(blocker.center, radius))
        pieces = [(nodes, horizon * (1 + slope * nodes.directions[:, 2])) for nodes in (hemisphere, cone)]
        return laws.law_of_directions(directions, UP, pieces)

    return receiver_scene(
        f"floor under a linear sky with a sphere in the way, {directions} directions",
        irradiance_beside_sphere,
        {"horizon": horizon, "slope": slope, "radius": radius, "height": height, "offset": offset},
        [blocker],
        "elementary: moments of the cone of a sphere",
        geometry="A black sphere hides a part of a sky that is linear in the cosine of the angle from the zenith.",
        law=law,
        strategy={"bounces": 0, "directions": directions, "lights": "none"},
        sky=sky,
        view=plate_view([blocker], sky=sky, size=height + radius),
    )


def ball_under_zonal_sky(
    constant: float = 1.0,
    linear: float = 0.6,
    quadratic: float = 0.5,
    albedo: float = 0.8,
    polar: float = math.pi / 5,
    *,
    directions: str = "cosine",
) -> AnalyticScene:
    """Return the radiance of a diffuse ball where its normal is at ``polar`` from the zenith, under a zonal sky."""
    normal = np.array([math.sin(polar), 0.0, math.cos(polar)])
    scene = _ball_in_sky(constant, linear, quadratic, albedo)

    def law(exact):
        nodes = laws.cap_nodes(normal, math.pi / 2)
        met = _zonal(constant, linear, quadratic, nodes.directions[:, 2])
        return laws.scaled(laws.law_of_directions(directions, normal, [(nodes, met)]), albedo / math.pi)

    return closed_form_scene(
        f"ball under a zonal sky, {directions} directions",
        zonal_radiance,
        {"constant": constant, "linear": linear, "quadratic": quadratic, "albedo": albedo, "polar": polar},
        mc.radiance(scene, 3.0 * normal, -normal, bounces=1, directions=directions, lights="none"),
        ZONAL_SOURCE,
        geometry="A diffuse ball under a sky of zonal harmonics up to degree 2, seen at one point, straight on.",
        law=law,
        view=_ball_view(scene, normal),
    )


def disk_of_ball_under_zonal_sky(
    constant: float = 1.0,
    linear: float = 0.6,
    quadratic: float = 0.5,
    albedo: float = 0.8,
    polar: float = math.pi / 4,
    *,
    directions: str = "cosine",
) -> AnalyticScene:
    """Return the mean radiance of the disk of a diffuse ball, seen from ``polar`` off the zenith: four dimensions."""
    eye = np.array([math.sin(polar), 0.0, math.cos(polar)])
    scene = _ball_in_sky(constant, linear, quadratic, albedo)

    def law(exact):
        normals, solid_angles, _ = laws.cap_nodes(eye, math.pi / 2)
        shares = solid_angles * (normals @ eye) / math.pi
        lobes = [laws.cap_nodes(normal, math.pi / 2) for normal in normals]
        cosines = np.stack([np.sum(lobe.directions * n, axis=1) for lobe, n in zip(lobes, normals)])
        weight = 2.0 * cosines if directions == "uniform" else np.ones_like(cosines)
        met = _zonal(constant, linear, quadratic, np.stack([lobe.directions[:, 2] for lobe in lobes]))
        density = cosines / math.pi if directions == "cosine" else np.full_like(cosines, 0.5 / math.pi)
        around = shares[:, None] * density * lobes[0].solid_angles
        return laws.law_of_values([around], [albedo * weight * met])

    return closed_form_scene(
        f"disk of a ball under a zonal sky, {directions} directions",
        zonal_disk_radiance,
        {"constant": constant, "linear": linear, "quadratic": quadratic, "albedo": albedo, "polar": polar},
        mean_radiance(scene, 3.0 * eye, 1.0, -eye, bounces=1, directions=directions, lights="none"),
        ZONAL_SOURCE + ", applied twice",
        geometry="A diffuse ball under a sky of zonal harmonics up to degree 2; an orthographic pixel covers its disk.",
        law=law,
        view=_ball_view(scene, eye),
    )


def _zonal(constant, linear, quadratic, z):
    return constant + linear * z + quadratic * (3.0 * z**2 - 1.0) / 2.0


def _ball_in_sky(constant, linear, quadratic, albedo):
    sky = mc.GradientSky((constant - quadratic / 2.0, linear, 1.5 * quadratic), up=UP)
    return mc.Scene([mc.Sphere((0.0, 0.0, 0.0), 1.0, mc.Diffuse(albedo))], sky)


def _ball_view(scene, eye):
    side = (0.0, 1.0, 0.0)
    return lambda: (scene, mc.PinholeCamera(6.0 * eye, (0.0, 0.0, 0.0), up=side, fov=30.0, width=96, height=96))
