"""Path integrands in parts: they sum to the whole, and each contribution is in the part that its path belongs to."""

import itertools
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.transport import path_parts
from jaxmc.transport.path_classes import automaton, classify
from jaxmc.transport.path_parts import CLASSES
from jaxmc.transport.paths import Gained

PATTERNS = ["E L", "E D L", "E D S+ L", "E S* [DG] L", "E .* D S+ L", "E (DS|G)+ L", "E D? (S|GD)* .? L", "E .* L"]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_class_is_the_regular_expression_it_reads_as(pattern):
    machine = automaton([pattern])
    python = re.compile(pattern.replace(" ", "")[1:-1].replace(".", "[DGS]"))
    for length in range(6):
        for word in map("".join, itertools.product("DGS", repeat=length)):
            assert (classify(machine, word) == 0) == bool(python.fullmatch(word)), word


def test_the_first_class_that_matches_counts():
    first, second = automaton(["E D .* L", "E .* L"]), automaton(["E .* L", "E D .* L"])
    assert [classify(first, w) for w in ("", "D", "S", "DSG")] == [1, 0, 1, 0]
    assert [classify(second, w) for w in ("", "D", "S", "DSG")] == [0, 0, 0, 0]
    assert classify(automaton(["E D L"]), "DD") == 1
    default = automaton(CLASSES)
    words = ("", "SS", "D", "SG", "DS", "SDSS", "DDS", "DD", "DSD")
    assert [classify(default, w) for w in words] == [0, 1, 2, 2, 3, 3, 4, 5, 5]


@pytest.mark.parametrize(
    "classes",
    [[], "E L", ["D L"], ["E D"], ["E X L"], ["E (D L"], ["E D) L"], ["E [] L"], ["E [DX] L"], ["E * L"], [3]],
)
def test_malformed_classes_are_refused(classes):
    with pytest.raises(ValueError, match="class"):
        automaton(classes)


def test_too_many_states_are_refused():
    with pytest.raises(ValueError, match="256 states"):
        automaton(["E .* D " + ". " * 9 + "L"])


def everything(colored=True):
    """Return a scene with all materials, a light and a sky."""
    tint = (0.7, 0.5, 0.3) if colored else 0.6
    things = [
        mc.Quad((-2, 0, 2), (4, 0, 0), (0, 0, -4), mc.Diffuse(tint)),
        mc.Sphere((-0.9, 0.5, 0), 0.45, mc.Mirror(0.9)),
        mc.Sphere((0.0, 0.5, 0), 0.4, mc.RoughConductor(0.3, 0.8)),
        mc.Sphere((0.9, 0.5, 0), 0.45, mc.Dielectric(1.5)),
        mc.Quad((-0.4, 2, -0.4), (0.8, 0, 0), (0, 0, 0.8), mc.Diffuse(0.2), emission=20.0),
    ]
    return mc.Scene(things, sky=0.5), mc.PinholeCamera((0, 1.2, 4), (0, 0.5, 0), fov=40, width=16, height=8)


def values(integrand, n=4000, seed=0):
    u = np.random.default_rng(seed).random((n, integrand.dim))
    return np.asarray(integrand.batch(u))


def three_quads():
    """Return a grey floor and a mirror beside it under a light."""
    things = [
        mc.Quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), mc.Diffuse(0.6)),
        mc.Quad((1, 0, 1), (0, 0, -2), (0, 2, 0), mc.Mirror(0.9)),
        mc.Quad((-0.4, 1.5, -0.4), (0.8, 0, 0), (0, 0, 0.8), mc.Diffuse(0.0), emission=20.0),
    ]
    return mc.Scene(things), mc.PinholeCamera((0, 1.0, 4), (0, 0.5, 0), fov=40, width=16, height=8)


SETUPS = {
    "three quads": (three_quads, {"bounces": 2}),
    "mirror box": (partial(scenes.mirror_box, width=8, height=8), {"bounces": 4, "hide_emitters": True}),
    "all materials, sky sampled": (everything, {"bounces": 3, "sample_sky": True}),
    "nothing sampled, roulette": (everything, {"bounces": 3, "lights": "none", "roulette": mc.Roulette(0.7)}),
    "grey, lights sampled only": (lambda: everything(False), {"bounces": 2, "lights": "nee", "hide_emitters": True}),
    "one event": (everything, {"bounces": 1}),
    "none": (everything, {"bounces": 0}),
}


QUICK = ("three quads", "none")


@pytest.mark.parametrize("name", [k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in SETUPS])
def test_parts_sum_to_the_path_integrand_sample_by_sample(name):
    check_the_sum(*SETUPS[name])


def check_the_sum(build, options):
    scene, camera = build()
    whole = np.asarray(mc.luminance(values(mc.path_integrand(scene, camera, **options))))
    assert whole.max() > 0.0
    parts = mc.path_parts(scene, camera, by=("class", "technique", "bounce"), **options)
    found = values(parts)
    names = mc.part_names(parts)
    assert found.shape[1:] == (len(names),) and len(set(names)) == len(names)
    assert np.allclose(found.sum(1), whole, rtol=1e-5, atol=1e-6)
    assert not found[:, [k for k, n in enumerate(names) if n.startswith("other")]].any()


