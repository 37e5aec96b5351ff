"""Estimators of enclosures, exchange and walks against their closed forms, and wrong ones that must not pass.

Points come from NumPy here, not from a sampler of ours; ``test_analytic_scenes`` runs the default scenes by
``integrate``, to a smaller error.
"""

import copy
import dataclasses
import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes as scenes
import jaxmc as mc
from analytic_scenes import cavity, receivers, sensors
from jaxmc.testing import SIGMAS, assert_unbiased
from jaxmc.transport.vec import cross
from jaxmc.transport.warps import sample_uniform_hemisphere

PRECISION = 1e-3
PILOT, CHUNK = 1 << 14, 1 << 16


def sampled(integrand, n, seed=1):
    """Return what an estimate knows, from ``n`` random points whose coordinates float32 holds exactly."""
    rng, values = np.random.default_rng(seed), []
    for _ in range(-(-n // CHUNK)):
        u = (rng.integers(0, 1 << 23, (CHUNK, integrand.dim)) + 0.5) / (1 << 23)
        values.append(np.asarray(integrand.batch(u), np.float64))
    values = np.concatenate(values)
    unlike = np.count_nonzero(~np.isfinite(values))
    return SimpleNamespace(mean=values.mean(), variance=values.var(ddof=1), n=values.size, nonfinite=unlike)


def check(integrand, scene, n=None):
    """Check the integrand's mean, and the variance that the scene states, with an error of 1e-3 of the mean."""
    if n is None:
        variance = sampled(integrand, PILOT).variance if scene.exact_variance is None else scene.exact_variance
        n = max(PILOT, math.ceil(1.3 * variance / (PRECISION * scene.exact) ** 2))
    estimate = sampled(integrand, n)
    assert_unbiased(estimate, scene.exact, PRECISION)
    if scene.exact_variance is not None and scene.exact_kurtosis is not None:
        assert_unbiased(estimate, scene.exact, PRECISION, variance=scene.exact_variance)
        stderr = scene.exact_variance * math.sqrt((scene.exact_kurtosis - 1) / estimate.n)
        assert abs(estimate.variance - scene.exact_variance) <= SIGMAS * stderr
    elif scene.exact_variance == 0.0:
        assert estimate.variance <= 1e-13 * scene.exact**2


OTHERS = {  # unlike the default scenes in their numbers
    "close spheres, uniform directions": lambda: scenes.concentric_spheres(0.9, 1.0, bounces=2, directions="uniform"),
    "third bounce": lambda: scenes.lit_cap(3.0, 0.75, 2.0, bounces=3, fewest=3),
    "lamp near the wall": lambda: scenes.lamp_in_sphere(offset=1.5, albedo=0.8, bounces=3),
    "offset rectangles, none": lambda: scenes.offset_rectangles((0, 0), (1, 1), (-1, -2), (3, 4), 0.5, lights="none"),
    "distant disks": lambda: scenes.coaxial_disks(1.0, 1.5, 1.0),
    "late roulette, uniform directions": lambda: scenes.roulette_furnace(
        0.5, 0.8, bounces=3, directions="uniform", guaranteed=1
    ),
    "plates take turns": lambda: scenes.throughput_walk(3, 0.9, 0.4),
}


@pytest.mark.parametrize("name", OTHERS)
def test_estimator(name):
    scene = OTHERS[name]()
    check(scene.integrand, scene)


SLOWLY = {  # more of them, and some of larger variance
    "Kirchhoff room, uniform directions": lambda: scenes.kirchhoff_room(2.0, bounces=2, directions="uniform"),
    "Kirchhoff room, one bounce": lambda: scenes.kirchhoff_room(bounces=1),
    "inner sphere shines": lambda: scenes.concentric_spheres(outer_emission=0.0, bounces=3),
    "plates, uniform directions": lambda: scenes.parallel_plates(bounces=2, directions="uniform"),
    "cap of its own albedo": lambda: scenes.lit_cap(3.0, 0.9, math.pi / 6, 0.2, bounces=5),
    "standing rectangle, none": lambda: scenes.standing_rectangle(lights="none"),
    "sphere to larger sphere": lambda: scenes.two_spheres(0.3, 2.0, 2.5),
    "sphere to equal sphere": lambda: scenes.two_spheres(1.0, 1.0, 3.0, lights="none"),
    "sphere to sphere, mis": lambda: scenes.two_spheres(0.1, 0.2, 0.5, lights="mis"),
    "endless furnace with roulette": lambda: scenes.roulette_furnace(0.6, 0.6, bounces=30),
    "endless paths that count where they die": lambda: scenes.absorption_furnace(0.6, 0.7, bounces=40),
    "endless cap": lambda: scenes.lit_cap(3.0, 0.75, math.pi / 6, bounces=None),
    "endless spheres": lambda: scenes.concentric_spheres(1.0, 2.0, 1.0, 0.0, 0.5, 0.7, bounces=None),
    "endless plates": lambda: scenes.parallel_plates(bounces=None, directions="uniform"),
    "fourth moment": lambda: scenes.throughput_walk(1, 0.8, power=4),
    "rare firefly": lambda: scenes.throughput_exceedance(2.0, 5, 0.8),
    "squares that share an edge": lambda: scenes.standing_rectangle(1.0, 1.0, 1.0, lights="none"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOWLY)
def test_more_estimators(name):
    scene = SLOWLY[name]()
    check(scene.integrand, scene)


@pytest.mark.slow
def test_the_picture_of_a_furnace_has_one_brightness():
    for scene, albedo in ((scenes.cube_furnace(), None), (scenes.kirchhoff_room(), 0.9)):
        place, camera = scene.view()
        image = mc.render(place, camera, spp=4, bounces=3 if albedo is None else 60, lights="none")
        # Of the Kirchhoff room, at most the largest albedo to the power of the number of events is left out.
        assert np.abs(image.mean - scene.exact).max() <= 1e-5 + (0.0 if albedo is None else albedo**60)


# ---------------------------------------------------------------------------------------- mutants
#
# A mutant is the integrand of a scene with one mistake; its name says which.


def fresh(integrand, **changes):
    """Return the integrand as a function that no cache has seen, so that it is traced with the code as it is now."""
    changed = dataclasses.replace(integrand, **changes)
    return dataclasses.replace(changed, fn=lambda u, *params: changed.fn(u, *params))


def one_event_too_few(integrand):
    walk = integrand.fn.walk
    return fresh(
        integrand, fn=dataclasses.replace(integrand.fn, walk=dataclasses.replace(walk, bounces=walk.bounces - 1))
    )


def emission_seen_too_soon(integrand):
    walk = integrand.fn.walk
    return fresh(integrand, fn=dataclasses.replace(integrand.fn, walk=dataclasses.replace(walk, fewest=1)))


def uniform_directions_with_the_weight_of_cosine_ones(integrand, monkeypatch):
    right = cavity.sample_diffuse
    monkeypatch.setattr(cavity, "sample_diffuse", lambda _, *args: (*right("uniform", *args)[:2], 1.0))
    return fresh(integrand)


class SurvivalByDirection:
    """Coordinates in which survival, the first of three of each event, is decided by the next one."""

    def __init__(self, u):
        self.u = u

    def __getitem__(self, k):
        return self.u[jnp.where(k % 3 == 0, k + 1, k)]


def survival_shares_a_coordinate(integrand):
    return dataclasses.replace(integrand, fn=lambda u, *params: integrand.fn(SurvivalByDirection(u), *params))


def the_last_light_is_dark(integrand):
    scene = copy.copy(integrand.params[0])
    light, radiance = scene.emitters[-1]
    scene.emitters = [*scene.emitters[:-1], (light, 0.0 * radiance)]
    return fresh(integrand, params=(scene, *integrand.params[1:]))


def end_of_the_path_is_black(integrand):
    return fresh(integrand, params=(*integrand.params[:-1], 0.0))


def placed_by(place):
    def mutate(integrand):
        return fresh(integrand, fn=dataclasses.replace(integrand.fn, place=place))

    mutate.__name__ = place.__name__
    return mutate


def normal_of_any_length(u1, u2, corner, edge_u, edge_v):
    return sensors.on_parallelogram(u1, u2, corner, edge_u, edge_v)[0], cross(edge_u, edge_v)


def radius_is_uniform(u1, u2, center, radius):
    return receivers.on_disk(u1 * u1, u2, center, radius)


def height_is_not_uniform(u1, u2, center, radius, side):
    return receivers.on_sphere(u1 * u1, u2, center, radius, side)


def uniform_directions_to_the_disk(integrand, monkeypatch):
    monkeypatch.setattr(receivers, "sample_cosine_hemisphere", sample_uniform_hemisphere)
    return fresh(integrand)


def wrong_power(integrand):
    return fresh(integrand, params=(*integrand.params[:-1], 0.5))


MUTANTS = [
    (one_event_too_few, lambda: scenes.lit_cap(bounces=3)),
    (emission_seen_too_soon, lambda: scenes.lit_cap(half_angle=2.0, bounces=2, fewest=2)),
    (uniform_directions_with_the_weight_of_cosine_ones, lambda: scenes.lit_cap(bounces=1)),
    (survival_shares_a_coordinate, lambda: scenes.roulette_furnace(0.5, 0.8, bounces=2, directions="uniform")),
    (the_last_light_is_dark, lambda: scenes.concentric_spheres(bounces=2)),
    pytest.param(the_last_light_is_dark, lambda: scenes.kirchhoff_room(bounces=2), marks=pytest.mark.slow),
    pytest.param(end_of_the_path_is_black, lambda: scenes.kirchhoff_room(bounces=2), marks=pytest.mark.slow),
    (placed_by(normal_of_any_length), scenes.facing_rectangles),
    (placed_by(radius_is_uniform), scenes.sphere_over_disk),
    (placed_by(height_is_not_uniform), lambda: scenes.inner_sphere(0.6, 1.0)),
    (uniform_directions_to_the_disk, scenes.coaxial_disks),
    (wrong_power, scenes.throughput_walk),
]


@pytest.mark.parametrize(("mutate", "make"), MUTANTS, ids=lambda x: getattr(x, "__name__", ""))
def test_the_check_rejects_a_mutant(mutate, make, monkeypatch):
    scene = make()
    needs = (monkeypatch,) if mutate.__code__.co_argcount == 2 else ()
    with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
        check(mutate(scene.integrand, *needs), scene, n=1 << 21)


def test_the_check_rejects_wrong_formulas():
    scene = scenes.concentric_spheres()
    estimate = sampled(scene.integrand, 1 << 17)
    assert_unbiased(estimate, scene.exact, PRECISION)
    wrong = {
        "one event too few": scenes.concentric_spheres(bounces=2),
        "one too many": scenes.concentric_spheres(bounces=4),
        "albedos exchanged": scenes.concentric_spheres(inner_albedo=0.7, outer_albedo=0.5),
        "the outer sphere does not shine": scenes.concentric_spheres(outer_emission=0.0),
        "ratio of radii, not of areas": scenes.concentric_spheres(inner_radius=math.sqrt(2.0)),
    }
    for other in wrong.values():
        with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
            assert_unbiased(estimate, other.exact, PRECISION)
