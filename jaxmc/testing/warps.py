"""Checks of a way to draw points against its density: by counting samples in bins, and by the derivative of the map.

They see different mistakes. ``assert_jacobian`` is exact and immediate but local: it cannot see that a part of the
domain is drawn twice and another never. ``assert_samples_pdf`` sees that, and needs no derivative, but a small relative
error of the density takes many samples to show. Use both where both apply.

How others test: pbrt and Mitsuba count a million samples in 200 to 10,000 bins of (cos theta, phi), integrate the
density by Simpson's rule, pool bins of fewer than 5 expected samples, and reject at 1 %, divided among the tests. Here
the significance is that of 5 standard errors, which takes more expected samples in a bin (see ``chi_square``).
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..integration.draw import draw
from .chi_square import LEAST, SIGNIFICANCE, ChiSquare, chi_square
from .domains import Domain, bin_integrals, locate

TOTAL = 1e-3  # how far the integral of a density may be from 1: its quadrature, and float32
STRAY = 1e-4  # samples that rounding may move over an edge
ULPS = 1 << 12  # rounding errors that a Jacobian may have


def assert_samples_pdf(
    sample, pdf, domain: Domain, *, dim=2, n=1 << 20, key=0, accept=None, significance=SIGNIFICANCE
) -> ChiSquare:
    """Check by a chi-square test that points are drawn with the density that is claimed.

    Counts ``n`` samples in the bins of ``domain`` and compares them with integrals of ``pdf`` over the bins. Rare bins
    are pooled until 25 samples are expected in each. Fails also where the density does not integrate to 1 within 1e-3,
    where a sample is outside the domain or off its surface (a direction that is not of unit length), or where the
    density at a sample is not positive and finite; rounding may do that to one sample in 10,000.

    Power, with 512 bins and the default n and significance: a density that is off by a relative error e on a fraction f
    of the samples (and by -e f / (1 - f) on the rest) fails with a probability of 99 % from
    e = 0.0162 sqrt((1 - f) / f) on: 1.6 % on half of the samples, 5 % on a tenth, 16 % on a hundredth. The limit falls
    as 1 / sqrt(n); ``chi_square_power`` says it for any numbers. Errors that cancel within every bin cannot be seen.

    Args:
        sample: ``sample(u) -> x`` for one point u of shape ``(dim,)``; x is a number, an array, a ``Vec3`` or another
            pytree.
        pdf: ``pdf(x)``, a number: the density of x in the measure of the domain. It may jump. A peak much narrower than
            a bin may be missed by the quadrature, and then fails the test for its integral: use more bins.
        domain: what is sampled: ``SPHERE``, ``HEMISPHERE``, ``SQUARE``, ``directions(axis, half_angle)``, ``box`` or a
            ``Domain`` of your own.
        dim: number of coordinates that ``sample`` uses.
        n, key: number of samples and seed.
        accept: ``accept(x)``, whether a sample counts, where drawing may fail, such as a reflection that goes below the
            horizon. The density then integrates to the probability of acceptance; rejected samples are one more bin.
        significance: probability that a sound pair fails.

    Returns:
        The numbers of the test.

    Raises:
        AssertionError: what failed, with all the numbers.
        ValueError: fewer than two bins of 25 expected samples, or a density that cannot be integrated.
    """
    drawn = draw(lambda u: _record(sample(u), pdf, accept), dim=dim, n=n, key=key).value
    bins, inside = (np.asarray(x) for x in locate(domain, drawn["x"]))
    probability, uncertain = _bin_probabilities(sample, pdf, domain, dim, n)
    kept, positive, total = drawn["accepted"], drawn["positive"], float(probability.sum())
    faults = {
        f"the density integrates to {total:.5g}": not (total <= 1.0 + TOTAL and (accept or total >= 1.0 - TOTAL)),
        "samples are outside the domain or off its surface": np.mean(kept & ~inside) > STRAY,
        "the density at samples is not positive and finite": np.mean(kept & ~positive) > STRAY,
    }
    if found := [fault for fault, true in faults.items() if true]:
        raise AssertionError(
            f"{'; '.join(found)}: the integral must be 1 within {TOTAL:g}{'' if accept is None else ' or less'}; "
            f"{np.sum(kept & ~inside):,} samples are outside, {np.sum(kept & ~positive):,} have no density, "
            f"at most {STRAY * n:.0f} may; n = {n:,}"
        )
    if uncertain > TOTAL:
        raise ValueError(
            f"the density could not be integrated, {uncertain:.2g} of it is uncertain; pass a domain whose bins follow "
            "its edges and peaks"
        )
    observed = np.bincount(bins[kept], minlength=len(probability))
    if accept is not None:
        observed, probability = np.append(observed, n - kept.sum()), np.append(probability, max(1.0 - total, 0.0))
    result = chi_square(observed, n * probability)
    if not result.p_value >= significance:
        raise AssertionError(
            f"samples do not follow the density: chi-square {result.statistic:.5g} in {result.cells} bins, "
            f"p = {result.p_value:.2g} below {significance:.2g}, n = {n:,}; the worst bin has {result.worst[0]:,} "
            f"samples, expected are {result.worst[1]:.5g}"
        )
    return result


def assert_jacobian(sample, pdf, *, dim=2, n=1 << 12, key=0, tolerance=None) -> float:
    """Check that a density is that of a map: pdf(x(u)) |dx / du| = 1.

    The derivative comes from ``jax.jacfwd``. For directions and surfaces, |dx / du| is sqrt(det(J^T J)), the area that
    the map gives to du, so the density is per solid angle or per area. Points are random ones, and those on the edges
    of the unit cube as far as a sampler goes: each coordinate smallest, 1/2, or largest. There the relative error may
    be 4 sqrt(eps), for roots that start there, and the density may be 0, as rounding decides on which side of a jump
    they are; but it must be finite.

    Power: a density that is wrong by more than ``tolerance`` on a fraction f of the samples is found with a probability
    of 1 - (1 - f)^n, 98 % for f = 0.001. Not seen: a map that covers a part of the domain twice and another never.

    Args:
        sample: ``sample(u) -> x`` for one point u of shape ``(dim,)``, differentiable; x as in ``assert_samples_pdf``,
            with at least as many components as u. Every coordinate is used: dim is the dimension of the domain.
        pdf: ``pdf(x)``, a number: the density of x per length, area, volume or solid angle.
        dim: number of coordinates.
        n, key: number of random points and seed.
        tolerance: relative; by default 4096 rounding errors, 4.9e-4 in float32 and 9.1e-13 in float64.

    Returns:
        The largest relative error at a random point.

    Raises:
        AssertionError: the point where the product is farthest from 1, or not finite, with the numbers.
        ValueError: x has fewer components than u.
    """
    kind = jnp.result_type(float)
    eps = float(np.finfo(kind).eps)
    ends = (2.0**-33, 1.0 - 2.0**-24) if kind == np.float32 else (2.0**-53, 1.0 - 2.0**-53)
    edges = np.array(list(itertools.product((ends[0], 0.5, ends[1]), repeat=dim)))
    u = jnp.asarray(np.concatenate([np.random.default_rng(key).uniform(*ends, (n, dim)), edges]), kind)
    tolerance = np.full(len(u), ULPS * eps if tolerance is None else tolerance)
    tolerance[n:] = np.maximum(tolerance[n:], 4.0 * eps**0.5)

    def point_and_density(u):
        x = sample(u)
        return ravel_pytree(x)[0], pdf(x)

    derivative = jax.jit(jax.vmap(jax.jacfwd(point_and_density, has_aux=True)))
    jacobian, density = (np.asarray(x, np.float64) for x in derivative(u))
    if jacobian.shape[1] < dim:
        raise ValueError(
            f"a map from {dim} coordinates to {jacobian.shape[1]} components has no density there; pass the dim that "
            "sample needs"
        )
    finite = np.isfinite(jacobian).all((1, 2)) & np.isfinite(density)
    triangular = np.linalg.qr(np.where(finite[:, None, None], jacobian, 0.0), mode="r")
    product = np.where(finite, np.abs(triangular[:, range(dim), range(dim)].prod(1)) * density, np.nan)
    error = np.where(finite, np.abs(product - 1.0), np.inf)
    error[n:][product[n:] == 0.0] = 0.0
    excess = error / tolerance
    worst = int(np.argmax(excess))
    if not excess[worst] <= 1.0:
        raise AssertionError(
            f"density times Jacobian is {product[worst]:.8g}, not 1, at u = {np.asarray(u)[worst]}: density "
            f"{density[worst]:.6g}, Jacobian {jacobian[worst].tolist()}, allowed error {tolerance[worst]:.2g}; "
            f"so it is at {np.sum(excess > 1.0):,} of {len(u):,} points"
        )
    return float(error[:n].max())


def _record(x, pdf, accept):
    """Return the flat components of a sample, and whether its density is one and whether it counts."""
    density = jnp.asarray(pdf(x))
    accepted = jnp.asarray(True if accept is None else accept(x), bool)
    return {"x": ravel_pytree(x)[0], "positive": (density > 0.0) & jnp.isfinite(density), "accepted": accepted}


def _bin_probabilities(sample, pdf, domain, dim, n):
    """Return the integral of the density over each bin to a small part of the error of n samples, and what of it is
    uncertain."""
    x = jax.eval_shape(sample, jax.ShapeDtypeStruct((dim,), jnp.result_type(float)))
    flat, unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), x))
    return bin_integrals(
        lambda x: jnp.asarray(pdf(unravel(x.astype(flat.dtype))), float),
        domain,
        lambda integral: 0.05 * np.sqrt(np.maximum(integral, LEAST / n) / n),
    )
