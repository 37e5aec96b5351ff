"""Integrands: functions of one point of the unit hypercube."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from .counts import positive


@partial(
    jax.tree_util.register_dataclass, data_fields=["params"], meta_fields=["fn", "dim", "lazy", "labels", "together"]
)
@dataclasses.dataclass(frozen=True)
class Integrand:
    """A function ``fn(u, *params)`` of one point ``u`` in (0, 1)^dim, to be integrated over the unit hypercube.

    ``fn`` is written for one point; the driver makes it wide with ``jax.vmap``. It returns a number, an array or a
    pytree of them. ``fn`` and ``dim`` are static, ``params`` are leaves: the same integrand with other parameter
    values does not recompile, and ``jax.grad`` flows through them.

    Attributes:
        fn: ``fn(u, *params) -> value``; ``u[k]`` is coordinate k.
        dim: number of coordinates.
        params: a tuple of pytrees, passed on to ``fn``.
        lazy: ``fn`` uses ``u`` by ``u[k]`` only. Then it gets a point that computes coordinates when they are asked
            for, which saves time and memory in many dimensions; otherwise it gets an array of shape ``(dim,)``.
        labels: what each coordinate decides, ``dim`` words or none.
        together: the driver calls ``fn(each, *params)`` once for a row of samples; ``each(f)`` are the values of
            ``f(u)`` at all of their points, and ``fn`` returns the mean of what it makes of them. For what is cheaper
            to make of many samples than of one: a derivative in reverse mode. Such an integrand is not called.

    Raises:
        ValueError: ``fn`` is not callable, or ``dim`` is not a positive integer.
    """

    fn: Callable[..., Any]
    dim: int
    params: tuple = ()
    lazy: bool = False
    labels: tuple[str, ...] = ()
    together: bool = False

    def __post_init__(self):
        if not callable(self.fn):
            raise ValueError(f"fn must be a function of one point, got {self.fn!r}")
        positive("dim", self.dim, cure="pass the number of coordinates of u")

    def __call__(self, u):
        """Return the value at one point: an array of shape ``(dim,)`` or a lazy point."""
        return self.fn(u, *self.params)

    def at(self, point, *item):
        """Return the value at a lazy point, as the driver evaluates it; ``item`` is the number of one of a family."""
        return self.fn(point if self.lazy else point[jnp.arange(self.dim)], *self.params, *item)

    def map(self, g: Callable[[Any], Any]) -> "Integrand":
        """Return the integrand of ``g(value)``. ``g`` is static: pass the same function to run the same kernel."""
        return dataclasses.replace(self, fn=_Composed(self.fn, g))

    def through(self, change) -> "Integrand":
        """Return the integrand f(x(u)) |dx / du|, which has the same integral.

        ``change(u) -> (x, jacobian)`` is a change of variables of (0, 1)^dim and a pytree, such as an
        ``ImportanceMap``; it becomes the last of ``params``.

        Raises:
            ValueError: ``change`` is not callable, or has another dimension.
        """
        if not callable(change):
            raise ValueError(f"through wants a change of variables u -> (x, jacobian), got {change!r}")
        if getattr(change, "dim", self.dim) != self.dim:
            raise ValueError(f"the change of variables has dim={change.dim}, the integrand {self.dim}; adapt another")
        return Integrand(
            _Through(self.fn, len(self.params), type(change)), self.dim, (*self.params, change), labels=self.labels
        )

    def batch(self, u):
        """Return the values at an array of points of shape ``(n, dim)``: leading axis n on every leaf.

        Lets other integrators (SciPy, vegas, QMCPy) use the integrand.
        """
        u = jnp.asarray(u, float)
        if u.ndim != 2 or u.shape[1] != self.dim:
            raise ValueError(f"points must have shape (n, {self.dim}), got {u.shape}")
        return _batch(self, u)


SAMPLES = "samples"  # the axis along which the driver evaluates samples in step


def evaluated_in_step() -> bool:
    """Return whether this sample is evaluated in step with others, by the driver."""
    try:
        return lax.axis_size(SAMPLES) > 0
    except NameError:
        return False


def holds_for_any(condition):
    """Return whether a condition holds for any of the samples that are evaluated in step with this one: a branch on it
    stays a branch under ``vmap``.
    """
    return lax.pmax(condition.astype(jnp.int32), SAMPLES) > 0


@dataclasses.dataclass(frozen=True)
class _Composed:
    """g after f."""

    f: Callable[..., Any]
    g: Callable[[Any], Any]

    def __call__(self, u, *params):
        return self.g(self.f(u, *params))


@dataclasses.dataclass(frozen=True)
class _Through:
    """fn(x(u)) times the jacobian; the change follows the parameters of fn, the number of an item follows it."""

    fn: Callable[..., Any]
    count: int  # of parameters of fn
    # JAX takes two dataclasses with the same fields for one where their hashes happen to meet, and would then run the
    # kernel of the other: keep them apart by their class.
    kind: type

    def __call__(self, u, *args):
        x, jacobian = args[self.count](u)
        value = self.fn(x, *args[: self.count], *args[self.count + 1 :])
        return jax.tree.map(lambda v: v * jacobian, value)


@jax.jit
def _batch(integrand, u):
    return jax.vmap(integrand)(u)


def as_integrand(f, dim=None) -> Integrand:
    """Return ``f`` as an ``Integrand``: one already, or a function of ``u`` together with its dimension."""
    if isinstance(f, Integrand):
        if dim is not None and dim != f.dim:
            raise ValueError(f"dim={dim} contradicts the integrand, which has dim={f.dim}; leave dim out")
        return f
    if dim is None:
        raise ValueError("a plain function needs its dimension: integrate(f, dim=..., n=...)")
    return Integrand(f, dim)
