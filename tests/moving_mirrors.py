"""Lamps that a point or a camera sees in one plane mirror or two, cut by their rims and by what is on the way.

What is seen are images: of the lamp in all mirrors, of each mirror and of each blocker in those before it.
"""

import film_reference as film
import jax.numpy as jnp
import numpy as np
from moving_points import UP, MovingScene, ball, quad

import jaxmc as mc

PARTS = "corner", "edge_u", "edge_v"


def corners(p, name, mirrors=()):
    """Return the corners of a parallelogram, seen in mirrors, the last one first."""
    return _in_mirrors(p, film.quad(*(p[name + part] for part in PARTS)), mirrors)


def _in_mirrors(p, points, mirrors):
    for mirror in mirrors:
        normal = jnp.cross(p[mirror + "edge_u"], p[mirror + "edge_v"])
        points = film.mirrored(points, p[mirror + "corner"], normal)
    return points


def mirror(p, name):
    return mc.Quad(*(p[name + part] for part in PARTS), mc.Mirror(p["reflectance"]))


def _quads(p, *names):
    return [quad(*(p[name + part] for part in PARTS)) for name in names]


def _lamp(p):
    return quad(*(p[part] for part in PARTS), p["emission"])


def from_point(p, points):
    """Return where points over a receiver appear on the plane above it."""
    directions = points - p["point"]
    return directions[:, :2] / directions[:, 2:]


def irradiance_of(polygon):
    """Return the irradiance of a polygon of radiance 1, seen on a plane over the receiver. Source: Lambert (1760)."""
    corners = jnp.concatenate([polygon, jnp.ones_like(polygon[:, :1])], axis=1)
    after = jnp.roll(corners, -1, axis=0)
    across = jnp.cross(corners, after)
    squared = jnp.sum(across * across, axis=1)
    size = jnp.sqrt(jnp.where(squared > 1e-20, squared, 1.0))
    angle = jnp.arctan2(size, jnp.sum(corners * after, axis=1))
    return 0.5 * jnp.abs(jnp.sum(jnp.where(squared > 1e-20, angle * across[:, 2] / size, 0.0)))


# -------------------------------------------------------------------------------------------------- a mirror on a film
# The mirror is in front of the camera, at y = 2; what it shows lies behind the camera.

MIRROR = {
    "mirror_corner": np.array([-0.9, 2.0, -0.6]), "mirror_edge_u": np.array([1.7, 0.1, 0.0]),
    "mirror_edge_v": np.array([0.0, -0.1, 1.4]),
}  # fmt: skip
BACK = {
    "corner": np.array([-3.0, -1.5, -0.9]), "edge_u": np.array([0.0, 0.0, 1.9]), "edge_v": np.array([4.3, 0.2, 0.0]),
}  # fmt: skip
BETWEEN = {
    "near_corner": np.array([-0.5, -0.6, -0.3]), "near_edge_u": np.array([0.5, 0.1, 0.1]),
    "near_edge_v": np.array([0.1, -0.1, 0.5]),
}  # fmt: skip
SHINE = {"reflectance": 0.8, "emission": 2.0}
FROM = {"origin": np.array([0.1, 0.0, 0.05]), "target": np.array([0.0, 2.0, 0.1])}


def _camera(p):
    return mc.PinholeCamera(p["origin"], p["target"], UP, 52.0, 4, 4)


def _view(p):
    return film.view(p["origin"], p["target"], fov=52.0)


def _blocker_in_mirror(p):
    # The lamp shines to +y, where the mirror is.
    return mc.Scene([mirror(p, "mirror_"), _lamp(p), *_quads(p, "near_")]), _camera(p)


def _blocked_image(**p):
    view = _view(p)
    window = view.on_film(corners(p, "mirror_"))
    back, near = (view.on_film(corners(p, name, ["mirror_"])) for name in ("", "near_"))
    return p["reflectance"] * p["emission"] * (film.share(window, back) - film.share(window, back, near))


def _ball_in_mirror(p):
    return mc.Scene([mirror(p, "mirror_"), ball(p["center"], p["radius"], p["emission"])]), _camera(p)


def _sphere_image(**p):
    # The film holds the mirror, and the mirror's rim cuts the image.
    view = _view(p)
    window = view.on_film(corners(p, "mirror_"))
    center = _in_mirrors(p, p["center"], ["mirror_"])
    return p["reflectance"] * p["emission"] * film.sphere_share(view, center, p["radius"], window)


# ----------------------------------------------------------------------------------------------- a mirror over a point

WINDOW = {
    "mirror_corner": [-0.7, 1.0, 0.25], "mirror_edge_u": [1.3, 0.1, 0.02], "mirror_edge_v": [0.05, -0.05, 1.3],
    "corner": [-0.9, 0.3, 1.2], "edge_u": [0.05, -0.12, 1.3], "edge_v": [2.2, 0.0, 0.1],
    "near_corner": [-0.25, 0.5, 0.48], "near_edge_u": [0.16, 0.0, 0.02], "near_edge_v": [-0.02, 0.03, 0.15],
    "far_corner": [0.1, 0.7, 1.4], "far_edge_u": [0.3, 0.05, 0.0], "far_edge_v": [0.0, 0.02, 0.35],
    "point": [0.02, -0.03, 0.0],
}  # fmt: skip
WINDOW = {name: np.array(v) for name, v in WINDOW.items()} | {"reflectance": 0.8, "emission": 2.0}


