"""How heavy is the tail of the samples, and is their mean to be trusted?

A firefly is a sample from the far tail. These functions read what a tally keeps of the tail (the largest samples, sums,
a histogram) and never the samples themselves. Everything is float64 on the host.

The fits are local: they describe the tail at the number of samples seen so far, not the law in the limit. A renderer
with bounded lights and finite depth always has a finite variance, and may still look like a tail without a mean.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from ..integration.intervals import Ends

RELIABLE_KHAT = 0.7  # ceiling of the reliability threshold, Vehtari et al., arXiv 1507.02646
ROUNDING = 1e-5  # of a float32 path, relative to the tail: far below the gaps of a continuous law
MOST_DIGITS = 308  # of a float64
LEAST_EXCEEDANCES = 5  # fewest points a generalised Pareto law is fitted to


class TailFit(NamedTuple):
    """A generalised Pareto law fitted to the samples above a threshold.

    ``khat`` is its shape: moments of order below 1 / khat are finite (mean below 1, variance below 1/2). NaN where no
    law was fitted. ``stderr`` is the error of ``khat``; ``scale`` and ``threshold`` are in units of the sample.
    ``exceedances`` points were fitted where the rule asks for ``recommended``. ``reliable_below`` is the largest khat
    at which a mean of so many samples can be trusted, ``min_n`` the samples that this khat asks for.
    """

    khat: float
    stderr: float
    exceedances: int
    threshold: float
    scale: float
    reliable_below: float
    min_n: float
    status: str
    recommended: int

    def explain(self) -> str:
        """Say in one sentence what the fit means for the mean."""
        if self.status == "too few samples":
            return f"too few samples: only {self.exceedances} above the threshold, no tail can be fitted."
        if self.status == "atomic":
            return "atomic: the tail is a few repeated values, so count how often each is hit instead of fitting a law."
        fit = f"{self.status}: khat {self.khat:.2f} +- {self.stderr:.2f} (trusted below {self.reliable_below:.2f})"
        if self.exceedances < self.recommended:
            fit += f" from only {self.exceedances} of {self.recommended} recommended tail samples"
        if self.status == "reliable":
            return fit + ", so the mean and its standard error can be used."
        if self.status == "no mean":
            return fit + ", so at this sample count the tail looks as if it had no mean."
        return fit + ", so the standard error of the mean cannot be trusted."

    def __str__(self) -> str:
        return self.explain()


def pareto_khat(largest: np.ndarray, n: int) -> TailFit:
    """Fit a generalised Pareto law to the largest of ``n`` samples.

    ``largest``: the K largest samples, shape (K,), any order. The fit takes min(n / 5, 3 sqrt(n)) of them above the
    next one, or as many as there are, and leaves out ties with that threshold. Where the maximum is repeated (twice
    exactly, or three times to rounding), or the lowest quarter of the tail is one value, the tail is made of atoms and
    no continuous law is fitted.

    Raises ValueError if ``largest`` is empty, not finite, or longer than ``n``.

    Source: Zhang & Stephens, Technometrics 51 (2009), with the weak prior, the tail length and the thresholds of
    Vehtari, Simpson, Gelman, Yao & Gabry, "Pareto smoothed importance sampling", arXiv 1507.02646.
    """
    top = _checked_largest(largest, n)
    recommended = int(3.0 * np.sqrt(n)) if n > 225 else n // 5
    kept = min(recommended, top.size - 1)
    threshold = float(top[kept])
    tail = top[:kept][::-1] - threshold
    tail = tail[tail > 0.0]
    quarter = int(tail.size / 4 + 0.5) - 1
    reliable_below = min(1.0 - 1.0 / np.log10(n), RELIABLE_KHAT) if n > 1 else -np.inf
    if _is_repeated(top, threshold):
        status = "atomic"
    elif tail.size < LEAST_EXCEEDANCES:
        status = "too few samples"
    elif quarter > 0 and tail[quarter] == tail[0]:
        status = "atomic"
    else:
        khat, scale = _fit_generalised_pareto(tail)
        stderr = max(1.0 + khat, 0.5) / np.sqrt(tail.size)
        digits = 1.0 / (1.0 - max(khat, 0.0)) if khat < 1.0 else np.inf
        min_n = 10.0**digits if digits < MOST_DIGITS else np.inf
        status = "no mean" if khat >= 1.0 else "reliable" if khat < reliable_below else "unreliable"
        return TailFit(khat, stderr, tail.size, threshold, scale, reliable_below, min_n, status, recommended)
    return TailFit(np.nan, np.nan, tail.size, threshold, np.nan, reliable_below, np.nan, status, recommended)


def _is_repeated(top, threshold):
    exactly = top.size > 1 and top[0] == top[1]
    return exactly or (top.size > 2 and top[0] - top[2] <= ROUNDING * (top[0] - threshold))


def _fit_generalised_pareto(tail):
    """Return (shape, scale) of the law of ``tail``, increasing positive exceedances (M,): a mean over a posterior."""
    count, unit = tail.size, tail[-1]
    x = tail / unit
    grid = 30 + int(np.sqrt(count))
    quartile = x[max(int(count / 4 + 0.5) - 1, 0)]
    theta = 1.0 + (1.0 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))) / (3.0 * quartile)
    theta[theta == 0.0] = 1e-12  # step off the removable singularity, the exponential law
    shape = np.array([np.log1p(-t * x).mean() for t in theta])
    log_likelihood = count * (np.log(-theta / shape) - shape - 1.0)
    weight = np.exp(log_likelihood - log_likelihood.max())
    best = np.dot(weight, theta) / weight.sum()
    best = best if best != 0.0 else 1e-12
    shape = np.log1p(-best * x).mean()
    return float((count * shape + 5.0) / (count + 10.0)), float(-shape / best * unit)


def _checked_largest(largest, n):
    """Return ``largest`` in decreasing order as float64, or raise ValueError."""
    top = np.sort(np.asarray(largest, dtype=np.float64).ravel())[::-1]
    if not 0 < top.size <= n:
        raise ValueError(f"expected between 1 and n={n} largest samples, got {top.size}: pass those of the same run")
    if not np.all(np.isfinite(top)):
        raise ValueError("expected finite samples, got inf or nan: replay them by their index and mend the integrand")
    return top


def largest_shares(largest: np.ndarray, total: float, counts=(1, 10, 100)) -> np.ndarray:
    """Return the share of the sum ``total`` that the largest 1, 10, 100 samples carry, shape (len(counts),).

    The samples are non-negative. NaN where more samples are asked for than ``largest`` holds, or where the total is 0.
    The share of the largest one tends to 0 as n grows if and only if the mean is finite (Embrechts, Klueppelberg &
    Mikosch, "Modelling Extremal Events", 6.2.6). Raises ValueError on negative samples.
    """
    top = np.sort(np.asarray(largest, dtype=np.float64).ravel())[::-1]
    if np.any(top < 0.0):
        raise ValueError("expected non-negative samples, got negative ones: pass absolute values and their sum")
    carried = np.concatenate([[0.0], np.cumsum(top)])
    return np.array([carried[k] / total if k <= top.size and total > 0.0 else np.nan for k in counts])


def effective_sample_size(n: int, total: np.ndarray, total_square: np.ndarray) -> np.ndarray:
    """Return (sum c)^2 / sum c^2 = n / (1 + relative variance), between 0 and ``n``; 0 where all samples are 0.

    So many samples of equal value would know the sum as well. Shapes of ``total`` and ``total_square`` are kept.
    """
    total, total_square = np.asarray(total, dtype=np.float64), np.asarray(total_square, dtype=np.float64)
    size = np.divide(total, total_square, out=np.zeros_like(total), where=total_square > 0.0) * total
    return np.minimum(size, n)[()]


def clopper_pearson(count: np.ndarray, n: int, level: float = 0.95) -> Ends:
    """Return the exact two-sided interval of a probability from ``count`` hits in ``n`` independent samples.

    Source: Clopper & Pearson, Biometrika 26 (1934). Raises ValueError unless 0 <= count <= n and 0 < level < 1.
    """
    count = np.asarray(count, dtype=np.float64)
    if n < 1 or np.any(count < 0) or np.any(count > n):
        raise ValueError(f"expected 0 <= count <= n, got counts up to {count.max(initial=0)} and n={n}")
    if not 0.0 < level < 1.0:
        raise ValueError(f"expected a level between 0 and 1, got {level}: write 0.95 for 95 %")
    side = 0.5 * (1.0 - level)
    lower = np.where(count == 0, 0.0, stats.beta.ppf(side, np.maximum(count, 1), n - count + 1))
    upper = np.where(count == n, 1.0, stats.beta.isf(side, count + 1, np.maximum(n - count, 1)))
    return Ends(lower[()], upper[()])


class Exceedance(NamedTuple):
    """Fraction of samples at or above each edge and its pointwise band, each of shape (B,)."""

    edges: np.ndarray
    fraction: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def exceedance(histogram, level: float = 0.95) -> Exceedance:
    """Return the probability of a sample at or above each edge, with Clopper-Pearson intervals.

    ``histogram``: ``edges`` (B,), ``count`` (B,) and ``n``; bin j holds samples in [edges[j], edges[j + 1]).
    """
    above = np.cumsum(np.asarray(histogram.count)[::-1])[::-1]
    lower, upper = clopper_pearson(above, histogram.n, level)
    return Exceedance(np.asarray(histogram.edges), above / histogram.n, lower, upper)


class Wait(NamedTuple):
    """Samples until the first event: expected number and its interval, and the median number."""

    mean: float
    lower: float
    upper: float
    median: float


def expected_wait(count: int, n: int, level: float = 0.95) -> Wait:
    """Return how many samples pass until an event seen ``count`` times in ``n`` samples comes for the first time.

    The wait is geometric: mean 1 / p, median ln 2 / -ln(1 - p), rounded up. An event never seen has an infinite
    estimate and only a lower bound, 1 / (1 - delta^(1/n)), about n / 3 at 95 % (the rule of three).
    """
    p_lower, p_upper = clopper_pearson(count, n, level)
    if count == 0:
        return Wait(np.inf, float(-1.0 / np.expm1(np.log1p(-level) / n)), np.inf, np.inf)
    median = 1.0 if count == n else float(np.ceil(np.log(0.5) / np.log1p(-count / n)))
    return Wait(n / count, float(1.0 / p_upper), float(1.0 / p_lower), median)
