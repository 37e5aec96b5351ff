"""The caustic of a small light: local sampling does not find it, and shadow rays do not help.

Row of the source: Aalto CS-E5520, lecture "Path Tracing". Beside the pictures stands a point under a mirror ball, where
mean, variance and kurtosis are exact for a light of any size.
"""

import dataclasses
import math
from pathlib import Path

import numpy as np

from .. import plot
from ..analysis.tails import pareto_khat
from ..integration.driver import integrate
from ..integration.integrand import Integrand
from ..integration.tallies import TopSamples
from ..report import Report
from ..transport.images import render
from ..transport.integrands import irradiance, path_integrand
from .caustic_scenes import EXTENT, caustic_by_photons, curved_mirror, glass_ball
from .scores import deviation, exact_function
from .stages import Stages

SIZES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)  # radius of the light in units of the scene
STRATEGIES = {"waiting": "none", "next event estimation": "nee", "both (MIS)": "mis"}
SCENES = {"glass ball": glass_ball, "curved mirror": curved_mirror}
BRIGHT = 0.5  # the pixels that hold this share of the caustic's light are called the caustic


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: samples for each pixel of the pictures, and for the points whose tail is measured."""

    spp: int = 256
    samples: int = 1 << 22
    width: int = 64
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 4 <= self.spp <= 1 << 20:
            raise ValueError(f"the pictures take 4 to 2^20 samples per pixel, got spp={self.spp}")
        if not 1 << 12 <= self.samples <= 1 << 40:
            raise ValueError(f"a tail is measured by 2^12 to 2^40 samples, got samples={self.samples}")
        if not 8 <= self.width <= 1024:
            raise ValueError(f"the pictures are 8 to 1024 pixels wide, got width={self.width}")


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``; raises ``ValueError`` without exact values."""
    exact_function("sphere_light_in_mirror_ball")
    report = Report(folder, "A caustic that no local sampler finds", seed=settings.seed)
    pixels = settings.width**2
    total = len(SIZES) * settings.samples * (len(STRATEGIES) + len(SCENES)) + 2 * len(SIZES) * 2 * pixels * settings.spp
    with Stages(total, settings.progress) as stages:
        _show_truth(report, settings, stages)
        for k, (name, make) in enumerate(SCENES.items()):
            _show_scene(report, settings, stages, name, make, k)
        report.value("seconds", stages.seconds)
    return report.save()


def under_mirror_ball(size, lights="none"):
    """Return the irradiance at a point from a light below its horizon by way of a mirror ball, as an integrand, and the
    exact scene: mean, variance and kurtosis of a sample. The power of the light does not depend on its ``size``.
    """
    radius = size * EXTENT
    exact = exact_function("sphere_light_in_mirror_ball")(emission=1.0 / radius**2, radius=radius)
    if lights == "none":
        return exact.integrand, exact
    scene = exact.integrand.params[0]
    return irradiance(scene, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), bounces=1, directions="cosine", lights=lights), exact


def measure(integrand, n, key, progress=None):
    """Return mean, error, variance, kurtosis, k-hat and share of samples that are not 0 of an integrand of a number."""
    top = TopSamples(max(1 << 12, int(4.0 * math.sqrt(n))))
    estimate = integrate(integrand, n=n, key=key, tallies={"top": top}, progress=progress)
    variance, _, fourth = (float(c) for c in estimate.moments[0].central)
    tail = pareto_khat(estimate["top"].value, n)
    kurtosis = fourth / variance**2 if variance > 0.0 else None
    return estimate, float(estimate.stderr), variance, kurtosis, tail


def _show_truth(report, settings, stages):
    report.section("Under a mirror ball, exactly")
    report.text(
        "A point sees a spherical light in a mirror ball, and not by itself. Every direction that meets the light's "
        "image is worth the same, all others nothing. So all is known from the probability p of a hit: relative "
        "variance 1/p - 1, kurtosis near 1/p. With the light's power fixed, p falls as its size squared. Shadow rays "
        "toward the light end at the horizon or at the ball: sampling the light changes nothing."
    )
    rows, curves = [], {word: [] for word in STRATEGIES}
    hits, exact_variance, kurtoses, exact_kurtosis = [], [], [], []
    for k, size in enumerate(SIZES):
        for j, (word, lights) in enumerate(STRATEGIES.items()):
            integrand, exact = under_mirror_ball(size, lights)
            p = 1.0 / (1.0 + exact.exact_variance / exact.exact**2)
            key = (settings.seed << 10) + 4 * k + j
            estimate, _, variance, kurtosis, tail = measure(
                integrand, settings.samples, key, stages.stage(f"mirror ball, size {size:g}, {word}")
            )
            # The law of the mean is exact, so its error is too: the measured one is too small where hits are missing.
            z = deviation(estimate.mean, exact.exact, math.sqrt(exact.exact_variance / settings.samples))
            curves[word].append(variance / exact.exact**2 if variance > 0.0 else math.nan)  # no hit, no dot
            rows.append(
                [size, word, p, p * settings.samples, estimate.mean / exact.exact, z, variance / exact.exact_variance,
                 kurtosis, exact.exact_kurtosis, estimate.status, tail.status]
            )  # fmt: skip
            if lights == "none":
                hits.append(p)
                exact_variance.append(1.0 / p - 1.0)
                kurtoses.append(kurtosis)
                exact_kurtosis.append(exact.exact_kurtosis)
    headers = [
        "size", "strategy", "p", "hits expected", "mean / exact", "z", "variance / exact", "kurtosis", "exact kurtosis",
        "status", "tail",
    ]  # fmt: skip
    report.table(headers, rows, f"{settings.samples:,} samples each. z is by the exact variance.")
    fig, axes = plot.panels(3, 3, (4.6, 3.8))
    laws = {word: (values, exact_variance if word == "waiting" else None) for word, values in curves.items()}
    plot.law(axes[0], SIZES, laws, "size of the light", "relative variance of a sample")
    found = [math.nan if value is None else value for value in kurtoses]
    plot.law(axes[1], SIZES, {"waiting": (found, exact_kurtosis)}, "size of the light", "kurtosis of a sample")
    n = np.geomspace(1, 1e9, 200)
    for size, p in zip(SIZES, hits):
        axes[2].plot(n, -np.expm1(n * np.log1p(-p)), lw=1.3, label=f"size {size:g}")
    axes[2].set(xscale="log", xlabel="samples N", ylabel="probability that N samples find the light")
    axes[2].legend(fontsize=8)
    axes[2].grid(alpha=0.3)
    caption = (
        "Measured (dots) and exact (line). All three strategies have the same variance. Right: the chance that a pixel "
        "has seen any of its light, 1 - (1 - p)^N, exactly."
    )
    report.figure(fig, "mirror_ball", caption)
    report.value("samples for an even chance of one hit", {f"{s:g}": math.log(2.0) / p for s, p in zip(SIZES, hits)})


