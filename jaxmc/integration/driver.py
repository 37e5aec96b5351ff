"""The driver: runs a kernel over all samples on all cores, folds the records into tallies and stops on a target.

Kernel calls run on as many threads as there are cores, and XLA keeps each call on one of them. Records are folded in
the order of the blocks: a result is the same, bit for bit, for any chunk size and any number of workers.
"""

import itertools
import time
from collections.abc import Iterator
from operator import itemgetter
from typing import Any

import jax
import numpy as np

from .. import backend
from . import stopping
from .counts import positive
from .estimate import Estimate
from .integrand import Integrand, as_integrand
from .kernel import BLOCK, CHUNK, LANES, ROWS, evaluate, item_jobs, lanes_for, stream_jobs
from .moments import Moments, Replicates, pool
from .samplers import Independent, index_words, seed_words
from .work import Progress, ordered_map

REPLICATES = 16  # of a single integral
SMALL, SMALL_LANES, MOST_BLOCKS = 8, 480, 16  # replicates of so few rows go together in one kernel call
REPLICATES_EACH = 4  # of each of a family: few samples are better not divided further


def integrate(
    f, *, dim=None, n=None, key=0, sampler=Independent(), replicates=None,
    rtol=None, atol=None, max_n=None, max_seconds=None, tallies=None, progress=None, workers=None, chunk=None,
) -> Estimate:  # fmt: skip
    """Estimate the integral of ``f`` over the unit hypercube, from ``n`` samples or until a target is met.

    Args:
        f: an ``Integrand``, or a function of one point of shape ``(dim,)``.
        dim: number of coordinates, for a plain function.
        n: number of samples, up to 2^63; with ``replicates``, of all together. ``Sobol`` and ``Lattice`` round it up.
        key: seed, an integer in [0, 2^64) or a ``jax.random`` key.
        sampler: where the points lie: ``Independent``, ``Sobol``, ``Lattice``, ``Halton``, ``LatinHypercube`` or
            ``Stratified``.
        replicates: how many independent randomisations of the points the samples are divided into; the error bar comes
            from the spread of their means. 16 by default, and none for ``Independent``, whose samples are independent.
        rtol, atol: stop when half the width of the 95 % interval is at most ``max(atol, rtol * |mean|)`` for every
            component of the value; then n is not given. ``Estimate.status`` says whether that was reached.
        max_n, max_seconds: stop there at the latest; 2^32 samples by default.
        tallies: further tallies by name, such as ``{"tail": TailHistogram()}``; results are ``estimate["tail"]``.
        progress: True for a progress bar, a word for one with that title, or a function of (samples done, n).
        workers: number of threads; all cores by default.
        chunk: samples to a kernel call. Neither changes the result.

    Returns:
        An ``Estimate``.

    Raises:
        ValueError: neither or both of n and a target, a number out of range, ``dim`` is missing or contradicts ``f``,
            or a tally does not fit.
    """
    integrand = as_integrand(f, dim)
    target = stopping.target(n, rtol, atol, max_n, max_seconds)
    n = n if n is None else positive("n", n)
    replicates = _replicates(replicates, sampler, REPLICATES)
    blocks, rows, lanes = blocks_of(chunk), ROWS, LANES
    if n is not None and replicates and n // replicates < SMALL * SMALL_LANES:
        blocks, rows, lanes = max(blocks, min(replicates, MOST_BLOCKS)), SMALL, SMALL_LANES
    run = Run(integrand, key, sampler, replicates, tallies, workers, blocks, rows, lanes=lanes)
    if n is not None:
        with Progress(progress, run.total(n)) as bar:
            return run.stream(n, bar)
    with Progress(progress, None) as bar:
        return stopping.run_until(target, run, bar)


def integrate_each(
    f: Integrand, items: int, *, n, key=0, sampler=Independent(), replicates=None, tallies=None, progress=None,
    workers=None, chunk=None, kept=Moments(order=2),
) -> Estimate:  # fmt: skip
    """Estimate a family of integrals, ``n`` samples each: an image is one integral for each pixel.

    ``f.fn(u, *params, item)`` gets the number of its integral, an integer below ``items``. Sample ``s`` of item ``i``
    has index ``s * items + i`` for independent points. For others its low word is s, counted in each randomisation, and
    its high word is ``r * items + i`` for randomisation r. Moments have a leading axis of length ``items``; tallies
    that are pooled run over all samples of all items. Arguments and errors otherwise as in ``integrate``.

    ``kept`` is the tally that mean and error come from: ``Moments``, or one whose state is a list of sums such as those
    of ``Moments``, which may let a sample count in more than one item.
    """
    n, run = positive("n", n), family_run(f, items, key, sampler, replicates, tallies, workers, chunk, kept)
    with Progress(progress, run.total(n)) as bar:
        return run.family(n, bar)


