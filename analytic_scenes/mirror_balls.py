"""Light off a mirror ball: a sphere light seen in it, and the caustic that it throws on a floor.

Balls are perfect spheres; the receiver is a lone point at the origin with normal +z, or the floor z = 0. Arguments are
those of the closed forms, with the same names; vectors have shape (3,).

The directions in which a point sees an image in a ball are bounded by a smooth curve without a name, so its irradiance
is an integral over the azimuth, by the trapezoidal rule, that converges faster than any power of the number of points.
Where something is the root of an equation, bisection finds it and one Newton step carries its derivatives.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.irradiance import sphere_at_irradiance
from analytic_scenes.laws import Law, law_of_values
from analytic_scenes.lone_receiver import black_sphere, law_of_hits, plate_view, receiver_scene
from analytic_scenes.scene import AnalyticScene, closed_form_scene, value_of
from jaxmc.transport.bsdfs import reflect
from jaxmc.transport.hits import closest_hit, surface_at
from jaxmc.transport.rays import ray
from jaxmc.transport.vec import Vec3
from jaxmc.transport.warps import sincos_2pi

AZIMUTHS = 256


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 4."""
    return sphere_light_in_mirror_ball(), mirror_ball_caustic()


def in_mirror_ball_irradiance(emission, reflectance, center, radius, ball_center, ball_radius):
    """Irradiance from a sphere light, directly and by one reflection in a mirror ball that shows it whole.

    About the direction w0 in which the light's centre is seen, the image reaches to the angle g(f) at azimuth f, where
    the reflected ray passes the centre at the light's radius. With e(f) the unit vector at azimuth f across w0,

        E = Le oint [(n . w0) sin(g)^2 / 2 + (n . e) (g/2 - sin(2 g) / 4)] df.

    NaN where the ball does not show the whole light, or not above the horizon.
    """
    center, ball_center = jnp.asarray(center, float), jnp.asarray(ball_center, float)
    pole, across, reach, is_whole = _image_outline(center, radius, ball_center, ball_radius)
    is_whole = is_whole & jnp.all(pole[2] * jnp.cos(reach) + across[:, 2] * jnp.sin(reach) > 0)
    lobe = pole[2] * jnp.sin(reach) ** 2 / 2 + across[:, 2] * (reach / 2 - jnp.sin(2 * reach) / 4)
    reflected = jnp.where(is_whole, emission * 2 * jnp.pi * jnp.mean(lobe), jnp.nan)
    return sphere_at_irradiance(emission, center, radius) + reflectance * reflected


def caustic_irradiance(intensity, light, ball_center, ball_radius, point):
    """Irradiance on the floor at ``point``, with normal +z, from a point light by reflection in a perfect mirror ball.

    With incidence i and distances s to the light and t to the floor, the wavefront leaves with the focal distances
    1/st = 1/s + 2/(R cos i), 1/ss = 1/s + 2 cos(i)/R, and E = (I/s^2) st ss cos_floor / ((st + t) (ss + t)).

    Source: Coddington's equations (Kingslake, 1994); Mitchell and Hanrahan, Illumination from curved reflectors (1992).
    """
    light, ball_center, point = (jnp.asarray(vector, float) for vector in (light, ball_center, point))
    normal = _mirror_normal(light - ball_center, point - ball_center, ball_radius)
    to_light, to_point = light - ball_center - ball_radius * normal, point - ball_center - ball_radius * normal
    s, t = jnp.sqrt(to_light @ to_light), jnp.sqrt(to_point @ to_point)
    cos_i = normal @ to_light / s
    st, ss = 1 / (1 / s + 2 / (ball_radius * cos_i)), 1 / (1 / s + 2 * cos_i / ball_radius)
    return intensity / s**2 * st * ss / ((st + t) * (ss + t)) * jnp.abs(to_point[2]) / t


def parallel_caustic_irradiance(irradiance, radius, height, distance):
    """Irradiance on the floor from parallel light along -z reflected by a mirror ball with its centre at ``height``.

    ``distance`` from the axis is more than ``radius``; ``irradiance`` is that of the light on a surface that faces it.
    Source: flux between two rays; Burkhard and Shealy, Flux density for ray propagation (1973).
    """
    incidence = _incidence(radius, height, distance)
    slope = jax.grad(_landing_distance)(incidence, radius, height)
    return irradiance * radius**2 * jnp.sin(incidence) * jnp.cos(incidence) / (distance * jnp.abs(slope))


def annulus_caustic_irradiance(irradiance, radius, height, inner, outer):
    """Mean of ``parallel_caustic_irradiance`` over the annulus between two distances from the axis."""
    inside, outside = (jnp.sin(_incidence(radius, height, distance)) ** 2 for distance in (inner, outer))
    return irradiance * radius**2 * (inside - outside) / (outer**2 - inner**2)


