"""The driver: estimates integrals, from a given number of samples or until a target is met.

Kernel calls run on as many threads as there are cores, and XLA keeps each call on one of them. Records are added in
the order of the blocks: a result is the same, bit for bit, for any chunk size and any number of workers.
"""

from .. import backend
from . import stopping
from .checkpoint import keep
from .counts import positive
from .estimate import Estimate
from .integrand import Integrand, as_integrand
from .kernel import ROWS, lanes_for, lanes_together
from .moments import Moments
from .parts import WHOLE, Part, part
from .run import Run
from .samplers import Independent
from .work import Progress

REPLICATES = 16  # of a single integral
SMALL, SMALL_LANES, MOST_BLOCKS = 8, 480, 16  # replicates of so few rows go together in one kernel call
REPLICATES_EACH = 4  # of each of a family: few samples are better not divided further


def integrate(
    f, *, dim=None, n=None, key=0, sampler=Independent(), replicates=None,
    rtol=None, atol=None, max_n=None, max_seconds=None, tallies=None, progress=None, workers=None, chunk=None,
    checkpoint=None, indices=None,
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
        checkpoint: a file, such as ``"run.npz"``, or a ``Checkpoint``, in which the sums are kept every ten seconds and
            at the end. Called again with the same arguments, after a kill at any moment, it goes on where it stopped,
            and ends with the same bits. Ctrl-C keeps what is done, and then raises ``KeyboardInterrupt``.
        indices: a ``range`` of the samples 0 <= s < n, to estimate from these only: ``merge`` adds such parts, made by
            several machines. For independent points n may be left out. Those of other samplers are counted over all
            randomisations, one after the other, and a part has whole ones.

    Returns:
        An ``Estimate``.

    Raises:
        ValueError: neither or both of n and a target, a number out of range, ``dim`` is missing or contradicts ``f``,
            a tally does not fit, or the file is damaged or keeps another run.
        OSError: the file cannot be read or written.
    """
    integrand, some = as_integrand(f, dim), part(indices)
    replicates = _replicates(replicates, sampler, REPLICATES)
    n = _number(n, indices, replicates)
    target = stopping.target(n, rtol, atol, max_n, max_seconds)
    n = n if n is None else positive("n", n)
    blocks, rows, lanes = blocks_of(chunk), ROWS, backend.widths().lanes
    if integrand.together:
        lanes = lanes_together(n if indices is None else None, replicates)
    elif n is not None and replicates and n // replicates < SMALL * SMALL_LANES:
        blocks, rows, lanes = max(blocks, min(replicates, MOST_BLOCKS)), SMALL, SMALL_LANES
    run = Run(integrand, key, sampler, replicates, tallies, workers, blocks, rows, lanes=lanes, part=some)
    with Progress(progress, run.total(n) if n is not None else None) as bar:
        grow = (lambda: run.stream(n, bar)) if target is None else (lambda: stopping.run_until(target, run, bar))
        return keep(run, checkpoint, n, target, bar, grow)


def integrate_each(
    f: Integrand, items: int, *, n, key=0, sampler=Independent(), replicates=None, tallies=None, progress=None,
    workers=None, chunk=None, kept=Moments(order=2), checkpoint=None, indices=None,
) -> Estimate:  # fmt: skip
    """Estimate a family of integrals, ``n`` samples each: an image is one integral for each pixel.

    ``f.fn(u, *params, item)`` gets the number of its integral, an integer below ``items``. Sample ``s`` of item ``i``
    has index ``s * items + i`` for independent points. For others its low word is s, counted in each randomisation, and
    its high word is ``r * items + i`` for randomisation r. Moments have a leading axis of length ``items``; tallies
    that are pooled run over all samples of all items. Arguments and errors otherwise as in ``integrate``.

    ``kept`` is the tally that mean and error come from: ``Moments``, or one whose state is a list of sums such as those
    of ``Moments``, which may let a sample count in more than one item.
    """
    run = family_run(f, items, key, sampler, replicates, tallies, workers, chunk, kept, part(indices))
    return family(run, n, progress, checkpoint)


def family(run, n, progress, checkpoint) -> Estimate:
    """Return the estimate of a run of a family of integrals, from ``n`` samples each."""
    n = positive("n", _number(n, run.part.indices, run.replicates))
    with Progress(progress, run.total(n)) as bar:
        return keep(run, checkpoint, n, None, bar, lambda: run.family(n, bar))


def family_run(
    f, items, key, sampler, replicates, tallies, workers, chunk, kept=Moments(order=2), some: Part = WHOLE, view=None
) -> Run:
    """Return the run of a family of integrals before its first sample; arguments as in ``integrate_each``."""
    f, items = as_integrand(f), positive("items", items)
    replicates = _replicates(replicates, sampler, REPLICATES_EACH)
    count = items if some.chosen is None else len(some.chosen)
    lanes = lanes_for(count)
    blocks = min(blocks_of(chunk), -(-count // lanes))
    return Run(
        f, key, sampler, replicates, tallies, workers, blocks, kept=kept, items=items, lanes=lanes, part=some, view=view
    )


def blocks_of(chunk):
    """Return how many blocks there are in a kernel call of so many samples, None for what suits the backend."""
    lanes, usual = backend.widths()
    return max(1, positive("chunk", usual if chunk is None else chunk) // (ROWS * lanes))


def _replicates(replicates, sampler, default):
    if isinstance(sampler, type) or not hasattr(sampler, "independent"):
        raise ValueError(f"sampler must be one such as mc.Independent() or mc.Sobol(), got {sampler!r}")
    if replicates is None:
        return None if sampler.independent else default
    return positive("replicates", replicates)


def _number(n, indices, replicates):
    """Return the number of samples of a whole, of which there may be ``indices`` only."""
    if n is not None or indices is None:
        return n
    if replicates:
        raise ValueError("indices of points with replicates need n, the number of samples of all parts together")
    return indices.stop
