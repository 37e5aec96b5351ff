"""Integrands that are no scenes of light, over [0, 1]^dim: products, an edge, a singularity, rare spikes.

With the families of Genz they are what general integrators are tested on. Each function raises ``ValueError`` for a
``dim`` that is not a positive integer and for parameters outside the range that its docstring gives.
"""

import itertools
import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

import jaxmc as mc
from analytic_scenes import genz
from analytic_scenes.genz import scene_of_moments
from analytic_scenes.scene import AnalyticScene, variance_and_kurtosis
from jaxmc.integration.counts import is_count, positive

MOST_SPIKES = 16  # the fourth moment is a sum over all quadruples of spikes, 3876 of them


def default_integrands(dim: int = 8) -> tuple[AnalyticScene, ...]:
    """Return the integrands that plain Monte Carlo handles: relative variance below 15 at dim = 8, 100 to dim = 20."""
    return (
        genz.oscillatory(dim),
        genz.product_peak(dim),
        genz.corner_peak(dim),
        genz.gaussian_peak(dim),
        genz.continuous(dim),
        genz.discontinuous(dim),
        linear_product(dim),
        sobol_g(dim),
        simplex(dim),
        power(dim, a=0.1),
        spikes(dim, volume=2.0**-8),
    )


def heavy_integrands(dim: int = 8) -> tuple[AnalyticScene, ...]:
    """Return the integrands on which a sample variance misleads: rare large values, or an infinite moment."""
    return power(dim), power(dim, a=0.6), firefly(dim), spikes(dim)


def linear_product(dim: int = 8, c=1.0) -> AnalyticScene:
    """Return prod_k (1 + c_k (u_k - 1/2)); ``c`` is a finite number or ``dim`` of them.

    Exact: mean 1, variance prod (1 + c_k^2/12) - 1.
    """
    c = _each_coordinate("c", c, dim)
    name = f"product of linear factors, dim={dim}"
    return scene_of_moments(name, _linear_product, dim, _linear_product_moment, "elementary", {"c": c})


def sobol_g(dim: int = 8, a=None) -> AnalyticScene:
    """Return Sobol's g-function prod_k (|4 u_k - 2| + a_k) / (1 + a_k), where coordinates of large ``a`` matter little.

    ``a`` is a number >= 0 or ``dim`` of them, by default (k - 1)/2 for k = 1, 2, ...
    Exact: mean 1, variance prod (1 + 1/(3 (1 + a_k)^2)) - 1.
    """
    positive("dim", dim)
    a = _each_coordinate("a", np.arange(dim) / 2 if a is None else a, dim)
    if np.any(a < 0):
        raise ValueError(f"a must not be negative; got {a}")
    source = "Sobol, Sensitivity estimates for nonlinear mathematical models (1993)"
    return scene_of_moments(f"Sobol g-function, dim={dim}", _sobol_g, dim, _sobol_g_moment, source, {"a": a})


def simplex(dim: int = 8, s: float | None = None) -> AnalyticScene:
    """Return 1 where sum_k u_k < s, else 0, for 0 < s < dim; by default s lies a standard deviation below the mean sum.

    Exact: s^dim/dim! for s <= 1, in general the law of Irwin and Hall. Its alternating sum is evaluated in rational
    numbers, so it is right to the last digit in any dimension. The derivative comes from the edge alone.
    """
    positive("dim", dim)
    s = dim / 2 - math.sqrt(dim / 12) if s is None else s
    if not 0 < s < dim:
        raise ValueError(f"s must lie between 0 and dim={dim}; got {s}")
    below, density = irwin_hall(dim, s)
    variance, kurtosis = _two_values(below)
    return AnalyticScene(
        name=f"simplex sum u < {s:.4g}, dim={dim}",
        integrand=mc.Integrand(_simplex, dim, (float(s),)),
        exact=below,
        exact_variance=variance,
        exact_kurtosis=kurtosis,
        derivatives={"s": density},
        source="Irwin (1927); Hall (1927): law of a sum of uniform variables",
    )


