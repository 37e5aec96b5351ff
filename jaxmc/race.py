"""A race between ways to integrate: the error of each against its run time, rung by rung of a ladder of samples."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

import numpy as np

from .analysis.convergence import fit_rate

LADDER = tuple(1 << m for m in range(10, 28, 2))
SEEDS = 8


class Run(NamedTuple):
    """One estimate: its value, the samples that it took, and the wall time in seconds."""

    value: float
    n: int
    seconds: float


class Method(NamedTuple):
    """A way to integrate: ``run(n, seed)`` returns a ``Run`` of about n samples."""

    name: str
    run: Callable[[int, int], Run]
    own: bool = False
    error_bar: bool = True


class Rung(NamedTuple):
    """Root mean square relative error and median time over the seeds, and the time of the call that came first."""

    n: int
    error: float
    seconds: float
    first: float


@dataclass
class Curve:
    """What a method did on each rung of the ladder."""

    name: str
    own: bool
    error_bar: bool
    rungs: list[Rung] = field(default_factory=list)
    stopped: str = ""

    @property
    def compile_seconds(self):
        """How much longer the very first call took than one like it."""
        return max(0.0, self.rungs[0].first - self.rungs[0].seconds) if self.rungs else math.nan

    def slope(self, seeds):
        """Return slope and standard error of log error against log n, NaN where there are fewer than 3 rungs."""
        known = [r for r in self.rungs if 0.0 < r.error < math.inf]
        if len({r.n for r in known}) < 3:
            return math.nan, math.nan
        rate = fit_rate(np.array([r.n for r in known]), np.array([r.error**2 for r in known]), seeds)
        return rate.slope, rate.stderr

    def seconds_to(self, error):
        """Return the time at which the curve falls to ``error``, by interpolation between two rungs in log and log.

        The time of the first rung where that is good enough; infinite where the curve does not come down so far.
        """
        before = None
        for rung in self.rungs:
            if rung.error <= error:
                if before is None or not before.error > rung.error > 0.0:
                    return rung.seconds
                part = math.log(before.error / error) / math.log(before.error / rung.error)
                return before.seconds ** (1 - part) * rung.seconds**part
            before = rung
        return math.inf


def race(methods, exact, *, ladder=LADDER, seeds=SEEDS, seconds_each=10.0, enough=0.0, say=None) -> list[Curve]:
    """Measure methods side by side on an integral of value ``exact``: on each rung, seeds alternate between them.

    A method leaves when the next rung would take it beyond ``seconds_each`` in all, when its error is below ``enough``,
    or when it fails. The first call on each rung, which may compile, is recorded apart and is part of no median.
    """
    curves = {m.name: Curve(m.name, m.own, m.error_bar) for m in methods}
    spent, active = dict.fromkeys(curves, 0.0), list(methods)
    for rung, n in enumerate(ladder):
        growth = n / ladder[rung - 1] if rung else 1.0
        active = [m for m in active if _goes_on(curves[m.name], spent[m.name], growth, seeds, seconds_each, enough)]
        tried = {m.name: _first(m, n, curves[m.name]) for m in active}
        firsts = {name: run for name, run in tried.items() if run is not None}
        active = [m for m in active if m.name in firsts]
        if not active:
            break
        runs = {m.name: [] for m in active}
        for seed in range(1, seeds + 1):
            for method in active:
                runs[method.name].append(method.run(n, seed))
        for name, taken in runs.items():
            curves[name].rungs.append(_rung(taken, firsts[name].seconds, exact))
            # All compile on the first rung; those that compile on others too pay for it.
            spent[name] += sum(run.seconds for run in taken) + (firsts[name].seconds if rung else 0.0)
        if say is not None:
            say(f"  n = {n:,}: {len(active)} methods")
    return list(curves.values())


def _goes_on(curve, spent, growth, seeds, seconds_each, enough):
    if not curve.rungs:
        return True
    last = curve.rungs[-1]
    if last.error <= enough:
        curve.stopped = curve.stopped or "error small enough"
    elif spent + growth * last.seconds * (seeds + 1) > seconds_each:
        curve.stopped = curve.stopped or "time is up"
    return not curve.stopped


def _first(method, n, curve):
    """Return the first run on a rung, or None where the method fails: that ends its curve, not the others'."""
    try:
        return method.run(n, 0)
    except Exception as error:
        curve.stopped = f"{type(error).__name__}: {error}".splitlines()[0]
        return None


def _rung(runs, first, exact):
    error = math.sqrt(np.mean([(run.value / exact - 1.0) ** 2 for run in runs]))
    return Rung(max(run.n for run in runs), error, median(run.seconds for run in runs), first)


def timed(name, function, **about) -> Method:
    """Return the method of a function (n, seed) -> (value, samples taken), with our clock around it."""

    def run(n, seed):
        start = time.perf_counter()
        value, taken = function(n, seed)
        return Run(value, taken, time.perf_counter() - start)

    return Method(name, run, **about)
