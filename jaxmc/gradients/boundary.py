"""The boundary part of a derivative of light transport: one integral over all edges that matter on a path.

Edges matter on the film; at each surface point that directions are drawn from, before lights and before what reflects;
and over a plane mirror in both; where a sky meets its ground is one of them. One sample has a place on the edges of the
film and one vertex of a path with edges around.
"""

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..transport import paths
from ..transport.lights import black
from ..transport.vec import where
from .flows import still
from .horizon import has_horizon, horizon
from .jumps import jump
from .mirrors import Mirrors
from .options import MovingStrategy
from .shadows import Lamp, shadows
from .silhouettes import Silhouettes
from .vertices import share_of_emission
from .walks import as_state, scatter, scatter_at, vertex_of
from .windows import in_mirrors, of_film, of_vertex
from .world import world


@dataclasses.dataclass(frozen=True)
class Boundary:
    """An integrand of value 0, whose derivative has what moving edges add as its mean.

    Its coordinates are those of a path up to its last vertex, then ``choices``, then those of the paths that follow the
    edges.
    """

    strategy: MovingStrategy
    receiver: Any
    found: Silhouettes
    lamps: tuple[Lamp, ...]
    mirrors: Mirrors

    @property
    def chains(self) -> tuple[tuple[int, ...], ...]:
        """The mirrors that are looked into, one after the other, -1 for none."""
        faces, most = self.mirrors
        rows = [row for n in range(1, most + 1) for row in itertools.product(faces, repeat=n)]
        sound = [row for row in rows if all(a != b for a, b in itertools.pairwise(row))]
        return tuple((*row, *[-1] * (most - len(row))) for row in sound)

    @property
    def vertices(self) -> int:
        """How many vertices of a path may have edges around them."""
        return self.strategy.bounces + (1 if self.receiver.is_surface else 0)

    @property
    def has_outlines(self) -> bool:
        """Whether edges around vertices count besides those of shadows: with detached sampling those before what
        reflects, with attached sampling all.
        """
        return self.vertices > 1 or (self.vertices == 1 and self.strategy.is_attached)

    @property
    def choices(self) -> tuple[str, ...]:
        """What the coordinates decide between those of the two paths."""
        count, film = self.vertices, hasattr(self.receiver, "part")
        wanted = {
            "which vertex": count > 1,
            "film: edge": film,
            "film: edge in a mirror": film and self.chains,
            "shadow: edge": count and self.lamps,
            "outline: edge": self.has_outlines,
            "vertex: edge in a mirror": count > 1 and self.chains,
            "which mirrors": len(self.chains) > 1,
        }
        return tuple(word for word, is_wanted in wanted.items() if is_wanted)

    def labels(self, scene) -> tuple[str, ...]:
        """Return what every coordinate decides."""
        words, bounces = self.strategy.coordinates(scene), self.strategy.bounces
        before = tuple(f"event {k + 1}, {word}" for k in range(self.vertices - 1) for word in words)
        after = tuple(f"behind, event {k + 1}, {word}" for k in range(bounces) for word in words)
        return (*self.receiver.labels, *before, *self.choices, *after)

    def __call__(self, u, rest, at_rest, values, *pixel):
        if not self.found.known:
            raise ValueError(
                "which edges of a scene coincide is not known while JAX traces it: pass the function that makes the "
                "scene to mc.grad_integrate instead of differentiating this integrand"
            )
        moving = world(rest, at_rest, values, self.mirrors)
        begun, stride = self.receiver.begin(u, moving, *pixel), len(self.strategy.coordinates(rest))
        first = begun.first + stride * max(self.vertices - 1, 0)
        after = first + len(self.choices)

        def choice(word):
            return u[first + self.choices.index(word)]

        total, chain, chains = black(rest), None, np.array(self.chains)
        if self.chains:
            count = len(chains)
            which = jnp.minimum((choice("which mirrors") * count).astype(int), count - 1) if count > 1 else 0
            chain = tuple(jnp.asarray(chains)[which])
        if hasattr(self.receiver, "part"):
            part = self.receiver.part(moving.values.place, *pixel)

            def importance(x, y):
                return self.receiver.importance(moving, x, y, *pixel)

            total = total + self._on_film(moving, part, importance, chain, choice, u, after)
        if self.vertices:
            k, weight, vertex = self._vertex(moving, begun, choice, u)
            total = (
                total
                + self._around(moving, vertex, self.vertices - 1 - k, chain, choice, u, after) * weight * begun.weight
            )
        return self.receiver.finish(self.strategy, total)

    def _on_film(self, moving, part, importance, chain, choice, u, after):
        """Return what edges on the film add, seen directly and in mirrors."""
        bounces, window = self.strategy.bounces, of_film(moving, part, importance)
        along = self._radiance(moving, u, after, bounces, bounces)
        total = self._within(moving, window, choice("film: edge"), along)
        if chain is None:
            return total
        shown = in_mirrors(moving, self.found, window, chain)
        along = self._radiance(moving, u, after, bounces - 1, bounces - shown.passed)
        seen = self._within(moving, shown, choice("film: edge in a mirror"), along)
        return total + seen * float(len(self.chains))

    def _around(self, moving, vertex, left, chain, choice, u, after):
        """Return what edges add around a vertex of a path that has ``left`` further events."""
        total, most = black(moving.rest), self.vertices - 1
        if self.lamps:
            total = total + shadows(moving, self.found, self.lamps, self.strategy, vertex, choice("shadow: edge"))
        window = of_vertex(moving, self.strategy, vertex)
        if not self.has_outlines:
            if has_horizon(moving.rest.sky):
                total = total + horizon(moving, self.found, window, choice("shadow: edge"))
            return total

        def what_counts(emission, toward, hit):
            if not self.strategy.is_attached:
                # What is behind an edge and shines was counted among the shadows.
                return black(moving.rest)
            fixed = jax.tree.map(still, vertex)
            return emission * share_of_emission(moving, self.strategy, fixed, toward.direction, hit)

        along = self._radiance(moving, u, after, most, left, what_counts)
        total = total + self._within(moving, window, choice("outline: edge"), along)
        if chain is None or not most:
            return total
        shown = in_mirrors(moving, self.found, window, chain)
        along = self._radiance(moving, u, after, most - 1, left - shown.passed)
        seen = self._within(moving, shown, choice("vertex: edge in a mirror"), along)
        return total + where(left >= shown.passed, seen, black(moving.rest)) * float(len(self.chains))

    def _within(self, moving, window, u, along):
        """Return what all edges in a window add; ``along`` as ``jump`` takes it."""
        total = jump(moving, self.found, window, u, along)
        return total + horizon(moving, self.found, window, u) if has_horizon(moving.rest.sky) else total

    def _vertex(self, moving, begun, choice, u):
        """Return the number of a vertex, one over its probability, and the vertex."""
        k, weight = 0, 1.0
        if self.vertices > 1:
            chances = _chances(moving, self.vertices)
            k = jnp.sum(choice("which vertex") >= jnp.cumsum(chances)[:-1])
            weight = 1.0 / chances[k]
        if self.vertices == 1 and begun.vertex is not None:
            return k, weight, begun.vertex
        stride, walk, done = len(self.strategy.coordinates(moving.rest)), begun.walk, 0
        if walk is None:
            walk, _ = scatter_at(moving, self.strategy, u, begun.first, begun.vertex, 0, anywhere=True)
            done = 1

        def step(walk, i):
            onward, _ = scatter(moving, self.strategy, u, begun.first + stride * i, walk, i)
            return jax.tree.map(lambda a, b: jnp.where(i < k, a, b), onward, walk), None

        if self.vertices - 1 > done:
            walk = lax.scan(step, jax.tree.map(as_state, walk), jnp.arange(done, self.vertices - 1))[0]
        vertex = vertex_of(moving, walk)
        if begun.vertex is not None:
            vertex = jax.tree.map(lambda a, b: jnp.where(k == 0, a, b), begun.vertex, vertex)
        return k, weight, vertex

    def _radiance(self, moving, u, first, most, wanted, what_counts=None):
        """Return a function of a ray and what it meets: the radiance along it after ``wanted`` events, ``most`` at
        most; of the emission there ``what_counts(emission, ray, hit)``, or all.
        """
        rest = moving.rest

        def along(toward, hit):
            state = paths.begin(rest, self.strategy, toward, hit)
            if what_counts:
                state = state._replace(radiance=what_counts(state.radiance, toward, hit))
            if isinstance(wanted, int):
                return paths.follow(rest, self.strategy, u, first, state, wanted)[0]
            if most == 0:
                return state.radiance
            totals = paths.follow(rest, self.strategy, u, first, state, most, lambda surface, after: after.radiance)[1]

            def pick(none, some):
                return jnp.sum(jnp.where(jnp.arange(most + 1) == wanted, jnp.concatenate([none[None], some]), 0.0))

            return jax.tree.map(pick, state.radiance, totals)

        return along


def _chances(moving, count):
    """Return the probabilities to look around each of ``count`` vertices.

    Half of them fall by a half from one to the next; half as the brightest surface dims light, so that no weight grows
    along a path.
    """
    brightest = jnp.max(jnp.stack([jnp.max(x) for x in jax.tree.leaves(still(moving.values.reflectance))]))
    ratios = jnp.stack([jnp.full((), 0.5), jnp.clip(brightest, 0.5, 1.0)])
    powers = ratios[:, None] ** np.arange(count)
    return jnp.sum(0.5 * powers / jnp.sum(powers, axis=1, keepdims=True), axis=0)
