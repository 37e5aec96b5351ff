"""Estimators of derivatives beside exact ones: what each of them misses, how noisy it is, and what it costs.

What moves is a shadow's edge, the receiver under it, a light, an albedo or a roughness. Ordinary automatic
differentiation is one of the estimators; so are the score function, differences and softened edges.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import plot
from ..integration.driver import integrate
from ..report import Report
from . import gradient_roughness as rough
from .gradient_albedo import albedo_task
from .gradient_tasks import Task, light_task, shadow_task
from .scores import exact_function
from .stages import Stages

SIGMAS = 5.0
EARLIER = {  # standard deviations by another program: NumPy, 5e5 samples, facets by density, as printed there
    ("constant", 0.05): (7.4, 23.2, 3.9, 5.9), ("constant", 0.2): (3.4, 5.6, 2.6, 3.3),
    ("constant", 0.5): (1.6, 1.7, 0.92, 1.6), ("lobe", 0.05): (4.0, 13.4, 5.7, 4.0),
    ("lobe", 0.2): (1.37, 2.3, 1.40, 1.37), ("lobe", 0.5): (0.46, 0.65, 0.52, 0.46),
    ("disk", 0.05): (None, 4.4, 4.3, 41.6), ("disk", 0.2): (None, 1.55, 1.48, 7.4),
    ("disk", 0.5): (None, 0.36, 0.36, 1.3),
}  # fmt: skip
COMPARED = (rough.ATTACHED, rough.SCORE, rough.CONTROLLED, rough.DIFFERENCE)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: samples of each part of an estimate."""

    samples: int = 1 << 20
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 1 << 10 <= self.samples <= 1 << 32:
            raise ValueError(f"an estimate takes 2^10 to 2^32 samples, got samples={self.samples}")


class Found(NamedTuple):
    """What is measured of an estimator. ``z`` is the distance from the exact derivative in standard errors.

    ``variance`` is of one sample of each of the parts together, ``seconds`` are those of a million of them.
    ``seconds_to_percent``: until the standard error is 1 % of the exact derivative, on this machine.
    ``sound``: theory calls it unbiased. ``z_of_limit``: the distance from the mean that theory gives to a biased one.
    """

    estimator: str
    mean: float
    stderr: float
    bias: float
    z: float
    verdict: str
    variance: float
    seconds: float
    seconds_to_percent: float
    sound: bool
    z_of_limit: float | None

    @property
    def is_biased(self):
        return self.verdict == "biased"


