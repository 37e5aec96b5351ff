"""Importance maps: changes of variables that keep the integral, and lower the variance by as much as is claimed."""

import math
import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import jaxmc as mc
from jaxmc.integration import adaptive
from jaxmc.integration.adaptive import ImportanceMap, adapt
from jaxmc.integration.combine import combine
from jaxmc.testing import assert_unbiased


def random_map(dim, bins, strata=None, seed=0):
    rng = np.random.default_rng(seed)
    width = rng.random((dim, bins)) + 0.05
    edges = np.cumsum(np.pad(width / width.sum(1, keepdims=True), ((0, 0), (1, 0))), axis=1)
    edges[:, -1] = 1.0
    if strata is None:
        return ImportanceMap(jnp.asarray(edges, jnp.float32))
    p = rng.random(strata) + 0.1
    cells = np.cumsum(p / p.sum()).reshape(strata)
    cells.flat[-1] = 1.0
    return ImportanceMap(jnp.asarray(edges, jnp.float32), jnp.asarray(cells, jnp.float32))


MAPS = [(5, 16, None), (1, 5, (6,)), (3, 10, (2, 3, 4)), (9, 100, (7, 5))]
IDS = ["5D", "strata 1D", "strata 3D", "strata in 2 of 9"]


# The change of variables.


@pytest.mark.slow
@pytest.mark.parametrize("shape", MAPS, ids=IDS)
def test_the_jacobian_is_the_determinant_of_the_derivative(shape):
    importance_map = random_map(*shape)
    u = jnp.asarray(np.random.default_rng(1).random((200, shape[0])), jnp.float32)
    derivative = jax.jit(jax.vmap(jax.jacfwd(lambda u: importance_map(u)[0])))(u)
    x, jacobian = jax.jit(jax.vmap(importance_map))(u)
    assert np.allclose(np.linalg.det(np.asarray(derivative, float)), jacobian, rtol=2e-6)
    assert ((x > 0.0) & (x < 1.0)).all()


def peak(u, center, width):
    return jnp.exp(-0.5 * (((u - center) / width) ** 2).sum())


def peak_integral(dim, center, width):
    a, b = -center / (width * math.sqrt(2.0)), (1.0 - center) / (width * math.sqrt(2.0))
    return (width * math.sqrt(math.pi / 2.0) * (special.erf(b) - special.erf(a))) ** dim


class WithoutWeight(ImportanceMap):
    """A mutant: the jacobian lacks V / p."""

    def __call__(self, u):
        return super().__call__(u)[0], super().__call__(u)[1] / adaptive._stratify(self.cells, u)[1]


class NextBin(ImportanceMap):
    """A mutant: the jacobian is that of the next bin."""

    def __call__(self, u):
        y, weight, _ = adaptive._stratify(self.cells, u)
        x, _, i = adaptive._warp(self.edges, y)
        width = jnp.diff(self.edges)[jnp.arange(len(u)), (i + 1) % (self.edges.shape[1] - 1)]
        return x, weight * jnp.prod(width * (self.edges.shape[1] - 1))


class NextCell(ImportanceMap):
    """A mutant: the weight is that of the next cell."""

    def __call__(self, u):
        _, weight, cell = adaptive._stratify(self.cells, u)
        p = jnp.diff(self.cells.ravel(), prepend=0.0)
        x, jacobian = super().__call__(u)
        return x, jacobian / weight / (p[(cell + 1) % p.size] * p.size)


MUTANTS = [WithoutWeight, NextBin, NextCell]
for mutant in MUTANTS:
    jax.tree_util.register_dataclass(mutant, data_fields=["edges", "cells"], meta_fields=[])


def one_and_peak(u):
    return jnp.stack([1.0, peak(u, 0.3, 0.3)])


def check_integrals(change, shape):
    """Integrate 1, and a peak that is not symmetric, through a map of class ``change``."""
    integrand = one_and_peak_through(change, shape)
    assert_unbiased(mc.integrate(integrand, n=2**18), [1.0, peak_integral(shape[0], 0.3, 0.3)], 0.05)


