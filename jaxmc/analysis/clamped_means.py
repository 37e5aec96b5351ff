"""Means and images of clamped samples: thresholds that the data chooses, energy handed back, bands without a law.

See ``clamping`` for the cost of a threshold. A threshold that comes from the samples it clamps makes a second bias, as
it is low where no bright sample came. So half of the samples choose the threshold for the other half.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from ..integration.tallies import ClampSums
from .clamping import Band, ClampCurve, ImageClampCurve, clamp_curve, image_curve, image_optimum, optimal_threshold


class CrossFit(NamedTuple):
    """A clamped mean whose thresholds come from other samples than they clamp.

    ``mean`` is over both halves. ``thresholds`` are those for the first and for the second half, ``exceedances`` how
    many samples of the half that chose lie at or above. ``reliable`` is False where either choice is not to be trusted:
    clamp at a threshold from more samples then, or not at all.
    """

    mean: float
    thresholds: tuple[float, float]
    exceedances: tuple[float, float]
    reliable: bool


def cross_fitted_mean(first, second, N: int | None = None) -> CrossFit:
    """Return the mean of clamped samples, each half clamped at the best threshold of the other.

    ``first`` and ``second``: histograms of independent samples, with edges as in ``clamping``. Each half is clamped at
    an edge, the one nearest to the best threshold for means of ``N`` samples, by default all there are: the error is
    flat around the best. Given the thresholds, the mean is an unbiased estimate of E min(c, t). Raises ValueError on
    histograms that cannot be clamped.
    """
    N = first.n + second.n if N is None else N
    best = [optimal_threshold(clamp_curve(half), N) for half in (second, first)]
    edges = [_nearest(half.edges, b.threshold) for half, b in zip((first, second), best)]
    sums = [_clamped_sum(half, edge) for half, edge in zip((first, second), edges)]
    return CrossFit(
        mean=sum(sums) / (first.n + second.n),
        thresholds=(float(first.edges[edges[0]]), float(second.edges[edges[1]])),
        exceedances=(best[0].exceedances, best[1].exceedances),
        reliable=best[0].reliable and best[1].reliable,
    )


def _nearest(edges, t):
    """Return the number of the positive edge whose ratio to ``t`` is nearest to 1."""
    with np.errstate(divide="ignore"):
        return 1 + int(np.argmin(np.abs(np.log(np.asarray(edges)[1:]) - np.log(t))))


def _clamped_sum(histogram, j):
    """Return the sum of min(c, edges[j])."""
    return float(np.sum(histogram.total[:j]) + histogram.edges[j] * np.sum(histogram.count[j:]))


def ladder_curve(sums: ClampSums) -> ImageClampCurve:
    """Return the clamp curve of an image from the sums of a ``ClampLadder``: see ``clamping.image_curve``."""
    mean = sums.clamped[0] + sums.excess[0]
    return image_curve(
        mean, sums.clamped, sums.clamped_square, sums.excess, sums.excess_square, sums.thresholds, sums.n
    )


class CrossFitImage(NamedTuple):
    """An image, shape (items...), clamped at ``thresholds``, each half of the samples at that of the other."""

    mean: np.ndarray
    thresholds: tuple[float, float]
    reliable: bool


def cross_fitted_image(first: ClampSums, second: ClampSums, N: int | None = None) -> CrossFitImage:
    """Return the image clamped at one threshold for all pixels, each half of the samples at the best of the other.

    ``first`` and ``second`` come from independent renderings with the same ``ClampLadder``; of its thresholds the one
    nearest to the best for ``N`` samples per pixel is taken, by default for all there are. Not ``reliable`` where the
    best lies at an end of the ladder. Raises ValueError on other thresholds or shapes.
    """
    if not np.array_equal(first.thresholds, second.thresholds) or first.clamped.shape != second.clamped.shape:
        raise ValueError("both halves must have the same thresholds and pixels: render them with one ClampLadder")
    N = first.n + second.n if N is None else N
    best = [image_optimum(ladder_curve(half), N) for half in (second, first)]
    steps = [int(np.argmin(np.abs(np.log(first.thresholds / b.threshold)))) for b in best]
    means = [half.clamped[step] for half, step in zip((first, second), steps)]
    return CrossFitImage(
        mean=(first.n * means[0] + second.n * means[1]) / (first.n + second.n),
        thresholds=(float(first.thresholds[steps[0]]), float(first.thresholds[steps[1]])),
        reliable=best[0].reliable and best[1].reliable,
    )


def pool_residual(sums: ClampSums, threshold: float, *, width: int, tile: int = 8) -> np.ndarray:
    """Return the clamped image with what clamping took away handed back evenly to squares of pixels: (height, width).

    A pixel is the mean of min(c, t) plus the mean of max(c - t, 0) over its tile. So every tile keeps its energy, and
    the sum over a tile is unbiased; within it light is blurred, and a pixel is biased by how far its own share of the
    excess is from that of its tile. Tiles at the right and lower border may be smaller.

    Source: the idea of spreading, not removing, is that of Rushmeier & Ward, "Energy preserving non-linear filters"
    (SIGGRAPH 1994). Raises ValueError for a threshold that is not one of the ladder's, a width that does not divide the
    image, or a tile below 1.
    """
    steps = np.flatnonzero(np.isclose(sums.thresholds, threshold, rtol=1e-6, atol=0.0))
    if len(steps) != 1:
        raise ValueError(f"threshold must be one of the ladder's, {sums.thresholds.tolist()}, got {threshold}")
    pixels = sums.clamped[0].size
    if width < 1 or pixels % width:
        raise ValueError(f"width must divide the number of pixels, {pixels}, got {width}")
    if tile < 1:
        raise ValueError(f"expected a tile of at least 1 pixel, got {tile}")
    clamped, excess = (x[steps[0]].reshape(-1, width) for x in (sums.clamped, sums.excess))
    starts = [np.arange(0, size, tile) for size in excess.shape]
    total = np.add.reduceat(np.add.reduceat(excess, starts[0], 0), starts[1], 1)
    sizes = [np.diff(np.append(start, size)) for start, size in zip(starts, excess.shape)]
    mean = total / np.multiply.outer(*sizes)
    return clamped + mean[np.arange(excess.shape[0])[:, None] // tile, np.arange(width) // tile]


def bounded_band(curve: ClampCurve, bound: float, level: float = 0.95) -> Band:
    """Return a simultaneous band for the bias of samples that are at most ``bound``, whatever their law and number.

    With B(t) the integral of P(c > x) from t to the bound, an empirical law that is nowhere off by more than
    e = sqrt(ln(2 / (1 - level)) / (2 n)) gives B within e (bound - t). The bound must be known, as from the brightest
    light and the least probable path; from samples it cannot be. ``quantile`` is e.

    Source: Massart, "The tight constant in the Dvoretzky-Kiefer-Wolfowitz inequality", Annals of Probability 18 (1990);
    Anderson, "Confidence limits for the expected value of an arbitrary bounded random variable" (1969).
    Raises ValueError unless 0 < level < 1, or if a sample was above the bound.
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"expected a level between 0 and 1, got {level}: write 0.95 for 95 %")
    above = (curve.threshold >= bound) & (curve.bias > 0.0)
    if above.any():
        raise ValueError(f"samples above {curve.threshold[above][-1]:g} were seen, so {bound:g} is no bound")
    off = float(np.sqrt(np.log(2.0 / (1.0 - level)) / (2.0 * curve.n)))
    half = off * np.maximum(bound - curve.threshold, 0.0)
    note = f"holds for any law up to {bound:g}"
    return Band(np.maximum(curve.bias - half, 0.0), curve.bias + half, off, True, note)


