"""The kernel: evaluates blocks of samples of an integrand and reduces each block to the records of the tallies.

A block holds ``ROWS x LANES`` samples on a CPU; on a GPU rows are wider (``backend.widths``). One row is evaluated at a
time, so that its state stays in the cache; a kernel call runs a few blocks, one after the other.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import PartitionSpec

from .. import backend
from .blocks import VECTOR
from .integrand import SAMPLES
from .samplers import Index

LANES = backend.CPU_WIDTHS.lanes
ROWS = 32
BLOCK = ROWS * LANES
TOGETHER = 2048  # most lanes of samples that are worked on together
MEANS = 256  # their means that show how they are spread


class Job(NamedTuple):
    """One kernel call: the sample in row r, lane l of block b has index ``base[b, r] + offset[b, l] * stride``."""

    base: np.ndarray  # (blocks, rows) uint64
    offset: np.ndarray  # (blocks, lanes) uint32
    rows: np.ndarray  # (blocks, lanes) int32: how many rows of this lane are wanted
    replicate: np.ndarray  # (blocks,): which randomisation the samples belong to
    items: slice  # which integrals of a family the lanes belong to
    first: np.ndarray  # (blocks,): how many samples of its integral and randomisation come before those of a block
    stride: int = 1

    @property
    def samples(self) -> int:
        return int(self.rows.sum())

    def index(self, position):
        """Return the sample indices of flat positions in an array of shape (blocks, rows, lanes)."""
        block, row, lane = np.unravel_index(position, (*self.base.shape, self.offset.shape[1]))
        return self.base[block, row] + self.offset[block, lane].astype(np.uint64) * np.uint64(self.stride)


def remaining(ranges, size, done) -> Iterator[tuple[int, int, int]]:
    """Yield what is left of ``ranges``, cut in pieces of ``size`` samples, without the first ``done`` pieces."""
    for replicate, start, stop in ranges:
        skipped = min(done, -(-(stop - start) // size))
        done -= skipped
        if start + skipped * size < stop:
            yield replicate, start + skipped * size, stop


def stream_jobs(ranges, blocks, rows=ROWS, width=LANES, done=0) -> Iterator[Job]:
    """Yield jobs for the samples ``start <= index < stop`` of each ``(replicate, start, stop)`` in ``ranges``, in
    blocks of ``rows`` and ``width`` lanes, without the first ``done`` blocks.
    """
    block = rows * width
    left = remaining(ranges, block, done)
    pieces = ((r, first, stop) for r, start, stop in left for first in range(start, stop, block))
    lanes, steps = np.arange(width), np.arange(0, block, width, dtype=np.uint64)
    while piece := _take(pieces, blocks):
        replicate, first, stop = (np.array(column, np.uint64) for column in zip(*piece, strict=True))
        left = (stop - first).astype(np.int64)
        wanted = np.zeros((blocks, width), np.int32)
        wanted[: len(piece)] = np.clip(-(-(left[:, None] - lanes) // width), 0, rows)
        base = np.zeros((blocks, rows), np.uint64)
        base[: len(piece)] = ((replicate << np.uint64(32)) + first)[:, None] + steps
        offset = np.broadcast_to(lanes.astype(np.uint32), (blocks, width))
        yield Job(base, offset, wanted, replicate.astype(int), slice(None), first)


def item_jobs(ranges, items, blocks, lanes, independent, done=0, chosen=None) -> Iterator[Job]:
    """Yield jobs for the samples ``start <= s < stop`` of every integral of a family, for each ``(replicate, start,
    stop)`` in ``ranges``, without the first ``done`` blocks.

    Sample s of item i has index ``s * items + i`` where points are independent. If not, the high word of the index is
    ``replicate * items + i`` and the low word s: each integral has its own randomisations. With ``chosen``, an array of
    their numbers, only those items are done, and the slices of the jobs are those of ``chosen``.
    """
    count = items if chosen is None else len(chosen)
    steps, begun = divmod(done, -(-count // lanes))
    for replicate, start, stop in remaining(ranges, ROWS, steps):
        for sample in range(start, stop, ROWS):
            s = np.uint64(sample) + np.arange(ROWS, dtype=np.uint64)
            base = s * np.uint64(items) if independent else (np.uint64(replicate * items) << np.uint64(32)) + s
            for place in range(begun * lanes, count, blocks * lanes):
                places = place + np.arange(blocks * lanes).reshape(blocks, lanes)
                rows = np.where(places < count, min(stop - sample, ROWS), 0).astype(np.int32)
                offset = places if chosen is None else chosen[np.minimum(places, count - 1)]
                yield Job(
                    np.broadcast_to(base, (blocks, ROWS)), offset.astype(np.uint32), rows, np.full(blocks, replicate),
                    slice(place, place + rows.size), np.full(blocks, sample), 1 if independent else 1 << 32,
                )  # fmt: skip
            begun = 0


def _take(iterator, count):
    return [x for _, x in zip(range(count), iterator)]


def lanes_for(items):
    """Return how many lanes a row has in a family of integrals, so that few are left idle in the last row."""
    evenly = -(-items // -(-items // backend.widths().lanes))
    return -(-evenly // VECTOR) * VECTOR


def lanes_together(n, replicates=None):
    """Return how many samples to work on together where there are ``n`` of them, None if that is not known: a power of
    two, which divides randomised points evenly.
    """
    if n is None:
        return TOGETHER
    wanted = n // max(replicates or 1, MEANS)
    return min(max(1 << max(wanted, 1).bit_length() - 1, VECTOR), TOGETHER)


def mean_of_row(integrand, point, index, word_axes):
    """Return the value of an integrand whose samples are worked on together, and its leading axis 1."""

    def each(f):
        return jax.vmap(lambda i: f(point(i)), in_axes=(word_axes,), axis_name=SAMPLES)(index)

    return jax.tree.map(lambda x: jnp.asarray(x)[None], integrand.fn(each, *integrand.params))


def _indices_of_row(base, offset, independent, each):
    """Return the indices of the samples of a row and the axes of their words."""
    high, low = base
    if independent:
        high, low = jnp.broadcast_to(high, offset.shape), jnp.broadcast_to(low, offset.shape)
        return Index(high, low) + offset, Index(0, 0)
    # Keep the word that all lanes share a single number: what depends on it alone is then computed once.
    return (Index(high + offset, low), Index(0, None)) if each else (Index(high, low + offset), Index(None, 0))


def values_of_row(integrand, point, index, word_axes, items, axis_name=None):
    """Return the values of the samples of a row, leading axis LANES: for ``holds_for_any`` it has the ``axis_name``."""
    over_samples = partial(jax.vmap, axis_name=axis_name)
    axes = tuple(0 for _ in items)
    if integrand.lazy:
        return over_samples(lambda i, *item: integrand.at(point(i), *item), in_axes=(word_axes, *axes))(index, *items)
    # Put the lanes on the last axis, where vector code runs. A loop keeps XLA from making coordinates more than once.
    u = lax.map(lambda k: jax.vmap(lambda i: point(i)[k], in_axes=(word_axes,))(index), jnp.arange(integrand.dim))
    return over_samples(lambda u, *item: integrand.fn(u, *integrand.params, *item), in_axes=(1, *axes))(u, *items)


@partial(jax.jit, static_argnames=("sampler", "tallies", "each", "mesh"), compiler_options=backend.KERNEL_OPTIONS)
def evaluate(integrand, tables, seed, base, offset, rows, *, sampler, tallies, each, mesh=None):
    """Return the records of every tally for each block (leading axis) and a value, for its structure.

    ``base`` has shape (blocks, rows, 2): the two words of an index. On a ``mesh`` of several devices each has as many
    of the blocks, and does them by itself.
    """
    if mesh is not None:
        alone = partial(_evaluate, sampler=sampler, tallies=tallies, each=each)
        all, cut = PartitionSpec(), PartitionSpec(mesh.axis_names)
        specs = (all, all, all, cut, cut, cut), (cut, all)
        return jax.shard_map(alone, mesh=mesh, in_specs=specs[0], out_specs=specs[1], check_vma=False)(
            integrand, tables, seed, base, offset, rows
        )
    return _evaluate(integrand, tables, seed, base, offset, rows, sampler, tallies, each)


def _evaluate(integrand, tables, seed, base, offset, rows, sampler, tallies, each):
    axes = (0,) if each else (0, 1)

    def point(index):
        return sampler.point(seed, index, *tables)

    # Shapes are asked for before values: with a ``jit`` of its own, what an integrand does is traced once for both.
    @jax.jit
    def value_of_row(base, offset):
        index, word_axes = _indices_of_row(base, offset, sampler.independent, each)
        if integrand.together:
            return mean_of_row(integrand, point, index, word_axes)
        return values_of_row(integrand, point, index, word_axes, (offset,) if each else (), SAMPLES)

    shape = jax.eval_shape(value_of_row, base[0, 0], offset[0])

    def block(args):
        empty = _zeros(jax.eval_shape(records, *args))
        return lax.cond(args[2].max() > 0, records, lambda *_: empty, *args)

    @jax.jit
    def records(base, offset, rows):
        def evaluate_row(r, values):
            return jax.tree.map(lambda all_rows, x: all_rows.at[r].set(x), values, value_of_row(base[r], offset))

        valid = jnp.arange(len(base))[:, None] < (rows.min(keepdims=True) if integrand.together else rows)
        values = lax.fori_loop(0, rows.max(), evaluate_row, _zeros(shape, (len(base),)))
        return {name: tally.reduce(values, valid, axes) for name, tally in tallies}

    return lax.map(block, (base, offset, rows)), jax.tree.map(lambda x: jnp.zeros(x.shape[1:], x.dtype), shape)


def _zeros(shapes, leading=()):
    return jax.tree.map(lambda x: jnp.zeros((*leading, *x.shape), x.dtype), shapes)
