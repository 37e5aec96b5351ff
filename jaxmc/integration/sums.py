"""The sums of one estimate: the states of its tallies, and which samples are in them."""

import dataclasses
from operator import itemgetter
from typing import Any

import jax
import numpy as np

from .counts import is_count
from .estimate import Estimate
from .moments import MomentsResult, Replicates, pool
from .storage import NotStored, fits, is_storable, storable


@storable
class Sums:
    """What there is of an estimate while it grows, and all that a file must hold to go on with it.

    Attributes:
        tallies, states: by name.
        items: number of integrals of a family; None for a single one.
        replicates: how many randomisations the samples are divided into, the first of them ``first``; or None.
        points: of each randomisation, or of all together.
        drawn: samples folded, of all integrals together.
        ranges: the samples that are in the states, as (replicate, start, stop).
        pending: of the samples under way, their ranges and how many blocks of them are in the states; or None.
        looks, goal: of a run towards a target, its looks so far and the n of the one under way.
        moments: what is left of the sums of mean and error where these were not kept, see ``bands``; or None.
        recipe: what decides the values of the samples, see ``recipes``; None unless it was asked for.
        chosen: numbers of the integrals, for a part of a family; None for all.
        view: shapes an estimate, such as that of an image; or None.
        about: of the estimate's recipe.
        finished: whether all samples are in it; result: the estimate of a run towards a target, or None.
    """

    moments: Any = None  # never part of a file

    def __init__(self, tallies, items=None, replicates=None, chosen=None, view=None, about=None):
        self.tallies, self.items, self.replicates, self.chosen, self.view = tallies, items, replicates, chosen, view
        self.about: dict[str, Any] = about or {}
        self.recipe: Any = None
        self.states: dict[str, Any] = {}
        self.structure, self.first, self.points, self.drawn, self.ranges = None, 0, 0, 0, []
        self.looks, self.goal = [], None
        self.pending: Any = None
        self.seconds, self.finished, self.result = 0.0, False, None

    @property
    def n(self):
        """Samples of each integral so far."""
        return self.drawn // (self.items or 1)

    @property
    def divisible(self):
        """Whether the integrals of the family can be divided, and put together again, without a change of a bit."""
        return all(is_storable(t) and (not t.pooled or getattr(t, "exact", False)) for t in self.tallies.values())

    def some(self, chosen):
        """Return sums without samples for some of the integrals."""
        some = Sums(self.tallies, len(chosen), self.replicates, chosen)
        some.first, some.points = self.first, self.points
        return some

    def check(self, empty, most):
        """Raise an exception of some kind if this is not what an ``empty`` one, without samples, could have become when
        it got so many samples of each integral at ``most``."""
        ranges, done = self.pending or ([], 0)
        ranges = [*ranges, *self.ranges]
        whole = all(is_count(x, least=0) for x in [done, self.drawn, self.first, self.points, *sum(ranges, ())])
        if not whole or sum(stop - start for _, start, stop in ranges) > most or any(b < a for _, a, b in ranges):
            raise ValueError("counts samples in another way")
        result = self.result is None or (self.finished and isinstance(self.result, Estimate))
        if not (result and isinstance(self.seconds, float) and isinstance(self.looks, list)):
            raise ValueError("has no times, or another result")
        if not self.finished and self.states and not fits(self.states, empty.states):
            raise ValueError("holds other sums than it says")
        if (self.items, self.replicates) != (empty.items, empty.replicates):
            raise ValueError("holds other integrals than it says")
        self.structure = empty.structure
        if self.finished or (self.states and not self.replicates):
            self.estimate()

    def forget(self):
        """Drop all samples."""
        self.states, self.drawn, self.ranges, self.moments = {}, 0, [], None

    def has_added(self, blocks):
        """Say that so many more blocks of the pending samples are in the states."""
        ranges, done = self.pending
        self.pending = ranges, done + blocks

    def end_pending(self):
        """Say that all of the pending samples are in the states."""
        self.ranges, self.pending = self.ranges + list(self.pending[0]), None

    def begin(self, records, example):
        """Make empty states for records of this structure, unless there are some."""
        if self.states:
            return
        self.structure = jax.tree.structure(example)
        self.states = {name: self._init(name, tally, records[name]) for name, tally in self.tallies.items()}

    def _init(self, name, tally, record):
        apart = self.replicates and name == "moments"
        if self.items:
            state = tally.init(record, (self.items,))
            return Replicates(state) if apart else state
        if apart:
            # Each replicate has a state for itself.
            return tally.init(jax.tree.map(lambda x: np.zeros((1, 1, *x.shape[1:])), record), (self.replicates,))
        return tally.init(record, ())

    def add(self, records, job):
        """Add the records of a job, which follows on those before."""
        for name, tally in self.tallies.items():
            self._fold(name, tally, records[name], job)
        # One call may hold fewer samples than there are integrals.
        self.drawn += job.samples

    def _fold(self, name, tally, record, job):
        state = self.states[name]
        if isinstance(state, Replicates):
            state.begin(int(job.replicate[0]))
            state = state.current
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
            which, apart = job.replicate[:blocks] - self.first, self.replicates and name == "moments"
            if apart and len(set(which)) == blocks:
                tally.add(state, record, which)
                return
            for block in range(blocks):
                where = (which[block],) if apart else ...
                tally.add(state, jax.tree.map(itemgetter(block), record), where, **_place(record, job.first[block]))

    def estimate(self) -> Estimate:
        """Return the estimate from all samples so far; where there are randomisations, from those that are complete.

        Raises:
            ValueError: there are none yet, or one of the tallies came from a file and is not known here.
        """
        if self.result is not None:
            return dataclasses.replace(self.result, sums=self)
        if unknown := [name for name, tally in self.tallies.items() if isinstance(tally, NotStored)]:
            name = unknown[0]
            raise ValueError(f"the tally {name!r}, {self.tallies[name].name}, is none of jaxmc's own: make it anew")
        complete = self.drawn // (self.points * (self.items or 1)) if self.replicates else 1
        if not ((complete and self.states) or self.moments):
            raise ValueError("there is no estimate yet: too few samples were drawn")
        moments, between, means = self.finish()
        results = {name: t.result(self.states[name]) for name, t in self.tallies.items() if name != "moments"}
        n = complete * self.points if self.replicates else self.n
        recipe = {**self.about, "n": n}
        if self.replicates:
            recipe |= {"replicates": complete, "points": self.points}
        estimate = Estimate(
            moments, n, results, self.seconds, recipe, self.structure, between, means,
            sums=None if self.recipe is None else self,
        )  # fmt: skip
        return self.view.shaped(estimate, self.chosen) if self.view else estimate

    def finish(self):
        """Return the moments of all samples, and moments and values of the means of the replicates."""
        if self.moments is not None:
            return self.moments
        state = self.states["moments"]
        if isinstance(state, Replicates):
            return *state.finish(self.drawn % (self.points * self.items) == 0), None
        moments = self.tallies["moments"].result(state)
        if not self.replicates:
            return moments, None, None
        whole = [_first(m, self.drawn // self.points) for m in moments]
        pooled, between = map(list, zip(*map(pool, whole), strict=True))
        return pooled, between, [m.mean for m in whole]


def _first(m: MomentsResult, count):
    """Return the moments of the first few replicates."""
    return MomentsResult(m.n[:count], m.mean[:count], [c[:count] for c in m.central], m.nonfinite)


def _place(record, first):
    """Return what a tally is told that goes by the order of samples: the number of the first sample of a block."""
    return {"first": int(first)} if "in_order" in record else {}
