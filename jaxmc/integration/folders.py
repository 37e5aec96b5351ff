"""A folder of checkpoints, for work that makes many estimates one after the other, such as a study."""

import contextlib
import dataclasses
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .checkpoint import SECONDS, Checkpoint, Keeper, folder_in_use, is_first, meet
from .estimate import Estimate

ABOUT = "about.json"
SHORT = 2.0  # seconds: an estimate that takes less is made again, not read


@contextlib.contextmanager
def kept_in(folder, about: dict[str, Any], resume: bool, seconds: float = SECONDS) -> Iterator[None]:
    """Keep the estimates that are made inside in a folder, so that a run after a kill makes none of them again.

    The work must be the same each time: the k-th call of ``integrate`` or ``render`` is known by its number, and by its
    recipe. The folder is removed at the end of the work, and kept when that is ended by an exception.

    Args:
        folder: a folder of its own, made here.
        about: what the work is, as plain data; resumed is only what is about the same.
        resume: take up what is there; if not, it is removed.
        seconds: between checkpoints.

    Raises:
        ValueError: the folder holds other work, which would be resumed.
    """
    if not seconds >= 0.0:
        raise ValueError(f"seconds between checkpoints must be 0 or more, got {seconds!r}")
    folder, text = Path(folder), json.dumps(about, sort_keys=True, default=repr)
    known = folder / ABOUT
    if resume and known.exists() and (before := known.read_text(encoding="utf-8")) != text:
        cure = "resume with the same options, or leave out --resume"
        raise ValueError(f"{folder} was begun as {before[:500]}, and this is {text}; {cure}")
    meet()
    if is_first():
        if not resume:
            shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = known.with_suffix(".unfinished")
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, known)
    meet()
    token = folder_in_use.set(Folder(folder, seconds))
    try:
        yield
    finally:
        folder_in_use.reset(token)
    meet()
    if is_first():
        shutil.rmtree(folder, ignore_errors=True)


class Folder:
    """Files of the estimates of some work, by their numbers."""

    def __init__(self, path, seconds):
        self.path, self.seconds, self.count = path, seconds, 0

    def keep(self, run, n, target, bar, make) -> Estimate:
        """Return the estimate of ``make()``, or that in the file of its number; see ``checkpoint.keep``."""
        self.count += 1
        checkpoint = Checkpoint(self.path / f"{self.count:05}.npz", self.seconds)
        keeper = Keeper(checkpoint, run, n, target, at_least=min(SHORT, self.seconds))
        with contextlib.suppress(ValueError):
            keeper.resume(bar)
        estimate = keeper.grown(make)
        # The sums have done their work; without them an image needs a third of the memory.
        return dataclasses.replace(estimate, sums=None)
