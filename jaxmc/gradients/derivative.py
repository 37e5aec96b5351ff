"""Derivatives of integrals with respect to parameters, with error bars.

Where an integrand jumps and the jump moves, its derivative has two parts: the interior, which is the mean of the
integrand's own derivative, and an integral over the jumps, one dimension lower. They are estimated apart.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from ..integration.driver import integrate
from ..integration.estimate import Estimate
from ..integration.integrand import Integrand
from ..integration.intervals import Interval
from ..integration.samplers import seed_words
from .flows import sweeps

FEW = 4  # parameters, up to which forward mode is the cheaper one
EDGES = 0x65646765  # keeps the samples of the boundary apart from those of the interior
MODES = ("auto", "forward", "reverse")


class WithBoundary(NamedTuple):
    """An integrand together with what its moving jumps add to its derivative.

    ``interior`` is the integrand; the mean of its derivative is the interior part. ``boundary`` is an integrand of
    value 0, whose derivative has the other part as its mean; its function holds facts of the scene and no values. None
    where nothing jumps. ``flags`` say in words what neither of them covers. The first ``held`` parameters of both are
    the scene at rest, which no derivative is taken of.
    """

    interior: Integrand
    boundary: Integrand | None = None
    flags: tuple[str, ...] = ()
    held: int = 0


@dataclasses.dataclass(frozen=True)
class Gradient:
    """The derivative of an integral, in two independent parts.

    Every property has the structure of the value of the integrand, and at each leaf that of ``params``: an array of
    the shape of the value followed by that of the parameter, a float where both are numbers.

    Attributes:
        interior: the mean of the integrand's own derivative, an ``Estimate`` with all that one knows.
        boundary: what moving edges add; None where the integrand came without.
        flags: what may be missing in both, in words.
    """

    interior: Estimate
    boundary: Estimate | None = None
    flags: tuple[str, ...] = ()

    @property
    def parts(self) -> list[Estimate]:
        return [self.interior] if self.boundary is None else [self.interior, self.boundary]

    @property
    def mean(self):
        """The derivative."""
        return jax.tree.map(lambda *x: sum(x), *(p.mean for p in self.parts))

    @property
    def stderr(self):
        """Standard error of each component: the parts are independent."""
        return jax.tree.map(lambda *x: sum(e * e for e in x) ** 0.5, *(p.stderr for p in self.parts))

    @property
    def kurtosis(self):
        """Kurtosis of one sample, of the part where it is larger: 3 for a normal law, NaN where samples are equal."""
        trees = [p._tree([m.kurtosis for m in p.moments]) for p in self.parts]
        return jax.tree.map(lambda *x: np.fmax.reduce(x)[()], *trees)

    @property
    def nonfinite(self) -> int:
        return sum(p.nonfinite for p in self.parts)

    @property
    def n(self) -> int:
        """Samples of both parts together."""
        return sum(p.n for p in self.parts)

    @property
    def status(self) -> str:
        """The worst status of the parts, see ``Estimate.status``; a part whose samples are all equal is sound here, as
        many derivatives are 0."""
        found = [p.status for p in self.parts]
        order = ("non-finite values seen", "tail too heavy", "budget reached", "converged")
        return next((word for word in order if word in found), "complete")

    def interval(self, level: float = 0.95) -> Interval:
        """Return (lower, upper): normal, or by Student's law where errors come from randomisations."""
        if not 0.0 < level < 1.0:
            raise ValueError(f"level must lie in (0, 1), got {level!r}; 0.95 is usual")
        freedom = [p.recipe["replicates"] - 1 for p in self.parts if p.between is not None]
        half = (1.0 + level) / 2.0
        wide = float(stats.t.ppf(half, min(freedom)) if freedom else stats.norm.ppf(half))
        ends = (jax.tree.map(lambda m, e, s=s: m + s * wide * e, self.mean, self.stderr) for s in (-1.0, 1.0))
        return Interval(*ends, method="student-t over replicates" if freedom else "normal", level=level)

    def summary(self) -> str:
        """Return mean, error and status, and the parts where there are two."""
        lines = [f"{self.mean} +- {self.stderr}", f"n = {self.n:,}   {self.status}"]
        if self.boundary is not None:
            lines += [f"interior {self.interior.mean}", f"boundary {self.boundary.mean}"]
        return "\n".join([*lines, *(f"not covered: {flag}" for flag in self.flags)])

    __str__ = summary


