"""Rough metal under a constant sky: what facets of the GGX distribution reflect once, with exact laws of one sample.

Facets reflect ``reflectance`` at every angle, ``alpha`` is their width. With directions="bsdf" normals are drawn among
those that are visible, a sample is reflectance times sky times G2 / G1, and all its moments are integrals over one
variable; with "cosine" and "uniform" only the mean is known. ``sky`` is a radiance [W/m^2/sr].
"""

import functools
import math

import jaxmc as mc
from analytic_scenes.furnace import looking_along
from analytic_scenes.ggx_values import average_moment, directional_albedo, sampled_moment
from analytic_scenes.laws import Law
from analytic_scenes.scene import AnalyticScene, closed_form_scene, value_of, variance_and_kurtosis

FLOOR = 1e4  # half the side of a floor; one part in 1e8 of the light at height 1 comes past it
SOURCE = "Heitz 2014; Kulla and Conty 2017; azimuth in closed form, the rest by quadrature"


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        rough_floor(),
        rough_floor(0.1, 0.8),
        rough_floor(0.5, 0.2, directions="cosine"),
        rough_floor_from_above(),
    )


def rough_floor_radiance(alpha, cosine, reflectance, sky):
    """Radiance of a rough floor along a ray at ``cosine`` to its normal."""
    return reflectance * sky * directional_albedo(alpha, cosine)


def rough_floor(
    alpha: float = 0.5, cosine: float = 0.5, reflectance: float = 0.8, sky: float = 2.0, *, directions: str = "bsdf"
) -> AnalyticScene:
    """Return the radiance of a floor of rough metal, seen at ``cosine`` in (0, 1] to its normal.

    Raises ``ValueError`` for another ``cosine``.
    """
    if not 0.0 < cosine <= 1.0:
        raise ValueError(f"cosine must be in (0, 1], got {cosine}")
    sine = math.sqrt((1.0 - cosine) * (1.0 + cosine))
    ray = (-sine, 0.0, cosine), (sine, 0.0, -cosine)
    scene = _floor(alpha, reflectance, sky)
    return closed_form_scene(
        f"rough metal floor, alpha {alpha:g}, cosine {cosine:g}, {directions} directions",
        rough_floor_radiance,
        {"alpha": alpha, "cosine": cosine, "reflectance": reflectance, "sky": sky},
        mc.radiance(scene, *ray, bounces=1, directions=directions, lights="none"),
        SOURCE,
        geometry="A floor of rough metal under a sky that is the same everywhere.",
        law=lambda _: _law(sampled_moment, reflectance * sky, directions, alpha=alpha, cosine=cosine),
        view=lambda: (scene, looking_along(*ray, fov=40.0)),
    )


def rough_floor_irradiance(alpha, reflectance, sky):
    """Irradiance on a receiver that looks straight down at a rough floor that fills all it sees."""
    return math.pi * reflectance * sky * average_moment(alpha)


def rough_floor_from_above(
    alpha: float = 0.3, reflectance: float = 0.8, sky: float = 2.0, *, directions: str = "bsdf"
) -> AnalyticScene:
    """Return the irradiance that a floor of rough metal throws up: the mean over all angles at which it is seen."""
    scene = _floor(alpha, reflectance, sky)
    return closed_form_scene(
        f"rough metal floor from above, {directions} directions",
        rough_floor_irradiance,
        {"alpha": alpha, "reflectance": reflectance, "sky": sky},
        mc.irradiance(scene, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), bounces=1, directions=directions, lights="none"),
        SOURCE,
        geometry="A floor of rough metal under a sky that is the same everywhere; the receiver looks down at it.",
        law=lambda _: _law(average_moment, math.pi * reflectance * sky, directions, alpha=alpha),
        view=lambda: (scene, looking_along((0.0, -2.0, 1.0), (0.0, 2.0, -1.0))),
        tolerance=1e-8,
    )


def _floor(alpha, reflectance, sky):
    floor = mc.Quad(
        (-FLOOR, -FLOOR, 0.0), (2 * FLOOR, 0.0, 0.0), (0.0, 2 * FLOOR, 0.0), mc.RoughConductor(alpha, reflectance)
    )
    return mc.Scene([floor], sky)


def _law(moment, scale, directions, **arguments):
    """Return the law of ``scale`` times the weight of sampling visible normals."""
    if directions != "bsdf":
        return None
    moments = [scale**k * value_of(_power(moment, k), arguments) for k in (1, 2, 3, 4)]
    return Law(*variance_and_kurtosis(moments))


@functools.cache
def _power(moment, k):
    """Return the same function for the same arguments, which is then compiled once."""
    return functools.partial(moment, power=k)
