"""Input from disk and from the command line: a clear error or the right result, never a crash or a silent wrong answer.

Each test is run on a few inputs, and on 10,000 of them as a slow one.
"""

import contextlib
import copy
import io
import json
import random
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_checkpoint import same
from test_scene_files import WRONG, assert_same, camera_data, places, rich_scene

import jaxmc as mc
from jaxmc import cli
from jaxmc.integration import storage

seeds = st.integers(0, 10**12)


def fuzzed(few, many=10_000):
    """Run a test of a seed on a few seeds, and on many as a slow test."""

    def decorate(test):
        @pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])
        def run(count):
            quiet = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
            settings(max_examples=count, **quiet)(given(seeds)(test))()

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


MADE = mc.integrate(function, dim=2, n=1000, indices=range(1000), tallies={"top": mc.TopSamples(5)})


def stored():
    """Return the bytes of a file of sums, and of one of results."""
    MADE.save("sums.npz")
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
        assert "broken.npz" in str(error)
    else:
        # Faults in what the archive says of dates and the like change nothing.
        with open("whole.npz", "wb") as file:
            file.write(content)
        assert same(found, mc.Estimate.load("whole.npz"))
    try:
        # It is refused, or it is the same run and goes on.
        found = mc.integrate(
            function, dim=2, n=1000, indices=range(1000), tallies={"top": mc.TopSamples(5)}, checkpoint="broken.npz"
        )
    except ValueError as error:
        assert "broken.npz" in str(error)
        assert open("broken.npz", "rb").read() == broken
    else:
        assert same(found, MADE)


@fuzzed(150)
def test_files_that_are_forged(seed):
    """The checksum is right, the content is none."""
    choose = random.Random(seed)
    CONTENT[:] = CONTENT or stored()
    with np.load(io.BytesIO(choose.choice(CONTENT))) as file:
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
    np.savez("forged.npz", head=text, checksum=storage._checksum(text, arrays), **members)
    try:
        assert isinstance(mc.Estimate.load("forged.npz"), mc.Estimate)
    except ValueError as error:
        assert "forged.npz" in str(error)


def test_archives_that_would_grow(folder):
    with zipfile.ZipFile("bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("head.npy", bytes(10**7))
    with pytest.raises(ValueError, match="packed by another program"):
        mc.Estimate.load("bomb.npz")


def scene_text():
    camera = mc.PinholeCamera((0, 0, 9), (0, 0, 0), fov=30.5, width=7, height=5)
    return json.dumps(rich_scene().to_dict() | {"camera": camera_data(camera)}, indent=1).encode()


@fuzzed(150)
def test_scene_files_that_are_damaged(seed):
    with open("broken.json", "wb") as file:
        file.write(damaged(scene_text(), random.Random(seed)))
    try:
        scene, camera = mc.load_scene("broken.json")
    except ValueError as error:
        assert "broken.json" in str(error)
    else:
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


@fuzzed(80)
def test_options_of_integrate(seed):
    choose = random.Random(seed)
    names = choose.sample(list(OPTIONS), choose.randint(1, 4))
    options = {"dim": 2, "n": 10} | {name: choose.choice(OPTIONS[name]) for name in names}
    try:
        found = mc.integrate(function, **options)
    except ValueError as error:
        assert str(error)
    else:
        assert found.n >= 1 and (found.n < 3 or abs(found.mean - 0.25) < 0.3)


WORDS = ["-1", "0", "1", "2", "x", "", "1.5", "nan", "1e3", "99999999999999999999", "1/2", "--quiet", "missing.json"]
SHOT = ["--spp", "--width", "--height", "--bounces", "--roulette", "--seed", "--part", "--checkpoint", "--exposure"]
COMMANDS = {
    "render": (["mirror-box", "--width", "4", "--height", "4", "--spp", "1", "--quiet"], SHOT),
    "replay": (["mirror-box", "--sample", "1"], ["--sample", "--spp", "--bounces", "--roulette", "--seed", "--pixel"]),
    "merge": (["sums.npz"], ["--out", "--picture", "missing.npz"]),
    "study sparkles": (["--paths", "1"], ["--paths", "--seed", "--every", "--out"]),
}


@fuzzed(8, 1000)
def test_the_command_line(seed):
    choose = random.Random(seed)
    CONTENT[:] = CONTENT or stored()
    command = choose.choice(list(COMMANDS))
    words, names = COMMANDS[command]
    words = command.split() + words
    for _ in range(choose.randint(1, 2)):
        words += [choose.choice(names), choose.choice(WORDS)]
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            code = cli.main(words)
    except SystemExit as stop:
        code = stop.code
    assert code in (0, 2) and said.getvalue().strip(), words
