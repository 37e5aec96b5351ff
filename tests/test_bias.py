"""Welch's test of tiles, corrections for many tests, and metrics, against SciPy, known laws and rejections."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from jaxmc.analysis import bias, convergence, metrics

P, A = 1e-3, 500.0


def welch_samples(rng, tile, shape):
    """Draw sums over ``tile`` pixels of samples that are 500 with probability 0.001, else uniform on [0, 1)."""
    hits = rng.binomial(tile, P, shape)
    # The sum of many uniform numbers is normal to 1e-3 of a standard deviation.
    calm = rng.random(shape) if tile == 1 else rng.normal((tile - hits) / 2, np.sqrt((tile - hits) / 12))
    return np.where(hits == 1, A, calm) if tile == 1 else hits * A + calm


def false_positives(tile, n, runs, seed=1):
    rng, rejected = np.random.default_rng(seed), 0
    for _ in range(runs // 1000):
        a, b = (welch_samples(rng, tile, (1000, n)) for _ in range(2))
        test = bias.welch_test(a.mean(1), a.var(1, ddof=1), n, b.mean(1), b.var(1, ddof=1), n)
        rejected += int((test.p <= 0.05).sum())
    return rejected / runs


# Pixels in a tile, samples, false positives at 5 % as they were measured from some 2000 runs.
RATES = [(1, 64, 0.0435), (64, 16, 0.013), (64, 64, 0.045), (1024, 16, 0.047), (1024, 64, 0.050)]


@pytest.mark.parametrize(("tile", "n", "expected"), RATES)
def test_rare_fireflies_make_the_test_conservative(tile, n, expected):
    found = false_positives(tile, n, 8000)
    stderr = np.sqrt(expected * (1 - expected) * (1 / 8000 + 1 / 2000))
    assert abs(found - expected) <= 3.0 * stderr
    assert found <= 0.056 and (found < 0.025) == (tile == 64 and n == 16)


def test_welch_is_that_of_scipy():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 1, (40, 7)), rng.normal(0.3, 3, (40, 12))
    found = bias.welch_test(a.mean(1), a.var(1, ddof=1), 7, b.mean(1), b.var(1, ddof=1), 12)
    expected = stats.ttest_ind(a, b, axis=1, equal_var=False)
    assert np.allclose(found.t, expected.statistic) and np.allclose(found.p, expected.pvalue)
    assert np.allclose(found.dof, expected.df)


def test_values_that_do_not_vary():
    found = bias.welch_test(np.array([1.0, 1.0]), np.zeros(2), 5, np.array([1.0, 2.0]), np.zeros(2), 5)
    assert list(found.p) == [1.0, 0.0]
    with pytest.raises(ValueError, match="two samples"):
        bias.welch_test(1.0, 1.0, 1, 1.0, 1.0, 5)


def image(rng, n, shift=0.0, shape=(64, 96), channels=None):
    """Return moments of an image of exponential samples."""
    full = shape if channels is None else (*shape, channels)
    x = rng.exponential(1.0, (n, *full)) + shift
    return SimpleNamespace(mean=x.mean(0), variance=x.var(0, ddof=1), n=n)


def test_p_values_of_unbiased_tiles_are_uniform():
    rng = np.random.default_rng(5)
    p = np.concatenate([bias.compare_tiles(image(rng, 8), image(rng, 12), tile=16).p.ravel() for _ in range(10)])
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert abs((p <= 0.05).mean() - 0.05) <= 4.0 * np.sqrt(0.05 * 0.95 / p.size)


def test_biased_tiles_are_found_and_no_others():
    rng = np.random.default_rng(6)
    shift = np.zeros((64, 96))
    shift[:32, 32:64] = 0.2
    a, b = image(rng, 16), image(rng, 16, shift)
    test = bias.compare_tiles(a, b)
    assert test.p.shape == (2, 3) and np.array_equal(np.argwhere(test.rejected()), [[0, 1]])
    assert test.difference[0, 1] == pytest.approx(-0.2, abs=0.05)
    assert test.histogram()[0].sum() == 6
    # A bias too small for each tile shows in all p-values together.
    everywhere = bias.compare_tiles(image(rng, 16), image(rng, 16, 0.05), tile=8)
    assert everywhere.uniformity < 1e-4 and not everywhere.rejected().all()
    assert "1 of 6 tiles differ" in test.explain() and "not known" in test.explain()
    colored = bias.compare_tiles(image(rng, 4, channels=3), image(rng, 4, channels=3), tile=50)
    assert colored.p.shape == (2, 2, 3) and "no tile of 12" in colored.explain()


def test_whether_a_tile_holds_a_firefly():
    rng = np.random.default_rng(7)
    rate = np.full((64, 96), 5e-4)
    rate[32:] = 2e-3
    rate[:32, :32] = 0.0
    test = bias.compare_tiles(image(rng, 4), image(rng, 4), firefly_rate=rate)
    assert np.array_equal(test.valid, [[True, False, False], [True, True, True]])
    assert test.expected[1, 0] == pytest.approx(2.048) == bias.expected_fireflies(2e-3)
    assert "67%" in test.explain()


def test_images_that_do_not_fit_are_refused():
    rng = np.random.default_rng(8)
    with pytest.raises(ValueError, match="one shape"):
        bias.compare_tiles(image(rng, 4), image(rng, 4, shape=(8, 8)))
    with pytest.raises(ValueError, match="two samples"):
        bias.compare_tiles(
            SimpleNamespace(mean=np.ones((8, 8)), variance=np.ones((8, 8)), n=1), image(rng, 4, shape=(8, 8))
        )
    filtered = image(rng, 4)
    filtered.ratio = True
    with pytest.raises(ValueError, match="filter"):
        bias.compare_tiles(filtered, image(rng, 4))


def test_holm_and_sidak():
    p = np.array([[0.01, 0.04], [0.03, 0.005]])
    assert np.allclose(bias.holm(p), [[0.03, 0.06], [0.06, 0.02]])
    assert np.allclose(bias.sidak(p), 1 - (1 - p) ** 4) and np.all(bias.sidak(np.array([1.0, 0.0])) == [1.0, 0.0])
    rng = np.random.default_rng(9)
    families = rng.random((4000, 50))
    for adjust in (bias.holm, bias.sidak):
        wrong = np.mean([(adjust(p) <= 0.05).any() for p in families])
        assert abs(wrong - 0.0494) <= 4.0 * np.sqrt(0.05 * 0.95 / 4000)


# ---------------------------------------------------------------------------------------------------------- metrics


def test_metrics_are_their_formulas():
    x, r = np.array([1.0, 2.0, 0.0, 4.0]), np.array([1.0, 1.0, 0.1, 0.0])
    assert metrics.mse(x, r) == pytest.approx((0 + 1 + 0.01 + 16) / 4)
    assert metrics.relative_mse(x, r) == pytest.approx((0 + 1 / 1.01 + 0.01 / 0.02 + 16 / 0.01) / 4)
    pbrt = (0 + 1 / 1.01**2 + 0.01 / 0.11**2 + 16 / 0.01**2) / 4
    assert metrics.relative_mse(x, r, convention="pbrt") == pytest.approx(pbrt)
    assert metrics.smape(x, r) == pytest.approx((0 + 1 / 3.01 + 0.1 / 0.11 + 4 / 4.01) / 4)
    assert metrics.mse(x, r, trim=0.25) == pytest.approx((0 + 1 + 0.01) / 3)
    assert metrics.relative_mse(x, r, trim=0.5) == pytest.approx((0 + 0.01 / 0.02) / 2)
    assert metrics.relative_mse(np.array([np.inf, 2.0]), np.ones(2), convention="pbrt") == pytest.approx(1 / 1.01**2)
    assert convergence.relative_mse is metrics.relative_mse
    for wrong in ({"trim": 1.0}, {"trim": -0.1}, {"convention": "rel"}):
        with pytest.raises(ValueError, match=r"trim|convention"):
            metrics.relative_mse(x, r, **wrong)
    with pytest.raises(ValueError, match="one shape"):
        metrics.smape(x, r[:2])


def test_squared_bias_from_two_halves_is_unbiased():
    rng = np.random.default_rng(10)
    truth, off, noise, reference_noise = rng.random(20_000), 0.03, 0.5, 0.1
    reference = truth + rng.normal(0, reference_noise, truth.shape)
    halves = [truth + off + rng.normal(0, noise, truth.shape) for _ in range(2)]
    found = metrics.image_bias2(*halves, reference, reference_noise**2)
    assert found.stderr < 3e-3 and abs(found.value - off**2) <= 5.0 * found.stderr
    assert metrics.image_bias2(halves[0], halves[0], reference).value > 0.2  # one half twice: its variance counts
    assert abs(metrics.image_bias2(*halves, reference).value - off**2 - 0.01) <= 5.0 * found.stderr


def test_ratios_of_efficiency_cover_as_often_as_they_say():
    rng, rounds, covered, paired = np.random.default_rng(11), 600, 0, 0
    exact = (4.0 * 1.0) / (1.0 * 2.0)  # variance 1 in 2 s against variance 4 in 1 s
    for _ in range(rounds):
        x, y = rng.normal(0, 1, 400), rng.normal(0, 2, 400)
        ratio = metrics.efficiency_ratio(moments(x), 2.0, moments(y), 1.0)
        covered += ratio.interval.lower <= exact <= ratio.interval.upper
        blocks = x.reshape(10, 40).var(1, ddof=1), y.reshape(10, 40).var(1, ddof=1)
        both = metrics.paired_efficiency_ratio(blocks[0], np.full(10, 2.0), blocks[1], np.ones(10))
        paired += both.interval.lower <= exact <= both.interval.upper
    for count in (covered, paired):
        assert abs(count / rounds - 0.95) <= 4.0 * np.sqrt(0.95 * 0.05 / rounds)
    assert ratio.ratio == pytest.approx(2.0, rel=0.5) and metrics.efficiency(2.0, 5.0) == 0.1
    with pytest.raises(ValueError, match="shape"):
        metrics.paired_efficiency_ratio([1.0], [1.0], [1.0], [1.0])
    with pytest.raises(ValueError, match="positive"):
        metrics.paired_efficiency_ratio([1.0, 0.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0])


def moments(x):
    centered = x - x.mean()
    central = [(centered**k).mean() for k in (2, 3, 4)]
    return SimpleNamespace(n=x.size, variance=x.var(ddof=1), kurtosis=central[2] / central[0] ** 2)
