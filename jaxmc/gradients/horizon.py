"""The edge where a sky meets its ground: a great circle of directions, the same from everywhere.

Places do not move it. It moves over directions that turn: those of a film as its camera turns, those of attached
sampling as surfaces turn, those that a mirror shows as it turns; and over all of them as the zenith moves.
"""

import jax.numpy as jnp

from ..transport.lights import black
from ..transport.sky import ZenithPolynomial, zenith_of
from ..transport.vec import dot, frame, where
from .arcs import Cone, RimView, rim_arcs
from .curves import Pieces, draw
from .flows import motion, still
from .shadows import distances_from
from .silhouettes import Silhouettes
from .windows import Window
from .world import World


def has_horizon(sky) -> bool:
    """Return whether radiance jumps where a sky, as a scene has it, meets its ground."""
    return isinstance(sky, ZenithPolynomial) and sky.ground is not None


def horizon(world: World, found: Silhouettes, window: Window, u):
    """Return what the edge of the ground adds in a window: value 0, and its derivative; ``u`` draws a place on it.

    Directions whose cosine z with the zenith rises from 0 leave the ground for the sky, so the integrand along the edge
    is the difference of both times the derivative of z, where nothing is in the way.
    """
    sky, up = still(world.values.sky), zenith_of(world.values.sky)
    zenith, one = still(up), jnp.ones(1)
    # It is the rim of a sphere that fills half of all directions.
    tangent, bitangent = frame(zenith)
    view = RimView(zenith, tangent, bitangent, one, 0.0 * one, one, one > 0.0)
    cone = Cone(window.bounds[0].normal, 0.0) if window.cone is None else window.cone
    chosen = draw(u, Pieces(*rim_arcs(view, cone), one))
    wi = tangent * jnp.cos(chosen.angle) + bitangent * jnp.sin(chosen.angle)
    given = window.give(wi)
    lengths = distances_from(world, found, window.point, wi, window.own)
    is_free = ~jnp.any((lengths > given.least) & (lengths < jnp.inf))
    used = given.used & is_free & (chosen.density > 0.0)
    rise = motion(jnp.where(used, dot(up, wi if given.wi is None else given.wi), 0.0))
    weight = jnp.where(used, 1.0 / jnp.where(used, chosen.density, 1.0), 0.0)
    step = still((sky.coefficients[0] - sky.ground) * given.weight)
    return where(used, step * (rise * weight), black(world.rest))
