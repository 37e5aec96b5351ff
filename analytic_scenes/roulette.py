"""Russian roulette where everything about it is exact: white furnaces.

A path survives each scattering event with probability p, and is then worth 1/p as much. The mean does not change; the
variance does, and it is infinite where rho^2 >= p for cosine-distributed directions, 4 rho^2/3 >= p for uniform ones.
The walks have a last event, so they are integrals over finitely many coordinates; the closed forms stop there as well.
Walks with roulette go on for 1/(1 - p) rays in the mean; what a bound of n events leaves out is rho^(n + 1)/(1 - rho).
"""

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxmc as mc
from analytic_scenes.cavity import Walk, everywhere, wall_radiance
from analytic_scenes.chains import hemisphere_moments, path_moments
from analytic_scenes.furnace import furnace_radiance, geometric_sum
from analytic_scenes.laws import Law
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis

SOURCE = (
    "Arvo and Kirk, Particle transport and image synthesis (1990); Sbert, Random walk radiosity with generalized "
    "absorption probabilities (2000)"
)
GEOMETRY = "The inside of a diffuse sphere of one albedo that emits everywhere."


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        roulette_furnace(),
        roulette_furnace(guaranteed=2),
        roulette_furnace(0.5, 0.8, directions="uniform"),
        absorption_furnace(),
        path_length(),
    )


def roulette_furnace(
    albedo: float = 0.6,
    survival: float = 0.7,
    emission: float = 1.0,
    bounces: int = 6,
    directions: str = "cosine",
    guaranteed: int = 0,
) -> AnalyticScene:
    """Return the radiance inside a furnace by paths with Russian roulette; the first ``guaranteed`` events have none.

    Raises ``ValueError`` for a survival outside (0, 1], and negative numbers of events.
    """
    check_walk(survival, bounces)
    if guaranteed < 0:
        raise ValueError(f"guaranteed must be a number of events >= 0; got {guaranteed}")
    weights = hemisphere_moments(directions, albedo)[:, None, None]
    roulette = survival ** (1.0 - np.arange(1, 5))[:, None, None]
    ends = path_moments([emission], roulette * weights, max(bounces - guaranteed, 0))
    moments = path_moments([emission], weights, min(guaranteed, bounces), last=ends)
    walk = Walk(bounces, everywhere, everywhere, directions, guaranteed=guaranteed)
    return _furnace_scene(
        f"furnace, roulette {survival:g} after {guaranteed} events, {directions} directions",
        wall_radiance(walk, (0.6, 0.0, 0.8), survival=survival, lamp=(emission,), paint=(albedo,)),
        (albedo, emission, bounces),
        moments[:, 0],
        GEOMETRY,
    )


def absorption_furnace(
    albedo: float = 0.6, survival: float = 0.7, emission: float = 1.0, bounces: int = 6
) -> AnalyticScene:
    """Return the radiance inside a furnace by paths that count only where they die, Le (rho/p)^K/(1 - p).

    Survivors of all ``bounces`` events count Le (rho/p)^bounces. At survival = albedo every path of an endless walk is
    worth the same. No ray is traced: in a furnace nothing depends on where a path is.
    Raises ``ValueError`` for a survival outside (0, 1), and for bounces < 1.
    """
    check_walk(survival, bounces)
    if survival == 1 or bounces < 1:
        raise ValueError(f"paths must be able to die: survival < 1, bounces >= 1; got {survival} and {bounces}")
    moments = [
        emission**q
        * (
            (1.0 - survival) ** (1 - q) * geometric_sum(survival * (albedo / survival) ** q, bounces)
            + survival**bounces * (albedo / survival) ** (q * bounces)
        )
        for q in range(1, 5)
    ]
    labels = tuple(f"event {k + 1}, survival" for k in range(bounces))
    params = (albedo, survival, emission)
    return _furnace_scene(
        f"furnace, paths that count where they die, survival {survival:g}",
        mc.Integrand(_worth_at_death, bounces, params, lazy=False, labels=labels),
        (albedo, emission, bounces),
        moments,
        "Any closed room of one albedo that emits everywhere.",
    )


