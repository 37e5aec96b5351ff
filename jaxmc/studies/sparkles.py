"""Why long paths sparkle: uniform against cosine-weighted directions in a box with a narrow gap under its ceiling.

With uniform directions each bounce multiplies throughput by 2 albedo cos(theta), up to 2 albedo; after k bounces in a
closed scene of one albedo it is a product of k independent factors, whose law is known in closed form. With
cosine-weighted directions it is the product of albedos, always.
"""

import dataclasses
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.special import lambertw

from .. import plot
from ..analysis import tails
from ..analysis.fireflies import firefly_report
from ..integration.driver import integrate, integrate_each
from ..integration.moments import Moments
from ..integration.tallies import TailHistogram, TopSamples
from ..report import Report
from ..scenes import closed_sparkle_box, sparkle_box
from ..testing import ThroughputProduct
from ..transport import debug
from ..transport.images import render
from ..transport.integrands import path_throughput
from ..transport.materials import luminance
from .stages import Stages

ALBEDO = 0.95  # of the closed box
LENGTHS = (5, 20, 100)
DIRECTIONS = ("uniform", "cosine")
GAP = 0.499  # height of the lamp; the ceiling is at 0.5


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: paths searched for the extreme one and used for the moments, samples per pixel of "
    "images."""

    paths: int = 1 << 24
    spp: int = 128
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 1 << 14 <= self.paths <= 1 << 40:
            raise ValueError(f"the study searches 2^14 to 2^40 paths, got paths={self.paths}")


def tail_index(albedo):
    """Return the exponent k of P(S > x) ~ x^-k for the sum S over all path lengths in a closed scene: E[w^k] = 1 for
    one factor w = 2 albedo U, so (2 albedo)^k = 1 + k (Kesten 1973, Goldie 1991).
    """
    a = np.log(2.0 * albedo)
    return float(-1.0 - lambertw(-a * np.exp(-a), -1).real / a)


def largest_throughput(value):
    """Return the largest throughput that a path has had."""
    return value.max(-1)


def powers(value):
    """Return w, w^2, w^3, w^4 of throughput w, on a new last axis."""
    return jnp.stack([value, value**2, value**3, value**4], -1)


