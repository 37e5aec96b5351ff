"""What moving edges add to the radiance that is seen: on a film, around a surface point, and of both in plane mirrors.

With h the distance by which an edge moves over a direction, the integrand is the sum of L h in front and -L h behind.
A direction that a camera gives follows nothing, so all edges count where radiance jumps, also those between two faces
that are seen. A direction that was drawn follows what it has met: what is in front moves with its edge and h is 0, but
for mirrors, since what they show does not. A mirror shows what would be seen from the point's own image behind it.

Source: Reynolds' transport theorem; Li et al. 2018; Zeltner et al. 2021 on attached sampling.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..transport.hits import Hit, at
from ..transport.lights import black
from ..transport.rays import ray
from ..transport.vec import Vec3, cross, dot, normalize, where
from .arcs import Cone, Halfspace, cone_around, corners_of, middle_of, pyramid
from .curves import Place, draw, holds, kinds, look, pieces, place_on
from .flows import attach, motion, still
from .mirrors import flow_through, image, is_one_of, is_within, look_through, plane_of, reflected
from .shadows import draws, follows, is_free, reflects, scan, slip
from .silhouettes import Silhouettes
from .walks import Vertex
from .world import World


class Window(NamedTuple):
    """Where a point looks, at rest and in motion: within these bounds, and for rims in the ``cone`` that holds them.
    Through a mirror it is the point's image, ``own`` the mirror's face and ``primitive`` what that belongs to.

    Directions do not stay in place on faces that ``slip``, None for all: those count also where they lie in front, and
    where they go on into another face at an edge that is true in ``creases``.
    """

    point: Vec3
    moving: Vec3
    bounds: list[Halfspace]
    cone: Cone | None
    own: Any = -1
    primitive: Any = -1
    slip: tuple[int, ...] | None = None
    creases: Any = True


class Given(NamedTuple):
    """A direction: whether it is one that matters, a function that returns how it moves with a hit, the weight of
    radiance along it, and how far the mirror is.
    """

    used: Any
    follow: Callable
    weight: Any
    least: Any = 0.0


class Rectangle(NamedTuple):
    """A part of a camera's film in its coordinates, [-1, 1] in both directions for the whole."""

    left: Any
    top: Any
    right: Any
    bottom: Any


def of_film(world: World, part: Rectangle, importance):
    """Return the window of a part of the film, and how it gives directions: for the mean radiance over that part, times
    ``importance(x, y)`` of film positions.
    """
    camera = world.values.place
    fixed = still(camera)
    corners = _film_corners(fixed, part)
    inside = corners[0] + (corners[2] - corners[0]) * 0.5
    bounds = pyramid(corners, inside, fixed.origin)
    window = Window(fixed.origin, camera.origin, bounds, cone_around(corners, inside, fixed.origin))

    def give(place):
        used, moving, weight = _on_film(world, part, place.wi, importance)
        return Given(used, lambda hit: moving, weight)

    return window, give


def of_film_in_mirror(world: World, found: Silhouettes, part: Rectangle, face, importance):
    """Return the window of a part of the film, seen in a mirror."""
    camera, rest = world.values.place, world.rest
    fixed, plane = still(camera), plane_of(world.values.faces.at(face))
    corners = [still(image(plane, c)) for c in _film_corners(fixed, part)]
    window = _mirror_window(world, found, face, fixed.origin, camera.origin)
    inside = corners[0] + (corners[2] - corners[0]) * 0.5
    window = window._replace(bounds=window.bounds + pyramid(corners, inside, window.point))

    def give(place):
        least, wi, is_seen = _through(world, found, face, window.point, place.wi)
        used, moving, weight = _on_film(world, part, wi, importance)
        used = used & is_seen & is_free(world, found, fixed.origin, wi, least, -1, face)
        seen = reflected(plane, moving)
        return Given(used, lambda hit: seen, at(rest.reflectance, face) * weight, least)

    return window, give


def of_vertex(world: World, found: Silhouettes, strategy, vertex: Vertex):
    """Return the window of a surface point that draws directions: all that is above its horizon."""
    surface, mirrors = vertex.surface, world.mirrors
    creases = np.array([any(i in mirrors for i in edge.faces) for edge in found.edges])
    horizon = Halfspace(surface.normal)
    window = Window(
        surface.point, vertex.moving.point, [horizon], None, own=surface.face, slip=mirrors, creases=creases
    )

    def give(place):
        used = draws(vertex) & (dot(surface.normal, place.wi) > 0.0)

        def follow(hit):
            wi = follows(world, vertex.moving.point, place.wi, hit, hit.face == surface.face)
            shown = look_through(world.rest, mirrors, ray(surface.point, place.wi), hit)
            if shown is None:
                return wi
            mirror, behind = (world.values.faces.at(i) for i in (hit.face, shown.hit.face))
            distance = jnp.where(shown.there, hit.distance, 1.0)
            seen = flow_through(mirror, behind, vertex.moving.point, place.wi, distance, shown)
            return where(shown.there, seen.wi, wi)

        return Given(used, follow, reflects(world, strategy, vertex, place.wi))

    return window, give


