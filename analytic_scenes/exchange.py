"""Light exchanged between two surfaces: the irradiance on a receiver of some extent, in the mean over its area.

Two more coordinates pick the point of the receiver. Emission is a radiance; with the default of 1/pi the mean
irradiance is the view factor. With lights="none" directions are cosine-distributed and a sample is pi Le where its ray
meets the light, else 0, so variance and kurtosis are exact; with "nee" and "mis" only the mean is. Receivers are no
part of their scene: they reflect nothing and cast no shadow.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import sensors, view_factors
from analytic_scenes.furnace import looking_along
from analytic_scenes.integrating_sphere import cap_share
from analytic_scenes.laws import Law
from analytic_scenes.receivers import cap_to_cap, disk_to_disk, on_disk, on_sphere
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis
from analytic_scenes.sensors import on_parallelogram

WHITE = 1.0 / math.pi  # the radiance of a surface that emits 1 W/m^2
BLACK = mc.Diffuse(0.0)
SOURCE = "Howell, A catalog of radiation heat transfer configuration factors, "


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1; that of the two spheres is 4."""
    return (
        facing_rectangles(),
        facing_rectangles(1.0, 1.0, 1.0, lights="nee"),
        standing_rectangle(),
        offset_rectangles(),
        coaxial_disks(),
        two_spheres(),
        sphere_over_disk(),
        inner_sphere(),
        opposite_caps(),
    )


def facing_rectangles(
    width: float = 2.0, depth: float = 1.0, distance: float = 0.5, emission: float = WHITE, *, lights: str = "none"
) -> AnalyticScene:
    """Return the mean irradiance on a rectangle from an equal one straight above it, at ``distance``."""
    half = (-width / 2, -depth / 2)
    light = mc.Quad((*half, distance), (0.0, depth, 0.0), (width, 0.0, 0.0), BLACK, emission)
    receiver = ((*half, 0.0), (width, 0.0, 0.0), (0.0, depth, 0.0))
    return _exchange_scene(
        "rectangles face to face",
        view_factors.facing_rectangles_factor,
        {"width": width, "depth": depth, "distance": distance},
        emission,
        sensors.mean_irradiance(mc.Scene([light]), on_parallelogram, receiver, bounces=0, lights=lights),
        lights,
        "section C-11",
        "Two equal rectangles, one straight above the other; the upper one shines down on the lower.",
        lambda: _view(
            [light, mc.Quad(*receiver)], (0.8 * width, -1.2 * width - depth, 0.6 * distance), (0.0, 0.0, 0.4 * distance)
        ),
    )


def standing_rectangle(
    depth: float = 0.5, height: float = 2.0, width: float = 1.5, emission: float = WHITE, *, lights: str = "mis"
) -> AnalyticScene:
    """Return the mean irradiance on a floor ``depth`` x ``width`` from a wall ``height`` x ``width`` on its edge.

    Where they meet, a sample of the light may be arbitrarily bright: with lights="nee" the variance is infinite.
    """
    wall = mc.Quad((0.0, 0.0, 0.0), (0.0, width, 0.0), (0.0, 0.0, height), BLACK, emission)
    receiver = ((0.0, 0.0, 0.0), (depth, 0.0, 0.0), (0.0, width, 0.0))
    return _exchange_scene(
        "rectangle standing on another",
        view_factors.standing_rectangle_factor,
        {"depth": depth, "height": height, "width": width},
        emission,
        sensors.mean_irradiance(mc.Scene([wall]), on_parallelogram, receiver, bounces=0, lights=lights),
        lights,
        "section C-14",
        "A rectangular wall stands on the edge of a rectangular floor of the same width and shines on it.",
        lambda: _view(
            [wall, mc.Quad(*receiver)], (2.0 * height, -0.5 * height, 1.3 * height), (0.0, width / 2, 0.4 * height)
        ),
    )


def offset_rectangles(
    corner=(0.1, 0.2),
    size=(0.2, 0.3),
    light_corner=(0.35, 0.35),
    light_size=(0.3, 0.3),
    distance: float = 1.0,
    emission: float = 12.0,
    *,
    lights: str = "nee",
) -> AnalyticScene:
    """Return the mean irradiance on a rectangle of the floor from a ceiling lamp: a pixel of a Cornell box.

    ``corner`` and ``size``, shape (2,), are the least x and y of the receiver at z = 0 and its extent; those of the
    light likewise, at z = ``distance``.
    """
    light = mc.Quad((*light_corner, distance), (0.0, light_size[1], 0.0), (light_size[0], 0.0, 0.0), BLACK, emission)
    receiver = ((*corner, 0.0), (size[0], 0.0, 0.0), (0.0, size[1], 0.0))
    return _exchange_scene(
        "floor rectangle under a ceiling lamp",
        view_factors.parallel_rectangles_factor,
        {"corner": corner, "size": size, "other_corner": light_corner, "other_size": light_size, "distance": distance},
        emission,
        sensors.mean_irradiance(mc.Scene([light]), on_parallelogram, receiver, bounces=0, lights=lights),
        lights,
        "section C-13",
        "A rectangle of the floor, and a rectangular lamp in the ceiling beside it; sides parallel to x and y.",
        lambda: _view([light, mc.Quad(*receiver)], (0.5, -1.0, 0.7), (0.4, 0.4, 0.5)),
    )


def coaxial_disks(
    radius: float = 0.5, other_radius: float = 1.0, distance: float = 0.5, emission: float = WHITE
) -> AnalyticScene:
    """Return the mean irradiance on a disk of ``radius`` from a parallel one on the same axis.

    No primitive of a scene is a disk: the ray is cut with the light's plane.
    """
    return _exchange_scene(
        "coaxial disks",
        view_factors.coaxial_disks_factor,
        {"radius": radius, "other_radius": other_radius, "distance": distance},
        emission,
        disk_to_disk(radius, other_radius, distance, emission),
        "none",
        "section C-41",
        "Two parallel disks on one axis; one shines on the other.",
        None,
    )


