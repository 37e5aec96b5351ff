"""Points that are not independent: each evenly spread as it promises, each alone uniform, randomisations independent.

Statistical checks return p-values times the number of statistics (Bonferroni) and fail below 1e-6; each says how small
a fault it sees. Mutants with one known mistake fail the same checks.
"""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration import nets, stratified
from jaxmc.integration.draw import point_tables
from jaxmc.integration.samplers import GOLDEN, Index, mix, seed_words
from jaxmc.integration.tables import MOST_LATTICE, MOST_SOBOL

FAIL = 1e-6
SAMPLERS = {
    "Sobol": mc.Sobol(),
    "Halton": mc.Halton(),
    "Lattice": mc.Lattice(),
    "LatinHypercube": mc.LatinHypercube(),
    "Stratified": mc.Stratified(),
    "Jittered": mc.Stratified(correlated=False),
}
each_sampler = pytest.mark.parametrize("sampler", SAMPLERS.values(), ids=SAMPLERS)


@partial(jax.jit, static_argnames=("sampler", "raw"))
def _coordinates(seeds, high, low, dims, tables, *, sampler, raw):
    def one(seed, high, low):
        point = sampler.point(seed, Index(high, low), *tables)
        return point.bits(dims) if raw else point[dims]

    over_numbers = jax.vmap(one, (None, None, 0))
    return jax.vmap(jax.vmap(over_numbers, (None, 0, None)), (0, None, None))(seeds, high, low)


def points(sampler, numbers, dims=(0, 1), randomisations=(0,), n=64, keys=(0,), known=4096, raw=False):
    """Return coordinates, shape (keys x randomisations, numbers, dims): float64 that holds the values as they are."""
    seeds = jnp.asarray(np.stack([seed_words(int(key)) for key in keys]))
    words = (jnp.asarray(np.asarray(x, np.uint32)) for x in (randomisations, numbers, dims))
    tables = point_tables(sampler, known, n)
    u = np.asarray(_coordinates(seeds, *words, tables, sampler=sampler, raw=raw))
    return u.reshape(-1, *u.shape[2:]).astype(np.uint32 if raw else np.float64)


# Exactness.


@pytest.mark.parametrize("dim", [1, 21, 2048])
def test_plain_sobol_points_are_those_of_scipy(dim):
    n = 64
    theirs = qmc.Sobol(dim, scramble=False, bits=32).random(n)
    gray = np.arange(n) ^ (np.arange(n) >> 1)
    ours = points(mc.Sobol(scramble=False), gray, np.arange(dim), raw=True)[0]
    assert np.array_equal(ours, theirs * 2.0**32)
    values = points(mc.Sobol(scramble=False), gray, np.arange(dim))[0]
    # The middle of the last digit: what differs is a 0.
    assert np.abs(values - theirs).max() <= 2.0**-33 and (values > 0.0).all()


def test_plain_halton_points_are_those_of_scipy():
    theirs = qmc.Halton(30, scramble=False).random(5000)
    ours = points(mc.Halton(scramble=False), np.arange(5000), np.arange(30))[0]
    assert np.abs(ours - theirs).max() < (1e-6 if not jax.config.jax_enable_x64 else 1e-9)


@pytest.mark.parametrize("m", [0, 1, 8, 12])
def test_plain_lattices_meet_each_fraction_once_in_each_coordinate(m):
    dims = np.arange(MOST_LATTICE) if m <= 8 else np.array([0, 1, 2, 500, 1023])
    u = points(mc.Lattice(tent=False, shift=False), np.arange(1 << m), dims)[0]
    nearest = np.rint(u * 2.0**m)
    assert np.abs(u - nearest * 2.0**-m).max() <= 2.0**-33
    assert np.array_equal(np.sort(nearest, axis=0), np.broadcast_to(np.arange(1 << m)[:, None], u.shape))


