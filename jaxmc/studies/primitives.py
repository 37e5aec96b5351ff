"""What triangles, quads and boxes cost: one Cornell box in three builds, and scenes of 1 to 1000 spheres."""

import dataclasses
import os
import time
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import plot
from ..integration.counts import is_count
from ..integration.estimate import Estimate
from ..report import Report
from ..scenes import BUILDS, cornell_blocks
from ..testing import joint_sigmas
from ..transport.images import render
from ..transport.integrands import path_integrand
from .costs import RayCost, compile_seconds, operations, ray_cost
from .stages import Stages

BOUNCES = 5
STRATEGIES = {"naive": {"directions": "uniform", "lights": "none"}, "default": {}}
NAMES = {"triangles": "30 triangles", "quads": "15 quads", "boxes": "5 quads, 2 boxes"}
PUBLISHED = {"triangles": 21.1, "quads": 6.2, "boxes": 5.5}  # seconds with 8 threads, see ``run``
TILES = 8  # in each direction: regions of the image whose means are compared
TARGET_NS, TARGET_COMPILE = 1.5, 1.5


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: width and height of the image, samples per pixel, rounds of alternating renders, and
    numbers of spheres. The figures that were published are of ``size=512, spp=100``.
    """

    size: int = 256
    spp: int = 32
    rounds: int = 3
    counts: tuple[int, ...] = (1, 10, 100, 1000)
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 16 <= self.size <= 4096:
            raise ValueError(f"the image is 16 to 4096 pixels wide and high, got size={self.size}")
        if not 4 <= self.spp <= 1 << 16:
            raise ValueError(f"the study takes 4 to 2^16 samples per pixel, got spp={self.spp}")
        if not 1 <= self.rounds <= 100:
            raise ValueError(f"the study takes 1 to 100 rounds, got rounds={self.rounds}")
        if not self.counts or not all(is_count(n) for n in self.counts):
            raise ValueError(f"counts must be positive numbers of spheres, got counts={self.counts!r}")


class Build(NamedTuple):
    """What one build of the scene costs: ``wall`` and ``cores`` are the seconds of each round, of the clock and of all
    cores together; ``operations`` are those of one path. ``estimate`` is the image of the first round.
    """

    estimate: Estimate
    wall: np.ndarray
    cores: np.ndarray
    operations: float
    compiling: float


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``.

    ``PUBLISHED`` are of the text "Path tracing: getting started with diffuse and emissive", for the Cornell box with
    two blocks at 512 x 512 pixels, 5 bounces, 100 samples per pixel.
    """
    report = Report(folder, "What triangles, quads and boxes cost", seed=settings.seed)
    paths = len(STRATEGIES) * len(BUILDS) * settings.size**2 * (settings.rounds * settings.spp + 1)
    with Stages(paths, settings.progress) as stages:
        builds = {s: _measure_builds(settings, stages, s, k) for k, s in enumerate(STRATEGIES)}
        stages.stage("rays among spheres")
        rays = [ray_cost(count, settings.seed) for count in settings.counts]
    report.values({"load average, 1 5 15 minutes": os.getloadavg(), "published seconds": PUBLISHED})
    _show_builds(report, settings, builds)
    _show_agreement(report, settings, builds)
    _show_rays(report, rays)
    return report.save()


def _measure_builds(settings, stages, strategy, stream) -> dict[str, Build]:
    """Render the three builds in turn, so that what slows the machine slows all of them."""
    options = STRATEGIES[strategy]
    scenes = {build: cornell_blocks(True, build, settings.size, settings.size) for build in BUILDS}
    seconds, first = {build: [] for build in BUILDS}, {}
    for k in range(settings.rounds + 1):
        for j, (build, scene) in enumerate(scenes.items()):
            progress = stages.stage(f"{strategy}, {NAMES[build]}, {'warm-up' if k == 0 else f'round {k}'}")
            start, worked = time.perf_counter(), time.process_time()
            key = (settings.seed << 16) + (stream << 12) + 3 * k + j
            estimate = render(
                *scene, spp=settings.spp if k else 1, bounces=BOUNCES, key=key, progress=progress, **options
            )
            if k:
                seconds[build].append((time.perf_counter() - start, time.process_time() - worked))
                first.setdefault(build, estimate)
    found = {}
    for build, scene in scenes.items():
        integrand = path_integrand(*scene, bounces=BOUNCES, **options)
        wall, cores = np.array(seconds[build]).T
        found[build] = Build(first[build], wall, cores, operations(integrand), compile_seconds(integrand))
    return found


