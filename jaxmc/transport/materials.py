"""Materials: how a surface scatters. Written for one vertex, in world directions that leave the surface."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from .vec import Vec3, dot, frame, larger
from .warps import (
    grazing,
    pdf_cosine_hemisphere,
    pdf_uniform_hemisphere,
    sample_cosine_hemisphere,
    sample_uniform_hemisphere,
)


@dataclasses.dataclass(frozen=True)
class Diffuse:
    """A Lambertian surface, on both sides: it reflects ``albedo / pi`` per solid angle.

    Attributes:
        albedo: fraction of light reflected, in [0, 1]: a number or an RGB triple.
    """

    albedo: Any = 0.5


@dataclasses.dataclass(frozen=True)
class Mirror:
    """A perfect mirror, on both sides.

    Attributes:
        reflectance: fraction of light reflected, in [0, 1]: a number or an RGB triple.
    """

    reflectance: Any = 1.0


def sample_diffuse(directions: str, normal: Vec3, u1, u2):
    """Return (wi, density of wi per solid angle, weight).

    ``weight`` is BRDF times cosine over density for albedo 1: exactly 1 for ``directions="cosine"``, 2 cos(theta)
    for ``"uniform"``.
    """
    if directions == "cosine":
        local = sample_cosine_hemisphere(u1, u2)
        pdf, weight = pdf_cosine_hemisphere(local.z), 1.0
    else:
        local = sample_uniform_hemisphere(u1, u2)
        pdf, weight = pdf_uniform_hemisphere(), 2.0 * local.z
    tangent, bitangent = frame(normal)
    return tangent * local.x + bitangent * local.y + normal * local.z, pdf, weight


def pdf_diffuse(directions: str, cos_theta):
    """Return the density per solid angle with which ``sample_diffuse`` draws a direction at ``cos_theta``."""
    return pdf_cosine_hemisphere(cos_theta) if directions == "cosine" else pdf_uniform_hemisphere()


def reflect(direction: Vec3, normal: Vec3) -> Vec3:
    """Return ``direction`` reflected by a plane with unit normal ``normal`` on the side that it comes from."""
    reflected = direction + normal * (2.0 * larger(-dot(direction, normal), grazing()))
    # One Newton step to unit length: without it many reflections add up their rounding errors.
    return reflected * (1.5 - 0.5 * dot(reflected, reflected))


def power_heuristic(inverse_pdf, other_pdf):
    """Return p^2 / (p^2 + q^2) for p = 1 / ``inverse_pdf`` and q = ``other_pdf`` (Veach 1997).

    In terms of the ratio q / p it cannot overflow: an infinite ratio gives 0.
    """
    ratio = inverse_pdf * other_pdf
    return 1.0 / (1.0 + ratio * ratio)


@jax.custom_jvp
def weight_of_hit(pdf, inverse_light_pdf):
    """Return the power heuristic of density ``pdf`` against sampling a light: 0, with derivative 0, where the light
    cannot be sampled and ``inverse_light_pdf`` is 0.
    """
    return power_heuristic(1.0 / pdf, 1.0 / inverse_light_pdf)


@weight_of_hit.defjvp
def _weight_derivative(densities, tangents):
    pdf, inverse = densities
    weight = weight_of_hit(pdf, inverse)
    inverse = jnp.where(inverse > 0.0, 1.0 / inverse, 0.0)
    relative = tangents[0] / pdf + tangents[1] * inverse
    return weight, 2.0 * weight * (1.0 - weight) * relative


def luminance(rgb):
    """Return the luminance of linear RGB values with the channels on the last axis (ITU-R BT.709), or the value itself
    where it has no channels.
    """
    if isinstance(rgb, Vec3):
        return 0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z
    return rgb if jnp.shape(rgb)[-1:] != (3,) else 0.2126 * rgb[..., 0] + 0.7152 * rgb[..., 1] + 0.0722 * rgb[..., 2]