@pytest.mark.parametrize("shift", [False, True])
def test_the_tent_folds_each_coordinate(shift):
    plain, folded = (points(mc.Lattice(tent, shift), np.arange(256), np.arange(20))[0] for tent in (False, True))
    assert np.abs(folded - (1.0 - np.abs(2.0 * plain - 1.0))).max() < 2.0**-22


# Nets.


def counts(u, shape):
    """Return how many points lie in each elementary interval, where axis k is cut into 2^shape[k]."""
    cells = np.floor(u * 2.0 ** np.array(shape)).astype(int)
    assert (cells >= 0).all() and (cells < 1 << np.array(shape)).all()
    return np.bincount(np.ravel_multi_index(cells.T, [1 << j for j in shape]), minlength=1 << sum(shape))


def shapes(m, axes):
    return [shape for shape in itertools.product(range(m + 1), repeat=axes) if sum(shape) == m]


def uneven_shapes(sampler, m, first=0):
    """Return in how many cases a net in dimensions (0, 1) has not one point in each elementary interval."""
    u = points(sampler, first + np.arange(1 << m), (0, 1), (0, 1, 5, 2**31, 2**32 - 1), keys=(0, 1, 77))
    return sum((counts(x, shape) != 1).any() for x in u for shape in shapes(m, 2))


@pytest.mark.parametrize("first", [0, 1 << 12])
@pytest.mark.parametrize("m", [6, 8])
def test_scrambled_sobol_points_are_nets(m, first):
    assert uneven_shapes(mc.Sobol(), m, first) == 0


@pytest.mark.slow
@pytest.mark.parametrize("dims", [(2, 5), (10, 31), (0, 1, 2), (3, 4, 5, 6), (700, 2047)], ids=str)
@pytest.mark.parametrize("m", [6, 8])
def test_scrambling_keeps_how_many_points_share_a_box(m, dims):
    plain = points(mc.Sobol(scramble=False), np.arange(1 << m), dims)[0]
    for u in points(mc.Sobol(), np.arange(1 << m), dims, (0, 3), keys=(1, 2)):
        for shape in shapes(m, len(dims)):
            assert np.array_equal(np.sort(counts(u, shape)), np.sort(counts(plain, shape)))


class Rounded(mc.Sobol):
    """Digits are rounded to 24 where they should be cut."""

    def point(self, seed, index, matrices):
        return _Rounded(self, seed, index, matrices)


class _Rounded(nets._SobolPoint):
    def __getitem__(self, dimension):
        return self.bits(jnp.asarray(dimension).astype(jnp.uint32)).astype(jnp.float32) * 2.0**-32


@pytest.mark.slow
def test_no_sobol_point_leaves_its_interval_by_rounding():
    with jax.enable_x64(False):
        u = points(mc.Sobol(), np.arange(1 << 22), (0,), (3,))[0]
        assert (counts(u, (22,)) == 1).all() and 0.0 < u.min() and u.max() < 1.0
        rounded = points(Rounded(), np.arange(1 << 22), (0,), (3,))[0] * (1.0 - 2.0**-24)
        assert (counts(rounded, (22,)) != 1).any()


@pytest.mark.parametrize("base", [2, 3, 5, 13])
def test_scrambled_halton_points_fall_evenly_into_intervals(base):
    dim, power = [2, 3, 5, 7, 11, 13].index(base), int(np.log(2000) / np.log(base))
    n = base**power
    for u in points(mc.Halton(), 3 * n + np.arange(n), (dim,), (0, 9), keys=(0, 5)):
        for k in range(1, power + 1):
            # A point on an edge, to rounding, may count on either side: move all of them off the edges.
            cells = np.floor(u[:, 0] * base**k + 1e-3 * base ** (k - power))
            off = np.abs(np.bincount(cells.astype(int).clip(0, base**k - 1), minlength=base**k) - base ** (power - k))
            assert off.sum() <= 4


# Scrambling.

