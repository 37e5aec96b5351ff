"""Images: one integral for each pixel, all at once or in passes."""

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple, Unpack

import jax
import numpy as np

from ..integration.counts import is_count, positive
from ..integration.driver import family, family_run
from ..integration.estimate import Estimate
from ..integration.integrand import Integrand
from ..integration.moments import Moments, MomentsResult
from ..integration.parts import part
from ..integration.passes import integrate_each_in_passes
from ..integration.run import check_tallies
from ..integration.samplers import Independent
from ..integration.schedules import integrate_progressively
from ..integration.storage import storable
from .camera import Camera
from .film import on_film
from .integrands import path_integrand
from .regularize import Regularize, Shrinking
from .scene import Scene
from .strategy import PathOptions


def render(
    scene: Scene, camera: Camera, *, spp, bounces=5, key=0, sampler=Independent(), replicates=None, filter=None,
    tallies=None, progress=None, workers=None, chunk=None, checkpoint=None, indices=None, tiles=None,
    **options: Unpack[PathOptions],
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

    ``checkpoint`` is a file from which a render that was killed goes on, as in ``integrate``. A part of the image is
    made by ``indices``, a ``range`` of the samples 0 <= s < spp of every pixel, or by ``tiles``, a list of rectangles
    (left, top, width, height) in pixels that do not overlap; ``merge`` makes an image of such parts. Pixels outside of
    the tiles are NaN. Parts by tiles are exact: merged, they are the image that one run makes, bit for bit.

    Returns:
        An ``Estimate`` whose mean, variance and stderr have shape ``(height, width, 3)``: radiance, not clipped.
        ``Moments`` among ``tallies`` come back in that shape too.

    Raises:
        ValueError: as in ``path_integrand`` and ``integrate``, a filter that is none, or one for a camera without
            anti-aliasing, or with tiles, whose pixels would lack the samples of their neighbours; tiles that overlap or
            leave the image.
    """
    image = Image.of(scene, camera, filter, tallies, bounces=bounces, **options)
    if tiles is not None and filter is not None:
        raise ValueError("pixels with a filter need their neighbours: split the image by indices, not by tiles")
    run = family_run(
        image.integrand, camera.width * camera.height, key, sampler, replicates, image.seen, workers, chunk, image.kept,
        part(indices, None if tiles is None else pixels_of(tiles, camera)), image.frame,
    )  # fmt: skip
    return family(run, positive("spp", spp), progress, checkpoint)


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
        return map(first.frame.shaped, estimates)
    image = Image.of(scene, camera, filter, tallies, bounces=bounces, **options)
    estimates = integrate_each_in_passes(
        image.integrand, camera.width * camera.height, n=positive("spp", spp), key=key, sampler=sampler,
        replicates=replicates, tallies=image.seen, progress=progress, workers=workers, chunk=chunk, kept=image.kept,
    )  # fmt: skip
    return map(image.frame.shaped, estimates)


class Image(NamedTuple):
    """A family of integrals that are the pixels of an image: what is integrated, and how samples become pixels.

    ``kept`` is the tally that pixels come from, ``seen`` the tallies of the samples, ``frame`` what shapes estimates.
    """

    integrand: Integrand
    kept: Any
    seen: Any
    frame: "Frame"

    @classmethod
    def of(cls, scene, camera, filter, tallies, **options) -> "Image":
        check_tallies(tallies)
        integrand, kept, seen = path_integrand(scene, camera, **options), Moments(order=2), tallies
        if filter is not None:
            integrand, kept, seen = on_film(integrand, filter, camera, tallies)
        shaped = tuple(name for name, tally in (tallies or {}).items() if isinstance(tally, Moments))
        return cls(integrand, kept, seen, Frame(camera.width, camera.height, filter and repr(filter), shaped))


@storable
@dataclasses.dataclass(frozen=True)
class Frame:
    """Gives estimates of the pixels, in the order of their numbers, the shape of an image.

    Attributes:
        width, height: in pixels.
        filter: in words, or None.
        tallies: the names of those with moments of every pixel.
    """

    width: int
    height: int
    filter: str | None
    tallies: tuple[str, ...]

    def shaped(self, estimate: Estimate, chosen=None) -> Estimate:
        """Return the estimate of an image, from that of its pixels or of a few ``chosen`` ones."""
        image = partial(self._shaped, chosen=chosen)
        tallies = {
            name: list(map(image, result)) if name in self.tallies else result
            for name, result in estimate.tallies.items()
        }
        moments, between = list(map(image, estimate.moments)), estimate.between and list(map(image, estimate.between))
        if self.filter is not None:
            recipe = estimate.recipe | {"filter": self.filter}
            estimate = dataclasses.replace(estimate, structure=jax.tree.structure(0), recipe=recipe, ratio=True)
        return dataclasses.replace(estimate, moments=moments, tallies=tallies, between=between)

    def _shaped(self, m: MomentsResult, chosen) -> MomentsResult:
        def image(x, elsewhere=np.nan):
            if chosen is not None:
                whole = np.full((self.width * self.height, *x.shape[1:]), elsewhere)
                whole[chosen] = x
                x = whole
            x = x.reshape(self.height, self.width, -1)
            return np.broadcast_to(x, (*x.shape[:2], 3))

        return MomentsResult(image(m.n, 0.0), image(m.mean), [image(c) for c in m.central], m.nonfinite)


def pixels_of(tiles, camera: Camera) -> np.ndarray:
    """Return the numbers of the pixels in a list of rectangles (left, top, width, height), increasing."""
    numbers = np.arange(camera.width * camera.height).reshape(camera.height, camera.width)
    taken = np.zeros(numbers.shape, bool)
    tiles = list(tiles) if isinstance(tiles, list | tuple) else []
    for tile in tiles:
        whole = isinstance(tile, list | tuple) and len(tile) == 4 and all(is_count(x, least=0) for x in tile)
        if not whole or not (0 < tile[2] <= camera.width - tile[0] and 0 < tile[3] <= camera.height - tile[1]):
            raise ValueError(
                f"a tile is (left, top, width, height) in the {camera.width} x {camera.height} pixels of the image, "
                f"got {tile!r}"
            )
        left, top, width, height = tile
        inside = taken[top : top + height, left : left + width]
        if inside.any():
            raise ValueError(f"tiles must not overlap, but {tile!r} covers pixels of another; leave one out")
        inside[...] = True
    if not tiles:
        raise ValueError("tiles must be a list of rectangles (left, top, width, height), got none")
    return numbers[taken]
