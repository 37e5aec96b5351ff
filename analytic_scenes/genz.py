"""The six families of Genz: integrands over [0, 1]^dim, one for each difficulty that an integrator may meet.

``a`` says how hard the integrand is along each coordinate, and ``w`` where in the cube it is hard. Without ``a``, fixed
uneven coefficients are scaled to the sum ``difficulty``; without ``w``, fixed numbers in [0, 1] are taken. The default
sums are those of Barthelmann, Novak and Ritter for dim = 10. Genz himself draws ``a`` and ``w`` at random.

Every integrand has exact mean, variance, kurtosis and derivatives with respect to ``a`` and ``w``, because a power of
such a function belongs to the same family, or nearly. Each function raises ``ValueError`` for a ``dim`` that is not a
positive integer, a ``difficulty`` or ``a`` that is not positive and finite, ``w`` outside [0, 1], a wrong shape, and
moments outside the range of float64.

Source: Genz, Testing multidimensional integration routines (1984), A package for testing multiple integration
subroutines (1987); Barthelmann, Novak and Ritter, High dimensional polynomial interpolation on sparse grids (2000).
"""

import math
import types
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.scene import AnalyticScene, Derivatives, value_of, variance_and_kurtosis
from jaxmc.integration.counts import positive

SOURCE = "Genz, Testing multidimensional integration routines (1984); moments: the same integrals"
MOST_DIMENSIONS = 1000  # of the corner peak, whose quadrature takes memory as dim^(3/2)
NOTHING = types.MappingProxyType({})
LEAST_SQUARE = 1e-135  # of a mean square: below it, squares of variances leave the range of float64
LEAST_VARIANCE = 1e-3  # relative to the mean square: below it, rounding of the raw moments spoils the kurtosis


def oscillatory(dim: int = 8, difficulty: float = 9.0, a=None, w: float = 0.4) -> AnalyticScene:
    """Return cos(2 pi w + sum_k a_k u_k): a plane wave. With the defaults its mean is positive for dim > 1.

    Exact: mean cos(2 pi w + sum a/2) prod sin(a_k/2) / (a_k/2); powers of a cosine are sums of cosines.
    """
    a = _coefficients(dim, difficulty, a)
    arguments = {"a": a, "w": _place(w, ())}
    return scene_of_moments(f"Genz oscillatory, dim={dim}", _oscillatory, dim, _oscillatory_moment, SOURCE, arguments)


def product_peak(dim: int = 8, difficulty: float = 7.25, a=None, w=None) -> AnalyticScene:
    """Return prod_k 1 / (a_k^-2 + (u_k - w_k)^2): a peak in the middle with slow, rational decay.

    Exact: mean prod a_k (atan(a_k (1 - w_k)) + atan(a_k w_k)), higher moments by recurrence.
    """
    arguments = {"a": _coefficients(dim, difficulty, a), "w": _place(w, (dim,))}
    name = f"Genz product peak, dim={dim}"
    return scene_of_moments(name, _product_peak, dim, _product_peak_moment, SOURCE, arguments)


def corner_peak(dim: int = 8, difficulty: float = 1.85, a=None) -> AnalyticScene:
    """Return (1 + sum_k a_k u_k)^-(dim + 1): a peak in the corner at 0, not a product.

    Exact: the q-th moment is E prod (1 - exp(-a_k T)) / (a_k T) over a Gamma(q (dim + 1)) variable T, by quadrature to
    rounding (relative error 1e-12). The textbook sum over 2^dim corners is equal, but cancels. Also raises
    ``ValueError`` for dim > 1000.
    """
    a = _coefficients(dim, difficulty, a)
    if dim > MOST_DIMENSIONS:
        raise ValueError(f"the corner peak is known for dim up to {MOST_DIMENSIONS}; got dim={dim}")
    return scene_of_moments(f"Genz corner peak, dim={dim}", _corner_peak, dim, _corner_peak_moment, SOURCE, {"a": a})


def gaussian_peak(dim: int = 8, difficulty: float = 7.03, a=None, w=None) -> AnalyticScene:
    """Return exp(-sum_k a_k^2 (u_k - w_k)^2).

    Exact: mean prod sqrt(pi) / (2 a_k) (erf(a_k (1 - w_k)) + erf(a_k w_k)); its q-th power has a sqrt(q) for a.
    """
    arguments = {"a": _coefficients(dim, difficulty, a), "w": _place(w, (dim,))}
    name = f"Genz Gaussian peak, dim={dim}"
    return scene_of_moments(name, _gaussian_peak, dim, _gaussian_peak_moment, SOURCE, arguments)


def continuous(dim: int = 8, difficulty: float = 20.4, a=None, w=None) -> AnalyticScene:
    """Return exp(-sum_k a_k |u_k - w_k|): continuous, with a kink in every coordinate.

    Exact: mean prod (2 - exp(-a_k w_k) - exp(-a_k (1 - w_k))) / a_k; its q-th power has q a for a.
    """
    arguments = {"a": _coefficients(dim, difficulty, a), "w": _place(w, (dim,))}
    return scene_of_moments(f"Genz continuous, dim={dim}", _continuous, dim, _continuous_moment, SOURCE, arguments)


