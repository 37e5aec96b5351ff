"""Several processes, on one machine or many, that make each estimate together.

All of them run the same program, and talk by way of the key-value store of ``jax.distributed``. The integrals of a
family, such as the pixels of an image, are dealt to them, see ``dealing``. Of the kernel calls of a single integral
each makes every k-th, and sends the records to the others; all add them up in the same order. So each process has the
same estimate, bit for bit that of a single one.
"""

import threading
import time
from collections import deque

import jax
import numpy as np

from .. import backend
from .mailbox import Mailbox, new_secret, own_host

BEAT, SILENCE = 2.0, 20.0  # seconds between signs of life; without one a process is lost
PATIENCE = 3600.0  # seconds that processes wait for each other where there is nothing to tell that one is lost


class LostProcess(RuntimeError):
    """Another process has ended, or cannot be reached."""


class Team:
    """The processes that make estimates together, of which this is number ``rank`` of ``size``."""

    def __init__(self, client, rank, size, workers, first):
        self.client, self.rank, self.size = client, rank, size
        self.calls, self.meetings, self.sent, self.looked = 0, 0, deque(), time.monotonic()
        self.exchanges, self.words, self.heard = 0, 0, 0
        self.seen: dict[int, tuple[str, float, float]] = {}
        client.key_value_set(f"jaxmc/workers/{rank}", str(workers))
        threading.Thread(target=self._beat, daemon=True).start()
        if rank == 0:
            client.key_value_set("jaxmc/secret", new_secret())
        secret = self._wait(lambda ms: self._get("jaxmc/secret", ms), 0)
        self.mailbox = Mailbox(own_host(first), secret.encode())
        client.key_value_set(f"jaxmc/address/{rank}", self.mailbox.address)
        self.addresses = [self._wait(lambda ms, k=k: self._get(f"jaxmc/address/{k}", ms), k) for k in range(size)]
        self.workers = max(int(self._wait(lambda ms, k=k: self._get(f"jaxmc/workers/{k}", ms), k)) for k in range(size))

    def _get(self, key, milliseconds):
        return self.client.blocking_key_value_get(key, milliseconds)

    def _beat(self):
        count = 0
        while True:
            count += 1
            try:
                self.client.key_value_set(f"jaxmc/alive/{self.rank}", str(count), allow_overwrite=True)
            except Exception:  # the store is gone: whoever waits for something finds out
                return
            time.sleep(BEAT)

    def _wait(self, get, owner):
        """Return ``get(milliseconds)`` of what process ``owner`` sends, as soon as it is there."""
        while True:
            try:
                return get(int(1000 * BEAT))
            except jax.errors.JaxRuntimeError as error:
                if "DEADLINE_EXCEEDED" not in str(error):
                    raise LostProcess(f"the other processes cannot be reached: {str(error)[:200]}") from error
            self._check(owner)

    def _check(self, owner):
        """Raise ``LostProcess`` if a process has given no sign of life for too long."""
        try:
            beat = self._get(f"jaxmc/alive/{owner}", int(1000 * BEAT))
        except jax.errors.JaxRuntimeError:
            beat = "none"
        now = time.monotonic()
        last, since, looked = self.seen.get(owner, ("", 0.0, 0.0))
        # A new sign of life counts, and so does a pause of this process, for the others may have paused with it.
        if beat != last or now - looked > SILENCE / 2:
            since = now
        self.seen[owner] = beat, since, now
        if now - since > SILENCE:
            raise LostProcess(
                f"process {owner} of {self.size} has given no sign of life for {SILENCE:g} s: it was killed, or cannot "
                "be reached. Start all again; what is in a checkpoint is not made again"
            )

    def look(self):
        """Raise ``LostProcess`` if another process is lost; looks once in a while, however often it is called."""
        if time.monotonic() - self.looked > BEAT:
            self.looked = time.monotonic()
            for owner in range(self.size):
                self._check(owner)

    def say(self, word):
        """Let all processes ``hear`` a word of this one, the first of them."""
        self.words += 1
        self.client.key_value_set(f"jaxmc/words/{self.words}", word)

    def hear(self):
        """Return the next word of the first process."""
        self.heard += 1
        return self._wait(lambda ms: self._get(f"jaxmc/words/{self.heard}", ms), 0)

    def exchange(self, content: bytes, everyone: bool) -> list[bytes]:
        """Return what all processes pass here, by their ranks; unless ``everyone`` asks, none but the first gets it."""
        self.exchanges += 1
        number, found = self.exchanges, []
        self.mailbox.offers[number] = content
        self.client.key_value_set(f"jaxmc/offered/{number}/{self.rank}", "there")
        if everyone or self.rank == 0:
            found = [content if owner == self.rank else self._fetch(owner, number) for owner in range(self.size)]
        self.meet()
        del self.mailbox.offers[number]
        return found

    def _fetch(self, owner, number):
        self._wait(lambda ms: self._get(f"jaxmc/offered/{number}/{owner}", ms), owner)
        address = self.addresses[owner]
        try:
            return self.mailbox.fetch(address, number)
        except (OSError, EOFError) as error:
            raise LostProcess(f"process {owner} of {self.size} cannot be reached at {address}: {error}") from error

    def meet(self):
        """Wait until all processes are here."""
        self.meetings += 1
        key = f"jaxmc/met/{self.meetings}"
        self.client.key_value_set(f"{key}/{self.rank}", "here")
        for owner in range(self.size):
            self._wait(lambda ms, owner=owner: self._get(f"{key}/{owner}", ms), owner)

    def shared(self, compute, template):
        """Return a function of (number, job) that has the job done by the process whose turn it is.

        ``compute(job)`` returns the job, its number of blocks, its records and an example; ``template`` has the shapes
        and types of the records and the example.
        """
        self.calls += 1
        call, (shapes, example) = self.calls, template
        leaves, structure = jax.tree.flatten(shapes)
        example = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), example)

        def do(numbered):
            number, job = numbered
            key, owner = f"jaxmc/records/{call}/{number}", number % self.size
            if owner == self.rank:
                job, blocks, records, _ = compute(job)
                self.client.key_value_set_bytes(
                    key, b"".join(np.ascontiguousarray(x) for x in jax.tree.leaves(records))
                )
                self._forget(key)
                return job, blocks, records, example
            content = self._wait(lambda ms: self.client.blocking_key_value_get_bytes(key, ms), owner)
            blocks, found, start = int(np.count_nonzero(job.rows.any(axis=1))), [], 0
            for x in leaves:
                shape = (blocks, *x.shape[1:])
                count = int(np.prod(shape))
                found.append(np.frombuffer(content, x.dtype, count, start).reshape(shape))
                start += count * np.dtype(x.dtype).itemsize
            return job, blocks, jax.tree.unflatten(structure, found), example

        return do

    def _forget(self, key):
        """Take back what all have read by now: nobody is further ahead than its queue is long."""
        self.sent.append(key)
        while len(self.sent) > 4 * self.workers + 8:
            self.client.key_value_delete(self.sent.popleft())


_teams: list[Team] = []


def join_processes() -> Team | None:
    """Let all processes of ``jax.distributed`` make estimates together from now on; None if there is but one.

    All must call ``integrate`` and ``render`` in the same order with the same arguments, and run on processors of one
    kind. Files of checkpoints are written by process 0, and must be where all can read them.

    Raises:
        ValueError: ``jax.distributed`` was not initialised.
    """
    client, rank, size, first = backend.processes()
    if client is None:
        raise ValueError("call jax.distributed.initialize(address, count, rank) first, before any computation")
    if not _teams and size > 1:
        _teams.append(Team(client, rank, size, backend.workers(), first))
    return team()


def team() -> Team | None:
    """Return the processes that this one makes estimates with, or None."""
    return _teams[0] if _teams else None
