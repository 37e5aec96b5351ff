"""Closed forms of enclosures, view factors and walks: against figures of 40 digits, quadrature and enumeration."""

import functools
import itertools
import json
import math
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy import integrate

import analytic_scenes as scenes
from analytic_scenes import (
    chains,
    enclosures,
    exchange,
    furnace,
    integrating_sphere,
    roulette,
    throughput,
    view_factors,
)

RTOL = 1e-10
# Computed once with mpmath, 40 digits, independently of this code.
FIGURES = {entry["id"]: entry for entry in json.loads((Path(__file__).parent / "data/enclosures.json").read_text())}


def one_albedo(albedo, **fixed):
    return throughput.throughput_moment(albedo, albedo, **fixed)


FORMULAS = {
    "lamp over a floor rectangle": functools.partial(
        exchange.mean_irradiance, factor=view_factors.parallel_rectangles_factor
    ),
    "one-albedo moment": one_albedo,
    "one-albedo variance": lambda albedo, events: (
        one_albedo(albedo, events=events, power=2) - one_albedo(albedo, events=events) ** 2
    ),
}
MODULES = (furnace, enclosures, integrating_sphere, view_factors, throughput, roulette)
irradiance = jax.jit(scenes.sphere_irradiance)
FAMILIES = (furnace, enclosures, integrating_sphere, exchange, throughput, roulette)
SCENES = tuple(scene for family in FAMILIES for scene in family.default_scenes() if scene.formula)


def close(value, reference, rel=RTOL):
    assert value == pytest.approx(reference, rel=rel, abs=0)


def formula_of(entry):
    name = entry["formula"]
    found = [FORMULAS[name]] if name in FORMULAS else [getattr(m, name) for m in MODULES if hasattr(m, name)]
    fixed = {key: math.inf if value == "inf" else value for key, value in entry.get("fixed", {}).items()}
    return functools.partial(found[0], **fixed)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_with_20_digits(name):
    entry = FIGURES[name]
    exact, gradient = scenes.value_and_derivatives(formula_of(entry), **entry["parameters"])
    close(exact, float(entry["value"]))
    for key, figure in entry["derivatives"].items():
        argument, *component = key.split(".")
        derivative = gradient[argument]
        close(derivative[int(component[0])] if component else derivative, float(figure))


def test_figures_of_whole_scenes():
    close(scenes.throughput_walk(events=5).exact_kurtosis - 3, 19.249175851701994062)
    assert scenes.log_throughput(events=5).exact_variance == 5.0
    deep = scenes.lit_cap(3.0, 0.75, math.pi / 6, bounces=120)
    close(deep.exact_variance, float(FIGURES["R06"]["value"]))
    deep = scenes.lit_cap(3.0, 0.75, math.pi / 6, bounces=120, survival=0.75)
    close(deep.exact_variance, float(FIGURES["R07"]["value"]))
    close(roulette.roulette_furnace(0.6, 0.7, bounces=120).exact_variance, float(FIGURES["R01e"]["value"]))
    close(roulette.roulette_furnace(0.6, 0.7, bounces=120, guaranteed=3).exact_variance, float(FIGURES["R04"]["value"]))
    uniform = roulette.roulette_furnace(0.5, 0.8, bounces=120, directions="uniform")
    close(uniform.exact_variance, float(FIGURES["R05"]["value"]))
    close(scenes.absorption_furnace(0.6, 0.7, bounces=120).exact_variance, float(FIGURES["R03"]["value"]))
    close(scenes.path_length(0.7, bounces=120).exact_variance, float(FIGURES["R02v"]["value"]))
    facing, standing = unit_square_factors()
    close(facing + 4 * standing, 1.0)  # a cube is closed


@functools.cache
def unit_square_factors():
    facing, _ = scenes.value_and_derivatives(formula_of(FIGURES["V01a"]), **FIGURES["V01a"]["parameters"])
    standing, _ = scenes.value_and_derivatives(formula_of(FIGURES["V02a"]), **FIGURES["V02a"]["parameters"])
    return facing, standing


# ---------------------------------------------------------------------------------------- what every scene says


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_a_scene_agrees_with_its_formula(scene):
    exact, derivatives = scenes.value_and_derivatives(scene.formula, **scene.arguments)
    close(scene.exact, exact, rel=scene.tolerance)
    assert set(scene.derivatives) == set(scene.arguments) and scene.geometry and scene.source
    for name, derivative in scene.derivatives.items():
        assert derivatives[name] == pytest.approx(derivative, rel=RTOL, abs=1e-14)


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_derivatives_against_finite_differences(scene):
    def at(shift, name):
        moved = {**scene.arguments, name: np.add(scene.arguments[name], shift)}
        return scenes.value_and_derivatives(scene.formula, **moved)[0]

    for name, value in scene.arguments.items():
        for index in np.ndindex(np.shape(value)):
            step = np.zeros(np.shape(value))
            step[index] = 1e-5
            difference = (at(step, name) - at(-step, name)) / 2e-5
            assert np.asarray(scene.derivatives[name])[index] == pytest.approx(difference, rel=1e-7, abs=1e-8)


