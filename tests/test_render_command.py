"""The commands render and replay, previews, and the files that they leave."""

import dataclasses
import io
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import jaxmc as mc
from jaxmc import live, pictures, render_command, scenes
from jaxmc.cli import main
from jaxmc.studies import mirror_box, sparkles

PATHS = {"bounces": 2, "key": 3 << 8}
ARGUMENTS = ["--bounces", "2", "--seed", "3"]


def _tiny():
    scene = mc.Scene(
        [
            mc.Quad((-2, 0, 2), (4, 0, 0), (0, 0, -4), mc.Diffuse((0.7, 0.5, 0.3))),
            mc.Sphere((0, 0.5, 0), 0.5, mc.Mirror(0.9)),
            mc.Quad((-0.5, 2, -0.5), (1, 0, 0), (0, 0, 1), mc.Diffuse(0.0), emission=4.0),
        ]
    )
    return scene, mc.PinholeCamera((0, 1.2, 4), (0, 0.7, 0), fov=45, width=16, height=12)


SCENE, CAMERA = _tiny()


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(scenes.SCENES, "tiny", lambda: (SCENE, CAMERA))
    return tmp_path


@pytest.fixture(scope="module")
def image():
    return mc.render(SCENE, CAMERA, spp=16, **PATHS)


def shown(linear, exposure=1.0):
    return np.round(255 * np.clip(linear * exposure, 0, 1) ** (1 / 2.2))


def test_render_leaves_the_picture_and_the_linear_values(image, capsys):
    files = ["--out", "a/picture.png", "--hdr", "b/values.npz", "--exposure", "0.8", "--quiet"]
    assert main(["render", "tiny", "--spp", "16", *ARGUMENTS, *files]) == 0
    out = capsys.readouterr().out
    assert "a/picture.png" in out and "b/values.npz" in out and "16 spp" in out
    picture = np.asarray(Image.open("a/picture.png"))
    np.testing.assert_array_equal(picture, shown(image.mean, 0.8))
    values = np.load("b/values.npz")
    np.testing.assert_array_equal(values["image"], image.mean.astype(np.float32))
    np.testing.assert_array_equal(values["stderr"], image.stderr.astype(np.float32))
    assert values["image"].max() > 2.0 and picture.max() == 255  # what display cuts off is kept


def test_preview_rewrites_the_picture_and_ends_with_the_same_image(image, capsys, monkeypatch):
    written = []
    write = pictures.write
    monkeypatch.setattr(pictures, "write", lambda path, content: (written.append(content), write(path, content)))
    assert main(["render", "tiny", "--spp", "16", *ARGUMENTS, "--preview", "--out", "p.png", "--hdr", "p.npy"]) == 0
    frames = [np.asarray(Image.open(io.BytesIO(content))) for content in written[:-1]]
    assert len(frames) == 6  # after 1, 2, 4, 8 and 16 samples, and at the end
    assert all(frame.shape == (12, 16, 3) for frame in frames) and (frames[0] != frames[-1]).any()
    np.testing.assert_allclose(np.load("p.npy"), image.mean, rtol=1e-5, atol=1e-6)
    lines = capsys.readouterr().err.splitlines()
    assert [re.search(r"(\d+) of 16 spp", line)[1] for line in lines] == ["1", "2", "4", "8", "16"]
    assert all("paths/s" in line for line in lines) and "mean relative error" in lines[-1]


def test_interrupt_keeps_the_image_so_far(image, capsys, monkeypatch):
    some = dataclasses.replace(image, n=8)

    def interrupted(*args, **options):
        yield some
        raise KeyboardInterrupt

    monkeypatch.setattr(render_command, "render_progressively", interrupted)
    assert main(["render", "tiny", *ARGUMENTS, "--preview", "--out", "p.png", "--hdr", "p.pfm"]) == 130
    assert "interrupted; the image so far: p.png, p.pfm\n8 spp" in capsys.readouterr().out
    np.testing.assert_array_equal(np.asarray(Image.open("p.png")), shown(image.mean))

    def at_once(*args, **options):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(render_command, "render_progressively", at_once)
    assert main(["render", "tiny", *ARGUMENTS, "--preview", "--out", "q.png"]) == 130
    assert "interrupted" in capsys.readouterr().err and not Path("q.png").exists()


