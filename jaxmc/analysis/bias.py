"""Is one image biased against another? Welch's test of tiles, and when it may be believed.

A *Welch sample* is the sum of one sample from each pixel of a tile. Many pixels in a sum bring it near the normal law
that the test assumes. Source: Jung, Hanika & Dachsbacher, "Detecting Bias in Monte Carlo Renderers using Welch's
t-test", JCGT 9(2), 2020.

A test that does not reject proves nothing: its power grows as the noise falls. With fireflies so rare that a Welch
sample mostly holds none, both images mostly miss the same energy, and the test is conservative rather than exact.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

LEAST_FIREFLIES = 1.0  # expected in a Welch sample, for p-values that are uniform


class Welch(NamedTuple):
    """Welch's t-test: ``t``, its degrees of freedom, and the two-sided ``p``, in the shape of the means."""

    t: np.ndarray
    dof: np.ndarray
    p: np.ndarray


def welch_test(mean_a, variance_a, n_a, mean_b, variance_b, n_b) -> Welch:
    """Return Welch's test that two means are equal, from the means and unbiased variances of ``n`` samples each.

    t = (a - b) / sqrt(va / na + vb / nb), with Satterthwaite's degrees of freedom
    (va / na + vb / nb)^2 / ((va / na)^2 / (na - 1) + (vb / nb)^2 / (nb - 1)). Where neither varies p is 1 for equal
    means and 0 for others.

    Raises:
        ValueError: fewer than two samples.
    """
    n_a, n_b = np.asarray(n_a, np.float64), np.asarray(n_b, np.float64)
    if np.any(n_a < 2) or np.any(n_b < 2):
        raise ValueError(f"a variance needs two samples or more, got n = {n_a.min()} and {n_b.min()}")
    a, b = np.asarray(variance_a, np.float64) / n_a, np.asarray(variance_b, np.float64) / n_b
    return _test(np.asarray(mean_a, np.float64) - mean_b, a, n_a - 1.0, b, n_b - 1.0)


def _test(difference, a, freedom_a, b, freedom_b) -> Welch:
    """Test a difference whose two sides have the variances ``a`` and ``b``, known with some degrees of freedom."""
    with np.errstate(all="ignore"):
        t = difference / np.sqrt(a + b)
        dof = (a + b) ** 2 / (a**2 / freedom_a + b**2 / freedom_b)
        p = 2.0 * stats.t.sf(np.abs(t), dof)
    constant = a + b == 0.0
    return Welch(np.where(constant & (difference == 0.0), 0.0, t), dof, np.where(constant, difference == 0.0, p))


class BiasTest(NamedTuple):
    """Welch's test of the tiles of two images.

    Attributes:
        p: of each tile, shape (rows, columns) or with channels last; ``adjusted``, by Holm's steps, holds for all tiles
            and channels together.
        difference: mean of a tile in the first image minus the second.
        uniformity: p-value of the Kolmogorov-Smirnov test that all p are uniform, as they are without bias. Channels
            of one tile depend on each other: test luminance, or take it as a hint.
        expected: fireflies in a Welch sample of each tile, shape (rows, columns); NaN where their rate is not known.
    """

    p: np.ndarray
    adjusted: np.ndarray
    difference: np.ndarray
    uniformity: float
    expected: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """Whether a Welch sample holds at least one firefly on average, or is known to have none at all."""
        return (self.expected >= LEAST_FIREFLIES) | (self.expected == 0.0)

    def rejected(self, level: float = 0.05) -> np.ndarray:
        """Return which tiles differ, all tests together at ``level``."""
        return self.adjusted <= level

    def histogram(self, bins: int = 20) -> tuple[np.ndarray, np.ndarray]:
        """Return counts and edges of the histogram of p: flat where there is no bias."""
        return np.histogram(self.p[np.isfinite(self.p)], bins, (0.0, 1.0))

    def explain(self) -> str:
        """Say in a few words what was found and whether the test could find it."""
        count = int(self.rejected().sum())
        found = f"{count} of {self.p.size} tiles differ (Holm, 5 %)" if count else f"no tile of {self.p.size} differs"
        if np.isnan(self.expected).any():
            trust = "the rate of fireflies is not known: pass it to know whether the test can be trusted"
        else:
            trust = f"{self.valid.mean():.0%} of the tiles hold a firefly in each Welch sample"
        return f"{found}; p-values uniform: p = {self.uniformity:.3g}; {trust}"


