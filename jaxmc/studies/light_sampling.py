"""How paths find light: terms by length, local sampling, next event estimation, picks, roulette, and the area form.

Rows of the source: Aalto CS-E5520, lecture "Path Tracing". Every strategy stands in one table beside the exact value,
or beside another strategy of the same integral.
"""

import dataclasses
import itertools
from pathlib import Path

import numpy as np

from .. import plot
from ..analysis.tails import pareto_khat
from ..integration.driver import integrate, integrate_each
from ..integration.tallies import TopSamples
from ..report import Report
from ..scenes import cornell_box
from ..transport.areas import irradiance_by_areas
from ..transport.images import render
from ..transport.integrands import irradiance, neumann_terms, path_integrand
from ..transport.materials import luminance
from ..transport.scene import Scene
from . import light_scenes, roulettes
from .scores import HEADERS, against, deviation, exact_function, score
from .stages import Stages

LENGTHS = 5
LAMP_SIDES = (2.0, 0.5, 0.1)
PICKS = ("uniform", "power", "distance")
ALBEDO = light_scenes.FURNACE_ALBEDO
HEIGHTS = (2.0, 1.0, 0.5, 0.25, 0.125)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: samples of one estimate, and the width of its pictures."""

    samples: int = 1 << 20
    width: int = 96
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 1 << 10 <= self.samples <= 1 << 32:
            raise ValueError(f"an estimate takes 2^10 to 2^32 samples, got samples={self.samples}")
        if not 8 <= self.width <= 1024:
            raise ValueError(f"the pictures are 8 to 1024 pixels wide, got width={self.width}")


class Lab:
    """What the sections share: the settings, a report, the bar, a new key for each estimate, and the scores so far."""

    def __init__(self, report, settings, stages):
        self.report, self.settings, self.stages, self.scores = report, settings, stages, []
        self._keys = itertools.count(settings.seed << 12)

    def key(self):
        return next(self._keys)

    def score(self, integrand, strategy, scene, exact=None, exact_variance=None, share=1):
        """Score an integrand by a ``share``-th of the samples and keep the result."""
        progress = self.stages.stage(f"{scene}: {strategy}")
        n = max(self.settings.samples // share, 1 << 10)
        found = score(integrand, n, self.key(), strategy, scene, exact, exact_variance, progress)
        self.scores.append(found)
        return found

    def table(self, scores, caption, further=()):
        """Show some scores, with further columns (name, values)."""
        rows = [[*s, *(values[i] for _, values in further)] for i, s in enumerate(scores)]
        self.report.table([*HEADERS, *(name for name, _ in further)], rows, caption)


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``; raises ``ValueError`` without exact values."""
    exact_function("ceiling_lamp")
    report = Report(folder, "How paths find light", seed=settings.seed)
    with Stages(60 * settings.samples, settings.progress) as stages:
        lab = Lab(report, settings, stages)
        for section in (_neumann, _local, _next_event, _picks, roulettes.show, _areas):
            section(lab)
        report.section("All strategies")
        lab.table(lab.scores, "Efficiency is mean^2 / (variance x seconds of one sample), on this machine.")
        noisy = [s for s in lab.scores if s.variance > 1e-9 * s.mean**2]
        fig, (ax,) = plot.panels(1, 1, (8.0, 0.22 * len(noisy) + 1.2))
        plot.bars(ax, [f"{s.scene}: {s.strategy}" for s in noisy], [s.efficiency for s in noisy], "efficiency")
        report.figure(fig, "efficiency", "Compare within one scene: a longer bar needs less time for the same error.")
        report.value("largest |z|", max(abs(s.z) for s in lab.scores if s.z is not None))
        report.value("seconds", stages.seconds)
    return report.save()


