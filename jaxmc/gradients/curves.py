"""Places on silhouettes as they are seen from a point: which there are, how one is drawn, and what lies behind it."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport.vec import Vec3, cross, dot, larger
from .arcs import Cone, EdgeView, Halfspace, RimView, edge_arcs, ends_of, rim_arcs, view_edges, view_rims
from .disks import DiskView, on_rim, rim_point, view_disks
from .flows import Faces, one_of, still
from .silhouettes import Silhouettes


class Views(NamedTuple):
    """All edges and the rims of all spheres and disks as seen from a point; None where there are none."""

    edges: EdgeView | None
    rims: RimView | None
    disks: DiskView | None


class Pieces(NamedTuple):
    """Pieces of curves as arrays: where they start, their length on the sphere of directions, and how much of it is in
    a unit of the angle that ``start`` is measured in.
    """

    start: Any
    length: Any
    rate: Any


class Draw(NamedTuple):
    """The number of a piece, where on it, and the density of that by length; 0 where there is nothing to draw."""

    which: Any
    angle: Any
    density: Any


class Place(NamedTuple):
    """A point on a silhouette; ``stretch`` is the length of the curve there to a unit of the length that was drawn.

    ``wi`` and ``distance`` say where it is seen, ``away`` is the unit normal of the curve from what is in front to what
    lies behind, on the sphere of directions; ``point`` moves. ``own`` says for each face whether the silhouette is its,
    ``rests`` how the silhouette lies on it, as ``contacts.resting``; ``around`` and ``sides`` are the faces at an edge,
    and on which side of it they lie: 1 in front. A rim has one face in front.
    """

    wi: Vec3
    distance: Any
    away: Vec3
    point: Vec3
    own: Any
    rests: Any
    around: Any
    sides: Any
    stretch: Any = 1.0


def look(found: Silhouettes, fixed: Faces, point: Vec3) -> Views:
    """Return everything that can be a silhouette as seen from a point."""
    edges = view_edges(found, fixed, point) if found.edges else None
    rims = view_rims(found, fixed, point) if found.spheres else None
    return Views(edges, rims, view_disks(found, fixed, point) if found.disks else None)


def pieces(found: Silhouettes, views: Views, bounds: list[Halfspace], cone: Cone | None, *, creases=False, own=-1):
    """Return the pieces within some half spaces, and within a cone: where that comes from bounds, it is for rims only.

    ``creases``: also those edges, all or those for which it is true, where one visible face goes on into another. Those
    of primitive ``own`` are left out.
    """
    parts, owner = [], np.array(found.owner)
    if views.edges is not None:
        wanted = views.edges.sharp | (views.edges.seen & creases)
        arcs = edge_arcs(views.edges, bounds, None if bounds[1:] else cone, wanted)
        mine = jnp.any(jnp.asarray(owner)[views.edges.around] == own, 1)
        parts.append(Pieces(arcs.start, jnp.where(mine, 0.0, arcs.length), jnp.ones_like(arcs.start)))
    if views.rims is not None:
        arcs = rim_arcs(views.rims, cone)
        mine = jnp.asarray(owner[list(found.spheres)]) == own
        parts.append(Pieces(arcs.start, jnp.where(mine, 0.0, arcs.length), views.rims.sine))
    if views.disks is not None:
        mine, size = jnp.asarray(owner[list(found.disks)]) == own, views.disks.size
        parts.append(Pieces(jnp.zeros_like(size), jnp.where(mine, 0.0, 2.0 * np.pi * size), size))
    return joined(parts)


def joined(parts: list[Pieces]) -> Pieces:
    """Return pieces as one table."""
    return Pieces(*map(jnp.concatenate, zip(*parts)))


def draw(u, table: Pieces) -> Draw:
    """Draw a place on some pieces, uniformly by length."""
    upto = jnp.cumsum(table.length)
    total = upto[-1]
    aim = u * total
    which = jnp.minimum(jnp.sum(upto <= aim), len(table.length) - 1)
    length = table.length[which]
    angle = table.start[which] + (aim - (upto[which] - length)) / table.rate[which]
    there = (total > 0.0) & (length > 0.0)
    return Draw(which, angle, jnp.where(there, 1.0 / jnp.where(total > 0.0, total, 1.0), 0.0))


def curves(found: Silhouettes) -> int:
    """Return how many curves there are."""
    return len(found.edges) + len(found.spheres) + len(found.disks)


def place_on(found: Silhouettes, views: Views, k, angle, faces: Faces) -> Place:
    """Return the place at an angle on curve number ``k``: edges come first, then rims of spheres, then of disks."""
    counts = np.cumsum([0, len(found.edges), len(found.spheres)])
    most = 1 if views.edges is None else views.edges.sides.shape[1]
    own, rests = (jnp.asarray(rows)[k] for rows in _of_faces(found))
    place = None
    for view, on, first in zip(views, (_on_edge, _on_sphere, _on_disk), counts):
        if view is not None:
            i = jnp.clip(k - first, 0, len(jax.tree.leaves(view)[0]) - 1)
            found_here = on(found, jax.tree.map(lambda a, i=i: a[i], view), i, angle, faces, (own, rests), most)
            place = found_here if place is None else jax.tree.map(partial(jnp.where, k >= first), found_here, place)
    return place


def _on_edge(found, e: EdgeView, i, angle, faces, of_faces, most):
    wi = e.first * jnp.cos(angle) + e.second * jnp.sin(angle)
    # Where on the edge that direction points: both are perpendicular to wi x normal.
    side, along = cross(e.normal, wi), e.to_stop - e.to_start
    slope = dot(along, side)
    t = -dot(e.to_start, side) / jnp.where(slope != 0.0, slope, 1.0)
    start, stop = (one_of(end, i) for end in ends_of(found, faces))
    distance = dot(e.to_start + along * t, wi)
    return Place(wi, distance, e.normal, start + (stop - start) * still(t), *of_faces, e.around, e.sides, jnp.ones(()))


def _on_sphere(found, r: RimView, i, angle, faces, of_faces, most):
    across = r.tangent * jnp.cos(angle) + r.bitangent * jnp.sin(angle)
    wi, away = r.axis * r.cosine + across * r.sine, across * r.cosine - r.axis * r.sine
    number = jnp.asarray(found.spheres)[i]
    ball = faces.at(number)
    around, sides = jnp.full(most, number), jnp.ones(most)
    return Place(wi, r.distance, away, ball.center + away * ball.radius, *of_faces, around, sides, jnp.ones(()))


def _on_disk(found, view: DiskView, i, angle, faces, of_faces, most):
    at, number = rim_point(view, angle), jnp.asarray(found.disks)[i]
    disk = faces.at(number)
    point = disk.center + on_rim(disk.half_u, disk.half_v, angle)
    around, sides = jnp.full(most, number), jnp.ones(most)
    return Place(at.wi, at.distance, at.away, point, *of_faces, around, sides, at.stretch)


def _of_faces(found):
    """Return for each silhouette which faces it belongs to, and how it rests on each."""
    faces, rounds = range(len(found.owner)), (*found.spheres, *found.disks)
    groups = [*(edge.faces for edge in found.edges), *((i,) for i in rounds)]
    own = np.array([[face in group for face in faces] for group in groups])
    return own, np.array([*found.rests, *([0] * len(faces) for _ in rounds)])


def distances(found: Silhouettes, faces: Faces, point: Vec3, wi: Vec3, own):
    """Return how far every face is along a ray from a point on face ``own``, infinite for a miss."""
    to = faces.center - point
    normal = cross(faces.half_u, faces.half_v)
    speed = dot(normal, wi)
    flat = dot(normal, to) / jnp.where(speed != 0.0, speed, 1.0)
    inside = holds(faces, point + wi * flat, *kinds(found))
    nearest = dot(to, wi)
    aside = to - wi * nearest
    chord2 = faces.radius * faces.radius - dot(aside, aside)
    half = jnp.sqrt(larger(chord2, 0.0))
    ball = jnp.where(nearest - half > 0.0, nearest - half, nearest + half)
    # From its own surface only the other root is left.
    is_own = jnp.arange(len(faces.radius)) == own
    ball = jnp.where(is_own, 2.0 * nearest, ball)
    met, hit = (chord2 > 0.0) & (ball > 0.0), inside & (flat > 0.0) & (speed != 0.0) & ~is_own
    is_ball = faces.radius > 0.0
    return jnp.where(jnp.where(is_ball, met, hit), jnp.where(is_ball, ball, flat), jnp.inf)


def kinds(found: Silhouettes):
    """Return for each face whether it is a triangle, and whether a disk."""
    return np.array(found.triangles), np.isin(np.arange(len(found.triangles)), found.disks)


def holds(face: Faces, point: Vec3, triangle, disk):
    """Return whether a point of the plane of a flat face lies inside of it."""
    offset, normal = point - face.center, cross(face.half_u, face.half_v)
    squared = dot(normal, normal)
    inverse = 1.0 / jnp.where(squared > 0.0, squared, 1.0)
    u = dot(cross(offset, face.half_v), normal) * inverse
    v = dot(cross(face.half_u, offset), normal) * inverse
    square = (jnp.abs(u) <= 1.0) & (jnp.abs(v) <= 1.0)
    return square & ~(triangle & (u + v > 0.0)) & ~(disk & (u * u + v * v > 1.0))
