"""Where radiance is looked for whose edges matter: the part of a film, what is above a surface point, and in mirrors.

A mirror shows what would be seen from the point's own image behind it, and a mirror in a mirror likewise.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..transport.hits import at
from ..transport.vec import Vec3, cross, dot, normalize, where
from .arcs import Cone, Halfspace, cone_around, corners_of, middle_of, pyramid
from .curves import holds, kinds
from .flows import attach, still
from .mirrors import Plane, image, plane_of, reflected
from .shadows import draws, is_free, reflects
from .silhouettes import Silhouettes
from .vertices import Vertex, with_same_coordinates
from .world import World


class Given(NamedTuple):
    """A direction: whether it matters, the weight of radiance along it, how it moves, None where it keeps what it
    meets, and how far away the last mirror is.
    """

    used: Any
    weight: Any
    wi: Vec3 | None = None
    least: Any = 0.0


class Window(NamedTuple):
    """Where a point looks, at rest and in motion: within these bounds, and for rims in the ``cone`` that holds them.

    ``give(wi)`` tells of a direction. If they are ``pinned``, directions keep what they meet, up to ``further`` mirrors
    in a row. Through mirrors, as many as ``passed``, the point is its image, and ``own`` the last mirror's face.
    """

    point: Vec3
    moving: Vec3
    bounds: list[Halfspace]
    cone: Cone | None
    give: Callable[[Vec3], Given]
    pinned: bool
    further: int
    own: Any = -1
    passed: Any = 0


class Rectangle(NamedTuple):
    """A part of a camera's film in its coordinates, [-1, 1] in both directions for the whole."""

    left: Any
    top: Any
    right: Any
    bottom: Any


def of_film(world: World, part: Rectangle, importance) -> Window:
    """Return the window of a part of the film, for the mean radiance over that part, times ``importance(x, y)`` of film
    positions.
    """
    camera = world.values.place
    fixed = still(camera)
    corners = _film_corners(fixed, part)
    inside = corners[0] + (corners[2] - corners[0]) * 0.5

    def give(wi):
        used, moving, weight = _on_film(world, part, wi, importance)
        return Given(used, weight, moving)

    bounds = pyramid(corners, inside, fixed.origin)
    cone = cone_around(corners, inside, fixed.origin)
    return Window(fixed.origin, camera.origin, bounds, cone, give, pinned=False, further=0)


def of_vertex(world: World, strategy, vertex: Vertex) -> Window:
    """Return the window of a surface point that draws directions: all that is above its horizon."""
    surface = vertex.surface

    def give(wi):
        used = draws(vertex) & (dot(surface.normal, wi) > 0.0)
        moving = with_same_coordinates(world, strategy, vertex, wi) if strategy.is_attached else None
        return Given(used, reflects(world, strategy, vertex, wi), moving)

    horizon, further = Halfspace(surface.normal), 0 if strategy.is_attached else world.mirrors.in_a_row
    return Window(
        surface.point, vertex.moving.point, [horizon], None, give, not strategy.is_attached, further, surface.face
    )


class Look(NamedTuple):
    """One of the mirrors that are looked into: whether there is one, its face and plane, the image that the point has
    in it, at rest, and the face that the ray to it starts on.
    """

    there: Any
    face: Any
    plane: Plane
    image: Vec3
    before: Any


