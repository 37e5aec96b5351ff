"""Why one diffuse scene is calm and the next is noise: what the rays of a naive path tracer hit.

Naive: directions uniform over the hemisphere, light only where a path meets it, 5 bounces.
"""

import dataclasses
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from .. import plot
from ..analysis import convergence
from ..report import Report
from . import diffuse_ladders as ladders
from .diffuse_ladders import BOUNCES, DARK, REFERENCE, SCENES, SKY
from .light_hits import blocks_of, variance_from_hits
from .stages import Stages

ALLOWED = 0.05  # relative error that a picture may have


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: largest number of samples per pixel, width and height of the images, and which scenes."""

    spp: int = 256
    size: int = 128
    seed: int = 0
    scenes: tuple[str, ...] = tuple(SCENES)
    progress: bool = True

    def __post_init__(self):
        if not 16 <= self.spp <= 1 << 16:
            raise ValueError(f"the study takes 16 to 2^16 samples per pixel, got spp={self.spp}")
        if not 16 <= self.size <= 1024:
            raise ValueError(f"images are 16 to 1024 pixels wide and high, got size={self.size}")
        if not self.scenes or not set(self.scenes) <= set(SCENES) or (SKY in self.scenes and DARK not in self.scenes):
            known = ", ".join(SCENES)
            raise ValueError(f"scenes must be among {known}, {SKY!r} only with {DARK!r}, got {self.scenes!r}")

    @property
    def ladder(self):
        """Samples per pixel, each rung 4 times the one below."""
        return [4**k for k in range(self.spp.bit_length()) if 4**k <= self.spp]

    def replicates(self, n):
        """Independent renders of ``n`` samples per pixel: more where they are cheap and each is noisy."""
        return max(1, min(8, 64 // n))


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``."""
    report = Report(folder, "What the rays hit: four diffuse scenes by naive path tracing", seed=settings.seed)
    rungs = sum(n * settings.replicates(n) for n in settings.ladder) + REFERENCE * settings.spp
    spp = len(settings.scenes) * 2 * rungs + 2 * sum(t * t for t in ladders.TIMED) * settings.spp
    with Stages(int(settings.size**2 * spp), settings.progress) as stages:
        measured = {name: ladders.measure(name, settings, stages, 64 * k) for k, name in enumerate(settings.scenes)}
        times = ladders.time_pixels(settings, stages)
        report.value("seconds of sampling", stages.seconds)
    _show_images(report, settings, measured)
    _show_convergence(report, settings, measured)
    _show_hits(report, measured)
    _show_time(report, settings, measured, times)
    return report.save()


def _show_images(report, settings, measured):
    many, some = max(settings.ladder), 16
    report.section("Four scenes")
    report.text(
        "A small **orb** over a floor, in the dark and under a blue sky; a Cornell box with a small bright **lamp**, "
        "and one whose whole **ceiling** gives the same power. Naive path tracing draws directions uniformly over the "
        f"hemisphere, waits until a path meets light, and ends after {BOUNCES} events. The first and the third scene "
        "stay noise for long; the second and the fourth are calm soon. Our default, beside it, samples lights and "
        "draws directions as the surface reflects them."
    )
    pictures = {}
    rows = [(strategy, n) for strategy, n in (("naive", 1), ("naive", some), ("naive", many), ("default", some))]
    for strategy, n in dict.fromkeys(rows):
        pictures |= {f"{name},\n{strategy}, {n} spp": m.ladder[strategy][n].image for name, m in measured.items()}
    n = REFERENCE * settings.spp
    pictures |= {f"{name},\nreference, {n} spp": m.image for name, m in measured.items()}
    caption = "Clipped to [0, 1] and gamma 1/2.2 for display only: errors are of the linear radiance."
    report.figure(plot.images(pictures, len(measured), width=2.6), "images", caption)


def _show_convergence(report, settings, measured):
    n = np.array(settings.ladder)
    report.section("Four times the samples halve the error")
    report.text(
        "Root mean squared error of a pixel's luminance over the mean of the image, for the pixels that see a surface "
        "which is no light. The lines are no fits: they follow from the variance of one sample, measured once, and "
        "fall as N^(-1/2)."
    )
    fig, axes = plot.panels(2, 2, (5.2, 4.2))
    rows = []
    for (name, m), color in zip(measured.items(), plot.LINE_COLORS):
        for strategy, rungs in m.ladder.items():
            error = np.sqrt(np.maximum([r.mse for r in rungs.values()], 1e-12)) / m.mean
            predicted = np.sqrt(m.relative_variance(strategy) / n)
            style = {"color": color, "ls": "-" if strategy == "naive" else "--", "lw": 1}
            marks = {"color": color, "marker": "o" if strategy == "naive" else "^", "ms": 4}
            axes[0].plot(n, predicted, **style)
            axes[0].plot(n, error, ls="", label=f"{name}, {strategy}", **marks)
            axes[1].plot([r.core_seconds for r in rungs.values()], error, label=f"{name}, {strategy}", **style | marks)
            rate = convergence.fit_rate(n, error**2)
            wanted = m.relative_variance(strategy) / ALLOWED**2
            rows.append([name, strategy, float(error[0]), float(error[-1]), rate.slope, rate.stderr, float(wanted)])
            report.value(f"relative errors, {name}, {strategy}", error)
            report.value(f"predicted relative errors, {name}, {strategy}", predicted)
    for ax, label in zip(axes, ("samples per pixel", "seconds of all cores together")):
        ax.set(xscale="log", yscale="log", xlabel=label, ylabel="relative error of a pixel")
        ax.xaxis.set_minor_formatter("")
        ax.grid(alpha=0.3)
    plot.shared_legend(fig)
    report.figure(fig, "convergence", "Circles and full lines: naive. Triangles and dashed lines: our default.")
    headers = ["scene", "strategy", "error, 1 spp", f"error, {n[-1]} spp", "slope", "stderr", f"spp for {ALLOWED:.0%}"]
    caption = "Slopes by least squares through all rungs: -1/2 means that 4 times the samples halve the error."
    report.table(headers, rows, caption)


