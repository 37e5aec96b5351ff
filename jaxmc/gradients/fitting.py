"""Parameters of a scene from an image of it: the squared error of renders, descended with noisy gradients.

The square of a noisy residual is no estimate of the squared residual, nor is its derivative one of the derivative: the
noise adds to both. Here the loss has the variance subtracted, and its gradient multiplies residuals and derivatives
that come from independent renders.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.counts import positive
from ..integration.estimate import Estimate
from ..integration.samplers import seed_words
from ..integration.work import Progress
from ..transport.images import render
from .derivative import as_params
from .images import render_grad

STEP = 0.05  # the first step of the default optimiser, in units of each parameter
MEMORY = 0.95  # of its second moments: gradients shrink by orders of magnitude within a few dozen steps


@dataclasses.dataclass(frozen=True)
class Fit:
    """What a fit has found, and the way there.

    Attributes:
        params: the parameters at the end, a pytree like those at the start.
        trace: all parameters, the first ones included: a pytree like ``params`` with a leading axis of steps + 1.
        loss: of each of them, shape (steps + 1,). Unbiased, so near the minimum it may be negative.
        loss_stderr: its standard errors.
        status: "complete", or "non-finite values seen": then the fit has stopped there.
        flags: what the derivatives may lack, see ``Gradient``.
    """

    params: Any
    trace: Any
    loss: np.ndarray
    loss_stderr: np.ndarray
    status: str
    flags: tuple[str, ...] = ()

    def __str__(self):
        first, last = (f"{self.loss[i]:.4g} +- {self.loss_stderr[i]:.1g}" for i in (0, -1))
        lines = [f"loss {first} at the start, {last} after {len(self.loss) - 1} steps   {self.status}"]
        lines += [f"{jax.tree_util.keystr(path)} {x}" for path, x in jax.tree_util.tree_leaves_with_path(self.params)]
        return "\n".join([*lines, *(f"not covered: {flag}" for flag in self.flags)])


def fit(
    make: Callable, target, params, *, steps, spp, optimizer=None, weights=None, bounds=None, boundary_spp=None, key=0,
    gradient: Callable = render_grad, progress=None, **options,
) -> Fit:  # fmt: skip
    """Find the parameters of a scene whose image is ``target``, by stochastic gradient descent.

    The loss is the mean over pixels and channels of ``weights * (image - target)**2``, of the image without noise. Each
    step renders twice, with keys that no other step has: one image for the residual, and one derivative, weighted by
    that residual. From the same samples the two would be correlated, and the fit would end where the noise is small
    rather than where the image is right. The loss has the variance of its image subtracted. So both are unbiased for
    any ``spp``, and a few samples for each pixel are enough: steps average the noise.

    Steps that do not shrink leave the parameters to wander about the minimum; those of the default optimiser shrink to
    0. How far off the parameters are is seen from fits with other keys. A squared error has more than one minimum, as
    where shadows do not overlap: start from several places and compare the losses, whose errors say which differ.

    Args:
        make: a function of parameters that returns (scene, camera), as for ``mc.render_grad``.
        target: an image of shape (height, width) or (height, width, 3), or an ``Estimate`` of one, whose own variance
            is subtracted from the loss too.
        params: where to start: a pytree of numbers and arrays of floats. A scene in which two numbers of one kind are
            exactly equal has a kernel of its own, so start with numbers that nothing else has.
        steps: how many to take.
        spp: samples for each pixel of each render, at least 2.
        optimizer: a gradient transformation of optax; by default Adam with b2 = 0.95 and steps that fall from 0.05
            to 0 by a cosine. It steps about equally far in all parameters: let them have sizes near 1.
        weights: of the squared errors, at least 0: a number or an array that broadcasts to (height, width, 3); 0 leaves
            a pixel out. By default ``1 / (target**2 + mean(target)**2)``: errors are relative ones, but for dark
            pixels, whose slopes would drown all others. They must not depend on the noise of a render: with a noisy
            target, give weights that do not come from it.
        bounds: as ``params``, with (lowest, highest) or None for each of its leaves, and either of the two may be None:
            after each step parameters are moved back into them.
        boundary_spp: samples of the derivative's boundary part; as ``mc.render_grad``.
        key: seed, an integer in [0, 2^64) or a ``jax.random`` key.
        gradient: what estimates derivatives, called as ``mc.render_grad(make, params, adjoint=..., spp=...,
            boundary_spp=..., key=..., **options)``.
        progress: as in ``mc.integrate``, of the samples of all renders.
        options: as in ``mc.render`` and ``mc.render_grad``, such as ``bounces``.

    Raises:
        ImportError: optax is not installed: ``pip install "jaxmc[optimize]"``.
        ValueError: a number of steps or samples out of range, a target that does not fit the camera or is not finite,
            weights below 0, bounds that leave nothing or exclude the start, or what rendering refuses.
    """
    optax = _optax()
    steps, spp = positive("steps", steps), positive("spp", spp)
    if spp < 2:
        raise ValueError(f"spp must be at least 2, since one sample tells no variance, got {spp}")
    params = as_params(params)
    _, camera = make(params)
    goal = _target(target, weights, camera)
    limits = _limits(bounds, params)
    if optimizer is None:
        optimizer = optax.adam(optax.cosine_decay_schedule(STEP, steps), b2=MEMORY)
    state, trace, errors, flags, status = optimizer.init(params), [params], [], (), "complete"

    def error(step):
        scene, camera = make(params)
        return squared_error(render(scene, camera, spp=spp, key=_key(key, step, 0), **options), *goal)

    with Progress(progress, (steps + 1) * spp * camera.width * camera.height) as bar:
        for step in range(steps + 1):
            errors.append(error(step))
            bar.update(spp * camera.width * camera.height)
            if step == steps or not np.isfinite(errors[-1].mean):
                break
            how = {"spp": spp, "boundary_spp": boundary_spp, "key": _key(key, step, 1), **options}
            found = gradient(make, params, adjoint=errors[-1].adjoint, **how)
            flags = found.flags
            slopes = jax.tree.map(lambda p, g: jnp.asarray(g, p.dtype).reshape(p.shape), params, found.mean)
            if not all(bool(jnp.all(jnp.isfinite(g))) for g in jax.tree.leaves(slopes)):
                break
            updates, state = optimizer.update(slopes, state, params)
            params = _within(limits, optax.apply_updates(params, updates))
            trace.append(params)
    if len(errors) <= steps or not np.isfinite(errors[-1].mean):
        status = "non-finite values seen"
    stacked = jax.tree.map(lambda *x: np.stack(x), *trace)
    loss, stderr = (np.array([e[k] for e in errors]) for k in (0, 1))
    return Fit(params, stacked, loss, stderr, status, flags)


class SquaredError(NamedTuple):
    """The weighted squared error of an image: an unbiased estimate, its standard error, and the derivative of the
    error with respect to the image.
    """

    mean: float
    stderr: float
    adjoint: np.ndarray


def squared_error(image: Estimate, target, weights, target_variance=0.0) -> SquaredError:
    """Estimate the mean of ``weights * (expected image - target)**2`` over pixels and channels.

    Per pixel, of n samples x: the mean of (x_i - t) (x_j - t) over all pairs of different samples, which is the square
    of mean - t, less the variance of the mean. With V for that variance and d for the expected mean - t, the variance
    of this U-statistic (Hoeffding 1948) is 4 d^2 V + 2 V^2 n / (n - 1). Pixels are independent; channels count as fully
    correlated. So the error is too large where they are not, and mostly where few samples come from a heavy tail, whose
    V^2 is estimated too large. The noise of a target, the same for all images, is no part of it.

    Args:
        image: a render of at least 2 samples for each pixel.
        target, weights, target_variance: arrays that broadcast to its shape, (height, width, 3).
    """
    mean, variance = np.asarray(image.mean), np.asarray(image.stderr) ** 2
    n = image.recipe["replicates"] if image.between is not None else image.n
    weights = np.broadcast_to(weights, mean.shape)
    off = mean - target
    squares = off**2 - variance
    through_offset = np.maximum(np.sum(weights**2 * 4.0 * squares * variance, (0, 1)), 0.0)
    alone = np.sum(weights**2 * 2.0 * variance**2 * n / (n - 1), (0, 1))
    error = np.sum(np.sqrt(through_offset + alone)) / mean.size
    loss = np.mean(weights * (squares - target_variance))
    return SquaredError(float(loss), float(error), 2.0 * weights * off / mean.size)


def _optax():
    try:
        import optax
    except ImportError as error:
        raise ImportError('mc.fit needs optax: pip install "jaxmc[optimize]", or pip install optax') from error
    return optax


def _key(key, step, part) -> int:
    """Return the seed of one of the two renders of a step."""
    words = [int(word) for word in seed_words(key)]
    return int(np.random.SeedSequence([*words, step, part]).generate_state(1, np.uint64)[0])


def _target(target, weights, camera):
    """Return the target, the weights and the target's variance."""
    shape = camera.height, camera.width, 3
    variance = np.asarray(target.stderr) ** 2 if isinstance(target, Estimate) else np.zeros(())
    values = np.asarray(target.mean if isinstance(target, Estimate) else target, float)
    if values.shape not in (shape, shape[:2]) or not np.all(np.isfinite(values)):
        raise ValueError(
            f"target must be an image of finite numbers, of shape {shape} or {shape[:2]} as the camera's, "
            f"got {'one that has others' if values.shape in (shape, shape[:2]) else f'shape {values.shape}'}"
        )
    values = values[..., None] if values.ndim == 2 else values
    if weights is None:
        weights = 1.0 / np.maximum(values**2 + values.mean() ** 2, np.finfo(float).tiny)
    weights = np.asarray(weights, float)
    weights = weights[..., None] if weights.shape == shape[:2] else weights
    fits = all(a in (1, b) for a, b in zip(weights.shape[::-1], shape[::-1])) and weights.ndim <= 3
    if not fits or not np.all((weights >= 0.0) & np.isfinite(weights)):
        raise ValueError(f"weights must be at least 0, finite, and broadcast to {shape}, got {weights!r}")
    return values, weights, variance


def _limits(bounds, params):
    """Return (lowest, highest) or None for each leaf of the parameters."""
    leaves, structure = jax.tree.flatten(params)
    try:
        limits = [None] * len(leaves) if bounds is None else structure.flatten_up_to(bounds)
    except ValueError as error:
        raise ValueError(f"bounds must have (lowest, highest) for each leaf of the parameters: {error}") from error
    for leaf, limit in zip(leaves, limits):
        if limit is None:
            continue
        fits = isinstance(limit, tuple | list) and len(limit) == 2
        if not fits or not jnp.all(jnp.clip(leaf, *limit) == leaf):
            raise ValueError(f"bounds must be (lowest, highest) with the start between them, got {limit!r} for {leaf}")
    return limits


def _within(limits, params):
    leaves, structure = jax.tree.flatten(params)
    moved = [x if limit is None else jnp.clip(x, *limit) for x, limit in zip(leaves, limits)]
    return jax.tree.unflatten(structure, moved)