def in_mirrors(world: World, found: Silhouettes, window: Window, chain) -> Window:
    """Return what a window shows in a chain of mirrors, one after the other; those after the first may be none, -1."""
    point, moving, bounds, cone, own = window.point, window.moving, window.bounds, window.cone, window.own
    looks: list[Look] = []
    for k, face in enumerate(chain):
        row, there = world.values.faces.at(face), True if k == 0 else face >= 0
        plane = plane_of(row)
        fixed = still(plane)
        point, moving = where(there, image(fixed, point), point), where(there, image(plane, moving), moving)
        looks.append(Look(there, face, plane, point, own))
        triangle = jnp.asarray(found.triangles)[face]
        corners, inside = corners_of(still(row), triangle), middle_of(still(row), triangle)
        height = dot(fixed.normal, fixed.point - point)
        beyond = Halfspace(fixed.normal * jnp.sign(height), jnp.abs(height))
        bounds = [Halfspace(where(there, reflected(fixed, b.normal), b.normal), b.height) for b in bounds]
        bounds += [_if_there(there, bound) for bound in (*pyramid(corners, inside, point), beyond)]
        around = cone_around(corners, inside, point)
        cone = around if k == 0 else jax.tree.map(partial(jnp.where, there), around, cone)
        own = jnp.where(there, face, own)
    passed = 1 + sum(look.there.astype(int) for look in looks[1:])
    give = partial(_give_in_mirrors, world, found, window, looks)
    return Window(point, moving, bounds, cone, give, window.pinned, max(window.further - 1, 0), own, passed)


def _if_there(there, bound: Halfspace) -> Halfspace:
    """Return a half space, and all of space where it is not there."""
    return Halfspace(where(there, bound.normal, bound.normal * 0.0), jnp.where(there, bound.height, -1.0))


def _give_in_mirrors(world, found, window: Window, looks: list[Look], wi: Vec3) -> Given:
    """Tell of a direction that is seen from the last image: follow it back to the first mirror, and on again."""
    onward = [wi]
    for look in reversed(looks):
        onward.insert(0, where(look.there, reflected(still(look.plane), onward[0]), onward[0]))
    given = window.give(onward[0])
    used, weight, moving = given.used, given.weight, given.wi
    start, least = window.point, 0.0
    for look, before, after in zip(looks, onward, onward[1:]):
        row, plane = still(world.values.faces.at(look.face)), still(look.plane)
        speed = dot(plane.normal, after)
        distance = dot(plane.normal, plane.point - look.image) / jnp.where(speed != 0.0, speed, 1.0)
        end = look.image + after * distance
        triangle, disk = (jnp.asarray(kind)[look.face] for kind in kinds(found))
        is_seen = (distance > least) & holds(row, end, triangle, disk) & (look.before != look.face)
        is_seen = is_seen & is_free(world, found, start, before, distance - least, look.before, look.face)
        used = used & jnp.where(look.there, is_seen, True)
        weight = where(look.there, at(world.rest.reflectance, look.face) * weight, weight)
        if moving is not None:
            moving = where(look.there, reflected(look.plane, moving), moving)
        start, least = where(look.there, end, start), jnp.where(look.there, distance, least)
    return Given(used, weight, moving, least)


# ------------------------------------------------------------------------------------------------------------- film


def _film_corners(camera, part: Rectangle) -> list[Vec3]:
    middle = camera.origin + camera.forward
    places = ((part.left, part.top), (part.right, part.top), (part.right, part.bottom), (part.left, part.bottom))
    return [middle + camera.right * x + camera.down * y for x, y in places]


def _on_film(world: World, part: Rectangle, wi: Vec3, importance):
    """Return whether a direction comes from a part of the film, how the direction of that film position moves, and the
    film's share per solid angle.
    """
    camera = world.values.place
    fixed = still(camera)
    length = dot(fixed.forward, fixed.forward) / dot(wi, fixed.forward)
    x, y = (dot(wi, axis) * length / dot(axis, axis) for axis in (fixed.right, fixed.down))
    used = (length > 0.0) & (x >= part.left) & (x <= part.right) & (y >= part.top) & (y <= part.bottom)
    moving = normalize(camera.forward + camera.right * still(x) + camera.down * still(y))
    volume = jnp.abs(dot(fixed.forward, cross(fixed.right, fixed.down))) * (part.right - part.left)
    share = length**3 / (volume * (part.bottom - part.top))
    return used, attach(wi, moving), jax.tree.map(lambda w: w * share, importance(x, y))
