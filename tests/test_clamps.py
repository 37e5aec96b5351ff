"""Clamps inside a path: what is limited and where, and what that takes away."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.analysis import clamping, depths
from jaxmc.testing import assert_unbiased
from jaxmc.transport.clamps import Clamp, clamped
from jaxmc.transport.vec import Vec3

RTOL = 2e-5


# ---------------------------------------------------------------------------------------- colours

COLORS = np.random.default_rng(3).uniform(0.0, 2.0, (500, 3)) ** 3
SIZES = {
    "luminance": lambda c: c @ [0.2126, 0.7152, 0.0722],
    "maximum": lambda c: c.max(1),
    "sum": lambda c: c.sum(1) / 3.0,
}


@pytest.mark.parametrize("norm", SIZES)
def test_a_colour_is_scaled_down_to_its_limit(norm):
    found = np.stack(clamped(Vec3(*COLORS.T), 0.7, norm), 1)
    size = SIZES[norm](COLORS)
    assert 0.2 < (size > 0.7).mean() < 0.95
    np.testing.assert_allclose(found, COLORS * np.minimum(1.0, 0.7 / size)[:, None], rtol=RTOL)


def test_a_colour_may_be_limited_by_channel():
    found = np.stack(clamped(Vec3(*COLORS.T), 0.7, "channel"), 1)
    np.testing.assert_allclose(found, np.minimum(COLORS, 0.7), rtol=RTOL)
    np.testing.assert_allclose(clamped(COLORS[:, 0], 0.7, "sum"), np.minimum(COLORS[:, 0], 0.7), rtol=RTOL)


@pytest.mark.parametrize("norm", [*SIZES, "channel"])
def test_what_is_not_finite_stays_so_and_derivatives_are_those_of_the_smaller(norm):
    def one(x):
        return clamped(Vec3(x, x, x), 2.0, norm).y

    for bad in (np.inf, np.nan):
        assert not np.isfinite(one(jnp.asarray(bad)))
    slopes = [float(jax.grad(one)(x)) for x in (0.0, 1.0, 5.0)]
    np.testing.assert_allclose(slopes, [1.0, 1.0, 0.0], atol=1e-6)
    assert np.isfinite(jax.grad(lambda x: mc.clamp_luminance(x, 2.0))(0.0))


# ---------------------------------------------------------------------------------------- contributions


def grey_room():
    wall = mc.Diffuse(0.7)
    things = [
        mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), wall),
        mc.Quad((-1, 1, 0), (2, 0, 0), (0, 0, 2), wall),
        mc.Sphere((0.4, 0.2, 0.4), 0.4, mc.Mirror(0.9)),
        mc.Sphere((-0.4, 0.0, 1.5), 0.15, mc.Diffuse(0.0), emission=30.0),
    ]
    return mc.Scene(things, sky=0.2), mc.PinholeCamera((0, -3, 1.2), (0, 0, 0.7), width=8, height=8)


@functools.cache
def terms(lights, n=4096):
    return np.asarray(mc.draw(mc.neumann_terms(*grey_room(), bounces=4, lights=lights), n=n).value, np.float64)


def values(lights, clamp, n=4096):
    return mc.draw(mc.path_integrand(*grey_room(), bounces=4, lights=lights, clamp=clamp), n=n).value


def limited(c, direct, indirect):
    return np.minimum(c[:, :2], direct or np.inf).sum(1) + np.minimum(c[:, 2:], indirect or np.inf).sum(1)


SLOW = pytest.mark.slow
LIMITS = [pytest.param(None, 0.1, marks=SLOW), pytest.param(0.8, None, marks=SLOW), (0.8, 0.1)]


@pytest.mark.parametrize(("direct", "indirect"), LIMITS)
def test_each_contribution_has_its_own_limit(direct, indirect):
    # An event without weighted sampling brings one contribution: its term of the Neumann series. The sky is dim enough
    # to stay below the limits with what else an event brings.
    found, c = values("none", mc.Clamp(direct=direct, indirect=indirect)), terms("none")
    np.testing.assert_allclose(found, limited(c, direct, indirect), rtol=1e-4, atol=1e-5)
    assert (found < c.sum(1) - 1e-3).any()


@pytest.mark.slow
def test_weighted_contributions_are_limited_one_by_one():
    c, plain = terms("mis"), terms("mis").sum(1)
    found = values("mis", mc.Clamp(direct=0.8, indirect=0.1))
    lower = limited(c, 0.8, 0.1)
    assert np.all(found >= lower - 1e-4) and np.all(found <= plain + 1e-4)
    assert (found > lower + 1e-3).any() and (found < plain - 1e-3).any()
    # The whole sample is limited last.
    both = values("mis", mc.Clamp(sample=0.5, direct=0.8, indirect=0.1))
    np.testing.assert_allclose(both, np.minimum(found, 0.5), rtol=1e-4)
    assert np.array_equal(values("mis", 0.5), values("mis", mc.Clamp(sample=0.5)))


def test_mistaken_depths_are_found(monkeypatch):
    right = Clamp.of_contribution
    monkeypatch.setattr(Clamp, "of_contribution", lambda self, value, depth: right(self, value, depth - 1))
    f = mc.path_integrand(*grey_room(), bounces=4, lights="none", clamp=mc.Clamp(direct=0.8, indirect=0.1))
    found = mc.draw(lambda u: f(u), dim=f.dim, n=4096).value
    assert not np.allclose(found, limited(terms("none"), 0.8, 0.1), rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_light_of_a_receiver_is_direct():
    scene = mc.Scene([mc.Quad((-1, -1, 1), (0, 2, 0), (2, 0, 0), mc.Diffuse(0.8))], sky=1.0)
    f = mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=1, lights="none", directions="cosine")
    plain = mc.draw(f, n=2048).value

    def with_limit(**limits):
        options = {"bounces": 1, "lights": "none", "directions": "cosine", "clamp": mc.Clamp(**limits)}
        return mc.draw(mc.irradiance(scene, (0, 0, 0), (0, 0, 1), **options), n=2048).value

    # The sky itself brings 1 (times pi), the quad's light 0.8 after an event.
    sky = plain > 0.9 * np.pi
    assert 0.02 < sky.mean() < 0.98
    np.testing.assert_allclose(with_limit(direct=0.5), np.where(sky, 0.5 * np.pi, plain), rtol=1e-5)
    np.testing.assert_allclose(
        with_limit(indirect=0.5), np.where(sky, plain, np.minimum(plain, 0.5 * np.pi)), rtol=1e-5
    )


def test_throughput():
    # With uniform directions an event multiplies throughput by 2 rho cos(theta), and cos(theta) is uniform.
    rho, t = 0.8, 0.6
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Diffuse(rho))], sky=1.0)
    options = {"bounces": 1, "directions": "uniform", "lights": "none", "clamp": mc.Clamp(throughput=t)}
    f = mc.radiance(scene, (0, 0, 1), (0, 0, -1), **options)
    assert_unbiased(mc.integrate(f, n=1 << 16), t - t * t / (4.0 * rho), rel_precision=2e-3)


@pytest.mark.slow
def test_throughput_is_limited_before_roulette():
    rho, t = 0.8, 0.6
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Diffuse(rho))], sky=1.0)
    options = {"bounces": 1, "directions": "uniform", "lights": "none", "clamp": mc.Clamp(throughput=t)}
    survivors = mc.radiance(scene, (0, 0, 1), (0, 0, -1), **options, roulette=0.5)
    assert_unbiased(mc.integrate(survivors, n=1 << 16, key=1), t - t * t / (4.0 * rho), rel_precision=6e-3)


@pytest.mark.slow
def test_replay_clamps_as_render_does():
    scene, camera = scenes.mirror_box(True, 8, 8)
    options = {"bounces": 4, "clamp": mc.Clamp(indirect=0.05, throughput=0.9, norm="sum"), "roulette": 0.8}
    image = np.asarray(mc.render(scene, camera, spp=1, key=2, **options).mean).reshape(-1, 3)
    paths = mc.replay(scene, camera, list(range(64)), key=2, **options)
    np.testing.assert_allclose([p.value for p in paths], image, rtol=1e-4, atol=1e-6)


# ---------------------------------------------------------------------------------------- bias by path length


def test_biases_of_path_lengths_add_up():
    direct, indirect = 1.0, 0.125  # edges of the bins, where histograms are exact
    tallies = {f"term {k}": mc.TailHistogram(of=mc.Term(k)) for k in range(5)}
    found = mc.integrate(mc.neumann_terms(*grey_room(), bounces=4, lights="none"), n=4096, tallies=tallies)
    curves = [clamping.clamp_curve(found[name]) for name in tallies]
    c = terms("none")
    lost = depths.bias_by_depth(curves, direct, indirect)
    np.testing.assert_allclose(lost.bias[:2], np.maximum(c[:, :2] - direct, 0.0).mean(0), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(lost.bias[2:], np.maximum(c[:, 2:] - indirect, 0.0).mean(0), rtol=1e-4, atol=1e-6)
    kept = values("none", mc.Clamp(direct=direct, indirect=indirect)).mean()
    assert math.isclose(c.sum(1).mean() - kept, lost.total, rel_tol=1e-3)
    assert lost.total_stderr > 0.0 and depths.bias_by_depth(curves, None, indirect).bias[:2].sum() == 0.0
    whole = depths.bias_at(curves[2], 0.0)[0]
    assert math.isclose(whole, c[:, 2].mean(), rel_tol=1e-3) and depths.bias_at(curves[2], 1e6)[0] == 0.0


def test_terms_of_a_colour():
    values = np.arange(2 * 2 * 3 * 3.0).reshape(2, 2, 3, 3)
    np.testing.assert_allclose(mc.Term(1)(values), values[:, :, 1] @ [0.2126, 0.7152, 0.0722])
    assert np.array_equal(mc.Term(1)(values[..., 0]), values[:, :, 1, 0])
    with pytest.raises(ValueError, match="more than 3 terms"):
        mc.Term(3)(values)


def test_bad_input():
    scene, camera = grey_room()
    for make, match in [
        (lambda: mc.Clamp(), "at least one limit"),
        (lambda: mc.Clamp(sample=0.0), "sample must be a positive limit"),
        (lambda: mc.Clamp(direct=math.nan), "direct"),
        (lambda: mc.Clamp(indirect="3"), "indirect"),
        (lambda: mc.Clamp(throughput=1.0, norm="L2"), "norm must be one of"),
        (lambda: mc.path_integrand(scene, camera, bounces=1, clamp="3"), "mc.Clamp"),
        (lambda: mc.neumann_terms(scene, camera, bounces=1, clamp=mc.Clamp(sample=1.0)), "clamp of samples"),
        (lambda: mc.Term(-1), "k must be"),
        (lambda: depths.bias_by_depth([]), "got none"),
    ]:
        with pytest.raises(ValueError, match=match):
            make()
