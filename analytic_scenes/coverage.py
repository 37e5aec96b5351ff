"""Exact pixels under each filter: what a half-plane, a disk or an ellipse covers of one, and the outline of a sphere.

Lengths are in pixels, places relative to the centre of the pixel unless said otherwise. A value is the integral of
the filter over the shape, divided by that of the filter: the mean of a pixel whose picture is 1 inside of the shape
and 0 outside, away from the border of the image. With negative lobes it may lie outside of [0, 1].

One integral is done in closed form, by the integral of the profile along one axis. The other runs over smooth pieces
between the breaks of the profiles, where Gauss-Legendre quadrature is exact for polynomials (box, tent and Mitchell
filters under a half-plane) and converges to rounding for the rest. Derivatives, by ``jax.grad``, are those of the
value, with the moving edge.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf

import jaxmc as mc
from jaxmc.transport.camera import Camera
from jaxmc.transport.vec import Vec3, dot

NODES = 40  # enough for a Gaussian over its whole support, or a disk through it


class Profile(NamedTuple):
    """A filter along one axis, of integral 1: where it is not smooth, its density and the integral of that up to x."""

    breaks: tuple[float, ...]
    density: object
    cumulative: object


@functools.singledispatch
def profile(filter) -> Profile:
    """Return a filter along one axis.

    Raises:
        ValueError: none of the four filters of jaxmc.
    """
    raise ValueError(f"coverage is known for box, tent, Mitchell and Gaussian filters, got {filter!r}")


@profile.register
def _box(filter: mc.BoxFilter):
    r = filter.radius
    return Profile((-r, r), lambda x: jnp.where(abs(x) <= r, 0.5 / r, 0.0), lambda x: jnp.clip(0.5 + 0.5 * x / r, 0, 1))


@profile.register
def _tent(filter: mc.TentFilter):
    r = filter.radius

    def cumulative(x):
        t = jnp.clip(x / r, -1.0, 1.0)
        return 0.5 + t - 0.5 * t * jnp.abs(t)

    return Profile((-r, 0.0, r), lambda x: jnp.maximum(1.0 - jnp.abs(x) / r, 0.0) / r, cumulative)


@profile.register
def _mitchell(filter: mc.MitchellFilter):
    b, c, half = filter.b, filter.c, filter.radius / 2.0
    # The cubics of Mitchell and Netravali (1988) in powers of |x|, for |x| < 1 and for 1 <= |x| < 2.
    inner = np.array([6 - 2 * b, 0.0, -18 + 12 * b + 6 * c, 12 - 9 * b - 6 * c]) / 6.0
    outer = np.array([8 * b + 24 * c, -12 * b - 48 * c, 6 * b + 30 * c, -b - 6 * c]) / 6.0
    end = _antiderivative(outer, 2.0)

    def density(x):
        t = jnp.abs(x) / half
        near, far = jnp.polyval(inner[::-1], t), jnp.polyval(outer[::-1], t)
        return jnp.where(t < 1.0, near, jnp.where(t < 2.0, far, 0.0)) / half

    def cumulative(x):
        t = jnp.minimum(jnp.abs(x) / half, 2.0)
        mass = jnp.where(t < 1.0, _antiderivative(inner, t), 0.5 + _antiderivative(outer, t) - end)
        return 0.5 + jnp.sign(x) * mass

    return Profile(tuple(half * k for k in (-2, -1, 0, 1, 2)), density, cumulative)


def _antiderivative(coefficients, t):
    return jnp.polyval(np.array([*[a / (k + 1) for k, a in enumerate(coefficients)][::-1], 0.0]), t)


@profile.register
def _gaussian(filter: mc.GaussianFilter):
    sigma, r = filter.sigma, filter.radius
    mass = math.erf(filter.cut / math.sqrt(2.0))

    def density(x):
        return jnp.where(abs(x) <= r, jnp.exp(-0.5 * (x / sigma) ** 2) / (mass * sigma * math.sqrt(2.0 * math.pi)), 0.0)

    def cumulative(x):
        return 0.5 + 0.5 * erf(jnp.clip(x, -r, r) / (sigma * math.sqrt(2.0))) / mass

    return Profile((-r, r), density, cumulative)


def half_plane_coverage(filter, angle, offset):
    """Return what the half-plane ``x cos(angle) + y sin(angle) < offset`` covers of a pixel."""
    f = profile(filter)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    # Integrate in closed form along the axis that the normal is closer to: F is then smooth in the other one.
    steep = jnp.abs(sine) >= jnp.abs(cosine)
    major, minor = jnp.where(steep, sine, cosine), jnp.where(steep, cosine, sine)
    breaks, parallel = jnp.array(f.breaks), jnp.abs(minor) < 1e-12
    # An edge parallel to this axis meets no break of F.
    met = jnp.where(parallel, breaks, (offset - breaks * major) / jnp.where(parallel, 1.0, minor))
    low, high = f.breaks[0], f.breaks[-1]

    def along(x):
        below = f.cumulative((offset - x * minor) / major)
        return f.density(x) * jnp.where(major > 0.0, below, 1.0 - below)

    return _over_pieces(along, jnp.concatenate([breaks, jnp.clip(met, low, high)]))


def disk_coverage(filter, x, y, radius):
    """Return what the disk about (x, y) covers of a pixel."""
    square = radius * radius
    return ellipse_coverage(filter, x, y, square, 0.0, square)


def ellipse_coverage(filter, x, y, xx, xy, yy):
    """Return what an ellipse about (x, y) covers of a pixel: all p with (p - center)^T S^-1 (p - center) < 1.

    S is the positive definite matrix [[xx, xy], [xy, yy]]; of a disk it is the square of the radius times the identity.
    """
    f = profile(filter)
    width = jnp.sqrt(xx)
    tilt, height = xy / width, jnp.sqrt(yy - xy * xy / xx)
    breaks = jnp.array(f.breaks)
    # The outline is x + width sin t, y + tilt sin t +- height cos t: smooth in t where both profiles are.
    crossings = [_arcsine((breaks - x) / width)]
    amplitude, phase = jnp.hypot(tilt, height), jnp.arctan2(height, tilt)
    for sign in (1.0, -1.0):
        crossed = _arcsine((breaks - y) / amplitude)
        for angle in (crossed, math.pi - crossed):
            t = angle - sign * phase
            t = (t + math.pi) % (2.0 * math.pi) - math.pi
            crossings.append(jnp.clip(t, -math.pi / 2, math.pi / 2))

    def along(t):
        sine, cosine = jnp.sin(t), jnp.cos(t)
        middle, half = y + tilt * sine, height * cosine
        covered = f.cumulative(middle + half) - f.cumulative(middle - half)
        return f.density(x + width * sine) * covered * width * cosine

    return _over_pieces(along, jnp.concatenate([*crossings, jnp.array([-math.pi / 2, math.pi / 2])]))


def _arcsine(z):
    """Return the arcsine, and +-pi/2 beyond +-1, with derivative 0."""
    inside = jnp.abs(z) < 1.0
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, z, 0.0)), jnp.sign(z) * (math.pi / 2))


def _over_pieces(function, breaks):
    """Return the integral of a function from the lowest to the highest of ``breaks``, between which it is smooth."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    ends = jnp.sort(breaks)
    half = 0.5 * (ends[1:] - ends[:-1])
    x = 0.5 * (ends[1:] + ends[:-1])[:, None] + half[:, None] * nodes
    return jnp.sum(function(x) @ jnp.asarray(weights) * half)


