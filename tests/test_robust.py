"""Means that give up rare bright samples: against brute force, against laws, against exact sums over the hits."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from jaxmc.analysis import robust
from jaxmc.integration.buckets import BucketMeans
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto

M = 11


def bucket_means(samples, count=M):
    """Put sample s, on the first axis, into bucket s mod ``count``."""
    parts = [samples[k::count] for k in range(count)]
    size = np.array([len(part) for part in parts])
    mean = np.stack([part.mean(0) if len(part) else np.full(samples.shape[1:], np.nan) for part in parts])
    items = samples.shape[1:2]
    return BucketMeans(np.broadcast_to(size.reshape(-1, *[1] * len(items)), (count, *items)), mean)


def draw(law, *shape, seed=1):
    return law.sample(np.random.default_rng(seed).random((law.dim, *shape)))


# Medians of means.

RGB = draw(Pareto(1.05), 100, 40, 3)


def gini_by_pairs(x):
    """Return the Gini coefficient as half the relative mean absolute difference."""
    x = np.asarray(x)
    return np.abs(x[:, None] - x[None]).sum() / (2.0 * len(x) * x.sum())


def test_median_and_gini_by_hand():
    buckets = bucket_means(RGB)
    assert np.array_equal(robust.median_of_means(buckets), np.median(buckets.mean, axis=0))
    gini = [[gini_by_pairs(buckets.mean[:, i, c]) for c in range(3)] for i in range(40)]
    assert np.allclose(robust.bucket_gini(buckets), np.mean(gini, axis=1), rtol=1e-12)
    assert robust.bucket_gini(buckets).min() < 0.4 and robust.bucket_gini(buckets).max() > 0.6


def test_gini_of_extremes():
    def gini(x):
        x = np.asarray(x, float)
        return robust.bucket_gini(BucketMeans(np.ones(len(x), int), x))

    assert gini([3.0] * 11) == pytest.approx(0.0, abs=1e-15)
    assert gini([0.0] * 11) == 0.0
    assert gini([0.0] * 10 + [7.0]) == pytest.approx(10 / 11)
    assert gini([1.0, 3.0, 5.0]) == pytest.approx(gini_by_pairs([1.0, 3.0, 5.0]))


def test_adaptive_form_drops_as_many_as_the_gini_says():
    buckets = bucket_means(RGB)
    got, gini = robust.gini_median_of_means(buckets), robust.bucket_gini(buckets)
    dropped = np.floor(gini * 5).astype(int)
    assert {1, 2, 3} <= set(dropped.tolist())
    for i, c in itertools.product(range(40), range(3)):
        order = np.argsort(buckets.mean[:, i, c])[dropped[i] : M - dropped[i]]
        kept = np.concatenate([RGB[k::M, i, c] for k in order])
        assert got[i, c] == pytest.approx(kept.mean(), rel=1e-12)


def test_binary_form_is_one_or_the_other():
    buckets = bucket_means(RGB)
    got, calm = robust.gini_median_of_means(buckets, "binary"), robust.bucket_gini(buckets) <= 0.25
    assert 0 < calm.sum() < 40
    assert np.allclose(got[calm], RGB.mean(0)[calm]) and np.allclose(got[~calm], np.median(buckets.mean, 0)[~calm])
    with pytest.raises(ValueError, match="binary"):
        robust.gini_median_of_means(buckets, "trinary")


def test_calm_samples_give_the_plain_mean():
    samples = draw(Exponential(), 5003)
    buckets = bucket_means(samples)
    assert robust.gini_median_of_means(buckets) == pytest.approx(samples.mean(), rel=1e-12)
    assert robust.gini_median_of_means(buckets, "binary") == pytest.approx(samples.mean(), rel=1e-12)


def test_empty_buckets_are_left_out_and_bad_samples_are_not():
    samples = draw(Pareto(2.0), 6, 9)
    few = bucket_means(samples)
    assert (few.count[6:] == 0).all()
    assert np.allclose(robust.median_of_means(few), np.median(samples, axis=0))
    assert np.allclose(robust.bucket_gini(few), [gini_by_pairs(samples[:, i]) for i in range(9)])
    assert np.isfinite(robust.gini_median_of_means(few)).all()
    for bad in (np.nan, np.inf):
        spoilt = np.concatenate([samples] * 5)
        spoilt[3, 4] = bad
        for mean in (robust.median_of_means, robust.gini_median_of_means):
            assert np.isnan(mean(bucket_means(spoilt))).tolist() == [False] * 4 + [True] + [False] * 4


def median_bias(law, size):
    """Return E median of 11 means of ``size`` samples, less the mean, for Exponential: sums are Gamma."""
    middle = stats.beta(6, 6)
    return integrate.quad(lambda u: law.ppf(u) * middle.pdf(u), 0.0, 1.0, limit=200)[0] / size - 1.0


def test_skewed_samples_make_the_median_of_means_low():
    exact = median_bias(stats.gamma(16), 16)
    assert exact == pytest.approx(-0.0177, abs=5e-4)
    assert -2.0 * M / (6.0 * 1.0 * 16 * M) == pytest.approx(-0.0208, abs=5e-5)
    # The first order is the limit of large buckets.
    assert median_bias(stats.gamma(1000), 1000) * -3000 == pytest.approx(1.0, abs=0.15)
    got = robust.median_of_means(bucket_means(draw(Exponential(), 16 * M, 20_000))) - 1.0
    assert abs(got.mean() - exact) < 5.0 * got.std() / np.sqrt(20_000) < 0.004


def test_median_of_means_keeps_its_promise():
    # 8 ln(1/delta) buckets: 25 for delta = 0.05.
    law, n, delta = LogNormal(0.0, 1.5), 500, 0.05
    buckets = bucket_means(draw(law, n, 2000), 25)
    off = np.abs(robust.median_of_means(buckets) - law.mean)
    assert (off > np.sqrt(32.0 * law.variance * np.log(1.0 / delta) / n)).mean() < delta


# The rare bright path, D1: exact sums over the number of hits m, given which only calm numbers are random.

FIREFLY = Mix(1e-3, 500.0)
DRAWS = 4000


def over_hits(N, estimate):
    """Return mean, mean square and mean fourth power of the error of ``estimate(m, rng)``, shape (DRAWS,)."""
    rng = np.random.default_rng(N)
    powers = np.zeros(3)
    for m in range(min(N, int(stats.binom.isf(1e-13, N, FIREFLY.p)) + 2) + 1):
        error = estimate(m, rng) - FIREFLY.mean
        powers += stats.binom.pmf(m, N, FIREFLY.p) * np.array([np.mean(error**q) for q in (1, 2, 4)])
    return powers


def dim_mean(rng, size):
    """Draw means of ``size`` uniform numbers, in pairs that mirror each other; shape (draws, ...)."""
    size = np.broadcast_to(size, (DRAWS, *np.shape(size)[1:]))[: DRAWS // 2]
    normal = 0.5 + rng.normal(size=size.shape) / np.sqrt(12.0 * np.maximum(size, 1))
    few = rng.random((16, *size.shape)).cumsum(0)
    exact = np.take_along_axis(few, np.clip(size - 1, 0, 15)[None], 0)[0] / np.maximum(size, 1)
    mean = np.where(size <= 16, exact, normal)
    return np.concatenate([mean, 1.0 - mean])


def of_buckets(mean, N):
    def estimate(m, rng):
        sizes = np.array([len(range(k, N, M)) for k in range(M)])
        hits = np.tile(rng.multivariate_hypergeometric(sizes, m, size=DRAWS // 2), (2, 1))
        dim = np.where(hits < sizes, dim_mean(rng, sizes - hits), 0.0)
        # The second half of the draws has the hits of the first.
        means = (hits * FIREFLY.A + (sizes - hits) * dim) / sizes
        return mean(BucketMeans(np.broadcast_to(sizes[:, None], (M, DRAWS)), means.T))

    return estimate


# N: (bias, MSE) of the median of means and of the adaptive form, as measured on some 30,000 pixels.
BUCKET_TABLE = {
    16: ((-0.499, 0.258), (-0.499, 0.255)),
    128: ((-0.498, 0.249), (-0.498, 0.249)),
    1024: ((-0.495, 0.249), (-0.437, 0.253)),
    8192: ((-0.11, 0.12), (-0.058, 0.036)),
}
PIXELS = 30_000


def agrees(exact, measured, digits=3):
    """Whether bias and MSE measured on so many pixels, and rounded, fit exact moments of the error."""
    first, second, fourth = exact
    errors = np.sqrt([(second - first**2) / PIXELS, (fourth - second**2) / PIXELS])
    rounding = [0.5 * 10.0 ** -len(f"{x}".partition(".")[2]) for x in measured]
    return np.abs(np.subtract([first, second], measured)) < 4.0 * errors + rounding


@pytest.mark.parametrize("N", BUCKET_TABLE)
def test_medians_of_means_of_rare_bright_paths(N):
    for mean, measured in zip((robust.median_of_means, robust.gini_median_of_means), BUCKET_TABLE[N]):
        exact = over_hits(N, of_buckets(mean, N))
        assert agrees(exact, measured).all(), (exact, measured)
        # The same from samples of 4000 pixels.
        if N <= 1024:
            error = mean(bucket_means(draw(FIREFLY, N, 4000, seed=N))) - FIREFLY.mean
            spread = np.sqrt([(exact[1] - exact[0] ** 2) / 4000, (exact[2] - exact[1] ** 2) / 4000])
            assert (np.abs([error.mean() - exact[0], (error**2).mean() - exact[1]]) < 5.0 * spread + 1e-4).all()


CLAMP_TABLE = {16: (-0.49, 0.249), 128: (-0.444, 0.222), 1024: (-0.246, 0.124), 8192: (-0.051, 0.027)}


@pytest.mark.parametrize("N", CLAMP_TABLE)
def test_clamped_means_of_rare_bright_paths(N):
    t = FIREFLY.optimal_threshold(N)
    exact = over_hits(N, lambda m, rng: (m * t + (N - m) * dim_mean(rng, N - m)) / N)
    lost = FIREFLY.clamp_bias(t)
    mse = lost**2 + (FIREFLY.clamped_square(t) - (FIREFLY.mean - lost) ** 2) / N
    assert exact[:2] == pytest.approx([-lost, mse], rel=2e-3)
    assert agrees(exact, CLAMP_TABLE[N]).all()
    assert FIREFLY.variance / N == pytest.approx({16: 15.6, 128: 1.95, 1024: 0.2435, 8192: 0.0304}[N], rel=2e-3)


def test_a_median_of_means_sees_fireflies_late():
    assert M * math.log(2.0) / FIREFLY.p == pytest.approx(7620, abs=5)
    for N, exact in [(1024, 1.5e-4), (4096, 0.091), (8192, 0.568), (16_384, 0.979)]:
        hit = 1.0 - (1.0 - FIREFLY.p) ** (N / M)
        assert stats.binom.sf(M // 2, M, hit) == pytest.approx(exact, abs=0.5 * 10.0 ** (-5 if exact < 1e-3 else -3))
    # A median that holds a hit is above 0.5 + 500 M/N - noise.
    got = over_hits(8192, lambda m, rng: FIREFLY.mean + (of_buckets(robust.median_of_means, 8192)(m, rng) > 0.8))
    assert got[0] == pytest.approx(0.568, abs=0.005)


# Trimmed, winsorised and Catoni's means, of bins.


def in_bins(samples, edges):
    c = np.asarray(samples, float)
    j = np.searchsorted(edges, c, side="right") - 1
    count, total, square = (np.bincount(j, c**q, len(edges)) for q in range(3))
    return SimpleNamespace(edges=np.asarray(edges), count=count, total=total, square=square, n=c.size)


EDGES = np.concatenate([[0.0], 2.0 ** np.arange(-4, 12, 0.125)])


@pytest.mark.parametrize("fraction", [0.0, 0.001, 0.05, 0.5])
def test_trimmed_and_winsorised_means_equal_those_of_the_samples(fraction):
    c = draw(Pareto(1.5), 3000)
    bins = in_bins(c, EDGES)
    trimmed, winsorised = (f(bins, fraction) for f in (robust.trimmed_mean, robust.winsorised_mean))
    t = trimmed.threshold
    assert winsorised.threshold == t and trimmed.affected == winsorised.affected == (c >= t).sum()
    assert trimmed.mean == pytest.approx(c[c < t].mean(), rel=1e-12)
    assert winsorised.mean == pytest.approx(np.minimum(c, t).mean(), rel=1e-12)
    assert (c >= t).sum() <= fraction * 3000
    if fraction:
        # One edge lower would be too many.
        assert (c >= EDGES[np.searchsorted(EDGES, t) - 1]).sum() > fraction * 3000
    else:
        assert t == np.inf and trimmed.mean == pytest.approx(c.mean())


def test_bins_of_many_pixels_are_cut_one_by_one():
    c = draw(Pareto(1.5), 300, 20)
    each = [in_bins(c[:, i], EDGES) for i in range(20)]
    count, total = (np.stack([getattr(b, name) for b in each], 1) for name in ("count", "total"))
    every = SimpleNamespace(edges=EDGES, count=count, total=total)
    for mean in (robust.trimmed_mean, robust.winsorised_mean):
        got = mean(every, 0.02)
        for i, bins in enumerate(each):
            assert [x[i] for x in got] == pytest.approx(list(mean(bins, 0.02)), rel=1e-12)
    variance = c.var(0, ddof=1)
    got = robust.catoni_mean(every, variance=variance)
    assert got == pytest.approx([robust.catoni_mean(b, variance=v) for b, v in zip(each, variance)], rel=1e-10)


def test_all_cut_means_are_low_on_a_one_sided_tail():
    law, n = LogNormal(0.0, 2.0), 200
    for mean in (
        lambda b: robust.trimmed_mean(b, 0.02).mean,
        lambda b: robust.winsorised_mean(b, 0.02).mean,
        lambda b: robust.catoni_mean(b, 1e-4),
    ):
        got = np.array([mean(in_bins(draw(law, n, seed=s), EDGES)) for s in range(500)])
        error = got.std() / np.sqrt(len(got))
        assert got.mean() + 5.0 * error < law.mean and got.var() < 0.5 * law.variance / n


def psi(x):
    return np.sign(x) * np.log1p(np.abs(x) + 0.5 * x * x)


def test_catonis_mean_is_the_root_of_its_equation():
    c, delta = draw(LogNormal(0.0, 1.0), 400), 0.05
    n, L = 400, math.log(20.0)
    v = c.var(ddof=1)
    a = math.sqrt(2 * L / (n * v * (1 + 2 * L / (n - 2 * L))))
    # Bins so fine that each holds one sample at most.
    exact = in_bins(c, np.concatenate([[0.0], np.sort(c)]))
    m = robust.catoni_mean(exact, delta)
    assert psi(a * (c - m)).sum() == pytest.approx(0.0, abs=1e-9)
    assert robust.catoni_mean(exact, delta, variance=v) == pytest.approx(m, rel=1e-12)
    assert robust.catoni_mean(in_bins(c, EDGES), delta) == pytest.approx(m, rel=2e-4)
    assert robust.catoni_mean(in_bins(np.full(50, 0.3), EDGES)) == pytest.approx(0.3)


def test_catonis_mean_keeps_its_promise_and_has_the_bias_it_says():
    law, n, delta = LogNormal(0.0, 1.0), 200, 0.05
    L = math.log(1.0 / delta)
    got = [robust.catoni_mean(in_bins(draw(law, n, seed=s), EDGES), delta, variance=law.variance) for s in range(1000)]
    bound = math.sqrt(2.0 * law.variance * L / (n - 2.0 * L))
    assert (np.abs(np.array(got) - law.mean) > bound).mean() < 2.0 * delta
    # Of the exponential law itself, in many small bins as if seen without noise.
    x = -np.log1p(-(np.arange(200_000) + 0.5) / 200_000)
    bins = in_bins(x, np.arange(0.0, 14.0, 0.002))
    n = 100_000.0
    bins = SimpleNamespace(edges=bins.edges, count=bins.count * n / 200_000, total=bins.total * n / 200_000)
    a2 = 2 * L / (n * (1 + 2 * L / (n - 2 * L)))
    low = bins.total.sum() / n - robust.catoni_mean(bins, delta, variance=1.0)
    assert low == pytest.approx(a2 * 2.0 / 6.0, rel=0.05)


def test_bins_that_cannot_be_cut_are_refused():
    bins = in_bins(draw(Exponential(), 5), EDGES)
    for fraction in (-0.1, 1.0, math.nan):
        with pytest.raises(ValueError, match="fraction"):
            robust.trimmed_mean(bins, fraction)
    for delta in (0.0, 1.0):
        with pytest.raises(ValueError, match="delta"):
            robust.catoni_mean(bins, delta)
    with pytest.raises(ValueError, match="more than"):
        robust.catoni_mean(bins, 0.05)
