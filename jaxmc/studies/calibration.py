"""The calibration lab: do intervals cover known integrals as often as they say, and who says that they might not?

Each combination of an integral and a sampler is estimated many times. Light tails should be covered at every level;
heavy ones should be refused. Last, the rule by which VEGAS combines its iterations is held against pooling.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm
from tqdm import tqdm

from .. import plot
from ..analysis.coverage import Coverage, coverage
from ..analysis.tails import clopper_pearson
from ..integration.combine import combine
from ..integration.driver import integrate, integrate_each
from ..integration.lattices import Lattice
from ..integration.nets import Halton, Sobol
from ..integration.samplers import Independent
from ..integration.stratified import LatinHypercube, Stratified
from ..known import GROUP, maker, offered
from ..report import Report

SAMPLERS = (Independent(), Sobol(), Lattice(), Halton(), LatinHypercube(), Stratified())
N = 4096  # samples of one estimate, of all randomisations together
RTOL = {"Independent": 1e-2, "Sobol": 4e-4}  # targets that ask for more than the first look
FIRST = 3  # of the samplers meet the heavy tails, which none can help
ITERATIONS, EACH = 16, 256  # of VEGAS, and samples of one
METHODS = ("pooled", "inverse variance")
LEVEL = 0.95  # that tables show


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: how often each integral is estimated, and with which samplers."""

    replicates: int = 300
    samplers: tuple = SAMPLERS
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 20 <= self.replicates <= 1 << 20:
            raise ValueError(f"the study estimates each integral 20 to 2^20 times, got replicates={self.replicates}")


# Integrals, as (name on offer, arguments). Most are multiples of powers of 1/2: float32 holds them as they are.

RATES, PLACES = (0.5, 1.0, 1.5, 2.0, 2.5), (0.375, 0.75, 0.25, 0.625, 0.5)
OVER_CORNER = {"emission": 4.0, "corner": (0, 0, 1), "edge_u": (0, 0.5, 0), "edge_v": (0.75, 0, 0), "normal": (0, 0, 1)}
TALL_WALL = {"corner": (-4, -12, -2), "edge_u": (0, 24, 0), "edge_v": (20, 0, 11), "normal": (0, 0, 1)}
SPIKES = ("spikes", {"dim": 2, "volume": math.pi / 4096})  # of width 1/64
LIGHT = (
    ("discontinuous", {"dim": 5, "a": RATES, "w": (0.625, 0.625)}),
    ("oscillatory", {"dim": 5, "a": RATES, "w": 0.125 / math.pi}),
    ("gaussian-peak", {"dim": 5, "a": RATES, "w": PLACES}),
    ("continuous", {"dim": 5, "a": RATES, "w": PLACES}),
    ("linear-product", {"dim": 5}),
    ("quad-light", {**OVER_CORNER, "lights": "mis"}),
    ("quad-light", {**TALL_WALL, "lights": "none"}),
    ("quad-light-in-mirror", {}),
    ("sphere-light", {"emission": 4.0, "theta": math.acos(0.8), "lights": "mis"}),
    ("sphere-light", {"radius": 2.0 * math.sin(1.4), "theta": 0.3, "lights": "none"}),
    ("sphere-light-in-mirror", {}),
    ("sphere-furnace", {"directions": "uniform"}),
)
HEAVY = (
    ("power", {"dim": 2, "a": 0.6}),
    ("firefly", {"dim": 2, "p": 1.0 / 4096, "A": 1024.5}),
    SPIKES,
    ("throughput-product", {"k": 10, "rho": 0.75}),
    ("throughput-product", {"k": 24, "rho": 0.75}),
)


def problems(table: Sequence[tuple[str, dict]]) -> list:
    """Return the integrals of a table such as ``LIGHT`` and ``HEAVY``, each with ``name``, ``integrand`` and ``exact``.

    Raises ``ValueError`` where an installed package offers no such name.
    """
    if missing := sorted({name for name, _ in table} - set(offered())):
        raise ValueError(
            f"the study needs integrals of the package analytic_scenes, which is not found: no installed package "
            f"offers {', '.join(missing)} among the entry points {GROUP}. Install jaxmc again: it comes with it"
        )
    return [maker(name)(**arguments) for name, arguments in table]


