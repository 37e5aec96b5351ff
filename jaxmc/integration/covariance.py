"""Covariances of a vector-valued sample, with errors of whatever is computed from them."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .moments import apply

GROUPS = 32  # of samples, kept apart for error bars by the jackknife


@dataclasses.dataclass(frozen=True)
class Covariance:
    """Mean vector and covariance matrix of a sample that is a vector, such as the parts of a path integrand.

    Samples are divided into up to 32 groups, which are kept apart, so that any function of mean and covariance gets a
    standard error (``CovarianceResult.jackknife``). In a family of integrals the groups are the integrals: an image has
    a matrix for each pixel. Blocks are centred and scaled by themselves, and merged in float64 (Chan, Golub & LeVeque,
    The American Statistician 37 (1983)).

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
        groups = math.gcd(lanes, GROUPS) if len(axes) > 1 else lanes

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

    def init(self, record, items=()):
        shape = (*(items or record["center"].shape[1:2]), record["center"].shape[-1])
        return {
            "n": np.zeros(shape[:1]), "mean": np.zeros(shape), "scatter": np.zeros((*shape, shape[-1])),
            "nonfinite": 0, "each": bool(items),
        }  # fmt: skip

    @np.errstate(all="ignore")  # samples that are not finite make sums that are not: that is said by their number
    def add(self, state, record, where=...):
        n, center, scale, first, second = (
            np.asarray(record[k], np.float64) for k in ("count", "center", "scale", "first", "second")
        )
        share = first / np.maximum(n, 1.0)[:, None]
        scatter = second - first[:, :, None] * share[:, None, :]
        _merge(state, where, n, center + scale * share, scatter * scale[:, :, None] * scale[:, None, :])
        state["nonfinite"] += int(record["nonfinite"].sum())

    @np.errstate(all="ignore")
    def merge(self, a, b):
        _merge(a, ..., b["n"], b["mean"], b["scatter"])
        a["nonfinite"] += b["nonfinite"]
        return a

    def result(self, state):
        kept = (state[k].copy() for k in ("n", "mean", "scatter"))
        return CovarianceResult(*kept, state["nonfinite"], state["each"])


def _merge(state, where, n, mean, scatter):
    """Add groups of samples to groups of samples, in place."""
    known = state["n"][where]
    both = np.maximum(known + n, 1.0)
    # Leave a group that has no samples yet where the new ones are.
    apart = np.where((n > 0)[:, None], mean - state["mean"][where], 0.0)
    state["scatter"][where] += scatter + (known * n / both)[:, None, None] * (apart[:, :, None] * apart[:, None, :])
    state["mean"][where] += (n / both)[:, None] * apart
    state["n"][where] = known + n


class CovarianceResult(NamedTuple):
    """Samples in groups: their number ``n`` (G,), ``mean`` (G, P), and ``scatter`` (G, P, P), the sums of products of
    deviations from the mean of the group. ``each``: the groups are integrals of a family, such as pixels."""

    n: np.ndarray
    mean: np.ndarray
    scatter: np.ndarray
    nonfinite: int
    each: bool

    @property
    def covariance(self) -> np.ndarray:
        """Unbiased covariance matrix of one sample, shape (P, P); of a family the mean over its integrals, each around
        its own mean, weighted by n - 1: the noise alone. NaN for fewer than two samples."""
        if self.each:
            return self._within(self.scatter.sum(0), self.n)
        state = {"n": np.zeros(1), "mean": np.zeros((1, self.mean.shape[1])), "scatter": 0.0 * self.scatter[:1]}
        for k in range(len(self.n)):
            _merge(state, ..., self.n[k : k + 1], self.mean[k : k + 1], self.scatter[k : k + 1])
        return self._within(state["scatter"][0], state["n"])

    @property
    def total_mean(self) -> np.ndarray:
        """Mean of all samples, shape (P,)."""
        return self.n @ self.mean / self.n.sum()

    @property
    def covariances(self) -> np.ndarray:
        """Covariance matrix of each group, shape (G, P, P): of each pixel of an image."""
        with np.errstate(all="ignore"):
            return np.where(self.n[:, None, None] > 1, self.scatter / (self.n - 1.0)[:, None, None], np.nan)

    @staticmethod
    def _within(scatter, n):
        freedom = np.maximum(n - 1.0, 0.0).sum(-1)
        with np.errstate(all="ignore"):
            return np.where(freedom > 0, scatter / freedom, np.nan)

    def jackknife(self, function) -> tuple[np.ndarray, np.ndarray]:
        """Return ``function(mean, covariance)`` of all samples, and its standard error.

        The error is that of the jackknife that leaves out one of up to 32 groups at a time (Efron & Stein, Annals of
        Statistics 9 (1981)); it has a relative error of about 1 / 8 itself, more where few samples make the covariance.
        In a family group k holds the integrals k, k + 32, k + 64, ...; what these differ by counts as error, so it is
        rather too large there. Samples must be independent.

        Args:
            function: of mean (P,) and covariance (P, P); it may return an array.

        Raises:
            ValueError: fewer than two groups with samples.
        """
        count = min(GROUPS, len(self.n))
        some = [slice(k, None, count) for k in range(count)]
        n = np.array([self.n[k].sum() for k in some])
        total = np.array([self.n[k] @ self.mean[k] for k in some])
        scatter = np.array([self.scatter[k].sum(0) for k in some])
        freedom = np.array([np.maximum(self.n[k] - 1.0, 0.0).sum() for k in some])
        used = np.flatnonzero(freedom > 0)
        if len(used) < 2:
            raise ValueError(f"a jackknife needs two groups with samples, got {len(used)}: draw more samples")
        means = (total.sum(0) - total) / (n.sum() - n)[:, None]
        covariances = (scatter.sum(0) - scatter) / (freedom.sum() - freedom)[:, None, None]
        without = [np.asarray(function(means[k], covariances[k])) for k in used]
        spread = np.sum((without - np.mean(without, 0)) ** 2, 0)
        return np.asarray(function(self.total_mean, self.covariance)), np.sqrt((1.0 - 1.0 / len(used)) * spread)
