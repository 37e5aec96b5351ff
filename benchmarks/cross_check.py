"""Whether jaxmc and Mitsuba 3 agree on random scenes: image means, the spread of pixel differences, and one bias test.

    python benchmarks/cross_check.py [--scenes 24] [--peers .venv-peers/bin/python] [--masking]

``random_scenes.py`` makes the scenes; Mitsuba's ``path`` integrator and ``jaxmc.render`` each give ``IMAGES`` images of
every scene, of independent samples. Rough conductors are Mitsuba's with heights correlated, see ``mitsuba_masking.py``.
With ``--masking`` Mitsuba's own are taken: the difference that this makes is then seen.

Per scene, everything in ``benchmarks/results/cross_check.json``:

* the image mean of each channel: difference, its standard error from the pixel variances, and z;
* pixels: Welch's t of each pixel and channel over the images, turned into a normal score by Student's t with Welch's
  degrees of freedom. Their variance is 1 where images are normal. Pixels that do not vary are compared as numbers, and
  pixels too rarely lit for a normal law, those whose mean over one image has an excess kurtosis above ``PEAKED``, are
  left out; both are counted.

The bias test takes the image means of all scenes and channels together, by Holm's correction.
"""

import argparse
import json
import os
from pathlib import Path

import numpy as np
from peers import Peer
from random_scenes import random_scene
from scipy import stats

import jaxmc as mc
from jaxmc.report import machine, versions, write_json
from jaxmc.transport.mitsuba_scenes import describe

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "cross_check.json"
IMAGES = 16  # of each renderer and scene
PILOT = 32  # samples per pixel of the image that says how many are wanted
PRECISION = 5e-4  # relative standard error of the image mean that each renderer aims at; both together stay below 1e-3
LEAST, MOST = 128, 1024  # samples per pixel of one image
PEAKED = 1.0
LEVEL = 0.05


def main():
    options = arguments()
    found: dict = {"load_before": os.getloadavg(), "images": IMAGES, "seed": options.seed}
    found["masking"] = "Mitsuba's" if options.masking else "correlated"
    found["scenes"] = {}
    with Peer(options.peers, "llvm_ad_rgb") as peer:
        print("scene                  spp   z by channel   relative error   pixel scores: mean, variance   left out")
        for number in options.numbers or range(options.scenes):
            name, result = one_scene(peer, number, options.seed, options.masking)
            found["scenes"][name] = result
            print(line(name, result), flush=True)
            found["verdict"] = verdict(list(found["scenes"].values()))
            about = {"peer": peer.about, "machine": machine(), "versions": versions()}
            write_json(options.out, found | about)  # what there is, should the rest be broken off
    print(json.dumps(found["verdict"], indent=1, default=float))


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=24, help="how many scenes, from the first on")
    parser.add_argument("--numbers", type=int, nargs="+", help="these scenes only")
    parser.add_argument("--seed", type=int, default=0, help="other seeds are other samples")
    parser.add_argument("--masking", action="store_true", help="rough conductors as Mitsuba has them")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


def one_scene(peer, number, seed, masking):
    """Return the name of a scene and how both renderers compare on it."""
    name, scene, camera, options = random_scene(number)
    shape = camera.height * camera.width
    tallies = {"pixels": mc.Moments()}  # with fourth moments, which images leave out by themselves
    pilot = mc.render(scene, camera, spp=PILOT, key=number, tallies=tallies, **options)
    spread = np.sqrt(np.mean(pilot.variance, (0, 1)) / shape) / np.mean(pilot.mean, (0, 1))
    wanted = float(spread.max() / PRECISION) ** 2 / IMAGES
    spp = int(np.clip(2 ** np.ceil(np.log2(wanted)), LEAST, MOST))

    description = describe(scene, camera, spp, options["bounces"])
    peer.about = peer.ask(description if masking else correlated(description))
    seeds = [10000 * seed + 100 * number + k for k in range(IMAGES)]
    theirs = np.stack([peer.render(spp, key)[1] for key in seeds])
    ours, variances, fourths = [], [], []
    for key in seeds:
        estimate = mc.render(scene, camera, spp=spp, key=key, tallies=tallies, **options)
        ours.append(estimate.mean)
        (moments,) = estimate["pixels"]
        variances.append(moments.central[0])
        fourths.append(moments.central[2])
    variance = np.mean(variances, 0)
    kurtosis = np.mean(fourths, 0) / np.where(variance > 0.0, variance, 1.0) ** 2 - 3.0
    result = {"spp": spp, "options": {key: str(value) for key, value in options.items()}}
    return name, result | image_means(np.stack(ours), theirs) | pixel_scores(np.stack(ours), theirs, kurtosis / spp)


