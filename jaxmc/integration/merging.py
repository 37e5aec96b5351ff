"""One estimate from parts that were made apart: by other samples, or other integrals of a family."""

import copy
import functools
import itertools
from collections.abc import Sequence

import numpy as np

from .estimate import Estimate
from .moments import Replicates, _PowerSums
from .recipes import PART, difference
from .sums import Sums


def merge(*parts: Estimate) -> Estimate:
    """Return the estimate from all samples of several parts of one estimate, in whatever order they come.

    Parts are made by ``integrate`` or ``render`` with ``indices=`` or ``tiles=``, or come from files, of checkpoints
    too, by ``Estimate.load``. They must be of one recipe: integrand with its parameters, key, sampler, tallies. No
    sample may be in two of them. ``seconds`` adds up too.

    Parts by tiles, and parts of single integrals by whole randomisations, add up to the bits of a single run. Parts by
    samples do so for tallies that are exact, such as ``TailHistogram`` and ``TopSamples``. Other sums are rounded in
    another place, where samples are cut into other blocks: moments then differ by some 1e-7 of their error.

    Raises:
        ValueError: no parts, parts that overlap, differ in their recipe, are unfinished or ran towards a target;
            estimates that were made whole, and kept no sums.
    """
    if not parts:
        raise ValueError("merge wants at least one estimate, got none")
    found = [_sums_of(part, f"part {i}") for i, part in enumerate(parts)]
    for i, other in enumerate(found[1:]):
        if what := difference(found[0].recipe, other.recipe, PART):
            raise ValueError(f"parts must be of one estimate, but part {i + 1} has, against part 0, {what}")
    groups: dict[bytes, list[Sums]] = {}
    for sums in found:
        groups.setdefault(b"" if sums.chosen is None else sums.chosen.tobytes(), []).append(sums)
    whole = [_by_samples(group) for group in groups.values()]
    return (whole[0] if len(whole) == 1 else _by_items(whole)).estimate()


def _sums_of(part, name) -> Sums:
    if not isinstance(part, Estimate):
        raise ValueError(f"merge wants estimates, but {name} is {part!r}; read files with Estimate.load")
    sums = part.sums
    if sums is None:
        raise ValueError(f"{name} kept no sums: make it with indices=, tiles= or checkpoint=")
    if not sums.finished:
        raise ValueError(f"{name} is unfinished: run it again with its checkpoint first")
    if sums.recipe["target"] is not None:
        raise ValueError(f"{name} ran towards a target; parts have a fixed number of samples")
    return sums


def _by_samples(group: Sequence[Sums]) -> Sums:
    """Return the sums over samples of the same integrals."""
    group = sorted(group, key=lambda sums: min(sums.ranges))
    ranges = sorted(one for sums in group for one in sums.ranges)
    for (r, _, stop), (other, begin, end) in itertools.pairwise(ranges):
        if r == other and begin < stop:
            where = f" of randomisation {r}" if r else ""
            raise ValueError(f"parts overlap: samples {begin} to {min(stop, end)}{where} are in two of them")
    total = copy.deepcopy(group[0])
    for sums in group[1:]:
        for name, tally in total.tallies.items():
            total.states[name] = _merged(total, name, tally, sums)
        total.drawn += sums.drawn
        total.seconds += sums.seconds
        if total.replicates:
            total.replicates += sums.replicates
    total.ranges = _joined(ranges)
    _describe(total)
    return total


def _merged(total, name, tally, sums):
    a, b = total.states[name], copy.deepcopy(sums.states[name])
    if isinstance(a, Replicates):
        for mine, other in zip(a.pooled + a.between, b.pooled + b.between, strict=True):
            mine.merge(other)
        return a
    if name == "moments" and total.replicates:
        # Each replicate has sums of its own.
        return [_side_by_side([x, y], slice(None)) for x, y in zip(a, b, strict=True)]
    return tally.merge(a, b)


def _by_items(groups: Sequence[Sums]) -> Sums:
    """Return the sums of the integrals of all groups, which must have the same samples."""
    first = groups[0]
    if any(sums.chosen is None for sums in groups) or any(sums.ranges != first.ranges for sums in groups):
        raise ValueError("parts by tiles must each have the same samples of their pixels; merge those by samples first")
    chosen = np.concatenate([sums.chosen for sums in groups])
    order = np.argsort(chosen)
    if (np.diff(chosen[order]) == 0).any():
        raise ValueError("parts overlap: some pixels are in two of them")
    total = copy.deepcopy(first)
    total.states = join_items(total.tallies, copy.deepcopy([sums.states for sums in groups]), order)
    total.items, total.chosen = len(chosen), chosen[order]
    total.drawn, total.seconds = sum(sums.drawn for sums in groups), sum(sums.seconds for sums in groups)
    if total.items == total.recipe["items"]:
        total.chosen = None
    _describe(total)
    return total


def join_items(tallies, groups, order):
    """Return states by name of the integrals of all groups, of which ``order`` says how to sort them."""
    joined = {}
    for name, tally in tallies.items():
        states = [states[name] for states in groups]
        joined[name] = functools.reduce(tally.merge, states) if tally.pooled else _side_by_side(states, order)
    return joined


def _side_by_side(parts, order):
    """Return states of a family from those of parts of it: arrays have the integrals on their first axis."""
    one = parts[0]
    if isinstance(one, _PowerSums):
        rows = (np.concatenate([getattr(p, k) for p in parts])[order] for k in ("n", "center"))
        powers = (np.concatenate([getattr(p, k) for p in parts], 1)[:, order] for k in ("total", "carry"))
        return _PowerSums(*rows, *powers, sum(p.nonfinite for p in parts))
    if isinstance(one, Replicates):
        both = copy.copy(one)
        for k in ("current", "pooled", "between"):
            setattr(both, k, _side_by_side([getattr(p, k) for p in parts], order))
        return both
    if isinstance(one, dict):
        return {k: _side_by_side([p[k] for p in parts], order) for k in one}
    if isinstance(one, list):
        return [_side_by_side(some, order) for some in zip(*parts, strict=True)]
    if isinstance(one, np.ndarray):
        return np.concatenate(parts)[order]
    return one if isinstance(one, bool) else sum(parts)


def _joined(ranges):
    """Return sorted ranges, those that touch as one."""
    found = []
    for r, start, stop in ranges:
        if found and found[-1][0] == r and found[-1][2] == start:
            found[-1] = (r, found[-1][1], stop)
        else:
            found.append((r, start, stop))
    return found


def _describe(total: Sums):
    """Say in the recipe what is in the sums."""
    about = {k: v for k, v in total.about.items() if k not in ("indices", "integrals")}
    n, points = total.recipe["n"], total.points
    if total.replicates:
        whole = len(total.ranges) == total.recipe["replicates"]
        about |= {} if whole else {"randomisations": [r for r, *_ in total.ranges]}
    else:
        total.points = points = sum(stop - start for _, start, stop in total.ranges)
        n = max(n, max(stop for *_, stop in total.ranges))
        about |= {} if points == n else {"ranges": [[start, stop] for _, start, stop in total.ranges]}
    if total.chosen is not None:
        about["integrals"] = len(total.chosen)
    total.about, total.recipe = about, total.recipe | {"n": n, "indices": None, "chosen": None}
