"""Why the mirror box sparkles, and what clamping costs.

Rows of the source: M. Pharr, "Ignoring the Inconvenient When Tracing Rays", Ray Tracing Gems (2019), chapter 17.
"""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter

from .. import plot
from ..analysis import clamping, convergence, tails
from ..analysis.fireflies import firefly_report
from ..integration.moments import Moments
from ..integration.tallies import ClampLadder, TailHistogram, TopSamples
from ..report import Report
from ..scenes import mirror_box
from ..transport.clamps import clamp_luminance
from ..transport.debug import replay
from ..transport.images import render
from ..transport.materials import luminance
from .mirror_box_figures import show_all
from .stages import Stages

PATHS = {"bounces": 8, "hide_emitters": True}
CLAMP = 3.0
PIXEL_SAMPLES = (16, 128, 1024)  # sample counts the clamp curve is priced for
FIREFLY = 16.0  # one such sample makes a pixel of 16 samples brighter by display white
THRESHOLDS = tuple(sorted({CLAMP, *np.geomspace(0.25, 480.0, 26).round(4).tolist()}))
LISTED = 10

clamp_value = partial(clamp_luminance, threshold=CLAMP)


def is_firefly(value):
    """Return 1 where a sample's luminance reaches the firefly threshold."""
    return (luminance(value) >= FIREFLY).astype(value.dtype)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: ``spp`` samples for each pixel of the reference, fewer for everything else; ``all``: make
    the figures of the source too, one by one.
    """

    spp: int = 2048
    width: int = 192
    height: int = 128
    seed: int = 0
    progress: bool = True
    all: bool = False

    def __post_init__(self):
        if not 64 <= self.spp <= 1 << 20:
            raise ValueError(f"the study takes 64 to 2^20 samples per pixel, got spp={self.spp}")

    @property
    def ladder(self):
        """Sample counts of the independent renders that show convergence, up to 1024 or half of the reference."""
        return [1 << k for k in range(min(1024, self.spp // 2).bit_length())]

    def replicates(self, n):
        """Independent renders of ``n`` samples per pixel: more where they are cheap and each is noisy."""
        return max(1, min(16, 256 // n))


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``."""
    report = Report(folder, "Why the mirror box sparkles, and what clamping costs", seed=settings.seed)
    scene, camera = mirror_box(True, settings.width, settings.height)
    calm_scene, _ = mirror_box(False, settings.width, settings.height)
    pixels = camera.width * camera.height
    total = pixels * (2 * settings.spp + sum(n * settings.replicates(n) for n in settings.ladder) + 33)
    with Stages(total, settings.progress) as stages:
        shoot = partial(_shoot, camera, settings, stages)
        reference = shoot(scene, settings.spp, 0, "mirror reference", _all_tallies())
        few = shoot(scene, 16, 4, "mirror, 16 spp", _all_tallies())
        calm = shoot(calm_scene, settings.spp, 1, "diffuse reference")
        calm16 = shoot(calm_scene, 16, 2, "diffuse, 16 spp")
        # Compile before the timed renders.
        shoot(scene, 1, 3, "warm-up", {"clamped": Moments(clamp_value, order=2)})
        ladder = {
            n: [
                shoot(scene, n, 10 + 16 * k + r, f"mirror, {n} spp", {"clamped": Moments(clamp_value, order=2)})
                for r in range(settings.replicates(n))
            ]
            for k, n in enumerate(settings.ladder)
        }
        sampling_seconds = stages.seconds

    _show_images(report, settings, reference, few, calm, calm16, ladder)
    tail = _show_fireflies(report, scene, camera, settings, reference, few)
    image = _show_clamping(report, reference, tail)
    _show_convergence(report, reference, ladder, image)
    if settings.all:
        show_all(report, settings, scene, camera, PATHS, reference, few, calm, calm16, ladder)
    report.values(
        {"seconds of sampling": sampling_seconds, "paths": total, "paths per second": total / sampling_seconds}
    )
    return report.save()


def _all_tallies():
    return {
        "clamped": Moments(clamp_value, order=2),
        "firefly": Moments(is_firefly, order=2),
        "tail": TailHistogram(luminance),
        "top": TopSamples(1 << 15, luminance),
        "ladder": ClampLadder(THRESHOLDS, luminance),
    }


def _shoot(camera, settings, stages, scene, spp, stream, title, tallies=None):
    key = (settings.seed << 8) + stream
    progress = stages.stage(title)
    return render(scene, camera, spp=spp, **PATHS, key=key, tallies=tallies, progress=progress)


