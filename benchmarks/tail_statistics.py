"""What recording the tail statistics of every pixel costs, as a share of the time of the render.

    python benchmarks/tail_statistics.py

Renders with and without the tally take turns; each pair gives a ratio of CPU times, of which the median counts.
"""

import argparse
import time

import numpy as np

import jaxmc as mc
from jaxmc import scenes


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--spp", type=int, default=128)
    args = parser.parse_args()
    tally = {"tails": mc.PixelTails(of=mc.luminance)}
    for name in ("cornell-box", "mirror-box"):
        scene, camera = scenes.SCENES[name]()
        for bounces in (5, 8):

            def seconds(key, tallies, scene=scene, camera=camera, bounces=bounces):
                start = time.process_time()
                mc.render(scene, camera, spp=args.spp, bounces=bounces, key=key, tallies=tallies)
                return time.process_time() - start

            seconds(0, None), seconds(0, tally)  # compile
            pairs = np.array([[seconds(k, None), seconds(k, tally)] for k in range(args.rounds)])
            ratios = pairs[:, 1] / pairs[:, 0] - 1.0
            low, middle, high = np.quantile(ratios, [0.25, 0.5, 0.75])
            print(
                f"{name}, {args.spp} spp, {bounces} bounces: {np.median(pairs[:, 0]):.2f} s of CPU, "
                f"tail statistics {middle:+.1%} (quartiles {low:+.1%} to {high:+.1%})"
            )


if __name__ == "__main__":
    main()
