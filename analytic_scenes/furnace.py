"""White furnaces: closed rooms of one albedo in which every surface emits, so the radiance is the same everywhere.

After at most n scattering events L_n = Le (1 + rho + ... + rho^n), for any shape of room and any start of the ray.
With cosine-distributed directions every path returns exactly that (zero variance); with uniform directions every moment
is still exact, because the weights 2 rho cos of a path are independent whatever the room looks like.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

import jaxmc as mc
from analytic_scenes.chains import hemisphere_moments, path_moments
from analytic_scenes.scene import AnalyticScene, variance_and_kurtosis

SOURCE = "Neumann series of the rendering equation (Kajiya, The rendering equation, 1986); white-furnace test"
NEGLIGIBLE = 1e-9  # what `bounces=None` leaves out, relative to the whole: below the rounding of float32


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations: a cube and a sphere, each with and without variance."""
    return cube_furnace(), cube_furnace(directions="uniform"), sphere_furnace(), sphere_furnace(directions="uniform")


def cube_furnace(
    albedo: float = 0.5,
    emission: float = 1.0,
    bounces: int | None = 3,
    directions: str = "cosine",
    lights: str = "none",
) -> AnalyticScene:
    """Return the radiance inside the unit cube: six inward quads of one ``albedo`` that all emit ``emission``.

    bounces     number of scattering events n, or None for enough of them to reach Le/(1 - rho) to 1e-9
    directions  "cosine" (zero variance) or "uniform"
    lights      "none" for the estimator whose variance is exact; for "nee" and "mis" only the mean is
    Raises ``ValueError`` for bounces=None with albedo >= 1.
    """
    scene = mc.Scene(inward_cube([mc.Diffuse(albedo)] * 6, [emission] * 6))
    ray = (0.3, 0.6, 0.4), (0.36, 0.48, -0.8)
    return _furnace("cube", "the unit cube", scene, ray, albedo, emission, bounces, directions, lights)


def sphere_furnace(
    albedo: float = 0.5,
    emission: float = 1.0,
    bounces: int | None = 3,
    directions: str = "cosine",
    lights: str = "none",
    radius: float = 2.0,
) -> AnalyticScene:
    """Return the radiance inside a sphere of any ``radius``; the other arguments are those of ``cube_furnace``."""
    wall = mc.Sphere((0.0, 0.0, 0.0), radius, material=mc.Diffuse(albedo), emission=emission, inward=True)
    ray = (0.3 * radius, -0.2 * radius, 0.1 * radius), (0.36, 0.48, -0.8)
    room = f"a sphere of radius {radius:g}"
    return _furnace("sphere", room, mc.Scene([wall]), ray, albedo, emission, bounces, directions, lights)


def furnace_radiance(albedo, emission, bounces):
    """Return the radiance Le sum_{k=0..n} rho^k after at most ``bounces`` scattering events; math.inf is allowed.

    Source: the Neumann series.
    """
    return emission * geometric_sum(albedo, bounces + 1)


def geometric_sum(ratio, terms):
    """Return 1 + r + ... + r^(terms - 1); ``terms`` may be math.inf.

    Made of products and sums only, so that value and derivative are right at ratio 1 too: S_2m = S_m (1 + r^m).
    """
    if terms == math.inf:
        return 1.0 / (1.0 - ratio)
    total, power = 0.0, 1.0
    for digit in f"{terms:b}":
        total, power = total * (1.0 + power), power * power
        if digit == "1":
            total, power = 1.0 + ratio * total, ratio * power
    return total


