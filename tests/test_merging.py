"""Parts of an estimate, made apart, add up to the whole; what does not belong together is refused."""

import itertools

import jax
import numpy as np
import pytest
from test_checkpoint import PIXEL_TALLIES, PIXELS, TALLIES, N, same
from trees import tree

import jaxmc as mc
from jaxmc import cli
from jaxmc.integration import bands
from jaxmc.integration.kernel import BLOCK


def part(indices, **more):
    return mc.integrate(tree, dim=2, **{"tallies": TALLIES, "indices": indices, "chunk": BLOCK, **more})


def cut(n, at):
    edges = [0, *at, n]
    return [range(a, b) for a, b in itertools.pairwise(edges)]


EXACT = ("tail", "top")


@pytest.mark.parametrize("at", [[BLOCK, 3 * BLOCK], [1, 2, BLOCK + 7]])
def test_parts_by_samples_are_the_whole(at):
    whole, parts = mc.integrate(tree, dim=2, n=N, tallies=TALLIES, chunk=BLOCK), [part(r) for r in cut(N, at)]
    merged = mc.merge(*parts)
    assert same(mc.merge(*reversed(parts)), merged)
    nested = mc.merge(parts[0], mc.merge(*parts[1:]))
    for key in ("a", "b"):
        assert np.all(np.abs(nested.mean[key] - merged.mean[key]) <= 1e-15 * np.abs(merged.mean[key]))
        assert np.all(np.abs(merged.mean[key] - whole.mean[key]) <= 1e-5 * whole.stderr[key])
    assert merged.n == N == sum(p.n for p in parts) and merged.recipe == whole.recipe
    for name in EXACT:
        assert all(np.array_equal(a, b) for a, b in zip(merged[name], whole[name], strict=True))
    for got, want in zip(jax.tree.leaves(merged.moments), jax.tree.leaves(whole.moments), strict=True):
        assert np.allclose(got, want, rtol=1e-5, atol=1e-9)
    for name in TALLIES:
        for got, want in zip(jax.tree.leaves(merged[name]), jax.tree.leaves(whole[name]), strict=True):
            # Covariances are kept by groups of lanes, which another first sample moves.
            assert name == "covariance" or np.allclose(got, want, rtol=1e-5)
    assert np.allclose(merged["covariance"].covariance, whole["covariance"].covariance, rtol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"replicates": 8},
        pytest.param({"sampler": mc.Sobol()}, marks=pytest.mark.slow),
        pytest.param({"sampler": mc.Halton(), "replicates": 4}, marks=pytest.mark.slow),
    ],
)
def test_parts_by_randomisations_are_the_whole_bit_for_bit(options):
    whole = mc.integrate(tree, dim=2, n=1 << 16, tallies=TALLIES, chunk=BLOCK, **options)
    count, points = whole.recipe["replicates"], whole.recipe["points"]
    parts = [part(range(a * points, b * points), n=1 << 16, **options) for a, b in [(0, 1), (1, 3), (3, count)]]
    merged = mc.merge(parts[2], parts[0], parts[1])
    assert all(same(p, p) and p.n == p.recipe["replicates"] * points for p in parts) and np.isnan(parts[0].stderr["a"])
    exact = [(e.moments, e.between, e.replicate_means, [e[name] for name in EXACT]) for e in (merged, whole)]
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, exact), strict=True))
    assert merged.recipe == whole.recipe
    two = mc.merge(parts[0], parts[2])
    assert two.recipe["randomisations"] == [0, *range(3, count)] and two.n == (count - 2) * points


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Sobol(), marks=pytest.mark.slow)], ids=str)
def test_parts_of_families(sampler):
    def make(**more):
        return mc.integrate_each(PIXELS, 4000, n=256, sampler=sampler, tallies=PIXEL_TALLIES, chunk=BLOCK, **more)

    merged, whole = mc.merge(make(indices=range(128, 256)), make(indices=range(128))), make()
    assert merged.n == whole.n and merged.recipe == whole.recipe
    for got, want in zip(*(jax.tree.leaves((e.moments, e.between, e.tallies)) for e in (merged, whole)), strict=True):
        assert np.allclose(got, want, rtol=1e-4, equal_nan=True)


