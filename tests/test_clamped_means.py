"""Clamped means whose threshold the data chooses, energy handed back, and bands without a law."""

import numpy as np
import pytest
from scipy import stats

from jaxmc.analysis import clamped_means, clamping
from jaxmc.integration.tallies import ClampSums, Histogram
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto

EDGES = np.concatenate([[0.0], np.outer(2.0 ** np.arange(-10, 20), 1 + np.arange(8) / 8).ravel()])


def histogram(samples):
    c = np.asarray(samples, np.float64)
    j = np.searchsorted(EDGES, c, side="right") - 1
    return Histogram(EDGES, *(np.bincount(j, c**q, EDGES.size) for q in range(3)), c.size, 0, 0)


def draw(law, *shape, seed=1):
    return law.sample(np.random.default_rng(seed).random((law.dim, *shape)))


def test_each_half_is_clamped_at_the_threshold_of_the_other():
    first, second = draw(Pareto(1.5), 3000), draw(Pareto(1.5), 2000, seed=2)
    got = clamped_means.cross_fitted_mean(histogram(first), histogram(second))
    choices = [clamping.optimal_threshold(clamping.clamp_curve(histogram(c)), 5000) for c in (second, first)]
    for t, choice in zip(got.thresholds, choices):
        assert t in EDGES and t == pytest.approx(choice.threshold, rel=0.07)
    clamped = np.minimum(first, got.thresholds[0]).sum() + np.minimum(second, got.thresholds[1]).sum()
    assert got.mean == pytest.approx(clamped / 5000, rel=1e-12)
    assert got.exceedances == (choices[0].exceedances, choices[1].exceedances)
    assert got.reliable == (choices[0].reliable and choices[1].reliable)


