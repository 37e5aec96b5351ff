"""Scenes whose answer is known in closed form, so that error is measured against truth.

``ALL`` holds one default configuration of every scene; the functions make any other. See ``AnalyticScene`` for what
each one knows about itself.
"""

import functools

from analytic_scenes import (
    caps,
    genz,
    integrands,
    lights,
    lit_surfaces,
    mirror_balls,
    mirror_rooms,
    mirrors,
    occlusion,
    sensors,
    shadows,
    skies,
    sky_shares,
)
from analytic_scenes.caps import caps_irradiance, caps_overlap, parallelogram_caps, sphere_caps
from analytic_scenes.furnace import cube_furnace, furnace_moments, furnace_radiance, sphere_furnace
from analytic_scenes.irradiance import (
    corner_rectangle_irradiance,
    mirror_image,
    parallelogram_in_mirror_irradiance,
    parallelogram_irradiance,
    parallelogram_solid_angle,
    polygon_irradiance,
    rectangle_solid_angle,
    sphere_at_irradiance,
    sphere_in_mirror_irradiance,
    sphere_irradiance,
    standing_rectangle_irradiance,
)
from analytic_scenes.lights import light_solid_angle, rectangle_light, sphere_light
from analytic_scenes.lit_surfaces import ball_in_sunlight, ceiling_lamp, orb_over_floor, sphere_light_over_rectangle
from analytic_scenes.mirror_balls import mirror_ball_caustic, sphere_light_in_mirror_ball
from analytic_scenes.mirror_rooms import sphere_light_between_mirrors, sphere_light_in_corner
from analytic_scenes.mirrors import (
    rectangle_light_in_mirror,
    rectangle_light_in_small_mirror,
    sphere_light_in_mirror,
    sphere_light_in_small_mirror,
)
from analytic_scenes.occlusion import (
    open_beside_sphere,
    open_beside_sphere_within,
    open_beside_wall_within,
    open_in_corner_within,
    open_pixel_under_sphere,
    open_solid_angle_beside_sphere,
    open_under_rectangle,
    open_under_two_spheres,
)
from analytic_scenes.scene import AnalyticScene, value_and_derivatives
from analytic_scenes.shadows import (
    eclipsed_solid_angle,
    rectangle_behind_rectangle,
    rectangle_behind_sphere,
    sphere_behind_rectangle,
    sphere_behind_sphere,
)
from analytic_scenes.skies import ball_under_zonal_sky, disk_of_ball_under_zonal_sky, sphere_in_sky, tilted_under_sky
from analytic_scenes.throughput import critical_albedo, tail_index, throughput_product

FAMILIES = (lights, lit_surfaces, occlusion, skies, shadows, mirrors, mirror_rooms, mirror_balls)


def __getattr__(name: str):
    """Make ``ALL`` when it is first asked for: evaluating the closed forms takes seconds that an import should not."""
    if name != "ALL":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _all()


@functools.cache
def _all() -> tuple[AnalyticScene, ...]:
    """Return the default scenes. All have a relative variance below 8, most below 1."""
    return (
        cube_furnace(),
        cube_furnace(directions="uniform"),
        sphere_furnace(),
        sphere_furnace(directions="uniform"),
        *(scene for family in FAMILIES for scene in family.default_scenes()),
        throughput_product(),
    )


__all__ = [
    "ALL",
    "AnalyticScene",
    "ball_in_sunlight",
    "ball_under_zonal_sky",
    "caps",
    "caps_irradiance",
    "caps_overlap",
    "ceiling_lamp",
    "corner_rectangle_irradiance",
    "critical_albedo",
    "cube_furnace",
    "disk_of_ball_under_zonal_sky",
    "eclipsed_solid_angle",
    "furnace_moments",
    "furnace_radiance",
    "genz",
    "integrands",
    "light_solid_angle",
    "lights",
    "lit_surfaces",
    "mirror_ball_caustic",
    "mirror_balls",
    "mirror_image",
    "mirror_rooms",
    "mirrors",
    "occlusion",
    "open_beside_sphere",
    "open_beside_sphere_within",
    "open_beside_wall_within",
    "open_in_corner_within",
    "open_pixel_under_sphere",
    "open_solid_angle_beside_sphere",
    "open_under_rectangle",
    "open_under_two_spheres",
    "orb_over_floor",
    "parallelogram_caps",
    "parallelogram_in_mirror_irradiance",
    "parallelogram_irradiance",
    "parallelogram_solid_angle",
    "polygon_irradiance",
    "rectangle_behind_rectangle",
    "rectangle_behind_sphere",
    "rectangle_light",
    "rectangle_light_in_mirror",
    "rectangle_light_in_small_mirror",
    "rectangle_solid_angle",
    "sensors",
    "shadows",
    "skies",
    "sky_shares",
    "sphere_at_irradiance",
    "sphere_behind_rectangle",
    "sphere_behind_sphere",
    "sphere_caps",
    "sphere_furnace",
    "sphere_in_mirror_irradiance",
    "sphere_in_sky",
    "sphere_irradiance",
    "sphere_light",
    "sphere_light_between_mirrors",
    "sphere_light_in_corner",
    "sphere_light_in_mirror",
    "sphere_light_in_mirror_ball",
    "sphere_light_in_small_mirror",
    "sphere_light_over_rectangle",
    "standing_rectangle_irradiance",
    "tail_index",
    "throughput_product",
    "tilted_under_sky",
    "value_and_derivatives",
]