def irwin_hall(dim: int, s: float) -> tuple[float, float]:
    """Return P(S < s) and the density at ``s`` > 0 of the sum S of ``dim`` uniform variables, to the last digit."""
    exactly = Fraction(s)

    def truncated(power):
        terms = ((-1) ** k * math.comb(dim, k) * (exactly - k) ** power for k in range(min(math.ceil(s), dim + 1)))
        return float(sum(terms) / math.factorial(power))

    return truncated(dim), truncated(dim - 1)


def power(dim: int = 8, a: float = 0.3) -> AnalyticScene:
    """Return prod_k u_k^-a for 0 < a < 1: infinite on every face through 0. One singular coordinate is dim = 1.

    Exact: E f^q = (1 - q a)^-dim while q a < 1, else infinite. So ``exact_variance`` is None for a >= 1/2, and
    ``exact_kurtosis`` is None for a >= 1/4: then the sample variance has no error bar.

    In float32 no coordinate is below 2^-33. What lies between two coordinates is lost to each factor: relative to its
    mean, (1 - a) |zeta(a, 1/2)| 2^(-32 (1 - a)), that is 6e-5 at a = 0.6 and 3e-8 at a = 0.3.
    """
    positive("dim", dim)
    if not 0 < a < 1:
        raise ValueError(f"a must lie between 0 and 1, where the mean is finite; got {a}")
    moments = [(1 - q * a) ** -dim if q * a < 1 else math.inf for q in (1, 2, 3, 4)]
    variance = moments[1] - moments[0] ** 2 if 2 * a < 1 else None
    return AnalyticScene(
        name=f"product of powers u^-{a:g}, dim={dim}",
        integrand=mc.Integrand(_power, dim, (float(a),)),
        exact=moments[0],
        exact_variance=variance,
        exact_kurtosis=variance_and_kurtosis(moments)[1] if 4 * a < 1 else None,
        derivatives={"a": dim * (1 - a) ** -(dim + 1)},
        source="elementary",
    )


def firefly(dim: int = 8, p: float = 1e-3, A: float = 500.0, background: float = 0.5) -> AnalyticScene:
    """Return ``A`` with probability 0 < p < 1, namely in a cube of side p^(1/dim) at 0, and ``background`` elsewhere.

    Exact: mean p A + (1 - p) background, variance p (1 - p) (A - background)^2. The derivative with respect to ``p``
    comes from the edge alone. ``A`` and ``background`` are finite.
    """
    positive("dim", dim)
    if not 0 < p < 1 or not math.isfinite(A) or not math.isfinite(background):
        raise ValueError(f"0 < p < 1 and finite A and background are needed; got p={p}, A={A}, background={background}")
    variance, kurtosis = _two_values(p)
    return AnalyticScene(
        name=f"firefly of {A:g} with probability {p:g}, dim={dim}",
        integrand=mc.Integrand(_firefly, dim, (float(p), float(A), float(background))),
        exact=p * A + (1 - p) * background,
        exact_variance=variance * (A - background) ** 2,
        exact_kurtosis=kurtosis if A != background else None,
        derivatives={"p": A - background, "A": p, "background": 1 - p},
        source="moments of a law with two values",
    )