def compare_tiles(a, b, *, tile: int = 32, firefly_rate=None) -> BiasTest:
    """Test whether two independent images have the same expectation, tile by tile.

    The variance of a Welch sample is the sum of the variances of its pixels, which are independent; its degrees of
    freedom are Satterthwaite's.

    Args:
        a, b: estimates of ``render``, or moments of images: with ``mean``, ``variance`` and ``n``, shape
            (height, width) or (height, width, channels), of independent samples, two or more in each pixel.
        tile: its width and height; tiles at the right and the bottom may be smaller.
        firefly_rate: probability that a sample is a firefly, a number or one for each pixel (height, width), from
            ``TailImages.rate``; 0 where there are none.

    Raises:
        ValueError: images of different shapes, estimates with a filter or with points that are not independent, whose
            pixels or samples depend on each other, or fewer than two samples.
    """
    for estimate in (a, b):
        if getattr(estimate, "ratio", False) or getattr(estimate, "between", None) is not None:
            raise ValueError("expected independent samples and no filter: pixels or samples depend on each other here")
    if np.shape(a.mean) != np.shape(b.mean) or np.ndim(a.mean) not in (2, 3):
        raise ValueError(f"expected two images of one shape, got {np.shape(a.mean)} and {np.shape(b.mean)}")
    sides = []
    for estimate in (a, b):
        n = np.broadcast_to(estimate.n, np.shape(estimate.mean)).astype(np.float64)
        if np.any(n < 2):
            raise ValueError("a variance needs two samples or more in each pixel")
        square = np.asarray(estimate.variance) / n
        total, fourth = _tiled(square, tile), _tiled(square**2 / (n - 1.0), tile)
        with np.errstate(all="ignore"):
            sides += [total, np.where(fourth > 0.0, total**2 / fourth, np.inf)]
    pixels = _tiled(np.ones(np.shape(a.mean)), tile)
    difference = _tiled(np.asarray(a.mean) - np.asarray(b.mean), tile)
    p = _test(difference, *sides).p
    rate = np.full(np.shape(a.mean)[:2], np.nan if firefly_rate is None else firefly_rate, np.float64)
    seen = p[np.isfinite(p)]
    uniformity = float(stats.kstest(seen, "uniform").pvalue) if seen.size else np.nan
    return BiasTest(p, holm(p), difference / pixels, uniformity, _tiled(rate, tile))


def _tiled(x, tile):
    """Return sums over tiles of the first two axes."""
    rows, columns = (np.arange(0, size, tile) for size in x.shape[:2])
    return np.add.reduceat(np.add.reduceat(x, rows, 0), columns, 1)


def holm(p) -> np.ndarray:
    """Return p-values adjusted by Holm's steps, in the shape of ``p``; at most ``level`` where rejected at that level.

    They hold for any dependence between the tests (Holm, Scandinavian Journal of Statistics 6 (1979)). NaN stays NaN
    and counts as a test.
    """
    p = np.asarray(p, np.float64)
    flat = np.ravel(p)
    order = np.argsort(flat)
    steps = np.maximum.accumulate(flat[order] * np.arange(flat.size, 0, -1))
    adjusted = np.empty_like(flat)
    adjusted[order] = np.minimum(steps, 1.0)
    return adjusted.reshape(p.shape)


def sidak(p) -> np.ndarray:
    """Return p-values adjusted by Sidak's formula, 1 - (1 - p)^m for m independent tests, in the shape of ``p``."""
    p = np.asarray(p, np.float64)
    with np.errstate(divide="ignore"):
        return -np.expm1(p.size * np.log1p(-p))


def expected_fireflies(rate: float, tile: int = 32) -> float:
    """Return how many fireflies a Welch sample of a tile holds on average: rate times pixels; ask for 1 or more."""
    return float(rate) * tile * tile
