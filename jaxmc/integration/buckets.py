"""Buckets: the means of interleaved parts of the samples, for medians of means."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .blocks import fold_rows
from .counts import is_count
from .moments import apply
from .storage import storable


@storable
class BucketMeans(NamedTuple):
    """``count`` and ``mean`` of the samples in each bucket.

    Shapes are (buckets, items...) and (buckets, items..., components...); the mean of an empty bucket is NaN.
    """

    count: np.ndarray
    mean: np.ndarray


@storable
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
        lanes = x.shape[1]
        # Samples are numbered row by row, in one integral along the row as well.
        step = 1 if len(axes) == 1 else lanes

        def add_row(r, sums, keep, x):
            bucket = r * step % self.count
            kept = jnp.where(keep.reshape(lanes, *[1] * (x.ndim - 1)), x, 0.0)
            return sums[0].at[bucket].add(kept), sums[1].at[bucket].add(keep)

        start = jnp.zeros((self.count, *x.shape[1:]), x.dtype), jnp.zeros((self.count, lanes), jnp.int32)
        total, count = fold_rows(add_row, start, valid, x)
        if len(axes) == 1:
            return {"in_order": jnp.moveaxis(total, 1, 0), "count": jnp.moveaxis(count, 1, 0)}
        return {"in_order": self._fold_lanes(total), "count": self._fold_lanes(count)}

    def _fold_lanes(self, sums):
        """Return the sums by bucket of sums by bucket of the row and by lane."""
        turns = -(-sums.shape[1] // self.count)
        padding = [(0, 0), (0, turns * self.count - sums.shape[1])] + [(0, 0)] * (sums.ndim - 2)
        by_lane = jnp.pad(sums, padding).reshape(self.count, turns, self.count, *sums.shape[2:]).sum(1)
        row = jnp.arange(self.count)
        return by_lane[row[:, None], (row - row[:, None]) % self.count].sum(0)

    def init(self, record, items=()):
        total, lead = record["in_order"], 1 + len(items)
        return {"total": np.zeros(items + total.shape[lead:]), "count": np.zeros((*items, self.count), np.int64)}

    def add(self, state, record, where=..., *, first):
        # The record counts from the first sample of its block: turn it to where that belongs.
        axis, turn = record["count"].ndim - 1, first % self.count
        for name, sums in (("total", record["in_order"]), ("count", record["count"])):
            state[name][where] += np.roll(sums, turn, axis) if turn else sums

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
