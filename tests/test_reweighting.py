"""Layers of brightness resolved to images: against loops over pixels, and exact sums over hits."""

import itertools

import numpy as np
import pytest
from scipy import stats

from jaxmc.analysis import reweighting
from jaxmc.integration.layers import CascadeSums, LayerSums
from jaxmc.testing import Mix

HEIGHT, WIDTH, N = 5, 7, 40
RANDOM = np.random.default_rng(3)
SAMPLES = np.exp(RANDOM.normal(-0.5, 1.6, (N, HEIGHT * WIDTH, 3)))
SAMPLES[RANDOM.random(SAMPLES.shape[:2]) < 0.02] *= 300.0


def cascade_of(samples, base=8.0, start=1.0, layers=6):
    """Return the cascade of samples (n, pixels, 3), by the mean of the channels, as interpolation in 1 / L."""
    light = samples.mean(-1)
    inverse = 1.0 / (start * base ** np.arange(layers))
    weights = np.zeros((layers + 1, *light.shape))
    for i in range(layers):
        # np.interp wants increasing abscissae: 1 / L falls.
        peak = np.zeros(layers)
        peak[i] = 1.0
        weights[i] = np.interp(1.0 / light, inverse[::-1], peak[::-1])
    top = light > 1.0 / inverse[-1]
    weights[-2] = np.where(top, 1.0 / (inverse[-1] * light), weights[-2])
    weights[-1] = 1.0 - weights[:-1].sum(0)
    soft = (weights[:-1] * light).sum(1) * inverse[:, None]
    return CascadeSums(base, start, len(samples), np.einsum("lnp,npc->lpc", weights, samples) / len(samples), soft)


def neighbours(pixel):
    row, column = divmod(pixel, WIDTH)
    for r, c in itertools.product((row - 1, row, row + 1), (column - 1, column, column + 1)):
        if 0 <= r < HEIGHT and 0 <= c < WIDTH:
            yield r * WIDTH + c


def count_at(soft, i, pixel):
    return sum(soft[j, pixel] for j in (i - 1, i, i + 1) if 0 <= j < len(soft))


def resolve_pixel(sums, pixel, rule, kappa):
    """Return one pixel, as the rules are written."""
    n, result = sums.n, np.zeros(3)
    for i in range(len(sums.soft_count)):
        b = sums.start * sums.base**i
        local = count_at(sums.soft_count, i, pixel)
        around = np.mean([count_at(sums.soft_count, i, p) for p in neighbours(pixel)])
        if rule == "paper":
            weight = 0.0
            if around > 1.0:
                weight = max(np.clip((local - 1.0) / kappa, 0, 1), np.clip(result.mean() * n / (b * kappa), 0, 1))
        else:
            r = (around - 1.0) / kappa
            if r >= 0.0:
                r = (local - 1.0) / kappa
            q = max(result.mean(), 0.05) * n / (kappa * b)
            q *= np.interp(min(1.0, 1.0 / kappa), [0.0, 1.0], [1.0 + 0.6 * (sums.base - 1.0), 1.0])
            weight = np.clip(0.5 * (r + q), 0.0, 1.0)
        result = result + weight * sums.value[i, pixel]
    return result


@pytest.mark.parametrize("kappa", [0.5, 1.0, 5.0, 32.0])
@pytest.mark.parametrize("rule", ["paper", "glsl2020"])
def test_cascades_resolve_as_the_rules_are_written(rule, kappa):
    sums = cascade_of(SAMPLES)
    assert np.allclose(sums.value.sum(0), SAMPLES.mean(0))
    got = reweighting.resolve_cascade(sums, rule=rule, kappa=kappa, width=WIDTH)
    want = [resolve_pixel(sums, pixel, rule, kappa) for pixel in range(HEIGHT * WIDTH)]
    assert got.shape == (HEIGHT * WIDTH, 3) and np.allclose(got, want, rtol=1e-12)
    alone = reweighting.resolve_cascade(sums, rule=rule, kappa=kappa)
    assert not np.allclose(alone, got)
    one = CascadeSums(sums.base, sums.start, N, sums.value[:, 4:5], sums.soft_count[:, 4:5])
    assert np.allclose(reweighting.resolve_cascade(one, rule=rule, kappa=kappa, width=1), alone[4])


def test_many_samples_give_the_mean_and_few_a_darker_image():
    sums = cascade_of(SAMPLES)
    mean = SAMPLES.mean(0)
    many = sums._replace(n=N * 10**6, soft_count=sums.soft_count * 10**6)
    for rule in ("paper", "glsl2020"):
        assert np.allclose(reweighting.resolve_cascade(many, rule=rule, kappa=5.0, width=WIDTH), mean, rtol=1e-6)
        images = [reweighting.resolve_cascade(sums, rule=rule, kappa=k, width=WIDTH).mean() for k in (1.0, 4.0, 64.0)]
        assert mean.mean() > images[0] > images[1] > images[2]


