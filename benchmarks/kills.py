"""Kills a running study again and again, at random moments, and resumes it each time.

    python benchmarks/kills.py [--kills 100] [--seed 0] [--study "sparkles --paths 4194304"]

A kill is a SIGKILL: three in ten come at any moment from the start of the process, three in ten while a checkpoint is
being written, the others within two seconds of a checkpoint. The study keeps its sums after every kernel call. When it
ends, its report must hold the numbers of a run that nobody disturbed, bit for bit; times and dates aside. Then another
one is begun, until there were enough kills. Everything lands in ``benchmarks/results/kills.json``.
"""

import argparse
import json
import random
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from jaxmc.report import machine, versions, write_json

RESULTS = Path(__file__).parent / "results" / "kills.json"
PATIENCE = 600.0  # seconds without a checkpoint


def main():
    parser = argparse.ArgumentParser(description="Kill a study and resume it.")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--study", default="sparkles --paths 4194304")
    parser.add_argument("--out", default=str(RESULTS))
    options = parser.parse_args()
    command, draw = (
        [sys.executable, "-m", "jaxmc.cli", "study", *shlex.split(options.study)],
        random.Random(options.seed),
    )
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*command, "--out", f"{folder}/whole"], check=True)
        expected, kills, rounds = numbers(f"{folder}/whole"), [], 0
        while len(kills) < options.kills:
            rounds += 1
            out = f"{folder}/{rounds}"
            kills += disturbed([*command, "--every", "0", "--out", out], Path(out), draw, options.kills - len(kills))
            found = numbers(out)
            assert found == expected, f"round {rounds} gave other numbers: {difference(found, expected)}"
            assert not Path(out, ".unfinished").exists()
            print(f"round {rounds}: {len(kills)} kills so far, the numbers are the same", flush=True)
    facts = {"study": options.study, "kills": len(kills), "of them while writing": sum(kills), "rounds": rounds}
    facts |= {"resumes that failed": 0, "reports with other numbers": 0, "numbers in a report": len(expected)}
    write_json(options.out, {**facts, "machine": machine(), "versions": versions()})
    print(facts)


def disturbed(command, out, draw, most):
    """Run a study to its end, killed at most so many times; return for each kill whether it was writing."""
    kills = []
    while len(kills) < most:
        process = subprocess.Popen([*command, "--resume"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        at_moment(draw, out / ".unfinished", process)
        if process.poll() is not None:
            _check(process)
            return kills
        process.send_signal(signal.SIGKILL)
        process.wait()
        kills.append(bool(list((out / ".unfinished").glob(".*.npz.unfinished"))))
        print(f"  kill {len(kills)}{', while writing' if kills[-1] else ''}", flush=True)
    process = subprocess.Popen([*command, "--resume"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    process.wait()
    _check(process)
    return kills


def _check(process):
    assert process.returncode == 0, f"a resume failed:\n{process.stderr.read().decode()}"


def at_moment(draw, folder, process):
    """Wait for the moment of a kill, or the end of the process."""
    kind, started = draw.random(), time.time()
    if kind < 0.3:
        _wait(process, lambda: time.time() - started > delay, delay := draw.uniform(0.0, 30.0))
        return
    _wait(process, lambda: _newest(folder) > started, PATIENCE)
    if kind < 0.6:
        skip = draw.uniform(0.0, 2.0)
        _wait(process, lambda: time.time() - started > skip, skip)
        _wait(process, lambda: any(folder.glob(".*.npz.unfinished")), PATIENCE)
    else:
        _wait(process, lambda: False, draw.uniform(0.0, 2.0))


def _newest(folder):
    times = [0.0]
    for file in folder.glob("*.npz"):
        try:
            times.append(file.stat().st_mtime)
        except FileNotFoundError:
            pass
    return max(times)


def _wait(process, until, seconds):
    end = time.time() + seconds
    while process.poll() is None and time.time() < end and not until():
        time.sleep(0.0005)


def numbers(folder):
    """Return every number and word of a report by its place, without what tells of time."""
    found = {}

    def visit(place, value):
        if re.search(r"second|date|paths per|machine|versions", place.rsplit("/", 1)[-1]):
            return
        if isinstance(value, dict | list):
            for key, one in value.items() if isinstance(value, dict) else enumerate(value):
                visit(f"{place}/{key}", one)
        else:
            found[place] = value

    visit("", json.loads(Path(folder, "report.json").read_text()))
    return found


def difference(a, b):
    return [(k, a.get(k), b.get(k)) for k in sorted({*a, *b}) if a.get(k) != b.get(k)][:5]


if __name__ == "__main__":
    main()
