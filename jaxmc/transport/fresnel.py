"""Fresnel's equations at a smooth interface, for light that is not polarised, and the direction of what passes.

``eta`` is the index of refraction on the far side over that on the near side, the one that the light comes from; the
other way round it is 1 / eta. Cosines are of the angle to the normal on the near side, in [0, 1].

The usual differences c - q, with q = eta cos_t, are written as (c^2 - q^2) / (c + q), where Snell's law makes c^2 - q^2
a constant: so digits are lost nowhere, not for eta near 1 and not at grazing incidence. In float32 a reflectance
is accurate to 1e-6 of itself but for Brewster's zero of one polarisation, and for the jump in slope at the critical
angle, where it is accurate as a function of an angle off by rounding.

Source: Born and Wolf, Principles of Optics, sections 1.5 and 14.4.
"""

import jax.numpy as jnp

from .derivatives import root
from .vec import Vec3, dot, larger
from .warps import grazing

LEAST = 1e-15  # keeps 0 / 0 at grazing incidence on no interface at all finite


def _far_cosine(cos_i, eta):
    """Return (eta cos_t)^2, negative under total internal reflection."""
    return (eta - 1.0) * (eta + 1.0) + cos_i * cos_i


def fresnel_dielectric(cos_i, eta):
    """Return the share of light that a dielectric interface reflects, in [0, 1]; 1 under total internal reflection.

    The rest passes. The mean of both polarisations, which a path without polarisation takes anew at every interface.
    """
    squared = _far_cosine(cos_i, eta)
    q = root(larger(squared, 0.0))
    step, eta2 = (1.0 - eta) * (1.0 + eta), eta * eta
    across = step / larger((cos_i + q) * (cos_i + q), LEAST)
    along = eta2 * cos_i + q
    along = step * (1.0 - (eta2 + 1.0) * cos_i * cos_i) / larger(along * along, LEAST)
    return jnp.where(squared > 0.0, 0.5 * (across * across + along * along), jnp.where(step > 0.0, 1.0, 0.0))


def refract(direction: Vec3, normal: Vec3, eta) -> Vec3:
    """Return the direction of light that passes an interface, by Snell's law.

    ``direction`` arrives and ``normal`` points to the side that it comes from, as for ``reflect``. Under total internal
    reflection nothing passes: the result is then finite and of no meaning.
    """
    height = -dot(direction, normal)
    cos_i = larger(height, grazing())
    q = larger(root(larger(_far_cosine(cos_i, eta), 0.0)), eta * grazing())
    refracted = (direction + normal * ((1.0 - eta) * (1.0 + eta) / (cos_i + q) - (cos_i - height))) / eta
    # One Newton step to unit length: without it many passages add up their rounding errors.
    return refracted * (1.5 - 0.5 * dot(refracted, refracted))


def fresnel_conductor(cos_i, eta, k):
    """Return the share of light that a conductor of complex index eta + i k reflects, in [0, 1].

    Both are relative to the medium in front of it, and differ from channel to channel: call it for each. k = 0 is a
    dielectric, by ``fresnel_dielectric`` to rounding.
    """
    sin2 = (1.0 - cos_i) * (1.0 + cos_i)
    cos2 = cos_i * cos_i
    # a + i b is the root of (eta + i k)^2 - sin^2; the form of a^2 depends on the sign of its real part.
    real = _far_cosine(cos_i, eta) - k * k
    imaginary = 2.0 * eta * k
    size = root(real * real + imaginary * imaginary)
    positive = real > 0.0
    sum_ = larger(size + jnp.abs(real), LEAST)
    a2 = jnp.where(positive, 0.5 * sum_, 0.5 * imaginary * imaginary / sum_)
    twice = 2.0 * root(a2) * cos_i
    across = (size + cos2 - twice) / larger(size + cos2 + twice, LEAST)
    level, slope = cos2 * size + sin2 * sin2, twice * sin2
    return 0.5 * across * (1.0 + (level - slope) / larger(level + slope, LEAST))
