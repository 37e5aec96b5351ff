"""Tables behind the quasi-Monte Carlo samplers: Sobol' matrices, a lattice vector and primes.

``data/README.md`` says where the numbers come from. Arrays are made once, shared and read-only.
"""

from functools import cache
from importlib import resources

import numpy as np

from .counts import is_count

BITS = 32
MOST_SOBOL, MOST_LATTICE = 2048, 1024  # dimensions in the files


def sobol_matrices(dim: int) -> np.ndarray:
    """Return the first ``dim`` generating matrices of the Sobol' sequence, uint32, shape ``(dim, 32)``.

    Column j of a row belongs to bit j, from the least significant, of the point's number. It is the direction number
    as a 32-bit binary fraction: 2^31, 2^30, ... in dimension 0. A coordinate is the XOR of the columns of the bits set.
    Raises ValueError unless ``dim`` is an integer from 1 to 2048.
    """
    return _first(_all_sobol_matrices(), dim, "the table of Sobol' direction numbers")


def lattice_vector(dim: int) -> np.ndarray:
    """Return the first ``dim`` entries of a lattice's generating vector, odd numbers below 2^20, uint32.

    The same vector serves 2^m points for every m from 8 to 20. Raises ValueError unless ``dim`` is an integer from 1 to
    1024.
    """
    return _first(_whole_lattice_vector(), dim, "the lattice's generating vector")


def primes(dim: int) -> np.ndarray:
    """Return the first ``dim`` primes, uint32, shape ``(dim,)``: the bases of a Halton sequence.

    Raises ValueError unless ``dim`` is an integer from 1 to 6542, the number of primes below 2^16.
    """
    return _first(_primes_below(1 << 16), dim, "the table of primes below 2^16")


def _first(table, dim, name):
    if not is_count(dim, most=len(table)):
        raise ValueError(
            f"{name} holds dimensions 1 to {len(table)}, got dim={dim!r}: "
            "ask for fewer and take the remaining coordinates from the independent sampler"
        )
    return table[:dim]


def _read_only(array):
    array.setflags(write=False)
    return array


@cache
def _all_sobol_matrices():
    """Run Sobol's recurrence in all dimensions (P. Bratley and B. L. Fox, ACM Trans. Math. Softw. 14, 1988).

    With the polynomial x^s + a_1 x^(s-1) + ... + a_s, the direction number v_k, as a binary fraction, is
    m_k 2^-k for k <= s, then the XOR of v_(k-s) 2^-s and of those a_l v_(k-l), l = 1 to s, with a_l = 1.
    """
    with (resources.files(__package__) / "data/joe_kuo.npz").open("rb") as file, np.load(file) as table:
        polynomial, initial = table["polynomial"].astype(np.uint32), table["initial"].astype(np.uint32)
    columns = np.zeros((BITS, len(polynomial)), np.uint32)
    columns[: initial.shape[1]] = initial.T << np.arange(BITS - 1, BITS - 1 - initial.shape[1], -1, np.uint32)[:, None]
    degree = np.frexp(polynomial)[1] - 1
    for s in range(1, degree.max() + 1):
        rows = np.flatnonzero(degree == s)
        for k in range(s, BITS):
            columns[k, rows] = columns[k - s, rows] >> np.uint32(s)
            for l in range(1, s + 1):
                columns[k, rows] ^= (polynomial[rows] >> np.uint32(s - l) & 1) * columns[k - l, rows]
    columns[:, 0] = np.uint32(1) << np.arange(BITS - 1, -1, -1, np.uint32)  # van der Corput's: no polynomial
    return _read_only(np.ascontiguousarray(columns.T))


@cache
def _whole_lattice_vector():
    with (resources.files(__package__) / "data/lattice.npy").open("rb") as file:
        vector = np.load(file)
    # Continue the digits at random: the search fixed 20, and without more the points of longer lattices would be worse.
    digits = np.random.default_rng(20).integers(0, 1 << (BITS - 20), len(vector), np.uint32)
    return _read_only(vector | digits << np.uint32(20))


@cache
def _primes_below(limit):
    prime = np.ones(limit, bool)
    prime[:2] = False
    for p in range(2, int(limit**0.5) + 1):
        prime[p * p :: p] = False  # a composite p strikes out nothing new
    return _read_only(np.flatnonzero(prime).astype(np.uint32))
