"""Confidence intervals of a mean."""

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

NORMAL, STUDENT, BOUNDED = "normal", "student-t over replicates", "bounded"
MEDIAN, BOOTSTRAP = "median of means", "bootstrap-t"
RESAMPLES = 2000


class Ends(NamedTuple):
    """Two ends of a confidence interval, in the shape of what it is of."""

    lower: Any
    upper: Any


class Interval(Ends):
    """The ends (lower, upper) of a confidence interval, in the shape of the value, its ``method`` and ``level``."""

    def __new__(cls, lower, upper, method, level):
        ends = super().__new__(cls, lower, upper)
        ends.method, ends.level = method, level
        return ends

    def __getnewargs__(self):
        return self.lower, self.upper, self.method, self.level

    def __repr__(self):
        return f"({self.lower}, {self.upper}), {self.level:.4g} {self.method}"


def interval(estimate, level, method, bounds) -> Interval:
    """See ``Estimate.interval``."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, got {level}")
    natural = NORMAL if estimate.between is None else STUDENT
    method = method or (natural if bounds is None else BOUNDED)
    if method == natural:
        halves = estimate.half_widths(level)
        ends = [(m.mean - half, m.mean + half) for m, half in zip(estimate.moments, halves, strict=True)]
    elif method == BOUNDED and estimate.ratio:
        raise ValueError(f'the method "{BOUNDED}" is for plain means, and this is a ratio of sums; leave bounds out')
    elif method == BOUNDED:
        ends = [_bounded(m, level, bounds) for m in estimate.between or estimate.moments]
    elif method in (MEDIAN, BOOTSTRAP):
        ends = [(_median if method == MEDIAN else _bootstrap)(x, level) for x in _replicate_means(estimate, method)]
    else:
        raise ValueError(f'method must be "{natural}", "{BOUNDED}", "{MEDIAN}" or "{BOOTSTRAP}" here, got {method!r}')
    lower, upper = zip(*ends, strict=True) if ends else ((), ())
    return Interval(estimate._tree(list(lower)), estimate._tree(list(upper)), method, level)


def quantile(estimate, level):
    """Return how many standard errors half the width of the default interval is."""
    tail = (1.0 - level) / 2.0
    if estimate.between is None:
        return stats.norm.isf(tail)
    replicates = estimate.recipe["replicates"]
    return stats.t.isf(tail, replicates - 1) if replicates > 1 else np.nan


def _bounded(m, level, bounds):
    if bounds is None or np.shape(bounds) != (2,) or not bounds[0] < bounds[1]:
        raise ValueError(f'the method "{BOUNDED}" needs bounds=(a, b) with a < b, got {bounds!r}')
    low, high = bounds
    # Split the risk between the ends, and each share between the mean and its variance.
    log = np.log(4.0 / (1.0 - level))
    n = np.maximum(m.n, 2)
    half = np.sqrt(2.0 * np.where(m.n > 1, m.variance, np.inf) * log / n) + 7.0 * (high - low) * log / (3.0 * (n - 1))
    return np.maximum(m.mean - half, low), np.minimum(m.mean + half, high)


def _replicate_means(estimate, method):
    means = estimate.replicate_means
    if means is None or estimate.recipe["replicates"] < 6:
        raise ValueError(f'"{method}" needs the means of 6 or more replicates: pass replicates=16 to integrate')
    return means


def _median(means, level):
    """Return order statistics between which the median of the means lies at least with probability ``level``."""
    count = len(means)
    cut = int(stats.binom.ppf((1.0 - level) / 2.0, count, 0.5))
    ordered = np.sort(means, axis=0)
    return ordered[max(cut - 1, 0)], ordered[min(count - cut, count - 1)]


def _bootstrap(means, level):
    """Return the bootstrap-t interval (Efron and Tibshirani 1993, chapter 12)."""
    count = len(means)
    mean, error = means.mean(0), means.std(0, ddof=1) / np.sqrt(count)
    draws = means[np.random.default_rng(0).integers(0, count, (RESAMPLES, count))]
    with np.errstate(all="ignore"):
        t = (draws.mean(1) - mean) / (draws.std(1, ddof=1) / np.sqrt(count))
    tail = (1.0 - level) / 2.0
    low, high = np.nanquantile(np.where(np.isfinite(t), t, np.nan), [tail, 1.0 - tail], axis=0)
    return mean - high * error, mean - low * error
