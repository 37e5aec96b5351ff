"""Replay of single paths: any sample of an image, vertex by vertex, from its index alone."""

import dataclasses
import itertools
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.counts import is_count, positive
from ..integration.draw import is_index, point_tables
from ..integration.samplers import Independent, Index, index_words, seed_words
from .bsdfs import kinds_of
from .camera import Camera
from .hits import closest_hit, surface_at
from .integrands import path_integrand
from .materials import luminance
from .paths import begin, finish, play_roulette, scatter
from .scene import Scene
from .strategy import Roulette


class Vertex(NamedTuple):
    """One scattering event. ``throughput`` and ``gained`` are luminances: of the path before the event, and of the
    radiance that the event added, by a sampled light or by what the next ray ``met``: "light", "sky", "surface" or
    "nothing"; "roulette" where the path ended here. The ``normal`` is on the side that the path came from. ``reached``
    is where the next ray arrives, not finite where it meets nothing."""

    kind: str
    primitive: int
    point: np.ndarray
    normal: np.ndarray
    throughput: float
    gained: float
    met: str
    reached: np.ndarray


class Path(NamedTuple):
    """A replayed sample: its index, pixel (column, row), value (number or RGB), vertices, how it ended, and ``direct``,
    the luminance that the camera ray met by itself."""

    index: int
    pixel: tuple[int, int]
    value: np.ndarray
    vertices: list[Vertex]
    end: str
    direct: float

    @property
    def line(self) -> str:
        """The path in one line, up to the event that gained most: ``diffuse -> mirror -> light``."""
        gained = max((v.gained for v in self.vertices), default=0.0)
        if self.direct > gained:
            return "light or sky seen directly"
        if gained <= 0.0:
            return " -> ".join([*_runs(self.vertices), self.end])
        last = int(np.argmax([v.gained for v in self.vertices]))
        met = self.vertices[last].met
        source = met if met in ("light", "sky") else "sampled light"
        return " -> ".join([*_runs(self.vertices[: last + 1]), source])

    def __str__(self):
        value = ", ".join(f"{v:.6g}" for v in np.atleast_1d(self.value))
        head = f"sample {self.index}, pixel {self.pixel}: value {value}\n{self.line}\n"
        columns = (
            f"{'':>3} {'kind':8} {'prim':>4} {'x':>11} {'y':>11} {'z':>11} {'throughput':>12} {'gained':>12} then\n"
        )
        rows = [
            f"{i:>3} {v.kind:8} {v.primitive:>4} {v.point[0]:>11.6f} {v.point[1]:>11.6f} {v.point[2]:>11.6f} "
            f"{v.throughput:>12.6g} {v.gained:>12.6g} {v.met}"
            for i, v in enumerate(self.vertices, 1)
        ]
        return head + columns + "\n".join([*rows, f"ends at: {self.end}"])


def _runs(vertices):
    """Return the kinds of the vertices, more than three of one kind in a row as ``diffuse x 48``."""
    words = []
    for kind, run in itertools.groupby(v.kind for v in vertices):
        count = len(list(run))
        words += [kind] * count if count <= 3 else [f"{kind} x {count}"]
    return words


def replay(
    scene: Scene, camera: Camera, indices, *, key=0, sampler=Independent(), points=None, **options
) -> list[Path] | Path:  # fmt: skip
    """Replay samples of ``render`` with the same scene, camera, key, sampler and path options, from their indices.

    Args:
        indices: one index, or several.
        points: ``estimate.recipe["points"]``, which ``LatinHypercube`` and ``Stratified`` must know.

    Returns:
        One ``Path``, or a list of them. Values agree with the render's to rounding.

    Raises:
        ValueError: an index that is not an integer in [0, 2^64), or options as in ``path_integrand``.
    """
    integrand = path_integrand(scene, camera, **options)
    several = [indices] if np.ndim(indices) == 0 else list(indices)
    if not all(map(is_index, several)):
        raise ValueError(f"sample indices must be integers in [0, 2^64), got {indices!r}")
    if not several:
        return []
    number = np.asarray(several, np.uint64) >> np.uint64(0 if sampler.independent else 32)
    pixels = number % np.uint64(camera.width * camera.height)
    tables = point_tables(sampler, integrand.dim, points)
    words = index_words(several)
    seen = _replay(integrand, tables, jnp.asarray(seed_words(key)), words, pixels.astype(np.uint32), sampler)
    seen = jax.tree.map(np.asarray, seen)
    paths = []
    for k, (index, pixel) in enumerate(zip(several, pixels, strict=True)):
        paths.append(_path(scene, camera, index, pixel, *jax.tree.map(itemgetter(k), seen)))
    return paths[0] if np.ndim(indices) == 0 else paths


