"""Pixel filters: how much a sample counts in the pixels around it.

All are separable: the weight at a distance (x, y) from the centre of a pixel is ``profile(x) * profile(y)``, lengths in
pixels. A pixel is a weighted mean, so a filter may have any scale.
"""

import dataclasses
import math

import jax.numpy as jnp

from ..integration.storage import storable
from .primitives import is_number

WIDEST = 8.0  # pixels: the work for a sample grows with the square of the radius


class Filter:
    """What all filters have. One of your own is a frozen dataclass with ``radius`` and ``profile``.

    Attributes:
        radius: half the width of the support, in pixels: 0.5 to 8.
    """

    radius: float

    def profile(self, x):
        """Return the weight along one axis at distance ``x`` in pixels from the centre, an array; 0 outside."""
        raise NotImplementedError

    def __call__(self, x, y):
        """Return the weight at distances ``x`` and ``y`` in pixels, arrays of one shape; 0 outside of the support."""
        return self.profile(x) * self.profile(y)

    @property
    def reach(self) -> int:
        """How many pixels to either side a sample counts in: 0 for its own alone."""
        return max(0, math.ceil(self.radius - 0.5))


@storable
@dataclasses.dataclass(frozen=True)
class BoxFilter(Filter):
    """The plain mean over a square; with the default radius it is the pixel, as without a filter.

    Args:
        radius: half the side of the square, in pixels: 0.5 to 8.

    Raises:
        ValueError: a radius out of range.
    """

    radius: float = 0.5

    def __post_init__(self):
        _check(self, "radius", 0.5, WIDEST)

    def profile(self, x):
        return jnp.where(jnp.abs(x) <= self.radius, jnp.ones_like(x), 0.0)

    @property
    def integral(self) -> float:
        """The integral of the weight over the plane, in pixels^2."""
        return (2.0 * self.radius) ** 2


@storable
@dataclasses.dataclass(frozen=True)
class TentFilter(Filter):
    """A product of two triangles: ``1 - |x| / radius`` along each axis.

    Args:
        radius: where the weight reaches 0, in pixels: 0.5 to 8.

    Raises:
        ValueError: a radius out of range.
    """

    radius: float = 1.0

    def __post_init__(self):
        _check(self, "radius", 0.5, WIDEST)

    def profile(self, x):
        return jnp.maximum(1.0 - jnp.abs(x) * (1.0 / self.radius), 0.0)

    @property
    def integral(self) -> float:
        """The integral of the weight over the plane, in pixels^2."""
        return float(self.radius) ** 2


@storable
@dataclasses.dataclass(frozen=True)
class MitchellFilter(Filter):
    """The cubic filters of D. Mitchell and A. Netravali, "Reconstruction Filters in Computer Graphics" (1988).

    With ``c`` > 0 the weight is negative at the rim, which makes edges sharp: pixels there may lie outside of the range
    of the radiance, below 0 too. With few samples the sum of the weights itself may come near 0: take 4 or more.

    Args:
        b: share of the cubic B-spline, which blurs.
        c: how deep the negative lobes are, about. Mitchell and Netravali recommend b + 2 c = 1.
        radius: half the width of the support, in pixels: 0.5 to 8; the authors' is 2.

    Raises:
        ValueError: b or c outside of [0, 1], or a radius out of range.
    """

    b: float = 1.0 / 3.0
    c: float = 1.0 / 3.0
    radius: float = 2.0

    def __post_init__(self):
        _check(self, "b", 0.0, 1.0)
        _check(self, "c", 0.0, 1.0)
        _check(self, "radius", 0.5, WIDEST)

    def profile(self, x):
        t, b, c = jnp.abs(x) * (2.0 / self.radius), self.b, self.c
        inner = ((2 - 1.5 * b - c) * t - (3 - 2 * b - c)) * t * t + (1 - b / 3)
        outer = (((-b / 6 - c) * t + (b + 5 * c)) * t - (2 * b + 8 * c)) * t + (4 * b / 3 + 4 * c)
        return jnp.where(t < 1.0, inner, jnp.where(t < 2.0, outer, 0.0))

    @property
    def integral(self) -> float:
        """The integral of the weight over the plane, in pixels^2: that of the profile is 1 where the radius is 2."""
        return (self.radius / 2.0) ** 2


@storable
@dataclasses.dataclass(frozen=True)
class GaussianFilter(Filter):
    """A product of two Gaussians, cut off; ``radius`` is ``cut * sigma``.

    Args:
        sigma: standard deviation, in pixels: 0.05 to 8.
        cut: half the width of the support, in standard deviations: 1 to 10. ``cut * sigma`` must lie between 0.5 and 8
            pixels.

    Raises:
        ValueError: a number or the support out of range.
    """

    sigma: float = 0.5
    cut: float = 3.0
    radius: float = dataclasses.field(init=False, repr=False)

    def __post_init__(self):
        _check(self, "sigma", 0.05, WIDEST)
        _check(self, "cut", 1.0, 10.0)
        object.__setattr__(self, "radius", self.cut * self.sigma)
        _check(self, "radius", 0.5, WIDEST)

    def profile(self, x):
        return jnp.where(jnp.abs(x) <= self.radius, jnp.exp(x * x * (-0.5 / self.sigma**2)), 0.0)

    @property
    def integral(self) -> float:
        """The integral of the weight over the plane, in pixels^2."""
        return 2.0 * math.pi * (self.sigma * math.erf(self.cut / math.sqrt(2.0))) ** 2


def _check(filter, name, low, high):
    """Keep an argument as a float, or refuse it."""
    value = getattr(filter, name)
    if not (is_number(value) and low <= value <= high):
        raise ValueError(f"{type(filter).__name__} {name} must be a number from {low:g} to {high:g}, got {value!r}")
    object.__setattr__(filter, name, float(value))
