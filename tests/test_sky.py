"""Gradient skies against integrals done by hand, and what they cost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_facts import operations, scene

import jaxmc as mc
from jaxmc.testing import assert_unbiased

Z = (0.0, 0.0, 1.0)
SHIFTED = np.array([0.3, -0.4, 0.5])


def seen(sky, direction):
    """Return the radiance of a sky along a ray, exactly: there is nothing else, and nothing is sampled."""
    integrand = mc.radiance(mc.Scene([], sky=sky), (0, 0, 0), direction, bounces=0)
    return np.asarray(integrand.batch(np.full((1, integrand.dim), 0.5)))[0]


@pytest.mark.parametrize("up", [Z, (0.0, -2.0, 0.0), (0.6, 0.2, -0.7)])
def test_radiance_is_the_polynomial(up):
    direction = np.array([0.48, -0.6, 0.64])
    z = direction @ np.asarray(up) / np.linalg.norm(up)
    sky = mc.GradientSky((1.0, 0.3, 0.5), up=up)
    assert seen(sky, direction) == pytest.approx(1.0 + 0.3 * z + 0.5 * z * z, rel=1e-6)


def test_coloured_sky_and_ground():
    sky = mc.GradientSky([(0.1, 0.2, 0.3), 1.0], up=Z, ground=(0.5, 0.0, 0.2))
    assert seen(sky, (0.6, 0, 0.8)) == pytest.approx(np.array([0.9, 1.0, 1.1]), rel=1e-6)
    assert seen(sky, (0.6, 0, -0.8)) == pytest.approx(np.array([0.5, 0.0, 0.2]), rel=1e-6)
    assert seen(mc.GradientSky([0.7], up=Z, ground=0.0), (0, 0.6, -0.8)) == 0.0


def test_default_zenith_is_that_of_the_camera():
    assert seen(mc.GradientSky((0.5, 0.5)), (0, 1, 0)) == pytest.approx(1.0)


@pytest.mark.parametrize("directions", ["cosine", pytest.param("uniform", marks=pytest.mark.slow)])
def test_irradiance_of_an_overcast_sky(directions):
    overcast = mc.Scene([], sky=mc.GradientSky((1.0, 2.0), up=Z, ground=0.0))
    integrand = mc.irradiance(overcast, (0, 0, 0), Z, bounces=0, directions=directions)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), 7.0 * np.pi / 3.0, 1e-3)


def test_a_sky_that_does_not_vary_is_a_constant_sky():
    constant = operations(scene(sky=2.0))
    assert operations(scene(sky=mc.GradientSky([2.0]))) == constant
    assert operations(scene(sky=mc.GradientSky([2.0, 0.0], up=(0.1, 0.2, 0.3), ground=2.0))) == constant
    assert operations(scene(sky=mc.GradientSky([0.0], ground=0.0))) == operations(scene())
    assert seen(mc.GradientSky([(0.1, 0.2, 0.3)]), SHIFTED) == pytest.approx(np.array([0.1, 0.2, 0.3]))


def test_a_gradient_pays_for_its_degree_its_ground_and_its_tilt():
    counts = [
        operations(scene(sky=sky)).total()
        for sky in (
            2.0,
            mc.GradientSky([2.0, 1.0], up=Z),
            mc.GradientSky([2.0, 1.0, 0.5], up=Z),
            mc.GradientSky([2.0, 1.0, 0.5], up=Z, ground=0.1),
            mc.GradientSky([2.0, 1.0, 0.5], up=SHIFTED, ground=0.1),
            mc.GradientSky([(2.0, 1.0, 0.5), 1.0, 0.5], up=SHIFTED, ground=0.1),
        )
    ]
    assert sorted(set(counts)) == counts


def test_derivatives_with_respect_to_the_sky():
    def value(coefficients, ground):
        sky = mc.GradientSky(coefficients, up=(0.0, 0.6, 0.8), ground=ground)
        directions = ((0.0, 0.8, 0.6), (0.0, -0.8, -0.6))
        rays = [mc.radiance(mc.Scene([], sky=sky), (0, 0, 0), d, bounces=0) for d in directions]
        return sum(ray.batch(jnp.full((1, 1), 0.5))[0] for ray in rays)

    slopes, ground = jax.grad(value, (0, 1))([1.0, 0.5], 0.2)
    assert np.asarray(slopes) == pytest.approx([1.0, 0.96], rel=1e-6) and ground == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mc.GradientSky(1.0), "list of one or more"),
        (lambda: mc.GradientSky([]), "list of one or more"),
        (lambda: mc.GradientSky([1.0, (0.1, 0.2)]), "RGB triple"),
        (lambda: mc.GradientSky([1.0, float("nan")]), "finite"),
        (lambda: mc.GradientSky([1.0], up=(0, 0, 0)), "must not be zero"),
        (lambda: mc.GradientSky([1.0], up=(0, 1)), "three numbers"),
        (lambda: mc.GradientSky([1.0], ground=-0.1), "not negative"),
        (lambda: mc.GradientSky([1.0, 1.5]), "it is -0.5 where .* is -1; raise .* or give a ground"),
        (lambda: mc.GradientSky([1.0, (0.0, 0.0, -1.5)], ground=0.0), "it is -0.5 where .* is 1;"),
        (lambda: mc.GradientSky([0.2, -1.0, 1.0]), "it is -0.05 where .* is 0.5;"),
        (lambda: mc.Scene([], sky="blue"), "sky must be made of numbers"),
    ],
)
def test_bad_skies_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_ground_allows_a_polynomial_that_is_negative_below():
    mc.GradientSky([1.0, 1.5], ground=0.0)
    mc.GradientSky([0.25, -1.0, 1.0])
