"""Derivatives of whole paths against closed forms: silhouettes on the film, shadows, other surfaces, mirrors, glass."""

import json
from pathlib import Path

import numpy as np
import pytest
import two_bounce_reference
from moving_scenes import SCENES

import jaxmc as mc
from jaxmc.gradients import boundary, jumps, walks

TABLE = json.loads((Path(__file__).parent / "data" / "two_bounce.json").read_text())
KINDS = {"film": mc.moving_paths, "point": mc.moving_irradiance, "ray": mc.moving_radiance}
QUICK = {"sphere over the film's edge", "slab of glass"}
BY_NAME = {scene.name: scene for scene in SCENES}


def made(scene):
    def make(params):
        what = scene.make(params)
        return KINDS[scene.kind](*(what if isinstance(what, tuple) else (what,)), bounces=scene.bounces)

    return make


def check(found, exact, share=0.01, grain=1e-4):
    """Within 6 standard errors of 16 replicates, these below a share of the largest component.

    Points that fill a line evenly resolve the end of an edge to one of 4096 points, which is ``grain``; replicates may
    all be off by the same then.
    """
    largest = max(np.max(np.abs(truth)) for truth in exact.values())
    for name, truth in exact.items():
        mean, error = np.asarray(found.mean[name]), np.asarray(found.stderr[name])
        assert np.all(error <= share * np.maximum(np.abs(truth), 0.3 * largest)), (name, error, truth)
        assert np.all(np.abs(mean - truth) <= 6.0 * error + grain * largest), (name, mean, truth, error)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in BY_NAME]
)
def test_every_closed_form(name):
    scene = BY_NAME[name]
    found = mc.grad_integrate(made(scene), scene.params, n=1 << 16, sampler=mc.Sobol())
    check(found, scene.truth()[1])
    assert found.nonfinite == 0
