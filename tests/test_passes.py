"""Families of integrals in passes: disjoint samples, whose last estimate is that of one run."""

import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration.passes import doubling, integrate_each_in_passes, one_by_one

FAMILY = mc.Integrand(lambda u, item: u[0] * (item + 1.0), 1, lazy=True)


def test_passes_double_and_then_add_an_eighth():
    for spp in (1, 2, 3, 64, 100, 1000, 100_000):
        pieces = [piece for (piece,) in doubling([(0, 0, spp)])]
        starts, stops = [p[1] for p in pieces], [p[2] for p in pieces]
        assert starts == [0, *stops[:-1]] and stops[-1] == spp
        sizes = np.subtract(stops, starts)
        assert (sizes <= np.maximum(np.maximum(starts, 32), 1)).all()
    assert sizes[:9].tolist() == [1, 1, 2, 4, 8, 16, 32, 32, 32] and len(sizes) < 80


def test_replicates_come_one_by_one():
    ranges = [(0, 0, 8), (1, 0, 8)]
    assert list(one_by_one(ranges)) == [[(0, 0, 8)], [(1, 0, 8)]]


@pytest.mark.parametrize("sampler", [mc.Independent(), mc.Sobol()])
def test_last_estimate_is_that_of_one_run(sampler):
    tallies = {"top": mc.TopSamples(50), "half": mc.Moments(lambda x: 0.5 * x, 2), "tail": mc.TailHistogram()}
    one = mc.integrate_each(FAMILY, 1500, n=150, key=3, sampler=sampler, tallies=tallies)
    passes = list(integrate_each_in_passes(FAMILY, 1500, n=150, key=3, sampler=sampler, tallies=tallies))
    last = passes[-1]
    assert [e.n for e in passes] == sorted({e.n for e in passes}) and len(passes) >= 4
    assert last.n == one.n and last.recipe == one.recipe
    for a, b in ((last.mean, one.mean), (last.variance, one.variance), (last.stderr, one.stderr)):
        np.testing.assert_allclose(a, b, rtol=2e-6, atol=1e-12)
    np.testing.assert_array_equal(last["top"].index, one["top"].index)
    np.testing.assert_array_equal(last["tail"].count, one["tail"].count)
    np.testing.assert_allclose(last["half"][0].mean, one["half"][0].mean, rtol=2e-6)


def test_earlier_estimates_stay_as_they_were():
    first, second, *_, last = integrate_each_in_passes(FAMILY, 300, n=32)
    assert (first.n, second.n, last.n) == (1, 2, 32)
    assert (first.moments[0].n == 1).all() and (second.moments[0].n == 2).all()
    assert np.isnan(first.stderr).all() and (second.stderr >= 0.0).all()
    assert np.abs(first.mean - last.mean).max() > 0.1


def test_earlier_estimates_count_their_own_replicates():
    estimates = list(integrate_each_in_passes(FAMILY, 20, n=64, sampler=mc.Sobol()))
    assert [e.recipe["replicates"] for e in estimates] == [1, 2, 3, 4]
    exact = 0.5 * np.arange(1, 21)
    for e in estimates[1:]:
        lower, upper = e.interval(0.999)
        assert ((lower <= exact) & (exact <= upper)).sum() >= 18


def test_a_loop_may_be_left_early():
    for estimate in integrate_each_in_passes(FAMILY, 300, n=1 << 40):
        if estimate.n >= 100:
            break
    assert estimate.n == 128


def test_replicates_of_independent_samples_differ():
    four = mc.integrate_each(FAMILY, 400, n=256, replicates=4)
    plain = mc.integrate_each(FAMILY, 400, n=256)
    np.testing.assert_allclose(four.mean, plain.mean, rtol=1e-6)
    z = (four.mean - 0.5 * np.arange(1, 401)) / four.stderr
    # Student's t with 3 degrees of freedom exceeds 12.92 with probability 0.001.
    assert (np.abs(z) < 12.92).mean() > 0.98
    assert np.median(four.stderr / plain.stderr) == pytest.approx(0.89, abs=0.15)  # sqrt of the median of chi2(3) / 3


def test_images_of_few_samples_know_their_number():
    # As many pixels as need several kernel calls.
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, emission=1.0)])
    camera = mc.PinholeCamera((0, 0, 4), (0, 0, 0), width=640, height=450)
    estimate = mc.render(scene, camera, spp=1, bounces=0)
    assert estimate.n == 1 and estimate.recipe["n"] == 1 and (estimate.moments[0].n == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("filter", [None, mc.TentFilter()], ids=["pixels", "tent"])
def test_progressive_image_is_that_of_one_render(filter):
    scene, camera = scenes.mirror_box(width=24, height=16)
    options = {"spp": 40, "bounces": 2, "key": 5, "hide_emitters": True, "filter": filter}
    options["tallies"] = {"luminance": mc.Moments(mc.luminance, 2)}
    one = mc.render(scene, camera, **options)
    *earlier, last = mc.render_progressively(scene, camera, **options)
    assert earlier and last.n == one.n and last.mean.shape == (16, 24, 3)
    np.testing.assert_allclose(last.mean, one.mean, rtol=1e-5, atol=1e-7)
    if filter is None:
        np.testing.assert_allclose(last.stderr, one.stderr, rtol=1e-4, atol=1e-6)
    else:
        # The error of a filtered pixel comes from groups of samples, which are others here.
        assert np.sqrt(np.mean(last.stderr**2) / np.mean(one.stderr**2)) == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(last["luminance"][0].mean, one["luminance"][0].mean, rtol=1e-5, atol=1e-7)


def test_mistakes_are_raised_before_the_first_estimate():
    scene, camera = scenes.mirror_box(width=24, height=16)
    with pytest.raises(ValueError, match="spp"):
        mc.render_progressively(scene, camera, spp=0)
    with pytest.raises(ValueError, match="bounces"):
        mc.render_progressively(scene, camera, spp=4, bounces=-1)
