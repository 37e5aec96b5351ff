"""Checkpoints: a run that is killed at any moment goes on where it stopped, and ends with the same bits."""

import contextlib
import dataclasses
import os
import signal
import threading
import time
from contextvars import ContextVar
from pathlib import Path

from . import machines, storage
from .counts import MOST
from .estimate import Estimate
from .recipes import difference, recipe
from .sums import Sums

SECONDS = 10.0
SHARE = 0.005  # of the time that may go into writing, the last time aside
folder_in_use: ContextVar = ContextVar("folder of checkpoints", default=None)  # see folders


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """A file that a run is kept in.

    Attributes:
        path: of the file, such as ``"run.npz"``.
        seconds: from one write to the next; more where writing takes over 0.5 % of that. 0 writes after every kernel
            call, whatever that costs.

    Raises:
        ValueError: a path that is none, in a folder that is none, or a negative time.
    """

    path: str | os.PathLike
    seconds: float = SECONDS

    def __post_init__(self):
        if not isinstance(self.path, str | os.PathLike) or not str(self.path):
            raise ValueError(f'checkpoint must be the path of a file, such as "run.npz", got {self.path!r}')
        if Path(self.path).is_dir() or not Path(self.path).parent.is_dir():
            raise ValueError(f"checkpoint {str(self.path)!r} is no file in a folder; make the folder first")
        if not (isinstance(self.seconds, int | float) and self.seconds >= 0.0):
            raise ValueError(f"seconds between checkpoints must be 0 or more, got {self.seconds!r}")


def keep(run, checkpoint, n, target, bar, make) -> Estimate:
    """Return the estimate that ``make()`` returns when it has let ``run`` grow, and keep its sums in a file meanwhile.

    What is in the file already is not done again. Without a checkpoint, only parts are given their recipe.
    """
    if checkpoint is None and (folder := folder_in_use.get()) is not None:
        return folder.keep(run, n, target, bar, make)
    if checkpoint is None:
        if run.part.about:
            run.sums.recipe = recipe(run, n, target)
        estimate = make()
        run.sums.finished = True
        return estimate
    checkpoint = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
    keeper = Keeper(checkpoint, run, n, target)
    keeper.resume(bar)
    return keeper.grown(make)


def is_first() -> bool:
    """Return whether this process is the one that writes."""
    team = machines.team()
    return team is None or team.rank == 0


def meet():
    """Let all processes read a file before one of them writes it, or the other way round."""
    if team := machines.team():
        team.meet()


class Keeper:
    """Writes the sums of a run into the file of a checkpoint, and takes them up from there."""

    def __init__(self, checkpoint, run, n, target, at_least=0.0):
        self.path, self.seconds, self.at_least = Path(checkpoint.path), checkpoint.seconds, at_least
        self.run, self.n, self.target = run, n, target
        self.interrupted, self.recipe = False, None

    def resume(self, bar):
        """Take up what is in the file, if there is one. Raises ``ValueError`` where that is of no use."""
        try:
            if self.path.exists():
                self.take_up(self.load())
                bar.begin_at(self.run.sums.drawn)
        finally:
            meet()

    def grown(self, make) -> Estimate:
        """Return the estimate of ``make()``, which is kept when it took ``at_least`` some seconds."""
        if self.run.sums.finished:
            return self.run.sums.estimate()
        self.run.keeper, self.due = self, time.monotonic() + self.seconds
        with self._interrupts():
            estimate = make()
        return self.finish(estimate)

    def load(self) -> Sums:
        """Return the sums in the file. Raises ``ValueError`` where it holds none, or those of another recipe."""
        found = storage.load(self.path)
        cure = "name another file, or remove this one"
        self.recipe = recipe(self.run, self.n, self.target)
        try:
            if not isinstance(found, Sums) or found.recipe is None or not (found.finished or found.pending):
                raise ValueError(f"holds no checkpoint; {cure}")
            if other := difference(found.recipe, self.recipe):
                raise ValueError(f"is of another run: it has {other}; {cure}")
            # Tallies of the caller have their functions, those of a file do not.
            sums = self.run.sums
            found.tallies, found.about, found.view = sums.tallies, sums.about, sums.view
            most = MOST if self.n is None else self.run.points(self.n) * (self.run.replicates or 1)
            found.check(self.run.empty_sums(self.n), most)
        except Exception as error:  # a file that was written by another hand may hold anything
            why = error if isinstance(error, ValueError) else f"holds no checkpoint, but {error!r}; {cure}"
            raise ValueError(f"{self.path} {why}") from error
        return found

    def take_up(self, found: Sums):
        """Let the run go on from sums that were found."""
        run = self.run
        run.sums, run.seconds_before = found, found.seconds
        run.used = found.first + (run.replicates or 0)

    def after_job(self, due=False):
        """Write, if it is ``due`` or time to. If Ctrl-C was pressed, write and raise ``KeyboardInterrupt``."""
        if self.interrupted:
            self.write()
            done = f"{self.run.sums.drawn:,} samples are done and kept in {self.path}"
            with contextlib.suppress(ValueError):  # no estimate yet
                done += f": {self.run.sums.estimate()}"
            raise KeyboardInterrupt(done)
        if due or time.monotonic() >= self.due:
            self.write()

    def finish(self, estimate) -> Estimate:
        sums = self.run.sums
        sums.finished, sums.result = True, dataclasses.replace(estimate, sums=None) if self.target else None
        sums.seconds = estimate.seconds
        if sums.seconds >= self.at_least:
            self.write()
            meet()
        return dataclasses.replace(estimate, sums=sums)

    def write(self):
        """Write the file, and put off the next time so that all of writing takes a small share of the run."""
        began = time.monotonic()
        sums = self.run.sums
        if self.recipe is None:
            self.recipe = recipe(self.run, self.n, self.target)
        sums.recipe = self.recipe
        if not sums.finished:
            sums.seconds = self.run.seconds
        if is_first():
            storage.save(self.path, sums)
        took = time.monotonic() - began
        self.due = time.monotonic() + (max(self.seconds, took / SHARE) if self.seconds else 0.0)

    @contextlib.contextmanager
    def _interrupts(self):
        """Let Ctrl-C wait until a job is done; a second one ends at once."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(*_):
            self.interrupted = True
            signal.signal(signal.SIGINT, before)

        before = signal.getsignal(signal.SIGINT)
        if before is None:  # set by another language: leave it alone
            yield
            return
        signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