def family_run(f, items, key, sampler, replicates, tallies, workers, chunk, kept=Moments(order=2)) -> "Run":
    """Return the run of a family of integrals before its first sample; arguments as in ``integrate_each``."""
    f, items = as_integrand(f), positive("items", items)
    replicates = _replicates(replicates, sampler, REPLICATES_EACH)
    lanes = lanes_for(items)
    blocks = min(blocks_of(chunk), -(-items // lanes))
    return Run(f, key, sampler, replicates, tallies, workers, blocks, kept=kept, items=items, lanes=lanes)


def blocks_of(chunk):
    return max(1, positive("chunk", CHUNK if chunk is None else chunk) // BLOCK)


def _replicates(replicates, sampler, default):
    if replicates is None:
        return None if sampler.independent else default
    return positive("replicates", replicates)


def _as_array(x):
    # Leave it on the host: a compiled function takes it from there in a twentieth of the time of ``jnp.asarray``.
    return x if isinstance(x, jax.Array) else np.asarray(x)


def _place(record, first):
    """Return what a tally is told that goes by the order of samples: the number of the first sample of a block."""
    return {"first": int(first)} if "in_order" in record else {}


@jax.jit
def _on_device(arrays):
    return arrays


class Run:
    """The tallies of one estimate while it grows.

    Attributes:
        n: samples folded so far, of each integral of a family; ``drawn``: of all integrals together.
        seconds: wall time since the start, compilation included.
    """

    def __init__(
        self, integrand, key, sampler, replicates, tallies, workers, blocks, rows=ROWS, kept=Moments(), items=None,
        lanes=LANES,
    ):  # fmt: skip
        backend.check_arithmetic()
        if "moments" in (tallies or {}):
            raise ValueError('the name "moments" is taken by the estimate itself; give your tally another name')
        self.started = time.perf_counter()
        self.integrand, self.sampler, self.replicates = jax.tree.map(_as_array, integrand), sampler, replicates
        self.key, self.seed = key, seed_words(key)
        self.tallies = {"moments": kept, **(tallies or {})}
        self.workers, self.blocks, self.rows = workers or backend.workers(), blocks, rows
        self.items, self.lanes = items, lanes
        self.apart = "moments" if replicates else None  # the tally whose state each replicate has for itself
        self.states: dict[str, Any] = {}
        self.used, self.n, self.drawn = 0, 0, 0

    @property
    def seconds(self):
        return time.perf_counter() - self.started

    def total(self, n):
        """Return how many samples there will be in all if ``n`` are asked for."""
        return self.points(n) * (self.replicates or 1) * (self.items or 1)

    def points(self, n):
        """Return how many points each randomisation gets, or all together, if there are to be ``n`` samples."""
        return n if self.replicates is None else self.sampler.points(-(-n // self.replicates))

    def stream(self, n, bar, deadline=np.inf) -> Estimate | None:
        """Return an estimate of one integral from ``n`` samples: new points are added to independent ones, others are
        drawn afresh. None if that took longer than ``deadline`` on the clock; independent samples are cut short then.
        """
        points = self.points(n)
        jobs = stream_jobs(self._ranges(points), self.blocks, self.rows, self.lanes)
        complete = self._add(jobs, points, bar, deadline)
        return self._estimate(points) if complete or self.replicates is None else None

    def family(self, n, bar) -> Estimate:
        """Return the estimate of a family of integrals from ``n`` samples each."""
        *_, estimate = self.passes(n, bar, lambda ranges: [ranges])
        return estimate

    def passes(self, n, bar, cut) -> Iterator[Estimate]:
        """Yield an estimate of a family after each list of ranges that ``cut`` makes of those of all its samples."""
        points = self.points(n)
        ranges = self._ranges(points)
        if self.replicates and self.sampler.independent:
            # Independent points know no randomisations: give each replicate samples of its own.
            ranges = [(r, r * points, (r + 1) * points) for r, _, _ in ranges]
        for some in cut(ranges):
            self._add(item_jobs(some, self.items, self.blocks, self.lanes, self.sampler.independent), points, bar)
            yield self._estimate(points)

    def extend(self, integrand, start, stop, bar) -> Estimate:
        """Add independent samples ``start <= s < stop`` of an integrand that may have other values of its params."""
        if jax.tree.structure(integrand) != jax.tree.structure(self.integrand):
            raise ValueError("the integrands of all passes must be alike but for the values of their params")
        self.integrand, ranges = jax.tree.map(_as_array, integrand), [(0, start, stop)]
        each = item_jobs(ranges, self.items, self.blocks, self.lanes, True) if self.items else None
        self._add(each or stream_jobs(ranges, self.blocks, self.rows, self.lanes), stop, bar)
        return self._estimate(stop)

    def _ranges(self, points):
        """Return the samples to add: those that are missing, or new randomisations, for which others are forgotten."""
        if self.replicates is None:
            return [(0, self.n, points)]
        first, self.states, self.n, self.drawn = self.used, {}, 0, 0
        self.used += self.replicates
        return [(r, 0, points) for r in range(first, self.used)]

    def _add(self, jobs, points, bar, deadline=np.inf) -> bool:
        given = self.integrand, self.sampler.tables(points, self.integrand.dim), self.seed
        static, x64 = tuple(self.tallies.items()), jax.config.jax_enable_x64

        def call(job):
            return evaluate(
                *given, index_words(job.base), job.offset, job.rows,
                sampler=self.sampler, tallies=static, each=bool(self.items),
            )  # fmt: skip

        def records_of(job):
            # Drop the blocks that want no samples: they are the last ones, and their records are empty.
            blocks = np.count_nonzero(job.rows.any(axis=1))
            # Threads do not inherit the precision that a ``with`` block has set.
            with jax.enable_x64(x64):
                records, example = call(job)
                return job, jax.tree.map(lambda x: np.asarray(x)[:blocks], records), example

        first, second = next(jobs), next(jobs, None)
        if second is None:
            results = map(records_of, [first])  # no threads for a single call
        else:
            given = _on_device(given)
            # Compile once, on a job that wants no samples.
            if not self.states:
                self._begin(*call(first._replace(rows=np.zeros_like(first.rows))))
            results = ordered_map(records_of, itertools.chain([first, second], jobs), self.workers)
        for job, records, example in results:
            self._begin(records, example)
            for name, tally in self.tallies.items():
                self._fold(name, tally, records[name], job)
            # One call may hold fewer samples than there are integrals.
            self.drawn += job.samples
            self.n = self.drawn // (self.items or 1)
            bar.update(job.samples)
            if time.perf_counter() > deadline:
                return False
        return True

    def _begin(self, records, example):
        """Make empty states for records of this structure, unless there are some."""
        if self.states:
            return
        self.example = example
        self.states = {name: self._init(name, tally, records[name]) for name, tally in self.tallies.items()}
        self.spread = Replicates(self.states["moments"]) if self.items and self.replicates else None

    def _init(self, name, tally, record):
        if self.items or name != self.apart:
            return tally.init(record, (self.items,) if self.items else ())
        return tally.init(jax.tree.map(lambda x: np.zeros((1, 1, *x.shape[1:])), record), (self.replicates,))

    def _fold(self, name, tally, record, job):
        state = self.states[name]
        if self.spread and name == self.apart:
            self.spread.begin(job.replicate[0])
        if tally.pooled:
            extra = {"index": job.index} if "value" in record else {}
            tally.add(state, record, **extra)
        elif self.items:
            # Lanes are integrals: drop the lanes behind the last one.
            count = len(range(*job.items.indices(self.items)))
            flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:count], record)
            where = slice(job.items.start, job.items.start + count)
            tally.add(state, flat, where, **_place(record, job.first[0]))
        else:
            blocks = len(jax.tree.leaves(record)[0])
            which = job.replicate[:blocks] - (self.used - (self.replicates or 0))
            if name == self.apart and len(set(which)) == blocks:
                tally.add(state, record, which)
                return
            for block in range(blocks):
                where = (which[block],) if name == self.apart else ...
                tally.add(state, jax.tree.map(itemgetter(block), record), where, **_place(record, job.first[block]))

    def _moments(self):
        """Return the moments of all samples, and moments and values of the means of the replicates."""
        if self.spread:
            return *self.spread.finish(), None
        moments = self.tallies["moments"].result(self.states["moments"])
        if not self.replicates:
            return moments, None, None
        pooled, between = map(list, zip(*map(pool, moments), strict=True))
        return pooled, between, [m.mean for m in moments]

    def _estimate(self, points) -> Estimate:
        moments, between, means = self._moments()
        results = {name: t.result(self.states[name]) for name, t in self.tallies.items() if name != "moments"}
        recipe = {"key": self.key, "sampler": repr(self.sampler), "n": self.n}
        if self.replicates:
            recipe |= {"replicates": self.n // points, "points": points}
        structure = jax.tree.structure(self.example)
        return Estimate(moments, self.n, results, self.seconds, recipe, structure, between, means)
