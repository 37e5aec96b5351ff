"""What every cure of fireflies costs, on any scene: bias, variance, squared error, energy, and time."""

import dataclasses
from pathlib import Path
from typing import Any

from .. import plot
from ..fireflies import Comparison, compare
from ..report import Report
from ..transport.views import resized


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: the scene with its camera, its ``name`` and the options of its ``paths``; ``spp`` samples
    per pixel of the reference, in an image of ``width`` pixels.
    """

    scene: Any
    camera: Any
    name: str
    paths: dict[str, Any]
    spp: int = 32768
    width: int = 96
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        if not (256 <= self.spp <= 1 << 20 and self.spp & (self.spp - 1) == 0):
            raise ValueError(f"the study takes a power of two from 256 to 2^20 samples per pixel, got spp={self.spp}")
        if not 8 <= self.width <= 4096:
            raise ValueError(f"the study takes 8 to 4096 pixels in a row, got width={self.width}")


def run(folder, settings: Settings) -> Path:
    """Run the study and return the path of its ``report.html``."""
    report = Report(folder, f"Cures of fireflies: {settings.name}", seed=settings.seed)
    camera = settings.camera
    camera = resized(camera, settings.width, max(1, round(settings.width * camera.height / camera.width)))
    progress = settings.name if settings.progress else None
    found = compare(settings.scene, camera, spp=settings.spp, key=settings.seed, progress=progress, **settings.paths)
    show(report, found)
    return report.save()


def show(report: Report, found: Comparison):
    """Add a comparison of cures to a report: what it says, its figure and its table."""
    counts = ", ".join(map(str, found.counts))
    report.section("What each cure costs")
    report.text(
        f"Errors of luminance, for images of {counts} samples per pixel, against {found.spp:,} samples per pixel of "
        f"the scene as it is: the mean of that reference is known to {found.relative_error:.1e}, and its noise is no "
        "part of any number here.\n\n"
        "Cures that average independent samples have a bias and a variance of one sample, so their error is known for "
        "any N. The others are measured on images of N samples. **Energy lost** is what the mean of the image lacks. "
        "The best clamp is one threshold for the whole image, chosen with the truth in hand."
    )
    caption = (
        "Root mean squared error over that of the unclamped estimator, energy, and time; bars are one standard error, "
        "arrows stand where an error is below what could be measured. Below: where light is lost, mean of 3 x 3 pixels."
    )
    report.figure(plot.cures(found), "cures", caption)
    table = found.table()
    report.table(table.headers, table.rows, "Every cure: digits in brackets are the standard error of the last ones.")
    report.values({
        "spp": found.spp,
        "relative error of the reference": found.relative_error,
        "cures": [
            {"name": r.name, "averages": r.averages, "time": r.time, "time stderr": r.time_stderr,
             "at": {str(N): m for N, m in r.at.items()}} for r in found.rows
        ],
        "best clamp": {str(N): b for N, b in found.best.items()},
    })  # fmt: skip
