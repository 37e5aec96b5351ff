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

import jax.numpy as jnp
import numpy as np
from scipy.special import erf
from scipy.stats import norm
from tqdm import tqdm

from .. import plot
from ..analysis.coverage import Coverage, coverage
from ..analysis.tails import clopper_pearson
from ..integration.combine import combine
from ..integration.driver import integrate, integrate_each
from ..integration.integrand import Integrand
from ..integration.lattices import Lattice
from ..integration.nets import Halton, Sobol
from ..integration.samplers import Independent
from ..integration.stratified import LatinHypercube, Stratified
from ..report import Report
from ..testing import ThroughputProduct
from ..transport.integrands import irradiance, radiance
from ..transport.materials import Diffuse
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene

SAMPLERS = (Independent(), Sobol(), Lattice(), Halton(), LatinHypercube(), Stratified())
N = 4096  # samples of one estimate, of all randomisations together
RTOL = {"Independent": 1e-2, "Sobol": 4e-4}  # targets that ask for more than the first look
HEAVY = 3  # of the samplers meet the heavy tails, which none can help
ITERATIONS, EACH = 16, 256  # of VEGAS, and samples of one
METHODS = ("pooled", "inverse variance")
LEVEL = 0.95  # that tables show


class Problem(NamedTuple):
    """A known integral. Whatever has these fields will do, such as an ``analytic_scenes.AnalyticScene``."""

    name: str
    integrand: Integrand
    exact: float


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


# Integrals that are known. Parameters are multiples of powers of 1/2: float32 holds them as they are.

RATES = np.array([0.5, 1.0, 1.5, 2.0, 2.5])
PLACES = np.array([0.375, 0.75, 0.25, 0.625, 0.5])
JUMP = 0.625  # where the discontinuous integrand ends, in two coordinates
CENTERS = np.array([[0.25, 0.75], [0.75, 0.625], [0.375, 0.25], [0.875, 0.125]])


def light_problems() -> tuple[Problem, ...]:
    """Return integrals that intervals should cover: four of Genz's families, a product and three scenes of light.

    Sources: Genz, Testing multidimensional integration routines (1984); for the lights Lambert, Photometria (1760).
    """
    wave = np.exp(0.25j) * np.prod(np.expm1(1j * RATES) / (1j * RATES))
    a, w = RATES, PLACES
    bell = np.prod(math.sqrt(math.pi) / (2 * a) * (erf(a * (1 - w)) + erf(a * w)))
    kink = np.prod(-(np.expm1(-a * w) + np.expm1(-a * (1 - w))) / a)
    jump = np.prod(np.expm1(a * [JUMP, JUMP, 1, 1, 1]) / a)
    return (
        Problem("Genz discontinuous", Integrand(discontinuous, 5, (a,)), float(jump)),
        Problem("Genz oscillatory", Integrand(oscillatory, 5, (a,)), float(wave.real)),
        Problem("Genz Gaussian peak", Integrand(gaussian_peak, 5, (a, w)), float(bell)),
        Problem("Genz continuous", Integrand(continuous, 5, (a, w)), float(kink)),
        Problem("linear product", Integrand(linear_product, 5), 1.0),
        *_scenes(),
    )


def _scenes():
    up = (0.0, 0.0, 1.0)
    lamp = Quad((0.0, 0.0, 1.0), (0.0, 0.5, 0.0), (0.75, 0.0, 0.0), material=Diffuse(0.0), emission=4.0)
    long, short = math.hypot(1.0, 0.75), math.hypot(1.0, 0.5)
    over_corner = 2.0 * (0.75 / long * math.atan(0.5 / long) + 0.5 / short * math.atan(0.75 / short))
    ball = Sphere((0.0, 0.0, 2.0), 0.5, material=Diffuse(0.0), emission=4.0)
    room = Sphere((0.0, 0.0, 0.0), 2.0, material=Diffuse(0.5), emission=1.0, inward=True)
    origin, furnace = (0.0, 0.0, 0.0), {"bounces": 3, "lights": "none", "directions": "uniform"}
    return (
        Problem("rectangle light", irradiance(Scene([lamp]), origin, up, bounces=0), over_corner),
        Problem("sphere light", irradiance(Scene([ball]), origin, (0.6, 0.0, 0.8), bounces=0), 0.2 * math.pi),
        Problem("furnace", radiance(Scene([room]), (0.5, -0.5, 0.25), up, **furnace), 1.875),
    )


