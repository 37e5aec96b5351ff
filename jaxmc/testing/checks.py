"""Checks of estimates: against truth, and against each other."""

import jax
import numpy as np
from scipy import stats

from ..integration.estimate import heavy_tail
from ..integration.moments import MomentsResult

SIGMAS = 5.0  # a sound estimate is farther off once in two million checks
ROUNDING = 1e-5  # relative: what float32 may do to values that should all be the same


def joint_sigmas(count: int, freedom=np.inf):
    """Return how many standard errors each of ``count`` values may be off if all of them are to pass together.

    One normal value may be off by 5. The same probability, 6e-7, is divided equally among ``count`` values by
    Bonferroni's inequality, so they may depend on each other in any way: 5.4 standard errors for 10 values, 6.9 for
    100,000. Holm's steps would reject the same sets of values; they only name more of the values in a rejected set.

    Args:
        count: number of values.
        freedom: degrees of freedom of the variances that the standard errors come from, a number or an array; then the
            values follow Student's law. Infinite where they are known well.
    """
    share = stats.norm.sf(SIGMAS) / count
    freedom = np.asarray(freedom, np.float64)
    with np.errstate(invalid="ignore"):
        # Beyond 1e9 Student's law is the normal one to rounding, and SciPy slow.
        student = stats.t.isf(share, np.minimum(freedom, 1e9))
    return np.where(freedom > 1e9, stats.norm.isf(share), student)[()]


def assert_unbiased(estimate, exact, rel_precision, *, variance=None) -> None:
    """Check that an ``Estimate`` agrees with its true value, and that it could have disagreed.

    Passes where every component has a standard error of at most ``rel_precision`` times ``|exact|``, a mean within
    5 standard errors of ``exact``, and no value was NaN or infinite. Where the samples do not vary, beyond rounding,
    the mean may be off by rounding: 1e-5 of ``exact``. Where the points are not independent, the standard error comes
    from their randomisations, and 5 becomes what has the same probability in Student's law: 8.3 for 16 of them.

    Args:
        estimate: what ``integrate`` or ``render`` returned.
        exact: the true value, in the shape of the mean.
        rel_precision: how small a relative error bar counts as evidence; a smaller one reveals smaller mistakes.
        variance: of one sample in closed form, for a heavy tail, whose sample variance is too small most of the time.

    Raises:
        AssertionError: what failed, with all the numbers.
    """
    mean, exact = np.asarray(estimate.mean, np.float64), np.asarray(exact, np.float64)
    between = getattr(estimate, "between", None) if variance is None else None
    sigmas = SIGMAS if between is None else joint_sigmas(1, estimate.recipe["replicates"] - 1)
    variance = np.asarray(estimate.variance if variance is None else variance, np.float64)
    stderr = np.sqrt(variance / estimate.n) if between is None else np.asarray(estimate.stderr, np.float64)
    constant = np.sqrt(variance) <= ROUNDING * np.abs(exact)
    allowed = np.where(constant, ROUNDING * np.abs(exact), sigmas * stderr)
    with np.errstate(invalid="ignore"):
        faults = {
            f"{estimate.nonfinite} values were not finite": np.isnan(mean) | (estimate.nonfinite > 0),
            "the error bar is too wide to be evidence": ~(stderr <= rel_precision * np.abs(exact)),
            f"the mean is more than {sigmas:.2g} standard errors off": ~(np.abs(mean - exact) <= allowed),
        }
    found = [fault for fault, where in faults.items() if np.any(where)]
    if found:
        raise AssertionError(
            f"{'; '.join(found)}: mean {mean}, exact {exact}, difference {mean - exact}, allowed {allowed}, "
            f"standard error {stderr}, at most {rel_precision:g} of |exact|, n = {estimate.n:,}"
        )


