"""Parts of an estimate, that are made apart and merged: some of the samples, or some of the integrals of a family."""

from typing import Any, NamedTuple

import numpy as np

from .counts import MOST


class Part(NamedTuple):
    """What of an estimate is to be made.

    Attributes:
        indices: the samples, of each integral of a family, counted over all randomisations; None for all.
        chosen: the numbers of the integrals of a family, increasing; None for all.
        about: the part in words of the recipe.
    """

    indices: range | None = None
    chosen: np.ndarray | None = None
    about: dict[str, Any] = {}  # noqa: RUF012

    def of(self, replicate, start, stop):
        """Return the range of independent samples that the part has of ``start <= s < stop``."""
        return (replicate, start, stop) if self.indices is None else (replicate, self.indices.start, self.indices.stop)

    def replicates(self, first, count, points):
        """Return the ranges of the randomisations, of ``points`` samples each, that the part has of ``count``."""
        if self.indices is not None:
            first, count = first + self.indices.start // points, len(self.indices) // points
        return [(r, 0, points) for r in range(first, first + count)]

    def check(self, n, points):
        """Refuse a part that is none of ``n`` samples, or would cut a randomisation of ``points`` samples in two."""
        indices = self.indices
        if indices is None:
            return
        if indices.stop > n:
            raise ValueError(f"indices go up to {indices.stop}, but there are n={n} samples in all; take fewer")
        if indices.start % points or indices.stop % points:
            raise ValueError(
                f"a part has whole randomisations, of {points} points each: indices must start and stop at multiples "
                f"of that, got {indices}"
            )


WHOLE = Part()


def part(indices, chosen=None) -> Part:
    """Return the part that arguments of ``integrate`` or ``render`` mean."""
    if indices is not None and not (
        isinstance(indices, range) and indices.step == 1 and 0 <= indices.start < indices.stop <= MOST
    ):
        raise ValueError(
            f"indices must be a range(start, stop) of sample numbers with 0 <= start < stop, got {indices!r}"
        )
    about = {} if indices is None else {"indices": [indices.start, indices.stop]}
    if chosen is not None:
        about["integrals"] = len(chosen)
    return Part(indices, chosen, about)
