"""The raw samples behind an estimate, for scripts, plots and other tools."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .driver import positive
from .integrand import Integrand, as_integrand
from .samplers import Independent, Index, index_words, seed_words


class Samples(NamedTuple):
    """Samples with their coordinates: ``index`` (n,) uint64, ``u`` (n, dim), ``value`` with leading axis n."""

    index: np.ndarray
    u: np.ndarray
    value: Any


def draw(f, *, dim=None, n=None, indices=None, key=0, sampler=Independent()) -> Samples:
    """Return samples that ``integrate`` takes with the same key and sampler: the first ``n``, or those at ``indices``.

    Raises:
        ValueError: neither or both of ``n`` and ``indices``, or an index out of [0, 2^64).
    """
    integrand = as_integrand(f, dim)
    if (n is None) == (indices is None):
        raise ValueError("draw wants either n, for the first n samples, or indices")
    if indices is None:
        indices = np.arange(positive("n", n), dtype=np.uint64)
    given = np.asarray(indices)
    if given.ndim != 1 or given.dtype.kind not in "iu" or (given.dtype.kind == "i" and (given < 0).any()):
        raise ValueError(f"indices must be a list of integers in [0, 2^64), got {indices!r}")
    u, value = _draw(integrand, jnp.asarray(seed_words(key)), index_words(given), sampler=sampler)
    return Samples(given.astype(np.uint64), np.asarray(u), jax.tree.map(np.asarray, value))


@partial(jax.jit, static_argnames="sampler")
def _draw(integrand: Integrand, seed, words, *, sampler):
    def one(words):
        point = sampler.point(seed, Index(words[0], words[1]))
        return point[jnp.arange(integrand.dim)], integrand.at(point)

    return jax.vmap(one)(words)
