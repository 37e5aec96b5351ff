"""Tallies: what is kept of the samples.

A tally reduces a block of samples inside the kernel to a small record (``reduce``, in JAX) and adds records up on the
host in float64 (``init``, ``add``, ``merge``, ``result``, in NumPy). Records are added in a fixed order or in exact
integer arithmetic, so a result does not depend on how the work was cut.

A block has two sample axes, rows and lanes. One integral sums over both; a family of integrals (an image, with one
integral for each pixel) sums over rows and keeps the lanes, see ``axes``. A tally that is ``pooled`` keeps one state
for all integrals of a family; it is ``exact`` where merged states have the same bits however samples were divided.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .blocks import Added, fold_lanes, fold_rows, lanes_of
from .counts import is_count
from .moments import apply, per_sample
from .storage import storable

BINS_PER_OCTAVE = 8
BIN_BITS = 20  # bits of a float32 below the exponent and the leading three mantissa bits
BINS = 0x7F800000 >> BIN_BITS  # every finite non-negative float32 has its bin
CELL = 1 << (32 - BIN_BITS)  # samples of BIN_BITS bits each whose sum stays below 2^32


@storable
class Histogram(NamedTuple):
    """Samples c >= 0 in bins [edges[j], edges[j+1]), eight to the octave; edges[0] = 0, zeros are in bin 0.

    ``count``, ``total`` and ``square`` hold the number of samples in each bin, their sum and sum of squares: the first
    two exactly, the last to 3e-8. ``n`` counts all samples; ``nonfinite`` and ``negative`` ones are in no bin.
    """

    edges: np.ndarray
    count: np.ndarray
    total: np.ndarray
    square: np.ndarray
    n: int
    nonfinite: int
    negative: int


@storable
@dataclasses.dataclass(frozen=True)
class TailHistogram:
    """One-pass state of all tail statistics: count, sum and sum of squares in eight bins to the octave.

    The bin is the leading bits of the float32; what is left of it is summed in integers. So sums are exact, the order
    of samples does not matter, and the clamped mean at every edge is the sample's own, not an approximation.

    Attributes:
        of: maps the values of a block to one number each, sample axes first; None where the value is a number.
    """

    of: Callable[[Any], Any] | None = None
    pooled = exact = True

    def reduce(self, values, valid, axes):
        c = _scalar(self, values).astype(jnp.float32)
        bits = lax.bitcast_convert_type(c, jnp.uint32)
        # Look at the sign bit: the CPU may take a negative denormal for 0.
        finite, negative = jnp.isfinite(c), bits > jnp.uint32(1 << 31)
        keep = valid & finite & ~negative
        rest = bits & jnp.uint32((1 << BIN_BITS) - 1)
        rho = rest.astype(jnp.float32) * 2.0**-BIN_BITS
        square = jnp.minimum(jnp.round(rho * rho * 2.0**BIN_BITS), 2.0**BIN_BITS - 1).astype(jnp.uint32)
        rows, lanes = c.shape
        # A cell is a few rows, or a piece of a row that is wider than a cell.
        cell_rows, pieces = max(1, CELL // lanes), -(-lanes // CELL)
        cell = jnp.arange(rows)[:, None] // cell_rows * pieces + jnp.arange(lanes) // CELL
        # Send what is not kept to a spare bin behind the last one.
        bin_index = jnp.where(keep, (bits >> BIN_BITS) & 0x7FF, BINS).astype(jnp.int32) + cell * (BINS + 1)
        cells = -(-rows // cell_rows) * pieces

        def add_up(x):
            sums = jax.ops.segment_sum(x.ravel(), bin_index.ravel(), cells * (BINS + 1))
            return sums.reshape(cells, -1)[:, :BINS]

        return {
            "sums": jnp.stack([add_up(jnp.ones_like(rest)), add_up(rest), add_up(square)]),
            "n": valid.sum(),
            "nonfinite": (valid & ~finite).sum(),
            "negative": (valid & finite & negative).sum(),
        }

    def init(self, record, items=()):
        return {"sums": np.zeros((3, BINS), np.uint64), "n": 0, "nonfinite": 0, "negative": 0}

    def add(self, state, record, where=...):
        state["sums"] += record["sums"].sum(-2, dtype=np.uint64).reshape(-1, 3, BINS).sum(0)
        for k in ("n", "nonfinite", "negative"):
            state[k] += int(record[k].sum())

    def merge(self, a, b):
        return {k: a[k] + b[k] for k in a}

    def result(self, state):
        edges = np.arange(BINS + 1, dtype=np.uint32) << np.uint32(BIN_BITS)
        edges = edges.view(np.float32).astype(np.float64)
        edges[-1] = 2.0**128
        count, rest, square = state["sums"].astype(np.float64)
        low, width = edges[:-1], np.diff(edges)
        rest, square = rest * 2.0**-BIN_BITS, square * 2.0**-BIN_BITS
        total = low * count + width * rest
        return Histogram(
            edges[:-1], state["sums"][0].astype(np.int64), total,
            low * low * count + 2.0 * low * width * rest + width * width * square,
            state["n"], state["nonfinite"], state["negative"],
        )  # fmt: skip


@storable
class Largest(NamedTuple):
    """The largest samples, largest first, ties by index: ``value`` and ``index``, and ``n`` samples seen."""

    value: np.ndarray
    index: np.ndarray
    n: int


@storable
@dataclasses.dataclass(frozen=True)
class TopSamples:
    """The ``k`` largest samples with their indices, exact for any order of work. NaN counts as infinite; minus infinity
    is never among them.

    Attributes:
        k: how many to keep. Pareto k-hat wants more than 3 sqrt(n).
        of: maps the values of a block to one number each, sample axes first; None where the value is a number.
    """

    k: int = 4096
    of: Callable[[Any], Any] | None = None
    pooled = exact = True

    def __post_init__(self):
        if not is_count(self.k):
            raise ValueError(f"TopSamples keeps k >= 1 samples, a whole number, got k={self.k!r}")

    def reduce(self, values, valid, axes):
        c = _scalar(self, values)
        return {"value": jnp.where(valid, jnp.where(jnp.isnan(c), jnp.inf, c), -jnp.inf), "n": valid.sum()}

    def init(self, record, items=()):
        return {"value": np.zeros(0), "index": np.zeros(0, np.uint64), "least": -np.inf, "n": 0}

    def add(self, state, record, where=..., *, index):
        # Keep whatever could still be among the largest; sort only when the list has grown.
        chosen = np.flatnonzero(record["value"] >= max(state["least"], np.finfo(np.float64).min))
        state["value"] = np.append(state["value"], record["value"].ravel()[chosen])
        state["index"] = np.append(state["index"], index(chosen))
        state["n"] += int(record["n"].sum())
        if len(state["value"]) > 4 * self.k:
            self._prune(state)

    def _prune(self, state):
        order = np.lexsort((state["index"], -state["value"]))[: self.k]
        state["value"], state["index"] = state["value"][order], state["index"][order]
        if len(order) == self.k:
            state["least"] = state["value"][-1]

    def merge(self, a, b):
        both = {k: np.append(a[k], b[k]) for k in ("value", "index")}
        both |= {"least": max(a["least"], b["least"]), "n": a["n"] + b["n"]}
        self._prune(both)
        return both

    def result(self, state):
        self._prune(state)
        return Largest(state["value"], state["index"], state["n"])


def _scalar(tally, values):
    c = apply(tally.of, values)
    if jax.tree.structure(c) != jax.tree.structure(0) or c.ndim != 2:
        raise ValueError(
            f"{type(tally).__name__} needs one number for each sample, but the integrand returns an array or a tree; "
            f"say which number with of=..., for example {type(tally).__name__}(of=mc.luminance)"
        )
    return c


@storable
class ClampSums(NamedTuple):
    """Means over the samples at each threshold t, shape ``(thresholds, items...)``: of min(c, t) and (c - t)+ and of
    their squares. ``n`` is the number of samples of each integral; of an unfinished run, the largest one."""

    thresholds: np.ndarray
    n: int
    clamped: np.ndarray
    clamped_square: np.ndarray
    excess: np.ndarray
    excess_square: np.ndarray


@storable
@dataclasses.dataclass(frozen=True)
class ClampLadder(Added):
    """What clamping at each of a few thresholds leaves and takes away, for each integral of a family (each pixel).

    Attributes:
        thresholds: increasing positive numbers.
        of: maps the values of a block to one number each, sample axes first; None where the value is a number.
    """

    thresholds: tuple[float, ...]
    of: Callable[[Any], Any] | None = None

    def __post_init__(self):
        t = np.asarray(self.thresholds, float)
        if t.ndim != 1 or not len(t) or not (np.isfinite(t).all() and (t > 0).all() and (np.diff(t) > 0).all()):
            raise ValueError(f"thresholds must be increasing positive numbers, got {self.thresholds!r}")

    def reduce(self, values, valid, axes):
        c = _scalar(self, values)

        def add_row(t, r, sums, keep, c):
            kept, excess = jnp.where(keep, jnp.minimum(c, t), 0.0), jnp.where(keep, jnp.maximum(c - t, 0.0), 0.0)
            return [s + x for s, x in zip(sums, (kept, kept * kept, excess, excess * excess), strict=True)]

        def at(t):
            sums = fold_rows(partial(add_row, t), [jnp.zeros(c.shape[1:], c.dtype)] * 4, valid, c)
            return jnp.stack([fold_lanes(jnp.sum, x, lanes_of(axes)) for x in sums], -1)

        # A loop, so that the time to compile does not grow with the number of thresholds.
        sums = lax.map(at, jnp.array(self.thresholds, c.dtype))
        return {"sums": jnp.moveaxis(sums, 0, -2), "n": valid.sum(axes)}

    def result(self, state):
        means = np.moveaxis(per_sample(state["sums"], np.asarray(state["n"])), (-2, -1), (1, 0))
        return ClampSums(np.array(self.thresholds), int(np.max(state["n"])), *means)
