"""Precision: float32 against float64, long sums, and estimates put together from parts."""

import copy
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc.integration import driver, kernel
from jaxmc.integration.run import Run
from jaxmc.testing import SIGMAS

DEFAULTS = (*analytic_scenes.ALL, *analytic_scenes.integrands.default_integrands(8))
N = 1 << 18


@pytest.mark.slow
@pytest.mark.parametrize("scene", DEFAULTS, ids=lambda scene: scene.name)
def test_float32_and_float64_agree(scene):
    narrow = mc.integrate(scene.integrand, n=N, key=5)
    with jax.enable_x64(True):
        wide = mc.integrate(scene.integrand, n=N, key=6)
    error = np.hypot(narrow.stderr, wide.stderr)
    assert error <= 2e-2 * abs(scene.exact)
    assert abs(narrow.mean - wide.mean) <= SIGMAS * error + 3e-6 * abs(scene.exact)


@pytest.mark.slow
@pytest.mark.parametrize("scene", DEFAULTS, ids=lambda scene: scene.name)
def test_the_same_points_give_the_same_mean_to_rounding(scene):
    # Coordinates agree in 32 bits, so only samples next to an edge may fall on its other side.
    narrow = mc.integrate(scene.integrand, n=N, key=5)
    with jax.enable_x64(True):
        wide = mc.integrate(scene.integrand, n=N, key=5)
    assert abs(narrow.mean - wide.mean) <= 0.05 * wide.stderr + 3e-6 * abs(scene.exact)


@pytest.mark.slow
def test_the_mean_of_2_to_the_33_equal_numbers():
    estimate = mc.integrate(mc.Integrand(lambda u: jnp.float32(0.1), 1, lazy=True), n=1 << 33)
    assert estimate.n == 1 << 33 and estimate.mean == pytest.approx(0.1, rel=1e-7)
    assert estimate.mean == pytest.approx(float(np.float32(0.1)), rel=1e-15) and estimate.variance <= 1e-20


def merged(f, cuts):
    """Return the moments of the samples between cuts, each part run by itself and all merged."""
    tally, states = mc.Moments(), []
    for start, stop in itertools.pairwise(cuts):
        run = Run(f, 0, mc.Independent(), None, None, None, 2)
        run.sums.drawn = start
        run.stream(stop, driver.Progress(None, None))
        states.append(run.sums.states["moments"])
    total = copy.deepcopy(states[0])
    for state in states[1:]:
        total = tally.merge(total, state)
    return tally.result(total)[0]


UNEVEN = [0, 1, 1000, 70_000, 70_001, 200_000, 499_999, 500_000]
WHOLE_BLOCKS = [k * kernel.BLOCK for k in (0, 1, 3, 4, 9, 10, 12)] + [13 * kernel.BLOCK + 17]


# Where blocks are cut otherwise, the sums within them differ by the rounding of float32.
@pytest.mark.parametrize(
    ("cuts", "mean", "variance"), [(UNEVEN, 1e-8, 1e-6), (WHOLE_BLOCKS, 1e-12, 1e-12)], ids=["uneven", "whole blocks"]
)
def test_seven_parts_are_the_whole(cuts, mean, variance):
    if jax.config.jax_enable_x64:
        mean, variance = min(mean, 1e-12), min(variance, 1e-10)
    f = mc.Integrand(lambda u: u[0] / jnp.sqrt(u[1]), 2)
    parts, whole = merged(f, cuts), mc.integrate(f, n=cuts[-1]).moments[0]
    assert parts.n == whole.n and parts.mean == pytest.approx(whole.mean, rel=mean)
    assert parts.variance == pytest.approx(whole.variance, rel=variance)
