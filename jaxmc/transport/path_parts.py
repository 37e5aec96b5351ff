"""A path integrand in parts that sum to it, sample by sample: by bounce, by class of paths, by technique.

Each contribution of a path belongs to one part. So variance and fireflies can be traced to what brought them.
"""

import dataclasses
import itertools
from typing import Any, NamedTuple, Unpack

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.integrand import Integrand
from .bsdfs import kinds_of
from .camera import Camera
from .hits import closest_hit
from .integrands import Film, through_film
from .lights import black
from .materials import luminance
from .path_classes import LETTERS, automaton
from .paths import Gained, apart, begin, follow
from .scene import Scene
from .strategy import PathOptions, Strategy

# Light seen directly or over mirrors; direct light; light that reaches a surface over mirrors, with one such surface on
# the path or several; all other indirect light.
CLASSES = ("E L", "E S+ L", "E S* [DG] L", "E S* [DG] S+ L", "E .* [DG] S+ L", "E .* L")
GROUPINGS = ("bounce", "class", "technique")


def path_parts(
    scene: Scene, camera: Camera, *, by="bounce", classes=CLASSES, bounces, **options: Unpack[PathOptions]
) -> Integrand:
    """Return the luminance of ``path_integrand`` in parts: an integrand of shape (parts,).

    The parts sum to the luminance of ``path_integrand``, sample by sample, to rounding; ``part_names`` names them.
    Coordinates and options are as there, but no ``clamp``. The integrand of an image, one integral for each pixel, is
    this one in ``integrate_each(parts, camera.width * camera.height, n=spp)``.

    Args:
        by: what tells the parts apart: "bounce", the number of scattering events between eye and light; "class", which
            of ``classes`` matches the path; "technique", how the light was found: seen directly, sampled, or met by a
            direction, where light met after a mirror or glass, that no light sample serves, is apart. Or several of
            them, such as ("class", "technique"): one part for each combination.
        classes: expressions such as "E D S+ L", see ``path_classes``; the first one that matches counts, and what
            matches none is the last part, "other". By default light seen directly, over mirrors, direct light, light
            that reaches a surface over mirrors ("E S* [DG] S+ L" with one such surface, "E .* [DG] S+ L" with more),
            and all other indirect light.
        bounces: largest number of scattering events; 0 is emission seen directly.

    Raises:
        ValueError: an unknown grouping, malformed classes, a clamp, or as ``path_integrand``.
    """
    strategy = Strategy(bounces, **options)
    if strategy.clamp is not None:
        raise ValueError("path_parts has no clamp: it would apply to the sum of the parts; leave it out")
    chosen = (by,) if isinstance(by, str) else tuple(by)
    if not chosen or len(set(chosen)) < len(chosen) or not set(chosen) <= set(GROUPINGS):
        raise ValueError(f"by must be one of {', '.join(GROUPINGS)}, or several of them, got {by!r}")
    machine = automaton(classes) if "class" in chosen else None

    def kind(strategy, far):
        return _Parts(strategy, far, chosen, machine, _names(scene, strategy, chosen, machine))

    return through_film(kind, scene, camera, strategy)


def part_names(integrand: Integrand) -> tuple[str, ...]:
    """Return the names of the parts of what ``path_parts`` returned, or raise ``ValueError`` for another integrand."""
    names = getattr(integrand.fn, "names", None)
    if names is None:
        raise ValueError(f"expected what path_parts returned, got the integrand of {integrand.fn!r}")
    return tuple(", ".join(words) for words in itertools.product(*names))


class _Techniques(NamedTuple):
    """The number of each technique among those that a scene has."""

    names: tuple[str, ...]
    sampled: int
    met: int
    after_specular: int
    sky: int