MANY = 1 << 15  # randomisations
NUMBERS = {"first": 0, "second": 1, "later": 37, "last": 63}
DIMS = (0, 1, 2, 7, 40)


def least(p_values):
    return min(1.0, min(p_values) * len(p_values))


def chi_square(table):
    expected = table.sum() / table.size
    return stats.chi2(table.size - 1).sf(((table - expected) ** 2).sum() / expected)


def joint(x, y, bins=16):
    return chi_square(np.histogram2d(x, y, bins, [[0.0, 1.0], [0.0, 1.0]])[0])


def replicas(sampler, n=64):
    return points(sampler, list(NUMBERS.values()), DIMS, np.arange(MANY), n, known=64)


def uniform(u, sampler=None):
    """Each coordinate of each point over 32768 randomisations: sees a law whose CDF is wrong by 2.5 %."""
    return least([stats.kstest(x, "uniform").pvalue for x in u.reshape(MANY, -1).T])


def coordinates_independent(u, sampler=None):
    """Pairs of coordinates of a point in 16 x 16 cells: sees an unevenness of 7 % in root mean square."""
    pairs = itertools.combinations(range(len(DIMS)), 2)
    return least([joint(x[:, a], x[:, b]) for a, b in pairs for x in u.swapaxes(0, 1)])


def randomisations_independent(u, sampler=None):
    """One coordinate in randomisations 1, 2 and 1025 apart: sees a correlation of 4 %."""
    p_values = []
    for x in u.reshape(MANY, -1).T:
        for lag in (1, 2, 1025):
            r = np.corrcoef(x[:-lag], x[lag:])[0, 1] if np.ptp(x) else 1.0
            p_values.append(2.0 * stats.norm.sf(abs(r) * np.sqrt(MANY - lag)))
        p_values.append(joint(x[::2], x[1::2]))
    return least(p_values)


CHECKS = {
    "uniform": uniform,
    "coordinates independent": coordinates_independent,
    "randomisations independent": randomisations_independent,
}


@each_sampler
def test_each_point_is_uniform_and_randomisations_are_independent(sampler):
    u = replicas(sampler)
    assert 0.0 < u.min() and u.max() < 1.0
    assert {name: check(u) for name, check in CHECKS.items() if not check(u) > FAIL} == {}


@pytest.mark.slow
@each_sampler
def test_keys_scramble_as_randomisations_do(sampler):
    """Neighbouring keys: 4096 of them see a law whose CDF is wrong by 6 %, a correlation of 10 %."""
    u = points(sampler, (5,), (0, 3), keys=range(4096), known=64)[:, 0]
    p_values = [stats.kstest(x, "uniform").pvalue for x in u.T] + [joint(*u.T, 8)]
    p_values += [joint(x[::2], x[1::2], 8) for x in u.T]
    assert least(p_values) > FAIL


SMALL = [("LatinHypercube", 3), ("LatinHypercube", 8), ("Stratified", 7), ("Stratified", 8), ("Jittered", 7)]


@pytest.mark.parametrize(("name", "n"), SMALL)
def test_strata_are_uniform_for_any_number_of_points(name, n):
    """Counts of 12 intervals over 2^18 randomisations: sees an unevenness of 2 % or less."""
    u = points(SAMPLERS[name], (0, n - 1), (0, 1, 2), np.arange(1 << 18), n).reshape(1 << 18, -1)
    tables = [np.bincount((x * 12.0).astype(int), minlength=12) for x in u.T]
    assert least([chi_square(table) for table in tables]) > FAIL


