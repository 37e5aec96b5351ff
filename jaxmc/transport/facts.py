"""What is known of a scene before any ray: where it lies, what touches what, what can cast a shadow.

All of it is computed once, in float64, from the faces of the primitives as the user gave them: spheres, quads,
triangles and disks. While JAX traces the geometry nothing is known, and every answer is the safe one.
"""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .primitives import Box, Disk, Quad, Sphere, Triangle, as_unit, is_concrete
from .vec import Vec3, frame

LARGE = 16.0  # the largest primitive counts as large if it has so many times the size of all the others together
ROWS = 256  # faces that are compared with all others at a time
TIGHT = 1e-3  # of the scene: a gap in which rounding would be felt


class Layout(NamedTuple):
    """Where a scene lies. Coordinates of the kernel are relative to ``middle``, shape (3,), which float32 holds
    exactly; ``extent`` is the largest of them by size. ``grain`` is the rounding of a coordinate, the user's own
    included. ``large`` are the primitives left out of all three. All primitives lie within ``reach`` of the middle.
    """

    middle: np.ndarray
    extent: float
    grain: float
    large: tuple[int, ...]
    reach: float


def is_known(primitives) -> bool:
    """Return whether the geometry is known: not while JAX traces it."""
    return is_concrete([[getattr(p, name) for name in _places(p) + _lengths(p)] for p in primitives])


def _places(p):
    """Return the names of the attributes that move with a primitive."""
    kinds = {
        Sphere: ("center",), Disk: ("center",), Box: ("center",), Quad: ("corner",), Triangle: ("a", "b", "c"),
    }  # fmt: skip
    return kinds[type(p)]


def _lengths(p):
    """Return the names of the attributes that do not."""
    kinds = {
        Sphere: ("radius",), Disk: ("normal", "radius"), Box: ("size", "axes"), Quad: ("edge_u", "edge_v"),
        Triangle: (),
    }  # fmt: skip
    return kinds[type(p)]


def faces_of(primitive) -> list:
    """Return the faces of a primitive: itself, or the six sides of a box as quads, numbered as ``boxes`` does."""
    if not isinstance(primitive, Box):
        return [primitive]
    known = is_concrete((primitive.center, primitive.size, primitive.axes))
    center, size, axes = (
        np.asarray(x, np.float64) if known else jnp.stack([jnp.asarray(row) for row in x])
        for x in (primitive.center, primitive.size, primitive.axes)
    )
    edges = size[:, None] * axes
    left_handed = known and np.linalg.det(axes) < 0.0
    faces = []
    for k in range(3):
        for sign in (-1.0, 1.0):
            u, v = edges[(k + 1) % 3], edges[(k + 2) % 3]
            corner = center + 0.5 * (sign * edges[k] - u - v)
            # The normal is along cross(u, v).
            faces.append(Quad(corner, *((u, v) if (sign > 0.0) ^ primitive.inward ^ left_handed else (v, u))))
    return faces


def check_range(primitives) -> None:
    """Raise ``ValueError`` where squares of lengths would leave the range of the kernel's numbers."""
    kind = jnp.result_type(float)
    least = float(jnp.finfo(kind).tiny) ** 0.4
    for p in primitives:
        if not is_known([p]):
            continue
        sizes = [float(s) for s in _sizes(p)]
        lengths = [*sizes, *(float(np.abs(getattr(p, name)).max()) for name in _places(p))]
        if min(sizes) < least or max(lengths) > 1.0 / least:
            wrong = min(sizes) if min(sizes) < least else max(lengths)
            raise ValueError(
                f"a {type(p).__name__} has a length of {wrong:g}, but {kind} holds the squares of lengths from "
                f"{least:.0e} to {1.0 / least:.0e} only; scale the scene"
            )


def _sizes(p):
    """Return the lengths that make the size of a primitive."""
    if isinstance(p, Sphere | Disk):
        return [p.radius]
    if isinstance(p, Box):
        return list(p.size)
    return [math.hypot(*edge) for edge in edges_of(p)]  # whatever its square is


def edges_of(face):
    """Return the two edges of a quad or a triangle that meet in its first corner, shape (3,) each."""
    if isinstance(face, Quad):
        return np.asarray(face.edge_u, np.float64), np.asarray(face.edge_v, np.float64)
    a, b, c = (np.asarray(x, np.float64) for x in (face.a, face.b, face.c))
    return b - a, c - a


