"""What a derivative costs: the Cornell box by all of its colours, its lamp and all of its places.

    python benchmarks/gradient_cost.py [--rounds 7] [--n 4194304]

Times are those of the mean of the image alone, of its interior derivative in reverse mode, of the same by one number in
forward mode, and of the boundary; alternating in one run, medians. For the boundary the time of a sample is given
beside its variance and that of the interior, averaged over parameters in units of the squared derivative. Memory is
what XLA plans for a sweep, by the growth with the number of events. All of it is in
``benchmarks/results/gradient_cost.json``.
"""

import argparse
import dataclasses
import os
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from jaxmc import scenes
from jaxmc.backend import KERNEL_OPTIONS
from jaxmc.gradients.derivative import derivatives
from jaxmc.integration.kernel import TOGETHER, mean_of_row
from jaxmc.integration.samplers import Index, seed_words
from jaxmc.report import machine, versions, write_json

BOUNCES = 5
DEPTHS = (4, 8), (12, 24)
RESULTS = Path(__file__).parent / "results" / "gradient_cost.json"
PARTS = scenes.cornell_box_parts()


def parameters():
    """Return all numbers of the Cornell box: colours, emission, and where everything is."""
    params = []
    for p in PARTS.primitives:
        names = ("center", "radius") if isinstance(p, mc.Sphere) else ("corner", "edge_u", "edge_v")
        numbers = {name: np.asarray(getattr(p, name), float) for name in names}
        numbers["albedo"] = np.broadcast_to(np.asarray(p.material.albedo, float), 3)
        if p.emission is not None:
            numbers["emission"] = np.broadcast_to(np.asarray(p.emission, float), 3)
        params.append(numbers)
    return params


def make(params):
    """Return (scene, camera)."""
    primitives = []
    for p, numbers in zip(PARTS.primitives, params):
        places = {k: v for k, v in numbers.items() if k not in ("albedo",)}
        primitives.append(dataclasses.replace(p, material=mc.Diffuse(numbers["albedo"]), **places))
    return mc.Scene(primitives), mc.PinholeCamera(**PARTS.view, width=256, height=256)


def green(rgb):
    return rgb[1]


def main():
    options = arguments()
    params = parameters()
    value = mc.path_integrand(*make(params), bounces=BOUNCES).map(green)
    whole = derivatives(lambda p: with_green(make(p)), params, "reverse", together=True)
    one = derivatives(lambda a: with_green(make(brighter(params, a))), 1.0, "forward")
    ways = {
        "value": value, "interior, reverse": whole.interior, "interior, one number": one.interior,
        "boundary, reverse": whole.boundary,
    }  # fmt: skip
    times: dict = {name: [] for name in ways}
    for round in range(options.rounds + 1):
        for name, integrand in ways.items():
            start = time.perf_counter()
            mc.integrate(integrand, n=options.n, key=round)
            if round:
                times[name].append(time.perf_counter() - start)
    median = {name: float(np.median(t)) for name, t in times.items()}
    found = {
        "numbers": int(sum(x.size for x in jax.tree.leaves(params))), "n": options.n, "bounces": BOUNCES,
        "seconds": median, "times": times, "of_the_value": {name: t / median["value"] for name, t in median.items()},
    }  # fmt: skip
    found["bytes"] = {f"{a} to {b} events": bytes_per_event(params, a, b) for a, b in DEPTHS}
    found["variance"] = spread(whole)
    for name, ratio in found["of_the_value"].items():
        print(f"{name:22s} {median[name]:7.3f} s  {ratio:.2f} of the value", flush=True)
    print("bytes of a path and event:", found["bytes"], "variances:", found["variance"], flush=True)
    write_json(options.out, found | {"machine": machine(), "versions": versions(), "load": os.getloadavg()})


def bytes_per_event(params, a, b):
    """Return the memory that a path and event of a sweep takes, by the plans for ``a`` and ``b`` events."""

    def planned(bounces):
        swept = derivatives(lambda p: with_green(make(p), bounces), params, "reverse", together=True).interior
        point, low = partial(mc.Independent().point, seed_words(0)), jnp.arange(TOGETHER, dtype=jnp.uint32)

        def sweep(*params):
            integrand = dataclasses.replace(swept, params=params)
            rows = jnp.arange(4, dtype=jnp.uint32)
            return jax.lax.map(
                lambda k: mean_of_row(integrand, point, Index(jnp.full_like(low, k), low), Index(0, 0)), rows
            )

        compiled = jax.jit(sweep, compiler_options=KERNEL_OPTIONS).lower(*swept.params).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    return (planned(b) - planned(a)) / (TOGETHER * (b - a))


def spread(whole, n=1 << 20):
    """Return variances of one sample of both parts, over the squared norm of the whole derivative."""
    found = [mc.integrate(part, n=n, key=1) for part in (whole.interior, whole.boundary)]
    means, errors = ([np.concatenate([np.ravel(x) for x in jax.tree.leaves(t)]) for t in trees] for trees in (
        [f.mean for f in found], [f.stderr for f in found]
    ))  # fmt: skip
    size = float(np.sum((means[0] + means[1]) ** 2))
    return {name: float(n * np.sum(e**2) / size) for name, e in zip(("interior", "boundary"), errors)}


def with_green(scene_and_camera, bounces=BOUNCES):
    made = mc.moving_paths(*scene_and_camera, bounces=bounces)
    return made._replace(interior=made.interior.map(green), boundary=made.boundary.map(green))


def brighter(params, amount):
    return [{**p, "emission": p["emission"] * amount} if "emission" in p else p for p in params]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="runs of each")
    parser.add_argument("--n", type=int, default=1 << 22, help="samples of a run")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
