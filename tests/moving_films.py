"""Means over the films of cameras, of scenes in motion: what is seen at first sight."""

import film_reference as film
import jax.numpy as jnp
import numpy as np
from moving_points import BLACK, UP, MovingScene, ball, quad

import jaxmc as mc


def camera(p, fov=40.0):
    return mc.PinholeCamera(p["origin"], p["target"], UP, p.get("fov", fov), 4, 4)


def shares(of):
    """Return a formula from a function of the parameters and of a film's view."""
    return lambda **p: of(p, film.view(p["origin"], p["target"], fov=p.get("fov", 40.0)))


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
