"""Input from disk and from the command line: a clear error or the right result, never a crash or a silent wrong answer.

Each test is run on a few inputs, and on 10,000 of them as a slow one. The environment variable FUZZ_ERRORS names a file
that gets what was said, and how often: kinds of errors by tests, with numbers and names left out.
"""

import contextlib
import copy
import functools
import io
import json
import os
import random
import re
import shutil
import warnings
import zipfile
from collections import Counter
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_checkpoint import Killed, killed_after, same
from test_scene_files import WRONG, assert_same, camera_data, places, rich_scene

import jaxmc as mc
from jaxmc import cli, study_commands
from jaxmc.integration import kernel, run, storage

seeds = st.integers(0, 10**12)


SEEN: Counter[str] = Counter()


def saw(said):
    """Count what was said, or that there was a result."""
    words = re.sub(r"'[^']*'|\"[^\"]*\"|b'.*?'", "'...'", str(said).splitlines()[-1])
    SEEN[re.sub(r"-?\d[\w.+-]*", "#", words)[:110]] += 1


def fuzzed(few, many=10_000):
    """Run a test of a seed on a few seeds, and on many as a slow test."""

    def decorate(test):
        @pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])
        def run(count):
            quiet = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
            SEEN.clear()
            settings(max_examples=count, **quiet)(given(seeds)(test))()
            if path := os.environ.get("FUZZ_ERRORS"):
                with Path(path).open("a", encoding="utf-8") as file:
                    print(json.dumps({"test": test.__name__, "inputs": count, "seen": SEEN.most_common()}), file=file)

        return run

    return decorate


def damaged(content, choose):
    """Return bytes with a few faults: flipped, dropped, doubled, put in, or cut off."""
    content = bytearray(content)
    for _ in range(choose.randint(1, 3)):
        where = choose.randrange(len(content) + 1)
        size = choose.choice([1, 1, 4, 64, 1000])
        fault = choose.choice(["flip", "drop", "double", "insert", "cut", "zero"])
        if fault == "flip" and where < len(content):
            content[where] ^= 1 << choose.randrange(8)
        elif fault == "drop":
            del content[where : where + size]
        elif fault == "double":
            content[where:where] = content[where : where + size]
        elif fault == "insert":
            content[where:where] = choose.randbytes(size)
        elif fault == "cut":
            del content[where:]
        elif fault == "zero":
            content[where : where + size] = bytes(len(content[where : where + size]))
    return bytes(content)


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz")
    with contextlib.chdir(path):
        yield path


def function(u):
    return u[0] * u[1]


FIVE = {"top": mc.TopSamples(5)}


@functools.cache
def made():
    return mc.integrate(function, dim=2, n=1000, indices=range(1000), tallies=FIVE)


def stored():
    """Return the bytes of a file of sums, and of one of results."""
    made().save("sums.npz")
    mc.integrate(function, dim=2, n=1000, tallies={"tail": mc.TailHistogram()}).save("results.npz")
    return [open(name, "rb").read() for name in ("sums.npz", "results.npz")]


CONTENT: list[bytes] = []


@fuzzed(100)
def test_files_that_are_damaged(seed):
    choose = random.Random(seed)
    CONTENT[:] = CONTENT or stored()
    content = choose.choice(CONTENT)
    broken = damaged(content, choose)
    with open("broken.npz", "wb") as file:
        file.write(broken)
    try:
        found = mc.Estimate.load("broken.npz")
    except ValueError as error:
        saw(error)
        assert "broken.npz" in str(error)
    else:
        saw("read")
        # Faults in what the archive says of dates and the like change nothing.
        with open("whole.npz", "wb") as file:
            file.write(content)
        assert same(found, mc.Estimate.load("whole.npz"))
    try:
        # It is refused, or it is the same run and goes on.
        found = mc.integrate(function, dim=2, n=1000, indices=range(1000), tallies=FIVE, checkpoint="broken.npz")
    except ValueError as error:
        assert "broken.npz" in str(error)
        assert open("broken.npz", "rb").read() == broken
    else:
        assert same(found, made())


LONG = {"dim": 2, "n": 3 * kernel.BLOCK, "tallies": FIVE | {"tail": mc.TailHistogram()}, "chunk": kernel.BLOCK}
UNFINISHED: list[bytes] = []


def unfinished():
    """Return the bytes of a checkpoint of a run that was stopped."""
    with contextlib.suppress(Killed):
        mc.integrate(function, **LONG, checkpoint=mc.Checkpoint("stopped.npz", 0.0), progress=killed_after(2))
    return [Path("stopped.npz").read_bytes()]


