"""Lights that shine inward are dark from outside, and shapes hide their own far sides."""

import pytest

import jaxmc as mc
from jaxmc.testing import assert_equivalent

FLOOR = mc.Quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), mc.Diffuse(0.5))
TURN = ((0.36, 0.48, -0.8), (-0.8, 0.6, 0.0), (0.48, 0.64, 0.6))
ONE = [(0.0, 1.2, 0.0)]
MANY = [(3.0 * k, 1.2, 0.0) for k in range(-8, 9)]  # a table


def irradiance(kind, places, lights="mis", key=0, **sides):
    grey = {"material": mc.Diffuse(0.3), "emission": 1.0, **sides}
    shapes = [mc.Box(p, (1, 1, 1), TURN, **grey) if kind is mc.Box else mc.Sphere(p, 0.6, **grey) for p in places]
    scene = mc.Scene([FLOOR, *shapes])
    return mc.integrate(mc.irradiance(scene, (0.1, 0, 0), (0, 1, 0), bounces=1, lights=lights), n=1 << 15, key=key)


@pytest.mark.parametrize(
    "places, lights", [(ONE, "nee"), *(pytest.param(p, "mis", marks=pytest.mark.slow) for p in (ONE, MANY))]
)
@pytest.mark.parametrize("kind", [mc.Box, mc.Sphere])
def test_a_light_that_shines_inward_is_dark_from_outside(kind, places, lights):
    dark = irradiance(kind, places, lights, inward=True)
    assert dark.mean == 0.0 and dark.variance == 0.0


@pytest.mark.parametrize("places", [ONE, pytest.param(MANY, marks=pytest.mark.slow)], ids=["one", "many"])
@pytest.mark.parametrize("kind", [mc.Box, mc.Sphere])
def test_the_inside_of_a_light_is_not_seen_from_outside(kind, places):
    both = irradiance(kind, places, key=1, two_sided=True)
    assert_equivalent(both, irradiance(kind, places), rel_precision=0.03)
