"""Edges that lie on faces to which they do not belong: what they hide, what hides them, and what is beside them."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.gradients import silhouettes
from jaxmc.gradients.silhouettes import silhouettes_of

DARK, WHITE = mc.Diffuse(0.0), mc.Diffuse(0.8)
FLOOR = mc.Quad((-4, -4, 0), (8, 0, 0), (0, 8, 0), WHITE)


def test_which_edges_rest_on_what():
    beneath = mc.Quad((-4, -4, 0), (0, 8, 0), (8, 0, 0), WHITE)
    sheet = mc.Triangle((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.5), WHITE)
    for floor, sign in ((FLOOR, 1), (beneath, -1)):
        for thing, count in ((mc.Box((0, 0, 0.5), (1, 1, 1), material=WHITE), 4), (sheet, 1)):
            rests = np.array(silhouettes_of(mc.Scene([floor, thing]), 1)[0].rests)
            on_floor = rests[4:, 0]
            assert sorted(on_floor) == sorted([sign] * count + [0] * (len(on_floor) - count))
            assert not rests[:4].any() and not rests[:, 1:].any()
    # What lies in the floor, hangs above it, or goes through it rests on nothing.
    for z in (0.2, -0.2):
        assert not np.any(silhouettes_of(mc.Scene([FLOOR, mc.Box((0, 0, z), (1, 1, 1), material=WHITE)]), 1)[0].rests)
    flat = mc.Quad((0, 0, 0), (1, 0, 0), (0, 1, 0), WHITE)
    assert not np.any(silhouettes_of(mc.Scene([FLOOR, flat]), 1)[0].rests)


def crate_on_floor(sampling="detached"):
    def make(p):
        crate = mc.Box(jnp.stack([0.0 * p["crate"], 0.5 + p["crate"], 1.0]), (3.0, 1.0, 2.0), material=DARK)
        lamp = mc.Quad((-0.6, -3.6, 3.2), (0.0, 1.2, 0.0), (1.2, 0.0, 0.0), DARK, emission=6.0)
        there = jnp.stack([0.0 * p["gaze"], 0.0, p["gaze"]])
        camera = mc.PinholeCamera((0.1, -2.0, 0.7), there, (0, 0, 1), 25.0, 16, 16)
        return mc.moving_paths(mc.Scene([FLOOR, lamp, crate]), camera, bounces=1, sampling=sampling)

    return make


AT = {"crate": 0.0, "gaze": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["detached", "attached"])
def test_a_crate_that_stands_on_a_floor(sampling):
    report = mc.gradcheck(crate_on_floor(sampling), AT, n=1 << 18, scale=1.0, steps=(0.04, 0.02), sampler=mc.Sobol())
    assert report.verdict == "consistent" and report.flags == ()


@pytest.mark.slow
def test_contacts_are_needed(monkeypatch):
    monkeypatch.setattr(silhouettes, "resting", lambda outlines, edges, *_: tuple((0,) * len(outlines) for _ in edges))
    report = mc.gradcheck(crate_on_floor(), AT, n=1 << 18, scale=1.0, steps=(0.04, 0.02), sampler=mc.Sobol())
    assert report.verdict == "biased"