def _show_builds(report, settings, builds):
    samples = settings.size**2 * settings.spp
    report.section("One scene, three builds")
    report.text(
        "The Cornell box with two blocks, whose ceiling is the lamp: 30 triangles, 15 quads, or 5 quads and 2 "
        f"oriented boxes, {settings.size} x {settings.size} pixels, {settings.spp} samples per pixel, at most "
        f"{BOUNCES} bounces. **Naive**, as in the source: uniform directions, light only where a path meets it. "
        "**Default**: light sampling too, with two lights where the ceiling is two triangles. The builds are rendered "
        "in turn; a ratio is the median of the rounds. Published for 512 x 512 pixels and 100 samples: 21.1, 6.2 and "
        "5.5 s on 8 threads, or 3.84 : 1.13 : 1."
    )
    rows = []
    for strategy, found in builds.items():
        last = found[BUILDS[-1]]
        for build, b in found.items():
            ratios = [float(np.median(getattr(b, k) / getattr(last, k))) for k in ("wall", "cores")]
            published = PUBLISHED[build] / PUBLISHED[BUILDS[-1]]
            wall, cores = float(np.median(b.wall)), float(np.median(b.cores))
            per_path = cores / samples * 1e9
            rows.append([strategy, NAMES[build], wall, cores, *ratios, published, per_path, b.operations, b.compiling])
    headers = [
        "strategy", "build", "wall s", "core s", "ratio, wall", "ratio, core", "published", "core ns per path",
        "operations per path", "core s to compile",
    ]  # fmt: skip
    caption = "Ratios to the build of quads and boxes. Operations: numbers that a path computes, before XLA."
    report.table(headers, rows, caption)
    fig, (ax,) = plot.panels(1, 1, (6.6, 3.6))
    bars = {f"core seconds, {s}": [row[5] for row in rows if row[0] == s] for s in builds} | {
        "operations, naive": [row[8] / rows[len(BUILDS) - 1][8] for row in rows[: len(BUILDS)]],
        "published seconds": [PUBLISHED[build] / PUBLISHED[BUILDS[-1]] for build in BUILDS],
    }
    for k, (label, values) in enumerate(bars.items()):
        place = np.arange(len(BUILDS)) + 0.2 * (k - 1.5)
        drawn = ax.bar(place, values, 0.19, label=label, color=plot.LINE_COLORS[k])
        ax.bar_label(drawn, fmt="%.2f", fontsize=8)
    ax.set_xticks(range(len(BUILDS)), [NAMES[build] for build in BUILDS])
    ax.set(ylabel="cost, quads and boxes = 1")
    ax.legend(fontsize=8)
    report.figure(fig, "builds", "Seconds of all cores, operations, and the published seconds, as ratios.")


def agreement(a: Estimate, b: Estimate, tiles=TILES):
    """Return the z-scores of the difference of two images' means over ``tiles`` x ``tiles`` regions and 3 channels,
    and the relative difference of the means of the images with its standard error.
    """
    error = [(e.variance / e.n) for e in (a, b)]
    difference, variance = _tiles(a.mean - b.mean, tiles), _tiles(sum(error), tiles)
    count = a.mean[..., 0].size / tiles**2
    stderr = np.sqrt(variance / count)
    # What does not vary may not differ at all.
    certain = np.where(difference == 0.0, 0.0, np.inf)
    z = np.divide(difference, stderr, out=certain, where=stderr != 0.0)
    scale = 0.5 * (a.mean.mean() + b.mean.mean())
    # The channels of a sample vary together at most fully.
    whole = np.sqrt(sum(error)).mean(-1)
    spread = np.sqrt((whole**2).sum()) / whole.size
    return z, float(difference.mean() / scale), float(spread / scale)


