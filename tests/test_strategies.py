"""Control variates and mixtures of sampling techniques: integrals, variances and gradients with closed forms."""

import dataclasses
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import jaxmc as mc
from jaxmc.integration import mixtures, samplers
from jaxmc.integration.controls import control_variates
from jaxmc.integration.mixtures import mixture, one_sample_mixture, optimal_mixture
from jaxmc.integration.samplers import pilot_key
from jaxmc.integration.techniques import Space, Technique, space_of
from jaxmc.testing import assert_unbiased
from jaxmc.transport.vec import Vec3
from jaxmc.transport.warps import pdf_cosine_hemisphere, sample_cosine_hemisphere

N = 1 << 17
COUNTS = (2, 1, 3)

# A peak of width S times a slope, in each coordinate of (0, 1)^d: one technique follows the peak, one the slope, one
# neither.

S = 0.1
REACH = np.arctan(0.5 / S)


def peak(x):
    return 1.0 / ((x - 0.5) ** 2 + S * S)


def peak_and_slope(x):
    return jnp.prod(peak(x) * (1.0 + x))


def sample_peak(u):
    return 0.5 + S * jnp.tan((2.0 * u - 1.0) * REACH)


def pdf_peak(x):
    return jnp.prod(peak(x) * (0.5 * S / REACH))


def sample_slope(u):
    return jnp.sqrt(1.0 + 3.0 * u) - 1.0


def pdf_slope(x):
    return jnp.prod((1.0 + x) / 1.5)


def techniques_in(d):
    return [
        Technique(sample_peak, pdf_peak, d),
        Technique(sample_slope, pdf_slope, d),
        Technique(lambda u: u, lambda x: 1.0, d),
    ]


EXACT = 1.5 * 2.0 * REACH / S
LINE = techniques_in(1)
BALANCE = partial(mixture, weights="balance")
POWER = partial(mixture, weights="power")
MULTI = {"balance": BALANCE, "power": POWER, "optimal": optimal_mixture}
one_sample = partial(one_sample_mixture, probabilities=(0.5, 0.2, 0.3))

# The irradiance, over pi, that a disk of radius R in the height 1 above a surface sends straight down on it, by
# directions: drawn by their cosine, or as points of the disk.

R = 0.5
DISK = R * R / (1.0 + R * R)


def in_disk(w):
    return w.x**2 + w.y**2 < (R * w.z) ** 2


def from_disk(w):
    return jnp.where(in_disk(w), w.z / np.pi, 0.0)


def sample_disk(u):
    w = sample_cosine_hemisphere(u[0], u[1])  # its x and y are uniform on the unit disk
    scale = 1.0 / jnp.sqrt(R * R * (w.x**2 + w.y**2) + 1.0)
    return Vec3(R * w.x * scale, R * w.y * scale, scale)


def pdf_disk(w):
    return jnp.where(in_disk(w), 1.0 / (np.pi * R * R * w.z**3), 0.0)


BY_COSINE = Technique(lambda u: sample_cosine_hemisphere(u[0], u[1]), lambda w: pdf_cosine_hemisphere(w.z), 2)
BY_DISK = Technique(sample_disk, pdf_disk, 2)


def estimate(f, n=N, key=0):
    """Return what ``assert_unbiased`` reads of the estimate from the same samples as ``mc.integrate``, which would take
    longer to compile.
    """
    values = np.asarray(mc.draw(f, n=n, key=key).value, np.float64)
    nonfinite = np.count_nonzero(~np.isfinite(values))
    return SimpleNamespace(mean=values.mean(0), variance=values.var(0, ddof=1), n=n, nonfinite=nonfinite)


def check(f, exact, precision=3e-3):
    assert_unbiased(estimate(f), exact, precision)


def each_of_multi(g, techniques, counts=None):
    """Return the values with all weights, with one leading axis, from the same samples."""
    fs = [make(g, techniques, counts=counts) for make in MULTI.values()]
    return mc.Integrand(lambda u: jnp.stack([f(u) for f in fs]), fs[0].dim)


# ---------------------------------------------------------------------------------------- mixtures: the integral


@pytest.mark.slow
@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_mixture_has_the_same_integral(d):
    f = each_of_multi(peak_and_slope, techniques_in(d), COUNTS)
    assert f.dim == 6 * d
    check(f, EXACT**d)