def axes_of(disk: Disk) -> tuple[Vec3, Vec3, Vec3]:
    """Return the unit normal of a disk and two radii at right angles, in float64 where they are known."""
    normal = as_unit("Disk normal", disk.normal)
    tangent, bitangent = frame(normal, (-1.0 if normal.z < 0.0 else 1.0) if is_concrete(normal) else None)
    radius = float(disk.radius) if is_concrete(disk.radius) else disk.radius
    return normal, tangent * radius, bitangent * radius


def check_radiances(name, colors) -> None:
    """Raise ``ValueError`` where a radiance is too large for the kernel's numbers, or so small that they make it 0."""
    kind = jnp.result_type(float)
    least, most = float(jnp.finfo(kind).tiny), float(jnp.finfo(kind).max)
    for c in (c for rgb in colors for c in rgb):
        if is_concrete(c) and c != 0.0 and not least <= abs(c) <= most:
            raise ValueError(f"{name} {c:g} lies outside {kind}, which goes from {least:.0e} to {most:.0e}; scale it")


def layout(primitives) -> Layout:
    """Return where a scene lies.

    A scene that lies farther from the origin than its own size is given relative to its middle, so that moving a scene
    costs no digits. A ground of many times its size does not count: what happens, happens on a small part of it.
    """
    boxes = {i: _box(p) for i, p in enumerate(primitives) if is_known([p])}
    if not boxes:
        return Layout(np.zeros(3), 1e-30, 0.0, (), np.inf)
    rest, large = sorted(boxes, key=lambda i: _size(boxes[i])), []
    while len(rest) > 1 and _size(boxes[rest[-1]]) > LARGE * _size(_union(boxes[i] for i in rest[:-1])):
        large.append(rest.pop())
    together = _union(boxes[i] for i in rest)
    middle = together.mean(0).astype(np.float32).astype(np.float64)
    if len(boxes) < len(primitives) or np.abs(middle).max() <= _size(together):
        middle = np.zeros(3)
    farthest = max(np.linalg.norm(np.abs(box - middle).max(0)) for box in boxes.values())
    reach = float(farthest) if len(boxes) == len(primitives) else np.inf
    extent = float(np.abs(together - middle).max())
    grain = _eps(float) * extent + max(_given_eps(primitives[i]) for i in rest) * float(np.abs(together).max())
    return Layout(middle, extent, grain, tuple(sorted(large)), reach)


def _eps(kind):
    return float(jnp.finfo(jnp.result_type(kind)).eps)


def _given_eps(p):
    """Return the rounding of the numbers that a primitive was given in."""
    arrays = [np.asarray(getattr(p, name)) for name in _places(p)]
    return max(float(np.finfo(a.dtype if a.dtype.kind == "f" else np.float64).eps) for a in arrays)


def moved(primitive, offset):
    """Return a primitive moved by ``offset``, shape (3,)."""
    places = {name: np.asarray(getattr(primitive, name), np.float64) + offset for name in _places(primitive)}
    return dataclasses.replace(primitive, **places)


def _box(p):
    """Return the lower and the upper corner of the box around a face, shape (2, 3)."""
    if not isinstance(p, Sphere | Disk):
        points = corners(p)
        return np.stack([points.min(0), points.max(0)])
    center = np.asarray(p.center, np.float64)
    half = np.hypot(*map(np.array, axes_of(p)[1:])) if isinstance(p, Disk) else p.radius
    return np.stack([center - half, center + half])


def _union(boxes):
    lower, upper = zip(*boxes)
    return np.stack([np.min(lower, 0), np.max(upper, 0)])


def _size(box):
    return float((box[1] - box[0]).max()) / 2.0


def corners(face) -> np.ndarray:
    """Return the corners of a parallelogram or of a triangle, its last one twice, shape (4, 3)."""
    corner = np.asarray(face.corner if isinstance(face, Quad) else face.a, np.float64)
    u, v = edges_of(face)
    return np.stack([corner, corner + u, corner + v, corner + u + v if isinstance(face, Quad) else corner + v])


