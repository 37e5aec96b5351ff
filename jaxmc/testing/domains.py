"""What densities are over: a box of coordinates, how it maps to points, and integrals of a density over its bins."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

NODES = 4  # of Gauss and Legendre's rule, along each coordinate of a cell
BATCH = 1 << 15  # points that are evaluated together
MOST_CELLS = 1 << 17  # that still differ from their parts
FIRST_LEVELS = 4  # times a cell is divided in any case, shared by the coordinates


@dataclasses.dataclass(frozen=True)
class Domain:
    """A set of points x, given by coordinates q in a box.

    Attributes:
        low, high: ends of the box, k numbers each.
        point: ``point(q) -> x`` for one q of shape (k,); x is an array of shape (m,), m >= k: a vector-like value has
            its components in order.
        coordinates: ``coordinates(x) -> q``, the inverse.
        bins: number of bins along each coordinate, k integers.
        measure: ``measure(q)``, how much of the measure of the density belongs to dq. None is length, area or volume of
            the points, sqrt(det(J^T J)) with J = dx/dq: solid angle for directions.

    Raises:
        ValueError: bounds or bins that do not fit together.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    point: Callable[[Any], Any]
    coordinates: Callable[[Any], Any]
    bins: tuple[int, ...]
    measure: Callable[[Any], Any] | None = None

    def __post_init__(self):
        ends = [(a, b, count) for a, b, count in itertools.zip_longest(self.low, self.high, self.bins)]
        if not all(None not in end and -math.inf < end[0] < end[1] < math.inf and end[2] >= 1 for end in ends):
            raise ValueError(
                f"a domain needs finite low < high and bins >= 1, one for each coordinate; got low={self.low}, "
                f"high={self.high}, bins={self.bins}"
            )

    def element(self, q):
        """Return the measure of dx per dq at one point."""
        if self.measure is not None:
            return self.measure(q)
        jacobian = jax.jacfwd(self.point)(q)
        return jnp.sqrt(jnp.abs(jnp.linalg.det(jacobian.T @ jacobian)))


def box(low, high, bins=None) -> Domain:
    """Return the box of points x between ``low`` and ``high``, of shape (k,); by default some 500 bins in all."""
    low, high = tuple(map(float, low)), tuple(map(float, high))
    bins = bins or (max(2, round(512 ** (1 / len(low)))),) * len(low)
    return Domain(low, high, lambda q: q, lambda x: x, tuple(bins), lambda q: 1.0)


def directions(axis=(0.0, 0.0, 1.0), half_angle=math.pi, bins=(16, 32)) -> Domain:
    """Return the unit vectors within ``half_angle`` (radians, up to pi) of ``axis`` (any length).

    The coordinates are 1 - cos of the angle from the axis, and the azimuth; their product is solid angle. The first is
    taken from the sine where that is more exact, so that narrow cones keep their digits in float32.
    """
    axis = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    tangent = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    tangent = tangent / np.linalg.norm(tangent)
    frame = np.stack([tangent, np.cross(axis, tangent), axis])

    def point(q):
        radius = jnp.sqrt(jnp.maximum(q[0] * (2.0 - q[0]), 0.0))
        return jnp.stack([radius * jnp.cos(q[1]), radius * jnp.sin(q[1]), 1.0 - q[0]]) @ jnp.asarray(frame, q.dtype)

    def coordinates(x):
        x, y, z = jnp.asarray(frame, x.dtype) @ x
        return jnp.stack(
            [jnp.where(z > 0.0, (x * x + y * y) / (1.0 + jnp.maximum(z, 0.0)), 1.0 - z), jnp.arctan2(y, x)]
        )

    high = 2.0 * math.sin(half_angle / 2.0) ** 2
    return Domain((0.0, -math.pi), (high, math.pi), point, coordinates, tuple(bins), lambda q: 1.0)


SPHERE = directions()
HEMISPHERE = directions(half_angle=math.pi / 2)  # about +z
SQUARE = box((0, 0), (1, 1))


@partial(jax.jit, static_argnums=0)
def locate(domain: Domain, x):
    """Return the number of the bin of each point, flat components of shape (n, m), and whether it is in the domain.

    The coordinates must lie within their bounds, and lead back to the point but for 8 sqrt(eps) of its size: what
    rounding does to the direction next to a pole.
    """
    low, high, bins = (np.array(ends) for ends in (domain.low, domain.high, domain.bins))
    strides = np.append(np.cumprod(bins[:0:-1])[::-1], 1)

    def one(x):
        q = domain.coordinates(x)
        clipped = jnp.clip(q, low, high)
        slack = 8.0 * float(jnp.finfo(x.dtype).eps) ** 0.5 * jnp.max(jnp.abs(x))
        on_surface = jnp.max(jnp.abs(domain.point(clipped) - x)) <= slack
        cell = jnp.clip(jnp.floor((clipped - low) / (high - low) * bins).astype(int), 0, bins - 1)
        return jnp.sum(cell * strides), jnp.all((q >= low) & (q <= high)) & on_surface

    return jax.vmap(one)(x)


