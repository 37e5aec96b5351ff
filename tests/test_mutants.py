"""Estimators that are wrong on purpose: the check that the right ones pass must tell each of them apart."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc.testing import assert_unbiased
from jaxmc.transport import bsdfs, flats, paths, spheres, warps
from jaxmc.transport.vec import Vec3, normalize

PRECISION = 1e-3  # the smallest mistake below is one of 1 %
BLACK = mc.Diffuse(0.0)


def fresh(integrand):
    """Return the integrand as a function that no cache has seen, so that it is traced with the code as it is now."""
    return dataclasses.replace(integrand, fn=lambda u, *params: integrand.fn(u, *params))


def check(integrand, exact, n):
    assert_unbiased(mc.integrate(fresh(integrand), n=n, key=1), exact, PRECISION)


# ---------------------------------------------------------------------------------------- scenes with known values


def furnace(directions):
    scene = analytic_scenes.sphere_furnace(directions=directions)
    return scene.integrand, scene.exact, 1 << 20


def lit_furnace():
    scene = analytic_scenes.cube_furnace(lights="mis")
    return scene.integrand, scene.exact, 1 << 20


def rectangle(lights):
    large = {"corner": (-0.6, -0.5, 0.6), "edge_u": (0.0, 1.0, 0.2), "edge_v": (1.2, 0.0, 0.0)}
    scene = analytic_scenes.rectangle_light(**large, lights=lights)
    return scene.integrand, scene.exact, 1 << 22


def two_faced():
    """Return the irradiance from a rectangle that faces the receiver, beside one of the same kind that faces away."""
    corner, u, v = (-1.2, -0.5, 2.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
    facing = mc.Quad(corner, u, v, BLACK, emission=5.0)
    away = mc.Quad((0.4, -0.5, 2.0), v, u, BLACK, emission=5.0)
    exact, _ = analytic_scenes.value_and_derivatives(
        analytic_scenes.parallelogram_irradiance, emission=5.0, corner=corner, edge_u=u, edge_v=v
    )
    return mc.irradiance(mc.Scene([facing, away]), (0, 0, 0), (0, 0, 1), bounces=0, lights="nee"), exact, 1 << 22


def convex_ball():
    """Return the radiance of a sphere under a white sky: all that it scatters escapes, so it is albedo times sky."""
    scene = mc.Scene([mc.Sphere((0.3, 0.2, -0.1), 0.7, mc.Diffuse(0.5))], sky=2.0)
    return mc.radiance(scene, (3, 1, 2), (-2.7, -0.8, -2.1), bounces=3, lights="none"), 1.0, 1 << 20


SCENES = {
    "furnace": lambda: furnace("cosine"),
    "furnace, uniform": lambda: furnace("uniform"),
    "furnace, mis": lit_furnace,
    "rectangle, none": lambda: rectangle("none"),
    "rectangle, nee": lambda: rectangle("nee"),
    "rectangle, mis": lambda: rectangle("mis"),
    "two-faced": two_faced,
    "convex ball": convex_ball,
}


# The rest are among the scenes of test_analytic_scenes.
@pytest.mark.parametrize("name", ["rectangle, none", "rectangle, nee", "rectangle, mis", "two-faced", "convex ball"])
def test_the_right_estimator_passes(name):
    check(*SCENES[name]())


# ---------------------------------------------------------------------------------------- mutants
#
# A mutant replaces one function by ``wrong(right)``; its name says what is wrong.


def no_cosine_at_the_light(right):
    def wrong(light, *args):
        drawn = right(light, *args)
        return drawn._replace(inverse_pdf=light.area / (drawn.distance * drawn.distance))

    return wrong


def density_per_area(right):
    def wrong(light, *args):
        return right(light, *args)._replace(inverse_pdf=light.area)

    return wrong


def weights_that_sum_to_1_02(right):
    return lambda *args: 1.02 * right(*args)


def both_strategies_count_in_full(right):
    return lambda *args: 0.0 * right(*args) + 1.0


def light_point_on_a_diagonal(right):
    return lambda light, point, own, u1, u2: right(light, point, own, u1, u1)


def uniform_directions_with_the_weight_of_cosine_ones(right):
    return warps.sample_uniform_hemisphere


def one_event_too_few(right):
    def wrong(scene, strategy, u, first, state, bounces, observe=None):
        return right(scene, strategy, u, first, state, bounces - 1, observe)

    return wrong


class Reused:
    """A point of the hypercube in which coordinate ``taken`` is the one at ``given``."""

    def __init__(self, u, taken, given):
        self.u, self.taken, self.given = u, taken, given

    def __getitem__(self, k):
        return self.u[jnp.where(k == self.taken, self.given, k)]


def light_picked_by_the_direction_that_led_here(right):
    # An event has five coordinates: two for the point on the light, one to pick the light, polar, azimuth.
    def wrong(scene, strategy, vertex, u):
        return right(scene, strategy, vertex, Reused(u, vertex.first + 2, vertex.first - 2))

    return wrong


def every_event_uses_the_first_coordinates(right):
    def wrong(scene, strategy, u, first, *rest, **event):
        return right(scene, strategy, u, 0, *rest, **event)

    return wrong


def cube_normalised_direction(right):
    # A point drawn in the upper half of a cube and scaled to unit length crowds toward the cube's edges.
    def wrong(u1, u2):
        z = u1 * 4096.0 - jnp.floor(u1 * 4096.0)
        return normalize(Vec3(2.0 * u1 - 1.0, 2.0 * u2 - 1.0, z))

    return wrong


def light_shines_from_its_back(right):
    def wrong(light, point, own, u1, u2):
        front, turned = right(light, point, own, u1, u2), dataclasses.replace(light, normal=-light.normal)
        return front._replace(inverse_pdf=front.inverse_pdf + right(turned, point, own, u1, u2).inverse_pdf)

    return wrong


def surfaces_shadow_themselves(right):
    return lambda sphere, ray, own: right(sphere, ray, False)


MUTANTS = [  # what is wrong, where (the modules that hold the name), and the scene that shows it
    (no_cosine_at_the_light, [flats], "sample", "rectangle, nee"),
    (density_per_area, [flats], "sample", "rectangle, nee"),
    (weights_that_sum_to_1_02, [paths, bsdfs], "power_heuristic", "rectangle, mis"),
    (both_strategies_count_in_full, [paths, bsdfs], "power_heuristic", "rectangle, mis"),
    (light_point_on_a_diagonal, [flats], "sample", "rectangle, nee"),
    (uniform_directions_with_the_weight_of_cosine_ones, [bsdfs], "sample_cosine_hemisphere", "rectangle, none"),
    (one_event_too_few, [paths], "follow", "furnace"),
    (light_picked_by_the_direction_that_led_here, [paths], "_direct_light", "furnace, mis"),
    (every_event_uses_the_first_coordinates, [paths], "scatter", "furnace, uniform"),
    (cube_normalised_direction, [bsdfs, warps], "sample_uniform_hemisphere", "furnace, uniform"),
    (light_shines_from_its_back, [flats], "sample", "two-faced"),
    (surfaces_shadow_themselves, [spheres], "intersect", "convex ball"),
]


@pytest.mark.parametrize(("mutate", "modules", "name", "scene"), MUTANTS, ids=lambda x: getattr(x, "__name__", ""))
def test_the_check_rejects_a_mutant(mutate, modules, name, scene, monkeypatch):
    wrong, calls = mutate(getattr(modules[0], name)), []

    def counted(*args, **named):
        calls.append(name)
        return wrong(*args, **named)

    for module in modules:
        monkeypatch.setattr(module, name, counted)
    # It fails for its mean: its error bar is as small as that of the right one.
    with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
        check(*SCENES[scene]())
    assert calls, "the mutant has not run"


def test_a_kernel_that_was_compiled_before_is_not_a_mutant(monkeypatch):
    # Why ``fresh`` is needed: the driver keeps the kernel of an integrand that it knows.
    integrand, _, n = SCENES["rectangle, nee"]()
    right = mc.integrate(integrand, n=n, key=1).mean
    monkeypatch.setattr(flats, "sample", density_per_area(flats.sample))
    assert mc.integrate(integrand, n=n, key=1).mean == right


# ---------------------------------------------------------------------------------------- the check itself


def estimate(mean, variance, n=10_000, nonfinite=0):
    return SimpleNamespace(mean=mean, variance=variance, n=n, nonfinite=nonfinite)


def test_the_check_passes_only_on_evidence():
    uniform = estimate(0.501, 1 / 12)
    assert_unbiased(uniform, 0.5, rel_precision=0.01)
    assert_unbiased(uniform, 0.5, rel_precision=0.01, variance=1 / 12)
    with pytest.raises(AssertionError, match=r"too wide to be evidence: mean 0\.501, exact 0\.5, .* n = 10,000"):
        assert_unbiased(uniform, 0.5, rel_precision=1e-3)
    with pytest.raises(AssertionError, match="too wide to be evidence"):
        assert_unbiased(uniform, 0.5, rel_precision=0.01, variance=10.0)
    with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
        assert_unbiased(uniform, 0.52, rel_precision=0.01)
    with pytest.raises(AssertionError, match="too wide"):
        assert_unbiased(uniform, 0.0, rel_precision=0.01)


def test_the_check_looks_at_every_component_and_every_value():
    variance = np.full(2, 1 / 12)
    assert_unbiased(estimate(np.array([0.501, 0.499]), variance), [0.5, 0.5], rel_precision=0.01)
    with pytest.raises(AssertionError, match="5 standard errors off"):
        assert_unbiased(estimate(np.array([0.501, 0.499]), variance), [0.5, 0.6], rel_precision=0.01)
    for bad in (np.nan, np.inf):
        with pytest.raises(AssertionError, match="1 values were not finite"):
            assert_unbiased(estimate(np.array([0.5, bad]), variance, nonfinite=1), [0.5, 0.5], rel_precision=0.01)
    with pytest.raises(AssertionError, match="3 values were not finite"):
        assert_unbiased(estimate(0.5, 1 / 12, nonfinite=3), 0.5, rel_precision=0.01)
    with pytest.raises(AssertionError):  # of one sample there is no variance
        assert_unbiased(estimate(0.5, np.nan, n=1), 0.5, rel_precision=0.01)


def test_values_that_do_not_vary_may_be_off_by_rounding_only():
    constant = estimate(3.0, 1e-14)
    assert_unbiased(constant, 3.0, rel_precision=1e-9)
    assert_unbiased(constant, 3.0 * (1 + 9e-6), rel_precision=1e-9)
    for factor in (1 + 2e-5, 1 - 2e-5, 2.0, -1.0):
        with pytest.raises(AssertionError, match="5 standard errors off"):
            assert_unbiased(constant, 3.0 * factor, rel_precision=1e-9)
    assert_unbiased(estimate(0.0, 0.0), 0.0, rel_precision=0.0)
    for wrong in (estimate(1e-30, 0.0), estimate(0.0, 1e-30)):
        with pytest.raises(AssertionError):
            assert_unbiased(wrong, 0.0, rel_precision=0.0)
