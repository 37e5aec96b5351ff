"""A report is whole, strict and readable, or it is not written at all."""

import json
import os
import struct
from html.parser import HTMLParser
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxmc.report import Report, machine, write_json


class Pair(NamedTuple):
    mean: float
    stderr: float


class Tags(HTMLParser):
    """Collects the tags of a page and the text outside of ``style``."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.text, self.hidden = [], "", False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.hidden = tag == "style"

    def handle_endtag(self, tag):
        self.hidden = False

    def handle_data(self, data):
        self.text += "" if self.hidden else data


def strict(path):
    """Read a JSON file, failing on NaN and Infinity, which Python would accept."""
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=lambda word: pytest.fail(f"not JSON: {word}"))


def curve():
    fig = Figure(figsize=(3, 2))
    fig.subplots().plot([0, 1], [1, 0])
    return fig


def size(png):
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", png[16:24])


def test_round_trip(tmp_path):
    report = Report(tmp_path / "out" / "study", "Mirror box", seed=np.uint32(7))
    report.section("What was measured")
    report.text("The mean is **right**, see `report.json`.\n\nA second paragraph.")
    report.values({"mean": np.float32(0.5), "n": np.int64(3), "curve": jnp.arange(3.0), "pair": Pair(1.0, 0.25)})
    report.table(["name", "value"], [["a", 0.123456789], ["b", "0.26612(8)"]], "two rows")
    figure = report.figure(curve(), "curve", "a falling line")
    image = report.image(np.linspace(0, 1, 6).reshape(2, 3), "ramp", "six grey pixels")
    assert size(image.read_bytes()) == (3, 2)
    page = report.save()

    facts = strict(page.with_name("report.json"))
    assert facts["title"] == "Mirror box" and facts["seed"] == 7
    assert facts["values"] == {"mean": 0.5, "n": 3, "curve": [0, 1, 2], "pair": {"mean": 1, "stderr": 0.25}}
    assert facts["tables"][0]["rows"] == [["a", 0.123456789], ["b", "0.26612(8)"]]
    assert [entry["file"] for entry in facts["figures"]] == [figure.name, image.name] == ["curve.png", "ramp.png"]
    assert facts["versions"]["numpy"] == np.__version__
    assert facts["machine"] == machine() and facts["machine"]["cores"] >= 1 and facts["machine"]["devices"]

    parsed = Tags(page.read_text(encoding="utf-8"))
    sources = [attrs["src"] for tag, attrs in parsed.tags if tag == "img"]
    assert len(sources) == 2 and all(source.startswith("data:image/png;base64,") for source in sources)
    assert not {"script", "link"} & {tag for tag, _ in parsed.tags}
    assert "0.123457" in parsed.text and "A second paragraph." in parsed.text and "**" not in parsed.text
    assert sum(tag in ("td", "th") and attrs.get("class") == "number" for tag, attrs in parsed.tags) == 3
    assert sorted(os.listdir(page.parent)) == ["curve.png", "ramp.png", "report.html", "report.json"]


def test_json_is_strict(tmp_path):
    report = Report(tmp_path, "limits")
    report.value("all", [np.nan, np.inf, -np.inf, np.float32("nan"), np.array([1, np.inf]), jnp.float32(jnp.nan), True])
    report.table(["x"], [[float("nan")], [np.float64("inf")]])
    report.save()
    facts = strict(tmp_path / "report.json")
    assert facts["values"]["all"] == [None, "inf", "-inf", None, [1, "inf"], None, True]
    assert facts["tables"][0]["rows"] == [[None], ["inf"]]


def test_a_json_file_is_strict_and_whole_or_left_as_it_was(tmp_path):
    file = tmp_path / "new" / "numbers.json"
    write_json(file, {"a": np.inf, 2: (np.nan, np.float32(0.5)), "pair": Pair(1.0, -np.inf)})
    assert strict(file) == {"a": "inf", "2": [None, 0.5], "pair": {"mean": 1.0, "stderr": "-inf"}}
    with pytest.raises(ValueError, match=r"numbers\.thing.*object"):
        write_json(file, {"thing": object()})
    assert strict(file)["a"] == "inf" and [path.name for path in file.parent.iterdir()] == ["numbers.json"]
    with pytest.raises(ValueError, match="Name another folder"):
        write_json(file / "below" / "numbers.json", {})


def test_everything_is_escaped(tmp_path):
    evil = "<script>alert('&')</script>"
    report = Report(tmp_path, evil)
    report.section(evil)
    report.text(f"{evil} and `{evil}`")
    report.value(evil, evil)
    report.table([evil], [[evil]], evil)
    report.figure(curve(), "curve", evil)
    parsed = Tags(report.save().read_text(encoding="utf-8"))
    assert "script" not in {tag for tag, _ in parsed.tags}
    assert parsed.text.count(evil) == 11  # the title counts twice: in the head and on the page


def test_image_marks_what_is_not_finite(tmp_path):
    from PIL import Image

    pixels = np.array([[0.0, 1.0, 7.0, np.nan], [0.5, -1.0, np.inf, 0.2]])
    with Image.open(Report(tmp_path, "image").image(pixels, "image")) as image:
        shown = np.asarray(image)
    magenta = [255, 0, 255]
    assert shown[0].tolist() == [[0] * 3, [255] * 3, [255] * 3, magenta]
    assert shown[1].tolist() == [[128] * 3, [0] * 3, magenta, [51] * 3]


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ValueError, match="Name another folder"):
            Report(folder, "nowhere")


def test_mistakes_are_named_at_once(tmp_path):
    report = Report(tmp_path, "mistakes")
    with pytest.raises(ValueError, match=r"settings\.thing.*object"):
        report.value("settings", {"thing": object()})
    with pytest.raises(ValueError, match="one cell for each"):
        report.table(["a", "b"], [[1, 2], [1]])
    with pytest.raises(ValueError, match="shape"):
        report.image(np.zeros((2, 2, 4)), "rgba")
    report.image(np.zeros((2, 2)), "dark")
    for name in ("dark", "../outside", "a/b", ""):
        with pytest.raises(ValueError, match="new name"):
            report.image(np.zeros((2, 2)), name)


def test_old_report_survives_a_failing_save(tmp_path, monkeypatch):
    first = Report(tmp_path, "first")
    first.figure(curve(), "curve")
    first.save()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    second = Report(tmp_path, "second")
    second.value("x", 1.0)
    with monkeypatch.context() as patch:
        patch.setattr(Report, "_page", lambda self, about: "\ud800")  # a page that cannot be encoded
        with pytest.raises(UnicodeEncodeError):
            second.save()

        def full(self, content):
            raise OSError(28, "No space left on device")

        patch.setattr("pathlib.Path.write_bytes", full)
        with pytest.raises(OSError, match="No space left"):
            second.figure(curve(), "curve")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before

    second.save()
    assert strict(tmp_path / "report.json")["title"] == "second"