def grad_integrate(
    make_integrand: Callable[[Any], Any], params, *, n=None, boundary_n=None, mode="auto", key=0, **options
) -> Gradient:
    """Estimate the derivative of an integral with respect to parameters.

    The integrand that is estimated is the derivative of ``make_integrand(params)`` at each point, a pytree like
    ``params``, so every sampler, tally and stopping rule of ``integrate`` works. That is the whole derivative only
    where the integrand is continuous for fixed coordinates. For a jump that moves with a parameter
    ``make_integrand`` returns a ``WithBoundary``, as ``mc.direct_irradiance`` makes it; ``mc.gradcheck`` finds out
    whether that is needed.

    Args:
        make_integrand: a function of ``params`` that returns an ``Integrand`` or a ``WithBoundary``. It is traced:
            what it makes of its argument has to be differentiable. Pass the same function to run the same kernel.
        params: a pytree of numbers and arrays of floats.
        n: samples of the interior part.
        boundary_n: samples of the boundary part; ``n`` by default. They have a key of their own.
        mode: "forward" costs one derivative for each number in ``params``, "reverse" one for each component of the
            value; "auto" takes forward mode up to 4 numbers. In reverse mode up to 2048 samples are differentiated
            together: tallies and errors see means of so many, and ``n`` is rounded up to them.
        key, options: as in ``integrate``, for each of the parts. A target such as ``rtol`` is one for each part by
            itself.

    Returns:
        A ``Gradient``, with the parts apart.

    Raises:
        ValueError: an unknown mode, parameters that are no floats, a function that returns no integrand, or what
            ``integrate`` refuses.
    """
    params = as_params(params)
    found = derivatives(make_integrand, params, mode, together=True)
    inside = integrate(found.interior, n=n, key=key, **options)
    if found.boundary is None:
        return Gradient(inside, None, found.flags)
    count = n if boundary_n is None else boundary_n
    return Gradient(inside, integrate(found.boundary, n=count, key=boundary_key(key), **options), found.flags)


def derivatives(make_integrand, params, mode="auto", together=False) -> WithBoundary:
    """Return the derivatives of both parts as integrands, whose values are pytrees like ``params``; ``together``: in
    reverse mode those of many samples are made at once.
    """
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, got {mode!r}")
    if mode == "auto":
        few = sum(math.prod(x.shape) for x in jax.tree.leaves(params)) <= FEW
        mode = "forward" if few or not together else "reverse"
    made = as_parts(make_integrand(params))
    held = made.held if _keeps_structure(make_integrand, params, made) else 0
    inside, around, at_once = made.interior, made.boundary, together and mode == "reverse"

    def derivative(part, is_boundary):
        known = part.fn if held or is_boundary else None
        one = _Derivative(make_integrand, mode, known, is_boundary, held)
        fn = _OfMean(one, part.dim, part.lazy) if at_once else one
        return Integrand(fn, part.dim, (params, *part.params[:held]), part.lazy, part.labels, at_once)

    boundary = None if around is None else derivative(around, True)
    return WithBoundary(derivative(inside, False), boundary, made.flags)


def _keeps_structure(make, params, made):
    """Return whether what moves looks the same while JAX traces it, so that the scene at rest may stand in for it."""

    def moving(params):
        return as_parts(make(params)).interior.params[made.held :]

    try:
        traced = jax.eval_shape(moving, params)
    except ValueError:
        return False
    return jax.tree.structure(traced) == jax.tree.structure(made.interior.params[made.held :])


@dataclasses.dataclass(frozen=True)
class _Derivative:
    """The derivative of what ``make`` makes at one point: of its interior, or of its boundary.

    ``fn`` is the function of that part for known values, which holds what cannot be found out while JAX traces; None
    where it has to be made anew. Parameters after ``params`` are those that are held.
    """

    make: Callable
    mode: str
    fn: Any = None
    is_boundary: bool = False
    held: int = 0

    def value(self, u, params, *rest):
        """Return the value at a point, with parameters that may be traced."""
        made = as_parts(self.make(params))
        part = made.boundary if self.is_boundary and made.boundary is not None else made.interior
        # Of a family of integrals the number of one follows what is held.
        held, item = rest[: self.held], rest[self.held :]
        return (self.fn or part.fn)(u, *held, *part.params[self.held :], *item)

    def __call__(self, u, params, *rest):
        differentiate = jax.jacfwd if self.mode == "forward" else jax.jacrev
        return differentiate(lambda params: self.value(u, params, *rest))(params)


@dataclasses.dataclass(frozen=True)
class _OfMean:
    """The derivative of the mean of many samples: one sweep back through all of them."""

    derivative: _Derivative
    dim: int
    lazy: bool

    def __call__(self, each, params, *rest):
        def at(u, params):
            return self.derivative.value(u if self.lazy else u[jnp.arange(self.dim)], params, *rest)

        def mean(params):
            return jax.tree.map(lambda x: x.mean(0), each(lambda u: at(u, params)))

        token = sweeps.set(True)
        try:
            return jax.jacrev(mean)(params)
        finally:
            sweeps.reset(token)


def as_parts(made) -> WithBoundary:
    if isinstance(made, WithBoundary):
        return made
    if not isinstance(made, Integrand):
        raise ValueError(
            f"make_integrand must return an Integrand, or a WithBoundary as mc.direct_irradiance makes it, got {made!r}"
        )
    return WithBoundary(made)


def as_params(params):
    """Return parameters as arrays of floats, or raise ``ValueError``."""
    leaves, structure = jax.tree.flatten(params)
    if not leaves:
        raise ValueError("params must hold at least one number to differentiate by, got none")
    for leaf in leaves:
        try:
            kind = np.asarray(leaf).dtype.kind
        except (TypeError, ValueError):
            kind = "O"
        if kind not in "iuf":
            raise ValueError(f"params must be a pytree of real numbers and arrays of them, got {leaf!r}")
    return jax.tree.unflatten(structure, [jnp.asarray(leaf, float) for leaf in leaves])


def boundary_key(key) -> int:
    """Return the seed of the boundary part: 64 mixed bits, so none that a user would choose."""
    words = [int(word) for word in seed_words(key)]
    return int(np.random.SeedSequence([*words, EDGES]).generate_state(1, np.uint64)[0])
