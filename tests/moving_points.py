"""Irradiances at points and radiances along rays, of scenes in motion, whose values are closed forms."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

import jaxmc as mc
from analytic_scenes import moving
from analytic_scenes.scene import value_and_derivatives

BLACK = mc.Diffuse(0.0)
UP = (0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


class MovingScene(NamedTuple):
    """A scene, its parameters, the number of bounces its value counts, and that value as ``formula(**params)``.

    ``family``: the name of the same formula in ``analytic_scenes.moving``, where it is one of them as it stands; the
    parameters have the names of its arguments.
    """

    name: str
    kind: str
    make: Callable
    params: dict[str, Any]
    formula: Callable
    bounces: int
    family: str | None = None

    def truth(self) -> tuple[float, dict[str, Any]]:
        """Return the value and its derivative with respect to each parameter, in float64."""
        return value_and_derivatives(self.formula, **self.params)

    def integrand(self, params) -> mc.Integrand:
        """Return the estimator of the value, without boundary terms."""
        of = {"film": mc.path_integrand, "point": mc.irradiance, "ray": mc.radiance}[self.kind]
        return of(*self.make(params), bounces=self.bounces)


def quad(corner, edge_u, edge_v, emission=None, material=BLACK):
    return mc.Quad(corner, edge_u, edge_v, material, emission=emission)


def ball(center, radius, emission=None):
    return mc.Sphere(center, radius, BLACK, emission=emission)


ARGUMENTS = {family.name: dict(family.arguments) for family in moving.FAMILIES}
FORMULAS = {family.name: family.formula for family in moving.FAMILIES}


def at_origin(*primitives, sky=None, height=0.0):
    return mc.Scene(primitives, sky), [0.0, 0.0, height], UP


def _sphere_light(p):
    return at_origin(ball([p["offset"], 0.0, p["height"]], p["radius"], p["emission"]))


def _corner_rectangle(p):
    return at_origin(quad([0.0, 0.0, p["height"]], [0.0, p["depth"], 0.0], [p["width"], 0.0, 0.0], p["emission"]))


def _half_plane(p):
    a, b, s = p["half_width"], p["half_depth"], p["edge"]
    light = quad([-a, -b, p["height"]], [0.0, 2.0 * b, 0.0], [2.0 * a, 0.0, 0.0], p["emission"])
    return light, quad([s - 5.0, -5.0, p["blocker_height"]], [5.0, 0.0, 0.0], [0.0, 10.0, 0.0])


def _half_plane_at_point(p):
    return at_origin(*_half_plane(p), height=p["receiver"])


def _half_plane_on_floor(p):
    floor = mc.Quad([-2.0, -2.0, p["receiver"]], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], mc.Diffuse(p["albedo"]))
    return mc.Scene([*_half_plane(p), floor]), [0.0, 0.0, 0.6], [0.0, 0.0, -1.0]


def _on_floor(albedo, **p):
    return albedo / jnp.pi * moving.half_plane_shadow(**p)


def _annular_eclipse(p):
    light = ball([0.0, 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, ball([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"]))


def _sphere_under_sky(p):
    sine, cosine = jnp.sin(p["theta"]), jnp.cos(p["theta"])
    return at_origin(ball([p["distance"] * sine, 0.0, p["distance"] * cosine], p["radius"]), sky=p["sky"])


def _plane_mirror(p):
    mirror = mc.Quad([p["mirror"], -4.0, -1.0], [0.0, 8.0, 0.0], [0.0, 0.0, 8.0], mc.Mirror())
    return at_origin(mirror, ball([p["x"], 0.0, p["z"]], p["radius"], p["emission"]))


def _with_mirror(emission, radius, mirror, x, z):
    image = moving.sphere_in_plane_mirror(emission, radius, mirror, x, z)
    return image + moving.sphere_over_receiver(emission, radius, z, x)


def _furnace(p):
    shell = mc.Sphere(ORIGIN, 1.3, mc.Diffuse(p["albedo"]), emission=p["emission"], inward=True)
    return mc.Scene([shell]), [0.2, 0.1, 0.0], [0.3, -0.4, 0.8]


GLASS = {"ior": 1.5}


def _slab(p):
    glass = mc.Box([0.0, 0.0, 0.5], [20.0, 20.0, 1.0], material=mc.Dielectric(p["ior"]))
    lamp = quad([-5.0, -5.0, 2.0], [0.0, 10.0, 0.0], [10.0, 0.0, 0.0], 1.0)
    return mc.Scene([glass, lamp]), [0.1, 0.2, -1.0], UP


def _glass_surface(p):
    glass = mc.Box([0.0, 0.0, 0.5], [20.0, 20.0, 1.0], material=mc.Dielectric(p["ior"]))
    lamp = quad([-5.0, -5.0, -2.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], 1.0)
    return mc.Scene([glass, lamp]), [0.1, 0.2, -1.0], UP


def _rough_metal(p):
    floor = mc.Quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], mc.RoughConductor(p["roughness"]))
    return mc.Scene([floor], 1.0), [0.1, 0.2, 1.0], [0.0, 0.0, -1.0]


def _family(name, kind, make, bounces):
    return MovingScene(name, kind, make, ARGUMENTS[name], FORMULAS[name], bounces, name)


POINTS = (
    _family("sphere light", "point", _sphere_light, 0),
    _family("rectangle over its corner", "point", _corner_rectangle, 0),
    _family("shadow of a half plane", "point", _half_plane_at_point, 0),
    _family("annular eclipse", "point", _annular_eclipse, 0),
    _family("sphere under the sky", "point", _sphere_under_sky, 0),
    MovingScene("sphere beside a plane mirror", "point", _plane_mirror, ARGUMENTS["sphere in a plane mirror"],
                _with_mirror, 1),
)  # fmt: skip
RAYS = (
    MovingScene("shadow of a half plane on a floor", "ray", _half_plane_on_floor,
                {"albedo": 0.6, **ARGUMENTS["shadow of a half plane"]}, _on_floor, 1),
    _family("short furnace", "ray", _furnace, 4),
    # Of more than 8 events 1e-11 would come.
    MovingScene("slab of glass", "ray", _slab, GLASS, moving.glass_slab, 8, "slab of glass"),
    MovingScene("surface of glass", "ray", _glass_surface, GLASS, moving.glass_surface, 1, "surface of glass"),
    _family("rough metal", "ray", _rough_metal, 1),
)  # fmt: skip