@pytest.mark.parametrize("d", [1, 3])
def test_one_sample_of_a_mixture_has_the_same_integral(d):
    f = one_sample(peak_and_slope, techniques_in(d))
    assert f.dim == 1 + d
    check(f, EXACT**d)


def test_light_from_a_disk():
    check(each_of_multi(from_disk, [BY_COSINE, BY_DISK]), DISK)
    check(one_sample_mixture(from_disk, [BY_COSINE, BY_DISK], (0.5, 0.5)), DISK)


@pytest.mark.slow
def test_the_driver_takes_them_all():
    fs = [make(peak_and_slope, LINE) for make in [*MULTI.values(), one_sample]]
    fs.append(control_variates(fs[0], lambda u: u[2], 0.5).integrand)
    assert_unbiased(mc.integrate(lambda u: jnp.stack([f(u[: f.dim]) for f in fs]), dim=3, n=N), [EXACT] * 5, 2e-3)


@pytest.mark.slow
def test_values_may_be_arrays():
    def g(x):
        return jnp.outer(jnp.array([1.0, 2.0]), jnp.stack([peak_and_slope(x), 1.0 + x[0], 1.0]))

    exact = np.outer([1.0, 2.0], [EXACT, 1.5, 1.0])
    check(each_of_multi(g, LINE, COUNTS), exact)
    check(one_sample(g, LINE), exact, 1e-2)


def half(k):
    """Return the technique that is uniform on half ``k`` of (0, 1)."""
    return Technique(lambda u: 0.5 * (k + u), lambda x: jnp.where((x[0] < 0.5) == (k == 0), 2.0, 0.0), 1)


def test_supports_need_not_overlap():
    def g(x):
        return jnp.where(x[0] < 0.5, 1.0, 3.0) + x[0]

    f = each_of_multi(g, [half(0), half(1)])
    check(f, 2.5)
    # This is stratified sampling: each half is worth 1/2, and x varies by 1/48 within it.
    assert estimate(f, n=N).variance == pytest.approx(2.0 * 0.5**2 / 48.0, rel=0.02)
    check(one_sample_mixture(g, [half(0), half(1)], (0.3, 0.7)), 2.5)


# ---------------------------------------------------------------------------------------- mixtures: the variance

NODES, AREAS = special.roots_legendre(4000)
X, DX = 0.5 + 0.5 * NODES, 0.5 * AREAS


def line(function):
    return np.broadcast_to(np.asarray(jax.vmap(function)(X[:, None]), np.float64), X.shape)


G, P = line(peak_and_slope), np.stack([line(t.pdf) for t in LINE])
D = np.asarray(COUNTS) @ P


def variance_with(alpha):
    """Return the variance of the optimal mixture's estimator, with any alpha, by quadrature."""
    h = (G - alpha @ P) / D
    return (h * h * D) @ DX - np.asarray(COUNTS) @ ((P * h) @ DX) ** 2


def normal_equations():
    return (P * DX / D) @ P.T, (P * DX / D) @ G


def test_the_optimal_weights_are_optimal():
    A, b = normal_equations()
    best = np.linalg.solve(A, b)
    least = (G * G / D) @ DX - best @ b
    assert best.sum() == pytest.approx(EXACT, rel=1e-5)
    assert variance_with(best) == pytest.approx(least, rel=1e-4)
    assert variance_with(best + 7.0 * np.asarray(COUNTS)) == pytest.approx(least, rel=1e-4)
    steps = np.random.default_rng(0).normal(size=(50, 3))
    assert all(variance_with(best + step) >= least * (1.0 - 1e-9) for step in steps)

    f = optimal_mixture(peak_and_slope, LINE, COUNTS)
    alpha = np.asarray(f.params[0])
    assert variance_with(alpha) == pytest.approx(least, rel=0.01)
    assert estimate(f, n=N).variance == pytest.approx(variance_with(alpha), rel=0.02)
    balance = estimate(mixture(peak_and_slope, LINE, counts=COUNTS), n=N).variance
    assert balance == pytest.approx(variance_with(np.zeros(3)), rel=0.02)
    assert least < 0.01 * balance


def test_optimal_weights_are_no_worse_than_the_balance_heuristic_elsewhere():
    for g, techniques in [(from_disk, [BY_COSINE, BY_DISK]), (peak_and_slope, techniques_in(3))]:
        balance, best = (estimate(f(g, techniques), n=N).variance for f in (mixture, optimal_mixture))
        assert best < 1.01 * balance


