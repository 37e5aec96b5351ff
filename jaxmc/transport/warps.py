"""Changes of variables from the unit square to directions, with their densities.

Every ``sample_x`` maps uniform coordinates to a value, every ``pdf_x`` is its density; the docstring names the measure.
Directions are in the local frame whose z axis is the surface normal.
"""

import jax.numpy as jnp
import numpy as np

from .vec import Vec3, dot, frame, larger, smaller


def _coefficients(function, terms, end=0.25):
    """Return ascending coefficients in x^2 of an even function on |x| <= ``end``, near the best of that degree."""
    fit = np.polynomial.Chebyshev.interpolate(lambda x2: function(np.sqrt(x2)), terms - 1, domain=[0.0, end * end])
    return fit.convert(kind=np.polynomial.Polynomial, domain=[-1, 1], window=[-1, 1]).coef


# sin(2 pi x) / x and cos(2 pi x): the interpolation error is below 2e-9 with 6 terms and 1e-17 with 11.
_TERMS = {np.dtype(np.float32): 6, np.dtype(np.float64): 11}
_SINE = {kind: _coefficients(lambda x: 2.0 * np.pi * np.sinc(2.0 * x), terms) for kind, terms in _TERMS.items()}
_COSINE = {kind: _coefficients(lambda x: np.cos(2.0 * np.pi * x), terms) for kind, terms in _TERMS.items()}
# arctan(x) / x on |x| <= 1: the interpolation error is below 3e-9 with 11 terms and 1e-17 with 22.
_ARCTAN_TERMS = {np.dtype(np.float32): 11, np.dtype(np.float64): 22}
_ARCTAN = {kind: _coefficients(lambda x: np.arctan(x) / x, terms, 1.0) for kind, terms in _ARCTAN_TERMS.items()}


def sincos_2pi(u):
    """Return (sin, cos) of ``2 pi u`` for u in [0, 1].

    Folds the angle into a quarter turn and evaluates two short polynomials: error below 3e-7 in float32, where the
    rounding of u alone makes 2e-7; several times faster than XLA's ``sin`` and ``cos`` on a CPU.
    """
    x = u - 0.5
    size = jnp.abs(x)
    fold = size > 0.25
    x = jnp.where(x < 0.0, 1.0, -1.0) * jnp.where(fold, 0.5 - size, size)
    sine, cosine = sincos_2pi_quarter(x)
    return sine, jnp.where(fold, cosine, -cosine)


def sincos_2pi_quarter(x):
    """Return (sin, cos) of ``2 pi x`` for x in [-1/4, 1/4]; the sine keeps its digits next to 0."""
    x2 = x * x
    kind = np.dtype(jnp.result_type(x))
    return _horner(_SINE[kind], x2) * x, _horner(_COSINE[kind], x2)


def angle(y, x):
    """Return the angle of (x, y) to the x axis, in [0, pi], for y >= 0; not both 0.

    A polynomial after folding to an eighth of a turn: relative error below 3e-7 in float32, small angles included;
    several times faster than XLA's ``arctan2`` on a CPU.
    """
    size = jnp.abs(x)
    steep = y > size
    t = jnp.where(steep, size, y) / jnp.where(steep, y, size)
    folded = _horner(_ARCTAN[np.dtype(jnp.result_type(t))], t * t) * t
    folded = jnp.where(steep, 0.5 * np.pi - folded, folded)
    return jnp.where(x < 0.0, np.pi - folded, folded)


def turn(y, x):
    """Return the angle of (x, y) to the x axis as a share of a full turn, in [0, 1]; 0 where both are 0."""
    share = angle(jnp.abs(y), jnp.where((x == 0.0) & (y == 0.0), 1.0, x)) * (0.5 / np.pi)
    return jnp.where(y < 0.0, 1.0 - share, share)


def _horner(coefficients, x):
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = value * x + float(c)
    return value


def grazing():
    """Return the least cosine of a direction with the normal of the surface that it leaves: the rounding error of a
    product of two unit vectors, so that no ray starts below its own surface.
    """
    return 16.0 * float(jnp.finfo(jnp.result_type(float)).eps)


def sample_cosine_hemisphere(u1, u2):
    """Map (u1, u2) to a unit direction with density cos(theta) / pi per solid angle (Malley's method).

    In float32 cos(theta) is at least 2^-12.
    """
    radius = jnp.sqrt(u1)
    sine, cosine = sincos_2pi(u2)
    return Vec3(radius * cosine, radius * sine, jnp.sqrt(1.0 - u1))


def pdf_cosine_hemisphere(cos_theta):
    """Density of ``sample_cosine_hemisphere`` per solid angle."""
    return cos_theta * (1.0 / np.pi)


def cosine_hemisphere_coordinates(local):
    """Return the (u1, u2) that ``sample_cosine_hemisphere`` maps to a direction; ``local.z`` is not looked at."""
    return smaller(local.x * local.x + local.y * local.y, 1.0), turn(local.y, local.x)


def sample_uniform_hemisphere(u1, u2):
    """Map (u1, u2) to a unit direction with density 1 / (2 pi) per solid angle; cos(theta) = u1, or ``grazing()`` if
    that is more: what this adds to a mean is its square.
    """
    u1 = larger(u1, grazing())
    radius = jnp.sqrt((1.0 - u1) * (1.0 + u1))
    sine, cosine = sincos_2pi(u2)
    return Vec3(radius * cosine, radius * sine, u1)


def pdf_uniform_hemisphere():
    """Density of ``sample_uniform_hemisphere`` per solid angle."""
    return 1.0 / (2.0 * np.pi)


def uniform_hemisphere_coordinates(local):
    """Return the (u1, u2) that ``sample_uniform_hemisphere`` maps to a direction."""
    return local.z, turn(local.y, local.x)


def sample_cone(axis, half_angle, u1, u2):
    """Map (u1, u2) to a unit direction uniformly within ``half_angle``, radians in (0, pi], of the unit ``axis``."""
    away = u1 * _one_minus_cosine(half_angle)
    radius = jnp.sqrt(away * (2.0 - away))
    sine, cosine = sincos_2pi(u2)
    tangent, bitangent = frame(axis)
    return tangent * (radius * cosine) + bitangent * (radius * sine) + axis * (1.0 - away)


def pdf_cone(half_angle):
    """Density of ``sample_cone`` per solid angle, inside of the cone."""
    return (0.5 / np.pi) / _one_minus_cosine(half_angle)


def is_in_cone(w, axis, half_angle):
    """Return whether a unit direction lies within ``half_angle`` of ``axis``; by their difference, which keeps the
    digits of a small angle."""
    apart = w - axis
    return dot(apart, apart) <= 2.0 * _one_minus_cosine(half_angle)


def _one_minus_cosine(angle):
    sine = jnp.sin(0.5 * angle)
    return 2.0 * sine * sine