def sphere_light_in_mirror_ball(
    emission: float = 6.0,
    reflectance: float = 0.9,
    center=(0.2, 0.0, -2.0),
    radius: float = 1.8,
    ball_center=(0.1, 0.0, 1.25),
    ball_radius: float = 1.0,
    *,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere light, directly and by one reflection in a mirror ball.

    By default the light itself is below the horizon. Raises ``ValueError`` where the ball does not show the light whole
    and above the horizon, or where one of the two may hide the other.
    """
    _check_apart(np.asarray(center, float), radius, np.asarray(ball_center, float), ball_radius)
    light = black_sphere(center, radius, emission)
    ball = mc.Sphere(ball_center, ball_radius, mc.Mirror(reflectance))
    strategy = {"bounces": 1, "directions": directions, "lights": lights}

    def law(exact):
        if directions != "cosine" or lights != "none":
            return None
        direct = value_of(sphere_at_irradiance, {"emission": emission, "center": center, "radius": radius})
        return law_of_hits((direct, emission), (exact - direct, reflectance * emission))

    scene = receiver_scene(
        f"sphere light in a mirror ball, {directions} directions",
        in_mirror_ball_irradiance,
        {"emission": emission, "reflectance": reflectance, "center": center, "radius": radius}
        | {"ball_center": ball_center, "ball_radius": ball_radius},
        [light, ball],
        "derived: boundary integral of the image; checked against Coddington's equations in the limit of a small light",
        geometry="A sphere shines on a point by way of a mirror ball, and directly where it is above the horizon.",
        law=law,
        strategy=strategy,
        view=plate_view([light, ball], sky=0.05, eye=(0.3, -1.5, 0.1)),
    )
    if not math.isfinite(scene.exact):
        raise ValueError("the ball must show the whole light, above the horizon; make one smaller or move it")
    return scene


def mirror_ball_caustic(
    irradiance: float = 3.0, radius: float = 1.0, height: float = 2.0, inner: float = 1.2, outer: float = 3.5
) -> AnalyticScene:
    """Return the mean irradiance on an annulus of floor from parallel light that a perfect mirror ball reflects.

    The light falls straight down; what it adds directly is left out. Rays are traced from the light: a sample is the
    flux through the ball's disk over the area of the annulus, or 0 where the ray lands elsewhere.
    Raises ``ValueError`` unless radius < height and radius <= inner < outer.
    """
    if not (0 < radius < height and radius <= inner < outer):
        raise ValueError(f"0 < radius < height, radius <= inner < outer are needed; got {radius, height, inner, outer}")
    ball = mc.Sphere((0.0, 0.0, height), radius, mc.Mirror(1.0))
    floor = mc.Quad((-outer, -outer, 0.0), (2.0 * outer, 0.0, 0.0), (0.0, 2.0 * outer, 0.0), mc.Diffuse(0.7))
    scene = mc.Scene([ball, floor])
    value = irradiance * radius**2 / (outer**2 - inner**2)
    params = (scene, value, radius, height + radius, inner, outer)
    lamp = black_sphere((0.0, 0.0, 5.0 * height), 0.4 * height, 100.0)

    def law(exact) -> Law:
        return law_of_values([[exact / value]], [[value]])

    return closed_form_scene(
        "caustic of a mirror ball",
        annulus_caustic_irradiance,
        {"irradiance": irradiance, "radius": radius, "height": height, "inner": inner, "outer": outer},
        mc.Integrand(_traced_from_the_light, 2, params, lazy=True, labels=("light: first", "light: second")),
        "flux between two cones of rays; Burkhard and Shealy (1973)",
        geometry="Parallel light falls on a mirror ball, which throws it on an annulus of floor.",
        law=law,
        view=plate_view([ball, lamp], size=height + radius, eye=(0.3, -1.6, 1.4)),
    )


def _traced_from_the_light(u, scene, value, radius, top, inner, outer):
    """Return ``value`` where a ray that falls on the ball lands in the annulus, else 0."""
    sine, cosine = sincos_2pi(u[1])
    distance = radius * jnp.sqrt(u[0])
    fall = ray(Vec3(distance * cosine, distance * sine, 2.0 * top), Vec3(0.0, 0.0, -1.0))
    surface = surface_at(scene, fall, closest_hit(scene, fall))
    away = ray(surface.point, reflect(fall.direction, surface.normal))
    hit = closest_hit(scene, away, surface.face)
    lands = surface_at(scene, away, hit).point
    squared = lands.x * lands.x + lands.y * lands.y
    return jnp.where((hit.face == 1) & (squared > inner * inner) & (squared < outer * outer), value, 0.0)


def _landing_distance(incidence, radius, height):
    """Distance from the axis at which a ray of parallel light lands that meets the ball at ``incidence``."""
    return radius * jnp.sin(incidence) - (height + radius * jnp.cos(incidence)) * jnp.tan(2 * incidence)


def _incidence(radius, height, distance):
    """Incidence, between 45 and 90 degrees, at which parallel light is thrown to ``distance`` from the axis."""

    def excess(incidence, radius, height, distance):
        # The landing distance less the wanted one, times cos(2 i), which is smooth.
        rise = (height + radius * jnp.cos(incidence)) * jnp.sin(2 * incidence)
        return (radius * jnp.sin(incidence) - distance) * jnp.cos(2 * incidence) - rise

    return _root(excess, jnp.pi / 4, jnp.pi / 2, radius, height, distance)


def _mirror_normal(to_light, to_point, radius):
    """Normal of a ball where it shows a light to a point, both seen from its centre: the problem of Alhazen."""
    light, point = jnp.sqrt(to_light @ to_light), jnp.sqrt(to_point @ to_point)
    start = to_point / point
    sideways = to_light / light - start * (start @ to_light) / light
    length2 = sideways @ sideways
    sine = jnp.sqrt(jnp.where(length2 > 0, length2, 1.0))
    angle = jnp.where(length2 > 0, jnp.arctan2(sine, start @ to_light / light), 0.0)

    def imbalance(t, light, point, angle, radius):
        def sine_of_incidence(distance, t):
            return distance * jnp.sin(t) / jnp.sqrt(distance**2 + radius**2 - 2 * distance * radius * jnp.cos(t))

        return sine_of_incidence(point, t) - sine_of_incidence(light, angle - t)

    turn = _root(imbalance, 0.0, angle, light, point, angle, radius)
    return jnp.where(length2 > 0, start * jnp.cos(turn) + sideways / sine * jnp.sin(turn), start)


def _miss(reach, across, pole, center, ball_center, ball_radius):
    """Distance to ``center`` of the reflection of a ray that leaves the origin at ``reach`` from ``pole``."""
    direction = pole * jnp.cos(reach) + across * jnp.sin(reach)
    along = direction @ ball_center
    half_chord = jnp.sqrt(jnp.maximum(ball_radius**2 - ball_center @ ball_center + along**2, 1e-30))
    point = direction * (along - half_chord)
    normal = (point - ball_center) / ball_radius
    to_center, away = center - point, direction - 2 * (direction @ normal) * normal
    passing = to_center - away * jnp.maximum(to_center @ away, 0.0)  # the ray does not go back
    return jnp.sqrt(passing @ passing)


def _around_image(center, ball_center, ball_radius):
    """Return the direction in which a ball shows ``center``, unit vectors across it, and how far the ball reaches."""
    normal = _mirror_normal(center - ball_center, -ball_center, ball_radius)
    pole = ball_center + ball_radius * normal
    pole = pole / jnp.sqrt(pole @ pole)
    tangent = jnp.cross(pole, jnp.where(jnp.abs(pole[0]) < 0.7, jnp.array([1.0, 0, 0]), jnp.array([0, 1.0, 0])))
    tangent = tangent / jnp.sqrt(tangent @ tangent)
    azimuth = 2 * jnp.pi * jnp.arange(AZIMUTHS)[:, None] / AZIMUTHS
    across = tangent * jnp.cos(azimuth) + jnp.cross(pole, tangent) * jnp.sin(azimuth)
    distance = jnp.sqrt(ball_center @ ball_center)
    cosine, sine = pole @ ball_center / distance, across @ ball_center / distance
    limb = jnp.arccos(jnp.sqrt(1 - (ball_radius / distance) ** 2) / jnp.hypot(cosine, sine))
    return pole, across, jnp.arctan2(sine, cosine) + limb


def _image_outline(center, radius, ball_center, ball_radius):
    """Return the direction of the image's middle, unit vectors across it, how far the image reaches along each, and
    whether it ends before the ball does.
    """
    # The irradiance is the same whatever the middle, so there is nothing to differentiate in it.
    pole, across, limb = jax.lax.stop_gradient(_around_image(center, ball_center, ball_radius))

    def excess(reach, across, *params):
        return _miss(reach, across, pole, *params[1:]) - params[0]

    def outline(across, limb):
        params = across, radius, center, ball_center, ball_radius
        return _root(excess, 0.0, limb, *params), excess(limb, *params) > 0

    reach, is_inside = jax.vmap(outline)(across, limb)
    return pole, across, reach, jnp.all(is_inside)


def _root(function, low, high, *params):
    """Return x between ``low`` and ``high`` with ``function(x, *params)`` = 0, with its derivative in ``params``."""
    low, high, fixed = jax.lax.stop_gradient((jnp.asarray(low, float), jnp.asarray(high, float), params))
    falls = function(low, *fixed) > 0

    def halve(_, ends):
        low, high = ends
        middle = (low + high) / 2
        before = (function(middle, *fixed) > 0) == falls
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    x = jax.lax.fori_loop(0, 60, halve, (low, high))[0]
    return x - function(x, *params) / jax.grad(function)(x, *fixed)


def _check_apart(center, radius, ball_center, ball_radius):
    to_light, to_ball = np.linalg.norm(center), np.linalg.norm(ball_center)
    if not (0 < radius < to_light and 0 < ball_radius < to_ball):
        raise ValueError(f"the receiver must be outside light and ball; got {radius=}, {ball_radius=}")
    if np.linalg.norm(center - ball_center) <= radius + ball_radius:
        raise ValueError("light and ball must not touch")
    apart = math.acos(np.clip(center @ ball_center / (to_light * to_ball), -1.0, 1.0))
    if center[2] > -radius and apart < math.asin(radius / to_light) + math.asin(ball_radius / to_ball):
        raise ValueError("light and ball may hide each other: move the light out of the directions of the ball")
