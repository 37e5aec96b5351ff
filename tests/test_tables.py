"""The tables of the quasi-Monte Carlo samplers: each check passes on the table and fails on a mutant of it."""

import warnings

import numpy as np
import pytest
from scipy.stats import qmc

from jaxmc.integration.tables import MOST_LATTICE, MOST_SOBOL, lattice_vector, primes, sobol_matrices


def differing_points(matrices, first=0, count=64):
    """Return how many of SciPy's points, numbers ``first`` on, differ from those of the matrices, shape (dim, 32)."""
    number = np.arange(first, first + count, dtype=np.uint32)
    bits = (number ^ number >> 1)[:, None] >> np.arange(32, dtype=np.uint32) & 1  # SciPy's order: Gray code
    ours = np.bitwise_xor.reduce(bits[:, None] * matrices, axis=-1)
    theirs = qmc.Sobol(len(matrices), scramble=False, bits=32)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties")
        theirs = (theirs.fast_forward(first) if first else theirs).random(count)
    return np.count_nonzero(np.any(ours != np.rint(theirs * 2.0**32).astype(np.uint32), axis=1))


@pytest.mark.parametrize("dim", [1, 10, 1111, 2048])
def test_sobol_points_are_those_of_scipy(dim):
    assert sobol_matrices(dim).shape == (dim, 32) and sobol_matrices(dim).dtype == np.uint32
    assert differing_points(sobol_matrices(dim)) == 0


def test_later_columns_of_the_sobol_matrices_are_those_of_scipy():
    assert differing_points(sobol_matrices(10), first=(1 << 22) - 32) == 0


def test_shuffled_rows_of_the_sobol_table_are_not_those_of_scipy():
    assert differing_points(np.roll(sobol_matrices(10), 1, axis=0)) > 32


def is_unit_triangular(matrices):
    """Tell whether column j ends in binary digit j + 1: then every block of leading digits is nonsingular."""
    last = np.uint32(1) << np.arange(31, -1, -1, dtype=np.uint32)
    return bool(np.all(matrices & last) and not np.any(matrices & (last - 1)))


def test_each_sobol_dimension_alone_is_a_0_1_sequence():
    matrices = sobol_matrices(MOST_SOBOL)
    assert np.array_equal(matrices[0], 2 ** np.arange(31, -1, -1)) and len(np.unique(matrices, axis=0)) == MOST_SOBOL
    assert is_unit_triangular(matrices)
    assert not is_unit_triangular(np.roll(matrices, 1, axis=1)) and not is_unit_triangular(matrices >> 1)


def covers_the_grid(vector, m):
    """Tell whether the lattice of 2^m points meets every multiple of 2^-m once in each coordinate."""
    points = np.arange(1 << m, dtype=np.uint32)[:, None] * vector & (1 << m) - 1
    return bool(np.all(np.sort(points, axis=0) == np.arange(1 << m)[:, None]))


def test_lattice_entries_are_odd_and_distinct():
    vector = lattice_vector(MOST_LATTICE) % (1 << 20)
    assert vector.dtype == np.uint32 and vector.shape == (MOST_LATTICE,)
    assert np.all(vector % 2 == 1)
    # No two coordinates are equal or mirror images of each other.
    assert len(np.unique(np.minimum(vector, (1 << 20) - vector))) == MOST_LATTICE


@pytest.mark.parametrize("m", [8, 10, 13])
def test_lattice_coordinates_cover_the_grid_once(m):
    vector = lattice_vector(256) % (1 << 20)
    assert covers_the_grid(vector, m)
    mutant = vector.copy()
    mutant[100] += 1
    assert not covers_the_grid(mutant, m)


def worst_case_error(vector, m):
    """Return e_m of the weighted Korobov space by its definition; tools/lattice_vector.py gives the formula."""
    x = np.outer(np.arange(1 << m), vector.astype(np.int64)) % (1 << m) / (1 << m)
    kernel = 1 + 0.1 / np.arange(1, len(vector) + 1) * 2 * np.pi**2 * (x * x - x + 1 / 6)
    return np.sqrt(kernel.prod(axis=1).mean() - 1)


def gain(vector):
    """Return the worst-case error of random odd vectors over that of ``vector``, a geometric mean over m = 8 to 14."""
    random = np.random.default_rng(3)
    rivals = [random.integers(0, 1 << 19, len(vector)) * 2 + 1 for _ in range(5)]
    ratios = [[worst_case_error(z, m) / worst_case_error(vector, m) for z in rivals] for m in range(8, 15)]
    return np.exp(np.mean(np.log(ratios)))


@pytest.mark.parametrize("dim, least", [(8, 1.8), (32, 1.6)])
def test_lattice_beats_random_odd_vectors(dim, least):
    vector = lattice_vector(dim) % (1 << 20)
    assert gain(vector) > least
    mutants = np.random.default_rng(4).integers(0, 1 << 19, (4, dim)) * 2 + 1
    assert all(gain(mutant) < least for mutant in mutants)
    mutant = vector.copy()
    mutant[2] = mutant[1]
    assert gain(mutant) < least


def test_primes():
    found = primes(6542)
    assert found.dtype == np.uint32 and found[:6].tolist() == [2, 3, 5, 7, 11, 13]
    assert found[999] == 7919 and found[-1] == 65521 and np.all(np.diff(found.astype(int)) > 0)


@pytest.mark.parametrize("table, most", [(sobol_matrices, MOST_SOBOL), (lattice_vector, MOST_LATTICE), (primes, 6542)])
def test_tables_are_shared_and_refuse_dimensions_that_they_do_not_hold(table, most):
    assert len(table(np.int64(3))) == 3 and len(table(most)) == most
    assert np.shares_memory(table(3), table(4))
    with pytest.raises(ValueError, match="read-only"):
        table(3)[0] = 0
    for dim in (0, -1, most + 1, 2.0, True, None):
        with pytest.raises(ValueError, match=rf"1 to {most}, got dim={dim!r}: ask for fewer"):
            table(dim)