def test_cross_fitting_removes_the_bias_that_a_threshold_of_ones_own_makes():
    law, n, runs = Mix(0.01, 500.0), 400, 1500
    cross, own = np.empty(runs), np.empty(runs)
    for run in range(runs):
        halves = [histogram(c) for c in draw(law, 2, n // 2, seed=run)]
        got = clamped_means.cross_fitted_mean(*halves)
        cross[run] = got.mean - np.mean([law.mean - law.clamp_bias(t) for t in got.thresholds])
        both = Histogram(EDGES, *(a + b for a, b in zip(halves[0][1:5], halves[1][1:5])), 0, 0)
        curve = clamping.clamp_curve(both)
        t = clamping.optimal_threshold(curve, n).threshold
        own[run] = curve.unclamped_mean - np.interp(t, curve.threshold, curve.bias) - (law.mean - law.clamp_bias(t))
    errors = cross.std() / np.sqrt(runs), own.std() / np.sqrt(runs)
    assert abs(cross.mean()) < 5.0 * errors[0] < 0.3
    # Where many bright samples came the threshold is high too, and lets more of them pass.
    assert own.mean() > 4.0 * errors[1]


def test_thresholds_from_few_exceedances_are_refused():
    # 5 hits or more are needed on both sides to know what clamping loses.
    rare = np.concatenate([np.random.default_rng(0).random(2000), [500.0] * 3])
    often = np.concatenate([np.random.default_rng(1).random(2000), [500.0] * 30])
    assert not clamped_means.cross_fitted_mean(histogram(rare), histogram(often)).reliable
    assert clamped_means.cross_fitted_mean(histogram(often), histogram(often)).reliable
    assert min(clamped_means.cross_fitted_mean(histogram(rare), histogram(often)).exceedances) <= 3.0


# Images.

LADDER = 2.0 ** np.arange(-3, 12, 0.5)


def ladder(samples):
    """Return the sums of a ClampLadder over samples (n, pixels)."""
    kept = np.minimum(samples, LADDER[:, None, None])
    excess = np.maximum(samples - LADDER[:, None, None], 0.0)
    return ClampSums(LADDER, len(samples), *(x.mean(1) for x in (kept, kept**2, excess, excess**2)))


SCALE = np.where(np.arange(60) % 10 == 0, 20.0, 1.0)


def test_an_image_is_clamped_half_by_half():
    first, second = (draw(Pareto(1.6), 200, 60, seed=s) * SCALE for s in (1, 2))
    a, b = ladder(first), ladder(second)
    curve = clamped_means.ladder_curve(a)
    direct = clamping.image_curve(first.mean(0), *a[2:], LADDER, 200)
    assert all(np.allclose(x, y) for x, y in zip(curve, direct))
    got = clamped_means.cross_fitted_image(a, b, N=64)
    for mine, theirs in zip(got.thresholds, (b, a)):
        best = clamping.image_optimum(clamped_means.ladder_curve(theirs), 64).threshold
        assert mine == LADDER[np.argmin(np.abs(np.log(LADDER / best)))]
    t = got.thresholds
    want = 0.5 * (np.minimum(first, t[0]).mean(0) + np.minimum(second, t[1]).mean(0))
    assert got.reliable and np.allclose(got.mean, want)
    assert clamped_means.cross_fitted_image(a, b).thresholds > t
    with pytest.raises(ValueError, match="same thresholds"):
        clamped_means.cross_fitted_image(a, b._replace(thresholds=LADDER * 2.0))


@pytest.mark.parametrize("tile", [1, 2, 4, 100])
def test_pooled_residuals_keep_the_energy_of_every_tile(tile):
    samples = draw(Pareto(1.6), 50, 60) * SCALE
    sums, t = ladder(samples), LADDER[10]
    got = clamped_means.pool_residual(sums, t, width=10, tile=tile)
    mean, clamped = samples.mean(0).reshape(6, 10), np.minimum(samples, t).mean(0).reshape(6, 10)
    assert got.shape == (6, 10) and got.sum() == pytest.approx(mean.sum(), rel=1e-12)
    for row in range(0, 6, tile):
        for column in range(0, 10, tile):
            where = slice(row, row + tile), slice(column, column + tile)
            assert got[where].sum() == pytest.approx(mean[where].sum(), rel=1e-12)
            handed = got[where] - clamped[where]
            assert np.allclose(handed, handed.flat[0], atol=1e-12) and handed.flat[0] > 0.0
    if tile == 1:
        assert np.allclose(got, mean)


def test_pooled_residuals_trade_variance_for_blur():
    law, t = Mix(0.02, 500.0), 2.0
    samples = draw(law, 32, 64 * 64)
    excess = np.maximum(samples - t, 0.0).mean(0)[None]
    sums = ClampSums(np.array([t]), 32, np.minimum(samples, t).mean(0)[None], *(excess,) * 3)
    pooled, plain = clamped_means.pool_residual(sums, t, width=64, tile=8), samples.mean(0)
    # Where all pixels are alike nothing is lost, and the variance falls to that of a tile and of what is clamped.
    clamped_variance = (law.clamped_square(t) - (law.mean - law.clamp_bias(t)) ** 2) / 32
    assert pooled.var() < 1.3 * (clamped_variance + law.variance / 32 / 64) < 0.05 * plain.var()
    assert abs(pooled.mean() - law.mean) < 5.0 * np.sqrt(law.variance / samples.size)


@pytest.mark.parametrize(
    ("options", "match"), [({"threshold": 3.3}, "ladder"), ({"width": 7}, "divide"), ({"tile": 0}, "tile")]
)
def test_impossible_pools_are_refused(options, match):
    sums = ladder(draw(Exponential(), 4, 60))
    with pytest.raises(ValueError, match=match):
        clamped_means.pool_residual(sums, **({"threshold": 1.0, "width": 10, "tile": 2} | options))


# Bands.


def covers(band, exact):
    return bool(np.all((band.lower <= exact) & (exact <= band.upper)))


@pytest.mark.parametrize("n", [50, 2000])
def test_the_band_of_a_bounded_law_holds_where_the_normal_one_fails(n):
    law, held, normal = Mix(1e-3, 500.0), [], []
    for seed in range(300):
        curve = clamping.clamp_curve(histogram(draw(law, n, seed=seed)))
        exact = law.clamp_bias(curve.threshold)
        held.append(covers(clamped_means.bounded_band(curve, 500.0), exact))
        bias, stderr = (np.interp(2.0, curve.threshold, x, right=0.0) for x in (curve.bias, curve.bias_stderr))
        normal.append(abs(bias - law.clamp_bias(2.0)) <= 2.0 * stderr)
    assert np.mean(held) >= 0.95
    assert np.mean(normal) < (0.1 if n == 50 else 0.95)
    band = clamped_means.bounded_band(curve, 500.0)
    assert band.quantile == pytest.approx(np.sqrt(np.log(40.0) / (2 * n))) and band.trusted
    at = curve.threshold > 1.0
    assert np.allclose((band.upper - curve.bias)[at], band.quantile * np.maximum(500.0 - curve.threshold[at], 0.0))


def test_the_band_knows_when_its_bound_is_none():
    curve = clamping.clamp_curve(histogram(draw(Mix(0.1, 500.0), 100)))
    with pytest.raises(ValueError, match="no bound"):
        clamped_means.bounded_band(curve, 400.0)
    with pytest.raises(ValueError, match="level"):
        clamped_means.bounded_band(curve, 500.0, level=95)


def test_the_band_of_replicates_is_students_and_holds_as_often_as_it_says():
    law, held = Exponential(), []
    for seed in range(150):
        parts = [histogram(c) for c in draw(law, 10, 300, seed=seed)]
        t, band = clamped_means.replicate_band(parts)
        held.append((band.lower <= law.clamp_bias(t)) & (law.clamp_bias(t) <= band.upper))
        if seed == 0:
            j = np.searchsorted(t, 1.0)
            bias = [clamping.clamp_curve(p) for p in parts]
            bias = [c.bias[np.searchsorted(c.threshold, 1.0)] for c in bias]
            half = stats.t.ppf(0.975, 9) * np.std(bias, ddof=1) / np.sqrt(10)
            assert t[j] == 1.0 and band.upper[j] == pytest.approx(np.mean(bias) + half, rel=1e-9)
            low = t.min()
            assert band.upper[0] + band.lower[0] == pytest.approx(
                2 * np.mean([p.total.sum() / p.n - low for p in parts]), rel=1e-3
            )
    columns = min(len(h) for h in held)
    share = np.mean([h[np.searchsorted(EDGES[1:], 0.02) : columns - 40] for h in [h[:columns] for h in held]])
    assert 0.9 < share < 0.99
    for bad, match in (([parts[0]], "replicates"), (parts, "level")):
        with pytest.raises(ValueError, match=match):
            clamped_means.replicate_band(bad, level=95)


# The coverage of the sup-t band, which a heavy tail ruins.

COVERAGE = [(Exponential(), 0.967), (Mix(0.01, 500.0), 0.933), (Pareto(1.5), 0.607)]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "measured"), COVERAGE, ids=str)
def test_the_coverage_of_the_normal_band_with_as_few_as_5_exceedances(law, measured, monkeypatch):
    # Measured on 150 runs with all edges: the band of the library asks for 50 exceedances, and covers more.
    held = {5: [], 50: []}
    for least in held:
        monkeypatch.setattr(clamping, "BAND_EXCEEDANCES", least)
        for seed in range(150):
            curve = clamping.clamp_curve(histogram(draw(law, 20_000, seed=seed)))
            held[least].append(covers(clamping.bias_band(curve, khat=0.0), law.clamp_bias(curve.threshold)))
    error = np.sqrt(2.0 * measured * (1.0 - measured) / 150)
    assert np.mean(held[5]) < measured + 4.0 * error
    assert np.mean(held[50]) >= np.mean(held[5])
    if law == COVERAGE[2][0]:
        assert np.mean(held[50]) < 0.9
    else:
        assert np.mean(held[50]) > 0.88


