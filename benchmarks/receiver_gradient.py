"""What a moving receiver does to its image: the exact derivative, jaxmc's and those of Mitsuba 3.

    python benchmarks/receiver_gradient.py [--seeds 8] [--spp 1024] [--peers .venv-peers/bin/python]

A camera looks at a diffuse floor, on which a lamp shines past a black rectangle; it sees neither of these. Each of the
three moves along z by itself: the shadow's edge moves over the floor in all three cases. In a fourth the floor moves
with the rectangle far aside, so that nothing jumps. The derivative of the mean of the image is known by quadrature, see
``tests/two_bounce_reference.py``. Beside it stand

* central differences of Mitsuba's own images, with common random numbers;
* its integrators ``direct_projective`` and ``prb_projective``, as they are by default, in forward mode;
* ``mc.grad_integrate`` of ``mc.moving_paths``, with its two parts.

Errors are standard errors over seeds, or jaxmc's own. All of it is in ``benchmarks/results/receiver_gradient.json``.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from peers import Peer

import jaxmc as mc
from jaxmc.report import machine, versions, write_json
from jaxmc.transport.mitsuba_scenes import describe

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))
import two_bounce_reference as reference  # noqa: E402

SERVER = Path(__file__).with_name("mitsuba_gradients.py")
RESULTS = ROOT / "benchmarks" / "results" / "receiver_gradient.json"
UP = [0.0, 0.0, 1.0]
STEP = 0.01
# Where the image darkens as the floor comes nearer, because the shadow moves into it.
PARAMS = {
    **reference.PARAMS, "lamp_x": -1.5, "lamp_z": 1.5, "lamp_size": 0.6, "blocker_x": -0.7, "blocker_size": 1.3,
}  # fmt: skip
# What moves: the parameter of the reference, the primitive, and what else is different.
MOVING = {
    "receiver": ("floor", 0, {}),
    "blocker": ("blocker_z", 1, {}),
    "lamp": ("lamp_z", 2, {}),
    "receiver without shadow": ("floor", 0, {"blocker_y": 9.0}),
}
INTEGRATORS = {
    "direct_projective": {"type": "direct_projective"},
    "prb_projective": {"type": "prb_projective", "max_depth": 2},
}


def make(p):
    """Return (scene, camera): the floor, the blocker and the lamp of the reference, without its wall."""
    scene, camera = reference.make({**PARAMS, **p})
    floor, _, blocker, lamp = scene.given[0]
    return mc.Scene([floor, blocker, lamp]), camera


def main():
    options = arguments()
    found: dict = {"params": PARAMS, "spp": options.spp, "seeds": options.seeds, "step": STEP, "moving": {}}
    with Peer(options.peers, "llvm_ad_rgb", SERVER) as peer:
        for name, (parameter, number, changes) in MOVING.items():
            result = {"exact": exact(parameter, changes)}
            result.update(by_mitsuba(peer, number, changes, options.spp, options.seeds))
            if hasattr(mc, "moving_paths"):
                result["jaxmc"] = by_jaxmc(parameter, changes)
            found["moving"][name] = result
            print(line(name, result), flush=True)
        found["mitsuba"] = peer.about["mitsuba"]
    write_json(options.out, found | {"machine": machine(), "versions": versions()})


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8, help="runs of Mitsuba, from whose spread its error comes")
    parser.add_argument("--spp", type=int, default=1024, help="Mitsuba's samples per pixel of a 16 x 16 image")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


def exact(parameter, changes):
    def mean(p):
        return reference.direct_mean({**PARAMS, **changes, **p}, order=12)

    return float(reference.derivatives(mean, {parameter: PARAMS[parameter]})[parameter])


def by_mitsuba(peer, number, changes, spp, seeds):
    """Return derivatives with standard errors: of differences, and of each integrator."""
    scene = describe(*make(changes), spp, 1)
    common = {"scene": scene, "shape": f"primitive_{number}", "direction": UP, "spp": spp}
    ways = {"differences": {"step": STEP}, **{name: {"integrator": i} for name, i in INTEGRATORS.items()}}
    found = {}
    for name, way in ways.items():
        answers = [peer.ask({**common, **way, "seed": seed}) for seed in range(1, seeds + 1)]
        peer.about = {"mitsuba": answers[0]["mitsuba"]}
        slopes = np.array([a["slope"] for a in answers])
        found[name] = {
            "mean": float(slopes.mean()), "stderr": float(slopes.std(ddof=1) / seeds**0.5),
            "seconds": float(np.median([a["seconds"] for a in answers])),
            "warnings": sorted({w for a in answers for w in a["warnings"]}),
        }  # fmt: skip
    return found


def by_jaxmc(parameter, changes, n=1 << 18):
    """Return jaxmc's derivative, with standard error and both parts."""
    start = {parameter: PARAMS[parameter]}
    found = mc.grad_integrate(
        lambda p: mc.moving_paths(*make({**changes, **p}), bounces=1), start, n=n, sampler=mc.Sobol(), key=1
    )  # fmt: skip
    parts = {"interior": found.interior.mean, "boundary": found.boundary.mean if found.boundary else {parameter: 0.0}}
    return {
        "mean": float(found.mean[parameter]), "stderr": float(found.stderr[parameter]), "n": n,
        **{name: float(part[parameter]) for name, part in parts.items()},
    }  # fmt: skip


def line(name, result):
    ways = [f"{way} {r['mean']:+.5f}({r['stderr']:.5f})" for way, r in result.items() if way != "exact"]
    return f"{name:23s} exact {result['exact']:+.5f}, {', '.join(ways)}"


if __name__ == "__main__":
    main()
