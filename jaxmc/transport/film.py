"""The film: samples that count in all pixels which a filter covers.

A pixel is the sum of w L over the sum of w, where w is the weight of a sample by its place on the film and L its
radiance. Samples lie where they lie without a filter, the same number in each pixel; those outside of the image do not
exist, and at its border the sum of the weights makes up for them.

In the kernel the samples of a pixel are reduced, for each neighbour that they count in, to sums of w and of w^2 times
powers of L. Neighbours in a row of the image are added up there too, rows on the host. So memory does not depend on the
number of samples, nothing is scattered, and sums are added in an order that the blocks of the kernel fix.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.moments import MomentsResult
from .filters import Filter


def on_film(integrand, filter, camera, tallies):
    """Return the integrand of an image as splats, the tally that weighs them by ``filter``, and ``tallies`` as those of
    the samples themselves.

    Raises:
        ValueError: no filter, or a camera that sends all samples through the middle of a pixel.
    """
    if not isinstance(filter, Filter):
        raise ValueError(f"filter must be one such as mc.TentFilter(), or None for the mean of a pixel, got {filter!r}")
    if not camera.antialias:
        raise ValueError(f"the camera has antialias=False, so there is nothing to weigh: leave out {filter!r}")
    integrand = dataclasses.replace(integrand, fn=Placed(integrand.fn))
    seen = tallies and {name: Unplaced(tally) for name, tally in tallies.items()}
    return integrand, Film(filter, camera.width), seen


class Splat(NamedTuple):
    """A sample on the film: its radiance by channels, where it lies in its pixel, and the number of that pixel."""

    light: tuple[jax.Array, ...]
    x: jax.Array
    y: jax.Array
    pixel: jax.Array


@dataclasses.dataclass(frozen=True)
class Placed:
    """The samples of an image as splats; ``film(u, *params, pixel)`` is their radiance, and ``u`` begins with x, y."""

    film: Any

    def __call__(self, u, *args):
        value = self.film(u, *args)
        light = (value,) if value.ndim == 0 else tuple(value)
        return Splat(light, u[0], u[1], args[-1])


@dataclasses.dataclass(frozen=True)
class Unplaced:
    """A tally of the radiance of splats, whatever their weights."""

    tally: Any

    @property
    def pooled(self):
        return self.tally.pooled

    def reduce(self, values, valid, axes):
        light = values.light
        return self.tally.reduce(light[0] if len(light) == 1 else jnp.stack(light, -1), valid, axes)

    def init(self, record, items=()):
        return self.tally.init(record, items)

    def add(self, state, record, where=..., **extra):
        self.tally.add(state, record, where, **extra)

    def result(self, state):
        return self.tally.result(state)


@dataclasses.dataclass(frozen=True)
class Film:
    """The tally of an image with a filter: for each pixel the weighted mean of the samples around it and its error.

    A ratio of sums R = sum w L / sum w has, to first order, the variance of sum w (L - R), over (sum w)^2. Each pixel
    gives the same number of independent samples, so that is a sum over strata: within a block of n > 1 samples of one
    pixel it is estimated by n / (n - 1) times (sum of squares - square of sum / n).

    Attributes:
        filter: the weights.
        width: pixels in a row of the image.
    """

    filter: Filter
    width: int
    pooled = True

    @property
    def offsets(self):
        """Return the neighbours along one axis that a sample counts in, in pixels from its own."""
        return np.arange(-self.filter.reach, self.filter.reach + 1)

    def reduce(self, splats, valid, axes):
        count = valid.sum(0)
        centers = jnp.stack([_center(light, valid, count) for light in splats.light])
        deviations = [jnp.where(valid, light - c, 0.0) for light, c in zip(splats.light, centers, strict=True)]
        # Scale them, and the steps from pixel to pixel, or the squares of finite values overflow.
        sizes = [jnp.max(jnp.where(jnp.isfinite(d), jnp.abs(d), 0.0)) for d in (*deviations, centers)]
        scale = jnp.max(jnp.stack(sizes))
        inverse = jnp.where(scale > 0.0, 1.0 / scale, 0.0)
        deviations = [d * inverse for d in deviations]
        weights_x = jnp.moveaxis(lax.map(lambda dx: self.filter.profile(splats.x - 0.5 - dx), self._offsets(splats.x)), 0, 1)

        def of_row(dy):
            """Return the sums for the pixels of the image row that is ``dy`` rows below."""
            weights_y = jnp.where(valid, self.filter.profile(splats.y - 0.5 - dy), 0.0)
            sums = _sums(weights_x, lax.optimization_barrier(weights_y), deviations, count)
            return self._add_along_row(sums, centers * inverse, splats.pixel[0])

        return {
            "first": splats.pixel[0, 0], "count": count, "scale": scale, "center": self._spread(centers),
            "sums": lax.map(of_row, self._offsets(splats.y)),
            "nonfinite": sum((valid & ~jnp.isfinite(light)).sum() for light in splats.light),
        }  # fmt: skip

    def _offsets(self, like):
        """Return the neighbours along one axis that a sample counts in, in pixels from its own."""
        return jnp.arange(-self.filter.reach, self.filter.reach + 1, dtype=like.dtype)

    def _spread(self, x):
        """Return ``x`` with as many lanes more at either end as a sample reaches, like the last one."""
        return jnp.pad(x, ((0, 0), (self.filter.reach, self.filter.reach)), mode="edge")

    def _add_along_row(self, sums, centers, pixel):
        """Give the sums of each pixel to its neighbours in a row of the image; return those of each of them, about its
        own center, shape (2 + 3 channels, pixels + 2 reach)."""
        weight, ww, light = sums
        column = (pixel % self.width).astype(jnp.int32)
        around = self._spread(centers)
        total = jnp.zeros((2 + 3 * len(light), around.shape[1]), around.dtype)
        for i in range(len(weight)):
            w, v = weight[i], ww[i]
            moved = [w, v]
            for k, (wd, wwd, wdd) in enumerate(light):
                step = centers[k] - around[k, i : i + len(column)]
                moved += [wd[i] + step * w, wwd[i] + step * v, wdd[i] + step * (2.0 * wwd[i] + step * v)]
            to = column + i - self.filter.reach
            there = jnp.where((to >= 0) & (to < self.width), jnp.stack(moved), 0.0)
            total = total.at[:, i : i + len(column)].add(there)
        return total

    def init(self, record, items=()):
        channels = record["center"].shape[-2]
        return [FilmSums(self.width, self.filter.reach, channels, *items)]

    def add(self, state, record, where=...):
        state[0].add(record)

    def result(self, state):
        return [state[0].moments()]


def _center(light, valid, count):
    """Return about the mean of the samples of each pixel; a finite number in any case."""
    # Divide first: the sum of finite values may overflow.
    mean = jnp.sum(jnp.where(valid, light, 0.0) * (1.0 / len(light)), 0) * (len(light) / jnp.maximum(count, 1))
    return jnp.where(jnp.isfinite(mean), mean, 0.0).astype(light.dtype)


def _sums(weights_x, weights_y, deviations, count):
    """Return for each neighbour in a row, and each pixel, the sum over its samples of w, its variance, and for each
    channel the sum of w d, its covariance with that of w, and its variance: arrays of shape (neighbours, pixels).

    ``weights_x`` has shape (rows, neighbours, pixels), ``weights_y`` and the deviations d have (rows, pixels).
    """

    def add_row(r, sums):
        w = weights_x[r] * weights_y[r]
        new = [w, w * w]
        for d in deviations:
            wd = w * d[r]
            new += [wd, w * wd, wd * wd]
        return [s + x for s, x in zip(sums, new, strict=True)]

    zero = jnp.zeros(weights_x.shape[1:], weights_x.dtype)
    weight, ww, *rest = lax.fori_loop(0, count.max(), add_row, [zero] * (2 + 3 * len(deviations)))
    n = jnp.maximum(count, 1).astype(zero.dtype)
    factor = n / jnp.maximum(n - 1.0, 1.0)

    def variance(product, a, b):
        return jnp.where(count > 1, (product - a * b / n) * factor, product)

    light = []
    for k in range(0, len(rest), 3):
        wd, wwd, wdd = rest[k : k + 3]
        light.append((wd, variance(wwd, weight, wd), variance(wdd, wd, wd)))
    return weight, variance(ww, weight, weight), light


class FilmSums:
    """The sums of every pixel in float64, about a center of its own: of w, its variance, and for each channel the sum
    of w (L - center), its covariance with that of w, and its variance. ``total`` has shape (2 + 3 channels, pixels)."""

    def __init__(self, width, reach, channels, items):
        self.width, self.reach, self.channels = width, reach, channels
        self.total, self.center = np.zeros((2 + 3 * channels, items)), np.zeros((channels, items))
        self.n, self.touched, self.nonfinite = np.zeros(items), np.zeros(items, bool), 0

    @property
    def shape(self):
        """The shape of the mean."""
        return self.center.shape[::-1]

    def empty(self):
        """Return sums of the same image without samples."""
        return FilmSums(self.width, self.reach, *self.center.shape)

    def clear(self):
        self.total[...], self.n[...], self.nonfinite = 0.0, 0.0, 0

    def add(self, record):
        """Add the records of blocks, in their order."""
        items = len(self.n)
        powers = np.array([0, 0, *[1, 1, 2] * self.channels])
        for block, first in enumerate(record["first"].tolist()):
            count = record["count"][block][: items - first]
            self.n[first : first + len(count)] += count
            scale = np.float64(record["scale"][block]) ** powers
            for row, sums in enumerate(record["sums"][block]):
                start = first - self.reach + (row - self.reach) * self.width
                stop = start + sums.shape[1]
                inside = slice(max(0, -start), max(0, min(stop, items) - start))
                where = slice(max(0, start), max(0, min(stop, items)))
                center = record["center"][block][:, inside].astype(np.float64)
                self._accumulate(where, center, sums[:, inside] * scale[:, None])
        self.nonfinite += int(record["nonfinite"].sum())

    def merge(self, other):
        self._accumulate(slice(None), other.center, other.total)
        self.n, self.nonfinite = self.n + other.n, self.nonfinite + other.nonfinite

    @np.errstate(all="ignore")
    def _accumulate(self, where, center, sums):
        touched = self.touched[where]
        if not touched.all():
            self.center[:, where] = np.where(touched, self.center[:, where], center)
            self.touched[where] = True
        step = center - self.center[:, where]
        weight, ww = sums[:2]
        wd, wwd, wdd = sums[2::3], sums[3::3], sums[4::3]
        total = self.total[:, where]
        total[:2] += sums[:2]
        total[2::3] += wd + step * weight
        total[3::3] += wwd + step * ww
        total[4::3] += wdd + step * (2.0 * wwd + step * ww)

    @np.errstate(all="ignore")
    def moments(self) -> MomentsResult:
        """Return the mean of every pixel, shape (pixels, channels), and n times the square of its error as variance."""
        weight, ww = self.total[:2]
        shift = self.total[2::3] / weight
        wwd, wdd = self.total[3::3], self.total[4::3]
        error = np.maximum(wdd - shift * (2.0 * wwd - shift * ww), 0.0) / weight**2
        n = np.broadcast_to(self.n, shift.shape)
        return MomentsResult(n.T, (self.center + shift).T, [(error * (n - 1.0)).T], self.nonfinite)
