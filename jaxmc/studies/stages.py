"""One progress bar for all the sampling of a study."""

import dataclasses
import time

from tqdm import tqdm


@dataclasses.dataclass
class Stages:
    """A progress bar over all stages of a study, in samples, with rate and time left."""

    total: int
    shown: bool = True

    def __enter__(self):
        self.started = time.perf_counter()
        self.bar = tqdm(total=self.total, unit=" paths", unit_scale=True, disable=not self.shown, smoothing=0.05)
        return self

    def __exit__(self, *error):
        self.bar.close()

    @property
    def seconds(self):
        """Seconds since the start."""
        return time.perf_counter() - self.started

    def stage(self, title):
        """Start a stage and return the callback that takes (samples done, samples in this stage)."""
        self.bar.set_description(title)
        before = self.bar.n

        def update(done, total):
            self.bar.update(before + done - self.bar.n)

        return update
