"""Other integrators, to measure ours against: SciPy, vegas, QMCPy and torchquad. Needs neither our modules nor JAX.

Each is a function (n, seed) -> (estimate, samples taken) of one integral over [0, 1]^dim, as the documentation of that
package runs it, on a vectorised integrand ``batch``: points of shape (n, dim) -> values of shape (n,). Those whose name
ends in "points" are the plain mean over a point set, without an error bar, in the least time that it can take.
"""

import importlib.util
import warnings
from functools import partial
from importlib import metadata

import numpy as np

PACKAGES = ("scipy", "vegas", "qmcpy", "torchquad", "quadax")
ESTIMATORS = 8  # randomisations of SciPy's qmc_quad, its default
TRAINING, FINAL = 5, 10  # iterations of vegas: the first adapt the map and are thrown away, as its tutorial advises
POINTS_ONLY = "points"


def integrators(batch, dim):
    """Return the integrators whose packages are installed, by name."""
    found = {}
    if _installed("scipy"):
        for engine in ("Sobol", "Halton"):
            found[f"SciPy qmc_quad {engine}"] = partial(_scipy, batch, dim, engine)
    if _installed("vegas"):
        found["vegas"] = partial(_vegas, batch, dim)
    if _installed("qmcpy"):
        for kind, points, cubature in (
            ("Sobol", "DigitalNetB2", "CubQMCNetG"),
            ("lattice", "Lattice", "CubQMCLatticeG"),
        ):
            found[f"QMCPy {cubature}"] = partial(_qmcpy_cubature, batch, dim, points, cubature)
            found[f"QMCPy {kind} {POINTS_ONLY}"] = partial(_qmcpy_points, batch, dim, points)
    if _installed("torchquad"):
        found["torchquad VEGAS"] = partial(_torchquad, batch, dim)
    return found


def versions():
    """Return the versions of the packages that are installed."""
    return {name: metadata.version(name) for name in PACKAGES if _installed(name)}


def _installed(name):
    return importlib.util.find_spec(name) is not None


def _scipy(batch, dim, engine, n, seed):
    from scipy import integrate
    from scipy.stats import qmc

    # It first asks for one point of shape (dim,), then for shapes (dim, n).
    points = max(1, n // ESTIMATORS)
    result = integrate.qmc_quad(
        lambda x: batch(np.atleast_2d(x.T)), np.zeros(dim), np.ones(dim), n_estimates=ESTIMATORS, n_points=points,
        qrng=getattr(qmc, engine)(dim, rng=seed),
    )  # fmt: skip
    return float(result.integral), ESTIMATORS * points


def _vegas(batch, dim, n, seed):
    import gvar
    import vegas

    gvar.ranseed(seed)
    integrator = vegas.Integrator([[0.0, 1.0]] * dim)
    integrand = vegas.lbatchintegrand(batch)
    each = max(64, n // (TRAINING + FINAL))
    integrator(integrand, nitn=TRAINING, neval=each)
    result = integrator(integrand, nitn=FINAL, neval=each)
    return float(result.mean), (TRAINING + FINAL) * each


def _torchquad(batch, dim, n, seed):
    import loguru  # pyright: ignore[reportMissingImports]
    import torchquad  # pyright: ignore[reportMissingImports]

    loguru.logger.disable("torchquad")  # it reports each iteration
    box = np.array([[0.0, 1.0]] * dim)
    return float(torchquad.VEGAS().integrate(batch, dim, N=n, integration_domain=box, seed=seed, backend="numpy")), n


def _qmcpy_points(batch, dim, points, n, seed):
    import qmcpy

    u = getattr(qmcpy, points)(dim, seed=seed).gen_samples(n, warn=False)
    if points == "Lattice":
        u = 1.0 - np.abs(2.0 * u - 1.0)  # fold, as its own cubature does: a smooth integrand becomes periodic
    return float(np.mean(batch(u))), n


def _qmcpy_cubature(batch, dim, points, cubature, n, seed):
    """Let QMCPy take ``n`` samples and no more, by a tolerance that it cannot meet."""
    import qmcpy

    measure = qmcpy.Uniform(getattr(qmcpy, points)(dim, seed=seed))
    integrand = qmcpy.CustomFun(measure, lambda u, **_: batch(u))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says that the tolerance was not met
        solution, data = getattr(qmcpy, cubature)(integrand, abs_tol=1e-300, n_init=n, n_limit=n).integrate()
    return float(np.squeeze(solution)), int(np.max(data.n_total))
