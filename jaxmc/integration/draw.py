"""The raw samples behind an estimate, for scripts, plots and other tools."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .counts import is_count, positive
from .integrand import Integrand, as_integrand
from .samplers import Independent, Index, index_words, seed_words


class Samples(NamedTuple):
    """Samples with their coordinates: ``index`` (n,) uint64, ``u`` (n, dim), ``value`` with leading axis n."""

    index: np.ndarray
    u: np.ndarray
    value: Any


def draw(f, *, dim=None, n=None, indices=None, key=0, sampler=Independent(), points=None) -> Samples:
    """Return samples that ``integrate`` takes with the same key and sampler: the first ``n``, or those at ``indices``.

    Points that are not independent have an index whose high word is the randomisation and whose low word is the number
    of the point; the first n are those of randomisation 0. ``points``, n by default, is how many points a randomisation
    has, which ``LatinHypercube`` and ``Stratified`` must know: ``estimate.recipe["points"]``.

    Raises:
        ValueError: neither or both of ``n`` and ``indices``, an index out of [0, 2^64), or no ``points``.
    """
    integrand = as_integrand(f, dim)
    if (n is None) == (indices is None):
        raise ValueError("draw wants either n, for the first n samples, or indices")
    given = np.arange(positive("n", n), dtype=np.uint64) if indices is None else _as_indices(indices)
    tables = point_tables(sampler, integrand.dim, n if points is None else points)
    u, value = _draw(integrand, tables, jnp.asarray(seed_words(key)), index_words(given), sampler=sampler)
    return Samples(given, np.asarray(u), jax.tree.map(np.asarray, value))


def point_tables(sampler, dim, points):
    """Return the tables of a sampler, or raise ``ValueError`` where they depend on a number of points that is None."""
    if points is None and not sampler.extensible:
        raise ValueError(f"{sampler!r} places points by their number: pass points=estimate.recipe['points']")
    return sampler.tables(1 if points is None else positive("points", points), dim)


def is_index(value) -> bool:
    """Return whether ``value`` is an integer in [0, 2^64)."""
    return is_count(value, least=0, most=(1 << 64) - 1)


def _as_indices(indices):
    # NumPy makes floats of a list that holds integers below and above 2^63: look at each by itself.
    given = indices if isinstance(indices, np.ndarray) else np.array(indices, object)
    words = given.ravel().tolist()
    if given.ndim != 1 or not all(map(is_index, words)):
        raise ValueError(f"indices must be a list of integers in [0, 2^64), got {indices!r}")
    return np.array(words, np.uint64)


@partial(jax.jit, static_argnames="sampler")
def _draw(integrand: Integrand, tables, seed, words, *, sampler):
    def one(words):
        point = sampler.point(seed, Index(words[0], words[1]), *tables)
        return point[jnp.arange(integrand.dim)], integrand.at(point)

    return jax.vmap(one)(words)