def test_files_are_written_whole_or_not_at_all(monkeypatch):
    path = Path("x.png")
    pictures.write(path, b"old")
    write_bytes = Path.write_bytes

    def fails(self, content):
        write_bytes(self, content[:1])
        assert path.read_bytes() == b"old"
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", fails)
    with pytest.raises(OSError, match="disk full"):
        pictures.write(path, b"new")
    assert path.read_bytes() == b"old" and [p.name for p in Path().iterdir()] == ["x.png"]


def test_portable_float_maps_run_from_bottom_to_top():
    image = np.arange(24, dtype=float).reshape(2, 4, 3) * 100
    kind, size, scale, data = pictures.linear(".pfm", image).split(b"\n", 3)
    assert (kind, size, scale) == (b"PF", b"4 2", b"-1.0")
    np.testing.assert_array_equal(np.frombuffer(data, "<f4").reshape(2, 4, 3)[::-1], image)
    assert pictures.linear(".pfm", image[..., 0]).startswith(b"Pf\n4 2\n")


def test_display_marks_what_is_not_finite():
    image = np.array([[[np.nan, 0, 0], [2.0, 0.5, -1.0]]])
    np.testing.assert_allclose(pictures.tone_map(image), [[[1, 0, 1], [1, 0.5 ** (1 / 2.2), 0]]])


@pytest.mark.parametrize("view", ["normals", "depth"])
def test_views_leave_a_figure_and_their_values(view, capsys):
    files = ["--out", "v.png", "--hdr", "v.npy"]
    assert main(["render", "tiny", "--width", "32", "--view", view, *ARGUMENTS, *files]) == 0
    camera = mc.PinholeCamera((0, 1.2, 4), (0, 0.7, 0), fov=45, width=32, height=24)
    expected = {"normals": mc.view_normals, "depth": mc.view_depth}[view](SCENE, camera)
    np.testing.assert_allclose(np.load("v.npy"), expected, rtol=1e-6, atol=1e-6)
    assert np.asarray(Image.open("v.png")).shape[1] > 500
    assert f"{view}: v.png, v.npy" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("view", ["bounces", "variance", "fireflies", "time"])
