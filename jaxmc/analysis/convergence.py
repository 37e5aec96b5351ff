"""How fast an error falls with the number of samples, and how large it is against a reference."""

from typing import NamedTuple

import numpy as np
from scipy import special, stats

from .metrics import relative_mse as relative_mse


class Rate(NamedTuple):
    """A line through log RMSE against log n: ``log RMSE = intercept + slope log n``.

    Plain Monte Carlo with a finite variance has slope -1/2. ``dof`` are the degrees of freedom behind ``stderr``.
    """

    slope: float
    stderr: float
    intercept: float
    dof: float

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the two-sided Student-t interval of the slope."""
        half = stats.t.ppf(0.5 + 0.5 * level, self.dof) * self.stderr
        return self.slope - half, self.slope + half


def fit_rate(n: np.ndarray, mse: np.ndarray, replicates: int | None = None) -> Rate:
    """Fit the slope of log RMSE against log n by least squares.

    ``n`` and ``mse``: shape (L,), L >= 3, one mean squared error per sample count, each from its own independent runs:
    errors of one growing run are correlated, and the standard error would be too small. ``replicates``: how many
    independent normal errors every ``mse`` averages; then ``replicates * mse`` follows a chi-square law, whose variance
    in the log is trigamma(replicates / 2) and whose offset is taken off the intercept. Without it the standard error
    comes from the residuals, with L - 2 degrees of freedom.

    Where the variance is infinite the slope of the RMSE means nothing: fit squared medians of the absolute error.
    Raises ValueError on other shapes, on fewer than 3 sample counts, or where an entry is not positive and finite.
    """
    n, mse = np.asarray(n, dtype=np.float64), np.asarray(mse, dtype=np.float64)
    if n.ndim != 1 or n.shape != mse.shape or np.unique(n).size < 3:
        raise ValueError(f"expected one mse for each of 3 or more sample counts, got shapes {n.shape} and {mse.shape}")
    if not np.all(np.isfinite(mse) & (mse > 0.0) & np.isfinite(n) & (n > 0.0)):
        raise ValueError("expected positive finite n and mse: leave out counts whose error drowns in the reference's")
    x, y = np.log(n), 0.5 * np.log(mse)
    spread = np.sum((x - x.mean()) ** 2)
    slope = np.dot(x - x.mean(), y) / spread
    intercept = y.mean() - slope * x.mean()
    if replicates is None:
        residual = y - intercept - slope * x
        dof = n.size - 2
        return Rate(float(slope), float(np.sqrt(np.sum(residual**2) / dof / spread)), float(intercept), dof)
    if replicates < 1:
        raise ValueError(f"expected replicates >= 1, got {replicates}: leave it out where it is not known")
    half = 0.5 * replicates
    stderr = 0.5 * np.sqrt(special.polygamma(1, half) / spread)
    offset = 0.5 * (special.digamma(half) - np.log(half))
    return Rate(float(slope), float(stderr), float(intercept - offset), np.inf)


def image_error(image: np.ndarray, reference: np.ndarray, reference_variance: np.ndarray | float = 0.0) -> float:
    """Return the mean squared error of ``image`` against the truth behind a noisy ``reference``.

    ``reference_variance``: variance of the reference itself (squared standard error), one number or one per entry; its
    mean is taken off, so the result is unbiased and may fall below 0. Raises ValueError if the shapes differ.
    """
    return float(np.mean(_difference(image, reference) ** 2) - np.mean(reference_variance))


def _difference(image, reference):
    image, reference = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if image.shape != reference.shape:
        raise ValueError(f"expected image and reference of one shape, got {image.shape} and {reference.shape}")
    return image - reference