def discontinuous(dim: int = 8, difficulty: float = 4.3, a=None, w=None) -> AnalyticScene:
    """Return exp(sum_k a_k u_k) where u_1 <= w_1 and u_2 <= w_2, else 0; ``w`` has shape (2,), or (1,) for dim = 1.

    Exact: mean prod (exp(a_k w_k) - 1) / a_k with w_k = 1 from k = 3 on; its q-th power has q a for a. The derivative
    with respect to ``w`` comes from the edge alone: differentiating the integrand gives 0.
    """
    a = _coefficients(dim, difficulty, a)
    arguments = {"a": a, "w": _place(w, (min(dim, 2),))}
    name = f"Genz discontinuous, dim={dim}"
    return scene_of_moments(name, _discontinuous, dim, _discontinuous_moment, SOURCE, arguments)


def scene_of_moments(
    name: str, fn: Callable, dim: int, moment: Callable, source: str, arguments: Mapping, constants: Mapping = NOTHING
) -> AnalyticScene:
    """Return the scene of the integrand ``fn(u, *arguments, *constants)``, given ``moment(..., q=q)`` = E fn^q.

    ``exact`` is differentiated with respect to the ``arguments``. The variance is a difference of moments: its relative
    error is about 1e-15 mean^2/variance. The kurtosis is None below a relative variance of 1e-3. Raises ``ValueError``
    where a moment leaves the range of float64.
    """
    moments = [value_of(moment, arguments, {**constants, "q": q}) for q in (1, 2, 3, 4)]
    if not (moments[1] > LEAST_SQUARE and moments[3] < math.inf):
        raise ValueError(f"{name}: values are too small or too large for float64, with moments {moments}")
    variance, kurtosis = variance_and_kurtosis(moments)
    if variance < LEAST_VARIANCE * moments[1]:
        kurtosis = None
    integrand = mc.Integrand(fn, dim, (*arguments.values(), *constants.values()))
    derivatives = Derivatives(moment, arguments, {**constants, "q": 1})
    return AnalyticScene(name, integrand, moments[0], variance, kurtosis, derivatives, source)


def _coefficients(dim, difficulty, a):
    positive("dim", dim)
    if a is None:
        uneven = 0.5 + np.arange(1, dim + 1) * np.sqrt(3.0) % 1.0
        a = difficulty * uneven / uneven.sum()
    a = np.asarray(a, float)
    if a.shape != (dim,) or not np.all((a > 0) & (a < np.inf)):
        raise ValueError(f"a must be {dim} positive numbers, or the difficulty, their sum, positive; got a={a}")
    return a


def _place(w, shape):
    if w is None and shape:
        w = np.arange(1, shape[0] + 1) * np.sqrt(2.0) % 1.0
    w = np.asarray(w, float)
    if w.shape != shape or not np.all((w >= 0) & (w <= 1)):
        raise ValueError(f"w must lie in [0, 1] and have shape {shape}; got {w}")
    return w


# Integrands: functions of one point.


def _oscillatory(u, a, w):
    return jnp.cos(2 * jnp.pi * w + jnp.sum(a * u))


def _product_peak(u, a, w):
    return jnp.prod(1 / (a**-2 + (u - w) ** 2))


def _corner_peak(u, a):
    return (1 + jnp.sum(a * u)) ** -(a.size + 1)


def _gaussian_peak(u, a, w):
    return jnp.exp(-jnp.sum((a * (u - w)) ** 2))


def _continuous(u, a, w):
    return jnp.exp(-jnp.sum(a * jnp.abs(u - w)))


def _discontinuous(u, a, w):
    return jnp.where(jnp.all(u[: w.size] <= w), jnp.exp(jnp.sum(a * u)), 0.0)


# Their moments of order q = 1, 2, 3, 4.


def _oscillatory_moment(a, w, q):
    first, second, third, fourth = (
        jnp.cos(j * (2 * jnp.pi * w + jnp.sum(a) / 2)) * jnp.prod(jnp.sinc(j * a / (2 * jnp.pi))) for j in (1, 2, 3, 4)
    )
    powers = first, (1 + second) / 2, (3 * first + third) / 4, (3 + 4 * second + fourth) / 8
    return jnp.stack(powers)[q - 1]


def _product_peak_moment(a, w, q):
    def bell(y):
        """Integrate (1 + x^2)^-q from 0 to y, for q = 1, 2, 3, 4."""
        integrals = [jnp.arctan(y)]
        for n in (1, 2, 3):
            integrals.append((y / (1 + y**2) ** n + (2 * n - 1) * integrals[-1]) / (2 * n))
        return jnp.stack(integrals)

    return jnp.prod(a ** (2 * q - 1) * (bell(a * (1 - w)) + bell(a * w))[q - 1])


def _corner_peak_moment(a, q):
    # The trapezoidal rule in x = ln T converges exponentially; steps are a fraction of the width of the narrowest law.
    most = 4 * (a.size + 1)
    x = jnp.arange(-40.0, np.log(most + 10 * np.sqrt(most) + 40), 0.3 / np.sqrt(most))
    weight = jax.nn.softmax(q * (a.size + 1) * x - jnp.exp(x))
    scaled = a * jnp.exp(x)[:, None]
    return jnp.sum(weight * jnp.prod(-jnp.expm1(-scaled) / scaled, axis=1))


def _gaussian_peak_moment(a, w, q):
    a = a * jnp.sqrt(q)
    return jnp.prod(jnp.sqrt(jnp.pi) / (2 * a) * (jax.lax.erf(a * (1 - w)) + jax.lax.erf(a * w)))


def _continuous_moment(a, w, q):
    return jnp.prod(-(jnp.expm1(-q * a * w) + jnp.expm1(-q * a * (1 - w))) / (q * a))


def _discontinuous_moment(a, w, q):
    upper = jnp.ones_like(a).at[: w.size].set(w)
    return jnp.prod(jnp.expm1(q * a * upper) / (q * a))