def test_a_part_that_is_lost_is_seen(monkeypatch):
    right = path_parts._Observer.__call__

    def lost(self, surface, after):
        event = right(self, surface, after)
        return event._replace(met=jnp.zeros_like(event.met))

    monkeypatch.setattr(path_parts._Observer, "__call__", lost)
    with pytest.raises(AssertionError):
        check_the_sum(three_quads, {"bounces": 1, "lights": "none"})


@pytest.mark.slow
def test_bounces_are_the_neumann_terms():
    scene, camera = everything()
    parts = values(mc.path_parts(scene, camera, by="bounce", bounces=2))
    u = np.random.default_rng(0).random((4000, mc.path_integrand(scene, camera, bounces=2).dim))
    terms = np.asarray(mc.luminance(mc.neumann_terms(scene, camera, bounces=2).batch(u)))
    assert np.allclose(parts, terms, rtol=1e-4, atol=1e-5)


LETTER = {"diffuse": "D", "rough": "G", "mirror": "S", "glass": "S"}


@pytest.mark.slow
def test_contributions_belong_to_the_class_and_technique_of_their_replayed_path(monkeypatch):
    check_the_classes()

    def too_early(self, letters):
        return jnp.roll(right(self, letters), 1).at[0].set(0)

    right = path_parts._Parts._states
    monkeypatch.setattr(path_parts._Parts, "_states", too_early)
    with pytest.raises(AssertionError):
        check_the_classes()


def check_the_classes():
    scene, camera = everything()
    options = {"bounces": 3}
    parts = mc.path_parts(scene, camera, by=("class", "technique"), **options)
    names = mc.part_names(parts)
    pixels = camera.width * camera.height
    # Keep the parts of every sample: one sample for each integral of a larger family.
    index = np.arange(3 * pixels)
    found = np.asarray(_of_pixels(parts, index, pixels))
    expected = np.zeros_like(found)
    machine = automaton(CLASSES)
    for row, path in zip(expected, mc.replay(scene, camera, list(index), **options), strict=True):
        row[names.index("E L, seen directly")] += path.direct
        for k, vertex in enumerate(path.vertices):
            word = "".join(LETTER[v.kind] for v in path.vertices[: k + 1])
            found_class = (*CLASSES, "other")[classify(machine, word)]
            specular = LETTER[vertex.kind] == "S"
            ways = {"sky": "sky met", "light": "light met after a mirror or glass" if specular else "light met"}
            # A light that was both sampled and met shares the event: the sum of its techniques is compared.
            row[names.index(f"{found_class}, {ways.get(vertex.met, 'light sampled')}")] += vertex.gained

    def by_class(x):
        return x.reshape(len(x), len(CLASSES) + 1, -1).sum(2)

    assert np.allclose(by_class(found), by_class(expected), rtol=1e-4, atol=1e-4)
    # Specular events sample nothing, and what they meet is in a part of its own.
    after = [k for k, n in enumerate(names) if n.endswith("after a mirror or glass")]
    assert np.allclose(found[:, after].sum(), expected[:, after].sum(), rtol=1e-4) and found[:, after].sum() > 0.0


def _of_pixels(integrand, index, pixels):
    from jaxmc.integration.samplers import Index, index_words, seed_words

    sampler = mc.Independent()

    @jax.jit
    def evaluate(words, pixel):
        def one(words, pixel):
            return integrand.at(sampler.point(jnp.asarray(seed_words(0)), Index(words[0], words[1])), pixel)

        return jax.vmap(one)(words, pixel)

    return evaluate(index_words(index), (index % pixels).astype(np.uint32))


def test_kernels_that_ask_for_no_parts_carry_none():
    scene, camera = everything()
    plain = mc.path_integrand(scene, camera, bounces=3)
    parts = mc.path_parts(scene, camera, bounces=3)

    def carried(f):
        jaxpr = jax.make_jaxpr(lambda u: f(u))(jnp.zeros(f.dim)).jaxpr
        return next(e.params["num_carry"] for e in jaxpr.eqns if e.primitive.name == "scan" and e.params["length"] == 3)

    gained = len(jax.tree.leaves(Gained(*[mc.transport.vec.Vec3(0.0, 0.0, 0.0)] * 2)))
    assert carried(parts) == carried(plain) + gained


def test_what_cannot_be_divided_is_refused():
    scene, camera = scenes.mirror_box(width=8, height=8)
    for by in ("colour", (), ("bounce", "bounce"), ("bounce", "colour")):
        with pytest.raises(ValueError, match="by must be one of bounce, class, technique"):
            mc.path_parts(scene, camera, by=by, bounces=2)
    with pytest.raises(ValueError, match="no clamp"):
        mc.path_parts(scene, camera, bounces=2, clamp=3.0)
    with pytest.raises(ValueError, match="path_parts"):
        mc.part_names(mc.path_integrand(scene, camera, bounces=2))
