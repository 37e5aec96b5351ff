"""What clamping each path length by itself costs: biases add up over lengths.

A path brings c = sum of c_d, the light after d scattering events. Clamped each by itself, the sum of min(c_d, t_d) has
the bias B = sum of B_d(t_d), B_d(t) = E max(c_d - t, 0), whatever the c_d have to do with each other. So one histogram
for each length tells the bias for all limits at once:

    terms = neumann_terms(scene, camera, bounces=5)
    tallies = {f"term {k}": TailHistogram(of=Term(k)) for k in range(6)}
    curves = [clamp_curve(estimate[name]) for name in tallies]

The variance of the clamped sum is not told: it depends on how the c_d vary together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .clamping import ClampCurve


class DepthBias(NamedTuple):
    """Energy lost by path length, ``bias`` and ``stderr`` of shape (D,), and ``total``, with an upper bound of its
    standard error: the sum of the parts', as the terms of one path vary together."""

    bias: np.ndarray
    stderr: np.ndarray
    total: float
    total_stderr: float


def bias_at(curve: ClampCurve, t) -> tuple[np.ndarray, np.ndarray]:
    """Return B(t) and its standard error at any thresholds: exact at the edges of the histogram, and between them too
    large by at most what the curve bends, as B is convex."""
    t = np.asarray(t, np.float64)
    first = curve.threshold[0]
    # Below the smallest sample B falls with slope -1.
    bias = np.interp(t, curve.threshold, curve.bias, right=0.0) + np.maximum(first - t, 0.0)
    return bias, np.interp(t, curve.threshold, curve.bias_stderr, right=0.0)


def bias_by_depth(curves: Sequence[ClampCurve], direct=None, indirect=None) -> DepthBias:
    """Return what limits on direct and indirect light take away, by path length.

    Terms 0 and 1, emission seen directly and light after one event, are direct, as in ``Clamp``. With ``lights`` "nee"
    or "none" an event brings one contribution, and this is the bias of ``Clamp(direct, indirect)``, of its luminance;
    with "mis" it brings two, which are limited one by one, and this bounds their bias from above.

    Args:
        curves: one for each term of ``neumann_terms``, from 0 on.
        direct, indirect: limits; None for none.

    Raises:
        ValueError: no curves, or a limit that is not positive.
    """
    if not len(curves):
        raise ValueError("expected one clamp curve for each path length, got none")
    for limit in (direct, indirect):
        if limit is not None and not limit > 0.0:
            raise ValueError(f"expected a positive limit or None, got {limit!r}")
    limits = [direct if k <= 1 else indirect for k in range(len(curves))]
    found = [(0.0, 0.0) if t is None else bias_at(curve, t) for curve, t in zip(curves, limits, strict=True)]
    bias, stderr = (np.array([float(x) for x in column]) for column in zip(*found, strict=True))
    return DepthBias(bias, stderr, float(bias.sum()), float(stderr.sum()))