def after(event, value):
    """Return the throughput after one of the numbers of events."""
    return value[..., event]


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``."""
    report = Report(folder, "Why long paths sparkle", seed=settings.seed)
    scene, camera = sparkle_box()
    closed_scene, closed_camera = closed_sparkle_box(ALBEDO)
    pixels = camera.width * camera.height
    search = max(1, settings.paths // pixels)
    with Stages(2 * settings.paths // 4 + pixels * (search + 6 * settings.spp), settings.progress) as stages:
        images = {
            (d, k): render(
                closed_scene, closed_camera, spp=settings.spp, bounces=k, directions=d, lights="none",
                key=_key(settings, 1),
                tallies={"tail": TailHistogram(luminance), "top": TopSamples(8192, luminance)},
                progress=stages.stage(f"{d}, {k} bounces"),
            )
            for d in DIRECTIONS for k in LENGTHS
        }  # fmt: skip
        extreme = integrate_each(
            path_throughput(scene, camera, events=tuple(range(1, max(LENGTHS) + 1)), directions="uniform").map(
                largest_throughput
            ),
            pixels, n=search, key=_key(settings, 2), tallies={"top": TopSamples(16)},
            progress=stages.stage("search for the extreme path"),
        )  # fmt: skip
        closed = {d: _throughput_moments(settings, closed_scene, closed_camera, d, stages) for d in DIRECTIONS}

    _show_images(report, settings, images)
    _show_extreme(report, settings, extreme["top"], pixels * search)
    _show_moments(report, closed)
    report.value("seconds of sampling", stages.seconds)
    return report.save()


def extreme_path(index, seed) -> debug.Path:
    """Replay a path of the search for the extreme one."""
    scene, camera = sparkle_box()
    return debug.replay(
        scene,
        camera,
        index,
        key=_key(Settings(seed=seed), 2),
        bounces=max(LENGTHS),
        directions="uniform",
        lights="none",
    )


def _key(settings, stream):
    return (settings.seed << 8) + stream


def _throughput_moments(settings, scene, camera, directions, stages):
    tails_by_length = {f"tail {k}": TailHistogram(partial(after, i)) for i, k in enumerate(LENGTHS)}
    return integrate(
        path_throughput(scene, camera, events=LENGTHS, directions=directions), n=settings.paths // 4,
        key=_key(settings, 3), tallies={"powers": Moments(powers, order=2), **tails_by_length},
        progress=stages.stage(f"throughput, {directions}"),
    )  # fmt: skip


def _show_images(report, settings, images):
    report.section("Sparkles come with path length")
    report.text(
        f"A closed white box of albedo {ALBEDO} with a lamp 0.001 below its ceiling, by path tracing without "
        f"light sampling. "
        "Above: directions drawn **uniformly** over the hemisphere. Below: **cosine-weighted**. The longer the "
        "paths, the "
        "more sparkles above; below there are none. For paths without end the uniform tail is a power law whose "
        "exponent "
        f"is known: k-hat would tend to {1.0 / tail_index(ALBEDO):.2f}, and above albedo 0.866 the variance is "
        f"infinite."
    )
    pictures = {f"{d}, {k} bounces": e.mean for (d, k), e in images.items()}
    caption = f"{settings.spp} samples per pixel, the same for all; gamma 1/2.2."
    exposure = 0.25 / luminance(images["cosine", max(LENGTHS)].mean).mean()
    report.figure(plot.images(pictures, 3, exposure), "images", caption)
    rows = []
    for (d, k), e in images.items():
        result = firefly_report(e["tail"], e["top"], 16.0)
        mean, stderr = luminance(e.mean).mean(), np.sqrt((luminance(e.stderr) ** 2).sum()) / e.mean[..., 0].size
        rows.append(
            [
                d,
                k,
                mean,
                stderr,
                result.maximum,
                f"{result.shares[100]:.2%}",
                f"{result.tail.khat:.2f}",
                result.tail.status,
            ]
        )
        report.value(f"fireflies, {d}, {k} bounces", result)
    headers = [
        "directions",
        "bounces",
        "mean luminance",
        "stderr",
        "largest sample",
        "share of largest 100",
        "k-hat",
        "tail",
    ]
    report.table(headers, rows, "Both ways estimate the same mean; one of them does not know it.")


def _show_extreme(report, settings, top, searched):
    path = extreme_path(int(top.index[0]), settings.seed)
    throughput = [v.throughput for v in path.vertices]
    peak = int(np.argmax(throughput))
    in_gap = sum(GAP - 1e-4 <= v.point[1] for v in path.vertices[: peak + 1])
    report.section("The extreme path")
    report.text(
        "An open Cornell-like box, whose ceiling and lamp reflect 0.99. "
        f"Of {searched:,} paths of up to {max(LENGTHS)} bounces, the one whose throughput grew most reached "
        f"**{top.value[0]:.5g}**, at vertex {peak + 1}; {in_gap} of its first {peak + 1} vertices lie in the gap "
        f"between lamp "
        f"and ceiling (y from {GAP} to 0.5). `jaxmc replay sparkles --sample {top.index[0]}` prints it again."
    )
    rows = [[i, v.primitive, *map(float, v.point), v.throughput] for i, v in enumerate(path.vertices[: peak + 1], 1)]
    caption = "Vertex by vertex; throughput is that of the path as it arrives."
    report.table(["vertex", "primitive", "x", "y", "z", "throughput"], rows, caption)
    report.values({"extreme throughput": top.value[0], "extreme sample": int(top.index[0]), "extreme path": str(path)})
    report.values({"largest throughputs": top.value, "their samples": [int(i) for i in top.index]})


def _show_moments(report, closed):
    report.section("Throughput against its exact law")
    report.text(
        "The closed box again. After k uniform bounces throughput is the product of "
        "k independent factors 2 albedo U: its q-th moment is ((2 albedo)^q / (q + 1))^k. Where a moment rests on "
        "paths rarer "
        "than the sample, the estimate falls short and its error bar with it: the tail that matters has not been seen."
    )
    rows, law = [], {k: ThroughputProduct(k, ALBEDO) for k in LENGTHS}
    moments = {d: e["powers"][0] for d, e in closed.items()}
    for i, k in enumerate(LENGTHS):
        for q in range(1, 5):
            exact = {"uniform": law[k].moment(q), "cosine": ALBEDO ** (k * q)}
            measured = [
                (float(m.mean[i, q - 1]), float(np.sqrt(m.variance[i, q - 1] / m.n[i, q - 1])))
                for m in moments.values()
            ]
            rows.append([k, q, float(exact["uniform"]), *measured[0], float(exact["cosine"]), *measured[1]])
    headers = ["bounces", "q", "exact, uniform", "measured", "stderr", "exact, cosine", "measured", "stderr"]
    report.table(headers, rows, f"E[throughput^q], {closed['uniform'].n:,} paths each.")
    fig, (ax,) = plot.panels(1, 1, (6.4, 4.4))
    for k in LENGTHS:
        plot.throughput_law(ax, tails.exceedance(closed["uniform"][f"tail {k}"]), law[k].exceedance, f"{k} bounces")
    ax.plot([], [], "k--", lw=0.8, label="exact")
    ax.set_xlim(1e-12, 1e5)
    ax.legend(fontsize=8)
    report.figure(fig, "throughput", "How often throughput exceeds w after k uniform bounces, with 95% bands.")
