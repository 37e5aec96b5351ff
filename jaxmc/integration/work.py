"""Work in hand: threads that do jobs in order, and a bar that shows how many are done."""

import functools
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait

from tqdm import tqdm


@functools.cache
def _pool(workers):
    return ThreadPoolExecutor(workers)


def ordered_map(function, jobs, workers) -> Iterator:
    """Yield ``function(job)`` in the order of the jobs, with ``workers`` threads and a bounded queue."""
    pool, pending = _pool(workers), deque()
    try:
        for job in jobs:
            pending.append(pool.submit(function, job))
            if len(pending) > 2 * workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        # Leave nothing running behind: whoever stops early may change what the jobs use.
        for future in pending:
            future.cancel()
        wait(pending)


class Progress:
    """A progress bar with rate and time left, a callback, or nothing."""

    def __init__(self, progress, total):
        self.done, self.total = 0, total
        self.callback = progress if callable(progress) else None
        title = progress if isinstance(progress, str) else None
        shown = progress is not None and progress is not False and self.callback is None
        self.bar = tqdm(total=total, desc=title, unit=" samples", unit_scale=True) if shown else None

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if self.bar is not None:
            self.bar.close()

    def begin_at(self, samples):
        """Say how many samples were there before: they count as done, but not for the rate."""
        self.done = samples
        if self.bar is not None:
            self.bar.initial = self.bar.n = samples
            self.bar.refresh()

    def update(self, samples):
        self.done += samples
        if self.bar is not None:
            self.bar.update(samples)
        if self.callback is not None:
            self.callback(self.done, self.total)
