"""The parts of ``time_to_error.py`` that are about light: jaxmc beside Mitsuba's LLVM variants and their samplers.

Irradiance. A sample is one point on the light: ``lights="nee"`` here, ``direct`` without BSDF samples there. Mitsuba's
receiver is a small white diffuse square which a camera of one pixel, 0.01 degrees wide, looks at; irradiance is pi
times its radiance. One pixel lets its samplers spread all samples together. Its variant is ``llvm_ad_mono``: one
channel, as here. Known value; targets 1e-3 and 1e-4.

Image. The Cornell box of ``throughput.py``. ``error`` in a rung is that of the mean over all pixels and channels: from
the variance of each pixel over seeds, since pixels are independent; ``error_over_seeds`` is the same directly, from few
seeds and so less sure. ``pixel_error`` is the root of the mean variance of a pixel over the mean of the image.
``efficiency`` is 1 / (pixel variance x time), relative: the samples' worth of a second. Both renderers are unbiased and
agree (``throughput.py``), so an error is a spread over seeds; ``offset`` says how many standard errors the mean of all
seeds of a method lies off that of all methods.
"""

import math
import time
from contextlib import ExitStack
from functools import partial

import numpy as np
from peers import Peer
from ratios import summary

import jaxmc as mc
from analytic_scenes import rectangle_light
from jaxmc import bench, race, scenes
from jaxmc.scenes import Parts

SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")  # of Mitsuba
TARGETS = (1e-3, 1e-4)
BOUNCES = 5
LIGHT = {"corner": (0.5, -0.3, 1.2), "edge_u": (-0.2, 0.7, 0.4), "edge_v": (0.8, 0.3, 0.1)}
NORMAL = np.array((0.2, 0.1, 1.0)) / math.sqrt(1.05)
OURS = ((mc.Independent(), None), (mc.Sobol(), None), (mc.Lattice(), None), (mc.Sobol(), 1), (mc.Stratified(), 1))


def irradiance(options):
    """Return what every method does on the irradiance under a quad light."""
    scene = rectangle_light(**LIGHT, normal=NORMAL)
    settings = {"ladder": tuple(1 << m for m in range(8, 28, 2)), "seeds": race.SEEDS, "seconds_each": 8.0}
    if options.quick:
        settings |= {"ladder": (1 << 8, 1 << 10, 1 << 12), "seeds": 2, "seconds_each": 1.0}
    print(f"\nIrradiance, {scene.name}")
    with ExitStack() as stack:
        integrator = {"type": "direct", "bsdf_samples": 0}
        peers = start(stack, options.peers, "llvm_ad_mono", receiver_parts(), 1, 0, integrator)
        methods = bench.own_methods(scene.integrand) + bench.other_methods(scene.integrand)
        methods += [race.Method(f"Mitsuba {s}", partial(measure, peer, set()), error_bar=False) for s, peer in peers]
        curves = race.race(methods, scene.exact, enough=1e-6, **settings)
        about = peers[0][1].about if peers else {}
    print(bench.table(curves, settings["seeds"]))
    return {
        "title": "Irradiance under a quad light", "exact": scene.exact, "seeds": settings["seeds"],
        "target_errors": TARGETS, "targets": summary(curves, TARGETS), "peers": about,
        "methods": bench.as_dict(curves, settings["seeds"]),
    }  # fmt: skip


def start(stack, python, variant, parts, size, bounces, integrator=None):
    """Start one Mitsuba for each of its samplers and load the scene; returns (sampler, process) of those that work."""
    peers = []
    for sampler in SAMPLERS:
        try:
            peer = stack.enter_context(Peer(python, variant))
            peer.load(parts, size, size, bounces, sampler=sampler, integrator=integrator)
            peers.append((sampler, peer))
        except (RuntimeError, OSError) as error:
            print(f"Mitsuba {sampler} is left out: {error}")
    return peers