def _show_images(report, settings, reference, few, calm, calm16, ladder):
    clamped = reference["clamped"][0].mean
    many = ladder[max(ladder)][0]
    report.section("The scene")
    report.text(
        "A box, a green diffuse sphere and a second sphere, lit by one small light of radiance 500 that the camera "
        "does not see directly. With the second sphere **diffuse**, 16 samples per pixel are calm. With a **mirror** "
        "the image sparkles: a diffuse bounce rarely hits the one direction that leads over the mirror to the light, "
        "and when it does, the sample is worth hundreds. Light sampling does not help: no shadow ray goes over a "
        "mirror. The lamp's own image in the mirror is left out: it is light seen directly, without noise."
    )
    pictures = {
        f"diffuse sphere, {calm.n} spp": calm.mean,
        f"mirror sphere, {settings.spp} spp": reference.mean,
        "diffuse sphere, 16 spp": calm16.mean,
        "mirror sphere, 16 spp": few.mean,
        f"mirror, 16 spp, clamped at {CLAMP:g}": few["clamped"][0].mean,
        f"mirror, {many.n} spp, clamped at {CLAMP:g}": many["clamped"][0].mean,
    }
    report.figure(plot.images(pictures), "images", "Tone-mapped with gamma 1/2.2, nothing else.")
    lost = reference.mean - clamped
    energy = luminance(lost).mean() / luminance(reference.mean).mean()
    smooth = uniform_filter(lost, (7, 7, 0))
    factor = float(f"{1.0 / np.quantile(luminance(smooth), 0.999):.1g}")
    pictures = {"what clamping took away": lost, f"mean of 7 x 7 pixels, {factor:g} times as bright": factor * smooth}
    caption = (
        f"Unclamped minus clamped at {CLAMP:g}, {settings.spp} spp: all light that goes over the mirror, and with it "
        f"the caustic under and beside the sphere. It is {energy:.1%} of the image's light."
    )
    report.figure(plot.images(pictures), "caustic", caption)
    report.value("energy lost to clamping at 3", energy)


def _show_fireflies(report, scene, camera, settings, reference, few):
    result = firefly_report(reference["tail"], reference["top"], FIREFLY)
    early = firefly_report(few["tail"], few["top"], FIREFLY)
    report.section("Fireflies")
    rows = [[name, before, now] for (name, before), (_, now) in zip(early.rows(), result.rows(), strict=True)]
    headers = ["of the mirror scene's samples", f"{few.n} per pixel", f"{reference.n} per pixel"]
    report.table(headers, rows, "The firefly report, early and late. Only the late one knows how the tail ends.")
    report.values({f"fireflies at 16 spp: {name}": value for name, value in early._asdict().items()})
    report.values({f"fireflies: {name}": value for name, value in result._asdict().items()})
    fig, (ax,) = plot.panels(1, 1, (6.0, 4.2))
    plot.exceedance(ax, tails.exceedance(reference["tail"]), FIREFLY)
    report.figure(
        fig, "exceedance", "How often a sample exceeds t. The steps are the atoms 500 times a product of albedos."
    )

    rate = gaussian_filter(reference["firefly"][0].mean[..., 0], 2.0)
    fig, (ax,) = plot.panels(1, 1, (7.0, 4.4))
    plot.heat_map(ax, rate * 1e3, "fireflies in 1000 samples, smoothed over 2 pixels")
    caption = (
        f"Where on the image paths with a sample of {FIREFLY:g} or more start. Surfaces that see the mirror "
        f"sphere sparkle; "
        "behind the green sphere, as seen from the mirror, lies a shadow without fireflies."
    )
    report.figure(fig, "firefly_map", caption)

    top = reference["top"]
    chosen = _largest_of_each_line(scene, camera, settings, top)
    rows = [[p.index, p.pixel, float(luminance(np.asarray(p.value))), p.line] for p in chosen]
    caption = (
        "Large samples, most valuable first. `jaxmc replay mirror-box --sample INDEX` prints a path vertex by vertex."
    )
    report.table(["sample index", "pixel", "luminance", "path"], rows, caption)
    report.value("largest sample, replayed", str(chosen[0]))
    return result.tail


def _largest_of_each_line(scene, camera, settings, top):
    """Return the largest samples, at most three of one kind of path, so that the list shows more than one atom."""
    steps = np.unique(np.geomspace(1, len(top.index), 256).astype(int) - 1)
    paths = replay(scene, camera, [int(i) for i in top.index[steps]], key=settings.seed << 8, **PATHS)
    kept, seen = [], {}
    for path in paths:
        seen[path.line] = seen.get(path.line, 0) + 1
        if seen[path.line] <= 3:
            kept.append(path)
    return kept[:LISTED]


