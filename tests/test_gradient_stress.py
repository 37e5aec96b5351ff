"""Derivatives in the scenes of the stability study, where rounding is worst: every one must be a number."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.studies import strained_scenes, stress
from jaxmc.studies.stability import LONG

CASES = {f"{c.group}: {c.name}": c.make for c in strained_scenes.all_cases() if c.group != LONG}
# Of rooms in which everything shines take shorter paths: derivatives grow from mirror to mirror.
CASES |= {f"furnace: {kind}": partial(strained_scenes.furnace, kind, 1.0, 12) for kind in ("sphere", "box", "mirror")}
UNSEEN = "edge-on: upright: on its plane"  # a lamp in whose plane the point lies: neither it nor its edges are seen
QUICK = "moved: quad lamp: + 1.3e+06"


def slopes(part, mode, n=1024):
    """Return the derivatives at n points as all that can move does so, in a random direction; a NaN of one is one of
    their sum.
    """
    rest, at_rest, values = part.params[:3]
    rng = np.random.default_rng(0)
    direction = jax.tree.map(lambda x: jnp.asarray(rng.standard_normal(np.shape(x)), float), values)
    values = jax.tree.map(lambda x: jnp.asarray(x, float), values)

    def slope(u):
        if mode == "reverse":
            by = jax.grad(lambda v: jnp.sum(part.fn(u, rest, at_rest, v)))(values)
            return sum(jnp.sum(a * b) for a, b in zip(jax.tree.leaves(by), jax.tree.leaves(direction)))
        return jax.jvp(lambda v: jnp.sum(part.fn(u, rest, at_rest, v)), (values,), (direction,))[1]

    return np.asarray(jax.jit(jax.vmap(slope))(stress.common_points(n, part.dim)))


@pytest.mark.parametrize("mode", ["forward", pytest.param("reverse", marks=pytest.mark.slow)])
@pytest.mark.parametrize("sampling", ["detached", pytest.param("attached", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [n if n == QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_derivatives_are_numbers(name, sampling, mode, monkeypatch):
    for function in ("irradiance", "radiance"):
        monkeypatch.setattr(strained_scenes, function, partial(getattr(mc, f"moving_{function}"), sampling=sampling))
    made = CASES[name]()
    found = [slopes(part, mode) for part in (made.interior, made.boundary) if part is not None]
    assert all(np.isfinite(part).all() for part in found)
    assert any(np.any(part) for part in found) == (name != UNSEEN)
