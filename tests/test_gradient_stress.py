"""Derivatives in the scenes of the stability study, where rounding is worst: every one must be a number."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.studies import strained_scenes
from jaxmc.studies.stability import LONG

CASES = {f"{c.group}: {c.name}": c.make for c in strained_scenes.all_cases() if c.group != LONG}
# Of rooms in which everything shines take shorter paths: derivatives grow from mirror to mirror.
CASES |= {f"furnace: {kind}": partial(strained_scenes.furnace, kind, 1.0, 12) for kind in ("sphere", "box", "mirror")}
UNSEEN = "edge-on: upright: on its plane"  # a lamp in whose plane the point lies: neither it nor its edges are seen
QUICK = "moved: quad lamp: + 1.3e+06"


def slope(made, mode):
    """Return the derivative as all that can move does so, in a random direction; a NaN of one is one of their sum."""
    values = jax.tree.map(lambda x: np.asarray(x, float), made.interior.params[2])
    rng = np.random.default_rng(0)
    direction = jax.tree.map(lambda x: rng.standard_normal(np.shape(x)), values)

    def moved(by):
        def part(of):
            rest, at_rest, _, *item = of.params
            return replace(of, params=(rest, at_rest, jax.tree.map(lambda x, d: x + by * d, values, direction), *item))

        return made._replace(interior=part(made.interior), boundary=made.boundary and part(made.boundary))

    return mc.grad_integrate(moved, 0.0, n=1024, mode=mode)


@pytest.mark.parametrize("mode", ["forward", pytest.param("reverse", marks=pytest.mark.slow)])
@pytest.mark.parametrize("sampling", ["detached", pytest.param("attached", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [n if n == QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_derivatives_are_numbers(name, sampling, mode, monkeypatch):
    for function in ("irradiance", "radiance"):
        monkeypatch.setattr(strained_scenes, function, partial(getattr(mc, f"moving_{function}"), sampling=sampling))
    found = slope(CASES[name](), mode)
    assert found.nonfinite == 0
    assert any(np.any(part.mean) for part in found.parts) == (name != UNSEEN)