def _show_hits(report, measured):
    report.section("What the rays hit")
    report.text(
        "A naive sample of direct light is 0 unless its ray meets light, with probability p. If it does, it is worth "
        "v = L / p on average, where L is the direct light. That alone makes a variance of v^2 p (1 - p), or "
        "L^2 (1 - p) / p: a small light is rarely met, and each time worth much. The rest of the variance is the angle "
        "at which it is met. The orb under the sky is met as rarely as in the dark and makes as much variance; but the "
        "sky, which most rays meet, adds light and hardly any noise, so that this is small beside the mean."
    )
    count = len(measured)
    fig, axes = plot.panels(2 * count, count, (2.8, 2.4))
    rows, (points, ax) = [], plot.panels(1, 1, (6.0, 4.6))
    for k, ((name, m), color) in enumerate(zip(measured.items(), plot.LINE_COLORS)):
        parts = [m.light]
        if name == SKY:
            parts = [measured[DARK].light, m.light.without(measured[DARK].light)]
        _draw_hits(axes[k], axes[count + k], name, m)
        from_hits = variance_from_hits(parts)
        blocks = [blocks_of(x, m.mask) for x in (from_hits, m.direct_variance)]
        ax[0].plot(*blocks, ".", color=color, ms=4, label=name)
        predicted, direct, total = (x[m.mask].mean() for x in (from_hits, m.direct_variance, m.variance["naive"]))
        shares = [float(x[m.mask].mean()) for x in (m.meets, parts[0].probability)]
        rows.append([name, *shares, predicted, direct, predicted / direct, total, m.relative_variance("naive")])
    report.figure(
        fig, "hits",
        "Above: probability that a ray from the visible surface meets light. Below: standard deviation of one naive "
        "sample over the pixel's mean. White: the camera sees a light, the sky or nothing, or no sample met light.",
    )  # fmt: skip
    ends = np.array(ax[0].get_ylim())
    ends[0] = max(ends[0], 1e-4 * ends[1])
    ax[0].plot(ends, ends, color="k", lw=0.8)
    ax[0].set(xscale="log", yscale="log", xlabel="variance that follows from which light is met", xlim=ends, ylim=ends)
    ax[0].set_ylabel("measured variance of direct light")
    ax[0].legend(fontsize=8)
    ax[0].grid(alpha=0.3)
    caption = "Means of 8 x 8 pixels. Points lie above the line by the variance that the angle of the hit adds."
    report.figure(points, "explained", caption)
    headers = [
        "scene", "paths that meet light", "p of the lamp or orb", "variance from p", "of direct light, measured",
        "share explained", "of a whole sample", "relative to mean^2",
    ]  # fmt: skip
    report.table(headers, rows, "Luminance, means over the pixels that see a surface which is no light.")


def _draw_hits(above, below, title, m):
    for ax, values, label, limits, cmap in (
        (above, m.light.probability, "log10 p", (-4, 0), "viridis"),
        (below, np.sqrt(m.variance["naive"]) / np.maximum(m.truth, 1e-9), "log10 sd / mean", (-0.5, 2), "inferno"),
    ):
        shown = np.where(m.mask & (values > 0.0), values, np.nan)
        plot.heat_map(ax, np.log10(shown), label, cmap)
        ax.images[0].set_clim(*limits)
    above.set_title(title, fontsize=10)


def _show_time(report, settings, measured, times):
    n = np.array(settings.ladder)
    scene = list(measured)[-1]
    rungs = measured[scene].ladder["naive"]
    by_samples = np.array([[r.seconds, r.core_seconds] for r in rungs.values()])
    report.section("Time grows as samples and pixels do")
    fig, axes = plot.panels(2, 2, (4.8, 3.6))
    rows = []
    series = [("samples per pixel", n, by_samples), ("pixels", times[:, 0], times[:, 1:])]
    for ax, (label, x, seconds) in zip(axes, series):
        slopes = []
        for column, name in zip(seconds.T, ("wall", "all cores")):
            fixed, each = line(x, column)
            ax.plot(x, column, "o", ms=4, label=name)
            ax.plot(x, fixed + each * x, lw=1, color=ax.lines[-1].get_color())
            rows.append([label, name, fixed, each, float(np.max(np.abs(column / (fixed + each * x) - 1.0)))])
            slopes.append(each)
        ax.set(xscale="log", yscale="log", xlabel=label, ylabel="seconds")
        ax.yaxis.set_minor_formatter("")
        ax.legend(fontsize=8)
        ax.grid(alpha=0.3)
        report.value(f"seconds for each of {label}, wall and all cores", slopes)
    size = settings.size
    caption = (
        f"Left: {size} x {size} pixels. Right: {settings.spp} samples per pixel. Lines: a fixed cost, one for each."
    )
    report.figure(fig, "time", caption)
    headers = ["of", "seconds of", "fixed", "for each", "largest deviation from the line"]
    report.table(headers, rows, f"{scene}, naive, with all that this study keeps of a path; kernels compiled before.")


def line(x, seconds):
    """Return (fixed, each) of the line through times that fits relative errors best, with no negative cost."""
    weights = 1.0 / seconds
    fit, _ = nnls(np.stack([weights, x * weights], 1), np.ones(len(x)))
    return float(fit[0]), float(fit[1])
