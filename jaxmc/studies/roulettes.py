"""Russian roulette: its effect on variance, on rays and on time; a section of the study ``light_sampling``."""

from typing import Any, NamedTuple

import numpy as np

from .. import plot
from ..integration.driver import integrate
from ..transport.integrands import path_integrand
from ..transport.strategy import Roulette
from . import light_scenes
from .scores import against, exact_function

ALBEDO = light_scenes.FURNACE_ALBEDO
ROULETTES = {"none": None, "0.5": 0.5, "0.8": 0.8, "throughput": "throughput", "throughput after 3": Roulette(after=3)}
BOUNCES = 10  # of the paths with roulette


class Odds(NamedTuple):
    """A roulette, what it is called, and the probability with which a path of the furnace survives an event."""

    name: str
    roulette: Any
    survival: float


def show(lab):
    """Add the section on Russian roulette to the report of a ``Lab`` of the study ``light_sampling``."""
    lab.report.section("Russian roulette")
    lab.report.text(
        "A path survives an event with some probability and is then worth as much more. The mean stays, the variance "
        "grows, the number of rays falls. All paths of this tracer take their steps together, so that a path which "
        "has ended saves **no time**: the table shows seconds as measured, and rays."
    )
    scene, camera = light_scenes.furnace(ALBEDO)
    exact = (1.0 - ALBEDO ** (BOUNCES + 1)) / (1.0 - ALBEDO)
    survivals = [Odds("none", None, 1.0), *(Odds(f"{p:g}", p, p) for p in (0.9, 0.8, 0.7, 0.6, 0.5))]
    survivals.append(Odds("throughput", "throughput", ALBEDO))  # after each event the path is worth 1 again
    scores, rays = [], []
    for odds in survivals:
        options = {"bounces": BOUNCES, "directions": "cosine", "lights": "none", "roulette": odds.roulette}
        variance = float(exact_function("furnace_variance")(ALBEDO, 1.0, BOUNCES, survival=odds.survival))
        scores.append(
            lab.score(
                path_integrand(scene, camera, **options), f"survival {odds.name}", "furnace, 10 events", exact, variance
            )
        )
        rays.append(float(integrate(light_scenes.events(scene, camera, **options), n=1 << 14, key=lab.key()).mean))
    expected = [sum(odds.survival**k for k in range(BOUNCES)) for odds in survivals]
    lab.table(scores, "A white furnace.", [("rays", rays), ("rays, exact", expected)])
    fixed = slice(1, len(survivals) - 1)  # without roulette there is no variance to draw
    p = np.array([odds.survival for odds in survivals[fixed]])
    curves = {
        "variance": ([s.variance for s in scores[fixed]], [s.exact_variance for s in scores[fixed]]),
        "rays": (rays[fixed], expected[fixed]),
        "seconds for 1e7 samples": ([10 * s.seconds for s in scores[fixed]], None),
    }
    fig, axes = plot.panels(2, 2, (5.2, 3.8))
    plot.law(axes[0], p, curves, "probability of survival", "furnace of albedo 0.6", logx=False)
    scene, camera = light_scenes.closed_room()
    room, room_rays = [], []
    for name, roulette in ROULETTES.items():
        options = {"bounces": BOUNCES, "roulette": roulette}
        room.append(lab.score(path_integrand(scene, camera, **options), f"survival {name}", "room, 10 events", share=4))
        room_rays.append(float(integrate(light_scenes.events(scene, camera, **options), n=1 << 13, key=lab.key()).mean))
    worth = [s.mean**2 / (s.variance * r) for s, r in zip(room, room_rays)]
    further = [("rays", room_rays), ("efficiency for a ray", worth), ("z, against the first", against(room))]
    lab.table(room, "A closed room of albedo 0.7, with light sampling.", further)
    plot.bars(axes[1], list(ROULETTES), np.array(worth) / worth[0], "efficiency for a ray, none is 1", log=False)
    caption = (
        "Left: variance and rays in a furnace, measured (dots) and exact (lines); without roulette its variance is "
        "0, for 10 rays. Time does not follow the rays. Right: a room; what roulette gains for each ray traced."
    )
    lab.report.figure(fig, "roulette", caption)
