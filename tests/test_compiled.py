"""The compiled estimate: the points and the numbers of ``integrate``, as a pure function of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from analytic_scenes import genz, rectangle_light
from jaxmc.integration import compiled
from jaxmc.testing import SIGMAS

SAMPLERS = (mc.Independent(), mc.Sobol(), mc.Lattice(), mc.Halton(), mc.LatinHypercube(), mc.Stratified())
SIZES = ((100, 16), (3000, 2))  # samples, replicates: many of a row, a row that is not full


def wave(u, a, b):
    return {"number": jnp.exp(a * u[0]) * b, "pair": a * u[:2]}


WAVE = mc.Integrand(wave, 3, (0.5, 2.0))


def exact(a, b):
    return b * np.expm1(a) / a


SLOW = [pytest.param(s, marks=pytest.mark.slow) for s in SAMPLERS if s != mc.Sobol()]


@pytest.mark.parametrize("sampler", [mc.Sobol(), *SLOW], ids=repr)
def test_the_estimate_is_that_of_integrate(sampler):
    sizes = ((3000, None), *SIZES) if sampler.independent else SIZES
    rounding = 1e-12 if jax.config.jax_enable_x64 else 3e-7
    for n, replicates in sizes:
        found = mc.estimator(WAVE, n=n, sampler=sampler, replicates=replicates)(5)
        wanted = mc.integrate(WAVE, n=n, sampler=sampler, replicates=replicates, key=5)
        for leaf in ("number", "pair"):
            # An error of a mean that is nearly exact is the rounding of that mean.
            assert np.allclose(found.mean[leaf], wanted.mean[leaf], rtol=rounding)
            assert np.allclose(found.stderr[leaf], wanted.stderr[leaf], rtol=1e-3, atol=rounding)


def test_one_randomisation_has_no_error_bar():
    found = mc.estimator(WAVE, n=128, sampler=mc.Sobol())(1)
    assert np.isnan(found.stderr["number"]) and np.isnan(found.stderr["pair"]).all()


@pytest.mark.parametrize("sampler", (mc.Independent(), mc.Sobol()), ids=repr)
@pytest.mark.parametrize("scene", (genz.gaussian_peak(5), rectangle_light()), ids=lambda scene: scene.name)
def test_mean_and_error_bar_hold(scene, sampler):
    """1000 keys in one call: a bias of 5 / sqrt(1000) error bars is seen, an error bar that is off by 15 %."""
    estimate = mc.estimator(scene.integrand, n=512, sampler=sampler, replicates=None if sampler.independent else 16)
    mean, stderr = jax.vmap(estimate)(jax.random.split(jax.random.key(2), 1000))
    z = (np.asarray(mean, float) - scene.exact) / np.asarray(stderr, float)
    spread = np.std(mean, ddof=1) / np.sqrt(np.mean(np.square(stderr, dtype=float)))
    assert abs(np.mean(mean, dtype=float) - scene.exact) < SIGMAS * np.std(mean, ddof=1) / np.sqrt(1000)
    assert abs(spread - 1.0) < SIGMAS / np.sqrt(2000) and np.abs(z).max() < 8.0


@pytest.mark.slow
def test_it_is_a_pure_function():
    estimate = mc.estimator(WAVE, n=256, sampler=mc.Lattice(), replicates=4)
    keys = jax.random.split(jax.random.key(1), 3)
    alone = [estimate(key) for key in keys]
    together = jax.vmap(estimate)(keys)
    inside = jax.jit(lambda key: estimate(key))(keys[0])
    assert np.allclose(together.mean["pair"], [one.mean["pair"] for one in alone], rtol=1e-6)
    assert np.allclose(inside.mean["number"], alone[0].mean["number"], rtol=1e-6)
    assert len({float(one.mean["number"]) for one in alone}) == 3
    wanted = mc.integrate(WAVE, n=256, sampler=mc.Lattice(), replicates=4, key=keys[1])
    assert alone[1].mean["number"] == pytest.approx(wanted.mean["number"], rel=1e-6)


def test_parameters_and_derivatives():
    estimate = mc.estimator(WAVE, n=1 << 14, sampler=mc.Sobol())

    def mean(a):
        return estimate(3, a, 2.0).mean["number"]

    a, step = np.array([0.1, 0.5, 1.0]), 1e-6
    assert np.allclose(jax.vmap(mean)(a), exact(a, 2.0), rtol=1e-4)
    slope = (exact(a + step, 2.0) - exact(a - step, 2.0)) / (2 * step)
    assert np.allclose(jax.vmap(jax.grad(mean))(a), slope, rtol=1e-3)
    assert np.allclose(jax.jacfwd(mean)(0.5), slope[1], rtol=1e-3)


def test_an_estimator_may_be_made_while_tracing():
    made = jax.jit(lambda a: mc.estimator(mc.Integrand(wave, 3, (a, 2.0)), n=64, sampler=mc.Sobol())(1).mean["number"])
    assert made(0.5) == pytest.approx(float(mc.estimator(WAVE, n=64, sampler=mc.Sobol())(1).mean["number"]), rel=1e-6)


def test_values_that_are_not_finite_show():
    found = mc.estimator(lambda u: jnp.where(u[0] < 0.5, jnp.nan, 1.0), dim=1, n=64)(0)
    assert np.isnan(found.mean) and np.isnan(found.stderr)


def test_rows_without_samples_count_nothing(monkeypatch):
    """A mutant: the samples that fill up the last row are counted too."""
    right = mc.estimator(WAVE, n=1500)(5).mean["number"]
    monkeypatch.setattr(compiled, "_mean", lambda valid, x: x.mean(1))
    wrong = mc.estimator(WAVE, n=1500)(5).mean["number"]
    assert abs(wrong / right - 1.0) > 1e-5


BAD = {
    "no samples": lambda: mc.estimator(WAVE, n=0),
    "too many samples": lambda: mc.estimator(WAVE, n=1 << 23),
    "half a replicate": lambda: mc.estimator(WAVE, n=64, replicates=0.5),
    "no dim": lambda: mc.estimator(lambda u: u[0], n=64),
    "other params": lambda: mc.estimator(WAVE, n=64)(0, 1.0),
    "no key": lambda: mc.estimator(WAVE, n=64)(-1),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named(name):
    with pytest.raises(ValueError, match=r"must be|at most|dim"):
        BAD[name]()
