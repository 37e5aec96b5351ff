"""What a moving receiver does to its image: the exact derivative, jaxmc's and those of Mitsuba 3.

    python benchmarks/receiver_gradient.py [--seeds 16] [--spp 4096] [--peers .venv-peers/bin/python]

A camera looks at a diffuse floor, on which a lamp shines past a black rectangle; it sees neither of these. Each of the
three moves along z by itself: the shadow's edge moves over the floor in all three cases. The derivative of the mean of
the image is known by quadrature, see ``tests/two_bounce_reference.py``. Beside it stand

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
# What moves: the parameter of the reference, and the primitive.
MOVING = {"receiver": ("floor", 0), "blocker": ("blocker_z", 1), "lamp": ("lamp_z", 2)}
INTEGRATORS = {
    "direct_projective": {"type": "direct_projective"},
    "prb_projective": {"type": "prb_projective", "max_depth": 2},
}


def make(p):
    """Return (scene, camera): the floor, the blocker and the lamp of the reference, without its wall."""
    scene, camera = reference.make({**reference.PARAMS, **p})
    floor, _, blocker, lamp = scene.given[0]
    return mc.Scene([floor, blocker, lamp]), camera


def main():
    options = arguments()
    exact = reference.derivatives(reference.direct_mean, reference.PARAMS)
    found: dict = {"params": reference.PARAMS, "spp": options.spp, "seeds": options.seeds, "step": STEP, "moving": {}}
    with Peer(options.peers, "llvm_ad_rgb", SERVER) as peer:
        for name, (parameter, number) in MOVING.items():
            result = {"exact": float(exact[parameter]), **by_mitsuba(peer, number, options.spp, options.seeds)}
            if hasattr(mc, "moving_paths"):
                result["jaxmc"] = by_jaxmc(parameter)
            found["moving"][name] = result
            print(line(name, result), flush=True)
        found["mitsuba"] = peer.about["mitsuba"]
    write_json(options.out, found | {"machine": machine(), "versions": versions()})


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=16, help="runs of Mitsuba, from whose spread its error comes")
    parser.add_argument("--spp", type=int, default=4096, help="Mitsuba's samples per pixel of a 16 x 16 image")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with Mitsuba")
    parser.add_argument("--out", type=Path, default=RESULTS, help="the file of results")
    return parser.parse_args()


def by_mitsuba(peer, number, spp, seeds):
    """Return derivatives with standard errors: of differences, and of each integrator."""
    scene = describe(*make({}), spp, 1)
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


def by_jaxmc(parameter, n=1 << 18):
    """Return jaxmc's derivative, with standard error and both parts."""
    start = {parameter: reference.PARAMS[parameter]}
    found = mc.grad_integrate(
        lambda p: mc.moving_paths(*make(p), bounces=1), start, n=n, sampler=mc.Sobol(), key=1
    )  # fmt: skip
    parts = {"interior": found.interior.mean, "boundary": found.boundary.mean if found.boundary else {parameter: 0.0}}
    return {
        "mean": float(found.mean[parameter]), "stderr": float(found.stderr[parameter]), "n": n,
        **{name: float(part[parameter]) for name, part in parts.items()},
    }  # fmt: skip


def line(name, result):
    ways = [f"{way} {r['mean']:+.5f}({r['stderr']:.5f})" for way, r in result.items() if way != "exact"]
    return f"{name:9s} exact {result['exact']:+.5f}, {', '.join(ways)}"


if __name__ == "__main__":
    main()
