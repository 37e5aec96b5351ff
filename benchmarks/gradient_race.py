"""Derivatives of the Cornell box: jaxmc against Mitsuba 3, on the same integral, cores and number of paths.

    python benchmarks/gradient_race.py [--rounds 5] [--spp 256] [--edge-spp 16] [--seeds 6] [--peers PYTHON]

Everything: the derivatives of the mean of the image by all colours, the lamp and all places, of paths without edges, in
reverse mode: Mitsuba's ``prb``. What is timed makes as many paths on both sides; runs alternate, times are medians.

Edges: the derivative by one move of a sphere, with what its edges and shadows add: ``prb_projective``. Of several seeds
come a mean and a variance; what counts is variance times time, what a sample of variance 1 would cost.

All of it is in ``benchmarks/results/gradient_race.json``.
"""

import argparse
import os
import time
from pathlib import Path

import gradient_cost
import jax.numpy as jnp
import numpy as np
from peers import Peer

import jaxmc as mc
from jaxmc.gradients.derivative import derivatives
from jaxmc.report import machine, versions, write_json
from jaxmc.transport.mitsuba_scenes import describe

ROOT = Path(__file__).parents[1]
SERVER = Path(__file__).with_name("mitsuba_gradients.py")
RESULTS = ROOT / "benchmarks" / "results" / "gradient_race.json"
BOUNCES, SIZE = gradient_cost.BOUNCES, 64
SPHERE, ALONG = 6, [1.0, 0.0, 0.0]  # what moves at the edges, and where to
NEVER = 1000  # depth at which Russian roulette begins
PARTS = gradient_cost.PARTS


def integrator(name):
    return {"type": name, "max_depth": BOUNCES + 1, "rr_depth": NEVER}


def camera():
    return mc.PinholeCamera(**PARTS.view, width=SIZE, height=SIZE)


def moving(params):
    scene, _ = gradient_cost.make(params)
    made = mc.moving_paths(scene, camera(), bounces=BOUNCES)
    return made._replace(interior=made.interior.map(jnp.mean), boundary=made.boundary.map(jnp.mean))


def shifted(params, distance):
    """Return the parameters with the sphere moved."""
    moved = {**params[SPHERE], "center": params[SPHERE]["center"] + distance * np.array(ALONG)}
    return [moved if i == SPHERE else p for i, p in enumerate(params)]


def everything(peer, options):
    """Return times of values and of all derivatives, and the derivatives by albedos and emission of both."""
    params = gradient_cost.parameters()
    n = options.spp * SIZE * SIZE
    value = mc.path_integrand(gradient_cost.make(params)[0], camera(), bounces=BOUNCES).map(jnp.mean)
    inside = derivatives(moving, params, "reverse", together=True).interior
    message = {"all": True, "integrator": integrator("prb"), "spp": options.spp}
    scene = describe(mc.Scene(PARTS.primitives), camera(), options.spp, BOUNCES)
    times: dict = {"jaxmc value": [], "jaxmc": [], "prb value": [], "prb": []}
    ours, theirs = [], []
    for seed in range(options.rounds + 1):
        spent = {}
        for name, integrand in ("jaxmc value", value), ("jaxmc", inside):
            start = time.perf_counter()
            found = mc.integrate(integrand, n=n, key=seed)
            spent[name] = time.perf_counter() - start
        answer = peer.ask({**message, "seed": seed + 1, **({} if seed else {"scene": scene})})
        spent.update({"prb value": answer["value_seconds"], "prb": answer["seconds"]})
        if seed:
            for name, seconds in spent.items():
                times[name].append(seconds)
            ours.append(colours_of(found.mean))
            theirs.append(answer["gradient"])
    median = {name: float(np.median(t)) for name, t in times.items()}
    return {
        "paths": n, "seconds": median, "times": times, "faster": median["prb"] / median["jaxmc"],
        "derivatives": agreement(ours, theirs), "mitsuba": answer["mitsuba"],
    }  # fmt: skip


