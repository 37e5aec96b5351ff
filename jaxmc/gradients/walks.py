"""Paths through a scene in motion: found at rest, then evaluated again with what moves.

Every decision is taken at rest. Then a path moves: directions that were drawn keep what they have met in place, by its
flow; directions that a camera, a mirror or glass gives, and where they lead, follow from what is before them, and so do
drawn ones where sampling is attached.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..transport import paths
from ..transport.bsdfs import evaluate_bsdf, kinds_of, power_heuristic, reflect, sample_bsdf
from ..transport.fresnel import fresnel_dielectric, refract
from ..transport.hits import Hit, closest_hit, surface_at, unoccluded
from ..transport.lights import black, emission_toward, has_flat_lights, sample_light
from ..transport.rays import Ray, ray
from ..transport.sky import sky_radiance
from ..transport.strategy import POLAR
from ..transport.vec import Vec3, dot, where
from .flows import Flowed, attach, carried, distance_to, flow, ratio, still, sweeps, turning_at
from .mirrors import Shown, flow_through, look_through
from .vertices import Vertex, evaluate, sample_in_motion, share_of_emission
from .world import Row, World

KEPT = 8  # events of which reverse mode keeps everything


class Walk(NamedTuple):
    """A path on its way: its last ray and what that has met, at rest; and in motion the point there, how the unit
    normal turns, the reflectance, the direction in which it arrives, and throughput.
    """

    ray: Ray
    hit: Hit
    point: Vec3
    turning: Vec3
    reflectance: Any
    arriving: Vec3
    beta: Any


def start(world: World, wo: Ray, wi: Vec3, origin: Vec3) -> tuple[Walk, Any]:
    """Return a path after its first ray, and the radiance that it meets there.

    The ray ``wo`` is at rest; ``origin`` and ``wi`` are the same in motion.
    """
    rest = world.rest
    hit = closest_hit(rest, wo)
    one = jnp.ones(()) if rest.channels == 1 else Vec3(*[jnp.ones(())] * 3)
    row, distance = world.rows.at(hit.face), distance_to(hit)
    walk = _met(Walk(wo, hit, None, None, None, wi, one), row, carried(row.face, origin, wi, distance))
    met = black(rest)
    if rest.lights:
        met = world.emission.at(hit.face) * emission_toward(world.shares, wo, hit)
    if rest.sky is not None:
        met = met + where(hit.face < 0, sky_radiance(world.values.sky, wi), black(rest))
    return walk, met


def _met(walk: Walk, row: Row, point: Vec3) -> Walk:
    turning = turning_at(row.face, point, walk.ray.direction)
    return walk._replace(point=point, turning=turning, reflectance=row.reflectance)


def vertex_of(world: World, walk: Walk) -> Vertex:
    """Return the surface that a path has met."""
    return _vertex(world, surface_at(world.rest, walk.ray, walk.hit), walk)


def _vertex(world, surface, walk):
    moving = surface._replace(point=attach(surface.point, walk.point), normal=attach(surface.normal, walk.turning))
    return Vertex(
        surface, kinds_of(world.rest, surface), moving, kinds_of(world.moving, surface), walk.ray.direction,
        attach(walk.ray.direction, walk.arriving), walk.beta * attach(surface.reflectance, walk.reflectance),
    )  # fmt: skip


class Found(NamedTuple):
    """What an event has found with the scene at rest: the sample of a light and what it is worth, the direction drawn,
    what that is worth and where it leads, and the share of the emission there that counts; what plane mirrors show, or
    where sampling is attached the coordinates of the direction.
    """

    light: Vec3
    distance: Any
    face: Any
    brings: Any
    wi: Vec3
    weight: Any
    hit: Hit
    share: Any
    shown: tuple[Shown, ...]
    coordinates: Any


def scatter(world: World, strategy, u, first, walk: Walk, event) -> tuple[Walk, Any]:
    """Scatter a path at what it has met: return it after that, and the radiance that this brought."""
    rest, event = _each_time((world.rest, event))
    surface = still(surface_at(rest, walk.ray, walk.hit))
    beta = walk.beta * surface.reflectance
    found = _find(world._replace(rest=rest), strategy, u, first, surface, walk.ray.direction, beta, event)

    def move(tables, walk, found):
        (rows, lights, emission), _ = _each_time((tables, event))
        here = world._replace(rows=rows, lights=lights, emission=emission)
        return _move(here, strategy, _vertex(here, surface, walk), found)

    if sweeps.get():
        # Keep what was found, and do again on the way back what follows from it.
        move = jax.checkpoint(move, prevent_cse=False)
    return move((world.rows, world.lights, world.emission), walk, found)


def _each_time(tree):
    """Return a tree, in a sweep back such that nothing that follows from it is done before the loop it is in: that
    would be memory to read; nor together with what is stored.
    """
    return lax.optimization_barrier(tree) if sweeps.get() else tree


def scatter_at(world: World, strategy, u, first, vertex: Vertex, event, anywhere=False) -> tuple[Walk, Any]:
    """Scatter a path at a vertex, which may lie ``anywhere`` and not on a face."""
    found = _find(world, strategy, u, first, vertex.surface, vertex.came, vertex.beta, event, anywhere)
    return _move(world, strategy, vertex, found)


def _find(world, strategy, u, first, surface, came, beta, event, anywhere=False) -> Found:
    """Return what an event finds with the scene at rest."""
    rest, kinds, alive = world.rest, kinds_of(world.rest, surface), surface.face >= 0
    light, distance, face, brings = surface.normal, 1.0, -1, 0.0
    if strategy.lights != "none" and rest.lights:
        light, distance, face, brings = _light(rest, strategy, u, first, surface, kinds, came, anywhere)
    toward = first + strategy.coordinates(rest).index(POLAR)
    coordinates = u[toward], u[toward + 1]
    sample = sample_bsdf(rest, strategy.directions, surface, kinds, came, *coordinates)
    onward = ray(surface.point, sample.wi)
    meet = partial(closest_hit, rest)
    hit = meet(onward, surface.face) if rest.size <= paths.FEW else paths.apart(rest, meet, onward, surface.face)
    weight = sample.weight
    if strategy.roulette:
        after = still(beta) * weight
        survives, inverse = paths.play_roulette(strategy.roulette, after, kinds, event, u[toward + 2])
        weight = where(survives, weight * inverse, jax.tree.map(jnp.zeros_like, weight))
        alive = alive & survives
    # A path that has ended meets nothing, or what it meets by chance turns derivatives to NaN.
    hit = hit._replace(face=jnp.where(alive, hit.face, -1))
    share = 0.0
    if rest.lights and not (strategy.lights == "nee" and kinds.specular is None):
        share = paths.emission_met(world.shares, strategy, onward, hit, sample.pdf, surface, kinds.specular)
    shown = () if strategy.is_attached else look_through(rest, world.mirrors, onward, hit)
    kept = coordinates if strategy.is_attached else None
    return _each_time(still(Found(light, distance, face, brings, sample.wi, weight, hit, share, shown, kept)))


def _light(rest, strategy, u, first, surface, kinds, came, anywhere):
    """Return the direction, the distance and the face of a sample of the lights, and what multiplies its radiance."""
    which = u[first + strategy.coordinates(rest).index("which light")] if len(rest.lights) > 1 else None
    light, _, face = sample_light(
        rest, strategy, surface.point, surface.normal, surface.face, u[first], u[first + 1], which
    )
    there, cosine = light.inverse_pdf > 0.0, dot(surface.normal, light.wi)
    matters = there & (cosine > 0.0) & (surface.face >= 0)
    if kinds.specular is not None:
        matters = matters & ~kinds.specular
    seen = unoccluded(rest, ray(surface.point, light.wi), light.distance, surface.face, face, anywhere)
    weight = light.inverse_pdf * (1.0 / jnp.pi)
    if strategy.lights == "mis":
        _, pdf = evaluate_bsdf(rest, strategy.directions, surface, kinds, came, light.wi, cosine)
        weight = weight * power_heuristic(light.inverse_pdf, pdf)
    used = matters & seen
    return light.wi, jnp.where(there, light.distance, 1.0), jnp.where(used, face, -1), jnp.where(used, weight, 0.0)


def _move(world, strategy, vertex: Vertex, found: Found) -> tuple[Walk, Any]:
    """Return a path after an event in motion, and the radiance that this brought."""
    rest, gained = world.rest, black(world.rest)
    if strategy.lights != "none" and rest.lights:
        row, own = world.lights.at(found.face), found.face == vertex.surface.face
        moved = flow(row.face, vertex.moving.point, found.light, found.distance, own, has_flat_lights(rest))
        value, brings = evaluate(world, strategy, vertex, moved.wi), found.brings
        if strategy.is_attached:
            # The two ways to find a light move on their own, and their shares with them.
            share = share_of_emission(world, strategy, vertex, moved.wi, Hit(found.distance, found.face))
            brings = brings * ratio(1.0 - share)
        brought = vertex.beta * row.emission * (value * (moved.ratio * brings))
        gained = where(found.face >= 0, brought, gained)
    row, hit = world.rows.at(found.hit.face), found.hit
    point, wi, weight = _moved(world, strategy, vertex, found, row.face)
    beta = vertex.beta * weight
    if rest.sky is not None:
        met = (vertex.surface.face >= 0) & (hit.face < 0)
        gained = gained + where(met, beta * sky_radiance(world.values.sky, wi), black(rest))
    if rest.lights and not (strategy.lights == "nee" and vertex.kinds.specular is None):
        direct, share = beta, found.share
        if strategy.is_attached:
            share = attach(share, share_of_emission(world, strategy, vertex, wi, hit))
        elif set(world.mirrors.faces) & set(rest.lights):
            # What a mirror itself emits stays at its own points, as where lights are sampled.
            direct = vertex.beta * _moved(world, strategy, vertex, found._replace(shown=()), row.face)[2]
        gained = gained + direct * (world.emission.at(hit.face) * share)
    walk = Walk(ray(vertex.surface.point, found.wi), hit, None, None, None, wi, beta)
    return _met(walk, row, point), gained


def _moved(world, strategy, vertex, found, face):
    """Return how the point that a direction has met, the direction and its weight move."""
    if strategy.is_attached:
        sample = sample_in_motion(world, strategy, vertex, found.coordinates)
        wi, change = attach(found.wi, sample.wi), jax.tree.map(ratio, sample.weight)
        return carried(face, vertex.moving.point, wi, distance_to(found.hit)), wi, change * found.weight
    free, own = found.hit.face < 0, found.hit.face == vertex.surface.face
    distance, flat = distance_to(found.hit), world.rest.inverse_radius is None
    sample = flow(face, vertex.moving.point, found.wi, distance, own, flat)
    if found.shown:
        seen = flow_through(partial(_face_at, world), found.hit, vertex.moving.point, found.wi, found.shown, flat)
        sample = Flowed(*(where(found.shown[0].there, a, b) for a, b in zip(seen, sample)))
    wi = where(free, found.wi, sample.wi)
    value, above = evaluate(world, strategy, vertex, wi), dot(vertex.surface.normal, found.wi) > 0.0
    # What is not used must not turn derivatives to NaN.
    change = jax.tree.map(lambda v: ratio(jnp.where(above, v, 1.0)), value)
    change = change * jnp.where(free, 1.0, sample.ratio)
    point = sample.point
    if vertex.kinds.specular is not None:
        led, factor = _led(world, vertex, found)
        wi, change = where(vertex.kinds.specular, led, wi), where(vertex.kinds.specular, factor, change)
        point = where(vertex.kinds.specular, carried(face, vertex.moving.point, led, distance), point)
    return point, wi, change * found.weight


def _face_at(world, face):
    return world.rows.at(face).face


def _led(world, vertex, found):
    """Return where a mirror or glass leads a ray, and by how much its share changes."""
    arriving, normal = vertex.arriving, vertex.moving.normal
    reflected, factor = reflect(arriving, normal), jnp.ones(())
    if not world.rest.dielectrics:
        return attach(found.wi, reflected), factor
    ior = world.moving.ior.at(vertex.surface.face)
    ior = jnp.where(vertex.kinds.dielectric, ior, 1.5)
    eta = jnp.where(vertex.surface.behind, 1.0 / ior, ior)
    share = fresnel_dielectric(jnp.clip(-dot(arriving, normal), 0.0, 1.0), eta)
    is_reflected = (dot(found.wi, vertex.surface.normal) > 0.0) | ~vertex.kinds.dielectric
    passing = ratio(1.0 - share) * ratio(1.0 / (eta * eta))
    factor = jnp.where(vertex.kinds.dielectric, jnp.where(is_reflected, ratio(share), passing), 1.0)
    return attach(found.wi, where(is_reflected, reflected, refract(arriving, normal, eta))), factor


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
