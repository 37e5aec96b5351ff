"""When to stop: targets for the error, and how many samples to take next.

The interval that is reported must not be one that was picked for being short. So independent samples are only added to,
and there are so many that their variance is known well; other points are drawn afresh, in new randomisations, each time
their number grows, and aim well below the target, so that the last interval is hardly ever sent back.
"""

import dataclasses
import math
import time

import numpy as np

from .counts import positive

LEVEL = 0.95
FIRST = 1 << 16  # samples of the first look
GROWTH = 64  # at most, from one look to the next
MARGIN_INDEPENDENT = 1.03  # aim at an interval so many times shorter than the target
MARGIN_REPLICATES = 1.5
RATE_REPLICATES = 0.75  # error ~ n^-rate is assumed of evenly spread points until two looks have shown another
MAX_N = 1 << 32


@dataclasses.dataclass(frozen=True)
class Target:
    """Half the width of the interval is to be at most max(atol, rtol |mean|), within a budget."""

    rtol: float
    atol: float
    max_n: int
    max_seconds: float

    def excess(self, estimate) -> float:
        """Return how many times too wide the widest interval is."""
        ratios = []
        for m, half in zip(estimate.moments, estimate.half_widths(LEVEL), strict=True):
            with np.errstate(all="ignore"):
                ratio = half / np.maximum(self.atol, self.rtol * np.abs(m.mean))
            # An error of 0 meets any target, even that of a mean of 0.
            ratios.append(np.max(np.where(half == 0.0, 0.0, ratio)))
        worst = float(np.max(ratios))
        return worst if worst >= 0.0 else math.inf


def target(n, rtol, atol, max_n, max_seconds) -> Target | None:
    """Return the target that the arguments of ``integrate`` mean, None for a fixed number of samples."""
    for name, value in (("rtol", rtol), ("atol", atol), ("max_seconds", max_seconds)):
        if value is not None and not (np.isscalar(value) and np.isreal(value) and 0.0 < value < math.inf):
            raise ValueError(f"{name} must be a positive number, got {value!r}")
    if n is not None:
        if any(x is not None for x in (rtol, atol, max_n, max_seconds)):
            raise ValueError("give either n, or a target (rtol, atol) and a budget (max_n, max_seconds), not both")
        return None
    if rtol is None and atol is None and max_seconds is None:
        raise ValueError("say how many samples (n=...), how exact (rtol=..., atol=...) or how long (max_seconds=...)")
    return Target(
        rtol or 0.0, atol or 0.0, positive("max_n", MAX_N if max_n is None else max_n), max_seconds or math.inf
    )


def run_until(target: Target, run, bar):
    """Let ``run`` grow until the target is met or the budget is spent, and return its last estimate."""
    deadline = time.perf_counter() + target.max_seconds - run.seconds_before
    # A run that goes on from a checkpoint has had some looks, and is in the middle of one.
    looks, n = run.sums.looks, run.sums.goal or min(FIRST, target.max_n)
    estimate = None
    while True:
        began = time.perf_counter()
        # The first estimate is to be had at any price; one of independent samples may be cut short.
        needed = estimate is None and (run.replicates is not None or not looks)
        grown = run.stream(n, bar, math.inf if needed else deadline)
        if grown is None:
            break
        estimate, excess = grown, target.excess(grown)
        looks.append((grown.n, excess, time.perf_counter() - began))
        reached = excess <= 1.0 and not grown.heavy and not grown.nonfinite
        if reached or grown.nonfinite or grown.n >= target.max_n or time.perf_counter() >= deadline:
            break
        n = next_n(target, looks, run.replicates is not None, deadline - time.perf_counter())
        if n <= grown.n:
            break
    return dataclasses.replace(estimate, reached=looks[-1][1] <= 1.0, seconds=run.seconds)


def next_n(target: Target, looks, replicates: bool, seconds_left: float) -> int:
    """Return how many samples the next look should have; no more than before if there is no use in going on."""
    n, excess, seconds = looks[-1]
    rate, margin = _rate(looks) if replicates else 0.5, MARGIN_REPLICATES if replicates else MARGIN_INDEPENDENT
    wanted = n * min(max((margin * excess) ** (1.0 / rate), 2.0 if replicates else 1.1), GROWTH)
    # Fresh points cost all of their time again: take no more than fit in what is left.
    fit = n * seconds_left / seconds if replicates else math.inf
    n_next = min(wanted, target.max_n, fit)
    if replicates and n_next < wanted:
        n_next = 2.0 ** math.floor(math.log2(max(n_next, 1.0)))
    return int(n_next)


def _rate(looks):
    """Return the rate of convergence that the last two looks show, with caution."""
    if len(looks) < 2 or not 0.0 < looks[-1][1] < looks[-2][1] < math.inf:
        return RATE_REPLICATES if len(looks) < 2 else 0.5
    (n0, e0, _), (n1, e1, _) = looks[-2:]
    return float(np.clip(math.log(e0 / e1) / math.log(n1 / n0), 0.5, 1.25))
