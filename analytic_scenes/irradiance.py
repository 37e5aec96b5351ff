"""Closed forms of the irradiance [W/m^2] that a uniform diffuse light gives at a point.

Every function takes the radiance ``emission`` [W/m^2/sr] of the light first, and works on scalars and arrays of
``jax.numpy``, so ``jax.grad`` gives true derivatives: the light's own edges and the receiver's horizon are inside the
formula. The receiver stands at the origin; lengths are in any one unit, angles in radians.
"""

import jax
import jax.numpy as jnp


def sphere_irradiance(emission, radius, distance, theta) -> jax.Array:
    """Irradiance from a sphere, seen whole or cut by the horizon of the receiver.

    ``distance`` (> ``radius``) leads to the centre, ``theta`` in [0, pi] is the angle between that direction and the
    receiver's normal. With sin(sigma) = radius/distance, a sphere above the horizon acts as a point source of intensity
    pi emission radius^2; one that the horizon cuts (|theta - pi/2| < sigma) follows from the boundary integral
    E = emission n . (1/2) oint r x dr.

    Source: Snyder, Area light sources for real-time graphics (1996); Lagarde and de Rousiers, Moving Frostbite to PBR
    (2014), section 4.7; Howell, A catalog of radiation heat transfer configuration factors, section B.
    """
    return emission * _sphere_factor(radius / distance, jnp.cos(theta))


def sphere_at_irradiance(emission, center, radius, normal=(0.0, 0.0, 1.0)) -> jax.Array:
    """Irradiance from a sphere by its ``center``, shape (3,); ``normal`` has any length. See ``sphere_irradiance``."""
    center, n = jnp.asarray(center, float), jnp.asarray(normal, float)
    distance = jnp.sqrt(center @ center)
    return emission * _sphere_factor(radius / distance, center @ n / (distance * jnp.sqrt(n @ n)))


def polygon_irradiance(emission, vertices, normal) -> jax.Array:
    """Irradiance from a convex polygon that emits on both sides, clipped at the horizon of the receiver.

    ``vertices`` has shape (k, 3), in order along the outline; ``normal``, shape (3,), is the receiver's, any length.
    E = (emission/2) |sum_i Theta_i n . (v_i x v_i+1) / |v_i x v_i+1||, with Theta_i the angle between v_i and v_i+1.

    Source: Lambert, Photometria (1760); Baum, Rushmeier and Winget, Improving radiosity solutions through the use of
    analytically determined form-factors (1989); derivatives as in Arvo, The irradiance Jacobian (1994).
    """
    n = jnp.asarray(normal, float)
    n = n / jnp.sqrt(n @ n)
    start = jnp.asarray(vertices, float)
    stop = jnp.roll(start, -1, axis=0)
    rises, falls = (start @ n <= 0) & (stop @ n > 0), (start @ n > 0) & (stop @ n <= 0)
    crosses = rises | falls
    fraction = (start @ n) / jnp.where(crosses, (start - stop) @ n, 1.0)
    crossing = jnp.where(crosses, fraction, 0.0)[:, None] * (stop - start) + start

    first, last = jnp.where(rises[:, None], crossing, start), jnp.where(falls[:, None], crossing, stop)
    above = crosses | (start @ n > 0)
    outline = jnp.sum(jnp.where(above, jax.vmap(_arc, (0, 0, None))(first, last, n), 0.0))
    # A convex outline goes below the horizon once and comes back once: close it along the horizon.
    closing = _arc(_pick(falls, crossing), _pick(rises, crossing), n)
    return emission / 2 * jnp.abs(outline + jnp.where(jnp.any(crosses), closing, 0.0))


