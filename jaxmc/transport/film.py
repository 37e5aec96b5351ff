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
from jax import lax

from ..integration.storage import storable
from .film_sums import FilmSums, recentred
from .filters import Filter

GROUPS = 16  # of the samples of a pixel in a block, from whose spread the error comes, or somewhat more


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


@storable
@dataclasses.dataclass(frozen=True)
class Unplaced:
    """A tally of the radiance of splats, whatever their weights."""

    tally: Any

    @property
    def pooled(self):
        return self.tally.pooled

    @property
    def exact(self):
        return getattr(self.tally, "exact", False)

    def reduce(self, values, valid, axes):
        light = values.light
        return self.tally.reduce(light[0] if len(light) == 1 else jnp.stack(light, -1), valid, axes)

    def init(self, record, items=()):
        return self.tally.init(record, items)

    def add(self, state, record, where=..., **extra):
        self.tally.add(state, record, where, **extra)

    def merge(self, a, b):
        return self.tally.merge(a, b)

    def result(self, state):
        return self.tally.result(state)


@storable
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

    def reduce(self, splats, valid, axes):
        count = valid.sum(0)
        centers, largest, bad = _survey(splats.light, valid, count)
        # Take deviations from one sample of the pixel, so that a constant has none. Scale them, and the steps from
        # pixel to pixel, or the squares of finite values overflow.
        inverse = jnp.where(largest > 0.0, 1.0 / largest, 0.0)
        deviations = [
            jnp.where(valid, light - c, 0.0) * inverse for light, c in zip(splats.light, centers, strict=True)
        ]
        weights_y = jnp.where(valid[:, None], self._weights(splats.y), 0.0)
        sums = _sums(self._weights(splats.x), weights_y, deviations, count)
        return {
            "first": splats.pixel[0, 0], "count": count, "scale": largest, "center": self._spread(centers),
            "sums": self._add_along_row(sums, centers * inverse, splats.pixel[0]), "nonfinite": bad,
        }  # fmt: skip

    def _weights(self, x):
        """Return the weights along one axis for each neighbour, shape (rows, neighbours, pixels)."""
        reach = self.filter.reach
        weights = lax.map(lambda k: self.filter.profile(x - 0.5 - k), jnp.arange(-reach, reach + 1, dtype=x.dtype))
        return lax.optimization_barrier(jnp.moveaxis(weights, 0, 1))

    def _spread(self, x):
        """Return ``x`` with as many lanes more at either end as a sample reaches, like the last one."""
        return jnp.pad(x, ((0, 0), (self.filter.reach, self.filter.reach)), mode="edge")

    def _add_along_row(self, sums, centers, pixel):
        """Give the sums of each pixel to its neighbours in a row of the image; return those of each of them, about its
        own center, shape (neighbours above and below, 2 + 3 channels, pixels + 2 reach)."""
        column = (pixel % self.width).astype(jnp.int32)
        around = self._spread(centers)
        total = jnp.zeros((sums.shape[1], len(sums), around.shape[1]), sums.dtype)
        for k in range(sums.shape[2]):
            lanes = slice(k, k + len(column))
            to = column + (k - self.filter.reach)
            moved = jnp.concatenate(recentred(sums[:, :, k], (centers - around[:, lanes])[:, None]))
            moved = jnp.where((to >= 0) & (to < self.width), moved, 0.0)
            total = total.at[..., lanes].add(jnp.moveaxis(moved, 0, 1))
        return total

    def init(self, record, items=()):
        channels = record["center"].shape[-2]
        return [FilmSums(self.width, self.filter.reach, channels, *items)]

    def add(self, state, record, where=...):
        state[0].add(record)

    def merge(self, a, b):
        a[0].merge(b[0])
        return a

    def result(self, state):
        return [state[0].moments()]


def _survey(lights, valid, count):
    """Return the first sample of each pixel, 0 if it is not finite, shape (channels, pixels), the largest finite
    absolute value, and how many values are not finite."""

    def add_row(r, found):
        largest, bad = found
        light = jnp.where(valid[r], jnp.stack([light[r] for light in lights]), 0.0)
        finite = jnp.isfinite(light)
        return jnp.maximum(largest, jnp.where(finite, jnp.abs(light), 0.0)), bad + ~finite

    first = jnp.stack([light[0] for light in lights])
    start = jnp.zeros_like(first), jnp.zeros(first.shape, jnp.int32)
    largest, bad = lax.fori_loop(0, count.max(), add_row, start)
    return jnp.where(valid[0] & jnp.isfinite(first), first, 0.0), largest.max(), bad.sum()


def _sums(weights_x, weights_y, deviations, count):
    """Return sums over the samples of each pixel for each of its neighbours, in the layout of ``FilmSums.total``: shape
    (2 + 3 channels, neighbours, neighbours, pixels), from bottom to top and from left to right.

    Weights have shape (rows, neighbours, pixels), deviations (rows, pixels). Products are formed of the sums of a few
    samples each, which costs half of those of every sample; the interval of an edge then covers 93 % and not 94 %.
    """
    used, channels = count.max(), len(deviations)
    size = jnp.maximum(used // GROUPS, 1)
    groups = (used + size - 1) // size
    neighbours = weights_x.shape[1]
    zero = jnp.zeros((neighbours, *weights_x.shape[1:]), weights_x.dtype)

    def add_row(r, sums):
        w = weights_y[r][:, None] * weights_x[r]
        return [sums[0] + w, *(s + w * d[r] for s, d in zip(sums[1:], deviations, strict=True))]

    def add_group(k, total):
        stop = jnp.minimum((k + 1) * size, used)
        w, *wd = lax.fori_loop(k * size, stop, add_row, [zero] * (1 + channels))
        share = 1.0 / (stop - k * size).astype(zero.dtype)
        mean = w * share
        new = [w, mean * w, *wd, *(mean * x for x in wd), *(x * share * x for x in wd)]
        return [s + x for s, x in zip(total, new, strict=True)]

    total = lax.fori_loop(0, groups, add_group, [zero] * (2 + 3 * channels))
    w, ww, wd = total[0], total[1], total[2 : 2 + channels]
    wwd, wdd = total[2 + channels : 2 + 2 * channels], total[2 + 2 * channels :]
    n = jnp.maximum(used, 1).astype(zero.dtype)

    def variance(product, a, b):
        return jnp.where(groups > 1, (product - a * b / n) * (n / jnp.maximum(groups - 1, 1)), product)

    covariances = [variance(product, w, x) for product, x in zip(wwd, wd, strict=True)]
    variances = [variance(product, x, x) for product, x in zip(wdd, wd, strict=True)]
    return jnp.stack([w, variance(ww, w, w), *wd, *covariances, *variances])
