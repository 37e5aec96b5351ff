"""Closed forms of glass, water and metal against figures of 40 digits, and what draws and weighs against the forms."""

import functools
import json
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import jaxmc as mc
from analytic_scenes import fresnel_values, ggx_values, glass, rough_metal
from analytic_scenes.scene import value_and_derivatives, value_of, variance_and_kurtosis
from jaxmc.testing import assert_unbiased
from jaxmc.transport import fresnel, microfacets
from jaxmc.transport.vec import Vec3, dot
from jaxmc.transport.warps import sample_cosine_hemisphere

RTOL = 1e-10
# Computed once with mpmath, 40 digits, independently of this code.
FIGURES = {entry["id"]: entry for entry in json.loads((Path(__file__).parent / "data/materials.json").read_text())}
UP = Vec3(0.0, 0.0, 1.0)


def close(value, reference, rel=RTOL):
    # The derivative of a constant is 0 but for rounding.
    assert value == pytest.approx(reference, rel=rel, abs=1e-15 if reference == 0.0 else 0.0)


def formula_of(entry):
    room = fresnel_values if hasattr(fresnel_values, entry["formula"]) else ggx_values
    return functools.partial(getattr(room, entry["formula"]), **entry.get("fixed", {}))


@pytest.mark.parametrize("name", FIGURES)
def test_figures_with_20_digits(name):
    entry = FIGURES[name]
    exact, gradient = value_and_derivatives(formula_of(entry), **entry["parameters"])
    close(exact, float(entry["value"]))
    for argument, figure in entry["derivatives"].items():
        close(gradient[argument], float(figure))