def one_and_peak_through(change, shape=(3, 10, (2, 3, 4))):
    importance_map = random_map(*shape)
    return mc.Integrand(one_and_peak, shape[0]).through(change(importance_map.edges, importance_map.cells))


@pytest.mark.parametrize("shape", MAPS, ids=IDS)
def test_the_map_keeps_integrals(shape):
    check_integrals(ImportanceMap, shape)


@pytest.mark.parametrize("mutant", MUTANTS)
def test_wrong_maps_are_seen(mutant):
    with pytest.raises(AssertionError, match="standard errors off"):
        check_integrals(mutant, (3, 10, (2, 3, 4)))


def test_changes_of_variables_of_two_classes_never_share_a_kernel():
    integrands = [one_and_peak_through(change) for change in (ImportanceMap, *MUTANTS)]
    structures = [jax.tree.structure(f) for f in integrands]
    assert all((a == b) == (i == j) for i, a in enumerate(structures) for j, b in enumerate(structures))


@pytest.mark.parametrize("shape", [(2, 513, None), (2, 513, (255, 257)), (1, 3, (65536,))])
def test_points_stay_inside_and_in_order(shape):
    dim, _, strata = shape
    importance_map = random_map(*shape)
    below = np.float32(1.0 - 2.0**-24)
    special_points = [np.float32(2.0**-33), below, *np.linspace(0.0, 1.0, 514, dtype=np.float32)[1:-1]]
    if strata:
        ends = np.asarray(importance_map.cells).ravel()[:-1]
        special_points += [*ends[::7], *np.nextafter(ends[::7], np.float32(0.0))]
    u = np.unique(np.array(special_points, np.float32))
    x, jacobian = jax.jit(jax.vmap(importance_map))(jnp.asarray(np.repeat(u[:, None], dim, axis=1)))
    assert (x > 0.0).all() and (x < 1.0).all() and (jacobian > 0.0).all() and np.isfinite(jacobian).all()
    if dim == 1 or not strata:
        assert (np.diff(x, axis=0) >= 0.0).all()


def test_jacobians_do_not_underflow_on_the_way():
    slopes = np.array([2e-6] * 9 + [2.0 - 2e-6] * 9)
    steep = adaptive._product(jnp.array([1e-6] * 9 + [1e5] * 9))
    assert float(steep) == pytest.approx(1e-9, rel=1e-5)
    assert float(adaptive._product(jnp.asarray(slopes[5:]))) == pytest.approx(np.prod(slopes[5:]), rel=1e-5)


# What is learnt.

GAUSS = mc.Integrand(peak, 8, (0.4, 0.1))


@pytest.fixture(scope="module")
def learnt():
    return adapt(GAUSS)


def relative_variance(f, n=2**18, exact=None):
    estimate = mc.integrate(f, n=n, key=1)
    if exact is not None:
        assert_unbiased(estimate, exact, 0.02)
    return estimate.variance / estimate.mean**2


def test_a_peak_in_eight_dimensions(learnt):
    exact = peak_integral(8, 0.4, 0.1)
    plain = peak_integral(8, 0.4, 0.1 / math.sqrt(2.0)) / exact**2 - 1.0
    through_map = relative_variance(GAUSS.through(learnt), exact=exact)
    without = relative_variance(GAUSS.through(adapt(GAUSS, strata=False)), exact=exact)
    # Measured: 3512 without a map, 0.24 through it, 0.21 without strata.
    assert max(through_map, without) * 30.0 < plain and max(through_map, without) < 0.5


