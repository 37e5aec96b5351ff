"""A run: calls the kernel for the samples of an estimate, on all cores, and adds up records in the order of blocks."""

import copy
import itertools
import time
from collections.abc import Iterator

import jax
import numpy as np

from .. import backend
from . import machines
from .bands import add_in_bands, pays
from .counts import positive
from .dealing import add_dealt, can_deal
from .estimate import Estimate
from .kernel import ROWS, evaluate, item_jobs, lanes_for, stream_jobs
from .moments import Moments
from .parts import WHOLE, Part
from .samplers import index_words, seed_words
from .sums import Sums
from .work import ordered_map


def _as_array(x):
    # Leave it on the host: a compiled function takes it from there in a twentieth of the time of ``jnp.asarray``.
    return x if isinstance(x, jax.Array) else np.asarray(x)


def check_tallies(tallies):
    """Raise ``ValueError`` unless these are tallies by name, or None."""
    if tallies is not None and not (
        isinstance(tallies, dict) and all(isinstance(name, str) and hasattr(t, "reduce") for name, t in tallies.items())
    ):
        raise ValueError(f'tallies are given by name, such as {{"tail": mc.TailHistogram()}}, got {tallies!r}')


@jax.jit
def _on_device(arrays):
    return arrays


class Run:
    """One estimate in the making: what is computed, how the work is cut, and the ``sums`` so far.

    Attributes:
        items: number of integrals of the whole family, of which a ``part`` may be done here; None for a single one.
        keeper: keeps the sums in a file, see ``checkpoint``; or None.
    """

    def __init__(
        self, integrand, key, sampler, replicates, tallies, workers, blocks, rows=ROWS, kept=Moments(), items=None,
        lanes=None, part: Part = WHOLE, view=None,
    ):  # fmt: skip
        backend.check_arithmetic()
        check_tallies(tallies)
        if "moments" in (tallies or {}):
            raise ValueError('the name "moments" is taken by the estimate itself; give your tally another name')
        self.started, self.seconds_before = time.perf_counter(), 0.0
        self.integrand, self.sampler, self.replicates = jax.tree.map(_as_array, integrand), sampler, replicates
        self.seed = seed_words(key)
        self.mesh = backend.mesh()
        devices = self.mesh.size if self.mesh else 1
        # Every device gets as many blocks; the last ones may be empty.
        self.workers = backend.workers() if workers is None else positive("workers", workers)
        self.blocks, self.rows = -(-blocks // devices) * devices, rows
        self.items, self.lanes = items, lanes or backend.widths().lanes
        self.part, self.keeper = part, None
        about = {"key": key, "sampler": repr(sampler), **part.about}
        count = items if part.chosen is None else len(part.chosen)
        self.sums = Sums({"moments": kept, **(tallies or {})}, count, replicates, part.chosen, view, about)
        self.used = 0  # randomisations

    @property
    def seconds(self):
        """Wall time since the start, compilation included, and that of runs that this one goes on with."""
        return self.seconds_before + time.perf_counter() - self.started

    def points(self, n):
        """Return how many points each randomisation gets, or all together, if there are to be ``n`` samples."""
        # Samples that are worked on together come in whole rows.
        whole = self.lanes if self.integrand.together else 1
        points = -(-n // ((self.replicates or 1) * whole)) * whole
        return points if self.replicates is None else self.sampler.points(points)

    def total(self, n):
        """Return how many samples there will be in all if ``n`` are asked for."""
        points = self.points(n)
        each = points * (self.replicates or 1)
        if self.part.indices is not None:
            self.part.check(each, points if self.replicates else 1)
            each = len(self.part.indices)
        return each * (self.sums.items or 1)

    def stream(self, n, bar, deadline=np.inf) -> Estimate | None:
        """Return an estimate of one integral from ``n`` samples: new points are added to independent ones, others are
        drawn afresh. None if that took longer than ``deadline`` on the clock; independent samples are cut short then.
        """
        self.sums.goal, points = n, self.points(n)
        complete = self._add(self._ranges(points), points, bar, deadline)
        return self.estimate() if complete or self.replicates is None else None

    def family(self, n, bar) -> Estimate:
        """Return the estimate of a family of integrals from ``n`` samples each."""
        points = self.points(n)
        ranges = self._ranges(points)
        if pays(self):
            add_in_bands(self, ranges, points, bar)
        else:
            self._add(ranges, points, bar)
        return self.estimate()

    def passes(self, n, bar, cut) -> Iterator[Estimate]:
        """Yield an estimate of a family after each list of ranges that ``cut`` makes of those of all its samples."""
        points = self.points(n)
        for some in cut(self._ranges(points)):
            self._add(some, points, bar)
            yield self.estimate()

    def some(self, places) -> "Run":
        """Return a run of some integrals of the family, by their places among them, without samples."""
        some, chosen = copy.copy(self), places if self.part.chosen is None else self.part.chosen[places]
        some.part, some.keeper, some.lanes = Part(chosen=chosen), None, lanes_for(len(places))
        some.blocks, some.sums = min(self.blocks, -(-len(places) // some.lanes)), self.sums.some(chosen)
        return some

    def extend(self, integrand, start, stop, bar) -> Estimate:
        """Add independent samples ``start <= s < stop`` of an integrand that may have other values of its params."""
        if jax.tree.structure(integrand) != jax.tree.structure(self.integrand):
            raise ValueError("the integrands of all passes must be alike but for the values of their params")
        self.integrand = jax.tree.map(_as_array, integrand)
        self._add([(0, start, stop)], stop, bar)
        return self.estimate()

    def estimate(self) -> Estimate:
        self.sums.seconds = self.seconds
        return self.sums.estimate()

    def _ranges(self, points):
        """Return the samples to add: those that are missing, or new randomisations, for which others are forgotten."""
        if self.sums.pending:
            return self.sums.pending[0]
        if self.replicates is None:
            return [self.part.of(0, self.sums.n, points)]
        ranges = self.part.replicates(self.used, self.replicates, points)
        self.sums.forget()
        self.sums.first, self.sums.replicates = ranges[0][0], len(ranges)
        self.used += self.replicates
        # Independent points know no randomisations: give each replicate of a family samples of its own.
        apart = self.items and self.sampler.independent
        return [(r, r * points, (r + 1) * points) if apart else (r, 0, points) for r, *_ in ranges]

    def jobs(self, ranges, done, blocks=None) -> Iterator:
        """Return the kernel calls for ``ranges`` of samples, without the first ``done`` blocks."""
        blocks = blocks or self.blocks
        if self.items is None:
            return stream_jobs(ranges, blocks, self.rows, self.lanes, done)
        independent = self.sampler.independent
        return item_jobs(ranges, self.items, blocks, self.lanes, independent, done, self.part.chosen)

    def kernel_arguments(self, points):
        """Return what every call of the kernel gets: its arrays, and what is compiled into it."""
        given = self.integrand, self.sampler.tables(points, self.integrand.dim), self.seed
        static = {"sampler": self.sampler, "tallies": tuple(self.sums.tallies.items()), "each": bool(self.items)}
        return given, static

    def _add(self, ranges, points, bar, deadline=np.inf) -> bool:
        """Add the samples of ``ranges``, or what is left of them; return whether there was the time for all."""
        sums, team = self.sums, machines.team()
        sums.points, sums.pending = points, sums.pending or (list(ranges), 0)
        if team and np.isfinite(deadline):
            raise ValueError(
                "processes that work together have clocks of their own: give n or a target, no max_seconds"
            )
        if team and can_deal(self, team):
            add_dealt(self, team, bar)
        elif not self.fold(self.jobs(*sums.pending), bar, deadline, team):
            return False
        sums.end_pending()
        return True

    def begin(self):
        """Make empty sums, if there are none: that compiles the kernel, for a call that wants no samples."""
        if not self.sums.states:
            call, job = self._kernel(), next(self.jobs([(0, 0, 1)], 0))
            self.sums.begin(*call(job._replace(rows=np.zeros_like(job.rows))))

    def empty_sums(self, n) -> Sums:
        """Return the sums of a run for ``n`` samples, or a target, before the first of them; nothing is compiled."""
        sums = Sums(self.sums.tallies, self.sums.items, self.sums.replicates, self.part.chosen)
        shapes = self._kernel(self.points(n or 1))(next(self.jobs([(0, 0, 1)], 0)), evaluate.eval_shape)
        sums.begin(*jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), shapes))
        return sums

    def _kernel(self, points=None):
        """Return a function of a job that returns its records and an example of a value, by ``evaluate`` as it is or by
        what else knows its arguments."""
        given, static = self.kernel_arguments(points or self.sums.points)
        given = _on_device(given)
        static = {**static, "mesh": self.mesh}
        return lambda job, run=evaluate: run(*given, index_words(job.base), job.offset, job.rows, **static)

    def fold(self, jobs, bar, deadline=np.inf, team=None) -> bool:
        """Add the records of jobs, which a ``team`` of processes shares; return whether there was the time for all."""
        sums, x64, call = self.sums, jax.config.jax_enable_x64, self._kernel()

        def records_of(job):
            # Drop the blocks that want no samples: they are the last ones, and their records are empty.
            blocks = np.count_nonzero(job.rows.any(axis=1))
            # Threads do not inherit the precision that a ``with`` block has set.
            with jax.enable_x64(x64):
                records, example = call(job)
                return job, blocks, jax.tree.map(lambda x: np.asarray(x)[:blocks], records), example

        begin = list(itertools.islice(jobs, 2))
        if len(begin) < 2:
            results = map(records_of, begin)  # no threads for a single call
        else:
            self.begin()
            do, jobs, count = records_of, itertools.chain(begin, jobs), self.workers
            if team:
                do, jobs = team.shared(records_of, call(begin[0], evaluate.eval_shape)), enumerate(jobs)
                count *= team.size
            results = ordered_map(do, jobs, count)
        for job, blocks, records, example in results:
            sums.begin(records, example)
            sums.add(records, job)
            sums.has_added(int(blocks))
            bar.update(job.samples)
            if self.keeper:
                self.keeper.after_job()
            if time.perf_counter() > deadline:
                return False
        return True
