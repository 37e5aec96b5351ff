"""Rough surfaces: what draws against its density, both ways, and the laws that GGX must obey."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.testing import HEMISPHERE, assert_jacobian, assert_samples_pdf, assert_unbiased, directions
from jaxmc.transport import microfacets as ggx
from jaxmc.transport.vec import Vec3, dot, normalize


def eps():
    """Return the rounding error of the precision that JAX runs in."""
    return float(np.finfo(jnp.result_type(float)).eps)


def tilted(degrees, azimuth=0.7):
    """Return a direction at an angle to the normal."""
    theta = math.radians(degrees)
    return Vec3(math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth), math.cos(theta))


def pair(alpha, degrees, bins=(64, 16)):
    """Return sample, density and the sphere of directions about the mirror direction, in bins that are fine there."""
    wo = tilted(degrees)
    return (
        lambda u: ggx.sample_ggx(wo, alpha, u[0], u[1])[0],
        lambda wi: ggx.pdf_ggx(wo, wi, alpha),
        directions((-wo.x, -wo.y, wo.z), bins=bins),
    )


CASES = [(1.0, 0.0), (1.0, 85.0), (0.5, 60.0), (0.25, 30.0), (0.1, 80.0)]
QUICK = {(1.0, 85.0)}
CASES = [case if case in QUICK else pytest.param(*case, marks=pytest.mark.slow) for case in CASES]


@pytest.mark.parametrize(("alpha", "degrees"), CASES)
def test_samples_follow_the_density(alpha, degrees):
    # The density is over the whole sphere: it counts the directions that go below the surface.
    assert assert_samples_pdf(*pair(alpha, degrees)).cells >= 100


@pytest.mark.parametrize(("alpha", "degrees"), CASES)
def test_the_density_is_that_of_the_map(alpha, degrees):
    sample, pdf, _ = pair(alpha, degrees)
    assert_jacobian(sample, pdf, tolerance=4e3 * eps() / alpha)


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, None, 0))
def samples(wo, alpha, u):
    return ggx.sample_ggx(wo, alpha, u[0], u[1])


@functools.cache
def drawn(alpha, degrees, n=1 << 14):
    """Return (wo, wi, density, weight) of many samples, edges of the unit square among them."""
    u = np.random.default_rng(1).random((n, 2)).astype(jnp.result_type(float))
    last = 1.0 - float(np.finfo(np.float32).epsneg)
    edges = np.array([(a, b) for a in (0.0, 2.0**-33, 0.5, last) for b in (0.0, 2.0**-33, 0.5, last)], u.dtype)
    wo = tilted(degrees)
    return wo, *samples(wo, alpha, np.concatenate([edges, u]))


ALL_ANGLES = [(1.0, 89.999), (0.3, 60.0), (0.03, 0.0), (0.03, 89.0), (1e-3, 60.0), (1e-3, 89.999)]


@pytest.mark.parametrize(("alpha", "degrees"), ALL_ANGLES)
def test_sample_agrees_with_density_and_value(alpha, degrees):
    wo, wi, pdf, weight = drawn(alpha, degrees)
    wi = Vec3(*(np.asarray(x, np.float64) for x in wi))
    assert np.isfinite(np.stack([*wi, pdf, weight])).all()
    assert np.all(np.asarray(pdf) > 0.0)
    assert np.all((np.asarray(weight) >= 0.0) & (np.asarray(weight) <= 1.0 + 1e-6))
    assert np.max(np.abs(dot(wi, wi) - 1.0)) < 8 * eps()
    assert np.all((np.asarray(weight) > 0.0) == (wi.z > 16 * eps()))
    with jax.enable_x64(True):
        there = Vec3(*map(jnp.asarray, wi))
        density, value = (np.asarray(f(Vec3(*wo), there, alpha)) for f in (ggx.pdf_ggx, ggx.eval_ggx))
    half = np.sqrt(np.maximum((1.0 + dot(Vec3(*wo), wi)) / 2.0, 1e-16))
    # What rounding of ``wi`` does to the density of its facet normal, as the module says.
    known = 1.3 * eps() / (alpha * half)
    safe = known < 0.02
    error = np.abs(np.asarray(pdf) / density - 1.0)[safe]
    assert safe.mean() > 0.5 or alpha * wo.z < 1e-4
    assert np.all(error < 1e-5 + 2.0 * known[safe])
    upward = safe & (wi.z > 1e-3)
    np.testing.assert_allclose((np.asarray(weight) * density)[upward], value[upward], rtol=1e-5)


@pytest.mark.parametrize("alpha", [1e-3, 0.05, 0.5, 1.0])
def test_reciprocity(alpha):
    a, b = tilted(40.0, 0.3), tilted(39.5, 0.3 + math.pi + 0.2 * alpha)
    forth, back = float(ggx.eval_ggx(a, b, alpha)) / b.z, float(ggx.eval_ggx(b, a, alpha)) / a.z
    assert forth == pytest.approx(back, rel=1e-6)
    assert forth > 0.0


def test_below_the_surface_there_is_nothing():
    up, down = tilted(50.0), tilted(100.0)
    assert ggx.eval_ggx(up, down, 0.5) == 0.0
    assert ggx.eval_ggx(down, up, 0.5) == 0.0
    assert ggx.pdf_ggx(down, up, 0.5) == 0.0
    assert ggx.pdf_ggx(up, down, 0.5) > 0.0  # drawn, and of no weight
    assert ggx.pdf_ggx(up, -up, 0.5) == 0.0


@pytest.mark.parametrize("alpha", [0.5, *(pytest.param(alpha, marks=pytest.mark.slow) for alpha in (0.05, 1.0))])
def test_facets_cover_the_surface_once(alpha):
    """The density of normals is that of slopes drawn by its inverse distribution (Walter et al. 2007)."""

    def normal(u):
        tangent = alpha * jnp.sqrt(u[0] / (1.0 - u[0]))
        angle = 2.0 * math.pi * u[1]
        return normalize(Vec3(tangent * jnp.cos(angle), tangent * jnp.sin(angle), 1.0))

    assert_jacobian(normal, lambda h: ggx.ggx_density(h, alpha) * h.z, tolerance=2e-3)


@pytest.mark.parametrize(("alpha", "degrees"), [(0.2, 85.0), pytest.param(0.5, 60.0, marks=pytest.mark.slow)])
def test_weak_white_furnace(alpha, degrees):
    """Facets that are visible from ``v`` cover what ``v`` sees: G1 times the integral of D max(0, v.h) is cos(v)."""
    v = tilted(degrees)

    def visible(u):
        tangent = alpha * jnp.sqrt(u[0] / (1.0 - u[0]))
        h = normalize(
            Vec3(tangent * jnp.cos(2.0 * math.pi * u[1]), tangent * jnp.sin(2.0 * math.pi * u[1]), jnp.ones_like(u[0]))
        )
        return ggx.smith_g1(v.z, alpha) * jnp.maximum(dot(v, h), 0.0) / h.z

    assert_unbiased(mc.integrate(visible, dim=2, n=1 << 18), v.z, rel_precision=0.01)


@pytest.mark.parametrize("cosine", [0.0, 1e-4, 0.5, 1.0])
def test_masking_functions_agree(cosine):
    other = 0.3
    g1, g2 = float(ggx.smith_g1(cosine, 0.5)), float(ggx.smith_g2(cosine, other, 0.5))
    if cosine > 0.0:
        mine, its = (float(ggx.smith_lambda(c, 0.5)) for c in (cosine, other))
        assert mine == pytest.approx((math.sqrt(1 + 0.25 * (cosine**-2 - 1)) - 1) / 2, rel=1e-5, abs=1e-9)
        assert g1 == pytest.approx(1.0 / (1.0 + mine), rel=1e-5)
        assert g2 == pytest.approx(1.0 / (1.0 + mine + its), rel=1e-5)
    else:
        assert g1 == g2 == 0.0


def test_derivatives_are_finite_everywhere():
    def everything(alpha, wo, u1, u2):
        wo = normalize(Vec3(*wo))
        wi, pdf, weight = ggx.sample_ggx(wo, alpha, u1, u2)
        return sum(wi) + pdf + weight + ggx.pdf_ggx(wo, wi, alpha) + ggx.eval_ggx(wo, wi, alpha)

    last = 1.0 - float(np.finfo(np.float32).epsneg)
    cases = [
        (alpha, (x, 0.0, z), u1, u2)
        for alpha in (1e-3, 0.1, 1.0)
        for x, z in ((0.0, 1.0), (1.0, 1e-3), (1.0, 2e-6))
        for u1 in (0.0, 0.5, last)
        for u2 in (0.0, 2.0**-33, 0.5, last)
    ]
    cases = jax.tree.map(lambda *x: jnp.array(x, float), *cases)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(everything, argnums=(0, 1, 2, 3))))(*cases)
    assert np.isfinite(values).all()
    assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes))


# ---------------------------------------------------------------------------------------------------- mutants


def no_visible_normals(wo, wi, alpha):
    """The density of sampling all normals, not the visible ones."""
    h = normalize(wo + wi)
    return ggx.ggx_density(h, alpha) * h.z / (4.0 * jnp.abs(dot(wo, h)))


WO, FORGOTTEN = tilted(60.0), "the lower hemisphere forgotten"
MUTANTS = {
    "all normals, not the visible ones": lambda wi: no_visible_normals(WO, wi, 0.5),
    "alpha is a roughness, squared once too often": lambda wi: ggx.pdf_ggx(WO, wi, 0.25),
    "reflection's Jacobian forgotten": lambda wi: (
        ggx.pdf_ggx(WO, wi, 0.5) * 4.0 * jnp.sqrt(jnp.maximum(1.0 + dot(WO, wi), 0.0) / 2.0)
    ),
    FORGOTTEN: lambda wi: jnp.where(wi.z > 0.0, ggx.pdf_ggx(WO, wi, 0.5), 0.0),
}


SOME = [name if name == FORGOTTEN else pytest.param(name, marks=pytest.mark.slow) for name in MUTANTS]


@pytest.mark.parametrize("name", SOME)
def test_counting_finds_a_mutant(name):
    sample, _, domain = pair(0.5, 60.0)
    with pytest.raises(AssertionError, match=r"n = "):
        assert_samples_pdf(sample, MUTANTS[name], domain, n=1 << 16)


@pytest.mark.parametrize("name", SOME)
def test_the_jacobian_finds_a_mutant(name):
    sample, _, _ = pair(0.5, 60.0)
    with pytest.raises(AssertionError, match="density times Jacobian"):
        assert_jacobian(sample, MUTANTS[name])


@pytest.mark.slow
def test_a_domain_above_the_surface_is_too_small():
    sample, pdf, _ = pair(1.0, 85.0)
    with pytest.raises(AssertionError, match="samples are outside"):
        assert_samples_pdf(sample, pdf, HEMISPHERE, n=1 << 16)
