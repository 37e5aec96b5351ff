"""Coverage: right intervals hold, wrong ones are found out, and heavy tails are refused."""

import dataclasses
import functools
import json
import tomllib
from importlib import metadata
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from analytic_scenes import integrands
from jaxmc import known, plot
from jaxmc.analysis.coverage import Coverage, coverage
from jaxmc.cli import main
from jaxmc.studies import calibration

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
LINE = mc.Integrand(lambda u: u[0] + u[1], 2)


@functools.cache
def independent(key):
    return mc.integrate(LINE, n=1000, key=key)


@functools.cache
def replicated(key):
    return mc.integrate(LINE, n=1024, sampler=mc.Sobol(), key=key)


def scaled(run, factor):
    """Return the mutant whose standard error is ``factor`` times too large."""

    def mutant(key):
        estimate = run(key)
        name = "moments" if estimate.between is None else "between"
        moments = [m._replace(central=[m.central[0] * factor**2, *m.central[1:]]) for m in getattr(estimate, name)]
        return dataclasses.replace(estimate, **{name: moments})

    return mutant


@pytest.fixture(scope="module")
def normal():
    return coverage(independent, 1.0, replicates=400)


def test_right_intervals_hold(normal):
    lower, upper = normal.band(0.999)
    assert np.all((lower <= normal.levels) & (normal.levels <= upper)) and normal.status() == "holds"
    assert normal.claims == normal.replicates == 400 and normal.refused == {} and normal.n == 1000
    for value, truth in ((normal.ratio, 1.0), (normal.bias, 0.0)):
        assert abs(value[0] - truth) < 5 * value[1] < 0.3
    assert (
        normal.methods == ("corrected for skewness",)
        and normal.z.std() == pytest.approx(1.0, abs=0.2)
        and normal.dof == np.inf
    )


@pytest.mark.parametrize("run", [independent, replicated])
@pytest.mark.parametrize(("factor", "status"), [(0.5, "too short"), (2.0, "too long")])
def test_a_wrong_error_bar_is_found_out(run, factor, status):
    result = coverage(scaled(run, factor), 1.0, replicates=150)
    assert result.status() == status and result.verdict.startswith(f"{status}: ")
    ratio, error = result.ratio
    assert abs(ratio - factor) < 5 * error


def test_replicates_follow_student():
    result = coverage(
        replicated, 1.0, replicates=150, methods=("student-t over replicates", "median of means", bounded)
    )
    assert result.status() == "holds" and result.dof == 15
    assert result.methods == ("student-t over replicates", "median of means", "bounded")
    # For any law: it cannot be too short, and is far too long.
    assert result.status(2) == "too long" and result.covered[2].min() == 1.0
    assert len(result.rows()) == 12 and "median of means: " in str(result)


def bounded(estimate, level):
    return estimate.interval(level, bounds=(0.0, 2.0))


def test_a_biased_estimate_is_too_short():
    result = coverage(independent, 1.02, replicates=200)
    bias, error = result.bias
    assert result.status() == "too short" and bias < -5 * error


@pytest.mark.parametrize("case", range(len(calibration.HEAVY)))
def test_heavy_tails_are_refused(case, installed):
    (problem,) = calibration.problems(calibration.HEAVY[case : case + 1])
    result = coverage(lambda key: mc.integrate(problem.integrand, n=4096, key=key), problem.exact, replicates=40)
    assert result.refused["tail too heavy"] > 0.3
    assert result.claims + result.refusals["tail too heavy"] == 40


@pytest.mark.parametrize("sampler", calibration.SAMPLERS[: calibration.FIRST], ids=calibration._name)
def test_light_tails_are_not_refused(sampler, installed):
    # The most skew of them: its skewness^2 is n / 1000.
    (problem,) = calibration.problems(calibration.LIGHT[:1])
    runs = (mc.integrate(problem.integrand, n=4096, key=key, sampler=sampler) for key in range(100))
    assert not any(estimate.heavy for estimate in runs)


SHORT = calibration.LIGHT[6], calibration.LIGHT[10]  # lattices at an edge of light: their means take few values


@pytest.mark.slow
@pytest.mark.parametrize("case", SHORT, ids=lambda case: case[0])
def test_skew_means_of_lattices_are_covered(case, installed):
    (problem,) = calibration.problems([case])
    methods = (None, "student-t over replicates")
    result = coverage(lambda key: mc.integrate(problem.integrand, n=4096, key=key, sampler=mc.Lattice()),
                      problem.exact, replicates=4000, levels=(0.95,), methods=methods)  # fmt: skip
    (corrected,), (plain,) = result.covered
    assert 0.935 < corrected < 0.965 and plain < corrected - 0.005 and not result.refusals


@pytest.mark.slow
@pytest.mark.parametrize("sampler", calibration.SAMPLERS[: calibration.FIRST], ids=calibration._name)
def test_the_product_of_ten_weights_is_refused_mostly(sampler, installed):
    (problem,) = calibration.problems(calibration.HEAVY[3:4])
    result = coverage(lambda key: mc.integrate(problem.integrand, n=4096, key=key, sampler=sampler), problem.exact,
                      replicates=1000)  # fmt: skip
    assert result.status() == "refuses"


def test_values_that_are_not_finite_are_refused():
    result = coverage(lambda key: mc.integrate(lambda u: 1.0 / jnp.floor(2 * u[0]), dim=1, n=64, key=key), 1.0,
                      replicates=3)  # fmt: skip
    assert result.refused == {"non-finite values seen": 1.0} and np.isnan(result.covered).all()
    assert result.verdict == "refuses: 3 of 3 estimates (non-finite values seen: 3); none claims anything"
    assert np.isnan(result.ratio + result.bias).all() and "nan" in str(result)


