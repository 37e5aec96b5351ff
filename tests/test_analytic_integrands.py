"""General integrands: closed forms against quadrature and 40-digit figures, and the estimator against both."""

import itertools
import math
from fractions import Fraction

import jax
import numpy as np
import pytest
from scipy import integrate, interpolate

import jaxmc as mc
from analytic_scenes import genz, integrands
from jaxmc.testing import SIGMAS, assert_unbiased

A, W = (1.5, 2.0, 0.5, 1.0), (0.3, 0.6, 0.4, 0.7)
PANELS = {1: 40, 2: 8, 3: 1}


def close(value, reference, rel=1e-10):
    assert value == pytest.approx(reference, rel=rel, abs=0)


# Computed once with mpmath, 40 digits, independently of this code: mean, variance or None, a derivative or None.
FIGURES = {
    "oscillatory": (
        lambda: genz.oscillatory(4, a=A, w=0.3),
        (-0.23339131285313468829, 0.34878993689884291785, ("w", (), 4.3173832662774806946)),
    ),
    "product peak": (
        lambda: genz.product_peak(4, a=[5.0] * 4, w=W),
        (17962.879434558546745, None, ("w", 0, 9166.6339130182366970)),
    ),
    "corner peak": (
        lambda: genz.corner_peak(4, a=A),
        (0.0052669552669552669553, None, ("a", 0, -0.0027987036990764744492)),
    ),
    "Gaussian peak": (
        lambda: genz.gaussian_peak(4, a=A, w=W),
        (0.50446479070545231653, 0.047930593155216683436, ("w", 0, 0.30929496644466882135)),
    ),
    "continuous": (
        lambda: genz.continuous(4, a=A, w=W),
        (0.28326709576084261838, None, ("w", 0, 0.12073856193175299485)),
    ),
    "discontinuous": (
        lambda: genz.discontinuous(4, a=A, w=W[:2]),
        (0.97984665913659864754, 5.7319633616858904266, ("w", 0, 4.0559717739740674451)),
    ),
    "linear product": (
        lambda: integrands.linear_product(8, c=np.arange(1, 9) / 8),
        (1.0, 0.29498751161197314202, ("c", 0, 0.0)),
    ),
    "g-function": (
        lambda: integrands.sobol_g(4, a=(0.0, 1.0, 4.5, 9.0)),
        (1.0, 0.46522905825936128966, ("a", 0, 0.0)),
    ),
    "simplex": (
        lambda: integrands.simplex(5, 0.8),
        (0.0027306666666666666667, None, ("s", (), 0.017066666666666666667)),
    ),
    "half-space": (lambda: integrands.simplex(3, 1.3), (0.35266666666666666667, None, ("s", (), 0.71))),
    "power": (lambda: integrands.power(1, 0.2), (1.25, 0.10416666666666666667, ("a", (), 1.5625))),
}


@pytest.mark.parametrize("name", FIGURES)
def test_figures_with_40_digits(name):
    make, (mean, variance, (argument, item, derivative)) = FIGURES[name]
    scene = make()
    close(scene.exact, mean)
    close(np.asarray(scene.derivatives[argument])[item], derivative)
    if variance is not None:
        close(scene.exact_variance, variance)


