"""Tallies that robust means are made of, against NumPy on the same samples, whatever the way the work is cut."""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.integration import driver


class IndexPoint(NamedTuple):
    index: jax.Array

    def __getitem__(self, dimension):
        return jnp.broadcast_to(self.index, jnp.shape(dimension))


@dataclasses.dataclass(frozen=True)
class Counting(mc.Independent):
    """A sampler whose every coordinate is the low word of the sample's index."""

    def point(self, seed, index):
        return IndexPoint(index.low)


def brightest(values):
    return values.max(-1)


def integrate_table(table, **options):
    """Integrate with sample i = table[i]."""
    f = mc.Integrand(lambda u, table: table[u[0]], 1, (table,), lazy=True)
    return mc.integrate(f, n=len(table), sampler=Counting(), **options)


def integrate_columns(table, **options):
    """Integrate each column of a table of shape (samples, items, ...): sample s of item i has index s * items + i."""
    n, items = table.shape[:2]
    flat = table.reshape(n * items, *table.shape[2:])
    f = mc.Integrand(lambda u, table, item: table[u[0]], 1, (flat,), lazy=True)
    return mc.integrate_each(f, items, n=n, sampler=Counting(), **options)


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


RANDOM = np.random.default_rng(5)
TABLE = np.exp(RANDOM.normal(0.0, 3.0, (200, 7, 3))).astype(np.float32)


def bucket_means(samples, count):
    """Return count and mean of the samples with number = 0, 1, ... mod count; samples on the first axis."""
    parts = [np.asarray(samples[k::count], np.float64) for k in range(count)]
    return [len(part) for part in parts], np.stack([part.mean(0) for part in parts])


@pytest.mark.parametrize(("count", "n"), [slow(1, 131), slow(11, 200), (11, 131), slow(101, 131)])
def test_buckets_of_a_family_hold_every_so_many_samples(count, n):
    got = integrate_columns(TABLE[:n], tallies={"b": mc.Buckets(count)})["b"]
    size, mean = bucket_means(TABLE[:n], count)
    assert np.array_equal(got.count, np.broadcast_to(np.array(size)[:, None], (count, 7)))
    assert got.mean.shape == (count, 7, 3) and np.allclose(got.mean, mean, rtol=2e-6)


@pytest.mark.parametrize(("count", "n"), [slow(1, 5000), slow(3, 5000), (11, 7), (11, 150_001)])
def test_buckets_of_one_integral_do_too(count, n):
    table = np.exp(RANDOM.normal(0.0, 2.0, (n, 2))).astype(np.float32)
    got = integrate_table(table, tallies={"b": mc.Buckets(count)}, chunk=1)["b"]
    short = mc.Buckets(count, of=brightest)
    scalar = integrate_table(table, tallies={"b": short})["b"]
    if n < count:
        assert list(got.count) == [1] * n + [0] * (count - n) and np.isnan(got.mean[n:]).all()
        return
    size, mean = bucket_means(table, count)
    assert np.array_equal(got.count, size) and np.allclose(got.mean, mean, rtol=3e-6)
    assert scalar.mean.shape == (count,) and np.allclose(scalar.mean, bucket_means(table.max(1), count)[1], rtol=3e-6)


def test_buckets_of_replicates_count_from_the_start_of_each():
    table = RANDOM.random(6000).astype(np.float32)
    f = mc.Integrand(lambda u, table: table[u[0]], 1, (table,), lazy=True)
    got = mc.integrate(f, n=12_000, replicates=2, sampler=Counting(), tallies={"b": mc.Buckets(11)})["b"]
    size, mean = bucket_means(table, 11)
    assert np.array_equal(got.count, 2 * np.array(size)) and np.allclose(got.mean, mean, rtol=1e-6)


def run_part(start, stop, tallies):
    run = driver.family_run(_of_pixel, 40, 0, mc.Independent(), None, tallies, 2, None)
    list(run.passes(1, driver.Progress(None, None), lambda ranges: [[(0, start, stop)]]))
    return run


def _light(u, item):
    c = (1.0 + item) / jnp.sqrt(u[0])
    return jnp.stack([c, u[1] * c, 0.5 * c])


