"""What is asked of a scene: the mean over an image, the radiance along a ray, the irradiance at a point."""

import copy
import dataclasses
from functools import partial
from typing import Unpack

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.counts import is_count
from ..integration.integrand import Integrand
from .camera import Camera
from .hits import Hit, Surface, approach, face_at
from .lights import black
from .materials import luminance
from .paths import PathState, finish, follow, scatter, trace
from .primitives import as_unit, as_vec3, is_concrete
from .rays import Ray, ray
from .regularize import memory_at_start
from .scene import Scene
from .strategy import PathOptions, Strategy
from .vec import Vec3, dot

FAR = 8.0  # times the size of the scene: from there its rays start nearer


def path_integrand(scene: Scene, camera: Camera, *, bounces, **options: Unpack[PathOptions]) -> Integrand:
    """Return the mean radiance of a camera's image as one flat integral.

    The first two coordinates are the film position (x, y) over the whole image, then come 2 to 8 for each scattering
    event; ``Integrand.labels`` names them. Where the camera has ``antialias=False`` the first two only choose the
    pixel, and ``render``, which knows it, begins with the scattering events. The value is radiance, linear: a number
    for a grey scene, else RGB of shape (3,). ``jax.grad`` with respect to the scene's values gives the interior
    derivative only: what moving silhouettes and shadow edges add is missing, and whole in ``mc.moving_paths``.
    ``mc.gradcheck`` says whether that matters.

    Args:
        scene: what is there.
        camera: where it is seen from.
        bounces: largest number of scattering events; 0 is emission seen directly.
        options: ``directions``, ``lights``, ``pick``, ``sample_sky``, ``roulette``, ``clamp``, ``regularize``,
            ``hide_emitters``: see ``PathOptions``.

    Raises:
        ValueError: an option out of range, or a scene or camera that is none.
        TypeError: an unknown option.
    """
    return through_film(Film, scene, camera, Strategy(bounces, **options))


def neumann_terms(scene: Scene, camera: Camera, *, bounces, **options: Unpack[PathOptions]) -> Integrand:
    """Return the mean radiance of an image by path length, as an integrand of shape (bounces + 1,) or (bounces + 1, 3).

    Term k is the light that comes after exactly k scattering events: one flat integral for each, over the first
    coordinates of the same path. Their sum is ``path_integrand``, sample by sample. Options as there, but no ``clamp``
    of whole samples.
    """
    strategy = Strategy(bounces, **options)
    if strategy.clamp is not None and strategy.clamp.sample is not None:
        raise ValueError("neumann_terms has no clamp of samples: it would apply to the sum of the terms; leave it out")
    return through_film(_Terms, scene, camera, strategy)


def radiance(scene: Scene, origin, direction, *, bounces, **options: Unpack[PathOptions]) -> Integrand:
    """Return the radiance that arrives at ``origin`` from ``direction`` as an integrand; options as ``path_integrand``.

    ``direction`` points away from ``origin``, along the ray, and may have any length.
    """
    _check(scene, Scene, "scene", "mc.Scene([...])")
    strategy = Strategy(bounces, **options)
    start = Ray(scene.local(as_vec3("origin", origin)), as_unit("direction", direction), None)
    start, _ = approach(scene, start)
    return _integrand(_Ray(strategy), scene, (start.origin, start.direction), ())


def irradiance(scene: Scene, point, normal, *, bounces, **options: Unpack[PathOptions]) -> Integrand:
    """Return the irradiance at a point as an integrand; options as ``path_integrand``.

    ``bounces`` counts scattering events between light and point: 0 is direct light alone. The receiver is not part of
    the scene; one that lies on a face, to rounding, is not shadowed by it. ``normal`` may have any length.
    """
    _check(scene, Scene, "scene", "mc.Scene([...])")
    strategy = Strategy(bounces, **options)
    point = scene.local(as_vec3("point", point))
    return _integrand(_Receiver(strategy), scene, (point, as_unit("normal", normal)), (), extra=1)


def path_throughput(scene: Scene, camera: Camera, *, events, directions="bsdf") -> Integrand:
    """Return the luminance of a camera path's throughput after each number of scattering events in ``events``.

    The value has shape ``(len(events),)``; it is 0 where the path has left the scene before. Options and coordinates
    as in ``path_integrand`` with ``lights="none"``.
    """
    numbers = tuple(events) if np.ndim(events) == 1 else ()
    if not numbers or not all(map(is_count, numbers)):
        raise ValueError(f"events must be a list of positive integers, got {events!r}")
    numbers = tuple(map(int, numbers))
    strategy = Strategy(max(numbers), directions, "none")
    return through_film(partial(_Throughput, events=numbers), scene, camera, strategy)