def test_laws_of_the_optimum_at_infinite_variance():
    # The error falls as N^(-2 (1 - 1/alpha)), and alpha - 1 samples of a pixel are clamped.
    for alpha in (1.2, 1.5, 1.8):
        law = Pareto(alpha)
        N = np.array([10**5, 10**6])
        t = np.array([law.optimal_threshold(n) for n in N])
        mse = law.clamp_bias(t) ** 2 + (law.clamped_square(t) - (law.mean - law.clamp_bias(t)) ** 2) / N
        assert np.log10(mse[1] / mse[0]) == pytest.approx(-2.0 * (1.0 - 1.0 / alpha), abs=0.06)
        assert N[1] * law.exceedance(t[1]) == pytest.approx(alpha - 1.0, rel=0.02)
        assert t[1] == pytest.approx(((N[1] - 1) / (alpha - 1.0)) ** (1.0 / alpha), rel=0.05)
    assert all(Pareto(2.0).optimal_threshold(N) == pytest.approx(1.0 + np.sqrt(N), rel=1e-12) for N in (4, 100, 12_345))


BEST = [  # D1 with A = 500: p, N, best threshold, its MSE, MSE without clamping and with a threshold of 3
    (1e-3, 16, 8.3739, 0.25077, 15.5834, 0.25260),
    (1e-3, 128, 57.2311, 0.22181, 1.94792, 0.24771),
    (1e-3, 1024, 253.336, 0.12329, 0.24349, 0.24710),
    (1e-3, 10_000, 454.632, 0.022670, 0.024933, 0.24702),
    (1e-4, 16, 1.2980, 7.699e-3, 1.56443, 7.717e-3),
    (1e-4, 1024, 46.902, 2.3446e-3, 0.024444, 2.552e-3),
]


@pytest.mark.parametrize(("p", "N", "t", "best", "unclamped", "at_3"), BEST)
def test_what_the_best_clamp_saves(p, N, t, best, unclamped, at_3):
    law = Mix(p, 500.0)

    def mse(t):
        return law.clamp_bias(t) ** 2 + (law.clamped_square(t) - (law.mean - law.clamp_bias(t)) ** 2) / N

    assert law.optimal_threshold(N) == pytest.approx(t, rel=5e-5)
    exact = (mse(law.optimal_threshold(N)), law.variance / N, mse(3.0))
    assert exact == pytest.approx((best, unclamped, at_3), rel=2e-4)


def test_lognormal_thresholds_solve_their_equation():
    law = LogNormal(0.3, 1.2)
    for N in (4, 1000):
        t = law.optimal_threshold(N)
        assert (N - 1) * law.clamp_bias(t) == pytest.approx(t - law.mean, rel=1e-9)