def nested(sampler):
    """Two points that part at digit d lie independently behind that digit: 16 x 16 cells, as in ``joint``.

    Numbers 0 and 2^(d-1) do in dimension 0, and Owen's scrambling makes their later digits independent.
    """
    u = points(sampler, [0, 1, 2, 4, 8], (0,), np.arange(MANY), known=64)[..., 0]
    p_values = []
    for digit in (1, 2, 3, 4):
        scaled = u[:, [0, digit]] * 2.0**digit
        assert (np.floor(scaled[:, 0]) != np.floor(scaled[:, 1])).all()
        assert (np.floor(scaled[:, 0] / 2.0) == np.floor(scaled[:, 1] / 2.0)).all()
        p_values.append(joint(*(scaled % 1.0).T))
    return least(p_values)


def test_sobol_scrambling_is_nested_and_uniform():
    assert nested(mc.Sobol()) > FAIL


# Strata.


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 7, 64, 1000, 100_000])
def test_latin_hypercubes_meet_each_interval_once(n):
    u = points(mc.LatinHypercube(), np.arange(n), (0, 1, 2, 9, 1000), (0, 1, 2**31), n).reshape(-1, n, 5)
    cells = np.sort(np.floor(u * n).astype(int), axis=1)
    assert np.count_nonzero(cells != np.arange(n)[:, None]) == 0


