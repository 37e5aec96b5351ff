"""Derivatives to estimate, each with its exact value and its estimators: of a shadow and of a light that move."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..gradients.estimators import (
    blurred,
    derivative_parts,
    difference_integrand,
    score_control,
    score_integrand,
)
from ..gradients.paths import direct_irradiance, moving_irradiance
from ..integration.integrand import Integrand
from ..transport.integrands import irradiance
from ..transport.materials import Diffuse
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene
from .scores import exact_function

UP = (0.0, 0.0, 1.0)
BLACK = Diffuse(0.0)
STEPS = (0.3, 0.1, 0.03, 0.01)  # from one end of a difference to the other
WIDTHS = (0.05, 0.02)  # of blurred parameters
SOFT = (0.3, 0.1, 0.03, 0.01)  # widths of a softened edge
PILOT = 1 << 14


class Estimator(NamedTuple):
    """Integrands whose means add up to an estimate of a derivative, and whether theory calls that unbiased.

    ``limit``: the mean that theory gives where that is another than the derivative; None where it is not known.
    """

    name: str
    parts: tuple[Integrand, ...]
    sound: bool
    limit: float | None = None


class Task(NamedTuple):
    """A derivative, its exact value, and what estimates it."""

    name: str
    exact: float
    estimators: tuple[Estimator, ...]


def family(name):
    """Return a closed form with its arguments."""
    return next(f for f in exact_function("moving").FAMILIES if f.name == name)


def shadow_task(argument, seed=0) -> Task:
    """Return estimators of how the light changes that passes a half plane, when "edge" or "receiver" moves."""
    known = family("shadow of a half plane")
    make = Shadow(argument, tuple(known.arguments.items()))
    at, p, moves = known.arguments[argument], known.arguments, known.derivatives
    far, near = p["height"] - p["receiver"], p["blocker_height"] - p["receiver"]
    # What is plain does not see the shadow's edge move: it lacks the derivative by the edge, times its speed.
    speed = 1.0 if argument == "edge" else p["edge"] * (p["height"] - p["blocker_height"]) / (near * far)
    inside = derivative_parts(make, at)[:1]
    further = [
        Estimator(f"interior + boundary, {word}", (*inside, make.boundary(clip)), True)
        for word, clip in (("all of the edge", False), ("the edge before the light", True))
    ]
    further += [Estimator(f"softened by {w:g}", derivative_parts(Soft(make, w), at), False) for w in SOFT]
    return Task(
        f"{argument} moves", moves[argument],
        _moving(make, known, moves[argument] - moves["edge"] * speed, further, seed),
    )  # fmt: skip


def light_task(seed=0) -> Task:
    """Return estimators of how the light of a sphere changes when that moves to the side."""
    known = family("sphere light")
    make = MovingLight("offset", tuple(known.arguments.items()))
    exact = known.derivatives["offset"]
    return Task("light moves", exact, _moving(make, known, exact, [], seed))


def differences(known, argument, made, at) -> list[Estimator]:
    """Return difference quotients of what the functions ``made`` make, by a word for each; and what they lead to."""
    found = []
    for step in STEPS:
        ends = (known._replace(arguments={**known.arguments, argument: at + s * step / 2}).exact for s in (1, -1))
        limit = float(np.subtract(*ends)) / step
        for word, make in made.items():
            parts = (difference_integrand(make, at, step),)
            found.append(Estimator(f"difference of {step:g}{word}", parts, False, limit))
    return found


def _moving(make, known, plain, further, seed):
    """Return estimators for what moves; ``plain`` is where those without boundary lead."""
    argument = make.argument
    at, exact = known.arguments[argument], known.derivatives[argument]
    by_light, waiting, is_sound = Plain(make, "nee"), Plain(make, "none"), plain == exact
    found = [
        Estimator("plain AD, directions drawn", derivative_parts(waiting, at), False, 0.0),
        Estimator("plain AD, points on lights drawn", derivative_parts(by_light, at), is_sound, plain),
        Estimator("interior", derivative_parts(make, at)[:1], is_sound, plain),
        Estimator("interior + boundary", derivative_parts(make, at), True),
        Estimator("attached directions + boundary", derivative_parts(Attached(make), at), True),
        *further,
        *differences(known, argument, {"": by_light}, at),
    ]
    for width in WIDTHS:
        drawn = blurred(by_light, at, width)
        control, limit = score_control(drawn, at, n=PILOT, key=seed), _blurred_limit(known, argument, width)
        for word, c in (("", None), (", with control", control)):
            found.append(
                Estimator(f"score, blurred by {width:g}{word}", derivative_parts(Score(drawn, c), at), False, limit)
            )
    return tuple(found)


class Score:
    """Makes the integrand whose draws stay where they are."""

    def __init__(self, drawn, control=None):
        self.drawn, self.control = drawn, control

    def __call__(self, value):
        return score_integrand(self.drawn, value, self.control)


def _blurred_limit(known, argument, width):
    """Return the derivative of the blurred value, by Gauss and Hermite's rule."""
    node, weight = np.polynomial.hermite_e.hermegauss(7)
    at = known.arguments[argument]
    slopes = [
        known._replace(arguments={**known.arguments, argument: at + width * float(x)}).derivatives[argument]
        for x in node
    ]
    return float(np.dot(weight, slopes) / weight.sum())


