"""Buckets: the means of interleaved parts of the samples, for medians of means."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .counts import is_count
from .moments import apply, block_sum


class BucketMeans(NamedTuple):
    """``count`` and ``mean`` of the samples in each bucket.

    Shapes are (buckets, items...) and (buckets, items..., components...); the mean of an empty bucket is NaN.
    """

    count: np.ndarray
    mean: np.ndarray


@dataclasses.dataclass(frozen=True)
class Buckets:
    """Sample s of an integral goes to bucket s mod ``count``, for each integral of a family (each pixel).

    The rule does not depend on how the work is cut, so buckets of different machines add up one by one. Buckets of
    independent points are independent. Those of a Sobol sequence or a lattice are not: each mean is still unbiased, but
    no bound on a median of means holds. There s counts the points of one randomisation.

    Attributes:
        count: how many; odd, so that there is a median. 11 as in Buisine, Delepoulle & Renaud, "Firefly removal in
            Monte Carlo rendering with adaptive median of means" (EGSR 2021).
        of: maps the values of a block to one array, sample axes first; None where the value is an array or a number.
    """

    count: int = 11
    of: Callable[[Any], Any] | None = None
    pooled = False

    def __post_init__(self):
        if not is_count(self.count) or self.count % 2 == 0:
            raise ValueError(f"Buckets takes an odd positive number of buckets, got count={self.count!r}")

    def reduce(self, values, valid, axes):
        x = as_array(self, apply(self.of, values))
        x = jnp.where(valid.reshape(valid.shape + (1,) * (x.ndim - 2)), x, 0.0)
        if len(axes) == 2:
            # Samples are numbered row by row: make one long column of them.
            x, valid = x.reshape(-1, 1, *x.shape[2:]), valid.reshape(-1, 1)
        total, count = self._by_number(x), self._by_number(valid.astype(jnp.int32))
        if len(axes) == 2:
            total, count = total[:, 0], count[:, 0]
        else:
            total, count = jnp.moveaxis(total, 0, 1), jnp.moveaxis(count, 0, 1)
        return {"in_order": total, "count": count}

    def _by_number(self, x):
        """Return the sums of rows r, r + count, r + 2 count, ... for r = 0 .. count - 1."""
        turns = -(-len(x) // self.count)
        short = math.isqrt(turns)
        long = -(-turns // short)
        padding = short * long * self.count - len(x)
        x = jnp.pad(x, [(0, padding)] + [(0, 0)] * (x.ndim - 1))
        return block_sum(x.reshape(short, long, self.count, *x.shape[1:]), (0, 1))

    def init(self, record, items=()):
        total, lead = record["in_order"], 1 + len(items)
        return {"total": np.zeros(items + total.shape[lead:]), "count": np.zeros((*items, self.count), np.int64)}

    def add(self, state, record, where=..., *, first):
        # The record counts from the first sample of its block: turn it to where that belongs.
        axis = record["count"].ndim - 1
        state["total"][where] += np.roll(record["in_order"], first, axis)
        state["count"][where] += np.roll(record["count"], first, axis)

    def merge(self, a, b):
        return {k: a[k] + b[k] for k in a}

    def result(self, state):
        axis = state["count"].ndim - 1
        count, total = np.moveaxis(state["count"], axis, 0), np.moveaxis(state["total"], axis, 0)
        samples = count.reshape(count.shape + (1,) * (total.ndim - count.ndim))
        mean = np.divide(total, samples, out=np.full(total.shape, np.nan), where=samples > 0)
        return BucketMeans(count, mean)


def as_array(tally, x):
    """Return what ``tally`` sums up as an array of at least float32."""
    if not hasattr(x, "dtype"):
        name = type(tally).__name__
        raise ValueError(f"{name} needs an array for each sample, but the integrand returns a tree")
    return x.astype(jnp.promote_types(x.dtype, jnp.float32))
