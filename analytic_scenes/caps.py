"""Irradiance from the directions that several circles enclose together: lights, what hides them, mirrors and horizon.

Seen from a point, a sphere fills a cap of the sphere of directions, and each edge of a parallelogram lies on a great
circle, the border of a hemisphere. So a light is an intersection of caps, and so is the part of it that a blocker
hides, or that a mirror of finite size shows. Every cap is a row (axis x, y, z, cosine of its angular radius).

All functions are written with ``jax.numpy``; ``jax.grad`` gives true derivatives, moving edges included.
"""

import jax
import jax.numpy as jnp

SAME = 1e-12  # circles that differ by less are taken for one


def sphere_caps(center, radius) -> jax.Array:
    """Return the cap that a sphere fills, seen from the origin: shape (1, 4). The origin is outside the sphere."""
    center = jnp.asarray(center, float)
    distance = jnp.sqrt(center @ center)
    return jnp.append(center / distance, jnp.sqrt(1.0 - (radius / distance) ** 2))[None]


def parallelogram_caps(corner, edge_u, edge_v) -> jax.Array:
    """Return the hemispheres that enclose a parallelogram, seen from the origin on either side of it: shape (4, 4)."""
    corner, u, v = (jnp.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    outline = jnp.stack([corner, corner + u, corner + u + v, corner + v])
    axes = jnp.cross(outline, jnp.roll(outline, -1, axis=0)) * jnp.sign(corner @ jnp.cross(u, v))
    axes = axes / jnp.linalg.norm(axes, axis=1, keepdims=True)
    return jnp.concatenate([axes, jnp.zeros((4, 1))], axis=1)


def caps_irradiance(caps, normal) -> jax.Array:
    """Return irradiance over radiance from the directions in all ``caps``, shape (k, 4), above the horizon.

    The horizon of the receiver is one more cap, about the unit vector ``normal``. Along the border of all they share,
    E = normal . (1/2) oint r x dr. On the circle about axis a with angular radius s, and tangents t, b,

        (1/2) int r x dr = (1/2) [sin(s)^2 a phi - sin(s) cos(s) (t sin(phi) - b cos(phi))].

    Each circle is cut where it crosses the others. An arc counts where its middle lies in every other cap. Circles that
    coincide count once.

    Source: Arvo, Applications of irradiance tensors to the simulation of non-Lambertian phenomena (1995); for two cones
    Mazonka, Solid angle of conical surfaces, polyhedral cones, and intersecting spherical caps (2012).
    """
    normal = jnp.asarray(normal, float)
    caps = jnp.concatenate([caps, jnp.append(normal, 0.0)[None]])
    axis, cosine = caps[:, :3], caps[:, 3]
    sine = jnp.sqrt(1.0 - cosine**2)
    tangent, bitangent = _frames(axis)

    # Point phi of circle i lies in cap j where level[i, j] + along[i, j] cos(phi) + across[i, j] sin(phi) > 0.
    level = cosine[:, None] * (axis @ axis.T) - cosine[None, :]
    along, across = sine[:, None] * (tangent @ axis.T), sine[:, None] * (bitangent @ axis.T)
    swing2 = along**2 + across**2
    crosses = level**2 < swing2
    swing = jnp.sqrt(jnp.where(crosses, swing2, 1.0))
    half = jnp.arccos(jnp.where(crosses, -level / swing, 0.0))
    toward = jnp.arctan2(jnp.where(crosses, across, 0.0), jnp.where(crosses, along, 1.0))
    cuts = jnp.concatenate([toward - half, toward + half], axis=1) % (2 * jnp.pi)
    start = jnp.sort(jnp.where(jnp.concatenate([crosses, crosses], axis=1), cuts, 0.0), axis=1)
    stop = jnp.concatenate([start[:, 1:], start[:, :1] + 2 * jnp.pi], axis=1)

    middle = ((start + stop) / 2)[:, :, None]
    margin = level[:, None] + along[:, None] * jnp.cos(middle) + across[:, None] * jnp.sin(middle)
    counts = jnp.all(jnp.where(_is_same(level, swing2)[:, None], _goes_first(axis)[:, None], margin > 0), axis=2)

    def along_normal(vectors):
        return (vectors @ normal)[:, None]

    turn = along_normal(tangent) * (jnp.sin(stop) - jnp.sin(start))
    turn = turn - along_normal(bitangent) * (jnp.cos(stop) - jnp.cos(start))
    arcs = (sine**2)[:, None] * along_normal(axis) * (stop - start) - (sine * cosine)[:, None] * turn
    return jnp.sum(jnp.where(counts, arcs, 0.0)) / 2


def caps_overlap(first, second) -> jax.Array:
    """Return the solid angle [sr] that two caps share, whether they are apart, cross or lie one in the other.

    Source: Mazonka (2012); the theorem of Gauss and Bonnet.
    """
    (axis_1, cos_1), (axis_2, cos_2) = (first[:3], first[3]), (second[:3], second[3])
    sin_1, sin_2 = jnp.sqrt(1.0 - cos_1**2), jnp.sqrt(1.0 - cos_2**2)
    cos_apart = jnp.clip(axis_1 @ axis_2, -1.0, 1.0)
    # About one axis circles never cross, though by rounding they may seem to where they are one.
    crosses = (jnp.abs(cos_apart - cos_1 * cos_2) < sin_1 * sin_2) & (jnp.abs(cos_apart) < 1.0)
    safe = jnp.where(crosses, cos_apart, cos_1 * cos_2)
    sin_apart = jnp.sqrt(1.0 - safe**2)
    # Half the azimuth of either arc about its own axis, and the angle between the circles.
    half_1 = _angle((cos_2 - safe * cos_1) / (sin_apart * sin_1))
    half_2 = _angle((cos_1 - safe * cos_2) / (sin_apart * sin_2))
    corner = _angle((safe - cos_1 * cos_2) / (sin_1 * sin_2))
    lens = 2 * (jnp.pi - corner - half_1 * cos_1 - half_2 * cos_2)
    is_inside = cos_apart > cos_1 * cos_2
    smaller = 2 * jnp.pi * (1.0 - jnp.maximum(cos_1, cos_2))
    return jnp.where(crosses, lens, jnp.where(is_inside, smaller, 0.0))


def _angle(cosine):
    """Return arccos(cosine), with the derivative 0 where rounding has taken the cosine out of (-1, 1)."""
    inside = jnp.abs(cosine) < 1.0
    return jnp.where(inside, jnp.arccos(jnp.where(inside, cosine, 0.0)), jnp.where(cosine > 0.0, 0.0, jnp.pi))


def _frames(axis):
    """Return two tangents for each unit vector: rows of shape (k, 3) that make a right-handed frame with it."""
    other = jnp.where(jnp.abs(axis[:, 2:]) < 0.7, jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0]))
    tangent = jnp.cross(other, axis)
    tangent = tangent / jnp.linalg.norm(tangent, axis=1, keepdims=True)
    return tangent, jnp.cross(axis, tangent)


def _is_same(level, swing2):
    """Return whether circle j is circle i, itself too: then no point of one is on a side of the other."""
    return (jnp.abs(level) < SAME) & (swing2 < SAME**2)


def _goes_first(axis):
    """Return whether circle i counts where circle j is the same: once if their caps are too, else never."""
    index = jnp.arange(len(axis))
    return (index[:, None] == index) | ((index[:, None] < index) & (axis @ axis.T > 0))
