"""Laws of one sample whose moments, tails and cost of clamping are known.

Every law has ``dim`` and ``sample(u)``, where ``u[k]`` is coordinate k in [0, 1): an array of shape (dim,) or (dim, n),
NumPy or JAX, or a point that computes a coordinate when asked. So ``law.sample`` is an integrand as it stands.

``mean`` and ``variance`` are of one sample, inf where infinite. For a threshold t >= 0, a number or an array:
``exceedance`` is P(c > t), ``clamp_bias`` is E max(c - t, 0), ``clamped_square`` is E min(c, t)^2: integrals of the
exceedance: of P(c > x) over x > t, and of 2 x P(c > x) over x < t. ``optimal_threshold`` minimises the mean squared
error of the mean of N clamped samples: the root of (N - 1) clamp_bias(t) = t - mean (the first-order condition of
Searls, JASA 61 (1966)).

A float32 coordinate ends 2^-24 short of 1, so inverse transforms cut tails off near probability 1e-7.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize, special


class Mix(NamedTuple):
    """``A`` >= 1 with probability ``p``, else uniform on [0, 1]: a dim surface and a rare bright path."""

    p: float
    A: float
    dim = 1

    def sample(self, u):
        xp = _library(u[0])
        return xp.where(u[0] < self.p, self.A, (u[0] - self.p) / (1.0 - self.p))

    @property
    def mean(self) -> float:
        return self.p * self.A + 0.5 * (1.0 - self.p)

    @property
    def variance(self) -> float:
        return self.p * self.A**2 + (1.0 - self.p) / 3.0 - self.mean**2

    def exceedance(self, t):
        t = np.asarray(t, dtype=np.float64)
        return self.p * (t < self.A) + (1.0 - self.p) * np.maximum(1.0 - t, 0.0)

    def clamp_bias(self, t):
        t = np.asarray(t, dtype=np.float64)
        return self.p * np.maximum(self.A - t, 0.0) + (1.0 - self.p) * np.maximum(1.0 - t, 0.0) ** 2 / 2.0

    def clamped_square(self, t):
        t = np.asarray(t, dtype=np.float64)
        s = np.minimum(t, 1.0)
        return self.p * np.minimum(t, self.A) ** 2 + (1.0 - self.p) * (s**2 - 2.0 * s**3 / 3.0)

    def optimal_threshold(self, N: int) -> float:
        t = (N * self.p * self.A + 0.5 * (1.0 - self.p)) / (1.0 + (N - 1) * self.p)
        return t if t >= 1.0 else _solve_threshold(self, N)


class Pareto(NamedTuple):
    """P(c > t) = (xm / t)^alpha above ``xm``: the mean is infinite for alpha <= 1, the variance for alpha <= 2."""

    alpha: float
    xm: float = 1.0
    dim = 1

    def sample(self, u):
        return self.xm * (1.0 - u[0]) ** (-1.0 / self.alpha)

    @property
    def mean(self) -> float:
        return self.alpha * self.xm / (self.alpha - 1.0) if self.alpha > 1.0 else np.inf

    @property
    def variance(self) -> float:
        return self.alpha / (self.alpha - 2.0) * self.xm**2 - self.mean**2 if self.alpha > 2.0 else np.inf

    def exceedance(self, t):
        return (self.xm / np.maximum(t, self.xm)) ** self.alpha

    def clamp_bias(self, t):
        if self.alpha <= 1.0:
            return np.full(np.shape(t), np.inf)[()]
        x = np.maximum(t, self.xm)
        return self.exceedance(x) * x / (self.alpha - 1.0) + (x - t)

    def clamped_square(self, t):
        x = np.maximum(t, self.xm) / self.xm
        power = 2.0 - self.alpha
        tail = 2.0 * np.log(x) if power == 0.0 else 2.0 * np.expm1(power * np.log(x)) / power
        return np.minimum(t, self.xm) ** 2 + self.xm**2 * tail

    def optimal_threshold(self, N: int) -> float:
        return float(self.xm * (1.0 + np.sqrt(N))) if self.alpha == 2.0 else _solve_threshold(self, N)


class LogNormal(NamedTuple):
    """exp(m + s Z) with Z standard normal: all moments finite, and yet a heavy tail for s above 1."""

    m: float
    s: float
    dim = 1

    def sample(self, u):
        ndtri = jax.scipy.special.ndtri if _library(u[0]) is jnp else special.ndtri
        return _library(u[0]).exp(self.m + self.s * ndtri(u[0]))

    @property
    def mean(self) -> float:
        return float(np.exp(self.m + 0.5 * self.s**2))

    @property
    def variance(self) -> float:
        return float(np.expm1(self.s**2)) * self.mean**2

    def _score(self, t):
        with np.errstate(divide="ignore"):
            return (self.m - np.log(t)) / self.s

    def exceedance(self, t):
        return special.ndtr(self._score(t))

    def clamp_bias(self, t):
        return self.mean * special.ndtr(self._score(t) + self.s) - t * self.exceedance(t)

    def clamped_square(self, t):
        square = self.mean**2 * np.exp(self.s**2)
        return square * special.ndtr(-self._score(t) - 2.0 * self.s) + np.square(t) * self.exceedance(t)

    def optimal_threshold(self, N: int) -> float:
        return _solve_threshold(self, N)


class Exponential(NamedTuple):
    """P(c > t) = exp(-t): the light tail."""

    dim = 1

    def sample(self, u):
        return -_library(u[0]).log1p(-u[0])

    @property
    def mean(self) -> float:
        return 1.0

    @property
    def variance(self) -> float:
        return 1.0

    def exceedance(self, t):
        return np.exp(-np.asarray(t, dtype=np.float64))

    def clamp_bias(self, t):
        return self.exceedance(t)

    def clamped_square(self, t):
        return 2.0 * special.gammainc(2.0, t)

    def optimal_threshold(self, N: int) -> float:
        return 1.0 + float(special.lambertw((N - 1) / np.e).real)


class ThroughputProduct(NamedTuple):
    """Product of ``k`` weights 2 rho U: a path's throughput after k bounces on albedo ``rho``.

    Directions are uniform on the hemisphere, so each weight is 2 rho cos(theta) with cos(theta) uniform. The product
    is (2 rho)^k exp(-G) with G ~ Gamma(k, 1); its relative variance is (4/3)^k - 1 whatever the albedo.
    """

    k: int
    rho: float

    @property
    def dim(self) -> int:
        return self.k

    def sample(self, u):
        product = 2.0 * self.rho * u[0]
        for i in range(1, self.k):
            product = product * (2.0 * self.rho * u[i])
        return product

    def moment(self, q: float) -> float:
        """Return E c^q for q > -1."""
        return ((2.0 * self.rho) ** q / (q + 1.0)) ** self.k

    @property
    def mean(self) -> float:
        return self.moment(1)

    @property
    def variance(self) -> float:
        return self.mean**2 * float(np.expm1(self.k * np.log(4.0 / 3.0)))

    def _depth(self, t):
        """Return ln of the largest product over ``t``, at least 0: the Gamma variable below which c > t."""
        with np.errstate(divide="ignore"):
            return np.maximum(self.k * np.log(2.0 * self.rho) - np.log(t), 0.0)

    def exceedance(self, t):
        return special.gammainc(self.k, self._depth(t))

    def clamp_bias(self, t):
        return self.mean * special.gammainc(self.k, 2.0 * self._depth(t)) - t * self.exceedance(t)

    def clamped_square(self, t):
        return self.moment(2) * special.gammaincc(self.k, 3.0 * self._depth(t)) + np.square(t) * self.exceedance(t)

    def optimal_threshold(self, N: int) -> float:
        return _solve_threshold(self, N)


class DiskMollifier(NamedTuple):
    """A delta function blurred: (1 + a |x|^2) / h^2 where |x| < h <= 1, for x uniform on the unit disk; a >= -1.

    As h falls the mean tends to the value 1 at the middle, off by a h^2 / 2, and the variance grows as 1 / h^2: the
    bias and the variance of a mirror or a point light that is made a little wider.
    """

    a: float
    h: float
    dim = 2

    def sample(self, u):
        xp = _library(u[0])
        radius = xp.sqrt(u[0])
        x, y = radius * xp.cos(2.0 * np.pi * u[1]), radius * xp.sin(2.0 * np.pi * u[1])
        square = x * x + y * y
        return xp.where(square < self.h**2, (1.0 + self.a * square) / self.h**2, 0.0)

    def moment(self, q: int) -> float:
        """Return E c^q for a whole q >= 1: the integral of (1 + a v)^q over v < h^2, over h^2q."""
        v = self.h**2
        return sum(math.comb(q, j) * self.a**j * v ** (j + 1) / (j + 1) for j in range(q + 1)) / v**q

    @property
    def mean(self) -> float:
        return self.moment(1)

    @property
    def variance(self) -> float:
        return self.moment(2) - self.moment(1) ** 2


def _library(x):
    return jnp if isinstance(x, jax.Array) else np


def _solve_threshold(law, N):
    """Return the root of (N - 1) clamp_bias(t) = t - mean, unique as one side falls and the other rises."""
    if not np.isfinite(law.mean):
        raise ValueError(f"expected a law with a finite mean, got {law}: no threshold is optimal")

    def excess(t):
        return (N - 1) * law.clamp_bias(t) - (t - law.mean)

    high = 2.0 * law.mean
    while excess(high) > 0.0:
        high *= 2.0
    return float(optimize.brentq(excess, law.mean, high, xtol=1e-300, rtol=1e-14))