# The study.


class Cell(NamedTuple):
    """One combination, how it is sampled, and what came out."""

    problem: Any
    sampler: Any
    options: dict
    result: Coverage | None = None

    @property
    def by(self):
        return _name(self.sampler)


def _name(sampler):
    return type(sampler).__name__


def run(folder, settings: Settings = Settings(), light: Sequence | None = None, heavy: Sequence | None = None) -> Path:
    """Run the study and return the path of its ``report.html``.

    ``light`` and ``heavy`` replace the integrals: anything with ``name``, ``integrand`` and ``exact``, such as an
    ``AnalyticScene``. Raises ``ValueError`` where the integrals are not installed or the folder cannot be written.
    """
    light = problems(LIGHT) if light is None else light
    heavy = problems(HEAVY) if heavy is None else heavy
    report = Report(folder, "Do error bars hold?", seed=settings.seed)
    groups = {
        "light": [Cell(p, s, {"n": N}) for p in light for s in settings.samplers],
        "stopped": [Cell(light[0], s, {"rtol": RTOL[name]}) for s in settings.samplers if (name := _name(s)) in RTOL],
        "heavy": [Cell(p, s, {"n": N}) for p in heavy for s in settings.samplers[:FIRST]],
    }
    total, started = sum(map(len, groups.values())) * settings.replicates, time.perf_counter()
    with tqdm(total=total, unit=" runs", disable=not settings.progress, smoothing=0.05) as bar:
        streams = itertools.count()
        groups = {name: [_measure(c, settings, next(streams), bar) for c in cells] for name, cells in groups.items()}
    _show(report, settings, groups)
    _show_rules(report, settings)
    report.values({"replicates": settings.replicates, "runs": total, "seconds": time.perf_counter() - started})
    return report.save()


def _key(settings, stream):
    """Return the first key of a stream of 2^21 runs of its own: combinations share no points."""
    return (settings.seed << 32) + (stream << 21)


def _measure(cell, settings, stream, bar):
    bar.set_description(f"{cell.problem.name}, {cell.by}")
    f, first = cell.problem.integrand, _key(settings, stream)
    result = coverage(
        lambda key: integrate(f, sampler=cell.sampler, key=first + key, **cell.options), cell.problem.exact,
        replicates=settings.replicates, progress=lambda done, total: bar.update(),
    )  # fmt: skip
    return cell._replace(result=result)


def _show(report, settings, groups):
    report.section("Light tails: intervals should cover")
    holds = sum(c.result.status() == "holds" for c in groups["light"])
    report.text(
        f"Each row is {settings.replicates} independent estimates of about {N} samples. Of {len(groups['light'])} "
        f"combinations of an integral and a sampler, **{holds} hold** at all levels. A right one is called wrong once "
        "in 1000 times. *Claimed / actual* is the error bar over the true error, both root mean squares."
    )
    _table(report, groups["light"], "Fixed numbers of samples.")
    _figures(report, groups["light"])
    report.section("Stopped by their own error")
    report.text("Half the 95 % interval is to be below rtol times the mean; the error that is tested ends the run.")
    _table(report, groups["stopped"], f"Targets: {', '.join(f'rtol={r:g} for {s}' for s, r in RTOL.items())}.")
    report.section("Heavy tails: intervals should be refused")
    report.text(
        "An estimate is refused where few samples make its variance. One that has not met a rare bright sample cannot "
        "know of it: it claims, and is wrong. The column *claims that miss* is the share of all estimates."
    )
    _table(report, groups["heavy"], "Fixed numbers of samples.")
    for name, cells in groups.items():
        report.value(f"{name}: verdicts", {f"{c.problem.name}, {c.by}": c.result.verdict for c in cells})


