"""Pick and freeze: an integrand at pairs of points that share groups of coordinates, for Sobol' indices."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .integrand import Integrand, as_integrand


def before_comma(label: str) -> str:
    """Return the words of a label before the first comma or colon: "event 2" of "event 2, direction: polar"."""
    return label.split(",")[0].split(":")[0]


def coordinate_groups(f: Integrand, group: Callable[[str], str] = before_comma) -> tuple[str, ...]:
    """Return the name of the group of each coordinate, by its label; without labels each is a group by itself."""
    return tuple(map(group, f.labels)) if f.labels else tuple(f"u[{k}]" for k in range(f.dim))


def pick_freeze(
    f, *, dim=None, group: Callable[[str], str] = before_comma, of=None
) -> tuple[Integrand, tuple[str, ...]]:
    """Return an integrand whose covariances hold the Sobol' indices of ``f``, and the names of the groups.

    Its value has shape (2 + groups,): f at two independent points, then for each group at the first point with the
    coordinates of that group from the second. It has twice as many coordinates, and costs 2 + groups evaluations.
    ``sobol_indices`` reads the tally ``Covariance`` over it.

    Args:
        f: an ``Integrand``, or a function of one point together with ``dim``.
        group: returns the name of the group of a coordinate from its label; coordinates without labels are groups by
            themselves. By default the words before the first comma or colon: "film", "event 1", "event 2".
        of: maps the value to one number, such as ``luminance``; None where it is one.

    Raises:
        ValueError: no dimension, a value that is no number, or all coordinates in one group.
    """
    f = as_integrand(f, dim)
    words = coordinate_groups(f, group)
    names = tuple(dict.fromkeys(words))
    if len(names) < 2:
        raise ValueError(
            f"all {f.dim} coordinates are in the group {names[0]!r}: their total index is 1; pass group=..."
        )
    fn = _PickFreeze(f.fn, f.dim, f.lazy, tuple(names.index(w) for w in words), of)
    return Integrand(fn, 2 * f.dim, f.params, lazy=f.lazy), names


@dataclasses.dataclass(frozen=True)
class _PickFreeze:
    fn: Callable[..., Any]
    dim: int
    lazy: bool
    groups: tuple[int, ...]
    of: Callable[[Any], Any] | None

    def __call__(self, u, *params):
        count = max(self.groups) + 1

        def value(picked):
            point = _Mixed(u, self.dim, jnp.asarray(self.groups), picked, count)
            x = self.fn(point if self.lazy else point[jnp.arange(self.dim)], *params)
            x = x if self.of is None else self.of(x)
            if jnp.shape(x):
                raise ValueError(f"Sobol' indices are of one number, got a value of shape {jnp.shape(x)}; pass of=...")
            return x

        # One kernel serves all points: which group comes from the second point is a number. One past the last is all.
        return lax.map(value, jnp.array([-1, count, *range(count)], np.int32))


class _Mixed:
    """A point whose coordinates of one group come from the second half of another point, all others from the first."""

    def __init__(self, u, dim, groups, picked, everything):
        self.u, self.dim, self.groups, self.picked, self.everything = u, dim, groups, picked, everything

    def __getitem__(self, k):
        second = (self.groups[k] == self.picked) | (self.picked == self.everything)
        return self.u[k + self.dim * second]
