"""Tail statistics of every pixel, against brute force on the same samples, and how long fireflies are waited for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxmc as mc
from jaxmc.analysis import pixels, waits
from jaxmc.analysis.tails import pareto_khat
from jaxmc.integration.pixel_tails import _largest_of

WIDTH, HEIGHT, N = 12, 8, 150
TALLY = mc.PixelTails((0.5, 2.0, 8.0), largest=16)


def heavy(u, item):
    """Return a Pareto law with an exponent that grows from pixel to pixel; a few pixels are atoms, one is constant."""
    c = (1.0 - u[0]) ** (-1.0 / (1.2 + 0.05 * item))
    c = jnp.where(item % 7 == 3, jnp.where(u[0] < 0.05, 50.0, u[0]), c)
    return jnp.where(item == 0, 0.25, c)


@pytest.fixture(scope="module")
def family():
    """Return sums and samples, shape (pixels, N)."""
    f, count = mc.Integrand(heavy, 1), WIDTH * HEIGHT
    sums = mc.integrate_each(f, count, n=N, tallies={"tails": TALLY})["tails"]
    u = mc.draw(lambda u: u[0], dim=1, n=N * count).value
    return sums, np.asarray(heavy(jnp.asarray(u)[None], np.tile(np.arange(count), N)), np.float64).reshape(N, count).T


def test_sums_are_those_of_the_samples(family):
    sums, c = family
    m = sums.moments
    assert np.all(sums.n == N) and np.allclose(m.mean, c.mean(1), rtol=1e-6)
    assert np.allclose(m.variance, c.var(1, ddof=1), rtol=1e-4)
    for order, central in zip((3, 4), m.central[1:], strict=True):
        assert np.allclose(central, ((c - c.mean(1, keepdims=True)) ** order).mean(1), rtol=1e-3, atol=1e-12)
    assert np.allclose(sums.largest, -np.sort(-c, 1)[:, :16], rtol=1e-6, atol=0)
    for k, t in enumerate(sums.thresholds):
        above = np.where(c >= t, c, 0.0)
        assert np.array_equal(sums.count[k], (above > 0).sum(1))
        assert np.allclose(sums.total[k], above.sum(1), rtol=1e-5)
        assert np.allclose(sums.log_total[k], np.log(np.where(above > 0, c, 1.0)).sum(1), rtol=1e-4, atol=1e-5)


def test_images_of_the_tail(family):
    sums, c = family
    images = pixels.tail_images(sums, WIDTH, HEIGHT)

    def same(image, expected, rtol=1e-4):
        return np.allclose(image.reshape(-1)[1:], expected[1:], rtol=rtol)

    total, square = c.sum(1), (c**2).sum(1)
    with np.errstate(all="ignore"):
        assert same(images.effective_n, total**2 / square) and same(images.max_share, c.max(1) / total)
        assert same(images.max_square_share, c.max(1) ** 2 / square) and same(images.maximum, c.max(1))
        kurtosis = ((c - c.mean(1, keepdims=True)) ** 4).mean(1) / c.var(1) ** 2
        assert same(images.kurtosis, kurtosis, 1e-3) and images.kurtosis.shape == (HEIGHT, WIDTH)
        hill = np.array([np.log(row[row >= 2.0] / 2.0).mean() if (row >= 2.0).any() else np.nan for row in c])
    found = images.hill[1].reshape(-1)
    assert np.array_equal(np.isnan(found), np.isnan(hill))
    assert np.allclose(found, hill, rtol=1e-3, atol=1e-4, equal_nan=True)
    assert np.array_equal(images.rate[2].reshape(-1), (c >= 8.0).mean(1))
    assert np.isinf(images.wait[0, 0, 0]) and np.isnan(images.hill[0, 0, 0])
    with pytest.raises(ValueError, match="expected 5 x 5"):
        pixels.tail_images(sums, 5, 5)


def test_khat_of_rows_is_that_of_each_row(family):
    sums, _ = family
    rng = np.random.default_rng(0)
    ties = np.sort(np.round(rng.pareto(1.5, (40, 16)), 1))[:, ::-1]
    atoms = np.sort(np.where(rng.random((20, 16)) < 0.1, 7.0, rng.random((20, 16))))[:, ::-1]
    flat = np.sort(np.concatenate([np.ones((5, 12)), 2.0 + rng.random((5, 4))], 1))[:, ::-1]
    heavier = np.sort(rng.pareto(0.4, (20, 16)))[:, ::-1]
    seen = set()
    for largest, n in ((sums.largest, N), (ties, 1000), (atoms, 300), (flat, 16), (ties, 30), (heavier, 500)):
        khat, status = pixels.khat_rows(largest, np.full(len(largest), n))
        fits = [pareto_khat(row, n) for row in largest]
        assert [fit.status for fit in fits] == list(status)
        assert np.allclose(khat, [fit.khat for fit in fits], rtol=1e-9, equal_nan=True)
        seen.update(status)
    assert seen == {"atomic", "reliable", "unreliable", "no mean", "too few samples"}


def test_khat_of_tiles_pools_their_samples(family):
    sums, c = family
    fits = pixels.khat_tiles(sums, WIDTH, HEIGHT, tile=4)
    assert np.shape([[f.khat for f in row] for row in fits]) == (2, 3)
    tiles = c.reshape(HEIGHT, WIDTH, N)
    kinds = set()
    for y, row in enumerate(fits):
        for x, fit in enumerate(row):
            all_samples = tiles[4 * y : 4 * y + 4, 4 * x : 4 * x + 4].ravel()
            whole = pareto_khat(all_samples, all_samples.size)
            kinds.add(fit.status)
            if fit.status != "truncated":
                assert fit.status == whole.status and np.allclose(fit.khat, whole.khat, rtol=1e-9, equal_nan=True)
    assert kinds - {"truncated"}
    # A pixel that kept too few of the largest is noticed.
    few = sums._replace(largest=sums.largest[:, :2])
    assert {f.status for row in pixels.khat_tiles(few, WIDTH, HEIGHT, 4) for f in row} <= {"truncated", "atomic"}


@pytest.mark.slow
def test_uneven_shards_merge_to_the_same(family):
    sums, c = family
    x = jnp.asarray(c.T, jnp.float32)
    states = []
    for cuts in ((0, 150), (0, 1), (1, 70), (70, 150)):
        shard = x[cuts[0] : cuts[1]]
        record = TALLY.reduce(shard, jnp.ones(shard.shape, bool), (0,))
        states.append(TALLY.init(record, (c.shape[0],)))
        TALLY.add(states[-1], jax.tree.map(np.asarray, record))
    whole = TALLY.result(states[0])
    merged = TALLY.result(TALLY.merge(TALLY.merge(states[1], states[2]), states[3]))
    assert np.array_equal(merged.largest, whole.largest) and np.array_equal(merged.count, whole.count)
    assert np.allclose(merged.moments.kurtosis[1:], whole.moments.kurtosis[1:], rtol=1e-3)
    assert np.allclose(merged.total, whole.total, rtol=1e-6) and np.array_equal(merged.n, sums.n)


def test_the_largest_of_two_lists():
    rng = np.random.default_rng(1)
    for size in (1, 2, 8, 32):
        a, b = (-np.sort(-rng.integers(0, 20, (50, size)).astype(float), 1) for _ in range(2))
        a[:5] = -np.inf
        assert np.array_equal(_largest_of(a, b), -np.sort(-np.concatenate([a, b], 1), 1)[:, :size])


def test_leverage_counts_samples_that_move_a_pixel(family):
    sums, c = family
    reference = c.mean(1)
    found = pixels.leverage(sums, 16, 0.5, reference)
    expected = 16 * (c > 8.0 * reference[:, None]).mean(1)
    assert np.allclose(found, expected) and found.max() > 0.0
    assert np.isnan(pixels.leverage(sums, 1, 0.1, reference)).any()


def test_outlying_pixels():
    image = np.random.default_rng(2).normal(1.0, 0.01, (40, 30))
    image[7, 9], image[20, 3], image[21, 3] = 1.5, 0.5, 1.02
    found = pixels.outlying_pixels(image)
    assert found[7, 9] and found[20, 3] and not found[21, 3] and found.sum() < 10
    with pytest.raises(ValueError, match="luminance image"):
        pixels.outlying_pixels(np.zeros((4, 4, 3)))


def test_bad_input_is_refused():
    for options in ({"thresholds": (2.0, 1.0)}, {"thresholds": (0.0,)}, {"largest": 12}, {"largest": 0}):
        with pytest.raises(ValueError, match="must be"):
            mc.PixelTails(**options)
    with pytest.raises(ValueError, match="family"):
        mc.integrate(lambda u: u[0], dim=1, n=100, tallies={"tails": mc.PixelTails()})


def test_waits():
    first = waits.first_firefly(1e-3)
    assert first.mean == 1000.0 and first.median == pytest.approx(692.8, abs=0.1)
    assert waits.visible_share(500, 1e-3, 500.0, 1.0) == pytest.approx(0.394, abs=5e-4)
    assert waits.visible_share(501, 1e-3, 500.0, 1.0) == 0.0
    mean = 1e-3 * 500 + 0.999 * 0.5
    assert waits.recovery_n(500.0, 0.5, mean) == pytest.approx(1000.0)
    assert waits.recovery_n(500.0, 0.5, mean, within=0.1) == pytest.approx(500.0 / (0.1 * mean), rel=2e-3)
    assert waits.recovery_n(500.0, 0.5, 0.5) == np.inf
    law = (1e-3 * 500.0**2 + 0.999 / 3 - mean**2) / mean**2
    assert waits.samples_for_error(law, 0.1) == pytest.approx(24_960, rel=1e-3)
    with pytest.raises(ValueError, match="probability"):
        waits.first_firefly(0.0)


def test_the_visible_share_is_that_of_running_means():
    rng, p, A = np.random.default_rng(3), 2e-4, 100.0
    hits = rng.random((4000, 150)) < p
    for N in (50, 99, 110):
        shown = (hits[:, :N].sum(1) * A / N >= 1.0).mean()
        expected = waits.visible_share(N, p, A, 1.0)
        assert abs(shown - expected) < 5 * np.sqrt(0.02 / 4000) if N <= 100 else shown <= 3e-3


def test_one_outlier_hides_in_a_t_interval():
    # Coverage of 95 % Student intervals of a mean with a rare bright sample, N = 16, 256 and 1024.
    rng, mean = np.random.default_rng(4), 1e-3 * 500 + 0.999 * 0.5
    for N, expected in ((16, 0.016), (256, 0.227), (1024, 0.640)):
        x = rng.random((4000, N))
        x[rng.random((4000, N)) < 1e-3] = 500.0
        half = stats.t.ppf(0.975, N - 1) * x.std(1, ddof=1) / np.sqrt(N)
        covered = (np.abs(x.mean(1) - mean) <= half).mean()
        assert abs(covered - expected) <= 5.0 * np.sqrt(expected * (1 - expected) / 4000)
