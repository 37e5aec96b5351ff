"""Estimates: a mean, how sure it is, and how it was made."""

import dataclasses
import math
from typing import Any

import jax
import numpy as np

from . import intervals, storage
from .intervals import Interval
from .moments import MomentsResult
from .storage import storable

# Cochran's rule says that the mean of n samples is near normal if n exceeds 25 skewness^2. That is the skewness of the
# law; that of samples is mostly smaller, and the smaller, the lower their mean. So ask for twice as many.
TOO_SKEW = 50.0
EVEN_MEANS = 10.0  # half of the variance by two means of points that fill space evenly is no alarm yet
TOO_PEAKED = 0.05  # share of the sum of fourth powers in the squared sum of squares: few samples make the variance


@storable
@dataclasses.dataclass(frozen=True)
class Estimate:
    """The result of a Monte Carlo integration.

    Attributes:
        moments: sample moments of each leaf of the value.
        n: samples in all, or for each pixel of an image.
        tallies: results of the other tallies by name; ``estimate["name"]`` looks one up.
        seconds: wall time of the run, compilation included.
        recipe: what is needed to run it again: key, sampler, n, replicates.
        between: moments of the means of independent randomisations; None where the samples are independent.
        replicate_means: those means, shape (R, ...) for each leaf; None for a family of integrals.
        reached: whether the target was met; None where there was none.
        ratio: whether it is a ratio of sums, such as a pixel with a filter: then no interval follows from bounds.
        sums: what it was made from, so that ``merge`` can add others; None unless there was a checkpoint or a part.
    """

    moments: list[MomentsResult]
    n: int
    tallies: dict[str, Any]
    seconds: float
    recipe: dict[str, Any]
    structure: Any = None
    between: list[MomentsResult] | None = None
    replicate_means: list[np.ndarray] | None = None
    reached: bool | None = None
    ratio: bool = False
    sums: Any = dataclasses.field(default=None, repr=False, compare=False)

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
        """Unbiased variance of one sample. For evenly spread points it does not tell the error of the mean."""
        return self._tree([m.variance for m in self.moments])

    @property
    def stderr(self):
        """Standard error of the mean: from the variance of the samples where they are independent, else from the spread
        of the means of independent randomisations."""
        return self._tree(self._stderrs())

    def _stderrs(self):
        return [_stderr(m) for m in (self.moments if self.between is None else self.between)]

    @property
    def nonfinite(self) -> int:
        """How many values were NaN or infinite. They are part of the mean: nothing is dropped."""
        return sum(m.nonfinite for m in self.moments)

    @property
    def heavy(self) -> bool:
        """Whether few samples carry so much of the variance that no interval can be trusted: skewness^2 above n / 50,
        or kurtosis above n / 20, for some component; ten times that for means of points that fill space evenly, as
        reverse mode makes them. False for images, which keep no third moments."""
        return any(np.any(heavy_tail(m, self._of_even_means(m))) for m in self.moments)

    def _of_even_means(self, m):
        """Return whether moments are those of means of points that fill space evenly."""
        return self.between is not None and np.max(m.n, initial=0) < self.n

    @property
    def status(self) -> str:
        """Whether mean and error can be trusted, and whether a target was met: one of ``"non-finite values seen"``,
        ``"tail too heavy"``, ``"all samples equal"`` (a constant, or an event so rare that none has met it), and then
        ``"converged"``, ``"budget reached"``, or ``"complete"`` where there was no target."""
        if self.nonfinite:
            return "non-finite values seen"
        if self.heavy:
            return "tail too heavy"
        if self.moments and all(np.all((m.n > 1) & (m.central[0] == 0.0)) for m in self.moments):
            return "all samples equal"
        return {None: "complete", True: "converged", False: "budget reached"}[self.reached]

    def interval(self, level: float = 0.95, method: str | None = None, bounds=None) -> Interval:
        """Return a confidence interval (lower, upper) of the mean; its ``method`` says how it was made.

        Args:
            level: probability of covering the truth.
            method: None picks what is valid: ``"bounded"`` where bounds are given, else ``"corrected for skewness"``:
                the interval of ``"student-t over replicates"`` for randomised points, of ``"normal"`` for independent
                samples, bent by Hall's transform where the law of the mean leans. These two can be asked for as they
                are, and stand in where there are no moments of order 3 and 4 (images), or fewer than 8 replicates or
                samples. With replicates one can also ask for ``"median of means"``, which outliers do not move, and
                ``"bootstrap-t"``.
            bounds: numbers (a, b) between which all values of the integrand lie. The interval then holds for any
                number of samples and any law (empirical Bernstein bound, Maurer and Pontil 2009).

        Raises:
            ValueError: a level outside (0, 1), an unknown method, or one that needs replicates or bounds that are not
                there.
        """
        return intervals.interval(self, level, method, bounds)

    def half_widths(self, level: float) -> list[np.ndarray]:
        """Return half the width of the default interval for each leaf, the mean of both its sides."""
        return intervals.half_widths(self, level)

    def save(self, path) -> None:
        """Write it to an npz file, which appears whole or not at all; ``Estimate.load`` reads it.

        Functions, such as ``of`` of a tally, are kept by their names only, and a value of a class of your own comes
        back as a plain list or tuple.

        Raises:
            ValueError: a result of a tally of your own that is not made of numbers, arrays, lists and dictionaries.
            OSError: the file cannot be written.
        """
        storage.save(path, self if self.sums is None else self.sums)

    @classmethod
    def load(cls, path) -> "Estimate":
        """Read what ``save`` wrote, or a checkpoint: of an unfinished run, the estimate from what there is.

        Nothing in a file is run. Raises ``ValueError`` for a file that is damaged, of another version or none of
        jaxmc's, and for a checkpoint without samples; ``OSError`` where it cannot be read.
        """
        found = storage.load(path)
        try:
            return found if isinstance(found, cls) else found.estimate()
        except Exception as error:  # a file that was written by another hand may hold anything
            raise ValueError(f"{path} holds no estimate: {error}") from error

    def summary(self) -> str:
        """Return mean, error, samples, time and status in a few lines."""
        rate = self.n / self.seconds if self.seconds > 0 else math.inf
        return f"{self}\nn = {self.n:,}   {self.seconds:.3g} s   {rate:.3g} samples/s   {self.status}"

    def __str__(self):
        words = []
        for m, error in zip(self.moments, self._stderrs(), strict=True):
            mean, error = np.ravel(m.mean), np.ravel(error)
            if mean.size > 4:
                words.append(f"array{np.shape(m.mean)} of mean {mean.mean():.5g}")
            else:
                words.append(" ".join(with_error(a, b) for a, b in zip(mean, error, strict=True)))
        return "; ".join(words)


def _stderr(m: MomentsResult):
    return np.sqrt(m.variance / np.maximum(m.n, 1))


def heavy_tail(m: MomentsResult, even_means=False):
    """Return for each component whether few samples carry so much of its variance that no interval can be trusted;
    False where the moments of order 3 and 4 that tell it were not kept.

    ``even_means``: they are means of points that fill space evenly, of which few count for more by nature.
    """
    if len(m.central) < 3:
        return np.zeros(np.shape(m.mean), bool)
    n = m.n * (EVEN_MEANS if even_means else 1.0)
    return (m.skewness**2 > n / TOO_SKEW) | (m.kurtosis > n * TOO_PEAKED)


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
