"""Flat faces that stand on other ones: their edges are as far away as what is behind them."""

import film_reference as film
import jax.numpy as jnp
import numpy as np
from moving_films import EYE, camera, shares
from moving_mirrors import from_point, irradiance_of
from moving_points import UP, MovingScene, quad

import jaxmc as mc


def _fin(p):
    """Return the corner and the edges of a parallelogram that stands on the wall."""

    def on_plane(xz, y):
        return jnp.stack([xz[0], jnp.asarray(y, float), xz[1]])

    return on_plane(p["foot"], 2.0), on_plane(p["side"], 0.0), jnp.asarray(p["out"])


def _on_wall(p):
    wall = quad([-4.0, 2.0, -4.0], [8.0, 0.0, 0.0], [0.0, 0.0, 8.0], p["emission"])
    return mc.Scene([wall, quad(*_fin(p))]), camera(p)


def _wall_share(p, view):
    wall = view.on_film(film.quad(*(jnp.array(v) for v in ([-4.0, 2.0, -4.0], [8.0, 0.0, 0.0], [0.0, 0.0, 8.0]))))
    return p["emission"] * (film.share(wall) - film.share(wall, view.on_film(film.quad(*_fin(p)))))


FIN = {"foot": np.array([-0.3, 0.1]), "side": np.array([0.7, 0.3]), "out": np.array([0.3, -0.8, 0.4])}


def _hanging(p):
    """Return the same of one that hangs from the ceiling."""
    foot, side = (jnp.stack([*p[name], jnp.asarray(z, float)]) for name, z in (("foot", 1.5), ("side", 0.0)))
    return foot, side, jnp.asarray(p["out"])


CEILING = [-0.6, -0.9, 1.5], [0.0, 1.7, 0.0], [1.5, 0.0, 0.0]


def _under_ceiling(p):
    return mc.Scene([quad(*CEILING, p["emission"]), quad(*_hanging(p))]), p["point"], UP


def _lit_from_ceiling(**p):
    ceiling, fin = (from_point(p, film.quad(*(jnp.asarray(v) for v in q))) for q in (CEILING, _hanging(p)))
    return p["emission"] * (irradiance_of(ceiling) - irradiance_of(film.within(ceiling, fin)))


HUNG = {"foot": np.array([0.1, -0.3]), "side": np.array([0.2, 0.6]), "out": np.array([0.3, 0.1, -0.5])}
CONTACTS = (
    MovingScene("fin on a wall", "film", _on_wall, {**FIN, **EYE, "emission": 2.0}, shares(_wall_share), 0),
    MovingScene("fin on a lamp", "point", _under_ceiling,
                {**HUNG, "point": np.array([0.05, -0.02, 0.0]), "emission": 2.0}, _lit_from_ceiling, 0),
)  # fmt: skip
