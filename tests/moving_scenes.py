"""Scenes in motion of which the value is a closed form, and with it every derivative: on a film, at a point, on a ray.

``SCENES`` lists them. ``make(params)`` returns what an estimator takes before its options:

* "film": (scene, camera), for the mean radiance over the film;
* "point": (scene, point, normal), for an irradiance;
* "ray": (scene, origin, direction), for a radiance.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import film_reference as film
import jax.numpy as jnp
import numpy as np

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


def camera(p, fov=40.0):
    return mc.PinholeCamera(p["origin"], p["target"], UP, p.get("fov", fov), 4, 4)


def shares(of):
    """Return a formula from a function of the parameters and of a film's view."""
    return lambda **p: of(p, film.view(p["origin"], p["target"], fov=p.get("fov", 40.0)))


# ------------------------------------------------------------------------------------------------------ first sight
# Cameras look along y, at a slant, so that no image is symmetric.

EYE = {"origin": np.array([0.1, -3.0, 0.3]), "target": np.array([0.0, 0.2, 0.1])}
LAMP = {
    "corner": np.array([-0.5, 0.3, -0.4]), "edge_u": np.array([0.8, 0.2, 0.1]), "edge_v": np.array([-0.1, 0.3, 0.7]),
}  # fmt: skip


def _seen_sphere(p):
    return mc.Scene([ball(p["center"], p["radius"], p["emission"])], p.get("sky")), camera(p)


def _sphere_share(p, view):
    mine = film.sphere_share(view, p["center"], p["radius"])
    return p["emission"] * mine + p.get("sky", 0.0) * (1.0 - mine)


def _seen_quad(p):
    return mc.Scene([quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])], p.get("sky")), camera(p)


def _image(p, view, name=""):
    return view.on_film(film.quad(p[name + "corner"], p[name + "edge_u"], p[name + "edge_v"]))


def _quad_share(p, view):
    mine = film.share(_image(p, view))
    return p["emission"] * mine + p.get("sky", 0.0) * (1.0 - mine)


def _seen_triangle(p):
    return mc.Scene([mc.Triangle(p["a"], p["b"], p["c"], BLACK, emission=p["emission"])]), camera(p)


def _triangle_share(p, view):
    return p["emission"] * film.share(view.on_film(jnp.stack([p["a"], p["b"], p["c"]])))


def _seen_box(p):
    return mc.Scene([mc.Box(p["center"], p["size"], material=BLACK, emission=p["emission"])]), camera(p)


def _box_share(p, view):
    # The faces in front and those behind cover the same part of the film.
    half = 0.5 * p["size"]
    around = jnp.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    faces = [
        p["center"] + half * jnp.insert(around, axis, side, axis=1) for axis in range(3) for side in (-1.0, 1.0)
    ]  # fmt: skip
    return p["emission"] * 0.5 * sum(film.share(view.on_film(face)) for face in faces)


def _before(p):
    back = quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])
    return mc.Scene([back, quad(p["near_corner"], p["near_edge_u"], p["near_edge_v"])]), camera(p)


def _quad_before_quad(p, view):
    back = _image(p, view)
    return p["emission"] * (film.share(back) - film.share(back, _image(p, view, "near_")))


def _ball_before(p):
    back = quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])
    return mc.Scene([back, ball(p["center"], p["radius"])]), camera(p)


def _sphere_before_quad(p, view):
    # The quad lies within the film.
    back = _image(p, view)
    return p["emission"] * (film.share(back) - film.sphere_share(view, p["center"], p["radius"], back))


SPHERE = {"center": np.array([0.3, 0.4, -0.2]), "radius": 0.5, "emission": 2.0}
EDGE = SPHERE | {"center": np.array([1.1, 0.4, -0.2])}
NEAR = {
    "near_corner": np.array([-0.3, -0.5, -0.2]), "near_edge_u": np.array([0.5, 0.1, -0.2]),
    "near_edge_v": np.array([0.1, -0.1, 0.6]),
}  # fmt: skip
WALL = {
    "corner": np.array([-4.0, 2.0, -4.0]), "edge_u": np.array([8.0, 0.0, 0.0]), "edge_v": np.array([0.0, 0.0, 8.0]),
}  # fmt: skip
CUT = LAMP | {"corner": np.array([0.6, 0.3, 0.3])}
BALL = {"center": np.array([-0.4, -0.3, -0.1]), "radius": 0.25}
FRONT = (
    MovingScene("sphere", "film", _seen_sphere, {**SPHERE, **EYE}, shares(_sphere_share), 0),
    MovingScene("sphere over the film's edge", "film", _seen_sphere, {**EDGE, **EYE}, shares(_sphere_share), 0),
    MovingScene("sphere before a sky", "film", _seen_sphere, {**SPHERE, **EYE, "sky": 0.5}, shares(_sphere_share), 0),
    MovingScene("quad", "film", _seen_quad, {**LAMP, **EYE, "emission": 2.0}, shares(_quad_share), 0),
    MovingScene("quad over the film's corner", "film", _seen_quad, {**CUT, **EYE, "emission": 2.0},
                shares(_quad_share), 0),
    MovingScene("quad before a sky", "film", _seen_quad, {**LAMP, **EYE, "emission": 2.0, "sky": 3.0},
                shares(_quad_share), 0),
    MovingScene("triangle", "film", _seen_triangle,
                {"a": np.array([-0.5, 0.3, -0.4]), "b": np.array([0.6, -0.2, 0.0]), "c": np.array([0.1, 0.2, 0.7]),
                 "emission": 2.0, **EYE}, shares(_triangle_share), 0),
    MovingScene("box", "film", _seen_box,
                {"center": np.array([0.2, 0.5, -0.3]), "size": np.array([0.7, 0.5, 0.6]), "emission": 2.0, **EYE},
                shares(_box_share), 0),
    MovingScene("quad before a wall", "film", _before, {**WALL, **NEAR, **EYE, "emission": 2.0},
                shares(_quad_before_quad), 0),
    MovingScene("quad before a quad", "film", _before, {**LAMP, **NEAR, **EYE, "emission": 2.0},
                shares(_quad_before_quad), 0),
    MovingScene("sphere before a quad", "film", _ball_before, {**LAMP, **BALL, **EYE, "emission": 2.0},
                shares(_sphere_before_quad), 0),
)  # fmt: skip
# The same with the field of view as a parameter.
ZOOMS = tuple(
    s._replace(name=f"{s.name}, zoomed", params={**s.params, "fov": 40.0})
    for s in FRONT if s.name in ("sphere", "quad over the film's corner", "sphere before a quad")
)  # fmt: skip

