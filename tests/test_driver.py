"""The driver and its tallies against NumPy on the same samples, whatever the way the work is cut."""

import copy
import dataclasses
import math
import re
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from trees import of_a, of_b, tree

import jaxmc as mc
from jaxmc.analysis.clamping import clamp_curve
from jaxmc.integration import driver, kernel, moments
from jaxmc.integration.estimate import with_error
from jaxmc.integration.run import Run
from jaxmc.integration.samplers import Index, index_words, seed_words
from jaxmc.integration.sums import Sums
from jaxmc.testing import Exponential, LogNormal, Mix, Pareto

# Samples that are known in advance: the coordinate is the sample's own index, and looks its value up in a table.


class IndexPoint(NamedTuple):
    index: jax.Array

    def __getitem__(self, dimension):
        return jnp.broadcast_to(self.index, jnp.shape(dimension))


@dataclasses.dataclass(frozen=True)
class Counting(mc.Independent):
    """A sampler whose every coordinate is the low word of the sample's index."""

    def point(self, seed, index):
        return IndexPoint(index.low)


def _look_up(u, table):
    return jax.tree.map(lambda column: column[u[0]], table)


def integrate_table(table, n=None, **options):
    """Integrate with sample i = table[i], for a table or a pytree of tables of one length, or only the first n."""
    n = n or len(jax.tree.leaves(table)[0])
    return mc.integrate(mc.Integrand(_look_up, 1, (table,), lazy=True), n=n, sampler=Counting(), **options)


def run_from(start, stop, f, tallies, sampler=None, blocks=2):
    """Return the estimate from the samples with indices start <= i < stop."""
    run = Run(f, 0, sampler or mc.Independent(), None, tallies, 2, blocks)
    run.sums.drawn = start
    return run.stream(stop, driver.Progress(None, None))


def same(a, b):
    """Whether two estimates are equal in all tallies, bit for bit."""
    a, b = (jax.tree.flatten((e.moments, e.tallies)) for e in (a, b))
    return a[1] == b[1] and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a[0], b[0]))


def of_coordinate(values):
    return values["b"][..., 0]


TALLIES = {
    "tail": mc.TailHistogram(of=of_a),
    "top": mc.TopSamples(100, of=of_a),
    "coordinate": mc.TopSamples(100, of=of_coordinate),
    "clamp": mc.ClampLadder((0.5, 2.0, 10.0), of=of_a),
    "b": mc.Moments(of=of_b, order=3),
}
FEW = {name: TALLIES[name] for name in ("tail", "top", "clamp")}


# The way the work is cut.

N = 300_001


@pytest.fixture(scope="module")
def whole():
    return mc.integrate(tree, dim=2, n=N, tallies=TALLIES, chunk=1, workers=1)


CUTS = [(chunk, workers) for chunk in (1, 20_000, 2**18, 2**20) for workers in (1, 2, 5)]
QUICK = [(1, 5), (20_000, 2), (2**18, 1), (2**18, 5), (2**20, 2)]


@pytest.mark.parametrize(
    ("chunk", "workers"), [pytest.param(*cut, marks=[] if cut in QUICK else pytest.mark.slow) for cut in CUTS]
)
def test_results_do_not_depend_on_chunks_or_workers(whole, chunk, workers):
    assert same(mc.integrate(tree, dim=2, n=N, tallies=TALLIES, chunk=chunk, workers=workers), whole)


def test_other_seeds_and_other_orders_give_other_results(whole, monkeypatch):
    assert not same(mc.integrate(tree, dim=2, n=N, tallies=TALLIES, key=1), whole)
    fold = Sums._fold

    def backwards(sums, name, tally, record, job):
        fold(sums, name, tally, record if tally.pooled else jax.tree.map(lambda x: x[::-1], record), job)

    # Moments of blocks that are added in another order differ in their last digits, and the comparison sees it.
    monkeypatch.setattr(Sums, "_fold", backwards)
    assert not same(mc.integrate(tree, dim=2, n=N, tallies=TALLIES), whole)


def tree_of_item(u, scale, item):
    return jax.tree.map(lambda x: scale * x + item, tree(u))


@pytest.mark.slow
def test_families_do_not_depend_on_chunks_or_workers():
    f = mc.Integrand(tree_of_item, 2, (2.0,))
    run = partial(mc.integrate_each, f, 2100, n=70, tallies=FEW)
    narrow = run(chunk=1, workers=1)
    assert all(same(run(chunk=2**20, workers=workers), narrow) for workers in (1, 5))


class Numbered(mc.Independent):
    """A sampler whose coordinate 2 is the sample's own index."""

    def point(self, seed, index):
        return NumberedPoint(super().point(seed, index), index.low)


class NumberedPoint(NamedTuple):
    right: object
    index: jax.Array

    def __getitem__(self, dimension):
        return self.index if dimension == 2 else self.right[dimension]


def tree_up_to(u, end):
    return jax.tree.map(lambda x: jnp.where(u[2] < end, x, jnp.nan), tree(u))


@dataclasses.dataclass(frozen=True)
class LeakyMoments(mc.Moments):
    """A mutant that takes masked lanes for samples."""

    def reduce(self, values, valid, axes):
        return super().reduce(values, jnp.ones_like(valid), axes)


