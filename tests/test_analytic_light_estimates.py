"""Estimators of direct, occluded, mirrored and sky light against their closed forms, whatever stands where.

Means come from 32 randomisations of evenly spread points, so that their error bars are small enough to be evidence;
variances come from independent points. ``test_analytic_scenes`` runs the same scenes to an error of 1e-4.
"""

import dataclasses
import functools
import math
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy.stats import qmc

import analytic_scenes as scenes
import jaxmc as mc
from jaxmc.backend import QUICK_OPTIONS
from jaxmc.testing import SIGMAS, assert_unbiased

RANDOMISATIONS, POINTS = 32, 2**14
LARGEST = np.nextafter(np.float32(1.0), np.float32(0.0))  # the largest coordinate
FAMILIES = (
    scenes.lights, scenes.lit_surfaces, scenes.occlusion, scenes.skies, scenes.shadows, scenes.mirrors,
    scenes.mirror_rooms, scenes.mirror_balls,
)  # fmt: skip
DEFAULTS = [scene for family in FAMILIES for scene in family.default_scenes()]


@functools.cache
def even_points(dim):
    nets = [qmc.Sobol(dim, rng=np.random.default_rng(seed)).random(POINTS) for seed in range(RANDOMISATIONS)]
    return np.minimum(np.concatenate(nets), LARGEST)


@functools.cache
def independent_points(dim):
    return np.minimum(np.random.default_rng(5).random((RANDOMISATIONS * POINTS, dim)), LARGEST)


@functools.partial(jax.jit, compiler_options=QUICK_OPTIONS)
def evaluate(integrand, points):
    return jax.vmap(integrand)(points)


def values(integrand, points):
    return np.asarray(evaluate(integrand, jax.numpy.asarray(points(integrand.dim), float)), np.float64)


def estimate(integrand):
    """Return the mean over evenly spread points, with the variance of one randomisation's mean."""
    drawn = values(integrand, even_points)
    means = drawn.reshape(RANDOMISATIONS, POINTS).mean(axis=1)
    nonfinite = int(np.sum(~np.isfinite(drawn)))
    return SimpleNamespace(mean=means.mean(), variance=means.var(ddof=1), n=RANDOMISATIONS, nonfinite=nonfinite)


def check(scene, rtol=1e-3):
    assert_unbiased(estimate(scene.integrand), scene.exact, rtol)


def check_variance(scene):
    """Check mean and sample variance of independent points, with error bars in closed form and room for rounding."""
    drawn = values(scene.integrand, independent_points)
    n, variance = len(drawn), scene.exact_variance
    assert abs(drawn.mean() - scene.exact) <= SIGMAS * math.sqrt(variance / n) + 1e-6 * abs(scene.exact)
    if variance == 0.0:
        return
    stderr = variance * math.sqrt((scene.exact_kurtosis - 1) / n)
    assert stderr <= 0.02 * variance
    # Where a sample takes one of two values with equal probability the kurtosis is 1, and only rounding is left.
    assert abs(drawn.var() - variance) <= SIGMAS * stderr + 1e-5 * variance


@pytest.mark.parametrize("scene", DEFAULTS, ids=lambda scene: scene.name)
def test_default_scene(scene):
    check(scene)
    if scene.exact_variance is not None:
        check_variance(scene)
    assert scene.formula is not None and scene.geometry and scene.source


def rectangle(x0, x1, y0, y1, z):
    return {"corner": (x0, y0, z), "edge_u": (0.0, y1 - y0, 0.0), "edge_v": (x1 - x0, 0.0, 0.0)}


def blocker(x0, x1, y0, y1, z):
    return {f"blocker_{name}": vector for name, vector in rectangle(x0, x1, y0, y1, z).items()}


