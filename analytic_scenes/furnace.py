"""White furnaces: closed rooms of one albedo in which every surface emits, so the radiance is the same everywhere.

After at most n scattering events L_n = Le (1 + rho + ... + rho^n), for any shape of room and any start of the ray.
With cosine-distributed directions every path returns exactly that (zero variance); with uniform directions every moment
is still exact, because the weights 2 rho cos of a path are independent whatever the room looks like.
"""

import math

import jaxmc as mc
from analytic_scenes.scene import AnalyticScene, variance_and_kurtosis

SOURCE = "Neumann series of the rendering equation (Kajiya, The rendering equation, 1986); white-furnace test"
NEGLIGIBLE = 1e-9  # what `bounces=None` leaves out, relative to the whole: below the rounding of float32


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
    scene = mc.Scene(_inward_cube(mc.Diffuse(albedo), emission))
    view = (0.3, 0.6, 0.4), (0.36, 0.48, -0.8)
    return _furnace("cube", scene, view, albedo, emission, bounces, directions, lights)


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
    view = (0.3 * radius, -0.2 * radius, 0.1 * radius), (0.36, 0.48, -0.8)
    return _furnace("sphere", mc.Scene([wall]), view, albedo, emission, bounces, directions, lights)


def furnace_radiance(albedo, emission, bounces):
    """Return the radiance Le sum_{k=0..n} rho^k after at most ``bounces`` scattering events; math.inf is allowed.

    The sum is written out, not as a quotient, so that its derivative is right at albedo 1 too.
    """
    if bounces == math.inf:
        return emission / (1.0 - albedo)
    total = 1.0
    for _ in range(bounces):
        total = 1.0 + albedo * total
    return emission * total


def furnace_moments(albedo: float, bounces: float, directions: str, emission: float = 1.0) -> tuple[float, ...]:
    """Return E S, E S^2, E S^3, E S^4 of one path of at most ``bounces`` scattering events (math.inf is allowed).

    S_n = Le + w S_(n-1) with independent weights w gives E S_n^q = sum_j binomial(q, j) Le^(q-j) E[w^j] E[S_(n-1)^j],
    where E w^j is rho^j for cosine directions and (2 rho)^j / (j + 1) for uniform ones. A moment that diverges is inf.
    """
    if directions not in ("cosine", "uniform"):
        raise ValueError(f'directions must be "cosine" or "uniform"; got {directions!r}')
    weight = [albedo**j * (2**j / (j + 1) if directions == "uniform" else 1) for j in range(5)]
    if bounces == math.inf:
        moments = [1.0]
        for q in range(1, 5):
            finite = weight[q] < 1 and moments[-1] < math.inf
            moments.append(_binomial_sum(q, q, weight, moments) / (1 - weight[q]) if finite else math.inf)
    else:
        moments = [1.0] * 5
        for _ in range(bounces):
            moments = [_binomial_sum(q, q + 1, weight, moments) for q in range(5)]
    return tuple(emission**q * moments[q] for q in range(1, 5))


def _binomial_sum(q, terms, weight, moments):
    return sum(math.comb(q, j) * weight[j] * moments[j] for j in range(terms))


def _furnace(room, scene, view, albedo, emission, bounces, directions, lights):
    name = f"{room} furnace, {directions} directions"
    if lights != "none":
        name += f", lights={lights}"
    if bounces is None:
        if albedo >= 1:
            raise ValueError(f"an endless furnace needs albedo < 1; got {albedo}. Give a number of bounces")
        bounces = math.ceil(math.log(NEGLIGIBLE) / math.log(albedo)) if albedo > 0 else 0
    integrand = mc.radiance(scene, *view, bounces=bounces, directions=directions, lights=lights)
    per_emission = furnace_radiance(albedo, 1.0, bounces)
    slope = emission * sum(k * albedo ** (k - 1) for k in range(1, bounces + 1))
    derivatives = {"albedo": slope, "emission": per_emission}
    variance, kurtosis = None, None
    if lights == "none":
        variance, kurtosis = variance_and_kurtosis(furnace_moments(albedo, bounces, directions, emission))
    return AnalyticScene(name, integrand, emission * per_emission, variance, kurtosis, derivatives, SOURCE)


def _inward_cube(material, emission):
    o, x, y, z = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    faces = [(o, y, z), (o, z, x), (o, x, y), (x, z, y), (y, x, z), (z, y, x)]
    return [mc.Quad(*face, material=material, emission=emission) for face in faces]
