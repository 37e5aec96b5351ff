"""The tail of every integral of a family: of every pixel of an image, in one pass and at little cost."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from .counts import is_count
from .moments import MomentsResult, _PowerSums
from .storage import storable
from .tallies import _scalar


@storable
class TailSums(NamedTuple):
    """What is kept of the samples of each of I integrals, such as the pixels of an image row by row.

    Attributes:
        moments: count, mean and central moments to order 4, each of shape (I,).
        largest: the K largest samples, largest first, shape (I, K); minus infinity where there were fewer.
        thresholds: t, shape (T,).
        count, total, log_total: number, sum and sum of logarithms of the samples at or above t, shape (T, I).
    """

    moments: MomentsResult
    largest: np.ndarray
    thresholds: np.ndarray
    count: np.ndarray
    total: np.ndarray
    log_total: np.ndarray

    @property
    def n(self) -> np.ndarray:
        """Samples of each integral, shape (I,)."""
        return self.moments.n


@storable
@dataclasses.dataclass(frozen=True)
class PixelTails:
    """Tail statistics of each integral of a family: moments to order 4, the largest samples, and counts, sums and sums
    of logarithms above a few thresholds, as ``analysis.pixels`` reads them.

    Powers are taken around the first sample of a block in float32, so moments are those of values below about 1e9.

    Attributes:
        thresholds: increasing positive numbers.
        largest: how many of the largest samples are kept for each integral: a power of 2. The tail of a tile of 16 x 16
            pixels of n samples each wants 48 sqrt(n), 6 of each pixel for 1024 samples, if they shared it evenly.
        of: maps the values of a block to one number each, sample axes first; None where the value is a number.
    """

    thresholds: tuple[float, ...] = (1.0, 4.0, 16.0, 64.0)
    largest: int = 8
    of: Callable[[Any], Any] | None = None
    pooled = False

    def __post_init__(self):
        t = np.asarray(self.thresholds, float)
        if t.ndim != 1 or not (np.isfinite(t).all() and (t > 0).all() and (np.diff(t) > 0).all()):
            raise ValueError(f"thresholds must be increasing positive numbers, got {self.thresholds!r}")
        if not is_count(self.largest) or self.largest & (self.largest - 1):
            raise ValueError(f"largest must be a power of 2, got {self.largest!r}")

    def reduce(self, values, valid, axes):
        if len(axes) > 1:
            raise ValueError(
                "PixelTails is for a family of integrals, as render and integrate_each make them; of one integral use "
                "TailHistogram and TopSamples"
            )
        c = _scalar(self, values)
        c = c.astype(jnp.promote_types(c.dtype, jnp.float32))
        zero = jnp.zeros(c.shape[1:], c.dtype)
        # Deviations from a firefly would cost the digits of all others: take the least of the first few samples.
        center = jnp.where(valid[:4], c[:4], c[0]).min(0)
        lowest = jnp.full_like(zero, -jnp.inf)

        def add(r, state):
            powers, largest, above, bad = state
            x, wanted = c[r], valid[r]
            y = jnp.where(wanted, x - center, 0.0)
            y2 = y * y
            powers = [s + p for s, p in zip(powers, (y, y2, y * y2, y2 * y2), strict=True)]
            passing, kept = jnp.where(wanted, jnp.where(jnp.isnan(x), jnp.inf, x), -jnp.inf), []
            for held in largest:
                kept.append(jnp.maximum(held, passing))
                passing = jnp.minimum(held, passing)
            logarithm, found = jnp.log(x), []
            for t, sums in zip(self.thresholds, above, strict=True):
                over = wanted & (x >= t)
                found.append([s + jnp.where(over, v, 0.0) for s, v in zip(sums, (1.0, x, logarithm), strict=True)])
            return powers, kept, found, bad + (wanted & ~jnp.isfinite(x))

        start = [zero] * 4, [lowest] * self.largest, [[zero] * 3 for _ in self.thresholds], jnp.zeros(zero.shape, int)
        # Four rows at a time: what is summed up goes through memory a quarter as often.
        together = 4 if len(c) % 4 == 0 else 1

        def add_some(k, state):
            for r in range(together):
                state = add(together * k + r, state)
            return state

        used = valid.any(1).sum()
        powers, largest, above, bad = lax.fori_loop(0, -(-used // together), add_some, start)
        return {
            "moments": {
                "count": valid.sum(0).astype(c.dtype), "mean": center, "scale": zero + 1.0, "powers": powers,
                "nonfinite": bad,
            },
            "largest": jnp.stack(largest, -1),
            "above": jnp.stack([jnp.stack(sums, -1) for sums in above], -2),
        }  # fmt: skip

    def init(self, record, items=()):
        return {
            "moments": _PowerSums.zeros(items, 4),
            "largest": np.full((*items, self.largest), -np.inf, record["largest"].dtype),
            "above": np.zeros((*items, len(self.thresholds), 3)),
        }

    def add(self, state, record, where=...):
        state["moments"].add(record["moments"], where)
        state["largest"][where] = _largest_of(state["largest"][where], record["largest"])
        state["above"][where] += record["above"]

    def merge(self, a, b):
        a["moments"].merge(b["moments"])
        return a | {"largest": _largest_of(a["largest"], b["largest"]), "above": a["above"] + b["above"]}

    def result(self, state):
        above = np.moveaxis(state["above"], (-1, -2), (0, 1))
        largest = np.asarray(state["largest"], np.float64)
        return TailSums(
            state["moments"].moments(), largest, np.array(self.thresholds), above[0].astype(int), *above[1:]
        )


def _largest_of(a, b):
    """Return the largest of two lists that fall along the last axis, falling again.

    One step of a bitonic merge (Batcher 1968) finds them, the others sort them.
    """
    x = np.maximum(a, b[..., ::-1])
    span = x.shape[-1] // 2
    while span:
        pairs = x.reshape(*x.shape[:-1], -1, 2, span)
        first, second = pairs[..., 0, :], pairs[..., 1, :]
        x = np.stack([np.maximum(first, second), np.minimum(first, second)], -2).reshape(x.shape)
        span //= 2
    return x