def test_optimal_weights_know_a_sum_of_densities():
    f = optimal_mixture(lambda x: 3.0 * pdf_peak(x) - 2.0 * pdf_slope(x), LINE, COUNTS)
    run = estimate(f, n=1000)
    assert run.mean == pytest.approx(1.0, abs=1e-4) and run.variance < 1e-8


@pytest.mark.parametrize("counts", [(1, 1, 1), COUNTS, (8, 1, 1)])
def test_the_balance_heuristic_is_within_veachs_bound_of_each_technique(counts):
    run = estimate(mixture(peak_and_slope, LINE, counts=counts), n=N)
    alone = [((G * G / p) @ DX - EXACT**2) / n for p, n in zip(P, counts)]
    bound = (1.0 / min(counts) - 1.0 / sum(counts)) * EXACT**2
    assert run.variance <= 1.02 * (min(alone) + bound)
    # So many samples of the mixture do better than all techniques by themselves with their share of them.
    assert run.variance < min(alone[1:])


def test_a_technique_given_twice_is_one_with_more_samples():
    twice = optimal_mixture(peak_and_slope, [LINE[0], LINE[0], LINE[2]])
    once = optimal_mixture(peak_and_slope, [LINE[0], LINE[2]], (2, 1))
    check(twice, EXACT)
    assert np.abs(twice.params[0]).max() < 10.0 * EXACT
    variances = [estimate(f, n=N).variance for f in (twice, once)]
    assert variances[0] == pytest.approx(variances[1], rel=0.02)


# ---------------------------------------------------------------------------------------- mixtures: the edges

NOWHERE = Technique(lambda u: u, lambda x: 0.0 * x[0], 1)


def test_where_all_densities_vanish_nothing_is_contributed():
    def g(x, a=1.0):
        return jnp.stack([a / x[0], a])

    u = jnp.array([0.3])
    for name in MULTI:
        f = MULTI[name](g, [NOWHERE])
        assert np.array_equal(f.batch(u[None])[0], [0.0, 0.0]), name
        f = MULTI[name](g, [NOWHERE_TOO], params=(2.0,))
        slope = jax.jit(jax.jacfwd(lambda a, f=f: f.fn(u, *f.params[:-1], a)))(2.0)
        assert np.array_equal(slope, [0.0, 0.0]), name
    single = one_sample_mixture(g, [NOWHERE], (1.0,))
    assert np.array_equal(single.batch([[0.1, 0.3]])[0], [0.0, 0.0])


NOWHERE_TOO = Technique(lambda u, a: u, lambda x, a: 0.0 * a, 1)


def test_what_is_not_finite_is_seen():
    strange = Technique(lambda u: u, lambda x: jnp.where(x[0] < 0.5, jnp.nan, 1.0), 1)
    for weights in ("balance", "power"):
        assert estimate(mixture(peak_and_slope, [*LINE, strange], weights=weights), n=1000).nonfinite > 100
    with pytest.raises(ValueError, match="not finite"):
        optimal_mixture(peak_and_slope, [*LINE, strange])


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_the_power_heuristic_neither_overflows_nor_underflows(size):
    def scaled(t):
        return Technique(t.sample, lambda x: size * t.pdf(x), 1)

    u = jnp.array([0.3, 0.6, 0.9])
    f = mixture(lambda x: size * peak_and_slope(x), [scaled(t) for t in LINE], weights="power")
    assert f.batch(u[None])[0] == pytest.approx(float(POWER(peak_and_slope, LINE).batch(u[None])[0]), rel=1e-5)


def test_weights_are_the_ones_of_the_textbook():
    u = jnp.array([0.3, 0.6, 0.9, 0.1])
    x = np.array([sample_peak(u[0]), sample_peak(u[1]), sample_slope(u[2]), u[3]], float)
    c = np.stack([n * jax.vmap(t.pdf)(x[:, None]) * np.ones(4) for t, n in zip(LINE, (2, 1, 1))])
    own = c[[0, 0, 1, 2], range(4)]
    g = np.asarray(jax.vmap(peak_and_slope)(x[:, None]))
    for weights, beta in [("balance", 1), ("power", 2)]:
        w = own**beta / (c**beta).sum(0)
        f = mixture(peak_and_slope, LINE, counts=(2, 1, 1), weights=weights)
        assert f.batch(u[None])[0] == pytest.approx((w * g / own).sum(), rel=1e-5)


