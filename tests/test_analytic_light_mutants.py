"""Estimators, closed forms and derivatives that are wrong on purpose: the checks must reject them."""

import dataclasses
import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_analytic_light_estimates import POINTS, RANDOMISATIONS, check, check_variance, even_points

import analytic_scenes as scenes
import jaxmc as mc
from analytic_scenes import sky_shares
from analytic_scenes.scene import value_of
from jaxmc.backend import QUICK_OPTIONS
from jaxmc.testing import assert_unbiased
from jaxmc.transport import bsdfs, integrands, paths, spheres

CUT = {"radius": 1.2, "distance": 2.0, "theta": math.radians(80)}
SCENES = {
    "orb, uniform": lambda: scenes.orb_over_floor(radius=0.9, height=1.0, lights="none", directions="uniform"),
    "mean under a sphere": scenes.sphere_light_over_rectangle,
    "cut by the horizon": lambda: scenes.sphere_light(**CUT),
    "mirror": scenes.sphere_light_in_small_mirror,
    "corner": scenes.sphere_light_in_corner,
    "shadow": lambda: scenes.rectangle_behind_rectangle(lights="nee"),
    "sky": scenes.tilted_under_sky,
    "reach": scenes.open_beside_sphere_within,
    "pixel": scenes.open_pixel_under_sphere,
    "ball": scenes.sphere_light_in_mirror_ball,
}


# ---------------------------------------------------------------------------------------- estimators
#
# A mutant replaces one function of the path tracer by ``wrong(right)``; its name says what is wrong.


def no_cosine(right):
    return lambda *args: right(*args)._replace(weight=1.0)


def density_per_area(right):
    # Of the disk that the sphere shows, at its own distance.
    def wrong(light, point, own, u1, u2):
        drawn = right(light, point, own, u1, u2)
        return drawn._replace(inverse_pdf=jnp.pi * light.sphere.radius**2 + 0.0 * drawn.distance)

    return wrong


def light_from_below_the_horizon(right):
    def wrong(scene, strategy, vertex, u):
        turned = vertex.surface._replace(normal=-vertex.surface.normal)
        return right(scene, strategy, vertex, u) + right(scene, strategy, vertex._replace(surface=turned), u)

    return wrong


def directions_below_the_horizon(right):
    def wrong(scene, directions, surface, *rest):
        return right(scene, directions, surface._replace(normal=-surface.normal), *rest)

    return wrong


def reflectance_forgotten(right):
    def wrong(*args):
        surface = right(*args)
        return surface._replace(reflectance=1.0 + 0.0 * surface.reflectance)

    return wrong


def no_shadow(right):
    return lambda *args: jnp.ones((), bool)


def sky_upside_down(right):
    return lambda sky, direction: right(sky, -direction)


def ray_goes_through_the_mirror(right):
    return lambda direction, normal: direction


def last_reflection_forgotten(right):
    def wrong(scene, strategy, u, first, state, bounces, observe=None):
        return right(scene, strategy, u, first, state, bounces - 1, observe)

    return wrong


MUTANTS = [  # what is wrong, the module that holds the function, its name, and the scene that shows it
    (no_cosine, paths, "sample_bsdf", "orb, uniform"),
    (density_per_area, spheres, "sample", "mean under a sphere"),
    (light_from_below_the_horizon, paths, "_direct_light", "cut by the horizon"),
    (directions_below_the_horizon, paths, "sample_bsdf", "sky"),
    (reflectance_forgotten, paths, "surface_at", "mirror"),
    (no_shadow, paths, "unoccluded", "shadow"),
    (sky_upside_down, paths, "sky_radiance", "sky"),
]
FURTHER_MUTANTS = [
    (directions_below_the_horizon, paths, "sample_bsdf", "pixel"),
    (reflectance_forgotten, paths, "surface_at", "ball"),
    (ray_goes_through_the_mirror, bsdfs, "reflect", "mirror"),
    (last_reflection_forgotten, integrands, "follow", "corner"),
]


def _named(x):
    return getattr(x, "__name__", str(x)).rpartition(".")[2]


def some_slow(quick, others):
    return [*quick, *(pytest.param(*case, marks=pytest.mark.slow) for case in others)]


@pytest.mark.parametrize(("mutate", "module", "name", "scene"), some_slow(MUTANTS, FURTHER_MUTANTS), ids=_named)
def test_the_check_rejects_an_estimator(mutate, module, name, scene, monkeypatch):
    wrong, calls = mutate(getattr(module, name)), []

    def counted(*args, **options):
        calls.append(name)
        return wrong(*args, **options)

    monkeypatch.setattr(module, name, counted)
    right = SCENES[scene]()
    # No cache has seen this function, so it is traced with the code as it is now.
    fresh = dataclasses.replace(right.integrand, fn=lambda u, *params: right.integrand.fn(u, *params))
    with pytest.raises(AssertionError, match="the mean is more than 5 standard errors off"):
        check(dataclasses.replace(right, integrand=fresh), rtol=2e-3)
    assert calls, "the mutant has not run"


