"""Skies: the radiance that arrives from outside the scene, the same from everywhere or a gradient."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .derivatives import root
from .materials import luminance
from .primitives import as_color, as_unit, is_concrete, shape_of
from .vec import Vec3, dot, frame, larger, smaller, where
from .warps import sample_uniform_hemisphere, sincos_2pi

ROUNDS = 10  # of Newton's method


@dataclasses.dataclass(frozen=True, eq=False)
class GradientSky:
    """A sky whose radiance is a polynomial in z, the cosine of the angle from the zenith.

    z is 1 at the zenith, 0 at the horizon and -1 at the nadir; the radiance is the sum of ``coefficients[k] * z**k``.
    ``GradientSky((L / 3, 2 * L / 3), ground=0)`` is the overcast sky of Moon and Spencer (1942), later the CIE's, with
    zenith radiance L; three coefficients make any sky of zonal harmonics up to degree 2.

    Attributes:
        coefficients: one or more, constant first; each a number or an RGB triple [W/m^2/sr]. They may be negative, the
            radiance may not.
        up: points to the zenith; any length.
        ground: radiance from below the horizon, a number or an RGB triple. None: the polynomial holds there too.

    ``jax.grad`` is right for the coefficients and the ground. For ``up`` it leaves out what the moving edge of the
    ground adds, which ``mc.moving_paths`` and its kin have.

    Raises:
        ValueError: values of the wrong shape, that are not finite, or that make the radiance negative somewhere.
    """

    coefficients: Any
    up: Any = (0.0, 1.0, 0.0)
    ground: Any = None

    def __post_init__(self):
        if shape_of(self.coefficients) == () or len(self.coefficients) == 0:
            raise ValueError(f"GradientSky coefficients must be a list of one or more, got {self.coefficients!r}")
        as_unit("GradientSky up", self.up)
        polynomials = [as_color("GradientSky coefficient", c, signed=True) for c in self.coefficients]
        if self.ground is not None:
            as_color("GradientSky ground", self.ground)
        if not is_concrete(polynomials):
            return
        for channel in zip(*polynomials):
            least, z = _least(np.polynomial.Polynomial(channel), -1.0 if self.ground is None else 0.0)
            if least < -1e-12 * max(map(abs, channel)):
                raise ValueError(
                    f"GradientSky radiance must not be negative, and it is {least:g} where the cosine of the angle "
                    f"from the zenith is {z:g}; raise the constant coefficient, or give a ground if that is below it"
                )

    def colors(self) -> list[tuple]:
        """Return all its values as (r, g, b)."""
        ground = [] if self.ground is None else [as_color("ground", self.ground)]
        return [*(as_color("coefficient", c, signed=True) for c in self.coefficients), *ground]


class ZenithPolynomial(NamedTuple):
    """A gradient as the kernel uses it; components of ``up`` that are zero are None, ``ground`` may be None."""

    up: Vec3
    coefficients: tuple
    ground: Any


def table_of_sky(sky, color: Callable):
    """Return a sky as the kernel uses it: None where it is black, one radiance where it is the same from everywhere.

    ``sky`` is None, an (r, g, b) or a ``GradientSky``; ``color`` turns an (r, g, b) into the scene's channels.
    """
    if not isinstance(sky, GradientSky):
        return None if sky is None or _is_black(sky) else color(sky)
    coefficients = [as_color("coefficient", c, signed=True) for c in sky.coefficients]
    while len(coefficients) > 1 and _is_black(coefficients[-1]):
        coefficients.pop()
    ground = None if sky.ground is None else as_color("ground", sky.ground)
    is_same = ground is None or (is_concrete((ground, coefficients)) and ground == coefficients[0])
    if len(coefficients) == 1 and is_same:
        return table_of_sky(coefficients[0], color)
    up = as_unit("up", sky.up)
    sparse = Vec3(*(None if is_concrete(c) and c == 0.0 else c for c in up))
    return ZenithPolynomial(sparse, tuple(map(color, coefficients)), None if ground is None else color(ground))


def zenith_of(sky: ZenithPolynomial) -> Vec3:
    """Return the direction of the zenith with all its components."""
    return Vec3(*(jnp.zeros(()) if c is None else jnp.asarray(c) for c in sky.up))


def sky_radiance(sky, direction: Vec3):
    """Return the radiance of a sky, as ``table_of_sky`` made it, in the direction of a unit vector."""
    if not isinstance(sky, ZenithPolynomial):
        return sky
    z = sum(a * b for a, b in zip(sky.up, direction) if a is not None)
    value = _polynomial(sky.coefficients, z)
    return value if sky.ground is None else where(z > 0.0, value, sky.ground)


# ------------------------------------------------------------------------------------------------ as a light


def sample_sky(sky, normal: Vec3, u1, u2):
    """Return (wi, 1 / density per solid angle, radiance) of a direction toward a sky.

    A constant sky is drawn uniformly over the hemisphere of ``normal``; a gradient over the whole sphere in proportion
    to its luminance, by an inversion of the polynomial that luminance has integrated over z.
    """
    sine, cosine = sincos_2pi(u2)
    if not isinstance(sky, ZenithPolynomial):
        local = sample_uniform_hemisphere(u1, u2)
        tangent, bitangent = frame(normal)
        return tangent * local.x + bitangent * local.y + normal * local.z, 2.0 * np.pi, sky
    z = _sample_z(sky, u1)
    radius = root(larger((1.0 - z) * (1.0 + z), 0.0))
    up = zenith_of(sky)
    tangent, bitangent = frame(up)
    wi = tangent * (radius * cosine) + bitangent * (radius * sine) + up * z
    return wi, sky_inverse_pdf(sky, normal, wi), sky_radiance(sky, wi)


def sky_inverse_pdf(sky, normal: Vec3, wi: Vec3):
    """Return 1 / density per solid angle with which ``sample_sky`` draws a direction, 0 where it never does."""
    if not isinstance(sky, ZenithPolynomial):
        return jnp.where(dot(normal, wi) > 0.0, 2.0 * np.pi, 0.0)
    below, above = _masses(sky)
    y = luminance(sky_radiance(sky, wi))
    return jnp.where(y > 0.0, 2.0 * np.pi * (below + above) / jnp.where(y > 0.0, y, 1.0), 0.0)


def _luminances(sky):
    return [luminance(c) for c in sky.coefficients]


def _integral(coefficients, z):
    """Return the integral from 0 to z of a polynomial."""
    value = 0.0
    for k in range(len(coefficients) - 1, -1, -1):
        value = (value + coefficients[k] / (k + 1)) * z
    return value


def _masses(sky):
    """Return the integrals of luminance over z below and above the horizon."""
    y = _luminances(sky)
    below = -_integral(y, -1.0) if sky.ground is None else luminance(sky.ground)
    return below, _integral(y, 1.0)


def _sample_z(sky, u):
    """Return z with a density in proportion to luminance."""
    y, (below, above) = _luminances(sky), _masses(sky)
    # The integral from 0 to z must be so much; below the horizon it is negative.
    aim = u * (below + above) - below
    low, high = jnp.where(aim < 0.0, -1.0, 0.0), jnp.where(aim < 0.0, 0.0, 1.0)
    z = 0.5 * (low + high)
    for _ in range(ROUNDS):
        # Newton's method within what is known to hold the root; the middle of that where luminance is 0.
        excess, slope = _integral(y, z) - aim, _polynomial(y, z)
        low, high = jnp.where(excess < 0.0, z, low), jnp.where(excess < 0.0, high, z)
        step = smaller(larger(z - excess / jnp.where(slope > 0.0, slope, 1.0), low), high)
        z = jnp.where(slope > 0.0, step, 0.5 * (low + high))
    if sky.ground is None:
        return z
    ground = luminance(sky.ground)
    return jnp.where(aim < 0.0, larger(aim / jnp.where(ground > 0.0, ground, 1.0), -1.0), z)


def _polynomial(coefficients, z):
    value = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = value * z + c
    return value


def _is_black(color):
    return is_concrete(color) and not any(color)


def _least(polynomial, low):
    """Return the least value of a polynomial on [low, 1] and where it is."""
    turns = polynomial.deriv().roots()
    inside = turns.real[(abs(turns.imag) < 1e-12) & (turns.real > low) & (turns.real < 1.0)]
    points = np.array([low, *inside, 1.0])
    return min(zip(polynomial(points), points))
