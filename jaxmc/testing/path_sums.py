"""The sum that a path collects over all its lengths where every surface emits 1: S = 1 + w S', its tail a power law.

Directions are uniform on the hemisphere, so a weight w is 2 rho U with U uniform: the furnace whose albedo decides how
many moments the estimator has. It is the ground truth for whatever claims to see how heavy a tail is.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from .laws import _library, _solve_threshold

NEGLIGIBLE = 1e-9  # of the mean: what a sampled path of an endless sum leaves out
NODES = 24  # of a polynomial on each piece of the density
# From here on, or where so little is left that rounding shows, the tail is taken for the power law that it tends to.
FARTHEST, LEAST = 1e7, 1e-13


class PathSum(NamedTuple):
    """Light of a path of at most ``depth`` events (``math.inf`` is allowed) between surfaces of albedo 0 < ``rho``.

    With ``other``, events take turns between albedo ``rho``, first, and ``other``. At each the path is lost with
    probability ``escape``. Moments are inf where they diverge. Without end, ``sample`` follows paths until what is left
    out is below 1e-9 of the mean. Only without end, and without ``other`` and ``escape``, are ``exceedance``,
    ``clamp_bias``, ``clamped_square`` and ``optimal_threshold`` known, to some 1e-14, 1e-14 t and 1e-14 t^2.
    """

    rho: float
    depth: float = math.inf
    other: float | None = None
    escape: float = 0.0

    @property
    def albedos(self) -> tuple[float, float]:
        return self.rho, self.rho if self.other is None else self.other

    @property
    def dim(self) -> int:
        if self.depth != math.inf:
            return max(1, int(self.depth))
        step = 0.5 * math.log(self.weight_moment(0, 1) * self.weight_moment(1, 1))
        if step >= 0.0:
            raise ValueError(f"expected albedos whose product is below 1, got {self.albedos}: paths do not fade")
        return max(1, math.ceil(math.log(NEGLIGIBLE) / step))

    def sample(self, u):
        total, beta = 1.0, 1.0
        for k in range(self.dim if self.depth > 0 else 0):
            beta = beta * self._weight(self.albedos[k % 2], u[k])
            total = total + beta
        return total if self.depth > 0 else 1.0 + 0.0 * u[0]

    def _weight(self, rho, u):
        if self.escape == 0.0:
            return 2.0 * rho * u
        cosine = (u - self.escape) / (1.0 - self.escape)
        return 2.0 * rho * _library(u).maximum(cosine, 0.0)

    def weight_moment(self, surface: int, q: float) -> float:
        """Return E w^q = (1 - escape) (2 rho)^q / (q + 1) at the first (0) or the other (1) surface, for q > 0."""
        return (1.0 - self.escape) * (2.0 * self.albedos[surface]) ** q / (q + 1.0)

    def moment(self, q: int) -> float:
        """Return E S^q for a whole q >= 1, by E S^q = sum_j binomial(q, j) E w^j E S'^j."""
        return self._moments(q)[0][q]

    def _moments(self, most):
        """Return E S^0 .. E S^most of paths that start at either surface."""
        if self.depth != math.inf:
            moments = [[1.0] * (most + 1)] * 2
            for _ in range(int(self.depth)):
                moments = [[self._expand(s, q, q, moments) for q in range(most + 1)] for s in (0, 1)]
            return moments
        moments = [[1.0], [1.0]]
        for q in range(1, most + 1):
            first, second = (self._expand(s, q, q - 1, moments) for s in (0, 1))
            w0, w1 = self.weight_moment(0, q), self.weight_moment(1, q)
            finite = w0 * w1 < 1.0
            moments[0].append((first + w0 * second) / (1.0 - w0 * w1) if finite else math.inf)
            moments[1].append((second + w1 * first) / (1.0 - w0 * w1) if finite else math.inf)
        return moments

    def _expand(self, surface, q, most, moments):
        following = moments[1 - surface]
        return 1.0 + sum(math.comb(q, j) * self.weight_moment(surface, j) * following[j] for j in range(1, most + 1))

    @property
    def mean(self) -> float:
        return self.moment(1)

    @property
    def variance(self) -> float:
        return self.moment(2) - self.mean**2 if math.isfinite(self.moment(2)) else math.inf

    @property
    def tail_index(self) -> float:
        """kappa of the tail P(S > x) ~ C x^-kappa of endless paths: moments of order kappa and above diverge.

        E w^kappa E w'^kappa = 1, so kappa = -1 - W_-1(-a b e^-a) / a with a = ln(2 sqrt(rho other)) and b = 1 - escape.
        inf where no pair of weights exceeds 1, and for a finite depth. Source: Kesten, Random difference equations and
        renewal theory for products of random matrices (1973); Goldie, Implicit renewal theory (1991).
        """
        a = math.log(2.0) + 0.5 * math.log(self.albedos[0] * self.albedos[1])
        if self.depth != math.inf or a <= 0.0:
            return math.inf
        return -1.0 - float(special.lambertw(-a * (1.0 - self.escape) * math.exp(-a), -1).real) / a

    @property
    def tail_constant(self) -> float:
        """C of the tail P(S > x) ~ C x^-kappa, where kappa is a whole number, for one albedo.

        C = E[(1 + w S)^kappa - (w S)^kappa] / (kappa E[w^kappa ln w]) (Goldie), and E[w^kappa ln w] is
        ln(2 rho) - 1 / (kappa + 1): moments below kappa are enough. Raises ValueError for another kappa or two albedos.
        """
        kappa = round(self.tail_index) if math.isfinite(self.tail_index) else 0
        if self.other is not None or kappa < 1 or abs(self.tail_index - kappa) > 1e-6:
            raise ValueError(f"the tail constant is known for one albedo and a whole kappa, not for {self}")
        moments = self._moments(kappa - 1)[0]
        head = sum(math.comb(kappa, j) * self.weight_moment(0, j) * moments[j] for j in range(1, kappa))
        return (1.0 + head) / (kappa * (math.log(2.0 * self.rho) - 1.0 / (kappa + 1.0)))

    def exceedance(self, t):
        t = np.asarray(t, np.float64)
        return np.where(t < 1.0, 1.0, self._law().above(np.maximum(t - 1.0, 0.0), 0))[()]

    def clamp_bias(self, t):
        t = np.asarray(t, np.float64)
        return np.maximum(self.mean - np.minimum(t, 1.0) - self._law().above(np.maximum(t - 1.0, 0.0), 1), 0.0)[()]

    def clamped_square(self, t):
        t = np.asarray(t, np.float64)
        return (np.minimum(t, 1.0) ** 2 + 2.0 * self._law().above(np.maximum(t - 1.0, 0.0), 2))[()]

    def optimal_threshold(self, N: int) -> float:
        return _solve_threshold(self, N)

    def _law(self):
        if self.depth != math.inf or self.other is not None or self.escape or not 0.0 < self.rho < 1.0:
            raise ValueError(
                f"the law is known for endless paths of one albedo below 1 that none escapes, not of {self}"
            )
        return _law_of_rest(self.rho, self.tail_index)