# ---------------------------------------------------------------------------------------- closed forms


def all_of_the_sphere():
    """The irradiance of a sphere as if no horizon cut it."""
    return 10.0 * math.pi * 0.6**2 * math.cos(CUT["theta"])


def both_spheres_in_full():
    scene = scenes.open_under_two_spheres()
    sky = [scenes.sphere_at_irradiance(1 / math.pi, scene.arguments[f"center_{k}"], scene.arguments[f"radius_{k}"])
           for k in (1, 2)]  # fmt: skip
    return 1.0 - float(sum(sky))


def reflectance_once_for_all_images():
    scene = scenes.sphere_light_in_corner()
    none, all_of_it = (value_of(scene.formula, {**scene.arguments, "reflectance": r}) for r in (0.0, 1.0))
    return none + 0.9 * (all_of_it - none)


def sky_linear_in_the_angle():
    """The irradiance of a sky that is linear in the elevation, not in its sine."""
    angles = (np.arange(1000) + 0.5) / 1000 * math.pi / 2
    radiance = 2.0 * (1.0 + 1.5 * (1.0 - angles / (math.pi / 2)))
    return 2 * math.pi * np.sum(radiance * np.sin(angles) * np.cos(angles)) * math.pi / 2000


WRONG_FORMULAS = [
    (lambda: scenes.sphere_light(**CUT), all_of_the_sphere),
    (scenes.open_beside_sphere_within, lambda: scenes.open_beside_sphere(0.8, math.sqrt(5), math.atan(0.5)).exact),
    (scenes.sphere_behind_sphere, lambda: scenes.sphere_light(5.0, 1.2, math.hypot(0.3, 0.2, 2.0), 0.178).exact),
]
FURTHER_FORMULAS = [
    (scenes.open_under_two_spheres, both_spheres_in_full),
    (scenes.open_pixel_under_sphere, lambda: float(sky_shares.beside_sphere(0.8, math.hypot(2, 1.2), math.atan(0.6)))),
    (scenes.open_in_corner_within, lambda: 0.25),
    (scenes.sphere_light_in_corner, reflectance_once_for_all_images),
    (lambda: scenes.tilted_under_sky(tilt=0.0), sky_linear_in_the_angle),
]


@pytest.mark.parametrize(("make", "wrong"), some_slow(WRONG_FORMULAS, FURTHER_FORMULAS))
def test_the_check_rejects_a_closed_form(make, wrong):
    scene = make()
    check(scene)
    assert wrong() == pytest.approx(scene.exact, rel=0.5)  # the same quantity, not just any number
    with pytest.raises(AssertionError, match="the mean is more than 5 standard errors off"):
        check(dataclasses.replace(scene, exact=wrong()))


WRONG_LAWS = [
    (lambda **o: scenes.orb_over_floor(lights="none", **o), {"directions": "uniform"}),
    (lambda **o: scenes.ceiling_lamp(**o), {"height": 1.98}),
]
FURTHER_LAWS = [
    (lambda **o: scenes.sphere_light_between_mirrors(**o), {"reflectance": 0.85}),
    (lambda **o: scenes.tilted_under_sky(**o), {"directions": "uniform"}),
]


@pytest.mark.parametrize(("make", "wrong"), some_slow(WRONG_LAWS, FURTHER_LAWS))
def test_the_check_rejects_a_variance(make, wrong):
    right = make()
    check_variance(right)
    with pytest.raises(AssertionError):
        check_variance(dataclasses.replace(right, exact_variance=make(**wrong).exact_variance))


# ---------------------------------------------------------------------------------------- derivatives


def derivative_estimate(irradiance, x):
    """Return the mean of the derivative of samples with respect to x: edges do not come into it."""

    def slope(x, u):
        return jax.grad(lambda x: irradiance(x)(u))(x)

    run = jax.jit(jax.vmap(slope, (None, 0)), compiler_options=QUICK_OPTIONS)
    slopes = np.asarray(run(x, jnp.asarray(even_points(4), float)), np.float64)
    means = slopes.reshape(RANDOMISATIONS, POINTS).mean(axis=1)
    return SimpleNamespace(mean=means.mean(), variance=means.var(ddof=1), n=RANDOMISATIONS, nonfinite=0)