def test_a_lone_firefly_is_no_more_than_one_whatever_the_rounding():
    # Its soft counts add up to 1 exactly, and only more than 1 is believed.
    light = RANDOM.uniform(2.0, 3e4, 500)
    samples = np.concatenate([np.broadcast_to(light[None, :, None], (1, 500, 3)), np.full((99, 500, 3), 0.9)])
    for dtype in (np.float32, np.float64):
        sums = cascade_of(samples.astype(dtype))
        got = reweighting.resolve_cascade(sums, rule="paper", kappa=1.0)
        # Below 64 the calm samples of the lowest layer vouch for it.
        assert np.allclose(got[light > 64.0], 0.9 * 99 / 100, rtol=1e-3)
        assert (got[light < 8.0] > 0.9).all()


# D1 as the exact sum over its hits: the hits' share of each layer is known, and the dim samples are all in the lowest.

FIREFLY = Mix(1e-3, 500.0)
DRAWS, PIXELS = 20_000, 30_000
ZIRR = {  # N: (bias, MSE), measured on some 30,000 pixels, by the viewer's rule and the paper's, for kappa 1 and 32
    16: ((-0.49, 0.40), (-0.49, 0.83), (-0.91, 0.83), (-0.89, 0.79)),
    128: ((-0.44, 0.37), (-0.44, 0.65), (-0.494, 0.245), (-0.498, 0.249)),
    1024: ((-0.089, 0.269), (-0.18, 0.34), (-0.451, 0.207), (-0.484, 0.236)),
    8192: ((0.0, 0.031), (0.0, 0.031), (-0.115, 0.038), (-0.353, 0.131)),
}
EXACT = {  # the same by this sum
    16: ((-0.4924, 0.3725), (-0.4926, 0.7140), (-0.9118, 0.8319), (-0.8875, 0.7893)),
    128: ((-0.4363, 0.3774), (-0.4403, 0.6712), (-0.4940, 0.2451), (-0.4980, 0.2492)),
    1024: ((-0.0898, 0.2669), (-0.1797, 0.3354), (-0.4514, 0.2070), (-0.4838, 0.2356)),
    8192: ((0.0, 0.0304), (-0.0001, 0.0306), (-0.1179, 0.0383), (-0.3545, 0.1322)),
}
RULES = [("glsl2020", 1.0), ("paper", 1.0), ("glsl2020", 32.0), ("paper", 32.0)]


