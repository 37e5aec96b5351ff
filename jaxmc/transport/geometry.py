"""From the primitives of a scene to the shapes, tables and facts that the kernel uses."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import facts
from .boxes import BoxShape
from .flats import FlatLight, FlatShape
from .lookups import lookup, lookups
from .primitives import Box, Disk, Sphere, Triangle, as_vec3, is_concrete
from .shape_tables import MANY, ShapeTable, table_of
from .spheres import SphereShape
from .vec import Vec3, cross, dot

SQUARE = 1e-6  # cosine of edges that count as perpendicular


class Geometry(NamedTuple):
    """Where everything is; see ``Scene`` for most of it.

    shapes: those that stand for themselves in the kernel, ``first`` the number of the first face of each.
    tables: the others, where there are many of a kind.
    outlines: for each face a ``FlatLight`` or a ``SphereShape``, as lights need it.
    """

    owner: tuple[int, ...]
    first: tuple[int, ...]
    shapes: tuple
    tables: tuple[ShapeTable, ...]
    outlines: list
    twins: tuple[tuple[int, ...], ...]
    casters: tuple[int, ...]
    empty: tuple[int, ...]
    tight: bool
    middle: Any
    reach: Any
    normal: Any
    anchor: Any
    inverse_radius: Any
    inset: Any


def build(primitives) -> Geometry:
    """Return the geometry of a scene."""
    layout = facts.layout([face for p in primitives for face in facts.faces_of(p)])
    if layout.middle.any():
        primitives = [facts.moved(p, -layout.middle) for p in primitives]
    faces = [facts.faces_of(p) for p in primitives]
    owner = tuple(i for i, some in enumerate(faces) for _ in some)
    firsts = [owner.index(i) for i in range(len(primitives))]
    faces = [face for some in faces for face in some]
    outlines = [
        _sphere_shape(face, i in layout.large) if isinstance(face, Sphere) else _frame(face)
        for i, face in enumerate(faces)
    ]
    flat = [isinstance(outline, FlatLight) for outline in outlines]
    touch = facts.touch(faces, [o.normal if f else None for o, f in zip(outlines, flat)], layout)

    # Flat faces that touch each other overlap by rounding, so that no ray slips between them. The edges of a large one
    # are far away.
    alone = [free or i in layout.large for i, free in enumerate(touch.free)]
    rounding = [0.0 if a or not f else _rounding(o, layout.grain) for o, a, f in zip(outlines, alone, flat)]
    shapes = [_shape(p, i, outlines, touch.twins, rounding) for p, i in zip(primitives, firsts)]
    single, tables = _apart(shapes, firsts, touch)
    nowhere = Vec3(0.0, 0.0, 0.0)
    inward = [isinstance(f, Sphere) and f.inward for f in faces]
    curvature = [0.0 if f else (-1.0 if i else 1.0) / o.radius for f, i, o in zip(flat, inward, outlines)]
    return Geometry(
        owner=owner,
        first=tuple(firsts[i] for i in single),
        shapes=tuple(shapes[i] for i in single),
        tables=tables,
        outlines=outlines,
        twins=touch.twins,
        casters=touch.casters,
        empty=touch.empty,
        tight=touch.tight,
        middle=layout.middle.astype(jnp.result_type(float)),
        reach=layout.reach,
        normal=lookups([o.normal if f else nowhere for o, f in zip(outlines, flat)] or [nowhere]),
        anchor=lookups([o.centroid if f else o.center for o, f in zip(outlines, flat)] or [nowhere]),
        inverse_radius=lookup(curvature) if not all(flat) else None,
        inset=lookup([2.0 * r for r in rounding]),
    )


def _shape(primitive, first, outlines, twins, rounding):
    outline = outlines[first]
    if isinstance(primitive, Sphere):
        return outline
    if isinstance(primitive, Box):
        return _box_shape([outlines[first + 2 * k + 1] for k in range(3)], primitive)
    plane = outlines[min(first, *twins[first])] if twins[first] else outline
    return _flat_shape(outline, plane, rounding[first])


def _apart(shapes, firsts, touch):
    """Return the numbers of the shapes that stand for themselves, and tables of those of which there are many."""
    kinds: dict[Any, list[int]] = {}
    for i, shape in enumerate(shapes):
        large = isinstance(shape, SphereShape) and shape.power is not None
        outline = [getattr(shape, name, False) for name in ("triangle", "disk")]
        kinds.setdefault((type(shape), *outline, large), []).append(i)
    single, tables = [], []
    for numbers in kinds.values():
        if len(numbers) <= MANY:
            single += numbers
            continue
        faces = [firsts[i] for i in numbers]
        plane = [min(face, *touch.twins[face]) if touch.twins[face] else face for face in faces]
        tables.append(table_of([_dense(shapes[i]) for i in numbers], faces, plane, set(faces) <= set(touch.empty)))
    return sorted(single), tuple(tables)


def _dense(shape):
    """Return a shape with all components that ``FlatShape`` and ``BoxShape`` leave out."""
    if isinstance(shape, SphereShape):
        return shape
    if isinstance(shape, BoxShape):
        return BoxShape(tuple(Vec3(*map(_or_zero, row)) for row in shape.rows), tuple(map(_or_zero, shape.offsets)))
    normal = shape.normal or Vec3(*(1.0 if k == shape.axis else 0.0 for k in range(3)))
    return FlatShape(
        Vec3(*map(_or_zero, normal)), _or_zero(shape.offset), Vec3(*map(_or_zero, shape.row_u)),
        _or_zero(shape.offset_u), Vec3(*map(_or_zero, shape.row_v)), _or_zero(shape.offset_v), shape.limit, None,
        shape.triangle, shape.disk,
    )  # fmt: skip


def _or_zero(x):
    return 0.0 if x is None else x


def _frame(face) -> FlatLight:
    if isinstance(face, Disk):
        normal, half_u, half_v = facts.axes_of(face)
        area = np.pi * dot(half_u, half_u)
        return FlatLight(as_vec3("center", face.center), half_u, half_v, normal, area, disk=True)
    triangle = isinstance(face, Triangle)
    if triangle:
        corner, b, c = (as_vec3("corner", x) for x in (face.a, face.b, face.c))
        half_u, half_v = (b - corner) * 0.5, (c - corner) * 0.5
    else:
        corner, half_u, half_v = (
            as_vec3("corner", face.corner),
            *(as_vec3("edge", edge) * 0.5 for edge in (face.edge_u, face.edge_v)),
        )
    n = cross(half_u, half_v)
    length = dot(n, n) ** 0.5
    area = (2.0 if triangle else 4.0) * length
    edges = half_u, half_v
    rectangle = not triangle and is_concrete(edges) and abs(dot(*edges)) <= SQUARE * float(length)
    return FlatLight(corner + half_u + half_v, *edges, n / length, area, triangle, rectangle=bool(rectangle))


def _flat_shape(frame: FlatLight, plane: FlatLight, rounding) -> FlatShape:
    """Return a flat shape; twins share the numbers of one ``plane``, so that none is in front of another."""
    row_u, row_v = cross(frame.half_v, frame.normal), cross(frame.normal, frame.half_u)
    row_u, row_v = row_u / dot(row_u, frame.half_u), row_v / dot(row_v, frame.half_v)
    normal, offset = _without_zeros(plane.normal), dot(plane.normal, plane.center)
    present = [k for k in range(3) if normal[k] is not None]
    axis = present[0] if len(present) == 1 else None
    if axis is not None:
        normal, offset = None, plane.center[axis]
    rows = [(_without_zeros(r), _none_if_zero(dot(r, frame.center))) for r in (row_u, row_v)]
    return FlatShape(normal, offset, *rows[0], *rows[1], 1.0 + rounding, axis, frame.triangle, frame.disk)


def _box_shape(sides, box: Box) -> BoxShape:
    """Return a box from the outlines of its three sides in the directions of its axes."""
    center = as_vec3("center", box.center)
    rows = []
    for side in sides:
        outward = side.center - center
        rows.append(outward / dot(outward, outward))
    return BoxShape(tuple(map(_without_zeros, rows)), tuple(_none_if_zero(dot(r, center)) for r in rows))


def _sphere_shape(sphere: Sphere, large) -> SphereShape:
    radius = float(sphere.radius) if is_concrete(sphere.radius) else sphere.radius
    center = as_vec3("center", sphere.center)
    return SphereShape(center, radius, dot(center, center) - radius * radius if large else None)


def _none_if_zero(x):
    return None if is_concrete(x) and x == 0.0 else x


def _without_zeros(v):
    return Vec3(*map(_none_if_zero, v))


def _rounding(frame, grain):
    """Return the rounding error of a hit in a face's own coordinates, which run from -1 to 1."""
    shorter = jnp.minimum if not is_concrete(jax.tree.leaves(frame)) else min
    half = shorter(dot(frame.half_u, frame.half_u) ** 0.5, dot(frame.half_v, frame.half_v) ** 0.5)
    return 4.0 * (float(jnp.finfo(jnp.result_type(float)).eps) + grain / half)
