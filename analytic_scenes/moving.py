"""Closed forms of what changes when something moves: values with all derivatives, moving edges included.

Each family is a formula in ``jax.numpy`` with a default configuration; its derivatives are those of the formula. They
are the truth for estimators of derivatives: lights that move and grow, blockers whose shadow moves, receivers under
them, silhouettes on a film, mirrors, glass, roughness. ``emission`` is a radiance, lengths are in any one unit.
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from analytic_scenes.irradiance import corner_rectangle_irradiance
from analytic_scenes.scene import value_and_derivatives

NODES = 200  # of Gauss and Legendre's rule


class Family(NamedTuple):
    """A closed form with its default arguments; accurate to 1e-12 in float64."""

    name: str
    formula: Callable
    arguments: Mapping[str, float]
    source: str

    @property
    def exact(self) -> float:
        """The value at the default arguments."""
        return _evaluate(self.formula, tuple(self.arguments.items()))[0]

    @property
    def derivatives(self) -> dict[str, float]:
        """The derivative with respect to each argument."""
        return _evaluate(self.formula, tuple(self.arguments.items()))[1]


@functools.cache
def _evaluate(formula, arguments):
    return value_and_derivatives(formula, **dict(arguments))


# --------------------------------------------------------------------------------------------------- lights alone


def sphere_over_receiver(emission, radius, height, offset):
    """Irradiance from a sphere whose centre is at ``height`` over the receiver's plane, ``offset`` to the side, and
    wholly above that plane."""
    return jnp.pi * emission * radius**2 * height / (offset**2 + height**2) ** 1.5


def disk_over_receiver(emission, radius, height, offset):
    """Irradiance from a disk parallel to the receiver, its centre at ``height`` and ``offset`` to the side."""
    squares = height**2 + offset**2 + radius**2
    root = jnp.sqrt(squares**2 - 4.0 * radius**2 * offset**2)
    return jnp.pi * emission / 2.0 * (1.0 - (squares - 2.0 * radius**2) / root)


def coaxial_disk(emission, radius, height):
    """Irradiance from a disk parallel to the receiver and centred over it."""
    return jnp.pi * emission * radius**2 / (radius**2 + height**2)


# -------------------------------------------------------------------------------------------------------- shadows


def half_plane_shadow(emission, half_width, half_depth, height, blocker_height, edge, receiver):
    """Irradiance at (0, 0, receiver), facing up, from the rectangle |x| < half_width, |y| < half_depth at ``height``,
    of which the half plane x < ``edge`` at ``blocker_height`` hides all to the left of the shadow's edge.

    The edge must hide a part only: -half_width < edge (height - receiver) / (blocker_height - receiver) < half_width.
    """
    far = height - receiver
    start = edge * far / (blocker_height - receiver)
    right = corner_rectangle_irradiance(emission, half_width, half_depth, far)
    left = corner_rectangle_irradiance(emission, start, half_depth, far)
    return 2.0 * (right - left)


def annular_eclipse(emission, light_radius, light_height, blocker_radius, blocker_height, blocker_offset):
    """Irradiance from a sphere centred over the receiver, whose middle another sphere hides: a ring is left."""
    light = sphere_over_receiver(emission, light_radius, light_height, 0.0)
    return light - sphere_over_receiver(emission, blocker_radius, blocker_height, blocker_offset)


def disk_behind_sphere(emission, light_radius, light_height, blocker_radius, blocker_height, blocker_offset):
    """Irradiance from a disk centred over the receiver and parallel to it, whose middle a sphere hides."""
    light = coaxial_disk(emission, light_radius, light_height)
    return light - sphere_over_receiver(emission, blocker_radius, blocker_height, blocker_offset)


def sphere_under_sky(sky, radius, distance, theta):
    """Irradiance from a constant sky beside a black sphere at ``distance``, at angle ``theta`` from the normal and
    wholly above the horizon."""
    return jnp.pi * sky * (1.0 - (radius / distance) ** 2 * jnp.cos(theta))


# ----------------------------------------------------------------------------------------------------------- film


def disk_over_pixel_edge(radius, x):
    """Area inside the unit pixel of a disk centred at ``x``, that the pixel's edge at 1 cuts and no other."""
    inside = 1.0 - x
    segment = radius**2 * jnp.arccos(inside / radius) - inside * jnp.sqrt(radius**2 - inside**2)
    return jnp.pi * radius**2 - segment


def sphere_on_film(radius, x, y, z):
    """Area of a sphere at (x, y, z), seen from the origin along z, on a film at distance 1."""
    return jnp.pi * radius**2 * jnp.sqrt(x**2 + y**2 + z**2 - radius**2) / (z**2 - radius**2) ** 1.5


# ------------------------------------------------------------------------------------------------------ materials


