"""What is known exactly about an integrand: the record, and how its exact numbers are evaluated.

The closed forms of this package are written with ``jax.numpy``. They follow the precision that JAX runs in and
``jax.grad`` goes through them, so one evaluation here gives the value and every derivative, in float64.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.laws import Law
from analytic_scenes.names import slug
from jaxmc.backend import QUICK_OPTIONS


class _Deferred:
    """A field of a record that is given as a value, or as a function without arguments that is called for it once."""

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, record, owner=None):
        if record is None:
            raise AttributeError(self.name)  # so a dataclass learns that the field has no default
        value = record.__dict__[self.name]
        if callable(value):
            value = record.__dict__[self.name] = value()
        return value

    def __set__(self, record, value):
        record.__dict__[self.name] = value


def _deferred() -> Any:
    return _Deferred()  # which type checkers take for what it holds


@dataclasses.dataclass(frozen=True)
class AnalyticScene:
    """An integrand whose integral is known in closed form.

    What is exact may be given as a function without arguments, which is called when the value is first asked for:
    compiling a closed form takes longer than all else that makes a scene.

    name            what it is, in words; unique within ``analytic_scenes.ALL``
    integrand       the estimator under study; its values have shape ()
    exact           its integral: radiance [W/m^2/sr], irradiance [W/m^2], or a plain number
    exact_variance  variance of one sample of ``integrand``; None where no closed form is known
    exact_kurtosis  fourth central moment / variance^2 of one sample (3 for a normal law); None if unknown or undefined
    derivatives     true derivatives of ``exact``, visibility included, keyed by the argument of the function that made
                    the scene: a float, or an array of shape (3,) for a vector argument
    source          where the closed form comes from
    formula         the closed form in ``jax.numpy``: ``formula(**arguments)`` is ``exact``; None where there is none
    arguments       what ``formula`` takes: scalars and arrays of shape (3,)
    geometry        what stands where, in a sentence or two
    tolerance       relative accuracy of ``exact``: the rounding of the closed form in float64
    view            a function without arguments that returns (scene, camera) for a picture; None where there is none
    """

    name: str
    integrand: mc.Integrand
    exact: float = _deferred()
    exact_variance: float | None = _deferred()
    exact_kurtosis: float | None = _deferred()
    derivatives: Mapping[str, float | np.ndarray]
    source: str
    formula: Callable | None = None
    arguments: Mapping = dataclasses.field(default_factory=dict)
    geometry: str = ""
    tolerance: float = 1e-12
    view: Callable[[], tuple[mc.Scene, mc.PinholeCamera]] | None = None

    @property
    def slug(self) -> str:
        """The name as it is typed on a command line: ``jaxmc scenes sphere-light-lights-nee``."""
        return slug(self.name)


def closed_form_scene(
    name: str,
    formula: Callable,
    arguments: Mapping,
    integrand: mc.Integrand,
    source: str,
    *,
    geometry: str,
    law: Callable[[float], Law | None],
    view: Callable[[], tuple[mc.Scene, mc.PinholeCamera]] | None = None,
    constants: Mapping | None = None,
    tolerance: float = 1e-12,
) -> AnalyticScene:
    """Return the record of an integrand whose integral is ``formula(**arguments, **constants)``.

    ``law(exact)`` is the law of one sample, or None where it is not known. ``constants`` are arguments by which the
    formula is not differentiated.
    """

    @functools.cache
    def known():
        return law(scene.exact) or Law(None, None)

    scene = AnalyticScene(
        name=name,
        integrand=integrand,
        exact=lambda: value_of(formula, arguments, constants),
        exact_variance=lambda: known().variance,
        exact_kurtosis=lambda: known().kurtosis,
        derivatives=Derivatives(formula, arguments, constants),
        source=source,
        formula=formula,
        arguments={**arguments, **(constants or {})},
        geometry=geometry,
        tolerance=tolerance,
        view=view,
    )
    return scene


def value_and_derivatives(
    formula: Callable, constants: Mapping | None = None, **arguments
) -> tuple[float, dict[str, float | np.ndarray]]:
    """Evaluate ``formula(**arguments, **constants)`` and its derivative with respect to each argument, in float64.

    The arguments are scalars or arrays; a derivative has the shape of its argument, and is a float for a scalar.
    A formula is compiled once for arguments of the same shapes.
    """
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        value, gradients = _value_and_gradients(formula, _as_arrays(arguments), dict(constants or {}))
        return float(value), {name: float(g) if g.ndim == 0 else np.asarray(g) for name, g in gradients.items()}


def value_of(formula: Callable, arguments: Mapping, constants: Mapping | None = None) -> float:
    """Evaluate ``formula(**arguments, **constants)`` in float64: a number even while JAX traces."""
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        return float(_value(formula, _as_arrays(arguments), dict(constants or {})))


class Derivatives(Mapping):
    """The derivative of a closed form with respect to each of ``arguments``, evaluated when one is first asked for."""

    def __init__(self, formula: Callable, arguments: Mapping, constants: Mapping | None = None):
        self._formula, self._arguments, self._constants = formula, arguments, constants

    @functools.cached_property
    def _values(self):
        return value_and_derivatives(self._formula, self._constants, **self._arguments)[1]

    def __getitem__(self, name):
        return self._values[name]

    def __iter__(self):
        return iter(self._arguments)

    def __len__(self):
        return len(self._arguments)


def _as_arrays(arguments):
    return {name: jnp.asarray(value, float) for name, value in arguments.items()}


_compile = functools.partial(jax.jit, static_argnums=0, compiler_options=QUICK_OPTIONS)


@_compile
def _value_and_gradients(formula, arguments, constants):
    return jax.value_and_grad(lambda named: formula(**named, **constants))(arguments)


@_compile
def _value(formula, arguments, constants):
    return formula(**arguments, **constants)


def variance_and_kurtosis(moments: Sequence[float]) -> tuple[float, float | None]:
    """Return (variance, kurtosis) of a law from its raw moments E X, E X^2, E X^3, E X^4."""
    m1, m2, m3, m4 = moments
    variance = m2 - m1**2
    if variance <= 1e-14 * m2:  # a constant: what is left is rounding
        return 0.0, None
    return variance, (m4 - 4 * m3 * m1 + 6 * m2 * m1**2 - 3 * m1**4) / variance**2
