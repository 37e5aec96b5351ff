"""Unbiased estimators from a ladder of biased ones: a telescoping sum that is cut off at random.

Levels f_0, f_1, ..., f_L of one integrand, from the most biased and calmest to the one that is meant, are taken at the
same point. With N a random level, P(N >= k) = P_k > 0,

    Z = f_0 + sum over k = 1 .. N of (f_k - f_(k-1)) / P_k,      E Z = E f_L,

(Rhee and Glynn, Unbiased Estimation with Square Root Convergence for SDE Models, Operations Research 63(5), 2015; with
P_k for every term, the "coupled sum"). Given the point, the mean of Z is f_L there: so Var Z >= Var f_L, and Z can only
win where a low level takes less time. Levels that come with f_L itself, such as clamping at several limits, never do.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .driver import integrate
from .integrand import Integrand


def debias(levels, *, probabilities=None) -> Integrand:
    """Return an integrand with the integral of the last of some ``levels``, that mostly evaluates to a lower one.

    Args:
        levels: an integrand whose value has the levels on its first axis, such as
            ``integrand.map(ClampLevels((3.0, 30.0)))``; or a list of integrands of the same dimension, one for each
            level, which are evaluated at the same point; or a function that returns the integrand of level k, called
            for as many levels as there are probabilities.
        probabilities: that of stopping at each level: numbers >= 0 with sum 1, the last above 0. None: level k or a
            later one is reached with probability 2^-k.

    One more coordinate, the last, picks the level. Wide code evaluates every level for every sample, so integrands in a
    list cost their sum; ``debias_price`` says what that means.

    Raises:
        ValueError: fewer than two levels, of different dimensions, or probabilities that do not fit.
    """
    ladder = _ladder(levels, probabilities)
    count = _count(ladder)
    if count < 2:
        raise ValueError(f"debias wants at least two levels, got {count}")
    labels = (*ladder.labels, "level") if ladder.labels else ()
    fn = _Telescope(ladder.fn, ladder.dim, ladder.lazy, _reached(probabilities, count))
    return Integrand(fn, ladder.dim + 1, ladder.params, True, labels)


class DebiasPrice(NamedTuple):
    """An unbiased sum over levels beside plain averaging of the last level; per sample, arrays in the shape of a value.

    ``variance`` and ``plain_variance`` of one sample; ``levels`` the number of levels that a sample reaches on average;
    ``seconds`` and ``plain_seconds`` for one sample, all levels of a list included; ``efficiency`` the ratio of
    1 / (variance * time) to that of plain averaging, below 1 where plain averaging is better; ``best`` what it would be
    if a sample took ``levels / L`` of the time of all L levels and those with ``plain_seconds``: a program for one
    sample at a time whose levels cost the same each could come there.
    """

    mean: Any
    variance: Any
    plain_mean: Any
    plain_variance: Any
    levels: float
    seconds: float
    plain_seconds: float
    efficiency: Any
    best: Any


def debias_price(levels, *, probabilities=None, n, key=0) -> DebiasPrice:
    """Return variance and cost of ``debias`` beside plain averaging of the last level, from ``n`` samples of each.

    Both run twice, so that compilation does not count. Arguments as in ``debias``.
    """
    ladder = _ladder(levels, probabilities)
    reached = _reached(probabilities, _count(ladder))
    plain = levels[-1] if isinstance(levels, Sequence) else ladder.map(_Last())
    plain = levels(len(probabilities) - 1) if _is_function(levels) else plain
    found = []
    for f in (debias(levels, probabilities=probabilities), plain):
        integrate(f, n=min(n, 1 << 12), key=key)
        started = time.perf_counter()
        found.append((integrate(f, n=n, key=key), (time.perf_counter() - started) / n))
    (mine, seconds), (other, plain_seconds) = found
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.asarray(other.variance) / np.asarray(mine.variance)
    levels_reached = float(sum(reached))
    return DebiasPrice(
        mine.mean, mine.variance, other.mean, other.variance, levels_reached, seconds, plain_seconds,
        ratio * plain_seconds / seconds, ratio / levels_reached,
    )  # fmt: skip


def debiased_variance(levels, reached) -> Any:
    """Return the variance of the sum over levels from samples of all levels at the same points.

    E Z^2 = sum over k of E[(f_L - f_(k-1))^2 - (f_L - f_k)^2] / P_k, with f_(-1) = 0 (Rhee and Glynn 2015).

    Args:
        levels: values, shape (n, L, ...), levels on the second axis.
        reached: P_k for each level, the first 1.
    """
    levels = np.moveaxis(np.asarray(levels, np.float64), 1, 0)
    left = np.concatenate([levels[-1:], levels[-1] - levels])
    squares = (left**2).mean(1)
    parts = (squares[:-1] - squares[1:]) / np.reshape(reached, (-1, *(1,) * (squares.ndim - 1)))
    return parts.sum(0) - levels[-1].mean(0) ** 2


@dataclasses.dataclass(frozen=True)
class _Telescope:
    """The sum over levels; the coordinate behind those of the levels says how far it goes."""

    fn: Callable[..., Any]
    dim: int
    lazy: bool
    reached: tuple[float, ...]

    def __call__(self, u, *params):
        values = self.fn(u if self.lazy else u[jnp.arange(self.dim)], *params)
        pick = u[self.dim]
        weights = jnp.stack([jnp.where(pick < p, 1.0 / p, 0.0) for p in self.reached])

        def total(v):
            steps = jnp.concatenate([v[:1], jnp.diff(v, axis=0)])
            # A level that was not reached leaves no trace, even where it is not finite.
            w = weights.reshape(-1, *(1,) * (v.ndim - 1))
            return jnp.where(w > 0.0, steps * w, 0.0).sum(0)

        return jax.tree.map(total, values)


@dataclasses.dataclass(frozen=True)
class _Stack:
    """The values of several integrands at one point; ``counts`` parameters belong to each."""

    fns: tuple[Callable[..., Any], ...]
    counts: tuple[int, ...]

    def __call__(self, u, *params):
        values, first = [], 0
        for fn, count in zip(self.fns, self.counts, strict=True):
            values.append(fn(u, *params[first : first + count]))
            first += count
        return jax.tree.map(lambda *v: jnp.stack(v), *values)


@dataclasses.dataclass(frozen=True)
class _Last:
    def __call__(self, values):
        return jax.tree.map(lambda v: v[-1], values)


def _is_function(levels):
    return callable(levels) and not isinstance(levels, Integrand)


def _ladder(levels, probabilities) -> Integrand:
    """Return the levels as one integrand, with the levels on the first axis of its value."""
    if isinstance(levels, Integrand):
        return levels
    if _is_function(levels):
        if probabilities is None:
            raise ValueError("a function of levels needs probabilities: one for each level that there is to be")
        levels = [levels(k) for k in range(len(probabilities))]
    levels = list(levels)
    if not levels or not all(isinstance(f, Integrand) for f in levels):
        raise ValueError(f"levels must be integrands, got {levels!r}")
    if len({(f.dim, f.lazy) for f in levels}) > 1:
        raise ValueError(f"levels must have one dimension, got {[f.dim for f in levels]}: they share their points")
    first, params = levels[0], tuple(p for f in levels for p in f.params)
    fn = _Stack(tuple(f.fn for f in levels), tuple(len(f.params) for f in levels))
    return Integrand(fn, first.dim, params, first.lazy, first.labels)


def _count(ladder):
    shapes = jax.eval_shape(lambda u: ladder(u), jax.ShapeDtypeStruct((ladder.dim,), float))
    counts = {x.shape[0] if x.ndim else 0 for x in jax.tree.leaves(shapes)}
    if len(counts) != 1 or 0 in counts:
        raise ValueError(f"values must have the levels on their first axis, got {jax.tree.leaves(shapes)}")
    return counts.pop()


def _reached(probabilities, count) -> tuple[float, ...]:
    """Return the probability of reaching each level."""
    if probabilities is None:
        return tuple(0.5**k for k in range(count))
    p = np.asarray(probabilities, np.float64)
    if p.shape != (count,) or not (p >= 0.0).all() or not abs(p.sum() - 1.0) <= 1e-6 or not p[-1] > 0.0:
        raise ValueError(
            f"probabilities must be {count} numbers >= 0 with sum 1, one for each level, the last above 0, "
            f"got {p.tolist()}"
        )
    return (1.0, *(np.cumsum(p[::-1])[::-1] / p.sum())[1:].tolist())
