"""Marks as slow what is listed in ``slow.txt``: tests that take long and resemble others, as measured."""

from pathlib import Path

import pytest

SLOW = set(Path(__file__).with_name("slow.txt").read_text().split("\n"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.nodeid.removeprefix("tests/") in SLOW:
            item.add_marker(pytest.mark.slow)