@pytest.mark.parametrize("scene", [s for s in SCENES if s.view], ids=lambda scene: scene.name)
def test_a_view_can_be_seen(scene):
    place, camera = scene.view()
    assert place.size > 0 and camera.width * camera.height > 1000


# ---------------------------------------------------------------------------------------- view factors


def nodes(count, low=0.0, high=1.0):
    x, weight = np.polynomial.legendre.leggauss(count)
    return low + (high - low) * (x + 1) / 2, weight * (high - low) / 2


def test_parallel_rectangles_against_quadrature_of_the_point_formula():
    def corner_factor(u, v):  # from a point to the rectangle [0, u] x [0, v] at height 1
        to_u, to_v = np.sqrt(1 + u * u), np.sqrt(1 + v * v)
        return (u / to_u * np.arctan(v / to_u) + v / to_v * np.arctan(u / to_v)) / (2 * math.pi)

    (x, wx), (y, wy) = nodes(24, 0.1, 0.3), nodes(24, 0.2, 0.5)
    ends = [(sign, end - x[:, None]) for sign, end in ((-1, 0.35), (1, 0.65))]
    other_ends = [(sign, end - y[None]) for sign, end in ((-1, 0.35), (1, 0.65))]
    factor = sum(s * t * corner_factor(u, v) for s, u in ends for t, v in other_ends)
    close(wx @ factor @ wy / 0.06 * 12 * math.pi, scenes.offset_rectangles().exact)
    shape = {"corner": (0.0, 0.0), "size": (2.0, 1.0), "other_corner": (0.0, 0.0), "other_size": (2.0, 1.0)}
    general, _ = scenes.value_and_derivatives(view_factors.parallel_rectangles_factor, **shape, distance=0.5)
    close(general, scenes.facing_rectangles(2.0, 1.0, 0.5).exact)


def test_standing_rectangle_against_quadrature_of_the_point_formula():
    def corner_factor(width, distance):  # from a point to a wall of height 2 with a corner straight ahead
        slant = np.hypot(2.0, distance)
        return (np.arctan(width / distance) - distance / slant * np.arctan(width / slant)) / (2 * math.pi)

    # To the power of 5, so that points crowd at the ends of the common edge, where the irradiance is not smooth.
    t, weight = nodes(80)
    t, weight = t**5, weight * 5 * t**4
    mean = 2 * weight @ corner_factor(1.5 * t[:, None], 0.5 * t[None]) @ weight
    close(mean, scenes.standing_rectangle(0.5, 2.0, 1.5).exact)


def test_disks_against_quadrature_of_the_point_formula():
    def point_factor(r):  # from an element at distance r of the axis to a parallel disk
        square = r**2 + 0.25 + 1.0
        return (1 - (r**2 + 0.25 - 1.0) / math.sqrt(square**2 - 4 * r**2)) / 2

    mean, _ = integrate.quad(lambda r: 2 * r * point_factor(r), 0.0, 0.5, epsabs=1e-13)
    close(mean / 0.25, scenes.coaxial_disks(0.5, 1.0, 0.5).exact)


