"""Integrands that change with the number of the sample, so that a bias fades while samples come in."""

from collections.abc import Callable, Iterator

from .counts import positive
from .driver import blocks_of, family_run
from .estimate import Estimate
from .integrand import Integrand, as_integrand
from .moments import Moments
from .passes import doubling
from .run import Run
from .samplers import Independent
from .work import Progress


def integrate_progressively(
    make: Callable[[float], Integrand], *, n, items=None, key=0, tallies=None, progress=None, workers=None, chunk=None,
    kept=Moments(order=2),
) -> Iterator[Estimate]:  # fmt: skip
    """Return an iterator over estimates from more and more samples, of an integrand that may change with their number.

    Samples come in passes, of 1, 1, 2, 4 and so on up to 32, then an eighth of what is there. ``make(i)`` returns the
    integrand of a pass whose samples, counted from 1, have the numbers around i. All that it returns must differ in the
    values of ``params`` only, so that one kernel runs them all. An estimate is the plain mean of all samples so far: a
    sample's value depends on its index alone, as ever, and passes over disjoint parts of the samples add up. Its
    ``stderr`` counts differences between the passes as noise, so it is a little too large.

    With a bias b h^2 and a variance v / h^2 of one sample, as of a kernel of width h in two dimensions, h = h_0 i^(-p)
    makes the mean consistent for 0 < p < 1/2. Its bias is b h_0^2 n^(-2p) / (1 - 2p) and its variance
    v n^(2p - 1) / (h_0^2 (1 + 2p)), so the squared error falls as n^(-4p) or n^(2p - 1), whichever is slower, and
    fastest at p = 1/6, as n^(-2/3).

    Args:
        make: a function of the number of a sample, from 1.
        items: number of integrals of a family, as in ``integrate_each``; None for a single one.
        kept: of a family, as in ``integrate_each``.

    Points are independent ones. Other arguments and errors as in ``integrate``.
    """
    n = positive("n", n)
    first = as_integrand(make(1.0))
    if items is None:
        run = Run(first, key, Independent(), None, tallies, workers, blocks_of(chunk))
    else:
        run = family_run(first, items, key, Independent(), None, tallies, workers, chunk, kept)

    def estimates():
        with Progress(progress, run.total(n)) as bar:
            for ((_, start, stop),) in doubling([(0, 0, n)]):
                yield run.extend(make(0.5 * (start + 1 + stop)), start, stop, bar)

    return estimates()
