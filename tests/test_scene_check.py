"""An estimator on all scenes of known answer: what passes, what is found, and what is no evidence."""

import dataclasses
import math

import jax.numpy as jnp
import pytest

import analytic_scenes
import jaxmc as mc
from analytic_scenes import AnalyticScene, check
from jaxmc.testing import joint_sigmas


def event_or_ramp(u, p, event, start, height):
    """Return ``event`` with probability p, else what rises from ``start`` with u."""
    return jnp.where(u[0] < p, event, start + height * u[0])


def toy(exact, p=0.0, event=0.0, start=0.0, height=0.0, variance=None) -> AnalyticScene:
    """Return a scene. All share one kernel, as their numbers are parameters."""
    integrand = mc.Integrand(event_or_ramp, 1, (p, event, start, height))
    return AnalyticScene(f"mean of {exact:g}", integrand, exact, variance, None, {}, "elementary")


def ramp(height, variance=None):
    return toy(height / 2.0, height=height, variance=variance)


def wrong_by(factor):
    """Return the factory of an estimator that is off by a factor."""

    def factory(scene):
        p, *values = scene.integrand.params
        return dataclasses.replace(scene.integrand, params=(p, *(factor * x for x in values)))

    return factory


TOYS = [ramp(height) for height in (1.0, 2.0, 3.0)]


def verdicts(result):
    return [row.verdict for row in result.rows]


def test_a_right_estimator_passes_with_enough_samples_to_be_evidence():
    result = check(scenes=TOYS)
    result.assert_all()
    assert result.passed and verdicts(result) == ["agrees"] * 3 and result.sigmas == joint_sigmas(3)
    for row, scene in zip(result.rows, TOYS, strict=True):
        assert row.scene == scene.name and row.exact == scene.exact and row.seconds > 0.0
        assert row.stderr <= 1e-3 * row.exact and row.n < 1.3 * (1 / 3) / 1e-6
        assert row.z == pytest.approx((row.mean - row.exact) / row.stderr) and abs(row.z) < 5
        assert row.relative_error == pytest.approx(row.mean / row.exact - 1.0)


def test_the_table_has_a_row_for_each_scene():
    result = check(lambda scene: None if scene is TOYS[1] else scene.integrand, TOYS, 1e-2)
    heads, *rows, note = str(result).splitlines()
    assert heads.split() == "scene mean exact rel. error rel. stderr z n seconds verdict".split()
    assert [row.split()[-1] for row in rows] == ["agrees", "skipped", "agrees"] and rows[0].startswith("mean of 0.5 ")
    assert note == "Means may be 5.13 standard errors off; an error of 0.081 is found in 99.8 %."
    result.assert_all()


@pytest.mark.parametrize("factor", [1.002, 0.998])
def test_a_small_factor_is_found_where_the_precision_is_small(factor):
    result = check(wrong_by(factor), TOYS, rel_precision=1e-4)
    assert verdicts(result) == ["wrong"] * 3
    with pytest.raises(AssertionError, match=r"^3 of 3 scenes failed\nscene .*\nmean of 0.5 .* wrong"):
        result.assert_all()
    # At a precision of 1e-3, it is below the bound: nothing is claimed of it.
    assert abs(check(wrong_by(factor), TOYS[:1], rel_precision=1e-3).rows[0].z) < 6


def test_the_power_is_as_said():
    # An error of (sigmas + 3) precisions is found in 99.8 %, one of (sigmas - 3) hardly ever.
    sigmas, precision = joint_sigmas(1), 5e-3
    for shift, least, most in ((3.3, 59, 60), (-3.0, 0, 2)):
        factory = wrong_by(1.0 + (sigmas + shift) * precision)
        found = [not check(factory, TOYS[:1], precision, key=key).passed for key in range(60)]
        assert least <= sum(found) <= most


def test_one_wrong_scene_among_many_is_named():
    result = check(lambda scene: wrong_by(1.05 if scene is TOYS[2] else 1.0)(scene), TOYS)
    assert verdicts(result) == ["agrees", "agrees", "wrong"]
    with pytest.raises(AssertionError, match=r"^1 of 3 scenes failed\nscene .*\nmean of 1.5 .* wrong\nMeans"):
        result.assert_all()