@pytest.mark.parametrize("n", [1, 2, 961, 61_441])
def test_samples_behind_the_last_are_never_seen(n):
    def run(end):
        f = mc.Integrand(tree_up_to, 3, (np.uint32(end),), lazy=True)
        estimate = mc.integrate(f, n=n, sampler=Numbered(), tallies={**FEW, "leaky": LeakyMoments()}, chunk=1)
        return estimate, estimate.tallies.pop("leaky")[0]

    (right, _), (cut, leaky) = run(2**32 - 1), run(n)
    assert cut.nonfinite == 0 and same(cut, right)
    # The rest of the rows that were begun is NaN; rows that nobody wants are not evaluated.
    assert leaky.n > n and leaky.nonfinite > 0


@pytest.mark.parametrize("n", [1, 2, 959, 61_441, 170_001])
def test_every_index_is_evaluated_once(n):
    table = np.arange(170_001, dtype=np.float32)
    estimate = integrate_table(table, n, tallies={"top": mc.TopSamples(170_001)}, chunk=130_000)
    assert estimate.n == estimate.moments[0].n == estimate["top"].n == n
    assert np.array_equal(estimate["top"].index, np.arange(n)[::-1])
    assert np.array_equal(estimate["top"].value, np.arange(n)[::-1])
    assert estimate.mean == pytest.approx((n - 1) / 2, rel=1e-7)


def look_up_item(u, table, items, item):
    return jnp.where(item < items, table[u[0]], jnp.nan), (u[0] % items).astype(jnp.float32), item


def first(values):
    return values[0]


def integrate_items(table, items, n):
    """Integrate a family of which item i has the samples table[i], table[i + items], ..."""
    f = mc.Integrand(look_up_item, 1, (table, np.uint32(items)), lazy=True)
    tallies = {"top": mc.TopSamples(50, of=first)}
    return mc.integrate_each(f, items, n=n, sampler=Counting(), tallies=tallies, chunk=1)


@pytest.mark.parametrize(("items", "n"), [(1, 1), (3, 65), (960, 64), (2100, 130)])
def test_families_number_their_samples(items, n):
    table = np.random.default_rng(1).normal(size=300_000).astype(np.float32)
    estimate = integrate_items(table, items, n)
    table = table[: n * items]
    samples = table.astype(np.float64).reshape(n, items)
    mean, remainder, item = estimate.mean
    assert np.allclose(mean, samples.mean(0), rtol=0, atol=1e-7) and estimate.nonfinite == 0
    assert np.array_equal(remainder, np.arange(items)) and np.array_equal(item, np.arange(items))
    assert all((m.n == n).all() and m.n.shape == (items,) for m in estimate.moments)
    if n > 1:
        assert np.allclose(estimate.variance[0], samples.var(0, ddof=1), rtol=1e-6)
    order = np.lexsort((np.arange(table.size), -table))[:50]
    assert np.array_equal(estimate["top"].index, order) and np.array_equal(estimate["top"].value, table[order])


def test_families_get_points_as_single_integrals_do():
    # An array unless the integrand is lazy.
    f = mc.Integrand(lambda u, item: u.sum() + item, 3)
    estimate = mc.integrate_each(f, 2, n=1000)
    values = mc.draw(lambda u: u.sum(), dim=3, n=2000).value.astype(np.float64).reshape(1000, 2)
    assert np.allclose(estimate.mean, values.mean(0) + np.arange(2), rtol=1e-6)


# Long runs.


@pytest.mark.parametrize("start", [0, 2**32 - 3000, 2**40, 2**62 + 2**33 - 1, 2**63 - 50_000])
def test_jobs_number_their_samples(start):
    (job,) = kernel.stream_jobs([(0, start, start + 20_000)], 2)
    assert job.samples == 20_000 and job.rows.sum() == 20_000
    position = np.arange(20_000)
    assert np.array_equal(job.index(position), np.uint64(start) + position.astype(np.uint64))
    wanted = (np.arange(kernel.ROWS)[:, None] < job.rows[:, None, :]).ravel()
    assert np.array_equal(np.flatnonzero(wanted), position)
    assert next(kernel.stream_jobs([(0, start, start + 2**20)], 2)).samples == 2 * kernel.BLOCK


def skew(u):
    return -jnp.log(u[0]) * u[1]


@pytest.mark.parametrize("start", [2**32 - 3000, 2**40])
def test_kernels_count_across_word_boundaries(start):
    f = mc.Integrand(skew, 2)
    estimate = run_from(start, start + 20_000, f, {"top": mc.TopSamples(300)})
    samples = mc.draw(f, indices=np.arange(start, start + 20_000, dtype=np.uint64))
    order = np.lexsort((samples.index, -samples.value))[:300]
    assert np.array_equal(estimate["top"].index, samples.index[order])
    assert np.allclose(estimate["top"].value, samples.value[order], rtol=1e-6)
    assert estimate.mean == pytest.approx(samples.value.mean(dtype=np.float64), rel=1e-6)


