"""How tallies fold the samples of a block, rows by lanes, and add up what comes of it."""

import numpy as np
from jax import lax

VECTOR = 64  # a number of lanes that vector code divides evenly
WHOLE = "n", "count"  # what a record holds of whole numbers


class Added:
    """What tallies have whose records are added up as they are."""

    pooled = False

    def init(self, record, items=()):
        lead = 1 + len(items)
        return {k: np.zeros(items + x.shape[lead:], np.int64 if k in WHOLE else float) for k, x in record.items()}

    def add(self, state, record, where=...):
        for k in state:
            state[k][where] += record[k]

    def merge(self, a, b):
        return {k: a[k] + b[k] for k in a}


def fold_rows(step, start, valid, *arrays):
    """Fold ``step(r, sums, valid row, rows...)`` over the rows of a block that any lane wants."""
    used = valid.any(1).sum()
    return lax.fori_loop(0, used, lambda r, sums: step(r, sums, valid[r], *(x[r] for x in arrays)), start)


def fold_lanes(fold, x, lanes):
    """Return ``fold`` of ``x`` over its lanes, the axes ``lanes``: (0,), or () to leave it. The first step is vector
    code, and both are so short that a sum loses little to rounding."""
    # Without the barrier XLA merges the two steps into one long scalar loop.
    if lanes and len(x) % VECTOR == 0:
        x = lax.optimization_barrier(fold(x.reshape(-1, VECTOR, *x.shape[1:]), 0))
    return fold(x, lanes) if lanes else x


def lanes_of(axes):
    """Return the axes that are left to fold once the rows are."""
    return tuple(axis - 1 for axis in axes if axis > 0)
