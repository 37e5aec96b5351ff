"""How far an image is from the truth, and what an estimator costs: metrics with their conventions pinned.

Every mean runs over pixels and channels. Values compare only at equal ``eps``, ``trim`` and convention.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from ..integration.intervals import Ends

EPS = 0.01


def mse(image, reference, trim: float = 0.0) -> float:
    """Return the mean of (image - reference)^2, without the worst ``trim`` of the pixels."""
    x, r = _pair(image, reference)
    return _trimmed_mean((x - r) ** 2, trim)


def relative_mse(image, reference, eps: float = EPS, trim: float = 0.0, convention: str = "square") -> float:
    """Return relMSE: the mean of a squared error over the squared reference.

    Args:
        image, reference: of one shape.
        eps: keeps black pixels from ruling the mean.
        trim: share of the pixels, those with the largest error, that is left out: 0.001 is usual where fireflies are
            to be left out of the verdict. Left-out energy is not counted: state it.
        convention: "square", (x - r)^2 / (r^2 + eps), eps in units of radiance squared; or "pbrt",
            (x - r)^2 / (r + eps)^2, eps in units of radiance, which leaves infinite errors out as pbrt does.

    Raises:
        ValueError: images of different shapes, a trim outside of [0, 1), or an unknown convention.
    """
    x, r = _pair(image, reference)
    if convention == "square":
        return _trimmed_mean((x - r) ** 2 / (r**2 + eps), trim)
    if convention != "pbrt":
        raise ValueError(f'convention must be "square" or "pbrt", got {convention!r}')
    error = (x - r) ** 2 / (r + eps) ** 2
    return _trimmed_mean(error[~np.isinf(error)], trim)


def smape(image, reference, eps: float = EPS, trim: float = 0.0) -> float:
    """Return the symmetric mean absolute percentage error: the mean of |x - r| / (|x| + |r| + eps), from 0 to 1."""
    x, r = _pair(image, reference)
    return _trimmed_mean(np.abs(x - r) / (np.abs(x) + np.abs(r) + eps), trim)


class Bias2(NamedTuple):
    """Mean squared bias of an image's pixels, unbiased, so it may be negative; ``stderr`` from the spread of pixels."""

    value: float
    stderr: float


def image_bias2(first, second, reference, reference_variance=0.0) -> Bias2:
    """Return the mean over pixels of bias^2, from two independent halves of the samples: the mean of
    (first - r)(second - r), whose noise is independent and so averages out.

    ``reference_variance``: of the reference itself, a number or one for each pixel; it would count as bias, and is
    taken off. The standard error takes pixels as independent; channels are not, so pass luminance.
    """
    a, r = _pair(first, reference)
    b, _ = _pair(second, reference)
    product = (a - r) * (b - r) - reference_variance
    return Bias2(float(product.mean()), float(product.std(ddof=1) / np.sqrt(product.size)))


def efficiency(variance: float, seconds: float) -> float:
    """Return 1 / (variance x time): how much precision a second buys. Its inverse is the time to unit variance."""
    return 1.0 / (variance * seconds)


class EfficiencyRatio(NamedTuple):
    """Efficiency of a method over that of another, with an interval; ``log_stderr`` is the error of its logarithm."""

    ratio: float
    interval: Ends
    log_stderr: float


def paired_efficiency_ratio(variance, seconds, other_variance, other_seconds, level: float = 0.95) -> EfficiencyRatio:
    """Return the ratio of efficiencies of two methods from R paired replicates: Student's t on the logarithms.

    Each argument but the last has shape (R,): variance and time of a method and of the other one in the same round. The
    ratio is above 1 where the first method is better.

    Raises:
        ValueError: fewer than two rounds, different shapes, or numbers that are not positive.
    """
    values = [np.asarray(x, np.float64) for x in (variance, seconds, other_variance, other_seconds)]
    if len({x.shape for x in values}) > 1 or values[0].ndim != 1 or len(values[0]) < 2:
        raise ValueError(f"expected four arrays of one shape (R,), R >= 2, got shapes {[x.shape for x in values]}")
    if not all(np.all(np.isfinite(x) & (x > 0.0)) for x in values):
        raise ValueError("expected positive finite variances and times: a variance of 0 has no efficiency")
    v, t, w, s = map(np.log, values)
    log_ratio = (w + s) - (v + t)
    stderr = float(log_ratio.std(ddof=1) / np.sqrt(len(log_ratio)))
    return _ratio(log_ratio.mean(), stderr, stats.t.ppf(0.5 + 0.5 * level, len(log_ratio) - 1))


def efficiency_ratio(moments, seconds, other_moments, other_seconds, level: float = 0.95) -> EfficiencyRatio:
    """Return the ratio of efficiencies of two methods from one run of each, by the delta method.

    The logarithm of a sample variance has the variance (kurtosis - (n - 3) / (n - 1)) / n, to first order. ``moments``
    are sample moments to order 4 of one number, ``estimate.moments[0]``; seconds are taken as exact, for n samples.
    Fails where fourth moments are infinite, khat >= 1/4: use paired replicates there.
    """
    logs, square = [], 0.0
    for m, t in ((moments, seconds), (other_moments, other_seconds)):
        n = float(m.n)
        logs.append(np.log(float(m.variance)) + np.log(t / n))
        square += (float(m.kurtosis) - (n - 3.0) / (n - 1.0)) / n
    return _ratio(logs[1] - logs[0], float(np.sqrt(square)), stats.norm.ppf(0.5 + 0.5 * level))


def _ratio(log_ratio, stderr, quantile):
    half = quantile * stderr
    ends = Ends(float(np.exp(log_ratio - half)), float(np.exp(log_ratio + half)))
    return EfficiencyRatio(float(np.exp(log_ratio)), ends, stderr)


def _trimmed_mean(error, trim):
    if not 0.0 <= trim < 1.0:
        raise ValueError(f"trim is the share of pixels left out, in [0, 1), got {trim}")
    flat = np.ravel(error)
    kept = flat.size - int(trim * flat.size)
    return float(np.mean(np.partition(flat, kept - 1)[:kept] if kept < flat.size else flat))


def _pair(image, reference):
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if image.shape != reference.shape:
        raise ValueError(f"expected image and reference of one shape, got {image.shape} and {reference.shape}")
    return image, reference
