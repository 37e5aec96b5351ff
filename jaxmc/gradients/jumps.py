"""What moving edges add to the radiance that is seen: on a film, around a surface point, and of both in plane mirrors.

With h the distance by which an edge moves over a direction, the integrand is the sum of L h in front and -L h behind. A
direction that a camera gives keeps nothing in place, nor does one of attached sampling: all edges count where radiance
jumps, also those between two faces that are seen. Else a direction that was drawn keeps what it has met: what is in
front moves with its edge and h is 0, but for mirrors, since what they show does not. A mirror shows what would be seen
from the point's own image behind it.

Source: Reynolds' transport theorem; Li et al. 2018; Zeltner et al. 2021 on attached sampling.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..transport.hits import Hit
from ..transport.lights import black
from ..transport.rays import ray
from ..transport.vec import Vec3, cross, dot, where
from ..transport.warps import grazing
from .curves import Place, draw, look, pieces, place_on
from .flows import motion, still
from .mirrors import flow_through, is_one_of, is_within, look_through
from .shadows import CONTACT, follows, scan, slip
from .silhouettes import Silhouettes
from .windows import Window
from .world import World

ASIDE = 8.0  # times the least cosine of a ray with its face: so far off an edge, as an angle
SLANTED = 1e-3  # of a distance: a face that is seen edge-on changes it more


def jump(world: World, found: Silhouettes, window: Window, u, radiance_along):
    """Return what the edges in a window add: value 0, and its derivative.

    Coordinate ``u`` draws one; ``radiance_along(ray, hit)`` is an estimate of the radiance that a ray finds, with the
    same coordinates for both sides.
    """
    views = look(found, still(world.values.faces), window.point)
    chosen = draw(u, _pieces(world, found, views, window))
    place = place_on(found, views, chosen.which, chosen.angle, world.values.faces)
    given = window.give(place.wi)
    seen = scan(world, found, place, window.point, window.own, given.least)
    used = given.used & seen.seen & (chosen.density > 0.0) & (place.distance > given.least)
    behind, goes_on = _side(world, place, place.away, -1.0, seen.behind)
    sides = [(-1.0, behind, used & (_slips(world, window, behind) | ~goes_on))]
    if window.further or not window.pinned:
        front, _ = _side(world, place, place.away * -1.0, 1.0, Hit(jnp.inf, -1))
        sides.append((1.0, front, used & _slips(world, window, front)))
    sides = [(sign, Hit(hit.distance, jnp.where(counts, hit.face, -1)), counts) for sign, hit, counts in sides]

    toward = [_beside(world, window, place, given.least, sign, hit) for sign, hit, _ in sides]
    lights = _both(lambda side: radiance_along(*side), toward)
    weight, total = jnp.where(used, place.stretch / jnp.where(used, chosen.density, 1.0), 0.0), black(world.rest)
    for light, (sign, hit, counts) in zip(lights, sides):
        wi = given.wi if given.wi is not None else _follow(world, window, place.wi, given.least, hit)
        value = still(light * given.weight) * (sign * weight * motion(slip(place, window.moving, wi, counts)))
        total = total + where(counts, value, black(world.rest))
    return total


def _beside(world, window: Window, place: Place, least, side, hit: Hit):
    """Return the ray to what is on one side of an edge, and its hit. Of a flat face at the edge itself they are a
    little off that: otherwise rounding decides on which side of the other face they end.
    """
    face, start = still(world.values.faces.at(hit.face)), window.point + place.wi * least
    normal, aside = cross(face.half_u, face.half_v), place.wi - place.away * (side * ASIDE * grazing())
    speed, straight = dot(normal, aside), hit.distance - least
    distance = dot(normal, face.center - start) / jnp.where(speed != 0.0, speed, 1.0)
    is_at_edge = (face.radius == 0.0) & (jnp.abs(hit.distance - place.distance) <= CONTACT * place.distance)
    is_at_edge = is_at_edge & (hit.face >= 0) & (jnp.abs(distance - straight) <= SLANTED * straight)
    return ray(start, where(is_at_edge, aside, place.wi)), Hit(jnp.where(is_at_edge, distance, straight), hit.face)


def _both(f, sides):
    """Return ``f`` of one side or of both, compiled once."""
    if len(sides) == 1:
        return [f(sides[0])]
    stacked = lax.map(f, jax.tree.map(lambda *x: jnp.stack(x), *sides))
    return [jax.tree.map(lambda x, k=k: x[k], stacked) for k in range(len(sides))]


def _pieces(world, found, views, window: Window):
    """Return the pieces of all edges that may matter in a window; those of the mirror that it shows are left out."""
    creases: Any = True
    if window.pinned:
        mirrors = world.mirrors.faces if window.further else ()
        creases = np.array([any(i in mirrors for i in edge.faces) for edge in found.edges])
    primitive = jnp.where(window.passed > 0, jnp.asarray(world.rest.owner)[window.own], -1)
    return pieces(found, views, window.bounds, window.cone, creases=creases, own=primitive)


def _slips(world, window: Window, hit: Hit):
    """Return whether a direction does not stay in place on what it has met."""
    if not window.pinned:
        return True
    return is_one_of(world.mirrors.faces, hit.face) & (window.passed < world.mirrors.in_a_row)


def _follow(world, window: Window, wi, least, hit: Hit):
    """Return how a direction moves that was drawn, with what it has met or with what mirrors show there."""
    faces, passed = world.values.faces, window.passed
    own, corner = hit.face == window.own, window.point + wi * least
    own = own | ((passed > 0) & is_within(still(faces.at(hit.face)), corner))
    kept = follows(world, window.moving, wi, hit, own)
    mirrors = world.mirrors._replace(in_a_row=window.further)
    shown = look_through(world.rest, mirrors, ray(corner, wi), hit._replace(distance=hit.distance - least))
    if not shown:
        return kept
    shown = [s._replace(there=s.there & (passed + k < world.mirrors.in_a_row)) for k, s in enumerate(shown)]
    seen = flow_through(faces.at, hit, window.moving, wi, shown)
    return where(shown[0].there, seen.wi, kept)


def _side(world, place: Place, toward: Vec3, side, otherwise: Hit) -> tuple[Hit, Any]:
    """Return the face at an edge that is seen on one side of it, the one that comes nearer first, and whether there is
    one.
    """
    faces = still(world.values.faces)
    face, best, distance = jnp.asarray(-1), jnp.inf, place.distance
    for k in range(place.around.shape[0]):
        row = faces.at(place.around[k])
        is_ball = row.radius > 0.0
        normal = cross(row.half_u, row.half_v)
        speed = dot(normal, place.wi)
        slope = -dot(normal, toward) / jnp.where(speed != 0.0, speed, 1.0)
        slope = jnp.where(is_ball, 0.0, slope)
        better = (place.sides[k] == side) & (slope < best)
        face, best = jnp.where(better, place.around[k], face), jnp.where(better, slope, best)
        # A rim lies on the near side of its sphere: rounding must not decide that.
        distance = jnp.where(
            better & is_ball, place.distance * (1.0 - 16.0 * float(jnp.finfo(jnp.result_type(float)).eps)), distance
        )
    return Hit(*(jnp.where(face >= 0, a, b) for a, b in zip((distance, face), otherwise))), face >= 0
