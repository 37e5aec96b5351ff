"""How paths are sampled: the options that all path integrands share."""

import copy
import dataclasses
from typing import Any, TypedDict

from ..integration.counts import is_count
from .clamps import Clamp, as_clamp
from .primitives import is_number
from .regularize import Regularize, amount_of, as_regularize

POLAR, AZIMUTH = "direction: polar", "direction: azimuth"
THROUGHPUT = "throughput"


@dataclasses.dataclass(frozen=True)
class Roulette:
    """Russian roulette: a path survives a scattering event with some probability, and is then worth as much more.

    Attributes:
        survival: that probability, in (0, 1]; or "throughput" for the largest component of the throughput after the
            event, at most 1, so that dark paths end and all that survive are worth about the same.
        after: so many events come first without roulette.

    Glass is left out: what it takes from the radiance of a path it gives back at the way out.
    """

    survival: float | str = THROUGHPUT
    after: int = 0

    def __post_init__(self):
        fixed = is_number(self.survival) and 0.0 < self.survival <= 1.0
        if not (fixed or (isinstance(self.survival, str) and self.survival == THROUGHPUT)):
            raise ValueError(f'survival must be a number in (0, 1] or "{THROUGHPUT}", got {self.survival!r}')
        if not is_count(self.after, least=0):
            raise ValueError(f"after must be an integer >= 0, got {self.after!r}")


class PathOptions(TypedDict, total=False):
    """Options of path integrands, with their defaults.

    directions: how a surface draws directions: "bsdf" as its material reflects them; "cosine" and "uniform" on all
        surfaces but mirrors and glass. "bsdf".
    lights: "none" waits until a path meets a light, "nee" (next event estimation) samples a light at each event, "mis"
        does both and weights them by the power heuristic. "mis".
    pick: which light is sampled where there are several: "uniform"; "power", in proportion to it; "distance", to power
        over squared distance, and to bounds of both cosines. "uniform".
    light_points: how a point on a light is drawn: "area", uniformly over its surface; "solid angle", uniformly over the
        directions that it fills, for spheres and rectangles (other flat lights by area); "automatic", the cheaper one
        of each kind: spheres by solid angle, flat lights by area. Near a rectangle its solid angle has far less
        variance, and costs some 9 ns a sample. "automatic".
    sample_sky: sample the sky at each event too, in addition to a light; False: it is found by directions alone.
    roulette: a ``Roulette``, or its survival; None: all paths have all their events.
    clamp: scale each sample down to this luminance; or a ``Clamp``, with limits inside the path. Biased. None: leave
        them.
    regularize: a ``Regularize``, or its rule: make mirrors and metals less sharp after a path has scattered. Biased.
        None: leave them.
    hide_emitters: leave out lights that the camera sees by itself or over mirrors alone. False.
    """

    directions: str
    lights: str
    pick: str
    light_points: str
    sample_sky: bool
    roulette: Any
    clamp: float | Clamp | None
    regularize: Regularize | str | None
    hide_emitters: bool


CHOICES = {
    "directions": ("bsdf", "cosine", "uniform"),
    "lights": ("mis", "nee", "none"),
    "pick": ("uniform", "power", "distance"),
    "light_points": ("automatic", "area", "solid angle"),
}


@dataclasses.dataclass(frozen=True)
class Strategy:
    """The static options of every path integrand, see ``PathOptions``; ``bounces`` counts scattering events."""

    bounces: int
    directions: str = "bsdf"
    lights: str = "mis"
    pick: str = "uniform"
    light_points: str = "automatic"
    sample_sky: bool = False
    roulette: Any = None
    clamp: Any = None
    regularize: Any = None
    hide_emitters: bool = False

    def __post_init__(self):
        if not is_count(self.bounces, least=0):
            raise ValueError(f"bounces must be an integer >= 0, got {self.bounces!r}; 0 is emission seen directly")
        for name, known in CHOICES.items():
            if not isinstance(getattr(self, name), str) or getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        object.__setattr__(self, "clamp", as_clamp(self.clamp))
        object.__setattr__(self, "regularize", as_regularize(self.regularize))
        if self.regularize is not None and self.directions != "bsdf":
            raise ValueError(f'regularize changes what materials draw: use directions="bsdf", got {self.directions!r}')
        if self.roulette is not None and not isinstance(self.roulette, Roulette):
            object.__setattr__(self, "roulette", Roulette(self.roulette))

    def without_bounces(self) -> "Strategy":
        """Return the strategy of paths that see emission directly only."""
        return dataclasses.replace(self, bounces=0)

    def without_values(self, scene) -> "tuple[Strategy, Any]":
        """Return the strategy without the amount of its regularization, and the scene with it, where it can be another
        value for the same kernel; without a regularization where the scene has nothing to blur.
        """
        if not (scene.mirrors or scene.rough):
            return dataclasses.replace(self, regularize=None), scene
        blurred = copy.copy(scene)
        blurred.blur = amount_of(self.regularize)
        return dataclasses.replace(self, regularize=dataclasses.replace(self.regularize, amount=None)), blurred

    def coordinates(self, scene) -> tuple[str, ...]:
        """Return what the coordinates of one scattering event decide: what matters most comes first."""
        words: tuple[str, ...] = ()
        if self.lights != "none" and scene.lights:
            words += ("light: first", "light: second")
            words += ("which light",) if len(scene.lights) > 1 else ()
        if self.samples_sky(scene):
            words += ("sky: first", "sky: second")
        words += (POLAR, AZIMUTH)
        return words + (("survival",) if self.roulette else ())

    def samples_sky(self, scene) -> bool:
        """Return whether directions toward the sky are sampled."""
        return self.sample_sky and self.lights != "none" and scene.sky is not None