def _show_clamping(report, reference, tail):
    curve = clamping.clamp_curve(reference["tail"])
    # A tail of atoms is bounded by the largest of them: its variance is finite, and the band holds.
    atomic = tail.status == "atomic"
    band = clamping.bias_band(curve, khat=0.0 if atomic else tail.khat)
    if atomic:
        band = band._replace(note="The tail is made of atoms: bounded, so the band holds.")
    sums = reference["ladder"]
    y = luminance(reference.mean).reshape(-1)
    image = clamping.image_curve(
        y, sums.clamped, sums.clamped_square, sums.excess, sums.excess_square, sums.thresholds, sums.n
    )
    mse = {n: clamping.image_mse(image, n) for n in PIXEL_SAMPLES}
    best = {n: clamping.image_optimum(image, n) for n in PIXEL_SAMPLES}
    unclamped = {n: image.unclamped_variance / n for n in PIXEL_SAMPLES}
    fig, axes = plot.panels(3, 3, (4.9, 4.0))
    plot.clamp_bias(axes[0], curve, band)
    plot.clamp_variance(axes[1], image.threshold, image.variance, image.unclamped_variance)
    plot.clamp_mse(axes[2], image.threshold, mse, unclamped, best, CLAMP)
    report.section("What clamping costs")
    report.text(
        "All three curves come from one pass over the samples. Left: the mean luminance that clamping at t takes "
        "away, with a band that holds for all t at once. Middle: what it buys. Right: the two together, for the mean "
        "squared error of a pixel of N samples; bias is squared pixel by pixel, since squares of pixels do not follow "
        "from the image's mean. A fixed threshold is right for one N only: its error stops falling at the square of "
        "its bias."
    )
    report.figure(fig, "clamping", f"{band.note} N-sample errors: mean over pixels, luminance.")
    at3 = int(np.flatnonzero(image.threshold == CLAMP)[0])
    rows = [
        [n, unclamped[n], mse[n][at3], float(best[n].threshold), float(best[n].mse), mse[n][at3] / float(best[n].mse)]
        for n in PIXEL_SAMPLES
    ]
    headers = ["N", "MSE unclamped", f"MSE at t = {CLAMP:g}", "t*(N)", "MSE at t*(N)", f"t = {CLAMP:g} is worse by"]
    report.table(headers, rows, "The best threshold grows with the number of samples.")
    report.values({"clamp curve": curve, "bias band": band, "image clamp curve": image})
    report.values({f"MSE, N = {n}": {"mse": mse[n], "unclamped": unclamped[n], "best": best[n]} for n in PIXEL_SAMPLES})
    return image


def _show_convergence(report, reference, ladder, image):
    truth, noise = luminance(reference.mean), luminance_variance(reference)
    n = np.array(list(ladder))
    at3 = int(np.flatnonzero(image.threshold == CLAMP)[0])

    def measured(pick):
        return np.array(
            [
                np.mean([convergence.image_error(luminance(pick(e)), truth, noise) for e in runs])
                for runs in ladder.values()
            ]
        )

    unclamped, clamped = measured(lambda e: e.mean), measured(lambda e: e["clamped"][0].mean)
    curves = {
        "unclamped": _curve(n, unclamped, image.unclamped_variance / n),
        f"clamped at {CLAMP:g}": _curve(n, clamped, [clamping.image_mse(image, k)[at3] for k in n]),
    }
    seconds = np.array([np.median([e.seconds for e in runs]) for runs in ladder.values()])
    fig, axes = plot.panels(2, 2)
    plot.convergence(axes[0], n, curves, "samples per pixel N")
    plot.convergence(axes[1], seconds, curves, "seconds of rendering", slopes=False)
    report.section("Error against samples and time")
    report.text(
        "Independent renders against the reference, whose own variance is taken off. Unclamped, the error falls as "
        "N^(-1/2), with jumps where a rare bright sample comes in. Clamped, it starts far lower and then stays: "
        "what is left "
        "is bias. The lines are no fits: they are predicted from the one pass over the reference's samples."
    )
    caption = (
        "Root mean squared error of a pixel's luminance, mean of up to 16 renders for each N; slopes by least squares."
    )
    report.figure(fig, "convergence", caption)
    rows = [
        [int(k), len(ladder[k]), float(s), *(float(x[i]) for c in curves.values() for x in c[:2])]
        for i, (k, s) in enumerate(zip(n, seconds, strict=True))
    ]
    headers = [
        "N",
        "renders",
        "seconds",
        *(f"{word}, {label}" for label in curves for word in ("RMS error", "predicted")),
    ]
    report.table(headers, rows)
    report.values({f"slope, {label}": rate._asdict() for label, (_, _, rate) in curves.items()})


def _curve(n, mse, predicted):
    """Return RMS errors, predicted ones, and the fitted rate."""
    mse = np.maximum(mse, 1e-12)
    return np.sqrt(mse), np.sqrt(predicted), convergence.fit_rate(n, mse)


def luminance_variance(estimate):
    """Return an upper estimate of the variance of each pixel's mean luminance: channels vary together."""
    return luminance(np.sqrt(estimate.variance / estimate.n)) ** 2
