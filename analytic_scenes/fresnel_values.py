"""Closed forms of what smooth interfaces reflect: one, two in a slab, one over a diffuse base; glass, water and metal.

``ior`` is the index of refraction on the far side over that on the near side, ``theta`` [rad] the angle of incidence
to the normal. Light is not polarised, and an estimator that does not follow polarisation takes the mean of both at
every interface: closed forms of several interfaces do the same, where the name does not say otherwise.

All functions are written with ``jax.numpy``; ``jax.grad`` gives true derivatives.
"""

import jax.numpy as jnp
import numpy as np


def reflectance_across(ior, theta):
    """Reflectance of a dielectric for light polarised across the plane of incidence. Born & Wolf, section 1.5.2."""
    cos_i, cos_t = _cosines(ior, theta)
    return ((cos_i - ior * cos_t) / (cos_i + ior * cos_t)) ** 2


def reflectance_along(ior, theta):
    """Reflectance of a dielectric for light polarised in the plane of incidence. Born & Wolf, section 1.5.2."""
    cos_i, cos_t = _cosines(ior, theta)
    return ((ior * cos_i - cos_t) / (ior * cos_i + cos_t)) ** 2


def dielectric_reflectance(ior, theta):
    """Reflectance of a dielectric; below the critical angle where ``ior`` < 1."""
    return (reflectance_across(ior, theta) + reflectance_along(ior, theta)) / 2.0


def brewster_reflectance(ior):
    """Reflectance at Brewster's angle arctan(ior), at which none is polarised in the plane of incidence."""
    return ((ior**2 - 1.0) / (ior**2 + 1.0)) ** 2 / 2.0


def conductor_reflectance(eta, k, theta):
    """Reflectance of a conductor of index eta + i k. Born & Wolf, section 14.2."""
    cos_i, index2 = jnp.cos(theta), (eta + 1j * k) ** 2
    inside = jnp.sqrt(index2 - jnp.sin(theta) ** 2)
    across, along = (cos_i - inside) / (cos_i + inside), (index2 * cos_i - inside) / (index2 * cos_i + inside)
    return (jnp.abs(across) ** 2 + jnp.abs(along) ** 2) / 2.0


def diffuse_reflectance(ior):
    """Share of the light of a uniform sky that a dielectric with ``ior`` > 1 reflects.

    Near ior = 1 its terms cancel: the relative rounding error in float64 is 1e-14 at 1.3 and 1e-12 at 1.01.
    Source: Walsh, The reflection factor of a polished glass surface for diffused light (1926).
    """
    n, n2, n4 = ior, ior**2, ior**4
    value = 0.5 + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0) ** 2)
    value = value + n2 * (n2 - 1.0) ** 2 / (n2 + 1.0) ** 3 * jnp.log((n - 1.0) / (n + 1.0))
    value = value - 2.0 * n**3 * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n4 - 1.0))
    return value + 8.0 * n4 * (n4 + 1.0) / ((n2 + 1.0) * (n4 - 1.0) ** 2) * jnp.log(n)


def diffuse_internal_reflectance(ior):
    """The same from inside, total internal reflection included: 1 - (1 - R) / ior^2.

    Source: reciprocity; Duntley, The optical properties of diffusing materials (1942).
    """
    return 1.0 - (1.0 - diffuse_reflectance(ior)) / ior**2


def slab_reflectance(ior, theta, transmittance=1.0):
    """Reflectance of a plate of which one crossing lets ``transmittance`` pass: the sum over all reflections inside."""
    one = dielectric_reflectance(ior, theta)
    return one + (1.0 - one) ** 2 * one * transmittance**2 / (1.0 - (one * transmittance) ** 2)


def slab_transmittance(ior, theta, transmittance=1.0):
    """Transmittance of the same plate."""
    one = dielectric_reflectance(ior, theta)
    return (1.0 - one) ** 2 * transmittance / (1.0 - (one * transmittance) ** 2)


def polarised_slab_reflectance(ior, theta):
    """Reflectance of a clear plate inside which light keeps its polarisation, as in nature, not in most renderers."""
    across, along = reflectance_across(ior, theta), reflectance_along(ior, theta)
    return across / (1.0 + across) + along / (1.0 + along)


def diffuse_slab_reflectance(ior):
    """Share of the light of a uniform sky that a clear plate reflects, by 60 nodes of Gauss and Legendre's rule."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    # cos(theta) = t^2 makes the integrand smooth at grazing incidence.
    t = (nodes + 1.0) / 2.0
    return jnp.sum(2.0 * t**3 * weights * slab_reflectance(ior, jnp.arccos(t**2)))


def coated_albedo(ior, albedo):
    """Share of the light of a uniform sky that a diffuse base under a smooth dielectric reflects.

    Source: Saunderson, Calculation of the color of pigmented plastics (1942).
    """
    inside = diffuse_internal_reflectance(ior)
    outside = diffuse_reflectance(ior)
    return outside + (1.0 - outside) * (1.0 - inside) * albedo / (1.0 - inside * albedo)


def coated_directional_albedo(ior, albedo, theta):
    """The same for light from one direction."""
    one, inside = dielectric_reflectance(ior, theta), diffuse_internal_reflectance(ior)
    return one + (1.0 - one) * (1.0 - inside) * albedo / (1.0 - inside * albedo)


def schlick_reflectance(f0, theta):
    """Schlick's approximation f0 + (1 - f0) (1 - cos)^5."""
    return f0 + (1.0 - f0) * (1.0 - jnp.cos(theta)) ** 5


def diffuse_schlick_reflectance(f0):
    """Its mean under a uniform sky."""
    return (1.0 + 20.0 * f0) / 21.0


def irradiance_under_water(ior, radiance):
    """Irradiance [W/m^2] just below a flat surface under a uniform sky: Snell's window and nothing else.

    Radiance grows by ior^2 as light enters, and fills a solid angle as much smaller.
    """
    return jnp.pi * radiance * (1.0 - diffuse_reflectance(ior))


def ball_in_furnace_radiance(reflectance, events):
    """Radiance of a clear ball under a sky of radiance 1 if light is followed to ``events`` hits inside; else it is 1.

    By reversibility every hit inside reflects as much as the first one outside.
    """
    return 1.0 - (1.0 - reflectance) * reflectance**events


def _cosines(ior, theta):
    return jnp.cos(theta), jnp.sqrt(1.0 - (jnp.sin(theta) / ior) ** 2)