def colours_of(gradient):
    """Return derivatives by colours under Mitsuba's names; by each channel on its own."""
    found = {}
    for i, (primitive, numbers) in enumerate(zip(PARTS.primitives, gradient)):
        if isinstance(primitive.material, mc.Diffuse):
            found[f"primitive_{i}.bsdf.brdf_0.reflectance.value"] = numbers["albedo"]
        if "emission" in numbers:
            found[f"primitive_{i}.emitter.radiance.value"] = numbers["emission"]
    return found


def agreement(ours, theirs):
    """Return means of both over seeds, and their difference in standard errors, of the sum over channels."""
    found = {}
    for name in ours[0]:
        a = np.array([np.sum(one[name]) for one in ours])
        b = np.array([np.sum(one[name]) for one in theirs if name in one])
        if len(b) and b.any():
            error = np.hypot(a.std(ddof=1), b.std(ddof=1)) / len(a) ** 0.5
            found[name] = {
                "jaxmc": a.mean(),
                "prb": b.mean(),
                "standard errors apart": abs(a.mean() - b.mean()) / error,
            }
    return found


def edges(peer, options):
    """Return mean, variance and time of the derivative by one move, edges included."""
    params = gradient_cost.parameters()

    def make(distance):
        return moving(shifted(params, distance))

    n = options.edge_spp * SIZE * SIZE
    scene = describe(mc.Scene(PARTS.primitives), camera(), options.edge_spp, BOUNCES)
    message = {"scene": scene, "shape": f"primitive_{SPHERE}", "direction": ALONG, "spp": options.edge_spp}
    message["integrator"] = integrator("prb_projective")
    slopes: dict = {"jaxmc": [], "prb_projective": []}
    times: dict = {"jaxmc": [], "prb_projective": []}
    for seed in range(options.seeds + 1):
        start = time.perf_counter()
        found = float(mc.grad_integrate(make, 0.0, n=n, boundary_n=n // 4, key=seed).mean)
        spent = time.perf_counter() - start
        answer = peer.ask({**message, "seed": seed + 1})
        if seed:
            for name, slope, seconds in ("jaxmc", found, spent), ("prb_projective", answer["slope"], answer["seconds"]):
                slopes[name].append(slope)
                times[name].append(seconds)
    result = {}
    for name in slopes:
        variance, seconds = float(np.var(slopes[name], ddof=1)), float(np.median(times[name]))
        result[name] = {
            "mean": float(np.mean(slopes[name])), "stderr": (variance / options.seeds) ** 0.5, "variance": variance,
            "seconds": seconds, "variance times seconds": variance * seconds, "slopes": slopes[name],
        }  # fmt: skip
    result["better"] = result["prb_projective"]["variance times seconds"] / result["jaxmc"]["variance times seconds"]
    return result


def main():
    options = arguments()
    found: dict = {
        "bounces": BOUNCES,
        "size": SIZE,
        "spp": options.spp,
        "edge_spp": options.edge_spp,
        "seeds": options.seeds,
    }
    with Peer(options.peers, "llvm_ad_rgb", SERVER) as peer:
        found["everything"] = everything(peer, options)
        print({k: v for k, v in found["everything"].items() if k != "times"}, flush=True)
    with Peer(options.peers, "llvm_ad_rgb", SERVER) as peer:
        found["edges"] = edges(peer, options)
        print(found["edges"], flush=True)
    write_json(options.out, found | {"machine": machine(), "versions": versions(), "load": os.getloadavg()})


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="runs of each that are timed")
    parser.add_argument("--spp", type=int, default=256, help="paths per pixel of a 64 x 64 image")
    parser.add_argument("--edge-spp", type=int, default=16, help="the same where edges move")
    parser.add_argument("--seeds", type=int, default=6, help="runs from whose spread the variance at edges comes")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