def _neumann(lab):
    lab.report.section("One flat integral for each path length")
    lab.report.text(
        "Radiance is a Neumann series: light seen directly, after one scattering event, after two, ... Each term is "
        "one flat integral over the first coordinates of the same path. Their sum is the picture."
    )
    scene, camera = light_scenes.furnace(ALBEDO)
    options = {"bounces": LENGTHS, "directions": "uniform", "lights": "none"}
    terms = integrate(neumann_terms(scene, camera, **options), n=lab.settings.samples, key=lab.key())
    rows = [
        [k, terms.mean[k], terms.stderr[k], ALBEDO**k, deviation(terms.mean[k], ALBEDO**k, terms.stderr[k])]
        for k in range(LENGTHS + 1)
    ]
    headers = ["scattering events", "mean", "error", "exact: albedo^k", "z"]
    lab.report.table(headers, rows, "In a white furnace of emission 1, by uniform directions.")
    total = float(np.sum(terms.mean))
    whole = lab.score(
        path_integrand(scene, camera, **options), "terms together, uniform directions", "furnace",
        (1.0 - ALBEDO ** (LENGTHS + 1)) / (1.0 - ALBEDO),
        exact_function("furnace_variance")(ALBEDO, 1.0, LENGTHS, directions="uniform"),
    )  # fmt: skip
    lab.report.value("sum of terms less the whole", total - whole.mean)

    scene, camera = cornell_box(lab.settings.width, lab.settings.width)
    pixels, spp = camera.width * camera.height, max(16, min(256, lab.settings.samples >> 13))
    progress = lab.stages.stage("pictures of the terms")
    image = integrate_each(
        neumann_terms(scene, camera, bounces=LENGTHS), pixels, n=spp, key=lab.key(), progress=progress
    )
    image = np.asarray(image.mean).reshape(camera.height, camera.width, LENGTHS + 1, 3)
    pictures = {f"{k} events": image[:, :, k] for k in range(LENGTHS)} | {"sum": image.sum(2)}
    energy = luminance(image).mean((0, 1))
    lab.report.figure(
        plot.images(pictures, columns=3), "terms",
        f"The Cornell box by path length, {spp} samples for each pixel. The terms hold "
        + ", ".join(f"{e:.1%}" for e in energy / energy.sum()) + " of the light.",
    )  # fmt: skip
    lab.report.value("share of each term, Cornell box", energy / energy.sum())


def _local(lab):
    lab.report.section("Local sampling")
    lab.report.text(
        "A path is drawn event by event; its density is the product of the densities of its directions. What is drawn "
        "like the integrand leaves less variance: by the cosine in a diffuse room, by the BRDF on metal."
    )
    scores, variance = [], exact_function("furnace_variance")
    scene, camera = light_scenes.furnace(ALBEDO)
    for directions in ("uniform", "cosine"):
        options = {"bounces": LENGTHS, "directions": directions, "lights": "none"}
        exact = (1.0 - ALBEDO ** (LENGTHS + 1)) / (1.0 - ALBEDO), variance(ALBEDO, 1.0, LENGTHS, directions=directions)
        scores.append(
            lab.score(path_integrand(scene, camera, **options), f"{directions} directions", "furnace", *exact)
        )
    for alpha in (0.5, 0.1):
        for directions in ("uniform", "cosine", "bsdf"):
            known = exact_function("rough_floor")(alpha, directions=directions)
            name = f"metal of roughness {alpha:g}"
            scores.append(
                lab.score(known.integrand, f"{directions} directions", name, known.exact, known.exact_variance)
            )
    lab.table(scores, "By directions alone. In the furnace the cosine leaves no variance at all.")


def _next_event(lab):
    lab.report.section("Waiting for the light, or sampling it")
    lab.report.text(
        "Next event estimation turns the solid angle of a light into its area: 1 / r^2, two cosines, and a shadow ray. "
        "The smaller the lamp of the same power, the longer one waits for it, and the better it is sampled. Light that "
        "the camera sees by itself is added once, by its own ray."
    )
    scores = []
    for side in LAMP_SIDES:
        for lights in ("none", "nee", "mis"):
            known = exact_function("ceiling_lamp")(side=side, lights=lights)
            word = {"none": "waiting", "nee": "next event estimation", "mis": "both (MIS)"}[lights]
            scores.append(
                lab.score(known.integrand, word, f"ceiling lamp, side {side:g}", known.exact, known.exact_variance)
            )
    lab.table(scores, "The floor below a square lamp of fixed power.")
    scene, camera = light_scenes.closed_room()
    room = [
        lab.score(path_integrand(scene, camera, bounces=4, lights=lights), word, "room with lamp in view", share=2)
        for lights, word in (("none", "waiting"), ("nee", "next event estimation"), ("mis", "both (MIS)"))
    ]
    lab.table(
        room, "A room whose lamp the camera sees: it must be counted once.", [("z, against the first", against(room))]
    )
    scene, camera = cornell_box(lab.settings.width, lab.settings.width)
    progress, pictures = lab.stages.stage("pictures"), {}
    for lights, word in (("none", "waiting"), ("nee", "next event estimation"), ("mis", "both (MIS)")):
        image = render(scene, camera, spp=16, bounces=LENGTHS, lights=lights, key=lab.key(), progress=progress)
        pictures[f"{word}, 16 spp"] = image.mean
    caption = (
        "The Cornell box at 16 samples for each pixel. By the lamp's size, waiting is not hopeless here; only noisy."
    )
    lab.report.figure(plot.images(pictures, columns=3), "next_event", caption)