SCENE = mc.Scene(
    [mc.Sphere((0.0, 0.0, 0.0), 1.0, mc.Diffuse(0.5)), mc.Sphere((1.0, 1.0, 1.0), 0.5)], sky=(1.0, 2.0, 3.0)
)
CAMERA = mc.PinholeCamera((0, 0, 4), (0, 0, 0), fov=45, width=24, height=16)
# Parts of 128 pixels each, which share a kernel.
TILES = [[(0, 0, 24, 5), (0, 5, 8, 1)], [(8, 5, 16, 1), (0, 6, 16, 7)], [(16, 6, 8, 7), (0, 13, 24, 3)]]


def image(**more):
    tallies = {"tail": mc.TailHistogram(mc.luminance), "ladder": mc.ClampLadder((1.0, 4.0), mc.luminance)}
    tallies |= {"clamped": mc.Moments(mc.luminance, order=2)}
    return mc.render(SCENE, CAMERA, **{"spp": 40, "bounces": 1, "lights": "none", "tallies": tallies, **more})


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Sobol(), marks=pytest.mark.slow)], ids=str)
def test_parts_by_tiles_are_the_image_bit_for_bit(sampler, tmp_path):
    whole, parts = image(sampler=sampler), [image(tiles=tiles, sampler=sampler) for tiles in TILES]
    merged = mc.merge(parts[1], parts[2], parts[0])
    assert same(merged, whole) and merged.recipe == whole.recipe and merged.mean.shape == (16, 24, 3)
    top = parts[0].mean
    assert np.array_equal(top[:5], whole.mean[:5]) and np.isnan(top[6:]).all() and np.isnan(top[5, 8:]).all()
    for i, one in enumerate(parts):
        one.save(tmp_path / f"part-{i}.npz")
    out, picture = tmp_path / "whole.npz", tmp_path / "whole.png"
    assert cli.main(["merge", str(tmp_path / "part-*.npz"), "--out", str(out), "--picture", str(picture)]) == 0
    assert same(mc.Estimate.load(out), whole) and picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_tiles_of_samples_and_filters():
    whole = image()
    quarters = [
        image(tiles=t, indices=i) for t in ([(0, 0, 24, 8)], [(0, 8, 24, 8)]) for i in (range(32), range(32, 40))
    ]
    merged = mc.merge(*quarters)
    # Samples are cut where a block of the kernel ends.
    assert np.allclose(merged.mean, whole.mean, rtol=1e-12) and merged.n == 40 and merged.recipe == whole.recipe
    filtered, (first, second) = (
        image(filter=mc.TentFilter()),
        [image(filter=mc.TentFilter(), indices=indices) for indices in (range(16), range(16, 40))],
    )
    merged = mc.merge(first, second)
    assert np.allclose(merged.mean, filtered.mean, rtol=1e-5) and merged.ratio
    # Errors come from the spread within blocks, which differ.
    assert merged.stderr.mean() / filtered.stderr.mean() == pytest.approx(1.0, abs=0.05)
    assert first.stderr.mean() / filtered.stderr.mean() > 1.2


@pytest.mark.parametrize(
    "parts, word",
    [
        (lambda: [], "at least one"),
        (lambda: [3], "wants estimates"),
        (lambda: [mc.integrate(tree, dim=2, n=9)], "kept no sums"),
        (lambda: [part(range(9)), part(range(8, 20))], "samples 8 to 9 are in two"),
        (lambda: [part(range(9)), part(range(9))], "overlap"),
        (lambda: [part(range(9)), part(range(9, 20), key=1)], "seed"),
        (lambda: [part(range(9)), part(range(9, 20), tallies=None)], "integrand"),
        (lambda: [part(range(9)), mc.integrate(lambda u: u[0], dim=2, indices=range(9, 20))], "integrand"),
        (lambda: [mc.integrate(mc.Integrand(lambda u: u[0], 1), rtol=0.1, checkpoint="x.npz")], "target"),
        (lambda: [image(tiles=TILES[0], spp=2), image(tiles=TILES[0], spp=2)], "overlap"),
        (lambda: [image(tiles=TILES[0], spp=4, indices=range(2)), image(tiles=TILES[1], spp=4)], "same samples"),
    ],
)  # fmt: skip
def test_parts_that_do_not_belong_together(parts, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=word):
        mc.merge(*parts())


