"""Known mistakes must fail the check that the right code passes."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc.testing import assert_unbiased
from jaxmc.transport import materials, paths, shapes, warps
from jaxmc.transport.vec import Vec3, normalize

LAMP = partial(
    analytic_scenes.rectangle_light, corner=(-0.6, -0.5, 0.6), edge_u=(0.0, 1.0, 0.2), edge_v=(1.2, 0.0, 0.0)
)
FURNACE = partial(analytic_scenes.cube_furnace, albedo=0.6, bounces=3)


@pytest.fixture
def fresh():
    """Trace anew: kernels compiled before know nothing of a patch, and those compiled with it must not outlive it."""
    jax.clear_caches()
    yield
    jax.clear_caches()


def check(scene, n=1 << 21):
    assert_unbiased(mc.integrate(scene.integrand, n=n, key=5), scene.exact, rel_precision=2e-3)


def patch_sample(**changes):
    """Return a mutant of ``sample_diffuse`` that changes pdf or weight."""

    def mutant(directions, normal, u1, u2):
        wi, pdf, weight = materials.sample_diffuse(directions, normal, u1, u2)
        return wi, changes.get("pdf", lambda p: p)(pdf), changes.get("weight", lambda w: w)(weight)

    return mutant


def missing_cosine(monkeypatch):
    """Uniform directions without the cosine: every bounce weighs 2 instead of 2 cos(theta)."""
    monkeypatch.setattr(paths, "sample_diffuse", patch_sample(weight=lambda w: 2.0 * jnp.ones_like(w)))
    return FURNACE(directions="uniform")


def area_for_solid_angle(monkeypatch):
    """The density of a light sample per area, not per solid angle: no cosine at the light, no squared distance."""
    right = shapes.sample_quad_light

    def mutant(light, *args):
        return right(light, *args)._replace(inverse_pdf=light.area)

    monkeypatch.setattr(shapes, "sample_quad_light", mutant)
    return LAMP(lights="nee")


def weights_above_one(monkeypatch):
    """MIS weights that sum to 1.02."""
    right = paths.power_heuristic
    monkeypatch.setattr(paths, "power_heuristic", lambda *densities: 1.02 * right(*densities))
    return LAMP(lights="mis")


def both_strategies_in_full(monkeypatch):
    """Light counted by both strategies without weights."""
    monkeypatch.setattr(paths, "power_heuristic", lambda *densities: 1.0)
    return LAMP(lights="mis")


def one_bounce_fewer(monkeypatch):
    """A path that stops one event early."""
    return dataclasses.replace(FURNACE(), integrand=FURNACE(bounces=2).integrand)


def reused_coordinate(monkeypatch):
    """Both coordinates of the light point the same."""
    right = shapes.sample_quad_light
    monkeypatch.setattr(shapes, "sample_quad_light", lambda light, *args: right(light, *args[:-1], args[-2]))
    return LAMP(lights="nee")


def cube_directions(monkeypatch):
    """Normalised points of a cube for directions, folded to the upper side."""

    def mutant(u1, u2):
        third = jnp.modf(u1 * 4096.0)[0]
        return normalize(Vec3(2.0 * u1 - 1.0, 2.0 * u2 - 1.0, third + 1e-3))

    monkeypatch.setattr(materials, "sample_cosine_hemisphere", mutant)
    return LAMP(lights="none")


def reversed_polar_angle(monkeypatch):
    """Directions uniform over the hemisphere, weighted as if they were cosine-weighted."""
    monkeypatch.setattr(materials, "sample_cosine_hemisphere", warps.sample_uniform_hemisphere)
    return LAMP(lights="none")


MUTANTS = [
    missing_cosine,
    area_for_solid_angle,
    weights_above_one,
    both_strategies_in_full,
    one_bounce_fewer,
    reused_coordinate,
    cube_directions,
    reversed_polar_angle,
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.__name__)
def test_mutant_fails(mutant, monkeypatch, fresh):
    scene = mutant(monkeypatch)
    with pytest.raises(AssertionError, match="standard errors off"):
        check(scene)


@pytest.mark.parametrize(
    "make",
    [
        lambda: FURNACE(directions="uniform"),
        FURNACE,
        lambda: LAMP(lights="none"),
        lambda: LAMP(lights="nee"),
        lambda: LAMP(lights="mis"),
    ],
    ids=["uniform furnace", "furnace", "none", "nee", "mis"],
)
def test_the_right_code_passes(make):
    check(make())