_of_pixel = mc.Integrand(_light, 2)
PIXEL_TALLIES = {
    "buckets": mc.Buckets(11),
    "cascade": mc.Cascade(of=mc.luminance),
    "layers": mc.Layers(of=mc.luminance),
}


@pytest.mark.parametrize("name", PIXEL_TALLIES)
def test_uneven_shards_merge_to_the_whole(name):
    tally = PIXEL_TALLIES[name]
    whole, *parts = (run_part(*cut, {name: tally}) for cut in [(0, 333), (0, 64), (64, 65), (65, 301), (301, 333)])
    state = parts[0].sums.states[name]
    for part in parts[1:]:
        state = tally.merge(state, part.sums.states[name])
    for got, want in zip(tally.result(state), tally.result(whole.sums.states[name]), strict=True):
        assert np.allclose(got, want, rtol=1e-5, atol=1e-7)
    count = "soft_count" if name == "cascade" else "count"
    assert np.sum(getattr(tally.result(whole.sums.states[name]), count)) > 0.0


@pytest.mark.parametrize("chunk", [1, slow(2**20)])
def test_pixel_tallies_do_not_depend_on_the_chunk(chunk):
    # Few samples of many integrals, then many of one.
    def run(chunk, workers):
        each = mc.integrate_each(_of_pixel, 40, n=130, tallies=PIXEL_TALLIES, chunk=chunk, workers=workers)
        one = mc.integrate(lambda u: _light(u, 0), dim=2, n=200_000, tallies=PIXEL_TALLIES, chunk=chunk)
        return jax.tree.leaves((each.tallies, one.tallies))

    assert all(np.array_equal(a, b) for a, b in zip(run(chunk, 1), run(100_000, 2), strict=True))


def cascade_weights(light, base=8.0, start=1.0, layers=6):
    """Return the weights of one sample as the paper has them, and what is left over."""
    weights = np.zeros(layers + 1)
    if light <= start:
        weights[0] = 1.0
        return weights
    lower = int(np.floor(np.log(light / start) / np.log(base)))
    if lower >= layers - 1:
        top = start * base ** (layers - 1)
        weights[-2:] = top / light, 1.0 - top / light
        return weights
    b = start * base**lower
    weights[lower] = (b / light - 1.0 / base) / (1.0 - 1.0 / base)
    weights[lower + 1] = 1.0 - weights[lower]
    return weights


@pytest.mark.parametrize("options", [{}, slow({"base": 2.0, "start": 0.1, "layers": 12}), slow({"layers": 2})], ids=str)
def test_cascade_splits_every_sample_over_two_layers(options):
    tally = mc.Cascade(of=brightest, **options)
    table = TABLE.copy()
    table[:4, 0] = [[0.0] * 3, [8.0] * 3, [1.0] * 3, [1e6] * 3]
    got = integrate_columns(table, tallies={"c": tally})["c"]
    light = table.max(-1).astype(np.float64)
    weights = np.array([[cascade_weights(L, **options) for L in row] for row in light])
    # A share is a difference of numbers up to 1: small ones have an error of their own.
    rounding = 3e-7 * table.astype(np.float64).mean(0).max()
    assert np.allclose(got.value, np.einsum("nil,nic->lic", weights, table) / 200, rtol=3e-6, atol=rounding)
    heights = tally.start * tally.base ** np.arange(tally.layers)
    soft = np.einsum("nil,ni->il", weights[..., :-1], light).T / heights[:, None]
    assert np.allclose(got.soft_count, soft, rtol=3e-6, atol=3e-5)
    assert np.allclose(got.value.sum(0), table.astype(np.float64).mean(0), rtol=3e-6)
    # One soft count for each sample but those below the lowest layer.
    bright = light >= tally.start
    assert np.allclose(
        got.soft_count.sum(0), bright.sum(0) + np.where(bright, 0, light).sum(0) / tally.start, rtol=1e-5
    )


