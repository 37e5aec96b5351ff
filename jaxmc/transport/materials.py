"""Materials: what a user says of how a surface scatters. ``bsdfs`` says how that is computed."""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp

from .vec import Vec3

# Of a material: numbers that lie in a range, as (name, above, at most).
Ranges = ClassVar[tuple[tuple[str, float, float], ...]]


@dataclasses.dataclass(frozen=True)
class Diffuse:
    """A Lambertian surface, on both sides: it reflects ``albedo / pi`` per solid angle.

    Attributes:
        albedo: fraction of light reflected, in [0, 1]: a number or an RGB triple.
    """

    albedo: Any = 0.5
    ranges: Ranges = ()


@dataclasses.dataclass(frozen=True)
class Mirror:
    """A perfect mirror, on both sides.

    Attributes:
        reflectance: fraction of light reflected, in [0, 1]: a number or an RGB triple.
    """

    reflectance: Any = 1.0
    ranges: Ranges = ()


@dataclasses.dataclass(frozen=True)
class RoughConductor:
    """A rough metal, on both sides: microfacets of the GGX distribution, height-correlated masking, one reflection.

    Light that facets would reflect more than once is lost, as in most renderers: a white conductor of roughness 1
    reflects about half.

    Attributes:
        roughness: GGX's alpha, in (0, 1], not its square root; kept at 1e-3 or more.
        reflectance: of the facets, in [0, 1]: a number or an RGB triple. With ``eta`` a further factor.
        eta, k: real and imaginary part of the metal's index of refraction, numbers or RGB triples; None, both, for
            facets that reflect the same at all angles. With them Fresnel's equations hold.
    """

    roughness: Any = 0.1
    reflectance: Any = 1.0
    eta: Any = None
    k: Any = None
    ranges: Ranges = (("roughness", 0.0, 1.0),)

    def __post_init__(self):
        if (self.eta is None) != (self.k is None):
            raise ValueError(f"a metal has both eta and k, or neither, got eta={self.eta!r} and k={self.k!r}")


@dataclasses.dataclass(frozen=True)
class Dielectric:
    """A smooth interface to glass or water: it reflects by Fresnel's equations and refracts the rest.

    The medium lies behind the surface, where its normal points away from: inside a sphere or a box, beneath a quad.
    Outside is vacuum. Radiance changes by the square of the index on the way.

    Attributes:
        ior: index of refraction of the medium, above 0; below 1 for a bubble.
    """

    ior: Any = 1.5
    ranges: Ranges = (("ior", 0.0, 100.0),)


Material = Diffuse | Mirror | RoughConductor | Dielectric


def colors_of(material: Material) -> dict[str, Any]:
    """Return the fractions of light that a material reflects, by name: one, or none for a dielectric."""
    if isinstance(material, Dielectric):
        return {}
    return {"albedo": material.albedo} if isinstance(material, Diffuse) else {"reflectance": material.reflectance}


def luminance(rgb):
    """Return the luminance of linear RGB values with the channels on the last axis (ITU-R BT.709), or the value itself
    where it has no channels.
    """
    if isinstance(rgb, Vec3):
        return 0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z
    return rgb if jnp.shape(rgb)[-1:] != (3,) else 0.2126 * rgb[..., 0] + 0.7152 * rgb[..., 1] + 0.0722 * rgb[..., 2]
