"""What moving silhouettes add to the light that arrives at a point: integrals along them.

A direction to a light keeps what it meets in place, and so does one that is drawn, if sampling is not attached. So what
is in front of a silhouette moves along with it and adds nothing: with h the distance by which the silhouette moves over
what lies behind, on the sphere of directions and along its normal, the integrand is -f L cos(theta) h, L from behind.

Source: Reynolds' transport theorem; Li et al. 2018; Zhang et al. 2020.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport.hits import Hit
from ..transport.lights import black
from ..transport.primitives import Sphere
from ..transport.sky import sky_radiance
from ..transport.vec import Vec3, cross, dot, where
from .arcs import Halfspace, cone_around, cone_of_ball, corners_of, middle_of, pyramid, this_side
from .curves import Place, curves, distances, draw, joined, look, pieces, place_on
from .disks import ball_around
from .flows import distance_to, flow, motion, one_of, still
from .silhouettes import Silhouettes
from .vertices import Vertex, evaluate, share_of_emission
from .world import World

SKY = -1
CONTACT = 1e-4  # of a distance: by so much what touches is told apart


class Lamp(NamedTuple):
    """A face that shines, ``SKY`` for the sky, to the side of its normal, to the other, or to both."""

    face: int
    front: bool
    back: bool


def lamps_of(scene) -> tuple[Lamp, ...]:
    """Return what shines in a scene, which must be as it was made."""
    primitives, lamps = scene.as_given()[0], []
    for face in sorted(set(scene.lights)):
        p = primitives[scene.owner[face]]
        inward = isinstance(p, Sphere) and p.inward
        lamps.append(Lamp(face, p.two_sided or not inward, p.two_sided or inward))
    if scene.sky is not None:
        lamps.append(Lamp(SKY, True, True))
    return tuple(lamps)


class Scan(NamedTuple):
    """What a ray through a silhouette meets: whether the silhouette is seen, and the first thing behind it."""

    seen: jax.Array
    behind: Hit


def scan(world: World, found: Silhouettes, place: Place, point: Vec3, own, least=0.0) -> Scan:
    """Return what a ray from ``point`` on face ``own`` meets, farther away than ``least``."""
    lengths, faces = distances_from(world, found, point, place.wi, own), still(world.values.faces)
    lengths = jnp.where(place.own | (lengths <= least), jnp.inf, lengths)
    # What a silhouette rests on is as far away: behind it, or before it where it is seen from the other side.
    side = jnp.sign(dot(cross(faces.half_u, faces.half_v), point - faces.center))
    order = lengths * (1.0 + CONTACT * side * place.rests)
    nearest = jnp.min(order)
    face = jnp.argmin(order)
    there = nearest < jnp.inf
    return Scan(nearest > place.distance, Hit(jnp.where(there, lengths[face], jnp.inf), jnp.where(there, face, -1)))


def is_free(world: World, found: Silhouettes, point: Vec3, wi: Vec3, length, own, target):
    """Return whether a ray from face ``own`` reaches face ``target``, ``length`` away."""
    lengths = distances_from(world, found, point, wi, own)
    return ~jnp.any((lengths < length) & ~on_plane_of(world, found, target))


def distances_from(world, found, point, wi, own):
    """Return the distances of all faces, infinite for those on the plane of face ``own``."""
    lengths = distances(found, still(world.values.faces), point, wi, own)
    return jnp.where(on_plane_of(world, found, own), jnp.inf, lengths)


def on_plane_of(world, found, face):
    """Return for each face whether it is flat and lies on the same plane as ``face``, which may be none of them."""
    rest, numbers = world.rest, range(world.rest.size)
    plane = np.array([[(j == i or j in rest.twins[i]) and i not in found.spheres for j in numbers] for i in numbers])
    known = jnp.clip(jnp.asarray(face), -1, rest.size)
    return jnp.asarray(np.vstack([plane, np.zeros((1, rest.size), bool)]))[known] & (known >= 0)


def follows(world: World, point: Vec3, wi: Vec3, hit: Hit, own) -> Vec3:
    """Return a direction that was drawn at ``point`` in motion: it keeps what it has met, or itself, in place."""
    kept = flow(world.values.faces.at(hit.face), point, wi, distance_to(hit), own).wi
    return where(hit.face >= 0, kept, wi)


def slip(place: Place, point: Vec3, wi: Vec3, used):
    """Return h, how far a silhouette moves over ``wi``, both seen from ``point`` in motion, where it is ``used``."""
    # Keep what is not used finite, or the chain rule makes it NaN.
    away = (place.point - point) * jnp.where(used, 1.0 / jnp.where(used, place.distance, 1.0), 0.0)
    return jnp.where(used, dot(place.away, away) - dot(place.away, wi), 0.0)


def draws(vertex: Vertex):
    """Return whether there is a surface and directions are drawn from it: it is neither mirror nor glass."""
    there, specular = vertex.surface.face >= 0, vertex.kinds.specular
    return there if specular is None else there & ~specular


def reflects(world: World, strategy, vertex: Vertex, wi: Vec3):
    """Return the share of radiance that a vertex reflects per solid angle, times what comes before it, at rest."""
    rest = jax.tree.map(still, vertex)
    return still(rest.beta * (evaluate(world, strategy, rest, wi) * (1.0 / jnp.pi)))


def shadows(world: World, found: Silhouettes, lamps, strategy, vertex: Vertex, u):
    """Return what the edges of shadows add to direct light; with attached sampling, to what sampled lights bring of it.

    One coordinate draws a light, a silhouette that is seen before it, and a place on that. A place counts only where
    the ray past it meets the light in question, so every light is counted once.
    """
    fixed, surface = still(world.values.faces), vertex.surface
    x, n = surface.point, surface.normal
    views = look(found, fixed, x)
    chosen, count = draw(u, drawn_before(found, fixed, views, lamps, x, n)), curves(found)
    lamp = chosen.which // count
    place = place_on(found, views, chosen.which % count, chosen.angle, world.values.faces)
    face, front, back = (jnp.asarray([getattr(k, name) for k in lamps])[lamp] for name in Lamp._fields)
    seen = scan(world, found, place, x, surface.face)
    hit = seen.behind
    row = fixed.at(face)
    is_ball = row.radius > 0.0
    distance = distance_to(hit)
    outward = where(is_ball, x + place.wi * distance - row.center, cross(row.half_u, row.half_v))
    shines = jnp.where(dot(outward, place.wi) < 0.0, front, back)
    reached = (hit.face == face) & ((face == SKY) | shines)
    used = reached & seen.seen & (chosen.density > 0.0) & (dot(n, place.wi) > 0.0) & draws(vertex)
    met = Hit(hit.distance, jnp.where(used, face, -1))
    h = slip(place, vertex.moving.point, follows(world, vertex.moving.point, place.wi, met, face == surface.face), used)
    light = one_of(still(world.values.emission), face)
    if world.rest.sky is not None:
        light = where(face == SKY, sky_radiance(still(world.values.sky), place.wi), light)
    value = reflects(world, strategy, vertex, place.wi)
    if strategy.is_attached:
        # What drawn directions find of the light follows other flows, and is counted with all else that they meet.
        value = value * still(1.0 - share_of_emission(world, strategy, jax.tree.map(still, vertex), place.wi, met))
    weight = jnp.where(used, -place.stretch / jnp.where(used, chosen.density, 1.0), 0.0)
    return where(used, still(value * light) * (weight * motion(h)), black(world.rest))


def drawn_before(found, fixed, views, lamps, x, n):
    """Return the pieces of all silhouettes above the horizon and before each of the lights."""
    tables = []
    for lamp in lamps:
        bounds, cone, own = [Halfspace(n)], None, -1
        if lamp.face != SKY:
            target, own = fixed.at(lamp.face), found.owner[lamp.face]
            if lamp.face in (*found.spheres, *found.disks):
                cone = cone_of_ball(target if lamp.face in found.spheres else ball_around(target), x)
            else:
                triangle = found.triangles[lamp.face]
                corners, inside = corners_of(target, triangle), middle_of(target, triangle)
                bounds += [*pyramid(corners, inside, x), this_side(target, inside, x)]
                cone = cone_around(corners, inside, x)
        tables.append(pieces(found, views, bounds, cone, own=own))
    return joined(tables)
