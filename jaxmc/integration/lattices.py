"""Rank-1 lattice points."""

import dataclasses

import jax.numpy as jnp

from .nets import power_of_two, reverse_bits
from .samplers import EvenPoint, Index, as_word, fraction
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


class _LatticePoint(EvenPoint):
    def __init__(self, *args):
        super().__init__(*args)
        self.mirrored = reverse_bits(self.number)

    def __getitem__(self, dimension):
        """Return coordinate ``dimension``, an integer, a traced integer or an array of them."""
        dimension = as_word(dimension)
        bits = self.bits(dimension)
        if not self.sampler.shift:
            return fraction(bits, jnp.uint32(0))
        # The further digits are those of the shift, which all points share.
        return fraction(self.known(dimension, bits, self.own.bits(dimension)), self.key.further_bits(dimension))

    def bits(self, dimension):
        """Return the 32 leading binary digits of a coordinate."""
        x = self.mirrored * self.row(dimension)
        if self.sampler.shift:
            x = x + self.key.bits(dimension)
        # Fold the upper half back: its complement, and either way twice the value.
        return (x ^ (jnp.uint32(0) - (x >> 31))) << 1 if self.sampler.tent else x
