"""The command ``jaxmc scenes``, and names of scenes."""

import dataclasses
import functools
import re
import tomllib
from importlib import metadata
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import analytic_scenes
import jaxmc as mc
from analytic_scenes import command, find
from analytic_scenes.names import slug
from analytic_scenes.scene import AnalyticScene
from jaxmc import cli

ROOT = Path(__file__).parents[1]


def twice(x):
    return 2.0 * x


def value(height, shape):
    """The mean of a ramp."""
    return jax.vmap(lambda h: twice(h) / 4.0)(jnp.ones(shape) * height)[0]


def view():
    ball = mc.Sphere((0, 0, 0), 0.5, mc.Diffuse(0.3))
    return mc.Scene([ball], sky=0.1), mc.PinholeCamera((0, 1, 3), (0, 0, 0), width=24, height=16)


RAMP = AnalyticScene(
    name="Ramp of height 2, in one dimension",
    integrand=mc.Integrand(lambda u, height: height * u[0], 1, (2.0,)),
    exact=1.0,
    exact_variance=1.0 / 3.0,
    exact_kurtosis=1.8,
    derivatives={"height": 0.5, "direction": np.array([0.0, 1.0, 2.0])},
    source="elementary",
    formula=functools.partial(value, shape=(1,)),
    arguments={"height": 2.0},
    geometry="A line from 0 to the height.",
    view=view,
)
BARE = dataclasses.replace(
    RAMP, name="bare ramp", formula=None, arguments={}, geometry="", view=None, exact_variance=None
)


@pytest.fixture
def jaxmc(monkeypatch, capsys):
    """Return a function that runs the command line with the entry points of pyproject.toml and two small scenes."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    points = [metadata.EntryPoint(name, value, cli.COMMANDS) for name, value in groups[cli.COMMANDS].items()]
    monkeypatch.setattr(cli.metadata, "entry_points", lambda group: points if group == cli.COMMANDS else [])
    monkeypatch.setattr(analytic_scenes, "_all", lambda: (RAMP, BARE))

    def run(*arguments):
        code = cli.main(["scenes", *map(str, arguments)])
        return code, *capsys.readouterr()

    return run


def test_the_list_has_a_line_for_each_scene(jaxmc):
    code, out, _ = jaxmc()
    heads, first, second = out.splitlines()
    assert code == 0 and heads.split() == ["name", "exact", "variance", "derivatives", "source"]
    assert first.split() == ["ramp-of-height-2-in-one-dimension", "1", "0.3333", "2", "elementary"]
    assert second.split() == ["bare-ramp", "1", "-", "2", "elementary"]


def test_one_scene_is_shown_with_formula_picture_and_check(jaxmc, tmp_path):
    code, out, _ = jaxmc("height", "--out", tmp_path / "pictures", "--seed", 3)
    assert code == 0
    for words in ("A line from 0 to the height.", "exact       1,", "0.3333333333, kurtosis 1.8", "elementary"):
        assert words in out
    assert "arguments   height = 2." in out and "direction = [0. 1. 2.]" in out
    assert "def value(height, shape):" in out and '"""The mean of a ramp."""' in out
    assert re.search(r"\nRamp of height 2, in one dimension|  Ramp of height 2.* agrees\n", out)
    file = tmp_path / "pictures" / f"{RAMP.slug}.png"
    assert str(file) in out
    pixels = np.asarray(Image.open(file))
    assert pixels.shape == (16, 24, 3) and pixels.max() == 255 and pixels.min() < 200


def test_a_scene_that_knows_little_is_shown_too(jaxmc):
    code, out, _ = jaxmc("bare-ramp", "--rel-precision", "0.01")
    assert code == 0
    for words in ("geometry    not described", "not known", "arguments   none", "formula     none in code"):
        assert words in out
    assert "none: there is nothing to see" in out


def test_a_check_that_fails_is_the_exit_code(jaxmc, monkeypatch):
    monkeypatch.setattr(analytic_scenes, "_all", lambda: (dataclasses.replace(BARE, exact=1.1),))
    code, out, _ = jaxmc("bare")
    assert code == 1 and "wrong" in out


def test_errors_are_one_line_with_the_cure(jaxmc):
    for arguments, cure in (
        (["ramp"], "'ramp' fits 2 scenes; name one: ramp-of-height-2-in-one-dimension, bare-ramp"),
        (["bear-ramp"], "near are bare-ramp, ramp-of-height-2-in-one-dimension"),
        (["zzz"], "`jaxmc scenes` lists them all"),
        (["bare", "--rel-precision", "0"], "rel_precision must be positive"),
        (["height", "--out", "/dev/null/x"], "Name another one"),
    ):
        code, _, error = jaxmc(*arguments)
        assert code == 2 and error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error


def test_formulas_of_the_package_are_shown_with_what_they_call():
    text = command.source_text(analytic_scenes.sphere_in_mirror_irradiance)
    for name in ("sphere_in_mirror_irradiance", "mirror_image", "_sphere_factor"):
        assert text.count(f"def {name}(") == 1
    assert command.source_text(jax.jit(twice)) == "def twice(x):\n    return 2.0 * x"
    assert "cannot be read" in command.source_text(eval("lambda x: x", {}))
    assert command.source_text(np.exp) == repr(np.exp)


def test_the_entry_points_lead_to_functions_and_jaxmc_itself_knows_none():
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    points = [metadata.EntryPoint(name, value, cli.COMMANDS) for name, value in groups[cli.COMMANDS].items()]
    assert [point.name for point in points] == ["scenes"] and points[0].load() is command.add_command
    assert "analytic_scenes" not in (ROOT / "jaxmc" / "cli.py").read_text()


def test_a_broken_command_of_another_package_does_not_stop_the_others(monkeypatch, capsys):
    points = [metadata.EntryPoint("broken", "no_such_module:add", cli.COMMANDS)]
    monkeypatch.setattr(cli.metadata, "entry_points", lambda group: points)
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0 and "the command broken of no_such_module:add is missing" in capsys.readouterr().err


# ---------------------------------------------------------------------------------------- names


def test_slugs_are_typeable():
    assert slug("Größe: u^-0.3, n=2 (a)") == "große-u-0.3-n-2-a".replace("ß", "")
    assert slug(RAMP.name) == RAMP.slug == "ramp-of-height-2-in-one-dimension"


def test_a_scene_is_found_by_name_slug_or_a_part_of_its_own():
    scenes = (RAMP, BARE, dataclasses.replace(BARE, name="ramp"))
    for name in (RAMP.name, RAMP.slug, "Height 2", "one-dim"):
        assert find(name, scenes) is RAMP
    assert find("ramp", scenes).name == "ramp"  # a whole name before a part of others
    for name in ("", "--", "x"):
        with pytest.raises(ValueError, match="no scene"):
            find(name, scenes)
