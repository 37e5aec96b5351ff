"""Write the random bits of ``Independent`` to standard output, for a test of random numbers such as dieharder.

    python benchmarks/random_bits.py indices | dieharder -g 200 -a

The 32-bit words behind the coordinates are read along ``indices`` (dimension 0 of samples 0, 1, 2, ...), ``dimensions``
(1024 coordinates of sample 0, then those of sample 1, ...) or ``seeds`` (the first coordinate of sample 0, with the
plain numbers 0, 1, 2, ... in the first two of the four seed words; ``seed_words`` would mix them first, which makes it
easier and is slow). The stream ends when nobody reads any more.
"""

import argparse
import sys

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from jaxmc.integration.samplers import Index, index_words, seed_words

CHUNK = 1 << 20  # words
DIMENSIONS = 1024


@jax.jit
def _words(seeds, indices, dimensions):
    def one(seed, index, dimension):
        return mc.Independent().point(seed, Index(index[0], index[1])).bits(dimension)

    return jax.vmap(one)(seeds, indices, dimensions)


def words(order, first):
    """Return words ``first`` to ``first + CHUNK`` of a stream."""
    numbers = np.arange(first, first + CHUNK, dtype=np.uint64)
    zero = np.zeros(CHUNK, np.uint64)
    index, dimension = {"indices": (numbers, zero), "seeds": (zero, zero)}.get(
        order, (numbers // np.uint64(DIMENSIONS), numbers % np.uint64(DIMENSIONS))
    )
    seeds = np.broadcast_to(seed_words(0), (CHUNK, 4)).copy()
    if order == "seeds":
        seeds[:, :2] = index_words(numbers)[:, ::-1]
    return np.asarray(_words(jnp.asarray(seeds), index_words(index), dimension.astype(np.uint32)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("order", choices=("indices", "dimensions", "seeds"))
    order, first = parser.parse_args().order, 0
    try:
        while True:
            sys.stdout.buffer.write(words(order, first).tobytes())
            first += CHUNK
    except BrokenPipeError:
        sys.stderr.close()


if __name__ == "__main__":
    main()
