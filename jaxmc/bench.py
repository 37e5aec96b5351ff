"""Error against run time: of our samplers, and of other integrators on the same integral, in one run."""

import inspect
import math
from dataclasses import asdict
from functools import cache, partial

import jax
import numpy as np

from . import estimator, integrate, other_integrators, plot, report
from .integration.compiled import MOST
from .integration.lattices import Lattice
from .integration.nets import Halton, Sobol
from .integration.samplers import Independent
from .integration.stratified import LatinHypercube, Stratified
from .known import maker
from .race import SEEDS, Curve, Method, race, timed

SAMPLERS = (Independent(), Sobol(), Lattice(), Halton(), LatinHypercube(), Stratified())
SINGLE = (Sobol(), Lattice())  # also compiled, with an error bar and without: other integrators have none either
FEW = 4  # dimensions in which adaptive cubature pays
ROUNDING = 4 * float(np.finfo(np.float32).eps)  # below it there is nothing to see in float32
REGION = 100  # points to a region of quadax's rule, about


def own_methods(integrand, samplers=SAMPLERS, single=SINGLE) -> list[Method]:
    """Return ``integrate`` with each sampler, and for ``single`` the compiled ``estimator``: with an error bar, and as
    one randomisation."""
    compiled = cache(lambda sampler, replicates, n: estimator(integrand, n=n, sampler=sampler, replicates=replicates))

    def driven(sampler, replicates, n, seed):
        estimate = integrate(integrand, n=n, key=seed, sampler=sampler, replicates=replicates)
        return float(np.mean(estimate.mean)), estimate.n

    def direct(sampler, replicates, n, seed):
        if n > MOST:
            return driven(sampler, replicates, n, seed)
        return float(np.mean(compiled(sampler, replicates, n)(seed).mean)), n

    names = {sampler: type(sampler).__name__ for sampler in (*samplers, *single)}
    return [
        *(timed(names[s], partial(driven, s, None), own=True) for s in samplers),
        *(timed(f"{names[s]}, compiled", partial(direct, s, 16), own=True) for s in single),
        *(timed(f"{names[s]}, 1 replicate", partial(direct, s, 1), own=True, error_bar=False) for s in single),
    ]


def other_methods(integrand) -> list[Method]:
    """Return the other integrators that are installed, on the compiled, vectorised integrand."""

    def batch(u):
        # Fill up to a power of two: vegas changes the size of its batches, and JAX compiles for each.
        more = (1 << (len(u) - 1).bit_length()) - len(u)
        return np.array(integrand.batch(np.pad(u, ((0, more), (0, 0)), mode="edge")), float)[: len(u)]

    found = [
        timed(name, function, error_bar=not name.endswith(other_integrators.POINTS_ONLY))
        for name, function in other_integrators.integrators(batch, integrand.dim).items()
    ]
    if "quadax" in other_integrators.versions() and integrand.dim <= FEW:
        found.append(timed("quadax cubature", partial(_quadax, integrand)))
    return found


def _quadax(integrand, n, seed):
    """Divide the cube adaptively, by a rule of Genz and Malik, into at most n / 100 regions; has no seed."""
    regions = max(1, n // REGION)
    return float(_cubature(integrand, regions)), regions * REGION


@partial(jax.jit, static_argnums=1)
def _cubature(integrand, regions):
    import quadax  # pyright: ignore[reportMissingImports]

    box = np.array([[0.0, 1.0]] * integrand.dim, np.float32)
    return quadax.cubegm(integrand, box, epsabs=0.0, epsrel=0.0, max_nregion=regions)[0]


def problem(name, dim=None):
    """Return the integrand of known value called ``name``: one that a package offers, or ``module:function``.

    The function gets ``dim`` if it takes that, and returns an object with ``name``, ``integrand`` and ``exact``.
    Raises ``ValueError`` where there is none.
    """
    make = maker(name)
    sized = "dim" in inspect.signature(make).parameters
    return make(dim=dim) if sized and dim is not None else make()


def table(curves, seeds=SEEDS) -> str:
    """Return the last rung of each curve in words, with its slope and the time that compiling took."""
    lines = [f"{'':24s} {'n':>12s} {'error':>9s} {'time':>10s}   {'slope':14s} first call"]
    for curve in sorted(curves, key=lambda c: not c.own):
        if not curve.rungs:
            lines.append(f"{curve.name:24s} failed: {curve.stopped}")
            continue
        last, (slope, error) = curve.rungs[-1], curve.slope(seeds)
        rate = "-" if math.isnan(slope) else f"{slope:.2f} +- {error:.2f}"
        lines.append(
            f"{curve.name:24s} {last.n:12,d} {last.error:9.1e} {1e3 * last.seconds:7.1f} ms   {rate:14s} "
            f"+{curve.compile_seconds:.2f} s"
        )
    return "\n".join(lines)


def as_dict(curves, seeds=SEEDS) -> dict:
    """Return curves as plain data."""
    return {
        curve.name: {
            **{key: value for key, value in asdict(curve).items() if key not in ("name", "rungs")},
            "compile_seconds": curve.compile_seconds,
            "slope": curve.slope(seeds),
            "rungs": [rung._asdict() for rung in curve.rungs],
        }
        for curve in curves
    }


def about() -> dict:
    """Return machine and versions, ours and of the other integrators."""
    return {"machine": report.machine(), "versions": report.versions() | other_integrators.versions()}


def run(name, dim, max_seconds, out, say=print) -> list[Curve]:
    """Measure every sampler and every other integrator that is installed on one integrand; write figure and JSON.

    Raises ``ValueError`` for an unknown integrand, one whose integral is zero, or a folder that cannot be written.
    """
    scene = problem(name, dim)
    if not scene.exact:
        raise ValueError(f"{scene.name} integrates to 0: relative errors have no meaning")
    out = report.writable_folder(out)
    methods = own_methods(scene.integrand) + other_methods(scene.integrand)
    say(f"{scene.name}: {len(methods)} methods, RMS relative error over {SEEDS} seeds")
    curves = race(methods, scene.exact, seconds_each=max_seconds / len(methods), enough=ROUNDING)
    say(table(curves))
    fig, (ax,) = plot.panels(1, 1, size=(8.0, 5.0))
    plot.time_to_error(ax, curves, scene.name)
    plot.shared_legend(fig)
    fig.savefig(out / "time_to_error.png", dpi=150)
    report.write_json(
        out / "time_to_error.json",
        {"integrand": scene.name, "exact": scene.exact, "seeds": SEEDS, **about(), "methods": as_dict(curves)},
    )
    say(f"figure and numbers: {out}/time_to_error.png and .json")
    return curves
