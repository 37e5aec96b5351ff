"""Scenes whose answer is known in closed form, so that error is measured against truth.

``ALL`` holds one default configuration of every scene; the functions make any other. See ``AnalyticScene`` for what
each one knows about itself.
"""

import functools
import math

from analytic_scenes import genz, integrands
from analytic_scenes.checking import Check, check
from analytic_scenes.furnace import cube_furnace, furnace_moments, furnace_radiance, sphere_furnace
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
from analytic_scenes.scene import AnalyticScene, value_and_derivatives
from analytic_scenes.throughput import critical_albedo, tail_index, throughput_product


def __getattr__(name: str):
    """Make ``ALL`` when it is first asked for: evaluating the closed forms takes seconds that an import should not."""
    if name != "ALL":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _all()


@functools.cache
def _all() -> tuple[AnalyticScene, ...]:
    """Return the default scenes. All have a relative variance below 1: 1e8 samples reach a relative error of 1e-4."""
    wall = {"corner": (-4.0, -12.0, -2.0), "edge_u": (0.0, 24.0, 0.0), "edge_v": (20.0, 0.0, 11.0)}
    return (
        cube_furnace(),
        cube_furnace(directions="uniform"),
        sphere_furnace(),
        sphere_furnace(directions="uniform"),
        sphere_light(),
        sphere_light(radius=2.0 * math.sin(1.4), theta=0.3, lights="none"),
        rectangle_light(),
        rectangle_light(**wall, normal=(0.0, 0.0, 1.0), lights="none"),
        sphere_light_in_mirror(),
        rectangle_light_in_mirror(),
        throughput_product(),
    )


__all__ = [
    "ALL",
    "AnalyticScene",
    "Check",
    "check",
    "corner_rectangle_irradiance",
    "critical_albedo",
    "cube_furnace",
    "find",
    "furnace_moments",
    "furnace_radiance",
    "genz",
    "integrands",
    "mirror_image",
    "parallelogram_in_mirror_irradiance",
    "parallelogram_irradiance",
    "polygon_irradiance",
    "rectangle_light",
    "rectangle_light_in_mirror",
    "sphere_furnace",
    "sphere_in_mirror_irradiance",
    "sphere_irradiance",
    "sphere_light",
    "sphere_light_in_mirror",
    "standing_rectangle_irradiance",
    "tail_index",
    "throughput_product",
    "value_and_derivatives",
]