def furnace_variance(albedo, emission, bounces, survival=1.0, directions="cosine", guaranteed=0):
    """Return the variance of one path of at most ``bounces`` scattering events; math.inf is allowed.

    ``survival`` is the probability of Russian roulette at each event but the first ``guaranteed`` ones. The weights of
    events are independent, with mean rho and mean square q: rho^2/p for cosine directions, 4 rho^2/(3 p) for uniform
    ones. So the variance of an endless path is Le^2 (q - rho^2) / ((1 - rho)^2 (1 - q)), and infinite for q >= 1.
    Works on floats and tracers.
    """
    without_roulette = albedo**2 * (4.0 / 3.0 if _checked(directions) == "uniform" else 1.0)
    square = without_roulette / survival
    if bounces == math.inf:
        tame = jnp.where(square < 1, square, 0.0)  # keeps the derivative of the unused branch finite
        mean = 1.0 / (1.0 - albedo)
        mean_square = jnp.where(square < 1, (1.0 + albedo) * mean / (1.0 - tame), jnp.inf)
    else:
        mean, mean_square = 1.0, 1.0
        for _ in range(bounces - guaranteed):
            mean, mean_square = 1.0 + albedo * mean, 1.0 + 2.0 * albedo * mean + square * mean_square
    for _ in range(min(guaranteed, bounces)):
        mean, mean_square = 1.0 + albedo * mean, 1.0 + 2.0 * albedo * mean + without_roulette * mean_square
    return emission**2 * (mean_square - mean**2)


def furnace_moments(albedo: float, bounces: float, directions: str, emission: float = 1.0) -> tuple[float, ...]:
    """Return E S, E S^2, E S^3, E S^4 of one path of at most ``bounces`` scattering events (math.inf is allowed).

    S_n = Le + w S_(n-1) with independent weights w, whose moments are those of one diffuse event: see ``path_moments``.
    A moment that diverges is inf.
    """
    weights = hemisphere_moments(_checked(directions), albedo)[:, None, None]
    return tuple(path_moments([emission], weights, bounces)[:, 0].tolist())


def _checked(directions):
    if directions not in ("cosine", "uniform"):
        raise ValueError(f'directions must be "cosine" or "uniform"; got {directions!r}')
    return directions


def enough_bounces(albedo: float) -> int:
    """Return how many events leave out less than 1e-9 of an endless path in a room whose largest albedo is ``albedo``.

    Raises ``ValueError`` for an albedo of 1 or more.
    """
    if albedo >= 1:
        raise ValueError(f"an endless path needs an albedo < 1; got {albedo}. Give a number of bounces")
    return math.ceil(math.log(NEGLIGIBLE) / math.log(albedo)) if albedo > 0 else 0


def _furnace(kind, room, scene, ray, albedo, emission, bounces, directions, lights):
    name = f"{kind} furnace, {directions} directions"
    if lights != "none":
        name += f", lights={lights}"
    bounces = enough_bounces(albedo) if bounces is None else bounces
    variance, kurtosis = None, None
    if lights == "none":
        variance, kurtosis = variance_and_kurtosis(furnace_moments(albedo, bounces, directions, emission))
    per_emission = furnace_radiance(albedo, 1.0, bounces)
    slope = emission * sum(k * albedo ** (k - 1) for k in range(1, bounces + 1))
    return AnalyticScene(
        name=name,
        integrand=mc.radiance(scene, *ray, bounces=bounces, directions=directions, lights=lights),
        exact=emission * per_emission,
        exact_variance=variance,
        exact_kurtosis=kurtosis,
        derivatives={"albedo": slope, "emission": per_emission},
        source=SOURCE,
        formula=functools.partial(furnace_radiance, bounces=bounces),
        arguments={"albedo": albedo, "emission": emission},
        geometry=f"The inside of {room}: diffuse, of one albedo and one emission; at most {bounces} bounces.",
        view=lambda: (scene, looking_along(*ray)),
    )


def looking_along(origin, direction, fov=90.0, width=128, height=96):
    """Return a camera at ``origin`` that looks along ``direction``, with +z up."""
    target = tuple(np.add(origin, direction).tolist())
    return mc.PinholeCamera(origin, target, up=(0.0, 0.0, 1.0), fov=fov, width=width, height=height)


def inward_cube(materials, emissions) -> list[mc.Quad]:
    """Return the six faces of the unit cube seen from inside: at x = 0, y = 0, z = 0, x = 1, y = 1, z = 1."""
    o, x, y, z = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    faces = [(o, y, z), (o, z, x), (o, x, y), (x, z, y), (y, x, z), (z, y, x)]
    return [mc.Quad(*face, material, emission) for face, material, emission in zip(faces, materials, emissions)]
