"""How many coordinates a second each sampler makes on one core, and how many operations one coordinate takes.

    python benchmarks/coordinates.py [--rounds 7]

The kernel adds up all coordinates of its points inside a loop, so that none is stored. The operations are those of the
compiled loop body over its lanes, counted in XLA's optimised program; products of 32-bit integers and conversions count
as one like all others. Everything lands in ``benchmarks/results/coordinates.json``.
"""

import argparse
import re
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from jaxmc.backend import KERNEL_OPTIONS
from jaxmc.integration.kernel import LANES
from jaxmc.integration.samplers import Index, seed_words
from jaxmc.report import machine, versions, write_json

RESULTS = Path(__file__).parent / "results" / "coordinates.json"
DIM = 16
ROWS = 2048
SAMPLERS = (
    mc.Independent(),
    mc.Lattice(tent=False),
    mc.Lattice(),
    mc.Sobol(),
    mc.Stratified(),
    mc.LatinHypercube(),
    mc.Halton(),
)


@partial(jax.jit, static_argnames="sampler", compiler_options=KERNEL_OPTIONS)
def total(seed, tables, first, *, sampler):
    """Return sums over ROWS x LANES points of all DIM coordinates, lane by lane."""

    def row(r, sums):
        low = first + r * LANES + jnp.arange(LANES, dtype=jnp.uint32)

        def one(low):
            point = sampler.point(seed, Index(jnp.uint32(0), low), *tables)
            return sum(point[k] for k in range(DIM))

        return sums + jax.vmap(one)(low)

    return jax.lax.fori_loop(jnp.uint32(0), jnp.uint32(ROWS), row, jnp.zeros(LANES))


def operations(text):
    """Return the operations on whole rows in the compiled program, to a coordinate."""
    trivial = {"parameter", "constant", "broadcast", "bitcast", "tuple", "get-tuple-element", "iota", "fusion", "copy"}
    found = re.findall(rf"= \w+\[{LANES}\]\S* ([a-z\-]+)\(", text)
    return sum(word not in trivial for word in found) / DIM


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    seed, count = jnp.asarray(seed_words(0)), ROWS * LANES * DIM
    calls, found = {}, {}
    for sampler in SAMPLERS:
        tables = jax.tree.map(jnp.asarray, sampler.tables(ROWS * LANES, DIM))
        lowered = total.lower(seed, tables, jnp.uint32(0), sampler=sampler).compile()
        calls[sampler] = partial(total, seed, tables, sampler=sampler)
        calls[sampler](jnp.uint32(0)).block_until_ready()
        found[repr(sampler)] = {"operations": operations(lowered.as_text()), "seconds": []}
    for k in range(rounds):
        for sampler, call in calls.items():
            start = time.process_time()
            call(jnp.uint32(k)).block_until_ready()
            found[repr(sampler)]["seconds"].append(time.process_time() - start)
    for name, one in found.items():
        one["per_second"] = count / float(np.median(one["seconds"]))
        print(f"{name:36s} {one['per_second']:9.3g} coordinates/s  {one['operations']:6.1f} operations each")
    write_json(RESULTS, {"samplers": found, "machine": machine(), "versions": versions()})


if __name__ == "__main__":
    main()