def grid_of(n):
    across = int(np.ceil(np.sqrt(n)))
    return across, -(-n // across)


@pytest.mark.slow
@pytest.mark.parametrize("correlated", [True, False])
@pytest.mark.parametrize("n", [1, 7, 56, 1000, 100_000])
def test_stratified_points_share_no_cell(n, correlated):
    across, down = grid_of(n)
    assert n <= across * down < n + across
    for u in points(mc.Stratified(correlated), np.arange(n), (0, 1, 6, 7), (0, 5), n):
        for x, y in (u[:, :2].T, u[:, 2:].T):
            cells = np.floor(x * across).astype(int) * down + np.floor(y * down).astype(int)
            assert len(np.unique(cells)) == n and cells.max() < across * down


@pytest.mark.parametrize("n", [1, 7, 56, 1000, 100_000])
def test_correlated_strata_share_no_interval_in_one_coordinate(n):
    across, down = grid_of(n)
    u = points(mc.Stratified(), np.arange(n), (0, 1, 6, 7), (0, 5), n)
    intervals = np.floor(u * (across * down)).astype(int)
    assert all(len(np.unique(x)) == n for replicate in intervals for x in replicate.T)
    if n == 1000:
        jittered = points(mc.Stratified(False), np.arange(n), (0,), (0,), n)[0, :, 0]
        assert len(np.unique(np.floor(jittered * (across * down)))) < n


@partial(jax.jit, static_argnames="permute")
def _permuted(i, n, keys, permute):
    return permute(i, n, keys)


@pytest.mark.parametrize("most", [70, 1100, 70_000])
def test_permutations_meet_each_number_once(most):
    sizes = np.array([*range(1, 71)] if most == 70 else [most - 77, most // 2, 1024 * (most // 1024), most], np.uint32)
    i = np.minimum(np.arange(most), sizes[:, None] - 1).astype(np.uint32)
    for key in (0, 1, 0xDEADBEEF):
        images = np.asarray(_permuted(i, sizes[:, None], jnp.uint32(key), stratified.permute))
        assert all(np.array_equal(np.sort(row[:n]), np.arange(n)) for row, n in zip(images, sizes))


def pairs(permute, n, count=1 << 18):
    """Images of two numbers over 2^18 keys: for n = 8 the check sees an unevenness of 2 %, for n = 16 of 3 %."""
    keys = np.random.default_rng(n).integers(0, 2**32, count, np.uint32)
    ids = sorted({0, 1, n // 2, n - 1})
    images = {i: np.asarray(_permuted(jnp.uint32(i), jnp.uint32(n), keys, permute)).astype(int) for i in ids}
    p_values = []
    for i, j in itertools.combinations(ids, 2):
        table = np.bincount(images[i] * n + images[j], minlength=n * n).reshape(n, n)
        assert table.trace() == 0
        p_values.append(chi_square(table[~np.eye(n, dtype=bool)]))
    return least(p_values)


def ideal(i, n, keys):
    """A shift and a multiplication modulo a prime n: all pairs are equally likely."""
    return (i * (1 + mix(keys) % (n - 1)) + mix(keys ^ jnp.uint32(GOLDEN)) % n) % n


def rotated(i, n, keys):
    return (i + mix(keys)) % n


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8, 9, 16, 25, 31])
def test_permutations_are_near_uniform_in_pairs(n):
    assert pairs(stratified.permute, n) > FAIL


def test_permutations_that_keep_distances_fail():
    assert pairs(ideal, 31) > FAIL and pairs(rotated, 31) < FAIL


# Coordinates beyond the tables, and traced dimensions.

BEYOND = {"Sobol": MOST_SOBOL, "Halton": nets.MOST_HALTON, "Lattice": MOST_LATTICE}


@pytest.mark.parametrize("name", BEYOND)
def test_coordinates_beyond_the_tables_are_independent(name):
    """4096 points of 4 randomisations: sees a CDF that is wrong by 3 %, an unevenness over 64 cells of 7 %."""
    last = BEYOND[name]
    u = points(SAMPLERS[name], np.arange(4096), (0, last - 1, last, last + 476, 3000), range(4), known=3500)
    u = u.reshape(-1, 5)
    assert 0.0 < u.min() and u.max() < 1.0
    p_values = [stats.kstest(x, "uniform").pvalue for x in u[:, 2:].T]
    p_values += [joint(u[:, a], u[:, b], 8) for a, b in ((0, 2), (1, 2), (1, 3), (0, 4), (2, 3), (3, 4))]
    assert least(p_values) > FAIL
    # The last that is known is a net: far more even than independent numbers.
    assert np.abs(np.histogram(u[:4096, 1], 64, (0.0, 1.0))[0] - 64).max() <= (0 if name == "Sobol" else 80)


@pytest.mark.slow
@each_sampler
def test_a_dimension_may_be_a_number_traced_or_an_array(sampler):
    dims = (0, 1, 5, 700, 1500, 2047, 2048, 3000)
    tables = jax.tree.map(jnp.asarray, point_tables(sampler, 3500, 64))
    seed, word = jnp.asarray(seed_words(3)), jnp.uint32(11)

    def over(take):
        return jax.jit(lambda number: take(sampler.point(seed, Index(jnp.uint32(2), number), *tables)))(word).tolist()

    def loop(point):
        kind = point[0].dtype
        set_one = lambda k, u: u.at[k].set(point[jnp.asarray(dims)[k]])  # noqa: E731
        return jax.lax.fori_loop(0, len(dims), set_one, jnp.zeros(len(dims), kind))

    array = over(lambda point: point[jnp.asarray(dims)])
    numbers = over(lambda point: jnp.stack([point[k] for k in dims]))
    scanned = over(lambda point: jax.lax.scan(lambda c, k: (c, point[k]), 0, jnp.asarray(dims))[1])
    # Sums of floating-point digits may be contracted differently: a unit or two of the last place.
    error = 2.0**-22 if isinstance(sampler, mc.Halton) else 0.0
    assert all(np.abs(np.subtract(other, array)).max() <= error for other in (numbers, scanned, over(loop)))
    assert len(set(array)) == len(dims)


# The driver.


def smooth(u):
    """Return products over 1, 3 and 8 coordinates with mean 1, and the first coordinate."""
    c = jnp.asarray([2.0, 1.0, 1.0, 0.7, 0.5, 0.5, 0.3, 0.3])
    factors = 1.0 + c * (jnp.exp(u) - (np.e - 1.0))
    return {"value": jnp.stack([jnp.prod(factors[:k]) for k in (1, 3, 8)]), "first": u[0]}


def first_coordinate(values):
    return values["first"]


TOP = {"top": mc.TopSamples(40, of=first_coordinate)}
N, REPLICATES = 100_000, 64


@pytest.fixture(scope="module", params=SAMPLERS.values(), ids=SAMPLERS)
def run(request):
    sampler = request.param
    return sampler, mc.integrate(smooth, dim=8, n=N, sampler=sampler, replicates=REPLICATES, key=4, tallies=TOP)


@pytest.mark.slow
def test_means_are_unbiased_in_1_3_and_8_dimensions(run):
    _, estimate = run
    error, spread = estimate.mean["value"] - 1.0, estimate.stderr["value"]
    # All of them do better than independent points, in one dimension by a factor 5 or more.
    variance = estimate.variance["value"] / estimate.n
    # Rounding to float32 leaves 1e-7 or so.
    assert (np.abs(error) < 5.0 * spread + 2e-7).all() and (spread < np.sqrt(variance)).all()
    assert spread[0] < 0.2 * np.sqrt(variance[0])
    assert estimate.nonfinite == 0


def test_estimates_count_their_points(run):
    sampler, estimate = run
    power = isinstance(sampler, mc.Sobol | mc.Lattice)
    each = 2048 if power else -(-N // REPLICATES)
    assert estimate.recipe["points"] == each and estimate.recipe["replicates"] == REPLICATES
    assert estimate.n == estimate.recipe["n"] == each * REPLICATES == estimate.moments[0].n
    assert estimate.recipe["sampler"] == repr(sampler)


def test_replicates_are_estimates_of_their_own(run):
    _, estimate = run
    for means, between, pooled in zip(estimate.replicate_means, estimate.between, estimate.moments):
        assert len(means) == REPLICATES and len(np.unique(means, axis=0)) == REPLICATES
        assert np.allclose(means.mean(0), pooled.mean, rtol=1e-12, atol=0.0)
        assert np.allclose(means.var(0, ddof=1), between.variance, rtol=1e-6)
    means = estimate.replicate_means[1]
    assert abs(np.corrcoef(means[:-1].T, means[1:].T)[:3, 3:]).max() < 5.0 / np.sqrt(REPLICATES)


@pytest.mark.slow
def test_largest_samples_replay_through_draw(run):
    sampler, estimate = run
    samples = mc.draw(
        smooth, dim=8, indices=estimate["top"].index, key=4, sampler=sampler, points=estimate.recipe["points"]
    )
    assert np.array_equal(samples.index, estimate["top"].index)
    assert np.array_equal(samples.value["first"], samples.u[:, 0])
    assert np.allclose(samples.value["first"], estimate["top"].value, rtol=1e-6, atol=0.0)
    high, low = samples.index >> np.uint64(32), samples.index & np.uint64(2**32 - 1)
    assert high.max() < REPLICATES and low.max() < estimate.recipe["points"] and len(np.unique(high)) > 10


@pytest.mark.slow
@each_sampler
def test_draws_by_index_are_those_by_number(sampler):
    first = mc.draw(smooth, dim=8, n=100, sampler=sampler, key=2)
    same = mc.draw(smooth, dim=8, indices=np.arange(100), sampler=sampler, key=2, points=100)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(same)))
    if sampler.extensible:
        assert np.array_equal(mc.draw(smooth, dim=8, indices=[7, 99], sampler=sampler, key=2).u, first.u[[7, 99]])
    else:
        with pytest.raises(ValueError, match="points=estimate"):
            mc.draw(smooth, dim=8, indices=[7, 99], sampler=sampler, key=2)


@pytest.mark.slow
def test_replicate_means_are_means_of_draws(run):
    sampler, estimate = run
    each = estimate.recipe["points"]
    for replicate in (0, 63):
        indices = (np.uint64(replicate) << np.uint64(32)) + np.arange(each, dtype=np.uint64)
        samples = mc.draw(smooth, dim=8, indices=indices, sampler=sampler, key=4, points=each)
        mean = samples.value["value"].astype(np.float64).mean(0)
        assert np.allclose(mean, estimate.replicate_means[1][replicate], rtol=1e-6)


CUTS = [(1, 1), (1, 3), (130_000, 2)]
QUICK = ["Sobol"]


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in SAMPLERS])
@pytest.mark.slow
def test_results_do_not_depend_on_chunks_or_workers(name):
    def leaves(chunk, workers):
        estimate = mc.integrate(
            smooth, dim=8, n=330_000, sampler=SAMPLERS[name], replicates=5, tallies=TOP, chunk=chunk, workers=workers
        )
        return jax.tree.leaves((estimate.moments, estimate.between, estimate.replicate_means, estimate.tallies))

    first, *others = (leaves(*cut) for cut in CUTS)
    assert all(np.array_equal(a, b) for other in others for a, b in zip(first, other, strict=True))


