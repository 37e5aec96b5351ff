"""Lights: which one to sample, a sample of it, and the emission that a ray meets by itself."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import shapes
from .flats import FlatLight
from .materials import luminance
from .primitives import is_concrete
from .rays import LightSample
from .spheres import SphereLight
from .vec import Vec3, dot, larger, smaller, where

MANY = 8  # lights, above which one is looked up by its number before it is sampled


class Shining(NamedTuple):
    """A face that emits: its number, primitive and outline, and its radiance as (r, g, b) and as the scene's color."""

    face: int
    primitive: Any
    outline: Any
    rgb: tuple
    radiance: Any


class Group(NamedTuple):
    """Lights of one kind as arrays: of ``light`` and ``radiance``, the leading axis runs over them."""

    light: Any
    radiance: Any


def emitters(shining: list[Shining]) -> tuple[tuple[int, ...], Any, Any]:
    """Return the face of each light, the lights with their radiance, and their powers in units of the largest.

    Lights are a list of pairs, or where there are many a list of ``Group``; those of one kind follow each other.
    """
    entries = [(s.face, light, s.radiance, _power(light, s.rgb)) for s in shining for light in _lights_of(s)]
    powers = [power for *_, power in entries]
    largest = max(powers, default=1.0) if is_concrete(powers) else jnp.max(jnp.stack(powers))
    entries = [(*entry, power / largest) for *entry, power in entries]
    if len(entries) <= MANY:
        return tuple(e[0] for e in entries), tuple(e[1:3] for e in entries), tuple(e[3] for e in entries)
    kinds: dict[Any, list] = {}
    for entry in entries:
        kinds.setdefault(jax.tree.structure(entry[1]), []).append(entry)
    groups = tuple(Group(*_stacked([(light, radiance) for _, light, radiance, _ in kind])) for kind in kinds.values())
    ordered = [entry for kind in kinds.values() for entry in kind]
    return tuple(e[0] for e in ordered), groups, _stacked([e[3] for e in ordered])


def has_flat_lights(scene) -> bool:
    """Return whether all lights are flat."""
    return all(isinstance(entry[0], FlatLight) for entry in scene.emitters)


def _stacked(trees):
    return jax.tree.map(lambda *x: np.stack(x) if is_concrete(x) else jnp.stack(x), *trees)


def _lights_of(s: Shining) -> list:
    """Return the lights of a face: one, or two of a sphere that shines to both sides."""
    if isinstance(s.outline, FlatLight):
        return [s.outline.shining_to_both_sides() if s.primitive.two_sided else s.outline]
    sides = (False, True) if s.primitive.two_sided else (s.primitive.inward,)
    return [SphereLight(s.outline, inward) for inward in sides]


def _power(light, rgb):
    """Return the luminance of the flux of a light."""
    if isinstance(light, FlatLight):
        area = light.area * (2.0 if light.two_sided else 1.0)
    else:
        area = 4.0 * np.pi * light.sphere.radius * light.sphere.radius
    return luminance(Vec3(*rgb)) * area * np.pi


# ------------------------------------------------------------------------------------------------------- which one


def pick_light(scene, pick: str, point, normal, u):
    """Return the number of a light and its probability; ``u`` is the coordinate that picks.

    ``pick`` is "uniform", "power" or "distance": power over squared distance, times bounds of both cosines.
    """
    count = len(scene.lights)
    if pick == "uniform":
        return jnp.minimum((u * count).astype(jnp.int32), count - 1), 1.0 / count
    weights = _weights(scene, pick, point, normal)
    if isinstance(weights, list):
        total = sum(weights[1:], weights[0])
        aim, chosen, weight, below = u * total, 0, weights[0], weights[0]
        for k, w in enumerate(weights[1:], 1):
            beyond = (aim >= below) & (w > 0.0)
            chosen, weight, below = jnp.where(beyond, k, chosen), jnp.where(beyond, w, weight), below + w
    else:
        below = jnp.cumsum(weights)
        total = below[-1]
        chosen = jnp.minimum(jnp.searchsorted(below, u * total, side="right"), count - 1)
        weight = weights[chosen]
    return chosen, jnp.where(total > 0.0, weight / jnp.where(total > 0.0, total, 1.0), 0.0)


def probability_of(scene, pick: str, point, normal):
    """Return a function of the number of a light: the probability with which ``pick_light`` picks it."""
    count = len(scene.lights)
    if pick == "uniform":
        return lambda k: 1.0 / count
    weights = _weights(scene, pick, point, normal)
    total = sum(weights[1:], weights[0]) if isinstance(weights, list) else weights.sum()
    inverse = jnp.where(total > 0.0, 1.0 / jnp.where(total > 0.0, total, 1.0), 0.0)
    return lambda k: weights[k] * inverse


def _weights(scene, pick, point, normal):
    """Return the weights of all lights, a list, or an array where there are many."""
    few = isinstance(scene.powers, tuple)
    if pick == "power":
        return list(scene.powers) if few else jnp.asarray(scene.powers)
    if few:
        return [_importance(light, power, point, normal) for (light, _), power in zip(scene.emitters, scene.powers)]
    parts, first = [], 0
    for group in scene.emitters:
        powers = jnp.asarray(scene.powers)[first : first + _size(group)]
        parts.append(jax.vmap(lambda light, power: _importance(light, power, point, normal))(group.light, powers))
        first += _size(group)
    return jnp.concatenate(parts)


def _size(group):
    return len(jax.tree.leaves(group)[0])


