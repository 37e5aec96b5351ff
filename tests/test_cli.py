"""The command line and the studies, in small."""

import json
import subprocess
import sys

import pytest

from jaxmc.cli import main
from jaxmc.studies import mirror_box, sparkles


@pytest.fixture(scope="module")
def small_mirror_box(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mirror-box")
    settings = mirror_box.Settings(spp=256, width=48, height=32, seed=3, progress=False)
    page = mirror_box.run(folder, settings)
    return page, json.loads((folder / "report.json").read_text())


def test_mirror_box_leaves_report_and_figures(small_mirror_box):
    page, report = small_mirror_box
    html = page.read_text()
    names = {p.stem for p in page.parent.glob("*.png")}
    assert names == {"images", "caustic", "exceedance", "firefly_map", "clamping", "convergence"}
    assert html.count("data:image/png;base64,") == len(names) and 'src="http' not in html
    assert report["seed"] == 3 and report["versions"]["jax"] and report["machine"]["cores"]


def test_mirror_box_tells_what_clamping_costs(small_mirror_box):
    values = small_mirror_box[1]["values"]
    assert 0.005 < values["energy lost to clamping at 3"] < 0.3
    assert values["fireflies: count"] > 0
    for n in (16, 128, 1024):
        at = values[f"MSE, N = {n}"]
        # The best clamp is never worse than no clamp; the largest threshold of the grid is nearly none.
        assert at["best"]["mse"] <= at["unclamped"]
        assert at["mse"][-1] == pytest.approx(at["unclamped"], rel=0.02)


def test_largest_samples_go_over_the_mirror(small_mirror_box):
    table = small_mirror_box[1]["tables"][1]
    assert all("mirror" in row[3] for row in table["rows"][:3])


@pytest.mark.slow
def test_sparkles_moments_stand_beside_the_exact_ones(tmp_path):
    settings = sparkles.Settings(paths=1 << 16, spp=2, progress=False)
    sparkles.run(tmp_path, settings)
    report = json.loads((tmp_path / "report.json").read_text())
    k, q, exact, measured, stderr, *cosine = report["tables"][-1]["rows"][0]
    assert (k, q) == (5, 1) and abs(measured - exact) < 5 * stderr
    assert cosine[1] == pytest.approx(cosine[0], rel=1e-5) and cosine[2] < 1e-6
    assert len(report["tables"][1]["rows"]) >= 2


def test_replay_prints_a_path(capsys):
    assert main(["replay", "mirror-box", "--sample", "12345"]) == 0
    out = capsys.readouterr().out
    assert "sample 12345" in out and "throughput" in out


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["study", "mirror-box", "--spp", "3"], "64"),
        (["study", "mirror-box", "--seed", "-1"], "seed"),
        (["study", "mirror-box", "--quiet", "--out", "/dev/null/x"], "Name another folder"),
        (["study", "sparkles", "--paths", "1"], "2^14"),
        (["replay", "mirror-box", "--sample", "-4"], "[0, 2^64)"),
    ],
)
def test_errors_are_one_line_with_the_cure(arguments, cure, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error


def test_unknown_study_is_a_usage_error():
    done = subprocess.run([sys.executable, "-m", "jaxmc.cli", "study", "nothing"], capture_output=True, text=True)
    assert done.returncode == 2 and "invalid choice" in done.stderr and "mirror-box" in done.stderr
