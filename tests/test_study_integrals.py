"""The studies of flat and nested integrals, of light sampling and of a caustic: their laws, settings and reports."""

import json

import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc.cli import main
from jaxmc.studies import branching, caustic, caustic_scenes, flat_vs_nested, light_sampling, light_scenes, scores
from jaxmc.testing import assert_unbiased


def test_split_variance_is_that_of_the_pixel():
    for pixel in flat_vs_nested.PIXELS.values():
        exact = analytic_scenes.open_pixel_under_sphere(**flat_vs_nested.BALL, **pixel).exact
        between, within = flat_vs_nested.predicted(pixel)
        # A sample is 1 or 0, so its variance is p (1 - p) in all.
        assert between + within == pytest.approx(exact * (1.0 - exact), rel=1e-9)
        assert 0.0 < between < within


def test_many_directions_follow_the_law_of_nested_integrals():
    pixel = flat_vs_nested.PIXELS["wide pixel"]
    between, within = flat_vs_nested.predicted(pixel)
    room = flat_vs_nested.pixel_under_sphere(**flat_vs_nested.BALL, **pixel)
    estimate = mc.integrate(branching.gathered_occlusion(*room, 7), n=1 << 18, key=1)
    measured, error = float(estimate.variance), flat_vs_nested.variance_error(estimate)
    assert abs(measured - (between + within / 7)) < 5 * error and error < 0.01 * measured
    # All directions taken as one, or the points as all alike, is another law.
    assert abs(measured - (between + within)) > 20 * error and abs(measured - within / 7) > 20 * error


def test_a_loop_over_directions_is_ambient_occlusion():
    room = flat_vs_nested.pixel_under_sphere(**flat_vs_nested.BALL, **flat_vs_nested.PIXELS["small pixel"])
    loop, plain = branching.gathered_occlusion(*room, 3), mc.ambient_occlusion(*room, directions=3)
    assert loop.labels == plain.labels
    np.testing.assert_allclose(*(mc.draw(f, n=512, key=1).value for f in (loop, plain)), atol=1e-6)


def test_law_of_branching():
    for depth in (1, 2, 5):
        mean, variance = branching.furnace_law(0.6, depth, 1)
        exact = analytic_scenes.sphere_furnace(0.6, bounces=depth, directions="uniform")
        assert mean == pytest.approx(exact.exact) and variance == pytest.approx(exact.exact_variance)
    assert [branching.rays_of(3, b) for b in (1, 2, 100)] == [4, 15, 1010101]


def test_branching_in_a_furnace():
    terms = branching.branching_terms(*light_scenes.furnace(0.6), depth=2, branch=2, directions="uniform")
    assert terms.dim == 2 + 2 * 6
    estimate = mc.integrate(terms.map(_total), n=1 << 16, key=1)
    mean, variance = branching.furnace_law(0.6, 2, 2)
    assert_unbiased(estimate, mean, 1e-2)
    assert abs(float(estimate.variance) - variance) < 5 * flat_vs_nested.variance_error(estimate) < 0.1 * variance


def _total(values):
    return values.sum()


@pytest.mark.parametrize("place", light_scenes.PLACES.values(), ids=light_scenes.PLACES)
def test_irradiance_of_lamps(place):
    integrand = mc.irradiance(light_scenes.lamps_alone(), (*place, 0.0), light_scenes.UP, bounces=0, lights="nee")
    of_lamps = light_scenes.irradiance_of_lamps(place)
    estimate = mc.integrate(integrand, n=1 << 18, key=1)
    assert_unbiased(estimate, of_lamps.sum(), 1e-2)
    # The points on each lamp add a little to the law of the pick.
    law, error = len(of_lamps) * np.sum(of_lamps**2) - of_lamps.sum() ** 2, flat_vs_nested.variance_error(estimate)
    assert law - 5 * error < float(estimate.variance) < 1.05 * law and error < 0.02 * law


def test_rays_of_paths_with_roulette():
    room = light_scenes.furnace(0.6)
    events = light_scenes.events(*room, bounces=4, directions="cosine", lights="none", roulette=0.5)
    assert_unbiased(mc.integrate(events, n=1 << 16, key=1), 1 + 0.5 + 0.25 + 0.125, 1e-2)


