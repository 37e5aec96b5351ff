"""How fast jaxmc renders, beside Mitsuba 3 on the same scene, and whether their images agree.

    python benchmarks/throughput.py [--rounds 7] [--spp 64] [--size 256] [--peers .venv-peers/bin/python]

One renderer works at a time, and rounds alternate: jaxmc, Mitsuba's LLVM variant, jaxmc, its scalar variant. A time is
that of one call, from the scene to an image in NumPy, after a warm-up; a ratio compares neighbours in a round. Both
sides run the same estimator: cosine-distributed directions, one sample of the light at each vertex, the power
heuristic, a box filter, no Russian roulette. ``agreement.py`` says what the agreement figures mean. Everything lands in
``benchmarks/results/throughput.json``.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np
from agreement import compare, image_means, variance_by_own
from peers import Peer

import jaxmc as mc
from jaxmc import backend, scenes
from jaxmc.report import machine, versions, write_json

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "throughput.json"
BOUNCES = 5
LLVM, SCALAR = "llvm_ad_rgb", "scalar_rgb"
SEEDS = 32  # images of each renderer to a comparison
# What is compared: name, parts, scene and camera, bounces, samples per pixel of one image (enough for the means of the
# images to be known to 0.1 %).
COMPARED = [
    ("cornell_box", scenes.cornell_box_parts, scenes.cornell_box, 5, 64),
    ("mirror_box", scenes.mirror_box_parts, scenes.mirror_box, 8, 256),
]


def main():
    options = arguments()
    found = {"load_before": os.getloadavg(), "spp": options.spp, "size": options.size, "bounces": BOUNCES}
    # First, while this process is small: a child's peak starts from that of the process that started it.
    found["memory"] = memory(options)
    found["first_call"] = first_call(options)
    variants = ([LLVM] if options.no_scalar else [LLVM, SCALAR]) if options.peers.exists() else []
    if not variants:
        print(f"{options.peers} is missing, so jaxmc is measured alone; `make peers` adds Mitsuba.")
    with ExitStack() as stack:
        peers = start(stack, options, variants)
        found["throughput"] = throughput(options, peers)
        found["first_call"]["overhead"] = found["first_call"]["seconds"] - found["throughput"]["jaxmc"]["seconds"]
        print(f"  first call: {found['first_call']['overhead']:.2f} s more, which compiles the kernel")
        if peers and not options.skip_agreement:
            found["agreement"] = {scene[0]: agreement(peers[0], options.seed, *scene) for scene in COMPARED}
    found["gpu"] = gpu(options)
    found |= {"peers": [peer.about for peer in peers], "machine": machine(), "versions": versions()}
    write_json(RESULTS, found)
    print(f"All numbers: {RESULTS.relative_to(ROOT)}")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="renders of each peer")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel")
    parser.add_argument("--size", type=int, default=256, help="width and height of the image in pixels")
    parser.add_argument("--seed", type=int, default=1000, help="first seed of the comparison; others are other samples")
    parser.add_argument("--skip-agreement", action="store_true", help="only time; the comparison takes some minutes")
    parser.add_argument("--no-scalar", action="store_true", help="leave out Mitsuba's slower variant")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    return parser.parse_args()


def render(size, spp, seed):
    """Return (seconds, image) of one call of jaxmc on the Cornell box."""
    scene, camera = scenes.cornell_box(size, size)
    start = time.perf_counter()
    image = np.asarray(mc.render(scene, camera, spp=spp, bounces=BOUNCES, key=seed).mean)
    return time.perf_counter() - start, image


def memory(options):
    """Return peak memory, in MiB, of processes that only render."""
    found = {}
    for spp in (options.spp, 16 * options.spp):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as child:
            before, peak = child.submit(peak_memory, options.size, spp).result()
        print(f"Peak memory at {spp} spp: {peak:.0f} MiB, of which {before:.0f} MiB before the render")
        found[spp] = {"before": before, "peak": peak}
    return found


def peak_memory(size, spp):
    """Return the peak memory of this process in MiB before and after a render."""
    unit = 2**20 if sys.platform == "darwin" else 2**10
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    render(size, spp, 0)
    return before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def first_call(options):
    seconds, _ = render(options.size, options.spp, 0)
    return {"seconds": seconds}


def gpu(options):
    """Return how fast the same image is made where JAX has a GPU; None where it has none."""
    if jax.default_backend() == "cpu":
        print("JAX has no GPU here: nothing was measured on one.")
        return None
    times = [render(options.size, options.spp, seed)[0] for seed in range(1 + options.rounds)][1:]
    median = float(np.median(times))
    print(f"GPU: {options.size**2 * options.spp / median / 1e6:.2f} M paths/s")
    return {"device": jax.devices()[0].device_kind, "seconds": median, "times": times, "widths": backend.widths()}


def start(stack, options, variants):
    """Start the peers and load the scene; one that fails has said why, and the others go on."""
    peers = []
    for variant in variants:
        try:
            peer = stack.enter_context(Peer(options.peers, variant))
            peer.load(scenes.cornell_box_parts(), options.size, options.size, BOUNCES)
            peer.render(options.spp, 0)
            peers.append(peer)
        except RuntimeError as error:
            print(error)
    return peers


def throughput(options, peers):
    """Return times and ratios of alternating renders."""
    render(options.size, options.spp, 1)
    paths = options.size**2 * options.spp
    seconds = {"jaxmc": [], **{peer.variant: [] for peer in peers}}
    ratios = {peer.variant: [] for peer in peers}
    seed = 100
    for _ in range(options.rounds):
        for peer in peers or [None]:
            seed += 1
            seconds["jaxmc"].append(render(options.size, options.spp, seed)[0])
            if peer:
                seconds[peer.variant].append(peer.render(options.spp, seed)[0])
                ratios[peer.variant].append(seconds[peer.variant][-1] / seconds["jaxmc"][-1])
    found = {}
    print(f"Cornell box, {options.size} x {options.size}, {options.spp} spp, {BOUNCES} bounces:")
    for name, times in seconds.items():
        median = float(np.median(times))
        found[name] = {"seconds": median, "paths_per_second": paths / median, "times": times}
        line = f"  {name:12s} {paths / median / 1e6:6.2f} M paths/s   {median:.3f} s"
        if name in ratios:
            low, middle, high = np.quantile(ratios[name], (0.0, 0.5, 1.0))
            found[name] |= {"jaxmc_is_faster": middle, "from": low, "to": high}
            line += f"   jaxmc is {middle:.2f} times as fast ({low:.2f} to {high:.2f})"
        print(line)
    return found


def agreement(peer, seed, name, parts, build, bounces, spp):
    """Return how images of jaxmc and of a peer compare, and the same for jaxmc and itself with other seeds."""
    scene, camera = build()
    peer.load(parts(), camera.width, camera.height, bounces)
    theirs, ours, own_variance, other, fewer = [], [], [], [], []
    for k in range(SEEDS):
        theirs.append(peer.render(spp, seed + k)[1])
        estimate = mc.render(scene, camera, spp=spp, bounces=bounces, key=seed + k)
        ours.append(estimate.mean)
        own_variance.append(estimate.variance)
        other.append(mc.render(scene, camera, spp=spp, bounces=bounces, key=seed + SEEDS + k).mean)
        if k % 4 == 0:
            fewer.append(mc.render(scene, camera, spp=spp, bounces=bounces - 1, key=seed + 2 * SEEDS + k).mean)
    theirs, ours, own_variance, other, fewer = (
        np.stack([np.asarray(x, np.float32) for x in images]) for images in (theirs, ours, own_variance, other, fewer)
    )
    found = {"seed": seed, "seeds": SEEDS, "spp": spp, "bounces": bounces, **compare(ours, theirs)}
    found["jaxmc_and_itself"] = compare(ours, other)
    # A comparison that could not fail would say nothing: jaxmc with its last bounce missing.
    found["one_bounce_fewer"] = image_means(fewer, theirs)
    found["variance_over_seeds_by_own"] = variance_by_own(ours, own_variance, spp)
    show(name, found)
    return found


def show(name, found):
    image, null = found["image"], found["jaxmc_and_itself"]
    print(f"{name}, {found['bounces']} bounces, {SEEDS} images of {found['spp']} spp from jaxmc and from Mitsuba:")
    for word, key in (("jaxmc", "ours"), ("Mitsuba", "theirs")):
        means = zip(image[key], image[f"{key}_stderr"], strict=True)
        print(f"  image mean, {word:8s}", "   ".join(f"{m:.6f} +- {e:.6f}" for m, e in means))
    print("  relative difference ", "   ".join(f"{d:+.1e} +- {e:.1e}" for d, e in _pairs(image, "relative_")))
    print("  z of the image mean ", "   ".join(f"{z:+.2f}" for z in image["z"]))
    print("  ... one bounce fewer", "   ".join(f"{z:+.1f}" for z in found["one_bounce_fewer"]["z"]))
    for kind in ("pixels", "tiles"):
        a, b = found[kind], null[kind]
        print(
            f"  z of {a['values']} {kind}: mean {a['mean_z']:+.4f} +- {a['mean_z_error']:.4f}, standard deviation "
            f"{a['std_z']:.4f} +- {a['std_z_error']:.4f} (jaxmc and itself {b['std_z']:.4f}, normal images "
            f"{a['std_z_of_normal_images']:.4f}), largest {a['largest_z']:.1f} (itself {b['largest_z']:.1f})"
        )
        ratio, itself = found[f"variance_ratio_{kind}"], null[f"variance_ratio_{kind}"]
        print(
            f"  variance of {kind}, Mitsuba / jaxmc: {ratio[0]:.4f} +- {ratio[1]:.4f} "
            f"(itself {itself[0]:.4f} +- {itself[1]:.4f})"
        )
    fixed = found["pixels"]
    print(f"  values that never varied: {fixed['fixed']}, of which {fixed['fixed_and_different']} differ")
    ratio, error = found["variance_over_seeds_by_own"]
    print(f"  variance of pixels over seeds / as jaxmc reports it: {ratio:.4f} +- {error:.4f}")


def _pairs(image, prefix):
    return zip(image[f"{prefix}difference"], image[f"{prefix}stderr"], strict=True)


if __name__ == "__main__":
    main()
