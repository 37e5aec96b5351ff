"""Rectangles sampled by solid angle: the density against samples, Jacobian and closed forms, near, far and at edges."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from analytic_scenes import parallelogram_irradiance, rectangle_solid_angle
from analytic_scenes.scene import value_of
from jaxmc.testing import assert_jacobian, assert_samples_pdf, assert_unbiased, directions
from jaxmc.transport.rectangles import inverse_pdf_rectangle_light, rectangle_light, sample_rectangle_light
from jaxmc.transport.vec import Vec3, dot

ORIGIN = Vec3(0.0, 0.0, 0.0)
EDGE_U, EDGE_V = np.array([0.48, 0.6, 0.64]), np.array([0.8, 0.0, -0.6])
NORMAL = np.cross(EDGE_U, EDGE_V)


def light_at(x, y, z, half_u, half_v):
    """Return a tilted rectangle whose centre is at (x, y) along its edges and at ``z`` before it, seen from 0."""
    center = EDGE_U * x + EDGE_V * y - NORMAL * z
    vectors = (center, EDGE_U * half_u, EDGE_V * half_v, NORMAL)
    return rectangle_light(*(Vec3(*jnp.asarray(v, float)) for v in vectors))


# Place of the rectangle, and the directions that enclose it.
PLACES = {
    "ahead": ((0.1, -0.2, 1.5, 0.6, 0.9), (0.8, (16, 32))),
    "aside": ((-2.0, 1.5, 0.5, 0.7, 0.3), (0.5, (16, 32))),
    "just above": ((0.2, 0.1, 0.05, 1.0, 0.6), (math.pi / 2, (16, 24))),
    "above an edge": ((1.0, 0.1, 0.1, 1.0, 0.6), (math.pi / 2, (16, 32))),
    "far": ((3.0, -20.0, 30.0, 0.6, 0.9), (0.035, (16, 32))),
    "long": ((0.0, 1.0, 0.5, 0.05, 20.0), (math.pi / 2, (16, 64))),
}
QUICK = {"just above"}
NAMES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in PLACES]


def drawn(name):
    """Return how directions are drawn, the density of one that hits, and whether one hits."""
    (x, y, z, half_u, half_v), _ = PLACES[name]
    light = light_at(x, y, z, half_u, half_v)

    def hits(w):
        height = -dot(Vec3(*NORMAL), w)
        reach = z / jnp.maximum(height, 1e-9)
        u = (dot(Vec3(*EDGE_U), w) * reach - x) / half_u
        v = (dot(Vec3(*EDGE_V), w) * reach - y) / half_v
        return (height > 0.0) & (jnp.maximum(jnp.abs(u), jnp.abs(v)) <= 1.0)

    def sample(u):
        return sample_rectangle_light(light, ORIGIN, False, u[0], u[1])[0]

    return sample, lambda w: 1.0 / inverse_pdf_rectangle_light(light, ORIGIN), hits


def domain_of(name):
    (x, y, z, *_), (half_angle, bins) = PLACES[name]
    toward = -NORMAL if half_angle > 1.0 else x * EDGE_U + y * EDGE_V - z * NORMAL
    return directions(toward, half_angle, bins)


@pytest.mark.parametrize("name", NAMES)
def test_samples_follow_the_density(name):
    sample, pdf, hits = drawn(name)
    result = assert_samples_pdf(sample, lambda w: jnp.where(hits(w), pdf(w), 0.0), domain_of(name))
    assert result.cells >= 50


@pytest.mark.parametrize("name", NAMES)
def test_the_density_is_that_of_the_map(name):
    sample, pdf, _ = drawn(name)
    assert_jacobian(sample, pdf, tolerance=1e4 * float(np.finfo(jnp.result_type(float)).eps))


def places(kind, n=4096):
    """Return centres and half edges of many rectangles, float32 numbers."""
    rng = np.random.default_rng(len(kind))
    x, y = rng.uniform(-3.0, 3.0, (2, n))
    half_u, half_v = 10.0 ** rng.uniform(-1.0, 1.0, (2, n))
    z = 10.0 ** rng.uniform(-1.0, 1.0, n)
    if kind == "tiny":
        half_u, half_v = 10.0 ** rng.uniform(-4.0, -2.0, (2, n))
    elif kind == "near the plane":
        z = 10.0 ** rng.uniform(-4.0, -2.0, n)
    elif kind == "above an edge":
        x, z = half_u + 1e-3 * rng.normal(size=n), 10.0 ** rng.uniform(-3.0, -1.0, n)
    elif kind == "long":
        half_u, half_v = 100.0 * half_u, 0.1 * half_v
    return [np.asarray(a, np.float32) for a in (x, y, z, half_u, half_v)]


def axis_aligned(x, y, z, half_u, half_v):
    kind = jnp.result_type(float)
    x, y, z, half_u, half_v = (jnp.asarray(a, kind) for a in (x, y, z, half_u, half_v))
    zero, one = jnp.zeros((), kind), jnp.ones((), kind)
    return rectangle_light(Vec3(x, y, z), Vec3(half_u, zero, zero), Vec3(zero, half_v, zero), Vec3(zero, zero, -one))


@jax.jit
@jax.vmap
def solid_angles(*place):
    return inverse_pdf_rectangle_light(axis_aligned(*place), ORIGIN)


@jax.jit
@jax.vmap
def samples(u1, u2, *place):
    return sample_rectangle_light(axis_aligned(*place), ORIGIN, False, u1, u2)


# In float32: the relative error of a solid angle, the largest and that of 99 in 100; the largest error of a share u1.
# A rectangle that is a milliradian wide is as wide as 1e4 rounding errors of a direction.
TOLERANCES = {
    "anywhere": (1e-5, 1e-6, 1e-5),
    "tiny": (2e-6, 1e-6, 2e-2),
    "near the plane": (1e-3, 1e-6, 1e-4),
    "above an edge": (1e-3, 1e-4, 1e-3),
    "long": (1e-5, 1e-6, 2e-6),
}


@pytest.mark.parametrize("kind", TOLERANCES)
def test_solid_angle(kind):
    x, y, z, half_u, half_v = places(kind)
    value = np.asarray(solid_angles(x, y, z, half_u, half_v), np.float64)

    def corner(a, b):
        a, b, c = (np.asarray(v, np.longdouble) for v in (a, b, z))
        return np.arctan(a * b / (c * np.sqrt(a * a + b * b + c * c)))

    x, y, half_u, half_v = (np.asarray(v, np.longdouble) for v in (x, y, half_u, half_v))
    exact = sum(i * j * corner(x + i * half_u, y + j * half_v) for i in (-1, 1) for j in (-1, 1))
    error = np.asarray(np.abs(value / exact - 1.0), np.float64)
    most, nearly, _ = TOLERANCES[kind]
    assert error.max() < most
    assert np.quantile(error, 0.99) < nearly


@pytest.mark.parametrize("kind", TOLERANCES)
def test_the_line_across_leaves_the_right_share(kind):
    """The direction of every sample has u1 of the solid angle on one side and u2 of the rest below it."""
    place = places(kind)
    rng = np.random.default_rng(3)
    u1, u2 = rng.random((2, len(place[0]))).astype(np.float32)
    wi, distance, _ = samples(u1, u2, *place)
    x, y, z, half_u, half_v = (np.asarray(v, np.longdouble) for v in place)
    wi = [np.asarray(v, np.longdouble) for v in wi]
    assert np.max(np.abs(sum(v * v for v in wi) - 1.0)) < 1e-6
    np.testing.assert_allclose(np.float64(wi[2] * np.asarray(distance)), np.float64(z), rtol=1e-5)
    swap = half_v > half_u  # the line runs across the longer edge
    a, b, along, across = (np.where(swap, q, p) for p, q in ((x, y), (y, x), (half_u, half_v), (half_v, half_u)))
    at = np.where(swap, wi[1], wi[0]) / wi[2] * z

    def corner(s, t):
        return np.arctan(s * t / (z * np.sqrt(s * s + t * t + z * z)))

    def beyond(s):
        return (
            corner(a + along, b + across)
            - corner(a + along, b - across)
            - corner(s, b + across)
            + corner(s, b - across)
        )

    share = np.float64(1.0 - beyond(at) / beyond(a - along))
    share = np.where(a < 0.0, 1.0 - share, share)
    assert np.max(np.abs(share - u1)) < TOLERANCES[kind][2]


@pytest.mark.parametrize("degrees", [50.0, pytest.param(0.0, marks=pytest.mark.slow)])
def test_irradiance(degrees):
    """Against Lambert's polygon formula, and with less variance than by area."""
    quad = {"corner": (-0.3, -0.2, 0.3), "edge_u": (0.0, 0.8, 0.0), "edge_v": (1.2, 0.0, 0.0)}
    normal = (math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees)))
    exact = value_of(lambda **quad: parallelogram_irradiance(1.0, **quad, normal=jnp.asarray(normal)), quad)
    light = axis_aligned(0.3, 0.2, 0.3, 0.6, 0.4)

    def by_solid_angle(u):
        wi, _, inverse_pdf = sample_rectangle_light(light, ORIGIN, False, u[0], u[1])
        return jnp.maximum(dot(wi, Vec3(*normal)), 0.0) * inverse_pdf

    def by_area(u):
        to_light = Vec3(1.2 * u[0] - 0.3, 0.8 * u[1] - 0.2, 0.3)
        squared = dot(to_light, to_light)
        return jnp.maximum(dot(to_light, Vec3(*normal)), 0.0) * 0.3 * 0.96 / (squared * squared)

    estimate = mc.integrate(by_solid_angle, dim=2, n=1 << 16)
    assert_unbiased(estimate, exact, rel_precision=0.01)
    assert estimate.variance < 0.3 * mc.integrate(by_area, dim=2, n=1 << 16).variance


