"""Bias, variance and squared error of an image, unbiased, from independent images and a reference as noisy as they are.

All are means over pixels. With R independent pairs of an image x_r and a reference that does not share samples with the
other pairs, d_r the difference of a pair: bias^2 is the mean of d_r d_s over r != s, since the noise of one pair knows
nothing of that of another, and the variance is that between the x_r. Errors are those of the jackknife, which leaves
out one pair at a time (Efron & Stein, Annals of Statistics 9 (1981)); so they count what pixels share, and the noise of
the reference.
"""

from typing import NamedTuple

import numpy as np

LEAST = 4  # pairs, for an error bar


class Measured(NamedTuple):
    """An image of ``N`` samples for each pixel, beside the truth; means over pixels, each with its standard error.

    ``bias``: mean of what the image has more than the truth, negative where energy is lost. ``squared_bias``: of each
    pixel. ``variance`` of a pixel, ``mse`` the sum of the last two.
    """

    N: int
    bias: float
    bias_stderr: float
    squared_bias: float
    squared_bias_stderr: float
    variance: float
    variance_stderr: float
    mse: float
    mse_stderr: float


def from_images(images, references, N: int) -> Measured:
    """Return what R independent images of ``N`` samples show, with a reference for each: arrays of shape (R, pixels).

    Raises ValueError on fewer than 4 pairs, or other shapes.
    """
    x, r = _pairs(images, references)
    spread = _gram(x)

    def variance(kept):
        some = spread[np.ix_(kept, kept)]
        return (np.trace(some) - some.sum() / len(kept)) / (len(kept) - 1.0)

    return _measured(x - r, variance, N)


def from_averages(images, references, variances, counts) -> dict[int, Measured]:
    """Return what means of independent samples are for each number N of them: bias^2 + variance / N.

    ``images`` and ``references``: shape (R, pixels), means of any number of samples; ``variances``: of one sample, mean
    over pixels, shape (R,). Raises ValueError as ``from_images``.
    """
    x, r = _pairs(images, references)
    variances = np.asarray(variances, np.float64)
    return {N: _measured(x - r, lambda kept, N=N: variances[kept].mean() / N, N) for N in counts}


class Best(NamedTuple):
    """The best clamp for an image of some number of samples: ``threshold``, ``mse``, ``mse_stderr``; ``inside`` the
    thresholds that were tried, not at their end.
    """

    threshold: float
    mse: float
    mse_stderr: float
    inside: bool


def best_clamp(thresholds, excess, variances, N: int) -> Best:
    """Return the threshold with the least squared error for ``N`` samples in each pixel, one for the whole image.

    Args:
        excess: mean of max(c - t, 0) in each of R independent parts, shape (R, thresholds, pixels).
        variances: of one clamped sample, mean over pixels, shape (R, thresholds).
    """
    products = np.einsum("atp,btp->tab", excess, excess, optimize=True).astype(np.float64) / excess.shape[-1]

    def errors(kept):
        some = products[:, kept][:, :, kept]
        return _squared(some) + np.asarray(variances)[kept].mean(0) / N

    whole = np.arange(len(excess))
    found = errors(whole)
    k = int(np.argmin(found))
    left = [errors(np.delete(whole, r))[k] for r in whole]
    return Best(float(thresholds[k]), float(found[k]), _jackknife(left), 0 < k < len(found) - 1)


def _pairs(images, references):
    x, r = np.asarray(images, np.float64), np.asarray(references, np.float64)
    if x.ndim != 2 or x.shape != r.shape or len(x) < LEAST:
        raise ValueError(f"expected {LEAST} or more images and references, (R, pixels), got {x.shape} and {r.shape}")
    return x, r


def _measured(difference, variance, N):
    products, shift = _gram(difference), difference.mean(1)

    def at(kept):
        squared, spread = _squared(products[np.ix_(kept, kept)]), variance(kept)
        return [shift[kept].mean(), squared, spread, squared + spread]

    whole = np.arange(len(difference))
    left = np.array([at(np.delete(whole, r)) for r in whole])
    values = [float(v) for pair in zip(at(whole), map(_jackknife, left.T)) for v in pair]
    return Measured(N, *values)


def _gram(x):
    """Return the means over pixels of all products of two images."""
    return x @ x.T / x.shape[1]


def _squared(products):
    """Return the mean of products of different pairs, on the last two axes."""
    n = products.shape[-1]
    return (products.sum((-2, -1)) - np.trace(products, axis1=-2, axis2=-1)) / (n * (n - 1.0))


def _jackknife(left):
    """Return the standard error of a statistic from its values without each of the parts."""
    left = np.asarray(left)
    return float(np.sqrt((len(left) - 1.0) / len(left) * np.sum((left - left.mean()) ** 2)))
