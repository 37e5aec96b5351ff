"""The silhouettes that a point sees before a light, as arcs of great circles (edges) and circles (rims of spheres).

Everything here counts as constant for derivatives. Lengths are angles: those of the curves on the sphere of directions.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..transport.vec import Vec3, cross, dot, frame, larger, smaller, where
from .flows import Faces
from .silhouettes import CORNERS, Silhouettes


class Arcs(NamedTuple):
    """Pieces of curves, each field an array over all of them: where they start, in radians along their circle, and how
    long they are on the sphere of directions; 0 for those that are not there.
    """

    start: Any
    length: Any


class EdgeView(NamedTuple):
    """Edges seen from a point: their ends from there, unit vectors along and across the great circle, its normal away
    from the first face, and the sharp ones: where all faces lie on one side, and background beyond. ``sides`` says for
    the first, second ... face of each edge on which side it lies, ``around`` which face that is.
    """

    to_start: Vec3
    to_stop: Vec3
    first: Vec3
    second: Vec3
    normal: Vec3
    seen: Any
    sharp: Any
    sides: Any
    around: Any


class RimView(NamedTuple):
    """Spheres seen from a point: direction to the centre, tangents across, sine and cosine of the angular radius, the
    distance of the rim, and whether the point is outside.
    """

    axis: Vec3
    tangent: Vec3
    bitangent: Vec3
    sine: Any
    cosine: Any
    distance: Any
    outside: Any


def ends_of(found: Silhouettes, faces: Faces) -> tuple[Vec3, Vec3]:
    """Return both ends of every edge; they move with the faces."""
    mine = faces.at(np.array([edge.faces[0] for edge in found.edges]))
    starts, stops = (np.array([getattr(e, name) for e in found.edges], float).T for name in ("start", "stop"))
    return tuple(mine.center + mine.half_u * uv[0] + mine.half_v * uv[1] for uv in (starts, stops))


def view_edges(found: Silhouettes, faces: Faces, point: Vec3) -> EdgeView:
    """Return all edges as seen from a point."""
    start, stop = ends_of(found, faces)
    to_start, to_stop = start - point, stop - point
    first = _direction(to_start)
    normal = cross(to_start, to_stop)
    squared = dot(normal, normal)
    seen = squared > 0.0  # an edge that points at the point has no length
    normal = normal * (1.0 / jnp.sqrt(jnp.where(seen, squared, 1.0)))
    # An edge is sharp where all of its faces lie on one side of it; otherwise one face goes on into the other.
    most = max(len(edge.faces) for edge in found.edges)
    around = np.array([(*e.faces, *[e.faces[0]] * (most - len(e.faces))) for e in found.edges])
    shift = np.where(np.array(found.triangles), -1.0 / 3.0, 0.0)
    sides = []
    for k in range(most):
        face = faces.at(around[:, k])
        middle = face.center + (face.half_u + face.half_v) * shift[around[:, k]] - start
        sides.append(jnp.sign(dot(middle, normal)))
    sharp = seen
    for side in sides[1:]:
        sharp = sharp & (side == sides[0])
    away, sides = normal * -sides[0], jnp.stack([side * sides[0] for side in sides], 1)
    return EdgeView(to_start, to_stop, first, cross(normal, first), away, seen, sharp, sides, jnp.asarray(around))


def view_rims(found: Silhouettes, faces: Faces, point: Vec3) -> RimView:
    """Return the rims of all spheres as seen from a point."""
    ball = faces.at(np.array(found.spheres))
    to = ball.center - point
    squared = dot(to, to)
    outside = squared > ball.radius * ball.radius
    axis = _direction(to)
    sine = jnp.where(outside, ball.radius * (1.0 / jnp.sqrt(jnp.where(outside, squared, 1.0))), 0.5)
    rest = jnp.sqrt(larger(squared - ball.radius * ball.radius, 0.0))
    return RimView(axis, *frame(axis), sine, jnp.sqrt(1.0 - sine * sine), rest, outside)


class Cone(NamedTuple):
    """Directions within an angle of an axis, by its cosine; -1: all of them."""

    axis: Vec3
    cosine: Any


class Halfspace(NamedTuple):
    """The points p with ``normal`` . (p - x) >= ``height``, seen from x."""

    normal: Vec3
    height: Any = 0.0


def edge_arcs(view: EdgeView, bounds: list[Halfspace], cone: Cone | None, wanted) -> Arcs:
    """Return the part of every wanted edge that lies in all of some half spaces (Cyrus and Beck 1978) and in a cone."""
    low, high = jnp.zeros_like(view.first.x), jnp.ones_like(view.first.x)
    for bound in bounds:
        ends = (dot(bound.normal, to) - bound.height for to in (view.to_start, view.to_stop))
        low, high = _clip(low, high, *ends)
    begin, end = _angle_at(view, low), _angle_at(view, high)
    if cone is not None:
        center, width = _within_cone(view, cone)
        begin, end = larger(begin, center - width), smaller(end, center + width)
    return Arcs(begin, jnp.where(wanted & (high > low), larger(end - begin, 0.0), 0.0))


def rim_arcs(view: RimView, cone: Cone | None) -> Arcs:
    """Return the part of every rim that lies in a cone, or somewhat more; the whole of it without one."""
    if cone is None:
        middle, width = jnp.zeros_like(view.sine), jnp.full_like(view.sine, np.pi)
    else:
        apart = dot(view.axis, cone.axis)
        sine = jnp.sqrt(larger(1.0 - apart * apart, 1e-12))
        # Two circles on the sphere meet at this azimuth from the line between their centres.
        bound = (cone.cosine - view.cosine * apart) / (view.sine * sine)
        width = jnp.where(cone.cosine >= 0.0, jnp.arccos(jnp.clip(bound, -1.0, 1.0)), np.pi)
        middle = jnp.arctan2(dot(cone.axis, view.bitangent), dot(cone.axis, view.tangent))
    return Arcs(middle - width, jnp.where(view.outside, 2.0 * width * view.sine, 0.0))


def corners_of(face: Faces, triangle) -> list[Vec3]:
    """Return four corners of a flat face, in their order around it; of a triangle the last one twice."""
    corners = (*CORNERS[True], CORNERS[True][-1])
    places = [tuple(jnp.where(triangle, a, b) for a, b in zip(*uv)) for uv in zip(corners, CORNERS[False])]
    return [face.center + face.half_u * u + face.half_v * v for u, v in places]


def middle_of(face: Faces, triangle) -> Vec3:
    """Return the centroid of a flat face."""
    return face.center + (face.half_u + face.half_v) * jnp.where(triangle, -1.0 / 3.0, 0.0)


def pyramid(corners: list[Vec3], inside: Vec3, point: Vec3) -> list[Halfspace]:
    """Return the half spaces in whose common part a convex polygon around ``inside`` appears, seen from a point."""
    bounds = []
    for a, b in zip(corners, [*corners[1:], corners[0]]):
        plane = cross(a - point, b - point)
        bounds.append(Halfspace(plane * jnp.sign(dot(plane, inside - point))))
    return bounds


def this_side(face: Faces, inside: Vec3, point: Vec3) -> Halfspace:
    """Return the half space of a flat face's plane that holds the point from which it is seen."""
    across = cross(face.half_u, face.half_v)
    height = dot(across, inside - point)
    return Halfspace(across * -jnp.sign(height), -jnp.abs(height))


