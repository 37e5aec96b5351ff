"""Random walks that count what must not happen: a ray that leaves a closed room, or meets the surface that it leaves.

The walks take the steps of the path tracer. Beside its way to keep a ray from its own surface stand two others: a
constant offset of the ray's start, and leaving out the primitive that it comes from. Those know of no rounding error:
they get walls that meet as they are given.
"""

import copy
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.driver import integrate, integrate_each
from ..integration.integrand import Integrand
from ..transport import hits, rays
from ..transport.bsdfs import reflect, sample_diffuse
from ..transport.camera import Camera
from ..transport.flats import FlatShape
from ..transport.lights import emission_toward
from ..transport.primitives import as_vec3
from ..transport.scene import Scene
from ..transport.sky import sky_radiance
from ..transport.vec import Vec3, dot, normalize, where

COUNTS = ("events", "escapes", "self-hits", "inside a ball", "not finite")


def ours(scene, ray, own):
    """Return the closest hit as the path tracer finds it."""
    return hits.closest_hit(scene, ray, own)


class Offset(NamedTuple):
    """The closest hit of a ray whose start is moved along it by a constant length."""

    epsilon: float

    def __call__(self, scene, ray, own):
        start = jnp.where(own < 0, 0.0, self.epsilon)
        hit = hits.closest_hit(scene, ray._replace(origin=ray.origin + ray.direction * start))
        return hit._replace(distance=hit.distance + start)


def exclusion(scene, ray, own):
    """Return the closest hit on any primitive but the one that the ray comes from."""
    found = [hits.closest_hit(_alone(scene, i), ray) for i in range(len(scene.shapes))]
    distance = jnp.stack([jnp.where(own == i, jnp.inf, one.distance) for i, one in enumerate(found)])
    nearest = jnp.argmin(distance)
    return hits.Hit(distance[nearest], jnp.where(distance[nearest] < jnp.inf, nearest, -1))


def _alone(scene, i):
    one = copy.copy(scene)
    one.shapes, one.first, one.twins = scene.shapes[i : i + 1], (0,), ((),)
    return one


def bare(scene) -> Scene:
    """Return a scene without what the path tracer knows of rounding: quads that overlap, hits that are drawn inward."""
    plain = copy.copy(scene)
    plain.shapes = tuple(
        dataclasses.replace(s, limit=np.ones_like(s.limit)) if isinstance(s, FlatShape) else s for s in scene.shapes
    )
    plain.inset = jax.tree.map(np.zeros_like, scene.inset)
    plain.twins, plain.tight = ((),) * scene.size, False
    return plain


@dataclasses.dataclass(frozen=True)
class Walk:
    """A walk of so many events: its counts, in the order of ``COUNTS``, and the radiance that it has met, of lamps and
    of the sky. It ends where it leaves the room or gets into a ball.

    ``next_hit(scene, ray, own)`` returns where a ray that starts on primitive ``own`` ends.
    """

    next_hit: Callable
    bounces: int
    directions: str = "cosine"

    def __call__(self, u, scene, start, pixel=None):
        first, ray = _start(u, start, pixel)
        hit = self.next_hit(scene, ray, -1)
        met = jnp.stack([*[jnp.zeros(())] * len(COUNTS), *_light(scene, ray, hit)])
        state = (ray, hits.Hit(hit.distance, jnp.asarray(hit.face)), jnp.ones(()), met)

        def event(state, k):
            ray, hit, beta, total = state
            surface = hits.surface_at(scene, ray, hit)
            wi, _, weight = sample_diffuse(self.directions, surface.normal, u[first + 2 * k], u[first + 2 * k + 1])
            for i in scene.mirrors:
                wi = where(surface.face == i, reflect(ray.direction, surface.normal), wi)
            onward = rays.ray(surface.point, wi)
            after = self.next_hit(scene, onward, surface.face)
            beta = beta * surface.reflectance * weight
            alive, sphere, inward = hit.face >= 0, *_side(scene, surface)
            again = (after.face == surface.face) & ~(sphere & inward)
            finite = jnp.isfinite(dot(surface.point, surface.point)) & jnp.isfinite(dot(wi, wi))
            trapped = sphere & inward & (_curvature(scene, surface.face) > 0.0)
            happened = [alive, after.face < 0, again, trapped, ~finite]
            new = [jnp.where(alive & x, 1.0, 0.0) for x in happened]
            met = [jnp.where(alive, beta * light, 0.0) for light in _light(scene, onward, after)]
            after = hits.Hit(after.distance, jnp.where(alive & ~trapped, after.face, -1))
            return (onward, after, beta, total + jnp.stack([*new, *met])), None

        (*_, total), _ = lax.scan(event, state, jnp.arange(self.bounces))
        return total


def _start(u, start, pixel):
    """Return the number of the first coordinate that is left, and the ray: of a camera's pixel, or the one given."""
    if not isinstance(start, Camera):
        return 0, rays.ray(*start)
    column, row = pixel % start.width, pixel // start.width
    return 2, start.ray(column.astype(float) + u[0], row.astype(float) + u[1])


def _light(scene, ray, hit):
    """Return the radiance that a ray meets: of lamps, and of the sky."""
    sky = jnp.zeros(()) if scene.sky is None else jnp.where(hit.face < 0, sky_radiance(scene.sky, ray.direction), 0.0)
    return emission_toward(scene, ray, hit), sky


def _curvature(scene, i):
    return 0.0 * i if scene.inverse_radius is None else scene.inverse_radius.at(i)


def _side(scene, surface):
    """Return whether a surface is a sphere, and whether the path is inside it."""
    center = Vec3(*(table.at(surface.face) for table in scene.anchor))
    return _curvature(scene, surface.face) != 0.0, dot(surface.normal, surface.point - center) < 0.0


def count(scene, origin, toward, directions="cosine", *, events, bounces, next_hit=ours, key=0, progress=None) -> dict:
    """Walk for about ``events`` events from a point of a closed room and return how often each thing happened."""
    direction = normalize(as_vec3("toward", toward))
    start = scene.local(as_vec3("origin", origin)), Vec3(*map(np.asarray, direction))
    paths = max(1, events // bounces)
    walk = Integrand(Walk(next_hit, bounces, directions), 2 * bounces, (scene, start), lazy=True)
    estimate = integrate(walk, n=paths, key=key, progress=progress)
    totals = np.nan_to_num(np.asarray(estimate.mean, np.float64)) * paths
    found = dict(zip(COUNTS, np.round(totals).astype(int).tolist()))
    return found | {"not finite": found["not finite"] + estimate.nonfinite}


def picture(scene, camera, *, next_hit=ours, spp, bounces=4, key=0, progress=None) -> np.ndarray:
    """Return a picture of a closed grey scene, shape (height, width, 3), by walks that wait until they meet a light.
    What comes from its lamps is grey, what leaks in from the sky is red.
    """
    local = dataclasses.replace(camera, origin=scene.local(camera.origin))
    walk = Integrand(Walk(next_hit, bounces), 2 + 2 * bounces, (scene, local), lazy=True)
    estimate = integrate_each(walk, camera.width * camera.height, n=spp, key=key, progress=progress)
    lamps, sky = np.moveaxis(np.asarray(estimate.mean)[:, len(COUNTS) :].reshape(camera.height, camera.width, 2), -1, 0)
    return np.stack([lamps + sky, lamps, lamps], -1)
