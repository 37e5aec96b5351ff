"""Where variance and fireflies come from, as parts that add up exactly to the whole.

A sample that is a sum of parts x_1 + ... + x_P has the variance sum_i Cov(x_i, x_1 + ... + x_P). Each term is a part's
share: its own variance and its covariance with all the rest. Shares add up to 1; one may be negative, where a part is
small whenever the others are large.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..integration.covariance import CovarianceResult
from ..integration.intervals import Ends
from .tails import clopper_pearson


class VarianceParts(NamedTuple):
    """The variance of one sample in parts.

    Attributes:
        names: of the parts, P of them.
        variance: of each part by itself, shape (P,).
        covariance: of each part with the sum of all others, shape (P,).
        share: (variance + covariance) / total; they add up to 1.
        share_stderr: standard error of each share.
        total, total_stderr: variance of the sum of the parts.
        correlation: between the parts, shape (P, P); NaN where one does not vary.
    """

    names: tuple[str, ...]
    variance: np.ndarray
    covariance: np.ndarray
    share: np.ndarray
    share_stderr: np.ndarray
    total: float
    total_stderr: float
    correlation: np.ndarray

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return (part, variance, covariance with the rest, share) for a table, largest share first, then the sum."""
        order = np.argsort(-self.share)
        rows = [
            (self.names[i], f"{self.variance[i]:.4g}", f"{self.covariance[i]:.3g}",
             f"{self.share[i]:.2%} +- {self.share_stderr[i]:.1%}")
            for i in order
        ]  # fmt: skip
        sums = self.variance.sum(), self.covariance.sum()
        return [*rows, ("sum", f"{sums[0]:.4g}", f"{sums[1]:.3g}", f"{self.total:.5g} +- {self.total_stderr:.1g}")]

    def __str__(self):
        return _table(("part", "variance", "covariance", "share"), self.rows())