def test_what_cannot_be_seen_has_no_density():
    behind, level = axis_aligned(0.1, 0.2, -1.0, 0.6, 0.9), axis_aligned(0.1, 0.2, 0.0, 0.6, 0.9)
    ahead = axis_aligned(0.1, 0.2, 1.0, 0.6, 0.9)
    for light, own in ((behind, False), (level, False), (level, True), (ahead, True)):
        wi, distance, inverse_pdf = sample_rectangle_light(light, ORIGIN, own, 0.3, 0.6)
        assert inverse_pdf == 0.0
        assert np.isfinite([*wi, distance]).all()
    assert inverse_pdf_rectangle_light(behind, ORIGIN) == 0.0
    assert inverse_pdf_rectangle_light(level, ORIGIN) == 0.0
    assert inverse_pdf_rectangle_light(ahead, ORIGIN) > 0.0


def test_size_does_not_matter():
    """Lengths of a micrometre or a million kilometres give the same directions."""
    for scale in (1e-6, 1e9):
        small = sample_rectangle_light(
            axis_aligned(*(scale * v for v in (0.1, 0.2, 1.0, 0.6, 0.9))), ORIGIN, False, 0.3, 0.6
        )
        plain = sample_rectangle_light(axis_aligned(0.1, 0.2, 1.0, 0.6, 0.9), ORIGIN, False, 0.3, 0.6)
        np.testing.assert_allclose(np.array(small[0]), np.array(plain[0]), atol=1e-6)
        assert small[1] == pytest.approx(float(plain[1]) * scale, rel=1e-5)
        assert small[2] == pytest.approx(float(plain[2]), rel=1e-5)


