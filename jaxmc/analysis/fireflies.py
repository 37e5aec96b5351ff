"""The firefly report: how often, how heavy, how far the mean can be trusted."""

from typing import NamedTuple

import numpy as np

from ..integration.intervals import Ends
from ..integration.tallies import Histogram, Largest
from .tails import TailFit, Wait, clopper_pearson, effective_sample_size, expected_wait, largest_shares, pareto_khat

SHARES = (1, 10, 100)


class FireflyReport(NamedTuple):
    """What the samples say about their own tail.

    Attributes:
        n: samples seen.
        threshold: a firefly is a sample at or above it.
        count: fireflies seen.
        rate: count / n, with its 95% Clopper-Pearson interval in ``rate_interval``.
        energy: share of the sum that fireflies carry.
        shares: share of the sum that the largest 1, 10 and 100 samples carry.
        effective_n: samples of equal size that would know the mean as well, (sum c)^2 / sum c^2.
        tail: Pareto k-hat with its reliability.
        wait: expected number of samples until the first firefly, with interval and median.
        maximum: largest sample.
    """

    n: int
    threshold: float
    count: int
    rate: float
    rate_interval: Ends
    energy: float
    shares: dict[int, float]
    effective_n: float
    tail: TailFit
    wait: Wait
    maximum: float

    def rows(self) -> list[tuple[str, str]]:
        """Return (quantity, value) pairs for a table."""
        low, high = self.rate_interval
        return [
            ("samples", f"{self.n:,}"),
            (f"fireflies (samples >= {self.threshold:g})", f"{self.count:,}"),
            ("firefly rate", f"{self.rate:.3g}  [{low:.3g}, {high:.3g}]"),
            ("share of the sum carried by fireflies", f"{self.energy:.1%}"),
            *((f"share of the sum carried by the largest {k}", f"{share:.3g}") for k, share in self.shares.items()),
            ("largest sample", f"{self.maximum:.6g}"),
            ("effective number of samples", f"{self.effective_n:,.0f}  ({self.effective_n / self.n:.2%} of n)"),
            ("Pareto k-hat", self.tail.explain()),
            ("expected wait for the first firefly", f"{self.wait.mean:,.0f} samples (median {self.wait.median:,.0f})"),
        ]


def firefly_report(histogram: Histogram, largest: Largest, threshold: float) -> FireflyReport:
    """Return the firefly report of a tail histogram and the largest samples of the same run.

    Args:
        histogram: result of ``TailHistogram``.
        largest: result of ``TopSamples``; k-hat wants more than 3 sqrt(n) of them.
        threshold: what counts as a firefly; taken up to the next edge of the histogram, 13% at most.

    Raises:
        ValueError: a threshold that is not positive, or tallies of different runs.
    """
    if not threshold > 0.0:
        raise ValueError(f"threshold must be positive, got {threshold}")
    if histogram.n != largest.n:
        raise ValueError(f"histogram has n={histogram.n} and largest n={largest.n}: they must come from one run")
    first = int(np.searchsorted(histogram.edges, threshold))
    count, total = int(histogram.count[first:].sum()), float(histogram.total.sum())
    n = histogram.n
    return FireflyReport(
        n=n,
        threshold=float(histogram.edges[first]),
        count=count,
        rate=count / n,
        rate_interval=clopper_pearson(count, n),
        energy=float(histogram.total[first:].sum()) / total if total > 0.0 else 0.0,
        shares=dict(zip(SHARES, map(float, largest_shares(largest.value, total, SHARES)), strict=True)),
        effective_n=float(effective_sample_size(n, total, float(histogram.square.sum()))),
        tail=pareto_khat(largest.value, n),
        wait=expected_wait(count, n),
        maximum=float(largest.value[0]),
    )
