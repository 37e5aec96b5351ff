"""Parameters from images: fits end at the truth, losses and gradients are unbiased, and what is known wrong fails."""

import dataclasses
import sys
from types import SimpleNamespace

import jax
import numpy as np
import optax
import pytest

import jaxmc as mc
from jaxmc.gradients import fitting
from jaxmc.gradients.fitting import squared_error

TRUTH = {"x": 0.1, "half": 0.9, "glow": 0.4}
SHAPE = 8, 12


def make(p):
    """A square light of half-width ``half``, and a plate at ``x`` before it that glows."""
    p = {**TRUTH, **p}
    a, black = p["half"], mc.Diffuse(0.0)
    light = mc.Quad([-a, -a, 0.0], [2.0 * a, 0.0, 0.0], [0.0, 2.0 * a, 0.0], black, emission=1.0)
    plate = mc.Quad([p["x"] - 0.4, -0.3, 1.0], [0.8, 0.0, 0.0], [0.0, 0.6, 0.0], black, emission=p["glow"])
    return mc.Scene([light, plate]), mc.PinholeCamera([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], fov=30.0, width=12, height=8)


def render(p, spp, key):
    return mc.render(*make(p), spp=spp, bounces=0, key=key)


@pytest.fixture(scope="module")
def target():
    return render({}, 1 << 16, 1).mean


def interior_only(make, params, **how):
    """The mutant that leaves the boundary out."""
    return dataclasses.replace(mc.render_grad(make, params, **how), boundary=None)


def ends(target, start, keys, **options):
    """Return where fits with several keys end, shape (keys, parameters), and their fits."""
    found = [mc.fit(make, target, start, bounces=0, key=key, **options) for key in range(keys)]
    return np.array([[float(x) for x in jax.tree.leaves(f.params)] for f in found]), found


def assert_at_the_truth(found, truth, most):
    """Fits end less than ``most`` away, and their mean is at the truth within the error of their spread."""
    error = found.std(0, ddof=1) / len(found) ** 0.5
    assert np.all(np.abs(found - truth) < most), found
    assert np.all(np.abs(found.mean(0) - truth) < 6.0 * error + 0.1 * most), (found.mean(0), error)


# ------------------------------------------------------------------------------------------------------------- fits


def test_a_plate_is_found_and_plain_differentiation_does_not_see_it(target):
    found, fits = ends(target, {"x": -0.1}, 4, steps=60, spp=16)
    assert_at_the_truth(found, [0.1], 0.06)
    for f in fits:
        assert f.trace["x"].shape == f.loss.shape == f.loss_stderr.shape == (61,) and f.status == "complete"
        assert f.trace["x"][0] == pytest.approx(-0.1) and f.trace["x"][-1] == float(f.params["x"])
        assert f.loss[-1] < 5.0 * f.loss_stderr[-1] and "complete" in str(f)
    first, said = np.mean([f.loss[0] for f in fits]), fits[0].loss_stderr[0]
    assert first > 5.0 * said / len(fits) ** 0.5
    blind = mc.fit(make, target, {"x": -0.1}, steps=3, spp=16, bounces=0, gradient=interior_only)
    assert float(blind.params["x"]) == pytest.approx(-0.1)


@pytest.mark.slow
def test_three_parameters_are_found(target):
    bounds = {"x": (-0.5, 0.5), "half": (0.3, None), "glow": (0.0, 2.0)}
    start = {"x": -0.15, "half": 0.7, "glow": 0.8}
    found, _ = ends(target, start, 3, steps=60, spp=16, bounds=bounds)
    assert_at_the_truth(found, [TRUTH[k] for k in sorted(TRUTH)], 0.06)


# ------------------------------------------------------------------------------------------- losses without the noise


def losses(target, variance, spp, subtracted=True):
    """Return losses of many renders at the truth, where it is 0; the mutant does not subtract their variance."""
    found = []
    for key in range(200):
        image = render({}, spp, 1000 + key)
        error = squared_error(image, target, 1.0, variance)
        noise = 0.0 if subtracted else float(np.mean(image.stderr**2))
        found.append((error.mean + noise, error.stderr))
    return np.array(found).T


@pytest.mark.parametrize("subtracted", [True, False])
def test_the_loss_has_no_noise_in_it(target, subtracted):
    mean, said = losses(target, 0.0, 4, subtracted)
    error = mean.std(ddof=1) / len(mean) ** 0.5
    assert (abs(mean.mean()) < 5.0 * error) == subtracted
    if subtracted:
        assert np.sqrt(np.mean(said**2)) == pytest.approx(mean.std(ddof=1), rel=0.25)


