"""Is an estimator right? It is run on scenes of known answer, with error bars small enough to be evidence."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jaxmc as mc
from analytic_scenes.names import find
from analytic_scenes.scene import AnalyticScene
from jaxmc.integration.samplers import pilot_key
from jaxmc.testing import ROUNDING, joint_sigmas

PILOT = 1 << 14
MOST_SAMPLES = 1 << 27
ROUNDS = 4  # runs with more and more samples, where the first ones do not tell the variance
RARE = 1 << 20  # samples that are all the same, before they are taken for a constant and not for a rare event
AGREES, WRONG, NO_EVIDENCE, NOT_FINITE, SKIPPED = "agrees", "wrong", "no evidence", "not finite", "skipped"
HEADS = ("scene", "mean", "exact", "rel. error", "rel. stderr", "z", "n", "seconds", "verdict")


class Row(NamedTuple):
    """How an estimator did on one scene; numbers are NaN where the scene was skipped.

    ``z`` is the error in standard errors, NaN for samples that are all the same. ``verdict`` is one of "agrees",
    "wrong", "no evidence", "not finite" and "skipped"; ``reason`` says more where there is more to say.
    """

    scene: str
    mean: float
    exact: float
    stderr: float
    z: float
    n: int
    seconds: float
    verdict: str
    reason: str = ""

    @property
    def relative_error(self) -> float:
        """(mean - exact) / |exact|; NaN where exact is 0."""
        return (self.mean - self.exact) / abs(self.exact) if self.exact else math.nan


class Check(NamedTuple):
    """What ``check`` found: a row for each scene. ``str()`` is a table.

    ``sigmas`` is how many standard errors a mean may be off.
    """

    rows: tuple[Row, ...]
    rel_precision: float
    sigmas: float

    @property
    def passed(self) -> bool:
        """Whether at least one scene was checked, and the estimator agrees with every one that was not skipped."""
        verdicts = {row.verdict for row in self.rows} - {SKIPPED}
        return verdicts == {AGREES}

    def assert_all(self) -> None:
        """Raise ``AssertionError`` with the table of the failures unless ``passed``; a unit test calls it.

        No evidence is a failure too: a test that passes without it could never fail.
        """
        if not self.passed:
            failed = [row for row in self.rows if row.verdict not in (AGREES, SKIPPED)]
            what = f"{len(failed)} of {len(self.rows)} scenes failed" if failed else "no scene was checked"
            raise AssertionError(f"{what}\n{self._replace(rows=tuple(failed))}")

    def __str__(self):
        table = [HEADS, *map(_cells, self.rows)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  ".join([scene.ljust(widths[0]), *(c.rjust(w) for c, w in zip(numbers, widths[1:])), verdict])
            for scene, *numbers, verdict in table
        ]
        found = (self.sigmas + 3.0) * self.rel_precision
        lines.append(f"Means may be {self.sigmas:.2f} standard errors off; an error of {found:.2g} is found in 99.8 %.")
        return "\n".join(lines)


def _cells(row):
    if row.verdict == SKIPPED:
        return (row.scene, *[""] * (len(HEADS) - 2), SKIPPED)
    relative = row.stderr / abs(row.exact) if row.exact else math.nan
    z = "-" if math.isnan(row.z) else f"{row.z:.2f}"
    numbers = f"{row.mean:.6g}", f"{row.exact:.6g}", f"{row.relative_error:.1e}", f"{relative:.1e}", z
    verdict = f"{row.verdict}: {row.reason}" if row.reason else row.verdict
    return (row.scene, *numbers, f"{row.n:,}", f"{row.seconds:.1f}", verdict)


def check(
    factory: Callable[[AnalyticScene], mc.Integrand | None] | Mapping[str, mc.Integrand] | None = None,
    scenes: Sequence[AnalyticScene] | None = None,
    rel_precision: float = 1e-3,
    *,
    key=0,
    most_samples: int = MOST_SAMPLES,
) -> Check:
    """Compare an estimator with the closed form of every scene.

    A pilot on each scene tells how many samples bring the standard error to ``rel_precision`` of the exact value. The
    mean must then lie within a number of standard errors that a right estimator exceeds, on any of the scenes, once in
    two million checks: 5 for one scene, 5.4 for 10, 5.9 for 100 (``jaxmc.testing.joint_sigmas``).

    Power: an estimator that is off on one scene by (that number + 3) ``rel_precision`` or more is found with a
    probability of 99.8 %: an error of 0.85 % at the default, of 0.085 % at 1e-4. A scene is "no evidence" where the
    samples allowed are too few for that, or where the tail is too heavy for an error bar. Samples that are all the
    same may be off by rounding, 1e-5. The variance of ``scene.integrand`` itself is the exact one where it is known.
    That of other integrands is measured, so events that are too rare for the samples taken look like an error.

    Args:
        factory: makes the integrand that is to be checked from an ``AnalyticScene``, or returns None to skip it; by
            default the scene's own. Or such integrands by name or slug, other scenes being skipped.
        scenes: by default ``analytic_scenes.ALL``.
        rel_precision: how small a relative standard error counts as evidence; a smaller one reveals smaller mistakes,
            at a cost of 1 / rel_precision^2.
        key: seed.
        most_samples: for one scene.

    Returns:
        The table of results; call its ``assert_all()`` in a test.

    Raises:
        ValueError: a precision that is not positive, no scenes, unknown names, or a factory that returns anything but
            an ``Integrand`` of one number or None.
    """
    if not rel_precision > 0.0:
        raise ValueError(f"rel_precision must be positive, got {rel_precision!r}")
    if scenes is None:
        from analytic_scenes import ALL as scenes
    scenes = tuple(scenes)
    if not scenes:
        raise ValueError("there are no scenes to check; pass at least one")
    if isinstance(factory, Mapping):
        named = {find(name, scenes).name: integrand for name, integrand in factory.items()}
        integrands = [_checked(named.get(scene.name), scene) for scene in scenes]
    else:
        integrands = [_checked(factory(scene) if factory else scene.integrand, scene) for scene in scenes]
    sigmas = float(joint_sigmas(max(1, sum(f is not None for f in integrands))))
    rows = [_row(s, f, rel_precision, sigmas, key, most_samples) for s, f in zip(scenes, integrands, strict=True)]
    return Check(tuple(rows), rel_precision, sigmas)


def _checked(integrand, scene):
    if integrand is not None and not isinstance(integrand, mc.Integrand):
        raise ValueError(f"expected an mc.Integrand or None for the scene {scene.name!r}, got {integrand!r}")
    return integrand


def _row(scene, integrand, rel_precision, sigmas, key, most):
    if integrand is None:
        return Row(scene.name, math.nan, scene.exact, math.nan, math.nan, 0, 0.0, SKIPPED)
    started = time.perf_counter()
    known = scene.exact_variance if integrand is scene.integrand else None
    estimate = mc.integrate(integrand, n=PILOT, key=pilot_key(key))
    if not isinstance(estimate.mean, float):
        raise ValueError(f"the value must be one number, got {estimate.mean!r} for the scene {scene.name!r}")
    for _ in range(ROUNDS):
        verdict, reason, needed = _judge(scene, estimate, known, rel_precision, sigmas)
        if needed <= estimate.n:
            break
        if needed > most:
            reason = f"{reason}; {needed:.2g} samples are needed, {most:.2g} allowed".removeprefix("; ")
            break
        estimate = mc.integrate(integrand, n=int(needed), key=key)
    stderr = math.sqrt((estimate.variance if known is None else known) / estimate.n)
    z = (estimate.mean - scene.exact) / stderr if stderr * estimate.n**0.5 > ROUNDING * abs(scene.exact) else math.nan
    seconds = time.perf_counter() - started
    return Row(scene.name, estimate.mean, scene.exact, stderr, z, estimate.n, seconds, verdict, reason)


def _judge(scene, estimate, known, rel_precision, sigmas):
    """Return a verdict, its reason, and how many samples it takes to be sure of it."""
    variance, size = estimate.variance if known is None else known, abs(scene.exact)
    stderr, is_constant = math.sqrt(variance / estimate.n), math.sqrt(variance) <= ROUNDING * size
    allowed = ROUNDING * size if is_constant else sigmas * stderr + scene.tolerance * size
    is_off = not abs(estimate.mean - scene.exact) <= allowed
    if estimate.nonfinite:
        return NOT_FINITE, f"{estimate.nonfinite} values", 0
    if known is None and estimate.heavy:
        return NO_EVIDENCE, estimate.status, 16 * estimate.n
    if is_constant:
        return (WRONG, "all samples equal", RARE) if is_off else (AGREES, "", 0)
    if not stderr <= rel_precision * size:
        needed = math.ceil(1.1 * variance / (rel_precision * size) ** 2) if size else math.inf
        return WRONG if is_off else NO_EVIDENCE, "" if size else "relative to 0", needed
    return WRONG if is_off else AGREES, "", 0
