"""Pearson's chi-square test of counts in bins, far in the tail: what is pooled, what is refused, what it can see."""

from typing import NamedTuple

import numpy as np
from scipy import stats

from .checks import SIGMAS

SIGNIFICANCE = 2.0 * float(stats.norm.sf(SIGMAS))  # 6e-7: a sound pair fails once in two million tests
# Expected samples of a bin. The statistic follows its law only for many: counted over 2 million simulated tests of 20
# bins, it says 1e-5 where the probability is 2.4e-5 for 5 samples to a bin, 1.8e-5 for 10 and 1.2e-5 for 25.
LEAST = 25.0


class ChiSquare(NamedTuple):
    """How a test went: ``p_value`` is the probability of a larger ``statistic`` for sound counts, ``cells`` the number
    of bins after pooling, ``worst`` the samples in the bin that is farthest off and those expected in it."""

    statistic: float
    cells: int
    p_value: float
    worst: tuple[int, float]


def chi_square(observed, expected) -> ChiSquare:
    """Return the test of counts against expected counts of the same sum, after pooling rare bins.

    Raises:
        ValueError: fewer than two bins of 25 expected samples.
    """
    observed, expected = pool(observed, expected)
    if len(expected) < 2 or expected.min() < LEAST:
        raise ValueError(
            f"{expected.sum():.5g} expected samples fill only {np.sum(expected >= LEAST)} bins with {LEAST:g} each; "
            "draw more, or use a domain or bins that follow the density"
        )
    terms = (observed - expected) ** 2 / expected
    worst, statistic = np.argmax(terms), float(terms.sum())
    p_value = float(stats.chi2.sf(statistic, len(terms) - 1))
    return ChiSquare(statistic, len(terms), p_value, (int(observed[worst]), float(expected[worst])))


def pool(observed, expected):
    """Return both with the rarest bins thrown together, the rarest first, until each holds 25 expected samples."""
    order = np.argsort(expected, kind="stable")
    starts, held = [0], 0.0
    for place, count in enumerate(expected[order]):
        if held >= LEAST:
            starts.append(place)
            held = 0.0
        held += count
    if held < LEAST and len(starts) > 1:
        starts.pop()
    return np.add.reduceat(observed[order], starts), np.add.reduceat(expected[order], starts)


def chi_square_power(error, fraction, *, n=1 << 20, cells=512, significance=SIGNIFICANCE):
    """Return the probability that ``assert_samples_pdf`` finds a density that is wrong in some of its bins.

    The density is off by the relative ``error`` on bins that hold a ``fraction`` of the samples, and on all others by
    what makes up for it. The statistic then follows the noncentral chi-square law with noncentrality
    n error^2 fraction / (1 - fraction) (Patnaik, Biometrika 36 (1949)).
    """
    noncentrality = n * np.square(error) * fraction / (1.0 - fraction)
    return stats.ncx2.sf(stats.chi2.isf(significance, cells - 1), cells - 1, noncentrality)
