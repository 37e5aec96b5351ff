"""Cures of fireflies: each says what it renders, what it keeps of the samples, and how these become an image.

A cure is a ``Cure``; the list of them is ``standard_cures``, and one of your own goes beside them:

    mine = Cure("median of 5 means", Buckets(5), of_whole(lambda kept: light(median_of_means(kept.whole))))
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..analysis.clamped_means import cross_fitted_image, pool_residual
from ..analysis.reweighting import reject_sparse, resolve_cascade
from ..analysis.robust import catoni_mean, gini_median_of_means, median_of_means, trimmed_mean, winsorised_mean
from ..integration.buckets import Buckets
from ..integration.debias import debias
from ..integration.driver import integrate_each
from ..integration.layers import Cascade, Layers
from ..integration.moments import Moments
from ..integration.tallies import ClampLadder
from ..transport.clamps import Clamp, ClampLevels
from ..transport.images import render, render_progressively
from ..transport.integrands import path_integrand
from ..transport.materials import luminance
from ..transport.regularize import Regularize, Shrinking
from ..transport.tuning import tune_regularization
from ..transport.views import resized
from .merging import merged

CLAMP, INDIRECT = 3.0, 10.0  # in units of display white: the clamp of Pharr's chapter, and Blender's default
LADDER = tuple(np.geomspace(0.25, 512.0, 23).tolist())
BINS = (0.0, *(2.0**j for j in range(-4, 10)))
CUT = 1.0 / 16.0  # of the samples, that trimmed and winsorised means cut off or down at most
TILE = 8  # pixels over which clamped light is handed back
LEVELS = (3.0, 30.0)  # of debias, in units of display white
TUNED_FOR = 128  # samples per pixel
SHRINKING = Shrinking(0.2)


class Kept(NamedTuple):
    """What a tally kept of an image's samples: its results for ``halves`` of them, or for all as one; and the number of
    pixels in a row.
    """

    halves: tuple[Any, ...]
    width: int

    @property
    def whole(self):
        """What the tally keeps of all samples together."""
        return merged(self.halves)


class Cure(NamedTuple):
    """A way to make an image out of paths.

    Attributes:
        name: what tables and figures call it.
        tally: what is kept of the samples: ``Moments`` (of order 2, of one number for each sample), ``ClampLadder``,
            ``Buckets``, ``Cascade`` or ``Layers``.
        image: a function of what was ``Kept`` that returns luminances, one for each pixel, row by row.
        render: renders as ``mc.render`` does. Cures of one ``render`` share their samples; those of ``mc.render``
            itself, the plain samples, get these in two halves.
        averages: the image is the mean of independent samples, whose variance the tally knows; so its squared error for
            any number N of them is bias^2 + variance / N.
    """

    name: str
    tally: Any
    image: Callable[[Kept], np.ndarray]
    render: Callable[..., Any] = render
    averages: bool = False


def light(image) -> np.ndarray:
    """Return the luminance of pixels row by row, shape (pixels,) or (pixels, 3)."""
    return luminance(image) if np.ndim(image) == 2 else image


def numbers(image) -> np.ndarray:
    """Return one number for each pixel row by row from those of a ``Moments`` tally, whose image has three channels."""
    image = np.asarray(image)
    return (image[..., 0] if image.ndim == 3 else image).ravel()


def mean(kept: Kept) -> np.ndarray:
    """Return the mean of the samples."""
    return numbers(kept.whole.mean)


def average(name, of=luminance, render=render) -> Cure:
    """Return the cure that averages a number of each sample, such as its luminance after clamping."""
    return Cure(name, Moments(of, order=2), mean, render, averages=True)


@dataclasses.dataclass(frozen=True)
class Clamped:
    """The luminance of a sample that is clamped at ``limit`` in luminance, or channel by channel."""

    limit: float
    by_channel: bool = False

    def __call__(self, value):
        if self.by_channel:
            return luminance(jnp.minimum(value, self.limit))
        return jnp.minimum(luminance(value), self.limit)


def cross_fitted(kept: Kept) -> np.ndarray:
    """Return the image of each half clamped at the threshold that is best for the other."""
    return cross_fitted_image(*kept.halves).mean


def pooled_residual(kept: Kept, tile: int = TILE) -> np.ndarray:
    """Return the image of ``cross_fitted`` with what it took away handed back to tiles of pixels."""
    found = cross_fitted_image(*kept.halves)
    images = [pool_residual(h, t, width=kept.width, tile=tile) for h, t in zip(kept.halves, found.thresholds)]
    sizes = [h.n for h in kept.halves]
    return np.average([image.ravel() for image in images], 0, sizes)


def _catoni(kept):
    return catoni_mean(kept.whole)


def _cut(kept, cut):
    return cut(kept.whole, CUT).mean


def _medians(kept, of):
    return light(of(kept.whole))


def _cascade(kept, rule):
    return light(resolve_cascade(kept.whole, rule=rule, width=kept.width))


def _dense(kept):
    return light(reject_sparse(kept.whole, width=kept.width).mean)


def plain_cures(white: float = 1.0) -> tuple[Cure, ...]:
    """Return the cures that take the samples of ``mc.render`` as they are; ``white`` is the radiance shown as white."""
    limit, brightness = CLAMP * white, {"of": luminance}
    ladder = ClampLadder(tuple(t * white for t in LADDER), luminance)
    cascade, bins = Cascade(start=white, **brightness), Layers(tuple(t * white for t in BINS), **brightness)
    dense = Layers(tuple(float(np.expm1(j)) * white for j in range(12)), **brightness)
    return (
        average("none"),
        average(f"clamp {limit:g}", Clamped(limit)),
        average(f"clamp {limit:g} by channel", Clamped(limit, by_channel=True)),
        Cure("clamp t*(N), cross-fitted", ladder, cross_fitted),
        Cure("the same, excess pooled", ladder, pooled_residual),
        Cure("median of means", Buckets(), partial(_medians, of=median_of_means)),
        Cure("Gini-adaptive means", Buckets(), partial(_medians, of=gini_median_of_means)),
        Cure("Catoni's mean", bins, _catoni),
        Cure("trimmed mean", bins, partial(_cut, cut=trimmed_mean)),
        Cure("winsorised mean", bins, partial(_cut, cut=winsorised_mean)),
        Cure("cascade, paper's rule", cascade, partial(_cascade, rule="paper")),
        Cure("cascade, viewer's rule", cascade, partial(_cascade, rule="glsl2020")),
        Cure("density rejection", dense, _dense),
    )


def path_cures(white: float = 1.0) -> tuple[Cure, ...]:
    """Return the cures inside of paths that every scene can have: a limit on indirect light, and none in the mean."""
    indirect = partial(render, clamp=Clamp(indirect=INDIRECT * white, norm="sum"))
    levels = partial(render_debiased, levels=ClampLevels(tuple(t * white for t in LEVELS)))
    return (
        average(f"indirect clamp {INDIRECT * white:g} (Cycles)", render=indirect),
        average("debias over clamps", render=levels),
    )


def blur_cures(mirrors: bool = True, opsr: float = 0.1) -> tuple[Cure, ...]:
    """Return path regularizations; ``mirrors``: whether there are any, or rough metals only. ``opsr``: its amount."""
    rules = {
        "regularized, pbrt": Regularize("pbrt"),
        "regularized, max_prev 0.3": Regularize("max_prev", 0.3),
        f"regularized, gamma {opsr:.3f}": Regularize("opsr", opsr),
    }
    if mirrors:
        rules["regularized, cone 0.1"] = Regularize("cone", 0.1)
    cures = [average(name, render=partial(render, regularize=rule)) for name, rule in rules.items()]
    if mirrors:
        shrinking = partial(render_last, regularize=Regularize("cone", SHRINKING))
        cures.append(Cure("regularized, shrinking cone", Moments(luminance, order=2), mean, shrinking))
    return tuple(cures)


def standard_cures(scene, camera, *, white: float = 1.0, key=0, tune: bool = True, **paths) -> tuple[Cure, ...]:
    """Return all cures for a scene, the gamma of one of them tuned to it.

    Args:
        white: the radiance that is shown as white; limits and layers are in units of it.
        key: seed of the tuning.
        tune: find the constant attenuation of roughness that has the least squared error for 128 samples per pixel, by
            its derivative in a small image; False takes 0.1. Cures that blur mirrors are left out where there are none.
        paths: as in ``path_integrand``.
    """
    blurs = ()
    if scene.mirrors or scene.rough:
        amount = tuned_gamma(scene, camera, key=key, **paths) if tune else 0.1
        blurs = blur_cures(bool(scene.mirrors), amount)
    return plain_cures(white) + path_cures(white) + blurs


def tuned_gamma(scene, camera, *, N=TUNED_FOR, key=0, pixels=384, n=512, **paths) -> float:
    """Return the amount of "opsr" with the least squared error for ``N`` samples, in an image of some 400 pixels."""
    width = max(1, round((pixels * camera.width / camera.height) ** 0.5))
    small = resized(camera, width, max(1, round(pixels / width)))
    reference = luminance(np.asarray(render(scene, small, spp=16 * n, key=key + 1, **paths).mean))
    return tune_regularization(scene, small, reference, N=N, n=n, key=int(key) % (1 << 32), **paths).amount


def render_debiased(scene, camera, *, spp, key, tallies, levels, progress=None, **paths):
    """Render with the unbiased sum over levels of clamping, cut off at random."""
    path = debias(path_integrand(scene, camera, **paths).map(levels))
    items = camera.width * camera.height
    return integrate_each(path, items, n=spp, key=key, tallies=tallies, progress=progress)


def render_last(scene, camera, **options):
    """Render in passes and return the last one: for amounts that shrink with the number of the sample."""
    *_, last = render_progressively(scene, camera, **options)
    return last
