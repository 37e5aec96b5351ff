"""The integrating sphere: a hollow diffuse sphere of which only a part shines, exact to any number of events.

See ``cavity`` for the reason and for the walk. Radiance leaves a point of the wall that the docstrings name;
``bounces`` counts scattering events, and the closed forms stop where the paths do.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

from analytic_scenes.cavity import Walk, everywhere, inside_cap, lit_by_a_point, quadratic, wall_radiance
from analytic_scenes.chains import path_moments, variance_and_kurtosis_of_sum
from analytic_scenes.furnace import enough_bounces, geometric_sum
from analytic_scenes.laws import Law
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis

SOURCE = "integrating-sphere theory: Jacquez and Kuppenheim (1955); Fredholm equation with a kernel of rank one"
NODES = np.polynomial.legendre.leggauss(128)


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 1."""
    return (
        lit_cap(),
        lit_cap(cap_albedo=0.2),
        lit_cap(half_angle=2.0, fewest=2, bounces=2),
        lit_cap(half_angle=math.pi / 2, survival=0.9),
        smooth_wall(),
        lamp_in_sphere(),
    )


def lit_cap(
    emission: float = 3.0,
    albedo: float = 0.75,
    half_angle: float = math.pi / 3,
    cap_albedo: float | None = None,
    bounces: int | None = 4,
    fewest: int = 1,
    survival: float | None = None,
    radius: float = 2.0,
) -> AnalyticScene:
    """Return the radiance that leaves the pole z = -R where a cap about the pole z = R shines.

    half_angle  of the cap, seen from the centre, between 0 and pi
    cap_albedo  where the cap reflects otherwise than the rest of the wall
    bounces     number of scattering events, or None for enough of them to leave out less than 1e-9
    fewest      light that was scattered fewer times is left out; bounces = fewest leaves one order of scattering
    survival    probability of Russian roulette at each event; None for no roulette
    Raises ``ValueError`` for a half angle outside (0, pi), a survival outside (0, 1], fewest outside [1, bounces], and
    for bounces=None with an albedo of 1.
    """
    own_albedo = albedo if cap_albedo is None else cap_albedo
    bounces = enough_bounces(max(albedo, own_albedo)) if bounces is None else bounces
    if not 0 < half_angle < math.pi or not 1 <= fewest <= bounces:
        raise ValueError(
            f"0 < half_angle < pi and 1 <= fewest <= bounces are needed; got {half_angle}, {fewest}, {bounces}"
        )
    arguments = {"emission": emission, "albedo": albedo, "half_angle": half_angle}
    formula = lit_cap_radiance
    if cap_albedo is not None:
        arguments, formula = arguments | {"cap_albedo": cap_albedo}, painted_cap_radiance
    formula = functools.partial(formula, bounces=bounces, fewest=fewest)
    # Every hit is in the cap with probability f, whatever came before.
    share = (1.0 - math.cos(half_angle)) / 2.0
    chance = 1.0 if survival is None else _probability(survival)
    weights = [chance ** (1 - j) * np.outer((own_albedo**j, albedo**j), (share, 1.0 - share)) for j in range(1, 5)]
    seen = path_moments((emission, 0.0), weights, bounces - fewest)
    moments = path_moments((0.0, 0.0), weights, fewest, last=seen)[:, 1]
    edge = math.cos(half_angle)
    walk = Walk(bounces, inside_cap, inside_cap, fewest=fewest, guaranteed=None if survival is None else 0)
    words = [f"sphere lit by a cap of half angle {half_angle:.3g}"]
    words += [f"albedos {own_albedo:g} and {albedo:g}"] if cap_albedo is not None else []
    words += [f"{fewest} to {bounces} bounces"] if fewest > 1 else []
    words += [f"roulette {survival:g}"] if survival is not None else []
    lamp, paint = (emission, 0.0, edge), (own_albedo, albedo, edge)
    return closed_form_scene(
        ", ".join(words),
        formula,
        arguments,
        wall_radiance(walk, (0.0, 0.0, -1.0), radius=radius, survival=chance, lamp=lamp, paint=paint),
        SOURCE,
        geometry=f"A hollow diffuse sphere of radius {radius:g}; a cap about its top shines, seen from its bottom.",
        law=lambda _: Law(*variance_and_kurtosis(moments)),
    )


def smooth_wall(
    emission: float = 2.0, slope: float = 1.5, albedo: float = 0.7, bounces: int = 4, radius: float = 2.0
) -> AnalyticScene:
    """Return the radiance that leaves the pole z = R of a wall that emits ``emission`` (1 + ``slope`` z^2/R^2)."""
    # z/R is uniform on [-1, 1], so the mean of its 2i-th power is 1/(2i + 1).
    moments = [emission**q * sum(math.comb(q, i) * slope**i / (2 * i + 1) for i in range(q + 1)) for q in range(1, 5)]
    walk = Walk(bounces, quadratic, everywhere)
    return closed_form_scene(
        "sphere with a smooth emission",
        functools.partial(smooth_wall_radiance, bounces=bounces),
        {"emission": emission, "slope": slope, "albedo": albedo},
        wall_radiance(walk, (0.0, 0.0, 1.0), radius=radius, lamp=(emission, slope), paint=(albedo,)),
        SOURCE,
        geometry=f"A hollow diffuse sphere of radius {radius:g} that emits more toward its poles, seen at a pole.",
        law=lambda _: Law(*variance_and_kurtosis_of_sum(albedo ** np.arange(1, bounces + 1), moments)),
    )


