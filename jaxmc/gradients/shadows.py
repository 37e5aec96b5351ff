"""What the edges of shadows add to the derivative of direct light: an integral along silhouettes."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..transport.primitives import Sphere
from ..transport.sky import sky_radiance
from ..transport.vec import Vec3, cross, dot, larger, where
from .arcs import edge_arcs, ends_of, rim_arcs, view_edges, view_rims
from .disks import ball_around, on_rim, rim_point, view_disks
from .flows import Faces, flow, motion, one_of, still
from .silhouettes import Silhouettes

SKY = -1


class Lamp(NamedTuple):
    """A face that shines, ``SKY`` for the sky, to the side of its normal, to the other, or to both."""

    face: int
    front: bool
    back: bool


class Place(NamedTuple):
    """A point on a silhouette: direction and distance from where it is seen, unit normal of the curve from what is in
    front to what lies behind, the point itself, which moves, and the length of the curve to what it was drawn by."""

    wi: Vec3
    distance: Any
    away: Vec3
    point: Vec3
    stretch: Any


@dataclasses.dataclass(frozen=True)
class ShadowEdges:
    """The boundary part of direct light at a point: value 0, and its derivative has what moving silhouettes add as its
    mean.

    One coordinate ``u`` chooses a light, a silhouette that is seen before it and a place on that, uniformly by angle.
    With h the distance by which the silhouette moves over what lies behind, on the sphere of directions and along its
    normal, the integrand is -L cos(theta) h: what is in front moves along with the silhouette and adds nothing. A place
    counts only where the ray past it meets the light in question, so every light is counted once.

    Source: Reynolds' transport theorem; Li et al. 2018; Zhang et al. 2020.
    """

    found: Silhouettes
    lamps: tuple[Lamp, ...]

    def __call__(self, u, faces: Faces, emission, sky, point, normal, own):
        if not self.found.known:
            raise ValueError(
                "which edges of a scene coincide is not known while JAX traces it: pass the function that makes the "
                "scene to mc.grad_integrate instead of differentiating this integrand"
            )
        fixed, x, n = still(faces), still(point), still(normal)
        choice, density = self._choose(u, fixed, x, n)
        place, skip, lamp = self._place(choice, fixed, faces, x)
        target = jnp.asarray([max(k.face, 0) for k in self.lamps])[lamp]
        is_sky = jnp.asarray([k.face == SKY for k in self.lamps])[lamp]
        distances = _distances(fixed, self.found, x, place.wi)
        reached, distance = self._reaches(distances, fixed, x, place, skip, lamp, target, is_sky, own)
        reached = reached & (density > 0.0)
        # Keep what is not used finite, or the chain rule makes it NaN.
        distance = jnp.where(reached & ~is_sky, distance, 1.0)
        behind, _ = flow(jax.tree.map(partial(_or_nearby, reached & ~is_sky), faces.at(target), fixed.at(target)),
                         point, place.wi, distance)  # fmt: skip
        behind = where(is_sky, place.wi, behind)
        away = (place.point - point) * jnp.where(reached, 1.0 / jnp.where(reached, place.distance, 1.0), 0.0)
        h = jnp.where(reached, dot(place.away, away) - dot(place.away, behind), 0.0)
        length = place.stretch / jnp.where(density > 0.0, density, 1.0)
        weight = jnp.where(reached, -larger(dot(n, place.wi), 0.0) * length, 0.0)
        light = still(_radiance(emission, sky, target, is_sky, place.wi))
        value = light * (still(weight) * motion(h))
        return jnp.stack(value) if isinstance(value, Vec3) else value

    def _choose(self, u, fixed, x, n):
        """Return the number of a silhouette and light, where on it, and the density by angle."""
        starts, lengths, rates = [], [], []
        edges, rims, disks = self._views(fixed, x)
        for lamp in self.lamps:
            target = None if lamp.face == SKY else fixed.at(lamp.face)
            target = ball_around(target) if lamp.face in self.found.disks else target
            is_round = lamp.face in (*self.found.spheres, *self.found.disks)
            shape = None if target is None or is_round else self.found.triangles[lamp.face]
            if edges is not None:
                arcs = edge_arcs(edges, n, target, x, shape)
                mine = np.array([self._is_own(lamp, e.faces) for e in self.found.edges])
                starts.append(arcs.start)
                lengths.append(jnp.where(mine, 0.0, arcs.length))
                rates.append(jnp.ones_like(arcs.start))
            if rims is not None:
                arcs = rim_arcs(rims, target, x, shape)
                mine = np.array([self._is_own(lamp, (f,)) for f in self.found.spheres])
                starts.append(arcs.start)
                lengths.append(jnp.where(mine, 0.0, arcs.length))
                rates.append(rims.sine)
            if disks is not None:
                mine = np.array([self._is_own(lamp, (f,)) for f in self.found.disks])
                starts.append(jnp.zeros_like(disks.size))
                lengths.append(jnp.where(mine, 0.0, 2.0 * np.pi * disks.size))
                rates.append(disks.size)
        start, length, rate = map(jnp.concatenate, (starts, lengths, rates))
        upto = jnp.cumsum(length)
        total, aim = upto[-1], u * upto[-1]
        which = jnp.minimum(jnp.sum(upto <= aim), len(length) - 1)
        angle = start[which] + (aim - (upto - length)[which]) / rate[which]
        there = total > 0.0
        return (which, angle), jnp.where(there & (length[which] > 0.0), 1.0 / jnp.where(there, total, 1.0), 0.0)

    def _views(self, fixed, x):
        edges = view_edges(self.found, fixed, x) if self.found.edges else None
        rims = view_rims(self.found, fixed, x) if self.found.spheres else None
        return edges, rims, view_disks(self.found, fixed, x) if self.found.disks else None

    def _is_own(self, lamp, faces):
        owner = self.found.owner
        return lamp.face != SKY and owner[lamp.face] in {owner[f] for f in faces}

    def _place(self, choice, fixed, faces, x):
        """Return the chosen point, the faces that its primitives have, and the light."""
        which, angle = choice
        count, balls, rounds = (len(curves) for curves in (self.found.edges, self.found.spheres, self.found.disks))
        lamp, k = which // (count + balls + rounds), which % (count + balls + rounds)
        edges, rims, disks = self._views(fixed, x)
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        places = []
        if edges is not None:
            i = jnp.minimum(k, count - 1)
            e = jax.tree.map(lambda a: a[i], edges)
            wi = e.first * cosine + e.second * sine
            # Where on the edge that direction points: both are perpendicular to wi x normal.
            side, along = cross(e.normal, wi), e.to_stop - e.to_start
            slope = dot(along, side)
            t = -dot(e.to_start, side) / jnp.where(slope != 0.0, slope, 1.0)
            start, stop = (one_of(end, i) for end in ends_of(self.found, faces))
            distance = dot(e.to_start + along * t, wi)
            places.append((k < count, Place(wi, distance, e.normal, start + (stop - start) * still(t), 1.0)))
        if rims is not None:
            i = jnp.clip(k - count, 0, balls - 1)
            r = jax.tree.map(lambda a: a[i], rims)
            around = r.tangent * cosine + r.bitangent * sine
            wi, away = r.axis * r.cosine + around * r.sine, around * r.cosine - r.axis * r.sine
            ball = faces.at(jnp.asarray(self.found.spheres)[i])
            places.append((k < count + balls, Place(wi, r.distance, away, ball.center + away * ball.radius, 1.0)))
        if disks is not None:
            i = jnp.clip(k - count - balls, 0, rounds - 1)
            seen, disk = (
                rim_point(jax.tree.map(lambda a: a[i], disks), angle),
                faces.at(jnp.asarray(self.found.disks)[i]),
            )
            point = disk.center + on_rim(disk.half_u, disk.half_v, angle)
            places.append((True, Place(seen.wi, seen.distance, seen.away, point, seen.stretch)))
        _, place = places.pop()
        for is_it, other in reversed(places):
            place = jax.tree.map(lambda a, b, is_it=is_it: jnp.where(is_it, a, b), other, place)
        return place, jnp.asarray(self._primitives())[k], lamp

    def _primitives(self):
        """Return for each silhouette which faces belong to the primitives that make it."""
        owner = self.found.owner
        groups = [*(e.faces for e in self.found.edges), *((f,) for f in (*self.found.spheres, *self.found.disks))]
        return np.array([[o in {owner[f] for f in faces} for o in owner] for faces in groups])

    def _reaches(self, distances, fixed, x, place, skip, lamp, target, is_sky, own):
        """Return whether the ray past a silhouette meets the light, and where."""
        distance = distances[target]
        face = fixed.at(target)
        is_ball = face.radius > 0.0
        outward = where(is_ball, x + place.wi * distance - face.center, cross(face.half_u, face.half_v))
        facing = dot(outward, place.wi) < 0.0
        front, back = (jnp.asarray([getattr(k, name) for k in self.lamps])[lamp] for name in ("front", "back"))
        shines = jnp.where(facing, front, back) & (distance > place.distance)
        length = jnp.where(is_sky, jnp.inf, distance)
        numbers = jnp.arange(len(self.found.owner))
        # Planar faces and spheres are never in the way of rays that leave themselves outward.
        passed = skip | (numbers == own) | ((numbers == target) & ~is_sky)
        free = ~jnp.any((distances < length) & ~passed)
        return free & (is_sky | ((distance < jnp.inf) & shines)), distance


def _or_nearby(is_used, moving, fixed):
    return jnp.where(is_used, moving, fixed)


def _radiance(emission, sky, target, is_sky, wi):
    light = one_of(emission, target)
    if sky is None:
        return light
    return where(is_sky, sky_radiance(sky, wi), light)


def _distances(faces, found, x, wi):
    """Return how far every face is along a ray, infinite for a miss."""
    to = faces.center - x
    normal = cross(faces.half_u, faces.half_v)
    speed = dot(normal, wi)
    flat = dot(normal, to) / jnp.where(speed != 0.0, speed, 1.0)
    offset = wi * flat - to
    squared = dot(normal, normal)
    inverse = 1.0 / jnp.where(squared > 0.0, squared, 1.0)
    u = dot(cross(offset, faces.half_v), normal) * inverse
    v = dot(cross(faces.half_u, offset), normal) * inverse
    hit = (jnp.abs(u) <= 1.0) & (jnp.abs(v) <= 1.0) & (flat > 0.0) & (speed != 0.0)
    hit = hit & ~(np.array(found.triangles) & (u + v > 0.0))
    if found.disks:
        hit = hit & ~(np.isin(np.arange(len(found.owner)), found.disks) & (u * u + v * v > 1.0))
    nearest = dot(to, wi)
    aside = to - wi * nearest
    chord2 = faces.radius * faces.radius - dot(aside, aside)
    half = jnp.sqrt(larger(chord2, 0.0))
    ball = jnp.where(nearest - half > 0.0, nearest - half, nearest + half)
    met = (chord2 > 0.0) & (ball > 0.0)
    is_ball = faces.radius > 0.0
    return jnp.where(jnp.where(is_ball, met, hit), jnp.where(is_ball, ball, flat), jnp.inf)


def lamps_of(scene, primitives) -> tuple[Lamp, ...]:
    """Return what shines in a scene."""
    lamps = []
    for face in sorted(set(scene.lights)):
        p = primitives[scene.owner[face]]
        inward = isinstance(p, Sphere) and p.inward
        lamps.append(Lamp(face, p.two_sided or not inward, p.two_sided or inward))
    if scene.sky is not None:
        lamps.append(Lamp(SKY, True, True))
    return tuple(lamps)