@fuzzed(150)
def test_files_that_are_forged(seed):
    """The checksum is right, the content is none."""
    choose = random.Random(seed)
    CONTENT[:], UNFINISHED[:] = CONTENT or stored(), UNFINISHED or unfinished()
    with np.load(io.BytesIO(choose.choice(CONTENT + UNFINISHED))) as file:
        members = dict(file)
    head = json.loads(members.pop("head").tobytes())
    members.pop("checksum")
    for _ in range(choose.randint(1, 3)):
        *path, last = choose.choice(list(places(head)))
        inside = head
        for key in path:
            inside = inside[key]
        fault = choose.choice(["delete", "replace", "swap"])
        if fault == "delete":
            inside.pop(last)
        elif fault == "replace":
            inside[last] = copy.deepcopy(
                choose.choice([*WRONG, {"array": 0}, {"class": "Sums", "fields": {}}, {"name": "x"}])
            )
        else:
            *path, other = choose.choice(list(places(head)))
            value = head
            for key in [*path, other]:
                value = value[key]
            inside[last] = json.loads(json.dumps(value))
    text = np.frombuffer(json.dumps(head).encode(), np.uint8)
    arrays = [members[f"a{i}"] for i in range(len(members))]
    np.savez("whole.npz", head=text, checksum=storage._checksum(text, arrays), **members)
    for read in (
        lambda: mc.Estimate.load("forged.npz"),
        lambda: mc.integrate(function, dim=2, n=1000, indices=range(1000), tallies=FIVE, checkpoint="forged.npz"),
        lambda: mc.integrate(function, **LONG, checkpoint="forged.npz"),
    ):
        shutil.copy("whole.npz", "forged.npz")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # numbers may be any
                assert isinstance(read(), mc.Estimate)
            saw("read")
        except ValueError as error:
            saw(error)
            assert "forged.npz" in str(error)


def test_archives_that_would_grow(folder):
    with zipfile.ZipFile("bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("head.npy", bytes(10**7))
    with pytest.raises(ValueError, match="packed by another program"):
        mc.Estimate.load("bomb.npz")


def scene_text():
    camera = mc.PinholeCamera((0, 0, 9), (0, 0, 0), fov=30.5, width=7, height=5)
    return json.dumps(rich_scene().to_dict() | {"camera": camera_data(camera)}, indent=1).encode()


SCENE_TEXT = scene_text()


@fuzzed(150)
def test_scene_files_that_are_damaged(seed):
    with open("broken.json", "wb") as file:
        file.write(damaged(SCENE_TEXT, random.Random(seed)))
    try:
        scene, camera = mc.load_scene("broken.json")
    except ValueError as error:
        saw(error)
        assert "broken.json" in str(error)
    else:
        saw("read")
        mc.save_scene("again.json", scene, camera)
        again, _ = mc.load_scene("again.json")
        assert_same(scene, again)


NUMBERS = [
    None,
    True,
    -1,
    0,
    3,
    10,
    1.5,
    float("nan"),
    float("inf"),
    1 << 70,
    "10",
    [],
    (1,),
    {},
    np.int32(7),
    2.0,
    b"x",
]
OPTIONS = {
    "dim": [2, 2, 2, *NUMBERS], "n": [10, 10, 10, *NUMBERS], "key": NUMBERS, "replicates": [None, None, *NUMBERS],
    "rtol": [None] * 9 + NUMBERS, "atol": [None] * 9 + NUMBERS, "max_n": [None] * 9 + NUMBERS,
    "max_seconds": [None] * 9 + [x for x in NUMBERS if x not in (3, 10, 1.5, 2.0, 7)], "workers": [None, *NUMBERS],
    "chunk": [None, *NUMBERS], "indices": [None] * 9 + [range(3), range(2, 9), range(0), *NUMBERS],
    "checkpoint": [None] * 9 + [3, "", "missing/x.npz", ".", b"x"],
    "tallies": [None] * 5 + [{}, 3, [], {"moments": 3}, {"t": 3}],
    "sampler": [mc.Independent()] * 5 + [None, "sobol", 3, mc.Sobol],
}  # fmt: skip


def some_of(options, choose, most, **usual):
    """Return the usual options, up to so many of them others, or others besides."""
    names = choose.sample(list(options), choose.randint(1, most))
    return usual | {name: choose.choice(options[name]) for name in names}


@fuzzed(80)
def test_options_of_integrate(seed):
    choose = random.Random(seed)
    options = some_of(OPTIONS, choose, 4, dim=2, n=10)
    try:
        found = mc.integrate(function, **options)
    except ValueError as error:
        saw(error)
        assert str(error)
    else:
        saw("estimated")
        # One sample has the standard deviation sqrt(1/9 - 1/16).
        assert found.n >= 1 and abs(found.mean - 0.25) < 6.0 * 0.2205 / np.sqrt(found.n)


SCENE = mc.Scene([mc.Sphere((0.0, 0.0, 0.0), 1.0)], sky=1.0)
CAMERA = mc.PinholeCamera((0, 0, 4), (0, 0, 0), fov=45, width=4, height=3)
SHARED = ("key", "replicates", "workers", "chunk", "indices", "checkpoint", "tallies", "sampler")
PATHS = {
    "spp": [2, 2, *NUMBERS], "bounces": [1, 1, *[x for x in NUMBERS if x != 10]],
    "lights": ["mis", "nee", "none", "all", 3, None, "", b"x"], "directions": ["bsdf", "cosine", "uniform", 1, None],
    "roulette": [None, 0.5, "throughput", "x", *NUMBERS], "clamp": [None, 3.0, *NUMBERS, "x"],
    "filter": [None] * 5 + [mc.TentFilter(), mc.TentFilter, 3, "tent", mc.GaussianFilter()],
    "tiles": [None] * 5 + [[(0, 0, 4, 1)], [], 3, "x", [(0, 0, 5, 1)], [(0, 0, 1, 1), (0, 0, 1, 1)], [(1, 2)], [None]],
    "regularize": [None] * 5 + [mc.Regularize(), 3, "x", mc.Regularize], "spam": [1],
} | {name: OPTIONS[name] for name in SHARED}  # fmt: skip


@pytest.fixture
def nothing_drawn(monkeypatch):
    """Let kernels be traced, so that all mistakes show, and draw no samples: their records are empty."""

    def evaluate_nothing(*arguments, **options):
        return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), kernel.evaluate.eval_shape(*arguments, **options))

    for name in ("lower", "eval_shape"):
        setattr(evaluate_nothing, name, getattr(kernel.evaluate, name))
    monkeypatch.setattr(run, "evaluate", evaluate_nothing)


