"""Build ``jaxmc/integration/data/lattice.npy``: ``python tools/lattice_vector.py [--check]``.

The file holds a generating vector z, odd integers below 2^20, shape (1024,), uint32. For every n = 2^m, m = 8 to 20,
and every d <= 1024 the points {k z_j / n}, k = 0 to n - 1, j = 1 to d, are a rank-1 lattice, and those of a smaller n
are among those of a larger one.

Error. In the weighted Korobov space with Fourier coefficients falling as h^-2, the squared worst-case error is
    e_m^2(z) = -1 + 1/n sum_k prod_j (1 + gamma_j omega({k z_j / n})),   omega(x) = 2 pi^2 (x^2 - x + 1/6).
It is also that of a randomly shifted lattice in a space of functions with square-integrable first mixed derivatives.

Search. Component by component: given z_1 .. z_d-1, a candidate z adds gamma_d T_m(z) / n to e_m^2. Embedded: we take
the z with the least sum over m of T_m(z) / min_z T_m(z), so that every m counts alike. Cools, Kuo and Nuyens (SIAM J.
Sci. Comput. 28, 2006) take instead the worst ratio of e_m to that of a vector made for m alone. The sum needs no such
vectors, forgets bad luck of earlier components, and gave better pairs of neighbouring coordinates. The worst ratio over
all m and d is printed by ``--check``.

Weights. gamma_j = 0.1 / j. The slow fall keeps pairs of late coordinates in view (the bounces of a long path), where
1 / j^2 lets neighbours coincide; the small scale gives interactions of low order the say, without which e_m in hundreds
of dimensions is nearly the same for every z. For smooth integrands of 8 coordinates it does no worse than 1 / j^2.

Speed. Odd residues modulo 2^r, up to sign, are the powers of 5, 2^(r-2) of them. Over the points whose denominator is
2^r, T_m is then a cyclic correlation, done by FFT (Nuyens and Cools, J. Complexity 22, 2006): O(d n log n) in all.
Ties are broken by the smallest power of 5; rounding may still decide otherwise on another machine, at no loss.
"""

import sys
from pathlib import Path

import numpy as np

LEVELS, DIM = range(8, 21), 1024
FILE = Path(__file__).parents[1] / "jaxmc/integration/data/lattice.npy"


def weight(j):
    """Return gamma_j of coordinate j = 1, 2, ..."""
    return 0.1 / j


def omega(x):
    """Return the Korobov kernel less one: the sum over h != 0 of exp(2 pi i h x) / h^2, that is 2 pi^2 B_2(x)."""
    return 2 * np.pi**2 * (x * x - x + 1 / 6)


def powers_of_five(bits):
    """Return 5^a modulo 2^bits for a below 2^(bits - 2), int64."""
    powers = np.ones(1, np.int64)
    while len(powers) < 1 << bits - 2:
        powers = np.concatenate([powers, powers * pow(5, len(powers), 1 << bits) % (1 << bits)])
    return powers