@pytest.mark.parametrize(
    "options, word",
    [
        ({"indices": 5}, "range"),
        ({"indices": range(5, 5)}, "range"),
        ({"indices": range(0, 9, 2)}, "range"),
        ({"indices": range(-1, 9)}, "range"),
        ({"indices": range(0, 11), "n": 10}, "up to 11"),
        ({"indices": range(0, 10), "sampler": mc.Sobol()}, "need n"),
        ({"indices": range(0, 10), "sampler": mc.Sobol(), "n": 1 << 12}, "whole randomisations, of 256 points"),
        ({"indices": range(10), "rtol": 0.1}, "either n"),
    ],
)
def test_indices_that_are_none(options, word):
    with pytest.raises(ValueError, match=word):
        mc.integrate(tree, dim=2, **options)


@pytest.mark.parametrize(
    "tiles, word",
    [
        ([], "got none"),
        (3, "got none"),
        ([(0, 0, 25, 1)], "24 x 16"),
        ([(0, 0, 0, 1)], "24 x 16"),
        ([(0, -1, 1, 1)], "24 x 16"),
        ([(0, 0, 1)], "24 x 16"),
        ([(0, 0, 2, 2), (1, 1, 2, 2)], "overlap"),
    ],
)
def test_tiles_that_are_none(tiles, word):
    with pytest.raises(ValueError, match=word):
        image(tiles=tiles)
    with pytest.raises(ValueError, match="neighbours"):
        image(tiles=[(0, 0, 1, 1)], filter=mc.TentFilter())


@pytest.mark.slow
def test_render_and_merge_on_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shot = ["render", "mirror-box", "--width", "12", "--height", "8", "--spp", "4", "--quiet", "--hdr", "x.npy"]
    shot += ["--bounces", "1"]
    assert cli.main(shot) == 0
    whole = np.load("x.npy")
    for i in (1, 2, 3):
        assert cli.main([*shot, "--part", f"{i}/3", "--checkpoint", f"part-{i}.npz"]) == 0
    assert cli.main(["merge", "part-1.npz", "part-2.npz", "part-3.npz"]) == 0
    assert np.array_equal(mc.Estimate.load("merged.npz").mean.astype(np.float32), whole)
    capsys.readouterr()
    assert cli.main(["merge", "part-1.npz", "part-1.npz"]) == 2 and "overlap" in capsys.readouterr().err
    assert cli.main(["merge", "nothing.npz"]) == 2 and "cannot be read" in capsys.readouterr().err
    for wrong in (["--part", "4/3"], ["--part", "x"], ["--part", "1/3", "--preview"]):
        assert cli.main([*shot, *wrong]) == 2 and "--part" in capsys.readouterr().err


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Sobol(), marks=pytest.mark.slow)], ids=str)
def test_bands_of_a_large_image_have_the_bits_of_the_whole(sampler, monkeypatch):
    tallies = {"tail": mc.TailHistogram(mc.luminance), "top": mc.TopSamples(20, mc.luminance)}
    whole = image(sampler=sampler, tallies=tallies)
    monkeypatch.setattr(bands, "BAND", 150)
    banded = image(sampler=sampler, tallies=tallies)
    assert same(banded, whole) and banded.recipe == whole.recipe and str(banded) == str(whole)
    assert np.array_equal(banded.stderr, whole.stderr) and banded.sums is None
