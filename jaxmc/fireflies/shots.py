"""Renders of the scene on which cures are compared, and how long they take."""

import time
from typing import NamedTuple

import numpy as np

from ..integration.moments import Moments
from ..integration.work import Progress
from ..transport.images import render
from .cures import Kept

TIMED = 1 << 18  # samples, or so, of a timed image: what a call costs once must not count


class Shots(NamedTuple):
    """Renders of the scene that is compared, each with a number that makes its seed."""

    scene: object
    camera: object
    paths: dict
    seed: int
    bar: Progress

    def __call__(self, render, spp, stream, tallies):
        """Return the result of each tally from ``spp`` samples; a ``Moments`` tally has one leaf."""
        tallies = {str(k): tally for k, tally in enumerate(tallies)}
        estimate = render(self.scene, self.camera, spp=spp, key=self.seed + stream, tallies=tallies, **self.paths)
        self.bar.update(spp * self.camera.width * self.camera.height)
        results = [estimate[name] for name in tallies]
        return [r[0] if isinstance(t, Moments) else r for r, t in zip(results, tallies.values())]


def timed_spp(camera) -> int:
    """Return the samples per pixel of a timed image."""
    return max(16, 2 * round(0.5 * TIMED / (camera.width * camera.height)))


def times(cures, shots, rounds):
    """Return for each cure the time of an image over that without any cure, and its standard error."""
    pairs = list(dict.fromkeys((c.render, c.tally) for c in cures))
    sampling, making = np.zeros((rounds, len(pairs))), np.zeros((rounds, len(cures)))
    for r in range(rounds + 1 if rounds else 0):
        kept = []
        for k, (shoot, tally) in enumerate(pairs):
            started = time.perf_counter()
            parts = 2 if shoot is render else 1
            spp = timed_spp(shots.camera) // parts
            kept.append(tuple(shots(shoot, spp, 2 * k + part, [tally])[0] for part in range(parts)))
            if r:  # the first round compiles
                sampling[r - 1, k] = time.perf_counter() - started
        for k, c in enumerate(cures):
            started = time.perf_counter()
            c.image(Kept(kept[pairs.index((c.render, c.tally))], shots.camera.width))
            if r:
                making[r - 1, k] = time.perf_counter() - started
    whole = making + sampling[:, [pairs.index((c.render, c.tally)) for c in cures]]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = whole / whole[:, :1]
    error = ratio.std(0, ddof=1) / np.sqrt(rounds) if rounds > 1 else np.full(len(cures), np.nan)
    means = ratio.mean(0) if rounds else np.full(len(cures), np.nan)
    return {c.name: (float(m), float(e)) for c, m, e in zip(cures, means, error)}
