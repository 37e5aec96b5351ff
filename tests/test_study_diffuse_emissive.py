"""The study of diffuse and emissive scenes, in small: its numbers follow from the samples, and the law behind them."""

import json

import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.analysis import convergence
from jaxmc.studies import diffuse_emissive, diffuse_ladders
from jaxmc.studies.diffuse_ladders import DARK, SKY
from jaxmc.studies.light_hits import Part, blocks_of, facts, reflects, variance_from_hits
from jaxmc.studies.stages import Stages

SETTINGS = diffuse_emissive.Settings(spp=256, size=16, seed=3, progress=False, scenes=(DARK,))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("diffuse-emissive")
    page = diffuse_emissive.run(folder, SETTINGS)
    return page, json.loads((folder / "report.json").read_text())


@pytest.fixture(scope="module")
def measured():
    with Stages(1, False) as stages:
        return diffuse_ladders.measure(DARK, SETTINGS, stages, 0)


def test_the_study_leaves_report_and_figures(study):
    page, report = study
    names = {p.stem for p in page.parent.glob("*.png")}
    assert names == {"images", "convergence", "hits", "explained", "time"}
    assert page.read_text().count("data:image/png;base64,") == len(names)
    assert report["seed"] == 3


def test_the_errors_of_the_report_are_those_of_the_renders(study, measured):
    report = study[1]
    for row, strategy in zip(report["tables"][0]["rows"], diffuse_ladders.STRATEGIES, strict=True):
        rungs = measured.ladder[strategy]
        errors = [np.sqrt(rung.mse) / measured.truth[measured.mask].mean() for rung in rungs.values()]
        assert report["values"][f"relative errors, {DARK}, {strategy}"] == pytest.approx(errors)
        rate = convergence.fit_rate(np.array(list(rungs)), np.square(errors))
        assert row == [
            DARK,
            strategy,
            pytest.approx(errors[0]),
            pytest.approx(errors[-1]),
            *map(pytest.approx, row[4:]),
        ]
        assert row[4] == pytest.approx(rate.slope)
        # What 5% takes, at the rate that one sample's variance sets: n samples, error predicted for 1.
        predicted = report["values"][f"predicted relative errors, {DARK}, {strategy}"]
        assert row[6] == pytest.approx((predicted[0] / 0.05) ** 2)
        assert predicted[1:] == pytest.approx([predicted[0] / 2**k for k in range(1, len(predicted))])


def test_the_error_of_a_rung_is_that_of_an_independent_render(measured):
    errors = []
    for key in range(16):
        image, *_ = diffuse_ladders.shoot(DARK, 16, 4, "default", 10**6 + key)
        difference = (mc.luminance(image.mean["image"].reshape(16, 16, 3)) - measured.truth)[measured.mask]
        errors.append(np.mean(difference**2) - measured.noise[measured.mask].mean())
    stderr = np.std(errors, ddof=1) / np.sqrt(len(errors))
    # The rung is the mean of 8 such errors.
    assert abs(measured.ladder["default"][4].mse - np.mean(errors)) < 5 * np.sqrt(3) * stderr


def test_rays_meet_the_orb_as_often_as_its_solid_angle_says(measured):
    scene, camera = scenes.orb(width=16, height=16)
    y, x = np.mgrid[:16, :16] + 0.5
    s, t = x.ravel() / 8 - 1, y.ravel() / 8 - 1
    directions = np.stack(camera.forward + camera.right * s + camera.down * t, -1)
    found = mc.intersect(scene, np.broadcast_to(np.array(camera.origin), directions.shape), directions)
    # Points of the floor on the side of the orb that no ball shades.
    chosen = measured.mask.ravel() & (found.primitive == 0) & (found.point[:, 0] > 0.0)
    squared = ((np.asarray(found.point) - [0.4, 0.9, 0.0]) ** 2).sum(-1)[chosen]
    exact = (1.0 - np.sqrt(1.0 - 0.12**2 / squared)).mean()
    n = diffuse_ladders.REFERENCE * SETTINGS.spp * chosen.sum()
    got = measured.light.probability.ravel()[chosen].mean()
    stderr = np.sqrt(exact / n)
    # The centre stands for its pixel: 2 % at most where pixels are this large.
    assert stderr < 0.1 * exact and abs(got - exact) < 5 * stderr + 0.02 * exact


