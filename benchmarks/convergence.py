"""How fast the error of each sampler falls, and how much variance it saves against independent samples.

    python benchmarks/convergence.py

Smooth integrands in 8 dimensions: the slope of the error against the number of points in a randomisation, 2^8 to 2^16,
with its standard error. The irradiance under a rectangular light, one pixel of the Cornell box and its whole image: the
variance of n independent samples over that of n points, n = 2^10, 2^12, ..., 2^20. Variances are those of the means of
32 randomisations; a ratio of such is known to some 25 %. Everything lands in ``benchmarks/results/convergence.json``.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

import analytic_scenes
import jaxmc as mc
from jaxmc import scenes
from jaxmc.analysis.convergence import fit_rate
from jaxmc.report import machine, versions, write_json

RESULTS = Path(__file__).parent / "results" / "convergence.json"
REPLICATES = 32
SAMPLERS = (mc.Independent(), mc.Stratified(), mc.LatinHypercube(), mc.Halton(), mc.Sobol(), mc.Lattice())


def product(u):
    return jnp.prod(1.0 + 0.5 * (u - 0.5))


def exponential(u):
    return jnp.exp(u.sum() / 4.0)


def gaussian(u):
    return jnp.exp(-jnp.sum((u - 0.4) ** 2))


SMOOTH = {f.__name__: mc.Integrand(f, 8) for f in (product, exponential, gaussian)}


def paths():
    """Return the integrands of light transport: a number each."""
    scene, camera = scenes.cornell_box(256, 256)
    whole = mc.path_integrand(scene, camera, bounces=5).map(mc.luminance)
    origin, aside = np.array(camera.origin), np.array(camera.forward) + 0.3 * np.array(camera.right)
    tiny = mc.PinholeCamera(origin, origin + aside, fov=0.15, width=1, height=1)
    pixel = mc.path_integrand(scene, tiny, bounces=5).map(mc.luminance)
    light = analytic_scenes.rectangle_light().integrand
    return {"rectangular light": light, "Cornell pixel": pixel, "Cornell image": whole}


def spread(f, sampler, n):
    """Return the standard deviation of the means of randomisations of n points, and the variance of a sample."""
    estimate = mc.integrate(f, n=n * REPLICATES, sampler=sampler, replicates=REPLICATES)
    return float(estimate.stderr) * REPLICATES**0.5, float(estimate.variance)


def main():
    found = {"slopes": {}, "variance reduction": {}, "machine": machine(), "versions": versions()}
    sizes = 2 ** np.arange(8, 17)
    for name, f in SMOOTH.items():
        for sampler in SAMPLERS:
            errors = np.array([spread(f, sampler, int(n))[0] for n in sizes])
            rate = fit_rate(sizes, errors**2, REPLICATES - 1)
            found["slopes"].setdefault(name, {})[repr(sampler)] = {"slope": rate.slope, "stderr": rate.stderr}
            print(f"{name:12s} {sampler!r:34s} slope {rate.slope:6.2f} +- {rate.stderr:.2f}")
    for name, f in paths().items():
        for sampler in SAMPLERS[1:]:
            gains = {}
            for m in range(10, 21, 2):
                deviation, variance = spread(f, sampler, 1 << m)
                gains[m] = variance / 2**m / deviation**2
            found["variance reduction"].setdefault(name, {})[repr(sampler)] = gains
            print(f"{name:18s} {sampler!r:34s}", *(f"2^{m}: {gain:8.3g}" for m, gain in gains.items()))
    write_json(RESULTS, found)


if __name__ == "__main__":
    main()
