"""Error against run time: curves, races and the command, in small."""

import importlib
import json
import math
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import jaxmc as mc
from analytic_scenes import genz
from jaxmc import bench, known
from jaxmc.cli import main
from jaxmc.race import Curve, Method, Run, Rung, race

ROOT = Path(__file__).parents[1]


def law(name, rate, seconds_per_sample=1e-6, **about):
    """Return a method whose error on an integral of value 2 is n^rate and whose clock is told."""
    return Method(name, lambda n, seed: Run(2.0 * (1.0 + (-1) ** seed * n**rate), n, n * seconds_per_sample), **about)


def test_a_race_measures_error_time_and_slope():
    slow, quick = race([law("slow", -0.5), law("quick", -1.0, own=True)], 2.0, ladder=(64, 256, 1024), seeds=2)
    assert [rung.n for rung in quick.rungs] == [64, 256, 1024] and quick.own and not slow.own
    assert [rung.error for rung in slow.rungs] == pytest.approx([1 / 8, 1 / 16, 1 / 32])
    assert slow.slope(2)[0] == pytest.approx(-0.5) and quick.slope(2)[0] == pytest.approx(-1.0)
    # On a power law, interpolation is exact: the error 1/100 needs 100 samples.
    assert quick.seconds_to(0.01) == pytest.approx(1e-4)
    assert slow.seconds_to(0.01) == math.inf and slow.seconds_to(0.5) == slow.rungs[0].seconds


def test_a_race_goes_on_without_those_that_fail_or_are_done():
    def fails(n, seed):
        raise RuntimeError(f"no {n}\nmore words")

    methods = [Method("broken", fails), law("dear", -0.5, 1.0), law("done", -4.0), law("other", -0.5)]
    broken, dear, done, other = race(methods, 2.0, ladder=(16, 64, 256), seeds=2, seconds_each=100.0, enough=1e-3)
    assert broken.stopped == "RuntimeError: no 16" and not broken.rungs and math.isnan(broken.compile_seconds)
    assert dear.stopped == "time is up" and len(dear.rungs) == 1
    assert done.stopped == "error small enough" and len(done.rungs) == 1
    assert len(other.rungs) == 3 and not other.stopped
    assert "failed: RuntimeError" in bench.table([broken, other])


def test_compile_time_stands_apart():
    calls = []

    def run(n, seed):
        calls.append(seed)
        return Run(2.2, n, 5.0 if len(calls) == 1 else 0.5)

    (curve,) = race([Method("compiles", run)], 2.0, ladder=(16,), seeds=3)
    assert curve.rungs[0].seconds == 0.5 and curve.compile_seconds == 4.5
    assert calls == [0, 1, 2, 3]  # the seed of the first call is not among those measured


def test_our_methods_and_others_integrate():
    scene = genz.gaussian_peak(2)
    methods = bench.own_methods(scene.integrand, (mc.Independent(), mc.Sobol()), (mc.Lattice(),))
    names = {m.name: m.error_bar for m in methods}
    assert names == {"Independent": True, "Sobol": True, "Lattice, compiled": True, "Lattice, 1 replicate": False}
    for method in methods + bench.other_methods(scene.integrand):
        run = method.run(4096, 1)
        assert run.value == pytest.approx(scene.exact, rel=0.05) and 0 < run.n <= 4096 and run.seconds > 0, method.name


def test_names_of_the_command_all_lead_to_integrands_of_known_value():
    offered = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][known.GROUP]
    assert len(offered) > 10
    for value in offered.values():
        module, function = value.split(":")
        assert callable(getattr(importlib.import_module(module), function))
    assert bench.problem("analytic_scenes.genz:oscillatory", 3).integrand.dim == 3
    assert bench.problem("analytic_scenes:rectangle_light", 3).exact > 0  # has no choice of dimension


def test_the_command_writes_figure_and_strict_json(tmp_path, monkeypatch, capsys):
    own = bench.own_methods
    monkeypatch.setattr(bench, "own_methods", lambda f: own(f, (mc.Independent(),), ()))
    monkeypatch.setattr(bench, "race", lambda *a, **more: race(*a, ladder=(64, 256, 1024), **more))
    arguments = ["bench", "analytic_scenes.genz:continuous", "--dim", "2", "--max-seconds", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "Genz continuous, dim=2" in out and "Independent" in out and "SciPy qmc_quad Sobol" in out
    found = json.loads((tmp_path / "time_to_error.json").read_text(), parse_constant=pytest.fail)
    assert found["methods"]["Independent"]["own"] and found["machine"]["cores"] and found["versions"]["scipy"]
    assert (tmp_path / "time_to_error.png").read_bytes().startswith(b"\x89PNG")


def test_a_name_whose_package_is_gone_says_so(monkeypatch):
    monkeypatch.setattr(known, "offered", lambda: {"lost": "no_such_package:f"})
    with pytest.raises(ValueError, match=r"no integrand 'lost'.*no_such_package.*install the package again"):
        bench.problem("lost")


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["nothing"], "module:function"),
        (["analytic_scenes.genz:nothing"], "module:function"),
        (["analytic_scenes.genz:continuous", "--max-seconds", "0"], "--max-seconds"),
        (["analytic_scenes.genz:continuous", "--dim", "0"], "positive integer"),
        (["analytic_scenes.genz:continuous", "--out", "/dev/null/x"], "Name another"),
    ],
)
def test_errors_are_one_line_with_the_cure(arguments, cure, capsys):
    assert main(["bench", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error


def test_numpy_forms_of_the_benchmark_equal_ours(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.setattr(genz, "value_of", lambda *_: 1.0)  # takes seconds, and is not used
    integrators = importlib.import_module("integrators")
    u = np.random.default_rng(0).random((integrators.BLOCK + 7, 5), np.float32)
    with ThreadPoolExecutor(2) as pool:
        for name, family in integrators.FAMILIES.items():
            f = getattr(genz, name)(5).integrand
            theirs = integrators.in_blocks(family, f.params, pool)(u.astype(float))
            assert theirs == pytest.approx(np.asarray(f.batch(u)), rel=2e-4, abs=1e-5 * np.abs(theirs).max()), name


def test_the_slope_wants_three_rungs():
    curve = Curve("short", True, True, [Rung(16, 0.1, 1.0, 1.0), Rung(64, 0.05, 4.0, 4.0)])
    assert all(math.isnan(x) for x in curve.slope(8))
