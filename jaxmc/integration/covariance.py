"""Covariances of a vector-valued sample, with errors of whatever is computed from them."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .moments import apply
from .storage import storable

GROUPS = 32  # of samples of one integral, kept apart for error bars
REPLICATES = 64  # of halves of the samples of a family


@storable
@dataclasses.dataclass(frozen=True)
class Covariance:
    """Mean vector and covariance matrix of a sample that is a vector, such as the parts of a path integrand.

    Samples of one integral are divided into up to 32 groups, those of each integral of a family, such as the pixels of
    an image, into two halves. These are kept apart, so that any function of mean and covariance gets a standard error,
    see ``CovarianceResult.propagate``. Blocks are centred and scaled by themselves, and merged in float64 (Chan, Golub
    & LeVeque, The American Statistician 37 (1983)).

    Attributes:
        of: applied to the values of a block, sample axes first; None keeps the value as it is. One array for each
            sample, of any shape: it is taken as one vector.
    """

    of: Callable[[Any], Any] | None = None
    pooled = False

    def reduce(self, values, valid, axes):
        x = apply(self.of, values)
        if jax.tree.structure(x) != jax.tree.structure(0) or x.ndim < 3:
            raise ValueError(
                "Covariance needs one array for each sample, but the integrand returns a number or a tree; say which "
                "array with of=..., or use Moments for numbers"
            )
        x = x.astype(jnp.promote_types(x.dtype, jnp.float32)).reshape(*x.shape[:2], -1)
        lanes = x.shape[1]
        if len(axes) > 1:
            groups, strata = math.gcd(lanes, GROUPS), 1
        else:
            groups, strata = lanes, 2
            x, valid = _halves(x), _halves(valid)
        record = _reduce(x, valid, groups * strata)
        return {name: r.reshape(groups, strata, *r.shape[1:]) for name, r in record.items()}

    def init(self, record, items=()):
        shape = (*(items or record["center"].shape[1:2]), *record["center"].shape[-2:])
        return {
            "n": np.zeros(shape[:2]), "mean": np.zeros(shape), "scatter": np.zeros((*shape, shape[-1])),
            "nonfinite": 0, "each": bool(items),
        }  # fmt: skip

    @np.errstate(all="ignore")  # samples that are not finite make sums that are not: that is said by their number
    def add(self, state, record, where=...):
        n, center, scale, first, second = (
            np.asarray(record[k], np.float64) for k in ("count", "center", "scale", "first", "second")
        )
        share = first / np.maximum(n, 1.0)[..., None]
        scatter = (second - _outer(first, share)) * _outer(scale, scale)
        sums = state["n"][where], state["mean"][where], state["scatter"][where]
        state["n"][where], state["mean"][where], state["scatter"][where] = _merged(
            *sums, n, center + scale * share, scatter
        )
        state["nonfinite"] += int(record["nonfinite"].sum())

    @np.errstate(all="ignore")
    def merge(self, a, b):
        n, mean, scatter = _merged(*(x[k] for x in (a, b) for k in ("n", "mean", "scatter")))
        return a | {"n": n, "mean": mean, "scatter": scatter, "nonfinite": a["nonfinite"] + b["nonfinite"]}

    def result(self, state):
        kept = (state[k].copy() for k in ("n", "mean", "scatter"))
        return CovarianceResult(*kept, state["nonfinite"], state["each"])


def _halves(x):
    """Return rows in pairs, the two of a pair side by side: (rows, lanes, ...) becomes (rows / 2, 2 lanes, ...)."""
    x = jnp.pad(x, [(0, len(x) % 2)] + [(0, 0)] * (x.ndim - 1))
    return jnp.moveaxis(x.reshape(-1, 2, *x.shape[1:]), 1, 2).reshape(len(x) // 2, -1, *x.shape[2:])


def _reduce(x, valid, groups):
    """Return scaled sums of the vectors of each group of neighbouring lanes, around its mean."""
    lanes = x.shape[1]

    def by_group(sums):
        return sums.reshape(groups, lanes // groups, *sums.shape[1:])

    def to_lanes(record):
        return jnp.repeat(record, lanes // groups, axis=0)

    valid = valid[..., None]
    count = by_group(valid.sum(0)).sum(1).astype(x.dtype)
    size = len(x) * (lanes // groups)
    # Scale before summing, or finite values may overflow.
    total = by_group(jnp.where(valid, x * (1.0 / size), 0.0).sum(0)).sum(1)
    center = total * (size / jnp.maximum(count, 1.0))
    deviation = jnp.where(valid, x - to_lanes(center), 0.0)
    scale = by_group(jnp.abs(deviation).max(0)).max(1)
    z = deviation * to_lanes(jnp.where(scale > 0.0, 1.0 / scale, 0.0))
    return {
        "count": count[:, 0],
        "center": center,
        "scale": scale,
        "first": by_group(z.sum(0)).sum(1),
        "second": by_group((z[..., :, None] * z[..., None, :]).sum(0)).sum(1),
        "nonfinite": by_group((valid & ~jnp.isfinite(x)).sum(0)).sum((1, 2)),
    }


def _outer(a, b):
    return a[..., :, None] * b[..., None, :]


def _merged(n, mean, scatter, more, other, spread):
    """Return number, mean and scatter of two sets of samples together."""
    both = np.maximum(n + more, 1.0)
    # A mean of no samples may be anything.
    apart = np.where((more > 0)[..., None], other - mean, 0.0)
    scatter = scatter + spread + (n * more / both)[..., None, None] * _outer(apart, apart)
    return n + more, mean + (more / both)[..., None] * apart, scatter


@storable
class CovarianceResult(NamedTuple):
    """Samples in groups: their number ``n`` (G, H), ``mean`` (G, H, P), and ``scatter`` (G, H, P, P), the sums of
    products of deviations from the mean of the group. ``each``: the groups are the integrals of a family, such as
    pixels, in H = 2 halves."""

    n: np.ndarray
    mean: np.ndarray
    scatter: np.ndarray
    nonfinite: int
    each: bool

    def _groups(self):
        """Return number, mean and scatter of each group, its halves merged."""
        sums = self.n[:, 0], self.mean[:, 0], self.scatter[:, 0]
        for k in range(1, self.n.shape[1]):
            sums = _merged(*sums, self.n[:, k], self.mean[:, k], self.scatter[:, k])
        return sums

    @property
    def covariance(self) -> np.ndarray:
        """Unbiased covariance matrix of one sample, shape (P, P); of a family the mean over its integrals, each around
        its own mean, weighted by n - 1: the noise alone. NaN for fewer than two samples."""
        n, mean, scatter = self._groups()
        if self.each:
            return _divided(scatter.sum(0), np.maximum(n - 1.0, 0.0).sum())
        whole = 0.0 * n[0], 0.0 * mean[0], 0.0 * scatter[0]
        for k in range(len(n)):
            whole = _merged(*whole, n[k], mean[k], scatter[k])
        return _divided(whole[2], whole[0] - 1.0)

    @property
    def covariances(self) -> np.ndarray:
        """Covariance matrix of each group, shape (G, P, P): of each pixel of an image."""
        n, _, scatter = self._groups()
        return np.stack([_divided(s, k - 1.0) for s, k in zip(scatter, n, strict=True)])

    @property
    def total_mean(self) -> np.ndarray:
        """Mean of all samples, shape (P,)."""
        return np.tensordot(self.n, self.mean, 2) / self.n.sum()

    def propagate(self, function) -> tuple[np.ndarray, np.ndarray]:
        """Return ``function(mean, covariance)`` of all samples, and its standard error.

        Of one integral it is that of the jackknife, which leaves out one of up to 32 groups at a time (Efron & Stein,
        Annals of Statistics 9 (1981)). Of a family it is that of half-samples: one half of the samples of each integral
        at random against the other halves, 64 times (McCarthy, Review of the International Statistical Institute 37
        (1969)); so what integrals differ by does not count as error. It is known to about 1 in 8 itself, less well
        where few samples make the covariance. Samples must be independent.

        Args:
            function: of mean (P,) and covariance (P, P); it may return an array.

        Raises:
            ValueError: fewer than two groups, or no halves, with two samples or more.
        """
        freedom = np.maximum(self.n - 1.0, 0.0)
        total, scatter = self.n[..., None] * self.mean, self.scatter
        if self.each:
            spread = self._half_samples(function, freedom, total, scatter)
        else:
            spread = self._jackknife(function, freedom, total, scatter)
        return np.asarray(function(self.total_mean, self.covariance)), np.sqrt(spread)

    def _jackknife(self, function, freedom, total, scatter):
        used = np.flatnonzero(freedom[:, 0] > 0)
        if len(used) < 2:
            raise ValueError(f"an error needs two groups of two samples or more, got {len(used)}: draw more samples")

        def without(k):
            mean = (total.sum((0, 1)) - total[k, 0]) / (self.n.sum() - self.n[k, 0])
            return function(mean, (scatter.sum((0, 1)) - scatter[k, 0]) / (freedom.sum() - freedom[k, 0]))

        values = np.array([without(k) for k in used])
        return (1.0 - 1.0 / len(used)) * np.sum((values - values.mean(0)) ** 2, 0)

    def _half_samples(self, function, freedom, total, scatter):
        if not freedom.sum(0).all():
            raise ValueError(
                "an error needs halves of two samples or more of the same integral: take 4 samples of each"
            )
        # The halves are drawn, but always the same ones: an error is a function of its samples.
        which = np.random.default_rng(0).integers(0, 2, (REPLICATES, len(freedom))).astype(np.float64)

        def chosen(x):
            """Return sums over one half of each integral, and over the other halves."""
            first, second = (x[:, k].reshape(len(x), -1) for k in (0, 1))
            one = first.sum(0) + which @ (second - first)
            other = first.sum(0) + second.sum(0) - one
            return (y.reshape(REPLICATES, *x.shape[2:]) for y in (one, other))

        sides = zip(*map(chosen, (self.n, total, freedom, scatter)), strict=True)
        one, other = (
            np.array([function(t / n, s / max(f, 1.0)) for n, t, f, s in zip(*side, strict=True)]) for side in sides
        )
        return np.mean((0.5 * (one - other)) ** 2, 0)


def _divided(scatter, freedom):
    return scatter / freedom if freedom > 0 else np.full(scatter.shape, np.nan)
