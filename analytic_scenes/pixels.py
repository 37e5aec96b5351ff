"""Pixels with a filter, as scenes: an edge before a bright sky, a sphere in perspective, ambient occlusion on a floor.

The film position is drawn around the pixel and weighed by the filter, so one pixel is one flat integral. The camera
sees these positions as its whole image; at ``DISTANCE`` from it a pixel has side 1. ``mc.render`` with a filter
estimates the same number as a ratio, from samples that pixels share.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes import coverage, laws
from analytic_scenes.lone_receiver import BLACK
from analytic_scenes.scene import AnalyticScene, closed_form_scene
from jaxmc.transport.filters import Filter

DISTANCE = 8.0  # of the film, in pixels
TENT, MITCHELL = mc.TentFilter(), mc.MitchellFilter()
FAR = 64.0  # pixels: how far a half-plane reaches at least
SOURCE = "Mitchell and Netravali, Reconstruction Filters in Computer Graphics (1988); "


def half_plane_pixel(
    filter: Filter = MITCHELL, angle: float = math.pi / 6, offset: float = 0.25
) -> AnalyticScene:  # fmt: skip
    """Return a pixel under an edge: a bright sky where ``x cos(angle) + y sin(angle) < offset``, in pixels from the
    centre of the pixel, x to the right and y down; black beyond."""
    return _pixel_scene(
        f"pixel at an edge, {_named(filter)}",
        functools.partial(coverage.half_plane_coverage, filter),
        {"angle": angle, "offset": offset},
        half_plane_scene(angle, offset),
        filter,
        "truncated powers; piecewise quadrature",
        "A black half-plane hides a part of a bright sky; a camera sees its straight edge in one pixel.",
    )


def sphere_pixel(
    filter: Filter = TENT, x: float = -1.3, y: float = 0.9, z: float = DISTANCE + 1.5, radius: float = 1.5
) -> AnalyticScene:
    """Return a pixel at the outline of a sphere of radiance 1: an ellipse. The sphere is at (x, y, z) from the camera,
    to the right, down and ahead, in pixels at ``DISTANCE``."""
    scene = mc.Scene([mc.Sphere((x, -y, -z), radius, BLACK, emission=1.0)])
    return _pixel_scene(
        f"pixel at the outline of a sphere, {_named(filter)}",
        functools.partial(sphere_coverage, filter),
        {"x": x, "y": y, "z": z, "radius": radius},
        scene,
        filter,
        "section of a cone; piecewise quadrature",
        "A bright sphere in perspective covers a part of one pixel.",
    )


def half_plane_scene(angle: float, offset: float) -> mc.Scene:
    """Return a sky of radiance 1 of which a black half-plane leaves ``x cos(angle) + y sin(angle) < offset`` on a film
    at ``DISTANCE`` from a camera in the origin that looks along -z; film coordinates go right and down."""
    normal = np.array([math.cos(angle), -math.sin(angle), 0.0])
    along = np.array([-normal[1], normal[0], 0.0])
    corner = offset * normal - FAR * along - (0.0, 0.0, DISTANCE)
    return mc.Scene([mc.Quad(corner, 2.0 * FAR * along, FAR * normal, BLACK)], sky=1.0)


def sphere_coverage(filter, x, y, z, radius):
    """Return what a sphere covers of the pixel about the middle of the film; arguments of ``sphere_pixel``."""
    return coverage.sphere_outline(film_camera(1.0), (x, -y, -z), radius).coverage(filter, 0, 0)


def film_camera(width: float, pixels: int = 1) -> mc.PinholeCamera:
    """Return a camera in the origin whose film, a square of side ``width`` at ``DISTANCE``, lies along -z."""
    fov = 2.0 * math.degrees(math.atan(width / (2.0 * DISTANCE)))
    return mc.PinholeCamera((0, 0, 0), (0, 0, -1), up=(0, 1, 0), fov=fov, width=pixels, height=pixels)


@dataclasses.dataclass(frozen=True)
class _Filtered:
    """A pixel with a filter, where ``fn`` is the integrand of a camera whose image has side ``2 * _radius(filter)``."""

    fn: Callable
    filter: Filter

    def __call__(self, u, *params):
        f, radius, place, weight = coverage.profile(self.filter), _radius(self.filter), [], 1.0
        for k in (0, 1):
            # A tent is near enough to all but the box, and exact for itself.
            t = 2.0 * u[k] - 1.0
            if not isinstance(self.filter, mc.BoxFilter):
                # Twice the way to the nearer end is 1 - |t| without rounding, so never 0 inside of the interval.
                tent = jnp.sqrt(2.0 * jnp.minimum(u[k], 1.0 - u[k]))
                t = jnp.sign(t) * (1.0 - tent)
                weight /= tent
            else:
                weight *= 2.0
            weight *= f.density(radius * t) * radius
            place.append(0.5 + 0.5 * t)
        return self.fn(place, *params) * weight


def _radius(filter):
    """Return half the side of the square that positions are drawn in: where the tent has fallen to 0, the weight of a
    Gaussian must have been cut off."""
    return filter.radius * (1.25 if isinstance(filter, mc.GaussianFilter) else 1.0)


def _pixel_scene(name, formula, arguments, scene, filter, source, geometry):
    def view():
        return scene, film_camera(8.0, 128)

    integrand = mc.path_integrand(scene, film_camera(2.0 * _radius(filter)), bounces=0)
    return closed_form_scene(
        name,
        formula,
        arguments,
        dataclasses.replace(integrand, fn=_Filtered(integrand.fn, filter)),
        SOURCE + source,
        geometry=geometry,
        # Under a box a sample is 0 or 1.
        law=lambda exact: laws.law_of_values([exact], [1.0]) if isinstance(filter, mc.BoxFilter) else None,
        view=view,
    )


def _named(filter):
    return {mc.BoxFilter: "box", mc.TentFilter: "tent", mc.MitchellFilter: "Mitchell", mc.GaussianFilter: "Gaussian"}[
        type(filter)
    ] + " filter"


def default_scenes() -> list[AnalyticScene]:
    """Return both pixels under every filter."""
    filters = mc.BoxFilter(), TENT, MITCHELL, mc.GaussianFilter()
    return [make(filter) for make in (half_plane_pixel, sphere_pixel) for filter in filters]
