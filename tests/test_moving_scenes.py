"""The truth about scenes in motion: closed forms and quadratures against estimates, and against each other."""

import json

import film_reference as film
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import two_bounce_reference as two_bounce
from moving_scenes import SCENES

import jaxmc as mc
from analytic_scenes import moving
from analytic_scenes.scene import value_and_derivatives
from jaxmc.testing import assert_unbiased

TABLE = json.loads(two_bounce.TABLE.read_text())
PARTS = ("direct", "indirect")
# Those that every run of the tests estimates: compiling them is what takes time.
QUICK = ("sphere over a mirror's rim", "annular eclipse")


def each(scenes, quick=QUICK):
    return [pytest.param(s, id=s.name, marks=() if s.name in quick else pytest.mark.slow) for s in scenes]


@pytest.mark.parametrize("scene", each(SCENES))
def test_closed_forms_are_what_is_estimated(scene):
    exact, slopes = scene.truth()
    assert np.isfinite(exact) and all(np.all(np.isfinite(d)) for d in slopes.values())
    found = mc.integrate(scene.integrand(scene.params), n=1 << 16, sampler=mc.Sobol(), replicates=16)
    assert_unbiased(found, exact, rel_precision=0.01)


@pytest.mark.parametrize("scene", each((s for s in SCENES if s.kind == "film"), (*QUICK, "box", "quad before a quad")))
def test_derivatives_of_areas_are_differences(scene):
    _, slopes = scene.truth()
    for name, slope in slopes.items():
        value = np.asarray(scene.params[name], float)
        for index in np.ndindex(value.shape):
            step = np.zeros(value.shape)
            step[index] = 1e-4
            up, down = (value_and_derivatives(scene.formula, **{**scene.params, name: value + s * step})[0]
                        for s in (1.0, -1.0))  # fmt: skip
            assert np.asarray(slope)[index] == pytest.approx((up - down) / 2e-4, rel=1e-5, abs=1e-6), (name, index)


def test_the_sphere_on_the_film_is_the_conic_of_its_family():
    exact = next(f for f in moving.FAMILIES if f.name == "sphere on the film")

    def area(radius, x, y, z):
        # A film from -1 to 1 at distance 1 holds all of it; y points down.
        view = film.view((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), up=(0.0, -1.0, 0.0), fov=90.0)
        return 4.0 * film.sphere_share(view, (x, y, z), radius)

    value, slopes = value_and_derivatives(area, **exact.arguments)
    assert value == pytest.approx(exact.exact, rel=1e-12)
    assert slopes == pytest.approx(exact.derivatives, rel=1e-9)


def test_a_disk_over_the_edge_of_a_pixel_is_the_segment_of_its_family():
    """Parallel projection is a camera from far away."""
    family = next(f for f in moving.FAMILIES if f.name == "disk over a pixel's edge")
    far = 1e4

    def area(radius, x):
        view = film.view(
            (0.5, 0.5, -far), (0.5, 0.5, 0.0), up=(0.0, -1.0, 0.0), fov=2.0 * np.degrees(np.arctan(0.5 / far))
        )
        return film.sphere_share(view, (x, 0.5, 0.0), radius)

    value, slopes = value_and_derivatives(area, **family.arguments)
    assert value == pytest.approx(family.exact, rel=1e-6)
    assert slopes == pytest.approx(family.derivatives, rel=1e-6)


@pytest.mark.parametrize("name", ["fov", "origin", "target"])
def test_cameras_are_differentiable(name):
    start = {"origin": np.array([0.1, -3.0, 0.3]), "target": np.array([0.0, 0.2, 0.1]), "fov": np.array(40.0)}
    direction = np.cos(np.arange(start[name].size)).reshape(start[name].shape)

    def corner(t):
        camera = mc.PinholeCamera(**{**start, name: start[name] + t * direction}, up=(0.0, 0.0, 1.0), width=3, height=2)
        return jnp.stack([*camera.origin, *(camera.forward + camera.right + camera.down)])

    with jax.enable_x64(True):
        slope = jax.jacfwd(corner)(0.0)
        difference = (corner(1e-5) - corner(-1e-5)) / 2e-5
    assert np.max(np.abs(slope)) > 1e-3
    np.testing.assert_allclose(slope, difference, atol=1e-8)


# ------------------------------------------------------------------------------------------------------- two bounces


def test_the_table_of_two_bounces_is_what_quadrature_gives():
    found = two_bounce.means(two_bounce.PARAMS, order=5)
    assert found == pytest.approx([TABLE[part]["value"] for part in PARTS], rel=1e-5)
    few = {name: two_bounce.PARAMS[name] for name in ("blocker_x", "camera_z")}

    def value(p):
        return two_bounce.means({**two_bounce.PARAMS, **p}, order=4)

    _compare(two_bounce.derivatives(value, few), rel=2e-3)


@pytest.mark.slow
def test_the_table_of_two_bounces_is_converged():
    """Another order and another step leave all derivatives as they are."""
    found = two_bounce.means(two_bounce.PARAMS, order=12)
    assert found == pytest.approx([TABLE[part]["value"] for part in PARTS], rel=1e-9)
    slopes = two_bounce.derivatives(lambda p: two_bounce.means(p, order=6), two_bounce.PARAMS, step=0.004)
    _compare(slopes, rel=1e-4)


def _compare(slopes, rel):
    for name, pair in slopes.items():
        truth = [TABLE[part]["derivatives"][name] for part in PARTS]
        assert pair == pytest.approx(truth, rel=rel, abs=1e-7), name


def test_the_quadrature_of_two_bounces_is_what_is_estimated():
    terms = mc.neumann_terms(*two_bounce.make(two_bounce.PARAMS), bounces=2)
    found = mc.integrate(terms, n=1 << 16, sampler=mc.Sobol(), replicates=16)
    assert_unbiased(found, [0.0, *(TABLE[part]["value"] for part in PARTS)], rel_precision=0.01)
    # Wrong in one thing only: the blocker is not quite where it should be.
    wrong = two_bounce.means({**two_bounce.PARAMS, "blocker_x": 0.1}, order=5)
    for part in (0, 1):
        mutant = [0.0, *(TABLE[name]["value"] for name in PARTS)]
        mutant[part + 1] = wrong[part]
        with pytest.raises(AssertionError, match="standard errors off"):
            assert_unbiased(found, mutant, rel_precision=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["blocker_z", "lamp_x", "wall", "camera_y"])
def test_derivatives_of_two_bounces_are_differences_of_estimates(name):
    step = 0.02

    def mean(shift, key):
        params = {**two_bounce.PARAMS, name: two_bounce.PARAMS[name] + shift}
        terms = mc.neumann_terms(*two_bounce.make(params), bounces=2)
        return np.asarray(mc.integrate(terms, n=1 << 18, key=key, sampler=mc.Sobol(), replicates=8).mean)[1:]

    found = np.array([(mean(step, key) - mean(-step, key)) / (2.0 * step) for key in range(8)])
    error = found.std(0, ddof=1) / len(found) ** 0.5
    truth = np.array([TABLE[part]["derivatives"][name] for part in PARTS])
    largest = max(np.abs(truth))
    assert np.all(error < 0.02 * largest)
    assert np.all(np.abs(found.mean(0) - truth) < 6.0 * error + 0.005 * largest)