def test_the_noise_of_a_target_is_subtracted_too():
    found = np.array([losses_of_a_noisy_target(key) for key in range(40)])
    error = found.std(0, ddof=1) / len(found) ** 0.5
    assert abs(found[:, 0].mean()) < 5.0 * error[0]
    assert abs(found[:, 1].mean()) > 5.0 * error[1]  # the mutant: its noise is left


def losses_of_a_noisy_target(key):
    noisy, image = render({}, 8, 5000 + key), render({}, 8, 6000 + key)
    whole = squared_error(image, noisy.mean, 1.0, noisy.stderr**2).mean
    return whole, squared_error(image, noisy.mean, 1.0).mean


def test_the_error_of_a_loss_away_from_the_truth(target):
    found = [squared_error(render({"glow": 1.0, "x": 0.0}, 8, k), target, 1.0) for k in range(200)]
    means, said = np.array([(f.mean, f.stderr) for f in found]).T
    assert np.sqrt(np.mean(said**2)) == pytest.approx(means.std(ddof=1), rel=0.25)
    exact = np.mean((render({"glow": 1.0, "x": 0.0}, 1 << 14, 2).mean - target) ** 2)
    assert abs(means.mean() - exact) < 5.0 * means.std() / len(means) ** 0.5 < 0.05 * exact


# ------------------------------------------------------------------------------------- gradients without correlation


def by_pixel(make, params, adjoint, spp, key, **ignored):
    """The derivative by the glow, from the very samples that a render with that key has: images are linear in it."""
    above, below = (render({"glow": params["glow"] + h}, spp, key).mean for h in (0.25, -0.25))
    return SimpleNamespace(mean={"glow": 2.0 * np.sum(adjoint * (above - below))}, flags=())


def slopes(target):
    """Return first steps of gradient descent from the truth, where the gradient is 0."""
    how = {"steps": 1, "spp": 2, "bounces": 0, "optimizer": optax.sgd(0.1), "weights": 1.0, "gradient": by_pixel}
    start = {"glow": TRUTH["glow"]}
    return np.array([np.diff(mc.fit(make, target, start, key=key, **how).trace["glow"])[0] for key in range(200)])


@pytest.mark.parametrize("independent", [True, False])
def test_residual_and_derivative_come_from_independent_renders(target, independent, monkeypatch):
    if not independent:
        key = fitting._key
        monkeypatch.setattr(fitting, "_key", lambda seed, step, part: key(seed, step, 0))
    found = slopes(target)
    error = found.std(ddof=1) / len(found) ** 0.5
    assert (abs(found.mean()) < 5.0 * error) == independent, (found.mean(), error)


# -------------------------------------------------------------------------------------------------------- behaviour


def constant(slope):
    return lambda make, params, **how: SimpleNamespace(mean=jax.tree.map(lambda _: slope, params), flags=("a flag",))


def test_bounds_hold_and_flags_are_handed_on(target):
    how = {"steps": 4, "spp": 2, "bounces": 0, "gradient": constant(1.0), "optimizer": optax.sgd(0.2)}
    found = mc.fit(make, target, {"x": 0.0, "glow": 0.5}, bounds={"x": None, "glow": (0.2, 1.0)}, **how)
    assert np.allclose(found.trace["glow"], [0.5, 0.3, 0.2, 0.2, 0.2])
    assert np.allclose(found.trace["x"], [0.0, -0.2, -0.4, -0.6, -0.8])
    assert found.flags == ("a flag",) and "not covered: a flag" in str(found)


def test_what_is_not_finite_stops_a_fit(target):
    found = mc.fit(make, target, {"glow": 0.5}, steps=4, spp=2, bounces=0, gradient=constant(float("nan")))
    assert found.status == "non-finite values seen" and found.loss.shape == found.trace["glow"].shape == (1,)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"steps": 0}, "steps"),
        ({"spp": 1}, "at least 2"),
        ({"target": np.ones((3, 3))}, "target must be an image"),
        ({"target": np.full(SHAPE, np.nan)}, "finite"),
        ({"weights": -1.0}, "weights"),
        ({"weights": np.ones((5, 5))}, "weights"),
        ({"bounds": {"x": (0.5, 1.0)}}, "bounds"),
        ({"bounds": {"x": 0.5}}, "bounds"),
        ({"params": {"x": "left"}}, "real numbers"),
    ],
)
def test_mistakes_are_named(change, word):
    given = {"target": np.ones(SHAPE), "params": {"x": 0.0}, "steps": 1, "spp": 2, "bounces": 0, **change}
    with pytest.raises(ValueError, match=word):
        mc.fit(make, **given)


def test_without_optax_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "optax", None)
    with pytest.raises(ImportError, match=r"jaxmc\[optimize\]"):
        mc.fit(make, np.ones(SHAPE), {"x": 0.0}, steps=1, spp=2)