class _LawOfRest(NamedTuple):
    """The law of Y = S - 1: on each piece the integrals from its start, as Chebyshev series of the place in it."""

    starts: np.ndarray  # (pieces + 1,)
    before: np.ndarray  # (3, pieces + 1): P(Y > y), its integral from 0 and that of (1 + y) P(Y > y), at the starts
    series: np.ndarray  # (3, pieces, terms): what is added to them within the piece
    kappa: float

    def above(self, y, order):
        """Return P(Y > y) for order 0, its integral from 0 to y for 1, and that of (1 + y) P(Y > y) for 2."""
        piece = np.clip(np.searchsorted(self.starts, y, side="right") - 1, 0, len(self.starts) - 2)
        start, stop = self.starts[piece], self.starts[piece + 1]
        place = np.minimum(2.0 * (y - start) / (stop - start) - 1.0, 1.0)
        inside = chebyshev.chebval(place, np.moveaxis(self.series[order][piece], -1, 0), tensor=False)
        value = self.before[order][piece] + inside
        end, tail = self.starts[-1], self.before[0, -1]
        x = np.maximum(y / end, 1.0)
        if order == 0:
            return np.maximum(np.where(y > end, tail * x**-self.kappa, value), 0.0)
        power = order - self.kappa
        beyond = np.log(x) if power == 0.0 else (x**power - 1.0) / power
        return np.where(y > end, self.before[order, -1] + tail * end**order * beyond, value)


@functools.lru_cache(maxsize=64)
def _law_of_rest(rho, kappa):
    """Return the law of Y = 2 rho U (1 + Y').

    Given Y', Y is uniform up to a (1 + Y') with a = 2 rho, so its density f(y) is E[1 / (a (1 + Y')); a (1 + Y') > y]:
    constant up to a, and f'(y) = -f(y/a - 1) / (a y) beyond, a delay equation. The delay maps the pieces between
    0, a, a + a^2, ... linearly onto each other, so the density on each is an integral over the one before.
    """
    a = 2.0 * rho
    place = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    to_series = np.linalg.inv(chebyshev.chebvander(place, NODES - 1))
    starts, density = [0.0, a], [to_series @ np.ones(NODES)]
    while starts[-1] < FARTHEST and starts[-1] * chebyshev.chebval(1.0, density[-1]) > LEAST:
        start, stop = starts[-1], a * (1.0 + starts[-1])
        y = start + 0.5 * (stop - start) * (1.0 + place)
        slope = chebyshev.chebval(place, density[-1]) / (a * y)
        fall = 0.5 * (stop - start) * chebyshev.chebint(to_series @ slope, lbnd=-1)
        density.append(to_series @ (chebyshev.chebval(1.0, density[-1]) - chebyshev.chebval(place, fall)))
        starts.append(stop)
    starts, half = np.array(starts), 0.5 * np.diff(starts)
    mass = np.array([h * chebyshev.chebint(f, lbnd=-1) for h, f in zip(half, density)])
    # Beyond the last piece P(Y > y) = y f(y) / kappa.
    beyond = starts[-1] * max(chebyshev.chebval(1.0, density[-1]), 0.0) / kappa
    ends = chebyshev.chebval(1.0, mass.T)
    total = ends.sum() + beyond
    above = np.append(np.cumsum(np.append(ends, beyond)[::-1])[::-1] / total, 0.0)[: len(starts)]
    series = [-mass / total]
    before = [above]
    for order in (1, 2):
        pieces = []
        for i, h in enumerate(half):
            y = starts[i] + h * (1.0 + place)
            value = above[i] + chebyshev.chebval(place, series[0][i])
            pieces.append(h * chebyshev.chebint(to_series @ (value * (1.0 + y) if order == 2 else value), lbnd=-1))
        series.append(np.array(pieces))
        before.append(np.concatenate([[0.0], np.cumsum(chebyshev.chebval(1.0, series[-1].T))]))
    return _LawOfRest(starts, np.array(before), np.array(series), kappa)
