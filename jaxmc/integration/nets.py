"""Digital sequences: Sobol' and Halton points, with random digits scrambled."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .samplers import GOLDEN, EvenPoint, Index, as_word, divide, fraction, mix
from .tables import MOST_SOBOL, primes, sobol_matrices

MOST_HALTON = 1024


@dataclasses.dataclass(frozen=True)
class Sobol:
    """Sobol' points, Owen-scrambled: any 2^m of them are a net, evenly spread over boxes of volume 2^-m.

    For smooth integrands the error falls like n^-1.5. Direction numbers of Joe and Kuo (2008) for 2048 dimensions;
    further coordinates are independent. At most 2^32 points in a randomisation; best at powers of two, to which numbers
    of samples are rounded up.

    Scrambling is nested and uniform (Owen 1995), by an integer hash in which no digit depends on later ones (Laine and
    Karras 2011, with the multipliers of Vegdahl 2021; Burley 2020).

    Attributes:
        scramble: False gives the plain sequence, in which all randomisations are equal: for study, not for estimates.
    """

    scramble: bool = True
    independent, extensible = False, True

    def tables(self, n, dim):
        # Store the digits of a matrix in reverse: the scrambling hash wants the first digit lowest.
        return (reverse_bits(sobol_matrices(min(dim, MOST_SOBOL))),)

    def points(self, n):
        return power_of_two(n)

    def point(self, seed, index: Index, matrices):
        return _SobolPoint(self, seed, index, matrices)


class _SobolPoint(EvenPoint):
    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        dimension = as_word(dimension)
        bits = self.bits(dimension)
        if not self.sampler.scramble:
            return fraction(bits, jnp.uint32(0))
        return fraction(self.known(dimension, bits, self.own.bits(dimension)), self.own.further_bits(dimension))

    def bits(self, dimension):
        """Return the 32 leading binary digits of a coordinate."""
        row, digits = self.row(dimension), jnp.uint32(0)
        for j in range(32):
            chosen = jnp.uint32(0) - ((self.number >> j) & 1)
            digits = digits ^ (row[..., j] & chosen)
        if self.sampler.scramble:
            digits = _permute_nested(digits, self.key.bits(dimension))
        return reverse_bits(digits)


def _permute_nested(x, seed):
    """Permute words so that bit k of the result depends on bits 0 .. k alone."""
    x = x ^ (x * jnp.uint32(0x3D20ADEA))
    x = (x + seed) * ((seed >> 16) | 1)
    x = x ^ (x * jnp.uint32(0x05526C56))
    return x ^ (x * jnp.uint32(0x53A22864))


def reverse_bits(x):
    """Return 32-bit words with their bits in reverse order: halves are exchanged, then quarters, and so on."""
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        mask = np.uint32(mask)
        x = ((x >> np.uint32(shift)) & mask) | ((x & mask) << np.uint32(shift))
    return x


def power_of_two(n):
    """Return the smallest power of two that is at least n."""
    return 1 << (n - 1).bit_length()


@dataclasses.dataclass(frozen=True)
class Halton:
    """Halton points in the first 1024 prime bases, scrambled; further coordinates are independent.

    Good for any number of points, below Sobol' points in more than some ten dimensions. Each digit is mapped by a
    random affine permutation that depends on all digits before it, so every point is uniformly distributed (Owen 1995;
    Matousek 1998 for affine maps). At most 2^32 points in a randomisation.

    Attributes:
        scramble: False gives the plain sequence, in which all randomisations are equal: for study, not for estimates.
    """

    scramble: bool = True
    independent, extensible = False, True

    def tables(self, n, dim):
        return (primes(min(dim, MOST_HALTON)),)

    def points(self, n):
        return n

    def point(self, seed, index: Index, bases):
        return _HaltonPoint(self, seed, index, bases)


class _HaltonPoint(EvenPoint):
    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        dimension = as_word(dimension)
        inside = self._radical_inverse(self.row(dimension), self.key.bits(dimension), self.own[dimension])
        return self.known(dimension, inside, self.own[dimension]) if self.sampler.scramble else inside

    def _radical_inverse(self, base, key, rest):
        """Mirror the digits of the number at the radix point, from the first digit on."""
        kind = jnp.result_type(float)
        step = 1.0 / base.astype(kind)
        shape = jnp.broadcast_shapes(jnp.shape(self.number), jnp.shape(base))
        number = jnp.broadcast_to(self.number, shape)

        def digit(carry):
            number, before, place, weight, value = carry
            number, d = divide(number, base, step)
            if self.sampler.scramble:
                random = mix(before + key)
                shift, factor = _below(random, base), 1 + _below(mix(random + jnp.uint32(GOLDEN)), base - 1)
                image = divide(factor * d + shift, base, step)[1]
            else:
                image = d
            # Remember all digits so far, each at its place, in one word.
            before, place = before + mix(d + place), place * jnp.uint32(0x846CA68B) + 1
            return number, before, place, weight * step, value + image.astype(kind) * weight

        def unfinished(carry):
            return (carry[3] > 2.0**-32).any()

        zero, one = jnp.zeros(shape, jnp.uint32), jnp.ones(shape, jnp.uint32)
        start = number, zero, one, jnp.broadcast_to(step, shape), jnp.zeros(shape, kind)
        *_, weight, value = jax.lax.while_loop(unfinished, digit, start)
        if self.sampler.scramble:
            value = value + rest * weight * base.astype(kind)
        return jnp.clip(value, 2.0**-33 if self.sampler.scramble else 0.0, 1.0 - jnp.finfo(kind).epsneg)


def _below(random, bound):
    """Map a random word to an integer below ``bound`` < 2^16: the high word of their product."""
    return ((random >> 16) * bound + (((random & 0xFFFF) * bound) >> 16)) >> 16
