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
    from the faces, and the sharp ones: where background lies beyond.
    """

    to_start: Vec3
    to_stop: Vec3
    first: Vec3
    second: Vec3
    normal: Vec3
    sharp: Any


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
    away = normal * -sides[0]
    return EdgeView(to_start, to_stop, first, cross(normal, first), away, sharp)


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


def edge_arcs(view: EdgeView, normal: Vec3, target: Faces | None, point: Vec3, triangle: bool | None) -> Arcs:
    """Return the part of every edge that lies above the horizon of ``normal`` and before a light; None: the sky.

    Before a flat light that is exactly the part whose light would come from there, by the planes through the point and
    the light's own edges (Cyrus and Beck 1978); before a sphere the part within its cone.
    """
    low, high = jnp.zeros_like(view.first.x), jnp.ones_like(view.first.x)
    low, high = _clip(low, high, dot(normal, view.to_start), dot(normal, view.to_stop))
    is_ball = target is not None and triangle is None
    if target is not None and not is_ball:
        corners = [target.center + target.half_u * u + target.half_v * v - point for u, v in CORNERS[triangle]]
        shift = -1.0 / 3.0 if triangle else 0.0
        inside = target.center + (target.half_u + target.half_v) * shift - point
        for a, b in zip(corners, [*corners[1:], corners[0]]):
            plane = cross(a, b)
            plane = plane * jnp.sign(dot(plane, inside))
            low, high = _clip(low, high, dot(plane, view.to_start), dot(plane, view.to_stop))
        # Nearer than the light's plane.
        across = cross(target.half_u, target.half_v)
        height = dot(across, inside)
        across, height = across * jnp.sign(height), jnp.abs(height)
        low, high = _clip(low, high, height - dot(across, view.to_start), height - dot(across, view.to_stop))
    begin, end = _angle_at(view, low), _angle_at(view, high)
    if is_ball:
        center, width = _within_cone(view, target, point)
        begin, end = larger(begin, center - width), smaller(end, center + width)
    there = view.sharp & (high > low)
    return Arcs(begin, jnp.where(there, larger(end - begin, 0.0), 0.0))


def rim_arcs(view: RimView, target: Faces | None, point: Vec3, triangle: bool | None) -> Arcs:
    """Return the part of every rim that lies before a light, or somewhat more; the whole of it before the sky."""
    middle = width = None
    if target is not None:
        axis, cosine = _cone_around(target, point, triangle)
        apart = dot(view.axis, axis)
        sine = jnp.sqrt(larger(1.0 - apart * apart, 1e-12))
        # Two circles on the sphere meet at this azimuth from the line between their centres.
        bound = (cosine - view.cosine * apart) / (view.sine * sine)
        width = jnp.where(cosine > 0.0, jnp.arccos(jnp.clip(bound, -1.0, 1.0)), np.pi)
        middle = jnp.arctan2(dot(axis, view.bitangent), dot(axis, view.tangent))
    else:
        middle, width = jnp.zeros_like(view.sine), jnp.full_like(view.sine, np.pi)
    return Arcs(middle - width, jnp.where(view.outside, 2.0 * width * view.sine, 0.0))


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


def _within_cone(view, ball, point):
    """Return the middle and half the width of the part of every great circle that lies in the cone of a sphere."""
    axis, cosine = _cone_around(ball, point, None)
    x, y = dot(axis, view.first), dot(axis, view.second)
    width = jnp.where(cosine > -1.0, jnp.arccos(jnp.clip(cosine / jnp.sqrt(x * x + y * y), -1.0, 1.0)), 4.0 * np.pi)
    # Arcs run from 0 to pi at most: count the middle from -pi / 2 on.
    middle = jnp.arctan2(y, x)
    return jnp.where(middle < -0.5 * np.pi, middle + 2.0 * np.pi, middle), width


def _cone_around(target, point, triangle):
    """Return axis and cosine of a cone that holds a light: exactly a sphere's, -1 from inside of one."""
    if triangle is None:
        to = target.center - point
        squared = dot(to, to)
        outside = squared > target.radius * target.radius
        sine2 = target.radius * target.radius / jnp.where(outside, squared, 1.0)
        return _direction(to), jnp.where(outside, jnp.sqrt(larger(1.0 - sine2, 0.0)), -1.0)
    corners = [target.center + target.half_u * u + target.half_v * v - point for u, v in CORNERS[triangle]]
    axis = _direction(target.center + (target.half_u + target.half_v) * (-1.0 / 3.0 if triangle else 0.0) - point)
    cosines = [dot(axis, _direction(c)) for c in corners]
    least = cosines[0]
    for c in cosines[1:]:
        least = smaller(least, c)
    return axis, least
