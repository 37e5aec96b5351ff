"""The amount of a regularization that makes the least squared error of an image, by its derivative."""

from typing import NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.compiled import estimator
from ..integration.counts import positive
from ..integration.integrand import Integrand
from .camera import Camera
from .integrands import path_integrand
from .materials import luminance
from .regularize import Regularize
from .scene import Scene
from .strategy import PathOptions

SMOOTH = {"opsr": (0.0, 1.0), "max_prev": (0.01, 1.0)}  # rules whose derivatives are right, and where to search


class Tuned(NamedTuple):
    """The best ``amount`` for N samples per pixel; there the ``error``, its parts ``squared_bias`` and ``variance`` of
    one sample, means over pixels; and ``tried``, rows of (amount, error, derivative of the error)."""

    amount: float
    error: float
    squared_bias: float
    variance: float
    tried: np.ndarray


def tune_regularization(
    scene: Scene, camera: Camera, reference, *, N, bounces, rule="opsr", n=1024, key=0, steps=7,
    **options: Unpack[PathOptions],
) -> Tuned:  # fmt: skip
    """Return the amount of a rule with the least mean squared error of a pixel of ``N`` samples: bias^2 + variance / N.

    Bisects the derivative of that error with respect to the amount, which ``jax.grad`` takes of ``n`` samples in each
    pixel, in two independent halves: the square of the bias is the product of one half's with the other's, which is
    unbiased, and so is its derivative. All steps use the same points. Errors are of luminance. A camera of few pixels
    with the same view will do.

    Args:
        reference: luminance of the image without regularization, shape (height, width). Its own noise adds its variance
            to ``error`` and ``squared_bias``, and does not move the best amount.
        N: samples per pixel that the amount is meant for.
        rule: "opsr" or "max_prev"; the derivative of the others is not that of the integral.
        n: samples per pixel that the error is estimated from.
        steps: bisections.

    Raises:
        ValueError: another rule, or a reference of another shape.
    """
    if rule not in SMOOTH:
        raise ValueError(f"rule must be one of {', '.join(SMOOTH)}, whose derivatives are smooth, got {rule!r}")
    truth = np.asarray(reference, float)
    if truth.shape != (camera.height, camera.width):
        raise ValueError(f"reference must have shape {(camera.height, camera.width)}, got {truth.shape}")
    N, half = positive("N", N), positive("n", n) // 2
    path = path_integrand(scene, camera, bounces=bounces, regularize=Regularize(rule), **options).map(_with_square)
    error = jax.jit(jax.value_and_grad(_error_of(path, half, truth.ravel(), N, key), has_aux=True))
    low, high = SMOOTH[rule]
    tried, parts = [], {}
    for _ in range(steps):
        middle = 0.5 * (low + high)
        (value, parts[middle]), slope = error(middle)
        tried.append((middle, float(value), float(slope)))
        low, high = (low, middle) if slope > 0.0 else (middle, high)
    best = min(tried, key=lambda row: abs(row[2]))
    bias, variance = map(float, parts[best[0]])
    return Tuned(best[0], best[1], bias, variance, np.array(tried))


def _with_square(value):
    y = luminance(value)
    return jnp.stack([y, y * y])


def _error_of(path, half, truth, N, key):
    """Return the error as a function of the amount, with its two parts."""
    pixels = np.arange(len(truth), dtype=np.uint32)
    keys = jax.vmap(lambda k: jax.random.key_data(jax.random.fold_in(jax.random.key(key), k)))(
        np.arange(2 * len(truth))
    ).reshape(2, len(truth), -1)
    scene, *rest = path.params
    run = estimator(Integrand(path.fn, path.dim, (*path.params, pixels[0]), lazy=True), n=half)
    leaves, structure = jax.tree.flatten(scene)
    blur = next(k for k, leaf in enumerate(leaves) if leaf is scene.blur)

    def error(amount):
        blurred = jax.tree.unflatten(structure, [*leaves[:blur], amount, *leaves[blur + 1 :]])
        each = jax.vmap(lambda key, pixel: run(key, blurred, *rest, pixel).mean, (0, 0))
        first, second = (each(k, pixels) for k in keys)
        squared_bias = ((first[:, 0] - truth) * (second[:, 0] - truth)).mean()
        variance = sum((m[:, 1] - m[:, 0] ** 2).mean() for m in (first, second)) * 0.5 * half / (half - 1.0)
        return squared_bias + variance / N, (squared_bias, variance)

    return error