# Images.

SPP = 256


def red(value):
    return value[..., 0]


@pytest.mark.slow
def test_images_agree_with_independent_samples_and_err_less():
    scene, camera = scenes.cornell_box(8, 8)
    render = partial(mc.render, scene, camera, bounces=2, tallies={"top": mc.TopSamples(5, of=red)})
    even, plain, long = render(spp=SPP, sampler=mc.Sobol()), render(spp=SPP), render(spp=32 * SPP, key=1)
    assert even.recipe["points"] == SPP // 4 and even.n == SPP and even.nonfinite == 0
    # The variance of independent samples bounds that of even ones well: each is counted for the reference too.
    spread = np.sqrt(long.variance / SPP + long.variance / long.n)
    assert (np.abs(even.mean - long.mean) < 5.0 * spread + 1e-6).all()
    # Pixels are independent: their mean is 8 times as exact.
    mean_spread = np.sqrt((spread**2).sum((0, 1))) / 64.0
    assert (np.abs((even.mean - long.mean).mean((0, 1))) < 5.0 * mean_spread).all()
    lower, higher = (np.square(e.mean - long.mean).sum() for e in (even, plain))
    assert lower < 0.8 * higher
    indices, values = even["top"].index, even["top"].value
    paths = mc.replay(scene, camera, indices, bounces=2, sampler=mc.Sobol(), points=even.recipe["points"])
    assert np.allclose([path.value[0] for path in paths], values, rtol=1e-4)
    assert [path.pixel[0] + 8 * path.pixel[1] for path in paths] == [int(i >> np.uint64(32)) % 64 for i in indices]