@pytest.mark.parametrize(
    ("radius", "other", "distance"), [(1.0, 1.0, 3.0), (0.1, 0.2, 0.5), (0.2, 0.1, 0.5), (1.0, 5.0, 6.01)]
)
def test_spheres_against_quadrature_of_the_point_formula(radius, other, distance):
    def ring(angle):
        toward = np.array([distance - radius * math.cos(angle), -radius * math.sin(angle)])
        length = np.hypot(*toward)
        theta = math.acos(np.clip(toward @ (math.cos(angle), math.sin(angle)) / length, -1, 1))
        return float(irradiance(1 / math.pi, other, length, theta)) * math.sin(angle) / 2

    # The horizon of the receiver touches the other sphere at the first angle, and hides it from the second on.
    ends = [0.0, math.acos((radius + other) / distance), math.acos((radius - other) / distance)]
    with jax.enable_x64(True):
        parts = [integrate.quad(ring, a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(ends)]
    close(sum(parts), scenes.two_spheres(radius, other, distance).exact)


def test_round_table_against_quadrature_of_the_point_formula():
    def ring(r):
        return 2 * r * float(irradiance(1.0, 0.5, math.hypot(1.2, r), math.atan(r / 1.2))) / 0.64

    with jax.enable_x64(True):
        mean, _ = integrate.quad(ring, 0.0, 0.8, epsabs=1e-13)
    close(mean, scenes.sphere_over_disk().exact)


def test_small_spheres_are_points():
    # A distant sphere sees another as a disk: F = r^2/(4 D^2), to the next order.
    close(scenes.two_spheres(0.01, 0.02, 1.0).exact, 0.02**2 / 4, rel=1e-3)


# ---------------------------------------------------------------------------------------- radiosity


def test_two_surfaces_against_a_linear_system():
    matrix = np.array([[0.0, 1.0], [0.64, 0.36]])  # shares of what leaves: from the inner sphere, from the outer
    albedo, emission = np.diag([0.6, 0.8]), np.array([1.0, 0.3])
    for bounces in (None, 5):
        scene = scenes.concentric_spheres(0.8, 1.0, *emission, 0.6, 0.8, bounces=bounces)
        series = sum(np.linalg.matrix_power(albedo @ matrix, k) @ emission for k in range(6))
        whole = np.linalg.solve(np.eye(2) - albedo @ matrix, emission)
        close(scene.exact, (whole if bounces is None else series)[1], rel=1e-8)


def test_empty_room_at_equilibrium_against_radiosity():
    facing, standing = unit_square_factors()
    opposite = np.roll(np.eye(6), 3, axis=1)
    matrix = facing * opposite + standing * (1 - np.eye(6) - opposite)
    albedo = np.array(scenes.kirchhoff_room().arguments["albedos"])
    radiance = np.linalg.solve(np.eye(6) - albedo[:, None] * matrix, 1.0 - albedo)
    close(radiance, np.ones(6))


def test_mean_irradiance_in_the_sphere_against_quadrature():
    # From the cap to the opposite pole: distance 2 R cos(t/2), and both angles have the cosine cos(t/2).
    kernel, _ = integrate.quad(lambda t: 2 * math.pi * math.sin(t) / (math.pi * 4), 0, 1.1, epsabs=1e-14)
    close(scenes.lit_cap(2.0, 0.4, 1.1, bounces=1).exact, 0.4 * 2.0 * kernel)
    z, weight = nodes(200, -1.0, 1.0)
    at_wall = 10 / (4 * math.pi) * (2 - 0.8 * z) / (4 + 0.64 - 3.2 * z) ** 1.5
    close(weight @ at_wall / 2, 10 / (4 * math.pi * 4))
    direct = scenes.lamp_in_sphere(bounces=1)
    close(direct.exact, 0.6 / math.pi * irradiance_at_equator())
    assert direct.exact_variance == 0.0


def irradiance_at_equator():
    return 10 * 2 / (4 * math.pi * (4 + 0.64) ** 1.5)


# ---------------------------------------------------------------------------------------- moments by enumeration


def moments_of(values, chances):
    return [chances @ values**q for q in (1, 2, 3, 4)]


def walk_values(start, bounces, emission, steps):
    """Yield (chance, collected) of every walk; ``steps(class)`` lists (chance, weight, next class) of an event."""

    def continued(state, chance, beta, collected, left):
        collected += beta * emission[state]
        if left == 0:
            yield chance, collected
            return
        for part, weight, following in steps(state):
            yield from continued(following, chance * part, beta * weight, collected, left - 1)

    return np.array(list(continued(start, 1.0, 1.0, 0.0, bounces))).T


def check_spread(scene, chance, collected):
    assert chance.sum() == pytest.approx(1.0)
    close(scene.exact, chance @ collected)
    variance = chance @ (collected - scene.exact) ** 2
    close(scene.exact_variance, variance)
    close(scene.exact_kurtosis, chance @ (collected - scene.exact) ** 4 / variance**2)


def test_cap_sphere_against_all_its_walks():
    share, albedo, emission = 0.25, (0.2, 0.75), (3.0, 0.0)

    def steps(state):
        return [(share, albedo[state], 0), (1 - share, albedo[state], 1)]

    check_spread(scenes.lit_cap(cap_albedo=0.2), *walk_values(1, 4, emission, steps))

    def with_roulette(state):
        alive = [(0.9 * chance, albedo / 0.9, following) for chance, albedo, following in same(state)]
        return [*alive, (0.1, 0.0, 1)]

    def same(state):
        return [(share, 0.75, 0), (1 - share, 0.75, 1)]

    check_spread(scenes.lit_cap(survival=0.9), *walk_values(1, 4, emission, with_roulette))


def test_concentric_spheres_against_all_walks():
    def cosine_steps(state):
        return [(1.0, 0.5, 1)] if state == 0 else [(0.25, 0.7, 0), (0.75, 0.7, 1)]

    check_spread(scenes.concentric_spheres(), *walk_values(1, 3, (1.0, 0.5), cosine_steps))

    # Products of a few weights 2 rho cos are polynomials: quadrature over each cosine is exact.
    edge = math.sqrt(0.75)

    def uniform_steps(state):
        pieces = [(0.0, 1.0, 1)] if state == 0 else [(edge, 1.0, 0), (0.0, edge, 1)]
        albedo = (0.5, 0.7)[state]
        return [(w, 2 * albedo * c, following) for low, high, following in pieces for c, w in zip(*nodes(3, low, high))]

    check_spread(scenes.concentric_spheres(directions="uniform"), *walk_values(1, 3, (1.0, 0.5), uniform_steps))


def test_plates_and_roulette_against_all_walks():
    def plate_steps(state):
        return [(w, 2 * (0.9, 0.4)[state] * c, 1 - state) for c, w in zip(*nodes(3))]

    check_spread(scenes.parallel_plates(directions="uniform"), *walk_values(0, 4, (1.0, 0.25), plate_steps))

    def roulette_steps(state):
        return [(0.3, 0.0, 0), *((0.7 * w, 2 * 0.6 * c / 0.7, 0) for c, w in zip(*nodes(3)))]

    scene = roulette.roulette_furnace(0.6, 0.7, bounces=4, directions="uniform")
    check_spread(scene, *walk_values(0, 4, (1.0,), roulette_steps))
    with jax.enable_x64(True):
        variance = furnace.furnace_variance(0.6, 1.0, 4, survival=0.7, directions="uniform")
    close(scene.exact_variance, float(variance))


def test_deaths_are_enumerated():
    albedo, p, n = 0.6, 0.7, 5
    chance = np.array([(1 - p) * p**k for k in range(n)] + [p**n])
    worth = np.array([(albedo / p) ** k / (1 - p) for k in range(n)] + [(albedo / p) ** n])
    check_spread(scenes.absorption_furnace(albedo, p, bounces=n), chance, worth)
    check_spread(scenes.path_length(p, bounces=n), chance, np.arange(n + 1.0))


def test_sums_of_independent_terms_against_quadrature():
    z, weight = nodes(12, -1.0, 1.0)
    values = 2.0 * (1 + 1.5 * z**2)
    factors = 0.7 ** np.arange(1, 3)
    total = 5.0 + np.add.outer(factors[0] * values, factors[1] * values).ravel()
    check_spread(scenes.smooth_wall(bounces=2), np.outer(weight, weight).ravel() / 4, total)
    with pytest.raises(AssertionError):  # a wrong power: variances add with the squares of the factors
        variance = chains.variance_and_kurtosis_of_sum(factors**0.5, moments_of(values, weight / 2))[0]
        close(variance, scenes.smooth_wall(bounces=2).exact_variance)


def test_moments_that_diverge_are_infinite():
    for survival, directions in ((0.5, "cosine"), (0.8, "uniform")):
        with jax.enable_x64(True):
            critical = float(scenes.critical_roulette_albedo(survival, directions))
            for albedo, finite in ((critical - 1e-6, True), (critical + 1e-6, False)):
                variance = furnace.furnace_variance(albedo, 1.0, math.inf, survival, directions)
                assert math.isfinite(variance) == finite
    assert math.isinf(scenes.furnace_moments(0.9, math.inf, "uniform")[1])
    endless = chains.path_moments((1.0, 0.0), np.full((4, 2, 2), 0.6), math.inf)
    assert np.isinf(endless).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: scenes.kirchhoff_room(bounces=0),
        lambda: scenes.ball_under_sky(bounces=0),
        lambda: scenes.concentric_spheres(2.0, 1.0),
        lambda: scenes.parallel_plates(albedo=1.0, other_albedo=1.0, bounces=None),
        lambda: scenes.lit_cap(half_angle=4.0),
        lambda: scenes.lit_cap(survival=0.0),
        lambda: scenes.lit_cap(bounces=1, fewest=2),
        lambda: scenes.lamp_in_sphere(offset=2.0),
        lambda: scenes.two_spheres(2.0, 2.0, 3.0),
        lambda: scenes.sphere_over_disk(radius=2.0),
        lambda: scenes.inner_sphere(1.0, 0.5),
        lambda: scenes.roulette_furnace(survival=1.5),
        lambda: scenes.roulette_furnace(guaranteed=-1),
        lambda: scenes.absorption_furnace(survival=1.0),
        lambda: scenes.path_length(survival=0.0),
        lambda: scenes.throughput_walk(events=0),
        lambda: scenes.log_throughput(albedo=0.0),
        lambda: scenes.throughput_exceedance(threshold=-1.0),
        lambda: furnace.furnace_variance(0.5, 1.0, 3, directions="bsdf"),
    ],
)
def test_impossible_scenes_are_refused(make):
    with pytest.raises(ValueError, match=r"got"):
        make()