def variance_parts(found: CovarianceResult, names=None) -> VarianceParts:
    """Return the share of each part in the variance of one sample.

    Args:
        found: what the tally ``Covariance`` kept of a sample in parts, such as ``path_parts``. In an image the variance
            is the noise in the pixels, mean over them; in one flat integral it holds what pixels differ by as well.
        names: of the parts, as ``part_names`` returns them; numbers by default.

    Raises:
        ValueError: names of another number, or too few samples for an error.
    """
    count = found.mean.shape[-1]
    names = _checked_names(names, count)

    def shares(_, covariance):
        whole = covariance.sum()
        return np.append(_ratio(covariance.sum(0), whole), whole)

    values, errors = found.propagate(shares)
    covariance = found.covariance
    variance, deviation = np.diag(covariance), np.sqrt(np.diag(covariance))
    return VarianceParts(
        names, variance, covariance.sum(0) - variance, values[:-1], errors[:-1], float(values[-1]), float(errors[-1]),
        _ratio(covariance, np.outer(deviation, deviation), np.nan),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class FireflyParts:
    """What parts bring to fireflies, for ``Covariance(of=FireflyParts(threshold))``, which ``firefly_parts`` reads:
    of a sample in parts that sum to ``threshold`` or more, which part is largest, and the energy in each; else zeros.

    Attributes:
        threshold: positive; a firefly is a sample whose parts sum to it or more.
        of: maps the values of a block to parts, sample axes first; None where they are an array of parts.
    """

    threshold: float
    of: Callable[[Any], Any] | None = None

    def __post_init__(self):
        if not 0.0 < self.threshold < np.inf:
            raise ValueError(f"threshold must be positive and finite, got {self.threshold!r}")

    def __call__(self, values):
        x = values if self.of is None else self.of(values)
        firefly = x.sum(-1, keepdims=True) >= self.threshold
        largest = jnp.argmax(x, -1)[..., None] == jnp.arange(x.shape[-1])
        return jnp.where(firefly, jnp.concatenate([largest.astype(x.dtype), x], -1), 0.0)


class FireflyShares(NamedTuple):
    """Which parts bring the fireflies.

    Attributes:
        names: of the parts, P of them.
        count: fireflies in which the part is the largest, shape (P,).
        share, share_interval: count over all fireflies, with 95 % Clopper-Pearson intervals.
        energy, energy_stderr: share of the parts in the sum of all fireflies.
        n, fireflies: samples and fireflies among them.
    """

    names: tuple[str, ...]
    count: np.ndarray
    share: np.ndarray
    share_interval: Ends
    energy: np.ndarray
    energy_stderr: np.ndarray
    n: int
    fireflies: int

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return (part, fireflies, share of them, share of their energy) for a table, most energy first."""
        return [
            (self.names[i], f"{self.count[i]:,}",
             f"{self.share[i]:.2%} [{self.share_interval.lower[i]:.1%}, {self.share_interval.upper[i]:.1%}]",
             f"{self.energy[i]:.2%} +- {self.energy_stderr[i]:.1%}")
            for i in np.argsort(-self.energy)
        ]  # fmt: skip

    def __str__(self):
        return _table(("largest part", "fireflies", "share", "energy"), self.rows())


def firefly_parts(found: CovarianceResult, names=None) -> FireflyShares:
    """Return which parts bring the fireflies, from ``Covariance(of=FireflyParts(threshold))`` over a sample in parts.

    Raises:
        ValueError: no firefly among the samples, names of another number, or another tally.
    """
    parts, odd = divmod(found.mean.shape[-1], 2)
    if odd:
        raise ValueError(
            "expected the result of Covariance(of=FireflyParts(threshold)): twice as many numbers as parts"
        )
    names, n = _checked_names(names, parts), int(found.n.sum())
    count = np.rint(found.total_mean[:parts] * n).astype(int)
    if not count.sum():
        raise ValueError(f"no firefly among {n:,} samples: lower the threshold or draw more")
    energy, stderr = found.propagate(lambda mean, _: _ratio(mean[parts:], mean[parts:].sum()))
    interval = clopper_pearson(count, int(count.sum()))
    return FireflyShares(names, count, count / count.sum(), interval, energy, stderr, n, int(count.sum()))


class SobolIndices(NamedTuple):
    """Which groups of coordinates the variance hangs on.

    Attributes:
        names: of the groups, G of them.
        first, first_stderr: share of the variance of E[f | group]: what would vanish if the group were known.
        total, total_stderr: share of the variance that the group takes part in, by itself or with others: what would be
            left on the mean if all others were known.
        variance, variance_stderr: of one sample.
    """

    names: tuple[str, ...]
    first: np.ndarray
    first_stderr: np.ndarray
    total: np.ndarray
    total_stderr: np.ndarray
    variance: float
    variance_stderr: float

    def rows(self) -> list[tuple[str, str, str]]:
        """Return (group, first-order index, total index) for a table, largest total first."""
        return [
            (self.names[i], f"{self.first[i]:.4f} +- {self.first_stderr[i]:.1g}",
             f"{self.total[i]:.4f} +- {self.total_stderr[i]:.1g}")
            for i in np.argsort(-self.total)
        ]  # fmt: skip

    def __str__(self):
        return _table(("group", "first order", "total"), self.rows())


def sobol_indices(found: CovarianceResult, names=None) -> SobolIndices:
    """Return Sobol' indices from ``Covariance`` over ``pick_freeze(f)``.

    With f, f' at two independent points and f_g at the first point with the coordinates of group g from the second,
    the first-order index is Cov(f', f_g) / Var f and the total one 1 - Cov(f, f_g) / Var f, each with the variance of
    the two that it compares (Sobol', Mathematics and Computers in Simulation 55 (2001); Janon, Klein, Lagnoux, Nodet &
    Prieur, ESAIM: Probability and Statistics 18 (2014)).

    Raises:
        ValueError: names of another number, or too few samples for an error.
    """
    names = _checked_names(names, found.mean.shape[-1] - 2)

    def indices(_, c):
        variance = np.diag(c)
        first = _ratio(c[1, 2:], 0.5 * (variance[1] + variance[2:]))
        total = 1.0 - _ratio(c[0, 2:], 0.5 * (variance[0] + variance[2:]))
        return np.concatenate([first, total, [0.5 * (variance[0] + variance[1])]])

    values, errors = found.propagate(indices)
    (first, total, whole), (first_error, total_error, error) = (
        np.split(x, [len(names), 2 * len(names)]) for x in (values, errors)
    )
    return SobolIndices(names, first, first_error, total, total_error, float(whole[0]), float(error[0]))


def _checked_names(names, count) -> tuple[str, ...]:
    names = tuple(f"part {k}" for k in range(count)) if names is None else tuple(names)
    if len(names) != count:
        raise ValueError(f"expected {count} names, one for each part, got {len(names)}: {names!r}")
    return names


def _ratio(a, b, otherwise=0.0):
    a, b = np.broadcast_arrays(np.asarray(a, np.float64), b)
    return np.divide(a, b, out=np.full(a.shape, otherwise), where=b != 0.0)


def _table(header, rows) -> str:
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]
    lines = ["  ".join(f"{word:{width}}" for word, width in zip(row, widths, strict=True)) for row in (header, *rows)]
    return "\n".join(line.rstrip() for line in lines)
