"""What a rough metal reflects of three distant lights, with its derivative by roughness: quadrature in float64.

The surface faces +z; facets reflect everything, GGX with Smith's masking, heights correlated. Light of radiance 1 comes
from all sides ("constant"), from a smooth lobe ("lobe") or from a disk ("disk"), both ``OFFSET`` beside the mirror
direction; it is seen at ``VIEW`` from the normal. The derivative is that of the value in each direction, so that
nothing moves and no edge matters.
"""

import functools
from typing import NamedTuple

import numpy as np

VIEW = np.pi / 4.0
OFFSET = 0.15  # beyond the mirror direction, away from the normal
SHARPNESS = 30.0  # of the lobe exp(SHARPNESS (cos - 1)): half of it lies within 12 degrees, 84 % within 20
HALF_ANGLE = np.radians(5.0)  # of the disk
ALONG, AROUND = 600, 300  # nodes
TINY = 1e-30


class Reflected(NamedTuple):
    """Radiance, its derivative by roughness, and the variance of one sample of the likelihood ratio estimator of that
    derivative when facets are drawn by their density; accurate to 3e-4 of each, most to 1e-6.
    """

    value: float
    derivative: float
    score_variance: float


@functools.cache
def rough_metal_under(light: str, alpha: float) -> Reflected:
    """Return what is known of one light, "constant", "lobe" or "disk", at roughness ``alpha``."""
    if light not in ("constant", "lobe", "disk"):
        raise ValueError(f"light must be constant, lobe or disk, got {light!r}")
    wi, weight = _disk() if light == "disk" else _by_facets(alpha)
    brdf = _brdf_cosine(wi, complex(alpha, TINY))  # the imaginary part is the derivative, without cancellation
    radiance = np.exp(SHARPNESS * (wi @ light_direction() - 1.0)) if light == "lobe" else 1.0
    value, change = brdf.real * radiance, brdf.imag / TINY * radiance
    derivative = float((weight * change).sum())
    pdf = _pdf_of_facets(wi, alpha)
    second = float((weight * np.where(wi[..., 2] > 0.0, change**2 / pdf, 0.0)).sum())
    return Reflected(float((weight * value).sum()), derivative, second - derivative**2)


def viewer() -> np.ndarray:
    """Return the direction toward the viewer."""
    return np.array([np.sin(VIEW), 0.0, np.cos(VIEW)])


def light_direction() -> np.ndarray:
    """Return the direction toward the middle of the lobe and of the disk."""
    return np.array([-np.sin(VIEW + OFFSET), 0.0, np.cos(VIEW + OFFSET)])


def _disk():
    """Return directions on the disk and their weights, by Gauss and Legendre's rule along the radius."""
    node, weight = np.polynomial.legendre.leggauss(64)
    theta, weight = 0.5 * HALF_ANGLE * (node + 1.0), 0.5 * HALF_ANGLE * weight
    phi = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    axis = light_direction()
    across, up = np.array([0.0, 1.0, 0.0]), np.cross(axis, [0.0, 1.0, 0.0])
    around = np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * up
    wi = np.cos(theta)[:, None, None] * axis + np.sin(theta)[:, None, None] * around
    return wi, np.broadcast_to((weight * np.sin(theta) * 2.0 * np.pi / 64)[:, None], wi.shape[:2])


def _by_facets(alpha):
    """Return directions reflected by facets whose density is that of GGX, and their weights."""
    node, weight = np.polynomial.legendre.leggauss(ALONG)
    share, weight = 0.5 * (node + 1.0), 0.5 * weight
    tangent = alpha * np.sqrt(share / (1.0 - share))
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    phi = np.pi * (np.arange(AROUND) + 0.5) / AROUND  # half a turn: the other half is its image
    half = np.stack(
        [np.outer(tangent * cosine, np.cos(phi)), np.outer(tangent * cosine, np.sin(phi)),
         np.broadcast_to(cosine[:, None], (ALONG, AROUND))], axis=-1,
    )  # fmt: skip
    facing = half @ viewer()
    wi = 2.0 * facing[..., None] * half - viewer()
    seen = (facing > 0.0) & (wi[..., 2] > 0.0)
    pdf = np.where(seen, _pdf_of_facets(wi, alpha), 1.0)
    return wi, np.where(seen, weight[:, None] / AROUND / pdf, 0.0)


def _squared_cosine(wi):
    half = wi + viewer()
    return half[..., 2] ** 2 / (half**2).sum(-1)


def _density(squared, alpha):
    return alpha**2 / (np.pi * (squared * (alpha**2 - 1.0) + 1.0) ** 2)


def _pdf_of_facets(wi, alpha):
    """Return the density per solid angle of ``wi``, whose facet is drawn by D cos(h)."""
    squared = _squared_cosine(wi)
    facing = np.sqrt(np.maximum(0.5 * (1.0 + wi @ viewer()), 1e-12))
    return _density(squared, alpha) * np.sqrt(squared) / (4.0 * facing)


def _brdf_cosine(wi, alpha):
    """Return BRDF times cosine: D G / (4 cos_o); Walter et al. (2007), Heitz (2014)."""
    up = np.where(wi[..., 2] > 0.0, wi[..., 2], 1.0)
    masked = 1.0 + _hidden(np.cos(VIEW), alpha) + _hidden(up, alpha)
    return np.where(wi[..., 2] > 0.0, _density(_squared_cosine(wi), alpha) / (masked * 4.0 * np.cos(VIEW)), 0.0)


def _hidden(cosine, alpha):
    """Return Smith's Lambda."""
    return 0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 - cosine**2) / cosine**2) - 1.0)