# Convergence.

SIZES = 2 ** np.arange(8, 15)


def mild(u):
    """A smooth product with mean 1: coordinate k matters like 1 / k^2."""
    k = jnp.arange(1, 9)
    return jnp.prod(1.0 + (jnp.exp(u) - (np.e - 1.0)) / k**2)


def slope(sampler):
    """Return the exponent of the error of one randomisation, by least squares, and its standard error."""
    runs = [mc.integrate(mild, dim=8, n=64 * int(n), sampler=sampler, replicates=64, key=8) for n in SIZES]
    log_error = np.array([np.log2(np.mean((run.replicate_means[0] - 1.0) ** 2)) / 2.0 for run in runs])
    x = np.log2(SIZES) - np.log2(SIZES).mean()
    # The mean of 64 squares has a relative standard deviation of sqrt(2 / 64).
    return x @ log_error / (x @ x), 0.5 / np.log(2.0) * np.sqrt(2.0 / 64.0) / np.sqrt(x @ x)


@pytest.mark.parametrize("name", ["Sobol", "Lattice"])
@pytest.mark.slow
def test_errors_of_even_points_fall_fast(name):
    exponent, error = slope(SAMPLERS[name])
    assert exponent + 3.0 * error < -1.1 and error < 0.03


@pytest.mark.slow
def test_errors_of_independent_points_fall_like_the_root():
    exponent, error = slope(mc.Independent())
    assert abs(exponent + 0.5) < 0.1 and error < 0.03


