"""Irradiance at a point from one light, directly and by reflection in plane mirrors: the method of images.

The receiver is a lone point at the origin with normal +z; lights are black. Light sampling does not find a light in a
mirror, so rays must meet it. With lights="none" and directions="cosine" a sample is pi Le times the reflectances on the
way, or 0: variance and kurtosis are exact. ``emission`` is the radiance Le; vectors have shape (3,). Arguments are
those of the closed forms, with the same names.

Every function raises ``ValueError`` where the light reaches behind a mirror or may hide one of the images.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import irradiance as closed_form
from analytic_scenes.caps import caps_irradiance, parallelogram_caps, sphere_caps
from analytic_scenes.irradiance import mirror_image, parallelogram_irradiance, sphere_at_irradiance
from analytic_scenes.lone_receiver import (
    POLYGON_SOURCE,
    SPHERE_SOURCE,
    UP,
    black_quad,
    black_sphere,
    described,
    law_of_hits,
    plate_view,
    receiver_scene,
    unit,
    vertices,
)
from analytic_scenes.scene import AnalyticScene, value_of

IMAGES = "method of images; "


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 5."""
    return (
        sphere_light_in_mirror(),
        rectangle_light_in_mirror(),
        sphere_light_in_small_mirror(),
        rectangle_light_in_small_mirror(),
    )


def sphere_in_small_mirror_irradiance(
    emission, reflectance, center, radius, mirror_corner, mirror_edge_u, mirror_edge_v
):
    """Irradiance from a sphere, directly and by one reflection in a parallelogram, whose edges may cut the image."""
    image = _image(center, mirror_corner, mirror_edge_u, mirror_edge_v)
    mirror = parallelogram_caps(mirror_corner, mirror_edge_u, mirror_edge_v)
    shown = jnp.concatenate([sphere_caps(image, radius), mirror])
    reflected = emission * caps_irradiance(shown, jnp.asarray(UP))
    return sphere_at_irradiance(emission, center, radius) + reflectance * reflected


def rectangle_in_small_mirror_irradiance(
    emission, reflectance, corner, edge_u, edge_v, mirror_corner, mirror_edge_u, mirror_edge_v
):
    """Irradiance from a parallelogram, directly and by one reflection in another, whose edges may cut the image.

    The light emits on the side of cross(edge_u, edge_v); the mirror shows both of its own sides.
    """
    mirror = mirror_corner, mirror_edge_u, mirror_edge_v
    image = _image(corner, *mirror)
    image_u, image_v = (_image(jnp.add(corner, edge), *mirror) - image for edge in (edge_u, edge_v))
    shown = jnp.concatenate([parallelogram_caps(image, image_u, image_v), parallelogram_caps(*mirror)])
    # A reflection turns the outline round, so the front of the image is on the side of cross(image_v, image_u).
    facing = jnp.cross(image_v, image_u) @ image < 0
    reflected = jnp.where(facing, emission * caps_irradiance(shown, jnp.asarray(UP)), 0.0)
    return parallelogram_irradiance(emission, corner, edge_u, edge_v) + reflectance * reflected


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
    """
    mirror_normal = unit(mirror_normal)
    mirror = _covering_mirror(np.asarray(center, float)[None], radius, reflectance, mirror_distance, mirror_normal)
    return mirror_scene(
        "sphere light in a mirror",
        closed_form.sphere_in_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, "radius": radius, "center": center}
        | {"mirror_distance": mirror_distance},
        black_sphere(center, radius, emission),
        [mirror],
        IMAGES + SPHERE_SOURCE,
        "A sphere shines on a point by way of a plane mirror that shows all of it, and directly if above the horizon.",
        {"mirror_normal": mirror_normal},
        {"bounces": 1, "directions": directions, "lights": lights},
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

    The mirror is that of ``sphere_light_in_mirror``; the light emits on the side of cross(edge_u, edge_v).
    """
    mirror_normal = unit(mirror_normal)
    light = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    mirror = _covering_mirror(vertices(**light), 0.0, reflectance, mirror_distance, mirror_normal)
    return mirror_scene(
        "rectangle light in a mirror",
        closed_form.parallelogram_in_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, **light, "mirror_distance": mirror_distance},
        black_quad(**light, emission=emission),
        [mirror],
        IMAGES + POLYGON_SOURCE,
        "A parallelogram shines on a point by way of a plane mirror that shows all of it, and directly if it faces it.",
        {"mirror_normal": mirror_normal},
        {"bounces": 1, "directions": directions, "lights": lights},
    )


