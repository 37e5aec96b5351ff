"""How surfaces scatter, for one vertex: ``arriving`` is the direction in which the path from the viewer arrives.

Only the materials that a scene has are computed. Colour is left to ``Surface.reflectance``, which every material
multiplies; only Fresnel's equations for a metal differ from channel to channel.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .derivatives import drawn_with
from .fresnel import fresnel_conductor, fresnel_dielectric, refract
from .hits import Surface, at
from .lookups import is_among
from .microfacets import eval_ggx, ggx_coordinates, pdf_ggx, sample_ggx
from .vec import Vec3, dot, frame, larger, where
from .warps import (
    cosine_hemisphere_coordinates,
    grazing,
    is_in_cone,
    pdf_cone,
    pdf_cosine_hemisphere,
    pdf_uniform_hemisphere,
    sample_cone,
    sample_cosine_hemisphere,
    sample_uniform_hemisphere,
    uniform_hemisphere_coordinates,
)


class Kinds(NamedTuple):
    """What a surface is made of: a flag for each material that the scene has, None for one that it lacks.

    ``cone``: a mirror that reflects into a cone, of half-angle ``scene.blur``. ``alpha``: roughness where it is rough.
    """

    mirror: Any
    rough: Any
    metal: Any
    dielectric: Any
    alpha: Any = None
    cone: Any = None

    @property
    def specular(self):
        """Whether the surface scatters into single directions, which sampling lights cannot serve."""
        flags = [flag for flag in (self.mirror, self.dielectric) if flag is not None]
        return (flags[0] | flags[1] if len(flags) > 1 else flags[0]) if flags else None


def kinds_of(scene, surface: Surface) -> Kinds:
    """Return what a surface is made of."""
    groups = (scene.mirrors, scene.rough, scene.metals, scene.dielectrics)
    flags = (is_among(faces, surface.face, scene.size) if faces else None for faces in groups)
    return Kinds(*flags, at(scene.alpha, surface.face) if scene.rough else None)


class BsdfSample(NamedTuple):
    """A direction, its density per solid angle, and BRDF times cosine over density, reflectance left out."""

    wi: Vec3
    pdf: Any
    weight: Any


def sample_bsdf(scene, directions: str, surface: Surface, kinds: Kinds, arriving: Vec3, u1, u2) -> BsdfSample:
    """Sample a direction to scatter into: of the material where ``directions`` is "bsdf", else "cosine" or "uniform" on
    all surfaces that are not specular.
    """
    tangent, bitangent = frame(surface.normal)
    local, pdf, weight = _sample_hemisphere(directions, u1, u2)
    metallic = None
    if kinds.rough is not None:
        alpha = kinds.alpha
        local_wo = _viewer(arriving, tangent, bitangent, surface.normal)
        if directions == "bsdf":
            facet = sample_ggx(local_wo, _drawing(scene, alpha), u1, u2)
            if scene.blur is not None:
                facet = (*facet[:2], weight_by_value(facet[2], local_wo, facet[0], alpha))
            local, pdf, weight = (where(kinds.rough, a, b) for a, b in zip(facet, (local, pdf, weight), strict=True))
        else:
            weight = jnp.where(kinds.rough, eval_ggx(local_wo, local, alpha) / pdf, weight)
        metallic = _metal(scene, surface, kinds, local_wo, local)
    wi = tangent * local.x + bitangent * local.y + surface.normal * local.z
    if kinds.mirror is not None:
        wi = where(kinds.mirror, reflect(arriving, surface.normal), wi)
        weight = jnp.where(kinds.mirror, 1.0, weight)
    if kinds.cone is not None:
        cone = sample_cone(reflect(arriving, surface.normal), scene.blur, u1, u2)
        wi, pdf = where(kinds.cone, cone, wi), jnp.where(kinds.cone, pdf_cone(scene.blur), pdf)
        weight = jnp.where(kinds.cone, jnp.where(dot(cone, surface.normal) > grazing(), 1.0, 0.0), weight)
    if scene.dielectrics:
        # What is no glass must not turn derivatives to NaN.
        ior = jnp.where(kinds.dielectric, at(scene.ior, surface.face), 1.5)
        through, factor = _sample_dielectric(ior, surface, arriving, u1)
        wi = where(kinds.dielectric, through, wi)
        weight = jnp.where(kinds.dielectric, factor, weight)
    return BsdfSample(wi, pdf, weight if metallic is None else metallic * weight)


def _sample_hemisphere(directions, u1, u2):
    """Return (local direction, density per solid angle, weight of a white diffuse surface: 1, or 2 cos(theta))."""
    if directions == "uniform":
        local = sample_uniform_hemisphere(u1, u2)
        return local, pdf_uniform_hemisphere(), 2.0 * local.z
    local = sample_cosine_hemisphere(u1, u2)
    return local, pdf_cosine_hemisphere(local.z), 1.0


def bsdf_coordinates(scene, directions: str, surface: Surface, kinds: Kinds, arriving: Vec3, wi: Vec3):
    """Return the (u1, u2) that ``sample_bsdf`` maps to a direction above a surface that is not specular."""
    tangent, bitangent = frame(surface.normal)
    local = Vec3(dot(wi, tangent), dot(wi, bitangent), dot(wi, surface.normal))
    pair = (uniform_hemisphere_coordinates if directions == "uniform" else cosine_hemisphere_coordinates)(local)
    if kinds.rough is None or directions != "bsdf":
        return pair
    wo = _viewer(arriving, tangent, bitangent, surface.normal)
    facet = ggx_coordinates(wo, local, _drawing(scene, kinds.alpha))
    return tuple(jnp.where(kinds.rough, a, b) for a, b in zip(facet, pair))


def sample_diffuse(directions: str, normal: Vec3, u1, u2):
    """Return (wi, density of wi per solid angle, weight) of a diffuse surface.

    ``weight`` is BRDF times cosine over density for albedo 1: exactly 1 for "cosine" and "bsdf", 2 cos(theta) for
    "uniform".
    """
    local, pdf, weight = _sample_hemisphere(directions, u1, u2)
    tangent, bitangent = frame(normal)
    return tangent * local.x + bitangent * local.y + normal * local.z, pdf, weight


def pdf_diffuse(directions: str, cos_theta):
    """Return the density per solid angle with which ``sample_diffuse`` draws a direction at ``cos_theta``."""
    return pdf_uniform_hemisphere() if directions == "uniform" else pdf_cosine_hemisphere(cos_theta)


def evaluate_bsdf(scene, directions: str, surface: Surface, kinds: Kinds, arriving: Vec3, wi: Vec3, cosine):
    """Return pi times BRDF times cosine, reflectance left out, and the density per solid angle of ``sample_bsdf``.

    ``cosine`` is that of ``wi`` with the normal. Specular surfaces are evaluated as diffuse ones: mask them.
    """
    value, pdf = cosine, pdf_diffuse(directions, cosine)
    if kinds.cone is not None:
        inside = jnp.where(is_in_cone(wi, reflect(arriving, surface.normal), scene.blur), pdf_cone(scene.blur), 0.0)
        value, pdf = jnp.where(kinds.cone, jnp.pi * inside, value), jnp.where(kinds.cone, inside, pdf)
    if kinds.rough is None:
        return value, pdf
    alpha = kinds.alpha
    tangent, bitangent = frame(surface.normal)
    local_wo = _viewer(arriving, tangent, bitangent, surface.normal)
    local = Vec3(dot(wi, tangent), dot(wi, bitangent), cosine)
    value = jnp.where(kinds.rough, jnp.pi * eval_ggx(local_wo, local, alpha), value)
    if directions == "bsdf":
        pdf = jnp.where(kinds.rough, pdf_ggx(local_wo, local, _drawing(scene, alpha)), pdf)
    metallic = _metal(scene, surface, kinds, local_wo, local)
    return (value if metallic is None else metallic * value), pdf


def _drawing(scene, alpha):
    """Return the roughness to draw with: where it comes from a regularization, without its derivative."""
    return alpha if scene.blur is None else lax.stop_gradient(alpha)


@jax.custom_jvp
def weight_by_value(weight, wo, wi, alpha):
    """Return the weight of a direction that stays where it is while ``alpha`` moves: with it moves the value alone."""
    return weight


@weight_by_value.defjvp
def _value_derivative(primals, tangents):
    weight, wo, wi, alpha = primals
    value, change = jax.jvp(lambda a: eval_ggx(wo, wi, a), (alpha,), (tangents[3],))
    shown = value > 0.0
    return weight, tangents[0] + weight * jnp.where(shown, change / jnp.where(shown, value, 1.0), 0.0)


def _viewer(arriving, tangent, bitangent, normal):
    """Return the direction toward the viewer in the local frame, above the surface."""
    return Vec3(-dot(arriving, tangent), -dot(arriving, bitangent), larger(-dot(arriving, normal), grazing()))


def _metal(scene, surface, kinds, wo, wi):
    """Return Fresnel's factor of facets that reflect ``wo`` into ``wi``, 1 where the surface is no metal."""
    if not scene.metals:
        return None
    half = wo + wi
    cosine = jnp.sqrt(jnp.clip(0.25 * dot(half, half), 0.0, 1.0))  # of half the angle between the two
    eta, k = at(scene.metal, surface.face)
    if scene.channels == 1:
        return jnp.where(kinds.metal, fresnel_conductor(cosine, eta, k), 1.0)
    return Vec3(*(jnp.where(kinds.metal, fresnel_conductor(cosine, e, a), 1.0) for e, a in zip(eta, k)))


def _sample_dielectric(ior, surface, arriving, u):
    """Return the direction reflected with the probability that Fresnel's equations give, else refracted, and what that
    multiplies radiance by: the squared ratio of the indices where light passes.
    """
    eta = jnp.where(surface.behind, 1.0 / ior, ior)
    reflectance = fresnel_dielectric(jnp.clip(-dot(arriving, surface.normal), 0.0, 1.0), eta)
    reflects = u < reflectance
    wi = where(reflects, reflect(arriving, surface.normal), refract(arriving, surface.normal, eta))
    share = drawn_with(jnp.where(reflects, reflectance, 1.0 - reflectance))
    return wi, jnp.where(reflects, 1.0, 1.0 / (eta * eta)) * share


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
