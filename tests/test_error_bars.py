"""Intervals, replicates and stopping: what is claimed of an error must be true."""

import copy
import dataclasses
import math
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxmc as mc
from jaxmc.integration import intervals, stopping
from jaxmc.integration.estimate import Estimate
from jaxmc.integration.moments import MomentsResult, pool
from jaxmc.testing import SIGMAS


def smooth(u):
    return jnp.exp(u[0]) * (1.0 + u[1] * u[2])


SMOOTH = mc.Integrand(smooth, 3)
EXACT = (math.e - 1.0) * 1.25
POINTS = [mc.Sobol(), mc.Lattice(), mc.Halton(), mc.LatinHypercube(), mc.Stratified()]


# All that jumps shares one kernel, as its numbers are parameters; so do families.


def _jump(u, p, value, rest):
    return jnp.where(u[0] < p, value, rest)


def jump(p, value, rest=0.0):
    """Return an integrand that is ``value`` with probability p, else ``rest``."""
    return mc.Integrand(_jump, 1, (p, value, rest))


SPIKE = jump(1e-4, 1e4)
INFINITE_VARIANCE = mc.Integrand(lambda u: u[0] ** -0.75, 1)
FAMILY = mc.Integrand(lambda u, item: u[0] + item, 1)


def coverage(estimates, exact, level=0.95, **options):
    ends = [e.interval(level, **options) for e in estimates]
    return np.mean([lower <= exact <= upper for lower, upper in ends])


def band(level, count):
    """Return the numbers between which a share of ``count`` lies with all but one chance in a million."""
    return stats.binom.ppf([5e-7, 1.0 - 5e-7], count, level) / count


# Replicates.


@pytest.mark.parametrize("sampler", POINTS, ids=repr)
def test_the_error_bar_is_that_of_the_replicates(sampler):
    estimate = mc.integrate(SMOOTH, n=16 * 256, sampler=sampler, key=3)
    means = estimate.replicate_means[0]
    assert means.shape == (16,) and estimate.n == 16 * 256
    assert estimate.mean == pytest.approx(means.mean(), rel=1e-12)
    assert estimate.stderr == pytest.approx(means.std(ddof=1) / 4.0, rel=1e-9)
    lower, upper = interval = estimate.interval(0.9, "student-t over replicates")
    assert interval.method == "student-t over replicates"
    assert upper - lower == pytest.approx(2.0 * stats.t.isf(0.05, 15) * estimate.stderr)


@pytest.mark.parametrize("sampler", POINTS, ids=repr)
def test_points_that_fill_the_cube_err_less_than_independent_ones_and_say_so(sampler):
    estimate = mc.integrate(SMOOTH, n=16 * 256, sampler=sampler, key=3)
    independent = math.sqrt(estimate.variance / estimate.n)
    assert estimate.stderr < 0.7 * independent
    assert abs(estimate.mean - EXACT) < SIGMAS * 1.5 * estimate.stderr


def test_replicates_of_independent_samples_err_like_their_variance():
    ratios = []
    for key in range(50):
        estimate = mc.integrate(SMOOTH, n=16_000, replicates=16, key=key)
        ratios.append(estimate.n * estimate.stderr**2 / estimate.variance)
    assert np.mean(ratios) == pytest.approx(1.0, abs=SIGMAS * math.sqrt(2.0 / 15 / 50))


def test_one_replicate_claims_no_error():
    estimate = mc.integrate(SMOOTH, n=256, sampler=mc.Sobol(), replicates=1)
    assert np.isnan(estimate.stderr) and np.isnan(estimate.interval()).all()
    assert estimate.mean == pytest.approx(EXACT, rel=1e-2)


def test_numbers_of_samples_are_rounded_up_where_points_want_it():
    for sampler, n in ((mc.Sobol(), 16 * 64), (mc.Lattice(), 16 * 64), (mc.Halton(), 16 * 63)):
        estimate = mc.integrate(SMOOTH, n=1000, sampler=sampler)
        assert estimate.n == n and estimate.recipe["points"] == n // 16


def test_images_have_error_bars_over_replicates():
    estimate = mc.integrate_each(FAMILY, 50, n=64, sampler=mc.Sobol(), replicates=8)
    assert estimate.mean.shape == estimate.stderr.shape == (50,)
    assert np.all(np.abs(estimate.mean - np.arange(50) - 0.5) < 30 * estimate.stderr)
    # One point falls in each eighth: the variance of a mean of 8 is 1 / (12 * 8^3), and there are 8 of these.
    expected = 1.0 / (12 * 8**3 * 8)
    assert np.mean(estimate.stderr**2) == pytest.approx(expected, rel=SIGMAS * math.sqrt(2.0 / 7 / 50))


