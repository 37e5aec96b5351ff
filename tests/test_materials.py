"""Glass, rough metal and what they do in a scene, against Fresnel's equations, white furnaces and each other."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.testing import assert_equivalent, assert_unbiased
from jaxmc.transport import bsdfs, fresnel, microfacets

Z = (0.0, 0.0, 1.0)
SLOW = pytest.mark.slow
UPPER = mc.GradientSky([1.0], up=Z, ground=0.0)  # white above the horizon, black below
# The directional albedo of GGX with height-correlated masking: (cosine, alpha) -> value; formula G03 of Heitz 2014 by
# quadrature to 1e-14.
ALBEDOS = {
    (0.5, 0.5): 0.698250696927548, (0.8, 0.5): 0.682045682100859, (0.5, 1.0): 0.450693855665945,
    (0.2, 0.5): 0.789929186564705, (0.5, 0.1): 0.969204984411689,
}  # fmt: skip
SILVER = {"eta": 0.2, "k": 3.9}
AT_60_DEGREES = 0.945882381801333  # of this metal
R_60 = 0.0891867128022128  # of glass of index 1.5, at 60 degrees
FLOOR = ((-50.0, -50.0, 0.0), (100.0, 0.0, 0.0), (0.0, 100.0, 0.0))


def looking_down(cosine):
    return (np.sqrt(1.0 - cosine * cosine), 0.0, -cosine)


def seen(primitives, cosine, sky=UPPER, **options):
    """Return the radiance of a floor at the origin, seen from above at an angle."""
    direction = np.array(looking_down(cosine))
    return mc.radiance(mc.Scene(primitives, sky), -3.0 * direction, direction, **options)


def test_an_interface_reflects_as_fresnel_says():
    integrand = seen([mc.Quad(*FLOOR, mc.Dielectric(1.5))], 0.5, bounces=1)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), R_60, 2e-3)


def test_what_passes_is_refracted_and_gains_or_loses_radiance():
    # Below the interface the sky is c + d z; radiance is divided by the squared index.
    sky, eta = mc.GradientSky([2.0, 1.0], up=Z), 1.5
    cos_t = np.sqrt(1.0 - (1.0 - 0.25) / eta**2)
    exact = R_60 * 2.5 + (1.0 - R_60) * (2.0 - cos_t) / eta**2
    integrand = seen([mc.Quad(*FLOOR, mc.Dielectric(eta))], 0.5, sky, bounces=1)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), exact, 1e-3)


def test_a_slab_reflects_between_its_faces():
    slab = mc.Box((0, 0, -0.5), (100.0, 100.0, 1.0), material=mc.Dielectric(1.5))
    integrand = seen([slab], 0.5, bounces=16)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), 2.0 * R_60 / (1.0 + R_60), 2e-3)


@pytest.mark.parametrize(
    ("shape", "ior"),
    [("sphere", 1.5), ("box", 1.5), *(pytest.param(s, n, marks=SLOW) for s in ("sphere", "box") for n in (1.0, 0.7))],
)
def test_glass_in_a_white_furnace_cannot_be_seen(shape, ior):
    # Each path brings the radiance of the sky, but for those that are still inside at the end.
    glass = mc.Dielectric(ior)
    body = mc.Sphere((0, 0, 0), 1.0, glass) if shape == "sphere" else mc.Box((0, 0, 0), (1, 2, 1.5), material=glass)
    integrand = seen([body], 0.8, sky=2.0, bounces=40)
    values = np.asarray(integrand.batch(np.random.default_rng(1).uniform(size=(20_000, integrand.dim))))
    arrived = values > 0.0
    # Total reflection keeps some for ever inside a box whose faces are parallel.
    assert arrived.mean() > (0.999 if shape == "sphere" or ior >= 1.0 else 0.5)
    np.testing.assert_allclose(values[arrived], 2.0, rtol=2e-5)


def test_total_reflection_keeps_light_inside():
    # From inside glass toward a face beyond the critical angle: all is reflected.
    block = mc.Box((0, 0, -1.0), (100.0, 100.0, 2.0), material=mc.Dielectric(1.5))
    integrand = mc.radiance(mc.Scene([block], sky=1.0), (0, 0, -1.0), (0.9, 0.0, 0.436), bounces=3)
    assert mc.integrate(integrand, n=1 << 12, key=1).mean == 0.0


# Hemisphere sampling of a narrow lobe would be no evidence.
@pytest.mark.parametrize(
    ("cosine", "alpha", "directions"),
    [
        (0.2, 0.5, "bsdf"),
        *[pytest.param(*key, "bsdf", marks=SLOW) for key in ALBEDOS if key != (0.2, 0.5)],
        pytest.param(0.5, 0.5, "cosine", marks=SLOW),
        pytest.param(0.5, 1.0, "uniform", marks=pytest.mark.slow),
    ],
)
def test_a_rough_metal_in_a_white_furnace(cosine, alpha, directions):
    integrand = seen([mc.Quad(*FLOOR, mc.RoughConductor(alpha))], cosine, bounces=1, directions=directions)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), ALBEDOS[cosine, alpha], 2e-3)


@pytest.mark.parametrize("lights", ["mis", pytest.param("nee", marks=SLOW)])
def test_a_rough_metal_under_a_sampled_sky(lights):
    options = {"bounces": 1, "lights": lights, "sample_sky": True}
    integrand = seen([mc.Quad(*FLOOR, mc.RoughConductor(0.5))], 0.5, **options)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), ALBEDOS[0.5, 0.5], 2e-3)


def test_a_smooth_metal_reflects_as_fresnel_says():
    # Roughness is kept at 1e-3 or more: the facets turn by that.
    integrand = seen([mc.Quad(*FLOOR, mc.RoughConductor(1e-3, **SILVER))], 0.5, bounces=1)
    assert_unbiased(mc.integrate(integrand, n=1 << 16, key=1), AT_60_DEGREES, 1e-4)


def test_a_metal_differs_from_channel_to_channel():
    metal = mc.RoughConductor(1e-3, reflectance=(1.0, 0.5, 1.0), eta=(0.2, 0.2, 1.5), k=(3.9, 3.9, 0.0))
    estimate = mc.integrate(seen([mc.Quad(*FLOOR, metal)], 0.5, bounces=1), n=1 << 16, key=1)
    np.testing.assert_allclose(estimate.mean, [AT_60_DEGREES, 0.5 * AT_60_DEGREES, R_60], rtol=2e-3)


def room(material, directions="bsdf", lights="mis"):
    """Return the image of a room with a ball of some material, a lamp and a sky through the open front."""
    white = mc.Diffuse(0.7)
    primitives = [
        mc.Quad((-1, -1, -1), (2, 0, 0), (0, 0, 2), white), mc.Quad((-1, -1, -1), (0, 2, 0), (2, 0, 0), white),
        mc.Sphere((0.0, -0.4, -0.2), 0.5, material), mc.Box((0.6, -0.7, 0.3), (0.4, 0.6, 0.4), material=white),
        mc.Quad((-0.5, 1, -0.5), (1.0, 0, 0), (0, 0, 1.0), mc.Diffuse(0.0), 4.0),
    ]  # fmt: skip
    camera = mc.PinholeCamera((0.3, 0.2, 3.5), (0, -0.2, 0), width=8, height=8)
    return mc.path_integrand(mc.Scene(primitives, 0.3), camera, bounces=3, directions=directions, lights=lights)


@pytest.mark.parametrize(
    "other", [{"lights": "none"}, *(pytest.param(o, marks=SLOW) for o in ({"lights": "nee"}, {"directions": "cosine"}))]
)
def test_strategies_agree_on_a_rough_ball(other):
    material = mc.RoughConductor(0.4, (0.9, 0.6, 0.3))
    a, b = (mc.integrate(room(material, **options), n=1 << 21, key=k) for k, options in enumerate(({}, other)))
    assert_equivalent(a, b, 4e-3)


@SLOW
def test_strategies_agree_on_a_glass_ball():
    a, b = (mc.integrate(room(mc.Dielectric(), lights=how), n=1 << 21, key=k) for k, how in enumerate(("mis", "none")))
    assert_equivalent(a, b, 6e-3)


@SLOW
def test_a_receiver_on_metal_or_glass_is_diffuse():
    for material in (mc.RoughConductor(0.3), mc.Dielectric(), mc.Mirror()):
        scene = mc.Scene([mc.Quad(*FLOOR, material)], sky=1.0)
        integrand = mc.irradiance(scene, (0, 0, 0), Z, bounces=0)
        assert mc.integrate(integrand, n=1 << 12, key=1).mean == pytest.approx(np.pi, rel=1e-6)


# What is wrong, the module that holds the function, its name, and the scene that shows it with its exact value.
MUTANTS = {
    "index upside down": (fresnel, "fresnel_dielectric", lambda right: lambda c, eta: right(c, 1.0 / eta)),
    "sine for cosine": (fresnel, "fresnel_dielectric", lambda right: lambda c, eta: right(jnp.sqrt(1 - c * c), eta)),
    "no masking": (microfacets, "sample_ggx", lambda right: lambda *a: (*right(*a)[:2], 1.0 + 0.0 * right(*a)[2])),
    "width squared": (microfacets, "sample_ggx", lambda right: lambda wo, a, *u: right(wo, a * a, *u)),
    "no metal": (fresnel, "fresnel_conductor", lambda right: lambda c, eta, k: 1.0 + 0.0 * c),
}
SHOWN_BY = {
    "fresnel_dielectric": (lambda: seen([mc.Quad(*FLOOR, mc.Dielectric(1.5))], 0.5, bounces=1), R_60),
    "sample_ggx": (
        lambda: seen([mc.Quad(*FLOOR, mc.RoughConductor(0.5))], 0.5, bounces=1), ALBEDOS[0.5, 0.5],
    ),
    "fresnel_conductor": (
        lambda: seen([mc.Quad(*FLOOR, mc.RoughConductor(1e-3, **SILVER))], 0.5, bounces=1), AT_60_DEGREES,
    ),
}  # fmt: skip


QUICK = {"index upside down", "no masking"}


@pytest.mark.parametrize("what", [w if w in QUICK else pytest.param(w, marks=SLOW) for w in MUTANTS])
def test_mutants_are_found(what, monkeypatch):
    module, name, mutate = MUTANTS[what]
    make, exact = SHOWN_BY[name]
    monkeypatch.setattr(bsdfs, name, mutate(getattr(module, name)))
    integrand = make()
    fresh = mc.Integrand(lambda u: integrand.fn(u, *integrand.params), integrand.dim, lazy=True)
    with pytest.raises(AssertionError, match=r"standard errors off|rounding"):
        assert_unbiased(mc.integrate(fresh, n=1 << 20, key=1), exact, 5e-3)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mc.Sphere((0, 0, 0), 1, mc.RoughConductor(0.0)), "roughness"),
        (lambda: mc.Sphere((0, 0, 0), 1, mc.RoughConductor(1.5)), "roughness must be at most 1"),
        (lambda: mc.Sphere((0, 0, 0), 1, mc.RoughConductor(0.5, 1.2)), "more light would leave"),
        (lambda: mc.Sphere((0, 0, 0), 1, mc.RoughConductor(0.5, eta=0.2)), "eta and k"),
        (lambda: mc.Sphere((0, 0, 0), 1, mc.Dielectric(-1.0)), "ior"),
        (lambda: mc.Sphere((0, 0, 0), 1, mc.Dielectric(np.nan)), "ior"),
    ],
)
def test_bad_materials_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