def cone_around(corners: list[Vec3], inside: Vec3, point: Vec3) -> Cone:
    """Return a cone with its axis through ``inside`` that holds a polygon."""
    axis = _direction(inside - point)
    least = jnp.ones_like(axis.x)
    for corner in corners:
        least = smaller(least, dot(axis, _direction(corner - point)))
    return Cone(axis, least)


def cone_of_ball(ball: Faces, point: Vec3) -> Cone:
    """Return the cone of a sphere; from inside of one, all directions."""
    to = ball.center - point
    squared = dot(to, to)
    outside = squared > ball.radius * ball.radius
    sine2 = ball.radius * ball.radius / jnp.where(outside, squared, 1.0)
    return Cone(_direction(to), jnp.where(outside, jnp.sqrt(larger(1.0 - sine2, 0.0)), -1.0))


def _direction(to):
    """Return the unit vector along ``to``, any one where that is 0."""
    squared = dot(to, to)
    known = squared > 0.0
    return where(known, to * (1.0 / jnp.sqrt(jnp.where(known, squared, 1.0))), Vec3(0.0, 0.0, 1.0))


def _clip(low, high, at_start, at_stop):
    """Return the part of [low, high] where a function that is linear from ``at_start`` at 0 to ``at_stop`` at 1 is not
    negative."""
    slope = at_stop - at_start
    place = -at_start / jnp.where(slope != 0.0, slope, 1.0)
    low = jnp.where(slope > 0.0, larger(low, place), low)
    high = jnp.where(slope < 0.0, smaller(high, place), high)
    return low, jnp.where((slope == 0.0) & (at_start < 0.0), low, high)


def _angle_at(view, t):
    to = view.to_start + (view.to_stop - view.to_start) * t
    return jnp.arctan2(dot(to, view.second), dot(to, view.first))


def _within_cone(view, cone):
    """Return the middle and half the width of the part of every great circle that lies in a cone."""
    x, y = dot(cone.axis, view.first), dot(cone.axis, view.second)
    bound = jnp.clip(cone.cosine / jnp.sqrt(x * x + y * y), -1.0, 1.0)
    width = jnp.where(cone.cosine > -1.0, jnp.arccos(bound), 4.0 * np.pi)
    # Arcs run from 0 to pi at most: count the middle from -pi / 2 on.
    middle = jnp.arctan2(y, x)
    return jnp.where(middle < -0.5 * np.pi, middle + 2.0 * np.pi, middle), width