def _tiles(image, tiles):
    """Return means over the tiles of an image; what does not fill a tile is left out."""
    height, width = (n // tiles * tiles for n in image.shape[:2])
    image = image[:height, :width]
    return image.reshape(tiles, height // tiles, tiles, width // tiles, -1).mean((1, 3))


def _show_agreement(report, settings, builds):
    report.section("The images agree")
    pictures = {f"{NAMES[b]}, naive": found.estimate.mean for b, found in builds["naive"].items()}
    pictures |= {f"{NAMES[b]}, default": found.estimate.mean for b, found in builds["default"].items()}
    report.figure(plot.images(pictures, 3, width=3.4), "images", f"{settings.spp} samples per pixel; gamma 1/2.2.")
    runs = {f"{NAMES[b]}, {s}": found[b].estimate for s, found in builds.items() for b in found}
    rows = []
    for (one, a), (other, b) in combinations(runs.items(), 2):
        z, difference, stderr = agreement(a, b)
        largest, allowed = float(np.abs(z).max()), float(joint_sigmas(z.size))
        verdict = "agree" if largest <= allowed else "differ"
        rows.append([one, other, float(np.sqrt(np.mean(z**2))), largest, allowed, difference, stderr, verdict])
    headers = ["image", "and", "rms z", "largest |z|", "allowed", "relative difference of means", "stderr", "verdict"]
    caption = f"Means over {TILES} x {TILES} regions in 3 channels. Noise alone makes an rms z of 1."
    report.table(headers, rows, caption)


def _show_rays(report, rays: list[RayCost]):
    report.section("From one sphere to many")
    report.text(
        "Rays from random points in random directions among spheres of one size in a cube, on one core. A small scene "
        "is written out shape by shape; a larger one is a table that a loop runs over, so that the time to compile it "
        f"stays. Wanted: at most {TARGET_NS} ns for each ray and sphere, and compile times within a factor of "
        f"{TARGET_COMPILE}."
    )
    headers = ["spheres", "closest hit, ns", "shadow test, ns", *(f"compile {x}, s" for x in ("hit", "shadow", "path"))]
    rows = [[r.count, r.ns_closest, r.ns_shadow, r.compile_closest, r.compile_shadow, r.compile_path] for r in rays]
    report.table(
        headers, rows, "Nanoseconds for each ray and sphere; seconds of cores. A path has 5 events under a sky."
    )
    compiling = [r.compile_path for r in rays]
    report.values(
        {
            "compile time of a path, largest over least": max(compiling) / min(compiling),
            "largest ns for each ray and sphere, from 10 spheres on": max(
                [r.ns_closest for r in rays if r.count >= 10], default=None
            ),
        }
    )
    fig, axes = plot.panels(2, 2, (4.8, 3.6))
    counts = [r.count for r in rays]
    for label in ("closest", "shadow"):
        axes[0].plot(counts, [getattr(r, f"ns_{label}") for r in rays], "o-", ms=4, lw=1, label=label)
    for label in ("closest", "shadow", "path"):
        axes[1].plot(counts, [getattr(r, f"compile_{label}") for r in rays], "o-", ms=4, lw=1, label=label)
    axes[0].axhline(TARGET_NS, color="k", lw=0.8, ls="--", label="wanted")
    for ax, label in zip(axes, ("ns for each ray and sphere", "seconds to compile")):
        ax.set(xscale="log", xlabel="spheres", ylabel=label)
        ax.set_ylim(bottom=0.0)
        ax.legend(fontsize=8)
        ax.grid(alpha=0.3)
    report.figure(fig, "spheres", "Seconds of one core, so that other work on the machine does not count.")
