"""Derivatives of images: pixel by pixel, or of one number made of all pixels."""

import dataclasses
from collections.abc import Callable
from typing import Any, Unpack

import jax.numpy as jnp
import numpy as np

from ..integration.counts import positive
from ..integration.driver import integrate, integrate_each
from ..integration.moments import Moments, MomentsResult
from ..integration.samplers import Independent
from ..transport.vec import Vec3
from .derivative import Gradient, as_params, boundary_key, derivatives
from .options import MovingOptions
from .paths import moving_film
from .receivers import OnFilm, WeightedFilm


def render_grad(
    make: Callable, params, *, spp, boundary_spp=None, bounces=5, adjoint=None, mode="auto", key=0,
    sampler=Independent(), replicates=None, progress=None, workers=None, chunk=None, **options: Unpack[MovingOptions],
) -> Gradient:  # fmt: skip
    """Estimate the derivative of an image, moving silhouettes and shadows included.

    Without ``adjoint`` the result holds an image for each number in ``params``: the derivative of every pixel, in
    forward mode. With it, it is the derivative of the sum of ``adjoint`` times the image over pixels and channels, like
    ``params``: what an optimiser wants, where ``adjoint`` is the derivative of its loss by the image. Make that from
    another render than one that shares samples with this, or the product is biased.

    Args:
        make: a function of ``params`` that returns (scene, camera); it is traced. Pass the same function to run the
            same kernel.
        params: a pytree of numbers and arrays of floats.
        spp: samples for each pixel of the interior part.
        boundary_spp: samples for each pixel of the boundary part; ``spp`` by default.
        bounces, options: as in ``moving_paths``.
        adjoint: an array of shape (height, width, 3), or (height, width) for the same in all channels, or None.
        mode: as in ``grad_integrate``, where there is an ``adjoint``.
        key, sampler, replicates, progress, workers, chunk: as in ``render``.

    Returns:
        A ``Gradient``; without ``adjoint`` the leaves of its properties have shape ``(height, width, 3, *shape)`` with
        the shape of the parameter, in a grey scene ``(height, width, *shape)``.

    Raises:
        ValueError: an ``adjoint`` of another shape or not finite, and as ``moving_paths`` and ``grad_integrate``.
    """
    params, camera = as_params(params), make(params)[1]
    counts = positive("spp", spp), positive("boundary_spp", spp if boundary_spp is None else boundary_spp)
    pixels, keys = camera.width * camera.height, (key, boundary_key(key))
    run = {"sampler": sampler, "replicates": replicates, "progress": progress, "workers": workers, "chunk": chunk}
    film = _Film(make, OnFilm if adjoint is None else WeightedFilm, bounces, tuple(sorted(options.items())))

    def image(part, n, key):
        return _shaped(integrate_each(part, pixels, n=n, key=key, kept=Moments(order=4), **run), camera)

    def total(part, n, key):
        part = dataclasses.replace(part, params=(*part.params, weights))
        return integrate(part, n=n * pixels, key=key, **run)

    if adjoint is None:
        found = derivatives(film, params, "forward")
    else:
        found = derivatives(film, params, mode, together=True)
        weights = _weights(adjoint, camera, film(params).interior.params[0].channels)
    parts = (found.interior, found.boundary)
    estimate = image if adjoint is None else total
    estimates = [part and estimate(part, n, k) for part, n, k in zip(parts, counts, keys)]
    return Gradient(*estimates, found.flags)


@dataclasses.dataclass(frozen=True)
class _Film:
    """What a film receives, as a function of parameters."""

    make: Callable
    receiver: Any
    bounces: int
    options: tuple

    def __call__(self, params):
        return moving_film(self.receiver, *self.make(params), self.bounces, dict(self.options))


def _weights(adjoint, camera, channels):
    """Return an adjoint image as arrays of shape (height, width), one for each channel of the scene."""
    adjoint = np.asarray(adjoint, float)
    shape = camera.height, camera.width
    if adjoint.shape not in (shape, (*shape, 3)) or not np.all(np.isfinite(adjoint)):
        raise ValueError(
            f"adjoint must hold finite numbers in the shape {shape} or {(*shape, 3)} of the image, "
            f"got shape {adjoint.shape}"
        )
    if adjoint.ndim == 2:
        adjoint = np.repeat(adjoint[..., None], 3, axis=2)
    kind = jnp.result_type(float)
    if channels == 1:
        return adjoint.sum(2).astype(kind)
    return Vec3(*np.moveaxis(adjoint, 2, 0).astype(kind))


def _shaped(estimate, camera):
    """Return an estimate of pixels, in the order of their numbers, as one of an image of three channels."""

    def image(x):
        # A leaf has the pixels, then a colour where the scene has colours, then the shape of the parameter.
        return np.reshape(x, (camera.height, camera.width, *np.shape(x)[1:]))

    def shaped(m):
        return MomentsResult(image(m.n), image(m.mean), [image(c) for c in m.central], m.nonfinite)

    between = estimate.between and list(map(shaped, estimate.between))
    return dataclasses.replace(estimate, moments=list(map(shaped, estimate.moments)), between=between)
