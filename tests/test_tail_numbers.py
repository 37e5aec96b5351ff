"""Published and measured numbers of tails, waits and intervals, found again; k-hat against another implementation."""

import math

import numpy as np
import pytest
from scipy import stats

import analytic_scenes as scenes
from jaxmc.analysis import tails
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto, PathSum

FIREFLY = Mix(1e-3, 500.0)
S = 100_000


class Column:
    """Coordinates of ``n`` points, drawn one dimension at a time."""

    def __init__(self, n, seed):
        self.n, self.seed = n, seed

    def __getitem__(self, k):
        return np.random.default_rng([self.seed, k]).random(self.n)


# k-hat of the samples below by arviz-stats 0.8.0, ``array_stats.pareto_khat(x[None], r_eff=1.0, tail="right")``.
KHAT = {
    (Pareto(1.2), 200): 0.5406198289432119,
    (Pareto(1.2), 1000): 0.7348779050100742,
    (Pareto(1.2), S): 0.7274547391504632,
    (Pareto(1.5), 200): 0.440947506255148,
    (Pareto(1.5), 1000): 0.6032973458226281,
    (Pareto(1.5), S): 0.5649070232812446,
    (Pareto(2.0), 200): 0.3418399705779006,
    (Pareto(2.0), 1000): 0.4708172137213134,
    (Pareto(2.0), S): 0.4042509348347276,
    (Pareto(3.0), 200): 0.2429241335222136,
    (Pareto(3.0), 1000): 0.3374408537050849,
    (Pareto(3.0), S): 0.24613505899104227,
    (Pareto(5.0), 200): 0.16353799608923894,
    (Pareto(5.0), 1000): 0.23014602116025074,
    (Pareto(5.0), S): 0.12192227386064515,
    (Exponential(), 1000): 0.06840561609401498,
    (Exponential(), S): -0.060259439839778696,
}


def sample_of(law, n):
    return law.sample(np.random.default_rng(7).random((1, n)))


@pytest.mark.parametrize(("law", "n"), KHAT, ids=str)
def test_khat_agrees_with_arviz(law, n):
    sample = sample_of(law, n)
    assert tails.pareto_khat(sample, n).khat == pytest.approx(KHAT[law, n], abs=1e-9)
    assert tails.pareto_khat(np.sort(sample)[-4096:], n).khat == pytest.approx(KHAT[law, n], abs=1e-9)


@pytest.mark.slow
def test_khat_agrees_with_arviz_as_installed():
    peer = pytest.importorskip("arviz_stats.base").array_stats
    for seed in range(20):
        for law in (Pareto(1.1), Pareto(2.5), LogNormal(0.0, 2.0), PathSum(0.9, 30)):
            for n in (300, 30_000):
                sample = law.sample(Column(n, seed))
                khat = float(np.squeeze(peer.pareto_khat(sample[None], r_eff=1.0, tail="right")))
                assert tails.pareto_khat(sample, n).khat == pytest.approx(khat, abs=1e-6)


# k-hat at 100,000 samples as measured once, another time; its error is (1 + khat) / sqrt(948).
MEASURED = {5 / 6: 0.887, 2 / 3: 0.762, 0.5: 0.496, 1 / 3: 0.288, 0.2: 0.215}


@pytest.mark.parametrize("shape", MEASURED)
def test_khat_of_pareto_laws_is_as_measured(shape):
    fit = tails.pareto_khat(Pareto(1.0 / shape).sample(np.random.default_rng(11).random((1, S))), S)
    assert fit.exceedances == 948
    assert abs(fit.khat - MEASURED[shape]) < 4.0 * math.sqrt(2.0) * fit.stderr
    assert abs(fit.khat - shape) < 4.0 * fit.stderr


# The path sum: its tail index is known, but the tail is a power law only far out.
SLOW_TAILS = {0.178: 0.131, 0.25: 0.242, 0.346: 0.353, 0.5: 0.634, 0.774: 0.793}
ALBEDOS = {0.178: 0.7, 0.25: (5 / 16) ** 0.25, 0.346: 0.8, 0.5: math.sqrt(3) / 2, 0.774: 0.95}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SLOW_TAILS)
def test_khat_of_path_sums_is_near_their_tail_index(shape):
    law = PathSum(ALBEDOS[shape])
    assert 1.0 / law.tail_index == pytest.approx(shape, abs=6e-4)
    fit = tails.pareto_khat(law.sample(Column(S, 5)), S)
    assert abs(fit.khat - SLOW_TAILS[shape]) < 4.0 * math.sqrt(2.0) * fit.stderr
    assert abs(fit.khat - shape) < 0.15


