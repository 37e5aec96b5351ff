"""Estimates: a mean, how sure it is, and how it was made."""

import dataclasses
import math
from typing import Any

import jax
import numpy as np
from scipy import stats

from .moments import MomentsResult


@dataclasses.dataclass(frozen=True)
class Estimate:
    """The result of a Monte Carlo integration.

    Attributes:
        moments: sample moments of each leaf of the value.
        n: samples in all, or for each pixel of an image.
        tallies: results of the other tallies by name; ``estimate["name"]`` looks one up.
        seconds: wall time of the run, compilation included.
        recipe: what is needed to run it again: key, sampler, n.
    """

    moments: list[MomentsResult]
    n: int
    tallies: dict[str, Any]
    seconds: float
    recipe: dict[str, Any]
    structure: Any = None

    def __getitem__(self, name):
        return self.tallies[name]

    def _tree(self, leaves):
        leaves = [leaf.item() if leaf.ndim == 0 else leaf for leaf in map(np.asarray, leaves)]
        return jax.tree.unflatten(self.structure, leaves)

    @property
    def mean(self):
        """The estimate, float64, in the shape or pytree that the integrand returns."""
        return self._tree([m.mean for m in self.moments])

    @property
    def variance(self):
        """Unbiased variance of one sample."""
        return self._tree([m.variance for m in self.moments])

    @property
    def stderr(self):
        """Standard error of the mean, from the sample variance: right for independent samples."""
        return self._tree([_stderr(m) for m in self.moments])

    @property
    def nonfinite(self) -> int:
        """How many values were NaN or infinite. They are part of the mean: nothing is dropped."""
        return sum(m.nonfinite for m in self.moments)

    @property
    def status(self) -> str:
        """``"complete"``, or ``"non-finite values seen"``, in which case mean and error mean nothing."""
        return "non-finite values seen" if self.nonfinite else "complete"

    def interval(self, level: float = 0.95):
        """Return (lower, upper): the normal confidence interval of the mean at ``level``.

        Rests on the central limit theorem; a heavy tail that the samples have not met yet makes it too short.
        """
        if not 0.0 < level < 1.0:
            raise ValueError(f"level must lie between 0 and 1, got {level}")
        z = stats.norm.isf((1.0 - level) / 2.0)
        lower = self._tree([m.mean - z * _stderr(m) for m in self.moments])
        return lower, self._tree([m.mean + z * _stderr(m) for m in self.moments])

    def summary(self) -> str:
        """Return mean, error, samples, time and status in a few lines."""
        rate = self.n / self.seconds if self.seconds > 0 else math.inf
        return f"{self}\nn = {self.n:,}   {self.seconds:.3g} s   {rate:.3g} samples/s   {self.status}"

    def __str__(self):
        words = []
        for m in self.moments:
            mean, error = np.ravel(m.mean), np.ravel(_stderr(m))
            if mean.size > 4:
                words.append(f"array{np.shape(m.mean)} of mean {mean.mean():.5g}")
            else:
                words.append(" ".join(with_error(a, b) for a, b in zip(mean, error, strict=True)))
        return "; ".join(words)


def _stderr(m: MomentsResult):
    return np.sqrt(m.variance / np.maximum(m.n, 1))


def with_error(value: float, error: float) -> str:
    """Return ``0.26612(8)``: the error is of the last digit shown (of the last two where it starts with 1)."""
    if not (math.isfinite(value) and math.isfinite(error)) or error <= 0.0:
        return f"{value:.8g}"
    digits = 1 if error / 10.0 ** math.floor(math.log10(error)) >= 1.95 else 2
    place = digits - 1 - math.floor(math.log10(error))
    shown = round(error * 10.0**place)
    if not -5 < place < 15:
        return f"{value:.6g} +- {error:.1g}"
    return f"{value:.{max(place, 0)}f}({shown * 10 ** max(-place, 0)})"
