"""Large families of integrals, such as the pixels of a large image, band by band: memory is that of the result.

The sums of a pixel take four times the room of its mean and error. Where nobody asks for them afterwards, a band of the
image gets all of its samples, and its sums are dropped before the next one. The bits are the same.
"""

import numpy as np

from . import machines
from .moments import MomentsResult

BAND = 1 << 20  # integrals


def pays(run) -> bool:
    """Return whether a run of a family can drop sums: there is no checkpoint, part, or tally of each integral."""
    sums = run.sums
    needed = run.keeper or run.part.about or machines.team() or sums.pending
    others = (tally.pooled for name, tally in sums.tallies.items() if name != "moments")
    return not needed and sums.items > BAND and sums.divisible and all(others)


def add_in_bands(run, ranges, points, bar):
    """Add samples to a run that has none, and leave it mean and error of each integral."""
    whole, count = run.sums, run.sums.items
    whole.points = points
    found = []
    for places in np.array_split(np.arange(count), -(-count // BAND)):
        some = run.some(places)
        some.sums.pending = ranges, 0
        some.fold(some.jobs(ranges, 0), bar)
        moments, between, _ = some.sums.finish()
        band = [*moments, *(between or [])]
        found = [_put(room, one, places) for room, one in zip(found or [_room(m, count) for m in band], band)]
        _merge(whole, some.sums)
    leaves = whole.structure.num_leaves
    shaped = [_shaped(m) for m in found]
    whole.moments = shaped[:leaves], shaped[leaves:] or None, None
    whole.ranges = list(ranges)


def _room(m: MomentsResult, count) -> MomentsResult:
    """Return moments of as many integrals, with room for all; how many samples they have is one number for each."""
    shape = (count, *m.mean.shape[1:])
    return MomentsResult(np.empty(count), np.empty(shape), [np.empty(shape) for _ in m.central], 0)


def _put(room: MomentsResult, m: MomentsResult, places) -> MomentsResult:
    band = slice(places[0], places[-1] + 1)
    room.n[band], room.mean[band] = m.n.reshape(len(m.n), -1)[:, 0], m.mean
    for x, one in zip(room.central, m.central, strict=True):
        x[band] = one
    return room._replace(nonfinite=room.nonfinite + m.nonfinite)


def _shaped(m: MomentsResult) -> MomentsResult:
    n = m.n.reshape(-1, *[1] * (m.mean.ndim - 1))
    return m._replace(n=np.broadcast_to(n, m.mean.shape))


def _merge(whole, some):
    """Add the pooled tallies of a band to those of all."""
    whole.structure, whole.drawn = some.structure, whole.drawn + some.drawn
    for name, tally in whole.tallies.items():
        if name != "moments":
            state = some.states[name]
            whole.states[name] = tally.merge(whole.states[name], state) if name in whole.states else state
