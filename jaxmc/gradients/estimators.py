"""Other estimators of a derivative, for comparison: through the draw, by the score, by differences, by blurring.

An integral over x of a value that depends on parameters is estimated from draws whose density may depend on them too.
A derivative can follow the draws as they move, or leave them where they are and weigh them by the score, which is the
derivative of log density. ``grad_integrate`` estimates the derivative of each of the integrands that are made here.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.scipy.special import ndtri
from jax.scipy.stats import norm

from ..integration.controls import control_variates
from ..integration.integrand import Integrand
from .derivative import as_params, as_parts, derivatives


class Drawn(NamedTuple):
    """An integral over x together with how x is drawn.

    Attributes:
        dim: number of coordinates of ``u``.
        sample: ``sample(u, params)`` -> x, a pytree, from a point of (0, 1)^dim.
        pdf: ``pdf(x, params)``, the density of x in the measure that ``value`` is integrated over; 1 in total. Its
            logarithm must be differentiable wherever x is drawn.
        value: ``value(x, params)``, what is integrated: a number or an array.
    """

    dim: int
    sample: Callable
    pdf: Callable
    value: Callable


class ScoreControl(NamedTuple):
    """Coefficients (*value, J, J) of the scores of all J numbers in the parameters, row by row for each derivative; and
    the variance of one sample of each derivative with them, relative to that without, as a pilot predicts it.
    """

    coefficients: np.ndarray
    variance_ratio: np.ndarray


def attached_integrand(drawn: Drawn, params) -> Integrand:
    """Return value / pdf at draws that move with the parameters, as automatic differentiation follows them by itself.

    The derivative is unbiased where that is continuous in the parameters for fixed u: where ``value`` jumps at a place
    that draws move across, it lacks what the jump adds.
    """
    return Integrand(_Attached(drawn), drawn.dim, (params,))


def score_integrand(drawn: Drawn, params, control: ScoreControl | None = None) -> Integrand:
    """Return value / pdf at draws that stay where they are: its derivative is that of the value over the density, which
    is the likelihood ratio or score function estimator: of the mean of g = value / pdf it is g' + g d log(pdf).

    The derivative is unbiased, with or without a ``control``, where neither value nor density jumps at a place that
    moves with the parameters. The support of the density is such a place unless it is fixed or the density falls to 0
    there. Jumps of the value at places that are fixed do no harm.

    Args:
        drawn: the integral and its draws.
        params: a pytree of numbers and arrays of floats.
        control: what ``score_control`` returns: the mean of the score is 0, so it can be subtracted. The value has the
            same mean for any control, and the same value at ``params``.

    Source: L'Ecuyer, Management Science 36 (1990); Mohamed et al., JMLR 21 (2020).
    """
    if control is None:
        return Integrand(_Score(drawn), drawn.dim, (params,))
    return Integrand(_Score(drawn), drawn.dim, (params, jnp.asarray(control.coefficients, float)))


def score_control(drawn: Drawn, params, *, n=2**14, key=0) -> ScoreControl:
    """Return the control for ``score_integrand`` that leaves the least variance of the derivative.

    The coefficients are fitted to a pilot of ``n`` samples of its own, as ``mc.control_variates`` does; ``key`` may be
    that of the run to come.

    Raises:
        ValueError: parameters that are no floats, or what ``mc.control_variates`` refuses.
    """
    params = as_params(params)
    derivative = Integrand(_FlatDerivative(drawn), drawn.dim, (params,))
    score = Integrand(_FlatScore(drawn), drawn.dim, (params,))
    size = ravel_pytree(params)[0].size
    found = control_variates(derivative, score, np.zeros(size), n=n, key=key)
    return ScoreControl(found.coefficients, np.asarray(found.variance_ratio))


def blurred(make_integrand: Callable[[Any], Any], params, width) -> Drawn:
    """Return the mean of an integral over parameters that follow a normal law around ``params``.

    The score of that law gives a derivative whatever the integrand does, jumps included, from its values alone. It is
    the derivative of the blurred integral: the bias is of order ``width``^2, the variance without control of order
    ``width``^-2.

    Args:
        make_integrand: as in ``grad_integrate``; its value is a number or an array.
        params: around what.
        width: standard deviation of each number in the parameters.

    Raises:
        ValueError: a width that is not positive, or parameters that are no floats.

    Source: Katkovnik and Kulchitsky (1972), smoothed functionals; Salimans et al. (2017), evolution strategies.
    """
    params = as_params(params)
    if not (np.isscalar(width) and width > 0.0):
        raise ValueError(f"width must be a positive number, got {width!r}")
    dim, size = as_parts(make_integrand(params)).interior.dim, ravel_pytree(params)[0].size
    return Drawn(
        dim + size, _SampleBlurred(dim, width), _BlurDensity(width), _BlurredValue(make_integrand, _BlurDensity(width))
    )


def difference_integrand(make_integrand: Callable[[Any], Any], params, step) -> Integrand:
    """Return the central difference quotient with common random numbers: (f(p + step / 2) - f(p - step / 2)) / step.

    Its value has the structure of the derivative of ``grad_integrate``: one quotient for each number in ``params``. The
    bias is of order ``step``^2; the variance stays bounded where f is smooth in the parameters for fixed coordinates,
    and grows as 1 / ``step`` where a jump moves. Only the interior of a ``WithBoundary`` is needed, and used.

    Raises:
        ValueError: a step that is not positive, or parameters that are no floats.
    """
    params = as_params(params)
    if not (np.isscalar(step) and step > 0.0):
        raise ValueError(f"step must be a positive number, got {step!r}")
    inside = as_parts(make_integrand(params)).interior
    return Integrand(
        _Difference(make_integrand), inside.dim, (params, jnp.asarray(step, float)), inside.lazy, inside.labels
    )


@dataclasses.dataclass(frozen=True)
class _Attached:
    drawn: Drawn

    def __call__(self, u, params):
        x = self.drawn.sample(u, params)
        return _over(self.drawn.value(x, params), self.drawn.pdf(x, params))


@dataclasses.dataclass(frozen=True)
class _Score:
    drawn: Drawn

    def __call__(self, u, params, coefficients=None):
        still = lax.stop_gradient(params)
        x = lax.stop_gradient(self.drawn.sample(u, still))
        value = _over(self.drawn.value(x, params), lax.stop_gradient(self.drawn.pdf(x, still)))
        if coefficients is None:
            return value
        # Subtract what is 0 and has coefficients . score as its derivative.
        moved = ravel_pytree(params)[0]
        moved = moved - lax.stop_gradient(moved)
        return value - (coefficients @ _score(self.drawn, x, still)) @ moved


def _over(value, pdf):
    drawn = pdf > 0.0
    return value * jnp.where(drawn, 1.0 / jnp.where(drawn, pdf, 1.0), 0.0)


def _score(drawn, x, params):
    """Return the derivative of the log density by all numbers in the parameters, shape (J,)."""
    return ravel_pytree(jax.grad(lambda p: jnp.log(drawn.pdf(x, p)))(params))[0]


@dataclasses.dataclass(frozen=True)
class _FlatDerivative:
    drawn: Drawn

    def __call__(self, u, params):
        flat, unravel = ravel_pytree(params)
        return jax.jacfwd(lambda flat: _Score(self.drawn)(u, unravel(flat)))(flat)


@dataclasses.dataclass(frozen=True)
class _FlatScore:
    drawn: Drawn

    def __call__(self, u, params):
        return _score(self.drawn, self.drawn.sample(u, params), params)


@dataclasses.dataclass(frozen=True)
class _SampleBlurred:
    """Coordinates of the integrand, and parameters by normal variates."""

    dim: int
    width: float

    def __call__(self, u, params):
        flat, unravel = ravel_pytree(params)
        return u[: self.dim], unravel(flat + self.width * ndtri(u[self.dim :]))


@dataclasses.dataclass(frozen=True)
class _BlurDensity:
    width: float

    def __call__(self, x, params):
        return jnp.prod(norm.pdf(ravel_pytree(x[1])[0], ravel_pytree(params)[0], self.width))


@dataclasses.dataclass(frozen=True)
class _BlurredValue:
    make: Callable
    density: _BlurDensity

    def __call__(self, x, params):
        u, moved = x
        return as_parts(self.make(moved)).interior(u) * self.density(x, params)


@dataclasses.dataclass(frozen=True)
class _Difference:
    make: Callable

    def __call__(self, u, params, step):
        flat, unravel = ravel_pytree(params)
        moves = 0.5 * step * jnp.eye(flat.size)

        def values(flats):
            return jax.vmap(lambda flat: as_parts(self.make(unravel(flat))).interior(u))(flats)

        quotient = jax.tree.map(lambda a, b: (a - b) / step, values(flat + moves), values(flat - moves))
        return jax.tree.map(lambda q: _like(q, params), quotient)


def _like(quotients, params):
    """Return an array (J, *value) as a pytree like the parameters, with axes of the value first."""
    leaves, structure = jax.tree.flatten(params)
    ends = np.cumsum([leaf.size for leaf in leaves])[:-1]
    parts = jnp.split(jnp.moveaxis(quotients, 0, -1), ends, axis=-1)
    return jax.tree.unflatten(structure, [p.reshape(*p.shape[:-1], *leaf.shape) for p, leaf in zip(parts, leaves)])


def derivative_parts(make_integrand, params) -> tuple[Integrand, ...]:
    """Return the integrands whose means ``grad_integrate`` adds up: interior, and boundary where there is one."""
    found = derivatives(make_integrand, as_params(params))
    return (found.interior,) if found.boundary is None else (found.interior, found.boundary)
