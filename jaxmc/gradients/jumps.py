"""What moving edges add to light that arrives along directions that are given: by a camera, or over a plane mirror.

There nothing stays in place by itself. With h the distance by which an edge moves over the directions given, the
integrand is (L_front - L_behind) h: all edges count where radiance jumps, also those between two faces that are seen.
A mirror shows what would be seen from the point's own image behind it (Zeltner et al. 2021 on attached sampling).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..transport.hits import Hit, at
from ..transport.lights import black
from ..transport.rays import ray
from ..transport.vec import Vec3, cross, dot, normalize, where
from .arcs import Cone, Halfspace, cone_around, corners_of, middle_of, pyramid
from .curves import Place, draw, holds, kinds, look, pieces, place_on
from .flows import Faces, attach, flow, motion, still, turning_at
from .shadows import draws, is_free, scan
from .silhouettes import Silhouettes
from .walks import Vertex, evaluate
from .world import World


class Window(NamedTuple):
    """Where a point looks, at rest and in motion: within these bounds, and for rims in the ``cone`` that holds them.
    Through a mirror it is the point's image, ``own`` the mirror's face and ``primitive`` what that belongs to.
    """

    point: Vec3
    moving: Vec3
    bounds: list[Halfspace]
    cone: Cone
    own: Any = -1
    primitive: Any = -1


class Given(NamedTuple):
    """A direction that is given: whether it is, as it moves, the weight of radiance along it, how far the mirror is."""

    used: Any
    wi: Vec3
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
        return Given(used, moving, weight)

    return window, give


def of_film_in_mirror(world: World, found: Silhouettes, part: Rectangle, face, importance):
    """Return the window of a part of the film, seen in a mirror."""
    camera, rest = world.values.place, world.rest
    fixed = still(camera)
    corners = [_image(world, face, c, fixed=True) for c in _film_corners(fixed, part)]
    window = _mirror_window(world, found, face, fixed.origin, camera.origin)
    inside = corners[0] + (corners[2] - corners[0]) * 0.5
    window = window._replace(bounds=window.bounds + pyramid(corners, inside, window.point))

    def give(place):
        least, wi, is_seen = _through(world, found, face, window.point, place.wi)
        used, moving, weight = _on_film(world, part, wi, importance)
        used = used & is_seen & is_free(world, found, fixed.origin, wi, least, -1, face)
        return Given(used, _reflected(world, face, moving), at(rest.reflectance, face) * weight, least)

    return window, give


def of_vertex_in_mirror(world: World, found: Silhouettes, strategy, vertex: Vertex, face):
    """Return the window of a surface point, seen in a mirror that its directions find."""
    rest, surface = world.rest, vertex.surface
    window = _mirror_window(world, found, face, surface.point, vertex.moving.point)
    horizon = Halfspace(_reflected(world, face, surface.normal, fixed=True))
    window = window._replace(bounds=[*window.bounds, horizon])

    def give(place):
        least, wi, is_seen = _through(world, found, face, window.point, place.wi)
        used = draws(vertex) & is_seen & (dot(wi, surface.normal) > 0.0) & (surface.face != face)
        used = used & is_free(world, found, surface.point, wi, least, surface.face, face)
        pinned = flow(world.values.faces.at(face), vertex.moving.point, wi, jnp.where(used, least, 1.0)).wi
        still_vertex = jax.tree.map(still, vertex)
        value = still(evaluate(world, strategy, still_vertex, wi)) * (1.0 / jnp.pi)
        return Given(
            used, _reflected(world, face, pinned), still(vertex.beta) * at(rest.reflectance, face) * value, least
        )

    return window, give


def jump(world: World, found: Silhouettes, window: Window, give, u, radiance_along):
    """Return what edges add: value 0, and its derivative.

    Coordinate ``u`` draws one; ``radiance_along(ray, hit)`` is an estimate of the radiance that a ray finds, with the
    same coordinates for both sides.
    """
    views = look(found, still(world.values.faces), window.point)
    chosen = draw(u, pieces(found, views, window.bounds, window.cone, creases=True, own=window.primitive))
    place = place_on(found, views, chosen.which, chosen.angle, world.values.faces)
    given = give(place)
    seen = scan(world, found, place, window.point, window.own, given.least)
    used = given.used & seen.seen & (chosen.density > 0.0) & (place.distance > given.least)
    toward = ray(window.point + place.wi * given.least, place.wi)
    hits = [
        _side(world, place, place.away * -1.0, 1.0, Hit(jnp.inf, -1)),
        _side(world, place, place.away, -1.0, seen.behind),
    ]
    hits = [Hit(h.distance - given.least, jnp.where(used, h.face, -1)) for h in hits]

    both = lax.map(lambda hit: radiance_along(toward, hit), jax.tree.map(lambda *x: jnp.stack(x), *hits))
    front, behind = (jax.tree.map(lambda x, k=k: x[k], both) for k in (0, 1))
    away = (place.point - window.moving) * jnp.where(used, 1.0 / jnp.where(used, place.distance, 1.0), 0.0)
    h = jnp.where(used, dot(place.away, away) - dot(place.away, given.wi), 0.0)
    weight = jnp.where(used, place.stretch / jnp.where(used, chosen.density, 1.0), 0.0)
    value = still((front - behind) * given.weight) * (weight * motion(h))
    return where(used, value, black(world.rest))


def _side(world, place: Place, toward: Vec3, side, otherwise: Hit) -> Hit:
    """Return the face at an edge that is seen on one side of it: the one that comes nearer first."""
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
    return Hit(*(jnp.where(face >= 0, a, b) for a, b in zip((distance, face), otherwise)))


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


def _mirror(world: World, face, fixed: bool) -> tuple[Faces, Vec3]:
    """Return a plane mirror and its unit normal."""
    row = world.values.faces.at(face)
    normal = normalize(cross(row.half_u, row.half_v))
    return (still(row), still(normal)) if fixed else (row, attach(normal, turning_at(row, row.center, -normal)))


def _image(world, face, point, fixed=False):
    """Return the mirror image of a point."""
    row, normal = _mirror(world, face, fixed)
    return point - normal * (2.0 * dot(normal, point - row.center))


def _reflected(world, face, direction, fixed=False):
    """Return the mirror image of a direction."""
    _, normal = _mirror(world, face, fixed)
    return direction - normal * (2.0 * dot(normal, direction))


def _mirror_window(world: World, found, face, point: Vec3, moving: Vec3) -> Window:
    row, normal = _mirror(world, face, fixed=True)
    image = _image(world, face, point, fixed=True)
    triangle = jnp.asarray(found.triangles)[face]
    corners, inside = corners_of(row, triangle), middle_of(row, triangle)
    height = dot(normal, row.center - image)
    beyond = Halfspace(normal * jnp.sign(height), jnp.abs(height))
    return Window(
        image, _image(world, face, moving), [*pyramid(corners, inside, image), beyond],
        cone_around(corners, inside, image), face, jnp.asarray(world.rest.owner)[face],
    )  # fmt: skip


def _through(world, found, face, image, wi):
    """Return how far from the image of a point the mirror is along a direction, the direction that it reflects, and
    whether it is seen there.
    """
    row, normal = _mirror(world, face, fixed=True)
    speed = dot(normal, wi)
    distance = dot(normal, row.center - image) / jnp.where(speed != 0.0, speed, 1.0)
    triangle, disk = (jnp.asarray(kind)[face] for kind in kinds(found))
    is_seen = (distance > 0.0) & holds(row, image + wi * distance, triangle, disk)
    return distance, _reflected(world, face, wi, fixed=True), is_seen
