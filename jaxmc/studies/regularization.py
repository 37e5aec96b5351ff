"""What path regularization keeps of a caustic, and clamping does not: the mirror box at few samples.

Rows of the source: M. Pharr, "Ignoring the Inconvenient When Tracing Rays", Ray Tracing Gems (2019), chapter 17: its
images clamped at 3, with 16 samples per pixel and with 1024, and regularized, with 16 and with 128.
"""

import dataclasses
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

from .. import plot
from ..analysis.convergence import image_error
from ..integration.moments import Moments
from ..report import Report
from ..scenes import mirror_box
from ..transport.clamps import Clamp
from ..transport.images import render
from ..transport.materials import luminance
from ..transport.regularize import Regularize
from .mirror_box import CLAMP, PATHS, clamp_value, luminance_variance
from .stages import Stages

CURES = {
    "none": {},
    f"clamped at {CLAMP:g}": {"clamp": CLAMP},
    f"indirect light clamped at {CLAMP:g}": {"clamp": Clamp(indirect=CLAMP)},
    "regularized, pbrt": {"regularize": "pbrt"},
    "regularized, cone of 0.1": {"regularize": Regularize("cone", 0.1)},
    "regularized, max_prev up to 0.3": {"regularize": Regularize("max_prev", 0.3)},
    "regularized, opsr 0.1": {"regularize": Regularize("opsr", 0.1)},
}
SHOWN = ("none", f"clamped at {CLAMP:g}", "regularized, pbrt", "regularized, max_prev up to 0.3")
SHARE = 0.5  # of the light that clamping takes away falls into the region that is measured


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: ``spp`` samples per pixel of the reference, and an eighth of that for each cure's bias."""

    spp: int = 8192
    width: int = 192
    height: int = 128
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not 256 <= self.spp <= 1 << 20:
            raise ValueError(f"the study takes 256 to 2^20 samples per pixel, got spp={self.spp}")

    @property
    def few(self):
        """The sample counts of the images, and how many independent renders there are of each."""
        return {16: min(16, self.spp // 16), 128: min(4, self.spp // 128)}


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``."""
    report = Report(folder, "Keeping the caustic: regularization beside clamping", seed=settings.seed)
    scene, camera = mirror_box(True, settings.width, settings.height)
    pixels, few = settings.width * settings.height, settings.few
    each = settings.spp // 8 + sum(n * count for n, count in few.items())
    with Stages(pixels * (settings.spp * 9 // 8 + each * len(CURES)), settings.progress) as stages:

        def shoot(spp, stream, title, options=None):
            key, progress = (settings.seed << 8) + stream, stages.stage(title)
            tallies = {"clamped": Moments(clamp_value, order=2)}
            return render(
                scene, camera, spp=spp, **PATHS, **(options or {}), key=key, tallies=tallies, progress=progress
            )

        reference, pilot = shoot(settings.spp, 0, "reference"), shoot(settings.spp // 8, 1, "where the caustic is")
        runs = {}
        for name, options in CURES.items():
            runs[name] = {settings.spp // 8: [shoot(settings.spp // 8, 2, name, options)]}
            for stream, (n, count) in enumerate(few.items()):
                runs[name][n] = [shoot(n, 16 * (1 + stream) + r, name, options) for r in range(count)]

    region = _caustic(pilot)
    _show_images(report, reference, runs)
    _show_energy(report, reference, runs, region, settings)
    return report.save()


def _caustic(pilot):
    """Return the pixels of the caustic: the fewest that hold half of what clamping takes away, smoothed."""
    lost = uniform_filter(luminance(pilot.mean) - luminance(pilot["clamped"][0].mean), 7)
    order = np.argsort(lost, axis=None)[::-1]
    held = np.cumsum(lost.ravel()[order])
    region = np.zeros(lost.size, bool)
    region[order[: np.searchsorted(held, SHARE * held[-1])]] = True
    return region.reshape(lost.shape)


def _show_images(report, reference, runs):
    pictures = {f"reference, {reference.n} spp": reference.mean}
    for n in (16, 128):
        pictures |= {f"{name}, {n} spp": runs[name][n][0].mean for name in SHOWN}
    report.section("The images")
    report.text(
        "Clamping makes the image calm and takes the caustic away: light that comes over the mirror ball is rare "
        "and bright. Regularization makes the ball a little rough for paths that have met a diffuse surface, so "
        "that light sampling reaches the lamp over it: the caustic stays, blurred. What the camera sees in the ball is "
        "sharp."
    )
    report.figure(plot.images(pictures), "images", "Tone-mapped with gamma 1/2.2, nothing else.")


def _show_energy(report, reference, runs, region, settings):
    truth, lost = luminance(reference.mean), luminance(reference["clamped"][0].mean)
    noise = luminance_variance(reference)
    whole, none = truth[region].mean(), lost[region].mean()
    error = _error(reference, region)
    rows = []
    for name, by_count in runs.items():
        for n, estimates in by_count.items():
            images = np.array([luminance(e.mean) for e in estimates])
            mean = images[:, region].mean()
            stderr = np.sqrt(sum(_error(e, region) ** 2 for e in estimates)) / len(estimates)
            rows.append([
                name, n, mean, stderr, (mean - none) / (whole - none), stderr / (whole - none),
                float(np.mean([image_error(image, truth, noise) for image in images])),
            ])  # fmt: skip
    report.section("What is left of the caustic")
    headers = ["cure", "N", "luminance there", "stderr", "of the caustic kept", "its stderr", "MSE of a pixel"]
    caption = (
        f"The caustic: {region.sum():,} of {region.size:,} pixels, which hold {SHARE:.0%} of what clamping at "
        f"{CLAMP:g} takes away. Luminance there is {whole:.5f} +- {error:.5f} in the reference and {none:.5f} in the "
        "same samples clamped: the first is a caustic kept in full, the second none. The long run of each cure, "
        f"{settings.spp // 8} samples, states its bias; independent renders of 16 and 128 must agree with it. The "
        "noise of the reference is taken off the squared errors."
    )
    report.table(headers, rows, caption)
    report.values({
        "caustic": {"pixels": int(region.sum()), "reference": whole, "stderr": error, "clamped": none},
        "cures": [dict(zip(headers, row, strict=True)) for row in rows],
    })  # fmt: skip


def _error(estimate, region):
    """Return the standard error of the mean luminance over some pixels, which are independent."""
    return float(np.sqrt(luminance_variance(estimate)[region].sum()) / region.sum())
