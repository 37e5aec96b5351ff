"""Rims of disks as silhouettes: circles in space, ellipses on the sphere of directions.

A rim p(phi) = center + half_u cos(phi) + half_v sin(phi) is drawn uniformly in phi. Seen along wi at distance d, its
element of length is |wi x p'(phi)| / d dphi, and its normal is along wi x p'(phi).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..transport.vec import Vec3, cross, dot
from .flows import Faces
from .silhouettes import Silhouettes


class DiskView(NamedTuple):
    """Disks seen from a point: the way to the centre, two radii at right angles, and about the angular radius."""

    to_center: Vec3
    half_u: Vec3
    half_v: Vec3
    size: Any


class RimPoint(NamedTuple):
    """A point of a rim: direction and distance, the unit normal away from the disk on the sphere of directions, and the
    length there, in radians, to ``size`` dphi.
    """

    wi: Vec3
    distance: Any
    away: Vec3
    stretch: Any


def view_disks(found: Silhouettes, faces: Faces, point: Vec3) -> DiskView:
    """Return all disks as seen from a point."""
    disk = faces.at(np.array(found.disks))
    to, squared = disk.center - point, dot(disk.half_u, disk.half_u)
    return DiskView(to, disk.half_u, disk.half_v, jnp.sqrt(squared / (dot(to, to) + squared)))


def on_rim(half_u: Vec3, half_v: Vec3, angle) -> Vec3:
    """Return the place of a point of a rim, from the centre."""
    return half_u * jnp.cos(angle) + half_v * jnp.sin(angle)


def rim_point(disk: DiskView, angle) -> RimPoint:
    """Return the point of one rim at an angle."""
    to = disk.to_center + on_rim(disk.half_u, disk.half_v, angle)
    distance = jnp.sqrt(dot(to, to))
    wi = to * (1.0 / distance)
    normal = cross(wi, on_rim(disk.half_v, -disk.half_u, angle))
    length = jnp.sqrt(dot(normal, normal))
    # The normal is perpendicular to the way to the rim point: which side of the curve the centre is on decides.
    outward = jnp.where(dot(normal, disk.to_center) > 0.0, -1.0, 1.0)
    away = normal * (outward / jnp.where(length > 0.0, length, 1.0))
    return RimPoint(wi, distance, away, length / (distance * disk.size))


def ball_around(disk: Faces) -> Faces:
    """Return the sphere of a disk's centre and radius, which holds it."""
    return disk._replace(radius=jnp.sqrt(dot(disk.half_u, disk.half_u)))