def construct(dim, levels):
    """Return (z, error): a vector of shape (dim,), int64, and e_m^2 of its first d entries, shape (dim, levels).

    With one level this is the ordinary construction for one number of points.
    """
    # Entry r of each list belongs to the points k z / 2^r with k odd, up to sign: k = 5^a at position a. Two points
    # share a position, except for r = 0 (the origin) and r = 1 (the middle).
    units = powers_of_five(max(levels))
    kernel = [omega(np.array([0.0])), omega(np.array([0.5]))]
    kernel += [omega(units[: 1 << r - 2] % (1 << r) / (1 << r)) for r in range(2, max(levels) + 1)]
    transform = [np.fft.rfft(values) for values in kernel]
    count = [1, 1] + [2] * (len(kernel) - 2)
    product = [np.ones_like(values) for values in kernel]
    vector, error = [], []
    for j in range(1, dim + 1):
        total, badness = np.zeros(1), np.zeros(1)  # at position b: of the candidate 5^b
        for r, values in enumerate(product):
            added = np.fft.irfft(np.conj(np.fft.rfft(values)) * transform[r], len(values))
            total = np.tile(total, len(added) // len(total)) + count[r] * added
            badness = np.tile(badness, len(added) // len(badness))
            if r in levels:
                badness += total / total.min()
        best = 0 if j == 1 else np.flatnonzero(badness <= badness.min() * (1 + 1e-10))[0]
        for values, omegas in zip(product, kernel):
            values *= 1 + weight(j) * np.roll(omegas, -(best % len(omegas)))
        sums = np.cumsum([c * values.sum() for c, values in zip(count, product)])
        vector.append(units[best])
        error.append([sums[m] / (1 << m) - 1 for m in levels])
    return np.array(vector), np.array(error)


def squared_error(vector, m):
    """Return e_m^2 of a vector from its definition, in O(d n)."""
    k = np.arange(1 << m)
    product = np.ones(1 << m)
    for j, z in enumerate(vector, 1):
        product *= 1 + weight(j) * omega(k * int(z) % (1 << m) / (1 << m))
    return product.mean() - 1


def slope(vector, f, tent, seed=1, shifts=16, levels=range(8, 19)):
    """Return (RMSE at the last level, slope of log RMSE against log n) over random shifts, for f of mean 1."""
    random = np.random.default_rng(seed)
    errors = []
    for m in levels:
        points = (np.arange(1 << m)[:, None] * vector) % (1 << m) / (1 << m)
        shifted = ((points + random.random(len(vector))) % 1 for _ in range(shifts))
        means = [f(1 - abs(2 * u - 1) if tent else u).mean() for u in shifted]
        errors.append(np.sqrt(np.mean(np.square(np.array(means) - 1))))
    return errors[-1], np.polyfit(np.log(2) * np.array(levels), np.log(errors), 1)[0]


def check(vector):
    """Print what the vector in the file is worth."""
    random = np.random.default_rng(0)
    for m in (8, 12, 16):
        rivals = [random.integers(0, 1 << 19, 256) * 2 + 1 for _ in range(9)]
        for d in (2, 8, 32, 256):
            e, odd = (np.sqrt(squared_error(v[:d], m)) for v in (vector, rivals[0]))
            median = np.median([np.sqrt(squared_error(v[:d], m)) for v in rivals]) if m < 16 else odd
            print(f"m={m} d={d}: e = {e:.3e}, random odd vectors {median:.3e}, ratio {median / e:.2f}")
    dim = 64
    alone = np.concatenate([construct(dim, [m])[1] for m in LEVELS], axis=1)
    embedded = construct(dim, LEVELS)[1]
    ratio = np.sqrt(embedded / alone)
    print(f"e over e of a vector for that m alone, d <= {dim}: worst {ratio.max():.2f}, mean {ratio.mean():.2f}")
    for m in (8, 14):
        print(f"m={m}: e^2 by FFT {embedded[-1, m - 8]:.10e}, directly {squared_error(vector[:dim], m):.10e}")
    functions = {
        "prod 1 + (u - 1/2)^2 - 1/12": lambda u: np.prod(1 + (u - 0.5) ** 2 - 1 / 12, axis=1),
        "prod 1 + (u - 1/2) / 2": lambda u: np.prod(1 + (u - 0.5) / 2, axis=1),
        "prod exp(u) / (e - 1)": lambda u: np.exp(u.sum(axis=1)) / (np.e - 1) ** u.shape[1],
    }
    for name, f in functions.items():
        for tent in (False, True):
            last, power = slope(vector[:8], f, tent)
            print(f"{name}, 8-D, {'tent' if tent else 'shift alone'}: slope {power:.2f}, RMSE at 2^18 {last:.1e}")


if __name__ == "__main__":
    if "--check" in sys.argv:
        check(np.load(FILE).astype(np.int64))
    else:
        np.save(FILE, construct(DIM, LEVELS)[0].astype(np.uint32))
        print(f"wrote {FILE}")