def parallelogram_irradiance(emission, corner, edge_u, edge_v, normal=(0.0, 0.0, 1.0)) -> jax.Array:
    """Irradiance from a parallelogram that emits on the side of cross(edge_u, edge_v) only; all vectors of shape (3,).

    Source: ``polygon_irradiance``; 0 where the receiver is behind the light.
    """
    corner, u, v = (jnp.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    vertices = jnp.stack([corner, corner + u, corner + u + v, corner + v])
    facing = jnp.cross(u, v) @ corner < 0
    return jnp.where(facing, polygon_irradiance(emission, vertices, normal), 0.0)


def corner_rectangle_irradiance(emission, width, depth, height) -> jax.Array:
    """Irradiance from a rectangle [0, width] x [0, depth] at ``height``, parallel to the receiver, a corner overhead.

    Odd in ``width`` and in ``depth``, so signed sums of four give any parallel rectangle.
    Source: Howell's catalog, configuration B-3.
    """
    to_width, to_depth = jnp.sqrt(width**2 + height**2), jnp.sqrt(depth**2 + height**2)
    u_term = width / to_width * jnp.arctan(depth / to_width)
    v_term = depth / to_depth * jnp.arctan(width / to_depth)
    return emission / 2 * (u_term + v_term)


def standing_rectangle_irradiance(emission, width, height, distance) -> jax.Array:
    """Irradiance from a rectangle that stands on the receiver's plane at ``distance``, a lower corner straight ahead.

    Source: Howell's catalog, configuration B-4.
    """
    slant = jnp.sqrt(height**2 + distance**2)
    return emission / 2 * (jnp.arctan(width / distance) - distance / slant * jnp.arctan(width / slant))


def parallelogram_solid_angle(corner, edge_u, edge_v) -> jax.Array:
    """Solid angle [sr] of a parallelogram seen from the origin, from either side: two triangles.

    Source: van Oosterom and Strackee, The solid angle of a plane triangle (1983).
    """
    corner, u, v = (jnp.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    far = corner + u + v
    return jnp.abs(_triangle_solid_angle(corner, corner + u, far) + _triangle_solid_angle(corner, far, corner + v))


def rectangle_solid_angle(x0, x1, y0, y1, height) -> jax.Array:
    """Solid angle [sr] of the rectangle [x0, x1] x [y0, y1] seen from ``height`` above the origin.

    Source: Khadjavi, Calculation of solid angle subtended by rectangular apertures (1968).
    """

    def corner(x, y):
        return jnp.arctan(x * y / (height * jnp.sqrt(x**2 + y**2 + height**2)))

    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def sphere_in_mirror_irradiance(emission, reflectance, radius, center, mirror_distance, mirror_normal) -> jax.Array:
    """Irradiance on a receiver with normal +z from a sphere, directly and by one reflection in a plane mirror.

    ``center`` has shape (3,); the mirror is the plane at ``mirror_distance`` from the receiver whose unit normal
    ``mirror_normal`` points to it. Source: method of images, ``sphere_irradiance``.
    """
    image = mirror_image(center, mirror_distance, mirror_normal)
    reflected = sphere_at_irradiance(emission, image, radius)
    return sphere_at_irradiance(emission, center, radius) + reflectance * reflected


def parallelogram_in_mirror_irradiance(
    emission, reflectance, corner, edge_u, edge_v, mirror_distance, mirror_normal
) -> jax.Array:
    """Irradiance on a receiver with normal +z from a parallelogram, directly and by one reflection in a plane mirror.

    The mirror is that of ``sphere_in_mirror_irradiance``. Source: method of images, ``parallelogram_irradiance``.
    """
    image = mirror_image(corner, mirror_distance, mirror_normal)
    image_u, image_v = (mirror_image(edge, 0.0, mirror_normal) for edge in (edge_u, edge_v))
    # A reflection turns the outline round: with the edges exchanged, the image emits on the image of the same side.
    reflected = parallelogram_irradiance(emission, image, image_v, image_u)
    return parallelogram_irradiance(emission, corner, edge_u, edge_v) + reflectance * reflected


def mirror_image(point, mirror_distance, mirror_normal) -> jax.Array:
    """Image of ``point`` in the plane at ``mirror_distance`` from the origin whose unit normal points to it."""
    n = jnp.asarray(mirror_normal, float)
    return point - 2 * (jnp.asarray(point, float) @ n + mirror_distance) * n


def _sphere_factor(sin_sigma, cos_theta):
    """Irradiance over radiance from a sphere of angular radius sigma, whose centre is at theta from the normal."""
    whole = jnp.pi * sin_sigma**2 * jnp.maximum(cos_theta, 0.0)

    is_cut = jnp.abs(cos_theta) < sin_sigma
    cos_theta = jnp.where(is_cut, cos_theta, 0.0)  # keeps the unused branch, and its derivative, finite
    sin_theta, cos_sigma = jnp.sqrt(1.0 - cos_theta**2), jnp.sqrt(1.0 - sin_sigma**2)
    cos_phi = cos_sigma * cos_theta / (sin_sigma * sin_theta)
    phi = jnp.arccos(cos_phi)  # azimuth, about the direction of the centre, at which the rim crosses the horizon
    rim_y = sin_sigma * jnp.sin(phi)
    arc = jnp.arctan2(rim_y, cos_sigma * sin_theta + sin_sigma * cos_theta * cos_phi)
    cut = (jnp.pi - phi) * cos_theta * sin_sigma**2 - cos_sigma * sin_theta * rim_y + arc
    return jnp.where(is_cut, cut, whole)


def _triangle_solid_angle(a, b, c):
    """Signed solid angle of the triangle a b c."""
    la, lb, lc = (jnp.sqrt(vertex @ vertex) for vertex in (a, b, c))
    below = la * lb * lc + (a @ b) * lc + (b @ c) * la + (c @ a) * lb
    return 2 * jnp.arctan2(a @ jnp.cross(b, c), below)


def _arc(v, w, n):
    """Angle between v and w times the component along n of the unit vector along v x w; 0 where they are parallel."""
    normal = jnp.cross(v, w)
    length2 = normal @ normal
    length = jnp.sqrt(jnp.where(length2 > 0, length2, 1.0))
    return jnp.where(length2 > 0, jnp.arctan2(length, v @ w) * (normal @ n) / length, 0.0)


def _pick(mask, rows):
    return jnp.sum(jnp.where(mask[:, None], rows, 0.0), axis=0)
