"""Rates and image errors against their definitions, and against errors of a known law."""

import numpy as np
import pytest
from scipy import special

from jaxmc.analysis import convergence
from jaxmc.testing import Exponential, Pareto


def test_exact_power_law_is_recovered():
    n = np.array([10, 100, 1000, 10_000])
    rate = convergence.fit_rate(n, 9.0 * n**-1.5)
    assert rate.slope == pytest.approx(-0.75) and rate.intercept == pytest.approx(np.log(3.0))
    assert rate.stderr < 1e-12 and rate.dof == 2


def _monte_carlo_errors(rng, counts, replicates):
    """Return the mean squared error of the mean of n exponential samples: Gamma(n) / n about 1."""
    return np.array([np.mean((rng.gamma(n, size=replicates) / n - 1.0) ** 2) for n in counts])


@pytest.mark.parametrize("replicates", [None, 16])
def test_monte_carlo_falls_with_one_half_and_the_interval_covers_it(replicates):
    rng, counts = np.random.default_rng(1), 64 * 2 ** np.arange(8)
    rates = [convergence.fit_rate(counts, _monte_carlo_errors(rng, counts, 16), replicates) for _ in range(300)]
    slopes = np.array([rate.slope for rate in rates])
    assert abs(slopes.mean() + 0.5) < 4.0 * slopes.std() / np.sqrt(300) < 0.01
    covered = np.mean([rate.interval(0.95)[0] <= -0.5 <= rate.interval(0.95)[1] for rate in rates])
    assert 0.90 < covered < 0.99
    if replicates is not None:
        assert rates[0].stderr == pytest.approx(slopes.std(), rel=0.15)
        assert abs(np.mean([rate.intercept for rate in rates]) - np.log(Exponential().variance) / 2) < 0.05


def test_stderr_with_known_replicates_is_trigamma():
    n = np.array([1.0, 2.0, 4.0, 8.0])
    spread = np.log(2.0) ** 2 * 5.0
    rate = convergence.fit_rate(n, 1.0 / n, replicates=16)
    assert special.polygamma(1, 8.0) == pytest.approx(0.133, abs=1e-3)
    assert rate.stderr == pytest.approx(0.5 * np.sqrt(special.polygamma(1, 8.0) / spread))
    assert rate.intercept == pytest.approx(0.032, abs=1e-3) and rate.dof == np.inf


def test_median_error_of_an_infinite_variance_falls_with_the_tail_exponent():
    # Means of a Pareto law with exponent 1.5 converge as n^-(1 - 1/1.5), which squares of errors cannot show.
    rng, counts, law = np.random.default_rng(2), 4 ** np.arange(2, 7), Pareto(1.5)
    median = [np.median(np.abs(law.sample(rng.random((1, 400, n))).mean(axis=1) - law.mean)) for n in counts]
    assert convergence.fit_rate(counts, np.square(median)).slope == pytest.approx(-1 / 3, abs=0.04)


@pytest.mark.parametrize(
    ("n", "mse"),
    [
        ([1, 2], [1, 1]),
        ([1, 2, 3], [1, 1]),
        ([5, 5, 5], [1, 2, 3]),
        ([1, 2, 3], [1, 0, 1]),
        ([1, 2, 3], [1, np.nan, 1]),
    ],
)
def test_fit_rejects_impossible_input(n, mse):
    with pytest.raises(ValueError, match="expected"):
        convergence.fit_rate(np.array(n), np.array(mse))


def test_fit_rejects_zero_replicates():
    with pytest.raises(ValueError, match="replicates"):
        convergence.fit_rate(np.array([1, 2, 3]), np.array([3, 2, 1]), replicates=0)


def test_image_error_takes_off_the_noise_of_the_reference():
    rng = np.random.default_rng(3)
    truth = rng.random((200, 200))
    deviation = 0.1 + 0.2 * truth
    image, reference = truth + 0.3, truth + deviation * rng.standard_normal(truth.shape)
    assert convergence.image_error(image, truth) == pytest.approx(0.09)
    assert convergence.image_error(image, reference, deviation**2) == pytest.approx(0.09, abs=0.005)
    assert convergence.image_error(image, reference) > 0.12


def test_relative_mse_pins_its_epsilon():
    image, reference = np.array([1.0, 0.0]), np.array([0.0, 2.0])
    assert convergence.relative_mse(image, reference) == pytest.approx((1.0 / 0.01 + 4.0 / 4.01) / 2.0)
    assert convergence.relative_mse(reference, reference) == 0.0


def test_images_of_other_shapes_are_rejected():
    for metric in (convergence.image_error, convergence.relative_mse):
        with pytest.raises(ValueError, match="one shape"):
            metric(np.zeros((4, 3)), np.zeros(3))