# Intervals.


@pytest.mark.parametrize("sampler", [mc.Independent(), mc.Sobol(), mc.Lattice()], ids=repr)
def test_intervals_cover_as_often_as_they_say(sampler):
    estimates = [mc.integrate(SMOOTH, n=2048, sampler=sampler, key=key) for key in range(400)]
    for level in (0.5, 0.9):
        low, high = band(level, len(estimates))
        assert low <= coverage(estimates, EXACT, level) <= high


def test_a_variance_within_a_replicate_is_no_error_bar():
    # The mutant: iid standard errors for Sobol' points cover always.
    estimates = [mc.integrate(SMOOTH, n=2048, sampler=mc.Sobol(), key=key) for key in range(400)]
    inside = [abs(e.mean - EXACT) < stats.norm.isf(0.25) * math.sqrt(e.variance / e.n) for e in estimates]
    assert np.mean(inside) > band(0.5, 400)[1]


def test_other_intervals_cover_too():
    estimates = [mc.integrate(SMOOTH, n=4096, replicates=16, key=key) for key in range(400)]
    for method, least in (("median of means", 0.95), ("bootstrap-t", 0.95)):
        found = coverage(estimates, EXACT, method=method)
        assert found >= band(least, len(estimates))[0] and (method == "median of means" or found <= band(0.97, 400)[1])


def test_bounded_intervals_cover_what_no_normal_one_does():
    estimates = [mc.integrate(SPIKE, n=2000, key=key) for key in range(200)]
    normal, bounded = coverage(estimates, 1.0), coverage(estimates, 1.0, bounds=(0.0, 1e4))
    assert normal < 0.5 and bounded == 1.0
    assert estimates[0].interval(bounds=(0.0, 1e4)).method == "bounded"


def test_intervals_keep_the_shape_of_the_value():
    f = mc.Integrand(lambda u: {"a": u[0], "b": u[:2]}, 2)
    estimate = mc.integrate(f, n=1600, sampler=mc.Sobol())
    for method in (None, "median of means", "bootstrap-t"):
        lower, upper = estimate.interval(method=method)
        assert isinstance(lower["a"], float) and upper["b"].shape == (2,)
        assert lower["a"] <= 0.5 <= upper["a"] and (lower["b"] <= upper["b"]).all()


# The correction for skewness, on many estimates at once: each column is one, each row a replicate.

RUNS = 40_000


def claims(means):
    """Return estimates from means of shape (replicates, runs), as one estimate of a vector."""
    count, runs = means.shape
    record = MomentsResult(np.ones_like(means), means, [np.zeros_like(means)] * 3, 0)
    pooled, between = pool(record)
    structure = jax.tree.structure(0)
    return Estimate([pooled], count * runs, {}, 0.0, {"replicates": count}, structure, [between], [means])


def share(means, exact, method=None, level=0.95):
    lower, upper = claims(means).interval(level, method)
    return np.mean((lower <= exact) & (exact <= upper))


def choice(values, weights):
    """Return a law on a few values: its sampler and its mean."""
    weights = np.array(weights) / np.sum(weights)
    return lambda random, shape: random.choice(values, shape, p=weights), np.dot(values, weights)


