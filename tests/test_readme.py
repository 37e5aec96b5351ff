"""The README's examples run, in order, as one program."""

import re
from pathlib import Path

README = Path(__file__).resolve().parent.parent / "README.md"


def test_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # they write files
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.S)
    assert len(blocks) >= 4
    namespace = {}
    for block in blocks:
        exec(compile(block, str(README), "exec"), namespace)
        namespace.setdefault("estimate_of_exp", namespace["estimate"])
    assert namespace["even"].stderr < 0.02 * namespace["estimate_of_exp"].stderr
    assert namespace["wanted"].status == "converged"
    assert abs(namespace["estimate"].mean - namespace["lamp"].exact) < 5 * namespace["estimate"].stderr
    assert namespace["result"].passed


def test_files_named_in_the_readme_exist():
    for path in re.findall(r"\]\((?!http)([^)#]+)\)", README.read_text()):
        assert (README.parent / path).exists(), path
