"""Fresnel's equations against the textbook forms in float64, Snell's law, and the places where digits could be lost."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmc.transport.fresnel import fresnel_conductor, fresnel_dielectric, refract
from jaxmc.transport.vec import Vec3, dot

COSINES = np.concatenate([[0.0, 1e-6, 1e-3], np.linspace(0.01, 1.0, 100)]).astype(np.float32)
INDICES = np.array([0.4, 1 / 1.5, 0.75, 0.999, 0.9999999, 1.0, 1.0000001, 1.001, 1.333, 1.5, 2.4, 10.0], np.float32)


dielectric = jax.jit(jax.vmap(fresnel_dielectric, (0, None)))
conductor = jax.jit(jax.vmap(fresnel_conductor, (0, None, None)))
refracted = jax.jit(jax.vmap(refract, (0, 0, None)))


def textbook(cosine, index):
    """Return the reflectance from the ratios of the amplitudes, with the complex cosine of the refracted ray."""
    cosine, index = np.asarray(cosine, np.complex128), np.asarray(index, np.complex128)
    inner = np.sqrt(index**2 - 1.0 + cosine**2)  # index times the cosine inside
    with np.errstate(invalid="ignore"):
        across = (cosine - inner) / (cosine + inner)
        along = (index**2 * cosine - inner) / (index**2 * cosine + inner)
    return (np.abs(across) ** 2 + np.abs(along) ** 2) / 2


@pytest.mark.parametrize("index", INDICES)
def test_dielectric(index):
    value = np.asarray(dielectric(COSINES, index), np.float64)
    expected = np.where(COSINES > 0.0, textbook(np.maximum(COSINES, 1e-12), index), 1.0 if index != 1.0 else 0.0)
    assert np.all((value >= 0.0) & (value <= 1.0 + 1e-6))
    # Next to the critical angle the reflectance is as steep as a square root.
    steep = np.abs(np.float64(index) ** 2 - 1.0 + COSINES.astype(np.float64) ** 2) < 1e-2
    np.testing.assert_allclose(value[~steep], expected[~steep], rtol=2e-6, atol=1e-14)
    np.testing.assert_allclose(value, expected, atol=2e-3)


def test_dielectric_where_the_answer_is_plain():
    assert fresnel_dielectric(1.0, 1.5) == pytest.approx(0.04, rel=1e-6)
    assert fresnel_dielectric(0.5, 1.0) == 0.0
    assert fresnel_dielectric(0.0, 1.0) == 0.0
    assert fresnel_dielectric(0.0, 1.5) == pytest.approx(1.0, abs=1e-6)
    assert fresnel_dielectric(0.5, 0.5) == 1.0  # beyond the critical angle
    # An index that differs by its last digit reflects a quarter of the square of the difference.
    last = np.nextafter(np.float32(1.0), np.float32(2.0))
    assert fresnel_dielectric(1.0, last) == pytest.approx((float(last) - 1.0) ** 2 / 4.0, rel=1e-5)


def test_both_sides_reflect_alike():
    # Closer to grazing, rounding of the inner cosine alone makes more of a difference.
    cosine = jnp.asarray(COSINES[COSINES > 0.05])
    inner = jnp.sqrt(1.0 - (1.0 - cosine**2) / 2.25)
    outside = dielectric(cosine, 1.5)
    inside = dielectric(inner, 1.0 / 1.5)
    np.testing.assert_allclose(outside, inside, rtol=2e-5)


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (0.05, 9.0), (3.0, 3.5), (1.5, 0.0), (0.7, 1e-3), (1.0, 1e-6)])
def test_conductor(eta, k):
    eta, k = np.float32(eta), np.float32(k)
    value = np.asarray(conductor(COSINES, eta, k), np.float64)
    expected = textbook(np.maximum(COSINES, 1e-12), complex(eta, k))
    assert np.all((value >= -1e-7) & (value <= 1.0 + 1e-6))
    np.testing.assert_allclose(value, expected, rtol=3e-6, atol=3e-7)


@pytest.mark.parametrize("eta", [0.7, 1 / 1.5, 0.9999, 1.0, 1.0001, 1.5, 3.0])
def test_refraction_obeys_snell(eta):
    rng = np.random.default_rng(0)
    normal, arriving = (v / np.linalg.norm(v, axis=0) for v in rng.normal(size=(2, 3, 2000)))
    arriving = np.where(np.sum(normal * arriving, 0) < 0.0, arriving, -arriving)
    kind = jnp.result_type(float)
    normal, arriving = (Vec3(*jnp.asarray(v, kind)) for v in (normal, arriving))
    passed = refracted(arriving, normal, eta)
    normal, arriving, passed = (np.stack([np.asarray(x, np.float64) for x in v]) for v in (normal, arriving, passed))
    cos_i = -np.sum(normal * arriving, 0)
    passes = eta**2 - 1.0 + cos_i**2 > 1e-3
    assert np.isfinite(passed).all()
    tangential = passed + normal * np.sqrt(np.maximum(1.0 - (1.0 - cos_i**2) / eta**2, 0.0))
    expected = (arriving + normal * cos_i) / eta
    eps = float(np.finfo(kind).eps)
    assert np.max(np.abs(np.linalg.norm(passed, axis=0) - 1.0)[passes]) < 4 * eps
    # The angle of refraction is as steep as a square root at the critical angle.
    np.testing.assert_allclose(tangential[:, passes], expected[:, passes], atol=50 * eps)
    assert np.all(np.sum(normal * passed, 0)[eta**2 - 1.0 + cos_i**2 > 0.0] < 0.0)


def test_refraction_there_and_back():
    """The way back of light is its way there reversed."""
    normal, arriving = Vec3(0.0, 0.6, 0.8), Vec3(0.48, -0.36, -0.8)
    passed = refract(arriving, normal, 1.5)
    back = refract(-passed, -normal, 1.0 / 1.5)
    np.testing.assert_allclose(np.array(back), -np.array(arriving), atol=1e-6)


def test_grazing_light_leaves_the_surface():
    """However flat it arrives, what passes is below the surface by more than rounding."""
    up = Vec3(0.0, 0.0, 1.0)
    eps = float(np.finfo(jnp.result_type(float)).eps)
    for height in (0.0, 1e-9, 1e-3):
        for eta in (1.0, 1.0 + 1e-6, 1.5):
            passed = refract(Vec3(math.sqrt(1.0 - height**2), 0.0, -height), up, eta)
            assert float(passed.z) < -8.0 * eps
            assert float(dot(passed, passed)) == pytest.approx(1.0, abs=1e-6)


def test_derivatives_are_finite_everywhere():
    def everything(cosine, eta):
        direction = Vec3(jnp.sqrt((1.0 - cosine) * (1.0 + cosine) + 1e-20), 0.0, -cosine)
        passed = refract(direction, Vec3(0.0, 0.0, 1.0), eta)
        return fresnel_dielectric(cosine, eta) + fresnel_conductor(cosine, eta, 1e-3) + passed.x + passed.z

    grid = np.meshgrid(np.append(COSINES[:20], 1.0), np.append(INDICES, 0.6), indexing="ij")
    cosine, eta = (jnp.asarray(x.ravel(), float) for x in grid)
    # cos = 0.8 and eta = 0.6 is a critical angle.
    cosine, eta = jnp.append(cosine, 0.8), jnp.append(eta, 0.6)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(everything, argnums=(0, 1))))(cosine, eta)
    assert np.isfinite(values).all()
    assert all(np.isfinite(slope).all() for slope in slopes)


@pytest.mark.parametrize("cosine", [0.2, 0.5, 0.9])
def test_derivatives_are_those_of_the_textbook(cosine):
    with jax.enable_x64(True):
        slopes = jax.grad(fresnel_dielectric, argnums=(0, 1))(cosine, 1.5)
        other = jax.grad(fresnel_conductor, argnums=(0, 1, 2))(cosine, 0.2, 3.9)
    step = 1e-6

    def difference(forward, backward):
        return (textbook(*forward) - textbook(*backward)) / (2 * step)

    glass = [
        difference((cosine + step, 1.5), (cosine - step, 1.5)),
        difference((cosine, 1.5 + step), (cosine, 1.5 - step)),
    ]
    metal = [
        difference((cosine + step, 0.2 + 3.9j), (cosine - step, 0.2 + 3.9j)),
        difference((cosine, 0.2 + step + 3.9j), (cosine, 0.2 - step + 3.9j)),
        difference((cosine, 0.2 + (3.9 + step) * 1j), (cosine, 0.2 + (3.9 - step) * 1j)),
    ]
    np.testing.assert_allclose(slopes, glass, rtol=1e-6)
    np.testing.assert_allclose(other, metal, rtol=1e-6)


# ---------------------------------------------------------------------------------------------------- mutants

MUTANTS = {
    "index upside down": lambda cosine, eta: fresnel_dielectric(cosine, 1.0 / eta),
    "one polarisation": lambda cosine, eta: textbook_across(cosine, eta),
    "Schlick's polynomial": lambda cosine, eta: (
        ((eta - 1) / (eta + 1)) ** 2 * (1 - (1 - cosine) ** 5) + (1 - cosine) ** 5
    ),
}


def textbook_across(cosine, eta):
    inner = jnp.sqrt(eta**2 - 1.0 + cosine**2)
    return ((cosine - inner) / (cosine + inner)) ** 2


@pytest.mark.parametrize("name", MUTANTS)
def test_the_textbook_finds_a_mutant(name):
    value = np.asarray(jax.vmap(MUTANTS[name], (0, None))(COSINES[5:], 1.5), np.float64)
    with pytest.raises(AssertionError, match="Not equal"):
        np.testing.assert_allclose(value, textbook(COSINES[5:], 1.5), rtol=1e-3)
