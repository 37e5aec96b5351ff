"""Path regularization: what the rules make of a surface, that sampling and densities fit, and that ways agree."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_facts import operations

import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration import kernel
from jaxmc.testing import assert_equivalent, assert_samples_pdf, assert_unbiased, directions
from jaxmc.transport import bsdfs, hits, regularize
from jaxmc.transport.regularize import blur, memory_at_start, soften
from jaxmc.transport.vec import Vec3

BLACK = mc.Diffuse(0.0)
SLOW = pytest.mark.slow
X64 = jax.config.jax_enable_x64


def rule(name, amount=None, always=False):
    return mc.Regularize(name, amount, always)


# ---------------------------------------------------------------------------------------- what a rule does


def test_the_rule_of_pbrt():
    alpha = np.array([0.0, 0.02, 0.05, 0.1, 0.149, 0.2, 0.3, 0.5, 1.0])
    expected = [0.1, 0.1, 0.1, 0.2, 0.298, 0.3, 0.3, 0.5, 1.0]
    np.testing.assert_allclose(blur("pbrt", alpha), expected, rtol=1e-6)


def path_of(name, amount, alphas):
    """Return the roughness that a rule gives to each vertex of a path of these roughnesses, 0 for a mirror."""
    kinds = [mc.Mirror() if a == 0.0 else mc.Diffuse() if a == 1.0 else mc.RoughConductor(a) for a in alphas]
    quads = [mc.Quad((0, 0, k), (1, 0, 0), (0, 1, 0), m) for k, m in enumerate(kinds)]
    scene, chosen = mc.Scene(quads), rule(name, amount)
    scene.blur = regularize.amount_of(chosen)
    memory, scattered, found = memory_at_start(chosen), jnp.zeros((), bool), []
    for face in range(len(alphas)):
        surface = hits.Surface(None, None, 1.0, jnp.asarray(face))
        kinds, memory = soften(scene, chosen, bsdfs.kinds_of(scene, surface), scattered, memory)
        scattered = scattered | ~(jnp.zeros((), bool) if kinds.specular is None else kinds.specular)
        smooth = kinds.mirror is not None and bool(kinds.mirror)
        found.append(0.0 if smooth else float(kinds.alpha) if bool(kinds.rough) else 1.0)
    return found


def test_roughness_along_a_path():
    alphas = [0.0, 0.02, 0.0, 1.0, 0.25, 0.0]
    # Mirrors before the first vertex that scatters stay mirrors, and that vertex stays as it is.
    np.testing.assert_allclose(path_of("pbrt", None, alphas), [0.0, 0.02, 0.1, 1.0, 0.3, 0.1], rtol=1e-6)
    one = path_of("opsr", 1.0, alphas)
    kept = np.cumprod([1.0 - a for a in alphas])
    np.testing.assert_allclose(one, 1.0 - kept, rtol=1e-5)
    none = path_of("opsr", 0.0, alphas)
    np.testing.assert_allclose(none, [0.0, 0.02, 1e-3, 1.0, 0.25, 1e-3], rtol=1e-5)
    half = path_of("opsr", 0.5, [1.0, 0.2, 0.0])
    np.testing.assert_allclose(half, [1.0, 1.0 - 0.8 * 0.5, 1.0 - 0.5 * 0.9], rtol=1e-5)
    np.testing.assert_allclose(path_of("max_prev", 0.3, alphas), [0.0, 0.02, 0.02, 1.0, 0.3, 0.3], rtol=1e-5)
    np.testing.assert_allclose(path_of("max_prev", None, [0.2, 0.1, 0.4, 0.0]), [0.2, 0.2, 0.4, 0.4], rtol=1e-5)


# ---------------------------------------------------------------------------------------- the same as rough surfaces


def ball_under_sky(material):
    return mc.Scene([mc.Sphere((0, 0, 0), 1.0, material), mc.Quad((-3, -3, -1.2), (6, 0, 0), (0, 6, 0))], sky=1.0)


def seen(material, **options):
    ray = (3.0, 0.2, 0.3), (-1.0, 0.05, -0.1)
    return mc.draw(mc.radiance(ball_under_sky(material), *ray, bounces=2, lights="mis", **options), n=512).value


@pytest.mark.parametrize(("name", "amount", "alpha"), [("pbrt", None, 0.1), ("max_prev", 0.3, 0.3), ("opsr", 0.4, 0.4)])
def test_a_blurred_mirror_is_a_rough_metal(name, amount, alpha):
    # The receiver is diffuse, so all mirrors that its light comes over are blurred.
    def received(material, **options):
        lamp = mc.Sphere((0.5, 0.5, 3.0), 0.3, BLACK, emission=4.0)
        scene = mc.Scene([mc.Sphere((1.0, 0.0, 1.0), 0.5, material), lamp])
        return mc.draw(mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=1, **options), n=4096).value

    blurred = received(mc.Mirror(0.9), regularize=rule(name, amount))
    expected = received(mc.RoughConductor(alpha, 0.9))
    assert np.std(expected) > 0.0
    np.testing.assert_allclose(blurred, expected, rtol=2e-5)


def test_what_the_camera_sees_stays_sharp():
    sharp = seen(mc.Mirror())
    for name in regularize.AMOUNTS:
        np.testing.assert_array_equal(seen(mc.Mirror(), regularize=name)[:1], sharp[:1])
    assert not np.allclose(seen(mc.Mirror(), regularize=rule("pbrt", always=True)), sharp)
    np.testing.assert_allclose(
        seen(mc.Mirror(), regularize=rule("pbrt", always=True)), seen(mc.RoughConductor(0.1)), rtol=2e-5
    )


def test_a_white_furnace_gains_nothing():
    for name, amount in [("pbrt", None), ("cone", 0.3), ("opsr", 0.5), ("max_prev", 1.0)]:
        scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Mirror(1.0))], sky=1.0)
        for height in (0.0, 0.9):  # across the middle, and close to the rim
            f = mc.radiance(scene, (3, 0, height), (-1, 0, 0), bounces=1, regularize=rule(name, amount, always=True))
            values = mc.draw(f, n=1 << 12).value
            assert values.max() <= 1.0 + 1e-5 and 0.4 < values.mean() <= 1.0 + 1e-5


# ---------------------------------------------------------------------------------------- the cone


def cap_light(half_angle, eps, **options):
    """Return light from a ball of the given half-angle, straight above a mirror that reflects into a cone."""
    lamp = mc.Sphere((0, 0, 3), 3.0 * math.sin(half_angle), BLACK, emission=2.0)
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Mirror(0.8)), lamp])
    return mc.radiance(scene, (0, 0, 0.5), (0, 0, -1), bounces=1, regularize=rule("cone", eps, always=True), **options)


def covered(half_angle, eps):
    return 1.6 * min(1.0, (1.0 - math.cos(half_angle)) / (1.0 - math.cos(eps)))


@pytest.mark.parametrize("lights", ["none", "nee", "mis"])
@pytest.mark.parametrize(
    ("half_angle", "eps"), [(0.2, 0.5), pytest.param(0.2, 0.1, marks=SLOW), pytest.param(0.05, 0.8, marks=SLOW)]
)
def test_a_cone_mirror_facing_a_cap(lights, half_angle, eps):
    n = 1 << 21 if lights == "none" else 1 << 15
    f = cap_light(half_angle, eps, lights=lights)
    assert_unbiased(mc.integrate(f, n=n, key=5), covered(half_angle, eps), rel_precision=1.5e-2)


def cone_surface(eps):
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Mirror(1.0))])
    scene.blur = jnp.asarray(eps, float)
    surface = hits.Surface(Vec3(0.0, 0.0, 0.0), Vec3(0.0, 0.0, 1.0), 1.0, jnp.zeros((), jnp.int32))
    kinds, _ = soften(scene, rule("cone", always=True), bsdfs.kinds_of(scene, surface), None, None)
    return scene, surface, kinds, Vec3(*map(jnp.asarray, (0.6, 0.0, -0.8)))


@pytest.mark.parametrize("eps", [0.5, 0.01])
def test_cone_samples_follow_the_density(eps):
    scene, surface, kinds, arriving = cone_surface(eps)

    def sample(u):
        return bsdfs.sample_bsdf(scene, "bsdf", surface, kinds, arriving, u[0], u[1]).wi

    def pdf(w):
        return bsdfs.evaluate_bsdf(scene, "bsdf", surface, kinds, arriving, w, w.z)[1]

    # The rim of the cone is an edge of the domain, but rounding decides on which side of it a point lies.
    inside = directions((0.6, 0.0, 0.8), eps * (1.0 - 1e-4))
    axis = Vec3(0.6, 0.0, 0.8)
    kept = 2.0 * math.sin(0.5 * eps * (1.0 - 1e-4))
    result = assert_samples_pdf(
        sample, pdf, inside, n=1 << 18,
        accept=lambda w: (w.x - axis.x) ** 2 + (w.y - axis.y) ** 2 + (w.z - axis.z) ** 2 <= kept**2,
    )  # fmt: skip
    assert result.cells > 200
    if X64 or eps > 0.1:
        u = np.random.default_rng(1).random((256, 2)) * 0.99
        one = jax.vmap(lambda u: bsdfs.sample_bsdf(scene, "bsdf", surface, kinds, arriving, u[0], u[1]))(jnp.asarray(u))
        values, densities = jax.vmap(lambda w: bsdfs.evaluate_bsdf(scene, "bsdf", surface, kinds, arriving, w, w.z))(
            one.wi
        )
        # The reflectance is all in the lobe: value over density is 1, with pi for the convention of ``evaluate_bsdf``.
        np.testing.assert_allclose(values / (np.pi * densities), one.weight, rtol=1e-5)
        np.testing.assert_allclose(densities, one.pdf, rtol=1e-5)


# ---------------------------------------------------------------------------------------- three ways to the same light


def room(**options):
    """Return light on a floor beside a mirror ball, a shiny wall and a lamp, over two bounces."""
    things = [
        mc.Quad((-2, -2, 0), (4, 0, 0), (0, 4, 0), mc.Diffuse(0.6)),
        mc.Quad((-2, 2, 0), (4, 0, 0), (0, 0, 4), mc.RoughConductor(0.15, 0.8)),
        mc.Sphere((0.9, 0.0, 0.7), 0.6, mc.Mirror(0.9)),
        mc.Sphere((-0.6, 0.0, 2.2), 0.5, BLACK, emission=3.0),
    ]
    return mc.irradiance(mc.Scene(things), (0, 0.2, 0), (0, 0, 1), bounces=2, **options)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pbrt", "cone", "opsr", "max_prev"])
def test_light_sampling_and_waiting_find_the_same(name):
    chosen = rule(name, {"cone": 0.3, "opsr": 0.4}.get(name))
    found = [
        mc.integrate(room(lights=lights, regularize=chosen), n=1 << 19, key=k)
        for k, lights in enumerate(("none", "nee", "mis"))
    ]
    for a, b in itertools.combinations(found, 2):
        assert_equivalent(a, b, rel_precision=6e-3)


def blurred_lamp(lights, key, n=1 << 16):
    """Return light of a large lamp over a mirror that is rough by the rule of pbrt, found in one of three ways."""
    lamp = mc.Sphere((0.3, 0, 3), 0.7, BLACK, emission=2.0)
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Mirror(0.8)), lamp])
    f = mc.radiance(scene, (0, 0, 0.5), (0, 0, -1), bounces=1, lights=lights, regularize=rule("pbrt", always=True))
    fresh = mc.Integrand(lambda u, *params: f.fn(u, *params), f.dim, f.params, lazy=True)
    return mc.integrate(fresh, n=n, key=key)


def test_three_ways_to_a_blurred_lamp_and_a_mutant(monkeypatch):
    found = [blurred_lamp(lights, key) for key, lights in enumerate(("none", "nee", "mis"))]
    for a, b in itertools.combinations(found, 2):
        assert_equivalent(a, b, rel_precision=1e-2)
    monkeypatch.setattr(bsdfs, "eval_ggx", sharper_when_evaluated(bsdfs.eval_ggx))
    with pytest.raises(AssertionError, match="the estimates differ"):
        assert_equivalent(found[0], blurred_lamp("nee", 5), rel_precision=1e-2)


def wide_cone(right):
    return lambda half_angle: 0.98 * right(half_angle)


def narrow_when_evaluated(right):
    return lambda w, axis, half_angle: right(w, axis, 0.95 * half_angle)


def sharper_when_evaluated(right):
    return lambda wo, wi, alpha: right(wo, wi, 0.9 * alpha)


MUTANTS = [
    (wide_cone, "pdf_cone", "nee", 0.2, 0.5),
    pytest.param(wide_cone, "pdf_cone", "mis", 0.2, 0.5, marks=SLOW),
    pytest.param(narrow_when_evaluated, "is_in_cone", "mis", 0.7, 0.5, marks=SLOW),
]


@pytest.mark.parametrize(("mutate", "name", "lights", "half_angle", "eps"), MUTANTS)
def test_the_cap_tells_mutants(mutate, name, lights, half_angle, eps, monkeypatch):
    def check():
        f = cap_light(half_angle, eps, lights=lights)
        fresh = mc.Integrand(lambda u, *params: f.fn(u, *params), f.dim, f.params, lazy=True)
        assert_unbiased(mc.integrate(fresh, n=1 << 18, key=2), covered(half_angle, eps), rel_precision=3.8e-3)

    check()
    monkeypatch.setattr(bsdfs, name, mutate(getattr(bsdfs, name)))
    with pytest.raises(AssertionError, match="5 standard errors off"):
        check()


# ---------------------------------------------------------------------------------------- the amount is a value


def over_the_mirror(gamma, lights):
    lamp = mc.Sphere((1.0, 0.0, 0.4), 0.3, BLACK, emission=4.0)
    scene = mc.Scene([mc.Quad((-2, -2, 1), (4, 0, 0), (0, 4, 0), mc.Mirror(0.9)), lamp])
    chosen = rule("opsr", gamma)
    return mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=1, lights=lights, regularize=chosen)


def slope(lights, n, key):
    """Return the derivative of the mean with respect to the amount, for each of 32 parts of the samples."""
    run = mc.estimator(over_the_mirror(0.4, lights), n=n)
    scene, *place = over_the_mirror(0.4, lights).params

    def mean(amount, key):
        blurred = jax.tree.unflatten(jax.tree.structure(scene), jax.tree.leaves(scene))
        blurred.blur = amount
        return run(key, blurred, *place).mean

    keys = jax.vmap(jax.random.key)(np.arange(32) + 100 * key)
    return np.asarray(jax.jit(jax.vmap(jax.grad(mean), (None, 0)))(jnp.asarray(0.4), keys)), mean, keys


@pytest.mark.slow
def test_the_derivative_of_the_amount_is_that_of_the_integral():
    parts, mean, keys = slope("nee", 8192, 1)
    h, mean = 1e-2, jax.jit(mean)
    apart = np.array([(mean(0.4 + h, k) - mean(0.4 - h, k)) / (2 * h) for k in keys[:4]])
    # The points of light sampling do not move with the amount, so differences are exact to their own error.
    np.testing.assert_allclose(parts[:4], apart, rtol=2e-2)
    for lights in ("none", "mis"):
        others, _, _ = slope(lights, 8192, 2)
        error = math.hypot(parts.std(ddof=1), others.std(ddof=1)) / math.sqrt(len(parts))
        assert abs(parts.mean() - others.mean()) <= 5.0 * error and error <= 0.1 * abs(parts.mean())


def test_other_amounts_run_the_same_kernel():
    scene, camera = scenes.mirror_box(True, 8, 8)
    options = {"spp": 64, "bounces": 2}
    first = mc.render(scene, camera, **options, regularize=rule("cone", 0.1)).mean
    before = kernel.evaluate._cache_size()
    other = mc.render(scene, camera, **options, regularize=rule("cone", 0.2)).mean
    assert kernel.evaluate._cache_size() == before and not np.array_equal(first, other)


def test_nothing_to_blur_is_the_same_kernel():
    scene, camera = scenes.cornell_box()
    assert operations(scene, camera, regularize="pbrt") == operations(scene, camera)
    glass = mc.Scene([mc.Sphere((0, 0, 0), 0.5, mc.Dielectric(1.5)), mc.Sphere((0, 2, 0), 0.2, emission=2.0)])
    assert operations(glass, regularize="pbrt") == operations(glass)


def test_bad_input():
    scene, camera = scenes.mirror_box(True, 8, 8)

    def paths(**options):
        return mc.path_integrand(scene, camera, bounces=2, **options)

    for make, match in [
        (lambda: rule("blur"), "rule must be one of pbrt"),
        (lambda: rule("pbrt", 0.1), "has no amount"),
        (lambda: rule("cone", 0.0), "above 0"),
        (lambda: rule("opsr", 1.5), "at most 1.0"),
        (lambda: rule("cone", always=1), "always"),
        (lambda: paths(regularize=0.1), "mc.Regularize"),
        (lambda: paths(regularize="pbrt", directions="cosine"), 'directions="bsdf"'),
        (lambda: paths(regularize=rule("cone", mc.Shrinking(0.1))), "render_progressively"),
        (lambda: mc.Shrinking(-1.0), "first"),
        (lambda: mc.Shrinking(0.1, 0.5), "power"),
    ]:
        with pytest.raises(ValueError, match=match):
            make()
    assert dataclasses.replace(rule("opsr"), amount=0.0).amount == 0.0
