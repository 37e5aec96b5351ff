"""Processes that work together find the bits of a single one, and say so when one of them is lost."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_devices import HERE, integrals

from jaxmc.integration import machines

CODE = """
import sys, jax, jaxmc, test_devices
from jaxmc.integration import machines
jax.distributed.initialize("127.0.0.1:{port}", {count}, int(sys.argv[1]))
assert machines.join_processes().size == {count}
print("digests", *test_devices.integrals(), *test_devices.image())
"""


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
    from test_devices import image

    code = CODE.format(port=free_port(), count=count)
    processes = [start(["-c", code, str(rank)]) for rank in range(count)]
    expected = integrals() + image()
    for process in processes:
        out, errors, code = said(process)
        assert code == 0, errors
        assert out.split("digests")[1].split() == expected


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
    kept = out / ".unfinished"
    deadline = time.monotonic() + 300
    while not len(list(kept.glob("*.npz"))) > 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    second.send_signal(signal.SIGKILL)
    second.communicate()
    _, errors, code = said(first)
    assert code == 3 and "process 1 of 2 has given no sign of life" in errors
    before = len(list(kept.glob("*.npz")))
    assert before > 2
    # Another number of processes goes on.
    ended = [said(process) for process in processes(3, free_port())]
    assert [code for *_, code in ended] == [0, 0, 0], ended
    assert f"report: {out}" in ended[0][0] and not kept.exists()
    alone = said(start(study(tmp_path / "alone")))
    assert alone[2] == 0 and numbers(out) == numbers(tmp_path / "alone")


@pytest.mark.slow
def test_what_is_missing_is_named(tmp_path):
    _, errors, code = said(start(study(tmp_path / "out", "--distributed", "--address", "127.0.0.1:1")))
    assert code == 2 and "--processes" in errors