def assert_equivalent(a, b, rel_precision, *, abs_precision=0.0) -> None:
    """Check that two ``Estimates`` agree on all components of their value together, and that they could have disagreed.

    For two estimators of the same thing whose truth is not known, such as a path tracer with and without light
    sampling. They must be independent: drawn with different keys.

    Every component of the difference is measured against ``joint_sigmas`` of its standard error, so that a sound pair
    fails once in two million checks however many components there are. That bound must be at most
    5 ``max(abs_precision, rel_precision |value|)``, or it is no evidence. So a component that is off by 8 of these
    precisions is found with a probability above 99.8 %. Standard errors from few samples or few randomisations are
    widened by Student's law, with the degrees of freedom of Welch and Satterthwaite. Where neither estimate varies,
    beyond rounding, they may differ by rounding: 1e-5 of the value.

    A component whose variance hangs on few samples is refused, as its error bar is too small most of the time. Images
    keep no moments that tell this, unless they are asked for: ``render(..., tallies={"shape": Moments(order=4)})``.

    Args:
        a, b: what ``integrate`` or ``render`` returned; means of one structure and shape.
        rel_precision: how small an error bar of the difference counts as evidence, relative to each component.
        abs_precision: the same in absolute terms, for components near 0, such as dark pixels.

    Raises:
        AssertionError: values that are not finite, a tail too heavy for an error bar, no evidence, or a difference.
        ValueError: means of different structure or shape, or estimates drawn with the same key.
    """
    _check_pair(a, b)
    mean_a, spread_a, variance_a, freedom_a, heavy_a = _components(a)
    mean_b, spread_b, variance_b, freedom_b, heavy_b = _components(b)
    heavy = heavy_a | heavy_b | ((spread_a == 0.0) != (spread_b == 0.0))
    variance = variance_a + variance_b
    with np.errstate(invalid="ignore", divide="ignore"):
        value, off = np.abs(mean_a + mean_b) / 2.0, np.abs(mean_a - mean_b)
        freedom = variance**2 / (variance_a**2 / freedom_a + variance_b**2 / freedom_b)
    freedom = np.where(variance > 0.0, freedom, np.inf)
    bound = joint_sigmas(value.size, freedom) * np.sqrt(variance)
    constant = np.sqrt(spread_a + spread_b) <= ROUNDING * value
    allowed = np.where(constant, ROUNDING * value, bound)
    precision = SIGMAS * np.maximum(abs_precision, rel_precision * value)
    nonfinite = a.nonfinite + b.nonfinite
    with np.errstate(invalid="ignore"):
        faults = {
            f"{nonfinite} values were not finite": ~np.isfinite(off) | (nonfinite > 0),
            "too few samples make the variance for an error bar": heavy,
            "the error bar is too wide to be evidence": ~(bound <= precision),
            "the estimates differ": ~(off <= allowed) & ~heavy,
        }
    found = [f"{fault} ({np.sum(where):,} of {off.size:,})" for fault, where in faults.items() if np.any(where)]
    if found:
        worst = int(np.argmax(np.nan_to_num(off / np.maximum(allowed, 1e-300), nan=np.inf, posinf=np.inf)))
        raise AssertionError(
            f"{'; '.join(found)}: component {worst} is worst, {mean_a[worst]:.8g} and {mean_b[worst]:.8g}, "
            f"difference {off[worst]:.3g}, allowed {allowed[worst]:.3g}, evidence from {precision[worst]:.3g} down, "
            f"n = {a.n:,} and {b.n:,}"
        )


def _check_pair(a, b):
    shapes = [jax.tree.map(np.shape, estimate.mean) for estimate in (a, b)]
    if jax.tree.structure(a.mean) != jax.tree.structure(b.mean) or shapes[0] != shapes[1]:
        raise ValueError(
            f"the means must have one structure and shape, got {shapes[0]} and {shapes[1]}; map one of them"
        )
    keys = [str(estimate.recipe["key"]) for estimate in (a, b)]
    if keys[0] == keys[1]:
        raise ValueError(
            f"both estimates were drawn with key={keys[0]}, so their errors may be alike and hide a difference; "
            "draw one of them with another key"
        )


def _components(estimate):
    """Return, for all components of all leaves, mean, variance of one sample, variance of the mean, its degrees of
    freedom, and whether few samples make the variance."""
    within = estimate.moments
    between = within if estimate.between is None else estimate.between
    kept = [within, *(t for t in estimate.tallies.values() if isinstance(t, list) and len(t) == len(within))]
    rows = []
    for leaf, (m, among) in enumerate(zip(within, between, strict=True)):
        records = [t[leaf] for t in kept if isinstance(t[leaf], MomentsResult)]
        heavy = np.any([heavy_tail(r) for r in records if np.shape(r.mean) == np.shape(m.mean)], axis=0)
        rows.append((m.mean, m.variance, among.variance / among.n, among.n - 1.0, heavy))
    return [np.concatenate([np.ravel(x) for x in column]) for column in zip(*rows, strict=True)]