def lamp_in_sphere(
    power: float = 10.0, offset: float = 0.8, radius: float = 2.0, albedo: float = 0.6, bounces: int = 4
) -> AnalyticScene:
    """Return the radiance that leaves the wall at (R, 0, 0) where an isotropic point of ``power`` is at (0, 0, offset).

    What is reflected once depends on where the lamp is; all that is reflected twice or more does not.
    ``power`` [W], lengths in metres. Raises ``ValueError`` unless 0 <= offset < radius, and for bounces < 1.
    """
    if not 0 <= offset < radius or bounces < 1:
        raise ValueError(f"0 <= offset < radius and bounces >= 1 are needed; got {offset}, {radius} and {bounces}")
    z, weight = NODES
    reflected = albedo * power / (4 * math.pi**2) * (radius - offset * z)
    reflected /= (radius**2 + offset**2 - 2 * radius * offset * z) ** 1.5
    moments = [weight @ reflected**q / 2 for q in range(1, 5)]
    lamp = (power, offset, radius, albedo)
    walk = Walk(bounces - 1, lit_by_a_point, everywhere)
    return closed_form_scene(
        "point lamp in a sphere",
        functools.partial(lamp_in_sphere_radiance, bounces=bounces),
        {"power": power, "offset": offset, "radius": radius, "albedo": albedo},
        wall_radiance(walk, (1.0, 0.0, 0.0), radius=radius, lamp=lamp, paint=(albedo,)),
        SOURCE + "; inverse-square law; moments by Gauss-Legendre quadrature",
        geometry=f"A hollow diffuse sphere of radius {radius:g}; a point lamp hangs {offset:g} above its centre.",
        law=lambda _: Law(*variance_and_kurtosis_of_sum(albedo ** np.arange(1, bounces), moments)),
    )


def lit_cap_radiance(emission, albedo, half_angle, bounces, fewest=1):
    """Return Le f sum_{k=fewest..bounces} rho^k, where f is the cap's share of the sphere; bounces may be math.inf."""
    return painted_cap_radiance(emission, albedo, half_angle, albedo, bounces, fewest)


def painted_cap_radiance(emission, albedo, half_angle, cap_albedo, bounces, fewest=1):
    """Return Le f rho sum_k a^(k - 1) for a cap of its own albedo; a is the mean albedo over the sphere."""
    share = cap_share(half_angle)
    mean_albedo = share * cap_albedo + (1.0 - share) * albedo
    scattered = mean_albedo ** (fewest - 1) * geometric_sum(mean_albedo, bounces - fewest + 1)
    return emission * share * albedo * scattered


def lit_cap_variance(emission, albedo, half_angle, survival=1.0):
    """Return the variance of an endless path in the sphere of ``lit_cap``; ``survival`` 1 is no roulette.

    With A = q/(1 - q), q = rho^2/p: Le^2 (f A (1 + 2 f rho/(1 - rho)) - (f rho/(1 - rho))^2); infinite for q >= 1.
    """
    share, square = cap_share(half_angle), albedo**2 / survival
    tame = jnp.where(square < 1, square, 0.0)
    total, following = tame / (1.0 - tame), share * albedo / (1.0 - albedo)
    variance = emission**2 * (share * total * (1.0 + 2.0 * following) - following**2)
    return jnp.where(square < 1, variance, jnp.inf)


def smooth_wall_radiance(emission, slope, albedo, bounces):
    """Return Le (1 + a) + Le (1 + a/3) sum_{k=1..n} rho^k: the mean of z^2/R^2 is 1/3; bounces may be math.inf."""
    return emission * (1.0 + slope) + emission * (1.0 + slope / 3.0) * albedo * geometric_sum(albedo, bounces)


def lamp_in_sphere_radiance(power, offset, radius, albedo, bounces):
    """Return rho/pi (E + P/(4 pi R^2) sum_{k=1..n-1} rho^k), E = P R/(4 pi (R^2 + c^2)^(3/2)); bounces may be inf."""
    direct = power * radius / (4.0 * jnp.pi * (radius**2 + offset**2) ** 1.5)
    mean = power / (4.0 * jnp.pi * radius**2)
    return albedo / jnp.pi * (direct + mean * albedo * geometric_sum(albedo, bounces - 1))


def cap_share(half_angle):
    """Return the share of a sphere's area in a cap of ``half_angle``; between any two parts of one sphere it is also
    the view factor to the cap: the kernel is constant.

    Source: Howell, A catalog of radiation heat transfer configuration factors, section C.
    """
    return (1.0 - jnp.cos(half_angle)) / 2.0


def _probability(survival):
    if not 0 < survival <= 1:
        raise ValueError(f"survival must be a probability in (0, 1]; got {survival}")
    return survival