def test_light_sampling_does_not_help_under_a_mirror_ball():
    integrand, exact = caustic.under_mirror_ball(0.1, "nee")
    estimate = mc.integrate(integrand, n=1 << 18, key=1)
    assert abs(estimate.mean - exact.exact) < 5 * np.sqrt(exact.exact_variance / estimate.n)
    assert float(estimate.variance) == pytest.approx(exact.exact_variance, rel=0.1)
    assert exact.exact_variance > 20 * exact.exact**2


def test_bright_pixels_hold_half_of_the_light():
    radiance = np.array([[1.0, 6.0], [2.0, 3.0]])
    assert caustic.bright_pixels(radiance).tolist() == [[False, True], [False, False]]
    assert caustic.bright_pixels(np.ones((2, 4))).sum() == 4


@pytest.mark.slow
@pytest.mark.parametrize("make", caustic.SCENES.values(), ids=caustic.SCENES)
def test_photons_and_paths_bring_the_same_light(make):
    scene = make(0.1, 8)
    truth, error = caustic_scenes.caustic_by_photons(scene, 1 << 19, key=1)
    options = {"spp": 1 << 13, "lights": "mis"}
    paths = mc.render(scene.scene, scene.camera, bounces=scene.bounces, key=1, **options)
    direct = mc.render(scene.scene, scene.camera, bounces=1, key=2, **options)
    difference = (paths.mean - direct.mean)[..., 0] - truth
    bar = np.sqrt(error**2 + (paths.stderr**2 + direct.stderr**2)[..., 0])
    assert abs(difference.sum()) < 5 * np.sqrt((bar**2).sum()) < 0.1 * truth.sum()
    assert (np.abs(difference) < 5 * bar + 1e-3 * truth.max()).all()


def test_exact_values_are_found_by_name():
    assert scores.exact_function("furnace_radiance")(0.5, 1.0, 3) == 1.875
    with pytest.raises(ValueError, match="no integrand"):
        scores.exact_function("nothing_like_it")


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["study", "flat-vs-nested", "--rays", "1000"], "power of two"),
        (["study", "light-sampling", "--samples", "1"], "2^10"),
        (["study", "caustic", "--spp", "0"], "samples per pixel"),
        (["study", "caustic", "--samples", "1"], "2^12"),
    ],
)
def test_settings_out_of_range(arguments, cure, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error


def _report(folder):
    return json.loads((folder / "report.json").read_text())


@pytest.mark.slow
def test_report_of_flat_and_nested(tmp_path):
    settings = flat_vs_nested.Settings(rays=1 << 10, replicates=64, width=16, seed=3, progress=False)
    flat_vs_nested.run(tmp_path, settings)
    report = _report(tmp_path)
    rows = report["tables"][0]["rows"]
    assert max(abs(row[6]) for row in rows) < 5.0 and len(rows) == 20
    # Independent estimates follow the law; Sobol' points in four dimensions are far below it.
    ratio = {(row[0], row[1], row[3]): row[9] for row in rows}
    assert all(0.4 < ratio[key] < 1.9 for key in ratio if key[1] == "Independent")
    assert ratio["small pixel", "Sobol", 1] < 0.3
    assert all(abs(row[5]) < 5.0 for row in report["tables"][2]["rows"])


@pytest.mark.slow
def test_report_of_light_sampling(tmp_path):
    light_sampling.run(tmp_path, light_sampling.Settings(samples=1 << 14, width=16, progress=False))
    report = _report(tmp_path)
    assert report["values"]["largest |z|"] < 5.0
    rows = {(row[1], row[0]): row for row in report["tables"][-1]["rows"]}
    variance = {key: row[6] for key, row in rows.items()}
    assert variance["ceiling lamp, side 0.1", "next event estimation"] < variance["ceiling lamp, side 0.1", "waiting"]
    assert variance["near a weak lamp", "pick by distance"] < variance["near a weak lamp", "pick by uniform"]
    for row in rows.values():
        assert row[9] == "inf" or row[9] == pytest.approx(row[2] ** 2 / (row[6] * row[8] * 1e-6), rel=1e-6)


@pytest.mark.slow
def test_report_of_the_caustic(tmp_path):
    caustic.run(tmp_path, caustic.Settings(spp=16, samples=1 << 14, width=12, progress=False))
    report = _report(tmp_path)
    assert max(abs(row[5]) for row in report["tables"][0]["rows"]) < 5.0
    found = list(report["values"]["glass ball: share of the caustic found"].values())
    assert found[0] > 0.9 and found[-1] < 0.1
