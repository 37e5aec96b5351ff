"""Which curves of a scene can be silhouettes: edges of flat faces, and the rims of spheres and disks.

Edges that coincide are one edge with several faces, so each is counted once, and none where faces go on into each
other. All of it is found once, outside of JAX, and holds as long as what touches moves together.
"""

import itertools
from typing import NamedTuple

import numpy as np

from ..transport import geometry
from ..transport.flats import FlatLight
from ..transport.primitives import is_concrete
from .contacts import resting
from .mirrors import IN_A_ROW

SAME = 1e-5  # of the size of the scene: points closer than that are one
CORNERS = {False: ((-1, -1), (1, -1), (1, 1), (-1, 1)), True: ((-1, -1), (1, -1), (-1, 1))}


class Edge(NamedTuple):
    """An edge: the faces that it belongs to, and its ends as coordinates (u, v) of the first of them."""

    faces: tuple[int, ...]
    start: tuple[int, int]
    stop: tuple[int, int]


class Silhouettes(NamedTuple):
    """The edges of a scene, the faces that are spheres, the primitive of each face, which faces are triangles, and the
    faces that are disks; and for each edge how it rests on each face, as ``contacts.resting`` says.

    Not ``known`` while JAX traces the scene: what coincides cannot be told then.
    """

    edges: tuple[Edge, ...]
    spheres: tuple[int, ...]
    owner: tuple[int, ...]
    triangles: tuple[bool, ...]
    disks: tuple[int, ...] = ()
    rests: tuple[tuple[int, ...], ...] = ()
    known: bool = True


def silhouettes_of(scene, bounces) -> tuple[Silhouettes, tuple[str, ...]]:
    """Return what can be a silhouette in a scene as it was made, and in words what paths of so many bounces see that is
    not covered.
    """
    found, flags = silhouettes(geometry.build(scene.as_given()[0]).outlines, scene.owner)
    curved = [i for i in scene.mirrors if i in found.spheres]
    if bounces and (curved or scene.dielectrics):
        some = " and ".join(name for name, faces in (("curved mirrors", curved), ("glass", scene.dielectrics)) if faces)
        flags += (f"edges that are seen over {some}: their images are not known",)
    if bounces > IN_A_ROW and len(set(scene.mirrors) - set(curved)) > 1:
        flags += (f"edges that are seen over more than {IN_A_ROW} mirrors, one after the other",)
    return found, flags


def silhouettes(outlines, owner) -> tuple[Silhouettes, tuple[str, ...]]:
    """Return what can be a silhouette, and in words what is not covered: where primitives pass through each other, or
    edges overlap in part."""
    if not is_concrete(outlines):
        return Silhouettes((), (), tuple(owner), (), known=False), ()
    spheres = [i for i, o in enumerate(outlines) if not isinstance(o, FlatLight)]
    disks = [i for i, o in enumerate(outlines) if isinstance(o, FlatLight) and o.disk]
    sides = [(i, a, b) for i, o in enumerate(outlines) if i not in (*spheres, *disks) for a, b in _sides(o)]
    ends = np.array([[_corner(outlines[i], a), _corner(outlines[i], b)] for i, a, b in sides]).reshape(-1, 2, 3)
    size = max([np.ptp(ends.reshape(-1, 3), axis=0).max(initial=0.0)] if len(ends) else [0.0])
    size = max([size, *(_radius(outlines[i]) for i in (*spheres, *disks))]) or 1.0
    edges: list[Edge] = []
    kept: list[int] = []
    for k, (face, a, b) in enumerate(sides):
        twin = next((j for j, other in enumerate(kept) if _is_same(ends[k], ends[other], SAME * size)), None)
        if twin is None:
            edges.append(Edge((face,), a, b))
            kept.append(k)
        else:
            edges[twin] = edges[twin]._replace(faces=(*edges[twin].faces, face))
    triangles = tuple(isinstance(o, FlatLight) and o.triangle for o in outlines)
    rests = resting(outlines, edges, ends[kept], SAME * size)
    found = Silhouettes(tuple(edges), tuple(spheres), tuple(owner), triangles, tuple(disks), rests)
    return found, _flags(outlines, owner, found, ends[kept], size)


def _sides(outline):
    corners = CORNERS[outline.triangle]
    return itertools.pairwise((*corners, corners[0]))


def _corner(outline, uv):
    center, half_u, half_v = (np.array(v, np.float64) for v in (outline.center, outline.half_u, outline.half_v))
    return center + half_u * uv[0] + half_v * uv[1]


def _is_same(a, b, tolerance):
    return any(np.abs(a - other).max() <= tolerance for other in (b, b[::-1]))


# ------------------------------------------------------------------------------------------------- what is missing


