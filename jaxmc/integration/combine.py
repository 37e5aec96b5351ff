"""One mean from several estimates of the same integral."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .estimate import Estimate


class Combined(NamedTuple):
    mean: np.ndarray  # float64, in the shape of the estimates
    stderr: np.ndarray


def combine(estimates: Sequence[Estimate], rule: str = "pooled") -> Combined:
    """Return one mean of independent estimates of the same integral, numbers or arrays of one shape.

    ``"pooled"`` weighs by the number of samples, and is as unbiased as the estimates are. ``"inverse variance"`` weighs
    by 1 / stderr^2, as the vegas package does. It is biased and loses fireflies: estimates that missed the bright
    samples have the smaller error and count most, those without any variance count alone. It is an object of study.
    Raises ``ValueError`` for no estimates, values that are not arrays of one shape, two with one key, or another rule.
    """
    estimates = list(estimates)
    if rule not in ("pooled", "inverse variance"):
        raise ValueError(f'rule must be "pooled" or "inverse variance", got {rule!r}')
    means, errors = ([np.asarray(getattr(e, name)) for e in estimates] for name in ("mean", "stderr"))
    if len({x.shape for x in means}) != 1 or any(x.dtype == object for x in means):
        raise ValueError(f"combine wants estimates with values of one shape, got {[str(e) for e in estimates]}")
    keys = [str(e.recipe["key"]) for e in estimates if "key" in e.recipe]
    if len(set(keys)) < len(keys):
        raise ValueError(f"estimates must be independent, got keys {keys}; integrate each with a key of its own")
    mean, stderr = np.stack(means).astype(float), np.stack(errors).astype(float)
    weight = np.stack([np.full(mean.shape[1:], float(e.n)) for e in estimates])
    if rule == "inverse variance":
        sure = stderr == 0.0
        weight = np.where(sure.any(0), sure, 1.0 / np.where(sure, 1.0, stderr) ** 2)
    weight = weight / weight.sum(0)
    return Combined((weight * mean).sum(0), np.sqrt(((weight * stderr) ** 2).sum(0)))