def test_the_same_mixture_runs_the_same_kernel():
    for make in [*MULTI.values(), one_sample]:
        assert make(peak_and_slope, LINE).fn == make(peak_and_slope, LINE).fn
    a, b = (optimal_mixture(peak_and_slope, LINE, key=key) for key in (0, 1))
    assert a.fn == b.fn and not np.array_equal(a.params[0], b.params[0])


# ---------------------------------------------------------------------------------------- gradients

POWERS = [
    Technique(lambda u, a: u ** (1.0 / (a + 1.0)), lambda x, a: (a + 1.0) * x[0] ** a, 1),
    Technique(lambda u, a: u, lambda x, a: 1.0, 1),
]


@pytest.mark.parametrize("make", [*MULTI.values(), partial(one_sample_mixture, probabilities=(0.4, 0.6))])
def test_gradients_of_a_mixture(make):
    def g(x, a):
        return x[0] ** a * (1.0 + x[0])

    a = 2.0
    f = make(g, POWERS, params=(a,))
    check(f, 1.0 / (a + 1.0) + 1.0 / (a + 2.0))

    def derivative(u):
        return jax.grad(lambda a: f.fn(u, *f.params[:-1], a))(a)

    check(mc.Integrand(derivative, f.dim), -((a + 1.0) ** -2) - (a + 2.0) ** -2)


def test_gradients_with_control_variates():
    f = mc.Integrand(lambda u, a: jnp.exp(a * u[0]), 1, (1.0,))
    less = control_variates(f, lambda u: u, [0.5]).integrand

    def derivative(u):
        return jax.grad(lambda a: less.fn(u, (a,), *less.params[1:]))(1.0)

    check(mc.Integrand(derivative, 1), 1.0)


# ---------------------------------------------------------------------------------------- control variates


def square_and_line(u):
    return u[0] * u[0] + u[1]


def both_coordinates(u):
    return jnp.stack([u[0], u[1]])


def test_control_variates_leave_1_minus_r_squared():
    # var u^2 = 4/45, var u = cov(u, u^2) = 1/12: of 31/180 is left 4/45 - 1/12 = 1/180, with both coefficients 1.
    f = mc.Integrand(square_and_line, 2)
    less, coefficients, ratio = control_variates(f, both_coordinates, [0.5, 0.5])
    assert coefficients.shape == (2,) and np.allclose(coefficients, 1.0, atol=0.02)
    assert ratio == pytest.approx(1.0 / 31.0, rel=0.05)
    run = estimate(less, n=N)
    assert_unbiased(run, 5.0 / 6.0, 3e-4)
    assert run.variance == pytest.approx(1.0 / 180.0, rel=0.01)


def test_control_variates_of_arrays():
    def f(u):
        return jnp.outer(jnp.array([1.0, -3.0]), jnp.stack([square_and_line(u), u[1], 5.0]))

    less, coefficients, ratio = control_variates(mc.Integrand(f, 2), both_coordinates, [0.5, 0.5])
    assert coefficients.shape == (2, 3, 2) and ratio.shape == (2, 3)
    assert np.allclose(coefficients[:, 1:], [[[0, 1], [0, 0]], [[0, -3], [0, 0]]], atol=1e-5)
    assert np.allclose(ratio, [[1.0 / 31.0, 0.0, 1.0]] * 2, atol=0.002)
    check(less, np.outer([1.0, -3.0], [5.0 / 6.0, 0.5, 5.0]))


def test_controls_may_be_a_number_or_a_lazy_integrand_with_params():
    f = mc.Integrand(lambda u, a: a * jnp.exp(u[0]), 3, (2.0,), lazy=True, labels=("x", "y", "z"))
    for c in [lambda u: u[0], mc.Integrand(lambda u, b: b * u[0], 3, (1.0,), lazy=True)]:
        less, coefficients, ratio = control_variates(f, c, 0.5)
        assert coefficients.shape == (1,) and ratio < 0.02 and less.labels == f.labels
        assert less.lazy == isinstance(c, mc.Integrand)
        check(less, 2.0 * np.expm1(1.0))


