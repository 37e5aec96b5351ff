"""Paths through a scene in motion: found at rest, then evaluated again with what moves.

Every decision is taken at rest. Then a path moves: directions that were drawn keep what they have met in place, by its
flow; directions that a camera, a mirror or glass gives, and where they lead, follow from what is before them.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..transport import paths
from ..transport.bsdfs import Kinds, evaluate_bsdf, kinds_of, power_heuristic, reflect, sample_bsdf
from ..transport.fresnel import fresnel_dielectric, refract
from ..transport.hits import Hit, Surface, closest_hit, surface_at, unoccluded
from ..transport.lights import black, emission_toward, sample_light
from ..transport.rays import Ray, ray
from ..transport.sky import sky_radiance
from ..transport.strategy import POLAR
from ..transport.vec import Vec3, dot, where
from .flows import attach, carried, flow, normal_at, one_of, ratio, still
from .world import World

KEPT = 8  # events of which reverse mode keeps everything


class Walk(NamedTuple):
    """A path on its way: its last ray and what that has met, at rest; and in motion the point there, the direction in
    which it arrives, and throughput.
    """

    ray: Ray
    hit: Hit
    point: Vec3
    arriving: Vec3
    beta: Any


class Vertex(NamedTuple):
    """A surface that a path scatters at, at rest and in motion; ``beta`` has the surface's reflectance."""

    surface: Surface
    kinds: Kinds
    moving: Surface
    moving_kinds: Kinds
    came: Vec3
    arriving: Vec3
    beta: Any


def start(world: World, wo: Ray, wi: Vec3, origin: Vec3) -> tuple[Walk, Any]:
    """Return a path after its first ray, and the radiance that it meets there.

    The ray ``wo`` is at rest; ``origin`` and ``wi`` are the same in motion.
    """
    rest = world.rest
    hit = closest_hit(rest, wo)
    one = jnp.ones(()) if rest.channels == 1 else Vec3(*[jnp.ones(())] * 3)
    row, distance = _met(world, hit)
    walk = Walk(wo, hit, carried(row, origin, wi, distance), wi, one)
    met = black(rest)
    if rest.lights:
        met = one_of(world.values.emission, hit.face) * emission_toward(world.shares, wo, hit)
    if rest.sky is not None:
        met = met + where(hit.face < 0, sky_radiance(world.values.sky, wi), black(rest))
    return walk, met


def _met(world, hit):
    return world.values.faces.at(hit.face), jnp.where(hit.face >= 0, hit.distance, 1.0)


def vertex_of(world: World, walk: Walk) -> Vertex:
    """Return the surface that a path has met."""
    surface = surface_at(world.rest, walk.ray, walk.hit)
    row = world.values.faces.at(surface.face)
    moving = surface._replace(
        point=attach(surface.point, walk.point), normal=normal_at(row, walk.point, surface.normal)
    )
    reflectance = attach(surface.reflectance, one_of(world.values.reflectance, surface.face))
    return Vertex(
        surface, kinds_of(world.rest, surface), moving, kinds_of(world.moving, surface), walk.ray.direction,
        attach(walk.ray.direction, walk.arriving), walk.beta * reflectance,
    )  # fmt: skip


def evaluate(world: World, strategy, vertex: Vertex, wi: Vec3):
    """Return pi times BRDF times cosine of a direction in motion, reflectance left out, and its density at rest."""
    cosine = dot(vertex.moving.normal, wi)
    value, pdf = evaluate_bsdf(
        world.moving, strategy.directions, vertex.moving, vertex.moving_kinds, vertex.arriving, wi, cosine
    )
    return value, still(pdf), still(cosine)


def scatter(world: World, strategy, u, first, walk: Walk, event) -> tuple[Walk, Any]:
    """Scatter a path at what it has met: return it after that, and the radiance that this brought."""
    return scatter_at(world, strategy, u, first, vertex_of(world, walk), event)


def scatter_at(world: World, strategy, u, first, vertex: Vertex, event, anywhere=False) -> tuple[Walk, Any]:
    """Scatter a path at a vertex, which may lie ``anywhere`` and not on a face."""
    rest, surface, kinds = world.rest, vertex.surface, vertex.kinds
    alive, gained = surface.face >= 0, black(rest)
    if strategy.lights != "none" and rest.lights:
        sampled = _light(world, strategy, vertex, u, first, anywhere)
        gained = sampled if kinds.specular is None else where(kinds.specular, gained, sampled)
    toward = first + strategy.coordinates(rest).index(POLAR)
    drawn = sample_bsdf(rest, strategy.directions, surface, kinds, vertex.came, u[toward], u[toward + 1])
    onward = ray(surface.point, drawn.wi)
    meet = partial(closest_hit, rest)
    hit = meet(onward, surface.face) if rest.size <= paths.FEW else paths.apart(rest, meet, onward, surface.face)
    # A path that has ended meets nothing, or what it meets by chance turns derivatives to NaN.
    hit = hit._replace(face=jnp.where(alive, hit.face, -1))
    point, wi, weight = _moved(world, strategy, vertex, drawn, hit)
    beta = vertex.beta * weight
    if strategy.roulette:
        survives, inverse = paths.play_roulette(strategy.roulette, still(beta), kinds, event, u[toward + 2])
        alive, beta = alive & survives, beta * inverse
        hit = hit._replace(face=jnp.where(alive, hit.face, -1))
    if rest.sky is not None:
        gained = gained + where(alive & (hit.face < 0), beta * sky_radiance(world.values.sky, wi), black(rest))
    if rest.lights and not (strategy.lights == "nee" and kinds.specular is None):
        share = paths.emission_met(world.shares, strategy, onward, hit, drawn.pdf, surface, kinds.specular)
        gained = gained + beta * (one_of(world.values.emission, hit.face) * share)
    return Walk(onward, hit, point, wi, beta), gained