def test_the_variance_follows_from_the_light_that_is_met():
    rng = np.random.default_rng(1)
    n, probability, worth = 4000, np.array([0.02, 0.5]), np.array([30.0, 0.4])
    which = rng.choice(3, (n, 400), p=[*probability, 1.0 - probability.sum()])
    value = np.array([*worth, 0.0])[which]
    nothing = np.zeros(400)
    parts = [Part((which == k).mean(0), n, np.full(400, probability[k] * worth[k]), nothing) for k in range(2)]
    exact = np.dot(probability, worth**2) - np.dot(probability, worth) ** 2
    assert variance_from_hits(parts).mean() == pytest.approx(exact, rel=0.02)
    assert value.var(0).mean() == pytest.approx(exact, rel=0.02)
    # Of one light it is v^2 p (1 - p).
    one = variance_from_hits(parts[:1]).mean()
    assert one == pytest.approx(30.0**2 * 0.02 * 0.98, rel=0.02)
    # One light known, and all of them: the other is what is left.
    everything = Part((which < 2).mean(0), n, sum(part.mean for part in parts), nothing)
    rest = everything.without(parts[0])
    assert rest.mean == pytest.approx(parts[1].mean) and rest.probability == pytest.approx(parts[1].probability)


def test_noise_of_a_mean_is_not_taken_for_variance():
    rng = np.random.default_rng(2)
    noisy = rng.normal(0.5, 0.2, 100_000)
    part = Part(np.full(noisy.shape, 0.1), 1000, noisy, np.full(noisy.shape, 0.04))
    assert variance_from_hits([part]).mean() == pytest.approx(0.25 * 9.0, rel=0.02)


def test_facts_tell_the_first_ray_from_the_others():
    terms = np.zeros((3, 4, 3), np.float32)
    terms[0, 0] = 2.0  # seen directly: no path meets it
    terms[1, 1] = 1.0
    terms[2, 3] = 4.0
    found = {name: np.asarray(x) for name, x in facts(terms).items()}
    assert found["luminance"] == pytest.approx([2.0, 1.0, 4.0]) and found["image"].shape == (3, 3)
    assert found["direct"] == pytest.approx([0.0, 1.0, 0.0])
    assert found["hit"].tolist() == [0.0, 1.0, 0.0] and found["meets"].tolist() == [0.0, 1.0, 1.0]


def test_the_mask_leaves_out_lights_and_their_edges():
    scene, camera = scenes.orb(width=64, height=64)
    mask = reflects(scene, camera)
    rows, columns = np.nonzero(mask)
    for x, y in ((0, 0), (0, 1), (1, 0), (1, 1)):  # the corners of the pixels
        s, t = (columns + x) / 32.0 - 1.0, (rows + y) / 32.0 - 1.0
        directions = np.stack(camera.forward + camera.right * s + camera.down * t, -1)
        found = mc.intersect(scene, np.broadcast_to(np.array(camera.origin), directions.shape), directions)
        assert set(np.asarray(found.primitive).tolist()) == {0, 1}
    assert 0.4 < mask.mean() < 0.8
    means = blocks_of(np.arange(64.0).reshape(8, 8), np.arange(8) < np.full((8, 1), 4), size=4)
    assert means.tolist() == [
        np.arange(64.0).reshape(8, 8)[:4, :4].mean(),
        np.arange(64.0).reshape(8, 8)[4:, :4].mean(),
    ]


def test_time_is_divided_into_a_fixed_part_and_one_for_each():
    x = np.array([1.0, 4.0, 16.0, 64.0])
    assert diffuse_emissive.line(x, 0.3 + 0.02 * x) == pytest.approx((0.3, 0.02))
    assert diffuse_emissive.line(x, 0.02 * x - 0.001)[0] == 0.0


@pytest.mark.parametrize(
    ("options", "cure"),
    [
        ({"spp": 8}, "16 to 2"),
        ({"size": 8}, "16 to 1024"),
        ({"scenes": (SKY,)}, "only with"),
        ({"scenes": ("moon",)}, "among"),
        ({"scenes": ()}, "among"),
    ],
)
def test_settings_are_checked(options, cure):
    with pytest.raises(ValueError, match=cure):
        diffuse_emissive.Settings(**options)


@pytest.mark.slow
def test_the_second_and_fourth_scene_are_calm(tmp_path):
    diffuse_emissive.run(tmp_path, diffuse_emissive.Settings(spp=256, size=48, progress=False))
    rows = json.loads((tmp_path / "report.json").read_text())["tables"][1]["rows"]
    relative = {row[0]: row[-1] for row in rows}
    assert relative[DARK] > 20 * relative[SKY]
    assert relative["box with a lamp"] > 10 * relative["box with a bright ceiling"]
    # Which light is met explains most of the variance of direct light, and never more than all of it.
    assert all(0.6 < row[5] < 1.05 for row in rows)
