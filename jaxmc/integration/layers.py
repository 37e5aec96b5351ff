"""Layers of brightness: sums of the samples of each integral, kept apart by how bright they are.

What is done with rare bright samples is then decided afterwards, as often as one likes, and the plain mean stays
recoverable: the layers add up to it.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from .blocks import Added, fold_rows
from .buckets import as_array
from .counts import is_count
from .moments import apply, per_sample
from .storage import storable

LAYERS = 16


@storable
class CascadeSums(NamedTuple):
    """Samples split over layers of brightness b_i = start base^i, the last one holding what is above the top layer.

    ``value``: sums of the samples over their number, shape (layers + 1, items..., components...); over the first axis
    they add up to the mean. ``soft_count``, shape (layers, items...), says how many samples as bright as b_i hold the
    light of a layer.
    """

    base: float
    start: float
    n: int
    value: np.ndarray
    soft_count: np.ndarray


@storable
@dataclasses.dataclass(frozen=True)
class Cascade(Added):
    """Samples split over layers of brightness, for each integral of a family (each pixel).

    A sample of brightness L between b_i and b_(i+1) counts in both, with weights linear in 1 / L, so that its light and
    the number of samples that it stands for are both kept: w + w' = 1 and w L/b_i + w' L/b_(i+1) = 1. Above the top
    layer b the share b / L stays there, and the rest is kept by itself.

    Source: Zirr, Hanika & Dachsbacher, "Re-weighting firefly samples for improved finite-sample Monte Carlo estimates",
    Computer Graphics Forum 37(6), 2018.

    Attributes:
        base: the ratio of two layers, above 1.
        start: brightness of the lowest layer, the last that is trusted as it is.
        layers: how many, at least 2; 6 of base 8 reach 32768 times the start.
        of: the brightness: maps the values of a block to one number each, sample axes first, for example
            ``mc.luminance``; None where the value is a number.
    """

    base: float = 8.0
    start: float = 1.0
    layers: int = 6
    of: Callable[[Any], Any] | None = None

    def __post_init__(self):
        if not (1.0 < self.base < math.inf and 0.0 < self.start < math.inf):
            raise ValueError(f"a Cascade takes base > 1 and start > 0, got base={self.base!r}, start={self.start!r}")
        if not is_count(self.layers) or self.layers < 2:
            raise ValueError(f"a Cascade takes layers >= 2, a whole number, got layers={self.layers!r}")

    def reduce(self, values, valid, axes):
        x, light = _with_light(self, values)
        soft, value = _split(self._weights, self.layers + 1, light, [light, x], valid, axes)
        heights = jnp.array([self.start * self.base**i for i in range(self.layers)], x.dtype)
        return {"value": value, "soft": soft[..., :-1] / heights, "n": valid.sum(axes)}

    def _weights(self, light):
        heights = [self.start * self.base**i for i in range(self.layers)]
        inverse = 1.0 / jnp.maximum(light, self.start)
        # What reaches a layer: all of a sample as bright as it, nothing of one as bright as the layer below.
        share = [jnp.ones_like(light)]
        share += [jnp.clip((1.0 - b * inverse) / (1.0 - 1.0 / self.base), 0.0, 1.0) for b in heights[:-1]]
        # Above the top, take the small share itself: as a difference of large ones it would lose its digits.
        stays = jnp.minimum(heights[-1] * inverse, 1.0)
        between = [below - above for below, above in itertools.pairwise(share)]
        return jnp.stack([*between, jnp.minimum(share[-1], stays), 1.0 - stays])

    def result(self, state):
        n, axis = np.asarray(state["n"]), np.ndim(state["n"])
        value, soft = (np.moveaxis(x, axis, 0) for x in (per_sample(state["value"], n), state["soft"]))
        return CascadeSums(float(self.base), float(self.start), int(n.max()), value, soft)


@storable
class LayerSums(NamedTuple):
    """Samples in bins of brightness: bin j from ``edges[j]`` up to the next edge, the first with all below.

    ``count`` and ``total``, shape (bins, items...), are the number of samples and the sum of their brightness, as in a
    ``Histogram``. ``value``, shape (bins, items..., components...), is their sum divided by n; over the first axis
    it adds up to the mean.
    """

    edges: np.ndarray
    n: int
    count: np.ndarray
    total: np.ndarray
    value: np.ndarray


@storable
@dataclasses.dataclass(frozen=True)
class Layers(Added):
    """Count and sum of the samples in bins of brightness, for each integral of a family (each pixel).

    A value that is not a number goes to the last bin.

    Attributes:
        edges: increasing numbers, of which the first is 0. By default 0, e - 1, e^2 - 1, ...: steps of 1 in ln(1 + L).
        of: the brightness, as for ``Cascade``.
    """

    edges: tuple[float, ...] = tuple(math.expm1(j) for j in range(LAYERS))
    of: Callable[[Any], Any] | None = None

    def __post_init__(self):
        e = np.asarray(self.edges, float)
        if e.ndim != 1 or len(e) < 2 or e[0] != 0.0 or not np.isfinite(e).all() or (np.diff(e) <= 0).any():
            raise ValueError(f"edges must be 0 and increasing positive numbers, got {self.edges!r}")

    def reduce(self, values, valid, axes):
        x, light = _with_light(self, values)
        ones = jnp.ones_like(light)
        count, total, value = _split(self._inside, len(self.edges), light, [ones, light, x], valid, axes)
        return {"count": count.astype(jnp.int32), "total": total, "value": value, "n": valid.sum(axes)}

    def _inside(self, light):
        above = [jnp.ones_like(light, bool), *(~(light < edge) for edge in self.edges[1:])]
        return jnp.stack([lower & ~upper for lower, upper in itertools.pairwise(above)] + above[-1:]).astype(
            light.dtype
        )

    def result(self, state):
        n, axis = np.asarray(state["n"]), np.ndim(state["n"])
        sums = state["count"], state["total"], per_sample(state["value"], n)
        count, total, value = (np.moveaxis(x, axis, 0) for x in sums)
        return LayerSums(np.array(self.edges, float), int(n.max()), count, total, value)


def _with_light(tally, values):
    """Return the values of a block, and the brightness of each."""
    x = as_array(tally, values)
    light = apply(tally.of, values)
    if getattr(light, "ndim", None) != 2:
        name = type(tally).__name__
        raise ValueError(f"{name} needs the brightness as one number for each sample: say {name}(of=mc.luminance)")
    return x, light.astype(x.dtype)


def _split(weights, count, light, columns, valid, axes):
    """Return for each column, an array of the samples of a block, its sums with each of ``count`` weights.

    ``weights`` maps the brightness of a row to (count, lanes). The sums have shape (items..., count, components...).
    """
    lanes = light.shape[1]
    sizes = [math.prod(x.shape[2:]) for x in columns]

    def add_row(r, sums, keep, light, *columns):
        # Lanes go last, where vector code runs. The barrier keeps XLA from making the weights anew for each component.
        x = jnp.concatenate([x.reshape(lanes, -1).T for x in columns])
        w, x = lax.optimization_barrier((jnp.where(keep, weights(light), 0.0), x))
        return sums + jnp.where(w[:, None] == 0.0, 0.0, w[:, None] * x)

    sums = fold_rows(add_row, jnp.zeros((count, sum(sizes), lanes), light.dtype), valid, light, *columns)
    sums = jnp.moveaxis(sums, -1, 0) if len(axes) == 1 else sums.sum(-1)
    lead, parts = sums.shape[:-1], jnp.split(sums, np.cumsum(sizes)[:-1], axis=-1)
    return [part.reshape(lead + x.shape[2:]) for part, x in zip(parts, columns, strict=True)]
