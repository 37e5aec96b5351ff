"""Sampling a rectangular light uniformly by the solid angle that it fills, seen from a point.

The density is 1 / solid angle, whatever the place on the light, so irradiance has only the variance of the receiver's
cosine and of what hides the light. By area it varies with cosine over squared distance, without bound near the light.

The idea is that of Urena, Fajardo & King 2013, "An Area-Preserving Parametrization for Spherical Rectangles": choose
a line across the light that leaves a share u1 of the solid angle on one side, then a place on it: a narrow strip along
it fills a solid angle uniform in y / sqrt(x^2 + y^2 + z^2), by Archimedes' theorem. The angles are measured otherwise
here. The band y0 < y < y1 beyond x is a spherical triangle with one corner at infinity, and its solid angle is

    2 arg(D(x) + i z h),  D(x) = (x + r0)(x + r1) + y0 y1 + z^2,  h = y1 - y0,  rj = sqrt(x^2 + yj^2 + z^2)

by van Oosterom & Strackee 1983. The light is what lies beyond its near end less what lies beyond its far end, and x
follows from an arg in closed form. That takes one arctangent instead of four arccosines, and no difference of nearly
equal angles: the solid angle keeps its digits however small it is, and nothing has to go over to sampling by area.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .vec import Vec3, dot, larger, smaller, where
from .warps import angle, grazing, sincos_2pi_quarter


class RectangleLight(NamedTuple):
    """A rectangle: its centre, unit vectors along its edges, the longer one first, half their lengths, and the unit
    normal of the side that shines.
    """

    center: Vec3
    along_u: Vec3
    along_v: Vec3
    half_u: Any
    half_v: Any
    normal: Vec3


def rectangle_light(center: Vec3, half_u: Vec3, half_v: Vec3, normal: Vec3) -> RectangleLight:
    """Return the light about ``center`` with half edges ``half_u`` and ``half_v``, which are perpendicular."""
    is_longer = dot(half_u, half_u) >= dot(half_v, half_v)
    longer, shorter = where(is_longer, half_u, half_v), where(is_longer, half_v, half_u)
    length, breadth = jnp.sqrt(dot(longer, longer)), jnp.sqrt(dot(shorter, shorter))
    return RectangleLight(center, longer / length, shorter / breadth, length, breadth, normal)


class _View(NamedTuple):
    """The light seen from a point, which looks along z: it spans x0..x1 and y0..y1 at height z > 0.

    Lengths are in units of the extent of all that, so that no product over- or underflows. The middle is at x, y >= 0:
    the signs to undo that are ``sign_x`` and ``sign_y``.
    """

    x0: Any
    x1: Any
    y0: Any
    y1: Any
    z: Any
    width: Any
    depth: Any
    sign_x: Any
    sign_y: Any
    unit: Any
    in_front: Any


def _view(light, point):
    to_center = light.center - point
    x, y, z = dot(light.along_u, to_center), dot(light.along_v, to_center), -dot(light.normal, to_center)
    size_x, size_y = jnp.abs(x), jnp.abs(y)
    unit = size_x + size_y + jnp.abs(z) + light.half_u + light.half_v
    scale = 1.0 / unit
    return _View(
        (size_x - light.half_u) * scale,
        (size_x + light.half_u) * scale,
        (size_y - light.half_v) * scale,
        (size_y + light.half_v) * scale,
        larger(z * scale, grazing()),
        2.0 * light.half_u * scale,
        2.0 * light.half_v * scale,
        jnp.where(x < 0.0, -1.0, 1.0),
        jnp.where(y < 0.0, -1.0, 1.0),
        unit,
        z > 0.0,
    )


def _half_solid_angle(view):
    """Return half the solid angle, and D(x1) and z h of what lies beyond the far end."""
    x0, x1, y0, y1, z = view[:5]
    low, high = y0 * y0 + z * z, y1 * y1 + z * z
    r00, r01 = jnp.sqrt(x0 * x0 + low), jnp.sqrt(x0 * x0 + high)
    r10, r11 = jnp.sqrt(x1 * x1 + low), jnp.sqrt(x1 * x1 + high)
    p0, q0, p1, q1 = r00 + x0, r01 + x0, r10 + x1, r11 + x1
    level, area = y0 * y1 + z * z, z * view.depth
    near, far = p0 * q0 + level, p1 * q1 + level
    # D(x1) - D(x0) is a sum of positive terms with the width as a factor.
    ends_0, ends_1 = r00 + r10, r01 + r11
    step = view.width * ((p0 + p1) * q1 * ends_1 + (q0 + q1) * p0 * ends_0) / (ends_0 * ends_1)
    return angle(area * step, near * far + area * area), far, area


def inverse_pdf_rectangle_light(light: RectangleLight, point: Vec3):
    """Return 1 / density per solid angle of ``sample_rectangle_light``: the solid angle [sr], 0 from behind.

    In float32 its relative error is below 5e-6, but for points straight above a short edge, s long, at a small height
    z: there it is up to 1e-7 s / z.
    """
    view = _view(light, point)
    return jnp.where(view.in_front, 2.0 * _half_solid_angle(view)[0], 0.0)


def sample_rectangle_light(light: RectangleLight, point: Vec3, own, u1, u2):
    """Return (wi, distance, inverse density) of a direction toward the light, uniform in solid angle.

    ``own``: the point lies in the light's plane, from which the light cannot be seen. The inverse density is the solid
    angle [sr]; it is 0 from there and from behind. The direction is exact to rounding, its place on the light to
    rounding of a direction. Points closer to the plane than 2e-6 of their distance are taken to be that close.
    """
    view = _view(light, point)
    half, far, area = _half_solid_angle(view)
    x = _sample_strip(view, half, far, area, u1)
    y = _sample_height(view, x, u2)
    squared = x * x + y * y + view.z * view.z
    inverse = jnp.sqrt(1.0 / squared)
    across, along = view.sign_x * x * inverse, view.sign_y * y * inverse
    wi = light.along_u * across + light.along_v * along - light.normal * (view.z * inverse)
    visible = view.in_front & jnp.logical_not(own)
    return wi, squared * inverse * view.unit, jnp.where(visible, 2.0 * half, 0.0)


def _sample_strip(view, half, far, area, u1):
    """Return the x that leaves a share 1 - u1 of the solid angle beyond it."""
    _, _, y0, y1, z = view[:5]
    # Turn D(x1) + i z h, half the solid angle beyond the light, by half of what is to be added; length does not matter.
    sine, cosine = sincos_2pi_quarter((1.0 - u1) * half * (0.25 / np.pi))
    turn_c, turn_s = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    c, s = far * turn_c - area * turn_s, far * turn_s + area * turn_c
    # Solve D(x) s = z h c for x.
    level = y0 * y1 + z * z
    down = 4.0 * s * (area * c - level * s) * ((z * c + y1 * s) * (z * c - y0 * s))
    down = jnp.sqrt(larger(down, 64.0 * float(jnp.finfo(jnp.result_type(down)).tiny)))
    x = z * (area * (c - s) * (c + s) - 2.0 * level * s * c) / down
    return smaller(larger(x, view.x0), view.x1)


def _sample_height(view, x, u2):
    """Return the y on the strip at x of which a share 1 - u2 of the solid angle lies beyond it."""
    y0, y1 = view.y0, view.y1
    squared = x * x + view.z * view.z
    r0, r1 = jnp.sqrt(squared + y0 * y0), jnp.sqrt(squared + y1 * y1)
    # 1 - y / r, without cancellation at the far end.
    beyond = y0 > 0.0
    start = jnp.where(beyond, squared, r0 - y0) / (r0 * jnp.where(beyond, r0 + y0, 1.0))
    end = squared / (r1 * (r1 + y1))
    left = end + (1.0 - u2) * (start - end)
    # The light reaches less far on the other side.
    y = (1.0 - left) * jnp.sqrt(squared / (left * larger(2.0 - left, end)))
    return smaller(larger(y, y0), y1)
