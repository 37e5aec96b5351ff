"""Every cure of fireflies beside the others, on one scene: what it costs in bias, in energy and in time."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from ..integration.counts import positive
from ..integration.moments import Moments
from ..integration.tallies import ClampLadder
from ..integration.work import Progress
from ..transport.images import render
from ..transport.materials import luminance
from .cures import LADDER, Cure, Kept, numbers, standard_cures
from .measuring import LEAST, Best, Measured, best_clamp, from_averages, from_images
from .merging import merged
from .shots import Shots, timed_spp, times
from .table import Table

COUNTS = (16, 128, 1024, 8192)
ROUNDS = 32  # independent parts of the reference
FEW = 16  # images of fewer samples than a part has
OWN = 8  # images, at most, of a cure that has samples of its own and does not average them
SHORTER = 4  # cures that average samples of their own get so many times fewer than the reference


class Row(NamedTuple):
    """A cure: ``at`` each number of samples what was ``Measured``, and ``lost``, images of the energy lost there.

    ``averages``: it is a mean of independent samples, so squared errors are bias^2 + variance / N for any N; otherwise
    they come from images of N samples, and are missing where N is too large. ``time``: of sampling and making the
    image, for 1 without any cure, with ``time_stderr``.
    """

    name: str
    averages: bool
    at: dict[int, Measured]
    lost: dict[int, np.ndarray]
    time: float
    time_stderr: float


class Comparison(NamedTuple):
    """All cures beside the unclamped estimator, ``rows[0]``, and the ``best`` clamp for each number of samples.

    ``reference``: luminances, shape (height, width), and ``stderr`` of each; ``relative_error``: of their mean.
    """

    rows: list[Row]
    best: dict[int, Best]
    counts: tuple[int, ...]
    reference: np.ndarray
    stderr: np.ndarray
    relative_error: float
    spp: int

    def __getitem__(self, name) -> Row:
        """Return the row of a cure by its name."""
        return next(row for row in self.rows if row.name == name)

    def table(self) -> Table:
        """Return one line for each cure, as headers and rows of text."""
        return Table.of(self)

    def __str__(self):
        return str(self.table().short())


def compare(
    scene, camera, *, spp=4096, counts=COUNTS, cures=None, white=1.0, bounces=5, key=0, rounds=5, progress=None, **paths
) -> Comparison:
    """Measure what every cure of fireflies does to an image: bias, variance, squared error, energy lost, and time.

    All is of luminance, and against samples of the scene as it is, whose own noise does not count: see ``measuring``.
    Images and reference come from seeds of their own. Memory is that of a few dozen images for each cure.

    Args:
        spp: samples per pixel of the reference, a multiple of 128. Images of N samples are made of it too, so cures
            that do not average are measured for N up to spp / 4.
        counts: the numbers N of samples per pixel: even, 8 or more, and between spp / 32 and spp / 4 a power of two
            times spp / 32.
        cures: a list of ``Cure``; None for ``standard_cures``. The unclamped estimator is put first.
        white: radiance shown as white, for the standard cures.
        rounds: how often each cure is timed, in turn with the others; 0: not at all, and times are NaN.
        progress: as in ``integrate``.
        bounces, paths: as in ``path_integrand``; no ``clamp`` and no ``regularize``, which cures bring.

    Returns:
        A ``Comparison``; ``print`` it, or give it to ``plot.cures``.

    Raises:
        ValueError: numbers that do not fit, two cures of one name, or options that belong to cures.
    """
    counts, spp = _checked(counts, positive("spp", spp), paths)
    paths = {"bounces": bounces, **paths}
    if not 0 <= int(key) < 1 << 47:
        raise ValueError(f"key must be an integer from 0 to 2^47 - 1, got {key!r}")
    cures = list(standard_cures(scene, camera, white=white, key=int(key), **paths) if cures is None else cures)
    none = Cure("none", Moments(luminance, order=2), _plain_mean, averages=True)
    cures = [none, *(c for c in cures if c.name != "none")]
    if len({c.name for c in cures}) < len(cures):
        raise ValueError(f"every cure needs a name of its own, got {[c.name for c in cures]}")
    ladder = ClampLadder(tuple(t * white for t in LADDER), luminance)
    with Progress(progress, _total(cures, counts, spp, rounds, camera)) as bar:
        shots = Shots(scene, camera, paths, (int(key) << 16), bar)
        plain = _plain(shots, [c for c in cures if c.render is render], ladder, counts, spp)
        images, averages = plain.images, plain.averages
        for own in [c for c in cures if c.render is not render]:
            if own.averages:
                averages[own.name] = [_average(own, shots, spp, k) for k in range(ROUNDS)]
            else:
                images[own.name] = {
                    N: _own(own, shots, N, spp, OWN * k) for k, N in enumerate(counts) if _repeats(N, spp) >= LEAST
                }
        timed = times(cures, shots, rounds)
    shape = camera.height, camera.width
    rows = [_row(c, images, averages, plain.means, counts, timed[c.name], shape) for c in cures]
    best = {N: best_clamp(ladder.thresholds, np.array(plain.excess), np.array(plain.spread), N) for N in counts}
    return Comparison(rows, best, counts, *_reference(plain.means, shape), spp)


def _plain_mean(kept):
    return numbers(kept.whole.mean)


def _checked(counts, spp, paths):
    counts = tuple(sorted(positive("counts", N) for N in counts))
    part = spp // ROUNDS
    if spp % (ROUNDS * SHORTER):
        raise ValueError(f"spp must be a multiple of {ROUNDS * SHORTER}, got {spp}")
    # An image of some parts must not share any with the reference of another image.
    odd = [N for N in counts if part < N <= spp // LEAST and (N % part or ROUNDS % (N // part))]
    if not counts or odd or any(N % 2 or N < 8 for N in counts):
        several = ", ".join(str(part << k) for k in (1, 2, 3))
        raise ValueError(
            f"counts must be even numbers from 8 on, of which those from {part} to {spp // LEAST} are multiples by a "
            f"power of two, {several}; got {counts}"
        )
    if wrong := {"clamp", "regularize"} & set(paths):
        raise ValueError(f"{', '.join(wrong)}: the reference has none; make a Cure whose render has it")
    return counts, spp


def _repeats(N, spp):
    """Return how many images of N samples the plain samples make."""
    return FEW if spp // ROUNDS > N else spp // N


def _total(cures, counts, spp, rounds, camera):
    """Return the number of samples that a comparison draws."""
    plain = spp + sum(FEW * N for N in counts if spp // ROUNDS > N)
    own = [c for c in cures if c.render is not render]
    once = sum(N * min(OWN, _repeats(N, spp)) for N in counts if _repeats(N, spp) >= LEAST)
    total = plain + sum(spp // SHORTER if c.averages else once for c in own)
    timed = len({(c.render, c.tally) for c in cures}) * timed_spp(camera) * (rounds + 1 if rounds else 0)
    return (total + timed) * camera.width * camera.height


class _Plain(NamedTuple):
    """What the plain samples give: ``means`` of luminance in each part, ``images`` of each cure by number of samples,
    ``averages`` of others (mean, variance) in each part, and what the ladder of clamps says in each part.
    """

    means: list
    images: dict
    averages: dict
    excess: list
    spread: list


def _plain(shots, cures, ladder, counts, spp) -> _Plain:
    """Render the reference part by part, and make all images of its samples on the way."""
    tallies = list(dict.fromkeys([*(c.tally for c in cures), ladder]))
    place = {c.name: tallies.index(c.tally) for c in cures}
    robust, part = [c for c in cures if not c.averages], spp // ROUNDS
    found = _Plain([], {c.name: defaultdict(list) for c in robust}, defaultdict(list), [], [])

    def halves(n, stream):
        both = [shots(render, n // 2, 2 * stream + k, tallies) for k in range(2)]
        return list(zip(*both, strict=True))

    def add_images(N, results):
        for c in robust:
            image = c.image(Kept(results[place[c.name]], shots.camera.width))
            found.images[c.name][N].append(np.asarray(image).ravel())

    large = {N: [] for N in counts if N >= part and _repeats(N, spp) >= LEAST}
    for k in range(ROUNDS):
        results = halves(part, k)
        for c in cures:
            if c.averages:
                whole = merged(results[place[c.name]])
                found.averages[c.name].append((c.image(Kept((whole,), 0)), numbers(whole.variance).mean()))
        found.means.append(found.averages["none"][-1][0])
        sums = merged(results[tallies.index(ladder)])
        found.excess.append(sums.excess.astype(np.float32))
        found.spread.append(((sums.clamped_square - sums.clamped**2) * (part / (part - 1.0))).mean(1))
        for N, sofar in large.items():
            sofar[:] = [
                tuple(map(_joined, pair, new)) for pair, new in zip(sofar or [(None, None)] * len(results), results)
            ]
            if (k + 1) % (N // part) == 0:
                add_images(N, sofar)
                sofar.clear()
    for place_of_N, N in enumerate(N for N in counts if part > N):
        for r in range(FEW):
            add_images(N, halves(N, ROUNDS + FEW * place_of_N + r))
    return found


def _joined(sofar, new):
    return new if sofar is None else merged([sofar, new])


def _average(cure, shots, spp, part):
    """Return mean and variance of a cure's own samples that belong to a part of the reference, with seeds of it."""
    (result,) = shots(cure.render, spp // (ROUNDS * SHORTER), 2 * part, [cure.tally])
    return cure.image(Kept((result,), shots.camera.width)), numbers(result.variance).mean()


def _own(cure, shots, N, spp, stream):
    """Return independent images of a cure with samples of its own, whose seeds the reference does not have."""
    images = []
    for r in range(min(OWN, _repeats(N, spp))):
        (result,) = shots(cure.render, N, (1 << 14) + stream + r, [cure.tally])
        images.append(np.asarray(cure.image(Kept((result,), shots.camera.width))).ravel())
    return images


def _row(cure, images, averages, means, counts, timed, shape) -> Row:
    means = np.array(means)
    if cure.averages:
        found = averages[cure.name]
        x = np.array([image for image, _ in found])
        at = from_averages(x, means, [variance for _, variance in found], counts)
        lost = dict.fromkeys(counts, (means - x).mean(0).reshape(shape))
        return Row(cure.name, True, at, lost, *timed)
    at, lost = {}, {}
    for N, found in images[cure.name].items():
        # Give each image a reference of its own: the parts, dealt out in order.
        x, r = np.array(found), np.array([part.mean(0) for part in np.array_split(means, len(found))])
        at[N], lost[N] = from_images(x, r, N), (r - x).mean(0).reshape(shape)
    return Row(cure.name, False, at, lost, *timed)


def _reference(means, shape):
    means = np.array(means)
    stderr = means.std(0, ddof=1) / np.sqrt(len(means))
    whole = means.mean(1)
    relative = whole.std(ddof=1) / np.sqrt(len(means)) / whole.mean()
    return means.mean(0).reshape(shape), stderr.reshape(shape), float(relative)