def _window(p):
    """A lamp that only a mirror shows, whose rim cuts it, with a blocker on the way there and one on the way back."""
    # The lamp shines to +y, where the mirror is, and the point is behind it.
    return mc.Scene([mirror(p, "mirror_"), _lamp(p), *_quads(p, "near_", "far_")]), p["point"], UP


def _in_window(**p):
    def seen(name, *mirrors):
        return from_point(p, corners(p, name, mirrors))

    lit = film.within(seen("", "mirror_"), seen("mirror_"))
    hidden = [film.within(lit, seen("near_")), film.within(lit, seen("far_", "mirror_"))]
    return p["reflectance"] * p["emission"] * (irradiance_of(lit) - sum(map(irradiance_of, hidden)))


# -------------------------------------------------------------------------------------------------------- two mirrors

PERISCOPE = {
    "low_corner": [-0.7, 1.0, 0.25], "low_edge_u": [1.3, 0.05, 0.02], "low_edge_v": [0.05, -0.03, 0.6],
    "high_corner": [-0.6, -0.5, 1.0], "high_edge_u": [0.02, 0.03, 1.2], "high_edge_v": [1.1, 0.02, 0.0],
    "corner": [-0.9, 0.4, 2.2], "edge_u": [1.6, 0.0, 0.05], "edge_v": [0.0, 0.03, 1.0],
    "near_corner": [-0.12, 0.2, 1.3], "near_edge_u": [0.25, 0.02, 0.02], "near_edge_v": [0.0, 0.02, 0.15],
    "far_corner": [0.28, 0.0, 2.1], "far_edge_u": [0.2, 0.0, 0.01], "far_edge_v": [0.01, 0.02, 0.14],
}  # fmt: skip
PERISCOPE = {name: np.array(v) for name, v in PERISCOPE.items()} | {"reflectance": 0.8, "emission": 2.0}


def _periscope(p):
    """A low mirror before the origin, a high one behind it that it shows, and a lamp that shines to the high one."""
    return mc.Scene([mirror(p, "low_"), mirror(p, "high_"), _lamp(p), *_quads(p, "near_", "far_")])


def _periscope_at_point(p):
    return _periscope(p), p["point"], UP


def _up_periscope(**p):
    def seen(name, *mirrors):
        return from_point(p, corners(p, name, mirrors))

    direct = seen("")
    direct = irradiance_of(direct) - irradiance_of(film.within(direct, seen("near_")))
    once = film.within(seen("", "high_"), seen("high_"))
    once = irradiance_of(once) - irradiance_of(film.within(once, seen("far_", "high_")))
    twice = _twice(seen)
    twice = irradiance_of(twice) - sum(irradiance_of(film.within(twice, hidden)) for hidden in _hiding(seen))
    return p["emission"] * (direct + p["reflectance"] * once + p["reflectance"] ** 2 * twice)


def _twice(seen):
    return film.within(film.within(seen("", "high_", "low_"), seen("high_", "low_")), seen("low_"))


def _hiding(seen):
    return seen("near_", "low_"), seen("far_", "high_", "low_")


SEEN_FROM = {"origin": np.array([0.05, -0.1, 0.02]), "target": np.array([0.0, 1.0, 0.75])}


def _periscope_on_film(p):
    return _periscope(p), mc.PinholeCamera(p["origin"], p["target"], UP, 30.0, 4, 4)


def _through_periscope(**p):
    view = film.view(p["origin"], p["target"], fov=30.0)

    def seen(name, *mirrors):
        return view.on_film(corners(p, name, mirrors))

    lit = _twice(seen)
    share = film.share(lit) - sum(film.share(lit, hidden) for hidden in _hiding(seen))
    return p["emission"] * p["reflectance"] ** 2 * share


MIRRORED = (
    MovingScene("blocker before a wall in a mirror", "film", _blocker_in_mirror,
                {**MIRROR, **BACK, **BETWEEN, **SHINE, **FROM}, _blocked_image, 1),
    MovingScene("sphere in a mirror", "film", _ball_in_mirror,
                {**MIRROR, **SHINE, **FROM, "center": np.array([0.3, -1.0, 0.2]), "radius": 0.4}, _sphere_image, 1),
    MovingScene("sphere over a mirror's rim", "film", _ball_in_mirror,
                {**MIRROR, **SHINE, **FROM, "center": np.array([1.5, -1.0, 0.2]), "radius": 0.6}, _sphere_image, 1),
    MovingScene("lamp that a mirror's rim cuts", "point", _window, WINDOW, _in_window, 1),
    MovingScene("periscope", "point", _periscope_at_point, PERISCOPE | {"point": np.array([0.02, -0.03, 0.0])},
                _up_periscope, 2),
    MovingScene("through a periscope", "film", _periscope_on_film, PERISCOPE | SEEN_FROM, _through_periscope, 2),
)  # fmt: skip
