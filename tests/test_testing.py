"""The tools that tests are made of: what they pass, what they refuse, and how sure they are."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxmc as mc
from jaxmc.integration.estimate import Estimate
from jaxmc.integration.moments import MomentsResult
from jaxmc.testing import (
    SPHERE,
    SQUARE,
    Domain,
    assert_equivalent,
    assert_jacobian,
    assert_samples_pdf,
    assert_unbiased,
    box,
    checks,
    chi_square_power,
    directions,
    joint_sigmas,
)
from jaxmc.testing.chi_square import SIGNIFICANCE, chi_square, pool
from jaxmc.testing.domains import bin_integrals

# ---------------------------------------------------------------------------------------- two estimates


def estimate(samples, key) -> Estimate:
    """Return the estimate that independent samples make: arrays, the samples on the first axis."""
    leaves, structure = jax.tree.flatten(samples)
    moments = []
    for leaf in leaves:
        x = np.asarray(leaf, float)
        with np.errstate(invalid="ignore"):
            mean = x.mean(0)
            central = [np.mean((x - mean) ** k, 0) for k in (2, 3, 4)]
        moments.append(MomentsResult(np.full(mean.shape, float(len(x))), mean, central, int(np.sum(~np.isfinite(x)))))
    return Estimate(moments, len(x), {}, 0.0, {"key": key}, structure)


def noise(key, shape, mean=1.0):
    """Return an estimate from normal samples of standard deviation 1."""
    return estimate(np.random.default_rng(key).normal(mean, 1.0, shape), key)


MANY = 1 << 16  # normal samples: the standard error of a difference is 0.0055


def test_sound_pairs_agree():
    assert_equivalent(noise(1, MANY), noise(2, MANY), rel_precision=6e-3)
    assert_equivalent(noise(1, MANY), noise(2, 100), rel_precision=0.12)
    assert_equivalent(noise(1, (MANY, 4, 8)), noise(2, (MANY, 4, 8)), rel_precision=7e-3)


def test_estimates_of_the_driver_agree_however_their_points_lie():
    f = mc.Integrand(lambda u, factor: factor * jnp.exp(u[0]), 1, (1.0,))
    wrong = mc.Integrand(f.fn, 1, (1.0003,))
    plain, even = mc.integrate(f, n=MANY, key=jax.random.key(1)), mc.integrate(f, n=1 << 12, key=2, sampler=mc.Sobol())
    assert_equivalent(plain, even, rel_precision=2e-3)
    # The error bar of points that lie evenly is that of their randomisations, widened by Student's law.
    for other, precision in ((f, 1e-4), (wrong, 1e-4), (f, 1e-6)):
        again = mc.integrate(other, n=1 << 12, key=3, sampler=mc.Sobol())
        if other is f and precision == 1e-4:
            assert_equivalent(even, again, precision)
            assert_unbiased(again, math.e - 1.0, 1e-4)
        else:
            with pytest.raises(AssertionError, match="estimates differ" if other is wrong else "too wide"):
                assert_equivalent(even, again, precision)
    with pytest.raises(AssertionError, match=r"more than 8.3 standard errors off"):
        assert_unbiased(mc.integrate(wrong, n=1 << 12, key=3, sampler=mc.Sobol()), math.e - 1.0, 1e-4)


def test_a_difference_is_found():
    with pytest.raises(AssertionError, match=r"^the estimates differ \(1 of 1\): component 0 is worst, 0\.99"):
        assert_equivalent(noise(1, MANY), noise(2, MANY, mean=1.05), rel_precision=6e-3)
    mean = np.ones((4, 8))
    mean[2, 3] = 1.06
    with pytest.raises(AssertionError, match=r"^the estimates differ \(1 of 32\): component 19 is worst"):
        assert_equivalent(noise(1, (MANY, 4, 8)), noise(2, (MANY, 4, 8), mean), rel_precision=7e-3)


def test_agreement_without_evidence_is_refused():
    with pytest.raises(AssertionError, match=r"^the error bar is too wide to be evidence \(1 of 1\)"):
        assert_equivalent(noise(1, MANY), noise(2, MANY), rel_precision=5e-3)
    with pytest.raises(AssertionError, match=r"^the error bar is too wide"):  # more components take more evidence
        assert_equivalent(noise(1, (MANY, 32)), noise(2, (MANY, 32)), rel_precision=6e-3)
    assert_equivalent(noise(1, MANY), noise(2, MANY), rel_precision=0.0, abs_precision=6e-3)
    with pytest.raises(AssertionError, match="too wide"):  # one sample has no variance
        assert_equivalent(noise(1, MANY), noise(2, 1), rel_precision=10.0)
    heavy = [estimate(np.random.default_rng(key).random(MANY) ** -0.7, key) for key in (1, 2)]
    with pytest.raises(AssertionError, match=r"^too few samples make the variance for an error bar \(1 of 1\)"):
        assert_equivalent(*heavy, rel_precision=1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite_are_refused(bad):
    broken = [estimate(np.append(np.random.default_rng(key).random(999), bad), key) for key in (1, 2)]
    with pytest.raises(AssertionError, match=r"^1 values were not finite"):
        assert_equivalent(broken[0], noise(2, 1000), rel_precision=1.0)
    with pytest.raises(AssertionError, match=r"^2 values were not finite"):
        assert_equivalent(*broken, rel_precision=1.0)


def test_constants_may_differ_by_rounding():
    def constant(value, key):
        return estimate(np.full(64, value), key)

    assert_equivalent(constant(3.0, 1), constant(3.0 * (1 + 9e-6), 2), rel_precision=1e-9)
    assert_equivalent(constant(0.0, 1), constant(0.0, 2), rel_precision=0.0)
    for value in (3.0 * (1 + 2e-5), -3.0, 0.0):
        with pytest.raises(AssertionError, match=r"^the estimates differ"):
            assert_equivalent(constant(3.0, 1), constant(value, 2), rel_precision=1e-9)


def test_components_that_few_samples_make_are_no_evidence():
    rare = np.zeros((MANY, 2))
    rare[:, 0], rare[:3, 1] = np.random.default_rng(1).normal(1.0, 1.0, MANY), 1e4
    full = np.random.default_rng(2).normal((1.0, 3.0), 1.0, (MANY, 2))

    def refusal(a, b):
        with pytest.raises(AssertionError) as refused:
            assert_equivalent(a, b, 0.0, abs_precision=9.0)
        return str(refused.value)

    few = "too few samples make the variance for an error bar (1 of 2): component 1"
    assert refusal(estimate(rare, 1), estimate(full, 2)).startswith(few)
    # Images keep two moments: what tells it comes as a tally, or where an event was never met.
    shape = estimate(rare, 1).moments
    image = dataclasses.replace(estimate(rare, 1), moments=[shape[0]._replace(central=shape[0].central[:1])])
    assert refusal(image, estimate(full, 2)).startswith("the estimates differ (1 of 2): component 1")
    assert refusal(dataclasses.replace(image, tallies={"shape": shape}), estimate(full, 2)).startswith(few)
    assert refusal(estimate(rare * (1.0, 0.0), 1), estimate(full, 2)).startswith(few)


def small_room(factor):
    wall = mc.Quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), mc.Diffuse(0.7))
    lamp = mc.Quad((-0.5, 1.5, -0.5), (1, 0, 0), (0, 0, 1), mc.Diffuse(0.0), emission=3.0 * factor)
    return mc.Scene([wall, lamp]), mc.PinholeCamera((0, 0.5, 3), (0, 0.3, 0), width=12, height=8)


@pytest.mark.slow
def test_images_by_different_strategies_agree():
    def image(lights, key, factor=1.0):
        shape = {"shape": mc.Moments(order=4)}
        return mc.render(*small_room(factor), spp=1 << 14, bounces=1, lights=lights, key=key, tallies=shape)

    right = image("nee", 1)
    assert_equivalent(right, image("none", 2), rel_precision=0.04, abs_precision=0.03)
    with pytest.raises(AssertionError, match=r"^the estimates differ"):
        assert_equivalent(right, image("none", 2, factor=1.3), rel_precision=0.04, abs_precision=0.03)


def test_every_leaf_of_a_tree_is_compared():
    def pair(key, *means):
        rng = np.random.default_rng(key)
        return estimate({"a": rng.normal(means[0], 1.0, (MANY, 2)), "b": rng.normal(means[1], 1.0, MANY)}, key)

    assert_equivalent(pair(1, 1.0, 2.0), pair(2, 1.0, 2.0), rel_precision=7e-3)
    with pytest.raises(AssertionError, match=r"the estimates differ \(1 of 3\): component 2 is worst"):
        assert_equivalent(pair(1, 1.0, 2.0), pair(2, 1.0, 2.1), rel_precision=7e-3)


def test_static_mistakes_are_said():
    with pytest.raises(ValueError, match="drawn with key=1"):
        assert_equivalent(noise(1, 100), noise(1, 200), rel_precision=1.0)
    with pytest.raises(ValueError, match="one structure and shape"):
        assert_equivalent(noise(1, 100), noise(2, (100, 1)), rel_precision=1.0)


@pytest.mark.parametrize("components", [1, 50])
def test_false_alarms_are_as_rare_as_said(components, monkeypatch):
    # With a bound of 2 standard errors in place of 5, 4.6 % of sound pairs fail: for means of few randomisations, of
    # unequal spread, and many components.
    monkeypatch.setattr(checks, "SIGMAS", 2.0)
    rng, many, trials = np.random.default_rng(3), np.full(components, 1e6), 500
    within = MomentsResult(many, np.zeros(components), [np.ones(components)], 0)

    def randomised(key, replicates, scale):
        means = rng.normal(0.0, scale, (replicates, components))
        between = MomentsResult(np.full(components, float(replicates)), means.mean(0), [means.var(0)], 0)
        moments = [within._replace(mean=between.mean)]
        return Estimate(moments, 10**6, {}, 0.0, {"key": key}, jax.tree.structure(0), [between])

    pairs = [(randomised(1, 6, 1.0), randomised(2, 8, 1.5)) for _ in range(trials)]
    failures = sum(is_refused(*pair, 0.0, abs_precision=1e9) for pair in pairs)
    expected = trials * 2.0 * stats.norm.sf(2.0)
    assert 0.5 * expected < failures < expected + 4.0 * math.sqrt(expected)


def test_the_power_is_as_said():
    # With a precision as wide as it may be, a difference of 8 of it is found in 99.8 % of all cases, of 3 hardly ever.
    precision = 1.01 * math.sqrt(2.0 / 4096)
    for factor, least, most in ((8.0, 148, 150), (3.0, 0, 10)):
        pairs = [(noise(2 * k, 4096), noise(2 * k + 1, 4096, 1.0 + factor * precision)) for k in range(150)]
        assert least <= sum(is_refused(*pair, 0.0, abs_precision=1.05 * precision) for pair in pairs) <= most


def is_refused(*arguments, **more):
    try:
        assert_equivalent(*arguments, **more)
    except AssertionError:
        return True
    return False


def test_the_joint_bound():
    assert joint_sigmas(1) == pytest.approx(5.0, rel=1e-12)
    assert joint_sigmas(10) == pytest.approx(5.43, abs=0.01) and joint_sigmas(100_000) == pytest.approx(6.89, abs=0.01)
    assert joint_sigmas(1, 15) == pytest.approx(8.27, abs=0.01)
    np.testing.assert_allclose(joint_sigmas(7, np.array([1e8, 1e12])), joint_sigmas(7), rtol=1e-6)


# ------------------------------------------------------------------------------------- domains and integrals over bins


def bins_of(density, domain, accuracy=1e-5):
    return bin_integrals(density, domain, lambda integral: accuracy * np.maximum(integral, 1e-3))


DOMAINS = {
    "interval": (box((-1.0,), (3.0,)), 4.0),
    "square": (SQUARE, 1.0),
    "cube": (box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), 6.0),
    "sphere": (SPHERE, 4.0 * math.pi),
    "tilted cone": (directions((1.0, -2.0, 0.5), 0.3), 2.0 * math.pi * (1.0 - math.cos(0.3))),
    "cylinder": (
        Domain(
            low=(0.0, 0.0),
            high=(2.0 * math.pi, 3.0),
            point=lambda q: jnp.stack([2.0 * jnp.cos(q[0]), 2.0 * jnp.sin(q[0]), q[1]]),
            coordinates=lambda x: jnp.stack([jnp.arctan2(x[1], x[0]) % (2.0 * math.pi), x[2]]),
            bins=(8, 4),
        ),
        12.0 * math.pi,
    ),
}


@pytest.mark.parametrize("name", DOMAINS)
def test_a_domain_has_its_measure_and_its_inverse(name):
    domain, size = DOMAINS[name]
    found, uncertain = bins_of(lambda x: 1.0, domain)
    assert found.sum() == pytest.approx(size, rel=1e-5) and uncertain == 0.0 and len(found) == math.prod(domain.bins)
    q = jnp.asarray(np.random.default_rng(0).uniform(domain.low, domain.high, (200, len(domain.low))), float)
    np.testing.assert_allclose(jax.vmap(lambda q: domain.coordinates(domain.point(q)))(q), q, rtol=2e-3, atol=2e-5)


def test_smooth_densities_are_integrated_over_every_bin():
    domain = box((0.0, 0.0), (1.0, 2.0), bins=(3, 2))
    found, _ = bins_of(lambda x: jnp.exp(x[0]) * x[1] ** 3, domain)
    np.testing.assert_allclose(found, np.outer(np.diff(np.exp(np.arange(4) / 3.0)), [0.25, 3.75]).ravel(), rtol=1e-6)


def test_densities_with_jumps_are_integrated_over_every_bin():
    # A disk of radius 0.4 about the corner at 0, in 2 x 2 bins of side 1/4: it fills one and cuts the others.
    square = box((0.0, 0.0), (0.5, 0.5), bins=(2, 2))
    found, uncertain = bins_of(lambda x: jnp.where(x @ x < 0.16, 1.0, 0.0), square, 1e-4)
    strip = 0.5 * (0.25 * math.sqrt(0.16 - 0.0625) + 0.16 * math.asin(0.25 / 0.4))  # the disk over [0, 1/4]
    quarter = 0.04 * math.pi
    exact = [0.0625, strip - 0.0625, strip - 0.0625, quarter - 2.0 * strip + 0.0625]
    np.testing.assert_allclose(found, exact, rtol=1e-3)
    assert found.sum() == pytest.approx(quarter, rel=1e-4) and uncertain == 0.0


def test_a_density_that_cannot_be_integrated_is_refused():
    with pytest.raises(ValueError, match="could not be integrated"):
        assert_samples_pdf(
            lambda u: u, lambda x: 1.0 + 0.9 * jnp.sin(2e4 * x[0]) * jnp.sin(2e4 * x[1]), SQUARE, n=1 << 14
        )
    with pytest.raises(AssertionError, match="integrates to nan"):
        assert_samples_pdf(lambda u: u, lambda x: jnp.where(x[0] < 0.9, 1.0, jnp.nan), SQUARE, n=1 << 14)


@pytest.mark.parametrize(
    "wrong",
    [{"low": (0.0,)}, {"high": (0.0, 1.0)}, {"bins": (0, 3)}, {"high": (math.inf, 1.0)}, {"low": (0.0, 0.0, 0.0)}],
)
def test_a_domain_says_what_is_wrong_with_it(wrong):
    with pytest.raises(ValueError, match="finite low < high and bins >= 1"):
        Domain(**({"low": (0.0, 0.0), "high": (1.0, 1.0), "bins": (2, 2)} | wrong), point=None, coordinates=None)


# ---------------------------------------------------------------------------------------- counting in bins


def test_rare_bins_are_pooled_until_each_holds_enough():
    observed, expected = pool(np.arange(7), np.array([100.0, 1.0, 30.0, 24.0, 2.0, 0.0, 3.0]))
    assert expected.tolist() == [30.0, 30.0, 100.0] and observed.tolist() == [5 + 1 + 4 + 6 + 3, 2, 0]
    assert pool(np.array([1, 2]), np.array([5.0, 40.0]))[1].tolist() == [45.0]
    with pytest.raises(ValueError, match="fill only 1 bins"):
        chi_square(np.array([10, 90]), np.array([10.0, 90.0]))


def test_the_statistic_is_pearsons():
    observed, expected = np.array([60, 40, 100]), np.array([50.0, 50.0, 100.0])
    result = chi_square(observed, expected)
    assert (result.statistic, result.p_value) == pytest.approx(stats.chisquare(observed, expected))
    assert result.worst in ((60, 50.0), (40, 50.0)) and result.cells == 3


def test_the_test_has_the_significance_and_the_power_that_it_states():
    # Whole tests, of 512 bins of uneven expectation, with the default number of samples: only the drawing is left out.
    rng, trials, n = np.random.default_rng(5), 400, 1 << 20
    p = rng.uniform(0.2, 2.0, 512)
    p[:40] = 3e-5
    p /= p.sum()
    sound = [chi_square(rng.multinomial(n, p), n * p).p_value for _ in range(trials)]
    assert 0.5 * trials * 0.1 < np.sum(np.array(sound) < 0.1) < 1.6 * trials * 0.1 and min(sound) > SIGNIFICANCE
    for fraction, factor, power in ((0.5, 0.0162, 0.99), (0.1, 0.0162, 0.99), (0.01, 0.0162, 0.99), (0.5, 0.0132, 0.5)):
        up = np.cumsum(p[::-1])[::-1] <= fraction
        held = p[up].sum()
        error = factor * math.sqrt((1.0 - held) / held)
        wrong = p * np.where(up, 1.0 + error, 1.0 - error * held / (1.0 - held))
        said = chi_square_power(error, held)
        assert said == pytest.approx(power, abs=0.005 if power == 0.99 else 0.2)
        found = np.mean([chi_square(rng.multinomial(n, wrong), n * p).p_value < SIGNIFICANCE for _ in range(trials)])
        assert abs(found - said) < 4.0 * math.sqrt(said * (1.0 - said) / trials)


def tilted(error):
    """Return the density on the square that is off by a relative error, up on one half and down on the other."""
    return lambda x: 1.0 + jnp.where(x[0] < 0.5, error, -error)


@pytest.mark.slow
@pytest.mark.parametrize(("error", "least", "most"), [(0.0325, 19, 20), (0.0264, 5, 15)])
def test_the_power_of_a_whole_test_is_as_said(error, least, most):
    n = 1 << 18
    assert chi_square_power(error, 0.5, n=n, cells=23 * 23) * 20 == pytest.approx((least + most) / 2, abs=3)
    found = 0
    for key in range(20):
        try:
            assert_samples_pdf(lambda u: u, tilted(error), SQUARE, n=n, key=key)
        except AssertionError:
            found += 1
    assert least <= found <= most


def test_samples_of_any_kind_are_counted():
    assert_samples_pdf(
        lambda u: -jnp.log1p(-u[0] * (1 - math.exp(-3.0))),
        lambda x: jnp.exp(-x) / (1 - math.exp(-3.0)),
        box((0.0,), (3.0,)),
        dim=1,
        n=1 << 16,
    )
    assert_samples_pdf(
        lambda u: {"a": u[0], "b": jnp.sqrt(u[1:])},
        lambda x: 4.0 * x["b"][0] * x["b"][1],
        box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), bins=(4, 4, 4)),
        dim=3,
        n=1 << 16,
    )
    # A mixture takes a coordinate more than the domain has.
    assert_samples_pdf(
        lambda u: jnp.where(u[0] < 0.3, u[1:], jnp.sqrt(u[1:])),
        lambda x: 0.3 + 2.8 * x[0] * x[1],
        SQUARE,
        dim=3,
        n=1 << 16,
    )


def test_samples_may_be_rejected():
    # Points of the square, of which those in the quarter disk count.
    def in_disk(x):
        return x @ x < 1.0

    def inside(x):
        return jnp.where(in_disk(x), 1.0, 0.0)

    result = assert_samples_pdf(lambda u: u, inside, SQUARE, n=1 << 17, accept=in_disk)
    assert result.cells > 300
    with pytest.raises(AssertionError, match="do not follow"):  # too many are rejected
        assert_samples_pdf(lambda u: u, inside, SQUARE, n=1 << 17, accept=lambda x: x @ x < 0.97)


# ---------------------------------------------------------------------------------------- Jacobians


def test_the_jacobian_of_maps_in_one_and_three_dimensions():
    assert assert_jacobian(lambda u: jnp.sqrt(u[0]), lambda x: 2.0 * x, dim=1) < 1e-5
    uneven = jnp.asarray([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0], [4.0, 0.0, 1.0]], float)
    assert_jacobian(lambda u: uneven @ u, lambda x: 1.0 / 25.0, dim=3)
    with pytest.raises(AssertionError, match=r"density times Jacobian is 1\.0204"):
        assert_jacobian(lambda u: uneven @ u, lambda x: 1.0 / 24.5, dim=3)


def test_the_jacobian_of_a_surface_is_its_area():
    cylinder = lambda u: jnp.stack([2 * jnp.cos(6 * u[0]), 2 * jnp.sin(6 * u[0]), 3 * u[1]])  # noqa: E731
    assert_jacobian(cylinder, lambda x: 1.0 / 36.0)


def test_more_coordinates_than_components_are_refused():
    with pytest.raises(ValueError, match="3 coordinates to 2 components"):
        assert_jacobian(lambda u: u[:2], lambda x: 1.0, dim=3)


def test_a_derivative_that_is_not_finite_is_found():
    with pytest.raises(AssertionError, match="density times Jacobian is nan"):
        assert_jacobian(lambda u: jnp.where(u[0] < 0.9, u, jnp.sqrt(u - u)), lambda x: 1.0)


def test_a_density_may_jump_at_the_edge_of_the_square_but_not_within():
    lowest = 2.0**-30
    assert_jacobian(lambda u: u, lambda x: jnp.where(x[0] > lowest, 1.0, 0.0))
    with pytest.raises(AssertionError, match="density times Jacobian is 0"):
        assert_jacobian(lambda u: u, lambda x: jnp.where(x[0] > 0.01, 1.0, 0.0))
