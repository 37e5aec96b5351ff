"""Path sums with power-law tails, throughputs, blurred delta functions: closed forms against samples and quadrature."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats

import analytic_scenes as scenes
import jaxmc as mc
from analytic_scenes.chains import path_moments
from jaxmc.testing import DiskMollifier, PathSum, ThroughputProduct, assert_unbiased

ROOT_3 = math.sqrt(3.0) / 2.0  # the albedo at which the variance diverges, rounded to below it


class Column:
    """Coordinates of n points, drawn one dimension at a time."""

    def __init__(self, n, seed=1):
        self.n, self.seed = n, seed

    def __getitem__(self, k):
        return np.random.default_rng([self.seed, k]).random(self.n)


def test_moments_of_the_furnace():
    assert [PathSum(0.6).moment(q) for q in (1, 2, 3, 4)] == pytest.approx([2.5, 7.6923, 29.1847, 135.978], rel=5e-6)
    for rho in (0.1, 0.45, 0.6, 0.8, 0.85):
        law = PathSum(rho)
        assert law.variance == pytest.approx(rho**2 / ((1 - rho) ** 2 * (3 - 4 * rho**2)), rel=1e-10)
        moments = [law.moment(q) for q in (1, 2, 3, 4)]
        assert moments == pytest.approx(scenes.furnace_moments(rho, math.inf, "uniform"), rel=1e-10)
        for depth in (0, 1, 7):
            moments = [PathSum(rho, depth).moment(q) for q in (1, 2, 3, 4)]
            assert moments == pytest.approx(scenes.furnace_moments(rho, depth, "uniform"), rel=1e-12)


def test_critical_albedos():
    table = {2: ROOT_3, 3: 2.0 ** (-1 / 3), 4: (5 / 16) ** 0.25}
    for q, rho in table.items():
        assert scenes.critical_albedo(q) == pytest.approx(rho, rel=1e-12)
        assert math.isfinite(PathSum(rho - 1e-6).moment(q)) and PathSum(rho + 1e-6).moment(q) == math.inf
        assert scenes.tail_index(rho) == pytest.approx(q, rel=1e-9)
    assert [round(rho, 4) for rho in table.values()] == [0.866, 0.7937, 0.7477]
    assert scenes.critical_albedo(1000.0) == pytest.approx(0.5, abs=0.004)
    # Paths that may escape stand a higher albedo.
    for q in (2, 3):
        rho = scenes.critical_albedo(q, escape=0.1)
        assert rho > table[q] and scenes.tail_index(rho, escape=0.1) == pytest.approx(q, rel=1e-9)
        assert math.isfinite(PathSum(rho - 1e-6, escape=0.1).moment(q))
        assert PathSum(rho + 1e-6, escape=0.1).moment(q) == math.inf


def test_albedos_that_take_turns_have_a_finite_variance_below_three_quarters():
    for first in (0.8, 0.9, 1.0):
        second = 0.75 / first
        assert math.isfinite(PathSum(first, other=second - 1e-6).variance)
        assert PathSum(first, other=second + 1e-6).variance == PathSum(second + 1e-6, other=first).variance == math.inf
        assert PathSum(first, other=second).tail_index == pytest.approx(2.0, rel=1e-9)
    # The moments of the two rooms of a chain, by matrices.
    weights = np.array(
        [[[0.0, PathSum(0.8).weight_moment(0, q)], [PathSum(0.3).weight_moment(0, q), 0.0]] for q in range(1, 5)]
    )
    for depth in (3, 4, math.inf):
        want = path_moments([1.0, 1.0], weights, depth)
        assert [PathSum(0.8, depth, 0.3).moment(q) for q in (1, 2, 3, 4)] == pytest.approx(
            want[:, 0].tolist(), rel=1e-12
        )
        assert [PathSum(0.3, depth, 0.8).moment(q) for q in (1, 2, 3, 4)] == pytest.approx(
            want[:, 1].tolist(), rel=1e-12
        )


KAPPAS = {0.6: 15.31, 0.7: 5.615, 0.8: 2.890, ROOT_3: 2.0, 0.9: 1.672, 0.95: 1.293, 0.99: 1.053, 1.0: 1.0}


def test_tail_indices():
    for rho, kappa in KAPPAS.items():
        law = PathSum(rho)
        assert law.tail_index == pytest.approx(kappa, rel=5e-4)
        assert law.weight_moment(0, law.tail_index) == pytest.approx(1.0, rel=1e-9)
    assert PathSum(0.5).tail_index == PathSum(0.9, depth=10).tail_index == math.inf


def test_tail_constants():
    law = PathSum(ROOT_3)
    assert law.tail_constant == pytest.approx((1 + ROOT_3) / (1 - ROOT_3) / (2 * (math.log(3) / 2 - 1 / 3)), rel=1e-12)
    assert law.tail_constant == pytest.approx(32.245, abs=5e-4)
    assert PathSum((5 / 16) ** 0.25).tail_constant == pytest.approx(1946.4, abs=0.05)
    # The law itself comes close to its power law as 1 / x.
    for kappa in (2, 3):
        law = PathSum(scenes.critical_albedo(kappa))
        rise = [law.tail_constant / (x**kappa * law.exceedance(x)) - 1.0 for x in (500.0, 1000.0)]
        assert 0.0 < rise[1] < 0.02 and rise[0] / rise[1] == pytest.approx(2.0, rel=0.02)
    assert PathSum(ROOT_3).exceedance(100.0) == pytest.approx(0.00302, abs=5e-6)
    for law in (PathSum(0.7), PathSum(0.5), PathSum(0.8, other=0.9)):
        with pytest.raises(ValueError, match="whole kappa"):
            _ = law.tail_constant


ENDLESS = [0.3, 0.5, 0.6, 0.75, ROOT_3, 0.95]


@pytest.mark.parametrize("rho", ENDLESS)
def test_the_law_of_endless_paths_belongs_to_its_moments(rho):
    law = PathSum(rho)
    for t in (0.4, 1.3, 3.0, 12.0, 200.0):
        # Every second piece has a kink of higher order, at 1 + a + a^2 + ...
        kinks = np.cumsum((2.0 * rho) ** np.arange(12))
        points = np.unique(np.append(kinks[kinks < t], min(1.0, t)))
        clamped = integrate.quad(law.exceedance, 0.0, t, points=points, limit=400)[0]
        square = integrate.quad(lambda x: 2.0 * x * law.exceedance(x), 0.0, t, points=points, limit=400)[0]
        assert law.mean - law.clamp_bias(t) == pytest.approx(clamped, rel=1e-8)
        assert law.clamped_square(t) == pytest.approx(square, rel=1e-8)
    if law.moment(3) < math.inf:
        assert law.clamped_square(1e5) == pytest.approx(law.moment(2), rel=1e-7)
        assert law.clamp_bias(1e5) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("rho", ENDLESS)
def test_the_law_of_endless_paths_is_a_fixed_point(rho):
    # P(1 + w S > x) is the mean of P(S > (x - 1) / w) over the weights.
    law = PathSum(rho)

    def after_one_event(u, x):
        return law.exceedance((x - 1.0) / (2.0 * rho * u))

    for x in (1.2, 2.5, 6.0, 30.0):
        kinks = (x - 1.0) / (2.0 * rho) / np.cumsum((2.0 * rho) ** np.arange(10))
        points = np.unique(kinks[kinks < 1.0])
        mean = integrate.quad(after_one_event, 0.0, 1.0, (x,), points=points, limit=400)[0]
        assert law.exceedance(x) == pytest.approx(mean, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("law", [PathSum(0.45), PathSum(0.7), PathSum(0.9)], ids=str)
def test_sampled_paths_follow_the_law(law):
    n = 100_000
    sample = law.sample(Column(n))
    t = np.array([1.2, 2.0, 5.0, 20.0])
    p = law.exceedance(t)
    assert (np.abs((sample[:, None] > t).mean(0) - p) <= 5.0 * np.sqrt(p * (1 - p) / n) + 1e-12).all()
    clamped = np.minimum(sample[:, None], t)
    assert (np.abs(clamped.mean(0) - (law.mean - law.clamp_bias(t))) <= 5.0 * clamped.std(0) / math.sqrt(n)).all()


@pytest.mark.parametrize(
    "law",
    [
        PathSum(0.6, 4),
        PathSum(0.9, 3, 0.4),
        PathSum(0.7, 5, escape=0.3),
        PathSum(0.6, other=0.7, escape=0.2),
        PathSum(0.8, 0),
    ],
    ids=str,
)
def test_sampled_paths_have_the_moments(law):
    n = 400_000
    sample = np.broadcast_to(law.sample(Column(n)), (n,))
    assert abs(sample.mean() - law.mean) <= 5.0 * math.sqrt(law.variance / n)
    fourth = law.moment(4) - 4 * law.moment(3) * law.mean + 6 * law.moment(2) * law.mean**2 - 3 * law.mean**4
    assert abs(sample.var() - law.variance) <= 5.0 * math.sqrt(max(fourth - law.variance**2, 0.0) / n)


def test_optimal_thresholds_of_path_sums_solve_their_equation():
    for rho in (0.6, 0.9):
        law = PathSum(rho)
        for N in (16, 1024):
            t = law.optimal_threshold(N)
            assert (N - 1) * law.clamp_bias(t) == pytest.approx(t - law.mean, rel=1e-7)


def test_laws_that_are_not_known_are_refused():
    for law in (PathSum(0.6, 5), PathSum(0.6, other=0.5), PathSum(0.6, escape=0.1), PathSum(1.0)):
        with pytest.raises(ValueError, match="law is known"):
            law.exceedance(2.0)
    with pytest.raises(ValueError, match="fade"):
        _ = PathSum(1.2).dim


SCENES = [
    pytest.param(scenes.path_sum(), marks=pytest.mark.slow),
    scenes.path_sum(depth=5, albedo=0.8, other_albedo=0.5, escape=0.2),
    scenes.disk_mollifier(),
    pytest.param(scenes.disk_mollifier(a=-0.5, h=0.8), marks=pytest.mark.slow),
    pytest.param(scenes.cone_mirror(), marks=pytest.mark.slow),
    scenes.cone_mirror(offset=0.15, cone=0.25),
]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.slug)
def test_scenes_against_samples(scene):
    n = 300_000
    estimate = mc.integrate(scene.integrand, n=n, key=3)
    assert_unbiased(estimate, scene.exact, 5e-3, variance=scene.exact_variance)
    error = scene.exact_variance * math.sqrt((scene.exact_kurtosis - 1.0) / n)
    assert abs(estimate.variance - scene.exact_variance) <= 5.0 * error + 1e-4 * scene.exact_variance


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.slug)
def test_derivatives_of_scenes_against_differences(scene):
    step = 1e-5
    with jax.enable_x64(True):
        for name, derivative in scene.derivatives.items():
            if scene.arguments[name] == 0.0:
                continue  # an angle of 0 has no other side
            ends = [float(scene.formula(**scene.arguments | {name: scene.arguments[name] + s})) for s in (step, -step)]
            assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(derivative, rel=1e-6, abs=1e-8)


def test_scenes_know_what_diverges():
    assert scenes.path_sum(0.9).exact_variance is None and scenes.path_sum(0.9).exact_kurtosis is None
    assert scenes.path_sum(0.8).exact_variance > 0.0 and scenes.path_sum(0.8).exact_kurtosis is None
    for bad in (lambda: scenes.path_sum(0.0), lambda: scenes.path_sum(1.0), lambda: scenes.disk_mollifier(h=1.5)):
        with pytest.raises(ValueError, match="needed"):
            bad()
    with pytest.raises(ValueError, match="angles"):
        scenes.cone_mirror(cone=0.0)


def test_a_blurred_delta_function():
    law = DiskMollifier(1.0, 0.5)
    assert law.mean == 1.125 and law.variance == pytest.approx(3.8177, abs=5e-5)
    assert law.moment(2) == pytest.approx((1 + 0.25 + 0.0625 / 3) / 0.25, rel=1e-12)
    sample = law.sample([np.linspace(0.0, 1.0, 2_000_001), 0.3])
    assert [(sample**q).mean() for q in (1, 2, 3, 4)] == pytest.approx([law.moment(q) for q in (1, 2, 3, 4)], rel=1e-4)
    assert np.allclose(
        jax.vmap(law.sample)(jnp.array([[0.2, 0.7], [0.3, 0.1]])), law.sample(np.array([[0.2, 0.3], [0.7, 0.1]]))
    )


def test_a_cone_mirror_sees_the_share_of_its_cone():
    for cone, light in ((0.3, 0.2), (0.2, 0.3), (0.01, 0.2), (0.3, 0.3), (0.7, 0.7)):
        share = min(1.0, (1.0 - math.cos(light)) / (1.0 - math.cos(cone)))
        scene = scenes.cone_mirror(radiance=5.0, reflectance=1.0, cone=cone, light=light)
        assert scene.exact == pytest.approx(5.0 * share, rel=1e-12)
        assert scene.exact_variance == pytest.approx(25.0 * share * (1.0 - share), abs=1e-9)


# The throughput alone.


def test_typical_throughput_falls_behind_its_mean():
    k, rho = 40, 0.8
    law = ThroughputProduct(k, rho)
    median = (2 * rho) ** k * math.exp(-special.gammaincinv(k, 0.5))
    assert law.exceedance(median) == pytest.approx(0.5, abs=1e-9)
    assert median == pytest.approx((2 * rho / math.e) ** k * math.exp(1 / 3), rel=0.01)
    assert law.mean / median == pytest.approx((math.e / 2) ** k * math.exp(-1 / 3), rel=0.01)
    # A weight exceeds 1 where cos > 1 / (2 rho).
    assert ThroughputProduct(1, rho).exceedance(1.0) == pytest.approx(1.0 - 1.0 / (2.0 * rho))
    assert law.moment(4) / law.moment(2) ** 2 == pytest.approx((9 / 5) ** k, rel=1e-9)
    assert law.variance / law.mean**2 == pytest.approx((4 / 3) ** k - 1.0, rel=1e-9)


def test_samples_that_it_takes_to_see_what_carries_mean_and_square():
    for k, mean, square in ((10, 31.4, 424), (38, 1.25e4, 1.4e8), (100, 3.1e9, 9.7e19)):
        law = ThroughputProduct(k, 1.0)
        # The mean is carried by products of (2 rho)^k e^-(k/2), the mean square by e^-(k/3).
        assert 1.0 / law.exceedance(2.0**k * math.exp(-k / 2)) == pytest.approx(mean, rel=0.02)
        assert 1.0 / law.exceedance(2.0**k * math.exp(-k / 3)) == pytest.approx(square, rel=0.04)
    rates = [
        math.log(special.gammainc(k, k * x) / special.gammainc(2 * k, 2 * k * x)) / k
        for k, x in ((400, 0.5), (400, 1 / 3))
    ]
    assert rates == pytest.approx([0.193, 0.432], abs=2e-3)


def test_the_chance_of_a_throughput_that_was_printed():
    # 33 bounces between two plates that multiply the throughput by 1821 or more.
    for first, second, chance in ((1.0, 0.8, 3.1e-7), (0.9, 0.9, 3.6e-7), (0.8, 0.8, 3.2e-11)):
        depth = 17 * math.log(2 * first) + 16 * math.log(2 * second) - math.log(1821.0)
        assert special.gammainc(33, depth) == pytest.approx(chance, rel=0.03)


@pytest.mark.slow
def test_cosine_distributed_directions_have_no_tail():
    scene = scenes.cube_furnace(albedo=0.9, bounces=20)
    estimate = mc.integrate(scene.integrand, n=2000)
    assert estimate.mean == pytest.approx(scene.exact, rel=1e-5) and estimate.variance < 1e-9


def test_products_of_uniforms_are_gamma():
    law = ThroughputProduct(6, 0.8)
    sample = law.sample(Column(20_000))
    assert stats.kstest(sample, lambda t: 1.0 - law.exceedance(t)).pvalue > 1e-4
    wrong = ThroughputProduct(6, 0.81)
    assert stats.kstest(sample, lambda t: 1.0 - wrong.exceedance(t)).pvalue < 1e-6
