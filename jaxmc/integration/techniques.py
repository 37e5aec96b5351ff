"""Techniques: ways to draw points x of a space, and an integral of g(x) over it."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from .controls import coordinates, value_shape
from .counts import is_count, positive


@dataclasses.dataclass(frozen=True)
class Technique:
    """A way to draw points x of some space.

    Attributes:
        sample: ``sample(u, *params) -> x`` for u of shape ``(dim,)``; x is a number, an array or a pytree.
        pdf: ``pdf(x, *params)``, a number: the exact density of ``sample``, finite, of integral 1 in the measure that
            all techniques share.
        dim: number of coordinates that ``sample`` uses.

    Raises:
        ValueError: ``sample`` or ``pdf`` is not callable, or ``dim`` is not a positive integer.
    """

    sample: Callable[..., Any]
    pdf: Callable[..., Any]
    dim: int

    def __post_init__(self):
        if not callable(self.sample) or not callable(self.pdf):
            raise ValueError(f"sample and pdf must be functions, got {self.sample!r} and {self.pdf!r}; pass functions")
        positive("dim", self.dim, cure="pass how many coordinates sample uses")


@dataclasses.dataclass(frozen=True)
class Space:
    """What is integrated and how x is drawn."""

    g: Callable[..., Any]
    techniques: tuple[Technique, ...]
    counts: tuple[int, ...]

    @property
    def dim(self):
        return sum(n * t.dim for t, n in zip(self.techniques, self.counts))

    def over(self, rule, u, params):
        """Return, for each technique i, ``rule(i, g(x), [p_k(x)])`` of its samples: leading axis ``counts[i]``."""

        def one(i, u):
            x = self.techniques[i].sample(u, *params)
            return rule(i, *self.at(x, params))

        results, start = [], 0
        for i, (t, n) in enumerate(zip(self.techniques, self.counts)):
            block = u[start : start + n * t.dim].reshape(n, t.dim)
            results.append(jax.vmap(partial(one, i))(block))
            start += n * t.dim
        return results

    def at(self, x, params):
        """Return g and the list of all densities at x."""
        return jnp.asarray(self.g(x, *params)), [jnp.asarray(t.pdf(x, *params), float) for t in self.techniques]

    def dense(self, p):
        """Return the list of c_k = n_k p_k."""
        return [n * p_k for n, p_k in zip(self.counts, p)]


def ratio(value, density):
    """Return ``value / density``, and 0, with derivative 0, where the density is 0."""
    nowhere = density == 0.0
    return jnp.where(nowhere, 0.0, value / jnp.where(nowhere, 1.0, density))


def space_of(g, techniques, counts, params):
    """Return the ``Space``, or raise ``ValueError`` where something is not as documented."""
    techniques = tuple(techniques)
    if not techniques or not all(isinstance(t, Technique) for t in techniques):
        raise ValueError(f"techniques must be at least one Technique, got {techniques!r}; pass [Technique(...), ...]")
    counts = (1,) * len(techniques) if counts is None else tuple(counts)
    if len(counts) != len(techniques) or not all(map(is_count, counts)):
        raise ValueError(
            f"counts must be {len(techniques)} positive integers, one for each technique, got {counts!r}; "
            "leave out a technique that is not to be used"
        )
    points = [jax.eval_shape(lambda u, t=t: t.sample(u, *params), coordinates(t.dim)) for t in techniques]
    if any(_kind(x) != _kind(points[0]) for x in points):
        raise ValueError(
            f"all techniques must draw points of one structure, shape and type, got {points}; convert them"
        )
    value_shape("g", lambda x: g(x, *params), points[0])
    for k, t in enumerate(techniques):
        shape = value_shape(f"pdf of technique {k}", lambda x, t=t: t.pdf(x, *params), points[0])
        if shape != ():
            raise ValueError(f"pdf of technique {k} must return a number, got shape {shape}; multiply its parts")
    return Space(g, techniques, tuple(map(int, counts)))


def _kind(x):
    leaves, structure = jax.tree.flatten(x)
    return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]
