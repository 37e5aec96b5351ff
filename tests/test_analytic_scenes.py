"""The estimator against truth: every scene whose answer is known, with error bars small enough to be evidence."""

import dataclasses
import math
import re

import jax
import pytest

import analytic_scenes as scenes
import jaxmc as mc
from jaxmc.testing import SIGMAS, assert_unbiased

MOST_SAMPLES = 2**30
PILOT = 2**14


def relative_variance(scene):
    variance = scene.exact_variance
    if variance is None:
        variance = float(mc.integrate(scene.integrand, n=PILOT, key=7).variance)
    return variance / scene.exact**2


def check(scene, rtol):
    """Check mean and, where it is known, variance, with enough samples for a standard error of ``rtol`` of the mean."""
    n = max(PILOT, math.ceil(1.3 * relative_variance(scene) / rtol**2))
    assert n <= MOST_SAMPLES, f"this check would need {n:.2g} samples"
    estimate = mc.integrate(scene.integrand, n=n, key=1)
    assert_unbiased(estimate, scene.exact, rtol)
    if scene.exact_variance is not None:
        assert_unbiased(estimate, scene.exact, rtol, variance=scene.exact_variance)
    if scene.exact_kurtosis is not None:
        variance_stderr = scene.exact_variance * math.sqrt((scene.exact_kurtosis - 1) / n)
        assert abs(estimate.variance - scene.exact_variance) <= SIGMAS * variance_stderr


QUICK = "cube furnace, cosine", "sphere light, lights=nee", "product of"  # names that begin so
DEFAULTS = [
    pytest.param(scene, id=scene.name, marks=() if scene.name.startswith(QUICK) else pytest.mark.slow)
    for scene in scenes.ALL
]


@pytest.mark.parametrize("scene", DEFAULTS)
def test_default_scene(scene):
    if scene.exact_variance == 0.0:
        estimate = mc.integrate(scene.integrand, n=PILOT, key=1)
        assert_unbiased(estimate, scene.exact, rel_precision=1e-4)
        assert estimate.variance <= 1e-13 * scene.exact**2
    else:
        check(scene, rtol=1e-4)


def test_names_are_unique_and_typeable():
    assert len({scene.name for scene in scenes.ALL}) == len({scene.slug for scene in scenes.ALL}) == len(scenes.ALL)
    assert all(re.fullmatch(r"[a-z0-9][a-z0-9.-]*[a-z0-9]", scene.slug) for scene in scenes.ALL)


def test_exact_values_are_evaluated_once_and_when_asked_for():
    asked = []
    scene = scenes.AnalyticScene(
        "two", mc.Integrand(lambda u: 2.0, 1), lambda: asked.append(1) or 2.0, 0.0, None, {}, ""
    )
    assert not asked and scene.exact == scene.exact == 2.0 and asked == [1]
    assert dataclasses.replace(scene, name="three", exact=3.0).exact == 3.0


def test_exact_values_are_numbers_inside_jit():
    lamp = scenes.sphere_light(emission=10.0, radius=0.5, distance=2.0, theta=0.63)
    assert jax.jit(lambda x: x * lamp.exact)(2.0) == pytest.approx(2.0 * lamp.exact, rel=1e-6)
    assert isinstance(lamp.exact, float) and isinstance(lamp.exact_variance, float)


ABOVE = {"normal": (0.0, 0.0, 1.0)}
OTHERS = {
    "sphere ahead": lambda: scenes.sphere_light(theta=0.0),
    "sphere mostly above the horizon": lambda: scenes.sphere_light(radius=1.2, theta=math.radians(80)),
    "sphere mostly below the horizon": lambda: scenes.sphere_light(radius=1.2, theta=math.radians(100)),
    "sphere, mis": lambda: scenes.sphere_light(radius=1.2, theta=math.radians(80), lights="mis"),
    "sphere, uniform directions": lambda: scenes.sphere_light(radius=1.8, lights="none", directions="uniform"),
    "rectangle overhead": lambda: scenes.rectangle_light(
        5.0, (0.0, 0.0, 0.8), (0.0, 0.6, 0.0), (1.0, 0.0, 0.0), **ABOVE
    ),
    "rectangle through the horizon": lambda: scenes.rectangle_light(
        5.0, (1.0, -0.5, -0.4), (0.0, 0.0, 1.3), (0.0, 1.2, 0.0), **ABOVE
    ),
    "parallelogram through a tilted horizon": lambda: scenes.rectangle_light(
        5.0, (1.0, -1.0, -0.5), (-0.3, 0.4, 1.2), (0.5, 2.0, 0.2), (-0.3, 0.2, 0.6), lights="mis"
    ),
    "cube, several bounces": lambda: scenes.cube_furnace(0.8, 0.5, 5, directions="uniform"),
    "cube, mis": lambda: scenes.cube_furnace(lights="mis"),
    "sphere inside, mis": lambda: scenes.sphere_furnace(lights="mis"),
    "sphere in a mirror, mis": lambda: scenes.sphere_light_in_mirror(lights="mis"),
    "product of five": lambda: scenes.throughput_product(k=5),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.slow
def test_other_scene(name):
    check(OTHERS[name](), rtol=5e-4)


@pytest.mark.parametrize("lights", ["none", "mis"])
@pytest.mark.slow
def test_light_and_its_mirror_image_together(lights):
    light = {"corner": (0.5, -1.0, 0.9), "edge_u": (0.0, 2.0, 0.0), "edge_v": (0.6, 0.0, -0.8)}
    scene = scenes.rectangle_light_in_mirror(
        **light, mirror_distance=1.0, mirror_normal=(1.0, 0.0, -0.3), lights=lights
    )
    direct = scenes.rectangle_light(**light, **ABOVE).exact
    assert scene.exact - direct > 0.1 * direct  # the image counts for much more than the error bar
    check(scene, rtol=5e-4)


@pytest.mark.parametrize("albedo", [0.0, 0.3])
def test_endless_furnace_is_reached(albedo):
    scene = scenes.sphere_furnace(albedo, bounces=None)
    estimate = mc.integrate(scene.integrand, n=2**10, key=1)
    assert float(estimate.mean) == pytest.approx(1 / (1 - albedo), rel=1e-5)