def ridge(u, width):
    """A ridge along the diagonal."""
    middle = u.mean()
    return jnp.exp(-0.5 * ((u - middle) ** 2).sum() / width**2 - 0.5 * ((middle - 0.5) / 0.2) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize(("dim", "width", "gain"), [(2, 0.02, 20.0), (4, 0.05, 10.0)])
def test_strata_follow_a_diagonal(dim, width, gain):
    f = mc.Integrand(ridge, dim, (width,))
    separable, stratified = (f.through(adapt(f, strata=strata)) for strata in (False, True))
    a, b = mc.integrate(separable, n=2**18, key=1), mc.integrate(stratified, n=2**18, key=2)
    assert abs(a.mean - b.mean) < 5.0 * math.hypot(a.stderr, b.stderr) < 0.2 * b.mean
    # Measured: 37 and 38 times.
    assert b.variance * gain < a.variance


class EvenFirst(mc.Independent):
    """The first coordinate of 2^16 samples is stratified, as it is in a net or a lattice."""

    def point(self, seed, index):
        point = super().point(seed, index)

        class Even:
            def __getitem__(self, k):
                even = (index.low.astype(jnp.float32) + point[k]) / 2.0**16
                return jnp.where(k == 0, even, point[k])

        return Even()


EVEN, INDEPENDENT = EvenFirst(), mc.Independent()


@pytest.mark.slow
def test_even_first_coordinates_share_samples_out():
    f = mc.Integrand(ridge, 2, (0.02,))
    g = f.through(adapt(f))
    means = [[mc.integrate(g, n=2**16, key=k, sampler=s).mean for k in range(24)] for s in (EVEN, INDEPENDENT)]
    # Measured: 6 times less variance of the mean than from independent points; 23 degrees of freedom.
    assert np.var(means[0]) * 2.0 < np.var(means[1])


@pytest.mark.slow
def test_vectors_and_pytrees_share_a_map():
    def fn(u):
        return {"a": peak(u, 0.2, 0.05), "b": jnp.stack([peak(u, 0.8, 0.05), 0.0])}

    f = mc.Integrand(fn, 2)
    estimate = mc.integrate(f.through(adapt(f)), n=2**18, key=1)
    assert abs(estimate.mean["a"] - peak_integral(2, 0.2, 0.05)) < 5.0 * estimate.stderr["a"] < 0.02
    assert abs(estimate.mean["b"][0] - peak_integral(2, 0.8, 0.05)) < 5.0 * estimate.stderr["b"][0] < 0.02
    plain = peak_integral(2, 0.2, 0.05 / math.sqrt(2.0)) - peak_integral(2, 0.2, 0.05) ** 2
    assert estimate.variance["a"] * 10.0 < plain and estimate.variance["b"][0] * 10.0 < plain


def test_maps_are_deterministic(learnt):
    again, other = adapt(GAUSS), adapt(GAUSS, key=1)
    assert np.array_equal(learnt.edges, again.edges) and np.array_equal(learnt.cells, again.cells)
    assert not np.array_equal(learnt.edges, other.edges)


def test_bins_keep_their_width():
    f = mc.Integrand(lambda u: jnp.where(jnp.abs(u[0] - 0.9) < 1e-5, 1e15, 1e-25), 1)
    learnt = adapt(f, n=5000, iterations=30, bins=400, alpha=1.5)
    edges = np.asarray(learnt.edges)
    assert (np.diff(edges) > 0.0).all() and edges[0, 0] == 0.0 and edges[0, -1] == 1.0
    assert (np.diff(np.asarray(learnt.cells).ravel(), prepend=0.0) > 0.0).all()


def partly_bad(u, scale, bad):
    return scale * jnp.where(u[1] < 0.01, bad, peak(u, 0.4, 0.1))


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_scale_of_values_does_not_matter(scale):
    plain, scaled = (adapt(mc.Integrand(partly_bad, 2, (factor, 0.0))) for factor in (1.0, scale))
    assert np.allclose(plain.edges, scaled.edges, atol=2e-3)  # small values lose digits at 1e-38


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_ignored_and_told(bad):
    with pytest.warns(UserWarning, match=r"[1-9][\d,]* of 200,000 values were not finite") as told:
        learnt = adapt(mc.Integrand(partly_bad, 2, (1.0, bad)))
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = adapt(mc.Integrand(partly_bad, 2, (1.0, 0.0)))
    assert np.array_equal(learnt.edges, right.edges) and np.array_equal(learnt.cells, right.cells)


@pytest.mark.parametrize("options", [{"iterations": 1}, {"n": 1}, {"n": 20}, {"alpha": 0.0}, {"bins": 1}])
def test_small_runs_make_maps(options):
    learnt = adapt(lambda u: u[0] * u[1], dim=2, **{"n": 500, "strata": (2, 3), **options})
    adaptive._check(np.asarray(learnt.edges), np.asarray(learnt.cells))
    if options == {"alpha": 0.0}:
        assert np.allclose(np.diff(learnt.edges), 1.0 / 8.0, atol=1e-6)


def test_nothing_to_learn_leaves_the_map_even():
    learnt = adapt(lambda u: 0.0 * u[0], dim=2, n=1000, strata=(3, 3))
    assert np.allclose(np.diff(learnt.edges), 1.0 / 8.0) and np.allclose(np.diff(learnt.cells.ravel()), 1.0 / 9.0)


# As an integrand.


@pytest.mark.slow
def test_gradients_flow_through_parameters(learnt):
    points = mc.draw(GAUSS, n=2**16, key=3).u

    def mean(width):
        return mc.Integrand(peak, 8, (0.4, width)).through(learnt).batch(points).mean()

    value, slope = jax.value_and_grad(mean)(0.1)
    step = 1e-4
    exact = (peak_integral(8, 0.4, 0.1 + step) - peak_integral(8, 0.4, 0.1 - step)) / (2.0 * step)
    assert float(value) == pytest.approx(peak_integral(8, 0.4, 0.1), rel=0.02)
    assert float(slope) == pytest.approx(exact, rel=0.05)


def test_other_maps_do_not_recompile(learnt):
    calls = []

    def fn(u):
        calls.append(1)
        return peak(u, 0.4, 0.1)

    f = mc.Integrand(fn, 8)
    mc.integrate(f.through(learnt), n=100)
    seen = len(calls)
    other = ImportanceMap(learnt.edges[::-1], learnt.cells)
    mc.integrate(f.through(other), n=100)
    assert len(calls) == seen > 0


def test_families_keep_their_number(learnt):
    f = mc.Integrand(lambda u, width, item: (1.0 + item) * peak(u, 0.4, width), 8, (0.1,))
    estimate = mc.integrate_each(f.through(learnt), 3, n=2**14)
    assert_unbiased(estimate, peak_integral(8, 0.4, 0.1) * np.arange(1.0, 4.0), 0.02)


# Files.


@pytest.mark.parametrize("strata", [None, (4, 3)])
def test_maps_come_back_from_files(tmp_path, strata):
    saved = random_map(3, 20, strata)
    path = tmp_path / "map.npz"
    for _ in range(2):
        saved.save(path)
    back = ImportanceMap.load(str(path))
    assert [p.name for p in tmp_path.iterdir()] == ["map.npz"]
    assert np.array_equal(back.edges, saved.edges) and (back.cells is None) == (strata is None)
    if strata:
        assert np.array_equal(back.cells, saved.cells) and back.cells.shape == strata


GOOD = np.array([[0.0, 0.5, 1.0]])
FILES = {
    "not floating": {"edges": np.array([[0, 1]])},
    "missing": {"edge": GOOD},
    "run from": {"edges": GOOD[0]},
    "run from 0 to 1": {"edges": GOOD + 0.1},
    "do not increase in": {"edges": np.array([[0.0, np.nan, 1.0]])},
    "do not increase": {"edges": np.array([[0.0, 0.5, 0.5 + 1e-17, 1.0]])},
    "do not fit": {"edges": GOOD, "cells": np.ones((1, 1))},
    "increase to 1": {"edges": GOOD, "cells": np.array([0.6, 0.5, 1.0])},
    "cells do not": {"edges": GOOD, "cells": np.array([0.5, 0.9])},
    "pickle": {"edges": np.array([None])},
}


@pytest.mark.parametrize("reason", FILES)
def test_bad_files_are_refused(tmp_path, reason):
    path = tmp_path / "bad.npz"
    np.savez(path, **FILES[reason])
    with pytest.raises(ValueError, match=f"bad.npz is no importance map: .*{reason}.*; load what"):
        ImportanceMap.load(path)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04 cut short"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="no importance map"):
        ImportanceMap.load(path)
    np.save(tmp_path / "plain.npy", GOOD)
    with pytest.raises(ValueError, match="no importance map"):
        ImportanceMap.load(tmp_path / "plain.npy")
    with pytest.raises(FileNotFoundError):
        ImportanceMap.load(tmp_path / "none.npz")


# Combinations.


def spikes(u, item):
    """A few narrow peaks of equal height on a dim floor."""
    return 0.1 * u[0] + sum(peak(u, c, 0.01) for c in (0.13, 0.37, 0.62, 0.91))


SPIKES = 0.05 + 4.0 * 2.0 * math.pi * 0.01**2


def test_inverse_variance_loses_fireflies():
    # 10 estimates of 500 samples each, 2000 times.
    estimates = [mc.integrate_each(mc.Integrand(spikes, 2), 2000, n=500, key=key) for key in range(10)]
    pooled, weighted = (combine(estimates, rule) for rule in ("pooled", "inverse variance"))

    def deviation(means):
        return (means.mean() - SPIKES) / (means.std() / math.sqrt(means.size))

    assert abs(deviation(pooled.mean)) < 5.0 and deviation(weighted.mean) < -20.0
    assert pooled.mean.std() == pytest.approx(np.sqrt((pooled.stderr**2).mean()), rel=0.1)


def line(u, slope):
    return 0.5 + slope * (u[0] - 0.5)


LINE = mc.Integrand(line, 1, (1.0,))


def test_combinations_by_hand():
    a = mc.integrate(LINE, n=1000, key=1)
    b = mc.integrate(LINE, n=3000, key=2)
    pooled, weighted = combine([a, b]), combine([a, b], "inverse variance")
    assert pooled.mean == pytest.approx(0.25 * a.mean + 0.75 * b.mean, rel=1e-12)
    assert pooled.stderr == pytest.approx(math.hypot(0.25 * a.stderr, 0.75 * b.stderr), rel=1e-12)
    wa, wb = a.stderr**-2, b.stderr**-2
    assert weighted.mean == pytest.approx((wa * a.mean + wb * b.mean) / (wa + wb), rel=1e-12)
    assert weighted.stderr == pytest.approx((wa + wb) ** -0.5, rel=1e-12)
    sure = mc.integrate(mc.Integrand(line, 1, (0.0,)), n=10, key=3)
    assert combine([a, sure], "inverse variance") == (0.5, 0.0)


# Mistakes.

PLANE = mc.Integrand(lambda u: u[0], 2)
A, B = (partial(mc.integrate, f, n=10, key=k) for f, k in ((PLANE, 0), (mc.Integrand(lambda u: u, 2), 1)))
MISTAKES = [
    *[(f"{k}={v!r}", partial(adapt, PLANE, **{k: v}), k) for k, v in [("n", 0), ("iterations", 2.5), ("bins", -1)]],
    *[(f"alpha={a}", partial(adapt, PLANE, alpha=a), "alpha from 0 to 2") for a in (-0.1, 2.5, math.nan)],
    *[(f"strata={s}", partial(adapt, PLANE, strata=s), "strata") for s in ((), (2, 2, 2), (0,), 5, (300, 300), (2.5,))],
    ("bins", partial(adapt, PLANE, bins=1 << 16), "below 2^16"),
    ("key", partial(adapt, PLANE, key=-1), "key must be"),
    ("no dim", partial(adapt, lambda u: u[0]), "dimension"),
    ("no map", partial(PLANE.through, 3), "change of variables"),
    ("other dim", partial(PLANE.through, random_map(3, 4)), "dim=3"),
    ("nothing", partial(combine, []), "one shape"),
    ("rule", lambda: combine([A()], "median"), "rule must"),
    ("shapes", lambda: combine([A(), B()]), "one shape"),
    ("tree", lambda: combine([mc.integrate(lambda u: {"a": u[0]}, dim=1, n=10)]), "one shape"),
    ("one key", lambda: combine([A(), A()]), "independent"),
]


@pytest.mark.parametrize(("call", "match"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES])
def test_mistakes_are_refused(call, match):
    with pytest.raises(ValueError, match=match.replace("^", r"\^")):
        call()
