"""Cures of fireflies beside each other: what is measured of them, against laws, brute force and one another."""

import dataclasses
import json
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import fireflies, plot, scenes
from jaxmc.cli import main
from jaxmc.fireflies import Cure, average, cures
from jaxmc.fireflies.table import short
from jaxmc.studies import mirror_box
from jaxmc.testing import Mix

PIXELS, BIAS, SIGMA, NOISE = 200, 0.3, 0.7, 0.5
PATHS = {"bounces": 2, "hide_emitters": True}


def noisy_pairs(draw, count):
    """Return images with a bias that differs from pixel to pixel, and references of their own noise."""
    truth = np.linspace(0.0, 1.0, PIXELS)
    bias = BIAS * np.linspace(0.0, 2.0, PIXELS)
    images = truth + bias + draw.normal(0.0, SIGMA, (count, PIXELS))
    return images, truth + draw.normal(0.0, NOISE, (count, PIXELS)), (bias**2).mean()


def test_bias_variance_and_error_are_unbiased_and_their_error_bars_right():
    draw, runs = np.random.default_rng(1), 400
    found, naive = [], []
    for _ in range(runs):
        images, references, squared = noisy_pairs(draw, 6)
        found.append(fireflies.from_images(images, references, 16))
        naive.append(((images - references).mean(0) ** 2).mean())
    exact = {"bias": BIAS, "squared_bias": squared, "variance": SIGMA**2, "mse": squared + SIGMA**2}
    for name, value in exact.items():
        values = np.array([getattr(m, name) for m in found])
        claimed = np.array([getattr(m, f"{name}_stderr") for m in found])
        assert abs(values.mean() - value) < 5.0 * values.std() / runs**0.5
        # The jackknife is a little too large where a statistic is not linear, by design.
        assert 0.9 < np.sqrt((claimed**2).mean()) / values.std() < 1.35
    # The plain square of the mean difference is too large by the noise of both: this test would see it.
    naive = np.array(naive)
    assert (naive.mean() - squared) > 20.0 * naive.std() / runs**0.5


def test_averages_have_the_error_of_any_number_of_samples():
    draw = np.random.default_rng(2)
    images, references, squared = noisy_pairs(draw, 32)
    found = fireflies.from_averages(images, references, np.full(32, 3.0), (16, 64))
    assert found[16].mse - found[64].mse == pytest.approx(3.0 / 16 - 3.0 / 64)
    assert found[16].squared_bias == found[64].squared_bias
    assert abs(found[16].squared_bias - squared) < 5.0 * found[16].squared_bias_stderr
    with pytest.raises(ValueError, match="4 or more"):
        fireflies.from_images(images[:3], references[:3], 16)


def test_the_best_clamp_is_that_of_the_law():
    law, t = Mix(p=1e-2, A=500.0), np.geomspace(1.0, 512.0, 40)
    samples = np.asarray(mc.draw(law.sample, dim=law.dim, n=8 * 400 * 256, key=3).value).reshape(8, 400, 256)
    excess = np.array([np.maximum(samples - x, 0.0).mean(-1) for x in t]).swapaxes(0, 1)
    spread = np.array([np.minimum(samples, x).var(-1, ddof=1).mean(-1) for x in t]).T
    for N in (16, 128, 1024):
        best = fireflies.best_clamp(t, excess, spread, N)
        exact = law.optimal_threshold(N)
        assert best.inside and abs(np.log(best.threshold / exact)) < 2.0 * np.log(t[1] / t[0])
        mse = law.clamp_bias(exact) ** 2 + (law.clamped_square(exact) - (law.mean - law.clamp_bias(exact)) ** 2) / N
        assert abs(best.mse - mse) < 5.0 * best.mse_stderr + 0.01 * mse
        assert best.mse_stderr < 0.2 * mse


class IndexPoint(NamedTuple):
    index: jax.Array

    def __getitem__(self, dimension):
        return jnp.broadcast_to(self.index, jnp.shape(dimension))


@dataclasses.dataclass(frozen=True)
class Counting(mc.Independent):
    """A sampler whose every coordinate is the low word of the sample's index."""

    def point(self, seed, index):
        return IndexPoint(index.low)


TALLIES = {
    "average": mc.Moments(order=2),
    "ladder": mc.ClampLadder((0.5, 3.0)),
    "buckets": mc.Buckets(3),
    "cascade": mc.Cascade(),
    "layers": mc.Layers((0.0, 1.0, 4.0)),
}


