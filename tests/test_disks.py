"""Disks: where they are, no self-hits, and the light that they give, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxmc as mc
from analytic_scenes import moving
from jaxmc.testing import assert_unbiased
from jaxmc.transport import facts, flats, hits, rays
from jaxmc.transport.vec import Vec3

BLACK, SLOW = mc.Diffuse(0.0), pytest.mark.slow
TURN = Rotation.from_euler("xyz", (0.3, -0.7, 1.1)).as_matrix()
UP = TURN[2]
LIGHT = {"emission": 5.0, "radius": 0.9, "height": 0.8, "offset": 0.5}
EXACT = float(moving.disk_over_receiver(**LIGHT))
HOLE = (2.0, 3.0, 4.0)  # where receivers stand


def lamp(turned=-1.0, **options):
    """Return a disk light over HOLE, in a turned frame; -1: it shines down."""
    center = np.array(HOLE) + LIGHT["height"] * UP + LIGHT["offset"] * TURN[0]
    return mc.Disk(center, 7.0 * turned * UP, LIGHT["radius"], BLACK, LIGHT["emission"], **options)


def irradiance(*primitives, **options):
    return mc.irradiance(mc.Scene(primitives), HOLE, UP, bounces=0, **options)


def check(integrand, exact=EXACT, n=1 << 18, precision=4e-3):
    fresh = mc.Integrand(lambda u, *p: integrand.fn(u, *p), integrand.dim, integrand.params, integrand.lazy)
    assert_unbiased(mc.integrate(fresh, n=n, key=1), exact, precision)


@pytest.mark.parametrize("lights", ["mis", *(pytest.param(how, marks=SLOW) for how in ("nee", "none"))])
def test_a_disk_light_gives_what_the_closed_form_says(lights):
    check(irradiance(lamp(), lights=lights))


@SLOW
def test_a_light_over_its_receiver():
    scene = mc.Scene([mc.Disk((0, 0, 2.0), (0, 0, -1), 0.5, BLACK, 5.0)])
    integrand = mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=0, lights="nee")
    check(integrand, float(moving.coaxial_disk(5.0, 0.5, 2.0)), n=1 << 16, precision=5e-4)


def test_light_leaves_on_the_side_of_the_normal_or_on_both():
    assert mc.integrate(irradiance(lamp(1.0), lights="mis"), n=1 << 12).mean == 0.0
    check(irradiance(lamp(1.0, two_sided=True), lights="nee"))


def test_the_same_light_as_an_integral_over_its_area():
    assert mc.integrate(mc.irradiance_by_areas(mc.Scene([lamp(1.0)]), HOLE, UP), n=1 << 12).mean == 0.0
    check(mc.irradiance_by_areas(mc.Scene([lamp(1.0, two_sided=True)]), HOLE, UP))


def test_a_blocker_hides_what_is_behind_it():
    # The part of the light behind a coaxial blocker is a disk too.
    light = mc.Disk((0, 0, 2.0), (0, 0, -1), 1.0, BLACK, 5.0)
    blocker = mc.Disk((0, 0, 0.5), (0, 0, 1), 0.2, BLACK)
    exact = moving.coaxial_disk(5.0, 1.0, 2.0) - moving.coaxial_disk(5.0, 0.2, 0.5)
    check(mc.irradiance(mc.Scene([light, blocker]), (0, 0, 0), (0, 0, 1), bounces=0, lights="mis"), float(exact))


@SLOW
def test_a_white_disk_under_a_white_sky():
    # What it receives it sends on, and it does not see itself: albedo times sky, whatever the number of events.
    scene = mc.Scene([mc.Disk(HOLE, UP, 0.7, mc.Diffuse(0.5))], sky=2.0)
    start = np.array(HOLE) + UP + 0.3 * TURN[0]
    found = mc.integrate(mc.radiance(scene, start, -UP - 0.2 * TURN[0], bounces=3, lights="none"), n=1 << 12)
    assert np.allclose(found.mean, 1.0, rtol=1e-6) and found.variance < 1e-10


# ------------------------------------------------------------------------------------------------------- geometry


def test_points_of_a_disk_know_it_and_do_not_meet_it_again():
    disk, rng = mc.Disk(HOLE, UP, 0.7), np.random.default_rng(1)
    scene = mc.Scene([disk, mc.Sphere((9, 9, 9), 0.1)])
    n = 50_000
    share, turn = np.sqrt(rng.uniform(size=(n, 1))), rng.uniform(0.0, 2.0 * np.pi, (n, 1))
    inside = HOLE + 0.7 * share * (np.cos(turn) * TURN[0] + np.sin(turn) * TURN[1])
    wi = rng.normal(size=(n, 3))

    @jax.jit
    @jax.vmap
    def follow(origin, direction):
        point = Vec3(*origin)
        own = hits.face_at(scene, point)
        return own, hits.closest_hit(scene, rays.ray(point, Vec3(*direction)), own).face

    own, met = follow(*(jnp.asarray(x, float) for x in (scene.local(inside), wi)))
    # Rounding takes some of the points next to the rim off the disk.
    assert np.mean(own == 0) > 0.9999 and not np.any(np.asarray(met) == 0)
    outside = HOLE + 0.7 * (1.0 + 0.01 * share) * (inside - HOLE) / (0.7 * share)
    for points in (outside, inside + 0.01 * UP):
        assert np.all(follow(*(jnp.asarray(x, float) for x in (scene.local(points), wi)))[0] == scene.size)


def test_a_disk_along_an_axis_costs_less_and_a_scene_without_disks_nothing():
    level, tilted = (mc.Scene([mc.Disk((0, 0, 1), normal, 1.0)]).shapes[0] for normal in ((0, 0, -2), UP))
    assert level.normal is None and level.axis == 2 and level.row_u.y is None and level.row_v.x is None
    assert tilted.axis is None and None not in tilted.row_u
    quad = mc.Scene([mc.Quad((0, 0, 1), (1, 0, 0), (0, 1, 0))]).shapes[0]
    assert not quad.disk and jax.tree.structure(quad) != jax.tree.structure(level)


def test_what_a_disk_touches_and_where_it_reaches():
    # It stands on the floor by its rim: the whole scene is on one side of the floor, but not of the disk.
    floor = mc.Quad((-2, -2, 0), (4, 0, 0), (0, 4, 0))
    for normal in ((1, 0, 0), (1, 0, 1), (1, 2, 3)):
        tilt = np.hypot(*normal[:2]) / np.linalg.norm(normal)
        standing = mc.Disk((0, 0, 0.5 * tilt), normal, 0.5)
        assert mc.Scene([floor, standing]).casters == (1,)
        assert mc.Scene([floor, mc.Disk((0, 0, 0.49 * tilt), normal, 0.5)]).casters == (0, 1)
        low, high = facts._box(standing)
        assert np.allclose([low[2], high[2]], [0.0, tilt]) and np.all(high - low <= 1.0 + 1e-12)
    level = mc.Scene([floor, mc.Disk((0, 0, 0), (0, 0, -3), 0.5), mc.Sphere((0, 0, 1), 0.5)])
    assert level.twins == ((1,), (0,), ()) and level.casters == (2,)


def test_many_disks_are_a_table_and_shine_like_few():
    few = [lamp(), mc.Disk((3, 3, 9), (0, 0, 1), 0.1)]
    many = [*few, *(mc.Disk((20.0 + 2 * k, 0, 0), (1, 2, 3), 0.5, BLACK, 1e-9) for k in range(20))]
    assert not mc.Scene(few).tables and len(mc.Scene(many).tables) == 1 and not mc.Scene(many).shapes
    check(irradiance(*many, lights="nee", pick="distance"))


# -------------------------------------------------------------------------------------------------------- mutants


def crowded_at_the_middle(right):
    return lambda light, u1, u2: right(light, u1 * u1, u2)


def half_of_it(right):
    return lambda light, u1, u2: right(light, u1, 0.5 * u2)


def whole_square(right):
    def wrong(light, u1, u2):
        return light.center + light.half_u * (2.0 * u1 - 1.0) + light.half_v * (2.0 * u2 - 1.0)

    return wrong


@pytest.mark.parametrize("mutate", [crowded_at_the_middle, pytest.param(half_of_it, marks=SLOW), whole_square])
def test_the_check_rejects_a_mutant(mutate, monkeypatch):
    monkeypatch.setattr(flats, "point_on", mutate(flats.point_on))
    with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
        check(irradiance(lamp(), lights="nee"))


def test_a_disk_that_holds_its_square_is_found(monkeypatch):
    monkeypatch.setattr(flats.FlatShape, "holds", lambda self, u, v: (jnp.abs(u) <= 1.0) & (jnp.abs(v) <= 1.0))
    with pytest.raises(AssertionError, match=r"^the mean is more than 5 standard errors off"):
        check(irradiance(lamp(), lights="none"), precision=1e-2)
