"""Other estimators of derivatives: attached, score with control, blurred, differences; on laws of known answer."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import ndtri
from jax.scipy.stats import norm

import jaxmc as mc
from jaxmc.testing import assert_unbiased

LAW = {"mean": 0.7, "width": 1.3}
N = 1 << 17


def sample(u, p):
    return p["mean"] + p["width"] * ndtri(u[0])


def pdf(x, p):
    return norm.pdf(x, p["mean"], p["width"])


def squared(x, p):
    return x * x * pdf(x, p)


SQUARE = mc.Drawn(1, sample, pdf, squared)  # of mean mean^2 + width^2
TRUTH = {"mean": 1.4, "width": 2.6}


def check(make, truth, params=LAW, precision=0.05, key=1):
    found = mc.grad_integrate(make, params, n=N, key=key)
    for name, exact in truth.items():
        error = float(found.stderr[name])
        assert error < precision * abs(exact) and abs(found.mean[name] - exact) < 5.0 * error, (name, found)
    return found


def test_all_that_is_unbiased_finds_the_same_derivative():
    control = mc.score_control(SQUARE, LAW, key=1)
    attached = check(partial(mc.attached_integrand, SQUARE), TRUTH)
    plain = check(partial(mc.score_integrand, SQUARE), TRUTH)
    controlled = check(lambda p: mc.score_integrand(SQUARE, p, control), TRUTH)
    variances = [[float(g.interior.variance[k]) for k in LAW] for g in (attached, plain, controlled)]
    # Draws that move have the derivative 2 x and 2 x z.
    assert variances[0][0] == pytest.approx(4.0 * 1.3**2, rel=0.1)
    ratio = np.divide(variances[2], variances[1])
    np.testing.assert_allclose(ratio, control.variance_ratio, rtol=0.15)
    assert control.coefficients.shape == (2, 2) and (ratio < 0.75).all()


@pytest.mark.slow
def test_the_value_is_that_of_the_integral_with_any_control():
    control = mc.ScoreControl(np.ones((2, 2)), np.ones(2))
    for f in (mc.attached_integrand(SQUARE, LAW), mc.score_integrand(SQUARE, LAW, control)):
        assert_unbiased(mc.integrate(f, n=N, key=2), 0.7**2 + 1.3**2, 0.05)


def without_the_scale(x, p):
    return jnp.exp(-0.5 * ((x - p["mean"]) / p["width"]) ** 2) / jnp.sqrt(2.0 * jnp.pi) / LAW["width"]


def draws_that_follow(p):
    """Return an integrand whose draws move and whose density is differentiated as well: counted twice."""

    def value(u, p):
        x = sample(u, p)
        return squared(x, p) / jax.lax.stop_gradient(pdf(x, p))

    return mc.Integrand(value, 1, (p,))


def test_wrong_estimators_are_found():
    unnormalised = mc.Drawn(1, sample, without_the_scale, squared)
    control = mc.ScoreControl(np.array([[0.0, 0.0], [0.0, 1.0]]), np.ones(2))
    with pytest.raises(AssertionError):
        check(lambda p: mc.score_integrand(unnormalised, p, control), TRUTH)
    with pytest.raises(AssertionError):
        check(draws_that_follow, TRUTH)


def above(x, p):
    return jnp.where(x > 1.0, pdf(x, p), 0.0)


def test_a_jump_that_draws_cross_is_seen_by_the_score_alone():
    jump = mc.Drawn(1, sample, pdf, above)
    z = (1.0 - 0.7) / 1.3
    truth = {"mean": norm.pdf(z) / 1.3, "width": norm.pdf(z) * z / 1.3}
    check(partial(mc.score_integrand, jump), truth)
    attached = mc.grad_integrate(partial(mc.attached_integrand, jump), LAW, n=256)
    assert all(abs(attached.mean[k]) < 1e-6 for k in LAW)


def even(u, end):
    return end * u[0]


def flat(x, end):
    return jnp.where(x < end, 1.0 / end, 0.0)


def x_flat(x, end):
    return x * flat(x, end)


@pytest.mark.slow
def test_a_support_that_moves_is_lost_to_the_score():
    drawn = mc.Drawn(1, even, flat, x_flat)  # of mean end / 2
    found = mc.grad_integrate(partial(mc.score_integrand, drawn), 0.8, n=4096, sampler=mc.Sobol())
    assert found.mean == pytest.approx(-0.5, abs=1e-3)
    found = mc.grad_integrate(partial(mc.attached_integrand, drawn), 0.8, n=4096, sampler=mc.Sobol())
    assert found.mean == pytest.approx(0.5, abs=1e-3)


def pair(x, p):
    return jnp.stack([x, x * x * x]) * norm.pdf(x, p[0, 0], p[0, 1])


@pytest.mark.slow
def test_values_and_parameters_that_are_arrays():
    drawn = mc.Drawn(1, lambda u, p: p[0, 0] + p[0, 1] * ndtri(u[0]), lambda x, p: norm.pdf(x, p[0, 0], p[0, 1]), pair)
    params = np.array([[0.7, 1.3]])
    control = mc.score_control(drawn, params)
    assert control.coefficients.shape == (2, 2, 2) and control.variance_ratio.shape == (2, 2)
    found = mc.grad_integrate(lambda p: mc.score_integrand(drawn, p, control), params, n=1 << 18)
    exact = np.array([[[1.0, 0.0]], [[3 * (0.7**2 + 1.3**2), 6 * 0.7 * 1.3]]])
    assert found.mean.shape == exact.shape
    assert (np.abs(found.mean - exact) < 5.0 * found.stderr + 1e-6).all() and (found.stderr < 0.1).all()


def step(p):
    return mc.Integrand(lambda u, p: jnp.where(u[0] < p["a"] ** 3, p["b"][1], 0.0) + p["b"][0] ** 2, 1, (p,))


STEP = {"a": 0.8, "b": np.array([2.0, 3.0])}


def test_differences_find_what_jumps():
    found = mc.integrate(mc.difference_integrand(step, STEP, 0.2), n=N, key=3)
    # ((0.9^3 - 0.7^3) / 0.2) b_1; the others have no bias.
    exact = {"a": 3.0 * (0.9**3 - 0.7**3) / 0.2, "b": np.array([4.0, 0.512])}
    for mean, error, truth in zip(*(jax.tree.leaves(t) for t in (found.mean, found.stderr, exact))):
        assert np.shape(mean) == np.shape(truth) and np.all(np.abs(mean - truth) < 5.0 * error + 1e-4)
    narrow = mc.integrate(mc.difference_integrand(step, STEP, 0.02), n=N, key=3)
    for width, of in ((0.2, found), (0.02, narrow)):
        share = (0.8 + width / 2) ** 3 - (0.8 - width / 2) ** 3
        assert of.variance["a"] == pytest.approx(9.0 * share * (1.0 - share) / width**2, rel=0.1)


@pytest.mark.slow
def test_blurred_parameters_see_what_jumps():
    width, at = 0.05, {"a": 0.8, "b": np.array([0.0, 3.0])}
    drawn = mc.blurred(step, at, width)
    control = mc.score_control(drawn, at)
    found = mc.grad_integrate(lambda p: mc.score_integrand(drawn, p, control), at, n=1 << 17)
    # The mean of a^3 under the blur is a^3 + 3 a width^2.
    exact = 3.0 * (3.0 * 0.8**2 + 3.0 * width**2)
    assert abs(found.mean["a"] - exact) < 5.0 * found.stderr["a"] < 0.15 * exact
    assert found.mean["b"].shape == (2,) and control.variance_ratio[0] < 0.6


@pytest.mark.parametrize(
    "call, word",
    [
        (lambda: mc.blurred(step, STEP, 0.0), "width"),
        (lambda: mc.difference_integrand(step, STEP, -1.0), "step"),
        (lambda: mc.difference_integrand(step, {"a": "x"}, 0.1), "real numbers"),
        (lambda: mc.score_control(SQUARE, {}), "at least one number"),
        (lambda: mc.score_control(SQUARE, LAW, n=2), "pilot"),
    ],
)
def test_mistakes_are_named(call, word):
    with pytest.raises(ValueError, match=word):
        call()
