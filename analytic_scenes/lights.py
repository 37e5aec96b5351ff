"""Irradiance at a point from one uniform diffuse light: seen directly, cut by the horizon, or also in a plane mirror.

The receiver is a lone point at the origin with normal +z (or ``normal``); lights are black, so nothing else reflects.
The arguments are those of the closed form, with the same names, so ``derivatives`` is keyed by them. ``emission`` is a
radiance [W/m^2/sr]; vectors have shape (3,). With lights="none" and directions="cosine" a sample is pi times the
radiance that its ray meets: a discrete law, whose variance and kurtosis are exact too.
"""

import math

import numpy as np

import jaxmc as mc
from analytic_scenes import irradiance as closed_form
from analytic_scenes.scene import AnalyticScene, value_and_derivatives, variance_and_kurtosis

UP = (0.0, 0.0, 1.0)
SPHERE_SOURCE = "Snyder (1996); Lagarde and de Rousiers, Moving Frostbite to PBR (2014), section 4.7"
POLYGON_SOURCE = "Lambert, Photometria (1760), clipped at the horizon"


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
    arguments = {"emission": emission, "radius": radius, "distance": distance, "theta": theta}
    is_cut = abs(theta - math.pi / 2) < math.asin(radius / distance)
    return _irradiance_scene(
        f"sphere light, {'cut by the horizon, ' if is_cut else ''}lights={lights}",
        closed_form.sphere_irradiance,
        arguments,
        [_black_sphere(center, radius, emission)],
        SPHERE_SOURCE,
        strategy={"bounces": 0, "directions": directions, "lights": lights},
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
    normal = _unit(normal)
    light = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    heights = _vertices(**light) @ normal
    is_cut = heights.min() < 0 < heights.max()
    return _irradiance_scene(
        f"rectangle light, {'cut by the horizon, ' if is_cut else ''}lights={lights}",
        closed_form.parallelogram_irradiance,
        {"emission": emission, **light},
        [_black_quad(**light, emission=emission)],
        POLYGON_SOURCE,
        constants={"normal": normal},
        normal=normal,
        strategy={"bounces": 0, "directions": directions, "lights": lights},
    )


def sphere_light_in_mirror(
    emission: float = 10.0,
    reflectance: float = 0.9,
    radius: float = 0.97,
    center=(0.1, 0.0, -1.0),
    mirror_distance: float = 0.01,
    mirror_normal=(0.0, 0.0, -1.0),
    *,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere, directly and by one reflection in a plane mirror.

    The mirror is a square at ``mirror_distance`` from the receiver; ``mirror_normal`` (of any length) points from it to
    the receiver. It is large enough to show the whole image. By default the light itself is below the horizon.
    Raises ``ValueError`` where the light reaches behind the mirror or may hide its own image.
    """
    mirror_normal = _unit(mirror_normal)
    mirror = _covering_mirror(np.asarray(center, float)[None], radius, reflectance, mirror_distance, mirror_normal)
    return _irradiance_scene(
        f"sphere light in a mirror, lights={lights}",
        closed_form.sphere_in_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, "radius": radius, "center": center}
        | {"mirror_distance": mirror_distance},
        [_black_sphere(center, radius, emission), mirror],
        "method of images; " + SPHERE_SOURCE,
        constants={"mirror_normal": mirror_normal},
        strategy={"bounces": 1, "directions": directions, "lights": lights},
    )


def rectangle_light_in_mirror(
    emission: float = 5.0,
    reflectance: float = 0.9,
    corner=(-3.0, -3.0, -0.05),
    edge_u=(6.0, 0.0, 0.0),
    edge_v=(0.0, 6.0, 0.0),
    mirror_distance: float = 0.5,
    mirror_normal=(0.1, -0.05, -1.0),
    *,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a parallelogram, directly and by one reflection in a plane mirror.

    Mirror and errors are those of ``sphere_light_in_mirror``; the light emits on the side of cross(edge_u, edge_v).
    """
    mirror_normal = _unit(mirror_normal)
    light = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    mirror = _covering_mirror(_vertices(**light), 0.0, reflectance, mirror_distance, mirror_normal)
    return _irradiance_scene(
        f"rectangle light in a mirror, lights={lights}",
        closed_form.parallelogram_in_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, **light, "mirror_distance": mirror_distance},
        [_black_quad(**light, emission=emission), mirror],
        "method of images; " + POLYGON_SOURCE,
        constants={"mirror_normal": mirror_normal},
        strategy={"bounces": 1, "directions": directions, "lights": lights},
    )


def _irradiance_scene(name, formula, arguments, primitives, source, *, constants=None, normal=UP, strategy):
    exact, derivatives = value_and_derivatives(formula, constants, **arguments)
    integrand = mc.irradiance(mc.Scene(primitives), (0.0, 0.0, 0.0), normal, **strategy)
    variance, kurtosis = None, None
    if strategy["lights"] == "none" and strategy["directions"] == "cosine":
        # A sample is pi Le for the light, pi Le reflectance for its image, else 0: E V^q = sum of value^(q-1) E.
        reflectance = arguments.get("reflectance", 0.0)
        mirrored = reflectance * derivatives.get("reflectance", 0.0)  # exact is linear in the reflectance
        value = math.pi * arguments["emission"]
        moments = [value ** (q - 1) * (exact - mirrored + reflectance ** (q - 1) * mirrored) for q in (1, 2, 3, 4)]
        variance, kurtosis = variance_and_kurtosis(moments)
    return AnalyticScene(name, integrand, exact, variance, kurtosis, derivatives, source)


def _covering_mirror(points, margin, reflectance, mirror_distance, mirror_normal):
    """Return a square mirror that shows the images of all ``points``, shape (n, 3), and of ``margin`` around them."""
    depths = points @ mirror_normal + mirror_distance
    if mirror_distance <= 0 or depths.min() <= margin:
        raise ValueError(
            f"receiver and light must be in front of the mirror; they are {mirror_distance} and {depths} from it"
        )
    images = points - 2 * depths[:, None] * mirror_normal
    if np.any(points[:, 2] + margin > 0) and _cones_meet(points, images, margin):
        raise ValueError("the light may hide its own image: move it out of the directions in which the image is seen")
    foot = -mirror_distance * mirror_normal
    sideways = np.linalg.norm(images - np.outer(images @ mirror_normal, mirror_normal), axis=1) + margin
    half = 1.01 * mirror_distance * np.max(sideways / (depths - margin + mirror_distance))
    u = half * _unit(np.cross(mirror_normal, np.eye(3)[np.argmin(np.abs(mirror_normal))]))
    v = np.cross(mirror_normal, u)
    return mc.Quad(foot - u - v, 2 * u, 2 * v, material=mc.Mirror(reflectance))


def _cones_meet(points, images, margin):
    """Return whether the cones from the origin about two congruent clouds of points could overlap."""
    middles = points.mean(axis=0), images.mean(axis=0)
    reach = np.linalg.norm(points - middles[0], axis=1).max() + margin
    half_angles = [math.asin(min(1.0, reach / np.linalg.norm(middle))) for middle in middles]
    return math.acos(np.clip(_unit(middles[0]) @ _unit(middles[1]), -1.0, 1.0)) < sum(half_angles)


def _unit(vector):
    return np.asarray(vector, float) / np.linalg.norm(vector)


def _vertices(corner, edge_u, edge_v):
    corner, u, v = (np.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    return np.stack([corner, corner + u, corner + u + v, corner + v])


def _black_sphere(center, radius, emission):
    return mc.Sphere(center, radius, material=mc.Diffuse(0.0), emission=emission)


def _black_quad(corner, edge_u, edge_v, emission):
    return mc.Quad(corner, edge_u, edge_v, material=mc.Diffuse(0.0), emission=emission)