# Mutants.


class MutantSobol(mc.Sobol):
    """Sobol points up to a change in ``Point``."""

    Point = nets._SobolPoint

    def point(self, seed, index, matrices):
        return self.Point(self, seed, index, matrices)


class Multiplied(MutantSobol):
    """Digits are scrambled by a product: each depends on later ones."""

    class Point(nets._SobolPoint):
        def bits(self, dimension):
            plain = nets._SobolPoint(mc.Sobol(scramble=False), jnp.zeros(4, jnp.uint32), self.index, self.table)
            return (plain.bits(dimension) + self.key.bits(dimension)) * jnp.uint32(GOLDEN)

        def __init__(self, sampler, seed, index, matrices):
            super().__init__(sampler, seed, index, matrices)
            self.index = index


class Shifted(MutantSobol):
    """Digits are shifted alike in all points: not nested uniform."""

    class Point(Multiplied.Point):
        def bits(self, dimension):
            plain = nets._SobolPoint(mc.Sobol(scramble=False), jnp.zeros(4, jnp.uint32), self.index, self.table)
            return plain.bits(dimension) ^ self.key.bits(dimension)


class SharedKey(MutantSobol):
    """Dimensions 0 and 1 are scrambled alike."""

    def point(self, seed, index, matrices):
        point = super().point(seed, index, matrices)
        point.key = _Paired(point.key)
        return point


class _Paired:
    def __init__(self, right):
        self.right = right

    def bits(self, dimension):
        return self.right.bits(jnp.where(dimension == 1, 0, dimension))


class OneRandomisation(MutantSobol):
    """The high word of an index is dropped."""

    def point(self, seed, index, matrices):
        return super().point(seed, Index(jnp.zeros_like(index.high), index.low), matrices)


class Unpermuted(mc.LatinHypercube):
    """Point i lies in interval i of every coordinate."""

    def point(self, seed, index, n):
        return _Diagonal(self, seed, index, n)


class _Diagonal(stratified._LatinPoint):
    def __getitem__(self, dimension):
        return stratified._inside(self.number, self.own[dimension], self.table)


class SamePermutation(mc.LatinHypercube):
    """All coordinates are permuted alike."""

    def point(self, seed, index, n):
        return _Alike(self, seed, index, n)


class _Alike(stratified._LatinPoint):
    def __getitem__(self, dimension):
        stratum = stratified.permute(self.number, self.table, self.key.bits(0))
        return stratified._inside(stratum, self.own[dimension], self.table)


MUTANTS = [
    (mc.Sobol(scramble=False), "uniform"),
    (mc.Halton(scramble=False), "uniform"),
    (mc.Lattice(shift=False), "uniform"),
    (SharedKey(), "coordinates independent"),
    (Unpermuted(), "uniform"),
    (Unpermuted(), "coordinates independent"),
    (SamePermutation(), "coordinates independent"),
    (OneRandomisation(), "randomisations independent"),
    (OneRandomisation(), "uniform"),
]


@pytest.mark.parametrize(("mutant", "name"), MUTANTS, ids=lambda x: x if isinstance(x, str) else repr(x))
def test_points_with_a_mistake_fail(mutant, name):
    assert CHECKS[name](replicas(mutant)) < FAIL


def test_a_scramble_that_is_not_nested_makes_no_nets():
    assert uneven_shapes(Multiplied(), 6) > 50 and uneven_shapes(MutantSobol(), 6) == 0


def test_a_shift_of_digits_keeps_the_net_but_is_not_nested():
    assert uneven_shapes(Shifted(), 6) == 0 and nested(Shifted()) < FAIL


@pytest.mark.slow
def test_equal_replicates_claim_no_error():
    estimate = mc.integrate(smooth, dim=8, n=4096, sampler=OneRandomisation(), replicates=4)
    assert len(np.unique(estimate.replicate_means[1], axis=0)) == 1