def path_length(survival: float = 0.8, bounces: int = 6) -> AnalyticScene:
    """Return the number of scattering events of a path that survives each with probability ``survival``.

    A path counts no more than ``bounces`` events. Raises ``ValueError`` as ``roulette_furnace`` does.
    """
    check_walk(survival, bounces)
    # P(K >= k) = p^k, so E K^q = sum_k (k^q - (k - 1)^q) p^k.
    k = np.arange(1, bounces + 1)
    moments = [float(np.sum((k**q - (k - 1) ** q) * survival**k)) for q in range(1, 5)]
    # The throughput of a path whose albedo is its survival is 1 while it lives.
    walk = Walk(bounces, everywhere, everywhere, fewest=1, guaranteed=0)
    return closed_form_scene(
        f"number of events with survival {survival:g}, at most {bounces}",
        functools.partial(mean_path_length, bounces=bounces),
        {"survival": survival},
        wall_radiance(walk, (0.6, 0.0, 0.8), survival=survival, lamp=(1.0,), paint=(survival,)),
        "geometric distribution",
        geometry=GEOMETRY,
        law=lambda _: Law(*variance_and_kurtosis(moments)),
    )


def mean_path_length(survival, bounces=math.inf):
    """Return the mean number of events sum_{k=1..n} p^k; p/(1 - p) for an endless walk."""
    return survival * geometric_sum(survival, bounces)


def path_length_variance(survival):
    """Return the variance p/(1 - p)^2 of the number of events of an endless walk."""
    return survival / (1.0 - survival) ** 2


def absorption_variance(albedo, survival, emission=1.0):
    """Return the variance of an endless path that counts only where it dies: 0 at survival = albedo.

    Le^2 (1/((1 - p)(1 - rho^2/p)) - 1/(1 - rho)^2); infinite for rho^2 >= p.
    """
    square = albedo**2 / survival
    tame = jnp.where(square < 1, square, 0.0)
    variance = emission**2 * (1.0 / ((1.0 - survival) * (1.0 - tame)) - 1.0 / (1.0 - albedo) ** 2)
    return jnp.where(square < 1, variance, jnp.inf)


def roulette_work(albedo, survival, emission=1.0):
    """Return variance times rays, rho^2 Le^2/((1 - rho)^2 (p - rho^2)), of an endless walk with cosine directions.

    It falls with growing p: where a white furnace is all there is, roulette never pays.
    """
    gap = survival - albedo**2
    work = emission**2 * albedo**2 / ((1.0 - albedo) ** 2 * jnp.where(gap > 0, gap, 1.0))
    return jnp.where(gap > 0, work, jnp.inf)


def critical_roulette_albedo(survival, directions="cosine"):
    """Return the albedo from which the variance with roulette is infinite: sqrt(p), or sqrt(3 p)/2 for "uniform"."""
    return jnp.sqrt(survival * (3.0 / 4.0 if directions == "uniform" else 1.0))


def check_walk(survival, bounces) -> None:
    """Raise ``ValueError`` where ``survival`` is no probability above 0, or ``bounces`` is negative."""
    if not 0 < survival <= 1 or bounces < 0:
        raise ValueError(f"survival in (0, 1] and bounces >= 0 are needed; got {survival} and {bounces}")


def _worth_at_death(u, albedo, survival, emission):
    def event(beta, coordinate):
        dies = coordinate >= survival
        worth = jnp.where(dies, beta / (1.0 - survival), 0.0)
        return jnp.where(dies, 0.0, beta * albedo / survival), worth

    left, worth = lax.scan(event, jnp.ones(()), u)
    return emission * (jnp.sum(worth) + left)


def _furnace_scene(name, integrand, parameters, moments, geometry):
    albedo, emission, bounces = parameters
    formula = functools.partial(furnace_radiance, bounces=bounces)
    arguments = {"albedo": albedo, "emission": emission}

    def law(_):
        return Law(*variance_and_kurtosis(moments))

    return closed_form_scene(name, formula, arguments, integrand, SOURCE, geometry=geometry, law=law)
