"""Convex polygons in a plane, cut along lines, and Gauss and Legendre's rule over them. All of it is NumPy."""

import itertools

import numpy as np


def event_lines(first, second, plane):
    """Return the lines (a, b, c), a u + b v + c = 0, in which a plane origin + u e1 + v e2 meets all planes through an
    edge of one polygon and a corner of another: there a corner of one appears on an edge of the other.
    """
    lines = []
    for edges, corners in ((first, second), (second, first)):
        for (a, b), corner in itertools.product(zip(edges, np.roll(edges, -1, axis=0)), corners):
            normal = np.cross(b - a, corner - a)
            line = np.array([normal @ plane[1], normal @ plane[2], normal @ (plane[0] - a)])
            size = np.hypot(line[0], line[1])
            if size > 1e-12:
                lines.append(line / size)
    return lines


def split(polygons, lines, tolerance=1e-10):
    """Return convex polygons cut along lines into convex pieces."""
    for line in lines:
        pieces = []
        for polygon in polygons:
            height = polygon @ line[:2] + line[2]
            if height.max() < tolerance or height.min() > -tolerance:
                pieces.append(polygon)
                continue
            for sign in (1.0, -1.0):
                piece = clip(polygon[None], sign * line[:2], np.array([sign * line[2]]))[0]
                pieces.append(piece[np.linalg.norm(piece - np.roll(piece, -1, axis=0), axis=1) > 0.0])
        polygons = pieces
    return polygons


def clip(polygons, normal, offset):
    """Return the parts of convex polygons, shape (n, k, 2), where normal . x + offset >= 0, with k + 1 corners each,
    of which some may coincide: all, if nothing is left. Source: Sutherland and Hodgman (1974).
    """
    after = np.roll(polygons, -1, axis=1)
    here, there = (polygons @ normal + offset[:, None], after @ normal + offset[:, None])
    crossing = (here < 0.0) != (there < 0.0)
    share = here / np.where(crossing, here - there, 1.0)
    both = np.stack([polygons + (after - polygons) * share[..., None], after], axis=2)
    kept = np.stack([crossing, there >= 0.0], axis=2).reshape(len(polygons), -1)
    both = both.reshape(len(polygons), -1, 2)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : polygons.shape[1] + 1]
    count = kept.sum(axis=1)
    # Let corners that are left over coincide with the first one.
    order = np.where(np.arange(order.shape[1]) < count[:, None], order, order[:, :1])
    return np.take_along_axis(both, order[..., None], axis=1)


def area(polygons):
    after = np.roll(polygons, -1, axis=1)
    return 0.5 * np.abs((polygons[..., 0] * after[..., 1] - polygons[..., 1] * after[..., 0]).sum(axis=1))


def fan(polygons):
    """Return the triangles between the first corner and all edges: (..., k, 2) to (..., k - 2, 3, 2)."""
    first = np.broadcast_to(polygons[..., :1, :], polygons[..., 2:, :].shape)
    return np.stack([first, polygons[..., 1:-1, :], polygons[..., 2:, :]], axis=-2)


def over_polygons(polygons, order):
    """Return nodes and weights of a rule for the union of convex polygons."""
    return over_triangles(np.concatenate([fan(polygon) for polygon in polygons]), order)


def over_triangles(triangles, order):
    """Return nodes (..., n, 2) and weights (..., n) of Gauss and Legendre's product rule for triangles (..., t, 3, 2),
    squares of which one side is drawn together to a corner."""
    node, weight = np.polynomial.legendre.leggauss(order)
    u, v = (0.5 * (x.ravel() + 1.0) for x in np.meshgrid(node, node))
    weight = np.outer(weight, weight).ravel() * 0.25 * v
    a, b, c = (triangles[..., k, None, :] for k in range(3))
    nodes = a + ((b - a) * (1.0 - u)[:, None] + (c - a) * u[:, None]) * v[:, None]
    sides = np.stack(
        [triangles[..., 1, :] - triangles[..., 0, :], triangles[..., 2, :] - triangles[..., 0, :]], axis=-2
    )
    weights = np.abs(np.linalg.det(sides))[..., None] * weight
    shape = triangles.shape[:-3]
    return nodes.reshape(*shape, -1, 2), weights.reshape(*shape, -1)