@partial(jax.jit, static_argnums=0)
def _points(domain, q):
    return jax.vmap(domain.point)(q), jnp.broadcast_to(jax.vmap(domain.element)(q), len(q))


@np.errstate(invalid="ignore")  # a density that is not finite has an integral that is not
def bin_integrals(density, domain: Domain, tolerance):
    """Return the integral of ``density(x)`` over every bin, float64, and how much of it is uncertain.

    ``density`` gets the flat components of one point. Every cell is compared, part by part, with its 2^k parts. Where
    they differ by more than ``tolerance(integral of the bin)``, halved from level to level, the parts are divided
    further: a density with jumps is integrated too. A comparison of whole cells would take many a jump for smooth by
    accident.
    """
    evaluate, rule = _in_batches(density, domain), _Rule(len(domain.low))
    low, high, bins = (np.array(x) for x in (domain.low, domain.high, domain.bins))
    cells = np.stack(np.meshgrid(*map(np.arange, bins), indexing="ij"), -1).reshape(-1, rule.k)
    lower, width = low + (high - low) * cells / bins, (high - low) / bins
    owner, total, unresolved = np.arange(len(cells)), np.zeros(len(cells)), 0.0
    values, level = rule.values(evaluate, lower, width), 0
    allowed = tolerance(values @ rule.weights * width.prod())
    while len(owner):
        predicted = values @ rule.parts * width.prod()
        lower, width, level = rule.divide(lower, width), width / 2.0, level + 1
        values = rule.values(evaluate, lower, width)
        found = (values @ rule.weights * width.prod()).reshape(predicted.shape)
        error = np.abs(found - predicted).sum(1)
        # Always divide a few times, or what all nodes of a cell miss stays unseen.
        rough = ~(error <= allowed[owner] / 2.0**level) | (level <= FIRST_LEVELS // rule.k)
        if np.sum(rough) * 2**rule.k > MOST_CELLS or not np.isfinite(values).all():
            unresolved, rough = float(error[rough].sum()), np.zeros_like(rough)
        np.add.at(total, owner[~rough], found[~rough].sum(1))
        parts = np.repeat(rough, 2**rule.k)
        owner, lower, values = np.repeat(owner, 2**rule.k)[parts], lower[parts], values[parts]
    return total, unresolved


class _Rule:
    """The rule of Gauss and Legendre in k coordinates: ``weights`` of the nodes for the whole of a cell, and for each
    of its 2^k ``parts``, over which the polynomial through the nodes is integrated."""

    def __init__(self, k):
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        nodes, weights = (nodes + 1.0) / 2.0, weights / 2.0
        ends = np.array([0.0, 0.5, 1.0])[:, None] ** np.arange(1, NODES + 1) / np.arange(1, NODES + 1)
        halves = np.linalg.solve(np.vander(nodes, increasing=True).T, np.diff(ends, axis=0).T)
        self.k = k
        self.grid = np.array(list(itertools.product(nodes, repeat=k)))
        self.corners = np.array(list(itertools.product((0.0, 0.5), repeat=k)))
        self.weights = reduce(np.multiply.outer, [weights] * k).ravel()
        self.parts = reduce(np.kron, [halves] * k)

    def values(self, evaluate, lower, width):
        """Return the values at the nodes of cells of one ``width`` (k,) at ``lower`` (n, k)."""
        return evaluate((lower[:, None] + self.grid * width).reshape(-1, self.k)).reshape(len(lower), -1)

    def divide(self, lower, width):
        """Return the lower ends of all parts of all cells."""
        return (lower[:, None] + self.corners * width).reshape(-1, self.k)


def _in_batches(density, domain):
    """Return density times element as a function of coordinates (n, k) that compiles once."""
    compiled = jax.jit(lambda x: jnp.broadcast_to(jax.vmap(density)(x), len(x)))

    def evaluate(q):
        values = []
        for start in range(0, len(q), BATCH):
            piece = q[start : start + BATCH]
            padded = np.pad(piece, ((0, BATCH - len(piece)), (0, 0)), mode="edge")
            x, element = _points(domain, jnp.asarray(padded, float))
            values.append((np.asarray(compiled(x), np.float64) * np.asarray(element, np.float64))[: len(piece)])
        return np.concatenate(values)

    return evaluate
