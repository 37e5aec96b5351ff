"""A picture that refines while it is rendered: in a file, with a line on the terminal, or in a notebook."""

import sys
import time
from collections.abc import Callable, Iterable

import numpy as np

from .integration.estimate import Estimate
from .transport.camera import Camera
from .transport.images import render_progressively
from .transport.materials import luminance
from .transport.scene import Scene


def preview(scene: Scene, camera: Camera, *, spp=64, exposure=1.0, **options) -> Estimate:
    """Render an image in passes and show it after each of them, in place, in a notebook.

    Interrupt the kernel to stop early. Without IPython nothing is shown.

    Args:
        spp: samples for each pixel, at the most.
        exposure: what radiance is multiplied by for display, before it is cut off at 1.
        options: as in ``render``.

    Returns:
        The last estimate: of all samples, or of the passes that were complete when it was interrupted.

    Raises:
        ValueError, TypeError: as ``render``.
    """
    estimates = render_progressively(scene, camera, spp=spp, **options)
    display = _display()
    return refine(estimates, display(exposure) if display else lambda estimate, line: None, spp)[0]


def refine(estimates: Iterable[Estimate], show: Callable[[Estimate, str], None], spp: int) -> tuple[Estimate, bool]:
    """Call ``show(estimate, line)`` with each estimate of an image and what can be said of it in one line; there are to
    be ``spp`` samples for each pixel.

    Returns the last estimate, and whether it is that of all samples: Ctrl-C ends with what has been reached. Before the
    first estimate there is nothing, and ``KeyboardInterrupt`` is raised.
    """
    last, before, started = None, 0, time.perf_counter()
    try:
        for last in estimates:
            rate = (last.n - before) * last.mean[..., 0].size / (time.perf_counter() - started)
            show(last, f"{last.n:,} of {max(spp, last.n):,} spp, {said(last, rate)}")
            before, started = last.n, time.perf_counter()
    except KeyboardInterrupt:
        if last is None:
            raise
        return last, False
    return last, True


def said(estimate: Estimate, rate: float) -> str:
    """Return seconds, a rate in paths per second and the mean relative error of an image, in words."""
    error = relative_error(estimate)
    error = "" if np.isnan(error) else f", mean relative error {error:.2%}"
    return f"{estimate.seconds:.1f} s, {rate / 1e6:.3g} million paths/s{error}"


def relative_error(estimate: Estimate) -> float:
    """Return the mean standard error of the pixels of an image over their mean, of luminance; NaN where not known.

    The error of luminance is an upper bound, reached where the channels vary together.
    """
    error, mean = luminance(estimate.stderr).mean(), luminance(estimate.mean).mean()
    return float(error / mean) if mean > 0.0 else float("nan")


class Terminal:
    """A line of text that is written again in place on a terminal; elsewhere each is a line of its own."""

    def __init__(self, stream=None):
        self.stream = stream or sys.stderr
        self.in_place = self.stream.isatty()

    def say(self, line):
        self.stream.write(f"\r\x1b[K{line}" if self.in_place else f"{line}\n")
        self.stream.flush()

    def end(self):
        if self.in_place:
            self.stream.write("\n")


def _display():
    """Return what makes a ``show`` for ``refine`` in a notebook, None where there is no IPython session."""
    try:
        from IPython import get_ipython
        from IPython.display import Image, display
    except ImportError:
        return None
    if get_ipython() is None:
        return None

    def begin(exposure):
        from . import plot

        handle = None

        def show(estimate, line):
            nonlocal handle
            shown = Image(plot.png(plot.images({line: estimate.mean}, 1, exposure)))
            if handle is None:
                handle = display(shown, display_id=True)
            else:
                handle.update(shown)

        return show

    return begin
