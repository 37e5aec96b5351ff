"""Skies with a ground, whose edge is a great circle of directions: seen on a film, from points, and in a mirror."""

import film_reference as film
import jax.numpy as jnp
import numpy as np
from moving_films import EYE, SPHERE, camera, shares
from moving_mirrors import FROM, MIRROR, corners, from_point, irradiance_of, mirror
from moving_points import UP, MovingScene, ball

import jaxmc as mc

WHOLE = jnp.array(film.FILM)
NORMAL = [0.2, 0.5, 0.6]
SKY = {"zenith": np.array([0.3, -0.2, 0.9]), "sky": 2.0, "ground": 0.5}


def _sky(p):
    return mc.GradientSky([p["sky"]], up=p["zenith"], ground=p["ground"])


def _lit(normal, **p):
    """Return the irradiance of all of a sky and its ground; the sky's share is that of a tilted half space."""
    cosine = normal @ p["zenith"] / jnp.sqrt((normal @ normal) * (p["zenith"] @ p["zenith"]))
    return 0.5 * jnp.pi * (p["sky"] * (1.0 + cosine) + p["ground"] * (1.0 - cosine))


def _of_sky(polygon, directions, zenith):
    """Return the part of a polygon, on a plane where its corners are seen in these directions, that shows the sky."""
    return film.above(polygon, directions @ zenith)


# ------------------------------------------------------------------------------------------------------------ points


def _open(p):
    # The ball is behind the receiver.
    return mc.Scene([ball([0.0, -3.0, -4.0], 0.5)], _sky(p)), [0.0, 0.0, 0.0], NORMAL


def _over_point(**p):
    return _lit(jnp.array(NORMAL), **p)


def _on_floor(p):
    floor = mc.Quad([-1.0, -1.0, 0.0], p["edge_u"], p["edge_v"], mc.Diffuse(p["albedo"]))
    return mc.Scene([floor], _sky(p)), [0.1, 0.0, 1.5], [-0.05, 0.1, -1.0]


def _of_floor(edge_u, edge_v, albedo, **p):
    return albedo / jnp.pi * _lit(jnp.cross(edge_u, edge_v), **p)


def _beside_mirror(p):
    return mc.Scene([mirror(p, "mirror_")], _sky(p)), p["point"], UP


def _shown(p):
    """Return the zenith as a mirror shows it."""
    return film.mirrored(p["zenith"], jnp.zeros(3), jnp.cross(p["mirror_edge_u"], p["mirror_edge_v"]))


def _beside(**p):
    rim = from_point(p, corners(p, "mirror_"))
    to = jnp.concatenate([rim, jnp.ones((4, 1))], axis=1)
    behind, before = (irradiance_of(_of_sky(rim, to, zenith)) for zenith in (p["zenith"], _shown(p)))
    step, ground = p["sky"] - p["ground"], p["ground"] * irradiance_of(rim)
    seen = p["reflectance"] * (ground + step * before) - ground - step * behind
    return _lit(jnp.array(UP), **{name: p[name] for name in SKY}) + seen


# ------------------------------------------------------------------------------------------------------------- films


def _behind_ball(p):
    return mc.Scene([ball(p["center"], p["radius"], p["emission"])], _sky(p)), camera(p)


def _around_sphere(p, view):
    sky = _of_sky(WHOLE, view.directions(WHOLE), p["zenith"])
    hidden = film.sphere_share(view, p["center"], p["radius"])
    of_sky = film.share(sky) - film.sphere_share(view, p["center"], p["radius"], sky)
    return p["ground"] * (1.0 - hidden) + (p["sky"] - p["ground"]) * of_sky + p["emission"] * hidden


def _mirror_before(p):
    return mc.Scene([mirror(p, "mirror_")], _sky(p)), camera(p)


def _with_mirror(p, view):
    rim, step = view.on_film(corners(p, "mirror_")), p["sky"] - p["ground"]
    behind, before = (_of_sky(WHOLE, view.directions(WHOLE), zenith) for zenith in (p["zenith"], _shown(p)))
    around = p["ground"] * (1.0 - film.share(rim)) + step * (film.share(behind) - film.share(behind, rim))
    return around + p["reflectance"] * (p["ground"] * film.share(rim) + step * film.share(before, rim))


FLOOR = {"edge_u": np.array([2.0, 0.1, 0.3]), "edge_v": np.array([0.0, 2.0, -0.4]), "albedo": 0.7}
BESIDE = {
    "mirror_corner": np.array([-0.7, 1.0, 0.25]), "mirror_edge_u": np.array([1.3, 0.1, 0.02]),
    "mirror_edge_v": np.array([0.05, -0.3, 1.3]), "reflectance": 0.8, "point": np.array([0.02, -0.03, 0.0]),
}  # fmt: skip
SKIES = (
    MovingScene("sky over a ground", "point", _open, SKY, _over_point, 0),
    MovingScene("floor under a sky and a ground", "ray", _on_floor, {**SKY, **FLOOR}, _of_floor, 1),
    MovingScene("horizon behind a sphere", "film", _behind_ball,
                {**SPHERE, **EYE, **SKY, "zenith": np.array([0.2, -0.1, 1.0])}, shares(_around_sphere), 0),
    MovingScene("horizon in a mirror on a film", "film", _mirror_before,
                {**MIRROR, **FROM, **SKY, "zenith": np.array([0.2, -0.1, 1.0]), "reflectance": 0.8},
                shares(_with_mirror), 1),
    MovingScene("horizon in a mirror over a point", "point", _beside_mirror,
                {**BESIDE, **SKY, "zenith": np.array([0.2, -0.5, 0.8])}, _beside, 1),
)  # fmt: skip