LEANING = (-0.8, 0.2, 0.6)
WIDE = rectangle(-1.5, 1.5, -1.2, 1.2, 1.2)
OTHERS = {
    # Cut by the horizon.
    "orb beside a floor, mis": lambda: scenes.orb_over_floor(radius=0.9, height=1.0, lights="mis"),
    "orb over a floor, uniform and nee": lambda: scenes.orb_over_floor(sky=3.0, directions="uniform"),
    "mean over a rectangle, by directions": lambda: scenes.sphere_light_over_rectangle(radius=1.2, lights="none"),
    "ball at half phase": lambda: scenes.ball_in_sunlight(phase=1.6),
    "sphere below the horizon": lambda: scenes.open_beside_sphere(1.2, 1.5, math.radians(110)),
    "two spheres, one below the horizon": lambda: scenes.open_under_two_spheres(
        (1.0, 0.0, -0.2), 0.9, (0.6, 0.9, 0.8), 0.5
    ),
    "one sphere behind the other": lambda: scenes.open_under_two_spheres((0.0, 0.3, 3.0), 0.5, (0.0, 0.1, 1.0), 0.7),
    "rectangle through a leaning horizon": lambda: scenes.open_under_rectangle(**WIDE, normal=LEANING),
    "sphere out of reach": lambda: scenes.open_beside_sphere_within(0.8, 2.0, 0.4, 1.1),
    "sphere wholly in reach": lambda: scenes.open_beside_sphere_within(0.8, 2.0, 0.4, 1.95),
    "surface turned to the ground": lambda: scenes.tilted_under_sky(tilt=2.3, directions="uniform"),
    "linear sky that darkens upward": lambda: scenes.sphere_in_sky(slope=-0.7, directions="uniform"),
    "zonal sky, uniform directions": lambda: scenes.disk_of_ball_under_zonal_sky(directions="uniform"),
    # The blocker inside the light, over an edge, over a corner, beside it, and over all of it.
    "sphere before the middle of a sphere": lambda: scenes.sphere_behind_sphere(
        center=(0.1, 0.0, 2.0), blocker_center=(0.05, 0.0, 0.6), blocker_radius=0.1, lights="nee"
    ),
    "sphere beside a sphere": lambda: scenes.sphere_behind_sphere(blocker_center=(-0.7, 0.0, 0.3), lights="nee"),
    "sphere light through a leaning horizon": lambda: scenes.sphere_behind_sphere(normal=LEANING),
    "sphere before a corner": lambda: scenes.rectangle_behind_sphere(
        **WIDE, blocker_center=(0.7, 0.6, 0.55), blocker_radius=0.25, lights="nee"
    ),
    "sphere before an edge, leaning horizon": lambda: scenes.rectangle_behind_sphere(
        **WIDE, blocker_center=(-0.7, 0.0, 0.55), normal=LEANING
    ),
    "corner of a blocker": lambda: scenes.rectangle_behind_rectangle(
        **WIDE, **blocker(0.2, 3.0, -0.3, 4.0, 0.7), lights="nee"
    ),
    "blocker inside the light": lambda: scenes.rectangle_behind_rectangle(
        **WIDE, **blocker(-0.4, 0.3, -0.2, 0.3, 0.6), lights="mis"
    ),
    "blocker across the light, leaning horizon": lambda: scenes.rectangle_behind_rectangle(
        **WIDE, **blocker(-9.0, 9.0, -0.3, 0.2, 0.6), normal=LEANING
    ),
    "sphere behind a strip": lambda: scenes.sphere_behind_rectangle(
        **blocker(-9.0, 9.0, -0.3, 0.1, 0.5), normal=LEANING
    ),
    # Light and image together, and light sampling, which finds the light alone.
    "small mirror beside the light": lambda: scenes.rectangle_light_in_small_mirror(
        5.0, 0.8, (0.4, -0.6, 1.0), (0, 1.2, 0), (1.0, 0, 0), (-0.8, -0.9, 0.2), (0, 1.5, 0), (0.2, 0, 1.2)
    ),
    "sphere and its image in a small mirror, mis": lambda: scenes.sphere_light_in_small_mirror(
        10.0, 0.8, (0.9, 0.0, 0.9), 0.6, (-0.8, -0.9, 0.0), (0.0, 1.5, 0.0), (0.2, 0.0, 1.2), lights="mis"
    ),
    "off the middle between mirrors": lambda: scenes.sphere_light_between_mirrors(
        radius=0.4, offset=0.3, height=1.8, bounces=1, lights="mis"
    ),
    "sphere light above the horizon and in a ball": lambda: scenes.sphere_light_in_mirror_ball(
        6.0, 0.9, (1.6, 0.2, 0.5), 0.9, (-0.3, 0.0, 0.95), 0.8
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_other_scene(name):
    scene = OTHERS[name]()
    check(scene, rtol=2e-3)
    if scene.exact_variance is not None:
        check_variance(scene)


def test_every_scene_can_be_looked_at():
    for scene in DEFAULTS:
        shown, camera = scene.view()
        assert isinstance(shown, mc.Scene) and shown.size and camera.width > 0, scene.name


@pytest.mark.slow
@pytest.mark.parametrize("scene", DEFAULTS, ids=lambda scene: scene.name)
def test_a_view_shows_something(scene):
    shown, camera = scene.view()
    image = mc.render(shown, dataclasses.replace(camera, width=16, height=12), spp=4, bounces=2)
    assert np.isfinite(image.mean).all() and np.ptp(image.mean) > 0.0