def behind_a_screen(emission=5.0, edge=0.1):
    light = mc.Quad((-1.5, -1.2, 1.5), (0.0, 2.4, 0.0), (3.0, 0.0, 0.0), mc.Diffuse(0.0), emission)
    screen = mc.Quad((edge, -1.5, 1.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0), mc.Diffuse(0.0))
    return mc.irradiance(mc.Scene([light, screen]), (0, 0, 0), (0, 0, 1), bounces=0, lights="nee").map(jnp.mean)


def test_the_check_rejects_a_derivative_without_its_edge():
    truth = scenes.rectangle_behind_rectangle(lights="nee").derivatives
    interior = derivative_estimate(lambda emission: behind_a_screen(emission=emission), 5.0)
    assert_unbiased(interior, truth["emission"], 1e-3)
    without_edge = derivative_estimate(lambda edge: behind_a_screen(edge=edge), 0.1)
    assert without_edge.mean == 0.0 and truth["blocker_corner"][0] > 1.0
    with pytest.raises(AssertionError, match="the mean is more than 5 standard errors off"):
        assert_unbiased(without_edge, truth["blocker_corner"][0], 1e-3)


def test_the_true_derivative_explains_the_difference_of_estimates():
    """Estimates with the edge here and there differ by the integral of the true derivative between."""
    edges = np.polynomial.legendre.leggauss(6)
    low, high = 0.0, 0.3
    slopes = [
        scenes.rectangle_behind_rectangle(blocker_corner=(0.15 + 0.15 * x, -1.5, 1.0)).derivatives["blocker_corner"][0]
        for x in edges[0]
    ]
    between = 0.15 * edges[1] @ slopes
    drawn = [scenes.rectangle_behind_rectangle(blocker_corner=(x, -1.5, 1.0), lights="nee") for x in (low, high)]
    assert drawn[1].exact - drawn[0].exact == pytest.approx(between, rel=1e-8)
    for scene in drawn:
        check(scene)


def test_impossible_scenes_are_refused():
    for make in (
        lambda: scenes.sphere_light_over_rectangle(radius=2.0),
        lambda: scenes.sphere_light_over_rectangle(x0=1.4, x1=0.2),
        lambda: scenes.orb_over_floor(radius=1.0, height=1.0, offset=0.0),
        lambda: scenes.ball_in_sunlight(phase=4.0),
        lambda: scenes.light_solid_angle((0, 0, -0.1), (1, 0, 0), (0, 1, 1)),
        lambda: scenes.open_beside_sphere(2.0, 1.0),
        lambda: scenes.open_solid_angle_beside_sphere(theta=1.5),
        lambda: scenes.open_beside_wall_within(2.0, 1.0),
        lambda: scenes.open_in_corner_within(1.2, 1.2, 1.6),
        lambda: scenes.open_pixel_under_sphere(radius=2.0),
        lambda: scenes.tilted_under_sky(tilt=4.0),
        lambda: scenes.tilted_under_sky(slope=-1.5),
        lambda: scenes.sphere_in_sky(radius=3.0),
        lambda: scenes.sphere_behind_sphere(blocker_center=(0.3, 0.2, 5.0)),
        lambda: scenes.sphere_behind_rectangle(blocker_corner=(0.15, -0.5, 1.5)),
        lambda: scenes.rectangle_behind_sphere(blocker_center=(0.5, 0.4, 1.2)),
        lambda: scenes.rectangle_behind_rectangle(blocker_corner=(0.1, -1.5, 2.0)),
        lambda: scenes.rectangle_behind_rectangle(edge_u=(3.0, 0, 0), edge_v=(0, 2.4, 0)),
        lambda: scenes.rectangle_behind_rectangle(blocker_corner=(0.1, -1.5, 0.0)),
        lambda: scenes.sphere_light_in_small_mirror(center=(0.2, 0.0, 0.6)),
        lambda: scenes.sphere_light_between_mirrors(radius=1.1),
        lambda: scenes.sphere_light_between_mirrors(bounces=5),
        lambda: scenes.sphere_light_in_corner(center=(-0.5, 0.6, 0.2)),
        lambda: scenes.sphere_light_in_mirror_ball(radius=2.5),
        lambda: scenes.sphere_light_in_mirror_ball(6.0, 0.9, (0.0, 0.0, 0.3), 0.2),
        lambda: scenes.sphere_light_in_mirror_ball(6.0, 0.9, (0.2, 0.0, -0.75), 0.74, (2.0, 0.0, 0.2), 1.0),
        lambda: scenes.mirror_ball_caustic(inner=0.5),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"must|may|needed|edge-on|negative"):
            make()
