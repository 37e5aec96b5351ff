"""A sphere light among several plane mirrors: between two that face each other, and in the corner of three.

The receiver is a lone point at the origin with normal +z. Each image is a light of its own, dimmed by the reflectance
for each mirror on the way; with lights="none" a sample takes one of a few values, so variance and kurtosis are exact.
Mirrors are as large as the paths need. Both functions raise ``ValueError`` where the sphere reaches behind a mirror or
where one image may hide another.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.irradiance import sphere_at_irradiance
from analytic_scenes.lone_receiver import SPHERE_SOURCE, black_sphere, law_of_hits
from analytic_scenes.mirrors import IMAGES, check_apart, mirror_scene
from analytic_scenes.scene import AnalyticScene, value_of


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 8."""
    return sphere_light_between_mirrors(), sphere_light_in_corner()


def between_mirrors_irradiance(emission, reflectance, radius, offset, height, gap, bounces):
    """Irradiance from a sphere at (offset, 0, height) between mirrors x = -gap and x = gap, by up to ``bounces``.

    The image by k reflections is at x = 2 k gap + (-1)^k offset, for k < 0 too.
    """
    images = [(abs(k), jnp.stack([x, 0.0, height])) for k, x in _series(offset, gap, bounces)]
    return _sum_of_images(emission, reflectance, radius, images)


def in_corner_irradiance(emission, reflectance, radius, center, distances):
    """Irradiance from a sphere in the corner of mirrors x = -distances[0], y = -distances[1] and z = distances[2].

    Seven images, by one, two and three reflections.
    """
    center = jnp.asarray(center, float)
    images = [(sum(t), _corner_image(center, distances, t)) for t in itertools.product((0, 1), repeat=3)]
    return _sum_of_images(emission, reflectance, radius, images)


def sphere_light_between_mirrors(
    emission: float = 5.0,
    reflectance: float = 0.9,
    radius: float = 0.5,
    offset: float = 0.0,
    height: float = 2.0,
    gap: float = 1.0,
    *,
    bounces: int = 2,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere at (offset, 0, height) between mirrors x = -gap and x = gap.

    ``bounces`` is the number of reflections: the series of images is cut there.
    """
    if not 0 < radius < gap - abs(offset):
        raise ValueError(f"the sphere must fit between the mirrors; got {radius=}, {offset=}, {gap=}")
    images = [(abs(k), (x, 0.0, height)) for k, x in _series(offset, gap, bounces)]
    low, tall = min(0.0, height) - 2.0 * radius, abs(height) + 4.0 * radius
    mirrors = [
        mc.Quad((side * gap, -2.0 * radius, low), (0, 4.0 * radius, 0), (0, 0, tall), mc.Mirror(reflectance))
        for side in (-1.0, 1.0)
    ]
    return _room_scene(
        f"sphere light between mirrors, {bounces} reflections",
        _between(bounces),
        {"reflectance": reflectance, "radius": radius, "offset": offset, "height": height, "gap": gap},
        (offset, 0.0, height),
        emission,
        images,
        mirrors,
        bounces,
        lights,
        "A sphere hangs between two parallel mirrors that face each other, and shines on a point between them.",
        (0.1, -1.2, 0.4),
    )


def sphere_light_in_corner(
    emission: float = 5.0,
    reflectance: float = 0.9,
    radius: float = 0.45,
    center=(0.5, 0.6, 0.2),
    distances=(0.7, 0.8, 1.2),
    *,
    lights: str = "none",
) -> AnalyticScene:
    """Return the irradiance from a sphere in the corner of three mirrors, at ``distances`` from the receiver.

    They are x = -distances[0], y = -distances[1] and the ceiling z = distances[2].
    """
    distances, start = np.asarray(distances, float), np.asarray(center, float)
    inward = np.array([1.0, 1.0, -1.0])
    if not np.all(distances > 0) or not np.all(inward * start + distances > radius):
        raise ValueError(f"the sphere must be in front of all mirrors; got {radius=}, {center=}, {distances=}")
    turns = list(itertools.product((0, 1), repeat=3))
    images = [(sum(t), np.where(t, -2.0 * inward * distances - start, start)) for t in turns]
    size = 2.0 * max(np.abs(image).max() for _, image in images) + 2.0 * radius
    corner = -inward * distances
    edges = np.diag(inward) * size
    mirrors = [mc.Quad(corner, edges[i], edges[j], mc.Mirror(reflectance)) for i, j in ((1, 2), (2, 0), (0, 1))]
    return _room_scene(
        "sphere light in a corner of mirrors",
        in_corner_irradiance,
        {"reflectance": reflectance, "radius": radius, "center": center, "distances": distances},
        center,
        emission,
        images,
        mirrors,
        3,
        lights,
        "A sphere in the corner of two walls and a ceiling, all mirrors, shines on a point in the same corner.",
        (0.9, 1.2, 0.05),
    )


def _room_scene(name, formula, arguments, center, emission, images, mirrors, bounces, lights, geometry, eye):
    radius, reflectance = arguments["radius"], arguments["reflectance"]
    for (_, first), (_, second) in itertools.combinations(images, 2):
        check_apart(np.asarray(first)[None], np.asarray(second)[None], radius)

    def law(exact):
        if lights != "none":
            return None
        shines = [emission * reflectance**k for k, _ in images]
        return law_of_hits(*((_irradiance(shine, image, radius), shine) for shine, (_, image) in zip(shines, images)))

    return mirror_scene(
        name,
        formula,
        {"emission": emission, **arguments},
        black_sphere(center, radius, emission),
        mirrors,
        IMAGES + SPHERE_SOURCE,
        geometry,
        {},
        {"bounces": bounces, "directions": "cosine", "lights": lights},
        law,
        eye,
    )


def _irradiance(emission, center, radius):
    return value_of(sphere_at_irradiance, {"emission": emission, "center": center, "radius": radius})


@functools.cache
def _between(bounces):
    """Return the closed form for a number of reflections; always the same function, so that it is compiled once."""
    return functools.partial(between_mirrors_irradiance, bounces=bounces)


def _sum_of_images(emission, reflectance, radius, images):
    """Irradiance from spheres given as (number of reflections, centre)."""
    reflections, centers = zip(*images)
    each = jax.vmap(sphere_at_irradiance, (None, 0, None))(emission, jnp.stack(centers), radius)
    return jnp.sum(reflectance ** np.array(reflections, float) * each)


def _series(offset, gap, bounces):
    return [(k, 2 * k * gap + (-1) ** k * offset) for k in range(-bounces, bounces + 1)]


def _corner_image(center, distances, turns):
    inward = np.array([1.0, 1.0, -1.0])
    return jnp.where(np.array(turns), -2.0 * inward * jnp.asarray(distances, float) - center, center)
