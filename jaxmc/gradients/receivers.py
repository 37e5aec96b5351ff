"""Where the light is received whose derivative is asked for: a film, the end of a ray, a point or a face."""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport import integrands
from ..transport.bsdfs import kinds_of
from ..transport.hits import Surface, face_at
from ..transport.paths import finish
from ..transport.rays import ray
from ..transport.vec import Vec3, cross, normalize
from .flows import still
from .vertices import Vertex
from .walks import Walk, start
from .windows import Rectangle
from .world import World


class Begun(NamedTuple):
    """A path at its begin: at a vertex that receives light, or on its way with the radiance that it has met; the first
    of the coordinates that are left; and what its radiance is multiplied by.
    """

    vertex: Vertex | None
    walk: Walk | None
    met: Any
    first: int
    weight: Any = 1.0


class _Receiver:
    def finish(self, strategy, radiance):
        """Return the value of a path."""
        return finish(strategy, radiance)


@dataclasses.dataclass(frozen=True)
class OnFilm(_Receiver):
    """Mean radiance over the film, or over a pixel where its number is given; ``far`` as in ``integrands.Film``."""

    far: bool
    is_surface: ClassVar[bool] = False
    labels: tuple[str, ...] = ("film: x", "film: y")

    def begin(self, u, world: World, pixel=None) -> Begun:
        film = integrands.Film(None, self.far)
        first = film.start(u, world.rest, world.values.place, pixel)
        walk, met = start(world, ray(still(first.origin), still(first.direction)), first.direction, first.origin)
        return Begun(None, walk, met, film.first(world.values.place, pixel))

    def part(self, camera, pixel=None) -> Rectangle:
        """Return which part of the film is meant."""
        if pixel is None:
            return Rectangle(-1.0, -1.0, 1.0, 1.0)
        x, y = pixel % camera.width, pixel // camera.width
        wide, high = 2.0 / camera.width, 2.0 / camera.height
        return Rectangle(x * wide - 1.0, y * high - 1.0, (x + 1) * wide - 1.0, (y + 1) * high - 1.0)

    def importance(self, world: World, x, y, pixel=None):
        """Return what radiance through a film position in [-1, 1]^2 is multiplied by."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class WeightedFilm(OnFilm):
    """The sum over all pixels and channels of an image times another one, which has an array (height, width) for each
    channel.
    """

    def begin(self, u, world: World, image=None) -> Begun:
        begun = super().begin(u, world)
        return begun._replace(weight=self.importance(world, 2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0, image))

    def part(self, camera, image=None) -> Rectangle:
        return super().part(camera)

    def importance(self, world: World, x, y, image=None):
        camera = world.values.place
        column = jnp.clip((0.5 * (x + 1.0) * camera.width).astype(int), 0, camera.width - 1)
        row = jnp.clip((0.5 * (y + 1.0) * camera.height).astype(int), 0, camera.height - 1)
        return jax.tree.map(lambda one: one[row, column] * float(camera.width * camera.height), image)

    def finish(self, strategy, radiance):
        return radiance.x + radiance.y + radiance.z if isinstance(radiance, Vec3) else radiance


@dataclasses.dataclass(frozen=True)
class AlongRay(_Receiver):
    """Radiance that arrives along one ray."""

    is_surface: ClassVar[bool] = False
    labels: tuple[str, ...] = ()

    def begin(self, u, world: World) -> Begun:
        origin, direction = world.values.place
        walk, met = start(world, ray(still(origin), still(direction)), direction, origin)
        return Begun(None, walk, met, 0)


@dataclasses.dataclass(frozen=True)
class AtPoint(_Receiver):
    """Irradiance at a point, which is pi times what a white diffuse surface would reflect."""

    is_surface: ClassVar[bool] = True
    labels: tuple[str, ...] = ()

    def begin(self, u, world: World) -> Begun:
        return Begun(white_vertex(world, *world.values.place), None, None, 0)


@dataclasses.dataclass(frozen=True)
class OverFace(_Receiver):
    """Mean irradiance over a parallelogram, on the side of the cross product of its edges."""

    is_surface: ClassVar[bool] = True
    labels: tuple[str, ...] = ("receiver: first", "receiver: second")

    def begin(self, u, world: World) -> Begun:
        corner, edge_u, edge_v = world.values.place
        point = corner + edge_u * u[0] + edge_v * u[1]
        return Begun(white_vertex(world, point, normalize(cross(edge_u, edge_v))), None, None, 2)


def white_vertex(world: World, point: Vec3, normal: Vec3) -> Vertex:
    """Return a diffuse vertex that reflects pi times its irradiance, whatever it lies on."""
    rest, down = world.rest, -normal
    pi = np.pi * jnp.ones(()) if rest.channels == 1 else Vec3(*[np.pi * jnp.ones(())] * 3)
    behind = jnp.zeros((), bool) if rest.dielectrics else None
    moving = Surface(point, normal, pi, face_at(rest, still(point)), behind)
    surface = still(moving._replace(face=0))._replace(face=moving.face)
    kinds = kinds_of(rest, surface._replace(face=-1))
    return Vertex(surface, kinds, moving, kinds, still(down), down, pi)