def test_controls_that_say_nothing_do_no_harm():
    def idle(u):
        # A constant up to rounding, the same control twice, and scales far apart.
        return jnp.stack([jnp.sin(u[1]) ** 2 + jnp.cos(u[1]) ** 2, u[0], u[0], 1e6 * u[1], 1e-6 * u[1] ** 2])

    f = mc.Integrand(square_and_line, 2)
    less, coefficients, ratio = control_variates(f, idle, [1.0, 0.5, 0.5, 0.5e6, 1e-6 / 3.0])
    assert coefficients[0] == 0.0 and np.allclose(coefficients[1:3], 0.5, atol=0.02)
    assert ratio == pytest.approx(1.0 / 31.0, rel=0.05)
    check(less, 5.0 / 6.0)


def test_pilots_have_samples_of_their_own():
    keys = [*range(1000), 2**64 - 1, jax.random.key(3)]
    seeds = {pilot_key(key) for key in keys}
    assert len(seeds) == len(keys) and min(seeds) > 1000 and seeds.isdisjoint(k for k in keys if isinstance(k, int))
    f = mc.Integrand(lambda u: u, 1)
    run, pilot = (mc.draw(f, n=1 << 14, key=key).u[:, 0] for key in (0, pilot_key(0)))
    assert abs(np.corrcoef(run, pilot)[0, 1]) < 5.0 / np.sqrt(1 << 14)
    less = [control_variates(f, lambda u: u**2, [1.0 / 3.0], key=key).coefficients for key in (0, 0, 1)]
    assert less[0] == less[1] != less[2]


# ---------------------------------------------------------------------------------------- mutants


def fails(f, exact, precision=3e-3):
    with pytest.raises(AssertionError, match="standard errors off"):
        check(f, exact, precision)


@pytest.mark.parametrize("rule", [mixtures._balance, mixtures._power])
def test_weights_that_do_not_sum_to_one_fail(rule):
    class WithoutCounts(Space):
        def dense(self, p):
            return p

    space = space_of(peak_and_slope, LINE, COUNTS, ())
    check(mc.Integrand(mixtures._Weighted(space, rule), space.dim), EXACT)
    sums_to_1_02 = mixtures._Weighted(space, lambda i, g, c: 1.02 * rule(i, g, c))
    all_in_full = mixtures._Weighted(space, lambda i, g, c: g / c[i])
    without_counts = mixtures._Weighted(WithoutCounts(space.g, space.techniques, COUNTS), rule)
    for mutant in (sums_to_1_02, all_in_full, without_counts):
        fails(mc.Integrand(mutant, space.dim), EXACT, 1e-2)


@pytest.mark.parametrize("name", MULTI)
def test_densities_that_are_wrong_fail(name):
    per_area = Technique(sample_disk, lambda w: jnp.where(in_disk(w), 1.0 / (np.pi * R * R), 0.0), 2)
    fails(MULTI[name](from_disk, [BY_COSINE, per_area]), DISK)
    too_large = Technique(sample_peak, lambda x: 1.05 * pdf_peak(x), 1)
    fails(MULTI[name](peak_and_slope, [too_large, LINE[1]]), EXACT)


def test_a_reused_coordinate_fails():
    class Reused(mixtures._OneSample):
        def __call__(self, u, *params):
            return super().__call__(jnp.concatenate([u[1:2], u[1:]]), *params)

    right = one_sample(peak_and_slope, LINE)
    fails(dataclasses.replace(right, fn=Reused(right.fn.space, right.fn.probabilities)), EXACT)


def refitted(reuse, n=4):
    """Return the optimal mixture with a pilot of n samples for each n of the run: its own, or the same.

    The ridge keeps small pilots from a system that is nearly singular: any alpha is unbiased, if it is independent.
    """
    space = space_of(peak_and_slope, LINE, (1, 1, 1), ())

    def mean(u):
        pilot, run = u.reshape(2, n, space.dim)
        x, y = jax.vmap(mixtures._Regression(space))(pilot)
        rows = x.reshape(-1, 3)
        alpha = jnp.linalg.solve(rows.T @ rows + 0.01 * jnp.eye(3), rows.T @ y.ravel())
        return jax.vmap(mixtures._Optimal(space), (0, None))(pilot if reuse else run, alpha).mean()

    return mc.Integrand(mean, 2 * n * space.dim)


def controlled(reuse, n=4):
    """Return the mean of u^2 controlled by u, with a coefficient from n samples of its own, or from the same."""

    def mean(u):
        pilot, run = u.reshape(2, n)
        centred = pilot - pilot.mean()
        beta = (centred * pilot**2).sum() / ((centred**2).sum() + 0.01)
        run = pilot if reuse else run
        return (run**2 - beta * (run - 0.5)).mean()

    return mc.Integrand(mean, 2 * n)


