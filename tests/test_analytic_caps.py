"""What circles on the sphere of directions enclose, against quadrature and brute force that share no code with it."""

import math

import jax
import numpy as np
import pytest
from scipy import integrate
from scipy.stats import qmc

from analytic_scenes import caps, laws, mirror_balls
from analytic_scenes.irradiance import parallelogram_irradiance
from analytic_scenes.scene import value_and_derivatives, value_of
from jaxmc.testing import SIGMAS

UP = np.array([0.0, 0.0, 1.0])
NETS, POINTS = 32, 2**13


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


def shared(rows, normal=UP):
    return value_of(caps.caps_irradiance, {"caps": np.asarray(rows), "normal": normal})


def cap(axis, degrees):
    return np.append(unit(axis), math.cos(math.radians(degrees)))


@pytest.mark.parametrize("seed", range(8))
def test_two_caps_against_a_quadrature_over_the_polar_angle(seed):
    rng = np.random.default_rng(seed)
    half_1, half_2 = rng.uniform(0.1, 0.5, 2)
    apart = rng.uniform(abs(half_1 - half_2), half_1 + half_2)
    tilt = unit([*rng.normal(size=2), 4.0])
    sideways = unit(np.cross(tilt, rng.normal(size=3)))
    other = tilt * math.cos(apart) + sideways * math.sin(apart)

    def azimuth(polar):
        cosine = (math.cos(half_2) - math.cos(polar) * math.cos(apart)) / (math.sin(polar) * math.sin(apart))
        return math.acos(min(1.0, max(-1.0, cosine)))

    def ring(polar, power):
        phi = azimuth(polar)
        along, across = math.cos(polar) * tilt[2] * phi, math.sin(polar) * sideways[2] * math.sin(phi)
        return 2 * math.sin(polar) * (along + across if power else phi)

    # Between these angles the ring about the first axis enters the second cap, where the integrand has a root.
    ends = sorted((abs(apart - half_2), half_1))
    pieces = [(0.0, ends[0]), tuple(ends)]
    lens, solid_angle = (sum(integrate.quad(ring, *p, args=(k,), epsabs=1e-13)[0] for p in pieces) for k in (1, 0))
    rows = [np.append(tilt, math.cos(half_1)), np.append(other, math.cos(half_2))]
    assert shared(rows) == pytest.approx(lens, rel=1e-7)
    overlap = value_of(caps.caps_overlap, {"first": rows[0], "second": rows[1]})
    assert overlap == pytest.approx(solid_angle, rel=1e-7)


def test_caps_apart_and_one_in_the_other():
    big, small, far = cap(UP, 40), cap((0.2, 0.1, 1.0), 10), cap((1.0, 0.0, 1.0), 3)
    alone = math.pi * math.sin(math.radians(10)) ** 2 * small[2]
    assert shared([big, small]) == pytest.approx(alone, rel=1e-12)
    assert shared([small, far]) == 0.0
    solid_angle = 2 * math.pi * (1 - small[3])
    assert value_of(caps.caps_overlap, {"first": big, "second": small}) == pytest.approx(solid_angle, rel=1e-12)
    assert value_of(caps.caps_overlap, {"first": far, "second": small}) == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_caps_that_touch_or_are_the_same(seed):
    rng = np.random.default_rng(seed)
    axis, half_1, half_2 = unit(rng.normal(size=3)), *rng.uniform(0.05, 1.2, 2)
    sideways = unit(np.cross(axis, rng.normal(size=3)))

    def overlap(half_1, half_2, apart):
        other = math.cos(apart) * axis + math.sin(apart) * sideways
        given = {"first": np.append(axis, math.cos(half_1)), "second": np.append(other, math.cos(half_2))}
        value, gradient = value_and_derivatives(caps.caps_overlap, **given)
        assert np.isfinite(np.concatenate(list(gradient.values()))).all()
        return value

    # A circle that rounding moves by 1e-8 cuts off little of the other one.
    inside, whole = (2 * math.pi * (1 - math.cos(half)) for half in (min(half_1, half_2), half_1))
    assert overlap(half_1, half_2, abs(half_1 - half_2)) == pytest.approx(inside, abs=1e-6)
    assert overlap(half_1, half_2, half_1 + half_2) == pytest.approx(0.0, abs=1e-6)
    assert overlap(half_1, half_1, 0.0) == pytest.approx(whole, abs=1e-6)
    assert overlap(half_1, half_1, 1e-9) == pytest.approx(whole, abs=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_parallelogram_against_the_polygon_formula(seed):
    rng = np.random.default_rng(seed)
    corner, u, v, normal = rng.normal(size=(4, 3))
    if np.cross(u, v) @ corner > 0:
        u, v = v, u
    quad, normal = {"corner": corner, "edge_u": u, "edge_v": v}, unit(normal)
    polygon = value_of(parallelogram_irradiance, {"emission": 1.0, **quad, "normal": normal})
    with jax.enable_x64(True):
        rows = np.asarray(caps.parallelogram_caps(**quad))
    assert shared(rows, normal) == pytest.approx(polygon, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_any_caps_against_brute_force(seed):
    rng = np.random.default_rng(100 + seed)
    axes = [unit([*rng.normal(size=2), rng.uniform(-0.3, 1.5)]) for _ in range(4)]
    rows = np.array([cap(axis, degrees) for axis, degrees in zip(axes, rng.uniform(35, 110, 4))])
    shares = []
    for net in range(NETS):
        u = qmc.Sobol(2, rng=np.random.default_rng(net)).random(POINTS)
        radius, azimuth = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
        w = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - u[:, 0])])
        shares.append(np.all(rows[:, :3] @ w > rows[:, 3:], axis=0).mean())
    stderr = math.pi * np.std(shares, ddof=1) / math.sqrt(NETS)
    assert stderr < 1e-3
    assert abs(shared(rows) - math.pi * np.mean(shares)) <= SIGMAS * stderr


