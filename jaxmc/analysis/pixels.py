"""Tail statistics as images: of every pixel, and of tiles of pixels, from what the tally ``PixelTails`` keeps."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from ..integration.pixel_tails import TailSums
from .tails import LEAST_EXCEEDANCES, RELIABLE_KHAT, ROUNDING, TailFit, effective_sample_size, pareto_khat

MAD_LIMIT = 6.0


class TailImages(NamedTuple):
    """Tail statistics of the pixels of an image, arrays of shape (height, width), or (T, height, width) with a leading
    axis for the thresholds. NaN where a pixel does not tell.

    Attributes:
        thresholds: shape (T,).
        mean, relative_variance, skewness, kurtosis: of one sample; relative variance is variance / mean^2.
        effective_n: (sum c)^2 / sum c^2.
        maximum: largest sample; ``max_share`` and ``max_square_share`` are its shares in the sums of c and of c^2.
        khat, khat_status: Pareto k-hat of the largest samples kept, and "reliable", "unreliable", "no mean", "atomic"
            or "too few samples". Few are kept of each pixel: its error is about (1 + khat) / sqrt(7); tiles know more.
        rate: of samples at or above each threshold (F1), and ``energy`` their share in the sum of c.
        hill: Hill's estimate of 1 / alpha of the tail above each threshold.
        wait: samples until the first at or above each threshold, 1 / rate; infinite where there was none.
    """

    thresholds: np.ndarray
    mean: np.ndarray
    relative_variance: np.ndarray
    skewness: np.ndarray
    kurtosis: np.ndarray
    effective_n: np.ndarray
    maximum: np.ndarray
    max_share: np.ndarray
    max_square_share: np.ndarray
    khat: np.ndarray
    khat_status: np.ndarray
    rate: np.ndarray
    energy: np.ndarray
    hill: np.ndarray
    wait: np.ndarray


def tail_images(sums: TailSums, width: int, height: int) -> TailImages:
    """Return the tail statistics of every pixel as images.

    Raises:
        ValueError: another number of pixels than ``sums`` holds.
    """
    if sums.n.shape != (width * height,):
        raise ValueError(f"expected {width} x {height} = {width * height} pixels, got sums of shape {sums.n.shape}")
    m = sums.moments
    total, square = m.n * m.mean, m.n * (m.central[0] + m.mean**2)
    largest = sums.largest[:, 0]
    khat, status = khat_rows(sums.largest, m.n)
    with np.errstate(all="ignore"):
        values = {
            "mean": m.mean,
            "relative_variance": m.variance / m.mean**2,
            "skewness": m.skewness,
            "kurtosis": m.kurtosis,
            "effective_n": effective_sample_size(m.n, total, square),
            "maximum": largest,
            "max_share": np.where(total > 0.0, largest / total, np.nan),
            "max_square_share": np.where(square > 0.0, largest**2 / square, np.nan),
            "khat": khat,
            "khat_status": status,
            "rate": sums.count / m.n,
            "energy": np.where(total > 0.0, sums.total / total, np.nan),
            "hill": np.where(sums.count > 0, sums.log_total / sums.count - np.log(sums.thresholds)[:, None], np.nan),
            "wait": np.where(sums.count > 0, m.n / sums.count, np.inf),
        }
    return TailImages(sums.thresholds, **{k: v.reshape(*v.shape[:-1], height, width) for k, v in values.items()})


def khat_rows(largest: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Pareto k-hat and its status for each row of ``largest``: as ``pareto_khat`` does, for all rows at once.

    ``largest``: the K largest of ``n`` samples (I,), falling along the last axis, shape (I, K).
    """
    n = np.broadcast_to(n, len(largest)).astype(np.int64)
    khat, status = np.full(len(n), np.nan), np.full(len(n), "too few samples", object)
    recommended = np.where(n > 225, (3.0 * np.sqrt(n)).astype(int), n // 5)
    kept = np.minimum(recommended, np.minimum(np.isfinite(largest).sum(1), largest.shape[1]) - 1)
    for count in np.unique(kept[kept >= 1]):
        rows = np.flatnonzero((kept == count) & np.isfinite(largest[:, 0]))
        khat[rows], status[rows] = _fit_rows(largest[rows], int(count), n[rows])
    return khat, status


def _fit_rows(top, count, n):
    """Fit rows that all have ``count`` samples above the threshold; the formulas are those of ``pareto_khat``."""
    threshold = top[:, count]
    tail = top[:, :count][:, ::-1] - threshold[:, None]
    size = (tail > 0.0).sum(1)
    row = np.arange(len(top))
    least = tail[row, np.minimum(count - size, count - 1)]
    at_quarter = tail[row, np.clip(count - size + (size / 4 + 0.5).astype(int) - 1, 0, count - 1)]
    repeated = top[:, 0] == top[:, 1]
    if top.shape[1] > 2:
        repeated |= top[:, 0] - top[:, 2] <= ROUNDING * (top[:, 0] - threshold)
    atomic = repeated | ((size >= LEAST_EXCEEDANCES) & ((size / 4 + 0.5).astype(int) - 1 > 0) & (at_quarter == least))
    fitted = ~atomic & (size >= LEAST_EXCEEDANCES)
    khat = np.full(len(top), np.nan)
    for m in np.unique(size[fitted]):
        chosen = fitted & (size == m)
        khat[chosen] = _shapes(tail[chosen, count - m :])
    with np.errstate(divide="ignore"):
        reliable_below = np.where(n > 1, np.minimum(1.0 - 1.0 / np.log10(np.maximum(n, 2)), RELIABLE_KHAT), -np.inf)
    status = np.where(khat >= 1.0, "no mean", np.where(khat < reliable_below, "reliable", "unreliable")).astype(object)
    status[~fitted] = "too few samples"
    status[atomic] = "atomic"
    return khat, status


def _shapes(tail):
    """Return Zhang and Stephens' shape of each row of increasing positive exceedances (I, M)."""
    count = tail.shape[1]
    x = tail / tail[:, -1:]
    grid = 30 + int(np.sqrt(count))
    quartile = x[:, max(int(count / 4 + 0.5) - 1, 0), None]
    theta = 1.0 + (1.0 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))) / (3.0 * quartile)
    theta[theta == 0.0] = 1e-12
    shape = np.stack([np.log1p(-theta[:, j, None] * x).mean(1) for j in range(grid)], 1)
    log_likelihood = count * (np.log(-theta / shape) - shape - 1.0)
    weight = np.exp(log_likelihood - log_likelihood.max(1, keepdims=True))
    best = (weight * theta).sum(1) / weight.sum(1)
    best = np.where(best == 0.0, 1e-12, best)
    return (count * np.log1p(-best[:, None] * x).mean(1) + 5.0) / (count + 10.0)


