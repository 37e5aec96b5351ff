"""Path integrands: light transport as one flat integral over the unit hypercube.

A path takes two coordinates for the film position (only where there is a camera), then for each scattering event, with
light sampling, two for the point on the light and one to pick the light where there are several, and two for the
direction. So what matters most comes first, which evenly spread points want. ``Integrand.labels`` names them all.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..integration.integrand import evaluated_in_step, holds_for_any
from . import bsdfs
from .bsdfs import evaluate_bsdf, kinds_of, power_heuristic, sample_bsdf, weight_of_hit
from .hits import Hit, Surface, closest_hit, surface_at, unoccluded
from .lights import black, emission_toward, probability_of, sample_light
from .rays import Ray, ray
from .regularize import memory_at_start, soften
from .scene import Scene
from .sky import sample_sky, sky_inverse_pdf, sky_radiance
from .strategy import POLAR, THROUGHPUT, Strategy
from .vec import Vec3, dot, larger, smaller, where

FEW = 12  # faces, above which the closest one is found apart: twice as fast for 18, no gain for 9


class Gained(NamedTuple):
    """What one scattering event added to the radiance: by what was sampled, and by what the next ray met."""

    sampled: Any
    met: Any


class PathState(NamedTuple):
    """A path after some scattering events: its last ray and what it met, throughput and radiance collected.

    ``scattered`` says that a surface has been met that is neither mirror nor glass, ``memory`` what a regularization
    remembers of the path, ``gained`` what the last event brought; all are None where nobody asks.
    """

    ray: Ray
    hit: Hit
    beta: Any
    radiance: Any
    scattered: Any
    memory: Any = None
    gained: Gained | None = None


class Vertex(NamedTuple):
    """A scattering event: the surface, its material, the direction in which the path arrives, the first of the event's
    coordinates, and whether the surface may be none of the scene's.
    """

    surface: Surface
    kinds: bsdfs.Kinds
    arriving: Vec3
    first: Any
    anywhere: bool


def _light_from(scene, strategy, vertex: Vertex, toward, visible):
    """Return what one sampled direction with light brings, reflectance left out: radiance times BRDF over density.

    ``toward`` is (wi, inverse_pdf, radiance); ``visible`` a function of the ray and whether it can matter.
    """
    surface, (wi, inverse_pdf, radiance) = vertex.surface, toward
    cosine = dot(surface.normal, wi)
    matters = (cosine > 0.0) & (inverse_pdf > 0.0) & (surface.face >= 0)
    value, pdf = evaluate_bsdf(scene, strategy.directions, surface, vertex.kinds, vertex.arriving, wi, cosine)
    weight = value * inverse_pdf * (1.0 / jnp.pi)
    if strategy.lights == "mis":
        weight = weight * power_heuristic(inverse_pdf, pdf)
    return where(matters & visible(ray(surface.point, wi)), radiance * weight, black(scene))


def _direct_light(scene, strategy, vertex: Vertex, u):
    """Return radiance times BRDF over density of sampled lights and of the sampled sky, reflectance left out."""
    surface, first = vertex.surface, vertex.first
    words, total = strategy.coordinates(scene), None
    if scene.lights:
        which = u[first + words.index("which light")] if len(scene.lights) > 1 else None
        light, radiance, target = sample_light(
            scene, strategy, surface.point, surface.normal, surface.face, u[first], u[first + 1], which
        )

        def reaches(toward):
            return unoccluded(scene, toward, light.distance, surface.face, target, vertex.anywhere)

        total = _light_from(scene, strategy, vertex, (light.wi, light.inverse_pdf, radiance), reaches)
    if strategy.samples_sky(scene):
        k = first + words.index("sky: first")
        found = sample_sky(scene.sky, surface.normal, u[k], u[k + 1])

        def is_free(toward):
            return unoccluded(scene, toward, jnp.inf, surface.face, None, anywhere=True)

        sky = _light_from(scene, strategy, vertex, found, is_free)
        total = sky if total is None else total + sky
    return total


def scatter(
    scene, strategy, u, first, surface: Surface, path: PathState, anywhere=False, event=0, received=0
) -> PathState:
    """Scatter a path at a surface: sample a light, then a direction, and follow it. A path that ended stays so.

    ``anywhere``: the surface need not be one of the scene's. ``event`` counts the scattering events before this one;
    ``received`` is 1 where the path came to a receiver before them.
    """
    alive = surface.face >= 0
    beta = path.beta * surface.reflectance
    kinds, memory = kinds_of(scene, surface), path.memory
    if strategy.regularize:
        kinds, memory = soften(scene, strategy.regularize, kinds, path.scattered, memory)
    vertex = Vertex(surface, kinds, path.ray.direction, first, anywhere)
    specular, radiance, sampled, met = vertex.kinds.specular, path.radiance, black(scene), black(scene)

    def limited(value):
        return strategy.clamp.of_contribution(value, event + received) if strategy.clamp else value

    if strategy.lights != "none" and (scene.lights or strategy.samples_sky(scene)):
        direct = _direct_light(scene, strategy, vertex, u)
        direct = direct if specular is None else where(specular, black(scene), direct)
        sampled = limited(beta * direct)
        radiance = radiance + sampled
    toward = first + strategy.coordinates(scene).index(POLAR)
    wi, pdf, weight = sample_bsdf(
        scene, strategy.directions, surface, vertex.kinds, vertex.arriving, u[toward], u[toward + 1]
    )
    beta = beta if isinstance(weight, float) else beta * weight
    beta = strategy.clamp.of_throughput(beta) if strategy.clamp else beta
    if strategy.roulette:
        survives, inverse = play_roulette(strategy.roulette, beta, vertex.kinds, event, u[toward + 2])
        alive, beta = alive & survives, beta * inverse
    onward = ray(surface.point, wi)
    meet = partial(closest_hit, scene)
    hit = apart(scene, meet, onward, surface.face) if scene.size > FEW else meet(onward, surface.face)
    if scene.sky is not None:
        sky = limited(beta * _sky_met(scene, strategy, wi, pdf, surface.normal, specular))
        met = where(alive & (hit.face < 0), sky, black(scene))
        radiance = radiance + met
    hit = hit._replace(face=jnp.where(alive, hit.face, -1))
    scattered = path.scattered
    if scattered is not None and specular is not None:
        scattered = scattered | ~specular
    elif scattered is not None:
        scattered = jnp.ones((), bool)
    if scene.lights and not (strategy.lights == "nee" and specular is None):
        emitted = emission_met(scene, strategy, onward, hit, pdf, surface, specular)
        if scattered is not None and strategy.hide_emitters:
            emitted = where(scattered, emitted, black(scene))
        emitted = limited(beta * emitted)
        radiance = radiance + emitted
        met = emitted if path.gained is None else met + emitted
    return PathState(onward, hit, beta, radiance, scattered, memory, path.gained and Gained(sampled, met))


def play_roulette(roulette, beta, kinds, event, u):
    """Return whether a path survives, and what that makes it worth."""
    if roulette.survival == THROUGHPUT:
        brightest = larger(larger(beta.x, beta.y), beta.z) if isinstance(beta, Vec3) else beta
        survival = smaller(brightest, 1.0)
    else:
        survival = roulette.survival
    exempt = event < roulette.after
    if kinds.dielectric is not None:
        exempt = exempt | kinds.dielectric
    survival = jnp.where(exempt, 1.0, survival)
    # A path of throughput 0 may end: it is worth nothing.
    return u < survival, jnp.where(survival > 0.0, 1.0 / jnp.where(survival > 0.0, survival, 1.0), 0.0)


def _sky_met(scene, strategy, wi, pdf, normal, specular):
    """Return the radiance of the sky that a direction has met, weighted against sampling the sky."""
    radiance = sky_radiance(scene.sky, wi)
    if not strategy.samples_sky(scene):
        return radiance
    if strategy.lights == "mis":
        weight = weight_of_hit(pdf, sky_inverse_pdf(scene.sky, normal, wi))
    else:
        weight = jnp.zeros(())
    return radiance * (weight if specular is None else jnp.where(specular, 1.0, weight))


def emission_met(scene, strategy, onward, hit, pdf, surface, specular):
    """Return emission met after scattering: in full, weighted, or only after a mirror, which no light sample serves."""
    if strategy.lights == "none":
        return emission_toward(scene, onward, hit)
    weighted = black(scene)
    if strategy.lights == "mis":
        count = len(scene.lights)
        probability = None
        if count > 1 and strategy.pick != "uniform":
            probability = probability_of(scene, strategy.pick, surface.point, surface.normal)

        def weigh(inverse, k):
            # The density of the ray, against that of picking this light and the point the ray has met.
            if probability is None:
                return weight_of_hit(pdf, inverse * count)
            p = probability(k)
            return weight_of_hit(pdf, jnp.where(p > 0.0, inverse / jnp.where(p > 0.0, p, 1.0), jnp.inf))

        weighted = emission_toward(scene, onward, hit, weigh, strategy.light_points)
    return weighted if specular is None else where(specular, emission_toward(scene, onward, hit), weighted)


def trace(scene: Scene, strategy: Strategy, u, first: int, start: Ray, observe=None):
    """Return the radiance that arrives along a ray, and what ``observe(surface, state)`` saw at each scattering event.

    Coordinates from ``first`` on feed the scattering events.
    """
    hit = closest_hit(scene, start) if strategy.bounces else apart(scene, partial(closest_hit, scene), start)
    return follow(scene, strategy, u, first, begin(scene, strategy, start, hit), strategy.bounces, observe)


def begin(scene, strategy, start: Ray, hit: Hit) -> PathState:
    """Return a path before its first scattering event: the radiance that its first ray meets."""
    one = jnp.ones(()) if scene.channels == 1 else Vec3(*[jnp.ones(())] * 3)
    radiance = emission_toward(scene, start, hit) if scene.lights and not strategy.hide_emitters else black(scene)
    if scene.sky is not None:
        radiance = radiance + where(hit.face < 0, sky_radiance(scene.sky, start.direction), black(scene))
    if strategy.clamp:
        radiance = strategy.clamp.of_contribution(radiance, 0)
    hides = (scene.mirrors or scene.dielectrics) and strategy.hide_emitters
    scattered = jnp.zeros((), bool) if hides or strategy.regularize else None
    return PathState(start, hit, one, radiance, scattered, memory_at_start(strategy.regularize))


def follow(scene, strategy, u, first, state: PathState, bounces, observe=None, received=0):
    """Scatter a path ``bounces`` times."""
    state = jax.tree.map(lambda x: jnp.asarray(x, float if jnp.result_type(x).kind == "f" else None), state)
    stride = len(strategy.coordinates(scene))

    def event(state, k):
        surface = surface_at(scene, state.ray, state.hit)
        after = scatter(scene, strategy, u, first + stride * k, surface, state, event=k, received=received)
        return after, (observe(surface, after) if observe else None)

    if bounces == 0:
        return state.radiance, None
    if bounces == 1:
        state, seen = apart(scene, partial(event, k=0), state)
        return state.radiance, jax.tree.map(lambda x: x[None], seen)

    def scatter_on(state):
        return lax.scan(event, state, jnp.arange(bounces))

    if observe or not evaluated_in_step():
        state, seen = scatter_on(state)
        return state.radiance, seen
    # Paths take their steps together: where none of them has met a surface, take none. A look before every step would
    # save more in an open scene, and cost a tenth in a closed one, where the state has to be copied.
    going = holds_for_any(state.hit.face >= 0)
    return lax.cond(going, lambda s: scatter_on(s)[0], lambda s: s, state).radiance, None


def apart(scene: Scene, function, *args):
    """Return ``function(*args)``, computed behind a branch that is always taken.

    XLA:CPU repeats what several results share wherever it can see through, which in a chain of intersections grows
    without bound; it does not see through a loop or a branch. Loops of one round it removes.
    """
    shapes = jax.eval_shape(function, *args)
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return lax.cond(scene.present > 0.0, function, lambda *_: nothing, *args)


def finish(strategy: Strategy, radiance):
    """Return the value of a path: a number or RGB of shape (3,), limited where asked."""
    radiance = radiance if strategy.clamp is None else strategy.clamp.of_sample(radiance)
    return jnp.stack(radiance) if isinstance(radiance, Vec3) else radiance
