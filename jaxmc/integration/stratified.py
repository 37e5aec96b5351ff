"""Stratified points: Latin hypercubes and jittered grids in pairs of coordinates."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .samplers import GOLDEN, EvenPoint, Index, as_word, divide, mix

ROUNDS = 8  # measured: with 4, images of pairs are uneven by up to 40 % for small n


@dataclasses.dataclass(frozen=True)
class LatinHypercube:
    """Latin hypercube points: each coordinate alone has exactly one point in each of n equal intervals.

    Takes away the part of the variance that is a sum of functions of one coordinate (McKay, Beckman and Conover 1979;
    Stein 1987). n is the number of points in a randomisation, at most 2^31. Points are no sequence: for another n all
    are others.
    """

    independent = extensible = False

    def tables(self, n, dim):
        return (_checked(n),)

    def points(self, n):
        return n

    def point(self, seed, index: Index, n):
        return _LatinPoint(self, seed, index, jnp.asarray(n))


class _LatinPoint(EvenPoint):
    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        stratum = permute(self.number, self.table, self.key.bits(dimension))
        return _inside(stratum, self.own[dimension], self.table)


@dataclasses.dataclass(frozen=True)
class Stratified:
    """Jittered grids: each pair of coordinates (0, 1), (2, 3), ... has one point in each cell of a grid of about
    sqrt(n) by sqrt(n), and pairs are shuffled against each other.

    n is the number of points in a randomisation, at most 2^31; where the cells are more than n, some are left out at
    random. Points are no sequence: for another n all are others.

    Attributes:
        correlated: multi-jittered (Kensler 2013): in addition each coordinate of a pair alone falls evenly into as many
            intervals as there are cells. False: jittered independently in each cell (Cook, Porter and Carpenter 1984).
    """

    correlated: bool = True
    independent = extensible = False

    def tables(self, n, dim):
        across = int(np.ceil(np.sqrt(float(_checked(n)))))
        return (np.array([across, -(-int(n) // across)], np.uint32),)

    def points(self, n):
        return n

    def point(self, seed, index: Index, grid):
        return _JitteredPoint(self, seed, index, jnp.asarray(grid))


class _JitteredPoint(EvenPoint):
    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        dimension = as_word(dimension)
        second = (dimension & 1) == 1
        key, (across, down) = self.key.bits(dimension >> 1), self.table
        cell = permute(self.number, across * down, key)
        row, column = divide(cell, across, 1.0 / across.astype(float))
        mine, other = jnp.where(second, row, column), jnp.where(second, column, row)
        size, others = jnp.where(second, down, across), jnp.where(second, across, down)
        jitter = self.own[dimension]
        if self.sampler.correlated:
            # Divide each column among its cells, in an order that all columns share.
            mine, size = mine * others + permute(other, others, mix(key + dimension)), size * others
        return _inside(mine, jitter, size)


def _checked(n):
    if not 0 < n <= 1 << 31:
        raise ValueError(f"stratified points number at most 2^31 in a randomisation, got n={n}; use more replicates")
    return np.uint32(n)


def _inside(stratum, jitter, n):
    """Return the number at ``jitter`` in interval ``stratum`` of n."""
    kind = jitter.dtype
    # Keep off the ends by what rounding may add, so that no point leaves its interval.
    margin = jnp.minimum(n.astype(kind) * (2.0 * jnp.finfo(kind).eps), 0.5)
    return (stratum.astype(kind) + (margin + jitter * (1.0 - 2.0 * margin))) / n.astype(kind)


def permute(i, n, key):
    """Return where i < n goes under a permutation of 0 .. n - 1 that ``key`` picks.

    A keyed permutation of the words of as many bits as n - 1 has, repeated while the result lies outside (cycle
    walking, Black and Rogaway 2002), and a rotation. Numbers from n on, which idle lanes have, count as n - 1.
    """
    bits = 32 - jax.lax.clz(jnp.maximum(n, 2) - 1)
    mask = (jnp.uint32(2) << (bits - 1)) - 1
    half = (bits + 1) >> 1
    keys = [mix(key + jnp.uint32(GOLDEN) * jnp.uint32(k)) for k in range(2 * ROUNDS)]

    def walk(x):
        # Each step can be undone: an odd factor, an added constant, a shift to the right.
        for factor, term in zip(keys[::2], keys[1::2]):
            x = (x * (factor | 1) + term) & mask
            x = x ^ (x >> half)
        return x

    shape = jnp.broadcast_shapes(jnp.shape(i), jnp.shape(key), jnp.shape(n))
    first = walk(jnp.minimum(jnp.broadcast_to(i, shape), n - 1))
    x = jax.lax.while_loop(lambda x: (x >= n).any(), lambda x: jnp.where(x >= n, walk(x), x), first)
    random = mix(key + jnp.uint32(GOLDEN) * jnp.uint32(2 * ROUNDS)).astype(float)
    turn = (random * (2.0**-32 * n.astype(float))).astype(jnp.uint32)
    x = x + jnp.minimum(turn, n - 1)
    return jnp.where(x >= n, x - n, x)