def khat_tiles(sums: TailSums, width: int, height: int, tile: int = 16) -> list[list[TailFit]]:
    """Return the tail fit of each tile of ``tile`` x ``tile`` pixels, rows of tiles from the top left.

    The samples of a tile are pooled, so a fit tells about the law of a sample in a random pixel of it. The largest of
    the tile are among the largest of its pixels. Where a pixel may have had more of them than it kept, the status of
    the fit is "truncated" and khat NaN: keep more with ``PixelTails(largest=...)``.
    """
    largest = sums.largest.reshape(height, width, -1)
    n = sums.n.reshape(height, width)
    return [
        [_tile_fit(largest[y : y + tile, x : x + tile], n[y : y + tile, x : x + tile]) for x in range(0, width, tile)]
        for y in range(0, height, tile)
    ]


def _tile_fit(largest, n):
    n = int(n.sum())
    kept = np.sort(largest[np.isfinite(largest)])[::-1]
    wanted = min(int(3.0 * np.sqrt(n)) if n > 225 else n // 5, len(kept) - 1)
    fit = pareto_khat(kept[: wanted + 1], n)
    if fit.status != "atomic" and np.any(largest[..., -1] > fit.threshold):
        return fit._replace(khat=np.nan, stderr=np.nan, scale=np.nan, min_n=np.nan, status="truncated")
    return fit


def leverage(sums: TailSums, N: int, eta: float, reference: np.ndarray) -> np.ndarray:
    """Return how many of ``N`` samples of each pixel move it by more than ``eta`` of its value, on average, shape (I,).

    That is N P(c > eta N mean) (F2), from the largest samples kept: NaN where all of those are beyond.
    ``reference``: the means (I,), such as those of another render.
    """
    above = (sums.largest > (eta * N * np.asarray(reference, np.float64))[:, None]).sum(1)
    return np.where(above < sums.largest.shape[1], N * above / sums.n, np.nan)


def outlying_pixels(image: np.ndarray, limit: float = MAD_LIMIT) -> np.ndarray:
    """Return which pixels stand out of their 3 x 3 neighbourhood, booleans of shape (height, width) (F3).

    A pixel does where it is off the median of its neighbourhood by more than ``limit`` times the median absolute
    deviation, which is the median of that difference's size over the whole image. ``image``: luminance.

    Raises:
        ValueError: an image that is not of shape (height, width), or a limit that is not positive.
    """
    image = np.asarray(image, np.float64)
    if image.ndim != 2 or not limit > 0.0:
        raise ValueError(f"expected a luminance image (height, width) and limit > 0, got {image.shape} and {limit}")
    off = np.abs(image - median_filter(image, 3, mode="nearest"))
    return off > limit * np.median(off)