def sample_index(camera: Camera, pixel, sample, *, sampler=Independent(), points=None) -> int:
    """Return the index, for ``replay``, of a sample of ``render``: the ``sample``-th, from 0, of ``pixel``, a (column,
    row) from the top left.

    ``points``: ``estimate.recipe["points"]``, for samplers whose points are not independent.

    Raises:
        ValueError: a pixel outside of the image, a sample that is no integer >= 0, or no ``points``.
    """
    size = camera.width, camera.height
    inside = np.shape(pixel) == (2,) and all(is_count(p, 0, s - 1) for p, s in zip(pixel, size, strict=True))
    if not inside:
        raise ValueError(f"pixel must be (column, row) inside of {size[0]} x {size[1]} pixels, got {pixel!r}")
    if not is_count(sample, least=0):
        raise ValueError(f"sample must be an integer >= 0, got {sample!r}")
    pixels, number = size[0] * size[1], int(pixel[1]) * size[0] + int(pixel[0])
    if sampler.independent:
        return int(sample) * pixels + number
    if points is None:
        raise ValueError(f"{sampler!r} has randomisations of some points each: pass points=estimate.recipe['points']")
    randomisation, point = divmod(int(sample), positive("points", points))
    return (randomisation * pixels + number << 32) + point


@partial(jax.jit, static_argnames="sampler")
def _replay(integrand, tables, seed, words, pixels, sampler):
    strategy = integrand.fn.strategy
    scene, camera = integrand.params
    film, stride = integrand.fn.first(camera, 0), len(strategy.coordinates(scene))

    def one(words, pixel):
        u = sampler.point(seed, Index(words[0], words[1]), *tables)
        start = integrand.fn.start(u, scene, camera, pixel)
        state = begin(scene, strategy, start, closest_hit(scene, start))
        direct, first_face = luminance(state.radiance), state.hit.face

        def event(state, k):
            surface, first = surface_at(scene, state.ray, state.hit), film + stride * k
            after = scatter(scene, strategy, u, first, surface, state, event=k)
            return after, {
                "face": surface.face, "point": jnp.stack(surface.point), "normal": jnp.stack(surface.normal),
                "throughput": luminance(after.beta), "radiance": luminance(after.radiance), "next": after.hit.face,
                "reached": jnp.stack(after.ray.origin + after.ray.direction * after.hit.distance),
                "survives": survives(state, surface, u, first, k),
            }  # fmt: skip

        def survives(state, surface, u, first, k):
            if strategy.roulette is None:
                return True
            # Scatter without risk, on the same coordinates, to know the throughput that roulette saw.
            safe = dataclasses.replace(strategy, roulette=Roulette(1.0))
            beta = scatter(scene, safe, u, first, surface, state, event=k).beta
            # The last coordinate of an event is for roulette.
            return play_roulette(strategy.roulette, beta, kinds_of(scene, surface), k, u[first + stride - 1])[0]

        state = jax.tree.map(lambda x: jnp.asarray(x, float if jnp.result_type(x).kind == "f" else None), state)
        state, seen = lax.scan(event, state, jnp.arange(strategy.bounces))
        return finish(strategy, state.radiance), direct, first_face, seen

    return jax.vmap(one)(words, pixels)


def _path(scene, camera, index, pixel, value, direct, first_face, events) -> Path:
    vertices, throughput, collected = [], 1.0, float(direct)
    for k in range(len(events["face"])):
        face = int(events["face"][k])
        if face < 0:
            break
        total = float(events["radiance"][k])
        met = _met(scene, int(events["next"][k])) if events["survives"][k] else "roulette"
        point, normal = events["point"][k] + scene.middle, events["normal"][k]
        kind, reached = _kind(scene, face), events["reached"][k] + scene.middle
        vertices.append(Vertex(kind, scene.owner[face], point, normal, throughput, total - collected, met, reached))
        throughput, collected = float(events["throughput"][k]), total
    end = vertices[-1].met if vertices else _met(scene, int(first_face))
    pixel = (int(pixel) % camera.width, int(pixel) // camera.width)
    return Path(int(index), pixel, value, vertices, "last bounce" if end == "surface" else end, float(direct))


def _kind(scene, face):
    kinds = {"mirror": scene.mirrors, "rough": scene.rough, "glass": scene.dielectrics}
    return next((kind for kind, faces in kinds.items() if face in faces), "diffuse")


def _met(scene, face):
    if face < 0:
        return "nothing" if scene.sky is None else "sky"
    return "light" if face in scene.lights else "surface"
