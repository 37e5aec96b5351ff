"""Control variates: what is known of other integrals, subtracted, so that less is left to estimate.

What is fitted comes from a pilot with samples of its own, so what is returned is an ordinary integrand with fixed
numbers in it: unbiased for whatever key it is integrated with.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .draw import draw
from .integrand import Integrand
from .samplers import pilot_key


class Controlled(NamedTuple):
    """An ``integrand`` less its control variates, their ``coefficients`` of shape ``(*value, k)``, and the variance of
    one sample of it relative to the original, of the value's shape, as the pilot predicts it.
    """

    integrand: Integrand
    coefficients: np.ndarray
    variance_ratio: Any


def control_variates(f: Integrand, controls, means, *, n=2**14, key=0) -> Controlled:
    """Return ``f(u) - coefficients . (controls(u) - means)``, whose integral is that of ``f``.

    The coefficients that minimise the variance are those of a linear regression of f on the controls; what remains is
    1 - R^2 of it (Owen, Monte Carlo theory, methods and examples, 2013, chapter 8). They are fitted in float64 to a
    pilot of ``n`` samples, with a key of its own that is derived from ``key``: fitted to the samples that are then
    averaged they would bias the result. A control that does not vary gets 0; of controls that are the same up to
    rounding each gets a share. Gradients with respect to ``f.params`` flow, with the coefficients held; call this
    function itself outside of ``jit`` and ``grad``.

    Args:
        f: the integrand; its value is a number or an array.
        controls: a function of the same u, or an ``Integrand`` of it: values of shape ``(k,)``, or a number.
        means: the known integrals of the controls, shape ``(k,)``. An error in them is an error in the result.
        n: number of pilot samples.
        key: seed of the pilot: any seed, also that of the run to come.

    Raises:
        ValueError: ``f`` is no ``Integrand``, the shapes of ``controls`` and ``means`` differ, or the pilot is too
            short or has values that are not finite.
    """
    if not isinstance(f, Integrand):
        raise ValueError(f"f must be an Integrand, got {f!r}; wrap a function of u: mc.Integrand(f, dim)")
    c = controls if isinstance(controls, Integrand) else Integrand(controls, f.dim)
    if c.dim != f.dim:
        raise ValueError(f"controls must take the same point as f, with dim={f.dim}, got dim={c.dim}; change its dim")
    u = coordinates(f.dim)
    shape, k = value_shape("f", f, u), int(np.prod(value_shape("controls", c, u)))
    means = np.asarray(means, np.float64).ravel()
    if means.shape != (k,) or not np.isfinite(means).all():
        raise ValueError(f"means must hold the {k} known integrals of the controls, all finite, got {means.tolist()}")
    if n < k + 2:
        raise ValueError(f"a pilot of n={n} samples cannot fit {k} coefficients; take at least {k + 2}, better 100 {k}")
    both = dataclasses.replace(f, fn=_Both(f.fn, c.fn), params=(f.params, c.params), lazy=f.lazy and c.lazy)
    y, x = (np.asarray(values, np.float64).reshape(n, -1) for values in draw(both, n=n, key=pilot_key(key)).value)
    beta, ratio = _regress_on_controls(x, y)
    beta = beta.T.reshape(*shape, k)
    fixed = dataclasses.replace(both, fn=_Less(f.fn, c.fn), params=(*both.params, beta, means))
    return Controlled(fixed, beta, ratio.reshape(shape)[()])


@dataclasses.dataclass(frozen=True)
class _Both:
    f: Callable[..., Any]
    controls: Callable[..., Any]

    def __call__(self, u, params, control_params):
        return self.f(u, *params), self.controls(u, *control_params)


@dataclasses.dataclass(frozen=True)
class _Less:
    f: Callable[..., Any]
    controls: Callable[..., Any]

    def __call__(self, u, params, control_params, coefficients, means):
        excess = jnp.ravel(self.controls(u, *control_params)) - means
        return self.f(u, *params) - (coefficients * excess).sum(-1)


def _regress_on_controls(x, y):
    """Return coefficients (k, m) and 1 - R^2 (m,), adjusted for the number fitted, of x (n, k) and y (n, m)."""
    rounding = 16.0 * _epsilon() * np.abs(x).max(0)
    x, y = x - x.mean(0), y - y.mean(0)
    x[:, x.std(0) <= rounding] = 0.0
    beta = least_squares(x, y)
    n, k = x.shape
    before, after = (y**2).sum(0) / (n - 1), ((y - x @ beta) ** 2).sum(0) / (n - k - 1)
    return beta, np.divide(after, before, out=np.ones_like(before), where=before > 0.0)


def least_squares(x, y):
    """Return the coefficients (k, m) that minimise |y - x coefficients|, the shortest where many do, in float64."""
    bad = np.count_nonzero(~np.isfinite(x)) + np.count_nonzero(~np.isfinite(y))
    if bad:
        raise ValueError(f"the pilot has {bad} values that are not finite, expected none; mend the integrand first")
    size = np.sqrt((x**2).mean(0))
    size[size == 0.0] = 1.0
    return np.linalg.lstsq(x / size, y, rcond=10.0 * _epsilon())[0] / size[:, None]


def _epsilon():
    return float(jnp.finfo(jnp.result_type(float)).eps)  # of the samples


def coordinates(dim):
    """Return the abstract point of ``dim`` coordinates that ``value_shape`` takes."""
    return jax.ShapeDtypeStruct((dim,), jnp.result_type(float))


def value_shape(name, function, *args):
    """Return the shape of a function's value, or raise ``ValueError`` where that is neither a number nor an array."""
    value = jax.eval_shape(function, *args)
    if not isinstance(value, jax.ShapeDtypeStruct):
        raise ValueError(f"{name} must return a number or an array, got {value}; stack its parts with jnp.stack")
    return value.shape
