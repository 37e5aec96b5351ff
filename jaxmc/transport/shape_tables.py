"""Many shapes of one kind, as a table that a loop runs over: compile time does not grow with their number."""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from . import shapes
from .boxes import BoxShape

MANY = 16  # shapes of one kind, above which they become a table
WIDTH = 2  # shapes to a round of the loop; measured as fast as 8, and compiled in two thirds of the time


@partial(jax.tree_util.register_dataclass, data_fields=["shape"], meta_fields=["first", "plane", "empty"])
@dataclasses.dataclass(frozen=True)
class ShapeTable:
    """Shapes of one kind.

    Attributes:
        shape: a shape whose numbers are arrays of shape (rounds, WIDTH). The last shape fills the last round.
        first: number of the first face of each shape.
        plane: number of the plane or sphere on which it lies: that of the first face there.
        empty: whether no ray starts or ends inside any of the spheres.
    """

    shape: Any
    first: tuple[int, ...]
    plane: tuple[int, ...]
    empty: bool

    def rounds(self):
        return -(-len(self.first) // WIDTH)

    def numbers(self):
        """Return the first faces and the planes, shape (rounds, WIDTH)."""
        return _padded(np.array(self.first, np.int32)), _padded(np.array(self.plane, np.int32))


def table_of(shapes_of_kind, first, plane, empty) -> ShapeTable:
    """Return the table of shapes that have the same components."""
    stack = jax.tree.map(lambda *x: _padded(np.stack(x) if not _traced(x) else jnp.stack(x)), *shapes_of_kind)
    return ShapeTable(stack, tuple(first), tuple(plane), empty)


def _traced(values):
    return any(isinstance(v, jax.core.Tracer) for v in values)


def _padded(x):
    missing = -len(x) % WIDTH
    stack = np.concatenate if isinstance(x, np.ndarray) else jnp.concatenate
    return stack([x, *[x[-1:]] * missing]).reshape(-1, WIDTH)


def _each(table: ShapeTable, visit, state):
    """Return ``visit(shape, first, plane, state)`` of all shapes of a table, one after the other."""
    first, plane = map(jnp.asarray, table.numbers())

    def round_of(r, state):
        for k in range(WIDTH):
            shape = jax.tree.map(lambda x, k=k: jnp.asarray(x)[r, k], table.shape)
            state = visit(shape, first[r, k], plane[r, k], state)
        return state

    return lax.fori_loop(0, table.rounds(), round_of, state)


def nearest(table: ShapeTable, ray, own, own_plane, best):
    """Return distance and face of the closest hit, ``best`` being one that has been found before."""

    def visit(shape, first, plane, best):
        distance, face = shapes.intersect(shape, first, ray, own, own_plane == plane)
        closer = distance < best[0]
        return jnp.where(closer, distance, best[0]), jnp.where(closer, face, best[1])

    return _each(table, visit, best)


def blocks(table: ShapeTable, ray, length, own, own_plane, target, target_plane, anywhere):
    """Return whether any shape but the ``target`` cuts the first ``length`` of a ray; ``anywhere`` as in
    ``hits.unoccluded``.
    """

    def visit(shape, first, plane, blocked):
        if isinstance(shape, BoxShape):
            # A box hides its own far sides.
            distance, face = shapes.intersect(shape, first, ray, own, own_plane == plane)
            return blocked | ((distance < length) & (face != target))
        cuts = shapes.blocks(shape, first, ray, length, own, own_plane == plane, table.empty and not anywhere)
        return blocked | (cuts & (target_plane != plane))

    return _each(table, visit, jnp.zeros((), bool))


def face_at(table: ShapeTable, point, found):
    """Return the face on which a point lies, to rounding, or ``found``."""

    def visit(shape, first, plane, found):
        face = shapes.face_at(shape, point)
        return jnp.where(face >= 0, first + face, found)

    return _each(table, visit, found)
