"""Error against run time: jaxmc, and what else one could integrate or render with, on the same machine in one run.

    python benchmarks/time_to_error.py [--only genz|irradiance|image] [--quick] [--peers .venv-peers/bin/python]

* genz: the six families of Genz in 8 dimensions, beside SciPy, vegas and QMCPy (``integrators.py``);
* irradiance: a point under a quad light, of known value, beside Mitsuba and the integrators that are installed here;
* image: the Cornell box, beside Mitsuba (``time_to_error_light.py`` has both).

An error is the root mean square relative error over some seeds, a time the median wall time of one estimate; seeds
alternate between the methods. A first call, which compiles, is in no median and stands apart as ``compile_seconds``.
Numbers go to ``benchmarks/results/time_to_error.json``, where parts that were not run keep what they had, and the
figure to ``docs/time_to_error.png``. With --quick both go to ``out/time_to_error``: it shows that all works, no more.
"""

import argparse
import json
import math
import os
from pathlib import Path

import numpy as np
from peers import Peer
from ratios import summary
from time_to_error_light import image, irradiance

from analytic_scenes import genz
from jaxmc import bench, plot, race, report

ROOT = Path(__file__).parents[1]
FAMILIES = ("oscillatory", "product_peak", "corner_peak", "gaussian_peak", "continuous", "discontinuous")
DIM = 8
TARGETS = (1e-4, 1e-6)
ENOUGH = 1e-7  # a curve that has come down so far has met both targets
PANELS = 3  # to a row of the figure


def main():
    options = arguments()
    parts = {"genz": families, "irradiance": irradiance, "image": image}
    results, figure = ROOT / "benchmarks/results/time_to_error.json", ROOT / "docs/time_to_error.png"
    if options.quick:
        results, figure = (ROOT / "out/time_to_error" / file.name for file in (results, figure))
    found = json.loads(results.read_text()) if results.exists() else {}
    for name in [options.only] if options.only else parts:
        load = os.getloadavg()
        found[name] = {"load_before": load, **parts[name](options), **bench.about()}
        report.write_json(results, found)  # after each part: a long run that is stopped keeps what it has
    draw(found, figure)
    print(f"All numbers: {results}\nFigure: {figure}")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=("genz", "irradiance", "image"), help="one part")
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to see that everything works")
    parser.add_argument("--peers", type=Path, default=ROOT / ".venv-peers/bin/python", help="the Python with the peers")
    return parser.parse_args()


def families(options):
    """Return what every method does on each family of Genz; 2 rungs of one family if it is to be quick."""
    settings = {"ladder": race.LADDER, "seeds": race.SEEDS, "seconds_each": 8.0, "enough": ENOUGH}
    if options.quick:
        settings |= {"ladder": race.LADDER[:3], "seeds": 2, "seconds_each": 1.0}
    server = Path(__file__).with_name("integrators.py")
    found = {"dim": DIM, "seeds": settings["seeds"], "families": {}}
    print("quadax is left out: adaptive cubature divides the cube along each of its 8 axes")
    with Peer(options.peers, "integrators", server) as peer:
        for name in FAMILIES[:1] if options.quick else FAMILIES:
            scene = getattr(genz, name)(DIM)
            others = other_methods(peer, name, scene.integrand)
            print(f"\n{scene.name}")
            curves = race.race(bench.own_methods(scene.integrand) + others, scene.exact, **settings)
            print(bench.table(curves, settings["seeds"]))
            found["families"][name] = {
                "exact": scene.exact, "targets": summary(curves, TARGETS),
                "methods": bench.as_dict(curves, settings["seeds"]),
            }  # fmt: skip
        found["peers"] = peer.about
    return found


def other_methods(peer, name, integrand):
    """Return the integrators of the other environment on the NumPy form of the integrand, after a look at its values.

    Raises ``RuntimeError`` where the two forms differ, or the other environment lacks what it needs.
    """
    params = [np.asarray(p).tolist() for p in integrand.params]
    peer.about = peer.ask({"family": name, "dim": integrand.dim, "params": params})
    u = np.random.default_rng(0).random((256, integrand.dim)).astype(np.float32)
    ours, theirs = np.asarray(integrand.batch(u)), np.array(peer.ask({"u": u.tolist()})["values"])
    if not np.allclose(ours, theirs, rtol=1e-4, atol=1e-5 * np.abs(theirs).max()):
        raise RuntimeError(f"{name}: the NumPy form differs from ours by {np.abs(ours - theirs).max()}")

    def method(kind):
        def run(n, seed):
            answer = peer.ask({"method": kind, "n": n, "seed": seed})
            return race.Run(answer["value"], answer["n"], answer["seconds"])

        return race.Method(kind, run, error_bar=not kind.endswith("points"))

    return [method(kind) for kind in peer.about["methods"]]


def draw(found, file):
    """Draw the figure of all parts that the results hold."""
    genz_parts = found.get("genz", {}).get("families", {})
    drawn = [(f"Genz {name.replace('_', ' ')}, {DIM}-D", one["methods"], TARGETS) for name, one in genz_parts.items()]
    light = [found[part] for part in ("irradiance", "image") if part in found]
    drawn += [(one["title"], one["methods"], one["target_errors"]) for one in light]
    others = list(dict.fromkeys(name for _, methods, _ in drawn for name, m in methods.items() if not m["own"]))
    fig, axes = plot.panels(len(drawn), min(PANELS, len(drawn)), size=(4.9, 3.9))
    for ax, (title, methods, targets) in zip(axes, drawn):
        curves = [
            race.Curve(name, m["own"], m["error_bar"], [race.Rung(**_numbers(rung)) for rung in m["rungs"]])
            for name, m in methods.items()
        ]
        plot.time_to_error(ax, curves, title, targets, others)
    plot.shared_legend(fig)
    file.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(file, dpi=110)


def _numbers(rung):
    """Return the numbers of a rung that may have been read from JSON, where NaN is null and infinity "inf"."""
    return {key: math.nan if value is None else float(value) for key, value in rung.items()}


if __name__ == "__main__":
    main()
