"""Scenes whose answer is known in closed form, so that error is measured against truth.

``ALL`` holds the default configurations of every scene; the functions make any other. See ``AnalyticScene`` for what
each one knows about itself.
"""

import functools

from analytic_scenes import (
    caps,
    cavity,
    chains,
    coverage,
    enclosures,
    exchange,
    fresnel_values,
    furnace,
    genz,
    ggx_values,
    glass,
    integrands,
    integrating_sphere,
    lights,
    lit_surfaces,
    mirror_balls,
    mirror_rooms,
    mirrors,
    mollified,
    moving,
    occlusion,
    pixels,
    receivers,
    rough_lights,
    rough_metal,
    roulette,
    sensors,
    shadows,
    skies,
    sky_shares,
    throughput,
    view_factors,
)
from analytic_scenes.caps import caps_irradiance, caps_overlap, parallelogram_caps, sphere_caps
from analytic_scenes.checking import Check, check
from analytic_scenes.coverage import (
    disk_coverage,
    ellipse_coverage,
    half_plane_coverage,
    sphere_outline,
)
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
from analytic_scenes.furnace import cube_furnace, furnace_moments, furnace_radiance, furnace_variance, sphere_furnace
from analytic_scenes.glass import coated_floor, glass_ball, glass_plate, under_water
from analytic_scenes.integrating_sphere import lamp_in_sphere, lit_cap, smooth_wall
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
from analytic_scenes.lights import disk_light, light_solid_angle, rectangle_light, sphere_light
from analytic_scenes.lit_surfaces import ball_in_sunlight, ceiling_lamp, orb_over_floor, sphere_light_over_rectangle
from analytic_scenes.mirror_balls import mirror_ball_caustic, sphere_light_in_mirror_ball
from analytic_scenes.mirror_rooms import sphere_light_between_mirrors, sphere_light_in_corner
from analytic_scenes.mirrors import (
    rectangle_light_in_mirror,
    rectangle_light_in_small_mirror,
    sphere_light_in_mirror,
    sphere_light_in_small_mirror,
)
from analytic_scenes.mollified import cone_mirror, disk_mollifier
from analytic_scenes.names import find
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
from analytic_scenes.pixels import half_plane_pixel, sphere_pixel
from analytic_scenes.rough_lights import rough_metal_under
from analytic_scenes.rough_metal import rough_floor, rough_floor_from_above
from analytic_scenes.roulette import absorption_furnace, critical_roulette_albedo, path_length, roulette_furnace
from analytic_scenes.scene import AnalyticScene, value_and_derivatives
from analytic_scenes.shadows import (
    eclipsed_solid_angle,
    rectangle_behind_rectangle,
    rectangle_behind_sphere,
    sphere_behind_rectangle,
    sphere_behind_sphere,
)
from analytic_scenes.skies import ball_under_zonal_sky, disk_of_ball_under_zonal_sky, sphere_in_sky, tilted_under_sky
from analytic_scenes.throughput import (
    critical_albedo,
    log_throughput,
    path_sum,
    tail_index,
    throughput_exceedance,
    throughput_product,
    throughput_walk,
)

FAMILIES = (
    furnace, enclosures, integrating_sphere, exchange, lights, lit_surfaces, occlusion, skies, shadows, mirrors,
    mirror_rooms, mirror_balls, rough_metal, glass, throughput, roulette, pixels,
    mollified,
)  # fmt: skip


def __getattr__(name: str):
    """Make ``ALL`` when it is first asked for: evaluating the closed forms takes seconds that an import should not."""
    if name != "ALL":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _all()


@functools.cache
def _all() -> tuple[AnalyticScene, ...]:
    """Return the default scenes. All have a relative variance below 8, most below 1."""
    return tuple(scene for family in FAMILIES for scene in family.default_scenes())


__all__ = [
    "ALL",
    "AnalyticScene",
    "Check",
    "absorption_furnace",
    "ball_in_sunlight",
    "ball_under_sky",
    "ball_under_zonal_sky",
    "caps",
    "caps_irradiance",
    "caps_overlap",
    "cavity",
    "ceiling_lamp",
    "chains",
    "check",
    "coated_floor",
    "coaxial_disks",
    "concentric_spheres",
    "cone_mirror",
    "corner_rectangle_irradiance",
    "coverage",
    "critical_albedo",
    "critical_roulette_albedo",
    "cube_furnace",
    "disk_coverage",
    "disk_light",
    "disk_mollifier",
    "disk_of_ball_under_zonal_sky",
    "eclipsed_solid_angle",
    "ellipse_coverage",
    "enclosures",
    "exchange",
    "facing_rectangles",
    "find",
    "fresnel_values",
    "furnace",
    "furnace_moments",
    "furnace_radiance",
    "furnace_variance",
    "genz",
    "ggx_values",
    "glass",
    "glass_ball",
    "glass_plate",
    "half_plane_coverage",
    "half_plane_pixel",
    "inner_sphere",
    "integrands",
    "integrating_sphere",
    "kirchhoff_room",
    "lamp_in_sphere",
    "light_solid_angle",
    "lights",
    "lit_cap",
    "lit_surfaces",
    "log_throughput",
    "mirror_ball_caustic",
    "mirror_balls",
    "mirror_image",
    "mirror_rooms",
    "mirrors",
    "mollified",
    "moving",
    "occlusion",
    "offset_rectangles",
    "open_beside_sphere",
    "open_beside_sphere_within",
    "open_beside_wall_within",
    "open_in_corner_within",
    "open_pixel_under_sphere",
    "open_solid_angle_beside_sphere",
    "open_under_rectangle",
    "open_under_two_spheres",
    "opposite_caps",
    "orb_over_floor",
    "parallel_plates",
    "parallelogram_caps",
    "parallelogram_in_mirror_irradiance",
    "parallelogram_irradiance",
    "parallelogram_solid_angle",
    "path_length",
    "path_sum",
    "pixels",
    "polygon_irradiance",
    "receivers",
    "rectangle_behind_rectangle",
    "rectangle_behind_sphere",
    "rectangle_light",
    "rectangle_light_in_mirror",
    "rectangle_light_in_small_mirror",
    "rectangle_solid_angle",
    "rough_floor",
    "rough_floor_from_above",
    "rough_lights",
    "rough_metal",
    "rough_metal_under",
    "roulette",
    "roulette_furnace",
    "sensors",
    "shadows",
    "skies",
    "sky_shares",
    "smooth_wall",
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
    "sphere_outline",
    "sphere_over_disk",
    "sphere_pixel",
    "standing_rectangle",
    "standing_rectangle_irradiance",
    "tail_index",
    "throughput",
    "throughput_exceedance",
    "throughput_product",
    "throughput_walk",
    "tilted_under_sky",
    "two_spheres",
    "under_water",
    "value_and_derivatives",
    "view_factors",
]
