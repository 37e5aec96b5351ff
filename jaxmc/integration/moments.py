"""Sample moments: count, mean and central moments of every component of a value."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .blocks import fold_lanes, lanes_of
from .storage import storable

PIECE = 8192  # numbers that are worked on together


@storable
@dataclasses.dataclass(frozen=True)
class Moments:
    """Count, mean and central moments to order 4 of every component of the value.

    Each block is centred on its own mean and scaled by its own largest deviation, so fourth powers neither overflow nor
    lose digits; blocks are added in float64 with a running compensation (Knuth 1969).

    Attributes:
        of: applied to the values of a block, sample axes first; None keeps the value as it is.
        order: highest moment kept, from 2 to 4. Images keep 2, which halves their memory.
    """

    of: Callable[[Any], Any] | None = None
    order: int = 4
    pooled = False

    def __post_init__(self):
        if self.order not in (2, 3, 4):
            raise ValueError(f"Moments keeps orders up to 2, 3 or 4, got order={self.order!r}")

    def reduce(self, values, valid, axes):
        leaves = jax.tree.leaves(apply(self.of, values))
        if valid.shape[-1] > 1 or len({leaf.dtype for leaf in leaves}) > 1:
            return [_reduce_moments(leaf, valid, axes, self.order) for leaf in leaves]
        # Where there is a single lane, put all numbers side by side instead.
        flat = jnp.concatenate([leaf.reshape(*valid.shape, -1) for leaf in leaves], -1)
        return _cut(_reduce_moments(flat, valid, axes, self.order), [leaf.shape[2:] for leaf in leaves])

    def init(self, record, items=()):
        return [_PowerSums.zeros(items + leaf["mean"].shape[1 + len(items) :], self.order) for leaf in record]

    def add(self, state, record, where=...):
        for sums, leaf in zip(state, record, strict=True):
            sums.add(leaf, where)

    def merge(self, a, b):
        for sums, other in zip(a, b, strict=True):
            sums.merge(other)
        return a

    def result(self, state):
        return [sums.moments() for sums in state]


def apply(of, values):
    return values if of is None else of(values)


def _cut(record, shapes):
    """Return the parts of a record of numbers side by side that belong to arrays of these shapes."""
    stops = np.cumsum([math.prod(shape) for shape in shapes])

    def part(shape, stop, x):
        return x[..., stop - math.prod(shape) : stop].reshape(*x.shape[:-1], *shape)

    return [jax.tree.map(partial(part, shape, stop), record) for shape, stop in zip(shapes, stops)]


def per_sample(sums, n):
    """Return sums divided by the number of samples of each integral, whose axes come first; NaN where there are none.

    In an unfinished run some integrals may have fewer samples than others.
    """
    with np.errstate(all="ignore"):
        return sums / n.reshape(n.shape + (1,) * (sums.ndim - n.ndim))


def _reduce_moments(x, valid, axes, order):
    # Count in at least float32: a bool, a small integer or a half cannot hold the number of samples.
    x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
    lanes = lanes_of(axes)
    wanted = valid.sum(0)  # rows of each lane
    valid, rows = (v.reshape(v.shape + (1,) * (x.ndim - 2)) for v in (valid, wanted))
    count = fold_lanes(jnp.sum, rows, lanes).astype(x.dtype)
    # Scale before summing, or finite values above 2e34 overflow; the mean need not be exact, deviations make up for it.
    size = math.prod(x.shape[axis] for axis in axes)

    def per_lane(start, step):
        """Fold the rows that are wanted, each lane by itself."""
        return lax.fori_loop(0, wanted.max(), lambda r, sums: step(sums, x[r], valid[r]), start)

    zero = jnp.zeros(x.shape[1:], x.dtype)
    total = per_lane(zero, lambda s, x, valid: s + jnp.where(valid, x, 0.0) * (1.0 / size))
    mean = fold_lanes(jnp.sum, total, lanes) * (size / jnp.maximum(count, 1.0))
    center = jnp.expand_dims(mean, lanes)
    widest = per_lane(zero, lambda s, x, valid: jnp.maximum(s, jnp.where(valid, jnp.abs(x - center), 0.0)))
    scale = fold_lanes(jnp.max, widest, lanes)
    inverse = jnp.expand_dims(jnp.where(scale > 0.0, 1.0 / scale, 0.0), lanes)

    def add_powers(sums, x, valid):
        z = jnp.where(valid, x - center, 0.0) * inverse
        powers = [z, z * z, z * z * z, (z * z) * (z * z)][:order]
        bad = sums[1] + (valid & ~jnp.isfinite(x))
        return [s + power for s, power in zip(sums[0], powers, strict=True)], bad

    powers, bad = per_lane(([zero] * order, jnp.zeros(x.shape[1:], jnp.int32)), add_powers)
    return {
        "count": jnp.broadcast_to(count, mean.shape),
        "mean": mean,
        "scale": scale,
        "powers": [fold_lanes(jnp.sum, power, lanes) for power in powers],
        "nonfinite": fold_lanes(jnp.sum, bad, lanes),
    }


@storable
class MomentsResult(NamedTuple):
    """Sample moments: ``central`` holds the central moments from the second on, divided by n."""

    n: np.ndarray
    mean: np.ndarray
    central: list[np.ndarray]
    nonfinite: int

    @property
    def variance(self):
        """Unbiased variance of one sample; NaN for fewer than two."""
        with np.errstate(all="ignore"):
            return np.where(self.n > 1, self.central[0] * (self.n / (self.n - 1)), np.nan)

    @property
    def skewness(self):
        """Skewness of the samples; NaN where nothing varies. Needs the moments of order 3."""
        with np.errstate(all="ignore"):
            return self.central[1] / self.central[0] ** 1.5

    @property
    def kurtosis(self):
        """Kurtosis of the samples, 3 for the normal law; NaN where nothing varies. Needs the moments of order 4."""
        with np.errstate(all="ignore"):
            return self.central[2] / self.central[0] ** 2


@storable
@dataclasses.dataclass
class _PowerSums:
    """Compensated sums of (x - center)^k for k = 1 .. order; the power is the first axis of ``total`` and ``carry``."""

    n: np.ndarray
    center: np.ndarray
    total: np.ndarray
    carry: np.ndarray
    nonfinite: int = 0

    @classmethod
    def zeros(cls, shape, order):
        return cls(np.zeros(shape), np.zeros(shape), np.zeros((order, *shape)), np.zeros((order, *shape)))

    @property
    def shape(self):
        return self.center.shape

    def empty(self):
        return _PowerSums.zeros(self.shape, len(self.total))

    @np.errstate(all="ignore")  # samples that are not finite make sums that are not: that is said by their number
    def add(self, leaf, where):
        n, mean, scale = (np.asarray(leaf[k], np.float64) for k in ("count", "mean", "scale"))
        scaled, factor = [], 1.0
        for power in leaf["powers"]:
            factor = factor * scale
            scaled.append(power * factor)
        self.nonfinite += int(leaf["nonfinite"].sum())
        known = self.n[where] > 0
        if not known.any():
            # Centre on the first block: there is nothing to shift or to add to.
            self.n[where], self.center[where] = n, mean
            for k, x in enumerate(scaled):
                self.total[k, where] = x
            return
        center = self.center[where] = np.where(known, self.center[where], mean)
        self._accumulate(where, _shift(n, scaled, mean - center))
        self.n[where] += n

    def _accumulate(self, where, powers):
        for k, x in enumerate(powers):
            total = self.total[k, where]
            with np.errstate(all="ignore"):
                new = total + x
                # Keep what the sum has lost to rounding (Knuth's two-sum).
                part = new - total
                self.carry[k, where] += (total - (new - part)) + (x - part)
            self.total[k, where] = new

    def clear(self):
        for x in (self.n, self.center, self.total, self.carry):
            x[...] = 0.0
        self.nonfinite = 0

    @np.errstate(all="ignore")
    def merge(self, other):
        self.center = np.asarray(np.where(self.n == 0, other.center, self.center))
        self._accumulate(..., _shift(other.n, other.total + other.carry, other.center - self.center))
        self.n, self.nonfinite = np.asarray(self.n + other.n), self.nonfinite + other.nonfinite

    @np.errstate(all="ignore")
    def moments(self) -> MomentsResult:
        mean, central = np.empty(self.center.size), np.empty((len(self.total) - 1, self.center.size))
        n, center = self.n.ravel(), self.center.ravel()
        total, carry = (x.reshape(len(x), -1) for x in (self.total, self.carry))
        # Work on pieces that stay in the cache.
        for first in range(0, len(mean), PIECE):
            piece = slice(first, first + PIECE)
            powers = total[:, piece] + carry[:, piece]
            shift = powers[0] / n[piece]
            mean[piece] = center[piece] + shift
            central[:, piece] = [x / n[piece] for x in _shift(n[piece], powers, -shift)[1:]]
        np.maximum(central[0], 0.0, out=central[0])
        shape = self.center.shape
        return MomentsResult(self.n.copy(), mean.reshape(shape), [x.reshape(shape) for x in central], self.nonfinite)


@storable
class Replicates:
    """The moments of independent randomisations of a family, one after the other: pooled over all samples, and of their
    means. ``current`` holds the sums of the randomisation under way, one ``_PowerSums`` to a leaf, or what has its
    ``shape``, ``empty``, ``clear``, ``merge`` and ``moments``."""

    def __init__(self, current):
        self.current, self.under_way = current, None
        self.pooled = [sums.empty() for sums in current]
        self.between = [_PowerSums.zeros(sums.shape, 2) for sums in current]

    def begin(self, replicate):
        """Say that the next samples belong to this randomisation."""
        if self.under_way is not None and replicate != self.under_way:
            self._close()
        self.under_way = replicate

    def _close(self):
        for sums, pooled, between in zip(self.current, self.pooled, self.between, strict=True):
            mean, zero = sums.moments().mean, np.zeros(sums.shape)
            record = {"count": zero + 1.0, "mean": mean, "scale": zero, "powers": [zero, zero], "nonfinite": zero}
            between.add(record, ...)
            pooled.merge(sums)
            sums.clear()

    def finish(self, complete=True):
        """Return moments of all samples and moments of the means; of the randomisation under way if it is complete."""
        if complete and self.under_way is not None:
            self._close()
            self.under_way = None
        return [s.moments() for s in self.pooled], [s.moments() for s in self.between]


@np.errstate(all="ignore")
def pool(replicates: MomentsResult) -> tuple[MomentsResult, MomentsResult]:
    """Return the moments of all samples and of the means, from those of replicates of one size on the first axis."""
    means, count = replicates.mean, len(replicates.mean)
    mean = means.mean(0)
    powers = [np.zeros_like(means), *(c * replicates.n for c in replicates.central)]
    central = [x.sum(0) / replicates.n.sum(0) for x in _shift(replicates.n, powers, means - mean)[1:]]
    between = [((means - mean) ** k).mean(0) for k in (2, 3, 4)]
    return (
        MomentsResult(replicates.n.sum(0), mean, central, replicates.nonfinite),
        MomentsResult(np.full(mean.shape, float(count)), mean, between, 0),
    )


def _shift(n, powers, d):
    """Return sums of (y + d)^k over n samples from the sums of y^k, k = 1 .. order (binomial theorem)."""
    s1, s2, s3, s4 = [*powers, *[None] * (4 - len(powers))]
    with np.errstate(all="ignore"):
        nd = n * d
        shifted = [s1 + nd, s2 + d * (2.0 * s1 + nd)]
        if s3 is not None:
            shifted.append(s3 + d * (3.0 * s2 + d * (3.0 * s1 + nd)))
        if s4 is not None:
            shifted.append(s4 + d * (4.0 * s3 + d * (6.0 * s2 + d * (4.0 * s1 + nd))))
    return shifted
