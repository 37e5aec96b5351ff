"""Whole derivatives of images of random scenes, checked against differences with common random numbers.

    python benchmarks/gradient_checks.py [--scenes 0 1 2 3 4 5 6 7 8 9 10 11] [--n 67108864]

Each scene has a floor, a wall that may be a mirror, a lamp, a box, a ball and a sheet at random places, drawn anew
where one passes through another: where they meet is an edge that is not covered, as a flag says. Five numbers move: the
lamp, the box, the ball, an albedo and the camera. ``mc.gradcheck`` says whether the derivative of the mean of
the image is biased, and which bias it would have found. All of it is in ``benchmarks/results/gradient_checks.json``;
scenes that are not asked for stay there as they are.
"""

import argparse
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from jaxmc.report import machine, versions, write_json

RESULTS = Path(__file__).parent / "results" / "gradient_checks.json"
STEPS = (0.12, 0.06, 0.03)
WORDS = ("verdict", "gradient", "difference", "bias", "error", "p", "detectable", "slope", "step")


def random_scene(number):
    """Return parameters, and a function of them that returns (scene, camera); nothing in it passes through another."""
    rng = np.random.default_rng([7, number])
    while True:
        params, make = anything(number, rng)
        if not mc.moving_paths(*make(params), bounces=1).flags:
            return params, make


def anything(number, rng):
    """Return a scene as ``random_scene`` does, wherever its parts are."""
    lamp, size = rng.uniform([-0.8, -0.8, 1.8], [0.2, 0.2, 2.2]), rng.uniform(0.4, 0.9)
    box, ball = rng.uniform([-0.6, -0.6, 0.35], [0.0, 0.5, 0.8]), rng.uniform([0.2, -0.5, 0.3], [0.8, 0.5, 0.9])
    sheet, angle = rng.uniform([-0.3, -0.4, 1.1], [0.5, 0.3, 1.4]), rng.uniform(0.0, 1.5)
    shape = (mc.Quad, mc.Triangle, mc.Disk)[number % 3]
    wall = mc.Mirror(0.8) if number % 4 == 3 else mc.Diffuse(rng.uniform(0.3, 0.8))
    metal = mc.RoughConductor(rng.uniform(0.2, 0.5), 0.9) if number % 2 else mc.Diffuse(0.5)
    params = {"lamp": lamp[0], "box": box[1], "ball": ball[2], "albedo": rng.uniform(0.3, 0.7), "eye": 0.1}
    c, s = np.cos(angle), np.sin(angle)

    def at(place, **changes):
        return jnp.stack([jnp.asarray(changes.get(k, v), float) for k, v in zip("xyz", place)])

    def blade():
        if shape is mc.Disk:
            return mc.Disk(sheet, (s, 0.2, c), 0.3, mc.Diffuse(0.3))
        edges = np.array([0.5 * c, 0.5 * s, 0.1]), np.array([-0.5 * s, 0.5 * c, 0.1])
        if shape is mc.Quad:
            return mc.Quad(sheet, *edges, mc.Diffuse(0.3))
        return mc.Triangle(sheet, sheet + edges[0], sheet + edges[1], mc.Diffuse(0.3))

    def make(p):
        scene = mc.Scene([
            mc.Quad([-2.0, -2.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], mc.Diffuse(p["albedo"])),
            mc.Quad([-2.0, 2.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 2.5], wall),
            mc.Quad(at(lamp, x=p["lamp"]), [0.0, size, 0.0], [size, 0.0, 0.0], mc.Diffuse(0.0), emission=8.0),
            mc.Box(at(box, y=p["box"]), [0.5, 0.4, 0.6], [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], mc.Diffuse(0.6)),
            mc.Sphere(at(ball, z=p["ball"]), 0.28, metal),
            blade(),
        ])  # fmt: skip
        return scene, mc.PinholeCamera(at([0.0, -3.2, 1.3], x=p["eye"]), [0.0, 0.0, 0.6], (0, 0, 1), 45.0, 32, 24)

    return params, make


def main():
    options = arguments()
    known = json.loads(options.out.read_text())["scenes"] if options.out.exists() else []
    found = {scene["number"]: scene for scene in known}
    for number in options.scenes:
        found[number] = check(number, options)
        scenes = [found[k] for k in sorted(found)]
        write_json(options.out, {"steps": STEPS, "scenes": scenes, "machine": machine(), "versions": versions()})


def check(number, options):
    """Return what is found for one scene."""
    params, make = random_scene(number)

    def moving(p):
        return mc.moving_paths(*make(p), bounces=options.bounces)

    how = {"n": options.n, "boundary_n": options.n // 16, "scale": 1.0, "steps": STEPS, "sampler": mc.Sobol()}
    report = mc.gradcheck(moving, params, key=number, **how)
    norm = float(np.linalg.norm([f.gradient for f in report.findings]))
    share = max(f.detectable for f in report.findings) / norm
    print(f"{number:2d} {report.verdict:12s} detectable {100 * share:.2f} % of the norm, "
          f"p {min(f.p for f in report.findings):.2g} {report.flags}", flush=True)  # fmt: skip
    return {
        "number": number, "n": options.n, "bounces": options.bounces, "verdict": report.verdict, "flags": report.flags,
        "norm": norm, "detectable_share": share,
        "findings": {f.name: {word: getattr(f, word) for word in WORDS} for f in report.findings},
    }  # fmt: skip


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, nargs="*", default=range(12), help="their numbers")
    parser.add_argument("--n", type=int, default=1 << 26, help="samples of the interior and of the differences")
    parser.add_argument("--bounces", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