def of_vertex_in_mirror(world: World, found: Silhouettes, strategy, vertex: Vertex, face):
    """Return the window of a surface point, seen in a mirror that its directions find."""
    surface = vertex.surface
    plane = plane_of(still(world.values.faces.at(face)))
    window = _mirror_window(world, found, face, surface.point, vertex.moving.point)
    horizon = Halfspace(reflected(plane, surface.normal))
    window = window._replace(bounds=[*window.bounds, horizon], slip=(), creases=False)

    def give(place):
        least, wi, is_seen = _through(world, found, face, window.point, place.wi)
        used = draws(vertex) & is_seen & (dot(wi, surface.normal) > 0.0) & (surface.face != face)
        used = used & is_free(world, found, surface.point, wi, least, surface.face, face)
        weight = at(world.rest.reflectance, face) * reflects(world, strategy, vertex, wi)

        def follow(hit):
            within = is_within(still(world.values.faces.at(hit.face)), window.point + place.wi * least)
            return follows(world, window.moving, place.wi, hit, within)

        return Given(used, follow, weight, least)

    return window, give


def jump(world: World, found: Silhouettes, window: Window, give, u, radiance_along):
    """Return what edges add: value 0, and its derivative.

    Coordinate ``u`` draws one; ``radiance_along(ray, hit)`` is an estimate of the radiance that a ray finds, with the
    same coordinates for both sides.
    """
    views = look(found, still(world.values.faces), window.point)
    table = pieces(found, views, window.bounds, window.cone, creases=window.creases, own=window.primitive)
    chosen = draw(u, table)
    place = place_on(found, views, chosen.which, chosen.angle, world.values.faces)
    given = give(place)
    seen = scan(world, found, place, window.point, window.own, given.least)
    used = given.used & seen.seen & (chosen.density > 0.0) & (place.distance > given.least)
    behind, goes_on = _side(world, place, place.away, -1.0, seen.behind)
    sides = [(-1.0, behind, used & (_slips(window, behind) | ~goes_on))]
    if window.slip != ():
        front, _ = _side(world, place, place.away * -1.0, 1.0, Hit(jnp.inf, -1))
        sides.append((1.0, front, used & _slips(window, front)))
    sides = [(sign, Hit(hit.distance, jnp.where(counts, hit.face, -1)), counts) for sign, hit, counts in sides]

    toward = ray(window.point + place.wi * given.least, place.wi)
    hits = [Hit(hit.distance - given.least, hit.face) for _, hit, _ in sides]
    lights = lax.map(lambda hit: radiance_along(toward, hit), jax.tree.map(lambda *x: jnp.stack(x), *hits))
    weight = jnp.where(used, place.stretch / jnp.where(used, chosen.density, 1.0), 0.0)
    total = black(world.rest)
    for k, (sign, hit, counts) in enumerate(sides):
        light = jax.tree.map(lambda x, k=k: x[k], lights)
        h = slip(place, window.moving, given.follow(hit), counts)
        total = total + where(counts, still(light * given.weight) * (sign * weight * motion(h)), black(world.rest))
    return total


def _slips(window: Window, hit: Hit):
    return True if window.slip is None else is_one_of(window.slip, hit.face)


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


# ---------------------------------------------------------------------------------------------------------- mirrors


def _mirror_window(world: World, found, face, point: Vec3, moving: Vec3) -> Window:
    row = world.values.faces.at(face)
    fixed, plane = still(row), plane_of(row)
    seen_from = still(image(plane, point))
    triangle = jnp.asarray(found.triangles)[face]
    corners, inside = corners_of(fixed, triangle), middle_of(fixed, triangle)
    normal = still(plane.normal)
    height = dot(normal, fixed.center - seen_from)
    beyond = Halfspace(normal * jnp.sign(height), jnp.abs(height))
    return Window(
        seen_from, image(plane, moving), [*pyramid(corners, inside, seen_from), beyond],
        cone_around(corners, inside, seen_from), face, jnp.asarray(world.rest.owner)[face],
    )  # fmt: skip


def _through(world, found, face, seen_from, wi):
    """Return how far from the image of a point the mirror is along a direction, the direction that it reflects, and
    whether it is seen there.
    """
    row = still(world.values.faces.at(face))
    plane = plane_of(row)
    speed = dot(plane.normal, wi)
    distance = dot(plane.normal, plane.point - seen_from) / jnp.where(speed != 0.0, speed, 1.0)
    triangle, disk = (jnp.asarray(kind)[face] for kind in kinds(found))
    is_seen = (distance > 0.0) & holds(row, seen_from + wi * distance, triangle, disk)
    return distance, reflected(plane, wi), is_seen