def test_circles_that_coincide_count_once():
    standing = {"corner": (0.0, 1.0, 0.0), "edge_u": (0.7, 0.0, 0.0), "edge_v": (0.0, 0.0, 0.9)}
    with jax.enable_x64(True):
        rows = np.asarray(caps.parallelogram_caps(**standing))
        hanging = np.asarray(caps.parallelogram_caps(**{**standing, "edge_v": (0.0, 0.0, -0.9)}))
    on_the_floor = value_of(parallelogram_irradiance, {"emission": 1.0, **standing, "normal": UP})
    assert shared(rows) == pytest.approx(on_the_floor, rel=1e-12)
    assert shared(hanging) == 0.0
    assert shared([*rows, *rows]) == pytest.approx(on_the_floor, rel=1e-12)
    assert shared([cap(UP, 30), cap(UP, 30)]) == pytest.approx(math.pi / 4, rel=1e-12)
    assert shared(np.zeros((0, 4))) == pytest.approx(math.pi, rel=1e-12)


def test_nodes_integrate_the_directions_they_stand_for():
    center, radius = np.array([0.4, -0.2, 1.5]), 0.7
    cone, lune = laws.sphere_nodes(center, radius), laws.lune_nodes(UP, unit([1.0, 0.3, -0.4]))
    assert cone.solid_angles @ cone.directions[:, 2] == pytest.approx(
        math.pi * radius**2 * center[2] / np.linalg.norm(center) ** 3, rel=1e-13
    )
    angle = math.acos(unit([1.0, 0.3, -0.4])[2])
    assert lune.solid_angles.sum() == pytest.approx(2 * (math.pi - angle), rel=1e-12)
    assert lune.solid_angles @ lune.directions[:, 2] == pytest.approx(math.pi * (1 + math.cos(angle)) / 2, rel=1e-12)
    assert lune.directions[:, 2].min() > 0
    # A quad so close that 48 nodes a side do not integrate it has no law.
    near = {"corner": (-5.0, -5.0, 0.05), "edge_u": (0.0, 10.0, 0.0), "edge_v": (10.0, 0.0, 0.0)}
    far = {**near, "corner": (-5.0, -5.0, 9.0)}
    assert laws.of_parallelogram(lambda nodes: laws.law_of_light(UP, nodes, 1.0), **near) is None
    assert laws.of_parallelogram(lambda nodes: laws.law_of_light(UP, nodes, 1.0), **far) is not None


def test_small_light_in_a_mirror_ball_is_a_point_light():
    """The image of a sphere against Coddington's equations, which know nothing of its outline."""
    place = {"center": np.array([1.5, 0.3, 0.8]), "ball_center": np.array([0.0, 0.1, 2.0]), "ball_radius": 0.7}
    radius = 1e-3
    direct, whole = (
        value_of(
            mirror_balls.in_mirror_ball_irradiance,
            {"emission": 1.0, "reflectance": reflectance, "radius": radius, **place},
        )
        for reflectance in (0.0, 1.0)
    )
    point = {"light": place.pop("center"), **place, "point": np.zeros(3), "intensity": math.pi * radius**2}
    assert whole - direct == pytest.approx(value_of(mirror_balls.caustic_irradiance, point), rel=1e-5)


def test_far_point_light_over_a_mirror_ball_is_parallel():
    far = 1e6
    point = {"intensity": 3.0 * far**2, "light": (0.0, 0.0, far), "ball_center": (0.0, 0.0, 2.0), "ball_radius": 1.0}
    near = value_of(mirror_balls.caustic_irradiance, {**point, "point": (2.2, 0.0, 0.0)})
    parallel = value_of(
        mirror_balls.parallel_caustic_irradiance, {"irradiance": 3.0, "radius": 1.0, "height": 2.0, "distance": 2.2}
    )
    assert near == pytest.approx(parallel, rel=1e-5)


def test_caustic_of_an_annulus_is_the_mean_of_its_points():
    arguments = {"irradiance": 3.0, "radius": 1.0, "height": 2.0}

    def ring(distance):
        return 2 * distance * value_of(mirror_balls.parallel_caustic_irradiance, {**arguments, "distance": distance})

    points, weights = np.polynomial.legendre.leggauss(20)
    mean = 0.5 * weights @ [ring(3.0 + 0.5 * x) for x in points] / (3.5**2 - 2.5**2)
    annulus = value_of(mirror_balls.annulus_caustic_irradiance, {**arguments, "inner": 2.5, "outer": 3.5})
    assert annulus == pytest.approx(mean, rel=1e-11)


@pytest.mark.slow
def test_derivatives_of_many_circles_against_differences():
    rng = np.random.default_rng(3)
    rows = np.array([cap(unit([*rng.normal(size=2), 0.5]), degrees) for degrees in (60, 75, 90, 50)])
    _, gradient = value_and_derivatives(caps.caps_irradiance, {"normal": UP}, caps=rows)
    for index in np.ndindex(rows.shape):
        step = np.zeros(rows.shape)
        step[index] = 1e-5
        difference = (shared(rows + step) - shared(rows - step)) / 2e-5
        assert gradient["caps"][index] == pytest.approx(difference, rel=1e-6, abs=1e-8)
