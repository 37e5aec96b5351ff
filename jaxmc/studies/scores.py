"""What the studies of integrals have in common: exact values of another package, and the score of an estimator."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..integration.driver import integrate
from ..integration.integrand import Integrand
from ..known import collection, maker


def exact_function(name: str) -> Callable:
    """Return a function of the package that comes with ``jaxmc scenes``, such as "furnace_variance" or the maker of a
    scene; raises ``ValueError`` where there is no such package or function.
    """
    scenes = collection()
    if scenes is None:
        raise ValueError("the study needs the exact values of the package analytic_scenes: install jaxmc again")
    return maker(f"{scenes.partition(':')[0]}:{name}")


class Score(NamedTuple):
    """How well an estimator of one integral does. ``exact`` and ``exact_variance`` are None where they are not known.

    ``z`` is (mean - exact) / stderr. ``seconds`` are those of a million samples, compilation left out. ``efficiency``
    is mean^2 / (variance x seconds of one sample): one over the squared relative error after a second.
    """

    strategy: str
    scene: str
    mean: float
    stderr: float
    exact: float | None
    z: float | None
    variance: float
    exact_variance: float | None
    seconds: float
    efficiency: float


HEADERS = [
    "strategy", "scene", "mean", "error", "exact", "z", "variance", "exact variance", "seconds / million", "efficiency",
]  # fmt: skip


def score(f: Integrand, n, key, strategy, scene, exact=None, exact_variance=None, progress=None) -> Score:
    """Return the score of an integrand of one number from ``n`` independent samples, drawn twice: once to compile."""
    integrate(f, n=n, key=key, progress=progress)
    estimate = integrate(f, n=n, key=key, progress=progress)
    mean, stderr, variance = float(estimate.mean), float(estimate.stderr), float(estimate.variance)
    z = None if exact is None else deviation(mean, exact, stderr)
    with np.errstate(all="ignore"):
        efficiency = float(np.float64(mean) ** 2 / (variance * estimate.seconds / n))
    return Score(
        strategy, scene, mean, stderr, exact, z, variance, exact_variance, estimate.seconds / n * 1e6, efficiency
    )


def deviation(mean, exact, stderr) -> float:
    """Return (mean - exact) / stderr; where all samples are equal, rounding of float32 counts as the error."""
    return float((mean - exact) / max(stderr, 1e-6 * abs(exact), 1e-30))


def against(scores: list[Score]) -> list[Any]:
    """Return for each score how many standard errors its mean differs from the first one's; None for the first."""
    first = scores[0]
    return [None, *(deviation(s.mean, first.mean, np.hypot(s.stderr, first.stderr)) for s in scores[1:])]
