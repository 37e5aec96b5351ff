"""Derivatives by albedo, of a closed room: by weights, by roulette, and by the score of being absorbed."""

import jax.numpy as jnp

from ..gradients.estimators import Drawn, attached_integrand, derivative_parts, score_control
from ..gradients.paths import moving_radiance
from ..transport.integrands import radiance
from ..transport.materials import Diffuse
from ..transport.primitives import Sphere
from ..transport.scene import Scene
from .gradient_tasks import PILOT, Estimator, Score, Task, differences, family

BOUNCES = 4
UNIFORM = {"bounces": BOUNCES, "directions": "uniform", "lights": "none"}


def albedo_task(seed=0) -> Task:
    """Return estimators of the derivative of a furnace's radiance after at most 4 events, by its albedo."""
    known = family("short furnace")
    at = known.arguments["albedo"]
    scored, controlled = Score(WALK), Score(WALK, score_control(WALK, at, n=PILOT, key=seed))
    found = [
        Estimator("plain AD, uniform directions", derivative_parts(_furnace, at), True),
        Estimator("interior, uniform directions", derivative_parts(_moving_furnace, at), True),
        Estimator("plain AD, roulette of 1/2", derivative_parts(_furnace_with_roulette, at), True),
        Estimator("absorption, attached", derivative_parts(_attached_walk, at), False, 0.0),
        Estimator("absorption, score", derivative_parts(scored, at), True),
        Estimator("absorption, score, with control", derivative_parts(controlled, at), True),
    ]
    made = {", uniform directions": _furnace, ", absorption": _attached_walk}
    return Task("albedo changes", known.derivatives["albedo"], (*found, *differences(known, "albedo", made, at)))


def _room(albedo):
    shell = Sphere([0.0, 0.0, 0.0], 1.3, Diffuse(albedo), emission=1.0, inward=True)
    return Scene([shell]), [0.2, 0.1, 0.0], [0.3, -0.4, 0.8]


def _furnace(albedo):
    return radiance(*_room(albedo), **UNIFORM)


def _moving_furnace(albedo):
    return moving_radiance(*_room(albedo), **UNIFORM)


def _furnace_with_roulette(albedo):
    return radiance(*_room(albedo), roulette=0.5, **UNIFORM | {"directions": "cosine"})


def survivals(u, albedo):
    """Return how many events a path survives that is absorbed with probability 1 - albedo at each of ``BOUNCES``."""
    return jnp.sum(jnp.cumprod(u < albedo))


def probability(events, albedo):
    """Return with which probability a path survives so many events."""
    return albedo**events * jnp.where(events < BOUNCES, 1.0 - albedo, 1.0)


def radiance_of_walk(events, albedo):
    """Return 1 for each surface that the path has met, times the probability."""
    return (1.0 + events) * probability(events, albedo)


WALK = Drawn(BOUNCES, survivals, probability, radiance_of_walk)


def _attached_walk(albedo):
    return attached_integrand(WALK, albedo)
