"""What a checkpoint costs, and what parts of an image cost in files and memory.

    python benchmarks/checkpoints.py [--seconds 60]

For a single integral and for images: the size of a file, the time to write and to read it, and the time to tell a
recipe. For a render of about so many seconds with a checkpoint every ten: the share of its time that went into them.
For an image in four parts, by samples and by tiles: the bytes of a part's file, the largest memory of a process that
makes one, and the time to merge. Everything lands in ``benchmarks/results/checkpoints.json``.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax.numpy as jnp

import jaxmc as mc
from jaxmc.integration import checkpoint
from jaxmc.report import machine, versions, write_json
from jaxmc.scenes import cornell_box

RESULTS = Path(__file__).parent / "results" / "checkpoints.json"
SIZE, SPP = 512, 64
PARTS, LARGE, FEW = 4, 1536, 16  # parts of a large image of few samples


def steep(u):
    return u[0] / jnp.sqrt(u[1])


def image(size=SIZE, spp=SPP, **options):
    return mc.render(*cornell_box(size, size), spp=spp, bounces=5, **options)


KINDS = {
    "integral, tail and 4096 largest": lambda path: mc.integrate(
        steep, dim=2, n=1 << 20, tallies={"tail": mc.TailHistogram(), "top": mc.TopSamples()}, checkpoint=path
    ),
    "image of 128 x 128": lambda path: image(128, 32, checkpoint=path),
    "image of 512 x 512": lambda path: image(512, 32, checkpoint=path),
    "image of 1024 x 1024": lambda path: image(1024, 32, checkpoint=path),
}


def timed(run, *arguments):
    start = time.perf_counter()
    result = run(*arguments)
    return result, time.perf_counter() - start


def costs(folder):
    """Return size and times of the file of each kind."""
    found = {}
    for name, make in KINDS.items():
        path = Path(folder, "run.npz")
        estimate = make(path)
        writing = min(timed(estimate.save, path)[1] for _ in range(5))
        reading = min(timed(mc.Estimate.load, path)[1] for _ in range(3))
        found[name] = {"bytes": path.stat().st_size, "write ms": 1e3 * writing, "read ms": 1e3 * reading}
        print(name, found[name], flush=True)
        path.unlink()
    return found


def share(folder, seconds):
    """Return what part of the time of a render went into its checkpoints, and how many there were."""
    spent, write, tell = [], checkpoint.Keeper.write, checkpoint.recipe

    def measured(keeper):
        spent.append(timed(write, keeper)[1])

    def told(*arguments):
        result, telling = timed(tell, *arguments)
        found["recipe ms"] = 1e3 * telling
        return result

    found = {}
    checkpoint.Keeper.write, checkpoint.recipe = measured, told
    warm = image(SIZE, SPP)
    again = timed(image, SIZE, SPP)[1]
    spp = max(SPP, int(seconds / again * warm.n))
    plain = timed(image, SIZE, spp)[1]
    kept = timed(lambda: image(SIZE, spp, checkpoint=Path(folder, "share.npz")))[1]
    found |= {"spp": spp, "seconds without": plain, "seconds with": kept, "writes": len(spent), "writing": sum(spent)}
    return found | {"share of writing": sum(spent) / kept}


def part(way, number, path):
    """Make a part of an image, and print the largest memory of this process."""
    pixels = LARGE // PARTS
    by = {"samples": {"indices": range(number * FEW // PARTS, (number + 1) * FEW // PARTS)}}
    by["tiles"] = {"tiles": [(0, number * pixels, LARGE, pixels)]}
    image(LARGE, FEW, checkpoint=path, **by[way])
    # What resource tells would begin with the memory of the process that started this one.
    peak = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    print("memory", int(peak[1]) * 1024)


def parts(folder):
    """Return what an image costs that is made in parts."""
    found = {}
    for way in ("samples", "tiles"):
        files, memory = [Path(folder, f"{way}-{k}.npz") for k in range(PARTS)], []
        for k, file in enumerate(files):
            command = [sys.executable, __file__, "--part", way, str(k), str(file)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            memory.append(int(done.stdout.split("memory")[1]))
        merged, seconds = timed(lambda: mc.merge(*map(mc.Estimate.load, files)))  # noqa: B023
        found[way] = {
            "bytes of a part": files[0].stat().st_size, "bytes of all": sum(f.stat().st_size for f in files),
            "memory of a process": sorted(memory)[PARTS // 2], "seconds to read and merge": seconds, "spp": merged.n,
        }  # fmt: skip
        print(way, found[way], flush=True)
    return found


def main():
    parser = argparse.ArgumentParser(description="Measure what checkpoints cost.")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--out", default=str(RESULTS))
    parser.add_argument("--part", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        return part(options.part[0], int(options.part[1]), options.part[2])
    with tempfile.TemporaryDirectory() as folder:
        found = {"files": costs(folder), "parts": parts(folder), "render": share(folder, options.seconds)}
    print(found["render"])
    write_json(options.out, {**found, "machine": machine(), "versions": versions()})


if __name__ == "__main__":
    main()