def of_rows(table, first, count):
    """Return the results of tallies of some rows of a table: sample s of integral i is table[first + s, i]."""
    items = table.shape[1]
    f = mc.Integrand(lambda u, table, start, item: table[start + u[0]], 1, (table.ravel(), first * items), lazy=True)
    found = mc.integrate_each(f, items, n=count, sampler=Counting(), tallies=TALLIES)
    return [found[name][0] if name == "average" else found[name] for name in TALLIES]


def test_results_of_parts_of_any_size_make_those_of_all():
    # Parts of 12, 6 and 3 samples, whose means are weighed by their number; three buckets fit into each.
    table = np.exp(np.random.default_rng(4).normal(0.0, 1.5, (21, 5))).astype(np.float32)
    parts = [of_rows(table, first, count) for first, count in ((0, 12), (12, 6), (18, 3))]
    for found, exact in zip(map(fireflies.merged, zip(*parts)), of_rows(table, 0, 21), strict=True):
        for name in exact._fields:
            a, b = (np.asarray(getattr(x, name)) for x in (found, exact))
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6, err_msg=f"{type(exact).__name__}.{name}")
    with pytest.raises(ValueError, match="Moments, ClampLadder"):
        fireflies.merged([{}, {}])


@pytest.fixture(scope="module")
def compared():
    scene, camera = scenes.mirror_box(width=12, height=8)
    ladder = mc.ClampLadder(cures.LADDER, mc.luminance)
    clamp = average("clamp 3", cures.Clamped(3.0))
    some = [
        clamp,
        Cure("clamp 3, from images", clamp.tally, cures.mean),
        Cure("pooled", ladder, partial(cures.pooled_residual, tile=12)),
        Cure("cross-fitted", ladder, cures.cross_fitted),
        average("clamped by render", render=partial(mc.render, clamp=3.0)),
    ]
    return mc.fireflies.compare(scene, camera, spp=1024, counts=(8, 64, 1024), cures=some, key=5, rounds=0, **PATHS)


def test_without_a_cure_there_is_no_bias(compared):
    none = compared.rows[0]
    assert none.name == "none" and none.averages
    for N, m in none.at.items():
        assert (m.bias, m.squared_bias) == (0.0, 0.0) and m.mse == m.variance
        assert m.mse == pytest.approx(none.at[8].mse * 8 / N)
        assert compared.best[N].mse <= m.mse
    assert compared.reference.shape == (8, 12) and (compared.stderr > 0.0).any() and 0 < compared.relative_error < 0.1


def test_images_agree_with_what_averages_predict(compared):
    predicted, seen = compared["clamp 3"], compared["clamp 3, from images"]
    assert predicted.averages and not seen.averages and set(seen.at) == {8, 64}
    for N in seen.at:
        for name in ("bias", "squared_bias", "variance", "mse"):
            a, b = ((getattr(m, name), getattr(m, f"{name}_stderr")) for m in (predicted.at[N], seen.at[N]))
            assert abs(a[0] - b[0]) < 5.0 * (a[1] ** 2 + b[1] ** 2) ** 0.5
        assert predicted.at[N].variance_stderr < 0.2 * predicted.at[N].variance


def test_samples_of_a_cure_of_its_own_agree_with_the_plain_ones(compared):
    a, b = compared["clamp 3"], compared["clamped by render"]
    for N in a.at:
        assert abs(a.at[N].mse - b.at[N].mse) < 5.0 * (a.at[N].mse_stderr + b.at[N].mse_stderr)
        assert abs(a.at[N].bias - b.at[N].bias) < 5.0 * (a.at[N].bias_stderr + b.at[N].bias_stderr)
    assert a.at[8].bias < 0.0


def test_pooled_light_is_not_lost_and_thresholds_are_not_better_than_the_best(compared):
    pooled, fitted = compared["pooled"].at[64], compared["cross-fitted"].at[64]
    # These images are made of the reference's samples, whose light they keep: only rounding is left.
    assert abs(pooled.bias) < 1e-5 * compared.reference.mean() and fitted.bias < 0.0
    assert fitted.mse > compared.best[64].mse - 3.0 * (fitted.mse_stderr + compared.best[64].mse_stderr)


def test_the_table_has_a_line_for_each_cure_and_marks_what_is_missing(compared):
    table = compared.table()
    assert len(table.headers) == 3 + 4 * 3 and all(len(row) == len(table.headers) for row in table.rows)
    assert [row[0] for row in table.rows[:-1]] == [row.name for row in compared.rows]
    lines = {row[0]: row for row in table.rows}
    assert lines["pooled"][5] == "–" and lines["clamp 3"][5] != "–" and "best clamp" in table.rows[-1][0]
    assert {row[1] for row in table.rows} == {"images", "bias^2 + variance / N"}
    assert "pooled" in str(compared) and len(plot.png(plot.cures(compared))) > 10_000