def test_one_randomisation_has_no_error_bar():
    one = coverage(lambda key: mc.integrate(LINE, n=64, sampler=mc.Sobol(), replicates=1, key=key), 1.0, replicates=3)
    assert one.refusals == {"no error bar": 3}


def test_an_error_of_zero_is_a_claim():
    constant = mc.Integrand(lambda u: 0.0 * u[0] + 0.5, 1)
    for exact, share in ((0.5, 1.0), (0.6, 0.0)):
        result = coverage(lambda key: mc.integrate(constant, n=64, key=key), exact, replicates=30)
        assert result.claims == 30 and result.covered[0, 0] == share


def test_the_table_can_be_read(normal):
    text = str(normal)
    assert "400 estimates of 1, n = 1,000" in text and "claimed / actual error" in text and "refused none" in text
    assert text.splitlines()[-1] == normal.verdict and normal.verdict.startswith("holds: ")
    assert "cover at 0.95, that is 0." in normal.verdict


def test_progress_is_told():
    seen = []
    coverage(independent, 1.0, replicates=3, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3)]


MISTAKES = [
    (dict(exact=np.nan), "exact"),
    (dict(exact=[1.0]), "exact"),
    (dict(replicates=0), "replicates"),
    (dict(levels=(0.5, 95.0)), "0.95 for 95 %"),
    (dict(methods=()), "methods"),
    (dict(methods=("student",)), "method must be"),
    (dict(run=lambda key: 1.0), "return an Estimate, got 1.0"),
    (dict(run=lambda key: mc.integrate(lambda u: u, dim=2, n=8, key=key)), "one number.*Integrand.map"),
]


@pytest.mark.parametrize(("change", "match"), MISTAKES)
def test_mistakes_are_named_with_their_cure(change, match):
    arguments = dict(run=independent, exact=1.0, replicates=2) | change
    with pytest.raises(ValueError, match=match):
        coverage(**arguments)


# The study.


@pytest.fixture(scope="module")
def installed():
    """Offer what this project's metadata say, even where an older copy of them is installed."""
    with pytest.MonkeyPatch.context() as patch:
        points = PROJECT["entry-points"][known.GROUP].items()
        offered = metadata.EntryPoints(metadata.EntryPoint(*point, known.GROUP) for point in points)
        patch.setattr(metadata, "entry_points", lambda group: offered.select(group=group))
        yield


def test_the_integrals_of_the_study_are_installed(installed):
    light, heavy = (calibration.problems(table) for table in (calibration.LIGHT, calibration.HEAVY))
    assert len({p.name for p in [*light, *heavy]}) == len(calibration.LIGHT + calibration.HEAVY)
    # No error bar is tested by an integrand that is constant; the heavy ones have a large variance or none.
    assert all(p.exact_variance is None or p.exact_variance > 0 for p in light)
    assert all(p.exact_variance is None or p.exact_variance > 10 * p.exact**2 for p in heavy)


def test_a_study_without_integrals_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(metadata, "entry_points", lambda group: ())
    assert main(["study", "calibration", "--out", str(tmp_path / "study")]) == 2
    error = capsys.readouterr().err
    assert "analytic_scenes, which is not found" in error and "Install jaxmc again" in error and error.count("\n") == 1
    assert not (tmp_path / "study").exists()


@pytest.fixture(scope="module")
def small(tmp_path_factory, installed):
    folder = tmp_path_factory.mktemp("calibration")
    settings = calibration.Settings(replicates=20, samplers=(mc.Independent(), mc.Lattice()), progress=False)
    light = [integrands.linear_product(3)]
    heavy = calibration.problems(calibration.HEAVY[1:2])
    page = calibration.run(folder, settings, light, heavy)
    return page, json.loads((folder / "report.json").read_text())


def test_the_study_leaves_report_and_figures(small):
    page, report = small
    assert {p.stem for p in page.parent.glob("*.png")} == {"reliability", "z_scores", "rules"}
    assert page.read_text().count("data:image/png;base64,") == 3
    fixed, stopped, heavy, rules = (table["rows"] for table in report["tables"])
    assert [row[1] for row in fixed] == ["Independent", "Lattice"] and [row[-1] for row in fixed] == ["holds"] * 2
    assert [row[:2] for row in stopped] == [[integrands.linear_product(3).name, "Independent"]]
    assert {row[-1] for row in heavy} <= {"refuses", "too short"} and len(rules) == 2
    assert report["values"]["runs"] == 20 * 5 and len(report["values"]["light: verdicts"]) == 2


def test_inverse_variances_lose_the_spikes(small):
    (_, pooled, error, _, _), (_, weighed, _, covered, _) = small[1]["tables"][-1]["rows"]
    assert abs(pooled - 1.0) < 5 * error < 0.3
    assert weighed < 0.5 and covered < 0.2


def test_the_study_refuses_few_replicates(capsys):
    assert main(["study", "calibration", "--replicates", "3"]) == 2
    assert "20 to 2^20" in capsys.readouterr().err


def test_figures_stand_claims_that_always_or_never_cover(normal):
    never = dataclasses.replace(normal, hits=np.zeros_like(normal.hits))
    always = dataclasses.replace(normal, hits=np.full_like(normal.hits, normal.claims))
    assert isinstance(never, Coverage) and never.status() == "too short" and always.status() == "too long"
    figure, (ax, scores) = plot.panels(2)
    plot.reliability(ax, {"never": never, "always": always, "right": normal})
    plot.z_scores(scores, np.append(normal.z, [np.inf, -np.inf, np.nan]), 15)
    figure.canvas.draw()
    assert len(ax.lines) == 4 and "Student's, 15 dof" in scores.get_legend_handles_labels()[1]