def rare_bright_paths(N, m, rng):
    """Return the cascade of pixels of ``N`` samples of which ``m`` are hits of 500."""
    normal = 0.5 * (N - m) + rng.normal(size=DRAWS // 2) * np.sqrt((N - m) / 12.0)
    half = rng.random((N - m, DRAWS // 2)).sum(0) if N < 1000 else normal
    dim = np.concatenate([half, (N - m) - half])
    lower = (64.0 / 500.0 - 1.0 / 8.0) / (1.0 - 1.0 / 8.0)
    sums = np.zeros((7, DRAWS))
    sums[0], sums[2], sums[3] = dim, lower * 500.0 * m, (1.0 - lower) * 500.0 * m
    return CascadeSums(8.0, 1.0, N, sums / N, sums[:-1] / 8.0 ** np.arange(6)[:, None])


@pytest.mark.parametrize("N", ZIRR)
def test_cascades_of_rare_bright_paths(N):
    for (rule, kappa), measured, digits in zip(RULES, ZIRR[N], EXACT[N], strict=True):
        rng, powers = np.random.default_rng(N), np.zeros(3)
        for m in range(min(N, int(stats.binom.isf(1e-13, N, FIREFLY.p)) + 2) + 1):
            image = reweighting.resolve_cascade(rare_bright_paths(N, m, rng), rule=rule, kappa=kappa)
            error = image - FIREFLY.mean
            powers += stats.binom.pmf(m, N, FIREFLY.p) * np.array([np.mean(error**q) for q in (1, 2, 4)])
        first, second, fourth = powers
        assert (first, second) == pytest.approx(digits, abs=2e-4)
        errors = np.sqrt([(second - first**2) / PIXELS, (fourth - second**2) / PIXELS])
        rounding = [0.5 * 10.0 ** -len(f"{x}".partition(".")[2]) for x in measured]
        assert (np.abs(np.subtract([first, second], measured)) < 4.0 * errors + rounding).all()


@pytest.mark.parametrize(
    ("options", "match"), [({"rule": "best"}, "rule"), ({"kappa": 0.0}, "kappa"), ({"width": 6}, "divide")]
)
def test_impossible_cascades_are_refused(options, match):
    with pytest.raises(ValueError, match=match):
        reweighting.resolve_cascade(cascade_of(SAMPLES), **options)


# Rejection of samples that stand alone.

EDGES = np.expm1(np.arange(10))


def layers_of(samples, edges=EDGES):
    light = samples.mean(-1)
    inside = np.searchsorted(edges, light, side="right")[None] - 1 == np.arange(len(edges))[:, None, None]
    value = np.einsum("bnp,npc->bpc", inside, samples) / len(samples)
    return LayerSums(edges, len(samples), inside.sum(1), (inside * light).sum(1), value)


@pytest.mark.parametrize(("k", "tile"), [(1, 1), (2, 1), (9, 3), (40, 2)])
def test_samples_that_stand_alone_are_rejected(k, tile):
    got = reweighting.reject_sparse(layers_of(SAMPLES), k=k, width=WIDTH, tile=tile)
    cell = np.searchsorted(EDGES, SAMPLES.mean(-1), side="right") - 1
    row, column = np.divmod(np.arange(HEIGHT * WIDTH), WIDTH)
    alone = 0
    for pixel in range(HEIGHT * WIDTH):
        near = np.abs(row // tile - row[pixel] // tile) <= 1
        near &= np.abs(column // tile - column[pixel] // tile) <= 1
        keep = [(np.abs(cell[:, near] - cell[s, pixel]) <= 1).sum() >= k + 1 for s in range(N)]
        alone += N - sum(keep)
        samples = SAMPLES[:, pixel]
        assert np.allclose(got.mean[pixel], samples[keep].mean(0), rtol=1e-12)
        assert got.kept[pixel] == pytest.approx(np.mean(keep))
        assert np.allclose(got.lost[pixel], samples[~np.array(keep)].sum(0) / N, atol=1e-12)
    assert alone > 0


def test_pixels_that_stand_alone_know_no_neighbours():
    sums = layers_of(SAMPLES)
    got = reweighting.reject_sparse(sums, k=3)
    for pixel in (0, 17):
        one = LayerSums(EDGES, N, *(x[:, pixel : pixel + 1] for x in sums[2:]))
        assert np.allclose(got.mean[pixel], reweighting.reject_sparse(one, k=3, width=1).mean)
    assert (got.kept <= reweighting.reject_sparse(sums, k=3, width=WIDTH).kept).all() and got.kept.min() < 1.0


def test_rejection_is_order_free_mergeable_and_never_divides_by_nothing():
    first, second = layers_of(SAMPLES[:25]), layers_of(SAMPLES[25:])
    count, total = first.count + second.count, first.total + second.total
    both = LayerSums(EDGES, N, count, total, (25 * first.value + 15 * second.value) / N)
    for a, b in zip(
        reweighting.reject_sparse(both, width=WIDTH), reweighting.reject_sparse(layers_of(SAMPLES), width=WIDTH)
    ):
        assert np.allclose(a, b, rtol=1e-12)
    none = reweighting.reject_sparse(both, k=10**6, width=WIDTH)
    assert (none.mean == 0.0).all() and (none.kept == 0.0).all() and np.allclose(none.lost, SAMPLES.mean(0))


def test_rejection_of_rare_bright_paths_is_biased_low_until_fireflies_come_in_pairs():
    light = FIREFLY.sample(np.random.default_rng(4).random((1, 64, 20_000)))
    got = reweighting.reject_sparse(layers_of(light[..., None]), k=1)
    hits = (light == 500.0).sum(0)
    # One hit is rejected, two are kept: the mean is over the others, or over all.
    lone = hits == 1
    assert lone.sum() > 500 and np.allclose(got.kept[lone], 63 / 64) and np.allclose(got.kept[~lone], 1.0)
    dim = np.where(light < 500.0, light, 0.0).sum(0)
    assert np.allclose(got.mean[lone, 0], dim[lone] / 63) and np.allclose(got.lost[lone, 0], 500 / 64)
    assert np.allclose(got.mean[~lone, 0], light.mean(0)[~lone])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"k": 0}, "k >= 1"),
        ({"tile": 0}, "tile"),
        ({"width": 6}, "divide"),
        ({"tile": 2}, "width"),
        ({"width": 0}, "divide"),
    ],
)
def test_impossible_rejections_are_refused(options, match):
    with pytest.raises(ValueError, match=match):
        reweighting.reject_sparse(layers_of(SAMPLES), **options)
