"""What is known of a scene before any ray: where it lies, what touches what, what can cast a shadow.

All of it is computed once, in float64, from the primitives as the user gave them. While JAX traces the geometry nothing
is known, and every answer is the safe one.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .primitives import Quad, Sphere, is_concrete

LARGE = 16.0  # the largest primitive counts as large if it has so many times the size of all the others together
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
    return is_concrete(
        [(p.corner, p.edge_u, p.edge_v) if isinstance(p, Quad) else (p.center, p.radius) for p in primitives]
    )


def check_range(primitives) -> None:
    """Raise ``ValueError`` where squares of lengths would leave the range of the kernel's numbers."""
    kind = jnp.result_type(float)
    least = float(jnp.finfo(kind).tiny) ** 0.4
    for p in primitives:
        if not is_known([p]):
            continue
        sizes = [p.radius] if isinstance(p, Sphere) else [np.linalg.norm(p.edge_u), np.linalg.norm(p.edge_v)]
        lengths = [*sizes, np.abs(p.center if isinstance(p, Sphere) else p.corner).max()]
        if min(sizes) < least or max(lengths) > 1.0 / least:
            wrong = min(sizes) if min(sizes) < least else max(lengths)
            raise ValueError(
                f"a {type(p).__name__} has a length of {wrong:g}, but {kind} holds the squares of lengths from "
                f"{least:.0e} to {1.0 / least:.0e} only; scale the scene"
            )


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
    arrays = [np.asarray(x) for x in ((p.corner, p.edge_u, p.edge_v) if isinstance(p, Quad) else (p.center,))]
    return max(float(np.finfo(a.dtype if a.dtype.kind == "f" else np.float64).eps) for a in arrays)


def moved(primitive, offset):
    """Return a primitive moved by ``offset``, shape (3,)."""
    place = "corner" if isinstance(primitive, Quad) else "center"
    return dataclasses.replace(primitive, **{place: np.asarray(getattr(primitive, place), np.float64) + offset})


def _box(p):
    """Return the lower and the upper corner of the box around a primitive, shape (2, 3)."""
    if isinstance(p, Quad):
        points = corners(p)
        return np.stack([points.min(0), points.max(0)])
    center = np.asarray(p.center, np.float64)
    return np.stack([center - p.radius, center + p.radius])


def _union(boxes):
    lower, upper = zip(*boxes)
    return np.stack([np.min(lower, 0), np.max(upper, 0)])


def _size(box):
    return float((box[1] - box[0]).max()) / 2.0


def corners(quad) -> np.ndarray:
    """Return the corners of a parallelogram, shape (4, 3)."""
    corner, u, v = (np.asarray(x, np.float64) for x in (quad.corner, quad.edge_u, quad.edge_v))
    return np.stack([corner, corner + u, corner + v, corner + u + v])


class Touch(NamedTuple):
    """What primitives have to do with each other, each a tuple over the primitives or of their numbers.

    twins: for each primitive the others on the same plane or sphere: a ray that leaves it cannot meet them either.
    free: for each primitive whether it is a quad that touches no other, so that its edges need not overlap.
    casters: those that can lie between two points of the scene. A quad with all of it on one side of its plane cannot.
    empty: the spheres with no part of the scene inside.
    tight: whether two planes lie so close to each other that a hit must be exactly on its own.
    """

    twins: tuple[tuple[int, ...], ...]
    free: tuple[bool, ...]
    casters: tuple[int, ...]
    empty: tuple[int, ...]
    tight: bool


def touch(primitives, normals, layout: Layout) -> Touch:
    """Return what primitives have to do with each other; ``normals`` are those of the quads, None for spheres."""
    count = len(primitives)
    if not is_known(primitives):
        return Touch(((),) * count, (False,) * count, tuple(range(count)), (), True)
    slack = 4.0 * layout.grain
    quad = np.array([n is not None for n in normals], bool)
    normal = np.array([(0.0, 0.0, 0.0) if n is None else n for n in normals]).reshape(-1, 3)
    points = np.array([_points(p) for p in primitives]).reshape(-1, 4, 3)
    radius = np.array([0.0 if isinstance(p, Quad) else p.radius for p in primitives])
    other, both, neither = ~np.eye(count, dtype=bool), quad[:, None] & quad, ~quad[:, None] & ~quad

    # Heights of the points of primitive j over the plane of quad i, at [i, j], and how far apart the centres are.
    height = np.einsum("ijkx,ix->ijk", points - points[:, None, :1], normal)
    low, high = height.min(-1) - radius, height.max(-1) + radius
    distance = np.linalg.norm(points[:, None, 0] - points[:, 0], axis=-1)
    hull = quad & ((low >= -slack).all(1) | (high <= slack).all(1))

    # A quad counts as its whole plane: a sphere is then called empty too rarely, never too often.
    clear = (distance >= radius[:, None] + radius - slack) | ~(neither & other)
    empty = ~quad & clear.all(1) & ((np.abs(height[:, :, 0]) >= radius - slack) | ~quad[:, None]).all(0)

    beyond = np.maximum(np.abs(low), np.abs(high))  # the largest height of j over the plane of i
    flat = beyond <= slack
    same = (distance <= slack) & (np.abs(radius[:, None] - radius) <= slack)
    twins = other & ((both & flat & flat.T) | (neither & same))
    tight = (beyond < TIGHT * layout.extent) & both & other & ~twins

    lower, upper = points.min(1), points.max(1)
    apart = (lower[:, None] - upper > slack).any(-1) | (low > slack) | (high < -slack)
    free = quad & (apart | apart.T | ~(both & other)).all(1)
    numbers = np.arange(count)
    return Touch(
        twins=tuple(tuple(numbers[row].tolist()) for row in twins),
        free=tuple(free.tolist()),
        casters=tuple(numbers[~hull].tolist()),
        empty=tuple(numbers[empty].tolist()),
        tight=bool(tight.any()),
    )


def _points(p):
    return corners(p) if isinstance(p, Quad) else np.broadcast_to(np.asarray(p.center, np.float64), (4, 3))
