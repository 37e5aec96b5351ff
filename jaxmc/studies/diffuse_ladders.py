"""The four scenes of the study of diffuse and emissive surfaces, rendered with more and more samples."""

import time
from typing import NamedTuple

import numpy as np

from ..analysis import convergence
from ..integration.driver import integrate_each
from ..scenes import cornell_blocks, orb
from ..transport.integrands import neumann_terms
from .light_hits import Part, facts, reflects

BOUNCES = 5
DARK, SKY = "orb in the dark", "orb under a sky"
SCENES = {
    DARK: (orb, False),
    SKY: (orb, True),
    "box with a lamp": (cornell_blocks, False),
    "box with a bright ceiling": (cornell_blocks, True),
}
STRATEGIES = {"naive": {"directions": "uniform", "lights": "none"}, "default": {}}
REFERENCE = 4  # times as many samples as the largest rung
TIMED = (1 / 4, 1 / 2, 1)  # of the width and height: images that show how time grows with pixels


class Rung(NamedTuple):
    """Renders of one number of samples per pixel: the first of them, and of all the mean squared error and the medians
    of wall seconds and of seconds of all cores."""

    image: np.ndarray
    mse: float
    seconds: float
    core_seconds: float


class Measured(NamedTuple):
    """What is measured of one scene, arrays of shape (height, width) but for the image.

    ``mask``: the pixels in which a surface that is no light is seen. ``truth`` is the luminance of the reference,
    ``noise`` its variance. ``light`` is the direct light, ``direct_variance`` that of one naive sample of it, ``meets``
    the share of naive paths that meet light. ``variance`` is that of one sample's luminance, ``ladder`` the rungs by
    number of samples, both for each strategy.
    """

    mask: np.ndarray
    image: np.ndarray
    truth: np.ndarray
    noise: np.ndarray
    light: Part
    direct_variance: np.ndarray
    meets: np.ndarray
    variance: dict[str, np.ndarray]
    ladder: dict[str, dict[int, Rung]]

    @property
    def mean(self):
        """Mean luminance over the mask."""
        return self.truth[self.mask].mean()

    def relative_variance(self, strategy):
        """Return the variance of one sample, mean over the mask, in units of the squared mean."""
        return self.variance[strategy][self.mask].mean() / self.mean**2


def measure(name, settings, stages, stream) -> Measured:
    """Estimate image and facts by both strategies; then render with more and more samples, and compare."""
    n, size = REFERENCE * settings.spp, settings.size
    found, ladder = {}, {}
    for k, strategy in enumerate(STRATEGIES):
        progress = stages.stage(f"{name}, {strategy}, {n} spp")
        estimate, *_ = shoot(name, size, n, strategy, _key(settings, stream + k), progress)
        found[strategy] = [_images(tree, size) for tree in (estimate.mean, estimate.variance)]
    (mean, variance), (naive, naive_variance) = found["default"], found["naive"]
    truth, noise = mean["luminance"], variance["luminance"] / n
    make, light = SCENES[name]
    mask = reflects(*make(light, width=size, height=size))
    for k, strategy in enumerate(STRATEGIES):
        first = stream + 2 + 30 * k
        ladder[strategy] = _ladder(name, settings, stages, strategy, (mask, truth, noise), first)
    light = Part(naive["hit"], n, mean["direct"], variance["direct"] / n)
    variances = {strategy: variance["luminance"] for strategy, (_, variance) in found.items()}
    return Measured(
        mask, mean["image"], truth, noise, light, naive_variance["direct"], naive["meets"], variances, ladder
    )  # fmt: skip


def _ladder(name, settings, stages, strategy, reference, stream) -> dict[int, Rung]:
    mask, truth, noise = reference
    progress = stages.stage(f"{name}, {strategy}, up to {settings.spp} spp")
    ladder, done = {}, 0
    for n in settings.ladder:
        errors, times, first = [], [], None
        for _ in range(settings.replicates(n)):
            stream, done = stream + 1, done + n * settings.size**2
            estimate, *seconds = shoot(name, settings.size, n, strategy, _key(settings, stream))
            images = _images(estimate.mean, settings.size)
            first = images["image"] if first is None else first
            errors.append(convergence.image_error(images["luminance"][mask], truth[mask], noise[mask]))
            times.append(seconds)
            progress(done, None)
        ladder[n] = Rung(first, float(np.mean(errors)), *map(float, np.median(times, axis=0)))
    return ladder


def shoot(name, size, spp, strategy, key, progress=None):
    """Return an image with its facts, the wall seconds, and the seconds that all cores worked on it."""
    make, light = SCENES[name]
    integrand = neumann_terms(*make(light, width=size, height=size), bounces=BOUNCES, **STRATEGIES[strategy])
    start, worked = time.perf_counter(), time.process_time()
    estimate = integrate_each(integrand.map(facts), size**2, n=spp, key=key, progress=progress)
    return estimate, time.perf_counter() - start, time.process_time() - worked


def _images(tree, size):
    return {key: x.reshape(size, size, *x.shape[1:]) for key, x in tree.items()}


def time_pixels(settings, stages):
    """Return (pixels, wall seconds, seconds of cores) of naive renders of several sizes, compiled before."""
    name, times = settings.scenes[-1], []
    for part in TIMED:
        size = int(part * settings.size)
        progress = stages.stage(f"{size} x {size} pixels")
        shoot(name, size, 1, "naive", _key(settings, 999))
        shots = []
        for k in range(2):
            shots.append(shoot(name, size, settings.spp, "naive", _key(settings, 1000 + k))[1:])
            progress((k + 1) * settings.spp * size**2, None)
        times.append((size**2, *np.min(shots, axis=0)))
    return np.array(times)


def _key(settings, stream):
    return (settings.seed << 10) + stream