def test_cascade_and_layers_of_one_integral():
    table = TABLE[:, 0, 0]
    tallies = {"c": mc.Cascade(), "l": mc.Layers((0.0, 1.0, 10.0))}
    one = integrate_table(table, tallies=tallies)
    each = integrate_columns(table[:, None], tallies=tallies)
    for name in tallies:
        for got, want in zip(one[name], each[name], strict=True):
            assert np.allclose(got, want[:, 0] if np.ndim(want) > 1 else want, rtol=3e-6)
    assert one["c"].value.shape == (7,) and one["l"].count.tolist() == each["l"].count[:, 0].tolist()


def test_layers_count_and_sum_by_brightness():
    edges = (0.0, 1.0, 4.0, 300.0)
    got = integrate_columns(TABLE, tallies={"l": mc.Layers(edges, of=brightest)})["l"]
    light, bin_index = TABLE.max(-1), np.searchsorted(edges, TABLE.max(-1), side="right") - 1
    for j in range(4):
        inside = bin_index == j
        assert np.array_equal(got.count[j], inside.sum(0))
        assert np.allclose(got.value[j], np.where(inside[..., None], TABLE, 0).mean(0, dtype=float), rtol=3e-6)
        assert np.allclose(got.total[j], np.where(inside, light, 0).sum(0, dtype=float), rtol=3e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_not_lost(bad):
    table = TABLE[:, :2].copy()
    table[17, 1, :] = bad
    got = integrate_columns(table, tallies=PIXEL_TALLIES)
    for sums in (got["buckets"].mean.swapaxes(0, 1), got["cascade"].value.sum(0), got["layers"].value[-1]):
        assert np.isfinite(sums[0]).all()
    assert not np.isfinite(got["buckets"].mean[17 % 11, 1]).any() and np.isfinite(got["buckets"].mean[0, 1]).all()
    assert not np.isfinite(got["cascade"].value.sum(0)[1]).any()
    assert not np.isfinite(got["layers"].value[-1, 1]).any() and np.isfinite(got["layers"].value[:-1]).all()


@pytest.mark.parametrize("filter", [None, slow(mc.TentFilter())], ids=["none", "tent"])
def test_pixel_tallies_render(filter):
    camera = mc.PinholeCamera((0, 0, 4), (0, 0, 0), (0, 1, 0), 40.0, 8, 6)
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Diffuse((0.2, 0.5, 0.8)))], sky=1.0)
    grey = mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Diffuse(0.5))], sky=1.0)
    got = mc.render(scene, camera, spp=20, bounces=1, tallies=PIXEL_TALLIES, filter=filter)
    mean = mc.render(scene, camera, spp=20, bounces=1).mean.reshape(48, 3)
    assert np.allclose(got["cascade"].value.sum(0), mean, rtol=1e-5)
    assert np.allclose(got["layers"].value.sum(0), mean, rtol=1e-5)
    assert np.allclose((got["buckets"].mean * got["buckets"].count[..., None]).sum(0) / 20, mean, rtol=1e-5)
    got = mc.render(grey, camera, spp=20, bounces=1, tallies=PIXEL_TALLIES, filter=filter)
    assert np.allclose(got["cascade"].value.sum(0), mean[:, 1], rtol=1e-5)


BAD = [
    *[(f"buckets {count!r}", partial(mc.Buckets, count), "odd positive") for count in (0, 2, -3, 2.5, True)],
    ("base 1", partial(mc.Cascade, base=1.0), "base > 1"),
    ("start 0", partial(mc.Cascade, start=0.0), "start > 0"),
    ("one layer", partial(mc.Cascade, layers=1), "layers >= 2"),
    *[(f"edges {e}", partial(mc.Layers, e), "edges must be") for e in ((0.0,), (1.0, 2.0), (0, 2, 1), (0, np.inf))],
    ("a vector", partial(integrate_columns, TABLE, tallies={"c": mc.Cascade()}), "of=mc.luminance"),
    ("a vector in layers", partial(integrate_columns, TABLE, tallies={"c": mc.Layers()}), "of=mc.luminance"),
    (
        "a tree",
        lambda: mc.integrate(lambda u: {"a": u[0]}, dim=1, n=4, tallies={"b": mc.Buckets()}),
        "the integrand returns a tree",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("call", "match"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_mistakes_are_refused(call, match):
    with pytest.raises(ValueError, match=match):
        call()