def bright_pixels(radiance):
    """Return where the brightest pixels are that hold half of the light, a mask of the picture's shape."""
    order = np.argsort(radiance, axis=None)[::-1]
    held = np.cumsum(radiance.ravel()[order]) / radiance.sum()
    mask = np.zeros(radiance.size, bool)
    mask[order[: 1 + np.searchsorted(held, BRIGHT)]] = True
    return mask.reshape(radiance.shape)


def _show_scene(report, settings, stages, name, make, number):
    report.section(name.capitalize())
    rows, pictures, found = [], {}, {}
    for k, size in enumerate(SIZES):
        caustic = make(size, settings.width)
        key = (settings.seed << 10) + 256 * (number + 1) + 32 * k
        # Choose pixels by other photons than those that say what is there: noise would choose what it has made bright.
        chosen, (truth, truth_error) = (
            caustic_by_photons(caustic, max(settings.samples >> 2, 1 << 16), key + 2 * r) for r in (0, 1)
        )
        shoot = {"spp": settings.spp, "progress": stages.stage(f"{name}, size {size:g}")}
        image = render(caustic.scene, caustic.camera, bounces=caustic.bounces, lights="mis", key=key + 8, **shoot)
        direct = render(caustic.scene, caustic.camera, bounces=1, lights="nee", key=key + 9, **shoot)
        light = image.mean[..., 0] - direct.mean[..., 0]
        mask = bright_pixels(chosen[0])
        # What is found of the caustic: its light in those pixels where the paths have seen any of it.
        seen = light > 0.5 * truth.clip(min=1e-12)
        share = float(truth[mask & seen].sum() / truth[mask].sum())
        error = np.sqrt((image.variance + direct.variance)[..., 0] / settings.spp + truth_error**2)
        ratio, bar = light[mask].sum() / truth[mask].sum(), np.sqrt((error[mask] ** 2).sum()) / truth[mask].sum()
        pixel = int(np.argmax(chosen[0]))
        whole = path_integrand(caustic.scene, caustic.camera, bounces=caustic.bounces, lights="mis")
        one = Integrand(whole.fn, whole.dim, (*whole.params, np.int32(pixel)), lazy=True).map(_first_channel)
        estimate, _, variance, kurtosis, tail = measure(
            one, settings.samples, key + 10, stages.stage(f"{name}, size {size:g}, one pixel")
        )
        there = float(truth.ravel()[pixel] + direct.mean[..., 0].ravel()[pixel])
        rows.append(
            [size, ratio, (ratio - 1.0) / bar, share, estimate.mean / there, variance / there**2, kurtosis, tail.khat,
             estimate.status, tail.status]
        )  # fmt: skip
        found[size] = share
        if k % 2 == 0:
            exposure = 1.0 / float(np.quantile(truth, 0.99))
            pictures[f"size {size:g}: what is there"] = exposure * truth
            pictures[f"size {size:g}: paths, {settings.spp} spp"] = exposure * light
    shown = {title: np.repeat(np.asarray(p)[..., None], 3, -1).clip(min=0.0) for title, p in pictures.items()}
    caption = (
        f"The caustic of a {name} on the floor under it, direct light taken off. Left by photons, right by paths with "
        "light sampling (MIS), each row at one exposure. The smaller the light, the sharper the caustic, and the fewer "
        "pixels find any of it; those that do are too bright by far."
    )
    report.figure(plot.images(shown, columns=2), name.replace(" ", "_"), caption)
    headers = [
        "size", "paths / photons in the caustic", "z", "share of its light found", "one pixel: mean / photons",
        "relative variance", "kurtosis", "k-hat", "status", "tail",
    ]  # fmt: skip
    caption = (
        f"The caustic: the brightest pixels that hold half of its light, {settings.spp} samples each. Its share "
        "that is found: of pixels with at least half of what is there. z is by the measured error, which is far too "
        f"small where few paths or none have met the light. One pixel, the brightest: {settings.samples:,} samples."
    )
    report.table(headers, rows, caption)
    report.value(f"{name}: share of the caustic found", {f"{size:g}": share for size, share in found.items()})


def _first_channel(value):
    return value[0] if value.ndim else value
