"""A family of integrals in passes, so that there is something to see from the first sample on."""

from collections.abc import Iterator

from .counts import positive
from .driver import family_run
from .estimate import Estimate
from .integrand import Integrand
from .kernel import ROWS
from .moments import Moments
from .samplers import Independent
from .work import Progress


def integrate_each_in_passes(
    f: Integrand, items: int, *, n, key=0, sampler=Independent(), replicates=None, tallies=None, progress=None,
    workers=None, chunk=None, kept=Moments(order=2),
) -> Iterator[Estimate]:  # fmt: skip
    """Return an iterator over estimates of a family of integrals from more and more of its samples.

    Each pass adds samples that no other has; the last estimate is that of ``integrate_each``, to rounding. Samples of
    each integral come in passes of 1, 1, 2, 4 and so on up to 32, then an eighth of what is there; where there are
    replicates, by whole replicates, one after the other. Arguments and errors as in ``integrate_each``.
    """
    n, run = positive("n", n), family_run(f, items, key, sampler, replicates, tallies, workers, chunk, kept)
    cut = doubling if run.replicates is None else one_by_one

    def estimates():
        with Progress(progress, run.total(n)) as bar:
            yield from run.passes(n, bar, cut)

    return estimates()


def doubling(ranges) -> Iterator[list]:
    """Cut ranges (replicate, start, stop) of samples into pieces that double until a block of the kernel is full, and
    then add an eighth.
    """
    for replicate, start, stop in ranges:
        while start < stop:
            step = max(1, start) if start < ROWS else max(1, start // (8 * ROWS)) * ROWS
            end = min(stop, start + step)
            yield [(replicate, start, end)]
            start = end


def one_by_one(ranges) -> Iterator[list]:
    """Give each range of samples, which is that of one replicate, a pass of its own."""
    return ([one] for one in ranges)
