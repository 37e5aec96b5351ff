"""Do intervals cover the truth as often as they say? Error bars calibrated on integrals that are known exactly.

One estimate cannot tell whether its error bar is right; many independent ones of a known integral can. Sources: the
share of intervals that cover is a binomial proportion (Clopper & Pearson, Biometrika 26, 1934).
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from tqdm import tqdm

from ..integration.counts import positive
from ..integration.estimate import Estimate
from .tails import clopper_pearson

LEVELS = (0.5, 0.9, 0.95, 0.99)
ALARM = 1e-3  # probability that intervals which are right are judged wrong, over all levels of a method together
REFUSED = 0.5  # share of refused estimates above which the others are no fair sample


@dataclasses.dataclass(frozen=True, eq=False)
class Coverage:
    """What R independent estimates of a known integral claimed, and what was true.

    An estimate that refuses (tail too heavy, values that are not finite, no error bar) makes no claim: it counts
    neither as covering nor as missing. All else is about the C estimates that do claim.

    Attributes:
        exact: the integral.
        levels: L nominal probabilities.
        methods: names of M kinds of intervals.
        hits: shape (M, L), how many claims cover.
        refusals: how many estimates were refused, by the reason that they give.
        means, stderrs: shape (C,).
        dof: degrees of freedom of Student's law of (mean - exact) / stderr; infinite for the normal law.
        n: median number of samples of all R estimates.
        seconds: median wall time of one estimate.
    """

    exact: float
    levels: tuple[float, ...]
    methods: tuple[str, ...]
    hits: np.ndarray
    refusals: dict[str, int]
    means: np.ndarray
    stderrs: np.ndarray
    dof: float
    n: float
    seconds: float

    @property
    def claims(self) -> int:
        """How many estimates make a claim."""
        return self.means.size

    @property
    def replicates(self) -> int:
        """How many estimates there are in all."""
        return self.claims + sum(self.refusals.values())

    @property
    def refused(self) -> dict[str, float]:
        """Share of refused estimates by reason."""
        return {reason: count / self.replicates for reason, count in self.refusals.items()}

    @property
    def covered(self) -> np.ndarray:
        """Share of claims that cover, shape (M, L); NaN where there are none."""
        return self.hits / self.claims if self.claims else np.full(self.hits.shape, np.nan)

    def band(self, level: float = 0.95):
        """Return the Clopper-Pearson interval (lower, upper) of ``covered``, shape (M, L) each."""
        if not self.claims:
            return np.zeros(self.hits.shape), np.ones(self.hits.shape)
        return clopper_pearson(self.hits, self.claims, level)

    @property
    def z(self) -> np.ndarray:
        """(mean - exact) / stderr, shape (C,); infinite where an error of 0 is claimed, NaN where that is true."""
        with np.errstate(all="ignore"):
            return (self.means - self.exact) / self.stderrs

    @property
    def ratio(self) -> tuple[float, float]:
        """Claimed over actual error, sqrt(mean stderr^2) / RMSE, and its standard error (delta method)."""
        claimed, actual = self.stderrs**2, (self.means - self.exact) ** 2
        if self.claims < 2 or not (claimed.any() and actual.any()):
            return math.nan, math.nan
        ratio = math.sqrt(claimed.mean() / actual.mean())
        spread = np.std(claimed / claimed.mean() - actual / actual.mean(), ddof=1)
        return ratio, float(0.5 * ratio * spread / math.sqrt(self.claims))

    @property
    def bias(self) -> tuple[float, float]:
        """Mean error of the claims, in standard deviations of one, and its standard error. It shows what refusing does:
        an unbiased estimator is biased where it is believed only if it has missed the large samples."""
        spread = np.std(self.means, ddof=1) if self.claims > 1 else 0.0
        if spread == 0.0:
            return math.nan, math.nan
        return float((self.means.mean() - self.exact) / spread), 1.0 / math.sqrt(self.claims)

    def status(self, method: int = 0) -> str:
        """Return ``"holds"``, ``"too short"``, ``"too long"`` or ``"refuses"`` for one of the methods.

        Intervals are too short where they cover less than their level, whatever they do at others, and they refuse
        where that is what more than half of the estimates do. Right ones are found wrong once in 1000 times.
        """
        if self.claims < (1.0 - REFUSED) * self.replicates:
            return "refuses"
        lower, upper = (ends[method] for ends in self.band(1.0 - ALARM / len(self.levels)))
        if np.any(upper < self.levels):
            return "too short"
        return "too long" if np.any(lower > self.levels) else "holds"

    def explain(self, method: int = 0) -> str:
        """Say the verdict on one of the methods in a sentence, with what it rests on."""
        status = self.status(method)
        reasons = ", ".join(f"{reason}: {count}" for reason, count in self.refusals.items())
        level = self._worst(method, status)
        lower, upper = (ends[method][level] for ends in self.band())
        found = f"{self.hits[method][level]} of {self.claims} cover at {self.levels[level]:g}"
        if status == "refuses":
            found = f"{found} among those that claim" if self.claims else "none claims anything"
            return f"refuses: {sum(self.refusals.values())} of {self.replicates} estimates ({reasons}); {found}"
        return f"{status}: {found}, that is {lower:.3f} to {upper:.3f}" + (f"; refused {reasons}" if reasons else "")

    @property
    def verdict(self) -> str:
        """The sentence on the first method."""
        return self.explain()

    def _worst(self, method, status):
        """Return the level that shows the verdict best: that of 0.95 unless another is further off."""
        if status in ("holds", "refuses"):
            return int(np.argmin(np.abs(np.subtract(self.levels, 0.95))))
        expected = np.multiply(self.claims, self.levels)
        off = (self.hits[method] - expected) / np.sqrt(expected * (1.0 - np.array(self.levels)))
        return int(np.argmin(off) if status == "too short" else np.argmax(off))

    def rows(self) -> list[tuple]:
        """Return (method, level, covered, lower, upper of its 95% band) for every method and level."""
        lower, upper = self.band()
        return [
            (method, level, float(self.covered[i, j]), float(lower[i, j]), float(upper[i, j]))
            for i, method in enumerate(self.methods)
            for j, level in enumerate(self.levels)
        ]

    def __str__(self):
        ratio, bias = ("{:.3f} +- {:.3f}".format(*pair) for pair in (self.ratio, self.bias))
        refused = ", ".join(f"{reason} {share:.1%}" for reason, share in self.refused.items()) or "none"
        lines = [f"{self.replicates} estimates of {self.exact:.7g}, n = {self.n:,.0f}, {self.seconds:.2g} s each"]
        lines += [f"{'interval':26} level  covered  95% band"]
        lines += [f"{m:26} {a:<5g}  {c:7.3f}  {low:.3f} to {up:.3f}" for m, a, c, low, up in self.rows()]
        lines += [f"claimed / actual error {ratio}   bias {bias} standard deviations   refused {refused}"]
        verdicts = [self.explain(i) for i in range(len(self.methods))]
        many = len(verdicts) > 1
        return "\n".join(lines + [f"{m}: {v}" if many else v for m, v in zip(self.methods, verdicts, strict=True)])


def coverage(
    run: Callable[[int], Estimate], exact: float, *, replicates: int = 2000, levels: Sequence[float] = LEVELS,
    methods: Sequence = (None,), progress=None,
) -> Coverage:  # fmt: skip
    """Return how often the intervals of ``run(0)``, ``run(1)``, ... cover ``exact``.

    Args:
        run: makes an independent estimate of one number from each key, such as
            ``lambda key: mc.integrate(f, n=4096, sampler=mc.Sobol(), key=key)``.
        exact: the integral.
        replicates: number of estimates. With 2000 a share of 0.95 is known to about 0.01, with 400 to 0.02.
        levels: between 0 and 1.
        methods: what ``Estimate.interval`` knows by name, None for its default, or a function of an estimate and a
            level that returns two ends.
        progress: True for a progress bar, a word for one with that title, or a function of (runs done, replicates).

    Raises:
        ValueError: ``exact`` is no finite number, ``replicates`` no positive integer, a level lies outside (0, 1),
            levels or methods are missing, or ``run`` returns anything but an estimate of one number.
    """
    levels, methods = tuple(levels), tuple(methods)
    _check(exact, replicates, levels, methods)
    hits = np.zeros((len(methods), len(levels)), int)
    means, stderrs, refusals, costs, names, dof = [], [], Counter(), [], [], math.inf
    for key in _counted(replicates, progress):
        estimate = _checked(run(key))
        costs.append((estimate.n, estimate.seconds))
        ends = [[_ends(estimate, level, method) for level in levels] for method in methods]
        names = [_name(method, row[0]) for method, row in zip(methods, ends, strict=True)]
        if reason := refusal(estimate):
            refusals[reason] += 1
            continue
        dof = math.inf if estimate.between is None else estimate.recipe["replicates"] - 1
        means.append(estimate.mean)
        stderrs.append(estimate.stderr)
        hits += np.array([[lower <= exact <= upper for lower, upper in row] for row in ends])
    n, seconds = np.median(costs, axis=0)
    return Coverage(
        float(exact), levels, tuple(names), hits, dict(refusals), np.array(means), np.array(stderrs), dof,
        float(n), float(seconds),
    )  # fmt: skip


def refusal(estimate: Estimate) -> str | None:
    """Return why an estimate makes no claim about its error, or None if it makes one."""
    if estimate.nonfinite or estimate.heavy:
        return estimate.status
    return None if np.isfinite(estimate.stderr) else "no error bar"


def _ends(estimate, level, method):
    return method(estimate, level) if callable(method) else estimate.interval(level, method)


def _name(method, interval):
    return getattr(method, "__name__", "a function") if callable(method) else interval.method


def _counted(replicates, progress):
    """Yield the keys, and show or tell how many are done."""
    shown = progress is not None and progress is not False and not callable(progress)
    title = progress if isinstance(progress, str) else None
    with tqdm(total=replicates, desc=title, unit=" runs", disable=not shown) as bar:
        for key in range(replicates):
            yield key
            bar.update()
            if callable(progress):
                progress(key + 1, replicates)


def _checked(estimate):
    if not isinstance(estimate, Estimate):
        raise ValueError(f"run(key) must return an Estimate, got {estimate!r}: return that of mc.integrate")
    if not isinstance(estimate.mean, float):
        shown = f"run(key) must estimate one number, got {estimate}"
        raise ValueError(f"{shown}: choose one component, such as with Integrand.map(lambda value: value[0])")
    return estimate


def _check(exact, replicates, levels, methods):
    if np.ndim(exact) != 0 or not np.isfinite(exact):
        raise ValueError(f"exact must be one finite number, got {exact!r}: pass the closed form of the integral")
    positive("replicates", replicates, cure="400 know 0.95 to 0.02")
    if not levels or not all(0.0 < level < 1.0 for level in levels):
        raise ValueError(f"levels must lie between 0 and 1, got {levels}: write 0.95 for 95 %")
    if not methods:
        raise ValueError("methods is empty: pass (None,) for the interval that an estimate gives by default")