def points_and_weights(dim, kinks):
    """Return the product of a Gauss-Legendre rule, composed of panels that end at the ``kinks``."""
    ends = np.unique([*np.linspace(0.0, 1.0, PANELS[dim] + 1), *kinks])
    x, weight = np.polynomial.legendre.leggauss(12)
    half = np.diff(ends)[:, None] / 2
    x, weight = (ends[:-1, None] + half * (1 + x)).ravel(), (half * weight).ravel()
    points = np.stack(np.meshgrid(*[x] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return points, math.prod(np.meshgrid(*[weight] * dim, indexing="ij")).ravel()


MAKERS = {
    "oscillatory": genz.oscillatory,
    "product peak": genz.product_peak,
    "corner peak": genz.corner_peak,
    "Gaussian peak": genz.gaussian_peak,
    "continuous": genz.continuous,
    "discontinuous": genz.discontinuous,
    "linear product": integrands.linear_product,
    "g-function": integrands.sobol_g,
    "spikes": lambda dim: integrands.spikes(dim, volume=2.0**-5),
    "firefly": lambda dim: integrands.firefly(dim, p=0.5**dim, A=50.0),  # its edge is a kink of the quadrature
}
CASES = [("discontinuous", 1), ("spikes", 1), ("corner peak", 2), ("spikes", 2), *((name, 3) for name in MAKERS)]


@pytest.mark.parametrize("name, dim", CASES)
def test_moments_against_quadrature(name, dim):
    scene = MAKERS[name](dim)
    points, weight = points_and_weights(dim, [0.5, *np.sqrt(2.0) * np.arange(1, 4) % 1.0])
    with jax.enable_x64(True):
        values = np.asarray(scene.integrand.batch(points))
    mean = weight @ values
    variance = weight @ (values - mean) ** 2
    close(scene.exact, mean, 1e-9)
    close(scene.exact_variance, variance, 1e-9)
    close(scene.exact_kurtosis, weight @ (values - mean) ** 4 / variance**2, 1e-9)


@pytest.mark.parametrize("dim", [4, 12])
def test_corner_peak_against_the_sum_over_corners_in_rational_numbers(dim):
    scene = genz.corner_peak(dim)
    a = [Fraction(x) for x in np.asarray(scene.integrand.params[0]).tolist()]

    def moment(q):
        power = q * (dim + 1) - dim  # what dim integrations leave of the exponent
        corners = itertools.product((0, 1), repeat=dim)
        total = sum(Fraction((-1) ** sum(v)) / (1 + sum(itertools.compress(a, v))) ** power for v in corners)
        return total / math.prod(a) / math.prod(range(power, power + dim))

    mean = moment(1)
    close(scene.exact, float(mean), 1e-12)
    if dim < 12:
        close(scene.exact_variance, float(moment(2) - mean**2), 1e-11)


@pytest.mark.parametrize("s", [0.3, 1.0, 2.7, 3.0, 4.9])
def test_simplex_against_a_spline(s):
    density = interpolate.BSpline.basis_element(np.arange(6))
    scene = integrands.simplex(5, s)
    close(scene.exact, float(density.integrate(0.0, s)))
    close(scene.derivatives["s"], float(density(s)))
    close(scene.exact_variance, scene.exact * (1 - scene.exact))


def test_simplex_in_many_dimensions_is_as_likely_as_not():
    assert integrands.irwin_hall(200, 100.0)[0] == 0.5
    close(integrands.irwin_hall(30, 1.0)[0], 1 / math.factorial(30), 1e-15)


@pytest.mark.parametrize("a", [0.1, 0.2, 0.3, 0.6])
def test_power_against_quadrature(a):
    scene = integrands.power(3, a)

    def moment(q, center=0.0):
        terms = ((-center) ** (q - j) * math.comb(q, j) * singular(j) ** 3 for j in range(q + 1))
        return sum(terms)

    def singular(j):
        return integrate.quad(lambda x: 1.0, 0, 1, weight="alg", wvar=(-j * a, 0.0))[0]

    mean = moment(1)
    close(scene.exact, mean, 1e-9)
    assert (scene.exact_variance is None) == (a >= 1 / 2)
    assert (scene.exact_kurtosis is None) == (a >= 1 / 4)
    if a < 1 / 2:
        close(scene.exact_variance, moment(2, mean), 1e-9)
    if a < 1 / 4:
        close(scene.exact_kurtosis, moment(4, mean) / moment(2, mean) ** 2, 1e-9)


@pytest.mark.parametrize("a, loss", [(0.3, 3e-8), (0.6, 6e-5)])
def test_what_float32_loses_of_a_power(a, loss):
    step, count = 2.0**-32, 2**12
    found = step * np.sum((step * (0.5 + np.arange(count))) ** -a)
    exact = (step * count) ** (1 - a) / (1 - a)
    assert (exact - found) * (1 - a) == pytest.approx(loss, rel=0.15)


DIFFERENTIATED = {
    "oscillatory": (genz.oscillatory, {"a": A, "w": 0.3}),
    "product peak": (genz.product_peak, {"a": A, "w": W}),
    "corner peak": (genz.corner_peak, {"a": A}),
    "Gaussian peak": (genz.gaussian_peak, {"a": A, "w": W}),
    "continuous": (genz.continuous, {"a": A, "w": W}),
    "discontinuous": (genz.discontinuous, {"a": A, "w": W[:2]}),
    "simplex": (integrands.simplex, {"s": 1.7}),
    "power": (integrands.power, {"a": 0.3}),
    "firefly": (integrands.firefly, {"p": 0.1, "A": 20.0, "background": 0.5}),
    "spikes": (integrands.spikes, {"volume": 0.01}),
}


@pytest.mark.parametrize("name", DIFFERENTIATED)
def test_derivatives_against_finite_differences(name):
    make, arguments = DIFFERENTIATED[name]
    derivatives = make(4, **arguments).derivatives
    assert set(derivatives) == set(arguments)
    for argument, value in arguments.items():
        value = np.asarray(value, float)
        step = 1e-4 * value * np.linspace(1.0, 2.0, value.size).reshape(value.shape)  # a direction of its own
        up, down = (make(4, **{**arguments, argument: value + sign * step}).exact for sign in (1, -1))
        close(np.sum(derivatives[argument] * step), (up - down) / 2, 1e-6)


@pytest.fixture(scope="module")
def defaults():
    return integrands.default_integrands()


@pytest.fixture(scope="module")
def heavy():
    return integrands.heavy_integrands()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(11))
def test_estimate_of_a_default_integrand(defaults, number):
    scene, n = defaults[number], 2**20
    estimate = mc.integrate(scene.integrand, n=n, key=1)
    relative = math.sqrt(scene.exact_variance / n) / scene.exact
    assert relative < 0.005
    assert_unbiased(estimate, scene.exact, 1.1 * relative)
    assert_unbiased(estimate, scene.exact, 1.1 * relative, variance=scene.exact_variance)
    variance_stderr = scene.exact_variance * math.sqrt((scene.exact_kurtosis - 1) / n)
    assert abs(estimate.variance - scene.exact_variance) <= SIGMAS * variance_stderr


@pytest.mark.slow
def test_estimates_of_heavy_integrands(heavy):
    scenes = [scene for scene in heavy if scene.exact_variance is not None]
    assert len(scenes) == 3
    for scene in scenes:
        estimate = mc.integrate(scene.integrand, n=2**21, key=1)
        assert_unbiased(estimate, scene.exact, 0.03, variance=scene.exact_variance)


def test_defaults_are_eleven_and_names_are_unique(defaults, heavy):
    assert len(defaults) == 11
    assert len({scene.name for scene in defaults + heavy}) == 15


def test_an_almost_constant_integrand_has_no_kurtosis():
    scene = genz.gaussian_peak(4, difficulty=0.1)
    assert scene.exact_kurtosis is None
    assert 0 < scene.exact_variance < 1e-6


@pytest.mark.parametrize(
    "make", [*list(MAKERS.values())[:-1], integrands.firefly, integrands.simplex, integrands.power]
)
@pytest.mark.parametrize("dim", [0, 2.0, True, "2"])
def test_bad_dimension(make, dim):
    with pytest.raises(ValueError, match="dim must be a positive integer, got"):
        make(dim)


BAD = {
    "difficulty 0": lambda: genz.oscillatory(difficulty=0.0),
    "difficulty NaN": lambda: genz.corner_peak(difficulty=math.nan),
    "negative a": lambda: genz.gaussian_peak(2, a=(1.0, -1.0)),
    "shape of a": lambda: genz.continuous(3, a=(1.0, 2.0)),
    "w outside": lambda: genz.product_peak(2, w=(0.5, 1.5)),
    "w NaN": lambda: genz.oscillatory(2, w=math.nan),
    "w missing": lambda: genz.oscillatory(2, w=None),
    "shape of w": lambda: genz.discontinuous(3, w=(0.5, 0.5, 0.5)),
    "too many dimensions": lambda: genz.corner_peak(1001),
    "out of float64": lambda: genz.product_peak(200),
    "c": lambda: integrands.linear_product(2, c=math.inf),
    "shape of c": lambda: integrands.linear_product(2, c=(1.0, 2.0, 3.0)),
    "a of g": lambda: integrands.sobol_g(2, a=-0.1),
    "s": lambda: integrands.simplex(2, s=2.0),
    "s NaN": lambda: integrands.simplex(2, s=math.nan),
    "infinite mean": lambda: integrands.power(a=1.0),
    "p": lambda: integrands.firefly(p=0.0),
    "A": lambda: integrands.firefly(A=math.inf),
    "count": lambda: integrands.spikes(count=17),
    "fractional count": lambda: integrands.spikes(count=2.5),
    "volume": lambda: integrands.spikes(volume=0.0),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments(name):
    with pytest.raises(ValueError, match=r"got|float64"):
        BAD[name]()
