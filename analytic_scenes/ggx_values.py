"""Closed forms and one-dimensional integrals of GGX: what rough metal of facets that reflect everything reflects.

``alpha`` is the width of the slopes, in (0, 1]; ``cosine`` is that of the angle to the normal, in (0, 1].

A directional albedo is the integral over all directions of density times D G2 / (4 cos cos'), and the integral over the
azimuth is elementary. With a = alpha, k = 1 - a^2, m = cosine, z that of the other direction, s = z + m,
P = 1 + z m - k s^2 / 2 and w^2 = k^2 (z - m)^2 / 4 + a^2 (1 - k z m),

    albedo = a^2 / (2 m) int_0^1 G2(z) [1 + k s / w + k^2 s P / (4 w^3)] dz.

Moments of the weight of sampling visible normals, G2 / G1, are integrals of the same kind, as the weight does not
depend on azimuth. In float64 they are accurate to 1e-13 for alpha >= 0.03, 1e-11 for 0.01 and 2e-8 for 0.001.

All functions are written with ``jax.numpy``; ``jax.grad`` gives true derivatives.

Sources: Walter et al. 2007, Microfacet Models for Refraction through Rough Surfaces; Heitz 2014, Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs; Kulla & Conty 2017, Revisiting Physically Based Shading at
Imageworks.
"""

import jax
import jax.numpy as jnp
import numpy as np


def facets_within(alpha, theta):
    """Share of the surface whose facets are tilted by less than ``theta`` [rad]; 1 at pi / 2."""
    sine2, cosine2 = jnp.sin(theta) ** 2, jnp.cos(theta) ** 2
    return sine2 / (sine2 + alpha**2 * cosine2)


def smith_masking(alpha, cosine):
    """Share of facets that is visible from a direction: Smith's G1."""
    return 2.0 / (1.0 + jnp.sqrt(1.0 + alpha**2 * (1.0 - cosine**2) / cosine**2))


def directional_albedo(alpha, cosine):
    """Share of light from one direction that is reflected once, with masking and shadowing of correlated heights."""
    return sampled_moment(alpha, cosine, 1)


def sampled_moment(alpha, cosine, power):
    """Mean of the ``power``-th power of the weight G2 / G1 of sampling visible normals; 1 is the directional albedo."""

    def integrand(z, apart):
        stretched, other = _stretched(cosine, alpha), _stretched(z, alpha)
        pair = z * stretched + cosine * other
        weight = z * (cosine + stretched) / pair
        return alpha**2 * z / pair * weight ** (power - 1) * _over_azimuth(z, apart, cosine, alpha)

    return _integral_about(integrand, cosine)


def separable_directional_albedo(alpha, cosine):
    """Directional albedo with G2 = G1 G1', as if masking and shadowing were independent (Walter et al. 2007)."""

    def integrand(z, apart):
        both = smith_masking(alpha, cosine) * 2.0 * z / (z + _stretched(z, alpha))
        return alpha**2 / (2.0 * cosine) * both * _over_azimuth(z, apart, cosine, alpha)

    return _integral_about(integrand, cosine)


def average_albedo(alpha):
    """Share of the light of a uniform sky that is reflected once: the mean of the directional albedo over 2 z dz."""
    return average_moment(alpha)


def average_moment(alpha, power=1):
    """Mean of ``sampled_moment`` over 2 z dz."""
    z, _, weights = _double_exponential(0.1)
    moments = jax.lax.map(lambda cosine: sampled_moment(alpha, cosine, power), jnp.asarray(z, float))
    return jnp.sum(weights * 2.0 * z * moments)


def _stretched(cosine, alpha):
    return jnp.sqrt(cosine**2 + alpha**2 * (1.0 - cosine**2))


def _over_azimuth(z, apart, cosine, alpha):
    """Bracket of the formula above, at ``z`` = cosine + ``apart``."""
    k, s = 1.0 - alpha**2, z + cosine
    w2 = (k * apart) ** 2 / 4.0 + alpha**2 * (1.0 - k * z * cosine)
    w = jnp.sqrt(w2)
    return 1.0 + k * s / w + k**2 * s * (1.0 + z * cosine - k * s**2 / 2.0) / (4.0 * w2 * w)


def _integral_about(function, middle):
    """Integral over z from 0 to 1 of ``function(z, z - middle)``, which may have a narrow peak at ``middle``."""
    x, rest, weights = _double_exponential(0.05)
    below = function(middle * x, -middle * rest) * middle
    above = function(middle + (1.0 - middle) * rest, (1.0 - middle) * rest) * (1.0 - middle)
    return jnp.sum(weights * (below + above))


def _double_exponential(step):
    """Nodes x on (0, 1), 1 - x and weights of Takahasi and Mori's rule: ends may be steep or singular."""
    t = np.arange(-3.3, 3.3 + step / 2, step)
    y = np.pi / 2.0 * np.sinh(t)
    x, rest = 1.0 / (1.0 + np.exp(-2.0 * y)), 1.0 / (1.0 + np.exp(2.0 * y))
    return x, rest, step * np.pi * np.cosh(t) * x * rest