def spikes(dim: int = 8, count: int = 4, volume: float = 2.0**-16) -> AnalyticScene:
    """Return sum_i exp(-|u - c_i|^2 / h^2) over ``count`` fixed, scattered centres, in any dimension.

    ``volume`` = (h sqrt(pi))^dim > 0 is the integral of one whole spike; the cube cuts off some. 1 <= count <= 16.
    Exact: products of erf, for the mean over spikes, for the q-th moment over q-tuples of spikes.

    The relative variance is about 2^(-dim/2) / (count volume). An iteration that misses a spike finds too small a mean
    and too small a variance. So a mean of iterations with weights 1/variance, the rule of VEGAS, comes out too small.
    """
    positive("dim", dim)
    if not is_count(count, most=MOST_SPIKES) or not 0 < volume < math.inf:
        raise ValueError(f"an integer 1 <= count <= {MOST_SPIKES} and volume > 0 are needed; got {count} and {volume}")
    numbers = np.outer(np.arange(1, count + 1), np.arange(1, dim + 1))
    centers = 0.1 + 0.8 * (numbers * math.sqrt(2.0) % 1.0)
    source = "elementary; rule of VEGAS: Lepage, A new algorithm for adaptive multidimensional integration (1978)"
    return scene_of_moments(
        f"{count} spikes of volume 2^{math.log2(volume):.3g}, dim={dim}",
        _spikes,
        dim,
        _spikes_moment,
        source,
        {"volume": float(volume)},
        {"centers": centers},
    )


def _each_coordinate(name, value, dim):
    positive("dim", dim)
    value = np.asarray(value, float)
    if value.shape not in ((), (dim,)) or not np.all(np.isfinite(value)):
        raise ValueError(f"{name} must be a finite number or {dim} of them; got {value}")
    return np.broadcast_to(value, (dim,))


def _two_values(p):
    """Return the variance and kurtosis of an event of probability ``p``."""
    variance = p * (1 - p)
    return variance, 1 / variance - 3 if variance > 0 else None


# Integrands, and their moments of order q = 1, 2, 3, 4.


def _linear_product(u, c):
    return jnp.prod(1 + c * (u - 0.5))


def _linear_product_moment(c, q):
    factors = jnp.ones_like(c), 1 + c**2 / 12, 1 + c**2 / 4, 1 + c**2 / 2 + c**4 / 80
    return jnp.prod(jnp.stack(factors)[q - 1])


def _sobol_g(u, a):
    return jnp.prod((jnp.abs(4 * u - 2) + a) / (1 + a))


def _sobol_g_moment(a, q):
    # |4 u - 2| is uniform on [0, 2], so each factor is distributed as 1 + c (u - 1/2).
    return _linear_product_moment(2 / (1 + a), q)


def _simplex(u, s):
    return jnp.where(jnp.sum(u) < s, 1.0, 0.0)


def _power(u, a):
    return jnp.exp(-a * jnp.sum(jnp.log(u)))


def _firefly(u, p, A, background):
    return jnp.where(jnp.max(u) < p ** (1 / u.size), A, background)


def _spikes(u, volume, centers):
    width = volume ** (1 / u.size) / jnp.sqrt(jnp.pi)
    return jnp.sum(jnp.exp(-jnp.sum(((u - centers) / width) ** 2, axis=1)))


def _spikes_moment(volume, centers, q):
    count, dim = centers.shape
    width = volume ** (1 / dim) / jnp.sqrt(jnp.pi)
    # Expand the q-th power of the sum: each row says how often each spike occurs in a product, of any order up to 4.
    products = [p for order in (1, 2, 3, 4) for p in itertools.combinations_with_replacement(range(count), order)]
    times = np.array([np.bincount(product, minlength=count) for product in products])
    order = times.sum(axis=1)
    ways = special.factorial(order) / special.factorial(times).prod(axis=1)
    # A product of Gaussians is a Gaussian about the mean of their centres, scaled by how far apart they are.
    middle = times @ centers / order[:, None]
    apart = jnp.sum(times[:, :, None] * ((centers - middle[:, None]) / width) ** 2, axis=(1, 2))
    slope = np.sqrt(order)[:, None] / width
    integrals = jnp.sqrt(jnp.pi) / (2 * slope) * (jax.lax.erf(slope * (1 - middle)) + jax.lax.erf(slope * middle))
    return jnp.sum(jnp.where(order == q, ways * jnp.exp(-apart) * jnp.prod(integrals, axis=1), 0.0))
