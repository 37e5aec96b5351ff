"""What two processes, two devices and two threads gain on two cores, against one process on one core.

    python benchmarks/processes.py [--rounds 7]

Two tasks in the Cornell box, with paths of 5 bounces: the radiance along one ray, from 2^25 paths, and an image of
256 x 256 pixels with 512 samples each. They are made by

* one process that is bound to one core,
* two processes, each bound to a core of its own, that make the estimate together (``mc.join_processes``),
* one process with two threads on two cores, as ``jaxmc`` works by itself,
* one process with two virtual devices on two cores, which share every kernel call.

All are started and warmed up before the first round, and take turns; a time is from the word to begin until the last
process of a kind has its estimate. A gain compares neighbours in a round; the seconds of all cores together tell what
was spent where other work slowed down the clock. All results must have the same bits.
Everything lands in ``benchmarks/results/processes.json``.
"""

import argparse
import hashlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results" / "processes.json"
TASKS = ("integral", "image")
PATHS, SIZE, SPP, BOUNCES = 1 << 25, 256, 512, 5
ALONE = "one process on one core"
# Cores of each process, and devices of each.
KINDS = {
    ALONE: ([{0}], 1),
    "two processes": ([{0}, {1}], 1),
    "two threads": ([{0, 1}], 1),
    "two devices": ([{0, 1}], 2),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", default=str(RESULTS))
    parser.add_argument("--work", nargs=3, type=int, metavar=("COUNT", "RANK", "PORT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work(*options.work)
    from jaxmc.report import machine, versions, write_json

    groups = {name: Group(*kind) for name, kind in KINDS.items()}
    found = {"paths": PATHS, "size": SIZE, "spp": SPP, "bounces": BOUNCES, "rounds": options.rounds}
    for task in TASKS:
        digests = {name: group.make(task)[2] for name, group in groups.items()}
        assert len(set(digests.values())) == 1, f"{task}: other bits: {digests}"
    found["load before"] = os.getloadavg()
    for task in TASKS:
        seconds, spent = ({name: [] for name in groups} for _ in range(2))
        for _ in range(options.rounds):
            for name, group in groups.items():
                clock, cores, _ = group.make(task)
                seconds[name].append(clock)
                spent[name].append(cores)
        found[task] = {name: figures(times, seconds[ALONE], spent[name]) for name, times in seconds.items()}
        for name, figure in found[task].items():
            low, middle, high = figure["gain from"], figure["gain"], figure["gain to"]
            spent = f"{figure['core seconds']:.2f} s of cores"
            print(f"{task}, {name}: {figure['seconds']:.2f} s, {spent}, gain {middle:.2f} ({low:.2f} to {high:.2f})")
    for group in groups.values():
        group.end()
    write_json(options.out, {**found, "machine": machine(), "versions": versions()})


def figures(times, alone, spent):
    low, middle, high = np.quantile(np.divide(alone, times), (0.0, 0.5, 1.0))
    found = {"seconds": np.median(times), "core seconds": np.median(spent)}
    return found | {"gain": middle, "gain from": low, "gain to": high, "times": times}


class Group:
    """Processes that wait for the word to make an estimate, together."""

    def __init__(self, cores, devices):
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            port = s.getsockname()[1]
        environment = os.environ | {"JAX_NUM_CPU_DEVICES": str(devices)}
        self.processes = [
            subprocess.Popen(
                [sys.executable, __file__, "--work", str(len(cores)), str(rank), str(port)], env=environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, preexec_fn=lambda own=own: os.sched_setaffinity(0, own),
            )
            for rank, own in enumerate(cores)
        ]  # fmt: skip
        for process in self.processes:
            assert process.stdout.readline() == "ready\n"

    def make(self, task):
        """Return the seconds that it took, those of all cores together, and the digest of the estimate."""
        start = time.perf_counter()
        for process in self.processes:
            process.stdin.write(f"{task}\n")
            process.stdin.flush()
        said = [process.stdout.readline().split() for process in self.processes]
        seconds, digests = time.perf_counter() - start, {digest for digest, _ in said}
        assert len(digests) == 1, digests
        return seconds, sum(float(spent) for _, spent in said), digests.pop()

    def end(self):
        for process in self.processes:
            process.stdin.close()
        for process in self.processes:
            process.wait()


def work(count, rank, port):
    """Make an estimate for each task on standard input, and print its digest and the seconds of its cores."""
    import jax

    import jaxmc as mc
    from jaxmc.scenes import cornell_box

    if count > 1:
        jax.distributed.initialize(f"127.0.0.1:{port}", count, rank)
        mc.join_processes()
    scene, camera = cornell_box(SIZE, SIZE)
    ray = mc.radiance(scene, (0.0, 0.0, 0.9), (0.3, -0.4, -1.0), bounces=BOUNCES)
    tasks = {
        "integral": lambda: mc.integrate(ray, n=PATHS),
        "image": lambda: mc.render(scene, camera, spp=SPP, bounces=BOUNCES),
    }
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.process_time()
        estimate = tasks[line.strip()]()
        spent = time.process_time() - start
        bits = b"".join(np.asarray(x).tobytes() for x in jax.tree.leaves(estimate.moments))
        print(hashlib.sha256(bits).hexdigest(), spent, flush=True)


if __name__ == "__main__":
    main()
