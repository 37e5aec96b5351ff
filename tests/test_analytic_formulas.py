"""The closed forms against figures that were computed once with 40 digits, independently of this code."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes as scenes
from jaxmc.testing import ThroughputProduct

RTOL = 1e-10
Q03 = {"corner": (0.5, -0.3, 1.2), "edge_u": (-0.2, 0.7, 0.4), "edge_v": (0.8, 0.3, 0.1)}
Q04 = {"corner": (1.0, -0.5, -0.4), "edge_u": (0.0, 0.0, 1.3), "edge_v": (0.0, 1.2, 0.0)}
Q04B = {"corner": (1.0, -1.0, -0.5), "edge_u": (-0.3, 0.4, 1.2), "edge_v": (0.5, 2.0, 0.2)}


def close(value, reference):
    assert value == pytest.approx(reference, rel=RTOL, abs=0)


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


@pytest.mark.parametrize(
    ("radius", "distance", "theta", "value", "derivatives"),
    [
        (0.5, 2.0, 0.0, 1.963495408493620774, {"radius": 7.8539816339744830962, "distance": -1.963495408493620774}),
        (0.5, 5**0.5, math.atan(0.5), 1.4049629462081452786, {"radius": 5.6198517848325811145}),
        (1.2, 2.0, math.radians(80), 2.7621436057273494993, {"theta": -7.2204922826516217504}),
        (1.2, 2.0, math.radians(100), 0.79822898436368858946, {"theta": -3.9174210047695061347}),
        (1.2, 2.0, math.radians(130), 0.0, {"theta": 0.0, "radius": 0.0}),
    ],
)
def test_sphere(radius, distance, theta, value, derivatives):
    exact, gradient = scenes.value_and_derivatives(
        scenes.sphere_irradiance, emission=10.0, radius=radius, distance=distance, theta=theta
    )
    close(exact, value)
    close({name: gradient[name] for name in derivatives}, derivatives)
    close(gradient["emission"], value / 10)


@pytest.mark.parametrize(("degrees", "reference"), [(80, 9.9060473103493163857), (100, 4.6689416533795539594)])
def test_sphere_cut_by_the_horizon_against_its_angular_radius(degrees, reference):
    _, gradient = scenes.value_and_derivatives(
        scenes.sphere_irradiance, emission=10.0, radius=1.2, distance=2.0, theta=math.radians(degrees)
    )
    close(gradient["radius"] * 2.0 * 0.8, reference)  # d radius / d sigma = distance cos(sigma)


def test_sphere_above_a_floor_moves_as_a_point_source():
    light = {"emission": 10.0, "reflectance": 0.0, "radius": 0.5, "center": (-1.0, 0.0, 2.0), "mirror_distance": 9.0}
    exact, gradient = scenes.value_and_derivatives(
        scenes.sphere_in_mirror_irradiance, {"mirror_normal": (0.0, 0.0, -1.0)}, **light
    )
    close(exact, 1.4049629462081452786)
    close(-gradient["center"][0], -0.84297776772488716718)
    close(gradient["center"][2], -0.98347406234570169504)


def test_sphere_is_continuous_where_the_horizon_touches_it():
    theta = math.pi / 2 - math.asin(0.6) + np.array([-1e-9, 1e-9])
    with jax.enable_x64(True):
        outside, inside = (float(scenes.sphere_irradiance(1.0, 1.2, 2.0, t)) for t in theta)
    assert inside == pytest.approx(outside, rel=1e-8)


def test_rectangle_under_a_corner():
    exact, gradient = scenes.value_and_derivatives(
        scenes.corner_rectangle_irradiance, emission=5.0, width=1.0, depth=0.6, height=0.8
    )
    close(exact, 2.0334395247733698575)
    close(gradient["height"], -2.3255715910414245048)
    close(gradient["width"], 0.62647503597158922657)
    quad = {"corner": (0.0, 0.0, 0.8), "edge_u": (0.0, 0.6, 0.0), "edge_v": (1.0, 0.0, 0.0)}
    exact, gradient = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **quad)
    close(exact, 2.0334395247733698575)
    close(gradient["corner"][2], -2.3255715910414245048)
    close(gradient["edge_v"][0], 0.62647503597158922657)


def test_centred_ceiling_light():
    quad = {"corner": (-1.2, -0.5, 2.0), "edge_u": (0.0, 1.0, 0.0), "edge_v": (1.0, 0.0, 0.0)}
    exact, gradient = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **quad)
    close(exact, 0.94392270313923671453)
    close(-gradient["corner"][0], -0.52154037818592948235)
    with jax.enable_x64(True):
        corners = [(x, y) for x in (-1.2, -0.2) for y in (-0.5, 0.5)]
        terms = [float(scenes.corner_rectangle_irradiance(5.0, x, y, 2.0)) for x, y in corners]
    close(terms[0] - terms[1] - terms[2] + terms[3], 0.94392270313923671453)


def test_rectangle_standing_on_the_receiver_plane():
    exact, gradient = scenes.value_and_derivatives(
        scenes.standing_rectangle_irradiance, emission=5.0, width=0.7, height=0.9, distance=1.0
    )
    close(exact, 0.63530781159741747245)
    close(gradient["distance"], -1.1530884593653837767)
    close(gradient["height"], 0.8216237558749700751)
    quad = {"corner": (0.0, 1.0, 0.0), "edge_u": (0.7, 0.0, 0.0), "edge_v": (0.0, 0.0, 0.9)}
    exact, gradient = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **quad)
    close(exact, 0.63530781159741747245)
    close(gradient["corner"][1], -1.1530884593653837767)
    close(gradient["edge_v"][2], 0.8216237558749700751)


@pytest.mark.parametrize(
    ("quad", "normal", "value", "derivatives"),
    [
        (Q03, (0.2, 0.1, 1.0), 0.90057346266465829302, {("corner", 0): -0.81984266670794199649}),
        (Q04, (0.0, 0.0, 1.0), 1.1332148787713539112, {("edge_u", 2): 1.4521250070626164279}),
        (Q04B, (-0.3, 0.2, 0.6), 0.23165277889065822299, {("corner", 2): 0.88478526294298116857}),
    ],
)
def test_parallelogram(quad, normal, value, derivatives):
    exact, gradient = scenes.value_and_derivatives(
        scenes.parallelogram_irradiance, {"normal": unit(normal)}, emission=5.0, **quad
    )
    close(exact, value)
    for (argument, component), reference in derivatives.items():
        close(gradient[argument][component], reference)


def test_bottom_edge_below_the_horizon_does_not_matter():
    _, gradient = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **Q04)
    assert gradient["corner"][2] - gradient["edge_u"][2] == pytest.approx(0.0, abs=1e-14)


def test_parallelogram_under_the_receiver_or_facing_away_is_dark():
    below = {"corner": (-3.0, -3.0, -1.0), "edge_u": (6.0, 0.0, 0.0), "edge_v": (0.0, 6.0, 0.0)}
    away = {"corner": Q03["corner"], "edge_u": Q03["edge_v"], "edge_v": Q03["edge_u"]}
    for quad in (below, away):
        exact, gradient = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **quad)
        assert exact == 0.0
        assert all(np.all(g == 0.0) for g in gradient.values())


def test_huge_slope_through_the_horizon_fills_its_part_of_the_hemisphere():
    tilt, size = math.radians(30), 1e7
    slope = size * np.array([math.cos(tilt), 0.0, math.sin(tilt)])
    quad = {"corner": (0.0, -size, 0.2) - slope, "edge_u": (0.0, 2 * size, 0.0), "edge_v": 2 * slope}
    exact, _ = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=1.0, **quad)
    assert exact == pytest.approx(math.pi * (1 + math.cos(tilt)) / 2, rel=1e-6)


def test_light_seen_in_a_mirror():
    light = {"corner": (0.2, -0.3, 2.0), "edge_u": (0.0, 0.6, 0.0), "edge_v": (0.6, 0.0, 0.0)}
    exact, gradient = scenes.value_and_derivatives(
        scenes.parallelogram_in_mirror_irradiance,
        {"mirror_normal": (1.0, 0.0, 0.0)},
        emission=5.0,
        reflectance=0.9,
        mirror_distance=1.0,
        **light,
    )
    direct, _ = scenes.value_and_derivatives(scenes.parallelogram_irradiance, emission=5.0, **light)
    close(exact - direct, 0.062270213498744626082)
    close(gradient["reflectance"] * 0.9, 0.062270213498744626082)
    close(gradient["mirror_distance"], -0.1212421441924021759)


FORMULAS = [
    (
        scenes.sphere_in_mirror_irradiance,
        {"mirror_normal": unit((0.3, 0.2, -1.0))},
        {"emission": 2.0, "reflectance": 0.7, "radius": 0.6, "center": (0.3, -0.5, 0.4), "mirror_distance": 1.5},
    ),
    (
        scenes.parallelogram_in_mirror_irradiance,
        {"mirror_normal": unit((1.0, 0.2, -0.6))},
        {"emission": 2.0, "reflectance": 0.7, "mirror_distance": 1.5, **Q04},
    ),
    (scenes.parallelogram_irradiance, {"normal": unit((-0.3, 0.2, 0.6))}, {"emission": 2.0, **Q04B}),
]


@pytest.mark.parametrize(("formula", "constants", "arguments"), FORMULAS, ids=lambda x: getattr(x, "__name__", ""))
def test_every_derivative_against_finite_differences(formula, constants, arguments):
    _, gradient = scenes.value_and_derivatives(formula, constants, **arguments)
    step = 1e-5
    for name, value in arguments.items():
        for index in np.ndindex(np.shape(value)):
            shift = np.zeros(np.shape(value))
            shift[index] = step
            high, low = (
                scenes.value_and_derivatives(formula, constants, **{**arguments, name: np.add(value, sign * shift)})[0]
                for sign in (1, -1)
            )
            assert np.asarray(gradient[name])[index] == pytest.approx((high - low) / (2 * step), rel=1e-7, abs=1e-9)


def test_furnace_radiance():
    scene = scenes.cube_furnace(albedo=0.8, emission=0.5, bounces=5)
    close(scene.exact, 1.84464)
    close(dict(scene.derivatives), {"albedo": 4.308, "emission": 1.84464 / 0.5})
    close(scenes.cube_furnace(albedo=0.8, emission=0.5, bounces=0).exact, 0.5)
    close(scenes.furnace_radiance(0.8, 0.5, math.inf), 2.5)
    endless = scenes.sphere_furnace(albedo=0.3, emission=1.0, bounces=None)
    assert endless.exact == pytest.approx(1.4285714285714285714, rel=1e-9)
    assert endless.derivatives["albedo"] == pytest.approx(2.0408163265306122449, rel=1e-7)
    with jax.enable_x64(True):
        close(float(jax.grad(scenes.furnace_radiance)(0.8, 0.5, 5)), 4.308)


def test_furnace_variance():
    close(
        scenes.cube_furnace(albedo=0.8, emission=0.5, bounces=5, directions="uniform").exact_variance,
        1.3661519282041152263,
    )
    m1, m2, *_ = scenes.furnace_moments(0.5, math.inf, "uniform", emission=0.5)
    close(m2 - m1**2, 0.125)
    assert scenes.furnace_moments(0.6, math.inf, "uniform") == pytest.approx((2.5, 7.6923, 29.1847, 135.978), rel=1e-5)
    assert scenes.cube_furnace(directions="cosine").exact_variance == 0.0
    assert scenes.cube_furnace(lights="mis").exact_variance is None


def test_furnace_moments_diverge_at_the_critical_albedos():
    close(scenes.critical_albedo(2), 0.86602540378443864676)
    for q in (2, 3, 4):
        rho = scenes.critical_albedo(q)
        assert math.isfinite(scenes.furnace_moments(rho - 1e-6, math.inf, "uniform")[q - 1])
        assert scenes.furnace_moments(rho + 1e-6, math.inf, "uniform")[q - 1] == math.inf


def test_throughput_product():
    scene = scenes.throughput_product(k=5, rho=0.8)
    close(scene.exact, 0.32768)
    close(scene.exact_variance, 0.34509973849547325103)
    close(scene.exact_kurtosis - 3, 19.249175851701994062)
    close(scene.derivatives["rho"], 2.048)
    close(scenes.throughput_product(k=1, rho=0.8).exact_variance, 0.21333333333333333333)
    u = jnp.array([0.5, 0.25, 1.0, 0.5, 0.5])
    assert float(scene.integrand.fn(u, *scene.integrand.params)) == pytest.approx(1.6**5 / 32, rel=1e-6)


@pytest.mark.parametrize(
    ("k", "rho", "t", "reference"),
    [
        (5, 0.8, 2.0, 0.026952497452943074067),
        (37, 1.0, 2342.368408, 0.000050777966791127783455),
        (37, 0.75, 2342.368408, 4.211276279479423824e-15),
    ],
)
def test_throughput_exceedance(k, rho, t, reference):
    close(float(ThroughputProduct(k, rho).exceedance(t)), reference)


@pytest.mark.parametrize(
    ("rho", "kappa"),
    [(0.6, 15.31), (0.7, 5.615), (math.sqrt(3) / 2, 2.0), (0.9, 1.672), (0.95, 1.293), (0.99, 1.053), (1.0, 1.0)],
)
def test_tail_index(rho, kappa):
    index = scenes.tail_index(rho)
    assert index == pytest.approx(kappa, rel=5e-4)
    close((2 * rho) ** index, 1 + index)


def test_tail_index_where_no_weight_exceeds_one():
    assert scenes.tail_index(0.5) == math.inf


@pytest.mark.parametrize(
    "make",
    [
        lambda: scenes.sphere_light(radius=2.0, distance=1.0),
        lambda: scenes.cube_furnace(albedo=1.0, bounces=None),
        lambda: scenes.throughput_product(k=0),
        lambda: scenes.tail_index(1.2),
        lambda: scenes.furnace_moments(0.5, 3, "bsdf"),
        lambda: scenes.sphere_light_in_mirror(center=(0.0, 0.0, -0.5)),
        lambda: scenes.sphere_light_in_mirror(radius=0.5, center=(0.0, 0.0, 1.0), mirror_distance=2.0),
    ],
)
def test_impossible_scenes_are_refused(make):
    with pytest.raises(ValueError, match=r"got|must|may"):
        make()
