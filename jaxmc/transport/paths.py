"""Path integrands: light transport as one flat integral over the unit hypercube.

A path takes two coordinates for the film position (only where there is a camera), then for each scattering event, with
light sampling, two for the point on the light and one to pick the light where there are several, and two for the
direction. So what matters most comes first, which evenly spread points want. ``Integrand.labels`` names them all.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.counts import is_count
from . import shapes
from .hits import Hit, Surface, closest_hit, is_same, surface_at, unoccluded
from .materials import luminance, pdf_diffuse, power_heuristic, reflect, sample_diffuse, weight_of_hit
from .primitives import is_number
from .scene import Scene
from .shapes import LightSample, QuadLight, Ray
from .sky import sky_radiance
from .vec import Vec3, dot, where

POLAR, AZIMUTH = "direction: polar", "direction: azimuth"


@dataclasses.dataclass(frozen=True)
class Strategy:
    """How paths are sampled: the static options of every path integrand."""

    bounces: int
    directions: str = "cosine"
    lights: str = "mis"
    clamp: float | None = None
    hide_emitters: bool = False

    def __post_init__(self):
        if not is_count(self.bounces, least=0):
            raise ValueError(f"bounces must be an integer >= 0, got {self.bounces!r}; 0 is emission seen directly")
        for name, known in (("directions", ("cosine", "uniform")), ("lights", ("mis", "nee", "none"))):
            if not isinstance(getattr(self, name), str) or getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        if self.clamp is not None:
            if not (is_number(self.clamp) and 0.0 < self.clamp < np.inf):
                raise ValueError(f"clamp must be a positive luminance or None, got {self.clamp!r}")
            object.__setattr__(self, "clamp", float(self.clamp))

    def without_bounces(self) -> "Strategy":
        """Return the strategy of paths that see emission directly only."""
        return dataclasses.replace(self, bounces=0)

    def coordinates(self, scene: Scene) -> tuple[str, ...]:
        """Return what the coordinates of one scattering event decide."""
        if self.lights == "none" or not scene.lights:
            return (POLAR, AZIMUTH)
        pick = ("which light",) if len(scene.lights) > 1 else ()
        return ("light: first", "light: second", *pick, POLAR, AZIMUTH)


class PathState(NamedTuple):
    """A path after some scattering events: its last ray and what it met, throughput and radiance collected.

    ``scattered`` says that a diffuse surface has been met; None where nobody asks.
    """

    ray: Ray
    hit: Hit
    beta: Any
    radiance: Any
    scattered: Any


def emission_toward(scene: Scene, ray: Ray, hit: Hit, pdf):
    """Return the emission that a ray meets, each light weighted by the power heuristic against sampling that light.

    ``pdf`` is the density of the ray's direction; None where lights are not sampled, and the weight is 1.
    """
    total = black(scene)
    distance = jnp.where(hit.primitive < 0, 1.0, hit.distance)
    for i, (light, radiance) in zip(scene.lights, scene.emitters, strict=True):
        inverse = _inverse_pdf(light, ray, distance)
        shines = (hit.primitive == i) & (inverse > 0.0)
        if pdf is not None:
            # The density of the ray, against that of picking this light and the point the ray has met.
            weight = weight_of_hit(pdf, inverse * len(scene.lights))
            total = total + where(shines, radiance * weight, black(scene))
        else:
            total = total + where(shines, radiance, black(scene))
    return total


def _inverse_pdf(light, ray, distance):
    inverse = shapes.inverse_pdf_quad_light if isinstance(light, QuadLight) else shapes.inverse_pdf_sphere_light
    return inverse(light, ray.origin, ray.direction, distance)


def sample_light(scene: Scene, point, own, u1, u2, pick) -> tuple[LightSample, Any, Any]:
    """Return a sample of one light from a point on primitive ``own``, its radiance, and its primitive; ``pick`` is the
    coordinate that picks the light.
    """
    count = len(scene.lights)
    chosen = 0 if count == 1 else jnp.minimum((pick * count).astype(jnp.int32), count - 1)
    result = None
    for k, (i, (light, radiance)) in enumerate(zip(scene.lights, scene.emitters, strict=True)):
        sample = shapes.sample_quad_light if isinstance(light, QuadLight) else shapes.sample_sphere_light
        one = (sample(light, point, is_same(scene, own, i), u1, u2), radiance, i)
        result = one if result is None else jax.tree.map(lambda a, b, k=k: jnp.where(chosen == k, a, b), one, result)
    drawn, radiance, primitive = result
    return drawn._replace(inverse_pdf=drawn.inverse_pdf * count), radiance, primitive


def black(scene):
    return jnp.zeros(()) if scene.channels == 1 else Vec3(*[jnp.zeros(())] * 3)


def _direct_light(scene, strategy, surface, u, first, anywhere):
    """Return radiance times BRDF over density of one sampled light, albedo left out."""
    pick = u[first + 2] if len(scene.lights) > 1 else None
    light, radiance, target = sample_light(scene, surface.point, surface.primitive, u[first], u[first + 1], pick)
    cosine = dot(surface.normal, light.wi)
    toward = shapes.ray(surface.point, light.wi)
    visible = (cosine > 0.0) & (light.inverse_pdf > 0.0) & (surface.primitive >= 0)
    visible = visible & unoccluded(scene, toward, light.distance, surface.primitive, target, anywhere)
    weight = cosine * light.inverse_pdf * (1.0 / np.pi)
    if strategy.lights == "mis":
        weight = weight * power_heuristic(light.inverse_pdf, pdf_diffuse(strategy.directions, cosine))
    return where(visible, radiance * weight, black(scene))


def scatter(scene, strategy, u, first, surface: Surface, path: PathState, anywhere=False) -> PathState:
    """Scatter a path at a surface: sample a light, then a direction, and follow it. A path that ended stays so.

    ``anywhere``: the surface need not be one of the scene's.
    """
    alive = surface.primitive >= 0
    beta = path.beta * surface.reflectance
    sampled = strategy.lights != "none" and bool(scene.lights)
    mirror = jnp.zeros((), bool)
    for i in scene.mirrors:
        mirror = mirror | (surface.primitive == i)
    radiance = path.radiance
    if sampled:
        direct = _direct_light(scene, strategy, surface, u, first, anywhere)
        direct = where(mirror, black(scene), direct) if scene.mirrors else direct
        radiance = radiance + beta * direct
    toward = first + strategy.coordinates(scene).index(POLAR)
    wi, pdf, weight = sample_diffuse(strategy.directions, surface.normal, u[toward], u[toward + 1])
    if scene.mirrors:
        wi = where(mirror, reflect(path.ray.direction, surface.normal), wi)
        weight = jnp.where(mirror, 1.0, weight)
    if not isinstance(weight, float):
        beta = beta * weight
    ray = shapes.ray(surface.point, wi)
    hit = closest_hit(scene, ray, surface.primitive)
    if scene.sky is not None:
        radiance = radiance + where(alive & (hit.primitive < 0), beta * sky_radiance(scene.sky, wi), black(scene))
    hit = hit._replace(primitive=jnp.where(alive, hit.primitive, -1))
    scattered = None if path.scattered is None else path.scattered | ~mirror
    if scene.lights and not (strategy.lights == "nee" and not scene.mirrors):
        met = _emission_by_strategy(scene, strategy, ray, hit, pdf, mirror)
        if scattered is not None:
            met = where(scattered, met, black(scene))
        radiance = radiance + beta * met
    return PathState(ray, hit, beta, radiance, scattered)


def _emission_by_strategy(scene, strategy, ray, hit, pdf, mirror):
    """Return emission met after scattering: in full, weighted, or only after a mirror, which no light sample serves."""
    if strategy.lights == "none":
        return emission_toward(scene, ray, hit, None)
    weighted = emission_toward(scene, ray, hit, pdf) if strategy.lights == "mis" else black(scene)
    return where(mirror, emission_toward(scene, ray, hit, None), weighted) if scene.mirrors else weighted


def trace(scene: Scene, strategy: Strategy, u, first: int, start: Ray, observe=None):
    """Return the radiance that arrives along a ray, and what ``observe(surface, state)`` saw at each scattering event.

    Coordinates from ``first`` on feed the scattering events.
    """
    hit = closest_hit(scene, start) if strategy.bounces else apart(scene, partial(closest_hit, scene), start)
    one = jnp.ones(()) if scene.channels == 1 else Vec3(*[jnp.ones(())] * 3)
    seen = scene.lights and not strategy.hide_emitters
    radiance = emission_toward(scene, start, hit, None) if seen else black(scene)
    if scene.sky is not None:
        radiance = radiance + where(hit.primitive < 0, sky_radiance(scene.sky, start.direction), black(scene))
    scattered = jnp.zeros((), bool) if scene.mirrors and strategy.hide_emitters else None
    state = PathState(start, hit, one, radiance, scattered)
    return follow(scene, strategy, u, first, state, strategy.bounces, observe)


def follow(scene, strategy, u, first, state: PathState, bounces, observe=None):
    """Scatter a path ``bounces`` times."""
    state = jax.tree.map(lambda x: jnp.asarray(x, float if jnp.result_type(x).kind == "f" else None), state)
    stride = len(strategy.coordinates(scene))

    def event(state, k):
        surface = surface_at(scene, state.ray, state.hit)
        after = scatter(scene, strategy, u, first + stride * k, surface, state)
        return after, (observe(surface, after) if observe else None)

    if bounces == 0:
        return state.radiance, None
    if bounces == 1:
        state, seen = apart(scene, partial(event, k=0), state)
        return state.radiance, jax.tree.map(lambda x: x[None], seen)
    state, seen = lax.scan(event, state, jnp.arange(bounces))
    return state.radiance, seen


def apart(scene: Scene, function, *args):
    """Return ``function(*args)``, computed behind a branch that is always taken.

    XLA:CPU repeats what several results share wherever it can see through, which in a chain of intersections grows
    without bound; it does not see through a loop or a branch. Loops of one round it removes.
    """
    shapes = jax.eval_shape(function, *args)
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return lax.cond(scene.present > 0.0, function, lambda *_: nothing, *args)


def finish(strategy: Strategy, radiance):
    """Return the value of a path: a number or RGB of shape (3,), scaled down to luminance ``clamp`` where asked."""
    value = jnp.stack(radiance) if isinstance(radiance, Vec3) else radiance
    return value if strategy.clamp is None else clamp_luminance(value, strategy.clamp)


def clamp_luminance(value, threshold):
    """Scale values down to luminance ``threshold`` where they exceed it; channels, if any, on the last axis."""
    y = luminance(value)
    scale = jnp.where(y > threshold, threshold / y, 1.0)
    return value * (scale if jnp.shape(value) == jnp.shape(y) else scale[..., None])
