"""Mixtures of sampling techniques: several ways to draw x, one integral of g(x) (Veach, Robust Monte Carlo Methods for
Light Transport Simulation, 1997, chapter 9).

c_k(x) = n_k p_k(x) is how densely technique k samples around x, D(x) their sum. A point where D = 0 contributes 0; what
is NaN stays NaN.

Every function takes ``g(x, *params)``, a number or an array, and techniques that share the measure in which g is
integrated. Together they must reach every x with g(x) != 0: what none of them reaches is missing from the result.
g and techniques are static: pass the same functions to run the same kernel. Gradients flow with respect to ``params``.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .controls import least_squares
from .draw import draw
from .integrand import Integrand
from .samplers import pilot_key
from .techniques import Space, Technique, ratio, space_of


def mixture(g, techniques: Sequence[Technique], *, counts=None, weights="balance", params=()) -> Integrand:
    """Return the multi-sample estimator with ``counts[k]`` samples of technique k as one integrand.

    Its value is the sum over all samples, of technique i at x, of w_i(x) g(x) / c_i(x), where

    - ``weights="balance"``: w_i = c_i / D, so a sample contributes g / D;
    - ``weights="power"``: w_i = c_i^2 / sum of c_k^2, in ratios to the largest c_k, which cannot overflow.

    Coordinates, ``sum(counts[k] * techniques[k].dim)`` of them: all samples of the first technique one after the other,
    then those of the second, and so on. One sample of the integrand costs ``sum(counts)`` evaluations of g.

    Raises:
        ValueError: unknown ``weights``; ``counts`` that are not one positive integer for each technique; a technique or
            g whose value has the wrong shape.
    """
    if weights not in ("balance", "power"):
        raise ValueError(
            f'weights must be "balance" or "power", got {weights!r}; for optimal ones call optimal_mixture'
        )
    space = space_of(g, techniques, counts, params)
    return Integrand(_Weighted(space, _balance if weights == "balance" else _power), space.dim, params)


def optimal_mixture(g, techniques: Sequence[Technique], counts=None, *, n=2**14, key=0, params=()) -> Integrand:
    """Return the multi-sample estimator with the weights of least variance, which may be negative (Kondapaneni et al.,
    Optimal multiple importance sampling, ACM TOG 38(4), 2019).

    Its value is ``sum of alpha_k + sum over all samples of (g - sum of alpha_k p_k) / D``. Each p_k integrates to 1, so
    any fixed alpha is unbiased; alpha = 0 is the balance heuristic. The variance is least where A alpha = b, with
    A_ik the integral of p_i p_k / D and b_i that of p_i g / D. As samples are as dense as D, these are the normal
    equations of the regression of g / D on the p_k / D, which is solved in float64 on a pilot of ``n`` samples of the
    estimator, with a key of its own that is derived from ``key``. alpha, of shape ``(k, *value)``, is the first of the
    integrand's ``params``; gradients hold it fixed. Adding a multiple of ``counts`` to it changes nothing.

    The p_k are control variates: of a density that is not normalised, the error enters times alpha_k. The pilot runs at
    once: call this outside of ``jit`` and ``grad``. Arguments and errors otherwise as in ``mixture``.
    """
    space = space_of(g, techniques, counts, params)
    x, y = draw(Integrand(_Regression(space), space.dim, params), n=n, key=pilot_key(key)).value
    shape, k = y.shape[2:], len(space.techniques)
    rows = np.asarray(x, np.float64).reshape(-1, k)
    alpha = least_squares(rows, np.asarray(y, np.float64).reshape(len(rows), -1)).reshape(k, *shape)
    return Integrand(_Optimal(space), space.dim, (alpha, *params))


def one_sample_mixture(g, techniques: Sequence[Technique], probabilities, *, params=()) -> Integrand:
    """Return ``g(x) / sum of q_k p_k(x)``, where x is drawn with technique k with probability q_k.

    This is the balance heuristic for one sample, which has the least variance of all weights (Veach 1997, section
    9.2.4). Coordinate 0 picks the technique; the others, as many as the largest ``dim``, are those of the technique.

    Raises:
        ValueError: ``probabilities`` are not one for each technique, nonnegative, with sum 1; otherwise as ``mixture``.
    """
    space = space_of(g, techniques, None, params)
    q = np.asarray(probabilities, np.float64)
    if q.shape != (len(space.techniques),) or not (q >= 0.0).all() or not abs(q.sum() - 1.0) <= 1e-6:
        raise ValueError(
            f"probabilities must be {len(space.techniques)} numbers >= 0 with sum 1, got {q.tolist()}, "
            f"whose sum is {q.sum()}; divide them by it"
        )
    picked = _OneSample(space, tuple((q / q.sum()).tolist()))
    return Integrand(picked, 1 + max(t.dim for t in space.techniques), params)


@dataclasses.dataclass(frozen=True)
class _Weighted:
    space: Space
    rule: Callable[..., Any]

    def __call__(self, u, *params):
        parts = self.space.over(lambda i, g, p: self.rule(i, g, self.space.dense(p)), u, params)
        return sum(part.sum(0) for part in parts)


def _balance(i, g, c):
    return ratio(g, sum(c))


def _power(i, g, c):
    largest = reduce(jnp.maximum, c)
    r = [ratio(x, largest) for x in c]
    return ratio(g * r[i], largest * sum(x * x for x in r))


@dataclasses.dataclass(frozen=True)
class _Regression:
    """The rows (samples, k) and the responses (samples, *value) whose regression gives alpha."""

    space: Space

    def __call__(self, u, *params):
        def row(i, g, p):
            density = sum(self.space.dense(p))
            return jnp.stack([ratio(p_k, density) for p_k in p]), ratio(g, density)

        return jax.tree.map(lambda *parts: jnp.concatenate(parts), *self.space.over(row, u, params))


@dataclasses.dataclass(frozen=True)
class _Optimal:
    space: Space

    def __call__(self, u, alpha, *params):
        def contribution(i, g, p):
            return ratio(g - sum(a * p_k for a, p_k in zip(alpha, p)), sum(self.space.dense(p)))

        return alpha.sum(0) + sum(part.sum(0) for part in self.space.over(contribution, u, params))


@dataclasses.dataclass(frozen=True)
class _OneSample:
    space: Space
    probabilities: tuple[float, ...]

    def __call__(self, u, *params):
        ends = np.cumsum(self.probabilities)[:-1]
        draws = [lambda u, t=t: t.sample(u[1 : 1 + t.dim], *params) for t in self.space.techniques]
        x = lax.switch((u[0] >= ends).sum(), draws, u)
        g, p = self.space.at(x, params)
        return ratio(g, sum(q * p_k for q, p_k in zip(self.probabilities, p)))