def heavy_problems() -> tuple[Problem, ...]:
    """Return integrals whose error bars should be refused: infinite variance, or rare samples that carry much."""
    width = 1.0 / 64
    sides = 0.5 * math.sqrt(math.pi) * width * (erf((1 - CENTERS) / width) + erf(CENTERS / width))
    products = [ThroughputProduct(k, 0.75) for k in (10, 24)]
    return (
        Problem("power u^-0.6", Integrand(power, 2, (0.6,)), 0.4**-2.0),
        Problem("firefly 1/4096", Integrand(firefly, 2, (1.0 / 64,)), 0.5 + 1024 / 4096),
        Problem("spikes", Integrand(spikes, 2, (width,)), float(sides.prod(axis=1).sum())),
        *(Problem(f"product of {p.k} weights", Integrand(p.sample, p.dim), float(p.mean)) for p in products),
    )


def oscillatory(u, a):
    return jnp.cos(0.25 + jnp.sum(a * u))


def gaussian_peak(u, a, w):
    return jnp.exp(-jnp.sum((a * (u - w)) ** 2))


def continuous(u, a, w):
    return jnp.exp(-jnp.sum(a * jnp.abs(u - w)))


def discontinuous(u, a):
    return jnp.where((u[0] <= JUMP) & (u[1] <= JUMP), jnp.exp(jnp.sum(a * u)), 0.0)


def linear_product(u):
    return jnp.prod(0.5 + u)


def power(u, a):
    return (u[0] * u[1]) ** -a


def firefly(u, side):
    return 0.5 + jnp.where((u[0] < side) & (u[1] < side), 1024.0, 0.0)


def spikes(u, width, item=None):
    return jnp.sum(jnp.exp(-jnp.sum(((u - CENTERS) / width) ** 2, axis=1)))


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

    ``light`` and ``heavy`` replace the integrals: sequences of ``Problem`` or of anything with the same fields.
    """
    report = Report(folder, "Do error bars hold?", seed=settings.seed)
    light = light_problems() if light is None else light
    heavy = heavy_problems() if heavy is None else heavy
    groups = {
        "light": [Cell(p, s, {"n": N}) for p in light for s in settings.samplers],
        "stopped": [Cell(light[0], s, {"rtol": RTOL[name]}) for s in settings.samplers if (name := _name(s)) in RTOL],
        "heavy": [Cell(p, s, {"n": N}) for p in heavy for s in settings.samplers[:HEAVY]],
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
        if cell.result.claims:
            by_sampler.setdefault(cell.by, {})[cell.problem.name] = cell.result
    figures = [plot.panels(len(by_sampler), 3, (4.2, 3.4)) for _ in range(2)]
    for i, (name, measured) in enumerate(by_sampler.items()):
        reliability, scores = (axes[i] for _, axes in figures)
        plot.reliability(reliability, measured)
        plot.z_scores(scores, np.concatenate([c.z for c in measured.values()]), next(iter(measured.values())).dof)
        reliability.set_title(name, fontsize=10)
        scores.set_title(name, fontsize=10)
    if by_sampler:
        figures[0][1][0].legend(fontsize=6)
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
    problem = next(p for p in heavy_problems() if p.name == "spikes")
    first = _key(settings, 1 << 10)
    keys = range(first, first + ITERATIONS)
    iterations = [integrate_each(problem.integrand, settings.replicates, n=EACH, key=key) for key in keys]
    combined = {rule: combine(iterations, rule) for rule in METHODS}
    half = norm.isf(0.5 - 0.5 * LEVEL)
    covers = {rule: np.abs(c.mean - problem.exact) <= half * c.stderr for rule, c in combined.items()}
    return {rule: c.mean for rule, c in combined.items()}, covers, problem.exact
