"""Sums over levels that are cut off at random, and integrands that change with the number of the sample."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration import debias as module
from jaxmc.integration.debias import debiased_variance
from jaxmc.testing import Mix, assert_unbiased

LAW = Mix(0.05, 20.0)
PROBABILITIES = (0.3, 0.2, 0.5)


def ladder(law=LAW, thresholds=(2.0, 8.0)):
    return mc.Integrand(law.sample, 1, lazy=True).map(mc.ClampLevels(thresholds))


def exact_variance(law, thresholds, probabilities):
    """Return the variance of the sum over levels of a ``Mix``, from E max(c - t, 0)^2 = p (A - t)^2 for t >= 1."""
    reached = np.cumsum(probabilities[::-1])[::-1]
    rest = [law.variance + law.mean**2, *(law.p * (law.A - t) ** 2 for t in thresholds), 0.0]
    return -np.sum(np.diff(rest) / reached) - law.mean**2


@pytest.mark.parametrize("probabilities", [None, PROBABILITIES])
def test_the_sum_is_unbiased_and_has_the_predicted_variance(probabilities):
    p = probabilities or (0.5, 0.25, 0.25)
    variance = exact_variance(LAW, (2.0, 8.0), p)
    found = mc.integrate(mc.debias(ladder(), probabilities=probabilities), n=1 << 22, key=1)
    assert_unbiased(found, LAW.mean, rel_precision=3e-3, variance=variance)
    assert math.isclose(found.variance, variance, rel_tol=0.02)
    values = mc.draw(ladder(), n=1 << 18).value
    assert math.isclose(debiased_variance(values, np.cumsum(p[::-1])[::-1]), variance, rel_tol=0.03)
    # Given the point, the mean of the sum is the last level: its variance cannot be less.
    assert variance > LAW.variance


@pytest.mark.slow
def test_rare_and_bright_at_a_standard_error_of_a_thousandth():
    law, p = Mix(1e-3, 500.0), (0.1, 0.2, 0.7)
    variance = exact_variance(law, (3.0, 30.0), p)
    n = math.ceil(variance / 1e-6)
    found = mc.integrate(mc.debias(ladder(law, (3.0, 30.0)), probabilities=p), n=n, key=1)
    assert_unbiased(found, law.mean, rel_precision=1.001e-3, variance=variance)


def test_levels_may_come_in_three_ways():
    whole = mc.Integrand(LAW.sample, 1, lazy=True)
    listed = [whole.map(lambda c: jnp.minimum(c, 2.0)), whole.map(lambda c: jnp.minimum(c, 8.0)), whole]
    ways = [ladder(), listed, lambda k: listed[k]]
    found = [mc.draw(mc.debias(way, probabilities=PROBABILITIES), n=256).value for way in ways]
    for other in found[1:]:
        np.testing.assert_allclose(found[0], other, rtol=1e-5)
    eager = [mc.Integrand(lambda u, k=k: jnp.minimum(LAW.sample(u), k), 1) for k in (2.0, 8.0, 1e9)]
    np.testing.assert_allclose(mc.draw(mc.debias(eager, probabilities=PROBABILITIES), n=256).value, found[0], rtol=1e-5)


@pytest.mark.slow
def test_levels_of_a_regularization():
    scene, camera = scenes.mirror_box(True, 4, 4)

    def level(k):
        rule = None if k == 2 else mc.Regularize("max_prev", (0.5, 0.2)[k])
        return mc.path_integrand(scene, camera, bounces=3, hide_emitters=True, regularize=rule).map(mc.luminance)

    levels = [level(k) for k in range(3)]
    f = mc.debias(levels, probabilities=PROBABILITIES)
    assert f.dim == levels[0].dim + 1 == len(f.labels)
    drawn = mc.draw(f, n=2048)
    each = np.stack([mc.draw(g, n=2048).value for g in levels])
    reached = np.cumsum(PROBABILITIES[::-1])[::-1]
    steps = np.diff(each, axis=0, prepend=0.0) * (drawn.u[:, -1] < reached[:, None]) / reached[:, None]
    # The path's coordinates are those that it has by itself.
    np.testing.assert_allclose(drawn.value, steps.sum(0), rtol=1e-3, atol=1e-4)


def unweighted(right):
    def wrong(self, u, *params):
        # Take every level that is reached at its own worth, as if it always were.
        value = self.fn(u, *params)
        steps = [value[0], *(value[1:] - value[:-1])]
        return sum(jnp.where(u[self.dim] < p, step, 0.0) for p, step in zip(self.reached, steps, strict=True))

    return wrong


def stops_without_the_last(right):
    def wrong(self, u, *params):
        return right(module.dataclasses.replace(self, reached=(*self.reached[:-1], 1e-30)), u, *params)

    return wrong


@pytest.mark.parametrize("mutate", [unweighted, stops_without_the_last])
def test_a_wrong_sum_is_found(mutate, monkeypatch):
    monkeypatch.setattr(module._Telescope, "__call__", mutate(module._Telescope.__call__))
    f = mc.debias(ladder(), probabilities=PROBABILITIES)
    found = mc.integrate(lambda u: f([u[0], u[1]]), dim=2, n=1 << 22, key=1)
    with pytest.raises(AssertionError, match="5 standard errors off"):
        assert_unbiased(found, LAW.mean, rel_precision=3e-3)


def test_the_price_says_that_plain_averaging_is_better():
    price = mc.debias_price(ladder(), probabilities=PROBABILITIES, n=1 << 18)
    assert math.isclose(price.plain_variance, LAW.variance, rel_tol=0.05)
    assert math.isclose(price.levels, 1.0 + 0.7 + 0.5)
    assert price.variance > price.plain_variance and price.best < 1.0
    assert price.seconds > 0.0 and price.plain_seconds > 0.0


def test_bad_levels():
    f = mc.Integrand(LAW.sample, 1, lazy=True)
    for make, match in [
        (lambda: mc.debias(f), "levels on their first axis"),
        (lambda: mc.debias([f]), "at least two levels"),
        (lambda: mc.debias([f, mc.Integrand(lambda u: u[0], 2, lazy=True)]), "one dimension"),
        (lambda: mc.debias([f, f], probabilities=(1.0, 0.0)), "the last above 0"),
        (lambda: mc.debias([f, f], probabilities=(0.5, 0.6)), "sum 1"),
        (lambda: mc.debias(lambda k: f), "needs probabilities"),
        (lambda: mc.debias([f, 3.0]), "must be integrands"),
    ]:
        with pytest.raises(ValueError, match=match):
            make()


# ---------------------------------------------------------------------------------------- changing integrands
#
# The law of a mollified point mass in two dimensions: X = 1[r < h] (1 + a r^2) / h^2, r^2 uniform on (0, 1).

A = 1.0


def disk(u, h):
    return jnp.where(u[0] < h * h, (1.0 + A * u[0]) / (h * h), 0.0)


def disk_mean(h):
    return 1.0 + 0.5 * A * h * h


def disk_variance(h):
    return (1.0 + A * h * h + A * A * h**4 / 3.0) / (h * h) - disk_mean(h) ** 2


def test_the_law_of_the_disk():
    assert math.isclose(disk_mean(0.5), 1.125) and math.isclose(disk_variance(0.5), 3.8177, rel_tol=1e-4)
    found = mc.integrate(mc.Integrand(disk, 1, (0.5,), lazy=True), n=1 << 18)
    assert_unbiased(found, disk_mean(0.5), rel_precision=5e-3, variance=disk_variance(0.5))


SLOPES = [(0.0, 0.0), (1 / 12, -1 / 3), (1 / 6, -2 / 3), (1 / 4, -1 / 2), (1 / 3, -1 / 3), (0.45, -0.1)]


@pytest.mark.parametrize(("power", "slope"), SLOPES)
def test_the_squared_error_falls_as_predicted(power, slope):
    n = 1 << 20
    h = mc.Shrinking(0.9, power).first * np.arange(1.0, n + 1) ** -power
    error = (np.cumsum(disk_mean(h) - 1.0) / np.arange(1, n + 1)) ** 2
    error += np.cumsum(disk_variance(h)) / np.arange(1, n + 1) ** 2
    assert math.isclose(np.log2(error[-1] / error[n // 16 - 1]) / 4.0, slope, abs_tol=0.01)


@pytest.mark.parametrize("power", [1 / 6, 1 / 4])
def test_passes_have_the_bias_and_the_error_of_their_widths(power):
    width, n, replicates = mc.Shrinking(0.9, power), 4096, 24

    def make(i):
        return mc.Integrand(disk, 1, (width(i),), lazy=True)

    runs = [[(e.n, float(e.mean)) for e in mc.integrate_progressively(make, n=n, key=k)] for k in range(replicates)]
    counts = [step[0] for step in runs[0]]
    assert counts[:6] == [1, 2, 4, 8, 16, 32] and counts[-1] == n
    h = np.array([width(i) for i in range(1, n + 1)])
    mean, error = disk_mean(h).mean(), math.sqrt(disk_variance(h).mean() / n / replicates)
    found = np.mean([run[-1][1] for run in runs])
    assert abs(found - mean) <= 5.0 * error and error < 0.03
    # The bias of constant widths would be found.
    assert abs(disk_mean(0.9) - mean) > 10.0 * error
    spread = np.std([run[-1][1] for run in runs], ddof=1) / math.sqrt(disk_variance(h).mean() / n)
    assert 0.5 < spread < 1.6  # of 24 runs, for 5 standard errors


def test_constant_integrands_give_the_estimate_of_integrate():
    f = mc.Integrand(disk, 1, (0.5,), lazy=True)
    *_, last = mc.integrate_progressively(lambda i: f, n=5000, key=3, tallies={"tail": mc.TailHistogram()})
    whole = mc.integrate(f, n=5000, key=3, tallies={"tail": mc.TailHistogram()})
    assert last.n == 5000 and math.isclose(last.mean, whole.mean, rel_tol=1e-6)
    assert np.array_equal(last["tail"].count, whole["tail"].count)
    with pytest.raises(ValueError, match="alike"):
        list(mc.integrate_progressively(lambda i: f if i < 3 else f.map(jnp.sqrt), n=8))


SIDE, RADIANCE = 0.004, 1e5


def below_a_mirror(h):
    """Return light of a tiny lamp that shines away from the receiver, over a mirror that reflects into a cone."""
    lamp = mc.Quad((0.8, 0.0, 0.3), (SIDE, 0, 0), (0, SIDE, 0), mc.Diffuse(0.0), emission=RADIANCE)
    scene = mc.Scene([lamp, mc.Quad((-20, -20, 1), (40, 0, 0), (0, 40, 0), mc.Mirror(1.0))])
    rule = mc.Regularize("cone", float(h))
    return mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=1, lights="nee", regularize=rule)


@pytest.mark.slow
def test_the_squared_error_of_a_scene_falls_as_predicted():
    exact, _ = analytic_scenes.value_and_derivatives(
        analytic_scenes.parallelogram_irradiance,
        emission=RADIANCE, corner=(0.8, 0.0, 1.7), edge_u=(0.0, SIDE, 0.0), edge_v=(SIDE, 0.0, 0.0),
    )  # fmt: skip
    # A bias as h^2, a variance as 1 / h^2.
    widths = np.array([0.8, 0.6, 0.4, 0.2])
    found = [mc.integrate(below_a_mirror(h), n=1 << 22, key=3) for h in widths]
    bias = np.array([e.mean / exact - 1.0 for e in found]) / widths**2
    error = np.array([e.stderr / exact for e in found]) / widths**2
    variance = np.array([e.variance / exact**2 for e in found]) * widths**2
    b, v = np.sum(bias / error**2) / np.sum(error**-2.0), variance[-1]
    assert -0.17 < b < -0.14 and np.all(np.abs(bias - b) <= 5.0 * error + 0.1 * abs(b))
    np.testing.assert_allclose(variance, v, rtol=0.25)
    # The mean over all widths so far, against what that predicts.
    n = 1 << 15
    for power, slope in [(1 / 6, -0.66), (1 / 4, -0.5)]:
        shrinking = mc.Shrinking(1.0, power)

        def make(i, shrinking=shrinking):
            return below_a_mirror(shrinking(i))

        runs = [
            [(e.n, float(e.mean) / exact - 1.0) for e in mc.integrate_progressively(make, n=n, key=1000 + r)]
            for r in range(96)
        ]
        counts, errors = np.array(runs)[0, :, 0], (np.array(runs)[:, :, 1] ** 2).mean(0)
        h = np.array([shrinking(i) for i in range(1, n + 1)])
        predicted = (b * (h**2).mean()) ** 2 + v * (h**-2.0).mean() / n
        assert 0.5 < errors[-1] / predicted < 1.7  # of 96 runs, for 5 standard errors
        late = counts >= 256
        assert abs(np.polyfit(np.log(counts[late]), np.log(errors[late]), 1)[0] - slope) < 0.15


def test_images_whose_blur_shrinks():
    scene, camera = scenes.mirror_box(True, 8, 8)
    options = {"spp": 8, "bounces": 2, "key": 4}

    def last(amount):
        *_, image = mc.render_progressively(scene, camera, **options, regularize=mc.Regularize("cone", amount, True))
        return np.asarray(image.mean)

    constant = np.asarray(mc.render(scene, camera, **options, regularize=mc.Regularize("cone", 0.4, True)).mean)
    np.testing.assert_allclose(last(mc.Shrinking(0.4, 0.0)), constant, rtol=1e-5)
    assert not np.allclose(last(mc.Shrinking(0.4)), constant, rtol=1e-3)
    with pytest.raises(ValueError, match="independent points"):
        mc.render_progressively(
            scene, camera, spp=4, sampler=mc.Sobol(), regularize=mc.Regularize("cone", mc.Shrinking(0.4))
        )