def receiver_parts():
    """Return the quad light, and a receiver in the origin with a camera that looks straight at it."""
    across = np.cross(NORMAL, (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    along, half = np.cross(NORMAL, across), 0.05
    receiver = mc.Quad(-half * (across + along), 2 * half * across, 2 * half * along, mc.Diffuse(1.0))
    view = {"origin": (0.02 * NORMAL).tolist(), "target": (0, 0, 0), "up": across.tolist(), "fov": 0.01}
    return Parts([receiver, mc.Quad(**LIGHT, material=mc.Diffuse(0.0), emission=5.0)], view)


def measure(peer, known, n, seed):
    """Return the irradiance from n samples of Mitsuba; the first time with another n, the call that compiles."""
    answer = peer.ask({"spp": n, "seed": seed})
    seconds = answer["seconds"] if n in known else answer["first"]
    known.add(n)
    return race.Run(math.pi * float(np.load(answer["file"])[..., 0].mean()), n, seconds)


def image(options):
    """Return what every method does on the image of the Cornell box."""
    size, ladder, seeds = (32, (4, 16, 64), 2) if options.quick else (256, (16, 64, 256), 4)
    print(f"\nCornell box, {size} x {size}, {BOUNCES} bounces, {seeds} seeds")
    with ExitStack() as stack:
        peers = start(stack, options.peers, "llvm_ad_rgb", scenes.cornell_box_parts(), size, BOUNCES)
        methods = {name_of(*sampler): partial(render, size, *sampler) for sampler in OURS}
        methods |= {f"Mitsuba {sampler}": partial(render_peer, peer, set()) for sampler, peer in peers}
        rows = [rung(methods, spp, seeds) for spp in ladder]
        about = peers[0][1].about if peers else {}
    curves = [
        race.Curve(name, name in map(lambda s: name_of(*s), OURS), "replicate" not in name and "Mitsuba" not in name,
                    [race.Rung(spp, row[name]["error"], row[name]["seconds"], row[name]["first"])
                     for spp, row in zip(ladder, rows)])
        for name in methods
    ]  # fmt: skip
    return {
        "title": f"Cornell box, mean of the image, {size} x {size}", "spp": ladder, "seeds": seeds,
        "target_errors": TARGETS, "targets": reach(curves), "peers": about,
        "efficiency": efficiency(curves, ladder, rows),
        "methods": bench.as_dict(curves, seeds), "rows": [dict(row) for row in rows],
    }  # fmt: skip


def name_of(sampler, replicates):
    return type(sampler).__name__ + (", 1 replicate" if replicates else "")


def render(size, sampler, replicates, spp, seed):
    """Return (seconds, image) of one call of jaxmc."""
    scene, camera = scenes.cornell_box(size, size)
    start = time.perf_counter()
    estimate = mc.render(scene, camera, spp=spp, bounces=BOUNCES, key=seed, sampler=sampler, replicates=replicates)
    pixels = np.asarray(estimate.mean)
    return time.perf_counter() - start, pixels


def render_peer(peer, known, spp, seed):
    answer = peer.ask({"spp": spp, "seed": seed})
    seconds = answer["seconds"] if spp in known else answer["first"]
    known.add(spp)
    return seconds, np.load(answer["file"])


def rung(methods, spp, seeds):
    """Render with every method, seeds alternating, and return errors and times by name."""
    firsts = {name: method(spp, 0)[0] for name, method in methods.items()}
    taken = {name: [] for name in methods}
    for seed in range(1, seeds + 1):
        for name, method in methods.items():
            taken[name].append(method(spp, seed))
    means = {name: np.mean([pixels.mean(dtype=float) for _, pixels in runs]) for name, runs in taken.items()}
    row = {name: errors(runs) | {"first": firsts[name], "mean": means[name]} for name, runs in taken.items()}
    middle = float(np.median(list(means.values())))
    for name, found in row.items():
        found["offset"] = (found["mean"] / middle - 1.0) / (found["error"] / math.sqrt(seeds))
        print(f"  {spp:5d} spp  {name:22s} {found['seconds']:7.3f} s   pixel {found['pixel_error']:.2e}   "
              f"mean {found['error']:.2e}   off by {found['offset']:+.1f}")  # fmt: skip
    return row


def errors(runs):
    """Return the errors of one image, from the spread over the seeds."""
    seconds, images = zip(*runs)
    stack = np.stack(images).astype(np.float64)
    mean = stack.mean()
    of_pixel_means = stack.mean(-1).var(0, ddof=1)
    return {
        "seconds": float(np.median(seconds)),
        "pixel_error": math.sqrt(stack.var(0, ddof=1).mean()) / mean,
        "error": math.sqrt(of_pixel_means.mean() / of_pixel_means.size) / mean,
        "error_over_seeds": float(stack.mean((1, 2, 3)).std(ddof=1)) / mean,
    }


def reach(curves):
    """Print and return the time in which the mean of the image gets to each target, extrapolated where need be."""
    found = {}
    for target in TARGETS:
        times = {curve.name: extrapolated(curve, target) for curve in curves}
        ours, theirs = (min(((times[c.name], c.name) for c in curves if c.own == own), default=(math.inf, "none"))
                        for own in (True, False))  # fmt: skip
        ratio = theirs[0] / ours[0]
        print(f"  mean of the image to {target:g}: {ours[1]} {ours[0]:.2f} s, {theirs[1]} {theirs[0]:.2f} s, "
              f"ratio {ratio:.2f}")  # fmt: skip
        found[f"{target:g}"] = {"ours": ours, "peer": theirs, "ratio": ratio, "seconds": times}
    return found


def extrapolated(curve, error, seeds=4):
    """Return the time to an error; beyond the last rung, from there by the slope of all, at as much time per sample."""
    last, (slope, _) = curve.rungs[-1], curve.slope(seeds)
    if last.error <= error:
        return curve.seconds_to(error)
    return last.seconds * (last.error / error) ** (-1.0 / slope) if slope < 0.0 else math.inf


def efficiency(curves, ladder, rows):
    """Print and return 1 / (variance of a pixel x time) of the best on each side, and their ratio, at each spp."""
    found = {}
    for spp, row in zip(ladder, rows):
        values = {name: 1.0 / (one["pixel_error"] ** 2 * one["seconds"]) for name, one in row.items()}
        ours, theirs = (max(((values[c.name], c.name) for c in curves if c.own == own), default=(0.0, "none"))
                        for own in (True, False))  # fmt: skip
        ratio = ours[0] / theirs[0] if theirs[0] else math.inf
        plain = values["Independent"] / values.get("Mitsuba independent", math.nan)
        print(f"  efficiency at {spp} spp: {ours[1]} against {theirs[1]}: {ratio:.2f}; both independent: {plain:.2f}")
        found[spp] = {"ours": ours, "peer": theirs, "ratio": ratio, "both_independent": plain, "values": values}
    return found
