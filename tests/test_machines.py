"""Processes that work together find the bits of a single one, and say so when one of them is lost."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_checkpoint import PIXEL_TALLIES, PIXELS, Killed, killed_after
from test_devices import HERE, digest, image, integrals

import jaxmc as mc
from jaxmc.integration import machines
from jaxmc.integration.dealing import _taken, places_of
from jaxmc.integration.kernel import BLOCK, LANES, lanes_for
from jaxmc.integration.merging import join_items
from jaxmc.integration.storage import from_bytes, to_bytes, to_plain
from jaxmc.scenes import mirror_box

CODE = """
import sys, jax, jaxmc, test_devices, test_machines
from jaxmc.integration import machines
jax.distributed.initialize("127.0.0.1:{port}", {count}, int(sys.argv[1]))
assert machines.join_processes().size == {count}
print("digests", *{call})
"""
EVERYTHING = "test_devices.integrals(), *test_devices.image(), *test_machines.families()"


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def start(command):
    environment = os.environ | {"PYTHONPATH": f"{HERE.parent}:{HERE}"}
    return subprocess.Popen(
        [sys.executable, *command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def said(process):
    out, errors = process.communicate(timeout=900)
    return out, errors, process.returncode


def test_alone_there_is_no_team():
    assert machines.team() is None
    with pytest.raises(ValueError, match=r"jax\.distributed\.initialize"):
        machines.join_processes()


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_every_process_has_the_bits_of_a_single_one(count):
    assert together(count, EVERYTHING) == integrals() + image() + families()


def families():
    """Return the digests of families: with all tallies, with randomisations, and in passes."""
    found = [mc.integrate_each(PIXELS, 5003, n=100, tallies=PIXEL_TALLIES, chunk=BLOCK)]
    found += [mc.integrate_each(PIXELS, 700, n=100, tallies={"buckets": mc.Buckets(5)}, sampler=mc.Sobol())]
    *_, last = mc.render_progressively(*mirror_box(True, 70, 50), spp=20, bounces=1)
    return [digest(estimate) for estimate in (*found, last)]


def kept(path, jobs, sampler=None):
    """Make a family with a checkpoint after every kernel call, and stop after so many of them; return its digest."""
    try:
        return digest(
            mc.integrate_each(
                PIXELS, 5003, n=300, tallies=PIXEL_TALLIES, chunk=BLOCK, checkpoint=mc.Checkpoint(path, seconds=0.0),
                progress=killed_after(jobs), sampler=sampler or mc.Independent(),
            )
        )  # fmt: skip
    except Killed:
        return "stopped"


def together(count, call):
    """Return the digests that so many processes find, which must be the same in all of them."""
    code = CODE.format(port=free_port(), count=count, call=call)
    found = []
    for process in [start(["-c", code, str(rank)]) for rank in range(count)]:
        out, errors, code = said(process)
        assert code == 0, errors
        found.append(out.split("digests")[1].split())
    assert all(one == found[0] for one in found)
    return found[0]


def test_all_integrals_are_dealt():
    for size, count in ((2, 128), (3, 5003), (4, 65537), (7, 448)):
        dealt = [places_of(rank, size, count) for rank in range(size)]
        assert np.array_equal(np.sort(np.concatenate(dealt)), np.arange(count))
        sizes = [len(places) for places in dealt]
        assert max(sizes) - min(sizes) <= -(-count // (size * LANES)) and len({lanes_for(n) for n in sizes}) == 1


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Sobol(), marks=pytest.mark.slow)], ids=str)
def test_states_that_are_dealt_and_put_together_are_as_before(sampler):
    kinds = {name: tally for name, tally in PIXEL_TALLIES.items() if not tally.pooled}
    made = mc.integrate_each(PIXELS, 300, n=64, tallies=kinds, sampler=sampler, indices=range(64), chunk=BLOCK).sums
    places = [places_of(rank, 3, 300) for rank in range(3)]
    parts = [{name: _taken(x, own, rank == 0) for name, x in made.states.items()} for rank, own in enumerate(places)]
    back = join_items(made.tallies, parts, np.argsort(np.concatenate(places)))
    got, want = [], []
    assert to_plain(from_bytes(to_bytes(back)), got) == to_plain(made.states, want)
    assert all(np.array_equal(a, b) for a, b in zip(got, want, strict=True)) and len(got) > 10


@pytest.mark.slow
def test_processes_go_on_with_what_one_began_and_one_with_what_they_began(tmp_path):
    path, whole = tmp_path / "run.npz", kept(tmp_path / "whole.npz", 10**6)
    # Three blocks of the kernel are a step: stop within one. Two blocks end it; then each process has two in a step.
    assert kept(path, 5) == "stopped"
    assert together(2, f"[test_machines.kept({str(path)!r}, 7)]") == ["stopped"]
    before = mc.Estimate.load(path)
    assert before.n == 128 and kept(path, 5) == "stopped" and mc.Estimate.load(path).n > 128
    assert together(3, f"[test_machines.kept({str(path)!r}, 10**6)]") == [whole]
    assert kept(path, 1) == whole


def study(out, *more):
    return ["-m", "jaxmc.cli", "study", "sparkles", "--paths", "1048576", "--quiet", "--out", str(out), *more]


def numbers(folder):
    values = json.loads(Path(folder, "report.json").read_text())["values"]
    values.pop("seconds of sampling")
    return values


@pytest.mark.slow
def test_when_a_process_is_lost_the_others_say_so_and_the_work_is_kept(tmp_path):
    out, port = tmp_path / "out", free_port()

    def processes(count, port):
        together = ["--distributed", "--address", f"127.0.0.1:{port}", "--processes", str(count), "--every", "0"]
        return [start(study(out, *together, "--resume", "--rank", str(rank))) for rank in range(count)]

    first, second = processes(2, port)
    left = out / ".unfinished"
    deadline = time.monotonic() + 300
    while not len(list(left.glob("*.npz"))) > 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    second.send_signal(signal.SIGKILL)
    second.communicate()
    _, errors, code = said(first)
    assert code == 3 and "process 1 of 2 has given no sign of life" in errors
    before = len(list(left.glob("*.npz")))
    assert before > 2
    # Another number of processes goes on.
    ended = [said(process) for process in processes(3, free_port())]
    assert [code for *_, code in ended] == [0, 0, 0], ended
    assert f"report: {out}" in ended[0][0] and not left.exists()
    alone = said(start(study(tmp_path / "alone")))
    assert alone[2] == 0 and numbers(out) == numbers(tmp_path / "alone")


@pytest.mark.slow
def test_what_is_missing_is_named(tmp_path):
    _, errors, code = said(start(study(tmp_path / "out", "--distributed", "--address", "127.0.0.1:1")))
    assert code == 2 and "--processes" in errors
