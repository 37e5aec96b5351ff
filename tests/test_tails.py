"""Tail fits, shares, exceedances and waiting times, against laws whose tail is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from jaxmc.analysis import tails
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto

N = 100_000
KEPT = 4096


def _largest(law, n=N, seed=1):
    return np.sort(law.sample(np.random.default_rng(seed).random((law.dim, n))))[-KEPT:]


@pytest.mark.parametrize("alpha", [1.2, 1.5, 2.0, 3.0, 5.0])
def test_khat_of_a_pareto_law_is_one_over_its_exponent(alpha):
    fit = tails.pareto_khat(_largest(Pareto(alpha)), N)
    assert fit.exceedances == fit.recommended == 948
    assert fit.stderr < 0.07
    assert abs(fit.khat - 1.0 / alpha) < 4.0 * fit.stderr
    # A Pareto law above a threshold t is generalised Pareto with scale t / alpha.
    assert fit.scale == pytest.approx(fit.threshold / alpha, rel=0.2)


def test_khat_has_no_bias_beyond_its_prior():
    # The prior, worth 10 samples at 1/2, moves 2/3 to 0.665 at 948 exceedances.
    rng = np.random.default_rng(2)
    khat = [tails.pareto_khat(Pareto(1.5).sample(rng.random((1, 949))), N).khat for _ in range(100)]
    assert np.std(khat) == pytest.approx((1 + 2 / 3) / np.sqrt(948), rel=0.2)
    assert abs(np.mean(khat) - 0.665) < 4.0 * np.std(khat) / 10.0 < 0.03


@pytest.mark.parametrize(("law", "khat"), [(LogNormal(0.0, 1.5), 0.42), (Exponential(), -0.03)])
def test_khat_of_laws_with_all_moments(law, khat):
    fit = tails.pareto_khat(_largest(law), N)
    assert fit.khat == pytest.approx(khat, abs=0.15)
    assert fit.status == "reliable"


def test_khat_of_a_bounded_law_is_minus_one():
    uniform = np.random.default_rng(3).random(N)
    assert tails.pareto_khat(uniform, N).khat == pytest.approx(-0.94, abs=0.05)


@pytest.mark.parametrize("shape", [0.2, 0.8])
def test_khat_is_a_posterior_mean_drawn_toward_one_half(shape):
    # Quantiles of a generalised Pareto law above 0, the 40 exceedances that 200 samples give.
    tail = stats.genpareto.ppf((np.arange(40) + 0.5) / 40, shape)
    # Zhang & Stephens' prior of theta = -shape / scale, by its quantiles; for each theta the likeliest shape.
    prior = (np.arange(4000) + 0.5) / 4000
    theta = 1.0 / tail[-1] + (1.0 - prior**-0.5) / (3.0 * tail[9])
    likeliest = np.array([np.log1p(-t * tail).mean() for t in theta])
    fits = zip(likeliest, -likeliest / theta, strict=True)
    likelihood = np.exp([stats.genpareto.logpdf(tail, k, scale=scale).sum() for k, scale in fits])
    best = np.log1p(-np.average(theta, weights=likelihood) * tail).mean()
    khat = tails.pareto_khat(np.append(tail, 0.0), 200).khat
    assert khat == pytest.approx((40 * best + 10 * 0.5) / 50, abs=0.01)


def test_khat_does_not_depend_on_units_or_order():
    sample = _largest(Pareto(1.5))
    fit = tails.pareto_khat(sample, N)
    for unit in (1e-30, 1e30):
        scaled = tails.pareto_khat(np.random.default_rng(4).permutation(sample) * unit, N)
        assert scaled.khat == pytest.approx(fit.khat, rel=1e-9)
        assert scaled.scale == pytest.approx(fit.scale * unit, rel=1e-9)


def test_statuses_and_the_samples_they_ask_for():
    heavy = tails.pareto_khat(_largest(Pareto(0.8)), N)
    assert heavy.status == "no mean" and heavy.min_n == np.inf
    middle = tails.pareto_khat(_largest(Pareto(1.15)), N)
    assert middle.status == "unreliable" and middle.reliable_below == 0.7
    assert middle.min_n == pytest.approx(10.0 ** (1.0 / (1.0 - middle.khat)))
    assert tails.pareto_khat(_largest(Exponential(), 400), 400).reliable_below == pytest.approx(1 - 1 / np.log10(400))
    for fit in (heavy, middle):
        assert str(fit) == fit.explain() and fit.status in str(fit) and f"{fit.khat:.2f}" in str(fit)


def test_repeated_maximum_is_atomic():
    # The law is bounded, yet a fit would claim that it has no mean.
    fit = tails.pareto_khat(_largest(Mix(1e-3, 500.0)), N)
    assert fit.status == "atomic" and np.isnan(fit.khat) and "repeated" in str(fit)
    assert tails.pareto_khat(np.ones(100), 100).status == "atomic"
    rounded = np.concatenate([[9.0, 9.0 - 2e-6, 9.0 - 4e-6], np.random.default_rng(0).random(9_700)])
    assert tails.pareto_khat(rounded, 10_000).status == "atomic"
    two_atoms = np.concatenate([[9.0], np.full(299, 5.0), np.random.default_rng(0).random(9_700)])
    assert tails.pareto_khat(two_atoms, 10_000).status == "atomic"


def test_short_tails_use_what_there_is_and_say_so():
    short = tails.pareto_khat(_largest(Pareto(2.0))[-200:], N)
    assert short.exceedances == 199 and "199 of 948" in str(short)
    assert short.khat == pytest.approx(0.5, abs=0.4)
    few = tails.pareto_khat(np.random.default_rng(5).random(20), 20)
    assert few.status == "too few samples" and np.isnan(few.khat) and "only 4" in str(few)


def test_samples_that_are_mostly_zero_are_fitted_above_zero():
    rng = np.random.default_rng(6)
    sample = np.where(rng.random(N) < 5e-3, Pareto(1.5).sample(rng.random((1, N))) - 1.0, 0.0)
    fit = tails.pareto_khat(sample, N)
    assert fit.threshold == 0.0 and fit.exceedances == np.count_nonzero(sample) < fit.recommended
    assert abs(fit.khat - 2 / 3) < 4.0 * fit.stderr < 0.4


@pytest.mark.parametrize(("largest", "n"), [([], 10), ([1.0, 2.0, 3.0], 2), ([1.0, np.inf], 9), ([1.0, np.nan], 9)])
def test_khat_rejects_impossible_input(largest, n):
    with pytest.raises(ValueError, match="expected"):
        tails.pareto_khat(np.array(largest), n)


def test_largest_shares():
    shares = tails.largest_shares(np.array([2.0, 5.0, 1.0]), 10.0, counts=(1, 2, 3, 4))
    assert np.allclose(shares[:3], [0.5, 0.7, 0.8]) and np.isnan(shares[3])
    assert np.isnan(tails.largest_shares(np.zeros(3), 0.0, counts=(1,))).all()
    with pytest.raises(ValueError, match="non-negative"):
        tails.largest_shares(np.array([-1.0]), 10.0)


def test_effective_sample_size():
    law = Mix(1e-3, 500.0)
    square = law.variance + law.mean**2
    assert tails.effective_sample_size(1000, 1000 * law.mean, 1000 * square) == pytest.approx(3.99, abs=0.01)
    assert tails.effective_sample_size(7, 7 * 0.1, 7 * 0.1**2) == pytest.approx(7.0)
    assert np.allclose(tails.effective_sample_size(4, np.array([0.0, 4.0, 1.0]), np.array([0.0, 4.0, 1.0])), [0, 4, 1])


def test_clopper_pearson_covers_and_solves_its_equations():
    lower, upper = tails.clopper_pearson(np.arange(11), 10)
    assert lower[0] == 0.0 and upper[10] == 1.0
    assert np.allclose(stats.binom.sf(np.arange(10), 10, lower[1:]), 0.025)
    assert np.allclose(stats.binom.cdf(np.arange(10), 10, upper[:10]), 0.025)
    for p in (0.01, 0.3, 0.77):
        covered = (lower <= p) & (p <= upper)
        assert stats.binom.pmf(np.arange(11), 10, p)[covered].sum() >= 0.95
    for count, n, level in ((11, 10, 0.95), (-1, 10, 0.95), (1, 10, 95.0)):
        with pytest.raises(ValueError, match="expected"):
            tails.clopper_pearson(count, n, level)


def test_exceedance_counts_from_each_edge_up():
    histogram = SimpleNamespace(edges=np.array([0.0, 1.0, 2.0, 4.0]), count=np.array([6, 3, 1, 0]), n=10)
    found = tails.exceedance(histogram)
    assert np.allclose(found.fraction, [1.0, 0.4, 0.1, 0.0])
    assert np.all(found.lower <= found.fraction) and np.all(found.fraction <= found.upper)
    assert found.upper[3] == pytest.approx(1.0 - 0.025**0.1)


def test_expected_wait():
    wait = tails.expected_wait(100, 100_000)
    assert wait.mean == pytest.approx(1000.0) and wait.median == 693.0
    assert wait.lower < 1000.0 < wait.upper
    assert tails.expected_wait(5, 10).median == 1.0 and tails.expected_wait(10, 10).mean == 1.0
    never = tails.expected_wait(0, 3000)
    assert never.mean == never.upper == never.median == np.inf
    assert never.lower == pytest.approx(1.0 / (1.0 - 0.05 ** (1 / 3000))) == pytest.approx(1000.0, rel=0.01)
