"""Difference quotients with common random numbers beside a gradient: what ``gradcheck`` judges by."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..integration.counts import positive
from ..integration.driver import integrate
from ..integration.integrand import Integrand
from .derivative import as_parts, boundary_key, derivatives


class Data(NamedTuple):
    """Means of the gradient (J,), of the quotients (J, K) and of the value; moments of gradient less quotient (J, K),
    of neighbouring quotients' differences (J, K - 1); variance of the quotients, kurtosis of the gradient."""

    gradient: Any
    quotient: Any
    value: Any
    bias: Any
    bias_error: Any
    change: Any
    change_error: Any
    variance: Any
    kurtosis: Any
    freedom: float


@dataclasses.dataclass(frozen=True)
class _Compare:
    """One sample of the value, of its interior gradient, and of all difference quotients."""

    make: Callable
    derivative: Callable

    def __call__(self, u, params, ends, widths, *held):
        def value(params):
            return as_parts(self.make(params)).interior(u)

        upper, lower = jax.vmap(value)(ends).reshape(2, *widths.shape)
        quotient = (upper - lower) / widths
        gradient = jnp.concatenate([jnp.ravel(x) for x in jax.tree.leaves(self.derivative(u, params, *held))])
        return {
            "value": value(params),
            "gradient": gradient,
            "quotient": quotient,
            "bias": gradient[:, None] - quotient,
            "change": quotient[:, :-1] - quotient[:, 1:],
        }


def _ends(params, widths):
    """Return the parameters moved up, then down, by half of each of the widths (J, K): the leading axis of every leaf
    runs over all of them."""
    flat, unravel = ravel_pytree(params)
    moves = 0.5 * jnp.asarray(widths, float)[:, :, None] * jnp.eye(flat.size)[:, None]
    return jax.vmap(unravel)(jnp.concatenate([flat + moves, flat - moves]).reshape(-1, flat.size))


def from_integrand(make, params, scales, steps, n, boundary_n, key, options):
    """Return the data of what ``make(params)`` makes, and its flags."""
    inside = as_parts(make(params)).interior
    shape = jax.eval_shape(inside, jax.ShapeDtypeStruct((inside.dim,), jnp.result_type(float)))
    if getattr(shape, "shape", None) != ():
        raise ValueError(f"gradcheck wants an integrand of one number, this one is {shape}; map it to one component")
    interior, boundary, flags, _ = derivatives(make, params)
    widths = 2.0 * np.outer(scales, steps)
    arrays = params, _ends(params, widths), jnp.asarray(widths, float), *interior.params[1:]
    compare = Integrand(_Compare(make, interior.fn), interior.dim, arrays, interior.lazy, interior.labels)
    found = integrate(compare, n=n, key=key, **options)
    mean, error, variance = found.mean, found.stderr, found.variance
    gradient, bias, bias_error = mean["gradient"], mean["bias"], error["bias"]
    kurtosis = found._tree([m.kurtosis for m in found.moments])["gradient"]
    if boundary is not None:
        edges = integrate(boundary, n=boundary_n or n, key=boundary_key(key), **options)
        more, more_error = flat_of(edges.mean), flat_of(edges.stderr)
        gradient, bias = gradient + more, bias + more[:, None]
        bias_error = np.sqrt(bias_error**2 + more_error[:, None] ** 2)
        kurtosis = np.fmax(kurtosis, flat_of(edges._tree([m.kurtosis for m in edges.moments])))
    freedom = np.inf if found.between is None else found.recipe["replicates"] - 1.0
    return Data(
        gradient, mean["quotient"], abs(mean["value"]), bias, bias_error, mean["change"], error["change"],
        variance["quotient"], kurtosis, freedom,
    ), flags  # fmt: skip


def from_batches(f, gradient, params, scales, steps, n, batches, key):
    """Return the data of a function of (params, key, n) and of its gradient, from batches."""
    positive("batches", batches)
    unravel = ravel_pytree(params)[1]
    flat, keys = flat_of(params), np.random.SeedSequence(key).generate_state(batches, np.uint64).tolist()

    def shifted(j, h, k):
        x = flat.copy()
        x[j] += h
        return float(f(unravel(jnp.asarray(x, float)), k, n))

    gradients = np.array([flat_of(gradient(params, k, n)) for k in keys])
    quotients = np.array([
        [[(shifted(j, e * s, k) - shifted(j, -e * s, k)) / (2.0 * e * s) for e in steps] for j, s in enumerate(scales)]
        for k in keys
    ])  # fmt: skip
    bias, change = gradients[:, :, None] - quotients, -np.diff(quotients, axis=2)

    def error(x):
        return x.std(0, ddof=1) / np.sqrt(batches)

    spread = gradients.std(0)
    fourth = ((gradients - gradients.mean(0)) ** 4).mean(0)
    kurtosis = np.divide(fourth, spread**4, out=np.full(len(flat), np.nan), where=spread > 0.0)
    return Data(
        gradients.mean(0), quotients.mean(0), abs(float(f(params, keys[0], n))), bias.mean(0), error(bias),
        change.mean(0), error(change), quotients.var(0, ddof=1), kurtosis, batches - 1.0,
    )  # fmt: skip


def scales_of(params, scale):
    """Return the length that steps are relative to, for each number in ``params``."""
    if scale is None:
        scale = jax.tree.map(lambda x: np.abs(x).max() or 1.0, jax.tree.map(np.asarray, params))
    elif np.ndim(scale) == 0 and not isinstance(scale, dict):
        scale = jax.tree.map(lambda x: scale, params)
    sizes = flat_of(jax.tree.map(lambda x, s: np.broadcast_to(np.asarray(s, float), x.shape), params, scale))
    if not np.all(np.isfinite(sizes) & (sizes > 0.0)):
        raise ValueError(f"scale must be positive, got {scale!r}")
    return sizes


def flat_of(tree):
    return np.concatenate([np.ravel(np.asarray(x, np.float64)) for x in jax.tree.leaves(tree)])
