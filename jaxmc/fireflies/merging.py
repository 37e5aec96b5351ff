"""Results of tallies of two disjoint parts of the samples, as the result of both together."""

from functools import reduce, singledispatch

import numpy as np

from ..integration.buckets import BucketMeans
from ..integration.layers import CascadeSums, LayerSums
from ..integration.moments import MomentsResult
from ..integration.tallies import ClampSums


def merged(results):
    """Return the result of all samples from those of disjoint parts, one or more, of any sizes, by one tally."""
    return reduce(_both, results)


@singledispatch
def _both(a, b):
    raise ValueError(f"results of {type(a).__name__} cannot be put together: a cure keeps Moments, ClampLadder, "
                     "Buckets, Cascade or Layers")  # fmt: skip


@_both.register
def _(a: MomentsResult, b):
    n, step = a.n + b.n, b.mean - a.mean
    second = (a.n * a.central[0] + b.n * b.central[0] + step**2 * (a.n * b.n / n)) / n
    return MomentsResult(n, a.mean + step * (b.n / n), [second], a.nonfinite + b.nonfinite)


@_both.register
def _(a: ClampSums, b):
    sums = [_mean(a.n, x, b.n, y) for x, y in zip(a[2:], b[2:], strict=True)]
    return ClampSums(a.thresholds, a.n + b.n, *sums)


@_both.register
def _(a: BucketMeans, b):
    def total(m):
        count = m.count.reshape(m.count.shape + (1,) * (m.mean.ndim - m.count.ndim))
        return count, np.where(count > 0, count * m.mean, 0.0)

    (count_a, total_a), (count_b, total_b) = total(a), total(b)
    count, sums = count_a + count_b, total_a + total_b
    mean = np.divide(sums, count, out=np.full(sums.shape, np.nan), where=count > 0)
    return BucketMeans(a.count + b.count, mean)


@_both.register
def _(a: CascadeSums, b):
    value = _mean(a.n, a.value, b.n, b.value)
    return a._replace(n=a.n + b.n, value=value, soft_count=a.soft_count + b.soft_count)


@_both.register
def _(a: LayerSums, b):
    value = _mean(a.n, a.value, b.n, b.value)
    return a._replace(n=a.n + b.n, count=a.count + b.count, total=a.total + b.total, value=value)


def _mean(n, x, m, y):
    return (n * x + m * y) / (n + m)