HEADERS = [
    "estimator", "mean", "error", "bias", "z", "verdict", "variance", "seconds / million", "seconds to 1 %",
    "unbiased in theory", "z of its own limit",
]  # fmt: skip


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``; raises ``ValueError`` without exact values."""
    exact_function("rough_metal_under")
    report = Report(folder, "Estimators of derivatives", seed=settings.seed)
    moving = [shadow_task("edge", settings.seed), shadow_task("receiver", settings.seed), light_task(settings.seed)]
    tasks = [*moving, albedo_task(settings.seed), rough.paths_task()]
    by_light = {light: [rough.roughness_task(light, a, settings.seed) for a in rough.ALPHAS] for light in rough.LIGHTS}
    every = [*tasks, *itertools.chain(*by_light.values())]
    parts = sum(len(e.parts) for task in every for e in task.estimators)
    keys = itertools.count(settings.seed << 12)
    with Stages(2 * parts * settings.samples, settings.progress) as stages:
        found = {task.name: measure(task, settings.samples, keys, stages) for task in every}
        seconds = stages.seconds
    report.text(
        "An estimator is called **biased** where its mean is more than 5 standard errors off the exact derivative. "
        "Otherwise no bias is seen, and one as large as the bar in the figure cannot be excluded. Interior and "
        "boundary have the same number of samples each. Colours: orange is biased, blue is not seen to be."
    )
    for task, words in zip(tasks, WORDS, strict=True):
        _show(report, task, found[task.name], words)
    _show_roughness(report, by_light, found)
    mistaken = [f"{task}: {f.estimator}" for task, rows in found.items() for f in rows if f.sound and f.is_biased]
    report.value("unbiased in theory, but called biased", mistaken)
    report.value("seconds", seconds)
    return report.save()


WORDS = (
    "Light from a rectangle passes beside a half plane, whose edge moves. What is differentiated at each sample "
    "does not change while the edge moves: it is 0 or 1. Only a boundary term, a difference, a blur or a "
    "softened edge sees the shadow move, and all but the first pay with variance, bias, or both.",
    "The same shadow, but the receiver moves: plain automatic differentiation sees the light come nearer and not the "
    "shadow move against it. It is wrong by a factor of 21, with a small error bar.",
    "A sphere light moves to the side and nothing is before it. Points drawn on the light move with it and bring the "
    "whole derivative, and no boundary term is needed; drawn directions do not, and miss it all but for that.",
    "All light in a closed room comes by up to 4 events. An albedo can weigh a path, or be the probability to survive. "
    "The latter is a jump for fixed random numbers, which the score sees, and its control makes almost as calm as "
    "weights; differentiating such a walk itself gives 0.",
    "A path tracer on rough metal under a constant sky, seen from above. Plain AD moves the drawn direction with "
    "roughness; the interior of `mc.moving_radiance` leaves it where it is and differentiates the BRDF, since under a "
    "small light the former would miss the edges of that.",
)


def measure(task: Task, n, keys, stages=None) -> list[Found]:
    """Return what is found of all estimators of a task from ``n`` samples, drawn twice: once to compile."""
    rows = []
    for estimator in task.estimators:
        made = []
        for part in estimator.parts:
            key, progress = next(keys), stages and stages.stage(f"{task.name}: {estimator.name}")
            integrate(part, n=n, key=key, progress=progress)
            made.append(integrate(part, n=n, key=key, progress=progress))
        mean = sum(float(e.mean) for e in made)
        stderr = float(np.sqrt(sum(float(e.stderr) ** 2 for e in made)))
        z = _deviation(mean, task.exact, stderr)
        limit = None if estimator.limit is None else _deviation(mean, estimator.limit, stderr)
        verdict = "biased" if abs(z) > SIGMAS else "no bias seen"
        variance, seconds = sum(float(e.variance) for e in made), sum(e.seconds for e in made) / n * 1e6
        bias, to_percent = mean - task.exact, variance * seconds * 1e-6 / (0.01 * task.exact) ** 2
        rows.append(
            Found(
                estimator.name, mean, stderr, bias, z, verdict, variance, seconds, to_percent, estimator.sound, limit
            )
        )  # fmt: skip
    return rows


def _deviation(mean, exact, stderr):
    """Return (mean - exact) / stderr, where rounding of float32 is an error too."""
    return float((mean - exact) / np.hypot(stderr, 1e-6 * max(abs(exact), abs(mean), 1e-3)))


def _show(report, task, rows, words):
    report.section(task.name[0].upper() + task.name[1:])
    report.text(words)
    report.table(HEADERS, rows, f"The exact derivative is {task.exact:.9g}.")
    names, biased = [f.estimator for f in rows], [f.is_biased for f in rows]
    fig, (left, right) = plot.panels(2, 2, (5.6, 0.24 * len(rows) + 1.1))
    plot.relative_biases(left, names, [f.mean for f in rows], [f.stderr for f in rows], task.exact, biased)
    plot.noise_bars(right, [f.variance for f in rows], biased, "variance of one sample")
    report.figure(fig, task.name.replace(",", "").replace(" ", "_"), f"{task.name}. Orange: biased.")
    report.value(task.name, [f._asdict() for f in rows])


def _show_roughness(report, by_light, found):
    report.section("Roughness under three lights")
    report.text(
        "A GGX metal seen at 45 degrees, under a constant sky, a smooth lobe, and a disk with a sharp edge; the latter "
        "two 0.15 radians beside the mirror direction. **Attached**: drawn directions move with roughness. **Score**: "
        "they stay, and the derivative is that of the BRDF. The **control** takes a multiple of the score off, by an "
        "independent pilot. Under the disk what is attached misses that directions cross its edge: an integral along "
        "the edge brings that back, and softening the edge trades the bias for variance."
    )
    fig, axes = plot.panels(len(by_light), 3, (4.3, 4.0))
    rows, compared = [], []
    for ax, (light, tasks) in zip(axes, by_light.items()):
        curves = {}
        for alpha, task in zip(rough.ALPHAS, tasks):
            here = {f.estimator: f for f in found[task.name]}
            rows += [[rough.LIGHTS[light], alpha, task.exact, *f] for f in here.values()]
            report.value(task.name, [f._asdict() for f in here.values()])
            compared.append(_beside_earlier(light, alpha, here))
            for name, f in here.items():
                values, biased = curves.setdefault(name, ([], []))
                values.append(f.variance)
                biased.append(f.is_biased)
        curves = {name: (values, any(biased)) for name, (values, biased) in curves.items()}
        plot.noise_by_roughness(ax, rough.ALPHAS, curves, rough.LIGHTS[light], "variance of one sample")
    plot.shared_legend(fig)
    report.figure(fig, "roughness", "Variance of one sample against roughness; dashed where a bias is found.")
    report.table(["light", "roughness", "exact", *HEADERS], rows, "Exact by quadrature.")
    headers = ["light", "roughness", *(f"{word}{of}" for word in COMPARED for of in ("", ", before"))]
    caption = (
        "Standard deviations of one sample, facets by density, beside those that another program had found before. "
        "The last column is exact, by quadrature, for the score without control."
    )
    report.table([*headers, "score, exact"], compared, caption)


def _beside_earlier(light, alpha, found):
    row = [rough.LIGHTS[light], alpha]
    for word, before in zip(COMPARED, EARLIER[light, alpha]):
        row += [found[f"{word}, {rough.BY_DENSITY}"].variance ** 0.5, before]
    return [*row, exact_function("rough_metal_under")(light, alpha).score_variance ** 0.5]
