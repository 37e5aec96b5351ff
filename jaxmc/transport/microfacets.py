"""Rough surfaces as GGX (Trowbridge and Reitz) microfacets: density of normals, Smith's masking, sampling.

Directions are unit vectors in the local frame whose z axis is the surface normal; ``wo`` and ``wi`` both leave the
surface. ``alpha`` is the width of the distribution of slopes, in (0, 1], as in pbrt and Mitsuba. The reflectance of a
facet is 1 here: multiply by the Fresnel factor or by a colour.

Rounding. A direction in float32 is known to 1e-7, so the normal h between two directions to 1e-7 / (wo . h), and that
must be small beside alpha: the relative error of ``pdf_ggx`` and ``eval_ggx`` is below 1.5e-7 / (alpha (wo . h)), and
a tenth of that in the median. So alpha = 0.001 is accurate to 2e-4 from above, and to 4e-3 at 89 degrees. What
``sample_ggx`` returns comes from the facet that it drew: 6e-6 at any alpha and angle. In float64 all is 2e-9 of that.

Sources: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces"; Heitz 2014, "Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs"; Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with
Spherical Caps".
"""

import jax.numpy as jnp
import numpy as np

from .vec import Vec3, dot, larger, where
from .warps import grazing, sincos_2pi, turn


def ggx_density(h: Vec3, alpha):
    """Return facet area per surface area and solid angle of normals, at ``h``, a vector of any length.

    Times h.z / |h| this density integrates to 1 over the hemisphere. It is 0 at and below the horizon. It takes the
    vector, not its cosine: in 1 - cos^2 the digits that matter for a small ``alpha`` are lost.
    """
    above = h.z > 0.0
    spread = where(above, h.x * h.x + h.y * h.y + (alpha * h.z) * (alpha * h.z), 1.0)
    peak = alpha * dot(h, h) / spread
    return jnp.where(above, peak * peak * (1.0 / np.pi), 0.0)


def _stretched(cosine, alpha):
    """Return the length of a direction whose part along the surface is shrunk by ``alpha``."""
    return jnp.sqrt(cosine * cosine + alpha * alpha * ((1.0 - cosine) * (1.0 + cosine)))


def smith_lambda(cosine, alpha):
    """Return Smith's Lambda, masked over visible facet area, for a direction at ``cosine`` > 0 to the normal."""
    sine2 = (1.0 - cosine) * (1.0 + cosine)
    return alpha * alpha * sine2 / (2.0 * cosine * (cosine + _stretched(cosine, alpha)))


def smith_g1(cosine, alpha):
    """Return the share of facets that is visible from a direction at ``cosine`` >= 0: 1 / (1 + Lambda)."""
    return 2.0 * cosine / (cosine + _stretched(cosine, alpha))


def smith_g2(cos_o, cos_i, alpha):
    """Return the share of facets visible from both directions, heights correlated: 1 / (1 + Lambda_o + Lambda_i)."""
    return 2.0 * cos_o * cos_i / (cos_i * _stretched(cos_o, alpha) + cos_o * _stretched(cos_i, alpha))


def sample_ggx(wo: Vec3, alpha, u1, u2):
    """Return (wi, density of wi per solid angle, weight): ``wo`` reflected by a facet drawn among those that it sees.

    ``weight`` is BRDF times cosine over density, G2 / G1, in [0, 1]. Some facets reflect below the surface: such a
    ``wi`` weighs 0, and so does one closer to the surface than ``grazing()``. They are drawn nevertheless, and the
    density, always positive, says how often. ``wo.z`` > 0. The derivatives go through ``wi`` as well as the weight.
    """
    # Stretch the surface so that its facets become a hemisphere, and draw on the cap that reflects ``wo`` upward.
    stretch = jnp.sqrt(1.0 / (alpha * alpha * (wo.x * wo.x + wo.y * wo.y) + wo.z * wo.z))
    x, y, z = wo.x * alpha * stretch, wo.y * alpha * stretch, wo.z * stretch
    up = (1.0 - u2) * (1.0 + z)
    # 1 - z of the cap's point is u2 (1 + z), 1 + z is up + 1 - z: neither loses digits where it is small.
    radius = _root_or_zero(u2 * (1.0 + z) * (up + (x * x + y * y) / (1.0 + z)))
    sine, cosine = sincos_2pi(u1)
    middle = Vec3(radius * cosine + x, radius * sine + y, up)

    # Undo the stretch: the normal of the facet, and the reflection by it.
    h = Vec3(alpha * middle.x, alpha * middle.y, middle.z)
    squared = dot(h, h)
    wi = h * (2.0 * dot(wo, h) / squared) - wo
    # One Newton step to unit length: without it many reflections add up their rounding errors.
    wi = wi * (1.5 - 0.5 * dot(wi, wi))

    peak = squared / dot(middle, middle)
    pdf = peak * peak * (0.5 / np.pi) / (alpha * alpha * (wo.z + _stretched(wo.z, alpha)))
    return wi, pdf, jnp.where(wi.z > grazing(), _weight(wo.z, larger(wi.z, grazing()), alpha), 0.0)


def ggx_coordinates(wo: Vec3, wi: Vec3, alpha):
    """Return the (u1, u2) that ``sample_ggx`` maps to ``wi``; both directions are above the surface."""
    stretched = Vec3(alpha * wo.x, alpha * wo.y, wo.z)
    stretched = stretched * (1.0 / jnp.sqrt(dot(stretched, stretched)))
    facet = Vec3((wo.x + wi.x) / alpha, (wo.y + wi.y) / alpha, wo.z + wi.z)
    middle = facet * (2.0 * dot(stretched, facet) / dot(facet, facet))
    u2 = jnp.clip(1.0 - middle.z / (1.0 + stretched.z), 0.0, 1.0)
    return turn(middle.y - stretched.y, middle.x - stretched.x), u2


def _weight(cos_o, cos_i, alpha):
    """Return G2 / G1."""
    stretched = _stretched(cos_o, alpha)
    return cos_i * (cos_o + stretched) / (cos_i * stretched + cos_o * _stretched(cos_i, alpha))


def _root_or_zero(x):
    """Return the square root, 0 with derivative 0 where rounding or u2 = 0 leaves nothing."""
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def pdf_ggx(wo: Vec3, wi: Vec3, alpha):
    """Return the density per solid angle with which ``sample_ggx`` draws ``wi``, of which some go below the surface.

    It integrates to 1 over the sphere of directions: G1 D / (4 cos_o). 0 where ``wo.z`` <= 0.
    """
    density = ggx_density(wo + wi, alpha)
    cosine = larger(wo.z, 0.0)
    return jnp.where(wo.z > 0.0, 0.5 * density / (cosine + _stretched(cosine, alpha)), 0.0)


def eval_ggx(wo: Vec3, wi: Vec3, alpha):
    """Return BRDF times the cosine of ``wi`` [1/sr]: D G2 / (4 cos_o); 0 where either goes below the surface."""
    above = (wo.z > 0.0) & (wi.z > 0.0)
    cos_o, cos_i = jnp.where(above, wo.z, 1.0), jnp.where(above, wi.z, 1.0)
    pair = cos_i * _stretched(cos_o, alpha) + cos_o * _stretched(cos_i, alpha)
    return jnp.where(above, 0.5 * cos_i * ggx_density(wo + wi, alpha) / pair, 0.0)
