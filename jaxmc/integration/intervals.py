"""Confidence intervals of a mean."""

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

CORRECTED, NORMAL, STUDENT = "corrected for skewness", "normal", "student-t over replicates"
BOUNDED, MEDIAN, BOOTSTRAP = "bounded", "median of means", "bootstrap-t"
RESAMPLES = 2000
LEAST_SKEW = 8  # numbers from which a skewness is worth correcting for
NOISE = 1.3  # 6 / (2 z^2 - 3) at z = 1.96, see ``_lean``


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
    method = method or (_default(estimate) if bounds is None else BOUNDED)
    if method == BOUNDED and estimate.ratio:
        raise ValueError(f'the method "{BOUNDED}" is for plain means, and this is a ratio of sums; leave bounds out')
    if method == BOUNDED:
        ends = [_bounded(m, level, bounds) for m in _records(estimate)]
    elif method in (_natural(estimate), _default(estimate)):
        sides = zip(estimate.moments, _sides(estimate, level, method), strict=True)
        ends = [(m.mean - below, m.mean + above) for m, (below, above) in sides]
    elif method in (MEDIAN, BOOTSTRAP):
        ends = [(_median if method == MEDIAN else _bootstrap)(x, level) for x in _replicate_means(estimate, method)]
    else:
        own = " or ".join(f'"{name}"' for name in dict.fromkeys([_default(estimate), _natural(estimate)]))
        raise ValueError(f'method must be {own}, "{BOUNDED}", "{MEDIAN}" or "{BOOTSTRAP}" here, got {method!r}')
    lower, upper = zip(*ends, strict=True) if ends else ((), ())
    return Interval(estimate._tree(list(lower)), estimate._tree(list(upper)), method, level)


def half_widths(estimate, level):
    """See ``Estimate.half_widths``."""
    return [(below + above) / 2.0 for below, above in _sides(estimate, level, _default(estimate))]


def _records(estimate):
    """Return the moments of what is independent: samples, or means of replicates."""
    return estimate.moments if estimate.between is None else estimate.between


def _natural(estimate):
    return NORMAL if estimate.between is None else STUDENT


def _default(estimate):
    known = all(len(m.central) == 3 and np.all(m.n >= LEAST_SKEW) for m in _records(estimate))
    return CORRECTED if known else _natural(estimate)


def _sides(estimate, level, method):
    """Return for each leaf how far an interval by quantiles of the normal law or of Student's reaches to both sides."""
    tail = (1.0 - level) / 2.0
    if estimate.between is None:
        q = stats.norm.isf(tail)
    else:
        replicates = estimate.recipe["replicates"]
        q = stats.t.isf(tail, replicates - 1) if replicates > 1 else np.nan
    sides = []
    for m in _records(estimate):
        error, lean = np.sqrt(m.variance / np.maximum(m.n, 1)), _lean(m) if method == CORRECTED else 0.0
        sides.append((_upright(q, lean) * error, -_upright(-q, lean) * error))
    return sides


@np.errstate(all="ignore")
def _lean(m):
    """Return the skewness of the mean that an interval should allow for, in the shape of the mean.

    Student's t of n numbers of skewness g leans by g / sqrt(n), and its symmetric interval covers too seldom. A share w
    of that is corrected. Where the excess kurtosis k is below 3/2 g^2, the noise of the estimated g goes against that
    of the mean, cov(estimated g, t) = (k - 3/2 g^2) / sqrt(n), and with w = 1 the interval would cover too often. In
    the expansions of P. Hall, The Bootstrap and Edgeworth Expansion, 1992, chapter 2, the terms of order 1/n in the
    coverage of (-z, z) nearly cancel for w = g^2 / (g^2 + 6 / (2 z^2 - 3) (3/2 g^2 - k)). It is 1 for gamma laws, and
    small where g is noise.
    """
    skew = m.skewness
    flat = np.maximum(1.5 * skew**2 - (m.kurtosis - 3.0), 0.0)
    share = skew**2 / (skew**2 + NOISE * flat)
    # Correct the sample skewness for its size; where nothing varies there is none.
    return np.nan_to_num(share * skew * np.sqrt(m.n - 1.0) / (m.n - 2.0))


def _upright(q, lean):
    """Return the t whose transform x + a x^2 / 3 + a^2 x^3 / 27 + a / 6, of less skewness, is q, where a is how much it
    leans (P. Hall, On the removal of skewness by transformation, J. R. Statist. Soc. B 54, 1992)."""
    x = q - lean / 6.0
    root = np.cbrt(1.0 + lean * x)
    return 3.0 * x / (root * root + root + 1.0)


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
