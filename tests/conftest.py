"""Marks as slow what is listed in ``slow.txt``: tests that take long and resemble others, as measured."""

from pathlib import Path

import jax
import pytest

HERE = Path(__file__).parent
SLOW = set((HERE / "slow.txt").read_text().splitlines())
LONGEST = "tests/test_readme.py"
MAPPINGS = Path("/proc/self/maps")
MOST = 30_000  # pieces of memory in use: Linux ends a process at 65,530, and each kernel takes some
MISSING = pytest.StashKey[set[str]]()  # listed tests that do not exist


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))  # so that no worker is left alone with it
    found = {item.nodeid.removeprefix("tests/"): item for item in items}
    for name in SLOW & found.keys():
        found[name].add_marker(pytest.mark.slow)
    # A file of which single tests were asked for tells nothing of the others, nor does one that was not asked for.
    files = {name.split("::")[0] for name in found}
    is_whole = not config.getoption("lf") and not any("::" in argument for argument in config.args)
    gone = {name for name in SLOW - found.keys() if name.split("::")[0] in files or not _has_file(name)}
    config.stash[MISSING] = gone if is_whole else set()


def _has_file(name):
    return (HERE / name.split("::")[0]).exists()


@pytest.fixture
def missing_slow_tests(pytestconfig):
    """Names in ``slow.txt`` of tests that were looked for and not found: renamed or removed."""
    return pytestconfig.stash[MISSING]


@pytest.fixture(autouse=True)
def few_kernels(request):
    """After a slow test forget all kernels where they have become too many."""
    yield
    if request.node.get_closest_marker("slow") and MAPPINGS.exists():
        with MAPPINGS.open() as lines:
            if sum(1 for _ in lines) > MOST:
                jax.clear_caches()