def furnace(emission, albedo):
    """Radiance in a closed room of one albedo and emission, after any number of bounces."""
    return emission / (1.0 - albedo)


def short_furnace(emission, albedo, bounces=4):
    """Radiance in such a room after at most 4 bounces."""
    return emission * sum(albedo**k for k in range(bounces + 1))


def sphere_in_plane_mirror(emission, radius, mirror, x, z):
    """Irradiance at the origin, facing +z, from the image of a sphere at (x, 0, z) in the mirror plane x = ``mirror``.

    The sphere itself is not counted.
    """
    return sphere_over_receiver(emission, radius, z, 2.0 * mirror - x)


def glass_slab(ior):
    """Transmittance of a slab of glass at normal incidence, all orders of reflection."""
    return 2.0 * ior / (ior**2 + 1.0)


def glass_surface(ior):
    """Reflectance of one surface of glass at normal incidence."""
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def ggx_albedo(roughness):
    """Directional albedo of a GGX conductor of reflectance 1 at normal incidence, Smith's masking.

    Facets within an angle h of the normal are a share P = tan^2 h / (roughness^2 + tan^2 h); of the light that they
    reflect to 2 h the share 2 / (1 + sqrt(1 + roughness^2 tan^2 2h)) is not masked, whose mean over P this is.
    """
    node, weight = np.polynomial.legendre.leggauss(NODES)
    share = 0.5 * (jnp.asarray(node, float) + 1.0) / (1.0 + roughness**2)
    squared = roughness**2 * share / (1.0 - share)  # tan^2 h, at most 1: light that goes up
    up = 1.0 - squared
    unmasked = 2.0 * up / (up + jnp.sqrt(up**2 + 4.0 * roughness**2 * squared))
    return 0.5 * jnp.sum(jnp.asarray(weight, float) * unmasked) / (1.0 + roughness**2)


LIGHT = {"emission": 5.0, "radius": 0.5, "height": 2.0}
OFF = LIGHT | {"offset": 0.7}
HALF_PLANE = {
    "emission": 5.0, "half_width": 1.0, "half_depth": 0.8, "height": 3.0, "blocker_height": 1.2, "edge": 0.2,
    "receiver": 0.0,
}  # fmt: skip
ECLIPSE = {
    "emission": 5.0, "light_radius": 1.0, "light_height": 3.0, "blocker_radius": 0.2, "blocker_height": 1.5,
    "blocker_offset": 0.1,
}  # fmt: skip
CORNER = {"emission": 5.0, "width": 1.0, "depth": 0.8, "height": 1.5}
SPHERE = "Snyder (1996): a sphere above the horizon acts as a point source"
FAMILIES = (
    Family("sphere light", sphere_over_receiver, OFF, SPHERE),
    Family("disk light", disk_over_receiver, OFF, "Howell's catalog, configuration B-14"),
    Family("coaxial disk light", coaxial_disk, LIGHT, "Howell's catalog, configuration B-12"),
    Family("rectangle over its corner", corner_rectangle_irradiance, CORNER, "Howell's catalog, configuration B-3"),
    Family("shadow of a half plane", half_plane_shadow, HALF_PLANE, "projection of the edge; Howell's catalog, B-3"),
    Family("annular eclipse", annular_eclipse, ECLIPSE, SPHERE),
    Family("disk behind a sphere", disk_behind_sphere, ECLIPSE, "Howell's catalog, configuration B-12, less a sphere"),
    Family("disk over a pixel's edge", disk_over_pixel_edge, {"radius": 0.3, "x": 0.85}, "circular segment"),
    Family(
        "sphere on the film", sphere_on_film, {"radius": 0.6, "x": 0.4, "y": -0.3, "z": 3.0}, "conic section: its area"
    ),
    Family("furnace", furnace, {"emission": 1.0, "albedo": 0.5}, "geometric series"),
    Family("short furnace", short_furnace, {"emission": 1.0, "albedo": 0.5}, "geometric series"),
    Family(
        "sphere in a plane mirror", sphere_in_plane_mirror,
        {"emission": 5.0, "radius": 0.5, "mirror": 2.0, "x": 0.3, "z": 2.0}, "mirror image; " + SPHERE,
    ),
    Family("slab of glass", glass_slab, {"ior": 1.5}, "Stokes (1862): sum over all reflections inside"),
    Family("surface of glass", glass_surface, {"ior": 1.5}, "Fresnel at normal incidence"),
    Family(
        "sphere under the sky", sphere_under_sky, {"sky": 2.0, "radius": 0.6, "distance": 2.0, "theta": 0.5}, SPHERE
    ),
    Family("rough metal", ggx_albedo, {"roughness": 0.3}, "Walter et al. (2007); Heitz (2014)"),
)  # fmt: skip
