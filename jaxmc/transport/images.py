"""Images: one integral for each pixel, all at once or in passes."""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple, Unpack

import jax
import numpy as np

from ..integration.counts import positive
from ..integration.driver import integrate_each
from ..integration.estimate import Estimate
from ..integration.integrand import Integrand
from ..integration.moments import Moments, MomentsResult
from ..integration.passes import integrate_each_in_passes
from ..integration.samplers import Independent
from ..integration.schedules import integrate_progressively
from .camera import Camera
from .film import on_film
from .integrands import path_integrand
from .regularize import Regularize, Shrinking
from .scene import Scene
from .strategy import PathOptions


def render(
    scene: Scene, camera: Camera, *, spp, bounces=5, key=0, sampler=Independent(), replicates=None, filter=None,
    tallies=None, progress=None, workers=None, chunk=None, **options: Unpack[PathOptions],
) -> Estimate:  # fmt: skip
    """Render an image: one integral for each pixel, ``spp`` samples each.

    Sample s of pixel p (row by row from the top left) has index ``s * width * height + p``, or as ``integrate_each``
    says for points that are not independent; ``replay`` shows its path. Points that are not independent are randomised
    afresh for each pixel and replicate, of which there are 4 by default.
    Path options as in ``path_integrand``, the rest as in ``integrate``.

    ``filter=None`` makes a pixel the mean of its own samples. With a filter, such as ``MitchellFilter()``, samples are
    the same but count in all pixels around: a pixel is the sum of weight times radiance over the sum of the weights.
    There are no samples outside of the image: at its border a pixel is a mean over the part of the filter inside. That
    ratio has a bias of the order of 1 / spp, far below its error; ``stderr`` is that of the ratio, to first order, from
    the spread of the samples in each pixel around, or from that of the images where there are replicates.
    ``variance`` is spp times its square, for points that are independent. Neighbours share samples, so their errors are
    correlated. A value that is not finite spoils all pixels in reach. Tallies see the samples by themselves.

    Returns:
        An ``Estimate`` whose mean, variance and stderr have shape ``(height, width, 3)``: radiance, not clipped.
        ``Moments`` among ``tallies`` come back in that shape too.

    Raises:
        ValueError: as in ``path_integrand`` and ``integrate``, or a filter that is none, or one for a camera without
            anti-aliasing.
    """
    image = Image.of(scene, camera, filter, tallies, bounces=bounces, **options)
    estimate = integrate_each(
        image.integrand, camera.width * camera.height, n=positive("spp", spp), key=key, sampler=sampler,
        replicates=replicates, tallies=image.seen, progress=progress, workers=workers, chunk=chunk, kept=image.kept,
    )  # fmt: skip
    return image.shaped(estimate)


def render_progressively(
    scene: Scene, camera: Camera, *, spp, bounces=5, key=0, sampler=Independent(), replicates=None, filter=None,
    tallies=None, progress=None, workers=None, chunk=None, **options: Unpack[PathOptions],
) -> Iterator[Estimate]:  # fmt: skip
    """Render an image in passes: return an iterator over estimates, the last of which is that of ``render``.

    Independent samples come in passes of 1, 1, 2, 4 and so on up to 32 for each pixel, then an eighth of what is there;
    those of other samplers by whole randomisations, 4 by default. Passes are disjoint parts of the samples of
    ``render``: each of the estimates is unbiased and has its own error, NaN while there is but one sample or replicate.
    To stop earlier, leave the loop. Arguments, values and errors as in ``render``.

    The amount of ``regularize`` may be a ``Shrinking``: then each pass has the amount of the samples in it, and the
    bias fades. Points are independent ones then.

    Raises:
        ValueError: a ``Shrinking`` amount with other points or with replicates; otherwise as ``render``.
    """
    rule = options.get("regularize")
    if isinstance(rule, Regularize) and isinstance(rule.amount, Shrinking):
        if not sampler.independent or replicates:
            raise ValueError(f"a shrinking amount needs independent points, got {sampler!r}, replicates={replicates!r}")

        def at(i):
            blurred = options | {"regularize": dataclasses.replace(rule, amount=rule.amount(i))}
            return Image.of(scene, camera, filter, tallies, bounces=bounces, **blurred)

        first = at(1.0)
        estimates = integrate_progressively(
            lambda i: at(i).integrand, n=positive("spp", spp), items=camera.width * camera.height, key=key,
            tallies=first.seen, progress=progress, workers=workers, chunk=chunk, kept=first.kept,
        )  # fmt: skip
        return map(first.shaped, estimates)
    image = Image.of(scene, camera, filter, tallies, bounces=bounces, **options)
    estimates = integrate_each_in_passes(
        image.integrand, camera.width * camera.height, n=positive("spp", spp), key=key, sampler=sampler,
        replicates=replicates, tallies=image.seen, progress=progress, workers=workers, chunk=chunk, kept=image.kept,
    )  # fmt: skip
    return map(image.shaped, estimates)


class Image(NamedTuple):
    """A family of integrals that are the pixels of an image: what is integrated, and how samples become pixels.

    ``kept`` is the tally that pixels come from, ``seen`` the tallies of the samples, ``tallies`` these as they came.
    """

    integrand: Integrand
    camera: Camera
    filter: Any
    kept: Any
    seen: Any
    tallies: Any

    @classmethod
    def of(cls, scene, camera, filter, tallies, **options) -> "Image":
        integrand, kept, seen = path_integrand(scene, camera, **options), Moments(order=2), tallies
        if filter is not None:
            integrand, kept, seen = on_film(integrand, filter, camera, tallies)
        return cls(integrand, camera, filter, kept, seen, tallies or {})

    def shaped(self, estimate: Estimate) -> Estimate:
        """Return an estimate of the pixels, in the order of their numbers, as that of an image."""
        tallies = {
            name: list(map(self._shaped, result)) if isinstance(self.tallies[name], Moments) else result
            for name, result in estimate.tallies.items()
        }
        moments = list(map(self._shaped, estimate.moments))
        between = estimate.between and list(map(self._shaped, estimate.between))
        if self.filter is not None:
            recipe = estimate.recipe | {"filter": repr(self.filter)}
            estimate = dataclasses.replace(estimate, structure=jax.tree.structure(0), recipe=recipe, ratio=True)
        return dataclasses.replace(estimate, moments=moments, tallies=tallies, between=between)

    def _shaped(self, m: MomentsResult) -> MomentsResult:
        def image(x):
            x = x.reshape(self.camera.height, self.camera.width, -1)
            return np.broadcast_to(x, (*x.shape[:2], 3))

        return MomentsResult(image(m.n), image(m.mean), [image(c) for c in m.central], m.nonfinite)