def test_derivatives_are_finite_everywhere():
    def everything(place, u1, u2):
        light = axis_aligned(*place)
        wi, distance, inverse_pdf = sample_rectangle_light(light, ORIGIN, False, u1, u2)
        return sum(wi) + distance + inverse_pdf + inverse_pdf_rectangle_light(light, ORIGIN)

    last = 1.0 - float(np.finfo(np.float32).epsneg)
    cases = [
        ((x, y, z, half_u, half_v), u1, u2)
        for x in (0.0, 0.5, -3.0)
        for y in (0.0, 0.2, 3.0)
        for z in (-1.0, 0.0, 1e-7, 1e-3, 1.0, 1e3)
        for half_u, half_v in ((0.5, 0.2), (1e-4, 1e-4), (100.0, 0.01))
        for u1 in (0.0, 0.3, last)
        for u2 in (0.0, 0.5, last)
    ]
    cases = jax.tree.map(lambda *x: jnp.array(x, float), *cases)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(everything, argnums=(0, 1, 2))))(*cases)
    assert np.isfinite(values).all()
    assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes))


def test_the_derivative_of_the_solid_angle():
    """dS/dz against the derivative of the sum over corners, in float64."""
    with jax.enable_x64(True):
        z = jnp.array([0.05, 0.5, 5.0])
        mine = jax.grad(lambda z: inverse_pdf_rectangle_light(axis_aligned(0.3, -0.2, z, 0.6, 0.4), ORIGIN))
        corners = jax.grad(lambda z: rectangle_solid_angle(-0.3, 0.9, -0.6, 0.2, z))
        np.testing.assert_allclose(jax.jit(jax.vmap(mine))(z), jax.jit(jax.vmap(corners))(z), rtol=1e-10)


# ---------------------------------------------------------------------------------------------------- mutants


def uniform_by_area(u):
    target = EDGE_U * 0.6 * (2 * u[0] - 1.0) + EDGE_V * 0.9 * (2 * u[1] - 1.0) + EDGE_U * 0.1 - EDGE_V * 0.2
    target = target - NORMAL * 1.5
    return Vec3(*(target / jnp.sqrt(target @ target)))


def height_by_angle(u):
    """The place on the line uniform in the angle to it, not in its sine."""
    light = light_at(*PLACES["ahead"][0])
    low, high = (sample_rectangle_light(light, ORIGIN, False, u[0], end)[0] for end in (0.0, 1.0 - 1e-7))
    apart = jnp.arccos(dot(low, high))
    return low * (jnp.sin((1.0 - u[1]) * apart) / jnp.sin(apart)) + high * (jnp.sin(u[1] * apart) / jnp.sin(apart))


MUTANTS = {
    "uniform by area": (uniform_by_area, 1.0),
    "half the solid angle": (None, 0.5),
    "2 % off": (None, 1.02),
    "angle, not sine": (height_by_angle, 1.0),
}


@pytest.mark.parametrize(
    "name", ["uniform by area", *(pytest.param(name, marks=pytest.mark.slow) for name in MUTANTS if name[0] != "u")]
)
def test_checks_find_a_mutant(name):
    sample, pdf, hits = drawn("ahead")
    wrong, factor = MUTANTS[name]
    sample = wrong or sample
    with pytest.raises(AssertionError, match=r"n = "):
        assert_samples_pdf(sample, lambda w: jnp.where(hits(w), factor * pdf(w), 0.0), domain_of("ahead"), n=1 << 18)
    with pytest.raises(AssertionError, match="density times Jacobian"):
        assert_jacobian(sample, lambda w: factor * pdf(w), tolerance=1e-3)