class Touch(NamedTuple):
    """What faces have to do with each other, each a tuple over the faces or of their numbers.

    twins: for each face the others on the same plane or sphere: a ray that leaves it cannot meet them either.
    free: for each face whether it is flat and touches no other, so that its edges need not overlap.
    casters: those that can lie between two points of the scene. A flat one with all of it on one side cannot.
    empty: the spheres with no part of the scene inside.
    tight: whether two planes lie so close to each other that a hit must be exactly on its own.
    """

    twins: tuple[tuple[int, ...], ...]
    free: tuple[bool, ...]
    casters: tuple[int, ...]
    empty: tuple[int, ...]
    tight: bool


def touch(faces, normals, layout: Layout) -> Touch:
    """Return what faces have to do with each other; ``normals`` are those of the flat ones, None for spheres."""
    count = len(faces)
    if not is_known(faces):
        return Touch(((),) * count, (False,) * count, tuple(range(count)), (), True)
    flat = np.array([n is not None for n in normals], bool)
    normal = np.array([(0.0, 0.0, 0.0) if n is None else n for n in normals]).reshape(-1, 3)
    points = np.array([_points(p) for p in faces]).reshape(-1, 4, 3)
    radius = np.array([p.radius if isinstance(p, Sphere | Disk) else 0.0 for p in faces])
    # Some rows at a time: memory for all pairs would be large.
    parts = [
        _compare(np.arange(i, min(i + ROWS, count)), flat, normal, points, radius, layout)
        for i in range(0, count, ROWS)
    ]
    hull, clear, uncut, coplanar, same, tight, apart = (np.concatenate(p) for p in zip(*parts)) if parts else [flat] * 7
    twins = (coplanar & coplanar.T) | same
    numbers = np.arange(count)
    return Touch(
        twins=tuple(tuple(numbers[row].tolist()) for row in twins),
        free=tuple((flat & (apart | apart.T).all(1)).tolist()) if count else (),
        casters=tuple(numbers[~hull].tolist()),
        empty=tuple(numbers[~flat & clear & uncut.all(0)].tolist()) if count else (),
        tight=bool((tight & ~twins).any()),
    )


def _compare(rows, flat, normal, points, radius, layout):
    """Compare the faces ``rows`` with all: for each row whether it has the whole scene on one side, and whether it is a
    sphere apart from all others; for each pair whether the row's plane misses the other, a sphere; whether that is
    flat in the same plane; the same sphere; flat in a plane close by; apart from it.
    """
    slack = 4.0 * layout.grain
    other = rows[:, None] != np.arange(len(flat))
    both, neither = flat[rows, None] & flat & other, ~flat[rows, None] & ~flat & other

    # Heights of the points of face j over the plane of face i, at [i, j], and how far apart the centres are. The rim of
    # a disk goes as far as it is tilted.
    height = np.einsum("ijkx,ix->ijk", points - points[rows, None, :1], normal[rows])
    tilt = np.linalg.norm(np.cross(normal[rows, None], normal), axis=-1)
    reach = radius * np.where(flat, tilt, 1.0)
    low, high = height.min(-1) - reach, height.max(-1) + reach
    distance = np.linalg.norm(points[rows, None, 0] - points[:, 0], axis=-1)
    hull = flat[rows] & ((low >= -slack).all(1) | (high <= slack).all(1))

    # A flat face counts as its whole plane: a sphere is then called empty too rarely, never too often.
    clear = ((distance >= radius[rows, None] + radius - slack) | ~neither).all(1)
    uncut = (np.abs(height[:, :, 0]) >= radius - slack) | ~flat[rows, None]

    beyond = np.maximum(np.abs(low), np.abs(high))  # the largest height of j over the plane of i
    same = neither & (distance <= slack) & (np.abs(radius[rows, None] - radius) <= slack)
    lower, upper = points.min(1) - radius[:, None], points.max(1) + radius[:, None]
    apart = (lower[rows, None] - upper > slack).any(-1) | (low > slack) | (high < -slack) | ~both
    return hull, clear, uncut, both & (beyond <= slack), same, both & (beyond < TIGHT * layout.extent), apart


def _points(p):
    """Return the corners of a face, or the centre of a round one four times, shape (4, 3)."""
    if isinstance(p, Sphere | Disk):
        return np.broadcast_to(np.asarray(p.center, np.float64), (4, 3))
    return corners(p)
