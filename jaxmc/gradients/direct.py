"""Direct light at a point, as it moves with the scene: interior and boundary."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..integration.integrand import Integrand
from ..transport import geometry
from ..transport.hits import closest_hit, face_at, unoccluded
from ..transport.lights import black, sample_light
from ..transport.primitives import as_color, as_unit, as_vec3
from ..transport.rays import ray
from ..transport.scene import Scene
from ..transport.sky import sky_radiance
from ..transport.strategy import Strategy
from ..transport.vec import Vec3, cross, dot, frame, larger, normalize, where
from ..transport.warps import sample_cosine_hemisphere
from .derivative import WithBoundary
from .flows import Faces, flow, one_of, stacked, still, table_of_faces
from .shadows import ShadowEdges, lamps_of
from .silhouettes import silhouettes


def direct_irradiance(scene: Scene, point, normal, *, pick="uniform", light_points="automatic") -> WithBoundary:
    """Return the irradiance from lights and sky at a point, with all that its derivative needs.

    The value is that of ``mc.irradiance(..., bounces=0)``. Its derivative in ``mc.grad_integrate`` holds with respect
    to whatever the scene, ``point`` and ``normal`` are made of: radiances, places, sizes, orientations of lights and
    of blockers. The interior keeps every sample at its place on the light; the boundary has the silhouettes of
    spheres, quads, triangles, disks and boxes before lights and sky, each once, so moving shadows are complete.

    What is not covered is said in ``flags``: primitives that pass through each other, edges that overlap in part.
    Primitives that share an edge count as one surface, and must move together.

    Args:
        scene: what shines and what stands in the way; materials do not matter.
        point: three numbers.
        normal: of the receiver, any length.
        pick, light_points: as in ``PathOptions``.

    Raises:
        ValueError: a scene that shines nowhere or is none, or an option out of range.
    """
    place = _local(scene, "point", point), as_unit("normal", normal)
    return _direct(scene, AT_POINT, place, (), Strategy(0, "cosine", "nee", pick, light_points))


def mean_direct_irradiance(scene: Scene, corner, edge_u, edge_v, *, pick="uniform", light_points="automatic"):
    """Return the mean of ``direct_irradiance`` over a parallelogram that receives light on the side of
    cross(edge_u, edge_v), as a ``WithBoundary``.

    The receiver may lie on a face of the scene. Where it does, or where it moves, all that holds as there; its own
    outline is no edge, since the mean is over all of it. Two more coordinates say where on it.
    """
    place = _local(scene, "corner", corner), as_vec3("edge_u", edge_u), as_vec3("edge_v", edge_v)
    words = ("receiver: first", "receiver: second")
    return _direct(scene, OVER_FACE, place, words, Strategy(0, "cosine", "nee", pick, light_points))


def _local(scene, name, point):
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, made by mc.Scene([...]), got {scene!r}")
    return scene.local(as_vec3(name, point))


def _direct(scene, receiver, place, words, strategy):
    primitives, _ = scene.as_given()
    if not scene.lights and scene.sky is None:
        raise ValueError("direct light needs a light or a sky: give a primitive an emission above 0")
    outlines = geometry.build(primitives).outlines
    faces = table_of_faces(outlines)
    emission = stacked([_color(scene, primitives[i].emission) for i in scene.owner])
    edge = (*words, "edge")
    words += ("light: first", "light: second") if scene.lights else ()
    words += ("light: which",) if len(scene.lights) > 1 else ()
    words += ("sky: first", "sky: second") if scene.sky is not None else ()
    interior = Integrand(_Direct(strategy, receiver), len(words), (scene, faces, emission, *place), True, words)
    found, flags = silhouettes(outlines, scene.owner)
    if found.known and not (found.edges or found.spheres or found.disks):
        return WithBoundary(interior, None, flags)
    around = _AtReceiver(ShadowEdges(found, lamps_of(scene, primitives)), receiver)
    boundary = Integrand(around, len(edge), (scene, faces, emission, scene.sky, *place), True, edge)
    return WithBoundary(interior, boundary, flags)


def _color(scene, emission):
    rgb = as_color("emission", 0.0 if emission is None else emission)
    return rgb[0] if scene.channels == 1 else Vec3(*rgb)


class Receiver(NamedTuple):
    """How many coordinates a place on the receiver takes, and a function (u, *place) that returns point and normal."""

    coordinates: int
    at: Callable


def _on_face(u, corner, edge_u, edge_v):
    return corner + edge_u * u[0] + edge_v * u[1], normalize(cross(edge_u, edge_v))


AT_POINT = Receiver(0, lambda u, point, normal: (point, normal))
OVER_FACE = Receiver(2, _on_face)


@dataclasses.dataclass(frozen=True)
class _Direct:
    """Light sampled with the scene at rest, and evaluated again with the scene in motion."""

    strategy: Strategy
    receiver: Receiver

    def __call__(self, u, scene, faces: Faces, emission, *place):
        point, normal = self.receiver.at(u, *place)
        rest, x, n = still(scene), still(point), still(normal)
        own = face_at(rest, x)
        total, k = black(scene), self.receiver.coordinates
        if scene.lights:
            which = u[k + 2] if len(scene.lights) > 1 else 0.0
            light, _, face = sample_light(rest, self.strategy, x, n, own, u[k], u[k + 1], which)
            k += 2 if len(scene.lights) == 1 else 3
            toward = ray(x, light.wi)
            seen = unoccluded(rest, toward, light.distance, own, face, anywhere=True)
            wi, ratio = flow(faces.at(face), point, light.wi, light.distance)
            cosine = dot(normal, wi)
            matters = seen & (light.inverse_pdf > 0.0) & (still(cosine) > 0.0)
            weight = jnp.where(matters, still(light.inverse_pdf), 0.0) * larger(cosine, 0.0) * ratio
            total = one_of(emission, face) * weight
        if scene.sky is not None:
            local = sample_cosine_hemisphere(u[k], u[k + 1])
            tangent, bitangent = frame(n)
            wi = tangent * local.x + bitangent * local.y + n * local.z
            free = closest_hit(rest, ray(x, wi), own).face < 0
            weight = jnp.where(free, dot(normal, wi) * (np.pi / local.z), 0.0)
            total = total + where(free, sky_radiance(scene.sky, wi) * weight, black(scene))
        return jnp.stack(total) if isinstance(total, Vec3) else total


@dataclasses.dataclass(frozen=True)
class _AtReceiver:
    """The boundary of a receiver, which may lie on a face."""

    edges: ShadowEdges
    receiver: Receiver

    def __call__(self, u, scene, faces, emission, sky, *place):
        point, normal = self.receiver.at(u, *place)
        own = face_at(still(scene), still(point))
        return self.edges(u[self.receiver.coordinates], faces, emission, sky, point, normal, own)
