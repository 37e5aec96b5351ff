"""Scenes whose answer is known in closed form, so that error is measured against truth.

``ALL`` holds one default configuration of every scene; the functions make any other. See ``AnalyticScene`` for what
each one knows about itself.
"""

import functools
import math

from analytic_scenes import (
    cavity,
    chains,
    enclosures,
    exchange,
    furnace,
    genz,
    integrands,
    integrating_sphere,
    receivers,
    roulette,
    throughput,
    view_factors,
)
from analytic_scenes.checking import Check, check
from analytic_scenes.enclosures import ball_under_sky, concentric_spheres, kirchhoff_room, parallel_plates
from analytic_scenes.exchange import (
    coaxial_disks,
    facing_rectangles,
    inner_sphere,
    offset_rectangles,
    opposite_caps,
    sphere_over_disk,
    standing_rectangle,
    two_spheres,
)
from analytic_scenes.furnace import (
    cube_furnace,
    furnace_moments,
    furnace_radiance,
    furnace_variance,
    sphere_furnace,
)
from analytic_scenes.integrating_sphere import lamp_in_sphere, lit_cap, smooth_wall
from analytic_scenes.irradiance import (
    corner_rectangle_irradiance,
    mirror_image,
    parallelogram_in_mirror_irradiance,
    parallelogram_irradiance,
    polygon_irradiance,
    sphere_in_mirror_irradiance,
    sphere_irradiance,
    standing_rectangle_irradiance,
)
from analytic_scenes.lights import rectangle_light, rectangle_light_in_mirror, sphere_light, sphere_light_in_mirror
from analytic_scenes.names import find
from analytic_scenes.roulette import absorption_furnace, critical_roulette_albedo, path_length, roulette_furnace
from analytic_scenes.scene import AnalyticScene, value_and_derivatives
from analytic_scenes.throughput import (
    critical_albedo,
    log_throughput,
    tail_index,
    throughput_exceedance,
    throughput_product,
    throughput_walk,
)

FAMILIES = (furnace, enclosures, integrating_sphere, exchange, throughput, roulette)


def __getattr__(name: str):
    """Make ``ALL`` when it is first asked for: evaluating the closed forms takes seconds that an import should not."""
    if name != "ALL":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _all()


@functools.cache
def _all() -> tuple[AnalyticScene, ...]:
    """Return the default scenes. Most have a relative variance below 1: 1e8 samples reach a relative error of 1e-4."""
    wall = {"corner": (-4.0, -12.0, -2.0), "edge_u": (0.0, 24.0, 0.0), "edge_v": (20.0, 0.0, 11.0)}
    return (
        *(scene for family in FAMILIES for scene in family.default_scenes()),
        sphere_light(),
        sphere_light(radius=2.0 * math.sin(1.4), theta=0.3, lights="none"),
        rectangle_light(),
        rectangle_light(**wall, normal=(0.0, 0.0, 1.0), lights="none"),
        sphere_light_in_mirror(),
        rectangle_light_in_mirror(),
    )


__all__ = [
    "ALL",
    "AnalyticScene",
    "Check",
    "absorption_furnace",
    "ball_under_sky",
    "cavity",
    "chains",
    "check",
    "coaxial_disks",
    "concentric_spheres",
    "corner_rectangle_irradiance",
    "critical_albedo",
    "critical_roulette_albedo",
    "cube_furnace",
    "enclosures",
    "exchange",
    "facing_rectangles",
    "find",
    "furnace",
    "furnace_moments",
    "furnace_radiance",
    "furnace_variance",
    "genz",
    "inner_sphere",
    "integrands",
    "integrating_sphere",
    "kirchhoff_room",
    "lamp_in_sphere",
    "lit_cap",
    "log_throughput",
    "mirror_image",
    "offset_rectangles",
    "opposite_caps",
    "parallel_plates",
    "parallelogram_in_mirror_irradiance",
    "parallelogram_irradiance",
    "path_length",
    "polygon_irradiance",
    "receivers",
    "rectangle_light",
    "rectangle_light_in_mirror",
    "roulette",
    "roulette_furnace",
    "smooth_wall",
    "sphere_furnace",
    "sphere_in_mirror_irradiance",
    "sphere_irradiance",
    "sphere_light",
    "sphere_light_in_mirror",
    "sphere_over_disk",
    "standing_rectangle",
    "standing_rectangle_irradiance",
    "tail_index",
    "throughput",
    "throughput_exceedance",
    "throughput_product",
    "throughput_walk",
    "two_spheres",
    "value_and_derivatives",
    "view_factors",
]