def _table(report, cells, caption):
    headers = ["integral", "sampler", "n", "covered at 0.95", "95% band", "refused", "claims that miss",
               "claimed / actual", "bias", "verdict"]  # fmt: skip
    rows = []
    for cell in cells:
        c, level = cell.result, cell.result.levels.index(LEVEL)
        lower, upper = (ends[0, level] for ends in c.band())
        missing = (c.claims - c.hits[0, level]) / c.replicates
        band, refused = f"{lower:.3f} to {upper:.3f}", f"{1.0 - c.claims / c.replicates:.1%}"
        ratio, bias = ("{:.2f} ± {:.2f}".format(*p) if np.isfinite(p[0]) else None for p in (c.ratio, c.bias))
        named = [cell.problem.name, cell.by, c.n, c.covered[0, level]]
        rows.append([*named, band, refused, f"{missing:.1%}", ratio, bias, c.status()])
    report.table(headers, rows, f"{caption} Bias is in standard deviations of one estimate.")


def _figures(report, cells):
    by_sampler = {}
    for cell in cells:
        by_sampler.setdefault(cell.by, {})[cell.problem.name] = cell.result
    by_sampler = {name: measured for name, measured in by_sampler.items() if any(c.claims for c in measured.values())}
    figures = [plot.panels(len(by_sampler), 3, (4.2, 3.4)) for _ in range(2)]
    for i, (name, measured) in enumerate(by_sampler.items()):
        reliability, scores = (axes[i] for _, axes in figures)
        plot.reliability(reliability, measured)
        dof = next(c.dof for c in measured.values() if c.claims)
        plot.z_scores(scores, np.concatenate([c.z for c in measured.values()]), dof)
        reliability.set_title(name, fontsize=10)
        scores.set_title(name, fontsize=10)
    if by_sampler:
        plot.shared_legend(figures[0][0])
        report.figure(figures[0][0], "reliability", "Light tails: each line is an integral; right ones stay in grey.")
        report.figure(figures[1][0], "z_scores", "Errors in units of their error bars, all light integrals together.")


def _show_rules(report, settings):
    means, covers, exact = _rules(settings)
    report.section("The rule of VEGAS against pooling")
    report.text(
        f"{ITERATIONS} iterations of {EACH} samples of the spikes, {settings.replicates} times, with no map learnt. "
        "Weights 1/variance trust most those iterations that missed the spikes, since their variance is small too. "
        "Pooling weighs by the number of samples. (G. P. Lepage, J. Comput. Phys. 27, 1978.)"
    )
    rows = []
    for rule in METHODS:
        mean, error = (float(x / exact) for x in (means[rule].mean(), means[rule].std(ddof=1)))
        lower, upper = clopper_pearson(covers[rule].sum(), settings.replicates)
        band = f"{lower:.3f} to {upper:.3f}"
        rows.append([rule, mean, error / math.sqrt(settings.replicates), float(covers[rule].mean()), band])
    report.table(["rule", "mean / truth", "stderr", "covered at 0.95", "95% band"], rows, "Normal intervals.")
    fig, (ax,) = plot.panels(1, 1, (6.4, 3.8))
    plot.histograms(ax, {r: means[r] / exact for r in METHODS}, np.linspace(0, 2.5, 51), 1.0, "combined mean / truth")
    report.figure(fig, "rules", "Combined means of the same iterations by both rules.")


def _rules(settings):
    """Return combined means and whether their intervals cover, shape (replicates,), by rule, and the truth."""
    (problem,) = problems([SPIKES])
    f = problem.integrand
    family = dataclasses.replace(f, fn=lambda u, *arguments: f.fn(u, *arguments[:-1]))  # the same, whatever its number
    first = _key(settings, 1 << 10)
    keys = range(first, first + ITERATIONS)
    iterations = [integrate_each(family, settings.replicates, n=EACH, key=key) for key in keys]
    combined = {rule: combine(iterations, rule) for rule in METHODS}
    half = norm.isf(0.5 - 0.5 * LEVEL)
    covers = {rule: np.abs(c.mean - problem.exact) <= half * c.stderr for rule, c in combined.items()}
    return {rule: c.mean for rule, c in combined.items()}, covers, problem.exact