class Outline(NamedTuple):
    """An ellipse on the film, in pixels from its top left corner; arguments of ``ellipse_coverage``."""

    x: jax.Array
    y: jax.Array
    xx: jax.Array
    xy: jax.Array
    yy: jax.Array

    @property
    def area(self):
        """The area in pixels."""
        return math.pi * jnp.sqrt(self.xx * self.yy - self.xy**2)

    def coverage(self, filter, column, row):
        """Return what the ellipse covers of a pixel."""
        return ellipse_coverage(filter, self.x - column - 0.5, self.y - row - 0.5, self.xx, self.xy, self.yy)


def sphere_outline(camera: Camera, center, radius) -> Outline:
    """Return the picture of a sphere that lies wholly in front of the camera: the cone that its rays fill, cut by the
    film. ``center`` is relative to the camera."""
    axes = [camera.right, camera.down, camera.forward]
    # A direction d meets the sphere where (d . c)^2 > (c . c - r^2) (d . d): a quadratic form in the film position.
    toward = [dot(axis, Vec3(*center)) for axis in axes]
    rest = dot(Vec3(*center), Vec3(*center)) - radius * radius
    form = jnp.array([[a * b - rest * dot(u, v) for b, v in zip(toward, axes)] for a, u in zip(toward, axes)])
    quadratic, linear = -form[:2, :2], form[:2, 2]
    middle = jnp.linalg.solve(quadratic, linear)
    spread = jnp.linalg.inv(quadratic) * (form[2, 2] + linear @ middle)
    pixels = jnp.array([camera.width / 2.0, camera.height / 2.0])
    x, y = (middle + 1.0) * pixels
    (xx, xy), (_, yy) = spread * pixels[:, None] * pixels
    return Outline(x, y, xx, xy, yy)