def _flags(outlines, owner, found, ends, size):
    flags = []
    pairs = itertools.combinations(range(len(ends)), 2)
    rims = [_rim(outlines[i]) for i in found.disks]
    shared = any(_is_same_rim(a, b, SAME * size) for a, b in itertools.combinations(rims, 2))
    if shared or any(_overlap(ends[i], ends[j], SAME * size) for i, j in pairs):
        flags.append("edges overlap in part: silhouettes there may be counted twice; divide them where they meet")
    flats = [i for i in range(len(outlines)) if i not in found.spheres]
    crossing = {
        tuple(sorted((owner[edge.faces[0]], owner[i])))
        for edge, segment in zip(found.edges, ends)
        for i in flats
        if owner[i] not in {owner[f] for f in edge.faces} and _pierces(segment, outlines[i], SAME)
    }
    crossing |= {
        tuple(sorted((owner[i], owner[j])))
        for i, rim in zip(found.disks, rims)
        for j in flats
        if i != j and any(_pierces(chord, outlines[j], SAME) for chord in _chords(rim, outlines[j]))
    }
    crossing |= {
        (owner[i], owner[j])
        for i, j in itertools.combinations(found.spheres, 2)
        if _spheres_cross(outlines[i], outlines[j], SAME * size)
    }
    crossing |= {
        tuple(sorted((owner[i], owner[j])))
        for i in found.spheres
        for j in flats
        if _cuts(outlines[i], outlines[j], SAME * size)
    }
    if crossing:
        some = ", ".join(f"{a} and {b}" for a, b in sorted(crossing)[:4])
        flags.append(f"primitives pass through each other ({some}): where they meet is no edge that is known")
    return tuple(flags)


def _overlap(a, b, tolerance):
    """Return whether two segments that are not the same share more than a point."""
    along = a[1] - a[0]
    length = np.linalg.norm(along)
    along = along / length
    places = (b - a[0]) @ along
    if np.abs(b - a[0] - places[:, None] * along).max() > tolerance:
        return False
    return min(places.max(), length) - max(places.min(), 0.0) > 2.0 * tolerance


def _pierces(segment, outline, margin):
    """Return whether a segment passes through the inside of a flat face."""
    center, half_u, half_v = (np.array(v, np.float64) for v in (outline.center, outline.half_u, outline.half_v))
    normal = np.cross(half_u, half_v)
    heights = (segment - center) @ normal / np.linalg.norm(normal)
    small = margin * np.linalg.norm(segment[1] - segment[0])
    if min(heights) > -small or max(heights) < small:
        return False
    point = segment[0] + (segment[1] - segment[0]) * heights[0] / (heights[0] - heights[1]) - center
    u, v = np.cross(point, half_v) @ normal / (normal @ normal), np.cross(half_u, point) @ normal / (normal @ normal)
    if outline.disk:
        return np.hypot(u, v) < 1.0 - margin
    return max(abs(u), abs(v)) < 1.0 - margin and not (outline.triangle and u + v > -margin)


def _radius(outline):
    return float(np.linalg.norm(outline.half_u) if isinstance(outline, FlatLight) else outline.radius)


def _rim(disk):
    """Return the centre of a disk and two radii at right angles, shape (3, 3)."""
    return np.array([disk.center, disk.half_u, disk.half_v], np.float64)


def _is_same_rim(a, b, tolerance):
    (center, u, v), (other, s, t) = a, b
    aside = np.linalg.norm(np.cross(np.cross(u, v), np.cross(s, t))) / (np.linalg.norm(u) * (s @ s))
    return max(np.linalg.norm(center - other), abs(np.linalg.norm(u) - np.linalg.norm(s)), aside) <= tolerance


def _chords(rim, flat):
    """Return short segments through the plane of a flat face, one at each point where a rim crosses it."""
    center, u, v = rim
    plane = np.array([flat.center, flat.half_u, flat.half_v], np.float64)
    normal = np.cross(plane[1], plane[2]) / np.linalg.norm(np.cross(plane[1], plane[2]))
    height, along = normal @ (center - plane[0]), np.hypot(u @ normal, v @ normal)
    if abs(height) >= (1.0 - SAME) * along:
        return []
    middle, half = np.arctan2(v @ normal, u @ normal), np.arccos(-height / along)
    crossings = [center + u * np.cos(a) + v * np.sin(a) for a in (middle - half, middle + half)]
    reach = SAME * np.linalg.norm(u) * normal
    return [np.array([c - reach, c + reach]) for c in crossings]


def _spheres_cross(a, b, tolerance):
    apart = np.linalg.norm(np.subtract(a.center, b.center))
    return abs(a.radius - b.radius) + tolerance < apart < a.radius + b.radius - tolerance


def _cuts(sphere, flat, tolerance):
    """Return whether a sphere's surface meets a flat face: its nearest point is inside, its farthest outside."""
    center = np.array(sphere.center, np.float64)
    if flat.disk:
        middle, u, v = _rim(flat)
        height, away = np.cross(u, v) @ (center - middle) / (u @ u), center - middle
        aside, radius = np.sqrt(max(away @ away - height**2, 0.0)), _radius(flat)
        nearest, farthest = np.hypot(max(aside - radius, 0.0), height), np.hypot(aside + radius, height)
        return nearest < sphere.radius - tolerance and farthest > sphere.radius + tolerance
    corners = np.array([_corner(flat, uv) for uv in CORNERS[flat.triangle]])
    farthest = np.linalg.norm(corners - center, axis=1).max()
    return _distance(center, corners) < sphere.radius - tolerance and farthest > sphere.radius + tolerance


def _distance(point, corners):
    """Return the distance of a point from a convex flat polygon."""
    normal = np.cross(corners[1] - corners[0], corners[-1] - corners[0])
    normal = normal / np.linalg.norm(normal)
    starts, sides = corners, np.roll(corners, -1, axis=0) - corners
    if np.all(np.cross(sides, point - starts) @ normal >= 0.0):
        return abs((point - corners[0]) @ normal)
    share = np.clip(np.sum((point - starts) * sides, axis=1) / np.sum(sides * sides, axis=1), 0.0, 1.0)
    return np.linalg.norm(starts + share[:, None] * sides - point, axis=1).min()
