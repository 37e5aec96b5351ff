"""Boxes of any orientation: closest hit, written for one ray.

Six faces count as one shape, so a box is watertight by itself: a ray that goes in comes out. Faces are numbered
``2 * axis`` on the negative side of the box's own axis, ``2 * axis + 1`` on the positive side.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from .derivatives import product, reciprocal
from .rays import Ray, is_rounding, row_at, sparse_dot
from .vec import larger, smaller


class BoxShape(NamedTuple):
    """A box as three rows: coordinate k of a point p is ``rows[k] . p - offsets[k]``, which runs from -1 to 1 inside.
    Components that are zero by construction are None.
    """

    rows: tuple[Any, Any, Any]
    offsets: tuple[Any, Any, Any]


def intersect(box: BoxShape, ray: Ray, own) -> tuple[Any, Any]:
    """Return the distance to a box, infinite for a miss, and the face there; ``own`` is the face that the ray starts
    on, any other number if it starts elsewhere. From inside, and inward from a face, the ray meets the far side.

    Source: the slabs of Kay and Kajiya 1986.
    """
    slabs = [_slab(row, offset, ray) for row, offset in zip(box.rows, box.offsets)]
    inward = outward = False
    near, far = -jnp.inf, jnp.inf
    entry = exit = 0
    for k, (low, high, backward) in enumerate(slabs):
        front, back = jnp.where(backward, 2 * k + 1, 2 * k), jnp.where(backward, 2 * k, 2 * k + 1)
        inward, outward = inward | (own == front), outward | (own == back)
        near, entry = jnp.where(low > near, low, near), jnp.where(low > near, front, entry)
        far, exit = jnp.where(high < far, high, far), jnp.where(high < far, back, exit)
    outside = (near > 0.0) & ~inward
    # A ray that goes inward cannot miss, even where rounding has put its start beyond an edge.
    hit = inward | ((near <= far) & (far > 0.0) & ~outward)
    distance = jnp.where(outside, near, larger(far, 0.0))
    return jnp.where(hit, distance, jnp.inf), jnp.where(outside, entry, exit)


def _slab(row, offset, ray):
    """Return where a line enters and leaves the space between two faces, and whether it goes from plus to minus."""
    start = row_at(row, offset, ray.origin)
    speed = sparse_dot(row, ray.direction)
    inverse = reciprocal(speed)
    minus, plus = product(-1.0 - start, inverse), product(1.0 - start, inverse)
    return smaller(plus, minus), larger(plus, minus), speed < 0.0


def face_at(box: BoxShape, point):
    """Return the face on which a point lies, to rounding, or -1."""
    found = -1
    for k, (row, offset) in enumerate(zip(box.rows, box.offsets)):
        value = row_at(row, offset, point)
        terms = [1.0, 0.0 if offset is None else offset, *(a * b for a, b in zip(row, point) if a is not None)]
        others = [row_at(r, o, point) for j, (r, o) in enumerate(zip(box.rows, box.offsets)) if j != k]
        inside = (jnp.abs(others[0]) <= 1.0) & (jnp.abs(others[1]) <= 1.0)
        for side, sign in enumerate((-1.0, 1.0)):
            found = jnp.where(inside & is_rounding(value - sign, terms), 2 * k + side, found)
    return found
