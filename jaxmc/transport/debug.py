"""Replay of single paths: any sample of an image, vertex by vertex, from its index alone."""

import itertools
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.draw import is_index, point_tables
from ..integration.samplers import Independent, Index, index_words, seed_words
from .camera import Camera
from .integrands import path_integrand
from .materials import luminance
from .paths import trace
from .scene import Scene
from .vec import Vec3


class Vertex(NamedTuple):
    """One scattering event. ``throughput`` and ``gained`` are luminances: of the path before the event, and of the
    radiance that the event added, by a sampled light or by what the next ray ``met``: "light", "sky", "surface" or
    "nothing"."""

    kind: str
    primitive: int
    point: np.ndarray
    normal: np.ndarray
    throughput: float
    gained: float
    met: str


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
        columns = f"{'':>3} {'kind':8} {'prim':>4} {'x':>11} {'y':>11} {'z':>11} {'throughput':>12} {'gained':>12}\n"
        rows = [
            f"{i:>3} {v.kind:8} {v.primitive:>4} {v.point[0]:>11.6f} {v.point[1]:>11.6f} {v.point[2]:>11.6f} "
            f"{v.throughput:>12.6g} {v.gained:>12.6g}"
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
        value, direct, events = jax.tree.map(itemgetter(k), seen)
        paths.append(_path(scene, camera, index, pixel, value, direct, events or {"face": ()}))
    return paths[0] if np.ndim(indices) == 0 else paths


@partial(jax.jit, static_argnames="sampler")
def _replay(integrand, tables, seed, words, pixels, sampler):
    def observe(surface, after):
        return {
            "face": surface.face, "point": jnp.stack(surface.point), "normal": jnp.stack(surface.normal),
            "throughput": luminance(after.beta), "radiance": luminance(after.radiance), "next": after.hit.face,
        }  # fmt: skip

    def one(words, pixel):
        scene, camera = integrand.params
        u = sampler.point(seed, Index(words[0], words[1]), *tables)
        start, first = integrand.fn.start(u, scene, camera, pixel), integrand.fn.first(camera, pixel)
        radiance, seen = trace(scene, integrand.fn.strategy, u, first, start, observe)
        direct, _ = trace(scene, integrand.fn.strategy.without_bounces(), u, first, start)
        value = jnp.stack(radiance) if isinstance(radiance, Vec3) else radiance
        return value, luminance(direct), seen

    return jax.vmap(one)(words, pixels)


def _path(scene, camera, index, pixel, value, direct, events) -> Path:
    vertices, throughput, collected = [], 1.0, float(direct)
    for k in range(len(events["face"])):
        face = int(events["face"][k])
        if face < 0:
            break
        total, met = float(events["radiance"][k]), _met(scene, int(events["next"][k]))
        point, normal = events["point"][k] + scene.middle, events["normal"][k]
        vertices.append(
            Vertex(_kind(scene, face), scene.owner[face], point, normal, throughput, total - collected, met)
        )
        throughput, collected = float(events["throughput"][k]), total
    end = vertices[-1].met if vertices else ("light or sky" if direct > 0.0 else "nothing")
    pixel = (int(pixel) % camera.width, int(pixel) // camera.width)
    return Path(int(index), pixel, value, vertices, "last bounce" if end == "surface" else end, float(direct))


def _kind(scene, face):
    kinds = {"mirror": scene.mirrors, "rough": scene.rough, "glass": scene.dielectrics}
    return next((kind for kind, faces in kinds.items() if face in faces), "diffuse")


def _met(scene, face):
    if face < 0:
        return "nothing" if scene.sky is None else "sky"
    return "light" if face in scene.lights else "surface"
