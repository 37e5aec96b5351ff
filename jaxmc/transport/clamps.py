"""Clamping: of whole samples, of the contributions inside a path, or of its throughput.

A value that is not finite stays so: it is scaled by 0 or by 1, never replaced by the limit.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp

from ..integration.counts import is_count
from .materials import luminance
from .primitives import is_number
from .vec import Vec3, larger

NORMS = ("luminance", "maximum", "sum", "channel")


@dataclasses.dataclass(frozen=True)
class Clamp:
    """Limits of what a path may bring. At least one is a number; None is no limit.

    Attributes:
        sample: limit of the whole sample, in radiance. Cameras apply it last, as Arnold's ``AA_sample_clamp`` does.
        direct, indirect: limits of each contribution, in radiance, when the path collects it. A scattering event has
            two: what light sampling brings there, from a light and from the sky together, and what the next ray meets.
            With ``lights="mis"`` each is weighted before it is limited. ``direct`` is for the first event and for
            emission that the camera, or a ``radiance`` ray, sees by itself, ``indirect`` for all later events: so light
            reached from the first vertex is direct, by whichever way, and light seen over a mirror is indirect. That is
            the rule of Cycles, whose limits bound the sum of three channels and are multiplied by 3 before:
            ``norm="sum"``. Of an ``irradiance`` the receiver's own light is direct. Arnold's ``indirect_sample_clamp``
            limits indirect contributions only.
        throughput: limit of the throughput after each event, before Russian roulette and before the path goes on. It
            limits all that the path collects later, and what its next ray meets.
        norm: what is limited: "luminance"; "maximum", the largest channel, as pbrt's ``maxComponentValue``; "sum", of
            the channels against three times the limit; or "channel", each by itself, which shifts hues. The first three
            scale all channels alike. In a grey scene they are the same.

    The bias is downward: the energy lost. That of ``direct`` and ``indirect`` is a sum over path lengths, which
    ``neumann_terms`` and ``analysis.depths`` tell for all limits at once; that of ``throughput`` is not.

    Sources: Blender Cycles, ``film_clamp_light``; Arnold 5, render options; pbrt-v4, ``RGBFilm``.

    Raises:
        ValueError: a limit that is no positive number, none at all, or an unknown norm.
    """

    sample: float | None = None
    direct: float | None = None
    indirect: float | None = None
    throughput: float | None = None
    norm: str = "luminance"

    def __post_init__(self):
        limits = {name: getattr(self, name) for name in ("sample", "direct", "indirect", "throughput")}
        for name, limit in limits.items():
            if limit is None:
                continue
            if not (is_number(limit) and 0.0 < limit < float("inf")):
                raise ValueError(f"{name} must be a positive limit or None, got {limit!r}")
            object.__setattr__(self, name, float(limit))
        if all(limit is None for limit in limits.values()):
            raise ValueError("a clamp needs at least one limit: mc.Clamp(sample=3.0), or leave clamp out")
        if not isinstance(self.norm, str) or self.norm not in NORMS:
            raise ValueError(f"norm must be one of {', '.join(NORMS)}, got {self.norm!r}")

    def of_sample(self, value):
        """Return the radiance of a whole path, limited."""
        return value if self.sample is None else clamped(value, self.sample, self.norm)

    def of_contribution(self, value, depth):
        """Return what a path collects after ``depth`` earlier events, limited."""
        limits = [jnp.inf if limit is None else limit for limit in (self.indirect, self.direct)]
        if limits == [jnp.inf, jnp.inf]:
            return value
        return clamped(value, jnp.where(depth > 0, *limits), self.norm)

    def of_throughput(self, beta):
        """Return the throughput of a path that goes on, limited."""
        return beta if self.throughput is None else clamped(beta, self.throughput, self.norm)


def as_clamp(clamp) -> Clamp | None:
    """Return a ``Clamp`` as it is, or a number as the largest luminance of a sample."""
    if clamp is None or isinstance(clamp, Clamp):
        return clamp
    if not (is_number(clamp) and 0.0 < clamp < float("inf")):
        raise ValueError(f"clamp must be a positive luminance, an mc.Clamp or None, got {clamp!r}")
    return Clamp(sample=clamp)


def clamped(value, limit, norm="luminance"):
    """Return a colour, a ``Vec3`` or a number, that does not exceed ``limit`` in the sense of a norm of ``Clamp``."""
    if not isinstance(value, Vec3):
        return value * _scale(value, limit)
    if norm == "channel":
        return Vec3(*(c * _scale(c, limit) for c in value))
    sizes = {
        "luminance": luminance,
        "maximum": lambda c: larger(larger(c.x, c.y), c.z),
        "sum": lambda c: (c.x + c.y + c.z) * (1.0 / 3.0),
    }
    return value * _scale(sizes[norm](value), limit)


def _scale(size, limit):
    # Divide by what exceeds the limit only: the derivative at 0 is then that of 1.
    exceeds = size > limit
    return jnp.where(exceeds, limit / jnp.where(exceeds, size, 1.0), 1.0)


def clamp_luminance(value, threshold):
    """Scale values down to luminance ``threshold`` where they exceed it; channels, if any, on the last axis."""
    y = luminance(value)
    scale = _scale(y, threshold)
    return value * (scale if jnp.shape(value) == jnp.shape(y) else scale[..., None])


@dataclasses.dataclass(frozen=True)
class ClampLevels:
    """What a value becomes at each of some limits and without, least limit first: the levels for ``debias``.

    ``integrand.map(ClampLevels((3.0, 30.0)))`` has one more axis in front, of length 3: clamped at 3, at 30, and as it
    is. Arrays are limited in luminance; channels, if any, on the last axis.
    """

    thresholds: tuple[float, ...]

    def __call__(self, value):
        return jnp.stack([*(clamp_luminance(value, t) for t in self.thresholds), value])


@dataclasses.dataclass(frozen=True)
class Term:
    """The luminance of term ``k`` of ``neumann_terms``, for tallies: ``TailHistogram(of=Term(2))``.

    The value that it takes has two sample axes, then the terms, then the channels, if any.
    """

    k: int

    def __post_init__(self):
        if not is_count(self.k, least=0):
            raise ValueError(f"k must be the number of a term, an integer >= 0, got {self.k!r}")

    def __call__(self, values: Any):
        if values.ndim not in (3, 4) or not self.k < values.shape[2]:
            raise ValueError(f"expected samples of neumann_terms with more than {self.k} terms, got {values.shape}")
        # Three terms are no channels: where there are channels, there is one more axis.
        return values[:, :, self.k] if values.ndim == 3 else luminance(values[:, :, self.k])
