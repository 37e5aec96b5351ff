"""Imports follow the arrows of the design, and files stay small."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOP = "integration transport analysis gradients backend report plot scenes testing race other_integrators known"
TOP += " pictures live fireflies"
# room -> the rooms that it may import, besides itself. "" is `jaxmc` itself, that is, the public names.
ALLOWED = {
    "backend": "",
    "report": "",
    "testing": "integration",
    "integration": "backend",
    "transport": "integration backend",
    "analysis": "integration backend",
    "gradients": "integration transport backend",
    "fireflies": "integration transport analysis",
    "pictures": "",
    "plot": "analysis pictures",
    "live": "integration transport plot pictures",
    "scenes": "transport",
    "race": "analysis",
    "other_integrators": "",
    "known": "",
    "merge_command": "integration pictures",
}
EDGES = {room: {room, *rooms.split()} for room, rooms in ALLOWED.items()}
EDGES["bench"] = {"", "bench", *TOP.split()}
EDGES["studies"] = {"", "studies", *TOP.split()}
EDGES["render_command"] = {"render_command", *EDGES["studies"]}
EDGES["study_commands"] = {"study_commands", *EDGES["render_command"]}
EDGES[""] = EDGES["cli"] = EDGES["__main__"] = {"cli", "bench", "merge_command", *EDGES["study_commands"]}
FILES = sorted(path for package in ("jaxmc", "analytic_scenes") for path in (ROOT / package).rglob("*.py"))


def imports(source, module):
    """Yield the dotted name of everything that ``source``, of the module at path ``module``, imports, functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = [*(module[: -node.level] if node.level else ()), *(node.module.split(".") if node.module else ())]
            yield from (".".join([*base, alias.name]) for alias in node.names)


def violations(source, module):
    """Return the imports in ``source`` that are forbidden to ``module``, such as ("jaxmc", "analysis", "tails")."""
    package, room = module[0], "" if module[1] == "__init__" else module[1]
    found = []
    for name in imports(source, module):
        top, target, *_ = [*name.split("."), "", ""]
        target = target if target in EDGES else ""  # `from jaxmc import integrate` asks for a public name
        wrong = (
            (package == "jaxmc" and top == "jaxmc" and target not in EDGES[room])
            or (package == "jaxmc" and top == "analytic_scenes")
            or (top == "matplotlib" and module[:2] != ("jaxmc", "plot"))
            or (f"{name}.".startswith("jax._src.") and module != ("jaxmc", "backend"))
        )
        found += [f"{'.'.join(module)} imports {name}"] if wrong else []
    return found


def test_imports_follow_the_arrows():
    assert len(FILES) > 5
    modules = {path: path.relative_to(ROOT).with_suffix("").parts for path in FILES}
    assert {parts[1] for parts in modules.values() if parts[0] == "jaxmc"} <= {*EDGES, "__init__"}, "an unknown room"
    assert [line for path, module in modules.items() for line in violations(path.read_text(), module)] == []


@pytest.mark.parametrize(
    "module, source, wrong",
    [
        ("jaxmc/analysis/tails", "from ..transport import vec", True),
        ("jaxmc/analysis/tails", "from .. import transport", True),
        ("jaxmc/analysis/tails", "from ..integration import tallies\nfrom . import fireflies", False),
        ("jaxmc/analysis/__init__", "from .tails import hill", False),
        ("jaxmc/integration/driver", "def f():\n    from jaxmc import integrate", True),
        ("jaxmc/integration/driver", "from .. import backend\nfrom ..backend import configure", False),
        ("jaxmc/transport/paths", "import jaxmc.analysis.tails as tails", True),
        ("jaxmc/studies/mirror_box", "import jaxmc as mc\nfrom ..report import Report", False),
        ("jaxmc/studies/mirror_box", "import analytic_scenes", True),
        ("jaxmc/studies/mirror_box", "from matplotlib import pyplot", True),
        ("jaxmc/studies/calibration", "from ..known import maker", False),
        ("jaxmc/known", "import analytic_scenes", True),
        ("jaxmc/plot/images", "from matplotlib import pyplot\nfrom ..pictures import tone_map", False),
        ("jaxmc/plot/images", "from ..transport import vec", True),
        ("jaxmc/report", "import matplotlib", True),
        ("analytic_scenes/plot", "import matplotlib", True),
        ("jaxmc/bench", "from . import integrate, plot", False),
        ("jaxmc/bench", "import analytic_scenes.genz", True),
        ("jaxmc/other_integrators", "from . import integrate", True),
        ("jaxmc/fireflies/cures", "from ..transport.images import render\nfrom ..analysis import robust", False),
        ("jaxmc/fireflies/comparison", "from ..plot import cures", True),
        ("jaxmc/plot/cures", "from ..fireflies import Comparison", True),
        ("jaxmc/transport/images", "from ..fireflies import compare", True),
        ("jaxmc/report", "from .backend import configure", True),
        ("jaxmc/__init__", "from .plot import image", False),
        ("jaxmc/transport/vec", "from jax._src import core", True),
        ("analytic_scenes/furnace", "import jaxmc as mc\nfrom . import cavity", False),
    ],
)
def test_the_rule_tells_right_from_wrong(module, source, wrong):
    assert bool(violations(source, tuple(module.split("/")))) == wrong


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_small_and_named_for_what_they_hold(path):
    assert path.stem not in ("utils", "util", "common", "helpers", "misc")
    assert len(path.read_text().splitlines()) <= 300


def test_slow_tests_that_are_listed_exist(missing_slow_tests):
    assert not missing_slow_tests, "take them off tests/slow.txt, or give them their new names"
