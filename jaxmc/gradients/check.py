"""Whether a gradient is biased: automatic differentiation against differences with common random numbers."""

import dataclasses
import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from .derivative import as_params
from .differences import from_batches, from_integrand, scales_of

STEPS = (0.1, 0.03, 0.01, 0.003)  # relative to the scale of each parameter
POWER = 0.8  # with which a bias as large as the minimum detectable one is found
JUMPS = -0.5  # slope of the variance of differences in the step, below which something jumps: -1, against 0 if smooth
TO_THE_NEXT = 2.0  # standard errors by which two differences may be apart and count as the same


class Finding(NamedTuple):
    """What is found of the derivative along one direction.

    Attributes:
        name: the parameter.
        verdict: "biased", "consistent" (a bias is smaller than ``detectable``), "inconclusive" (``detectable`` is too
            large to say so) or "not finite".
        gradient: the derivative under test.
        difference: the central difference quotient.
        bias, error: gradient less difference, and the standard error of that.
        p: probability of a bias at least as large in a sound gradient.
        detectable: the bias that would have been found with a probability of 80 %.
        slope: of log variance of the quotient in log step: near 0 if smooth, -1 where a jump moves.
        kurtosis: of one sample of the gradient, or of one batch; 3 for a normal law.
        step: half the distance of the difference.
        cause: what a bias suggests; empty where there is none.
    """

    name: str
    verdict: str
    gradient: float
    difference: float
    bias: float
    error: float
    p: float
    detectable: float
    slope: float
    kurtosis: float
    step: float
    cause: str

    @property
    def jumps(self) -> bool:
        """Whether a discontinuity moves with the parameter."""
        return self.slope < JUMPS

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return a confidence interval of the bias."""
        half = float(stats.norm.ppf((1.0 + level) / 2.0)) * self.error
        return self.bias - half, self.bias + half


@dataclasses.dataclass(frozen=True)
class GradCheck:
    """The findings for all directions; ``flags`` as in ``Gradient``."""

    findings: tuple[Finding, ...]
    flags: tuple[str, ...] = ()

    def __getitem__(self, name) -> Finding:
        """Return the finding for a parameter by its name, such as ``"['center'][0]"``, or its number."""
        if not isinstance(name, str):
            return self.findings[name]
        found = [f for f in self.findings if f.name == name]
        if not found:
            raise KeyError(f"{name!r} is none of {', '.join(f.name for f in self.findings)}")
        return found[0]

    @property
    def verdict(self) -> str:
        """The worst verdict."""
        order = ("not finite", "biased", "inconclusive", "consistent")
        return min((f.verdict for f in self.findings), key=order.index)

    def __str__(self):
        width = max(9, *(len(f.name) for f in self.findings))
        words = f"{'gradient':>12s} {'difference':>12s} {'bias':>11s} {'error':>9s} {'p':>8s} {'detectable':>10s}"
        lines = [f"{'parameter':{width}s} {words} {'slope':>6s} {'kurtosis':>8s}  verdict"]
        for f in self.findings:
            lines.append(
                f"{f.name:{width}s} {f.gradient:12.5g} {f.difference:12.5g} {f.bias:11.3g} {f.error:9.2g} "
                f"{f.p:8.1g} {f.detectable:10.2g} {f.slope:6.2f} {f.kurtosis:8.3g}  {f.verdict}"
                + (f": {f.cause}" if f.cause else "")
            )
        return "\n".join([*lines, *(f"not covered: {flag}" for flag in self.flags)])


def gradcheck(
    f: Callable, params, *, gradient: Callable | None = None, n=1 << 16, key=0, batches=64, scale=None, steps=STEPS,
    tolerance=0.02, alpha=1e-3, boundary_n=None, **options,
) -> GradCheck:  # fmt: skip
    """Test a gradient for bias against central differences with common random numbers, and say with what power.

    Differences of the value see jumps that automatic differentiation of an integrand does not. For every number in
    ``params`` they are taken with several steps, from the same samples as the gradient. The largest step is used whose
    difference does not tell itself from the next smaller one; of these two, the smaller. If even the smallest two
    differ, what the last one has left of curvature is not held against the gradient. Holm's method keeps the
    probability of any false alarm below ``alpha``.

    Args:
        f: as ``make_integrand`` of ``grad_integrate``, with an integrand of one number; its gradient is that of
            ``grad_integrate``: interior, and boundary where it has one. Or, with ``gradient``, any function
            ``f(params, key, n)`` that returns a number, of JAX or not: for the same key its random numbers must be
            the same. It must be linear in its samples, such as a mean.
        params: as in ``grad_integrate``.
        gradient: ``gradient(params, key, n)``, a pytree like ``params``, for such a function ``f``.
        n: samples: in all, or with ``gradient`` of each batch.
        key: seed.
        batches: calls of ``f`` and ``gradient`` at each point.
        scale: length to which ``steps`` are relative, a number or a pytree like ``params``; by default the largest
            size in each leaf, 1 where that is 0.
        steps: relative steps, falling.
        tolerance: the largest detectable bias with which a gradient counts as consistent, relative to the norm of the
            whole gradient, each component times its scale.
        alpha: probability of calling a sound gradient biased.
        boundary_n: samples of the boundary part; ``n`` by default.
        options: as in ``integrate``.

    Raises:
        ValueError: an argument out of range, or a value that is not one number.
    """
    params = as_params(params)
    steps = tuple(float(s) for s in steps)
    if len(steps) < 2 or not all(a > b > 0.0 for a, b in itertools.pairwise(steps)):
        raise ValueError(f"steps must be at least two positive numbers that fall, got {steps!r}")
    scales = scales_of(params, scale)
    if gradient is None:
        data, flags = from_integrand(f, params, scales, steps, n, boundary_n, key, options)
    else:
        data, flags = from_batches(f, gradient, params, scales, steps, n, batches, key), ()
    names = [jax.tree_util.keystr(path) or "params" for path, leaf in jax.tree_util.tree_leaves_with_path(params)
             for _ in range(leaf.size)]  # fmt: skip
    places = [f"[{i}]" if leaf.ndim else "" for leaf in jax.tree.leaves(params) for i in range(leaf.size)]
    names = [name + place for name, place in zip(names, places)]
    return GradCheck(_judge(names, data, scales, np.asarray(steps), tolerance, alpha), flags)


def _judge(names, data, scales, steps, tolerance, alpha):
    count = len(names)
    rows = [_weigh(j, data, scales[j], steps) for j in range(count)]
    chosen, allowance, error, bias, slope = (np.array(column) for column in zip(*rows))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.maximum(np.abs(bias) - allowance, 0.0) / error
    t = np.where(np.isnan(t), 0.0, t)
    p = 2.0 * stats.t.sf(t, data.freedom)
    # Holm: the smallest p against alpha / count, the next against alpha / (count - 1), until one passes.
    ranks = np.argsort(np.argsort(p, kind="stable"))
    passes = np.sort(p) > alpha / (count - np.arange(count))
    biased = ranks < (np.argmax(passes) if passes.any() else count)
    sigmas = stats.t.ppf([1.0 - alpha / (2.0 * count), POWER], data.freedom).sum()
    detectable = sigmas * error + allowance
    quotient = data.quotient[np.arange(count), chosen]
    finite = np.isfinite(data.gradient) & np.isfinite(quotient)
    norm = np.sqrt(np.sum((np.where(finite, quotient, 0.0) * scales) ** 2))
    findings = []
    for j, name in enumerate(names):
        small = detectable[j] * scales[j] <= tolerance * norm
        verdict = "biased" if biased[j] else "consistent" if small else "inconclusive"
        verdict = verdict if finite[j] else "not finite"
        numbers = data.gradient[j], quotient[j], bias[j], error[j], p[j], detectable[j], slope[j], data.kurtosis[j]
        step = steps[chosen[j]] * scales[j]
        cause = _cause(verdict, data.gradient[j], slope[j])
        findings.append(Finding(name, verdict, *map(float, numbers), float(step), cause))
    return tuple(findings)


def _weigh(j, data, scale, steps):
    """Return the step to use for one direction, what its difference may be off by, error, bias and slope."""
    last = len(steps) - 1
    same = np.abs(data.change[j]) < TO_THE_NEXT * data.change_error[j]
    k = int(np.argmax(same)) + 1 if same.any() else last
    # The difference of the last two steps tells what curvature has left in the smaller one.
    curvature = 0.0 if same.any() else abs(data.change[j, -1]) / ((steps[last - 1] / steps[last]) ** 2 - 1.0)
    eps = float(jnp.finfo(jnp.result_type(float)).eps)
    rounding = 2.0 * eps / steps[k] * (abs(data.quotient[j, k]) + data.value / scale)
    variance = data.variance[j]
    slope = np.polyfit(np.log(steps), np.log(variance), 1)[0] if np.all(variance > 0.0) else 0.0
    return k, curvature + rounding, data.bias_error[j, k], data.bias[j, k], slope


def _cause(verdict, gradient, slope):
    if verdict == "not finite":
        return "a value or derivative is infinite or NaN"
    if verdict != "biased":
        return ""
    if slope < JUMPS:
        zero = "the gradient is 0, but " if gradient == 0.0 else ""
        return f"{zero}a discontinuity moves with it, such as visibility: its boundary term is missing or wrong"
    return "nothing jumps: a smooth dependence is left out or counted twice"
