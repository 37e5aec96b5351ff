"""The throughput of a path that samples every direction uniformly on the hemisphere: a product of 2 rho U_i.

At a diffuse surface of albedo rho the weight of such a direction is (rho/pi) cos / (1/2 pi) = 2 rho cos, and cos is
uniform on [0, 1). The weights are independent in any closed scene of one albedo. Their mean is rho, yet they exceed 1
whenever cos > 1/(2 rho), and the products are heavy-tailed: the simplest source of fireflies. The whole law of the
product (exceedance, bias of clamping, ...) is ``jaxmc.testing.ThroughputProduct``.
"""

import math

from scipy.special import lambertw

import jaxmc as mc
from analytic_scenes.scene import AnalyticScene, variance_and_kurtosis
from jaxmc.integration.counts import is_count
from jaxmc.testing import ThroughputProduct


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
        source="moments of a product of independent uniform variables",
    )


def critical_albedo(q: float) -> float:
    """Return the albedo at which the ``q``-th moment of the furnace estimator with uniform directions diverges.

    E w^q = (2 rho)^q / (q + 1) = 1 at rho = (q + 1)^(1/q) / 2: sqrt(3)/2 for the variance, 0.7477 for the fourth
    moment, on which the error bar of a sample variance depends.
    """
    return (q + 1) ** (1 / q) / 2


def tail_index(rho: float) -> float:
    """Return kappa of the power-law tail P(S > x) ~ C x^-kappa of the endless furnace estimator S = 1 + 2 rho U S'.

    kappa solves (2 rho)^kappa = 1 + kappa, so kappa = -1 - W_-1(-a e^-a)/a with a = ln(2 rho). For rho <= 1/2 no weight
    exceeds 1, there is no power-law tail, and the answer is infinity. Raises ``ValueError`` outside 0 <= rho <= 1.

    Source: Kesten, Random difference equations and renewal theory for products of random matrices (1973);
    Goldie, Implicit renewal theory and tails of solutions of random equations (1991).
    """
    if not 0 <= rho <= 1:
        raise ValueError(f"an albedo in [0, 1] is needed; got {rho}")
    if rho <= 0.5:
        return math.inf
    a = math.log(2 * rho)
    return -1.0 - float(lambertw(-a * math.exp(-a), -1).real) / a
