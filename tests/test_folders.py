"""Studies that are stopped go on where they were, and nothing of theirs stays behind when they end."""

import dataclasses
import json
import os
import signal
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import pytest
from test_checkpoint import Killed, killed_after, same

import jaxmc as mc
from jaxmc import cli, study_commands
from jaxmc.integration.folders import kept_in
from jaxmc.integration.kernel import BLOCK


def steep(u):
    return u[0] / jnp.sqrt(u[1])


def flat(u):
    return u[0] + u[1]


N = 3 * BLOCK
ABOUT = {"study": "of three estimates"}


def work(progress=None, n=N):
    """Return three estimates, the last of them of as many samples as the first one needs."""
    one = mc.integrate(steep, dim=2, n=n, chunk=BLOCK, progress=progress)
    two = mc.integrate(flat, dim=2, n=n, chunk=BLOCK, progress=progress, key=round(100 * one.mean))
    return one, two, mc.integrate(flat, dim=2, rtol=1e-3, chunk=BLOCK, progress=progress)


def test_work_is_taken_up_where_it_was(tmp_path):
    whole, folder = work(), tmp_path / "kept"
    calls = []
    for _ in range(20):
        try:
            with kept_in(folder, ABOUT, True, 0.0):
                found = work(killed_after(3))
            break
        except Killed:
            calls.append(sorted(os.listdir(folder)))
    assert 3 <= len(calls) < 20 and calls[-1] == ["00001.npz", "00002.npz", "00003.npz", "about.json"]
    assert all(same(a, b) for a, b in zip(found, whole, strict=True)) and not folder.exists()
    assert all(estimate.sums is None for estimate in found)


def test_what_is_short_leaves_no_file(tmp_path):
    with pytest.raises(Killed), kept_in(tmp_path / "kept", ABOUT, False):
        work()
        raise Killed
    assert os.listdir(tmp_path / "kept") == ["about.json"]


def test_other_work_is_not_resumed(tmp_path):
    folder = tmp_path / "kept"
    with pytest.raises(Killed), kept_in(folder, ABOUT, False, 0.0):
        work(killed_after(5))
    before = sorted(os.listdir(folder))
    with pytest.raises(ValueError, match=r"was begun as .* and this is .* leave out --resume"):
        with kept_in(folder, {"study": "another"}, True):
            raise AssertionError
    assert sorted(os.listdir(folder)) == before
    # Files that are damaged, or of another estimate, are made anew.
    (folder / "00001.npz").write_bytes(b"nothing")
    with kept_in(folder, ABOUT, True, 0.0):
        assert same(work(n=2 * BLOCK)[1], work(n=2 * BLOCK)[1])


@dataclasses.dataclass(frozen=True)
class Settings:
    n: int = N
    seed: int = 0
    progress: bool = True


def run(folder, settings):
    estimates = work(run.progress, settings.n)
    path = Path(folder, "report.json")
    path.write_text(json.dumps([float(e.mean) for e in estimates]))
    return path


STUDY = study_commands.Study(
    "a study", SimpleNamespace(__name__="x", Settings=Settings, run=run), {"n": (N, "samples")}
)


def test_a_study_resumes_on_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(study_commands.STUDIES, "small", STUDY)
    out, calls = tmp_path / "out", []

    def interrupt(done, total):
        calls.append(done)
        if len(calls) == 5:
            os.kill(os.getpid(), signal.SIGINT)

    command = ["study", "small", "--out", str(out), "--every", "0"]
    monkeypatch.setattr(run, "progress", interrupt, raising=False)
    assert cli.main(command) == 130
    said = capsys.readouterr().err
    assert "00002.npz: 0.99" in said.replace("1.00", "0.99") and "--resume goes on" in said
    assert cli.main([*command, "--resume", "--n", "5"]) == 2 and "was begun as" in capsys.readouterr().err
    assert cli.main([*command, "--resume"]) == 0
    # The first estimate is read, the second goes on after two of its three calls.
    assert calls[:6] == [BLOCK, 2 * BLOCK, N, BLOCK, 2 * BLOCK, N]
    assert json.loads((out / "report.json").read_text()) == [float(e.mean) for e in work()]
    assert os.listdir(out) == ["report.json"]
    assert cli.main([*command[:-1], "-1"]) == 2 and "seconds between" in capsys.readouterr().err
