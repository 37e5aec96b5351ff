"""Closed forms of view factors: the share of what a uniform diffuse surface emits that meets another surface.

The view factor F12 is also the mean over surface 1 of the irradiance from surface 2, over pi times its radiance.
Lengths are in any one unit. All functions work on scalars of ``jax.numpy``; ``jax.grad`` through them gives true
derivatives, in which the edges of both surfaces move. Reciprocity: A1 F12 = A2 F21.

Sources are configurations of Howell, A catalog of radiation heat transfer configuration factors.
"""

import jax
import jax.numpy as jnp
import numpy as np

NODES, WEIGHTS = (x / 2 for x in np.polynomial.legendre.leggauss(64))  # on [-1/2, 1/2]


def facing_rectangles_factor(width, depth, distance) -> jax.Array:
    """View factor between two equal rectangles ``width`` x ``depth``, straight opposite each other at ``distance``.

    Source: configuration C-11. Rounding grows as 1/(width depth/distance^2)^2 where the rectangles are small: the
    relative error in float64 is 1e-12 at sides of a tenth of the distance, and 1e-8 at a hundredth.
    """
    x, y = width / distance, depth / distance
    to_x, to_y = jnp.sqrt(1.0 + x * x), jnp.sqrt(1.0 + y * y)
    logarithm = 0.5 * jnp.log1p((x * y) ** 2 / (1.0 + x * x + y * y))
    angles = x * to_y * jnp.arctan(x / to_y) + y * to_x * jnp.arctan(y / to_x)
    return 2.0 / (jnp.pi * x * y) * (logarithm + angles - x * jnp.arctan(x) - y * jnp.arctan(y))


def standing_rectangle_factor(depth, height, width) -> jax.Array:
    """View factor from a rectangle ``depth`` x ``width`` to one ``height`` x ``width`` that stands on its edge.

    Source: configuration C-14, its powers written as products with logarithms.
    """
    w, h = depth / width, height / width
    w2, h2 = w * w, h * h
    diagonal = jnp.sqrt(w2 + h2)
    angles = w * jnp.arctan(1.0 / w) + h * jnp.arctan(1.0 / h) - diagonal * jnp.arctan(1.0 / diagonal)
    whole = 1.0 + w2 + h2
    logarithms = (
        jnp.log((1.0 + w2) * (1.0 + h2) / whole)
        + w2 * jnp.log(w2 * whole / ((1.0 + w2) * diagonal**2))
        + h2 * jnp.log(h2 * whole / ((1.0 + h2) * diagonal**2))
    )
    return (angles + logarithms / 4.0) / (jnp.pi * w)


def parallel_rectangles_factor(corner, size, other_corner, other_size, distance) -> jax.Array:
    """View factor from one rectangle to another in a parallel plane at ``distance``, sides parallel to x and y.

    ``corner`` and ``size`` have shape (2,): the corner of least x and y, and the extent along x and y.
    Source: configuration C-13, a signed sum over the 16 pairs of corners.
    """
    corner, size, other_corner, other_size = (jnp.asarray(v, float) for v in (corner, size, other_corner, other_size))
    ends, other_ends = jnp.stack([corner, corner + size]), jnp.stack([other_corner, other_corner + other_size])
    apart = ends[:, None] - other_ends[None]  # end, other end, axis
    sign = jnp.array([[1.0, -1.0], [-1.0, 1.0]])
    u, v = apart[:, :, 0][:, :, None, None], apart[:, :, 1][None, None]
    signs = sign[:, :, None, None] * sign[None, None]
    return jnp.sum(signs * _corner_term(u, v, distance)) / (size[0] * size[1])


def coaxial_disks_factor(radius, other_radius, distance) -> jax.Array:
    """View factor from a disk to a parallel one on the same axis at ``distance``.

    Source: configuration C-41, in the form without cancellation.
    """
    total = radius**2 + other_radius**2 + distance**2
    return 2.0 * other_radius**2 / (total + jnp.sqrt(total**2 - 4.0 * (radius * other_radius) ** 2))


def spheres_factor(radius, other_radius, distance) -> jax.Array:
    """View factor from a sphere to another whose centre is at ``distance``, more than both radii.

    In a direction at angle t from the line of centres the spheres exchange what passes through the overlap of two disks
    at distance p = D sin t: F12 = 1/(2 pi r1^2) int overlap(p) sin t dt. Quadrature, to rounding: the overlap is
    constant up to p = |r1 - r2|, and p = large - small cos(phi) makes the rest smooth.
    Source: no elementary form is known (Juul 1976; Felske 1978); the integral over directions is elementary geometry.
    """
    small, large = jnp.minimum(radius, other_radius), jnp.maximum(radius, other_radius)
    # int_0^(large - small) p / (D sqrt(D^2 - p^2)) dp of the part in which one disk covers the other
    inner = large - small
    covered = jnp.pi * small**2 * inner**2 / (distance * (distance + jnp.sqrt(distance**2 - inner**2)))
    phi = jnp.pi * (NODES + 0.5)
    p = large - small * jnp.cos(phi)
    step = jnp.pi * small * jnp.sin(phi) * p / (distance * jnp.sqrt(distance**2 - p**2))
    crossing = jnp.sum(WEIGHTS * step * _disk_overlap(small, large, p))
    return (covered + crossing) / (2.0 * jnp.pi * radius**2)


def sphere_to_disk_factor(radius, distance) -> jax.Array:
    """View factor from a sphere to a disk of ``radius`` whose axis passes through the centre, at ``distance`` from it.

    It is the disk's solid angle from the centre over 4 pi, whatever the sphere's radius (below ``distance``) is.
    Source: section C, sphere to coaxial disk; in the form without cancellation.
    """
    slant = jnp.sqrt(distance**2 + radius**2)
    return radius**2 / (2.0 * slant * (slant + distance))


def outer_to_inner_sphere_factor(inner_radius, outer_radius) -> jax.Array:
    """View factor from the inside of a sphere to a sphere within it, at its centre or not: the ratio of areas.

    Source: section C, concentric spheres.
    """
    return (inner_radius / outer_radius) ** 2


def _corner_term(u, v, z):
    """Double integral over both axes of the kernel z^2/(pi r^4), up to terms that signed sums cancel."""
    to_u, to_v = jnp.sqrt(u * u + z * z), jnp.sqrt(v * v + z * z)
    angles = v * to_u * jnp.arctan(v / to_u) + u * to_v * jnp.arctan(u / to_v)
    return (angles - 0.5 * z * z * jnp.log(u * u + v * v + z * z)) / (2.0 * jnp.pi)


def _disk_overlap(small, large, p):
    """Area common to two disks that cross at distance ``p`` of their centres."""
    along = (p * p + small**2 - large**2) / (2.0 * p)  # from the centre of the small disk to the common chord
    heron = (large + small - p) * (p + small - large) * (p + large - small) * (p + small + large)
    half_chord = jnp.sqrt(heron) / (2.0 * p)
    # With atan2 the angles keep their digits where the disks only touch.
    angle, other_angle = jnp.arctan2(half_chord, along), jnp.arctan2(half_chord, p - along)
    return small**2 * angle + large**2 * other_angle - p * half_chord
