"""Clamp curves against brute force on the samples and against laws with closed forms."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

from jaxmc.analysis import clamping
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto, ThroughputProduct

LAWS = [Mix(1e-3, 500.0), Mix(1e-4, 500.0), Pareto(1.5), Pareto(2.0, 3.0), Pareto(5.0, 0.5)]
LAWS += [LogNormal(0.0, 1.5), Exponential(), ThroughputProduct(1, 0.9), ThroughputProduct(4, 0.8)]


def _histogram(samples, lowest=-100, highest=104):
    """Tally samples: octaves from 2^lowest up in 8 equal parts, all below in bin 0, all above in the last."""
    edges = np.concatenate([[0.0], np.outer(2.0 ** np.arange(lowest, highest), 1 + np.arange(8) / 8).ravel()])
    c = np.asarray(samples, dtype=np.float64)
    j = np.searchsorted(edges, c, side="right") - 1
    count, total, square = (np.bincount(j, c**q, edges.size) for q in range(3))
    return SimpleNamespace(edges=edges, count=count, total=total, square=square, n=c.size, nonfinite=0, negative=0)


def _draw(law, n, seed=1):
    return law.sample(np.random.default_rng(seed).random((law.dim, n)))


def _exact_mse(law, t, N):
    bias = law.clamp_bias(t)
    return bias**2 + (law.clamped_square(t) - (law.mean - bias) ** 2) / N


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("t", [0.2, 0.7, 1.0, 5.0])
def test_closed_forms_are_integrals_of_the_exceedance(law, t):
    kinks = [0.1, min(0.5, t), min(1.0, t), min(3.0, t)]
    clamped = integrate.quad(law.exceedance, 0.0, t, points=kinks, limit=200)[0]
    square = integrate.quad(lambda x: 2.0 * x * law.exceedance(x), 0.0, t, points=kinks, limit=200)[0]
    assert law.mean - law.clamp_bias(t) == pytest.approx(clamped, rel=1e-7)
    assert law.clamped_square(t) == pytest.approx(square, rel=1e-7)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_samples_follow_their_law(law):
    sample = _draw(law, 20_000)
    t = np.quantile(sample, [0.1, 0.5, 0.9, 0.99])
    p = law.exceedance(t)
    assert np.all(np.abs(np.mean(sample[:, None] > t, axis=0) - p) <= 4.0 * np.sqrt(p * (1.0 - p) / sample.size))
    unclamped = law.clamped_square(1e9) - (law.mean - law.clamp_bias(1e9)) ** 2
    assert law.variance == np.inf if getattr(law, "alpha", 3) <= 2 else law.variance == pytest.approx(unclamped)
    assert law.clamp_bias(0.0) == pytest.approx(law.mean) and law.clamped_square(0.0) == 0.0


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_samples_are_the_same_in_jax_one_point_at_a_time(law):
    u = np.random.default_rng(2).random((50, law.dim))
    assert np.allclose(jax.vmap(law.sample)(jnp.asarray(u, dtype=jnp.float32)), law.sample(u.T), rtol=1e-4, atol=1e-6)


def test_throughput_product_moments():
    law = ThroughputProduct(10, 0.8)
    per_bounce = [law.moment(q) ** 0.1 for q in (1, 2, 3, 4)]
    assert per_bounce == pytest.approx([0.8, 4 * 0.64 / 3, 2 * 0.512, 16 * 0.4096 / 5])
    assert law.variance == pytest.approx(law.moment(2) - law.moment(1) ** 2)
    # Half of the mean is carried by one product in 31.
    assert 1.0 / law.exceedance(1.6**10 * np.exp(-5.0)) == pytest.approx(31.4, abs=0.1)


MIX_TABLE = [  # p, N, best threshold, its MSE, MSE at 3
    (1e-3, 16, 8.3739, 0.25077, 0.25260),
    (1e-3, 1024, 253.336, 0.12329, 0.24710),
    (1e-3, 10_000, 454.632, 0.022670, 0.24702),
    (1e-4, 16, 1.2980, 7.699e-3, 7.717e-3),
    (1e-4, 1024, 46.902, 2.3446e-3, 2.552e-3),
]


@pytest.mark.parametrize(("p", "N", "t", "mse", "mse_at_3"), MIX_TABLE)
def test_best_threshold_of_the_rare_bright_path(p, N, t, mse, mse_at_3):
    law = Mix(p, 500.0)
    assert law.optimal_threshold(N) == pytest.approx(t, rel=5e-5)
    assert _exact_mse(law, law.optimal_threshold(N), N) == pytest.approx(mse, rel=1e-4)
    assert _exact_mse(law, 3.0, N) == pytest.approx(mse_at_3, rel=1e-4)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("N", [2, 16, 1000])
def test_optimal_thresholds_are_minima(law, N):
    t = law.optimal_threshold(N)
    assert (N - 1) * law.clamp_bias(t) == pytest.approx(t - law.mean, rel=1e-9)
    assert all(_exact_mse(law, t, N) < _exact_mse(law, t * f, N) for f in (0.98, 1.02))


def test_optimal_thresholds_in_closed_form():
    assert Pareto(2.0).optimal_threshold(256) == 17.0
    assert Exponential().optimal_threshold(1) == 1.0
    clamped = [N * Pareto(1.5).exceedance(Pareto(1.5).optimal_threshold(N)) for N in (16, 256, 4096)]
    assert clamped == pytest.approx([0.397, 0.479, 0.496], abs=5e-4)
    with pytest.raises(ValueError, match="finite mean"):
        Pareto(1.0).optimal_threshold(4)


RANDOM = np.random.default_rng(7)
SAMPLES = {
    "mix": _draw(Mix(1e-3, 500.0), 20_000),
    "exponential": _draw(Exponential(), 1000),
    "two samples": np.array([0.0, 3.0]),
    "on edges": 2.0 ** RANDOM.integers(-5, 6, 1000) * (1 + RANDOM.integers(0, 8, 1000) / 8),
    "mostly zero": np.where(RANDOM.random(1000) < 0.9, 0.0, RANDOM.random(1000)),
    "up to 1e30": 10.0 ** RANDOM.uniform(0, 30, 2000),
    "down to 1e-30": 10.0 ** RANDOM.uniform(-30, 0, 2000),
    "constant": np.full(1000, 0.3),
    "constant on an edge": np.full(1000, 0.25),
    "all zero": np.zeros(10),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_curve_equals_brute_force_at_every_edge(name):
    c = SAMPLES[name]
    curve = clamping.clamp_curve(_histogram(c))
    t = curve.threshold[:, None]
    excess, clamped = np.maximum(c - t, 0.0), np.minimum(c, t)
    scale = np.abs(c).max()
    assert curve.threshold[0] <= c.min() and curve.threshold[-1] >= c.max()
    assert np.allclose(curve.bias, excess.mean(axis=1), rtol=1e-9, atol=0)
    assert np.allclose(curve.mean, clamped.mean(axis=1), rtol=1e-9, atol=0)
    stderr = excess.std(axis=1, ddof=1) / np.sqrt(c.size)
    assert np.allclose(curve.bias_stderr, stderr, rtol=1e-6, atol=1e-8 * excess.max(axis=1))
    deviation = clamped.std(axis=1, ddof=1)
    assert np.allclose(np.sqrt(curve.variance), deviation, rtol=1e-6, atol=1e-7 * clamped.max(axis=1))
    assert np.array_equal(curve.exceedances, np.sum(c >= t, axis=1))
    assert np.all(np.diff(curve.bias) <= 0) and curve.bias[-1] == 0.0
    assert curve.unclamped_mean == pytest.approx(c.mean(), rel=1e-9)
    assert curve.unclamped_variance == pytest.approx(c.var(ddof=1), rel=1e-9, abs=1e-15 * scale**2)


def test_samples_beyond_the_last_edge_are_not_lost():
    c = np.array([1.0, 2.0, 100.0])
    curve = clamping.clamp_curve(_histogram(c, -2, 3))
    assert curve.threshold[-1] == 7.5 and curve.bias[-1] == pytest.approx((100.0 - 7.5) / 3)
    best = clamping.optimal_threshold(curve, 10**6)
    assert best.threshold == 7.5 and not best.reliable


def test_estimates_are_unbiased():
    law, t, N, runs = Exponential(), 1.0, 4, 4000
    found = np.empty((runs, 3))
    for row, c in zip(found, _draw(law, runs * 40).reshape(runs, 40), strict=True):
        curve = clamping.clamp_curve(_histogram(c, -6, 6))
        at = curve.threshold == t
        row[:] = curve.bias[at][0], curve.variance[at][0], clamping.mse(curve, N)[at][0]
    exact = law.clamp_bias(t), law.clamped_square(t) - (law.mean - law.clamp_bias(t)) ** 2, _exact_mse(law, t, N)
    z = (found.mean(axis=0) - exact) / (found.std(axis=0) / np.sqrt(runs))
    assert np.all(np.abs(z) < 4.0)
    # Without taking off the variance of the bias the error would be seen.
    naive = np.mean(found[:, 0] ** 2 + found[:, 1] / N) - exact[2]
    assert naive > 6.0 * found[:, 2].std() / np.sqrt(runs)


@pytest.mark.parametrize("law", [Mix(1e-3, 500.0), Pareto(2.0), Exponential(), LogNormal(0.0, 1.5)], ids=str)
@pytest.mark.parametrize("N", [16, 256])
def test_estimated_optimum_is_near_the_exact_one(law, N):
    curve = clamping.clamp_curve(_histogram(_draw(law, 300_000)))
    best = clamping.optimal_threshold(curve, N)
    assert best.threshold == pytest.approx(law.optimal_threshold(N), rel=0.1) and best.reliable
    assert _exact_mse(law, best.threshold, N) == pytest.approx(_exact_mse(law, law.optimal_threshold(N), N), rel=5e-3)
    assert best.bias == pytest.approx(law.clamp_bias(best.threshold), rel=0.2)
    assert best.mse == clamping.mse_at(curve, best.threshold, N) < curve.unclamped_variance / N


def test_optimum_of_degenerate_samples():
    constant = clamping.optimal_threshold(clamping.clamp_curve(_histogram(SAMPLES["constant"])), 16)
    assert 0.3 <= constant.threshold <= 0.3125 and constant.mse < 0.001**2 * 16
    on_edge = clamping.optimal_threshold(clamping.clamp_curve(_histogram(SAMPLES["constant on an edge"])), 16)
    assert on_edge.threshold == 0.25 and on_edge.mse == 0.0
    assert clamping.optimal_threshold(clamping.clamp_curve(_histogram(np.zeros(9))), 16).threshold == 0.0
    curve = clamping.clamp_curve(_histogram(SAMPLES["exponential"]))
    assert clamping.optimal_threshold(curve, 1).threshold == pytest.approx(curve.unclamped_mean)
    assert not clamping.optimal_threshold(curve, 10**9).reliable
    with pytest.raises(ValueError, match="N >= 1"):
        clamping.optimal_threshold(curve, 0)


def test_mse_at_thresholds_off_the_grid():
    c = 2.0 + SAMPLES["exponential"]
    curve = clamping.clamp_curve(_histogram(c))
    below, beyond = clamping.mse_at(curve, np.array([0.5, 1e6]), 8)
    assert below == pytest.approx((c.mean() - 0.5) ** 2 - c.var(ddof=1) / c.size)
    assert beyond == pytest.approx(c.var(ddof=1) / 8)
    assert clamping.mse_at(curve, curve.threshold[5], 8) == clamping.mse(curve, 8)[5]


@pytest.mark.parametrize(
    ("field", "value", "cure"), [("nonfinite", 3, "mend"), ("negative", 1, "split"), ("n", 1, "run more")]
)
def test_histograms_that_cannot_be_clamped_are_rejected(field, value, cure):
    histogram = _histogram(SAMPLES["exponential"])
    setattr(histogram, field, value)
    with pytest.raises(ValueError, match=cure):
        clamping.clamp_curve(histogram)


def test_correlation_equals_that_of_the_excesses():
    c = SAMPLES["exponential"]
    curve = clamping.clamp_curve(_histogram(c, -4, 4))
    live = curve.exceedances > 1
    excess = np.maximum(c - curve.threshold[live][:, None], 0.0)
    assert np.allclose(clamping._bias_correlation(curve, live), np.corrcoef(excess), atol=1e-9)


@pytest.mark.parametrize(("law", "n"), [(Exponential(), 4000), (Mix(0.01, 500.0), 20_000)], ids=str)
def test_band_holds_the_whole_curve_as_often_as_it_says(law, n):
    held = []
    for seed in range(100):
        curve = clamping.clamp_curve(_histogram(_draw(law, n, seed), -4, 10))
        band = clamping.bias_band(curve, khat=0.0)
        exact = law.clamp_bias(curve.threshold)
        held.append(np.all((band.lower <= exact) & (exact <= band.upper)))
        assert 1.9 < band.quantile < 3.2
        assert np.all(np.diff(band.upper) <= 0) and np.all(np.diff(band.lower) <= 0) and band.lower.min() == 0.0
    assert 0.86 <= np.mean(held) < 1.0


def test_band_is_trusted_with_a_light_tail_only():
    curve = clamping.clamp_curve(_histogram(SAMPLES["exponential"]))
    assert clamping.bias_band(curve, khat=0.1).trusted
    for khat in (0.5, 2.0, None, np.nan):
        band = clamping.bias_band(curve, khat=khat)
        assert not band.trusted and "khat" in band.note
    assert clamping.bias_band(curve, level=0.5, khat=0.1).quantile < clamping.bias_band(curve, khat=0.1).quantile
    few = clamping.bias_band(clamping.clamp_curve(_histogram(np.ones(20))), khat=0.1)
    assert np.all(few.upper == np.inf) and np.all(few.lower == 0.0)
    with pytest.raises(ValueError, match="level"):
        clamping.bias_band(curve, level=95)


THRESHOLDS = 2.0 ** np.arange(-3, 9, 0.5)


def _image_averages(c, thresholds=THRESHOLDS):
    """Return the arguments of image_curve for samples (n, pixels)."""
    t = thresholds[:, None, None]
    clamped, excess = np.minimum(c, t), np.maximum(c - t, 0.0)
    return c.mean(axis=0), *(x.mean(axis=1) for x in (clamped, clamped**2, excess, excess**2)), thresholds, c.shape[0]


def test_image_curve_equals_direct_formulas():
    c = _draw(LogNormal(0.0, 1.0), 600).reshape(50, 12) * np.linspace(0.1, 4.0, 12)
    curve = clamping.image_curve(*_image_averages(c))
    t = THRESHOLDS[:, None, None]
    excess, clamped = np.maximum(c - t, 0.0), np.minimum(c, t)
    squared_bias = excess.mean(axis=1) ** 2 - excess.var(axis=1, ddof=1) / 50
    assert np.allclose(curve.bias, excess.mean(axis=(1, 2)))
    assert np.allclose(curve.squared_bias, squared_bias.mean(axis=1), atol=1e-12)
    assert np.allclose(curve.variance, clamped.var(axis=1, ddof=1).mean(axis=1))
    assert curve.unclamped_variance == pytest.approx(c.var(axis=0, ddof=1).mean())
    assert np.allclose(clamping.image_mse(curve, 16), curve.squared_bias + curve.variance / 16)
    shaped = clamping.image_curve(*(x.reshape(*x.shape[:-1], 3, 4) for x in _image_averages(c)[:5]), THRESHOLDS, 50)
    assert np.allclose(shaped.squared_bias, curve.squared_bias)


def test_image_optimum_is_not_that_of_the_pooled_samples():
    # One bright pixel in sixteen: clamped to the pool's best threshold it loses nearly all its energy.
    scale, n, N = np.where(np.arange(16) == 0, 100.0, 1.0), 4000, 64
    c = _draw(Exponential(), n * 16).reshape(n, 16) * scale
    best = clamping.image_optimum(clamping.image_curve(*_image_averages(c, 2.0 ** np.arange(-3, 11, 0.25))), N)
    law = Exponential()
    exact = np.geomspace(100.0, 1000.0, 2000)
    error = [np.mean(scale**2 * _exact_mse(law, t / scale, N)) for t in exact]
    assert best.reliable and best.threshold == pytest.approx(exact[np.argmin(error)], rel=0.05)
    assert best.mse == pytest.approx(min(error), rel=0.1)
    assert best.bias == pytest.approx(np.mean(scale * law.clamp_bias(best.threshold / scale)), rel=0.2)
    pooled = clamping.optimal_threshold(clamping.clamp_curve(_histogram(c.ravel())), N).threshold
    assert np.mean(scale**2 * _exact_mse(law, pooled / scale, N)) > 1.02 * min(error)


def test_image_optimum_of_equal_pixels_is_that_of_one():
    law, N = Exponential(), 16
    curve = clamping.image_curve(*_image_averages(_draw(law, 200_000).reshape(-1, 4)))
    best = clamping.image_optimum(curve, N)
    assert best.threshold == pytest.approx(law.optimal_threshold(N), rel=0.05)
    assert best.mse == pytest.approx(_exact_mse(law, best.threshold, N), rel=0.05)
    short = clamping.ImageClampCurve(*(x[:5] for x in curve[:4]), *curve[4:])
    assert not clamping.image_optimum(short, N).reliable


def test_image_curve_rejects_impossible_input():
    good = list(_image_averages(_draw(Exponential(), 60).reshape(20, 3)))
    bad = [(5, THRESHOLDS[::-1]), (5, THRESHOLDS - 0.125), (1, good[1][:, :2]), (1, good[1] * 20), (6, 1)]
    for position, value in bad:
        with pytest.raises(ValueError, match=r"expected|add up"):
            clamping.image_curve(*good[:position], value, *good[position + 1 :])
