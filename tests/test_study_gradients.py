"""The study of estimators of derivatives: each of them against theory, and the report in small."""

import itertools
import json

import numpy as np
import pytest

import analytic_scenes
from jaxmc.cli import main
from jaxmc.studies import gradient_albedo, gradient_roughness, gradient_tasks, gradients

N = 1 << 17


def measured(task, names=None, n=N):
    """Return what is found of the estimators of a task, by name."""
    chosen = tuple(e for e in task.estimators if names is None or e.name in names)
    assert names is None or len(chosen) == len(names)
    return {f.estimator: f for f in gradients.measure(task._replace(estimators=chosen), n, itertools.count(1 << 8))}


def check(task, found):
    """Fail unless what is unbiased in theory agrees, and what is not is called biased where that can be told."""
    limits = {e.name: e.limit for e in task.estimators}
    for name, f in found.items():
        if f.sound:
            assert abs(f.z) < 5.0, (task.name, f)
        if f.z_of_limit is not None:
            assert abs(f.z_of_limit) < 5.0, (task.name, f)
            if abs(limits[name] - task.exact) > 10.0 * f.stderr + 1e-4 * abs(task.exact):
                assert f.is_biased and not f.sound, (task.name, f)


@pytest.mark.parametrize(
    "light, alpha", [("constant", 0.2), pytest.param("lobe", 0.05, marks=pytest.mark.slow), ("disk", 0.5)]
)
def test_quadrature_beside_another_program(light, alpha):
    known = analytic_scenes.rough_metal_under(light, alpha)
    derivative = {"constant": -0.718, "lobe": -2.98, "disk": -0.0386}[light]  # of 5e5 samples
    error = known.score_variance**0.5 / 5e5**0.5
    assert abs(known.derivative - derivative) < 5.0 * error < 0.08 * abs(derivative)
    assert known.score_variance**0.5 == pytest.approx(gradients.EARLIER[light, alpha][1], rel=0.01)
    step = 1e-4
    ends = (analytic_scenes.rough_metal_under(light, alpha + s * step).value for s in (1, -1))
    assert np.subtract(*ends) / (2 * step) == pytest.approx(known.derivative, rel=2e-4)
    with pytest.raises(ValueError, match="constant, lobe or disk"):
        analytic_scenes.rough_metal_under("lamp", alpha)


def test_attached_directions_miss_the_edge_of_a_disk():
    task = gradient_roughness.roughness_task("disk", 0.2)
    kinds = (gradient_roughness.ATTACHED, gradient_roughness.SCORE, gradient_roughness.CONTROLLED)
    found = measured(task, [f"{kind}, {gradient_roughness.BY_DENSITY}" for kind in kinds])
    check(task, found)
    attached, score, controlled = found.values()
    assert attached.is_biased and attached.mean == pytest.approx(-0.034, abs=0.001)
    variance = analytic_scenes.rough_metal_under("disk", 0.2).score_variance
    assert score.variance == pytest.approx(variance, rel=0.05) and controlled.variance < 0.97 * variance
    # The check sees what is wrong by 2 % and what has another's derivative.
    wrong = {name: f._replace(sound=True) for name, f in found.items()}
    with pytest.raises(AssertionError):
        check(task, wrong)


def test_absorption_needs_the_score():
    task = gradient_albedo.albedo_task()
    found = measured(task, ["absorption, attached", "absorption, score", "absorption, score, with control"])
    check(task, found)
    attached, score, controlled = found.values()
    assert attached.is_biased and attached.mean == 0.0 and not score.is_biased
    assert controlled.variance < 0.15 * score.variance
    # By hand: the score is N / p - 1 / (1 - p), or 4 / p after all 4; half of the walks end at each event.
    share, events = np.array([0.5, 0.25, 0.125, 0.0625, 0.0625]), np.arange(5)
    products = (1 + events) * (events / 0.5 - np.where(events < 4, 2.0, 0.0))
    assert products @ share == pytest.approx(3.25)
    assert score.variance == pytest.approx(products**2 @ share - 3.25**2, rel=0.05)


@pytest.mark.slow
def test_the_receiver_of_a_shadow():
    task = gradient_tasks.shadow_task("receiver")
    names = ["plain AD, points on lights drawn", "interior + boundary", "softened by 0.3"]
    found = measured(task, names, n=1 << 16)
    check(task, found)
    plain, whole, soft = found.values()
    assert plain.is_biased and plain.mean == pytest.approx(21.3 * task.exact, rel=0.1)
    assert soft.is_biased and not whole.is_biased and whole.stderr < 0.2 * task.exact


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda: gradient_tasks.shadow_task("edge"),
        lambda: gradient_tasks.shadow_task("receiver"),
        gradient_tasks.light_task,
        gradient_albedo.albedo_task,
        gradient_roughness.paths_task,
    ],
)
def test_every_estimator_leads_where_theory_says(make):
    task = make()
    found = measured(task, n=1 << 18)
    check(task, found)
    for f in found.values():
        assert f.sound or f.z_of_limit is not None or "softened" in f.estimator


@pytest.mark.slow
@pytest.mark.parametrize("light, alpha", gradients.EARLIER)
def test_every_estimator_of_roughness(light, alpha):
    task = gradient_roughness.roughness_task(light, alpha)
    found = measured(task, n=1 << 19)
    check(task, found)
    for word, before in zip(gradients.COMPARED, gradients.EARLIER[light, alpha]):
        if before is not None:
            sigma = found[f"{word}, {gradient_roughness.BY_DENSITY}"].variance ** 0.5
            # Draws that move toward the horizon, or across an edge, make heavy tails.
            moves = word in (gradient_roughness.ATTACHED, gradient_roughness.DIFFERENCE)
            tail = 0.25 if moves and light != "lobe" else 0.06
            assert sigma == pytest.approx(before, rel=tail)


@pytest.mark.slow
def test_report(tmp_path):
    assert main(["study", "gradients", "--samples", "4096", "--quiet", "--out", str(tmp_path)]) == 0
    values = json.loads((tmp_path / "report.json").read_text())["values"]
    assert values["unbiased in theory, but called biased"] == []
    plain = values["receiver moves"][1]
    assert plain["verdict"] == "biased" and plain["bias"] == pytest.approx(0.2, rel=0.2)
    for name in ("edge_moves", "receiver_moves", "light_moves", "albedo_changes", "roughness"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_settings_are_checked(capsys):
    assert main(["study", "gradients", "--samples", "1"]) != 0
    assert "2^10" in capsys.readouterr().err