@dataclasses.dataclass(frozen=True)
class Shadow:
    """Makes the light that passes a half plane, with its boundary; ``given`` are the arguments of the closed form."""

    argument: str
    given: tuple[tuple[str, float], ...]

    def scene(self, value):
        p = {**dict(self.given), self.argument: value}
        a, b, s = p["half_width"], p["half_depth"], p["edge"]
        light = [-a, -b, p["height"]], [0.0, 2.0 * b, 0.0], [2.0 * a, 0.0, 0.0]
        blocker = [s - 5.0, -5.0, p["blocker_height"]], [5.0, 0.0, 0.0], [0.0, 10.0, 0.0]
        scene = Scene([Quad(*light, BLACK, emission=p["emission"]), Quad(*blocker, BLACK)])
        return scene, [0.0, 0.0, p["receiver"]], UP

    def __call__(self, value):
        return direct_irradiance(*self.scene(value))

    def boundary(self, clip) -> Integrand:
        """Return the boundary part by itself: an integral over the angle along the blocker's edge, of all of it, or of
        the part that is seen before the light."""
        return Integrand(_Edge(self, clip), 1, (dict(self.given)[self.argument],))


@dataclasses.dataclass(frozen=True)
class MovingLight:
    """Makes the light of a sphere."""

    argument: str
    given: tuple[tuple[str, float], ...]

    def scene(self, value):
        p = {**dict(self.given), self.argument: value}
        lamp = Sphere([p["offset"], 0.0, p["height"]], p["radius"], BLACK, emission=p["emission"])
        return Scene([lamp]), [0.0, 0.0, 0.0], UP

    def __call__(self, value):
        return direct_irradiance(*self.scene(value))


@dataclasses.dataclass(frozen=True)
class Plain:
    """Makes an irradiance as ``mc.irradiance`` has it."""

    scenes: Shadow | MovingLight
    lights: str

    def __call__(self, value):
        return irradiance(*self.scenes.scene(value), bounces=0, lights=self.lights)


@dataclasses.dataclass(frozen=True)
class Attached:
    """Makes an irradiance that is found by drawn directions, which keep their random numbers, with its boundary."""

    scenes: Shadow | MovingLight

    def __call__(self, value):
        return moving_irradiance(*self.scenes.scene(value), bounces=0, lights="none", sampling="attached")


@dataclasses.dataclass(frozen=True)
class _Edge:
    """The derivative of irradiance that comes from the shadow's edge on the light: -L D^2 / r^4 dX/dp dY."""

    shadow: Shadow
    clip: bool

    def __call__(self, u, value):
        p = {**dict(self.shadow.given), self.shadow.argument: value}
        far, near = p["height"] - p["receiver"], p["blocker_height"] - p["receiver"]
        from_edge = jnp.hypot(p["edge"], near)
        widest = jnp.arctan(p["half_depth"] * near / far / from_edge) if self.clip else 0.5 * np.pi
        angle = (2.0 * u[0] - 1.0) * widest
        x, y = p["edge"] * far / near, from_edge * jnp.tan(angle) * far / near
        stretch = 2.0 * widest * from_edge / jnp.cos(angle) ** 2 * far / near  # dY / du
        speed = jax.grad(self._shadow_edge)(value)
        kernel = far**2 / (x**2 + y**2 + far**2) ** 2
        return jnp.where(jnp.abs(y) < p["half_depth"], -p["emission"] * kernel * speed * stretch, 0.0)

    def _shadow_edge(self, value):
        p = {**dict(self.shadow.given), self.shadow.argument: value}
        return p["edge"] * (p["height"] - p["receiver"]) / (p["blocker_height"] - p["receiver"])


@dataclasses.dataclass(frozen=True)
class Soft:
    """Makes the light past a half plane whose edge is a logistic ramp, ``width`` wide in the blocker's plane."""

    shadow: Shadow
    width: float

    def __call__(self, value):
        return Integrand(self._light, 2, (value,))

    def _light(self, u, value):
        p = {**dict(self.shadow.given), self.shadow.argument: value}
        x, y = (2.0 * u[0] - 1.0) * p["half_width"], (2.0 * u[1] - 1.0) * p["half_depth"]
        far, near = p["height"] - p["receiver"], p["blocker_height"] - p["receiver"]
        seen = jax.nn.sigmoid((x * near / far - p["edge"]) / self.width)
        area = 4.0 * p["half_width"] * p["half_depth"]
        return p["emission"] * area * far**2 / (x**2 + y**2 + far**2) ** 2 * seen
