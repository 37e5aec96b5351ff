"""Tables of one number for each face of a scene, looked up by the number of the face."""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .primitives import is_concrete
from .vec import Vec3

SELECT_LIMIT = 24  # look a value up by comparing, below this many faces; by gathering above


@partial(jax.tree_util.register_dataclass, data_fields=["values"], meta_fields=["group"])
@dataclasses.dataclass(frozen=True)
class Lookup:
    """A value for each face: face i has ``values[group[i]]``, so equal values are looked up once; or, of many faces,
    ``values[i]`` of an array, and ``group`` is None.
    """

    values: Any
    group: tuple[int, ...] | None

    def at(self, index):
        """Return the value of face ``index``; any value where there is no such face."""
        if self.group is None:
            return jnp.asarray(self.values).at[index].get(mode="clip")
        if len(self.values) == 1:
            return self.values[0]
        # Start from the commonest value.
        common = max(set(self.group), key=self.group.count)
        value = self.values[common]
        for i, g in enumerate(self.group):
            if g != common:
                value = jnp.where(index == i, self.values[g], value)
        return value


def lookup(values) -> Lookup:
    """Return the table of one number for each face."""
    values = list(values) or [0.0]  # an empty scene has tables too
    known, many = is_concrete(values), len(values) > SELECT_LIMIT
    if not known:
        return Lookup(jnp.stack(values), None) if many else Lookup(tuple(values), tuple(range(len(values))))
    # Compare as the kernel will: rounding must not decide what a kernel contains.
    array = np.asarray(values, jnp.result_type(float))
    distinct = list(dict.fromkeys(array.tolist()))
    if many and len(distinct) > 1:
        return Lookup(array, None)
    return Lookup(tuple(distinct), tuple(distinct.index(v) for v in array.tolist()))


def lookups(vectors):
    """Return the table of one number or one ``Vec3`` for each face."""
    if not isinstance(vectors[0] if vectors else 0.0, Vec3):
        return lookup(vectors)
    return Vec3(*(lookup([v[k] for v in vectors]) for k in range(3)))


def is_among(faces: tuple[int, ...], index, count: int):
    """Return whether face ``index``, of ``count``, is one of ``faces``."""
    if len(faces) > SELECT_LIMIT:
        flags = np.zeros(count, bool)
        flags[list(faces)] = True
        return jnp.asarray(flags).at[index].get(mode="clip") & (index >= 0)
    found = jnp.zeros((), bool)
    for i in faces:
        found = found | (index == i)
    return found
