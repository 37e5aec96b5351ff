"""The sums that the pixels of a filtered image are made of, added up on the host in float64."""

import numpy as np

from ..integration.moments import MomentsResult
from ..integration.storage import storable


def recentred(sums, step):
    """Return sums about centers that are lower by ``step``, channels on its first axis, in four parts: both of w, and
    each of the others. ``sums`` has the layout of ``FilmSums.total``."""
    c = len(step)
    weight, ww = sums[:1], sums[1:2]
    wd, wwd, wdd = sums[2 : 2 + c], sums[2 + c : 2 + 2 * c], sums[2 + 2 * c :]
    return sums[:2], wd + step * weight, wwd + step * ww, wdd + step * (2.0 * wwd + step * ww)


@storable
class FilmSums:
    """The sums of every pixel in float64, about a center of its own.

    ``total`` has shape (2 + 3 channels, pixels): the sum of w, its variance, then by channels the sums of w d, where d
    is L less the center, their covariances with the sum of w, and their variances.
    """

    def __init__(self, width, reach, channels, items):
        self.width, self.reach, self.channels = width, reach, channels
        self.total, self.center = np.zeros((2 + 3 * channels, items)), np.zeros((channels, items))
        self.n, self.touched, self.nonfinite = np.zeros(items), np.zeros(items, bool), 0

    @property
    def shape(self):
        """The shape of the mean."""
        return self.center.shape[::-1]

    def empty(self):
        """Return sums of the same image without samples."""
        return FilmSums(self.width, self.reach, *self.center.shape)

    def clear(self):
        self.total[...], self.n[...], self.nonfinite = 0.0, 0.0, 0

    def add(self, record):
        """Add the records of blocks, in their order."""
        items = len(self.n)
        powers = np.repeat([0, 1, 1, 2], [2, *[self.channels] * 3])
        for block, first in enumerate(record["first"].tolist()):
            count = record["count"][block][: items - first]
            self.n[first : first + len(count)] += count
            scale = np.float64(record["scale"][block]) ** powers
            for row, sums in enumerate(record["sums"][block]):
                start = first - self.reach + (row - self.reach) * self.width
                stop = start + sums.shape[1]
                inside = slice(max(0, -start), max(0, min(stop, items) - start))
                where = slice(max(0, start), max(0, min(stop, items)))
                center = record["center"][block][:, inside].astype(np.float64)
                self._accumulate(where, center, sums[:, inside] * scale[:, None])
        self.nonfinite += int(record["nonfinite"].sum())

    def merge(self, other):
        self._accumulate(slice(None), other.center, other.total)
        self.n, self.nonfinite = self.n + other.n, self.nonfinite + other.nonfinite

    @np.errstate(all="ignore")
    def _accumulate(self, where, center, sums):
        touched = self.touched[where]
        if not touched.all():
            # Leave alone what these sums do not reach: a constant keeps its own center, and so no error.
            new = ~touched & (sums != 0.0).any(0)
            self.center[:, where] = np.where(new, center, self.center[:, where])
            self.touched[where] |= new
        start = 0
        for part in recentred(sums, center - self.center[:, where]):
            self.total[start : start + len(part), where] += part
            start += len(part)

    @np.errstate(all="ignore")
    def moments(self) -> MomentsResult:
        """Return the mean of every pixel, shape (pixels, channels), and n times the square of its error as variance."""
        weight = self.total[0]
        shift = self.total[2 : 2 + self.channels] / weight
        variance = recentred(self.total, -shift)[-1]
        error = np.maximum(variance, 0.0) / weight**2
        n = np.broadcast_to(self.n, shift.shape)
        return MomentsResult(n.T, (self.center + shift).T, [(error * (n - 1.0)).T], self.nonfinite)
