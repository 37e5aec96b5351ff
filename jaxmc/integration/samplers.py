"""Samplers: random access from (seed, sample index, dimension) to a coordinate in (0, 1).

A sampler has no state. Coordinates are computed inside the kernel in 32-bit integer arithmetic, so a sample depends on
its index alone: not on chunk size, thread, device or machine, and any sample can be replayed.

A sampler is a hashable object with

* ``tables(n, dim)``: a tuple of arrays that its points need, for n points in each randomisation and dim coordinates;
* ``point(seed, index, *tables)``: one point, whose coordinate k is ``point[k]``;
* ``points(n)``: how many points a randomisation must have to hold n at its best;
* ``independent``: whether all points are independent. If not, an index is a randomisation (high word) and the number of
  a point in it (low word): points of one randomisation fill the cube evenly, randomisations are independent;
* ``extensible``: whether the points stay where they are as n grows.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .counts import is_count

GOLDEN = 0x9E3779B9  # 2^32 / golden ratio, odd: spreads consecutive dimensions over the words
KEY_WORDS = np.random.SeedSequence(GOLDEN).generate_state(4, np.uint32)  # from which those of a key are made
PILOT = 0x70696C6F  # keeps the samples of pilots apart from those of runs with the same key


class Index(NamedTuple):
    """A 64-bit sample index as two 32-bit words."""

    high: jax.Array
    low: jax.Array

    def __add__(self, offset):
        """Add a 32-bit unsigned offset, with carry."""
        low = self.low + offset
        return Index(self.high + (low < self.low).astype(jnp.uint32), low)


def index_words(index) -> np.ndarray:
    """Return the (high, low) words of integers below 2^64, shape ``(..., 2)``."""
    index = np.asarray(index, dtype=np.uint64)
    return np.stack([index >> np.uint64(32), index & np.uint64(0xFFFFFFFF)], axis=-1).astype(np.uint32)


def seed_words(key) -> np.ndarray | jax.Array:
    """Return four 32-bit words from a seed: an integer in [0, 2^64) or a ``jax.random`` key, which may be traced."""
    if isinstance(key, jax.Array):
        data = jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key
        # One key has two words or four; other arrays are no keys, and a batch of keys is not one.
        if data.dtype == np.uint32 and data.shape in ((2,), (4,)):
            return mix(mix(data[-1] ^ KEY_WORDS) + data[-2])
    if not is_count(key, least=0, most=(1 << 64) - 1):
        raise ValueError(f"key must be an integer in [0, 2^64) or a jax.random key, got {key!r}")
    # Spread the seed over four words, so that neighbouring seeds share nothing.
    return np.random.SeedSequence(int(key)).generate_state(4, np.uint32)


def pilot_key(key) -> int:
    """Return the seed of a pilot: 64 mixed bits, so none that a user would choose, nor ``key`` itself."""
    return int(np.random.SeedSequence([*seed_words(key).tolist(), PILOT]).generate_state(1, np.uint64)[0])


class Independent:
    """Independent uniform points: a counter-based integer hash of (seed, index, dimension).

    Each index is first mixed with the seed into two 32-bit words; each coordinate then takes one further mix of both
    words and the dimension. A coordinate is a multiple of 2^-32 plus 2^-33, rounded to the floating type and kept
    below 1: it resolves the interval next to 0 down to 2^-33 and never equals 0 or 1. With ``jax_enable_x64`` it is a
    multiple of 2^-52 plus 2^-53, exactly, and its leading 32 bits are the same.
    """

    independent = extensible = True

    def __eq__(self, other):
        return type(other) is type(self)

    def __hash__(self):
        return hash(type(self))

    def __repr__(self):
        return "Independent()"

    def tables(self, n, dim):
        return ()

    def points(self, n):
        return n

    def point(self, seed, index: Index) -> "Point":
        """Return the lazy point of one sample. ``seed`` holds the four words of ``seed_words``."""
        first = mix(mix(index.low ^ seed[0]) + index.high + seed[1])
        second = mix(mix(index.low * jnp.uint32(0x85EBCA6B) + seed[2]) ^ (index.high + seed[3]))
        return Point(first, second)


class Point:
    """One point of the unit hypercube that computes a coordinate when it is asked for."""

    def __init__(self, first, second):
        self.first, self.second = first, second

    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        bits = self.bits(dimension)
        low = self.further_bits(dimension)
        if low is not None:
            return fraction(bits, low)
        u = bits.astype(jnp.float32) * 2.0**-32 + 2.0**-33
        return jnp.where(u < 1.0, u, 1.0 - 2.0**-24)

    def bits(self, dimension):
        """Return 32 random bits."""
        x = self.first + jnp.uint32(GOLDEN) * as_word(dimension)
        x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D)
        x = x ^ self.second
        x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
        return x ^ (x >> 16)

    def further_bits(self, dimension):
        """Return 32 more random bits for float64, those of a dimension that nobody can name, with the top bit set; None
        in float32, which has no room for them."""
        return self.bits(as_word(dimension) | jnp.uint32(1 << 31)) if jax.config.jax_enable_x64 else None


class EvenPoint:
    """One of the points that fill the cube evenly together: its ``number`` among them, the random words ``key`` that
    all share, and its ``own`` independent point. Coordinates beyond the ``table`` of the sampler are taken from that.
    """

    def __init__(self, sampler, seed, index: Index, table=None):
        self.sampler, self.number, self.table = sampler, index.low, table
        self.key = Independent().point(seed ^ jnp.uint32(GOLDEN), Index(index.high, jnp.zeros_like(index.high)))
        self.own = Independent().point(seed, index)

    def row(self, dimension):
        """Return what the table holds for a dimension; beyond it, its last row."""
        return jnp.asarray(self.table)[jnp.minimum(dimension, len(self.table) - 1)]

    def known(self, dimension, inside, beyond):
        """Return ``inside`` where the table holds the dimension, else ``beyond``."""
        return jnp.where(dimension < len(self.table), inside, beyond)


def mix(x):
    """Permute the 32-bit words so that every input bit reaches every output bit.

    Shifts and multipliers: C. Wellons 2018, "Prospecting for Hash Functions" (lowbias32).
    """
    x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D)
    x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
    return x ^ (x >> 16)


def as_word(dimension):
    """Return a dimension, a number or an array of them, as unsigned 32-bit integers."""
    return jnp.asarray(dimension).astype(jnp.uint32)


def fraction(bits, low):
    """Return the number in (0, 1) with the binary digits ``bits`` behind the point, cut to what the type can hold.

    Cut and not rounded: a point never leaves its cell of a stratification, not even by an error of the last place.
    ``low`` holds further digits, for float64.
    """
    if jax.config.jax_enable_x64:
        low = low >> 12
        return (bits.astype(jnp.float64) * 2.0**20 + low.astype(jnp.float64) + 0.5) * 2.0**-52
    # Clear what lies behind 24 leading digits: as many as the top byte is long.
    excess = bits >> 24
    excess = excess | (excess >> 1)
    excess = excess | (excess >> 2)
    excess = excess | (excess >> 4)
    return jnp.maximum((bits & ~excess).astype(jnp.float32) * 2.0**-32, 2.0**-33)


def divide(number, base, inverse):
    """Return quotient and remainder of 32-bit ``number`` by ``base`` < 2^16, in vector code: integers have no division
    there. ``inverse`` is 1 / base in floating point."""
    high = _quotient(number >> 16, base, inverse)
    rest = (((number >> 16) - high * base) << 16) | (number & 0xFFFF)
    low = _quotient(rest, base, inverse)
    return (high << 16) + low, rest - low * base


def _quotient(number, base, inverse):
    q = (number.astype(inverse.dtype) * inverse).astype(jnp.uint32)
    # Rounding leaves it at most one off.
    q = jnp.where(q * base > number, q - 1, q)
    return jnp.where(number - q * base >= base, q + 1, q)