# ----------------------------------------------------------------------------------------------------- plane mirrors
# The mirror is in front of the camera, at y = 2; what it shows lies behind the camera.

MIRROR = {
    "mirror_corner": np.array([-0.9, 2.0, -0.6]), "mirror_edge_u": np.array([1.7, 0.1, 0.0]),
    "mirror_edge_v": np.array([0.0, -0.1, 1.4]),
}  # fmt: skip
BACK = {
    "corner": np.array([-3.0, -1.5, -0.9]), "edge_u": np.array([0.0, 0.0, 1.9]), "edge_v": np.array([4.3, 0.2, 0.0]),
}  # fmt: skip
FROM = {"origin": np.array([0.1, 0.0, 0.05]), "target": np.array([0.0, 2.0, 0.1]), "fov": 52.0}
BETWEEN = {
    "near_corner": np.array([-0.5, -0.6, -0.3]), "near_edge_u": np.array([0.5, 0.1, 0.1]),
    "near_edge_v": np.array([0.1, -0.1, 0.5]),
}  # fmt: skip


def _fixed_view(of):
    """A formula whose field of view is not a parameter."""
    return lambda **p: of(p, film.view(p["origin"], p["target"], fov=FROM["fov"]))


def _mirror(p):
    material = mc.Mirror(p["reflectance"])
    return mc.Quad(p["mirror_corner"], p["mirror_edge_u"], p["mirror_edge_v"], material)


def _in_mirror(p, view, points):
    normal = jnp.cross(p["mirror_edge_u"], p["mirror_edge_v"])
    return view.on_film(film.mirrored(points, p["mirror_corner"], normal))


def _blocker_in_mirror(p):
    back = quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])
    # The lamp shines to +y, where the mirror is.
    blocker = quad(p["near_corner"], p["near_edge_u"], p["near_edge_v"])
    return mc.Scene([_mirror(p), back, blocker]), camera(p, FROM["fov"])


def _blocked_image(p, view):
    window = _image(p, view, "mirror_")
    back = _in_mirror(p, view, film.quad(p["corner"], p["edge_u"], p["edge_v"]))
    near = _in_mirror(p, view, film.quad(p["near_corner"], p["near_edge_u"], p["near_edge_v"]))
    return p["reflectance"] * p["emission"] * (film.share(window, back) - film.share(window, back, near))


def _ball_in_mirror(p):
    return mc.Scene([_mirror(p), ball(p["center"], p["radius"], p["emission"])]), camera(p, FROM["fov"])


def _sphere_image(p, view):
    # The film holds the mirror, and the mirror's rim cuts the image.
    window = _image(p, view, "mirror_")
    normal = jnp.cross(p["mirror_edge_u"], p["mirror_edge_v"])
    center = film.mirrored(p["center"], p["mirror_corner"], normal)
    return p["reflectance"] * p["emission"] * film.sphere_share(view, center, p["radius"], window)


def _without_fov(p):
    return {key: value for key, value in p.items() if key != "fov"}


SHINE = {"reflectance": 0.8, "emission": 2.0, **_without_fov(FROM)}
MIRRORS = (
    MovingScene("blocker before a wall in a mirror", "film", _blocker_in_mirror,
                {**MIRROR, **BACK, **BETWEEN, **SHINE}, _fixed_view(_blocked_image), 1),
    MovingScene("sphere in a mirror", "film", _ball_in_mirror,
                {**MIRROR, **SHINE, "center": np.array([0.3, -1.0, 0.2]), "radius": 0.4},
                _fixed_view(_sphere_image), 1),
    MovingScene("sphere over a mirror's rim", "film", _ball_in_mirror,
                {**MIRROR, **SHINE, "center": np.array([1.5, -1.0, 0.2]), "radius": 0.6},
                _fixed_view(_sphere_image), 1),
)  # fmt: skip

# --------------------------------------------------------------------------------------------------- points and rays

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
SCENES = (*FRONT, *ZOOMS, *MIRRORS, *POINTS, *RAYS)