def two_spheres(
    radius: float = 1.0,
    other_radius: float = 1.0,
    distance: float = 3.0,
    emission: float = WHITE,
    *,
    lights: str = "nee",
) -> AnalyticScene:
    """Return the mean irradiance on a sphere from another one whose centre is at ``distance``.

    Raises ``ValueError`` where they overlap.
    """
    if not radius + other_radius <= distance:
        raise ValueError(f"the spheres must be apart: got radii {radius} and {other_radius} at distance {distance}")
    light = mc.Sphere((distance, 0.0, 0.0), other_radius, BLACK, emission)
    receiver = ((0.0, 0.0, 0.0), radius, 1.0)
    return _exchange_scene(
        "sphere to sphere",
        view_factors.spheres_factor,
        {"radius": radius, "other_radius": other_radius, "distance": distance},
        emission,
        sensors.mean_irradiance(mc.Scene([light]), on_sphere, receiver, bounces=0, lights=lights),
        lights,
        "spheres of two sizes (Juul 1976; Felske 1978)",
        "Two spheres apart from each other; one shines on the other.",
        lambda: _view(
            [light, mc.Sphere((0.0, 0.0, 0.0), radius)],
            (0.3 * distance, -2.2 * distance, 0.0),
            (distance / 2, 0.0, 0.0),
        ),
    )


def sphere_over_disk(
    radius: float = 0.5, disk_radius: float = 0.8, distance: float = 1.2, emission: float = 1.0, *, lights: str = "nee"
) -> AnalyticScene:
    """Return the mean irradiance on a round table from a sphere light over its middle, at ``distance``.

    Raises ``ValueError`` where the sphere meets the table's plane.
    """
    if not 0 < radius <= distance:
        raise ValueError(f"the sphere must be above the table: got radius {radius} at distance {distance}")
    light = mc.Sphere((0.0, 0.0, distance), radius, BLACK, emission)
    receiver = ((0.0, 0.0, 0.0), disk_radius)
    return _exchange_scene(
        "round table under a sphere light",
        _table_factor,
        {"radius": radius, "disk_radius": disk_radius, "distance": distance},
        emission,
        sensors.mean_irradiance(mc.Scene([light]), on_disk, receiver, bounces=0, lights=lights),
        lights,
        "section C, sphere to coaxial disk",
        "A disk, and a sphere that shines on it from straight above.",
        None,
    )


def inner_sphere(
    inner_radius: float = 0.8, outer_radius: float = 1.0, emission: float = WHITE, *, lights: str = "none"
) -> AnalyticScene:
    """Return the mean irradiance on the inside of a sphere from a smaller one in it, away from the centre."""
    if not 0 < inner_radius < outer_radius:
        raise ValueError(f"0 < inner_radius < outer_radius is needed; got {inner_radius} and {outer_radius}")
    aside = 0.6 * (outer_radius - inner_radius)
    light = mc.Sphere((aside, 0.0, 0.0), inner_radius, BLACK, emission)
    receiver = ((0.0, 0.0, 0.0), outer_radius, -1.0)
    return _exchange_scene(
        "wall of a sphere around a light",
        view_factors.outer_to_inner_sphere_factor,
        {"inner_radius": inner_radius, "outer_radius": outer_radius},
        emission,
        sensors.mean_irradiance(mc.Scene([light]), on_sphere, receiver, bounces=0, lights=lights),
        lights,
        "section C, sphere within a sphere; reciprocity",
        "A sphere shines inside a larger one, aside from its centre; the receiver is all of the larger one's inside.",
        None,
    )


def opposite_caps(
    half_angle: float = math.pi / 5, other_half_angle: float = 2 * math.pi / 3, emission: float = WHITE
) -> AnalyticScene:
    """Return the mean irradiance on a cap of a hollow sphere about -z from one about +z that shines.

    It is the same everywhere on the sphere; where the caps overlap, the receiver shines on itself.
    """
    return _exchange_scene(
        "cap to cap of one sphere",
        cap_share,
        {"half_angle": other_half_angle},
        emission,
        cap_to_cap(half_angle, other_half_angle, emission),
        "none",
        "section C, parts of one sphere",
        "Two caps of a hollow sphere about opposite poles; one shines on the other.",
        None,
    )


def mean_irradiance(emission, factor, **arguments):
    """Return pi Le F for a view factor F = ``factor(**arguments)``."""
    return jnp.pi * emission * factor(**arguments)


def _table_factor(radius, disk_radius, distance):
    """View factor from a disk to a sphere over its middle, by reciprocity."""
    return view_factors.sphere_to_disk_factor(disk_radius, distance) * 4.0 * radius**2 / disk_radius**2


def _exchange_scene(name, factor, shape, emission, integrand, lights, section, geometry, view):
    arguments = {"emission": emission, **shape}
    formula = functools.partial(mean_irradiance, factor=factor)
    value = math.pi * emission  # of a sample that meets the other surface

    def law(exact):
        if lights != "none":
            return None
        return Law(*variance_and_kurtosis([value ** (q - 1) * exact for q in (1, 2, 3, 4)]))

    name = f"{name}, lights={lights}"
    return closed_form_scene(
        name, formula, arguments, integrand, SOURCE + section, geometry=geometry, law=law, view=view
    )


def _view(primitives, origin, target):
    return mc.Scene(primitives), looking_along(origin, np.subtract(target, origin), fov=40.0)
