"""Importance maps learnt from samples, after VEGAS: a change of variables that sends more points to large values.

The cube of u is cut in cells of learnt probabilities; then each coordinate is warped by a piecewise linear function of
its own. Together they are a map u -> x: f(x(u)) * jacobian has the integral of f, for any sampler and with derivatives.

Sources: G. P. Lepage, J. Comput. Phys. 27 (1978) 192 and 439 (2021) 110386 ("VEGAS enhanced").
"""

import dataclasses
import math
import os
import warnings
import zipfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .counts import positive
from .integrand import as_integrand
from .samplers import Independent, Index, index_words, pilot_key, seed_words

BETA = 0.75  # damping of the probabilities of cells (Lepage 2021)
FLOOR = 0.1  # share of the points that cells get by their volume alone: no weight V / p exceeds 1 / FLOOR
MOST_CELLS = 1 << 16  # float32 coordinates must resolve the least probable cell
MEMORY = 0.7  # what earlier samples of a cell count, by iteration


@partial(jax.tree_util.register_dataclass, data_fields=["edges", "cells"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class ImportanceMap:
    """A one-to-one map of (0, 1)^dim, ``importance_map(u) -> (x, |dx / du|)``; a pytree: its arrays are leaves.

    Attributes:
        edges: (dim, bins + 1), each row increasing from 0 to 1. Every bin gets an equal share of its coordinate.
        cells: None, or probabilities of cells of equal volume, summed up in C order; the last is 1. Axis i has as many
            entries as coordinate i has strata. The first coordinate of u chooses the cell and then runs through it, so
            every cell gets its share of points that are even in that coordinate, as those of nets and lattices are.
    """

    edges: jax.Array
    cells: jax.Array | None = None

    @property
    def dim(self) -> int:
        return len(self.edges)

    def __call__(self, u):
        """Return the point x, shape ``(dim,)``, inside (0, 1)^dim, and the jacobian, a number, for one point u."""
        y, weight, _ = _stratify(self.cells, jnp.asarray(u, self.edges.dtype))
        x, slopes, _ = _warp(self.edges, y)
        return x, weight * _product(slopes)

    def save(self, path) -> None:
        """Write the map to the file ``path``: all of it or, if that fails, nothing."""
        path = Path(path)
        arrays = {"edges": self.edges} | ({} if self.cells is None else {"cells": self.cells})
        unfinished = path.with_name(f"{path.name}.{os.getpid()}.unfinished")
        try:
            with open(unfinished, "wb") as file:
                np.savez(file, **arrays)
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)

    @classmethod
    def load(cls, path) -> "ImportanceMap":
        """Return the map that ``save`` wrote, bit for bit. Raises ``ValueError`` where the file holds no such map."""
        try:
            with np.load(path, allow_pickle=False) as file:
                edges, cells = (file[k] if k in file else None for k in ("edges", "cells"))
            _check(edges, cells)
        except (ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
            raise ValueError(f"{path} is no importance map: {error}; load what ImportanceMap.save wrote") from error
        return _as_map(edges, cells)


def _check(edges, cells):
    """Raise ``ValueError`` where these are not the arrays of a map, in the floating type of this session."""
    if edges is None or any(x.dtype.kind != "f" for x in (edges, cells) if x is not None):
        raise ValueError("edges are missing or not floating-point numbers")
    kind = jnp.result_type(float)
    edges, cells = np.asarray(edges, kind), None if cells is None else np.asarray(cells, kind)
    if edges.ndim != 2 or 0 in edges.shape or (edges[:, 0] != 0.0).any() or (edges[:, -1] != 1.0).any():
        raise ValueError(f"edges, of shape {edges.shape}, do not run from 0 to 1")
    if not (np.diff(edges) > 0.0).all():
        raise ValueError(f"edges do not increase in {edges.dtype}")
    if cells is None:
        return
    if not 1 <= cells.ndim <= len(edges) or not 1 <= cells.size <= MOST_CELLS:
        raise ValueError(f"cells of shape {cells.shape} do not fit {len(edges)} coordinates or {MOST_CELLS} cells")
    if cells.flat[-1] != 1.0 or not (np.diff(cells.ravel(), prepend=0.0) > 0.0).all():
        raise ValueError(f"cells do not increase to 1 in {cells.dtype}")


def _as_map(edges, cells):
    return ImportanceMap(jnp.asarray(edges, float), None if cells is None else jnp.asarray(cells, float))


def _stratify(cells, u):
    """Return the point of u in its cell, the weight V / p of the cell and the cell's number."""
    if cells is None:
        return u, 1.0, 0
    ends, first = cells.ravel(), u[0]
    # Without the barrier XLA searches once more for every coordinate.
    cell = lax.optimization_barrier(jnp.searchsorted(ends, first, side="right", method="scan_unrolled"))
    start = jnp.where(cell > 0, ends[cell - 1], 0.0)
    p = ends[cell] - start
    # A coordinate stands for all that was rounded to it: half a step puts it inside its cell, off the lower end.
    rounded = lax.stop_gradient(first)
    half = (jnp.nextafter(rounded, jnp.full_like(rounded, 2.0)) - rounded) / 2.0
    inside = jnp.where(jnp.arange(len(u)) == 0, (first - start + half) / p, u)
    strata = np.array(cells.shape + (1,) * (len(u) - cells.ndim), u.dtype)
    # The digits of the number, in floating point, where division is fast; halves keep it away from rounding.
    rest = jnp.floor((cell + 0.5) / np.append(np.cumprod(strata[:0:-1])[::-1], strata.dtype.type(1)))
    digits = rest - strata * jnp.floor((rest + 0.5) / strata)
    return (digits + inside) / strata, 1.0 / (cells.size * p), cell


def _warp(edges, y):
    """Return x, the slopes dx / dy and the bins of the coordinates of y, shape (dim,) each."""
    k, bins = jnp.arange(len(edges)), edges.shape[1] - 1
    scaled = y * bins
    i = jnp.clip(scaled.astype(jnp.int32), 0, bins - 1)
    low = edges[k, i]
    width = edges[k, i + 1] - low
    x = low + width * (scaled - i)
    return jnp.minimum(x, 1.0 - jnp.finfo(x.dtype).epsneg), width * bins, i


def _product(slopes):
    """Return the product of positive numbers, without overflow or underflow on the way."""
    exponent = jnp.frexp(lax.stop_gradient(slopes))[1]
    return jnp.ldexp(jnp.prod(jnp.ldexp(slopes, -exponent)), exponent.sum())


def adapt(f, *, dim=None, n=20_000, iterations=10, bins=None, strata=True, alpha=0.5, key=0) -> ImportanceMap:
    """Return a map learnt from ``iterations`` times ``n`` samples of ``f``; squares of components add up.

    Each iteration draws new points through the map so far and moves edges, to share f^2 jacobian^2 more evenly.
    From half time on cells are measured too. The probability of a cell goes with (mean of f^2 jacobian^2)^(0.75 / 2); a
    tenth of the points is shared out evenly. Lepage 2021 takes the deviation within the cell for the root mean square:
    best where cells get exact shares of points, but it adds variance where points are independent.

    Args:
        f: an ``Integrand``, or a function of one point of shape ``(dim,)`` together with ``dim``.
        n: samples of one iteration.
        bins: of each coordinate, below 2^16; by default a power of two up to 512, with 128 samples to a bin.
        strata: True for cells of 8 samples or more, False for none, or numbers of strata of the first coordinates, such
            as ``(16, 16)``, up to 2^16 cells.
        alpha: damping, in [0, 2]: 0 leaves the bins alone, 1 and above follow fluctuations.
        key: seed, as in ``integrate``, which takes other points with the same key.

    Values that are NaN or infinite are left out, counted and warned of once. The same arguments make the same map.
    Raises ``ValueError`` where an argument is out of its range.
    """
    f, n, iterations = as_integrand(f, dim), positive("n", n), positive("iterations", iterations)
    strata = _strata(strata, f.dim, n)
    bins = 2 ** min(max(n // 128, 8).bit_length() - 1, 9) if bins is None else positive("bins", bins)
    if bins >= 1 << 16 or not 0.0 <= alpha <= 2.0:
        raise ValueError(f"bins must be below 2^16 and alpha from 0 to 2, got bins={bins}, alpha={alpha!r}")
    f, seed = jax.tree.map(jnp.asarray, f), jnp.asarray(seed_words(pilot_key(key)))
    edges, cells = np.tile(np.linspace(0.0, 1.0, bins + 1), (f.dim, 1)), None
    count, total, bad = np.zeros(math.prod(strata)), np.zeros(math.prod(strata)), 0
    for i in range(iterations):
        if strata and i == iterations // 2:
            cells = _cumulative(total).reshape(strata)
        words = index_words(np.arange(i * n, (i + 1) * n, dtype=np.uint64))
        seen = jax.tree.map(np.asarray, _observe(f, _as_map(edges, cells), seed, words))
        square, weight, cell = seen["size"].astype(float) ** 2, seen["weight"].astype(float), seen["cell"]
        bad += n - np.count_nonzero(seen["finite"])
        if cells is not None:
            count = MEMORY * count + np.bincount(cell, minlength=count.size)
            total = MEMORY * total + np.bincount(cell, square / weight**2, count.size)
            cells = _cumulative(total / np.where(count > 0.0, count, 1.0)).reshape(strata)
        if not strata or i < iterations - 1:
            edges = np.stack([_move(row, b, square, alpha) for row, b in zip(edges, seen["bins"].T, strict=True)])
    if bad:
        warnings.warn(f"{bad:,} of {n * iterations:,} values were not finite: the map ignores them", stacklevel=2)
    return _as_map(edges, cells)


def _strata(strata, dim, n):
    """Return how many strata the first coordinates have: none is ()."""
    if strata is True:
        most = min(n // 8, MOST_CELLS)
        axes = min(dim, max(int(math.log(most, 4)), 1)) if most else 1
        each = int(most ** (1.0 / axes) + 1e-9)
        return (each,) * axes if each > 1 else ()
    if strata is False:
        return ()
    given = tuple(positive("each of strata", s) for s in strata) if isinstance(strata, Sequence) else ()
    if not 1 <= len(given) <= dim or math.prod(given) > MOST_CELLS:
        cure = f"True, False or up to {dim} numbers of strata with a product of at most {MOST_CELLS}"
        raise ValueError(f"strata must be {cure}, got {strata!r}")
    return given


@jax.jit
def _observe(integrand, importance_map, seed, words):
    """Return what is learnt from samples: arrays of leading axis n. ``size`` is that of value times jacobian."""

    def one(words):
        u = Independent().point(seed, Index(words[0], words[1]))[jnp.arange(integrand.dim)]
        y, weight, cell = _stratify(importance_map.cells, u)
        x, slopes, bins = _warp(importance_map.edges, y)
        size = _norm(integrand(x)) * (weight * _product(slopes))
        finite = jnp.isfinite(size)
        return {"size": jnp.where(finite, size, 0.0), "finite": finite, "bins": bins, "cell": cell, "weight": weight}

    return lax.map(one, words, batch_size=1024)


def _norm(value):
    """Return the root of the sum of squares of all components."""
    parts = jnp.concatenate([jnp.abs(jnp.ravel(x) * 1.0) for x in jax.tree.leaves(value)])
    largest = parts.max()
    return jnp.where(largest > 0.0, largest * jnp.sqrt(jnp.sum((parts / largest) ** 2)), largest)


def _move(edges, bins, square, alpha):
    """Return edges between which ``square``, smoothed and damped, is shared equally (Lepage 1978, 2021)."""
    share = np.bincount(bins, square, len(edges) - 1)
    if not share.sum() > 0.0:
        return edges
    share = np.convolve(np.pad(share, 1, "edge"), [0.125, 0.75, 0.125], "valid")
    log = np.log(np.clip(share / share.sum(), 1e-300, 1.0 - 1e-15))
    ends = np.append(0.0, np.cumsum((np.expm1(log) / log) ** alpha))
    width = np.diff(np.interp(np.linspace(0.0, ends[-1], len(edges)), ends, edges))
    # Four steps of the floating type below 1 outlast rounding.
    moved = np.append(0.0, np.cumsum(np.maximum(width, 4.0 * jnp.finfo(jnp.result_type(float)).epsneg)))
    return moved / moved[-1]


def _cumulative(square):
    """Return sums of the probabilities of cells, the last 1."""
    p = square ** (BETA / 2.0)
    p = p / p.sum() if p.sum() > 0.0 else np.full(p.size, 1.0 / p.size)
    ends = np.cumsum((1.0 - FLOOR) * p + FLOOR / p.size)
    return ends / ends[-1]
