"""Ambient occlusion as one integral and as two; irradiance over directions and over surfaces."""

import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from analytic_scenes import occlusion
from jaxmc.testing import assert_unbiased

Z, BLACK = (0.0, 0.0, 1.0), mc.Diffuse(0.0)
FLOOR = mc.Quad((-50, -50, 0), (100, 0, 0), (0, 100, 0), BLACK)


def beside_sphere(theta=0.7):
    """Return a floor and a sphere beside its origin, a camera that sees that point only, and the sky seen there."""
    ball = mc.Sphere((1.5 * np.sin(theta), 0.0, 1.5 * np.cos(theta)), 1.0, BLACK)
    camera = mc.PinholeCamera((-3.0, 0.5, 2.0), (0, 0, 0), up=Z, fov=0.01, width=1, height=1)
    return mc.Scene([FLOOR, ball]), camera, occlusion.open_beside_sphere(1.0, 1.5, theta).exact


@pytest.mark.parametrize("directions", [1, 4])
def test_occlusion_beside_a_sphere(directions):
    scene, camera, exact = beside_sphere()
    integrand = mc.ambient_occlusion(scene, camera, directions=directions)
    assert integrand.dim == 2 + 2 * directions == len(integrand.labels)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), exact, 2e-3)


@pytest.mark.slow
def test_more_directions_divide_what_the_point_does_not_explain():
    # At one point all variance is that of directions: m of them leave 1 / m of it.
    scene, camera, exact = beside_sphere()
    one, four = (mc.integrate(mc.ambient_occlusion(scene, camera, directions=m), n=1 << 18, key=1) for m in (1, 4))
    assert float(one.variance) == pytest.approx(exact * (1 - exact), rel=0.01)
    assert float(four.variance) == pytest.approx(exact * (1 - exact) / 4, rel=0.01)


def test_only_what_is_within_reach_counts_and_a_missed_scene_is_open():
    scene, camera, _ = beside_sphere()
    assert mc.integrate(mc.ambient_occlusion(scene, camera, reach=0.4), n=1 << 12, key=1).mean == 1.0
    away = mc.PinholeCamera((0, 0, 5), (0, 0, 9), up=(0, 1, 0), width=2, height=2)
    assert mc.integrate(mc.ambient_occlusion(scene, away), n=1 << 12, key=1).mean == 1.0


@pytest.mark.slow
def test_each_pixel_has_its_own():
    scene, _, _ = beside_sphere()
    camera = mc.PinholeCamera((-3.0, 0.5, 2.0), (0, 0, 0), up=Z, fov=60, width=8, height=6)
    each = mc.integrate_each(mc.ambient_occlusion(scene, camera), 48, n=4096, key=1)
    whole = mc.integrate(mc.ambient_occlusion(scene, camera), n=1 << 18, key=2)
    difference = np.mean(each.mean) - whole.mean
    assert abs(difference) < 5 * np.hypot(whole.stderr, np.sqrt((each.stderr**2).mean() / 48))


CORNER, EDGE_U, EDGE_V = (-0.6, -0.5, 0.6), (0.0, 1.0, 0.2), (1.2, 0.0, 0.0)


@pytest.mark.parametrize(
    "kind", ["triangles", *(pytest.param(k, marks=pytest.mark.slow) for k in ("quad", "two-sided"))]
)
def test_direct_light_over_areas(kind):
    a, u, v = map(np.array, (CORNER, EDGE_U, EDGE_V))
    lamp = {
        "quad": [mc.Quad(a, u, v, BLACK, 5.0)],
        "triangles": [mc.Triangle(a, a + u, a + v, BLACK, 5.0), mc.Triangle(a + u + v, a + v, a + u, BLACK, 5.0)],
        "two-sided": [mc.Quad(a, v, u, BLACK, 5.0, two_sided=True)],
    }[kind]
    given = {"emission": 5.0, "corner": CORNER, "edge_u": EDGE_U, "edge_v": EDGE_V}
    exact = float(analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, **given)[0])
    integrand = mc.irradiance_by_areas(mc.Scene(lamp), (0, 0, 0), Z)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), exact, 2e-3)


@pytest.mark.slow
def test_a_sphere_light_over_its_area():
    scene = analytic_scenes.sphere_light()
    room, *_ = scene.integrand.params
    # Half of the points lie on its far side and count nothing.
    integrand = mc.irradiance_by_areas(mc.Scene(room.given[0]), (0, 0, 0), Z)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), scene.exact, 3e-3)


def test_one_bounce_over_areas_is_one_bounce_over_directions():
    primitives = [
        mc.Quad((-2, -2, 2.5), (0, 4, 0), (4, 0, 0), mc.Diffuse((0.8, 0.6, 0.4))),
        mc.Quad((1.5, -2, -0.5), (0, 4, 0), (0, 0, 2.5), mc.Diffuse(0.7)),
        mc.Sphere((0.2, 0.9, 1.2), 0.4, mc.Diffuse(0.5)),
        mc.Quad((-0.5, -0.5, 1.0), (1.0, 0, 0), (0, 1.0, 0), BLACK, 3.0),  # shines up, away from the receiver
    ]
    scene = mc.Scene(primitives)
    by_areas = mc.integrate(mc.irradiance_by_areas(scene, (0, 0, 0), Z, bounces=1), n=1 << 22, key=1)
    by_directions = mc.integrate(mc.irradiance(scene, (0, 0, 0), Z, bounces=1), n=1 << 21, key=2)
    error = np.hypot(by_areas.stderr, by_directions.stderr)
    assert (np.abs(by_areas.mean - by_directions.mean) < 5 * error).all()
    assert (error < 1.2e-2 * by_directions.mean).all() and (by_directions.mean > 0.01).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s, c: mc.ambient_occlusion(s, c, directions=0), "directions must be"),
        (lambda s, c: mc.ambient_occlusion(s, c, reach=-1.0), "reach must be"),
        (lambda s, c: mc.irradiance_by_areas(s, (0, 0, 0), Z), "at least one light"),
        (lambda s, c: mc.irradiance_by_areas(s, (0, 0, 0), Z, bounces=-1), "bounces must be|at least one light"),
    ],
)
def test_bad_input_is_refused(call, words):
    scene, camera, _ = beside_sphere()
    with pytest.raises(ValueError, match=words):
        call(scene, camera)
