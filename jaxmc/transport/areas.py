"""Light transport as an integral over surfaces: the same irradiance in the area form, point by point of each path.

Beside the form over directions it shows what the change of variables costs: 1 / r^2 is integrated as it stands, so two
surfaces that meet make the variance infinite.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.counts import is_count
from ..integration.integrand import Integrand
from . import flats, geometry, rays
from .flats import FlatLight
from .hits import at, closest_hit, face_at
from .lookups import lookups
from .primitives import Sphere, as_color, as_unit, as_vec3
from .scene import Scene
from .spheres import point_by_area
from .vec import Vec3, dot, larger, where


def irradiance_by_areas(scene: Scene, point, normal, *, bounces=0) -> Integrand:
    """Return the irradiance at a point after exactly ``bounces`` scattering events, as an integral over surfaces.

    For each event a face is picked in proportion to its area and a point on it, three coordinates; at last a light and
    a point on it, three more. The value is emission times the product of albedo / pi, of cosines over squared distances
    and of visibility, over the density per area. Source: Veach 1997, chapter 8 (three-point form).

    Unlike ``irradiance``, which sums up to a number of events, this is one term of the sum.

    Raises:
        ValueError: surfaces that are not diffuse, no light, or a scene that has gone through a transformation of JAX.
    """
    if not isinstance(scene, Scene) or not hasattr(scene, "given"):
        raise ValueError("irradiance_by_areas needs a scene as mc.Scene([...]) makes it")
    if scene.mirrors or scene.rough or scene.dielectrics or not scene.lights:
        raise ValueError("irradiance_by_areas needs diffuse surfaces and at least one light")
    if not is_count(bounces, least=0):
        raise ValueError(f"bounces must be an integer >= 0, got {bounces!r}")
    primitives, kind = scene.given[0], jnp.result_type(float)
    outlines = geometry.build(primitives).outlines
    emission = [as_color("emission", primitives[i].emission or 0.0) for i in scene.owner]
    emission = lookups([c[0] if scene.channels == 1 else Vec3(*c) for c in emission])
    lamps = sorted(set(scene.lights))
    sides = [_sides(primitives[scene.owner[i]]) for i in lamps]
    targets = tuple(
        Targets(tuple(faces), tuple(np.cumsum(areas).tolist()))
        for faces in (range(scene.size), lamps)
        for areas in ([_area(outlines[i]) for i in faces],)
    )
    words = [f"event {k + 1}" for k in range(bounces)] + ["light"]
    labels = tuple(f"{word}, {what}" for word in words for what in ("which face", "first", "second"))
    params = jax.tree.map(lambda x: np.asarray(x, kind), (tuple(outlines), emission))
    place = scene.local(as_vec3("point", point)), as_unit("normal", normal)
    return Integrand(_ByAreas(int(bounces), targets, tuple(sides)), len(labels), (scene, *params, *place), True, labels)


class Targets(NamedTuple):
    """Faces to pick from, and the sums of their areas up to each."""

    faces: tuple[int, ...]
    cumulative: tuple[float, ...]


def _area(outline):
    return float(outline.area) if isinstance(outline, FlatLight) else 4.0 * np.pi * float(outline.radius) ** 2


def _sides(primitive) -> tuple[bool, bool]:
    """Return whether a light shines to the side of its outline's normal, and to the other."""
    inward = isinstance(primitive, Sphere) and primitive.inward
    return (True, True) if primitive.two_sided else (not inward, inward)


def point_on(outline, u1, u2):
    """Return a point of a face drawn uniformly by area, and the normal there, away from a sphere's centre."""
    if isinstance(outline, FlatLight):
        return flats.point_on(outline, u1, u2), outline.normal
    return point_by_area(outline, u1, u2)


@dataclasses.dataclass(frozen=True)
class _ByAreas:
    bounces: int
    targets: tuple[Targets, Targets]
    sides: tuple[tuple[bool, bool], ...]

    def __call__(self, u, scene, outlines, emission, point, normal):
        own, weight = face_at(scene, point), 1.0
        beta = jnp.ones(()) if scene.channels == 1 else Vec3(*[jnp.ones(())] * 3)
        surfaces, lamps = self.targets
        for k in range(self.bounces):
            which, target, its_normal = _draw(surfaces, outlines, u, 3 * k)
            face = jnp.asarray(surfaces.faces)[which]
            factor, facing = _geometry_term(scene, point, normal, own, target, its_normal, face)
            weight = weight * factor * (surfaces.cumulative[-1] / np.pi)
            beta = beta * at(scene.reflectance, face)
            point, normal, own = target, where(facing > 0.0, its_normal, -its_normal), face
        which, target, its_normal = _draw(lamps, outlines, u, 3 * self.bounces)
        face = jnp.asarray(lamps.faces)[which]
        factor, facing = _geometry_term(scene, point, normal, own, target, its_normal, face)
        sides = jnp.asarray(self.sides)[which]
        shines = jnp.where(facing > 0.0, sides[0], sides[1])
        weight = jnp.where(shines, weight * factor * lamps.cumulative[-1], 0.0)
        value = beta * at(emission, face) * weight
        return jnp.stack(value) if isinstance(value, Vec3) else value


def _draw(targets, outlines, u, first):
    """Return which of the targets is picked by area, a point of it and the normal there."""
    aim, which = u[first] * targets.cumulative[-1], 0
    for k, edge in enumerate(targets.cumulative[:-1]):
        which = jnp.where(aim >= edge, k + 1, which)
    candidates = [point_on(outlines[i], u[first + 1], u[first + 2]) for i in targets.faces]
    result = candidates[0]
    for k, one in enumerate(candidates[1:], 1):
        result = jax.tree.map(lambda a, b, k=k: jnp.where(which == k, a, b), one, result)
    return which, *result


def _geometry_term(scene, point, normal, own, target, its_normal, face):
    """Return cosine times cosine over squared distance, 0 where the points do not see each other; and the cosine at
    the target, positive on the side of its normal.
    """
    to = target - point
    squared = dot(to, to)
    inverse = jnp.sqrt(1.0 / squared)
    wi = to * inverse
    facing = -dot(its_normal, wi)
    hit = closest_hit(scene, rays.ray(point, wi), own)
    # Of a sphere that is not the one it starts on, a ray meets the side that it faces, unless it starts inside.
    reached = (hit.face == face) & (jnp.abs(hit.distance * inverse - 1.0) < 1e-3)
    term = larger(dot(normal, wi), 0.0) * jnp.abs(facing) * (inverse * inverse)
    return jnp.where(reached, term, 0.0), facing