def test_sampled_views_leave_a_figure(view, capsys):
    assert main(["render", "tiny", "--spp", "8", "--view", view, *ARGUMENTS]) == 0
    assert Path(f"out/render/tiny-{view}.png").exists() and "mean" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["nowhere"], "one of cornell-box"),
        (["nowhere.json"], "nowhere.json"),
        (["tiny", "--spp", "0"], "--spp"),
        (["tiny", "--seed", "-1"], "--seed"),
        (["tiny", "--width", "0"], "width"),
        (["tiny", "--bounces", "-1"], "bounces"),
        (["tiny", "--roulette", "often"], "throughput"),
        (["tiny", "--roulette", "1.5"], "(0, 1]"),
        (["tiny", "--out", "picture.jpg"], ".png"),
        (["tiny", "--hdr", "picture.exr"], ".npy or .npz or .pfm"),
        (["tiny", "--out", "/dev/null/x.png"], "Name another file"),
        (["tiny", "--exposure", "0"], "--exposure"),
        (["tiny", "--view", "depth", "--preview"], "--view"),
        (["tiny", "--view", "fireflies", "--threshold", "-1"], "threshold"),
    ],
)
def test_errors_of_render_are_one_line_with_the_cure(arguments, cure, capsys):
    assert main(["render", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error
    assert not list(Path().rglob("*.png"))


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["tiny", "--sample", "1", "--pixel", "16", "0"], "16 x 12"),
        (["tiny", "--sample", "-1", "--pixel", "1", "1"], "sample"),
        (["tiny", "--sample", "-1"], "[0, 2^64)"),
        (["nowhere", "--sample", "1"], "one of cornell-box"),
    ],
)
def test_errors_of_replay_are_one_line_with_the_cure(arguments, cure, capsys):
    assert main(["replay", *arguments, *ARGUMENTS]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error


def test_scenes_come_from_files_too(capsys):
    mc.save_scene("room.json", SCENE, CAMERA)
    assert main(["render", "room.json", "--view", "depth", "--hdr", "room.npy"]) == 0
    np.testing.assert_array_equal(np.load("room.npy"), mc.view_depth(SCENE, CAMERA))
    assert Path("out/render/room-depth.png").exists()
    mc.save_scene("dark.json", SCENE)
    assert main(["render", "dark.json"]) == 2 and "no camera" in capsys.readouterr().err
    assert main(["render", "gone.json"]) == 2 and "cannot be read (No such file" in capsys.readouterr().err


def test_every_name_makes_a_scene():
    for make in scenes.SCENES.values():
        scene, camera = make()
        assert isinstance(scene, mc.Scene) and camera.width >= 16


@pytest.mark.parametrize("sampler", ["independent", pytest.param("sobol", marks=pytest.mark.slow)])
def test_replay_of_a_pixel_is_a_sample_of_the_render(sampler, capsys):
    kind, spp = render_command.SAMPLERS[sampler], 8
    estimate = mc.render(SCENE, CAMERA, spp=spp, sampler=kind, **PATHS)
    samples = []
    for s in range(spp):
        at = ["--pixel", "9", "7", "--sample", str(s), "--sampler", sampler, "--spp", str(spp)]
        assert main(["replay", "tiny", *at, *ARGUMENTS]) == 0
        value = re.search(r"pixel \(9, 7\): value (.*)", capsys.readouterr().out)[1]
        samples.append([float(v) for v in value.split(",")])
    assert np.ptp(samples) > 0.01
    np.testing.assert_allclose(np.mean(samples, 0), estimate.mean[7, 9], rtol=1e-4)


def test_studies_are_replayed_as_they_were_sampled(capsys):
    assert main(["replay", "sparkles", "--sample", "77", "--seed", "2"]) == 0
    assert capsys.readouterr().out == f"{sparkles.extreme_path(77, 2)}\n"
    assert main(["replay", "mirror-box", "--sample", "12345", "--seed", "2"]) == 0
    scene, camera = scenes.mirror_box()
    assert capsys.readouterr().out == f"{mc.replay(scene, camera, 12345, key=2 << 8, **mirror_box.PATHS)}\n"


def test_index_of_a_sample():
    assert mc.sample_index(CAMERA, (3, 2), 5) == 5 * 192 + 2 * 16 + 3
    lattice = mc.sample_index(CAMERA, (3, 2), 5, sampler=mc.Lattice(), points=4)
    assert lattice == (192 + 35 << 32) + 1
    for pixel, sample in (((16, 0), 0), ((0, 12), 0), ((-1, 0), 0), (3, 0), ((1.5, 2), 0), ((0, 0), -1)):
        with pytest.raises(ValueError, match=r"pixel must|sample must"):
            mc.sample_index(CAMERA, pixel, sample)
    with pytest.raises(ValueError, match="points"):
        mc.sample_index(CAMERA, (0, 0), 0, sampler=mc.Lattice())


class _Screen(io.StringIO):
    def __init__(self, tty):
        super().__init__()
        self.tty = tty

    def isatty(self):
        return self.tty


@pytest.mark.parametrize(("tty", "text"), [(True, "\r\x1b[Ka\r\x1b[Kb\n"), (False, "a\nb\n")])
def test_progress_is_written_in_place_on_a_terminal(tty, text):
    screen = _Screen(tty)
    terminal = live.Terminal(screen)
    terminal.say("a")
    terminal.say("b")
    terminal.end()
    assert screen.getvalue() == text


def test_mean_relative_error(image):
    error = live.relative_error(image)
    assert error == pytest.approx(mc.luminance(image.stderr).mean() / mc.luminance(image.mean).mean())
    assert np.isnan(live.relative_error(mc.render(SCENE, CAMERA, spp=1, **PATHS)))


def test_preview_without_a_notebook_returns_the_last_estimate(image):
    last = mc.preview(SCENE, CAMERA, spp=16, **PATHS)
    assert last.n == 16
    np.testing.assert_allclose(last.mean, image.mean, rtol=1e-5, atol=1e-6)


def test_preview_in_a_notebook_updates_one_figure(monkeypatch):
    IPython = pytest.importorskip("IPython")
    pictures_shown = []

    class Handle:
        def update(self, picture):
            pictures_shown.append(picture)

    def display(picture, display_id):
        assert display_id and not pictures_shown
        pictures_shown.append(picture)
        return Handle()

    monkeypatch.setattr(IPython, "get_ipython", lambda: object())
    monkeypatch.setattr("IPython.display.display", display)
    last = mc.preview(SCENE, CAMERA, spp=4, **PATHS)
    assert last.n == 4 and len(pictures_shown) == 3
    assert all(picture.data.startswith(b"\x89PNG") for picture in pictures_shown)


ROOM = mc.Scene(
    [
        mc.Quad((-3, 0, 3), (6, 0, 0), (0, 0, -6), mc.Diffuse(0.7)),
        mc.Box((0.9, 0.5, 0.2), (0.5, 0.5, 0.5), material=mc.Diffuse((0.8, 0.3, 0.2))),
        mc.Box((-0.2, 0.2, 0.9), (0.2, 0.2, 0.2), material=mc.Mirror(0.9)),
        mc.Sphere((-0.9, 0.5, 0.4), 0.5, mc.Dielectric(1.5)),
        mc.Sphere((0, 0.5, -0.7), 0.5, mc.RoughConductor(0.2, eta=(0.2, 0.9, 1.1), k=(3.9, 2.4, 2.1))),
        mc.Quad((-1, 3, -1), (2, 0, 0), (0, 0, 2), mc.Diffuse(0), emission=5.0),
        mc.Sphere((2, 2, 1), 0.2, mc.Diffuse(0.0), emission=(20, 15, 5.0)),
    ],
    sky=(0.1, 0.15, 0.3),
)
ROOM_CAMERA = mc.PinholeCamera((0, 1.6, 4.5), (0, 0.4, 0), fov=40, width=24, height=16)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"bounces": 8, "roulette": "throughput", "clamp": 1.0, "hide_emitters": True},
        {"bounces": 8},
        {"bounces": 12, "roulette": 0.6, "lights": "none"},
        {"bounces": 6, "pick": "distance", "sample_sky": True},
        {"bounces": 6, "lights": "nee", "directions": "uniform"},
        {"bounces": 0},
    ],
)
def test_replayed_values_are_those_of_the_render(options):
    image = mc.render(ROOM, ROOM_CAMERA, spp=1, key=3, **options)
    pixels = list(itertools.product(range(24), range(16)))
    paths = mc.replay(ROOM, ROOM_CAMERA, [mc.sample_index(ROOM_CAMERA, p, 0) for p in pixels], key=3, **options)
    for path, (x, y) in zip(paths, pixels):
        assert path.pixel == (x, y)
        np.testing.assert_allclose(path.value, image.mean[y, x], rtol=1e-3, atol=1e-5)
        if "clamp" not in options:
            # What the path has met by itself and what its events gained is its value.
            gained = path.direct + sum(v.gained for v in path.vertices)
            assert gained == pytest.approx(float(mc.luminance(path.value)), rel=1e-4, abs=1e-5)
    words = {mc.Mirror: "mirror", mc.Dielectric: "glass", mc.RoughConductor: "rough", mc.Diffuse: "diffuse"}
    kinds = [words[type(p.material)] for p in ROOM.given[0]]
    vertices = [v for path in paths for v in path.vertices]
    assert all(v.kind == kinds[v.primitive] for v in vertices)
    assert options["bounces"] == 0 or {v.kind for v in vertices} == set(kinds)
    ends = {path.end for path in paths}
    assert ("roulette" in ends) == ("roulette" in options) and "sky" in ends
    for path in paths:
        assert path.end != "roulette" or path.vertices[-1].met == "roulette"
        assert all(v.met != "roulette" for v in path.vertices[:-1])
        assert len(path.vertices) < options["bounces"] or path.end != "surface"


def test_paths_that_roulette_ends():
    # Inside of a sphere a path only ends by roulette: after a number of events that is geometric, cut off at the last.
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Diffuse(0.9))])
    survival, most, count = 0.5, 6, 1536
    paths = mc.replay(
        scene, mc.PinholeCamera((0, 0, 0), (0, 0, 1), width=8, height=8), range(count), bounces=most, roulette=survival
    )
    numbers = np.array([len(path.vertices) for path in paths])
    mean = (1 - survival**most) / (1 - survival)
    variance = sum((2 * k + 1) * survival**k for k in range(most)) - mean**2
    assert abs(numbers.mean() - mean) < 5 * np.sqrt(variance / count)
    last = numbers == most
    assert {path.end for path, n in zip(paths, numbers) if n < most} == {"roulette"}
    through = np.mean([path.end == "last bounce" for path in paths])
    p = survival**most
    assert abs(through - p) < 5 * np.sqrt(p * (1 - p) / count) and last.mean() > through
