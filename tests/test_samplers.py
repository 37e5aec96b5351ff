"""Quality of the independent sampler: every check is one p-value, and mutants with one known weakness fail it.

A check returns the probability, under truly independent uniform numbers, of a statistic as far out as the one seen,
times the number of statistics that it looked at (Bonferroni). It fails below 1e-6. Each says how small a fault it sees.
The tests call each twice: on some 6 million draws, and, marked slow, on 100 million.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxmc as mc
from jaxmc.integration.samplers import GOLDEN, Independent, Index, Point, index_words, seed_words

FAIL = 1e-6
CHUNK = 1 << 20


# Mutants: samplers with one mistake each.


class Mutant(Independent):
    """An independent sampler up to a change in ``Point``, or in what reaches it."""

    Point = Point
    seed_words = staticmethod(seed_words)

    def point(self, seed, index):
        right = Independent.point(self, seed, index)
        return self.Point(right.first, right.second)


class OneWord(Mutant):
    """Coordinates from one of the two words: a permutation of the indices."""

    def point(self, seed, index):
        return Point(super().point(seed, index).first, jnp.uint32(0))


class LinearCongruence(Mutant):
    """One step of a linear congruential generator for a hash."""

    class Point(Point):
        def bits(self, dimension):
            return self.first * jnp.uint32(747796405) + jnp.asarray(dimension).astype(jnp.uint32) * jnp.uint32(GOLDEN)

    def point(self, seed, index):
        return self.Point(index.low + seed[0], seed[1])


class NoSecondRound(Mutant):
    """A coordinate is not mixed again: dimensions are a step of the golden ratio apart."""

    class Point(Point):
        def bits(self, dimension):
            return self.first + jnp.asarray(dimension).astype(jnp.uint32) * jnp.uint32(GOLDEN)


class ReusedDimension(Mutant):
    """Coordinates 2k and 2k + 1 are equal."""

    class Point(Point):
        def bits(self, dimension):
            return super().bits(jnp.asarray(dimension) // 2)


class FarReuse(Mutant):
    """Coordinates repeat after 77 dimensions."""

    class Point(Point):
        def bits(self, dimension):
            return super().bits(jnp.asarray(dimension) % 77)


class Quantised(Mutant):
    """Coordinates have 23 bits, as from the mantissa of a number in [1, 2)."""

    class Point(Point):
        def bits(self, dimension):
            return super().bits(dimension) & jnp.uint32(0xFFFFFE00)


class SeedOffset(Mutant):
    """The seed is added to the index: neighbouring seeds share all but one of their samples."""

    @staticmethod
    def seed_words(key):
        return np.array([key, 0, 0, 0], np.uint32)

    def point(self, seed, index):
        return super().point(jnp.zeros_like(seed), index + seed[0])


class NoHighWord(Mutant):
    """The index is cut to 32 bits."""

    def point(self, seed, index):
        return super().point(seed, Index(jnp.zeros_like(index.high), index.low))


class Shrunk(Mutant):
    """Coordinates end a little short of 1."""

    class Point(Point):
        def __getitem__(self, dimension):
            return super().__getitem__(dimension) * (1.0 - 2.0**-9)


# Draws.


@partial(jax.jit, static_argnames=("sampler", "raw"))
def _evaluate(words, seeds, offsets, dims, *, sampler, raw):
    def one(word, seed, offset, dim):
        point = sampler.point(seed, Index(word[0] + offset[0], word[1]) + offset[1])
        return point.bits(dim) if raw else point[dim]

    return jax.vmap(lambda word: jax.vmap(partial(one, word))(seeds, offsets, dims))(words)


def draws(sampler, n, *, start=0, stride=1, keys=0, offsets=0, dims=0, raw=False):
    """Yield ``n`` tuples of coordinates as arrays (chunk, T).

    Element t of tuple i has index ``start + stride * i + offsets[t]``, seed ``keys[t]`` and dimension ``dims[t]``; each
    of these is a list of length T or one number for all. ``raw`` asks for the 32-bit words behind the coordinates.
    """
    keys, offsets, dims = np.broadcast_arrays(*map(np.atleast_1d, (keys, offsets, dims)))
    chunk = min(n, max(1, CHUNK >> (len(keys) - 1).bit_length()))
    assert n % chunk == 0
    make_words = getattr(sampler, "seed_words", seed_words)
    distinct, which = np.unique(keys, return_inverse=True)
    seeds = np.stack([make_words(int(key)) for key in distinct])[which]
    args = seeds, index_words(offsets), dims.astype(np.uint32)
    for first in range(0, n, chunk):
        index = np.uint64(start) + np.uint64(stride) * np.arange(first, first + chunk, dtype=np.uint64)
        yield np.asarray(_evaluate(index_words(index), *args, sampler=sampler, raw=raw))


def all_draws(*args, **options):
    return np.concatenate(list(draws(*args, **options)))


# Checks: sampler and number of draws to a p-value.


def _least(p_values):
    return min(1.0, min(p_values) * len(p_values))


def _two_sided(law, x):
    return min(1.0, 2.0 * min(law.cdf(x), law.sf(x - 1 if hasattr(law.dist, "pmf") else x)))


def _chi_square(counts):
    expected = counts.sum() / counts.size
    return _two_sided(stats.chi2(counts.size - 1), ((counts - expected) ** 2).sum() / expected)


def _normal(z):
    return [2.0 * stats.norm.sf(np.abs(z).max()) * z.size]


def serial(sampler, n, **stream):
    """Chi-square of one coordinate, of pairs and of triples, 4096 cells each.

    With n = 2e6 tuples it sees a relative unevenness over the cells of 1.5 % in root mean square, with 3e7 of 0.4 %.
    """
    groups = [(0,), (0, 1), (0, 2), (0, 1, 2)]
    counts = np.zeros((len(groups), 4096))
    for u in draws(sampler, n // 4, **stream):
        for count, group in zip(counts, groups):
            side = round(4096 ** (1 / len(group)))
            cell = sum((u[:, t] * side).astype(int) * side**axis for axis, t in enumerate(group))
            count += np.bincount(cell, minlength=4096)
    return _least([_chi_square(count) for count in counts])


def bits(sampler, n):
    """Balance of each of the 32 bits, correlation of any two in one word, in consecutive words, and over dimensions.

    With n = 1e6 tuples it sees a probability of 1/2 +- 0.003 of a bit or of two bits to agree, with 1.7e7 +- 0.0008.
    """
    differ, ones = np.zeros((32, 96)), np.zeros(96)
    for words in draws(sampler, n // 8, stride=2, offsets=(0, 1, 0), dims=(0, 0, 1), raw=True):
        each_bit = np.unpackbits(np.ascontiguousarray(words).view(np.uint8), axis=1)
        packed = np.ascontiguousarray(np.packbits(each_bit, axis=0).T).view(np.uint64)
        ones += np.bitwise_count(packed).sum(1)
        for k in range(32):
            differ[k] += np.bitwise_count(packed ^ packed[k]).sum(1)
    seen = np.concatenate([differ[:, :32][np.triu_indices(32, 1)], differ[:, 32:].ravel(), ones])
    return _least(_normal((2.0 * seen / (n // 8) - 1.0) * np.sqrt(n // 8)))


def _collisions(words):
    # Words that repeat an earlier one: close to Poisson while few of the 2^32 values are used.
    words = np.sort(words, axis=None)
    n, seen = words.size, np.count_nonzero(words[1:] == words[:-1])
    return _two_sided(stats.poisson(n + 2.0**32 * np.expm1(n * np.log1p(-(2.0**-32)))), seen)


def collisions_over_indices(sampler, n):
    """Equal words at one dimension: n = 8e6 expects 8192 +- 91, and a permutation has none; n = 1e8 sees 0.5 %."""
    return _collisions(all_draws(sampler, n, raw=True))


def collisions_over_dimensions(sampler, n):
    """Equal words among 64 dimensions: a dimension that returns, or that is another one displaced, gives too many."""
    return _collisions(all_draws(sampler, n // 64, dims=np.arange(64), raw=True))


def collisions_over_seeds(sampler, n):
    """Equal words among 64 neighbouring seeds: sequences that overlap, at whatever distance, give too many."""
    return _collisions(all_draws(sampler, n // 64, keys=np.arange(64), raw=True))


def _birthdays(words):
    # Equal distances between 4096 sorted birthdays in a year of 2^32 days: Poisson, 4 to a row (Marsaglia 1985).
    gaps = np.sort(np.diff(np.sort(words, axis=1), axis=1), axis=1)
    return _two_sided(stats.poisson(4.0 * len(words)), np.count_nonzero(gaps[:, 1:] == gaps[:, :-1]))


def birthdays_over_indices(sampler, n):
    """Birthday spacings along the indices: n = 2e6 draws expect 2048 +- 45, and lattices have many times more."""
    return _birthdays(all_draws(sampler, n // 4, raw=True).reshape(-1, 4096))


def birthdays_over_dimensions(sampler, n):
    """Birthday spacings among 4096 dimensions of one sample."""
    return _birthdays(all_draws(sampler, n // 4 // 4096, dims=np.arange(4096), raw=True))


def spectrum(sampler, n):
    """Largest power of the Fourier transform, largest autocorrelation, along indices and along dimensions.

    Power is exponential; with 2^20 points the check sees a wave of amplitude 0.003, or a correlation of 0.7 %.
    """
    size = 1 << int(np.log2(n // 8))
    p_values = []
    for u in (all_draws(sampler, size).ravel(), all_draws(sampler, 1, dims=np.arange(size // 4)).ravel()):
        power = np.abs(np.fft.rfft(u.astype(np.float64) - 0.5)) ** 2 / (u.size / 12.0)
        lags = np.fft.irfft(power)[1 : u.size // 2] * np.sqrt(u.size)
        inner = power[1:-1]
        p_values += [-np.expm1(inner.size * np.log1p(-np.exp(-inner.max()))), *_normal(lags)]
    return _least(p_values)


def small_values(sampler, n):
    """Frequency of small and of large coordinates, law of the least of many, and how finely small ones are resolved.

    Of n = 8e6 draws 128 lie below 2^-16: with 23 bits these have 128 values, so some 47 repeat; with 32 bits 1 in 8
    runs has one that does. The least of every 65536 is exponential. 0 and 1 themselves fail outright.
    """
    thresholds = 2.0 ** -np.array([8, 12, 16, 20])
    below, above, least, tiny = np.zeros(4), np.zeros(2), [], []
    for u in draws(sampler, n):
        if u.min() <= 0.0 or u.max() >= 1.0:
            return 0.0
        below += [np.count_nonzero(u < t) for t in thresholds]
        above += [np.count_nonzero(u > 1.0 - t) for t in thresholds[:2]]
        least += [u.reshape(16, -1).min(1)]
        tiny += [np.floor(u[u < 2.0**-16] * 2.0**32)]
    least, tiny = np.concatenate(least).astype(np.float64), np.concatenate(tiny)
    pairs = tiny.size * (tiny.size - 1) / 2.0 / 2.0**16
    p_values = [_two_sided(stats.poisson(n * t), k) for t, k in zip(thresholds, below)]
    p_values += [_two_sided(stats.poisson(n * t), k) for t, k in zip(thresholds, above)]
    p_values += [stats.poisson(pairs).sf(tiny.size - np.unique(tiny).size - 1)]
    p_values += [stats.kstest(least * (n // least.size), "expon").pvalue]
    return _least(p_values)


def moments(sampler, n):
    """Means of u, u^2, u^3, u^4: with n = 8e6 the check sees a mean that is wrong by 5e-4, with 1e8 by 1.5e-4."""
    k = np.arange(1, 5)
    sums = sum((u.astype(np.float64) ** k).sum(0) for u in draws(sampler, n))
    return _least(_normal((sums / n - 1.0 / (k + 1)) / np.sqrt((1.0 / (2 * k + 1) - 1.0 / (k + 1) ** 2) / n)))


CHECKS = {
    "consecutive indices": partial(serial, stride=3, offsets=(0, 1, 2)),
    "indices 2^16 apart": partial(serial, offsets=(0, 1 << 16, 2 << 16), stride=(3 << 16) + 1),
    "indices on both sides of 2^32": partial(serial, start=2**32 - 3 * 2**20, stride=3, offsets=(0, 1, 2)),
    "indices 2^32 apart": partial(serial, offsets=(0, 1 << 32, 2 << 32)),
    "consecutive dimensions": partial(serial, dims=(0, 1, 2)),
    "dimensions far apart": partial(serial, dims=(0, 77, 1000)),
    "consecutive seeds": partial(serial, keys=(0, 1, 2)),
    "seed and index traded": partial(serial, stride=3, keys=(0, 1, 2), offsets=(2, 1, 0)),
    "index and dimension traded": partial(serial, stride=3, offsets=(0, 1, 2), dims=(2, 1, 0)),
    "bits": bits,
    "collisions over indices": collisions_over_indices,
    "collisions over dimensions": collisions_over_dimensions,
    "collisions over seeds": collisions_over_seeds,
    "birthdays over indices": birthdays_over_indices,
    "birthdays over dimensions": birthdays_over_dimensions,
    "spectrum": spectrum,
    "small values": small_values,
    "moments": moments,
}


@pytest.mark.parametrize("name", CHECKS)
def test_points_are_independent_and_uniform(name):
    assert CHECKS[name](Independent(), 1 << 23) > FAIL


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKS)
def test_100_million_points_are_independent_and_uniform(name):
    assert CHECKS[name](Independent(), 1 << 27) > FAIL


MUTANTS = [
    (OneWord, "collisions over indices"),
    (LinearCongruence, "consecutive indices"),
    (LinearCongruence, "birthdays over indices"),
    (LinearCongruence, "spectrum"),
    (NoSecondRound, "consecutive dimensions"),
    (NoSecondRound, "birthdays over dimensions"),
    (ReusedDimension, "consecutive dimensions"),
    (ReusedDimension, "collisions over dimensions"),
    (FarReuse, "dimensions far apart"),
    (Quantised, "small values"),
    (Quantised, "bits"),
    (SeedOffset, "seed and index traded"),
    (SeedOffset, "collisions over seeds"),
    (NoHighWord, "indices 2^32 apart"),
    (Shrunk, "consecutive indices"),
    (Shrunk, "small values"),
    (Shrunk, "moments"),
]


@pytest.mark.parametrize(("mutant", "name"), MUTANTS, ids=lambda x: getattr(x, "__name__", x))
def test_a_weak_sampler_fails(mutant, name):
    assert CHECKS[name](mutant(), 1 << 22) < FAIL


def test_a_mutant_without_its_mistake_passes():
    assert CHECKS["consecutive dimensions"](Mutant(), 1 << 22) > FAIL


# Arithmetic.

EXTREMES = (0, 1, 0xFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFF7F, 0xFFFFFF80, 0xFFFFFFFF)


@pytest.mark.parametrize("word", EXTREMES, ids=hex)
@pytest.mark.parametrize("x64", [False, True])
def test_coordinates_lie_inside_the_unit_interval(monkeypatch, word, x64):
    monkeypatch.setattr(Point, "bits", lambda self, dimension: jnp.full(jnp.shape(dimension), word, jnp.uint32))
    with jax.enable_x64(x64):
        u = np.asarray(Point(None, None)[0])
        assert u.dtype == (np.float64 if x64 else np.float32)
        assert 0.0 < u < 1.0
        if x64:
            assert np.floor(u * 2.0**32) == word
        else:
            assert u == np.float32(min(np.float32(word * 2.0**-32) + 2.0**-33, 1.0 - 2.0**-24))
            assert float(u) == pytest.approx((word + 0.5) * 2.0**-32, rel=2.0**-24)


def test_double_precision_keeps_the_leading_bits_and_fills_the_rest():
    words = all_draws(Independent(), 1 << 16, dims=(0, 5), raw=True)
    with jax.enable_x64(False):
        single = all_draws(Independent(), 1 << 16, dims=(0, 5))
    with jax.enable_x64(True):
        double = all_draws(Independent(), 1 << 16, dims=(0, 5))
    assert (single.dtype, double.dtype) == (np.float32, np.float64)
    assert np.array_equal(np.floor(double * 2.0**32), words)
    assert np.abs(single - double).max() <= 2.0**-25 + 2.0**-32
    rest = double * 2.0**32 % 1.0 * 2.0**20
    assert (rest % 1.0 == 0.5).all()
    assert _chi_square(np.bincount((rest * 2.0**-10).astype(int).ravel(), minlength=1024)) > FAIL
    leading = words >> np.uint32(22)
    table = np.histogram2d(leading.ravel(), rest.ravel(), 32, [[0, 1024], [0, 2**20]])[0]
    assert _chi_square(table) > FAIL


def test_points_never_change():
    # Saved sample indices replay only as long as the hash stays what it is.
    words = all_draws(Independent(), 2, start=2**32 - 1, dims=(0, 1, 1000), keys=7, raw=True)
    assert words.tolist() == [[4032585782, 3660214947, 312255012], [3559834892, 3111300306, 2999174971]]


def test_a_dimension_may_be_a_number_traced_or_an_array():
    point = Independent().point(jnp.asarray(seed_words(3)), Index(jnp.uint32(0), jnp.uint32(11)))
    together = point[jnp.arange(3)]
    assert together.shape == (3,)
    traced = jax.jit(lambda k: point[k])
    assert [float(point[k]) for k in range(3)] == together.tolist() == [float(traced(k)) for k in range(3)]
    assert float(point[np.int64(2)]) == together.tolist()[2]


def test_samplers_of_a_kind_are_equal():
    assert Independent() == mc.Independent() and hash(Independent()) == hash(mc.Independent())
    assert Independent() != OneWord() and repr(Independent()) == "Independent()"


def test_index_words():
    assert index_words(2**40 + 5).tolist() == [256, 5]
    assert index_words([[0, 2**32 - 1], [2**32, 2**64 - 1]]).tolist() == [
        [[0, 0], [0, 2**32 - 1]],
        [[1, 0], [2**32 - 1, 2**32 - 1]],
    ]
    assert index_words([3]).dtype == np.uint32


def test_adding_to_an_index_carries():
    edges = np.array([0, 1, 2**31, 2**32 - 2, 2**32 - 1, 2**32, 2**33 - 1, 2**40, 2**63, 2**64 - 2**32], np.uint64)
    start = np.concatenate([edges, np.random.default_rng(1).integers(0, 2**63, 1000, np.uint64)])
    offset = np.array([0, 1, 255, 2**20, 2**31, 2**32 - 1], np.uint32)
    words = jnp.asarray(index_words(start)[:, None])
    total = Index(words[..., 0], words[..., 1]) + jnp.asarray(offset)
    assert total.high.dtype == total.low.dtype == jnp.uint32
    got = (np.asarray(total.high, np.uint64) << np.uint64(32)) + np.asarray(total.low, np.uint64)
    assert np.array_equal(got, start[:, None] + offset)


# Seeds.


def test_seeds_may_be_integers_of_any_kind():
    for key in (0, 1, 2**32, 2**64 - 1):
        words = seed_words(key)
        assert words.shape == (4,) and words.dtype == np.uint32
        assert np.array_equal(words, seed_words(np.uint64(key)))
    assert np.array_equal(seed_words(5), seed_words(np.int8(5)))


def test_neighbouring_seeds_share_nothing():
    keys = [*range(1000), *(2**32 + k for k in range(1000)), *(2**64 - 1 - k for k in range(1000))]
    words = np.concatenate([seed_words(key) for key in keys])
    # 12000 words expect 0.02 repetitions.
    assert len(np.unique(words)) >= words.size - 1
    ones = np.unpackbits(words.view(np.uint8)).mean()
    assert abs(ones - 0.5) < 5.0 * 0.5 / np.sqrt(words.size * 32)


@pytest.mark.parametrize("implementation", ["threefry2x32", "rbg"])
def test_seeds_may_be_jax_keys(implementation):
    key = jax.random.key(3, impl=implementation)
    words = seed_words(key)
    assert np.array_equal(words, seed_words(jax.random.key_data(key)))
    others = [jax.random.key(4, impl=implementation), *jax.random.split(key, 3), jax.random.fold_in(key, 7)]
    distinct = {tuple(seed_words(other).tolist()) for other in others}
    assert len(distinct) == len(others) and tuple(words.tolist()) not in distinct


BAD_KEYS = [-1, 2**64, True, False, 1.0, np.float32(1.0), "a", None, (1, 2), np.array([1, 2]), np.bool_(True)]


@pytest.mark.parametrize("key", BAD_KEYS, ids=repr)
def test_what_is_no_seed_is_refused(key):
    with pytest.raises(ValueError, match="key must be"):
        seed_words(key)


@pytest.mark.parametrize(
    "make",
    [
        lambda: jnp.float32(0.5),
        lambda: jnp.int32(-1),
        lambda: jnp.zeros(0, jnp.uint32),
        lambda: jnp.zeros(3, jnp.uint32),
        lambda: jnp.zeros((2, 2), jnp.uint32),
        lambda: jax.random.split(jax.random.key(0), 3),
        lambda: jax.random.split(jax.random.PRNGKey(0), 3),
    ],
)
def test_arrays_that_are_no_key_are_refused(make):
    with pytest.raises(ValueError, match="key must be"):
        seed_words(make())