def _picks(lab):
    lab.report.section("Several lights")
    lab.report.text(
        "Six lamps: a strong one far above, weak ones near the floor. One is picked for each sample, and its "
        "probability belongs to the density. What comes from lamp i is E_i; picked with probability p_i it leaves "
        "the variance sum E_i^2 / p_i - E^2, and a little more for the points on each lamp."
    )
    scores, laws = [], []
    for name, place in light_scenes.PLACES.items():
        of_lamps = light_scenes.irradiance_of_lamps(place)
        for pick in PICKS:
            integrand = irradiance(
                light_scenes.lamps_alone(), (*place, 0.0), light_scenes.UP, bounces=0, lights="nee", pick=pick
            )
            scores.append(lab.score(integrand, f"pick by {pick}", name, of_lamps.sum()))
            p = {"uniform": np.full(len(of_lamps), 1.0 / len(of_lamps)), "power": light_scenes.power_of_lamps()}.get(
                pick
            )
            laws.append(None if p is None else float(np.sum(of_lamps**2 / p) - of_lamps.sum() ** 2))
    lab.table(scores, "Irradiance at three places of the floor.", [("law of the pick", laws)])
    scene, camera = light_scenes.lamps_over_floor(lab.settings.width, lab.settings.width * 2 // 3)
    pictures, rows = {}, []
    for pick in PICKS:
        progress = lab.stages.stage(f"picture by {pick}")
        image = render(scene, camera, spp=16, bounces=1, lights="nee", pick=pick, key=lab.key(), progress=progress)
        pictures[f"pick by {pick}, 16 spp"] = image.mean
        rows.append([pick, float(image.variance.mean())])
    lab.report.figure(
        plot.images(pictures, columns=3, exposure=0.3), "picks", "One lamp for each sample, picked in three ways."
    )
    lab.report.table(["pick by", "variance of a sample, mean over pixels"], rows, "Of these pictures.")


def _areas(lab):
    lab.report.section("The same integral over surfaces")
    lab.report.text(
        "Instead of directions one can integrate over points of surfaces: with 1 / r^2, two cosines and visibility in "
        "the integrand. Light sampling of a quad does just that, so both have the same variance. Where a surface comes "
        "near, 1 / r^2 has no bound, and directions, over the lamp's solid angle or over all, are the better measure."
    )
    up = light_scenes.UP
    direct = {"the area form": [], "light sampling": [], "solid angle of the lamp": [], "cosine, waiting": []}
    for height in HEIGHTS:
        lamp = {"corner": (-0.5, -0.5, height), "edge_u": (0.0, 1.0, 0.0), "edge_v": (1.0, 0.0, 0.0)}
        sampled, waiting = (
            exact_function("rectangle_light")(1.0, **lamp, normal=up, lights=lights) for lights in ("nee", "none")
        )
        room = Scene(sampled.integrand.params[0].given[0])
        by_areas = irradiance_by_areas(room, (0.0, 0.0, 0.0), up)
        by_angle = irradiance(room, (0.0, 0.0, 0.0), up, bounces=0, lights="nee", light_points="solid angle")
        name = f"lamp at height {height:g}"
        for word, integrand, variance in (
            ("the area form", by_areas, None),
            ("light sampling", sampled.integrand, sampled.exact_variance),
            ("solid angle of the lamp", by_angle, None),
            ("cosine, waiting", waiting.integrand, waiting.exact_variance),
        ):
            direct[word].append(lab.score(integrand, word, name, sampled.exact, variance))
    lab.table([s for scores in direct.values() for s in scores], "Direct light of a square lamp of side 1.")
    scene = light_scenes.facing_plates()
    top = {"top": TopSamples(1 << 12)}
    bounce = []
    for word, integrand in (
        ("over directions", irradiance(scene, (0.0, 0.0, 0.0), up, bounces=1)),
        ("over areas", irradiance_by_areas(scene, (0.0, 0.0, 0.0), up, bounces=1)),
    ):
        bounce.append(lab.score(integrand, word, "one bounce between plates"))
        found = integrate(integrand, n=lab.settings.samples, key=lab.key(), tallies=top)
        lab.report.value(f"one bounce {word}: tail", str(pareto_khat(found["top"].value, found.n)))
    lab.table(bounce, "Light after one event, in both forms.", [("z, against the first", against(bounce))])
    fig, (ax,) = plot.panels(1, 1, (6.0, 4.0))
    curves = {}
    for word, scores in direct.items():
        exact = [np.nan if s.exact_variance is None else s.exact_variance / s.exact**2 for s in scores]
        curves[word] = [s.variance / s.exact**2 for s in scores], None if np.isnan(exact).all() else exact
    plot.law(ax, HEIGHTS, curves, "height of the lamp, of side 1", "relative variance of one sample")
    lab.report.figure(
        fig, "areas", "Direct light in four forms: measured (dots), and exact where that is known (lines)."
    )
