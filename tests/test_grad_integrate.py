"""Derivatives of integrals with error bars, and the check that tells biased gradients from sound ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.testing import assert_unbiased

PARAMS = {"a": 1.0, "b": [2.0, 3.0]}


def smooth(p):
    """b0 u1 + b1 exp(a u0), with the integral b0 / 2 + b1 (e^a - 1) / a."""
    return mc.Integrand(lambda u: jnp.exp(p["a"] * u[0]) * p["b"][1] + p["b"][0] * u[1], 2)


def smooth_exact(p):
    return p["b"][0] / 2.0 + p["b"][1] * (jnp.exp(p["a"]) - 1.0) / p["a"]


def jump(a):
    """a u1 for u0 < a, with the integral a^2 / 2; the boundary adds a u1 at u0 = a."""
    return mc.Integrand(lambda u: jnp.where(u[0] < a, u[1] * a, 0.0), 2)


def edge(u, a):
    still = jax.lax.stop_gradient
    return still(u[0] * a) * (a - still(a))


def jump_and_edge(a):
    return mc.WithBoundary(jump(a), mc.Integrand(edge, 1, (a,)))


def doubled_edge(a):
    """The mutant that counts an edge twice."""
    return mc.WithBoundary(jump(a), mc.Integrand(lambda u, a: 2.0 * edge(u, a), 1, (a,)))


@pytest.mark.parametrize(
    "sampler, mode",
    [
        (mc.Sobol(), "forward"),
        (mc.Independent(), "reverse"),
        pytest.param(mc.Lattice(), "forward", marks=pytest.mark.slow),
        pytest.param(mc.Lattice(), "reverse", marks=pytest.mark.slow),
    ],
)
def test_derivatives_of_a_smooth_integral(mode, sampler):
    found = mc.grad_integrate(smooth, PARAMS, n=1 << 16, mode=mode, sampler=sampler)
    exact = jax.grad(smooth_exact)(PARAMS)
    precision = 1e-2 if sampler == mc.Independent() else 1e-5
    assert jax.tree.structure(found.mean) == jax.tree.structure(exact)
    for mean, error, truth in zip(*(map(float, jax.tree.leaves(t)) for t in (found.mean, found.stderr, exact))):
        assert error < precision * truth and abs(mean - truth) < 8.0 * error + 1e-6 * truth
    assert found.status == "complete" and found.boundary is None


@pytest.mark.parametrize("power, status", [(2.0, "complete"), (-0.9, "tail too heavy")])
def test_tails_are_told_by_means_of_points_that_fill_space_evenly(power, status):
    def make(a):
        return mc.Integrand(lambda u, a: a * u[0] ** power, 1, (a,))

    found = mc.grad_integrate(make, 1.0, n=1 << 14, mode="reverse", sampler=mc.Sobol())
    assert found.status == status


@pytest.mark.slow
def test_values_and_parameters_of_any_shape():
    def make(m):
        return mc.Integrand(lambda u: jnp.stack([m[0, 0] * u[0], m[1, 2] ** 2 * u[1], 1.0]), 2)

    for mode in ("forward", "reverse"):
        found = mc.grad_integrate(make, np.full((2, 3), 3.0), n=4096, mode=mode, sampler=mc.Sobol())
        expected = np.zeros((3, 2, 3))
        expected[0, 0, 0], expected[1, 1, 2] = 0.5, 3.0
        assert found.mean.shape == found.stderr.shape == found.kurtosis.shape == (3, 2, 3)
        assert np.allclose(found.mean, expected, atol=1e-4)


def test_tallies_and_error_bars_of_both_parts():
    tallies = {"shape": mc.Moments(order=4)}
    found = mc.grad_integrate(jump_and_edge, 0.4, n=1 << 16, boundary_n=1 << 12, tallies=tallies, key=3)
    assert_unbiased(found.interior, 0.2, 1e-2)
    assert_unbiased(found.boundary, 0.2, 1e-2)
    assert found.boundary.n == 1 << 12 and found.n == (1 << 16) + (1 << 12)
    assert found.stderr == pytest.approx(np.hypot(found.interior.stderr, found.boundary.stderr))
    assert abs(found.mean - 0.4) < 5.0 * found.stderr
    assert found.interior["shape"][0].kurtosis == pytest.approx(found.interior.moments[0].kurtosis)
    low, high = found.interval(0.95)
    assert high - low == pytest.approx(2 * 1.95996 * found.stderr, rel=1e-4) and low < found.mean < high
    assert "boundary" in str(found)


@pytest.mark.slow
def test_gradcheck_of_a_sound_gradient():
    report = mc.gradcheck(smooth, PARAMS, n=1 << 14)
    assert report.verdict == "consistent", report
    assert [f.name for f in report.findings] == ["['a']", "['b'][0]", "['b'][1]"]
    assert not any(f.jumps for f in report.findings)
    assert report["['a']"].detectable < 0.02 * abs(report["['a']"].gradient)
    assert "consistent" in str(report)


def test_gradcheck_finds_what_moves():
    plain = mc.gradcheck(jump, 0.4, n=1 << 18)[0]
    assert plain.verdict == "biased" and plain.p < 1e-10 and plain.jumps
    assert plain.slope == pytest.approx(-1.0, abs=0.1) and "discontinuity" in plain.cause
    # The bias is the boundary part, -0.2, and the interval says so.
    low, high = plain.interval(0.99999)
    assert low < -0.2 < high and high < -0.15


@pytest.mark.slow
def test_gradcheck_of_both_parts():
    full = mc.gradcheck(jump_and_edge, 0.4, n=1 << 18, tolerance=0.1)[0]
    assert full.verdict == "consistent" and full.jumps and full.p > 1e-4
    assert full.gradient == pytest.approx(0.4, abs=6 * full.error)
    assert mc.gradcheck(doubled_edge, 0.4, n=1 << 18)[0].verdict == "biased"


@pytest.mark.slow
def test_gradcheck_says_when_it_cannot_tell():
    assert mc.gradcheck(jump_and_edge, 0.4, n=1 << 9).verdict == "inconclusive"


@pytest.mark.slow
def test_gradcheck_finds_a_smooth_dependence_that_is_left_out():
    def half(a):
        return mc.Integrand(lambda u: a * jax.lax.stop_gradient(a) * u[0], 1)

    found = mc.gradcheck(half, 0.7, n=1 << 12)[0]
    assert found.verdict == "biased" and not found.jumps and "smooth" in found.cause
    assert found.bias == pytest.approx(-0.35, rel=0.05)


@pytest.mark.slow
def test_gradcheck_does_not_take_curvature_for_bias():
    def cubic(a):
        return mc.Integrand(lambda u: jnp.exp(8.0 * a) * (1.0 + 1e-4 * u[0]), 1)

    assert mc.gradcheck(cubic, 1.0, n=1 << 12).verdict == "consistent"


def test_gradcheck_of_functions_outside_of_jax():
    def mean(p, key, n):
        u = np.random.default_rng(key).random((n, 2))
        return np.where(u[:, 0] < float(p["a"]), u[:, 1] * float(p["a"]), 0.0).mean()

    def naive(p, key, n):
        u = np.random.default_rng(key).random((n, 2))
        return {"a": np.where(u[:, 0] < float(p["a"]), u[:, 1], 0.0).mean()}

    def right(p, key, n):
        u = np.random.default_rng(key).random((n, 2))
        return {"a": naive(p, key, n)["a"] + (u[:, 1] * float(p["a"])).mean()}

    assert mc.gradcheck(mean, {"a": 0.4}, gradient=naive, n=1000).verdict == "biased"
    found = mc.gradcheck(mean, {"a": 0.4}, gradient=right, n=1000, tolerance=0.2)
    assert found.verdict == "consistent" and found["['a']"].jumps


@pytest.mark.slow
def test_gradcheck_reports_what_is_not_finite():
    def root(a):
        return mc.Integrand(lambda u: jnp.sqrt(jnp.maximum(a - 1.0, 0.0)) + u[0], 1)

    with np.errstate(all="ignore"):
        assert mc.gradcheck(root, 1.0, n=256).verdict == "not finite"


@pytest.mark.parametrize(
    "call, word",
    [
        (lambda: mc.grad_integrate(smooth, PARAMS, n=10, mode="sideways"), "mode"),
        (lambda: mc.grad_integrate(lambda p: 1.0, 1.0, n=10), "must return an Integrand"),
        (lambda: mc.grad_integrate(smooth, {}, n=10), "at least one number"),
        (lambda: mc.grad_integrate(smooth, {"a": "x"}, n=10), "real numbers"),
        (lambda: mc.gradcheck(smooth, PARAMS, steps=(0.1,)), "steps"),
        (lambda: mc.gradcheck(smooth, PARAMS, scale=-1.0), "scale"),
        (lambda: mc.gradcheck(lambda a: mc.Integrand(lambda u: jnp.stack([a, a]), 1), 1.0), "one number"),
        (lambda: mc.grad_integrate(jump, 0.4, n=64).interval(1.5), "level"),
    ],
)
def test_mistakes_are_named(call, word):
    with pytest.raises(ValueError, match=word):
        call()