@pytest.mark.parametrize("make, exact", [(refitted, EXACT), (controlled, 1.0 / 3.0)])
def test_fitting_to_the_samples_that_are_averaged_is_biased(make, exact):
    check(make(reuse=False), exact)
    fails(make(reuse=True), exact)


def test_the_key_of_the_pilot_is_not_for_the_run(monkeypatch):
    # With the pilot's key, and no more samples than the pilot has, the average is fitted to its own samples.
    f = optimal_mixture(peak_and_slope, LINE, n=8)
    own = estimate(f, n=8, key=pilot_key(0))
    assert own.mean == pytest.approx(float(f.params[0].sum()), rel=1e-4)
    monkeypatch.setattr(samplers, "PILOT", 1)
    assert not np.array_equal(optimal_mixture(peak_and_slope, LINE, n=8).params[0], f.params[0])


# ---------------------------------------------------------------------------------------- bad arguments

F = mc.Integrand(square_and_line, 2)
PAIR = Technique(lambda u: u, lambda x: 1.0, 2)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: Technique(0.5, pdf_peak, 1), "must be functions, got 0.5.*pass"),
        (lambda: Technique(sample_peak, pdf_peak, 0), "dim must be a positive integer, got 0; pass"),
        (lambda: mixture(peak_and_slope, []), r"at least one Technique, got \(\); pass"),
        (lambda: mixture(peak_and_slope, [sample_peak]), "at least one Technique, got .*sample_peak.*pass"),
        (lambda: mixture(peak_and_slope, LINE, weights="optimal"), "got 'optimal'; .* call optimal_mixture"),
        (lambda: mixture(peak_and_slope, LINE, counts=(1, 2)), r"3 positive integers.*got \(1, 2\); leave out"),
        (lambda: mixture(peak_and_slope, LINE, counts=(1, 2, 0)), r"3 positive integers.*got \(1, 2, 0\); leave out"),
        (lambda: optimal_mixture(peak_and_slope, LINE, (1, 2.5, 1)), r"got \(1, 2.5, 1\); leave out"),
        (lambda: optimal_mixture(peak_and_slope, LINE, n=0), "n must be a positive integer.*got 0"),
        (lambda: mixture(peak_and_slope, [LINE[0], PAIR]), "one structure, shape and type, got .*convert"),
        (lambda: mixture(lambda x: (1.0, 2.0), LINE), "g must return a number or an array, got .*stack"),
        (lambda: mixture(peak_and_slope, [Technique(sample_peak, peak, 1)]), r"technique 0 .* got shape \(1,\); mult"),
        (lambda: one_sample_mixture(peak_and_slope, LINE, (0.5, 0.5)), r"3 numbers >= 0 .*got \[0.5, 0.5\].*divide"),
        (lambda: one_sample_mixture(peak_and_slope, LINE, (0.5, 0.5, 0.02)), "whose sum is 1.02; divide"),
        (lambda: one_sample_mixture(peak_and_slope, LINE, (0.5, 0.7, -0.2)), r"got \[0.5, 0.7, -0.2\]"),
        (lambda: one_sample_mixture(peak_and_slope, LINE, (0.5, 0.5, np.nan)), r"got \[0.5, 0.5, nan\]"),
        (lambda: control_variates(square_and_line, both_coordinates, [0.5, 0.5]), "must be an Integrand, got .*wrap"),
        (lambda: control_variates(F, mc.Integrand(both_coordinates, 3), [0.5, 0.5]), "dim=2, got dim=3; change"),
        (lambda: control_variates(F, both_coordinates, [0.5]), r"the 2 known integrals .*got \[0.5\]"),
        (lambda: control_variates(F, both_coordinates, [0.5, np.inf]), r"finite, got \[0.5, inf\]"),
        (lambda: control_variates(F, both_coordinates, [0.5, 0.5], n=3), "pilot of n=3 .* take at least 4"),
        (lambda: control_variates(F, both_coordinates, [0.5, 0.5], key=-1), "key must be .*got -1"),
        (lambda: control_variates(F, lambda u: jnp.log(u - 0.5), [0.5, 0.5]), r"pilot has \d+ values .*not finite"),
        (lambda: control_variates(F.map(lambda y: {"y": y}), both_coordinates, [0.5, 0.5]), "f must return a number"),
    ],
)
def test_bad_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=f"(?s){words}"):
        call()
