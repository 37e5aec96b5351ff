"""Families of integrals, such as the pixels of an image, that several processes make: each has integrals of its own.

The integrals are cut into stripes, which are dealt to the processes in turn. Each adds up the samples of its stripes
in the order of a single process, so sums have the same bits. They are exchanged once at the end, and sent to process 0
for a checkpoint.
"""

import copy
import itertools
import json
import math
import time

import numpy as np

from .. import backend
from .kernel import ROWS, VECTOR, remaining
from .merging import join_items
from .moments import Replicates, _PowerSums
from .storage import from_bytes, to_bytes

ROUND = 5.0  # seconds of work between two looks whether it is time for a checkpoint


def can_deal(run, team) -> bool:
    """Return whether the processes can each have integrals of their own, and end with the bits of a single process."""
    return bool(run.items) and run.sums.items >= team.size * VECTOR and run.sums.divisible


def places_of(rank, size, count) -> np.ndarray:
    """Return which of ``count`` integrals process ``rank`` of ``size`` has: stripes no wider than a row of a block."""
    stripes = size * math.ceil(count / (size * backend.widths().lanes))
    edges = np.arange(stripes + 1) * count // stripes
    return np.flatnonzero(np.repeat(np.arange(stripes) % size, np.diff(edges)) == rank)


def add_dealt(run, team, bar):
    """Add the pending samples of ``run.sums``, of which this process makes those of its own integrals."""
    sums = run.sums
    _end_step(run, bar)
    ranges, done = sums.pending
    steps = _steps(ranges, done // _blocks(run))
    hand = Hand(run, team, bar)
    plan = Plan(run.keeper, team)
    while True:
        count, write = plan.next(len(steps))
        if write:
            hand.show(everyone=False)
            run.keeper.after_job(due=True)
        if not count:
            break
        now, steps = steps[:count], steps[count:]
        hand.add(now)
        sums.has_added(count * _blocks(run))
    hand.show(everyone=True)


def _blocks(run):
    """Return how many blocks of the kernel a step has, which is ``ROWS`` samples of every integral."""
    return -(-run.sums.items // run.lanes)


def _steps(ranges, done):
    """Return what is left of ``ranges`` behind the first steps, as one range for each step."""
    left = remaining(ranges, ROWS, done)
    return [(r, first, min(first + ROWS, stop)) for r, start, stop in left for first in range(start, stop, ROWS)]


def _end_step(run, bar):
    """End a step that a single process has begun, so that all integrals have the same samples: everybody does that."""
    ranges, done = run.sums.pending
    begun = done % _blocks(run)
    if begun:
        whole = _blocks(run) - begun
        run.fold(itertools.islice(run.jobs(ranges, done, blocks=1), whole), bar)


class Hand:
    """The integrals of a family that this process has, and their sums."""

    def __init__(self, run, team, bar):
        self.whole, self.team = run.sums, team
        count = run.sums.items
        self.places = [places_of(rank, team.size, count) for rank in range(team.size)]
        own = self.places[team.rank]
        self.run, self.bar = run.some(own), Share(bar, team, count / len(own))
        self._take()

    def _take(self):
        """Take over what there is of the sums of the own integrals. Process 0 has what all integrals share."""
        mine, whole, own = self.run.sums, self.whole, self.places[self.team.rank]
        self.run.begin()
        if whole.states:
            first = self.team.rank == 0
            for name, tally in whole.tallies.items():
                if tally.pooled:
                    mine.states[name] = whole.states[name] if first else mine.states[name]
                else:
                    mine.states[name] = _taken(whole.states[name], own, first)

    def add(self, steps):
        """Add the samples of a few steps."""
        before = self.run.sums.drawn
        self.run.sums.pending = steps, 0
        self.run.fold(self.run.jobs(steps, 0), self.bar)
        self.whole.drawn += (self.run.sums.drawn - before) // self.run.sums.items * self.whole.items

    def show(self, everyone):
        """Put the sums of all processes together: in all of them, or only in the first one."""
        own = self.run.sums.states
        contents = self.team.exchange(to_bytes(own), everyone)
        if contents:
            others = (from_bytes(content) if rank != self.team.rank else own for rank, content in enumerate(contents))
            groups = list(others if everyone else map(copy.deepcopy, others))
            order = np.argsort(np.concatenate(self.places))
            self.whole.states = join_items(self.whole.tallies, groups, order)
            self.whole.structure = self.run.sums.structure


def _taken(state, own, first):
    """Return the part of a state that belongs to some integrals; what belongs to all goes to the ``first`` process."""
    if isinstance(state, _PowerSums):
        rows, powers = (state.n[own], state.center[own]), (state.total[:, own], state.carry[:, own])
        return _PowerSums(*rows, *powers, state.nonfinite if first else 0)
    if isinstance(state, Replicates):
        some = copy.copy(state)
        for name in ("current", "pooled", "between"):
            setattr(some, name, _taken(getattr(state, name), own, first))
        return some
    if isinstance(state, dict):
        return {name: _taken(one, own, first) for name, one in state.items()}
    if isinstance(state, list):
        return [_taken(one, own, first) for one in state]
    if isinstance(state, np.ndarray):
        return state[own]
    return state if first or isinstance(state, bool) else type(state)(0)


class Plan:
    """What process 0 says that all do next: so many steps, and before them a checkpoint or none."""

    def __init__(self, keeper, team):
        self.keeper, self.team = keeper, team
        self.count, self.began = 0, 0.0

    def next(self, left):
        """Return how many of the steps that are left to do now, and whether to write a checkpoint first."""
        if self.keeper is None or not left:
            return left, False
        if self.team.rank == 0:
            self.team.say(json.dumps(self._decide(left)))
        elif self.keeper.interrupted:
            self.keeper.after_job()
        return json.loads(self.team.hear())

    def _decide(self, left):
        now = time.monotonic()
        write = bool(self.count) and (self.keeper.interrupted or now >= self.keeper.due)
        # As many steps as fit in a round; one where each is to be kept, and at first, for it compiles the kernel.
        fit = int(ROUND * self.count / max(now - self.began, 1e-9)) if self.keeper.seconds else 1
        self.count, self.began = min(left, max(1, min(fit, 4 * max(self.count, 1)))), now
        return self.count, write


class Share:
    """The progress of a family by that of the own integrals; looks now and then whether the others are alive."""

    def __init__(self, bar, team, factor):
        self.bar, self.team, self.factor, self.own, self.shown = bar, team, factor, 0, 0

    def update(self, samples):
        self.own += samples
        whole = round(self.own * self.factor)
        self.bar.update(whole - self.shown)
        self.shown = whole
        self.team.look()