@dataclasses.dataclass(frozen=True)
class Film:
    """A function of a film position: of the whole image, or of one pixel where its number is given.

    ``far``: the camera may lie far from the scene, and its rays start nearer.
    """

    strategy: Strategy
    far: bool

    def first(self, camera, pixel=None):
        """Return the first coordinate of the scattering events."""
        return 2 if camera.antialias or pixel is None else 0

    def start(self, u, scene, camera, pixel=None):
        if pixel is None:
            x, y = u[0] * camera.width, u[1] * camera.height
            if not camera.antialias:
                # Rounding up may lead to the pixel behind the last one.
                x = jnp.minimum(jnp.floor(x), camera.width - 1) + 0.5
                y = jnp.minimum(jnp.floor(y), camera.height - 1) + 0.5
            first = camera.ray(x, y)
        else:
            column, row = pixel % camera.width, pixel // camera.width
            if camera.antialias:
                first = camera.ray(column.astype(float) + u[0], row.astype(float) + u[1])
            else:
                first = camera.ray(column.astype(float) + 0.5, row.astype(float) + 0.5)
        return approach(scene, first)[0] if self.far else first

    def __call__(self, u, scene, camera, pixel=None):
        start = self.start(u, scene, camera, pixel)
        if pixel is not None and not camera.antialias and self.strategy.bounces > 1:
            start = _anew(start, u)
        return finish(self.strategy, trace(scene, self.strategy, u, self.first(camera, pixel), start)[0])


def _anew(start: Ray, u) -> Ray:
    """Return a ray of which the compiler does not know that all samples of a pixel share it.

    It traces a shared first ray once for all of them, which saves an eighth of the time of direct light. But beside a
    loop over events it is then slower by a fifth, for what lies outside of the loop over samples has to be copied.
    """
    return start._replace(origin=start.origin._replace(x=start.origin.x + 0.0 * u[0]))


@dataclasses.dataclass(frozen=True)
class _Throughput(Film):
    """Throughput of the paths of a film, after some numbers of events."""

    events: tuple[int, ...]

    def __call__(self, u, scene, camera, pixel=None):
        def observe(surface, after):
            return jnp.where(surface.face >= 0, luminance(after.beta), 0.0)

        start = self.start(u, scene, camera, pixel)
        _, throughput = trace(scene, self.strategy, u, self.first(camera, pixel), start, observe)
        return jnp.asarray(throughput)[jnp.array(self.events) - 1]


class _Terms(Film):
    """Radiance through a film position by path length."""

    def __call__(self, u, scene, camera, pixel=None):
        start, first = self.start(u, scene, camera, pixel), self.first(camera, pixel)
        direct, _ = trace(scene, self.strategy.without_bounces(), u, first, start)
        _, totals = trace(scene, self.strategy, u, first, start, lambda surface, after: after.radiance)
        values = jnp.stack(direct) if isinstance(direct, Vec3) else direct
        if totals is None:
            return values[None]
        totals = jnp.stack(totals, -1) if isinstance(totals, Vec3) else totals
        totals = jnp.concatenate([values[None], totals])
        return jnp.concatenate([totals[:1], jnp.diff(totals, axis=0)])


@dataclasses.dataclass(frozen=True)
class _Ray:
    """Radiance along one ray."""

    strategy: Strategy

    def __call__(self, u, scene, origin, direction):
        return finish(self.strategy, trace(scene, self.strategy, u, 0, ray(origin, direction))[0])


@dataclasses.dataclass(frozen=True)
class _Receiver:
    """Irradiance: pi times what a white diffuse surface would reflect."""

    strategy: Strategy

    def __call__(self, u, scene, point, normal):
        one = jnp.ones(()) if scene.channels == 1 else Vec3(*[jnp.ones(())] * 3)
        surface = Surface(point, normal, one, face_at(scene, point))
        rule = self.strategy.regularize
        scattered = jnp.zeros((), bool) if rule else None
        nowhere = PathState(ray(point, normal), Hit(jnp.inf, -1), one, black(scene), scattered, memory_at_start(rule))
        around = copy.copy(scene)
        # The receiver is diffuse, whatever it lies on.
        around.mirrors = around.rough = around.metals = around.dielectrics = ()
        state = scatter(around, self.strategy, u, 0, surface, nowhere, anywhere=True)
        first = len(self.strategy.coordinates(scene))
        radiance, _ = follow(scene, self.strategy, u, first, state, self.strategy.bounces, received=1)
        return finish(self.strategy, jax.tree.map(lambda x: x * np.pi, radiance))


def through_film(kind, scene, camera, strategy=None, labels=()) -> Integrand:
    """Return ``kind(strategy, far)`` as an integrand over the film of a camera: ``far`` as in ``Film``.

    Further coordinates have the ``labels``, or the strategy's where there is one.
    """
    _check(scene, Scene, "scene", "mc.Scene([...])")
    _check(camera, Camera, "camera", "mc.PinholeCamera(...)")
    camera, far = _local(scene, camera)
    return _integrand(kind(strategy, far), scene, (camera,), (*_film_labels(camera), *labels))


def _local(scene, camera):
    """Return a camera in the coordinates of the kernel, and whether it may lie far from the scene."""
    origin = scene.local(camera.origin)
    near = is_concrete((origin, scene.reach)) and dot(origin, origin) < (FAR * scene.reach) ** 2
    return dataclasses.replace(camera, origin=origin), not near


def _film_labels(camera):
    return ("film: x", "film: y") if camera.antialias else ("film: column", "film: row")


def _integrand(fn, scene, params, labels, extra=0):
    strategy = fn.strategy
    if strategy.regularize:
        strategy, scene = strategy.without_values(scene)
        fn = dataclasses.replace(fn, strategy=strategy)
    for event in range(strategy.bounces + extra):
        labels += tuple(f"event {event + 1}, {word}" for word in strategy.coordinates(scene))
    labels = labels or ("unused",)
    return Integrand(fn, len(labels), (scene, *params), lazy=True, labels=labels)


def _check(value, kind, name, cure):
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be a {kind.__name__}, made by {cure}, got {value!r}")
