"""Rank-1 lattice points."""

import dataclasses

import jax
import jax.numpy as jnp

from .nets import beyond, power_of_two, reverse_bits
from .samplers import Independent, Index, as_word, fraction, randomisation
from .tables import MOST_LATTICE, lattice_vector


@dataclasses.dataclass(frozen=True)
class Lattice:
    """A rank-1 lattice, shifted at random: point i is the fraction of i' z + shift, where i' has the binary digits of i
    mirrored at the point, so that any first 2^m points are a lattice.

    The cheapest points there are, three integer operations to a coordinate. For smooth integrands the error falls like
    n^-1 to n^-2, for periodic ones faster. The generating vector z was constructed component by component for all n
    from 2^8 to 2^20 at once (after Cools, Kuo and Nuyens 2006); coordinates beyond its length are independent. At most
    2^32 points in a randomisation; best at powers of two, to which numbers of samples are rounded up.

    Attributes:
        tent: fold each coordinate, u -> 1 - |2u - 1|, which makes any smooth integrand periodic (Hickernell 2002).
        shift: False gives the plain lattice, in which all randomisations are equal: for study, not for estimates.
    """

    tent: bool = True
    shift: bool = True
    independent, extensible = False, True

    def tables(self, n, dim):
        return (lattice_vector(min(dim, MOST_LATTICE)),)

    def points(self, n):
        return power_of_two(n)

    def point(self, seed, index: Index, vector):
        return _LatticePoint(self, seed, index, vector)


class _LatticePoint:
    def __init__(self, sampler, seed, index, vector):
        self.sampler, self.vector, self.mirrored = sampler, vector, reverse_bits(index.low)
        self.key, self.own = randomisation(seed, index), Independent().point(seed, index)

    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        dimension = as_word(dimension)
        low = self.key.bits(dimension | jnp.uint32(1 << 31)) if jax.config.jax_enable_x64 else None
        if not self.sampler.shift:
            return fraction(self.bits(dimension))
        return fraction(beyond(self, dimension, len(self.vector)), low)

    def bits(self, dimension):
        """Return the 32 leading binary digits of a coordinate."""
        z = jnp.asarray(self.vector)[jnp.minimum(dimension, len(self.vector) - 1)]
        x = self.mirrored * z
        if self.sampler.shift:
            x = x + self.key.bits(dimension)
        # Fold the upper half back: its complement, and either way twice the value.
        return (x ^ (jnp.uint32(0) - (x >> 31))) << 1 if self.sampler.tent else x