@pytest.mark.usefixtures("nothing_drawn")
@fuzzed(60)
def test_options_of_render(seed):
    choose = random.Random(seed)
    options = some_of(PATHS, choose, 2, spp=2, bounces=1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # there are no samples
            found = mc.render(SCENE, CAMERA, **options)
    except ValueError as error:
        saw(error)
        assert str(error)
    except TypeError as error:
        saw(error)
        assert "spam" in options
    else:
        saw("rendered")
        assert found.mean.shape == (3, 4, 3)


WORDS = ["-1", "0", "1", "2", "x", "", "1.5", "nan", "1e3", "99999999999999999999", "1/2", "--quiet", "missing.json"]
WORDS += [
    "image",
    "depth",
    "normals",
    "mis",
    "none",
    "throughput",
    "sobol",
    "x.png",
    "x.npy",
    "sums.npz",
    "--",
    "\u00e9",
]
SHOT = ["--spp", "--width", "--height", "--bounces", "--roulette", "--seed", "--part", "--checkpoint", "--exposure"]
SHOT += ["--lights", "--directions", "--sampler", "--view", "--out", "--hdr", "--threshold", "--preview", "--spam"]
COMMANDS = {
    "render": (["mirror-box", "--width", "4", "--height", "4", "--spp", "1", "--bounces", "1", "--quiet"], SHOT),
    "render scene.json": (["--width", "3", "--spp", "1", "--bounces", "1", "--quiet"], SHOT),
    "replay": (["mirror-box", "--sample", "1"], ["--sample", "--spp", "--bounces", "--roulette", "--seed", "--pixel"]),
    "merge": (["sums.npz"], ["--out", "--picture", "missing.npz", "results.npz", "part*.npz"]),
    "study sparkles": (["--paths", "1"], ["--paths", "--seed", "--every", "--out", "--resume", "--spp"]),
    "study cures": (["x", "--width", "1"], ["--spp", "--width", "--bounces", "--seed", "--every", "--out"]),
    "study mirror-box": ([], ["--spp", "--all", "--out", "--rank", "--processes", "--every"]),
    "study": ([], ["nothing", "calibration", "--resume", "--spam"]),
    "bench": (["nothing", "--max-seconds", "0"], ["--dim", "--out", "--max-seconds"]),
    "scenes": ([], ["--out", "nothing", "--seed", "--help"]),
    "": ([], ["--version", "--help", "spam", "render", "merge"]),
}


@pytest.fixture
def nothing_studied(monkeypatch):
    for module in [study.module for study in study_commands.STUDIES.values()] + [study_commands.cures]:
        monkeypatch.setattr(module, "run", lambda folder, settings: Path(folder, "report.html"))


@pytest.mark.usefixtures("nothing_drawn", "nothing_studied")
@fuzzed(12)
def test_the_command_line(seed):
    choose = random.Random(seed)
    CONTENT[:] = CONTENT or stored()
    for name, content in (("sums.npz", CONTENT[0]), ("results.npz", CONTENT[1]), ("scene.json", SCENE_TEXT)):
        Path(name).write_bytes(content)
    command = choose.choice(list(COMMANDS))
    words, names = COMMANDS[command]
    words = command.split() + words
    for _ in range(choose.randint(1, 2)):
        words += [choose.choice(names), choose.choice(WORDS)]
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            code = cli.main(words)
    except SystemExit as stop:
        code = stop.code
    saw(said.getvalue() if code else f"done: {command}")
    assert code in (0, 2, None) and said.getvalue().strip(), words