def test_any_sample_can_be_drawn():
    indices = [0, 2**32 - 1, 2**32, 2**40 + 5, 2**63 - 1, 2**63, 2**64 - 1]
    samples = mc.draw(lambda u: 2.0 * u, dim=3, indices=indices, key=9)
    assert samples.index.tolist() == indices and samples.index.dtype == np.uint64
    seed = jnp.asarray(seed_words(9))
    for row, (high, low) in zip(samples.u, index_words(indices)):
        point = mc.Independent().point(seed, Index(jnp.uint32(high), jnp.uint32(low)))
        assert row.tolist() == [float(point[k]) for k in range(3)]
    assert len(np.unique(samples.u)) == samples.u.size
    assert np.array_equal(samples.value, 2.0 * samples.u)
    first = mc.draw(lambda u: 2.0 * u, dim=3, n=5, key=9)
    assert first.index.tolist() == [0, 1, 2, 3, 4]
    assert np.array_equal(first.u[0], samples.u[0])
    top = mc.draw(lambda u: u[0], dim=1, indices=np.array([2**64 - 1], np.uint64))
    assert 0.0 < top.value[0] < 1.0


def test_one_sample():
    estimate = mc.integrate(tree, dim=2, n=1, tallies=TALLIES)
    sample = mc.draw(tree, dim=2, n=1)
    assert estimate.mean["a"] == pytest.approx(sample.value["a"][0], rel=1e-6)
    assert np.allclose(estimate.mean["b"], sample.value["b"][0], rtol=1e-6)
    assert math.isnan(estimate.variance["a"]) and np.isnan(estimate.stderr["b"]).all()
    assert estimate["tail"].count.sum() == 1 and estimate["top"].n == 1
    assert "nan" not in str(estimate) and estimate.status == "complete"


# Moments.


def wrong_moments(result, samples):
    """Return which of the moments differ from NumPy's in float64 by more than float32 arithmetic explains."""
    x = np.asarray(samples, np.float64)
    n, center = len(x), x.mean(0)
    z = (x - center) / np.where((sd := x.std(0)) > 0.0, sd, 1.0)
    wrong = set() if (result.n == n).all() else {"n"}
    if (np.abs(result.mean - center) > 1e-7 * sd + 1e-15 * np.abs(center)).any():
        wrong.add("mean")
    if (np.abs(result.variance - x.var(0, ddof=1)) > 1e-6 * sd**2 + 1e-20 * center**2).any():
        wrong.add("variance")
    for k, central in zip((2, 3, 4), result.central):
        if (
            np.abs(central - (z**k).mean(0) * sd**k)
            > 2e-6 * (np.abs(z) ** k).mean(0) * sd**k + 1e-20 * np.abs(center) ** k
        ).any():
            wrong.add(k)
    return wrong


RANDOM = np.random.default_rng(5)
NORMAL = RANDOM.normal(size=150_003)
TABLES = {
    "normal": NORMAL,
    "sorted": np.sort(NORMAL),
    "far from 0": 1e5 + NORMAL,
    "heavy tail": RANDOM.random(150_003) ** -0.4,
    "huge": 1e30 * np.exp(NORMAL),
    "tiny": 1e-30 * np.exp(NORMAL),
    "both": np.where(NORMAL > 3.0, 1e15, 1e-15),
    "rare": NORMAL > 3.5,
    "constant": np.full(150_003, 0.1),
    "largest": 1e37 * NORMAL,
    "huge constant": np.full(150_003, -3e38),
    "tiny constant": np.full(150_003, 1e-30),
    "zero": np.zeros(150_003),
}
TABLES = {name: table.astype(np.float32) for name, table in TABLES.items()}


@pytest.mark.parametrize("name", TABLES)
def test_moments_are_those_of_numpy(name):
    result = integrate_table(TABLES[name]).moments[0]
    assert not wrong_moments(result, TABLES[name])
    if "constant" in name or name == "zero":
        assert result.mean == pytest.approx(float(TABLES[name][0]), rel=1e-15)
        assert 0.0 <= result.variance <= 1e-28 * float(TABLES[name][0]) ** 2


@pytest.mark.parametrize("n", [2, 3, 10])
def test_moments_of_few_samples(n):
    assert not wrong_moments(integrate_table(TABLES["heavy tail"], n).moments[0], TABLES["heavy tail"][:n])


def test_moments_keep_the_shape_of_the_value():
    table = {"x": TABLES["normal"], "y": (np.random.default_rng(2).random((150_003, 2, 3)) ** 8,)}
    table = jax.tree.map(np.float32, table)
    estimate = integrate_table(table)
    assert all(not wrong_moments(m, x) for m, x in zip(estimate.moments, jax.tree.leaves(table), strict=True))
    shapes = {"x": (), "y": ((2, 3),)}
    for value in (estimate.mean, estimate.variance, estimate.stderr, *estimate.interval()):
        assert jax.tree.map(np.shape, value) == shapes
    assert isinstance(estimate.mean["x"], float)
    assert estimate.stderr["y"][0] == pytest.approx(np.sqrt(estimate.variance["y"][0] / estimate.n))


def test_moments_are_those_of_the_drawn_samples(whole):
    samples = mc.draw(tree, dim=2, n=N)
    assert not wrong_moments(whole.moments[1], samples.value["b"])
    assert not wrong_moments(whole["b"][0], samples.value["b"]) and len(whole["b"][0].central) == 2
    assert whole.mean["a"] == pytest.approx(samples.value["a"].mean(dtype=np.float64), rel=1e-6)


def test_moments_of_any_type_of_number():
    # An indicator function is a probability.
    integers = np.random.default_rng(4).integers(0, 100, 130_000)
    table = {"indicator": integers < 30, "half": integers.astype(np.float16)}
    result = integrate_table(table).moments
    assert not any(wrong_moments(m, column) for m, column in zip(result, jax.tree.leaves(table), strict=True))