def test_a_missing_bounce_is_found():
    right, short = (analytic_scenes.sphere_furnace(bounces=n) for n in (2, 1))
    result = check(lambda scene: short.integrand, [right])
    assert result.rows[0].verdict == "wrong" and result.rows[0].reason == "all samples equal"
    assert result.rows[0].relative_error == pytest.approx(1.5 / 1.75 - 1.0, rel=1e-5)


def test_what_takes_too_many_samples_is_not_passed():
    result = check(scenes=TOYS, rel_precision=1e-4, most_samples=1 << 20)
    assert verdicts(result) == ["no evidence"] * 3
    assert "samples are needed" in result.rows[0].reason and result.rows[0].n <= 1 << 20
    assert not result.passed
    with pytest.raises(AssertionError, match="no evidence"):
        result.assert_all()
    # What is off by far is wrong even so.
    assert verdicts(check(wrong_by(1.2), TOYS[:1], rel_precision=1e-4, most_samples=1 << 20)) == ["wrong"]


def test_the_exact_variance_is_used_where_it_is_known():
    known = ramp(2.0, variance=1.0 / 3.0)
    row = check(scenes=[known]).rows[0]
    assert row.stderr == math.sqrt(1.0 / 3.0 / row.n)
    # Another integrand has a variance of its own.
    row = check(wrong_by(1.0), [known]).rows[0]
    assert row.stderr != math.sqrt(1.0 / 3.0 / row.n)


def test_a_heavy_tail_is_no_evidence():
    heavy = dataclasses.replace(TOYS[0], integrand=mc.Integrand(lambda u: u[0] ** -0.7, 1), exact=1.0 / 0.3)
    row = check(scenes=[heavy], most_samples=1 << 20).rows[0]
    assert row.verdict == "no evidence" and row.reason.startswith("tail too heavy; ")


def test_a_rare_event_is_looked_for_before_it_is_called_a_mistake():
    rare = toy(1.0, p=1e-5, event=1e5)  # in most runs of the size of the pilot, all samples are 0
    row = check(scenes=[rare], rel_precision=0.1, most_samples=1 << 24).rows[0]
    assert row.verdict == "agrees" and row.n > 1 << 22
    assert verdicts(check(scenes=[toy(1.0)])) == ["wrong"]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite_fail(bad):
    result = check(scenes=[toy(1.0, p=1e-3, event=bad, start=1.0)])
    assert verdicts(result) == ["not finite"] and not result.passed


def test_rounding_alone_is_let_pass():
    assert verdicts(check(scenes=[toy(1.0, start=1.000008)])) == ["agrees"]
    assert verdicts(check(scenes=[toy(1.0, start=1.00003)])) == ["wrong"]
    assert verdicts(check(scenes=[toy(0.0)])) == ["agrees"]
    result = check(scenes=[toy(0.0, start=-0.5, height=1.0)])
    assert verdicts(result) == ["no evidence"] and result.rows[0].reason.startswith("relative to 0")


def test_integrands_may_come_by_name():
    result = check({"mean-of-1.5": TOYS[2].integrand, "mean of 0.5": wrong_by(1.1)(TOYS[0])}, TOYS)
    assert verdicts(result) == ["wrong", "skipped", "agrees"]
    with pytest.raises(ValueError, match="no scene 'mean of 7'"):
        check({"mean of 7": TOYS[2].integrand}, TOYS)


def test_nothing_checked_is_not_passed():
    result = check(lambda scene: None, TOYS)
    assert verdicts(result) == ["skipped"] * 3 and not result.passed
    with pytest.raises(AssertionError, match="no scene was checked"):
        result.assert_all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rel_precision": 0.0}, "rel_precision must be positive"),
        ({"scenes": []}, "at least one"),
        ({"factory": lambda scene: 3.0}, "expected an mc.Integrand or None for the scene 'mean of 0.5', got 3.0"),
        ({"factory": lambda scene: mc.Integrand(lambda u: u, 2)}, "one number"),
    ],
)
def test_static_mistakes_are_said(arguments, message):
    with pytest.raises(ValueError, match=message):
        check(**({"scenes": TOYS} | arguments))


@pytest.mark.slow
def test_all_default_scenes_agree_with_their_own_integrands():
    # A sample here has a standard deviation of up to 2.8 times its mean: that takes 2.1e8 samples.
    check(rel_precision=2e-4, most_samples=1 << 28).assert_all()