def sphere_light_in_small_mirror(
    emission: float = 10.0,
    reflectance: float = 0.9,
    center=(0.2, 0.0, -1.2),
    radius: float = 1.1,
    mirror_corner=(-0.3, -0.5, 0.5),
    mirror_edge_u=(1.5, 0.0, 0.3),
    mirror_edge_v=(0.1, 0.9, 0.0),
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere, directly and in a parallelogram of a mirror whose edges cut the image."""
    mirror = {"mirror_corner": mirror_corner, "mirror_edge_u": mirror_edge_u, "mirror_edge_v": mirror_edge_v}
    _check_images(np.asarray(center, float)[None], radius, *_plane(**mirror))
    return mirror_scene(
        "sphere light in a small mirror",
        sphere_in_small_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, "center": center, "radius": radius, **mirror},
        black_sphere(center, radius, emission),
        [mc.Quad(*mirror.values(), mc.Mirror(reflectance))],
        IMAGES + "boundary integral of what the mirror shows",
        "A sphere shines on a point by way of a mirror of finite size that shows a part of it.",
        {},
        {"bounces": 1, "directions": "cosine", "lights": lights},
    )


def rectangle_light_in_small_mirror(
    emission: float = 5.0,
    reflectance: float = 0.9,
    corner=(-0.6, -0.9, -0.3),
    edge_u=(1.6, 0.0, 0.0),
    edge_v=(0.0, 1.8, -0.2),
    mirror_corner=(-0.7, -0.5, 0.4),
    mirror_edge_u=(1.5, 0.0, 0.2),
    mirror_edge_v=(0.1, 1.1, 0.0),
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a parallelogram, directly and in another of a mirror whose edges cut the image."""
    light = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v}
    mirror = {"mirror_corner": mirror_corner, "mirror_edge_u": mirror_edge_u, "mirror_edge_v": mirror_edge_v}
    _check_images(vertices(**light), 0.0, *_plane(**mirror))
    return mirror_scene(
        "rectangle light in a small mirror",
        rectangle_in_small_mirror_irradiance,
        {"emission": emission, "reflectance": reflectance, **light, **mirror},
        black_quad(**light, emission=emission),
        [mc.Quad(*mirror.values(), mc.Mirror(reflectance))],
        IMAGES + "boundary integral of what the mirror shows",
        "A parallelogram shines on a point by way of a mirror of finite size that shows a part of it.",
        {},
        {"bounces": 1, "directions": "cosine", "lights": lights},
    )


def mirror_scene(
    name, formula, arguments, light, mirrors, source, geometry, constants, strategy, law=None, eye=(0.3, -1.5, 0.1)
):
    """Return the irradiance from a light and its images; ``law(exact)`` by default is that of one reflection."""

    def one_reflection(exact):
        if strategy["directions"] != "cosine" or strategy["lights"] != "none":
            return None
        direct, shine = _direct(light), light.emission
        return law_of_hits((direct, shine), (exact - direct, arguments["reflectance"] * shine))

    return receiver_scene(
        f"{name}, {described(strategy)}",
        formula,
        arguments,
        [light, *mirrors],
        source,
        geometry=geometry,
        law=law or one_reflection,
        strategy=strategy,
        constants=constants,
        view=plate_view([light, *mirrors], sky=0.05, eye=eye),
    )


def check_apart(points, images, margin):
    """Raise ``ValueError`` unless the cones about two clouds of points are apart, or one is below the horizon."""
    if np.any(points[:, 2] + margin > 0) and np.any(images[:, 2] + margin > 0) and _cones_meet(points, images, margin):
        raise ValueError("the light may hide its own image: move it out of the directions in which the image is seen")


def _direct(light):
    if isinstance(light, mc.Sphere):
        arguments = {"emission": light.emission, "center": light.center, "radius": light.radius}
        return value_of(sphere_at_irradiance, arguments)
    quad = {"corner": light.corner, "edge_u": light.edge_u, "edge_v": light.edge_v}
    return value_of(parallelogram_irradiance, {"emission": light.emission, **quad})


def _covering_mirror(points, margin, reflectance, mirror_distance, mirror_normal):
    """Return a square mirror that shows the images of all ``points``, shape (n, 3), and of ``margin`` around them."""
    depths, images = _check_images(points, margin, mirror_distance, mirror_normal)
    foot = -mirror_distance * mirror_normal
    sideways = np.linalg.norm(images - np.outer(images @ mirror_normal, mirror_normal), axis=1) + margin
    half = 1.01 * mirror_distance * np.max(sideways / (depths - margin + mirror_distance))
    u = half * unit(np.cross(mirror_normal, np.eye(3)[np.argmin(np.abs(mirror_normal))]))
    v = np.cross(mirror_normal, u)
    return mc.Quad(foot - u - v, 2 * u, 2 * v, material=mc.Mirror(reflectance))


def _check_images(points, margin, mirror_distance, mirror_normal):
    """Return how far ``points`` are in front of a mirror, and their images, if the light can hide none of these."""
    depths = points @ mirror_normal + mirror_distance
    if mirror_distance <= 0 or depths.min() <= margin:
        raise ValueError(
            f"receiver and light must be in front of the mirror; they are {mirror_distance} and {depths} from it"
        )
    images = points - 2 * depths[:, None] * mirror_normal
    check_apart(points, images, margin)
    return depths, images


def _plane(mirror_corner, mirror_edge_u, mirror_edge_v):
    """Return the distance of a mirror's plane from the origin and the unit normal toward the origin."""
    normal = unit(np.cross(mirror_edge_u, mirror_edge_v))
    height = -normal @ np.asarray(mirror_corner, float)
    return abs(height), normal * np.sign(height)


def _image(point, mirror_corner, mirror_edge_u, mirror_edge_v):
    """Return the image of a point in the plane of a mirror, with derivatives with respect to that plane."""
    normal = jnp.cross(jnp.asarray(mirror_edge_u, float), jnp.asarray(mirror_edge_v, float))
    normal = normal / jnp.sqrt(normal @ normal)
    return mirror_image(jnp.asarray(point, float), -(normal @ jnp.asarray(mirror_corner, float)), normal)


def _cones_meet(points, images, margin):
    """Return whether the cones from the origin about two congruent clouds of points could overlap."""
    middles = points.mean(axis=0), images.mean(axis=0)
    reach = np.linalg.norm(points - middles[0], axis=1).max() + margin
    half_angles = [math.asin(min(1.0, reach / np.linalg.norm(middle))) for middle in middles]
    return math.acos(np.clip(unit(middles[0]) @ unit(middles[1]), -1.0, 1.0)) < sum(half_angles)
