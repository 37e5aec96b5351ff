"""How long fireflies are waited for, seen, and remembered: a rare sample of value A over a calm base.

With probability p a sample is A, else it is around ``base``; the mean is p A + (1 - p) base.
"""

from typing import NamedTuple

import numpy as np


class FirstFirefly(NamedTuple):
    """Samples until the first firefly: mean and median."""

    mean: float
    median: float


def first_firefly(p: float) -> FirstFirefly:
    """Return how many samples pass until an event of probability p > 0: mean 1 / p, median ln 2 / -ln(1 - p)."""
    _check_probability(p)
    return FirstFirefly(1.0 / p, float(np.log(0.5) / np.log1p(-p)) if p < 1.0 else 1.0)


def visible_share(N, p: float, value: float, tolerance: float) -> np.ndarray:
    """Return the share of pixels of N samples with a visible firefly: 1 - (1 - p)^N to N = value / tolerance, then 0.

    One sample ``value`` moves a pixel by about value / N, and is seen while that is above ``tolerance``. So more
    samples look worse until N = value / tolerance. Two fireflies in a pixel, which are seen for twice as long, are
    left out: good for p N well below 1.
    """
    _check_probability(p)
    N = np.asarray(N, np.float64)
    hit = -np.expm1(N * np.log1p(-p)) if p < 1.0 else np.ones_like(N)
    return np.where(N <= value / tolerance, hit, 0.0)[()]


def recovery_n(value: float, base: float, mean: float, within: float = 0.0) -> float:
    """Return the number of samples at which a running mean that one sample ``value`` has spoilt is right again.

    It falls as base + (value - base) / N. It passes ``mean`` at N = (value - base) / (mean - base), which is 1 / p, and
    comes within ``within`` times the mean of ``base``, where it would stay without fireflies, at
    N = (value - base) / (within mean).
    """
    gap = within * mean if within > 0.0 else mean - base
    return float((value - base) / gap) if gap > 0.0 else np.inf


def samples_for_error(relative_variance: float, error: float) -> float:
    """Return how many samples a relative RMS error wants: relative variance / error^2."""
    return float(relative_variance / error**2)


def _check_probability(p):
    if not 0.0 < p <= 1.0:
        raise ValueError(f"expected a probability in (0, 1], got {p}")
