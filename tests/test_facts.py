"""A scene pays only for what it contains: operations of one path, counted in the jaxpr."""

from collections import Counter

import jax
import jax.numpy as jnp
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration import kernel
from jaxmc.integration.integrand import SAMPLES
from jaxmc.integration.samplers import Independent, Index
from jaxmc.transport.warps import sincos_2pi


def drawn(word):
    """Return a point of the sampler."""
    return Independent().point(jnp.arange(4, dtype=jnp.uint32), Index(word, word))


class Given:
    """A point of which every coordinate is the same number: drawing it takes no operations."""

    def __init__(self, word):
        self.u = word * 0.5

    def __getitem__(self, dimension):
        return self.u


def operations(scene, camera=None, point=drawn, **options):
    """Return how often each primitive operation occurs in one path of a scene, loop bodies included."""
    camera = camera or mc.PinholeCamera((0, 0, 3.9), (0, 0, 0))
    integrand = jax.tree.map(jnp.asarray, mc.path_integrand(scene, camera, bounces=3, **options))
    return _count(lambda integrand, word: integrand.at(point(word)), integrand, jnp.uint32(1))


def _count(function, *arguments):
    return _count_equations(jax.make_jaxpr(function)(*arguments).jaxpr)


def _count_equations(jaxpr):
    count = Counter()
    for equation in jaxpr.eqns:
        count[equation.primitive.name] += 1
        for value in equation.params.values():
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                count += _count_equations(inner)
    return count


FLOOR = ((-1, -1, 1), (2, 0, 0), (0, 0, -2))
TILTED = ((-1, -1, 1), (2, 0.3, 0.1), (0.2, 0.4, -2))
LAMP = mc.Quad((-0.2, 1, -0.2), (0.4, 0, 0), (0, 0, 0.4), mc.Diffuse(0.0), emission=5.0)


GREY = mc.Diffuse(0.5)


def scene(ball=GREY, floor=FLOOR, lamp=LAMP, sky=None, albedo=0.5, more=()):
    return mc.Scene([mc.Quad(*floor, mc.Diffuse(albedo)), mc.Sphere((0, 0, 0), 0.5, ball), lamp, *more], sky)


DARK = mc.Quad((-0.2, 1, -0.2), (0.4, 0, 0), (0, 0, 0.4), mc.Diffuse(0.0))


@pytest.mark.parametrize(
    ("less", "more", "least"),
    [
        (scene(), scene(ball=mc.Mirror(0.5)), 10),
        (scene(), scene(sky=1.0), 3),
        (scene(), scene(sky=(1.0, 0.5, 0.2)), 10),
        (scene(), scene(albedo=(0.5, 0.4, 0.3)), 10),
        (scene(lamp=DARK), scene(), 100),
        (scene(), scene(floor=TILTED), 10),
        (scene(), scene(more=[mc.Sphere((0.8, 0, 0), 0.2, mc.Diffuse(0.5))]), 30),
    ],
    ids=["mirror", "sky", "coloured sky", "colour", "light to sample", "tilted quad", "second sphere"],
)
def test_what_a_scene_lacks_is_not_in_its_kernel(less, more, least):
    assert operations(more).total() - operations(less).total() >= least


# Of paths with a camera, area lights, spheres and quads, diffuse surfaces and mirrors, before there was anything else,
# in float32.
FIRST_SCENES = {
    ("cornell_box", "mis"): 1212, ("cornell_box", "nee"): 1160, ("cornell_box", "none"): 1000,
    ("mirror_box", "mis"): 1385, ("mirror_box", "nee"): 1339, ("mirror_box", "none"): 1131,
}  # fmt: skip


@pytest.mark.parametrize(("name", "lights"), FIRST_SCENES)
def test_features_cost_scenes_without_them_nothing(name, lights):
    # Other versions of JAX may count an operation or two differently.
    with jax.enable_x64(False):
        found = operations(*getattr(scenes, name)(), lights=lights).total()
    assert 0.9 * FIRST_SCENES[name, lights] < found <= 1.005 * FIRST_SCENES[name, lights]


@pytest.mark.parametrize(("name", "lights"), [("cornell_box", "none"), ("mirror_box", "mis")])
def test_float64_costs_longer_polynomials_and_nothing_else(name, lights):
    # Coordinates, of two words there, are not counted. Each of these scenes has one diffuse direction in its loop.
    counts = []
    for is_double in (False, True):
        with jax.enable_x64(is_double):
            path = operations(*getattr(scenes, name)(), point=Given, lights=lights)
            counts.append((path, _count(sincos_2pi, jnp.asarray(0.5))))
    (path, turn), (path64, turn64) = counts
    assert turn64.total() > turn.total() and path64 - path == turn64 - turn and not path - path64


