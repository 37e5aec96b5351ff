"""Exact moments of light paths that are a Markov chain over a few classes of surfaces.

In some enclosures the class of the next hit, and the weight of the step, depend on nothing but the class of the present
one: between concentric spheres, between infinite plates, on regions of one sphere. What a path then collects obeys
S = Le + w S', with S' the same sum one event later, and its moments follow by recursion.
"""

import math

import numpy as np


def path_moments(emission, weights, bounces: float, last=None) -> np.ndarray:
    """Return E S, E S^2, E S^3, E S^4 of a path that starts at each class: an array of shape (4, classes).

    emission  radiance of each class, shape (classes,)
    weights   ``weights[j - 1][s, t]`` = E[w^j; the next class is t | this one is s], shape (4, classes, classes), where
              w is the factor that one scattering event puts on all that follows; 0 where the path ends
    bounces   number of scattering events; math.inf is allowed
    last      the moments of what the last vertex counts, shape (4, classes); by default it emits as any other

    Binomial expansion: E S^q = sum_j binomial(q, j) Le^(q - j) E[w^j S'^j]. A moment that diverges is inf.
    """
    emission, weights = np.asarray(emission, float), np.asarray(weights, float)
    if bounces == math.inf:
        return _endless(emission, weights)
    moments = emission ** np.arange(1, 5)[:, None] if last is None else last
    for _ in range(bounces):
        moments = np.stack([_expand(q, q, emission, weights, moments) for q in range(1, 5)])
    return moments


def _endless(emission, weights):
    moments: list[np.ndarray] = []
    for q in range(1, 5):
        step = weights[q - 1]
        converges = np.abs(np.linalg.eigvals(step)).max() < 1 and (not moments or np.isfinite(moments[-1]).all())
        known = _expand(q, q - 1, emission, weights, moments) if converges else None
        moments.append(np.linalg.solve(np.eye(len(step)) - step, known) if converges else np.full(len(step), math.inf))
    return np.stack(moments)


def _expand(q, terms, emission, weights, moments):
    """Return the terms of order up to ``terms`` in the moments of what follows."""
    following = (math.comb(q, j) * emission ** (q - j) * (weights[j - 1] @ moments[j - 1]) for j in range(1, terms + 1))
    return emission**q + sum(following)


def hemisphere_moments(directions: str, albedo, low=0.0, high=1.0) -> np.ndarray:
    """Return E[w^j; low < cos < high] for j = 1 to 4: shape (4,), moments of the weight of one diffuse event.

    Cosine-distributed directions have the weight ``albedo`` and P(cos > c) = 1 - c^2, uniform ones 2 albedo cos with
    cos uniform on [0, 1].
    """
    j = np.arange(1, 5)
    if directions == "cosine":
        return albedo**j * (high**2 - low**2)
    return (2 * albedo) ** j * (high ** (j + 1) - low ** (j + 1)) / (j + 1)


def variance_and_kurtosis_of_sum(factors, moments) -> tuple[float, float | None]:
    """Return (variance, kurtosis) of sum_k factors_k X_k, with X_k independent and of one law.

    ``moments`` are E X, E X^2, E X^3, E X^4. Cumulants of independent variables add: the k-th term has c^q kappa_q.
    """
    m1, m2, m3, m4 = moments
    second = m2 - m1**2
    fourth = m4 - 4 * m3 * m1 + 6 * m2 * m1**2 - 3 * m1**4 - 3 * second**2
    factors = np.asarray(factors, float)
    variance = second * np.sum(factors**2)
    if variance <= 1e-14 * m2 * np.sum(factors**2):
        return 0.0, None
    return float(variance), float(3 + fourth * np.sum(factors**4) / variance**2)
