"""Edges that lie on a face to which they do not belong, as those of a crate do on the floor that it stands on."""

import numpy as np

from ..transport.flats import FlatLight


def resting(outlines, edges, ends, tolerance) -> tuple[tuple[int, ...], ...]:
    """Return for each edge a number for each face: 0 where the edge does not lie on its plane; otherwise 1 where the
    edge's own faces are on the side of cross(half_u, half_v), -1 where they are on the other, 0 where they are on both
    or on neither.

    ``ends`` are those of the edges, shape (edges, 2, 3).
    """
    return tuple(
        tuple(0 if j in edge.faces else _side(outlines, edge, segment, o, tolerance) for j, o in enumerate(outlines))
        for edge, segment in zip(edges, ends)
    )


def _side(outlines, edge, segment, flat, tolerance):
    if not isinstance(flat, FlatLight):
        return 0
    center, half_u, half_v = (np.array(v, np.float64) for v in (flat.center, flat.half_u, flat.half_v))
    normal = np.cross(half_u, half_v)
    normal = normal / np.linalg.norm(normal)
    if np.abs((segment - center) @ normal).max() > tolerance:
        return 0
    # Both ends of the edge lie on the plane: the middle of a face says on which side all of it is.
    heights = [(_middle(outlines[face]) - center) @ normal for face in edge.faces]
    above, below = max(heights) > tolerance, min(heights) < -tolerance
    return int(above) - int(below)


def _middle(flat):
    center, half_u, half_v = (np.array(v, np.float64) for v in (flat.center, flat.half_u, flat.half_v))
    return center - (half_u + half_v) / 3.0 if flat.triangle else center
