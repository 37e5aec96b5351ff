"""What is known exactly about an integrand: the record, and how its exact numbers are evaluated.

The closed forms of this package are written with ``jax.numpy``. They follow the precision that JAX runs in and
``jax.grad`` goes through them, so one evaluation here gives the value and every derivative, in float64.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.names import slug
from jaxmc.backend import QUICK_OPTIONS


@dataclasses.dataclass(frozen=True)
class AnalyticScene:
    """An integrand whose integral is known in closed form.

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
    exact: float
    exact_variance: float | None
    exact_kurtosis: float | None
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


def value_and_derivatives(
    formula: Callable, constants: Mapping | None = None, **arguments
) -> tuple[float, dict[str, float | np.ndarray]]:
    """Evaluate ``formula(**arguments, **constants)`` and its derivative with respect to each argument, in float64.

    The arguments are scalars or arrays; a derivative has the shape of its argument, and is a float for a scalar.
    A formula is compiled once for arguments of the same shapes.
    """
    with jax.enable_x64(True):
        value, gradients = _value_and_gradients(formula, _as_arrays(arguments), dict(constants or {}))
        return float(value), {name: float(g) if g.ndim == 0 else np.asarray(g) for name, g in gradients.items()}


def value_of(formula: Callable, arguments: Mapping, constants: Mapping | None = None) -> float:
    """Evaluate ``formula(**arguments, **constants)`` in float64."""
    with jax.enable_x64(True):
        return float(_value(formula, _as_arrays(arguments), dict(constants or {})))


class Derivatives(Mapping):
    """The derivative of a closed form with respect to each of ``arguments``, evaluated when one is first asked for.

    Compiling a derivative takes longer than all else that makes a scene.
    """

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