def test_numbers_carry_their_errors():
    assert short(4.512e-4, 3e-6) == "4.51(3)e-4"
    assert short(0.2753, 0.002) == "0.275(2)"
    assert short(0.0, 0.0) == "0" and short(-0.0, 0.0) == "0" and short(float("nan"), 1.0) == "nan"


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"spp": 200}, "multiple of 128"),
        ({"counts": (6,)}, "from 8 on"),
        ({"spp": 2048, "counts": (80,)}, "128, 256, 512"),
        ({"spp": 2048, "counts": (192,)}, "128, 256, 512"),
        ({"clamp": 3.0}, "make a Cure"),
        ({"key": -1}, "key"),
        ({"cures": [average("a"), average("a")]}, "name of its own"),
    ],
)
def test_what_does_not_fit_is_said_before_work(wrong, message):
    scene, camera = scenes.mirror_box(width=4, height=4)
    with pytest.raises(ValueError, match=message):
        mc.fireflies.compare(scene, camera, **({"bounces": 1} | wrong))


def test_the_command_names_what_is_missing(capsys, tmp_path):
    assert main(["study", "cures", "nowhere", "--out", str(tmp_path)]) == 2
    assert "no scene 'nowhere'" in capsys.readouterr().err
    assert main(["study", "cures", "mirror-box", "--spp", "100", "--out", str(tmp_path)]) == 2
    assert "power of two" in capsys.readouterr().err


def test_cures_that_blur_mirrors_want_mirrors():
    scene, camera = scenes.cornell_box(8, 8)
    names = [c.name for c in fireflies.standard_cures(scene, camera, bounces=1)]
    assert len(names) == len(set(names)) == 15 and not any("regularized" in name for name in names)
    assert len(cures.blur_cures(mirrors=False)) == 3 < len(cures.blur_cures())
    assert fireflies.plain_cures(white=10.0)[1].name == "clamp 30"


@pytest.mark.slow
def test_all_cures_on_the_command_line(tmp_path):
    given = ["--spp", "512", "--width", "24", "--bounces", "4", "--quiet", "--out", str(tmp_path)]
    assert main(["study", "cures", "mirror-box", *given]) == 0
    values = json.loads((tmp_path / "report.json").read_text())["values"]
    rows = {row["name"]: row for row in values["cures"]}
    assert len(rows) == 20 and (tmp_path / "cures.png").exists()
    assert rows["none"]["time"] == 1.0 and all(row["time"] > 0.2 for row in rows.values())
    clamp, unclamped = rows["clamp 3"]["at"]["16"], rows["none"]["at"]["16"]
    assert clamp["mse"] < 0.1 * unclamped["mse"] and clamp["bias"] < 0.0
    for name in ("median of means", "winsorised mean", "cascade, paper's rule", "regularized, max_prev 0.3"):
        assert rows[name]["at"]["16"]["mse"] < 0.2 * unclamped["mse"]
    # What is unbiased, or nearly, must look so.
    for name in ("debias over clamps", "regularized, cone 0.1"):
        m = rows[name]["at"]["128"]
        assert abs(m["bias"]) < 5.0 * m["bias_stderr"]


@pytest.mark.slow
def test_the_figures_of_the_source_of_the_mirror_box(tmp_path):
    settings = mirror_box.Settings(spp=1024, width=48, height=32, progress=False, all=True)
    mirror_box.run(tmp_path, settings)
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert names >= {f"figure_17_{k}" for k in (1, 2, 3, 4)} | {"reweighted", "shadow", "random_pixels"}
    values = json.loads((tmp_path / "report.json").read_text())["values"]
    images = {row["image"]: row for row in values["images of the source"]}
    assert images["diffuse sphere, 16 spp"]["mse"] < 0.1 * images["mirror sphere, 16 spp"]["mse"]
    assert images["clamped at 3, 16 spp"]["mse"] < 0.1 * images["mirror sphere, 16 spp"]["mse"]
    assert images["regularized, 128 spp"]["mean"] > images["clamped at 3, 512 spp"]["mean"] + 0.02
    rates = [row["fireflies"] / row["samples"] for row in values["fireflies by view of the mirror"]]
    assert rates[0] > 1.2 * rates[1]
    wrong = values["random pixels"]["off by more than 1"]
    assert max(wrong) > 50 * wrong[0] and wrong[-1] < 0.01
