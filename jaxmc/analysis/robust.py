"""Estimators of the mean other than averaging: they give up rare bright samples for a smaller error.

On samples with a long tail to one side all of them are biased low. They buy variance, and lose energy.

``Buckets`` hold what the medians of means need, for each pixel. Trimmed, winsorised and Catoni's means read ``bins``: a
``Histogram``, or the ``LayerSums`` of each pixel, for which they are means of the brightness. Bins have ``edges`` (B,)
increasing from 0, and ``count`` and ``total`` of shape (B, items...): the number and the sum of the samples from an
edge up to the next.
"""

import math
from typing import NamedTuple

import numpy as np

from ..integration.buckets import BucketMeans

GINI = 0.25  # up to here the means of the buckets are taken to be alike
HALVINGS = 60  # of the interval that holds Catoni's mean: to the last digit of a float64


def median_of_means(buckets: BucketMeans) -> np.ndarray:
    """Return the median of the bucket means, component by component, shape (items..., components...).

    To first order it is too low by M mu3 / (6 sigma^2 n), for M buckets of n samples in all and third central moment
    mu3, while the buckets are near normal. A firefly of probability p is not seen at all until most buckets hold one,
    n > M ln 2 / p. In return, of 8 ln(1/delta) buckets the error is at most sigma sqrt(32 ln(1/delta) / n) with
    probability 1 - delta, whatever the law with this variance. Empty buckets are left out.

    Source: Lugosi & Mendelson, "Mean estimation and regression under heavy-tailed distributions: a survey", Foundations
    of Computational Mathematics 19 (2019).
    """
    x, _, M = _sorted(buckets)
    middle = [np.take_along_axis(x, place[None], 0)[0] for place in ((M - 1) // 2, M // 2)]
    return 0.5 * (middle[0] + middle[1])


def bucket_gini(buckets: BucketMeans) -> np.ndarray:
    """Return the Gini coefficient of the bucket means, averaged over components: shape (items...), from 0 to 1.

    0 where all are equal, and where all are 0; 1 - 1/M where one of M buckets holds everything.
    G = 2 sum_j j x_j / (M sum_j x_j) - (M + 1) / M with the means x_1 <= x_2 <= ... <= x_M, which are not negative.
    """
    x, _, M = _sorted(buckets)
    rank = np.arange(1, len(x) + 1).reshape(-1, *[1] * (x.ndim - 1))
    total = x.sum(0)
    weighted = 2.0 * (rank * x).sum(0) / (M * np.where(total == 0.0, 1.0, total))
    gini = np.clip(np.where(total == 0.0, 0.0, weighted - (M + 1) / M), 0.0, 1.0)
    return gini.mean(axis=tuple(range(buckets.count.ndim - 1, gini.ndim)))


def gini_median_of_means(buckets: BucketMeans, form: str = "adaptive") -> np.ndarray:
    """Return a mean of the bucket means that leaves out more of them the more they differ.

    ``form="binary"``: the mean of all samples where the Gini coefficient is at most 1/4, else the median of means.
    ``form="adaptive"``: the mean of the samples in the middle buckets, without the floor(G floor(M/2)) lowest and as
    many of the highest: the plain mean where all are alike, near the median where one bucket holds everything. Both are
    biased low like the median of means, less so the more buckets share the bright samples. Means of several buckets
    count samples equally. Shape (items..., components...).

    Source: Buisine, Delepoulle & Renaud, "Firefly removal in Monte Carlo rendering with adaptive median of means" (EGSR
    2021). Raises ValueError for another form.
    """
    if form not in ("binary", "adaptive"):
        raise ValueError(f'form must be "binary" or "adaptive", got {form!r}')
    x, count, M = _sorted(buckets)
    gini = bucket_gini(buckets)
    gini = gini.reshape(gini.shape + (1,) * (M.ndim - gini.ndim))
    if form == "binary":
        mean = _mean_of_samples(x, count, count > 0)
        return np.where(gini <= GINI, mean, median_of_means(buckets))
    dropped = np.floor(gini * (M // 2))
    place = np.arange(len(x)).reshape(-1, *[1] * (x.ndim - 1))
    return _mean_of_samples(x, count, (place >= dropped) & (place < M - dropped))


def _filled(buckets):
    lead = buckets.count.shape
    return (buckets.count > 0).reshape(lead + (1,) * (buckets.mean.ndim - len(lead)))


def _sorted(buckets):
    """Return the means in increasing order with empty buckets last, as 0, the count of each, and how many hold any.

    Where one is not finite, all are NaN: a sample that is not a number does not vanish.
    """
    filled = _filled(buckets)
    count = np.broadcast_to(buckets.count.reshape(filled.shape), buckets.mean.shape)
    order = np.argsort(np.where(filled, buckets.mean, np.inf), axis=0, kind="stable")
    x, count = (np.take_along_axis(a, order, 0) for a in (np.where(filled, buckets.mean, 0.0), count))
    x = np.where((filled & ~np.isfinite(buckets.mean)).any(0), np.nan, x)
    return x, count, np.broadcast_to(filled.sum(0), x.shape[1:])


def _mean_of_samples(x, count, kept):
    count = np.where(kept, count, 0)
    with np.errstate(invalid="ignore"):
        return (count * x).sum(0) / count.sum(0)


class CutMean(NamedTuple):
    """A mean without the brightest samples, arrays of shape (items...).

    ``threshold`` is the edge from which on samples were cut off or cut down, inf where none was; ``affected`` is how
    many.
    """

    mean: np.ndarray
    threshold: np.ndarray
    affected: np.ndarray


def trimmed_mean(bins, fraction: float) -> CutMean:
    """Return the mean of the samples without at most a ``fraction`` of them, the largest.

    Whole bins are left out, so the fraction is met from below. For fixed bins and n to infinity it tends to E[c; c < t]
    / P(c < t), which is below the mean. Raises ValueError unless 0 <= fraction < 1.
    """
    edge, count, below, above = _cut(bins, fraction)
    kept = count - above
    return CutMean(np.where(kept > 0, below / np.maximum(kept, 1), 0.0)[()], edge, above)


def winsorised_mean(bins, fraction: float) -> CutMean:
    """Return the mean of min(c, t), where at most a ``fraction`` of the samples is cut down to the edge t.

    Its bias is E max(c - t, 0). See ``clamping.optimal_threshold`` for the t of least error (Searls, JASA 61 (1966)).
    Raises ValueError unless 0 <= fraction < 1.
    """
    edge, count, below, above = _cut(bins, fraction)
    return CutMean((below + np.where(above > 0, edge, 0.0) * above) / count, edge, above)


def _cut(bins, fraction):
    """Return the threshold, the number of samples, the sum of those below it and the number of the others."""
    if not 0.0 <= fraction < 1.0:
        raise ValueError(f"expected a fraction from 0 to below 1, got {fraction}")
    count, total = np.asarray(bins.count), np.asarray(bins.total, np.float64)
    none = np.zeros_like(count[:1])
    above = np.concatenate([np.cumsum(count[::-1], 0)[::-1], none])
    below = np.concatenate([none, np.cumsum(total, 0)])
    first = np.argmax(above <= fraction * above[0], axis=0)[None]
    above_first, below_first = (np.take_along_axis(x, first, 0)[0] for x in (above, below))
    edge = np.where(above_first > 0, np.append(bins.edges, np.inf)[first[0]], np.inf)
    return edge[()], above[0], below_first, above_first


def catoni_mean(bins, delta: float = 0.05, variance=None) -> np.ndarray:
    """Return Catoni's mean, the root m of sum psi(a (c - m)) = 0 with psi(x) = sign(x) ln(1 + |x| + x^2 / 2).

    Samples count in full near the mean and by their logarithm far from it. With ``variance`` at least that of the law,
    the error is at most sqrt(2 v L / (n - 2 L)), L = ln(1/delta), with probability 1 - 2 delta, and
    a = sqrt(2 L / (n v (1 + 2 L / (n - 2 L)))). On a one-sided tail it is biased low, by about a^2 / 6 times the third
    central moment where that is finite and a small. ``variance=None`` takes that of the samples, which a rare bright
    sample may have been missed by: then nothing is guaranteed. Each bin counts with its mean.

    Source: Catoni, "Challenging the empirical mean and empirical variance: a deviation study", Annales de l'IHP 48
    (2012). Raises ValueError unless 0 < delta < 1 and n > 2 ln(1/delta).
    """
    count, total = np.asarray(bins.count, np.float64), np.asarray(bins.total, np.float64)
    if not 0.0 < delta < 1.0:
        raise ValueError(f"expected delta between 0 and 1, got {delta}")
    n, odds = count.sum(0), math.log(1.0 / delta)
    if np.any(n <= 2.0 * odds):
        raise ValueError(f"expected more than 2 ln(1/delta) = {2.0 * odds:.1f} samples, got {np.min(n):.0f}")
    used = count.reshape(len(count), -1).any(1)
    count, total = count[used], total[used]
    value = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    mean = total.sum(0) / n
    if variance is None:
        square = np.asarray(bins.square)[used] if hasattr(bins, "square") else count * value**2
        variance = np.maximum(square.sum(0) / n - mean**2, 0.0) * n / (n - 1.0)
    with np.errstate(divide="ignore"):
        a = np.sqrt(2.0 * odds / (n * variance * (1.0 + 2.0 * odds / (n - 2.0 * odds))))
    a = np.where(np.isfinite(a), a, 0.0)
    low, high = value.min(0), value.max(0)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        x = a * (value - middle)
        pull = (count * np.sign(x) * np.log1p(np.abs(x) + 0.5 * x * x)).sum(0)
        low, high = np.where(pull > 0.0, middle, low), np.where(pull > 0.0, high, middle)
    # Without variance all samples are the mean.
    return np.where(a > 0.0, 0.5 * (low + high), mean)[()]
