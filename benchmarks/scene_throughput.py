"""How fast jaxmc renders scenes of several kinds, beside Mitsuba 3, and what a ray costs in an open and a closed one.

    python benchmarks/scene_throughput.py [--rounds 7] [--size 256] [--peers .venv-peers/bin/python]

Both renderers sample a light and a direction at each of up to five events and weigh them by the power heuristic; the
sky is sampled like a light, as Mitsuba does. One works at a time, and rounds alternate; a time is that of one call,
after a warm-up, and a ratio compares neighbours in a round. The means of the images are compared too, so that nobody is
fast by leaving light out.

The rays that a path traces end where it leaves the scene: the camera's, and for each event the next one and one to each
light that is sampled. Everything lands in ``benchmarks/results/scene_throughput.json``.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from peers import Peer

import jaxmc as mc
from jaxmc import scenes
from jaxmc.report import machine, versions, write_json
from jaxmc.studies.light_scenes import events
from jaxmc.transport.mitsuba_scenes import describe

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "scene_throughput.json"
BOUNCES = 5
# Name: scene and camera for a size, samples per pixel, options.
SCENES = {
    "Cornell box, diffuse": (lambda n: scenes.cornell_box(n, n), 64, {}),
    "Cornell box, mirror and glass": (lambda n: scenes.cornell_glass(n, n), 64, {}),
    "Cornell box, two blocks": (lambda n: scenes.cornell_blocks(width=n, height=n), 64, {}),
    "100 spheres under a sky": (lambda n: scenes.many_spheres(100, n, n), 16, {"sample_sky": True}),
    "orb in the dark": (lambda n: scenes.orb(width=n, height=n), 64, {}),
}


def main():
    options = arguments()
    found: dict = {"load_before": os.getloadavg(), "size": options.size, "bounces": BOUNCES, "scenes": {}}
    with Peer(options.peers, "llvm_ad_rgb") as peer:
        for name, (build, spp, more) in SCENES.items():
            scene, camera = build(options.size)
            found["scenes"][name] = result = compare(peer, scene, camera, spp, options.rounds, more)
            print(line(name, result), flush=True)
        found["peer"] = peer.about
    per_ray = {name: result["ns_per_ray"] for name, result in found["scenes"].items()}
    found["orb_per_ray_by_cornell"] = per_ray["orb in the dark"] / per_ray["Cornell box, diffuse"]
    print(f"Time per traced ray, orb / Cornell box: {found['orb_per_ray_by_cornell']:.2f}")
    write_json(options.out, found | {"machine": machine(), "versions": versions()})


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="renders of each")
    parser.add_argument("--size", type=int, default=256, help="width and height of the images in pixels")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


def compare(peer, scene, camera, spp, rounds, more):
    """Return times, ratios, means and the rays of a path of a scene."""
    peer.about = peer.ask(describe(scene, camera, spp, BOUNCES))
    peer.render(spp, 0)
    render(scene, camera, spp, 0, more)
    ours, theirs, images = [], [], {"jaxmc": [], "mitsuba": []}
    for seed in range(1, rounds + 1):
        seconds, image = render(scene, camera, spp, seed, more)
        ours.append(seconds)
        images["jaxmc"].append(image.mean((0, 1)))
        seconds, image = peer.render(spp, seed)
        theirs.append(seconds)
        images["mitsuba"].append(image.mean((0, 1)))
    paths = camera.width * camera.height * spp
    rays = rays_of(scene, camera, more)
    ratios = np.array(theirs) / np.array(ours)
    seconds, peer_seconds = float(np.median(ours)), float(np.median(theirs))
    return {
        "spp": spp, "seconds": seconds, "mitsuba_seconds": peer_seconds, "times": ours, "mitsuba_times": theirs,
        "jaxmc_is_faster": float(np.median(ratios)), "from": float(ratios.min()), "to": float(ratios.max()),
        "paths_per_second": paths / seconds, "rays_of_a_path": rays,
        "ns_per_ray": 1e9 * seconds * mc.backend.workers() / (paths * rays), "z": difference(**images),
    }  # fmt: skip


def render(scene, camera, spp, seed, more):
    """Return (seconds, image) of one call of jaxmc."""
    start = time.perf_counter()
    image = np.asarray(mc.render(scene, camera, spp=spp, bounces=BOUNCES, key=seed, **more).mean)
    return time.perf_counter() - start, image


def rays_of(scene, camera, more):
    """Return how many rays a path traces on average."""
    count = float(mc.integrate(events(scene, camera, bounces=BOUNCES, **more), n=1 << 18, key=1).mean)
    shadows = bool(scene.lights) + bool(more.get("sample_sky"))
    return 1.0 + count * (1 + shadows)


def difference(jaxmc, mitsuba):
    """Return the z-scores of the difference of the image means, by channel, from the spread over the rounds."""
    a, b = np.array(jaxmc), np.array(mitsuba)
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / len(a))
    return ((a.mean(0) - b.mean(0)) / error).tolist()


def line(name, r):
    return (
        f"{name:30s} {r['paths_per_second'] / 1e6:6.2f} M paths/s, {r['jaxmc_is_faster']:.2f} times Mitsuba "
        f"({r['from']:.2f} to {r['to']:.2f}), {r['rays_of_a_path']:.2f} rays, {r['ns_per_ray']:.1f} ns of a core each, "
        f"z {' '.join(f'{z:+.1f}' for z in r['z'])}"
    )


if __name__ == "__main__":
    main()
