"""What a camera sees at first sight or in a plane mirror, exactly: areas of polygons and of spheres on its film.

The mean radiance over a film is the sum of radiance times share of the film that shows it. Quads appear as polygons and
spheres, as long as they are before the camera as a whole, as ellipses; ``share`` and ``sphere_share`` are their areas
within the film, or within another polygon on it. All are formulas in ``jax.numpy`` for float64, so ``jax.grad`` gives
derivatives. Corners that coincide, edges that overlap and circles that touch are no places to differentiate at.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

FILM = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


class View(NamedTuple):
    """A pinhole camera: where it is, the axes of its film, and how far its edges reach at distance 1."""

    origin: Any
    right: Any
    down: Any
    forward: Any
    reach: Any  # in x and y

    def local(self, points):
        """Return points, shape (..., 3), along the axes."""
        to = jnp.asarray(points) - self.origin
        return jnp.stack([to @ self.right, to @ self.down, to @ self.forward], axis=-1)

    def on_film(self, points):
        """Return where points before the camera appear on the film [-1, 1]^2."""
        local = self.local(points)
        return local[..., :2] / local[..., 2:] / self.reach

    def directions(self, places):
        """Return the directions, of any length, that places on the film are seen in."""
        x, y = (places * self.reach).T
        return self.forward + x[:, None] * self.right + y[:, None] * self.down


def view(origin, target, up=(0.0, 0.0, 1.0), fov=40.0, aspect=1.0) -> View:
    """Return the camera ``mc.PinholeCamera`` of the same arguments; ``aspect`` is width by height."""
    origin, target, up = (_stacked(v) for v in (origin, target, up))
    forward = _unit(target - origin)
    right = _unit(jnp.cross(forward, up))
    tangent = jnp.tan(jnp.asarray(fov) * (math.pi / 360.0))
    return View(origin, right, jnp.cross(forward, right), forward, jnp.stack([tangent * aspect, tangent]))


def quad(corner, edge_u, edge_v):
    """Return the corners of a parallelogram, shape (4, 3), in a circle."""
    corner, edge_u, edge_v = (_stacked(v) for v in (corner, edge_u, edge_v))
    return jnp.stack([corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v])


def mirrored(points, position, normal):
    """Return the images of points in the plane through ``position``."""
    normal = _unit(_stacked(normal))
    return points - 2.0 * ((points - _stacked(position)) @ normal)[..., None] * normal


def share(polygon, *others):
    """Return the share of the film inside all of some convex polygons on it, of shape (k, 2) each."""
    polygon = within(polygon, jnp.asarray(FILM))
    for other in others:
        polygon = within(polygon, other)
    return jnp.abs(signed_area(polygon)) / 4.0


def within(polygon, window):
    """Return the part of a convex polygon inside another one, whose corners go round in either direction.

    Each edge adds a corner, and corners may coincide. Source: Sutherland and Hodgman (1974).
    """
    turn = jnp.sign(signed_area(window))
    for a, b in zip(window, jnp.roll(window, -1, axis=0)):
        polygon = above(polygon, turn * _cross(b - a, polygon - a))
    return polygon


def above(polygon, height):
    """Return the part of a convex polygon where ``height``, which is linear and given at its corners, is positive."""
    after, beyond = jnp.roll(polygon, -1, axis=0), jnp.roll(height, -1)
    crossing = (height < 0.0) != (beyond < 0.0)
    part = height / jnp.where(crossing, height - beyond, 1.0)
    both = jnp.stack([polygon + (after - polygon) * part[:, None], after], axis=1).reshape(-1, 2)
    kept = jnp.stack([crossing, beyond >= 0.0], axis=1).ravel()
    order = jnp.argsort(~kept, stable=True)[: len(polygon) + 1]
    order = jnp.where(jnp.arange(len(polygon) + 1) < kept.sum(), order, order[0])
    return both[order]


def signed_area(polygon):
    return 0.5 * jnp.sum(_cross(polygon, jnp.roll(polygon, -1, axis=0)))


def sphere_share(view, center, radius, window=FILM):
    """Return the share of the film inside both a sphere's image and a convex polygon on it.

    A linear map takes the ellipse to the unit circle and the polygon to one whose part in the circle is a sum over its
    edges, of triangles and sectors.
    """
    x, y, z = view.local(_stacked(center))
    rest = z * z - radius * radius
    # The cone of tangents (c . d)^2 = (c . c - R^2) d . d, at distance 1: an ellipse with its long axis along (x, y).
    off2 = x * x + y * y
    middle = jnp.stack([x, y]) * (z / rest)
    long, short = radius * jnp.sqrt(off2 + rest) / rest, radius / jnp.sqrt(rest)
    off = jnp.sqrt(jnp.where(off2 > 0.0, off2, 1.0))
    along = jnp.where(off2 > 0.0, jnp.stack([x, y]) / off, jnp.array([1.0, 0.0]))
    across = jnp.stack([-along[1], along[0]])
    to = jnp.asarray(window) * view.reach - middle
    scaled = jnp.stack([to @ along / long, to @ across / short], axis=-1)
    area = sum(_beside(a, b) for a, b in zip(scaled, jnp.roll(scaled, -1, axis=0)))
    return jnp.abs(area) * long * short / (4.0 * view.reach[0] * view.reach[1])


def _beside(a, b):
    """Return the signed area of the unit disk's part in the triangle of the origin and an edge."""
    along = b - a
    squared, middle = along @ along, a @ along
    squared = jnp.where(squared > 0.0, squared, 1.0)  # corners may coincide
    root = middle * middle - squared * (a @ a - 1.0)
    met = root > 0.0
    half = jnp.sqrt(jnp.where(met, root, 1.0))
    low, high = (jnp.clip((-middle + s * half) / squared, 0.0, 1.0) for s in (-1.0, 1.0))
    p, q = a + along * low, a + along * high
    chord = _sector(a, p) + 0.5 * _cross(p, q) + _sector(q, b)
    return jnp.where(met, chord, _sector(a, b))


def _sector(a, b):
    return 0.5 * jnp.arctan2(_cross(a, b), a @ b)


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _stacked(v):
    return v if hasattr(v, "shape") else jnp.stack([jnp.asarray(c, float) for c in v])


def _unit(v):
    return v / jnp.sqrt(v @ v)
