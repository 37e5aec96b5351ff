"""How a strained integrand is measured: its rounding apart from its sampling error.

The same points, with coordinates that float32 holds exactly, are evaluated in float32 and in float64. What differs is
rounding alone; the float64 mean stands beside the exact value with its own error bar.
"""

import importlib.util
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ..integration.integrand import Integrand

SIGMAS = 5.0
BATCH = 1 << 18  # points that are evaluated together


class Case(NamedTuple):
    """One stress: ``make()`` returns the integrand, built in the precision of the moment.

    ``exact`` is its integral, or a function that returns an integrand whose float64 mean stands for that. ``promise``
    is the largest relative error of a float32 mean (of ``unit``, where the integral is 0), and ``x`` the number that
    its ``group`` varies.
    """

    group: str
    name: str
    x: float
    make: Callable[[], Integrand]
    exact: float | Callable[[], Integrand]
    promise: float
    unit: float | None = None


class Measured(NamedTuple):
    """Relative errors: ``rounding`` is (float32 mean - float64 mean) / exact, ``wide`` (float64 mean - exact) / exact,
    each with its standard error. ``nonfinite`` counts float32 values; ``n`` is the number of points.
    """

    rounding: float
    error: float
    wide: float
    wide_error: float
    nonfinite: int
    n: int

    def keeps(self, promise) -> bool:
        """Return whether rounding and the float64 mean lie within 5 standard errors of what is promised of them."""
        sound = abs(self.wide) <= 1e-9 + SIGMAS * self.wide_error
        return bool(sound and self.nonfinite == 0 and abs(self.rounding) <= promise + SIGMAS * self.error)


def common_points(n, dim, seed=0) -> np.ndarray:
    """Return n points, shape (n, dim), with coordinates in [2^-33, 1 - 2^-24] that float32 holds exactly."""
    bits = np.random.default_rng([seed, n, dim]).integers(0, 1 << 32, (n, dim), dtype=np.uint32)
    return np.minimum((bits + 0.5) * 2.0**-32, 1.0 - 2.0**-24).astype(np.float32)


def in_both(make, u) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of ``make()`` at points ``u`` in float32 and in float64, each built in its own precision."""
    values = []
    for wide in (False, True):
        with jax.enable_x64(wide):
            values.append(np.asarray(make().batch(np.asarray(u, np.float64 if wide else np.float32)), np.float64))
    return values[0], values[1]


def measure(case: Case, n=1 << 14, seed=0) -> Measured:
    """Measure a case at n common points."""
    dim, sums, bad, root = case.make().dim, np.zeros(5), 0, math.sqrt(n)
    for first in range(0, n, BATCH):
        u = common_points(min(BATCH, n - first), dim, seed + first)
        narrow, wide = in_both(case.make, u)
        exact = in_both(case.exact, u)[1] if callable(case.exact) else np.full(len(u), case.exact)
        bad += int((~np.isfinite(narrow)).sum())
        sums += [(narrow - wide).sum(), ((narrow - wide) ** 2).sum(), wide.sum(), (wide**2).sum(), exact.sum()]
    difference, squared, mean, square, exact = sums / n
    unit = case.unit or abs(exact)
    spread, wide_spread = (math.sqrt(max(s - m * m, 0.0)) for s, m in ((squared, difference), (square, mean)))
    return Measured(
        difference / unit, spread / unit / root, (mean - exact) / unit, wide_spread / unit / root, bad, n
    )  # fmt: skip


def bias_cases(scenes: str) -> list[Case]:
    """Return a case for each scene of a collection ``module:name``: objects with ``name``, ``integrand`` and ``exact``.

    Each is built in float32 and in float64. Raises ``ValueError`` where there is no such collection.
    """
    narrow, wide = (_collection(scenes, x64) for x64 in (False, True))

    def make(k):
        return lambda: (wide if jax.config.jax_enable_x64 else narrow)[k].integrand

    return [Case("bias", s.name, k, make(k), float(s.exact), 1e-6) for k, s in enumerate(narrow)]


def _collection(name, x64) -> tuple[Any, ...]:
    """Return a fresh copy of a module's collection: its numbers are made in the precision of the moment."""
    package, _, attribute = name.partition(":")
    try:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.loader is None:
            raise ImportError(package)
        module = importlib.util.module_from_spec(spec)
        with jax.enable_x64(x64):
            spec.loader.exec_module(module)
            return tuple(getattr(module, attribute))
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"no scenes {name!r}: name a collection as module:name, as in analytic_scenes:ALL") from error
