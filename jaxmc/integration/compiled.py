"""A compiled estimate, without the driver: for loops that need many small integrals, and inside of other JAX code."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import backend
from .counts import positive
from .integrand import as_integrand
from .kernel import values_of_row
from .samplers import Independent, Index, seed_words

SHORT = 1024  # samples that still make a single row
MOST = 1 << 22


class MeanAndError(NamedTuple):
    """A mean and its standard error, JAX arrays in the shape or pytree of the value."""

    mean: Any
    stderr: Any


def estimator(f, *, dim=None, n, sampler=Independent(), replicates=None) -> Callable[..., MeanAndError]:
    """Return a compiled function ``(key, *params) -> (mean, stderr)`` that estimates the integral of ``f``.

    A call takes some 0.1 ms where ``integrate`` takes 1 ms, and it is a pure function of JAX: it may stand inside of
    ``jit``, ``vmap`` (over keys, or over parameters: many integrals at once) and ``grad``. It runs on one core, sums in
    the precision of the values, and does without tallies, progress and status: a value that is not finite shows in the
    mean. The points are those of ``integrate`` with the same key.

    Derivatives with respect to ``params`` are those of the samples: exact for the estimate; for the integral itself
    they hold where the integrand has no jumps that move with the parameters.

    Args:
        f: an ``Integrand``, or a function of one point of shape ``(dim,)``.
        dim: number of coordinates, for a plain function.
        n: number of samples in all, at most 2^22. ``Sobol`` and ``Lattice`` round it up.
        sampler: where the points lie.
        replicates: independent randomisations of the points, from which ``stderr`` comes. None: for ``Independent`` it
            comes from the variance of the samples; for others there is one randomisation and ``stderr`` is NaN.

    Returns:
        A function of a key, an integer or a ``jax.random`` key, and of parameters in place of ``f.params``.

    Raises:
        ValueError: n or replicates is not a positive integer, n is above 2^22, or ``dim`` is missing.
    """
    integrand = as_integrand(f, dim)
    replicates = None if replicates is None else positive("replicates", replicates)
    points = sampler.points(-(-positive("n", n) // (replicates or 1)))
    if points * (replicates or 1) > MOST:
        raise ValueError(f"a compiled estimate takes at most {MOST} samples, got n={n}; use integrate for more")
    fixed = jax.tree.map(jnp.asarray, (integrand, sampler.tables(points, integrand.dim)))
    leaves, structure = jax.tree.flatten(fixed)

    inside = any(isinstance(x, jax.core.Tracer) for x in leaves)

    def run(leaves, seed):
        return _estimate(*jax.tree.unflatten(structure, leaves), seed, sampler, points, replicates)

    compiled = jax.jit(run, compiler_options=backend.KERNEL_OPTIONS)

    def estimate(key, *params):
        given = jax.tree.leaves((_with_params(fixed[0], params), fixed[1])) if params else leaves
        seed = seed_words(key)
        # Compiler options cannot be set inside of another compiled function.
        traced = inside or any(isinstance(x, jax.core.Tracer) for x in (seed, *jax.tree.leaves(params)))
        return (run if traced else compiled)(given, seed)

    return estimate


def _with_params(integrand, params):
    leaves, structure = jax.tree.flatten(params)
    if structure != jax.tree.structure(integrand.params):
        raise ValueError(f"params must be like f.params, {jax.tree.structure(integrand.params)}, got {structure}")
    return jax.tree.unflatten(jax.tree.structure(integrand), leaves)


def _estimate(integrand, tables, seed, sampler, points, replicates):
    count = replicates or 1
    lanes = points if points <= SHORT else backend.widths().lanes
    together = min(count, max(1, SHORT // lanes))  # replicates that share a row
    first, start = np.arange(0, count, together, np.uint32), np.arange(0, points, lanes, np.uint32)
    size = np.minimum(points - start.astype(int), lanes)

    def values_at(low, high):
        index, axes = Index(high, low), Index(None, 0)
        if sampler.independent:
            index, axes = Index(jnp.broadcast_to(high, low.shape), low), Index(0, 0)
        return values_of_row(integrand, lambda i: sampler.point(seed, i, *tables), index, axes, ())

    @jax.checkpoint
    def row(job):
        """Return mean and mean squared deviation of a row of samples, for each of its replicates."""
        low = job[1] + jnp.arange(lanes, dtype=jnp.uint32)
        values = jax.vmap(partial(values_at, low))(job[0] + jnp.arange(together, dtype=jnp.uint32))
        means = jax.tree.map(partial(_mean, low < points), values)
        deviations = jax.tree.map(lambda x, m: (x - m[:, None]) ** 2, values, means)
        return means, jax.tree.map(partial(_mean, low < points), deviations)

    jobs = np.repeat(first, len(start)), np.tile(start, len(first))
    means, squares = lax.map(row, jobs)

    def by_replicate(x):
        x = jnp.moveaxis(x.reshape(len(first), len(start), together, *x.shape[2:]), 1, 2)
        return x.reshape(-1, *x.shape[2:])[:count]

    means, squares = jax.tree.map(by_replicate, (means, squares))
    of_replicates = jax.tree.map(partial(_weighted, size / points), means)
    mean = jax.tree.map(lambda m: m.mean(0), of_replicates)
    if replicates is None and sampler.independent:
        within = jax.tree.map(lambda s, m, all: _weighted(size / points, s + (m - all) ** 2)[0], squares, means, mean)
        return MeanAndError(mean, jax.tree.map(lambda v: jnp.sqrt(v / (points - 1.0)), within))
    return MeanAndError(mean, jax.tree.map(lambda m: m.std(0, ddof=1) / np.sqrt(count), of_replicates))


def _mean(valid, x):
    """Return the mean over axis 1, where ``valid``."""
    valid = valid.reshape(-1, *(1,) * (x.ndim - 2))
    return jnp.where(valid, x, 0.0).sum(1) / valid.sum()


def _weighted(weights, x):
    """Return the weighted sum over axis 1."""
    return jnp.tensordot(x * 1.0, jnp.asarray(weights, x.dtype), ((1,), (0,)))