def _light(world, strategy, vertex, u, first, anywhere):
    """Return what a sample of the lights brings."""
    rest, surface = world.rest, vertex.surface
    which = u[first + strategy.coordinates(rest).index("which light")] if len(rest.lights) > 1 else None
    light, _, face = sample_light(
        rest, strategy, surface.point, surface.normal, surface.face, u[first], u[first + 1], which
    )
    there = light.inverse_pdf > 0.0
    row, distance, own = world.values.faces.at(face), jnp.where(there, light.distance, 1.0), face == surface.face
    moved = flow(row, vertex.moving.point, light.wi, distance, own)
    value, pdf, cosine = evaluate(world, strategy, vertex, moved.wi)
    matters = there & (cosine > 0.0) & (surface.face >= 0)
    toward = ray(surface.point, light.wi)
    seen = unoccluded(rest, toward, light.distance, surface.face, face, anywhere)
    weight = value * (moved.ratio * (light.inverse_pdf * (1.0 / jnp.pi)))
    if strategy.lights == "mis":
        weight = weight * power_heuristic(light.inverse_pdf, pdf)
    brought = vertex.beta * one_of(world.values.emission, face) * weight
    return where(matters & seen, brought, black(rest))


def _moved(world, strategy, vertex, drawn, hit):
    """Return how the point that a direction has met, the direction and its weight move."""
    row, distance = _met(world, hit)
    free, own = hit.face < 0, hit.face == vertex.surface.face
    pinned = flow(row, vertex.moving.point, drawn.wi, distance, own)
    wi = where(free, drawn.wi, pinned.wi)
    value, _, cosine = evaluate(world, strategy, vertex, wi)
    # What is not used must not turn derivatives to NaN.
    change = jax.tree.map(lambda v: ratio(jnp.where(cosine > 0.0, v, 1.0)), value)
    change = change * jnp.where(free, 1.0, pinned.ratio)
    point = pinned.point
    if vertex.kinds.specular is not None:
        led, factor = _led(world, vertex, drawn)
        wi, change = where(vertex.kinds.specular, led, wi), where(vertex.kinds.specular, factor, change)
        point = where(vertex.kinds.specular, carried(row, vertex.moving.point, led, distance), point)
    return point, wi, change * drawn.weight


def _led(world, vertex, drawn):
    """Return where a mirror or glass leads a ray, and by how much its share changes."""
    arriving, normal = vertex.arriving, vertex.moving.normal
    reflected, factor = reflect(arriving, normal), jnp.ones(())
    if not world.rest.dielectrics:
        return attach(drawn.wi, reflected), factor
    ior = world.moving.ior.at(vertex.surface.face)
    ior = jnp.where(vertex.kinds.dielectric, ior, 1.5)
    eta = jnp.where(vertex.surface.behind, 1.0 / ior, ior)
    share = fresnel_dielectric(jnp.clip(-dot(arriving, normal), 0.0, 1.0), eta)
    is_reflected = (dot(drawn.wi, vertex.surface.normal) > 0.0) | ~vertex.kinds.dielectric
    passing = ratio(1.0 - share) * ratio(1.0 / (eta * eta))
    factor = jnp.where(vertex.kinds.dielectric, jnp.where(is_reflected, ratio(share), passing), 1.0)
    return attach(drawn.wi, where(is_reflected, reflected, refract(arriving, normal, eta))), factor


def follow(world: World, strategy, u, first, walk: Walk, bounces):
    """Return the radiance that a path collects in ``bounces`` scattering events from what it has met."""
    stride = len(strategy.coordinates(world.rest))
    if bounces == 0:
        return black(world.rest)

    def event(state, k):
        walk, radiance = state
        walk, gained = scatter(world, strategy, u, first + stride * k, walk, k)
        return (walk, radiance + gained), None

    state = jax.tree.map(as_state, (walk, black(world.rest)))
    if bounces == 1:
        return event(state, 0)[0][1]
    # Of long paths keep what each event began with, and do it again on the way back.
    again = jax.checkpoint(event) if bounces > KEPT else event
    return lax.scan(again, state, jnp.arange(bounces))[0][1]


def as_state(x):
    return jnp.asarray(x, float if jnp.result_type(x).kind == "f" else None)