def test_rows_of_paths_that_met_nothing_take_no_steps():
    # The branch is on one number for all of them: it is not turned into a choice for each.
    open_scene, camera = scenes.orb(width=8, height=8)
    integrand = jax.tree.map(jnp.asarray, mc.path_integrand(open_scene, camera, bounces=3))

    def value(word):
        return integrand.at(drawn(word))

    def branches(**names):
        return _count(jax.vmap(value, **names), jnp.arange(16, dtype=jnp.uint32))["cond"]

    assert branches(axis_name=SAMPLES) == branches() + 1
    words = jnp.arange(4096, dtype=jnp.uint32)
    in_step = jax.vmap(value, axis_name=SAMPLES)(words)
    assert float(in_step.sum()) > 0.0
    assert jnp.array_equal(in_step, jax.vmap(value)(words))


def test_a_black_sky_and_a_dark_lamp_are_no_sky_and_no_lamp():
    assert operations(scene(sky=0.0)) == operations(scene())
    dark = mc.Quad((-0.2, 1, -0.2), (0.4, 0, 0), (0, 0, 0.4), mc.Diffuse(0.0), emission=0.0)
    assert operations(scene(lamp=dark)) == operations(scene(lamp=DARK))


def test_mirror_code_is_the_reflection_and_its_choices():
    # The reflected direction is the one thing that selects between two directions: three selects for wi.
    diffuse, mirror = operations(scene()), operations(scene(ball=mc.Mirror(0.5)))
    assert mirror["select_n"] > diffuse["select_n"] and mirror["or"] > diffuse["or"]
    # In float64 the sampler joins two words to a coordinate.
    assert jax.config.jax_enable_x64 or "or" not in diffuse


def test_grey_costs_one_channel_and_equal_values_are_looked_up_once():
    same = mc.Diffuse(0.5)
    grey = mc.Scene([mc.Quad(*FLOOR, same), mc.Sphere((0, 0, 0), 0.5, same), LAMP])
    assert grey.channels == 1 and scene(albedo=(0.5, 0.4, 0.3)).channels == 3
    assert len(grey.reflectance.values) == 2


def test_without_lights_to_sample_there_are_no_coordinates_for_them():
    camera = mc.PinholeCamera((0, 0, 3.9), (0, 0, 0))
    dims = {
        name: mc.path_integrand(s, camera, bounces=3).dim for name, s in [("lit", scene()), ("dark", scene(lamp=DARK))]
    }
    assert dims == {"lit": 2 + 3 * 4, "dark": 2 + 3 * 2}
    assert mc.path_integrand(scene(), camera, bounces=3, lights="none").dim == 2 + 3 * 2
    two = scene(more=[mc.Sphere((0, 2, 0), 0.1, emission=1.0)])
    integrand = mc.path_integrand(two, camera, bounces=3)
    assert integrand.dim == 2 + 3 * 5 == len(integrand.labels) and integrand.labels[4] == "event 1, which light"


def test_shadow_casters_are_what_can_lie_between_two_points():
    room, _ = scenes.cornell_box()
    assert room.casters == (5, 6, 7) and room.empty == (6, 7)
    inside = mc.Scene([mc.Sphere((0, 0, 0), 2.0, inward=True), mc.Sphere((0, 0, 0), 0.5), mc.Quad(*FLOOR)])
    assert inside.empty == () and 2 in inside.casters


def test_other_values_run_the_same_kernel():
    camera = mc.PinholeCamera((0, 0, 3.9), (0, 0, 0), width=8, height=8)
    mc.render(scene(), camera, spp=1, bounces=3)
    before = kernel.evaluate._cache_size()
    other = scene(ball=mc.Diffuse(0.3), lamp=mc.Quad((-0.3, 1, -0.2), (0.6, 0, 0), (0, 0, 0.4), mc.Diffuse(0.0), 7.0))
    mc.render(other, camera, spp=1, bounces=3, key=1)
    moved = mc.PinholeCamera((0.5, 0.2, 3.0), (0, 0, 0), fov=30, width=8, height=8)
    mc.render(scene(), moved, spp=1, bounces=3)
    assert kernel.evaluate._cache_size() == before + (other.reflectance.group != scene().reflectance.group)


@pytest.mark.parametrize("albedo, channels", [(0.5, 1), ((0.5, 0.5, 0.5), 3)])
def test_facts_are_not_drawn_from_values_that_are_traced(albedo, channels):
    def value(albedo):
        traced = scene(ball=mc.Diffuse(albedo))
        assert traced.channels == channels  # one number is grey whatever it is
        return (
            mc.path_integrand(traced, mc.PinholeCamera((0, 0, 3.9), (0, 0, 0)), bounces=1)
            .batch(jnp.full((1, 6), 0.3))
            .sum()
        )

    assert jnp.isfinite(jnp.asarray(jax.grad(value)(albedo))).all()
