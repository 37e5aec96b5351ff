"""Images that refine while they are rendered."""

import dataclasses
from collections.abc import Iterator
from typing import Unpack

from ..integration.counts import positive
from ..integration.estimate import Estimate
from ..integration.moments import Moments
from ..integration.passes import integrate_each_in_passes
from ..integration.samplers import Independent
from ..integration.schedules import integrate_progressively
from .camera import Camera
from .integrands import _as_image, path_integrand
from .regularize import Shrinking
from .scene import Scene
from .strategy import PathOptions


def render_progressively(
    scene: Scene, camera: Camera, *, spp, bounces=5, key=0, sampler=Independent(), replicates=None, tallies=None,
    progress=None, workers=None, chunk=None, **options: Unpack[PathOptions],
) -> Iterator[Estimate]:  # fmt: skip
    """Render an image in passes: return an iterator over estimates, the last of which is that of ``render``.

    Independent samples come in passes of 1, 1, 2, 4 and so on up to 64 for each pixel, then an eighth of what is there;
    those of other samplers by whole randomisations, 4 by default. Passes are disjoint parts of the samples of
    ``render``: each of the estimates is unbiased and has its own error, NaN while there is but one sample or replicate.
    To stop earlier, leave the loop. Arguments, values and errors as in ``render``.

    The amount of ``regularize`` may be a ``Shrinking``: then each pass has the amount of the samples in it, and the
    bias fades. Points are independent ones then.

    Raises:
        ValueError: a ``Shrinking`` amount with other points or with replicates.
    """
    shrinking = _shrinking(options.get("regularize"))
    if shrinking:
        if not sampler.independent or replicates:
            raise ValueError(f"a shrinking amount needs independent points, got {sampler!r}, replicates={replicates!r}")

        def make(i):
            rule = dataclasses.replace(options["regularize"], amount=shrinking(i))
            return path_integrand(scene, camera, bounces=bounces, **(options | {"regularize": rule}))

        passes = integrate_progressively(
            make, n=positive("spp", spp), items=camera.width * camera.height, key=key, tallies=tallies,
            progress=progress, workers=workers, chunk=chunk,
        )  # fmt: skip
        return (_as_images(estimate, camera, tallies or {}) for estimate in passes)
    estimates = integrate_each_in_passes(
        path_integrand(scene, camera, bounces=bounces, **options), camera.width * camera.height,
        n=positive("spp", spp), key=key, sampler=sampler, replicates=replicates, tallies=tallies, progress=progress,
        workers=workers, chunk=chunk,
    )  # fmt: skip
    return (_as_images(estimate, camera, tallies or {}) for estimate in estimates)


def _shrinking(regularize) -> Shrinking | None:
    amount = getattr(regularize, "amount", None)
    return amount if isinstance(amount, Shrinking) else None


def _as_images(estimate: Estimate, camera, tallies) -> Estimate:
    further = {
        name: [_as_image(m, camera) for m in result] if isinstance(tallies[name], Moments) else result
        for name, result in estimate.tallies.items()
    }
    moments = [_as_image(m, camera) for m in estimate.moments]
    between = estimate.between and [_as_image(m, camera) for m in estimate.between]
    return dataclasses.replace(estimate, moments=moments, tallies=further, between=between)