def _techniques(scene, strategy) -> _Techniques:
    names, numbers = ["seen directly"], {}
    specular = bool(scene.mirrors or scene.dielectrics)
    sampled = "light or sky sampled" if strategy.samples_sky(scene) else "light sampled"
    by_chance = scene.lights and not strategy.lights == "nee"
    for field, name, occurs in (
        ("sampled", sampled, strategy.lights != "none" and (scene.lights or strategy.samples_sky(scene))),
        ("met", "light met", by_chance),
        ("after_specular", "light met after a mirror or glass", scene.lights and specular),
        ("sky", "sky met", scene.sky is not None),
    ):
        numbers[field] = len(names) if occurs else 0
        names += [name] if occurs else []
    return _Techniques(tuple(names), **numbers)


def _names(scene, strategy, chosen, machine) -> tuple[tuple[str, ...], ...]:
    named = {
        "bounce": lambda: tuple(f"{k} bounce{'s' * (k != 1)}" for k in range(strategy.bounces + 1)),
        "class": lambda: (*machine.classes, "other"),
        "technique": lambda: _techniques(scene, strategy).names,
    }
    return tuple(named[by]() for by in chosen)


@dataclasses.dataclass(frozen=True)
class _Parts(Film):
    """Radiance through a film position by parts."""

    by: tuple[str, ...]
    machine: Any  # an ``Automaton``, or None where no classes are asked for
    names: tuple[tuple[str, ...], ...]

    def __call__(self, u, scene, camera, pixel=None):
        bounces, start = self.strategy.bounces, self.start(u, scene, camera, pixel)
        hit = closest_hit(scene, start) if bounces else apart(scene, lambda: closest_hit(scene, start))
        path = begin(scene, self.strategy, start, hit)._replace(gained=Gained(black(scene), black(scene)))
        seen: Any = follow(scene, self.strategy, u, self.first(camera, pixel), path, bounces, _Observer(scene))[1]
        contributions = luminance(path.radiance)[None]
        if bounces:
            contributions = jnp.concatenate([contributions, seen.sampled, seen.met])
        number = 0
        for by, names in zip(self.by, self.names, strict=True):
            number = number * len(names) + self._numbers(scene, by, seen)
        parts = np.arange(np.prod([len(names) for names in self.names]))
        return jnp.where(number[:, None] == parts, contributions[:, None], 0.0).sum(0)

    def _numbers(self, scene, by, seen):
        """Return the part of each contribution: of light seen directly, then what each event sampled, then met."""
        bounces = self.strategy.bounces
        if by == "bounce":
            events = np.arange(1, bounces + 1)
            return np.concatenate([[0], events, events])
        if by == "technique":
            return self._technique_numbers(scene, seen)
        found = np.array(self.machine.found)
        if not bounces:
            return found[:1]
        events = jnp.asarray(found)[self._states(seen.letter)]
        return jnp.concatenate([found[:1], events, events])

    def _states(self, letters):
        """Return the state of the automaton after each event."""
        table = jnp.asarray(self.machine.after)

        def step(state, letter):
            state = table[state, letter]
            return state, state

        return lax.scan(step, jnp.zeros((), table.dtype), letters)[1]

    def _technique_numbers(self, scene, seen):
        known = _techniques(scene, self.strategy)
        if not self.strategy.bounces:
            return np.zeros(1, int)
        met = jnp.where(seen.letter == LETTERS.index("S"), known.after_specular, known.met)
        met = jnp.where(seen.into_sky, known.sky, met)
        return jnp.concatenate([np.zeros(1, int), np.full(self.strategy.bounces, known.sampled), met])


class _Event(NamedTuple):
    """One scattering event: what it gained, by sampling and by what it met, in luminance; the letter of its surface;
    and whether the path leaves the scene."""

    sampled: Any
    met: Any
    letter: Any
    into_sky: Any


@dataclasses.dataclass(frozen=True)
class _Observer:
    scene: Any

    def __call__(self, surface, after) -> _Event:
        kinds = kinds_of(self.scene, surface)
        letter = jnp.full((), LETTERS.index("D"))
        if kinds.rough is not None:
            letter = jnp.where(kinds.rough, LETTERS.index("G"), letter)
        if kinds.specular is not None:
            letter = jnp.where(kinds.specular, LETTERS.index("S"), letter)
        sampled, met = (luminance(value) for value in after.gained)
        return _Event(sampled, met, letter, after.hit.face < 0)