def many_orders(sums):
    """Add single values of which the largest two cancel; the rest sum to 10000."""
    for x in [0.0, 1e16, *[1.0] * 10_000, -1e16]:
        record = {"count": 1.0, "mean": x, "scale": 0.0, "powers": np.zeros(4), "nonfinite": np.zeros((), int)}
        sums.add(record, ...)
    return sums.moments().mean * 10_003


def test_sums_are_compensated():
    assert many_orders(moments._PowerSums.zeros((), 4)) == pytest.approx(10_000.0, rel=1e-9)


def forgetful(self, where, powers):
    for k, x in enumerate(powers):
        self.total[k, where] += x


def biased(self):
    return self.central[0]


def twice_corrected(self):
    return self.central[0] * (self.n / (self.n - 2))


def without_cross_terms(n, powers, d):
    return [s + n * d ** (k + 1) for k, s in enumerate(powers)]


def test_mutants_of_moments_fail(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(moments._PowerSums, "_accumulate", forgetful)
        assert abs(many_orders(moments._PowerSums.zeros((), 4)) - 10_000.0) > 1000.0
    few = TABLES["heavy tail"][:10]
    for variance in (biased, twice_corrected):
        with monkeypatch.context() as patch:
            patch.setattr(moments.MomentsResult, "variance", property(variance))
            assert wrong_moments(integrate_table(TABLES["heavy tail"], 10).moments[0], few) == {"variance"}
    with monkeypatch.context() as patch:
        patch.setattr(moments, "_shift", without_cross_terms)
        assert {"variance", 3, 4} <= wrong_moments(integrate_table(TABLES["sorted"]).moments[0], TABLES["sorted"])


@pytest.mark.slow
def test_the_mean_of_a_constant_is_the_constant_after_100_million_samples():
    estimate = mc.integrate(lambda u: jnp.float32(0.1), dim=1, n=10**8)
    assert estimate.mean == pytest.approx(float(np.float32(0.1)), rel=1e-12)
    assert estimate.variance < 1e-30


# Tail histograms.


def wrong_histogram(histogram, samples):
    """Return what differs from float64 sums of the samples as float32: counts and sums exactly, squares by 3e-8."""
    c = np.asarray(samples, np.float32).astype(np.float64)
    kept = c[np.isfinite(c) & (c >= 0.0)]
    seen = histogram.n, histogram.nonfinite, histogram.negative
    wrong = set() if seen == (c.size, (~np.isfinite(c)).sum(), (np.isfinite(c) & (c < 0.0)).sum()) else {"n"}
    bins = np.searchsorted(histogram.edges, kept, side="right") - 1
    count, total, square = (np.bincount(bins, kept**q, histogram.edges.size) for q in range(3))
    if not np.array_equal(histogram.count, count):
        wrong.add("count")
    if not np.allclose(histogram.total, total, rtol=1e-12, atol=0.0):
        wrong.add("total")
    # Below the least normal number there is no octave to resolve the square in.
    normal = histogram.edges >= 2.0**-126
    if not np.allclose(histogram.square[normal], square[normal], rtol=3e-8, atol=0.0):
        wrong.add("square")
    return wrong


BITS = RANDOM.integers(0, 0x7F800000, 130_000, np.uint32)
POWERS = 2.0 ** np.arange(-126.0, 128.0)
EDGES = (POWERS[:, None] * (1.0 + np.arange(8) / 8)).ravel().astype(np.float32)
SPECIAL = [0.0, -0.0, 1e-45, 1e-40, 1.1754942e-38, 1.1754944e-38, 3.4028235e38, 1.0, np.nan, np.inf, -np.inf, -1.0]
HISTOGRAMS = {
    "any finite": BITS.view(np.float32),
    "on edges": EDGES,
    "next to edges": np.concatenate([np.nextafter(EDGES, np.float32(0.0)), np.nextafter(EDGES, np.float32(np.inf))]),
    "special": SPECIAL,
    "denormal": (BITS & 0x7FFFFF).view(np.float32),
    "negative": -BITS.view(np.float32),
    "negative denormal": -(BITS[:100] & 0x7FFFFF | 1).view(np.float32),
    "one bin, full": np.full(70_000, np.nextafter(np.float32(1.125), np.float32(0.0))),
    "ordinary": np.exp(2.0 * RANDOM.normal(size=130_000)),
    "mostly zero": np.where(RANDOM.random(130_000) < 0.99, 0.0, RANDOM.random(130_000)),
}


@pytest.mark.parametrize("name", HISTOGRAMS)
def test_histograms_hold_exact_sums(name):
    table = np.asarray(HISTOGRAMS[name], np.float32)
    table = np.resize(table, 70_000)
    assert not wrong_histogram(integrate_table(table, tallies={"tail": mc.TailHistogram()})["tail"], table)


def test_histogram_edges_are_eight_to_the_octave(whole):
    edges = whole["tail"].edges
    assert edges[0] == 0.0 and (np.diff(edges) > 0.0).all()
    assert np.array_equal(edges[edges >= 2.0**-126], EDGES.astype(np.float64))


def wrong_clamping(histogram, samples):
    """Return the greatest relative error of B(t) over the edges, against the samples themselves."""
    curve = clamp_curve(histogram)
    c = np.sort(np.asarray(samples, np.float32).astype(np.float64))
    first = np.searchsorted(c, curve.threshold)
    assert np.array_equal(curve.exceedances, c.size - first)
    bias = np.array([(c[k:] - t).sum() for k, t in zip(first, curve.threshold)]) / c.size
    return np.max(np.abs(curve.bias - bias) / np.where(bias > 0.0, bias, 1e-12 * c.mean()))


@dataclasses.dataclass(frozen=True)
class Midpoints(mc.TailHistogram):
    """A mutant that takes samples for the centres of their bins."""

    def result(self, state):
        right = super().result(state)
        upper = np.append(right.edges[1:], 2.0**128)
        return right._replace(total=right.count * (right.edges + upper) / 2.0)


LAWS = [Exponential(), LogNormal(0.0, 1.5), Pareto(1.5), Mix(1e-3, 500.0)]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_clamping_bias_is_that_of_the_samples(law):
    samples = law.sample(np.random.default_rng(3).random((law.dim, 100_000), np.float32)).astype(np.float32)
    estimate = integrate_table(samples, tallies={"tail": mc.TailHistogram(), "mutant": Midpoints()})
    assert wrong_clamping(estimate["tail"], samples) < 1e-6 < wrong_clamping(estimate["mutant"], samples)


def test_clamping_bias_is_that_of_the_drawn_samples(whole):
    samples = mc.draw(tree, dim=2, n=N).value["a"]
    # Another kernel may divide and take roots to within a few units of the last place.
    assert wrong_clamping(whole["tail"], samples) < 1e-6


def test_clamp_ladders_hold_means_of_both_parts():
    t = np.array([0.1, 1.0, 5.0, 1e3])
    table = np.exp(NORMAL).astype(np.float32).reshape(-1, 3)
    clamp = integrate_table(table[:, 0], tallies={"clamp": mc.ClampLadder(tuple(t))})["clamp"]
    f = mc.Integrand(lambda u, table, item: table[u[0]], 1, (table.ravel(),), lazy=True)
    each = mc.integrate_each(f, 3, n=len(table), sampler=Counting(), tallies={"clamp": mc.ClampLadder(tuple(t))})
    for sums, samples in ((clamp, table[:, :1]), (each["clamp"], table)):
        c = samples.astype(np.float64)
        kept, excess = np.minimum(c, t[:, None, None]), np.maximum(c - t[:, None, None], 0.0)
        assert sums.n == len(c) and np.array_equal(sums.thresholds, t)
        for got, x in zip(sums[2:], (kept, kept**2, excess, excess**2), strict=True):
            assert np.allclose(got, x.mean(1).reshape(np.shape(got)), rtol=2e-6, atol=1e-12)
    assert each["clamp"].excess.shape == (4, 3) and clamp.excess.shape == (4,)


# Largest samples.


def wrong_largest(largest, samples, k):
    """Whether the largest samples differ from a full sort, ties by index and NaN for infinity."""
    samples = np.where(np.isnan(samples), np.inf, samples)
    order = np.lexsort((np.arange(len(samples)), -samples))[:k]
    same_values = np.array_equal(largest.value, samples[order])
    return not (largest.n == len(samples) and same_values and np.array_equal(largest.index, order))


@dataclasses.dataclass(frozen=True)
class LastTies(mc.TopSamples):
    """A mutant that keeps the last of equal samples."""

    def _prune(self, state):
        order = np.lexsort((-state["index"].astype(np.int64), -state["value"]))[: self.k]
        state["value"], state["index"] = state["value"][order], state["index"][order]


ATOMS = RANDOM.integers(0, 10, 100_003).astype(np.float32)
TOPS = {
    "atoms": ATOMS,
    "all equal": np.full(100_003, -2.0, np.float32),
    "increasing": np.arange(100_003, dtype=np.float32),
    "decreasing": -np.arange(100_003, dtype=np.float32),
    "normal": RANDOM.normal(size=100_003).astype(np.float32),
    "some infinite": np.where(ATOMS[::-1] == 3.0, np.inf, ATOMS).astype(np.float32),
    "some NaN": np.select([ATOMS[::-1] == 3.0, ATOMS[::-1] == 4.0], [np.inf, np.nan], ATOMS).astype(np.float32),
}


@pytest.mark.parametrize("name", TOPS)
def test_largest_samples_are_those_of_a_sort(name):
    tallies = {f"top {k}": mc.TopSamples(k) for k in (1, 1000, 200_000)} | {"mutant": LastTies(1000)}
    estimate = integrate_table(TOPS[name], tallies=tallies)
    assert not any(wrong_largest(estimate[f"top {k}"], TOPS[name], k) for k in (1, 1000, 200_000))
    if name in ("atoms", "all equal", "some infinite", "some NaN"):
        assert wrong_largest(estimate["mutant"], TOPS[name], 1000)


def test_largest_samples_replay(whole):
    samples = mc.draw(tree, dim=2, indices=whole["top"].index)
    assert np.array_equal(samples.index, whole["top"].index)
    # Kernels may divide and take roots to within a few units of the last place.
    assert np.allclose(samples.value["a"], whole["top"].value, rtol=4e-7)
    assert np.allclose(samples.value["a"], samples.u[:, 0] / np.sqrt(samples.u[:, 1]), rtol=4e-7)


def test_coordinates_replay_exactly(whole):
    samples = mc.draw(tree, dim=2, indices=whole["coordinate"].index)
    assert np.array_equal(samples.u[:, 0], whole["coordinate"].value)
    assert np.array_equal(samples.value["b"][:, 0], whole["coordinate"].value)


# Merging.


@dataclasses.dataclass(frozen=True)
class State:
    """A tally whose result is its state; without samples where it is ``empty``."""

    tally: object
    empty: bool = False

    def __getattr__(self, name):
        return getattr(self.tally, name)

    def add(self, state, *args, **options):
        if not self.empty:
            self.tally.add(state, *args, **options)

    def result(self, state):
        return state


STATES = {f"{name}{'!' * empty}": State(tally, empty) for name, tally in TALLIES.items() for empty in (False, True)}


@pytest.fixture(scope="module")
def states():
    """States of the whole and of two parts; a name with an exclamation mark is of no samples."""
    ranges = {"whole": (0, 200_001), "left": (0, 130_000), "right": (130_000, 200_001)}
    return {name: run_from(*ends, mc.Integrand(tree, 2), STATES) for name, ends in ranges.items()}


def merged(name, first, *others):
    """Return the result of states of the tally ``name``, merged if there are two."""
    state, others = copy.deepcopy((first, others))
    for other in others:
        state = TALLIES[name].merge(state, other)
    return TALLIES[name].result(state)


def test_halves_merge_to_the_whole(states):
    whole = {name: merged(name, states["whole"][name]) for name in TALLIES}
    both = {name: merged(name, states["left"][name], states["right"][name]) for name in TALLIES}
    for name in ("tail", "top", "coordinate"):
        assert all(np.array_equal(a, b) for a, b in zip(both[name], whole[name], strict=True))
    assert both["clamp"].n == whole["clamp"].n == 200_001
    assert all(np.allclose(a, b, rtol=1e-6) for a, b in zip(both["clamp"], whole["clamp"], strict=True))
    samples = mc.draw(tree, dim=2, n=200_001).value["b"]
    assert not wrong_moments(both["b"][0], samples) and not wrong_moments(whole["b"][0], samples)
    assert wrong_moments(merged("b", states["left"]["b"], states["left"]["b"])[0], samples)


@pytest.mark.parametrize("name", TALLIES)
def test_nothing_merges_as_nothing(states, name):
    full, nothing = states["whole"][name], states["whole"][f"{name}!"]
    expected = jax.tree.leaves(merged(name, full))
    for got in (merged(name, full, nothing), merged(name, nothing, full)):
        assert all(np.allclose(a, b, rtol=1e-14) for a, b in zip(jax.tree.leaves(got), expected, strict=True))


# Integrands and parameters.


def test_other_parameter_values_do_not_recompile():
    traces = []

    def fn(u, a, b):
        traces.append(a)
        return a * u[0] + b["x"]

    first = mc.integrate(mc.Integrand(fn, 1, (2.0, {"x": 1.0})), n=1000)
    seen = len(traces)
    second = mc.integrate(mc.Integrand(fn, 1, (-4.0, {"x": 5.0})), n=2000, key=8)
    assert 0 < seen == len(traces)
    assert first.mean == pytest.approx(2.0, abs=0.1) and second.mean == pytest.approx(3.0, abs=0.2)
    # A new function is a new kernel.
    mc.integrate(mc.Integrand(lambda u, a, b: fn(u, a, b), 1, (2.0, {"x": 1.0})), n=1000)
    assert len(traces) > seen


def test_gradients_flow_through_parameters():
    f = mc.Integrand(lambda u, a, b: jnp.sin(a * u[0]) + b * u[1] ** 2, 2, (2.0, 3.0))
    u = jnp.array([0.3, 0.6])
    a, b = jax.grad(lambda g: g(u))(f).params
    assert float(a) == pytest.approx(0.3 * math.cos(0.6), rel=1e-6) and float(b) == pytest.approx(0.36, rel=1e-6)
    points = mc.draw(f, n=1000).u
    mean_gradient = jax.grad(lambda g: g.batch(points).mean())(f).params[1]
    assert float(mean_gradient) == pytest.approx((points[:, 1] ** 2).mean(), rel=1e-5)


def test_integrands_evaluate_batches():
    samples = mc.draw(tree, dim=2, n=100)
    values = mc.Integrand(tree, 2).batch(samples.u)
    assert np.allclose(values["a"], samples.value["a"]) and values["b"].shape == (100, 3)
    with pytest.raises(ValueError, match="shape"):
        mc.Integrand(tree, 2).batch(np.zeros((5, 3)))


def test_lazy_integrands_see_the_same_coordinates():
    def fn(u):
        return u[0] + 2.0 * u[1]

    lazy, array = (mc.draw(mc.Integrand(fn, 2, lazy=lazy), n=100).value for lazy in (True, False))
    assert np.allclose(lazy, array, rtol=1e-6)


# Known integrals.


def product(u):
    return jnp.prod(0.5 + u)


def exponential(u):
    return jnp.exp(u.sum())


E1, E2 = math.e - 1.0, (math.e**2 - 1.0) / 2.0
KNOWN = [(product, 8, 1.0, (13 / 12) ** 8 - 1.0), (exponential, 4, E1**4, E2**4 - E1**8)]


class Pairs(mc.Independent):
    """A mutant whose coordinates 2k and 2k + 1 are equal."""

    def point(self, seed, index):
        class Point(NamedTuple):
            right: object

            def __getitem__(self, dimension):
                return self.right[dimension // 2]

        return Point(super().point(seed, index))


def deviation(estimate, exact, variance):
    """Return the error of the mean in exact standard errors, which are small."""
    stderr = math.sqrt(variance / estimate.n)
    assert stderr < 2e-3 * exact and estimate.nonfinite == 0
    return abs(estimate.mean - exact) / stderr


@pytest.mark.parametrize(("f", "dim", "exact", "variance"), KNOWN, ids=["product", "exponential"])
def test_known_integrals(f, dim, exact, variance):
    estimate = mc.integrate(f, dim=dim, n=2**22)
    assert deviation(estimate, exact, variance) < 5.0
    assert estimate.stderr == pytest.approx(math.sqrt(variance / estimate.n), rel=0.01)


def test_a_coordinate_used_twice_is_seen():
    f, dim, exact, variance = KNOWN[0]
    assert deviation(mc.integrate(f, dim=dim, n=2**20, sampler=Pairs()), exact, variance) > 5.0


def test_intervals_hold_the_integral_as_often_as_they_say():
    # 20000 families of 256 nearly normal samples: the check sees a standard error that is wrong by 5 %.
    f = mc.Integrand(lambda u, item: u.sum(), 6)
    estimate = mc.integrate_each(f, 20_000, n=256)
    for level in (0.5, 0.95):
        lower, upper = estimate.interval(level)
        covered = np.mean((lower < 3.0) & (3.0 < upper))
        # The interval is normal, the law of the mean over its own standard error is Student's.
        truth = 1.0 - 2.0 * stats.t(255).sf(stats.norm.isf((1.0 - level) / 2.0))
        assert abs(covered - truth) < 5.0 * math.sqrt(truth * (1.0 - truth) / 20_000)
    short = np.abs(estimate.mean - 3.0) < 0.95 * stats.norm.isf(0.025) * estimate.stderr
    assert abs(short.mean() - truth) > 5.0 * math.sqrt(truth * (1.0 - truth) / 20_000)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("share", [1e-4, 0.01, 1.0])
def test_values_that_are_not_finite_are_counted(bad, share):
    table = np.where(np.random.default_rng(6).random(150_003) < share, bad, NORMAL).astype(np.float32)
    estimate = integrate_table(table)
    assert estimate.nonfinite == np.count_nonzero(~np.isfinite(table)) > 0
    assert estimate.status == "non-finite values seen" and not math.isfinite(estimate.mean)
    assert estimate.status in estimate.summary() and re.match("nan|-?inf", str(estimate))


def test_one_pixel_that_is_not_finite_leaves_the_others_alone():
    table = np.random.default_rng(1).normal(size=130_000).astype(np.float32)
    right = integrate_items(table, 3, 100).mean[0]
    table[1::3] = np.nan
    estimate = integrate_items(table, 3, 100)
    assert estimate.nonfinite == 100
    assert np.array_equal(estimate.mean[0], [right[0], np.nan, right[2]], equal_nan=True)


# Progress and words.


def test_progress_counts_samples():
    calls = []
    mc.integrate(tree, dim=2, n=N, tallies=TALLIES, chunk=1, progress=lambda done, total: calls.append((done, total)))
    done, total = np.array(calls).T
    assert (np.diff(done) > 0).all() and done[-1] == N and (total == N).all() and len(done) == -(-N // kernel.BLOCK)
    calls.clear()
    f = mc.Integrand(tree_of_item, 2, (2.0,))
    options = {"tallies": FEW, "chunk": 1}
    mc.integrate_each(f, 700, n=70, progress=lambda done, total: calls.append((done, total)), **options)
    done, total = np.array(calls).T
    assert (np.diff(done) > 0).all() and done[-1] == 49_000 and (total == 49_000).all()


def test_progress_bars_have_a_title(capsys):
    run = partial(mc.integrate, tree, dim=2, n=1000, tallies=TALLIES, chunk=1)
    run(progress="white furnace")
    assert "white furnace: 100%" in capsys.readouterr().err
    run(progress=True)
    assert "100%" in capsys.readouterr().err
    for silent in (None, False):
        run(progress=silent)
        assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (0.266123, 8e-5, "0.26612(8)"),
        (0.266123, 1.4e-4, "0.26612(14)"),
        (0.266123, 1.96e-4, "0.2661(2)"),
        (0.2661, 9.7e-5, "0.26610(10)"),
        (0.2661, 1e-5, "0.266100(10)"),
        (-0.5, 0.03, "-0.50(3)"),
        (0.1, 3.0, "0(3)"),
        (1234.4, 20.0, "1234(20)"),
        (123456.0, 1500.0, "123456(1500)"),
        (1e10, 1e6, "1e+10 +- 1e+06"),
        (1e-20, 1e-22, "1e-20 +- 1e-22"),
        (0.5, 0.0, "0.5"),
        (0.125, math.nan, "0.125"),
        (math.nan, 1.0, "nan"),
        (1.0, math.inf, "1"),
    ],
)
def test_errors_are_of_the_last_digits(value, error, words):
    assert with_error(value, error) == words


@given(st.floats(-1e4, 1e4), st.floats(-9.0, 4.0).map(lambda x: 10.0**x))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_errors_read_back(value, error):
    whole, fraction, last = re.fullmatch(r"(-?\d+)\.?(\d*)\((\d+)\)", with_error(value, error)).groups()
    unit = 10.0 ** -len(fraction)
    assert abs(float(f"{whole}.{fraction or 0}") - value) <= 0.51 * unit
    shown = int(last) * unit
    assert abs(shown - error) <= 0.27 * error
    assert len(last.rstrip("0")) <= 2


def test_estimates_speak(whole):
    assert re.fullmatch(r"0\.\d+\(\d+\); 0\.\d+\(\d+\) 1\.\d+\(\d+\) -6\.\d+\(\d+\)", str(whole))
    assert "n = 300,001" in whole.summary() and "complete" in whole.summary()
    assert whole.recipe == {"key": 0, "sampler": "Independent()", "n": N} and whole.seconds > 0.0
    image = dataclasses.replace(whole, moments=[m._replace(mean=np.ones((5, 3))) for m in whole.moments[:1]])
    assert str(image) == "array(5, 3) of mean 1"
    lower, upper = whole.interval(0.95, "normal")
    assert upper["a"] - whole.mean["a"] == pytest.approx(1.959964 * whole.stderr["a"], rel=1e-6)
    assert whole.mean["b"] - lower["b"] == pytest.approx(1.959964 * whole.stderr["b"], rel=1e-6)
    with pytest.raises(KeyError):
        whole["histogram"]


# Mistakes.


def one(u):
    return u[0]


ONE = mc.Integrand(one, 1)
VECTOR = partial(mc.integrate, lambda u: u, dim=2, n=10)
MISTAKES = [
    *[(f"n={n!r}", partial(mc.integrate, ONE, n=n), "n must be") for n in (0, -1, 2.5, True, "9", 2**63)],
    ("neither n nor target", partial(mc.integrate, ONE), "how many samples"),
    ("n and target", partial(mc.integrate, ONE, n=10, rtol=0.1), "not both"),
    *[(f"rtol={x!r}", partial(mc.integrate, ONE, rtol=x), "rtol must be") for x in (0.0, -1.0, math.nan, "a")],
    ("replicates=0", partial(mc.integrate, ONE, n=10, replicates=0), "replicates must be"),
    *[(f"each n={n!r}", partial(mc.integrate_each, ONE, 3, n=n), "n must be") for n in (0, 2.5)],
    *[(f"items={n!r}", partial(mc.integrate_each, ONE, n, n=3), "items must be") for n in (0, -1, 1.0)],
    *[(f"chunk={c!r}", partial(mc.integrate, ONE, n=10, chunk=c), "chunk must be") for c in (0, -5, 1.5)],
    *[(f"key={k!r}", partial(mc.integrate, ONE, n=10, key=k), "key must be") for k in (-1, 2**64, "a", 1.0, True)],
    ("draw key", partial(mc.draw, ONE, n=3, key=-1), "key must be"),
    ("no dim", partial(mc.integrate, one, n=10), "dimension"),
    ("family without a dim", partial(mc.integrate_each, one, 3, n=10), "dimension"),
    ("other dim", partial(mc.integrate, ONE, dim=2, n=10), "contradicts"),
    *[(f"dim={d!r}", partial(mc.Integrand, one, d), "dim must be") for d in (0, -1, 1.0, True, None)],
    ("no function", partial(mc.Integrand, 3, 1), "must be a function"),
    ("draw neither", partial(mc.draw, ONE), "either n"),
    ("draw both", partial(mc.draw, ONE, n=2, indices=[1]), "either n"),
    ("draw n=0", partial(mc.draw, ONE, n=0), "n must be"),
    *[(f"indices={i!r}", partial(mc.draw, ONE, indices=i), "indices") for i in ([-1], [0.5], [[1]], [2**64], [True])],
    *[
        (f"thresholds={t!r}", partial(mc.ClampLadder, t), "thresholds must be")
        for t in ((), (0.0, 1.0), (2.0, 1.0), (1.0, 1.0), (-1.0,), (1.0, math.inf), (math.nan,), ((1.0,),))
    ],
    *[(f"k={k!r}", partial(mc.TopSamples, k), "k >= 1") for k in (0, -3, 2.5, True)],
    ("name taken", partial(mc.integrate, ONE, n=10, tallies={"moments": mc.Moments()}), "another name"),
    *[(f"order={o!r}", partial(mc.Moments, order=o), "orders") for o in (1, 5, None)],
    ("vector in a histogram", partial(VECTOR, tallies={"tail": mc.TailHistogram()}), "of=mc.luminance"),
    ("vector in top samples", partial(VECTOR, tallies={"top": mc.TopSamples()}), "TopSamples needs one number"),
    ("vector in a ladder", partial(VECTOR, tallies={"c": mc.ClampLadder((1.0,))}), "ClampLadder needs one number"),
    *[
        (f"level={level}", partial(mc.Estimate([], 2, {}, 0.0, {}).interval, level), "level must lie")
        for level in (0.0, 1.0, 2.0, -0.5)
    ],
]


@pytest.mark.parametrize(("call", "match"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES])
def test_mistakes_are_refused(call, match):
    with pytest.raises(ValueError, match=re.escape(match)):
        call()


def test_a_family_larger_than_a_call_counts_its_samples():
    # One call holds at least a block of 64 rows: here each call has a part of the integrals.
    family = mc.Integrand(lambda u, item: u[0], 1)
    for n in (1, 3, 65):
        estimate = mc.integrate_each(family, 3 * 960, n=n, chunk=1)
        assert estimate.n == n and (estimate.moments[0].n == n).all()