@pytest.mark.parametrize(
    "name", ["D01", "D05p", "D06", "D07", "D08", "D08d", "D10", "D11", "G01c", "G02", "G03a", "G04"]
)
def test_every_derivative_against_differences(name):
    entry = FIGURES[name]
    formula, arguments = formula_of(entry), entry["parameters"]
    _, gradient = value_and_derivatives(formula, **arguments)
    for argument, value in arguments.items():
        high, low = (value_of(formula, {**arguments, argument: value + step}) for step in (1e-5, -1e-5))
        assert gradient[argument] == pytest.approx((high - low) / 2e-5, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("ior", [1.05, 1.333, 1.5, 2.4])
def test_diffuse_reflectance_against_quadrature(ior):
    with jax.enable_x64(True):
        one = jax.jit(fresnel_values.dielectric_reflectance)
        mean, _ = integrate.quad(lambda t: 4.0 * t**3 * float(one(ior, math.acos(t * t))), 0.0, 1.0, epsabs=1e-13)
    close(value_of(fresnel_values.diffuse_reflectance, {"ior": ior}), mean)


def test_light_is_neither_lost_nor_made_in_a_plate():
    plate = {"ior": 1.5, "theta": 1.0}
    both = [value_of(f, plate) for f in (fresnel_values.slab_reflectance, fresnel_values.slab_transmittance)]
    close(sum(both), 1.0)
    figure = value_of(
        fresnel_values.slab_transmittance, {"ior": 1.5, "theta": math.radians(60.0), "transmittance": 0.8}
    )
    close(figure, 0.66706050197501913751)


def test_brewster_and_the_other_polarisation():
    angle = {"ior": 1.5, "theta": math.atan(1.5)}
    close(value_of(fresnel_values.dielectric_reflectance, angle), float(FIGURES["D02"]["value"]))
    assert value_of(fresnel_values.reflectance_along, angle) < 1e-30
    at_60 = {"ior": 1.5, "theta": math.radians(60.0)}
    close(value_of(fresnel_values.reflectance_along, at_60), 0.0018019375215850362117)


def test_schlick_is_the_mean_of_its_polynomial():
    mean, _ = integrate.quad(
        lambda m: 2.0 * m * float(fresnel_values.schlick_reflectance(0.04, np.arccos(m))), 0.0, 1.0
    )
    assert mean == pytest.approx(value_of(fresnel_values.diffuse_schlick_reflectance, {"f0": 0.04}), rel=1e-6)


# ---------------------------------------------------------------------------------- per-ray functions, in float64


def test_interfaces_reflect_what_the_closed_forms_say():
    with jax.enable_x64(True):
        for theta in (0.0, 0.3, math.radians(60.0), 1.5):
            glass = float(fresnel.fresnel_dielectric(math.cos(theta), 1.5))
            close(glass, value_of(fresnel_values.dielectric_reflectance, {"ior": 1.5, "theta": theta}))
            silver = float(fresnel.fresnel_conductor(math.cos(theta), 0.2, 3.9))
            close(silver, value_of(fresnel_values.conductor_reflectance, {"eta": 0.2, "k": 3.9, "theta": theta}))
        close(float(fresnel.fresnel_dielectric(0.5, 1.5)), float(FIGURES["D01"]["value"]))
        close(float(fresnel.fresnel_conductor(0.5, 0.2, 3.9)), float(FIGURES["D11"]["value"]))
        close(float(fresnel.fresnel_dielectric(math.cos(math.atan(1.5)), 1.5)), float(FIGURES["D02"]["value"]))


def test_facets_are_those_of_the_closed_forms():
    with jax.enable_x64(True):
        close(float(microfacets.smith_g1(0.5, 0.5)), float(FIGURES["G02"]["value"]))
        # Facets tilted by less than 30 degrees, by quadrature of the density.
        nodes, weights = np.polynomial.legendre.leggauss(40)
        z = 1.0 + (1.0 - math.cos(math.radians(30.0))) * (nodes - 1.0) / 2.0
        density = jax.vmap(lambda z: microfacets.ggx_density(Vec3(jnp.sqrt(1.0 - z * z), 0.0 * z, z), 0.5))(z)
        area = 2.0 * math.pi * np.sum(weights * z * density) * (1.0 - math.cos(math.radians(30.0))) / 2.0
        close(area, float(FIGURES["G01c"]["value"]))


def test_a_clear_ball_in_a_furnace():
    """Both branches followed to three hits inside: the reflectance inside is taken at the refracted angle."""
    with jax.enable_x64(True):
        arriving = Vec3(0.8, 0.0, -0.6)
        inside = fresnel.refract(arriving, UP, 1.5)
        one = float(fresnel.fresnel_dielectric(0.6, 1.5))
        two = float(fresnel.fresnel_dielectric(-dot(inside, UP), 1.0 / 1.5))
    close(one + (1.0 - one) * (1.0 - two) * (1.0 + two + two**2), float(FIGURES["F04"]["value"]))


# ---------------------------------------------------------------------------------- estimators, by 5 standard errors


def incident(cosine):
    return Vec3(math.sqrt(1.0 - cosine**2), 0.0, cosine)


ALBEDOS = [name if name == "G03f" else pytest.param(name, marks=pytest.mark.slow) for name in FIGURES if "G03" in name]


@pytest.mark.parametrize("name", ALBEDOS)
def test_directional_albedo_by_visible_normals(name):
    parameters = FIGURES[name]["parameters"]
    wo, alpha = incident(parameters["cosine"]), parameters["alpha"]
    estimate = mc.integrate(lambda u: microfacets.sample_ggx(wo, alpha, u[0], u[1])[2], dim=2, n=1 << 18)
    assert_unbiased(estimate, float(FIGURES[name]["value"]), rel_precision=2e-3)
    moments = [value_of(functools.partial(ggx_values.sampled_moment, power=k), parameters) for k in (1, 2, 3, 4)]
    variance, kurtosis = variance_and_kurtosis(moments)
    spread = math.sqrt((kurtosis - 1.0) / estimate.n)
    assert float(estimate.variance) == pytest.approx(variance, rel=5.0 * spread)
    assert spread < 0.02


def test_derivative_of_the_directional_albedo():
    """Through the sampled direction: the weight is 0 where it meets the horizon, so no term is missing."""
    wo, entry = incident(0.5), FIGURES["G03a"]
    slope = jax.grad(lambda alpha, u: microfacets.sample_ggx(wo, alpha, u[0], u[1])[2])
    estimate = mc.integrate(lambda u: slope(0.5, u), dim=2, n=1 << 18)
    assert_unbiased(estimate, float(entry["derivatives"]["alpha"]), rel_precision=0.01)


def test_directional_albedo_by_cosine():
    """The BRDF itself, not the weight of a way to sample it."""
    wo = incident(0.5)

    def sample(u):
        wi = sample_cosine_hemisphere(u[0], u[1])
        return microfacets.eval_ggx(wo, wi, 0.5) * math.pi / wi.z

    assert_unbiased(mc.integrate(sample, dim=2, n=1 << 18), float(FIGURES["G03a"]["value"]), rel_precision=0.01)


def test_directional_albedo_with_independent_masking():
    wo = incident(0.5)

    def sample(u):
        wi = microfacets.sample_ggx(wo, 0.5, u[0], u[1])[0]
        return jnp.where(wi.z > 0.0, microfacets.smith_g1(jnp.maximum(wi.z, 0.0), 0.5), 0.0)

    estimate = mc.integrate(sample, dim=2, n=1 << 18)
    assert_unbiased(estimate, float(FIGURES["G04"]["value"]), rel_precision=2e-3)
    with pytest.raises(AssertionError, match="standard errors off"):
        assert_unbiased(estimate, float(FIGURES["G03a"]["value"]), rel_precision=2e-3)


@pytest.mark.slow
def test_average_albedo():
    def sample(u):
        wo = sample_cosine_hemisphere(u[2], u[3])
        return microfacets.sample_ggx(wo, 0.5, u[0], u[1])[2]

    assert_unbiased(mc.integrate(sample, dim=4, n=1 << 18), float(FIGURES["G05"]["value"]), rel_precision=2e-3)


def plate_walk(ior, cosine, transmittance):
    """Return a walk between the two faces of a plate that chooses at every hit."""

    def sample(u):
        one = fresnel.fresnel_dielectric(cosine, ior)
        returned, alive, weight = jnp.where(u[0] < one, 1.0, 0.0), u[0] >= one, 1.0
        for hit in range(1, 15):
            weight = weight * transmittance
            leaves = u[hit] >= one
            returned = jnp.where(alive & leaves & (hit % 2 == 0), weight, returned)
            alive = alive & ~leaves
        return returned

    return sample


def base_walk(ior, albedo):
    """Return a walk under a coat: every passage is weighed, every reflection by the base draws a direction."""

    def sample(u):
        outside = fresnel.fresnel_dielectric(jnp.sqrt(1.0 - u[0]), ior)
        value, weight = outside, 1.0 - outside
        for hit in range(1, 33):
            inside = fresnel.fresnel_dielectric(jnp.sqrt(1.0 - u[hit]), 1.0 / ior)
            value, weight = value + weight * albedo * (1.0 - inside), weight * albedo * inside
        return value

    return sample


def diffuse(function):
    """Return the mean of a function of the cosine under a uniform sky."""
    return lambda u: function(jnp.sqrt(1.0 - u[0]))


WATER = 2.0 * math.pi * 1.333**2
WALKS = {
    "D03": (diffuse(lambda c: fresnel.fresnel_dielectric(c, 1.5)), 1),
    "D04": (diffuse(lambda c: fresnel.fresnel_dielectric(c, 1 / 1.5)), 1),
    "D05": (plate_walk(1.5, 0.5, 1.0), 15),
    "D06": (plate_walk(1.5, 0.5, 0.8), 15),
    "D08": (base_walk(1.5, 0.7), 33),
    "D10": (diffuse(lambda c: WATER * (1.0 - fresnel.fresnel_dielectric(c, 1 / 1.333))), 1),
}


@pytest.mark.parametrize("name", ["D03", "D04", "D05", "D06", "D10", pytest.param("D08", marks=pytest.mark.slow)])
def test_walks_find_the_closed_forms(name):
    walk, dim = WALKS[name]
    assert_unbiased(mc.integrate(walk, dim=dim, n=1 << 17), float(FIGURES[name]["value"]), rel_precision=0.01)


def test_a_walk_without_polarisation_does_not_find_the_plate_of_nature():
    walk, dim = WALKS["D05"]
    with pytest.raises(AssertionError, match="standard errors off"):
        assert_unbiased(mc.integrate(walk, dim=dim, n=1 << 17), float(FIGURES["D05p"]["value"]), rel_precision=0.01)


# ---------------------------------------------------------------------------------- whole scenes

SCENES = [*rough_metal.default_scenes(), *glass.default_scenes()]


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.slug)
def test_derivatives_of_scenes_against_differences(scene):
    for name, gradient in scene.derivatives.items():
        value = float(scene.arguments[name])
        high, low = (value_of(scene.formula, {**scene.arguments, name: value + step}) for step in (1e-5, -1e-5))
        assert gradient == pytest.approx((high - low) / 2e-5, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("make", "figure", "scale"),
    [
        (lambda: rough_metal.rough_floor(), "G03a", 1.6),
        (lambda: glass.glass_ball(bounces=4), "F04", 2.0),
        (lambda: glass.glass_plate(theta=math.pi / 3, bounces=41), "D05", 2.0),
        (lambda: glass.coated_floor(bounces=81), "D08d", 2.0),
        (lambda: glass.under_water(), "D10", 1.0),
    ],
)
def test_scenes_are_those_of_the_figures(make, figure, scale):
    close(make().exact, scale * float(FIGURES[figure]["value"]))


@pytest.mark.parametrize(
    "make",
    [
        lambda: rough_metal.rough_floor(cosine=0.0),
        lambda: glass.glass_ball(offset=1.0),
        lambda: glass.glass_plate(theta=-0.1),
        lambda: glass.coated_floor(bounces=0),
    ],
)
def test_impossible_scenes_are_refused(make):
    with pytest.raises(ValueError, match="got"):
        make()


def test_a_ball_of_another_index_is_found_out():
    right, wrong = glass.glass_ball(), glass.glass_ball(ior=1.6)
    estimate = mc.integrate(wrong.integrand, n=1 << 18)
    assert_unbiased(estimate, wrong.exact, rel_precision=1e-3)
    with pytest.raises(AssertionError, match="standard errors off"):
        assert_unbiased(estimate, right.exact, rel_precision=1e-3)