def correlated(data):
    """Return a description whose rough conductors mask with correlated heights."""
    if isinstance(data, dict):
        data = {key: correlated(value) for key, value in data.items()}
        if data.get("type") == "roughconductor":
            names = ("alpha", "specular_reflectance", "eta", "k")
            data = {"type": "correlatedconductor"} | {name: data[name] for name in names if name in data}
    return data


def image_means(ours, theirs):
    """Return the means over the image, by channel, and how they differ."""
    means = [x.mean((0, 1, 2), dtype=np.float64) for x in (ours, theirs)]
    # Pixels are independent, so their variances add: much better known than that of the means of a few images.
    errors = [np.sqrt(_variance(x).sum((0, 1)) / len(x)) / x[0, ..., 0].size for x in (ours, theirs)]
    error = np.hypot(*errors)
    return {
        "ours": means[0],
        "theirs": means[1],
        "relative_difference": means[0] / means[1] - 1.0,
        "relative_stderr": error / means[1],
        "z": (means[0] - means[1]) / error,
    }


def pixel_scores(ours, theirs, kurtosis):
    """Return the mean and the variance of the normal scores of pixels, with their errors, and what was left out."""
    a, b = (_variance(x) / len(x) for x in (ours, theirs))
    difference = ours.mean(0, dtype=np.float64) - theirs.mean(0, dtype=np.float64)
    scale = np.abs(theirs).mean(0, dtype=np.float64)
    # What varies by rounding alone does not vary.
    fixed = np.sqrt(a + b) <= 1e-6 * scale
    peaked = ~fixed & (kurtosis > PEAKED)
    kept = ~fixed & ~peaked
    a, b = (np.where(kept, x, 1.0) for x in (a, b))
    freedom = (a + b) ** 2 * (len(ours) - 1) / (a**2 + b**2)
    tail = stats.t.logsf(np.abs(difference) / np.sqrt(a + b), freedom)
    scores = np.where(kept, np.sign(difference) * stats.norm.isf(np.exp(np.maximum(tail, -700.0))), np.nan)
    # The channels of a pixel come from the same paths: errors are those of one number for each pixel.
    each = np.nanmean(scores[kept.any(-1)], -1)
    squares = np.nanmean(scores[kept.any(-1)] ** 2, -1)
    return {
        "scores": {
            "mean": each.mean(),
            "mean_error": each.std() / np.sqrt(each.size),
            "variance": squares.mean(),
            "variance_error": squares.std() / np.sqrt(squares.size),
            "largest": np.nanmax(np.abs(scores)),
            "pixels": each.size,
        },
        "fixed": int(fixed.sum()),
        "fixed_and_different": int((fixed & (np.abs(difference) > 1e-5 * scale)).sum()),
        "peaked": int(peaked.sum()),
        "values": int(kept.size),
    }


def verdict(results):
    """Return the tests over all scenes."""
    z = np.array([r["z"] for r in results])
    p = np.sort(2.0 * stats.norm.sf(np.abs(z)).ravel())
    holm = np.minimum(np.maximum.accumulate(p * np.arange(len(p), 0, -1)), 1.0)
    scores = [r["scores"] for r in results]
    weights = np.array([s["pixels"] for s in scores], float)
    variance = np.average([s["variance"] for s in scores], weights=weights)
    errors = np.array([s["variance_error"] for s in scores])
    return {
        "largest_z": np.abs(z).max(),
        "beyond_3": int((np.abs(z) > 3.0).sum()),
        "image_means": z.size,
        "variance_of_z": (z**2).mean(),
        "largest_relative_stderr": max(np.max(r["relative_stderr"]) for r in results),
        "holm_smallest_p": holm[0],
        "bias_found": bool(holm[0] < LEVEL),
        "pixel_variance": variance,
        "pixel_variance_error": np.sqrt(np.sum((weights * errors) ** 2)) / weights.sum(),
        "scenes_beyond_5_percent": [
            i for i, s in enumerate(scores) if abs(s["variance"] - 1.0) > 0.05 + 3.0 * s["variance_error"]
        ],
        "largest_score": max(s["largest"] for s in scores),
        "values": sum(r["values"] for r in results),
        "left_out_as_peaked": sum(r["peaked"] for r in results),
        "fixed": sum(r["fixed"] for r in results),
        "fixed_and_different": sum(r["fixed_and_different"] for r in results),
    }


def line(name, r):
    scores = r["scores"]
    z = " ".join(f"{x:+5.2f}" for x in r["z"])
    spread = (
        f"{scores['mean']:+.3f}({scores['mean_error']:.3f}) {scores['variance']:.3f}({scores['variance_error']:.3f})"
    )
    left = f"{r['peaked']} peaked, {r['fixed']} fixed of {r['values']}"
    return f"{name:20s} {r['spp']:5d}   {z}     {np.max(r['relative_stderr']):.1e}    {spread}     {left}"


def _variance(images):
    return images.var(0, ddof=1, dtype=np.float64)


if __name__ == "__main__":
    main()