# What means of lattices over a set take (a sphere in a mirror; a rectangle cut by the horizon), and other laws.
AT_AN_EDGE = choice(np.arange(6.0), [289, 444, 99, 101, 64, 1])
CUT = choice(np.arange(5.0), [29, 110, 363, 481, 17])
TWO_VALUED = choice(np.arange(2.0), [4, 1])
TWO_HUMPS = (lambda random, shape: np.sign(random.random(shape) - 0.5) + 0.3 * random.normal(size=shape), 0.0)
LAWS = {
    "normal": (lambda random, shape: random.normal(size=shape), 0.0),
    "uniform": (lambda random, shape: random.random(shape), 0.5),
    "gamma": (lambda random, shape: random.gamma(4.0, size=shape), 4.0),
    "Laplace": (lambda random, shape: random.laplace(size=shape), 0.0),
    "two humps": TWO_HUMPS,
    "lattice at an edge": AT_AN_EDGE,
    "lattice, cut": CUT,
    "two values": TWO_VALUED,
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("replicates", [16, 32])
def test_corrected_intervals_cover_for_many_laws(name, replicates):
    draw, exact = LAWS[name]
    means = draw(np.random.default_rng(replicates), (replicates, RUNS))
    assert 0.935 < share(means, exact) < 0.971 - 0.005 * (name != "two values")


@pytest.mark.parametrize(("law", "most"), [(AT_AN_EDGE, 0.935), (CUT, 0.936), (TWO_VALUED, 0.87)])
def test_intervals_that_take_no_skewness_into_account_are_too_short(law, most):
    # The mutant: Student's t as it is.
    draw, exact = law
    means = draw(np.random.default_rng(1), (16, RUNS))
    plain, corrected = (share(means, exact, method) for method in ("student-t over replicates", None))
    assert plain < most and plain + 0.005 < corrected


def test_a_correction_that_trusts_its_skewness_is_too_long(monkeypatch):
    # The mutant: the whole correction, though the noise of the skewness goes against that of the mean.
    monkeypatch.setattr(intervals, "NOISE", 0.0)
    draw, exact = TWO_HUMPS
    assert share(draw(np.random.default_rng(1), (16, RUNS)), exact) > 0.97


def test_a_correction_to_the_wrong_side_is_too_short(monkeypatch):
    right = intervals._lean
    monkeypatch.setattr(intervals, "_lean", lambda m: -right(m))
    draw, exact = AT_AN_EDGE
    assert share(draw(np.random.default_rng(1), (16, RUNS)), exact) < 0.93


@pytest.mark.parametrize("lean", [-2.0, -0.2, 0.0, 1e-12, 0.3, 1.5])
def test_the_transform_is_inverted(lean):
    q = np.linspace(-6.0, 6.0, 25)
    x = intervals._upright(q, lean)
    assert np.allclose(x + lean * x**2 / 3.0 + lean**2 * x**3 / 27.0 + lean / 6.0, q, atol=1e-12)
    assert np.all(np.diff(x) > 0.0) and np.allclose(intervals._upright(-q, -lean), -x, atol=1e-14)


def test_the_corrected_interval_follows_unit_and_sign():
    means = np.random.default_rng(5).exponential(size=(16, 50))
    (lower, upper), (low, up) = (claims(x).interval(0.9) for x in (means, 7.0 - 3.0 * means))
    assert np.allclose(low, 7.0 - 3.0 * upper) and np.allclose(up, 7.0 - 3.0 * lower)
    (half,) = claims(means).half_widths(0.9)
    assert np.allclose(half, (upper - lower) / 2.0)
    # Means with a tail to the right are too low when it was not met: more room above.
    skew = stats.skew(means) > 1.0
    assert skew.any() and np.all((upper + lower - 2.0 * means.mean(0))[skew] > 0.0)


def test_the_correction_knows_skewness_and_kurtosis_of_the_replicates():
    estimate = mc.integrate(SMOOTH, n=4096, sampler=mc.Sobol(), key=3)
    (means,), (between,) = estimate.replicate_means, estimate.between
    assert between.skewness == pytest.approx(stats.skew(means), rel=1e-6)
    assert between.kurtosis == pytest.approx(stats.kurtosis(means) + 3.0, rel=1e-6)


def test_plain_intervals_stand_in_where_skewness_is_not_known():
    pixels = mc.integrate_each(FAMILY, 50, n=64, sampler=mc.Sobol(), replicates=8)
    means = np.random.default_rng(1).random((8, 5))
    for estimate in (pixels, claims(means[:7])):
        assert estimate.interval().method == "student-t over replicates"
    assert claims(means).interval().method == "corrected for skewness"
    independent = dataclasses.replace(pixels, between=None)
    assert independent.interval().method == "normal"


def test_where_nothing_varies_the_interval_is_a_point():
    lower, upper = claims(np.full((16, 3), 0.5)).interval()
    assert np.array_equal(lower, [0.5] * 3) and np.array_equal(upper, lower)


MISTAKES = [
    (dict(level=1.5), "level must lie"),
    (dict(method="student"), "method must be"),
    (dict(method="bootstrap-t"), "replicates"),
    (dict(method="bounded"), "bounds"),
    (dict(bounds=(1.0, 0.0)), "bounds"),
]


@pytest.mark.parametrize(("options", "match"), MISTAKES)
def test_wrong_intervals_are_refused(options, match):
    estimate = mc.integrate(SMOOTH, n=100)
    with pytest.raises(ValueError, match=match):
        estimate.interval(**options)


# Stopping.


@pytest.mark.parametrize("sampler", [mc.Independent(), *POINTS[:3]], ids=repr)
def test_a_target_is_met(sampler):
    rtol = 1e-3 if sampler == mc.Independent() else 1e-4
    estimate = mc.integrate(SMOOTH, rtol=rtol, sampler=sampler, key=1)
    lower, upper = estimate.interval()
    assert estimate.status == "converged" and upper - lower <= 2.0 * rtol * estimate.mean
    assert abs(estimate.mean - EXACT) < 3.0 * rtol * EXACT
    absolute = mc.integrate(SMOOTH, atol=rtol * EXACT, sampler=sampler, key=1)
    assert absolute.n == pytest.approx(estimate.n, rel=0.02)


@pytest.mark.parametrize("sampler", [mc.Independent(), mc.Sobol()], ids=repr)
def test_intervals_cover_also_where_the_error_itself_stopped_the_run(sampler):
    rtol = 2e-3 if sampler == mc.Independent() else 2e-4
    estimates = [mc.integrate(SMOOTH, rtol=rtol, sampler=sampler, key=key) for key in range(300)]
    assert {e.status for e in estimates} == {"converged"}
    low, high = band(0.95, len(estimates))
    assert low <= coverage(estimates, EXACT) <= high


def test_stopping_at_the_first_short_interval_would_not_cover(monkeypatch):
    # The mutant: many looks, few replicates, and no margin between the target and what is aimed at.
    monkeypatch.setattr(stopping, "FIRST", 64)
    monkeypatch.setattr(stopping, "next_n", lambda target, looks, *_: int(looks[-1][0] * 1.2))
    estimates = [mc.integrate(SMOOTH, key=key, rtol=0.02, replicates=4) for key in range(120)]
    assert coverage(estimates, EXACT) < band(0.95, 120)[0]


def test_budgets_are_kept():
    few = mc.integrate(SMOOTH, rtol=1e-9, max_n=100_000)
    assert few.n == 100_000 and few.status == "budget reached"
    even = mc.integrate(SMOOTH, rtol=1e-9, max_n=100_000, sampler=mc.Sobol())
    assert even.n <= 131_072 and even.status == "budget reached"
    for sampler in (mc.Independent(), mc.Sobol()):
        short = mc.integrate(SMOOTH, max_seconds=0.5, sampler=sampler)
        assert short.seconds < 5.0 and short.status == "budget reached" and np.isfinite(short.stderr)


def test_vectors_stop_when_all_components_are_known():
    f = mc.Integrand(lambda u: jnp.stack([u[0], u[0] ** 8]), 1)
    estimate = mc.integrate(f, rtol=1e-3)
    lower, upper = estimate.interval()
    assert estimate.status == "converged" and ((upper - lower) <= 2e-3 * estimate.mean).all()


@pytest.mark.parametrize("sampler", [mc.Independent(), mc.Sobol()], ids=repr)
@pytest.mark.parametrize("f", [INFINITE_VARIANCE, SPIKE], ids=["infinite_variance", "spike"])
def test_heavy_tails_are_refused(f, sampler):
    estimate = mc.integrate(f, n=65_536, sampler=sampler)
    assert estimate.heavy and estimate.status == "tail too heavy"
    assert mc.integrate(f, rtol=1e-12, max_n=65_536, sampler=sampler).status == "tail too heavy"


def test_a_nonfinite_value_ends_the_run():
    estimate = mc.integrate(jump(0.01, math.nan, 1.0), rtol=1e-3)
    assert estimate.status == "non-finite values seen" and estimate.n == stopping.FIRST


def test_where_nothing_varies_the_status_says_so():
    constant = mc.integrate(jump(0.5, 0.0), rtol=1e-6)
    assert constant.reached and constant.n == stopping.FIRST and constant.status == "all samples equal"
    unseen = mc.integrate(jump(1e-7, 1e7), n=1000)
    assert unseen.mean == 0.0 and unseen.status == "all samples equal"


def test_an_interval_can_be_copied_and_stored():
    interval = mc.integrate(SMOOTH, n=100).interval(0.9)
    for again in (copy.deepcopy(interval), pickle.loads(pickle.dumps(interval))):
        assert again == interval and (again.method, again.level) == (interval.method, 0.9)