def test_a_tail_of_one_atom_is_not_a_heavy_one():
    sample = FIREFLY.sample(np.random.default_rng(3).random((1, S)))
    fit = tails.pareto_khat(sample, S)
    assert fit.status == "atomic" and math.isnan(fit.khat)
    # What the fit would have said.
    tail = np.sort(sample)[-948:] - np.sort(sample)[-949]
    assert tails._fit_generalised_pareto(tail[tail > 0.0])[0] == pytest.approx(2.53, abs=0.3)


def test_a_khat_just_below_one_asks_for_more_samples_than_there_are_numbers(monkeypatch):
    # 10^(1 / (1 - khat)) has no float64 from khat = 0.9968 on.
    sample = Pareto(1.0).sample(np.random.default_rng(3).random((1, S)))
    for khat, few in ((0.99, True), (0.999, False)):
        monkeypatch.setattr(tails, "_fit_generalised_pareto", lambda tail, khat=khat: (khat, 1.0))
        fit = tails.pareto_khat(sample, S)
        assert fit.status == "unreliable" and math.isfinite(fit.min_n) == few


def test_effective_samples_and_waits_of_a_firefly():
    law = FIREFLY
    share = law.mean**2 / (law.variance + law.mean**2)
    assert share == pytest.approx(0.0040, abs=5e-5)
    assert tails.effective_sample_size(10**6, 10**6 * law.mean, 10**6 * (law.variance + law.mean**2)) == pytest.approx(
        share * 10**6
    )
    wait = tails.expected_wait(1000, 10**6)
    assert wait.mean == 1000.0 and wait.median == 693.0
    # One hit is visible, off by A / N > 1, until N = 500: there most pixels have one that will.
    assert 1.0 - (1.0 - law.p) ** 500 == pytest.approx(0.394, abs=5e-4)
    assert law.variance / law.mean**2 / 0.1**2 == pytest.approx(24_960, rel=1e-3)
    dim = 0.5
    assert (law.A - dim) / (law.mean - dim) == pytest.approx(1.0 / law.p, rel=1e-12)
    skewness = law.p * (1 - law.p) * (1 - 2 * law.p) * (law.A - dim) ** 3 / law.variance**1.5
    assert skewness == pytest.approx(law.p**-0.5, rel=0.01) and 25 * skewness**2 == pytest.approx(25 / law.p, rel=0.02)


def test_the_rate_of_samples_that_move_a_pixel_falls_with_its_samples():
    # P(c > eta N mean) in N samples falls as N^(1 - alpha).
    law = Pareto(1.5)
    rate = [N * law.exceedance(0.1 * N * law.mean) for N in (100, 10_000)]
    assert rate[1] / rate[0] == pytest.approx(100.0**-0.5)


COVERAGE = {16: 0.016, 256: 0.227, 1024: 0.640, 4096: 0.912, 25_000: 0.945, 100_000: 0.946}


@pytest.mark.parametrize("N", COVERAGE)
def test_students_interval_of_a_firefly_covers_as_rarely_as_said(N):
    # Sum over the hits m; given m, mean and variance follow from the dim samples, whose sums are nearly normal.
    rng, draws, covered = np.random.default_rng(N), 4000, 0.0
    quantile = stats.t.ppf(0.975, N - 1)
    first, last = (int(x) for x in stats.binom.ppf([1e-10, 1.0 - 1e-10], N, FIREFLY.p))
    for m in range(first, last + 1):
        rest = N - m
        if rest <= 256:
            u = rng.random((rest, draws))
            total, square = u.sum(0), (u * u).sum(0)
        else:
            # Sum and sum of squares of uniform numbers, with their covariance 1/12.
            z = rng.normal(size=(2, draws))
            total = rest / 2 + math.sqrt(rest / 12) * z[0]
            square = rest / 3 + math.sqrt(rest) * (z[0] / math.sqrt(12) + z[1] * math.sqrt(4 / 45 - 1 / 12))
        mean = (total + 500.0 * m) / N
        variance = ((square + 500.0**2 * m) - N * mean**2) / (N - 1)
        inside = np.abs(mean - FIREFLY.mean) <= quantile * np.sqrt(variance / N)
        covered += stats.binom.pmf(m, N, FIREFLY.p) * inside.mean()
    assert covered == pytest.approx(COVERAGE[N], abs=0.003)


def test_tail_indices_are_shapes():
    assert [1.0 / scenes.tail_index(rho) for rho in ALBEDOS.values()] == pytest.approx(list(SLOW_TAILS), abs=6e-4)