def _importance(light, power, point, normal):
    """Return the power of a light over its squared distance, times bounds of the cosines at the point and the light.

    The light counts as the ball around it; nearer than its radius the distance is that radius and the bounds are 1.
    Source of the bounds: Conty Estevez and Kulla 2018; pbrt, section 12.6.3.
    """
    if isinstance(light, FlatLight):
        center, radius2 = light.centroid, _farthest(light)
    else:
        center, radius2 = light.sphere.center, light.sphere.radius * light.sphere.radius
    to_light = center - point
    squared = larger(dot(to_light, to_light), 1e-12 * radius2)
    inverse = jnp.sqrt(1.0 / squared)
    sine2 = smaller(radius2 / squared, 1.0)
    cone = jnp.where(squared < radius2, -1.0, jnp.sqrt(1.0 - sine2)), jnp.sqrt(sine2)
    weight = power / larger(squared, radius2) * _bound(dot(normal, to_light) * inverse, *cone)
    if isinstance(light, FlatLight):
        facing = dot(light.normal, to_light) * inverse
        weight = weight * _bound(jnp.abs(facing) if light.two_sided else -facing, *cone)
    return weight


def _bound(cosine, cone_cosine, cone_sine):
    """Return a bound of the cosine with directions of a cone around one whose cosine is given."""
    sine = jnp.sqrt(larger(1.0 - cosine * cosine, 0.0))
    return jnp.where(cosine >= cone_cosine, 1.0, larger(cosine * cone_cosine + sine * cone_sine, 0.0))


def _farthest(light: FlatLight):
    """Return the squared distance of the farthest point from the centroid."""
    if light.disk:
        return dot(light.half_u, light.half_u)
    coordinates = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)) if light.triangle else ((1.0, 1.0), (1.0, -1.0))
    offsets = [light.center + light.half_u * u + light.half_v * v - light.centroid for u, v in coordinates]
    squares = [dot(o, o) for o in offsets]
    return larger(larger(squares[0], squares[1]), squares[-1])


# -------------------------------------------------------------------------------------------------------- samples


def sample_light(scene, strategy, point, normal, own, u1, u2, which) -> tuple[LightSample, Any, Any]:
    """Return a sample of one light from a point on face ``own``, its radiance, and its face; ``which`` is the
    coordinate that picks the light.
    """
    count, pick, by = len(scene.lights), strategy.pick, strategy.light_points
    if isinstance(scene.powers, tuple):
        chosen, probability = (0, 1.0) if count == 1 else pick_light(scene, pick, point, normal, which)
        result = None
        for k, (i, (light, radiance)) in enumerate(zip(scene.lights, scene.emitters, strict=True)):
            one = (shapes.sample_light(light, point, scene.is_same(own, i), u1, u2, by), radiance, i)
            result = (
                one if result is None else jax.tree.map(lambda a, b, k=k: jnp.where(chosen == k, a, b), one, result)
            )
        drawn, radiance, face = result
    else:
        chosen, probability = pick_light(scene, pick, point, normal, which)
        face = jnp.asarray(scene.lights)[chosen]
        is_own = scene.plane_of(own) == scene.plane_of(face)
        drawn, radiance = _sample_group(scene, chosen, point, is_own, u1, u2, by)
    if count == 1:
        return drawn, radiance, face
    if pick == "uniform":
        return drawn._replace(inverse_pdf=drawn.inverse_pdf * count), radiance, face
    inverse = jnp.where(probability > 0.0, 1.0 / jnp.where(probability > 0.0, probability, 1.0), 0.0)
    return drawn._replace(inverse_pdf=drawn.inverse_pdf * inverse), radiance, face


def _sample_group(scene, chosen, point, is_own, u1, u2, by):
    result, first = None, 0
    for group in scene.emitters:
        light, radiance = _nth(group, chosen - first)
        one = shapes.sample_light(light, point, is_own, u1, u2, by), radiance
        result = one if result is None else where_tree(chosen >= first, one, result)
        first += _size(group)
    return result


def where_tree(condition, a, b):
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def _nth(group, k):
    """Return light and radiance number ``k`` of a group, those at an end beyond it."""
    return jax.tree.map(lambda x: jnp.asarray(x)[jnp.clip(k, 0, _size(group) - 1)], tuple(group))


def emission_toward(scene, ray, hit, weigh=None, by="automatic"):
    """Return the emission that a ray meets.

    ``weigh(inverse_pdf, k)`` returns a factor for light number k, whose sampling has the inverse density
    ``inverse_pdf`` per solid angle there by the option ``light_points``, the choice of the light left out; None for 1.
    """
    total = black(scene)
    distance = jnp.where(hit.face < 0, 1.0, hit.distance)
    if isinstance(scene.powers, tuple):
        candidates = [
            (hit.face == i, k, *entry) for k, (i, entry) in enumerate(zip(scene.lights, scene.emitters, strict=True))
        ]
    else:
        candidates = _met(scene, hit)
    for is_met, k, light, radiance in candidates:
        inverse = shapes.inverse_pdf(light, ray.origin, ray.direction, distance, by)
        shines = is_met & (inverse > 0.0)
        value = radiance if weigh is None else radiance * weigh(inverse, k)
        total = total + where(shines, value, black(scene))
    return total


def _met(scene, hit):
    """Return what a ray may have met, one candidate of each kind of light."""
    first = 0
    for group in scene.emitters:
        faces = scene.lights[first : first + _size(group)]
        numbers = np.full(scene.size, -1)
        numbers[list(faces)] = np.arange(len(faces))
        k = jnp.where(hit.face < 0, -1, jnp.asarray(numbers).at[hit.face].get(mode="clip"))
        yield (k >= 0, first + k, *_nth(group, k))
        first += _size(group)


def black(scene):
    return jnp.zeros(()) if scene.channels == 1 else Vec3(*[jnp.zeros(())] * 3)
