"""The throughput of a path that samples every direction uniformly on the hemisphere: a product of 2 rho U_i.

At a diffuse surface of albedo rho the weight of such a direction is (rho/pi) cos / (1/2 pi) = 2 rho cos, and cos is
uniform on [0, 1). The weights are independent in any closed scene of one albedo, and between endless parallel plates of
two. Their mean is rho, yet they exceed 1 whenever cos > 1/(2 rho), and the products are heavy-tailed: the simplest
source of fireflies. The whole law of the product (exceedance, bias of clamping, ...) is
``jaxmc.testing.ThroughputProduct``.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax.scipy.special import gammainc

import jaxmc as mc
from analytic_scenes.enclosures import plates
from analytic_scenes.furnace import geometric_sum
from analytic_scenes.laws import Law
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis
from jaxmc.integration.counts import is_count
from jaxmc.testing import PathSum, ThroughputProduct
from jaxmc.transport import rays
from jaxmc.transport.paths import trace

SOURCE = "moments of a product of independent uniform variables"


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        throughput_product(),
        throughput_walk(),
        throughput_walk(events=1, power=2),
        throughput_walk(albedo=0.9, other_albedo=0.4),
        log_throughput(),
        throughput_exceedance(),
        path_sum(),
        path_sum(depth=5, albedo=0.8, other_albedo=0.5, escape=0.2),
    )


def throughput_product(k: int = 2, rho: float = 0.8) -> AnalyticScene:
    """Return the product of ``k`` weights 2 rho u_i, an integral over [0,1)^k.

    Exact: mean rho^k, E W^q = ((2 rho)^q / (q + 1))^k, relative variance (4/3)^k - 1 whatever rho.
    Raises ``ValueError`` for k < 1 or a negative rho.
    """
    if not is_count(k) or rho < 0:
        raise ValueError(f"a product of k >= 1 weights with rho >= 0 is needed; got k={k}, rho={rho}")
    law = ThroughputProduct(k, rho)
    _, kurtosis = variance_and_kurtosis([law.moment(q) for q in (1, 2, 3, 4)])

    return AnalyticScene(
        name=f"product of {k} uniform-hemisphere weights, rho={rho:g}",
        integrand=mc.Integrand(lambda u, rho: ThroughputProduct(k, rho).sample(u), k, (rho,)),
        exact=float(law.mean),
        exact_variance=float(law.variance),
        exact_kurtosis=kurtosis,
        derivatives={"rho": k * rho ** (k - 1)},
        source=SOURCE,
        formula=functools.partial(_power, k=k),
        arguments={"rho": rho},
        geometry="No scene: the weights of a path as they stand.",
    )


def throughput_walk(
    events: int = 2, albedo: float = 0.8, other_albedo: float | None = None, power: float = 1
) -> AnalyticScene:
    """Return E W^q of the throughput W of a path after ``events`` scattering events; q is the ``power``.

    The path is traced: inside a sphere of one ``albedo``, or between two endless plates, of which it meets the one of
    ``albedo`` first. Raises ``ValueError`` for events < 1 and a power or albedo that is not positive.
    """
    albedos = (albedo,) if other_albedo is None else (albedo, other_albedo)
    _check(events, *albedos, power)
    moments = [float(throughput_moment(*(albedos * 2)[:2], events, power * q)) for q in (1, 2, 3, 4)]
    arguments = {"albedo": albedo} if other_albedo is None else {"albedo": albedo, "other_albedo": other_albedo}
    where = "in a sphere" if other_albedo is None else "between plates"
    return _walk_scene(
        f"throughput{'' if power == 1 else f'^{power:g}'} after {events} events {where}",
        albedos,
        events,
        (_to_the, (float(power),)),
        functools.partial(_one_albedo if other_albedo is None else throughput_moment, events=events, power=power),
        arguments,
        variance_and_kurtosis(moments),
    )


def log_throughput(events: int = 5, albedo: float = 0.8) -> AnalyticScene:
    """Return the mean of the logarithm of a path's throughput in a sphere of one ``albedo``: ``events`` (ln 2 rho - 1).

    It falls although the mean throughput may not: typical paths are dim, rare ones bright. The logarithm of each weight
    is that of a uniform number, so the variance is ``events`` and the kurtosis 3 + 6/events.
    Errors as ``throughput_walk``.
    """
    _check(events, albedo)
    return _walk_scene(
        f"log throughput after {events} events",
        (albedo,),
        events,
        (jnp.log, ()),
        functools.partial(mean_log_throughput, events=events),
        {"albedo": albedo},
        (float(events), 3.0 + 6.0 / events),
    )


def throughput_exceedance(threshold: float = 0.2, events: int = 3, albedo: float = 0.8) -> AnalyticScene:
    """Return the probability that a path's throughput in a sphere of one ``albedo`` is above ``threshold``: a firefly.

    The derivatives come from the edge alone: differentiating the integrand gives 0. Errors as ``throughput_walk``.
    """
    _check(events, albedo, threshold)
    law = ThroughputProduct(events, albedo)
    probability = float(law.exceedance(threshold))
    return _walk_scene(
        f"throughput above {threshold:g} after {events} events",
        (albedo,),
        events,
        (_exceeds, (float(threshold),)),
        functools.partial(exceedance, events=events),
        {"albedo": albedo, "threshold": threshold},
        variance_and_kurtosis([probability] * 4),
    )


def throughput_moment(albedo, other_albedo, events, power=1):
    """Return E W^q = prod_i (2 rho_i)^q/(q + 1) after ``events`` events on surfaces that take turns."""
    first, second = (2.0 * albedo) ** power / (power + 1), (2.0 * other_albedo) ** power / (power + 1)
    return first ** ((events + 1) // 2) * second ** (events // 2)


def mean_log_throughput(albedo, events):
    """Return E ln W = k (ln 2 rho - 1)."""
    return events * (jnp.log(2.0 * albedo) - 1.0)


def exceedance(albedo, threshold, events):
    """Return P(W > t) = P(k, k ln(2 rho) - ln t), the regularised lower incomplete gamma function.

    -ln of a product of k uniform numbers is Gamma(k)-distributed. 0 for t >= (2 rho)^k, which no path exceeds.
    """
    depth = events * jnp.log(2.0 * albedo) - jnp.log(threshold)
    return jnp.where(depth > 0, gammainc(float(events), jnp.where(depth > 0, depth, 1.0)), 0.0)


def path_sum(
    albedo: float = 0.6, depth: float = math.inf, other_albedo: float | None = None, escape: float = 0.0
) -> AnalyticScene:
    """Return the sum S = 1 + w_1 + w_1 w_2 + ... over the lengths of a path where every surface emits 1.

    At most ``depth`` events (math.inf is allowed; then what is left out is below 1e-9), on surfaces that take turns
    where there is an ``other_albedo``; at each the path is lost with probability ``escape``. See
    ``jaxmc.testing.PathSum``. Without end the variance is finite while the product of both albedos is below
    3 / (4 (1 - escape)); where it is not, ``exact_variance`` is None, and likewise ``exact_kurtosis``.
    Raises ``ValueError`` for albedos that are not positive or paths that do not fade.
    """
    albedos = (albedo,) if other_albedo is None else (albedo, other_albedo)
    _check(max(depth, 1), *albedos, 1.0 - escape)
    sums = PathSum(albedo, depth, other_albedo, escape)
    moments = [sums.moment(q) for q in (1, 2, 3, 4)]
    if not math.isfinite(moments[0]):
        raise ValueError(f"albedos whose product is below 1 are needed; got {albedos}")
    known = [q for q in (2, 4) if math.isfinite(moments[q - 1])]
    variance, kurtosis = variance_and_kurtosis([m if math.isfinite(m) else 0.0 for m in moments])
    arguments = {"albedo": albedo} if other_albedo is None else {"albedo": albedo, "other_albedo": other_albedo}
    lengths = "all lengths" if depth == math.inf else f"up to {depth} events"
    return closed_form_scene(
        f"path sum, {lengths}, albedo {' and '.join(f'{x:g}' for x in albedos)}"
        + (f", {escape:g} escape" if escape else ""),
        functools.partial(_path_sum_mean, depth=depth, escape=escape),
        arguments,
        mc.Integrand(_PathSumSample(depth, sums.dim, escape), sums.dim, tuple(map(float, arguments.values()))),
        "moments by recursion; Goldie (1991) for the tail",
        geometry="No scene: the sum that a path collects in a furnace with uniform directions.",
        law=lambda _: Law(variance if 2 in known else None, kurtosis if 4 in known else None),
    )


@dataclasses.dataclass(frozen=True)
class _PathSumSample:
    depth: float
    events: int
    escape: float

    def __call__(self, u, albedo, other_albedo=None):
        # The number of events does not follow the albedo while that is differentiated.
        return PathSum(albedo, min(self.depth, self.events), other_albedo, self.escape).sample(u)


def _path_sum_mean(albedo, other_albedo=None, depth=math.inf, escape=0.0):
    first = (1.0 - escape) * albedo
    second = first if other_albedo is None else (1.0 - escape) * other_albedo
    pairs = math.inf if depth == math.inf else (depth + 2) // 2
    odd = math.inf if depth == math.inf else (depth + 1) // 2
    return geometric_sum(first * second, pairs) + first * (geometric_sum(first * second, odd) if odd else 0.0)


def critical_albedo(q: float, escape: float = 0.0) -> float:
    """Return the albedo at which the ``q``-th moment of the furnace estimator with uniform directions diverges.

    E w^q = (1 - escape) (2 rho)^q / (q + 1) = 1 at rho = ((q + 1) / (1 - escape))^(1/q) / 2: sqrt(3)/2 for the
    variance, 0.7477 for the fourth moment, on which the error bar of a sample variance depends. Where two albedos take
    turns it is their geometric mean: the variance is finite while their product is below 3/4. ``escape`` is the
    probability that a path is lost at an event.
    """
    return ((q + 1) / (1 - escape)) ** (1 / q) / 2


def tail_index(rho: float, escape: float = 0.0) -> float:
    """Return kappa of the power-law tail P(S > x) ~ C x^-kappa of the endless furnace estimator S = 1 + 2 rho U S'.

    kappa solves (1 - escape) (2 rho)^kappa = 1 + kappa: see ``jaxmc.testing.PathSum.tail_index``. For rho <= 1/2 no
    weight exceeds 1, there is no power-law tail, and the answer is infinity. Raises ``ValueError`` outside
    0 <= rho <= 1.
    """
    if not 0 <= rho <= 1:
        raise ValueError(f"an albedo in [0, 1] is needed; got {rho}")
    return math.inf if rho <= 0.5 else PathSum(rho, escape=escape).tail_index


@dataclasses.dataclass(frozen=True)
class _Walk:
    """``measure(throughput, *parameters)`` after the last event of a path.

    In float32, one uniform direction in 1e8 grazes a sphere so closely that its ray misses. Such a path has throughput
    0, or goes on from where it was for a ``measure`` that has no value at 0.
    """

    strategy: Any
    measure: Callable

    def __call__(self, u, scene, origin, direction, *parameters):
        def throughput(surface, state):
            return jnp.where((surface.face >= 0) | (self.measure is jnp.log), state.beta, 0.0)

        _, seen = trace(scene, self.strategy, u, 0, rays.ray(scene.local(origin), direction), throughput)
        return self.measure(jnp.asarray(seen)[-1], *parameters)


def _walk_scene(name, albedos, events, measure, formula, arguments, spread):
    function, parameters = measure
    if len(albedos) == 1:
        room = [mc.Sphere((0.0, 0.0, 0.0), 2.0, mc.Diffuse(albedos[0]), inward=True)]
        geometry = "The inside of a diffuse sphere."
    else:
        room = plates(*map(mc.Diffuse, albedos))
        geometry = "Two endless parallel plates, squares of side 2e5 at distance 1."
    path = mc.radiance(
        mc.Scene(room), (0.3, -0.2, 0.5), (0.2, 0.3, -0.9), bounces=events, directions="uniform", lights="none"
    )
    integrand = dataclasses.replace(path, fn=_Walk(path.fn.strategy, function), params=(*path.params, *parameters))
    return closed_form_scene(name, formula, arguments, integrand, SOURCE, geometry=geometry, law=lambda _: Law(*spread))


def _to_the(throughput, power):
    return throughput**power


def _exceeds(throughput, threshold):
    return jnp.where(throughput > threshold, 1.0, 0.0)


def _power(rho, k):
    return rho**k


def _one_albedo(albedo, events, power):
    return throughput_moment(albedo, albedo, events, power)


def _check(events, *positive):
    if events < 1 or min(positive) <= 0:
        raise ValueError(f"events >= 1, albedos, powers and thresholds > 0 are needed; got {events} and {positive}")
