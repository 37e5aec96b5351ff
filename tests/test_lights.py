"""Several lights and the sky as lights: picks are probabilities, and no choice of strategy changes a mean."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from analytic_scenes import moving
from analytic_scenes.roulette import roulette_furnace
from jaxmc.testing import SPHERE, assert_equivalent, assert_jacobian, assert_samples_pdf, assert_unbiased
from jaxmc.transport import lights, paths, sky
from jaxmc.transport.vec import Vec3

SLOW = pytest.mark.slow
BLACK, Z = mc.Diffuse(0.0), (0.0, 0.0, 1.0)
PICKS = ("uniform", "power", "distance")


def lamps(count):
    """Return quads, triangles and disks over the origin that do not hide each other, and the exact irradiance there."""
    rng = np.random.default_rng(7)
    primitives, exact = [], 0.0
    for k in range(count):
        corner = np.array([-2.0 + 0.9 * (k % 5), -2.0 + 0.9 * (k // 5), 1.5])
        u, v = np.array((0.0, 0.6, 0.0)), np.array((0.6, 0.0, 0.0))
        emission = float(rng.uniform(0.2, 5.0) ** 2)
        if k % 3 == 2:
            halves = ((corner, corner + u, corner + v), (corner + u + v, corner + v, corner + u))
            primitives += [mc.Triangle(*half, BLACK, emission) for half in halves]
        elif k % 4 == 1:
            center, down = corner + (u + v) / 2, (0.0, 0.0, -1.0)
            primitives.append(mc.Disk(center, down, 0.3, BLACK, emission, two_sided=k == 1))
            exact += float(moving.disk_over_receiver(emission, 0.3, center[2], np.hypot(*center[:2])))
            continue
        else:
            primitives.append(mc.Quad(corner, u, v, BLACK, emission, two_sided=k % 2 == 1))
        given = {"emission": emission, "corner": corner, "edge_u": u, "edge_v": v}
        exact += float(analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, **given)[0])
    return primitives, exact


def irradiance(primitives, **options):
    return mc.irradiance(mc.Scene(primitives), (0, 0, 0), Z, bounces=0, **options)


CASES = [(count, pick, strategy) for count in (3, 14) for pick in PICKS for strategy in ("nee", "mis")]
QUICK = {(3, "power", "mis"), (14, "distance", "mis")}


@pytest.mark.parametrize(
    ("count", "pick", "strategy"), [c if c in QUICK else pytest.param(*c, marks=SLOW) for c in CASES]
)
def test_many_lights_add_up(count, pick, strategy):
    primitives, exact = lamps(count)
    integrand = irradiance(primitives, pick=pick, lights=strategy)
    assert isinstance(integrand.params[0].powers, tuple) == (count == 3)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), exact, 4e-3)


@pytest.mark.parametrize("strategy", ["mis", pytest.param("nee", marks=SLOW)])
def test_spheres_of_all_kinds_add_up(strategy):
    # From inside a large ball that shines inward: pi Le. Two-sided balls show their outside.
    around = mc.Sphere((0, 0, 0), 50.0, BLACK, 0.5, inward=True)
    balls = [mc.Sphere((2.0 * k, 0.0, 4.0), 0.5, BLACK, 4.0, two_sided=k % 2 == 0) for k in range(-4, 5)]
    few = irradiance([around, *balls[:2]], lights=strategy, pick="distance")
    many = irradiance([around, *balls], lights=strategy, pick="distance")
    for integrand, some in ((few, balls[:2]), (many, balls)):
        exact = np.pi * 0.5
        for ball in some:
            distance2 = float(np.dot(ball.center, ball.center))
            exact += (4.0 - 0.5) * np.pi * 0.25 / distance2 * 4.0 / np.sqrt(distance2)
        assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), exact, 4e-3)


@SLOW
def test_better_picks_have_less_variance():
    near = mc.Quad((0.2, 0.2, 0.3), (0, 0.2, 0), (0.2, 0, 0), BLACK, 3.0)
    far = [mc.Quad((k, 3.0, 6.0), (0, 0.2, 0), (0.2, 0, 0), BLACK, 3.0) for k in range(6)]
    dim = mc.Quad((-0.6, -0.6, 0.5), (0, 0.4, 0), (0.4, 0, 0), BLACK, 0.01)
    variance = [
        float(mc.integrate(irradiance([near, *far, dim], pick=pick, lights="nee"), n=1 << 18, key=1).variance)
        for pick in PICKS
    ]
    assert variance[0] > variance[1] > 4.0 * variance[2]


@pytest.mark.parametrize("count", [5, 14])
@pytest.mark.parametrize("pick", ["distance", *(pytest.param(p, marks=SLOW) for p in ("uniform", "power"))])
def test_lights_are_picked_as_often_as_their_probability_says(pick, count):
    scene = mc.Scene(lamps(count)[0])
    point, normal = Vec3(*map(jnp.asarray, (0.3, -0.2, 0.1))), Vec3(*map(jnp.asarray, (0.6, 0.0, 0.8)))
    u = jnp.asarray((np.arange(1 << 16) + 0.5) / (1 << 16), float)
    chosen, probability = jax.vmap(lambda u: lights.pick_light(scene, pick, point, normal, u))(u)
    said = lights.probability_of(scene, pick, point, normal)
    total = 0.0
    for k in range(len(scene.lights)):
        p = float(said(k))
        total += p
        picked = np.asarray(chosen) == k
        assert picked.mean() == pytest.approx(p, abs=3e-5)
        np.testing.assert_allclose(np.broadcast_to(probability, picked.shape)[picked], p, rtol=2e-5)
    assert total == pytest.approx(1.0, rel=1e-5)


def test_the_bound_of_a_light_holds_for_all_of_its_points():
    # What a light adds is at most its importance, up to a constant that all lights share.
    rng = np.random.default_rng(3)
    light, _ = mc.Scene([mc.Quad((-0.5, -0.4, 2.0), (0, 0.9, 0.2), (1.1, 0, 0), BLACK, 1.0)]).emitters[0]
    wrong = 0
    for _ in range(300):
        x, n = rng.uniform(-3, 3, 3), rng.normal(size=3)
        point, normal = Vec3(*map(jnp.float32, x)), Vec3(*map(jnp.float32, n / np.linalg.norm(n)))
        importance = float(lights._importance(light, 1.0, point, normal))
        s = rng.uniform(-1, 1, (200, 2))
        target = np.array(light.center) + s[:, :1] * np.array(light.half_u) + s[:, 1:] * np.array(light.half_v)
        to = target - x
        wi = to / np.linalg.norm(to, axis=1)[:, None]
        adds = np.maximum(wi @ np.array(normal), 0) * np.maximum(-(wi @ np.array(light.normal)), 0)
        wrong += bool((adds > 1e-6).any() and importance <= 0.0)
    assert wrong == 0


# ---------------------------------------------------------------------------------------- sky

SKIES = {
    "constant": (mc.Scene([], sky=1.5).sky, None),
    "overcast": (mc.Scene([], sky=mc.GradientSky((1.0, 2.0), up=Z, ground=0.0)).sky, 7.0 * np.pi / 3.0),
    "tilted, coloured": (
        mc.Scene([], sky=mc.GradientSky([(1.0, 0.8, 0.5), (0.2, 0.3, 0.4), 0.6], up=(0.3, -0.5, 0.8))).sky,
        None,
    ),
    "with a ground": (mc.Scene([], sky=mc.GradientSky([0.5, 0.0, 1.0], up=Z, ground=0.3)).sky, None),
}


@pytest.mark.parametrize("name", [n if n == "with a ground" else pytest.param(n, marks=SLOW) for n in SKIES])
def test_the_sky_is_drawn_by_its_density(name):
    table, _ = SKIES[name]
    normal = Vec3(*map(jnp.float32, (0.36, -0.48, 0.8)))

    def sample(u):
        return sky.sample_sky(table, normal, u[0], u[1])[0]

    def pdf(w):
        inverse = sky.sky_inverse_pdf(table, normal, w)
        return jnp.where(inverse > 0.0, 1.0 / jnp.where(inverse > 0.0, inverse, 1.0), 0.0)

    assert assert_samples_pdf(sample, pdf, SPHERE).cells >= 100
    assert assert_jacobian(sample, pdf) < 2e-3


@pytest.mark.parametrize("strategy", ["mis", pytest.param("nee", marks=SLOW)])
def test_a_sampled_sky_lights_as_much(strategy):
    overcast = mc.GradientSky((1.0, 2.0), up=Z, ground=0.0)
    integrand = mc.irradiance(mc.Scene([], sky=overcast), (0, 0, 0), Z, bounces=0, lights=strategy, sample_sky=True)
    assert integrand.labels[:2] == ("event 1, sky: first", "event 1, sky: second")
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), 7.0 * np.pi / 3.0, 2e-3)


def test_a_floor_hides_the_sky_below_it():
    # Shadow rays to the sky meet all faces, those too that cannot stand between two points of the scene.
    floor = mc.Quad((-5000, -5000, 0), (10000, 0, 0), (0, 10000, 0), mc.Diffuse(0.0))
    scene = mc.Scene([floor], sky=1.0)
    integrand = mc.irradiance(scene, (0, 0, 1), (1.0, 0, 0), bounces=0, lights="nee", sample_sky=True)
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), np.pi / 2.0, 1e-2)


@SLOW
def test_sky_and_lights_are_sampled_side_by_side():
    primitives, exact = lamps(3)
    scene = mc.Scene(primitives, sky=0.4)
    with_sky, without = (
        mc.irradiance(scene, (0, 0, 0), Z, bounces=0, lights="mis", sample_sky=flag) for flag in (True, False)
    )
    a, b = mc.integrate(with_sky, n=1 << 20, key=1), mc.integrate(without, n=1 << 20, key=2)
    assert a.mean > exact
    assert_equivalent(a, b, 5e-3)


# ---------------------------------------------------------------------------------------- roulette, terms


@pytest.mark.parametrize(
    ("survival", "after"), [(0.7, 2), *(pytest.param(*case, marks=SLOW) for case in [(0.7, 0), (0.9, 0)])]
)
def test_roulette_keeps_the_mean_and_has_the_variance_of_the_closed_form(survival, after):
    exact = roulette_furnace(survival=survival, guaranteed=after)
    scene = analytic_scenes.sphere_furnace(albedo=0.6, emission=1.0, bounces=6)
    room = scene.integrand.params[0]
    integrand = mc.radiance(
        room, (0.0, 0.0, 0.0), (0.6, 0.0, 0.8), bounces=6, lights="none", roulette=mc.Roulette(survival, after)
    )
    estimate = mc.integrate(integrand, n=1 << 20, key=1)
    assert_unbiased(estimate, exact.exact, 2e-3, variance=exact.exact_variance)
    assert float(estimate.variance) == pytest.approx(exact.exact_variance, rel=0.02)


def test_throughput_roulette_is_unbiased_and_ends_dark_paths():
    scene = analytic_scenes.sphere_furnace(albedo=0.5, emission=1.0, bounces=8).integrand.params[0]
    integrand = mc.radiance(scene, (0, 0, 0), (0.6, 0, 0.8), bounces=8, lights="none", roulette="throughput")
    exact = sum(0.5**k for k in range(9))
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=1), exact, 2e-3)


def test_terms_by_length_add_up_sample_by_sample():
    scene = analytic_scenes.sphere_furnace(albedo=0.5, emission=1.0, bounces=2).integrand.params[0]
    camera = mc.PinholeCamera((0.1, 0.2, 0.3), (1, 0, 0), fov=60, width=4, height=4)
    terms = mc.neumann_terms(scene, camera, bounces=2)
    whole = mc.path_integrand(scene, camera, bounces=2)
    u = np.random.default_rng(2).uniform(size=(5000, terms.dim)).astype(np.float32)
    np.testing.assert_allclose(np.asarray(terms.batch(u)).sum(1), np.asarray(whole.batch(u)), rtol=1e-5)
    estimate = mc.integrate(terms, n=1 << 20, key=1)
    assert_unbiased(estimate, 0.5 ** np.arange(3), 4e-3)
    with pytest.raises(ValueError, match="clamp"):
        mc.neumann_terms(scene, camera, bounces=2, clamp=3.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"roulette": 0.0}, "survival"), ({"roulette": 1.5}, "survival"), ({"roulette": "often"}, "survival"),
        ({"pick": "nearest"}, "pick must be one of"), ({"lights": "all"}, "lights must be one of"),
    ],
)  # fmt: skip
def test_bad_options_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        mc.irradiance(mc.Scene([]), (0, 0, 0), Z, bounces=0, **options)


# ---------------------------------------------------------------------------------------- mutants


def pick_forgotten(right):
    return lambda *args: (right(*args)[0], 1.0 / len(args[0].lights) + 0.0 * right(*args)[1])


def survivors_not_weighted(right):
    def wrong(*args):
        survives, inverse = right(*args)
        return survives, jnp.ones_like(inverse)

    return wrong


def sky_not_weighted(right):
    return lambda sky, normal, wi: 0.0 * right(sky, normal, wi) + 2.0


MUTANTS = [
    (pick_forgotten, lights, "pick_light", lambda: (irradiance(lamps(3)[0], pick="power", lights="nee"), lamps(3)[1])),
    (
        survivors_not_weighted, paths, "play_roulette",
        lambda: (
            mc.radiance(
                analytic_scenes.sphere_furnace(albedo=0.5, emission=1.0, bounces=4).integrand.params[0], (0, 0, 0),
                (0.6, 0, 0.8), bounces=4, lights="none", roulette=0.7,
            ),
            1.9375,
        ),
    ),
    (
        sky_not_weighted, paths, "sky_inverse_pdf",
        lambda: (
            mc.irradiance(
                mc.Scene([], sky=mc.GradientSky((1.0, 2.0), up=Z, ground=0.0)), (0, 0, 0), Z, bounces=0, lights="mis",
                sample_sky=True,
            ),
            7.0 * np.pi / 3.0,
        ),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("mutate", "module", "name", "make"), MUTANTS, ids=lambda x: getattr(x, "__name__", ""))
def test_mutants_are_found(mutate, module, name, make, monkeypatch):
    integrand, exact = make()
    monkeypatch.setattr(module, name, mutate(getattr(module, name)))
    fresh = mc.Integrand(lambda u: integrand.fn(u, *integrand.params), integrand.dim, lazy=True)
    with pytest.raises(AssertionError, match="standard errors off"):
        assert_unbiased(mc.integrate(fresh, n=1 << 20, key=1), exact, 5e-3)