def replicate_band(histograms, level: float = 0.95) -> tuple[np.ndarray, Band]:
    """Return thresholds and a band for the bias at each, from histograms of independent replicates of the same size.

    Student's t over the replicates, at each threshold by itself and not for the curve at once. This is the band for
    points that are not independent, such as randomised Sobol points: the spread within a replicate says nothing about
    its error there. Take 10 replicates or more. Raises ValueError for fewer than 2, or unless 0 < level < 1.
    """
    if len(histograms) < 2:
        raise ValueError(f"expected at least 2 replicates, got {len(histograms)}")
    if not 0.0 < level < 1.0:
        raise ValueError(f"expected a level between 0 and 1, got {level}: write 0.95 for 95 %")
    curves = [clamp_curve(h) for h in histograms]
    t = np.asarray(histograms[0].edges, np.float64)
    t = t[(t >= min(c.threshold[0] for c in curves)) & (t <= max(c.threshold[-1] for c in curves))]
    # Below the smallest sample of a replicate nothing is left of it but its mean.
    bias = np.array(
        [np.where(t < c.threshold[0], c.unclamped_mean - t, np.interp(t, c.threshold, c.bias)) for c in curves]
    )
    quantile = float(stats.t.ppf(0.5 + 0.5 * level, len(curves) - 1))
    half = quantile * bias.std(0, ddof=1) / np.sqrt(len(curves))
    mean = bias.mean(0)
    note = f"Student's t over {len(curves)} replicates, at each threshold by itself"
    return t, Band(np.maximum(mean - half, 0.0), mean + half, quantile, True, note)
