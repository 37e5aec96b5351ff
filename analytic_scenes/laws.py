"""The law of one sample: variance and kurtosis of the estimators of direct light, by quadrature that is exact.

A set of directions is a ``Nodes``: unit vectors with the solid angle that each stands for. Those of a cap, a hemisphere
or a lune integrate polynomials of the direction to rounding, up to the degree that a fourth moment needs; those of a
parallelogram or a disk integrate its smooth kernel to rounding unless it is much larger than it is far away.

All sets lie above the horizon of the receiver, whose unit normal is ``normal``.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

HEIGHTS, AZIMUTHS = 12, 24  # polynomials up to degree 23


class Nodes(NamedTuple):
    """Directions, shape (n, 3), the solid angles [sr] that they stand for, and their shares in light sampling."""

    directions: np.ndarray
    solid_angles: np.ndarray
    shares: np.ndarray


class Law(NamedTuple):
    """Variance of one sample, and its kurtosis: fourth central moment / variance^2, None where nothing varies.

    A law that is known in part has None for what is not known, or not finite.
    """

    variance: float
    kurtosis: float | None


def law_of_values(probabilities, values) -> Law:
    """Return the law that takes each value with its probability, and 0 with what is left.

    Probabilities may be negative where one set of nodes is cut out of another.
    """
    probabilities, values = (np.concatenate([np.ravel(x) for x in xs]) for xs in (probabilities, values))
    probabilities, values = np.append(probabilities, 1.0 - probabilities.sum()), np.append(values, 0.0)
    deviation = values - probabilities @ values
    variance, fourth = probabilities @ deviation**2, probabilities @ deviation**4
    if variance <= 1e-28 * (probabilities @ values**2):
        return Law(0.0, None)
    return Law(float(variance), float(fourth / variance**2))


def law_of_directions(strategy: str, normal, pieces) -> Law:
    """Return the law of irradiance by directions, "cosine" or "uniform", where ``pieces`` are (nodes, radiance).

    Radiance is a number or an array of shape (n,). Where no piece is, it is dark; a piece with solid angles below 0
    takes light away.
    """
    probabilities, values = [], []
    for nodes, radiance in pieces:
        cosine = nodes.directions @ normal
        value = radiance * np.ones(len(cosine))
        if strategy == "cosine":
            probabilities.append(nodes.solid_angles * cosine / math.pi)
            values.append(math.pi * value)
        else:
            probabilities.append(nodes.solid_angles / (2.0 * math.pi))
            values.append(2.0 * math.pi * cosine * value)
    return law_of_values(probabilities, values)


def law_of_light(normal, nodes: Nodes, radiance: float) -> Law:
    """Return the law of irradiance by light sampling: a sphere by solid angle, a parallelogram or a disk by area."""
    values = radiance * (nodes.directions @ normal) * nodes.solid_angles / nodes.shares
    return law_of_values([nodes.shares], [values])


def independent_sum(first: Law, second: Law) -> Law:
    """Return the law of the sum of two independent samples: second and fourth cumulants add."""
    variance = first.variance + second.variance
    excess = sum((law.kurtosis - 3.0) * law.variance**2 for law in (first, second) if law.kurtosis is not None)
    return Law(variance, 3.0 + excess / variance**2 if variance > 0 else None)


def scaled(law: Law, factor: float) -> Law:
    """Return the law of ``factor`` times a sample."""
    return Law(law.variance * factor**2, law.kurtosis)


def without(nodes: Nodes) -> Nodes:
    """Return nodes that take away what ``nodes`` add."""
    return nodes._replace(solid_angles=-nodes.solid_angles)


def sphere_nodes(center, radius: float) -> Nodes:
    """Return the directions that a sphere fills, seen from the origin."""
    center = np.asarray(center, float)
    distance = np.linalg.norm(center)
    return cap_nodes(center / distance, math.asin(radius / distance))


def cap_nodes(axis, angular_radius: float) -> Nodes:
    """Return the directions within ``angular_radius`` [rad] of the unit vector ``axis``; pi/2 makes a hemisphere."""
    points, weights = np.polynomial.legendre.leggauss(HEIGHTS)
    depth = 2.0 * math.sin(angular_radius / 2.0) ** 2  # 1 - cos, without cancellation
    one_minus = np.repeat(depth * (1.0 + points) / 2.0, AZIMUTHS)
    azimuth = np.tile(2.0 * math.pi * np.arange(AZIMUTHS) / AZIMUTHS, HEIGHTS)
    across = np.sqrt(one_minus * (2.0 - one_minus))
    tangent, bitangent = _frame(axis)
    directions = np.outer(across * np.cos(azimuth), tangent) + np.outer(across * np.sin(azimuth), bitangent)
    directions += np.outer(1.0 - one_minus, axis)
    shares = np.repeat(weights / 2.0, AZIMUTHS) / AZIMUTHS
    return Nodes(directions, 2.0 * math.pi * depth * shares, shares)


def lune_nodes(normal, other) -> Nodes:
    """Return the directions that two hemispheres about unit vectors share: all of one where they agree."""
    pole = np.cross(normal, other)
    sine = np.linalg.norm(pole)
    pole = _frame(normal)[0] if sine < 1e-12 else pole / sine
    angle = math.atan2(sine, np.dot(normal, other))
    points, weights = np.polynomial.legendre.leggauss(32)
    polar = np.repeat(math.pi * (1.0 + points) / 2.0, len(points))
    azimuth = np.tile(angle / 2.0 + (math.pi - angle) * points / 2.0, len(points))
    ahead = np.cross(pole, normal)
    directions = np.outer(np.sin(polar) * np.cos(azimuth), normal) + np.outer(np.sin(polar) * np.sin(azimuth), ahead)
    directions += np.outer(np.cos(polar), pole)
    solid_angles = math.pi * (math.pi - angle) / 4.0 * np.outer(weights, weights).ravel() * np.sin(polar)
    return Nodes(directions, solid_angles, solid_angles / solid_angles.sum())


def parallelogram_nodes(corner, edge_u, edge_v, order: int = 48) -> Nodes:
    """Return the directions that a parallelogram fills, seen from the origin."""
    corner, u, v = (np.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    points, weights = np.polynomial.legendre.leggauss(order)
    points, shares = (1.0 + points) / 2.0, np.outer(weights, weights).ravel() / 4.0
    targets = corner + np.outer(np.repeat(points, order), u) + np.outer(np.tile(points, order), v)
    distance = np.linalg.norm(targets, axis=1)
    volume = abs(np.cross(u, v) @ corner)  # area times distance to the plane
    return Nodes(targets / distance[:, None], volume / distance**3 * shares, shares)


def disk_nodes(radius: float, height: float, offset: float, order: int = 48) -> Nodes:
    """Return the directions that a level disk fills, its centre at (offset, 0, height), seen from the origin."""
    points, weights = np.polynomial.legendre.leggauss(order)
    away = radius * np.sqrt(np.repeat((1.0 + points) / 2.0, 2 * order))
    azimuth = np.tile(math.pi * np.arange(2 * order) / order, order)
    targets = np.stack([offset + away * np.cos(azimuth), away * np.sin(azimuth), np.full(len(away), height)], axis=1)
    shares = np.repeat(weights / 2.0, 2 * order) / (2 * order)
    distance = np.linalg.norm(targets, axis=1)
    return Nodes(targets / distance[:, None], math.pi * radius**2 * height / distance**3 * shares, shares)


def of_parallelogram(law: Callable[[Nodes], Law | None], corner, edge_u, edge_v) -> Law | None:
    """Return ``law(nodes)`` of a parallelogram, or None where it is too close for the quadrature to have converged."""
    return converged(lambda order: law(parallelogram_nodes(corner, edge_u, edge_v, order)), 32)


def converged(law: Callable[[int], Law | None], order: int) -> Law | None:
    """Return ``law(3 order / 2)``, or None where it differs from ``law(order)``: too few nodes."""
    coarse, fine = law(order), law(order + order // 2)
    if coarse is None or fine is None or fine.kurtosis is None or coarse.kurtosis is None:
        return fine
    return fine if np.allclose(coarse, fine, rtol=1e-9, atol=0.0) else None


def rectangle_points(x0: float, x1: float, y0: float, y1: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points of a rectangle, shape (n, 2), and the share of its area that each stands for."""
    points, weights = np.polynomial.legendre.leggauss(order)
    x, y = ((low + high + (high - low) * points) / 2.0 for low, high in ((x0, x1), (y0, y1)))
    return np.stack([np.repeat(x, order), np.tile(y, order)], axis=1), np.outer(weights, weights).ravel() / 4.0


def _frame(axis):
    axis = np.asarray(axis, float)
    tangent = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    tangent /= np.linalg.norm(tangent)
    return tangent, np.cross(axis, tangent)
