"""Nested integrals with two knobs against one flat integral, at equal numbers of rays; and recursion that branches.

Rows of the source: Aalto CS-E5520, lecture "Path Tracing": ambient occlusion as two nested integrals or as a flat one
over four dimensions; a hundred rays for each hit against one.
"""

import dataclasses
import math
from pathlib import Path

import numpy as np

from .. import plot
from ..integration.driver import integrate, integrate_each
from ..integration.nets import Sobol
from ..integration.samplers import Independent
from ..report import Report
from ..transport.camera import PinholeCamera
from ..transport.integrands import neumann_terms
from ..transport.materials import Diffuse
from ..transport.primitives import Box, Quad, Sphere
from ..transport.scene import Scene
from .branching import branching_terms, furnace_law, gathered_occlusion, rays_of, split_variance
from .scores import deviation, exact_function
from .stages import Stages

DIRECTIONS = (1, 3, 7, 15, 63)  # with the camera's ray a power of two each
MANY = 15  # directions of the nested integral that stands beside the flat one
SAMPLERS = {"Independent": Independent(), "Sobol": Sobol()}
BALL = {"radius": 1.6, "height": 2.0}
PIXELS = {"small pixel": {"x": 1.2, "y": 0.1, "side": 0.6}, "wide pixel": {"x": 0.0, "y": 0.0, "side": 6.0}}
DEPTH, BRANCHES = 3, (1, 2, 4)
ALBEDO = 0.6


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: rays of one estimate, a power of two, and how many estimates tell its error."""

    rays: int = 1 << 12
    replicates: int = 128
    width: int = 96
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not (256 <= self.rays <= 1 << 24 and self.rays & (self.rays - 1) == 0):
            raise ValueError(f"an estimate takes 2^8 to 2^24 rays, a power of two, got rays={self.rays}")
        if not 8 <= self.replicates <= 1 << 16:
            raise ValueError(f"an error is measured by 8 to 2^16 estimates, got replicates={self.replicates}")
        if not 8 <= self.width <= 1024:
            raise ValueError(f"the pictures are 8 to 1024 pixels wide, got width={self.width}")

    @property
    def ladder(self):
        """Numbers of rays whose errors are measured, in steps of four."""
        return [self.rays >> k for k in range(0, 11, 2) if self.rays >> k >= 4 * (1 + MANY)][::-1]


def pixel_under_sphere(radius, height, x, y, side):
    """Return a floor under a black sphere, and a camera of one pixel that sees a square of it from straight above."""
    eye = min(side, (height - radius) / 2.0)
    floor = Quad((x - side, y - side, 0.0), (2.0 * side, 0.0, 0.0), (0.0, 2.0 * side, 0.0), Diffuse(1.0))
    fov = 2.0 * math.degrees(math.atan(side / 2.0 / eye))
    camera = PinholeCamera((x, y, eye), (x, y, 0.0), up=(0.0, 1.0, 0.0), fov=fov, width=1, height=1)
    return Scene([Sphere((0.0, 0.0, height), radius, Diffuse(0.0)), floor]), camera


def grey_box(width=64, height=64):
    """Return a closed grey room with a lamp below its ceiling, and a camera inside."""
    lamp = Quad((-0.4, 0.98, -0.4), (0.8, 0.0, 0.0), (0.0, 0.0, 0.8), Diffuse(0.0), 10.0)
    ball = Sphere((0.4, -0.6, -0.4), 0.4, Diffuse(ALBEDO))
    scene = Scene([Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), material=Diffuse(ALBEDO), inward=True), lamp, ball])
    return scene, PinholeCamera((0.0, 0.0, 0.95), (0.0, 0.0, 0.0), fov=80, width=width, height=height)


def predicted(pixel) -> tuple[float, float]:
    """Return the variance between the points of a pixel, and the mean one within them.

    A floor point at distance d from below a sphere sees the share 1 - r^2 h / (h^2 + d^2)^(3/2) of the sky.
    """

    def share(x, y):
        squared = (x + pixel["x"]) ** 2 + (y + pixel["y"]) ** 2
        return 1.0 - BALL["radius"] ** 2 * BALL["height"] / (BALL["height"] ** 2 + squared) ** 1.5

    return split_variance(share, pixel["side"])


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``; raises ``ValueError`` without exact values."""
    exact_pixel = exact_function("open_pixel_under_sphere")
    report = Report(folder, "Two nested integrals or one flat one", seed=settings.seed)
    pixels = (settings.width // 2) ** 2
    total = settings.replicates * (2 * 2 * len(DIRECTIONS) * settings.rays + 4 * sum(settings.ladder))
    total += 3 * pixels * 32 + len(BRANCHES) * settings.replicates * settings.rays
    with Stages(total, settings.progress) as stages:
        _show_law(report, settings, stages, exact_pixel)
        _show_errors(report, settings, stages, exact_pixel)
        _show_pictures(report, settings, stages)
        _show_branching(report, settings, stages)
        report.value("seconds", stages.seconds)
    return report.save()


def estimate_error(scene, camera, directions, sampler, rays, replicates, key, progress=None):
    """Return the estimate of a pixel from ``replicates`` runs of ``rays`` rays each, the camera's included, and the
    standard deviation of one run.
    """
    n = rays // (1 + directions)
    given = {"n": n * replicates, "sampler": sampler, "key": key, "progress": progress}
    integrand = gathered_occlusion(scene, camera, directions)
    estimate = integrate(integrand, replicates=None if sampler.independent else replicates, **given)
    return estimate, float(estimate.stderr) * math.sqrt(replicates)


def _show_law(report, settings, stages, exact_pixel):
    report.section("Two knobs: film samples and directions")
    report.text(
        "A pixel sees a square of floor under a black ball and a white sky. Its ambient occlusion is known exactly. "
        "The nested way takes N film samples and from each of them M directions. The variance of its mean is B / N + "
        "W / (N M): B is that **between** the points of the pixel, W the mean one **within** them. More directions "
        "leave B as it is. With M = 1 the two integrals are one flat integral over four dimensions, without a knob."
    )
    fig, axes = plot.panels(3, 3, (4.6, 3.8))
    rows, m = [], np.array(DIRECTIONS)
    for k, (name, pixel) in enumerate(PIXELS.items()):
        exact, (between, within) = exact_pixel(**BALL, **pixel).exact, predicted(pixel)
        law, measured = between + within / m, {sampler: [] for sampler in SAMPLERS}
        one = []
        for j, directions in enumerate(DIRECTIONS):
            for i, (word, sampler) in enumerate(SAMPLERS.items()):
                progress = stages.stage(f"{name}, {directions} directions, {word}")
                key = (settings.seed << 8) + 16 * k + 2 * j + i
                estimate, error = estimate_error(
                    *pixel_under_sphere(**BALL, **pixel), directions, sampler, settings.rays, settings.replicates, key,
                    progress,
                )  # fmt: skip
                measured[word].append(error)
                z = deviation(estimate.mean, exact, float(estimate.stderr))
                n = settings.rays // (1 + directions)
                if sampler.independent:
                    one.append((float(estimate.variance), variance_error(estimate)))
                rows.append(
                    [name, word, n, directions, estimate.mean, exact, z, error**2, law[j] / n, error**2 * n / law[j]]
                )
        one = np.array(one).T
        report.values({f"{name}: between": between, f"{name}: within": within, f"{name}: exact": exact})
        report.value(f"{name}: z of measured variance against the law", (one[0] - law) / one[1])
        best = math.sqrt(within / between)
        report.value(f"{name}: best number of directions where a camera ray costs as much as another", best)
        plot.law(axes[0], m, {name: (one[0], law)}, "directions M", "variance of one film sample")
        errors = {word: (values, None) for word, values in measured.items()}
        errors["Independent"] = (measured["Independent"], np.sqrt(law * (1 + m) / settings.rays))
        plot.law(axes[k + 1], m, errors, "directions M", f"RMS error of {settings.rays:,} rays")
        axes[k + 1].set_title(f"{name}: B = {between:.3g}, W = {within:.3g}", fontsize=10)
    axes[0].set_title("B + W / M (lines) and measured (dots)", fontsize=10)
    caption = (
        "Left: the law of one film sample. Middle and right: error at equal numbers of rays, the camera's included, so "
        "N = rays / (1 + M). Where the points of the pixel differ little, a few directions share a camera ray with "
        "profit; where they differ, every direction more than a few costs film samples. Sobol' points gain most in the "
        "flat integral, whose four dimensions they fill as a whole."
    )
    report.figure(fig, "law", caption)
    headers = ["pixel", "points", "N", "M", "mean", "exact", "z", "variance", "B/N + W/(NM)", "measured / law"]
    report.table(headers, rows, f"Estimates of {settings.rays:,} rays. The law is that of independent samples.")


def variance_error(estimate) -> float:
    """Return the standard error of the variance of a sample."""
    second, _, fourth = (float(c) for c in estimate.moments[0].central)
    return math.sqrt(max(fourth - second**2, 0.0) / estimate.n)


def _show_errors(report, settings, stages, exact_pixel):
    pixel = PIXELS["wide pixel"]
    scene, camera = pixel_under_sphere(**BALL, **pixel)
    fig, axes = plot.panels(1, 1, (6.4, 4.2))
    rows, curves = [], {}
    for j, directions in enumerate((1, MANY)):
        for i, (word, sampler) in enumerate(SAMPLERS.items()):
            label = f"{'flat' if directions == 1 else f'nested, M = {directions}'}, {word}"
            progress, errors = stages.stage, []
            for k, rays in enumerate(settings.ladder):
                key = (settings.seed << 8) + 64 + 16 * k + 2 * j + i
                _, error = estimate_error(
                    scene, camera, directions, sampler, rays, settings.replicates, key, progress(label)
                )
                errors.append(error)
            slope = float(np.polyfit(np.log(settings.ladder), np.log(errors), 1)[0]) if len(errors) > 1 else None
            rows.append([label, *errors, slope])
            curves[label if slope is None else f"{label}: slope {slope:.2f}"] = (errors, None)
    plot.law(axes[0], settings.ladder, curves, "rays", "RMS error of the wide pixel")
    report.section("Error against rays")
    report.figure(fig, "error_against_rays", "A wide pixel, flat and nested, by independent and by Sobol' points.")
    report.table(["", *(f"{rays:,} rays" for rays in settings.ladder), "slope"], rows, "RMS errors of one estimate.")


def _show_pictures(report, settings, stages):
    width = settings.width // 2  # large pixels show their edges
    camera = PinholeCamera((0.0, -0.1, 3.2), (0.05, -0.5, -0.4), fov=32, width=width, height=width)
    pictures = {}
    for k, (n, directions) in enumerate(((16, 1), (4, 7), (1, 31))):
        integrand = gathered_occlusion(_opened(), camera, directions)
        progress = stages.stage("pictures")
        estimate = integrate_each(
            integrand, camera.width * camera.height, n=n, key=(settings.seed << 8) + 200 + k, progress=progress
        )
        image = np.asarray(estimate.mean).reshape(camera.height, camera.width, 1)
        pictures[f"N = {n}, M = {directions}" + (" (flat)" if directions == 1 else "")] = np.repeat(image, 3, -1)
    report.section("The same in a picture")
    caption = (
        "Ambient occlusion by 32 rays for each pixel, the camera's included. One film sample gives clean areas and "
        "jagged edges; the flat integral smooth edges and more noise."
    )
    report.figure(plot.images(pictures, columns=3), "pictures", caption)


def _opened():
    """Return a floor with a ball and a box, under an open sky."""
    floor = Quad((-4.0, -1.0, 4.0), (8.0, 0.0, 0.0), (0.0, 0.0, -5.0))
    turned = ((0.8, 0.0, 0.6), (0.0, 1.0, 0.0), (-0.6, 0.0, 0.8))
    return Scene([floor, Sphere((0.45, -0.55, -0.5), 0.45), Box((-0.4, -0.6, -0.3), (0.6, 0.8, 0.5), turned)])


def _show_branching(report, settings, stages):
    scene, camera = grey_box()
    n = max(settings.rays * settings.replicates // 8, 1 << 10)
    reference = integrate(
        neumann_terms(scene, camera, bounces=DEPTH, lights="none", directions="cosine"),
        n=4 * n, key=(settings.seed << 8) + 240,
    )  # fmt: skip
    rows, efficiency = [], {b: [] for b in BRANCHES}
    for k, branch in enumerate(BRANCHES):
        estimate = integrate(
            branching_terms(scene, camera, depth=DEPTH, branch=branch), n=max(n // branch**2, 1 << 9),
            key=(settings.seed << 8) + 241 + k, progress=stages.stage(f"branching, {branch} rays at each hit"),
        )  # fmt: skip
        for depth in range(1, DEPTH + 1):
            rays, mean, variance = rays_of(depth, branch), estimate.mean[depth], estimate.variance[depth]
            error = np.hypot(estimate.stderr[depth], reference.stderr[depth])
            z = deviation(mean, reference.mean[depth], error)
            efficiency[branch].append(mean**2 / (variance * rays))
            rows.append([depth, branch, rays, mean, reference.mean[depth], z, variance, efficiency[branch][-1]])
    report.section("Recursion that branches")
    report.text(
        "A hundred rays for each hit are 10^2 at the first, 10^4 at the second and 10^6 at the third. One ray for "
        "each bounce is a flat integral over screen and hemispheres. Below, the light after exactly k scattering "
        "events in a grey room, by rays that wait for a lamp; and in a white furnace, where mean and variance are "
        "exact. Where only the last ray decides, as for a lamp that few rays meet, two or four of them pay for each "
        "ray. Where every event counts, as in the furnace, a hundred at depth 3 are a thousand times worse than one."
    )
    fig, axes = plot.panels(2, 2, (5.0, 3.8))
    depths = np.arange(1, 5)
    counts = {f"b = {b}": ([rays_of(d, b) for d in depths], None) for b in (1, 2, 4, 10, 100)}
    plot.law(axes[0], depths, counts, "depth", "rays of one sample", logx=False)
    branches = np.array([1, 2, 3, 4, 6, 10, 30, 100])
    curves = {
        f"depth {d}": ([efficiency[b][d - 1] / efficiency[1][d - 1] for b in BRANCHES], None)
        for d in range(1, DEPTH + 1)
    }
    plot.law(axes[1], BRANCHES, curves, "rays b at each hit", "efficiency at equal rays, b = 1 is 1")
    furnace = {d: np.array([_furnace_efficiency(d, b) for b in branches]) for d in range(1, DEPTH + 1)}
    for d, values in furnace.items():
        axes[1].plot(
            branches, values / values[0], color="0.6", lw=0.8, ls="--", label="law of a furnace" if d == 1 else None
        )
    axes[1].set_xticks(branches, branches)
    axes[1].legend(fontsize=8)
    caption = (
        "Left: how many rays a sample takes. Right: efficiency, 1 / (relative variance x rays), against one ray for "
        "each bounce: measured for the light after exactly so many events in the room (dots), and exactly for all the "
        "light in a white furnace with uniform directions (dashed, depths 1 to 3 from above)."
    )
    report.figure(fig, "branching", caption)
    headers = ["depth", "b", "rays", "mean", "one ray for each bounce", "z", "variance", "efficiency for a ray"]
    report.table(headers, rows, "The light after exactly so many events; z is against `mc.neumann_terms`.")
    rows = [
        [d, b, rays_of(d, b), *furnace_law(ALBEDO, d, b), _furnace_efficiency(d, b)]
        for d in (1, 2, 3)
        for b in (1, 10, 100)
    ]
    report.table(["depth", "b", "rays", "mean", "variance", "efficiency for a ray"], rows, "Exact, in a white furnace.")


def _furnace_efficiency(depth, branch):
    mean, variance = furnace_law(ALBEDO, depth, branch)
    return mean**2 / (variance * rays_of(depth, branch))
