"""Light transport where numbers are strained: what is promised there, measured in float32 beside float64.

The cases are those of ``jaxmc study stability``; here each kind is checked with few points. Mutants take away what
keeps a promise, and the same check must fail.
"""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.cli import main
from jaxmc.studies import closed_rooms, stability, strained_rays, strained_scenes, stress, walks
from jaxmc.transport import bsdfs, facts, geometry, hits, paths, rays, vec, warps
from jaxmc.transport.vec import Vec3

SLOW = pytest.mark.slow
CASES = strained_scenes.all_cases()
BY_NAME = {(c.group, c.name): c for c in CASES}
QUICK = {"apart", "small light", "emission", "touching", "lit sphere: radius 1e+06",
         "lamp in a ceiling: tilted", "lamp on a black sphere", "mirror: albedo 1"}  # fmt: skip


def is_quick(case):
    lamps = case.group in ("scaled", "moved", "edge-on") and not case.name.startswith(("room", "upright"))
    return lamps or case.group in QUICK or case.name in QUICK


def measure(case):
    return stress.measure(case, 64 if case.group == stability.LONG else 1 << 14)


def some_slow(items, quick, name):
    return [pytest.param(x, id=name(x), marks=[] if quick(x) else SLOW) for x in items]


# ---------------------------------------------------------------------------------------------------- promises


@pytest.mark.parametrize("case", some_slow(CASES, is_quick, lambda c: f"{c.group}: {c.name}"))
def test_a_case_keeps_its_promise(case):
    measured = measure(case)
    assert measured.keeps(case.promise), measured


def no_middle(right):
    return lambda primitives: right(primitives)._replace(middle=np.zeros(3))


def nothing_large(right):
    return lambda primitives: right(primitives)._replace(large=())


def no_twins(right):
    def wrong(*args):
        touch = right(*args)
        return touch._replace(twins=((),) * len(touch.twins))

    return wrong


def no_step_to_unit_length(right):
    return lambda direction, normal: direction - normal * (2.0 * vec.dot(direction, normal))


MUTANTS = [  # what is taken away, where, and the case that shows it
    (no_middle, facts, "layout", ("moved", "quad lamp: + 1.3e+06")),
    pytest.param(nothing_large, facts, "layout", ("sphere", "lit sphere: radius 1e+06"), marks=SLOW),
    (no_twins, facts, "touch", ("coincident", "lamp in a ceiling: tilted")),
    pytest.param(no_step_to_unit_length, paths, "reflect", ("1000 events", "mirror: albedo 1"), marks=SLOW),
]


@pytest.mark.parametrize(("mutate", "module", "name", "case"), MUTANTS, ids=lambda x: getattr(x, "__name__", ""))
def test_without_what_keeps_it_a_promise_is_broken(mutate, module, name, case, monkeypatch):
    case = BY_NAME[case]
    monkeypatch.setattr(module, name, mutate(getattr(module, name)))

    def fresh():
        # A function that no cache has seen is traced with the code as it is now.
        f = case.make()
        return dataclasses.replace(f, fn=lambda u, *params: f.fn(u, *params))

    assert not measure(case._replace(make=fresh)).keeps(case.promise)


def test_a_check_of_a_promise_can_fail():
    case, kept = BY_NAME["scaled", "quad lamp: x 1.3"], stress.Measured(0.0, 0.0, 0.0, 1e-3, 0, 100)
    assert kept.keeps(1e-5)
    for fault in ({"rounding": 2e-5}, {"rounding": -2e-5}, {"wide": 6e-3}, {"nonfinite": 1}, {"rounding": np.nan}):
        assert not kept._replace(**fault).keeps(1e-5), fault
    # A wrong exact value shows in float64.
    assert not stress.measure(case._replace(exact=1.05 * case.exact)).keeps(case.promise)


@pytest.mark.slow
def test_no_default_scene_has_a_bias_in_float32():
    cases = stress.bias_cases("analytic_scenes:ALL")
    assert len(cases) >= 11
    for case in cases:
        measured = stress.measure(case, 1 << 20)
        assert measured.error <= 2e-7 and measured.keeps(case.promise), (case.name, measured)


def test_the_bias_is_that_of_common_points():
    # Numbers that float32 holds are sampled exactly: nothing is left to differ.
    u = stress.common_points(1000, 3)
    assert u.dtype == np.float32 and u.min() > 0.0 and u.max() < 1.0
    narrow, wide = stress.in_both(lambda: mc.Integrand(lambda u: u[0] + 0.0, 3), u)
    np.testing.assert_array_equal(narrow, wide)
    narrow, wide = stress.in_both(lambda: mc.Integrand(lambda u: u[0] * u[1], 3), u)
    assert 0.0 < np.abs(narrow / wide - 1.0).max() < 2.0**-23
    with pytest.raises(ValueError, match="module:name"):
        stress.bias_cases("analytic_scenes:NONE")


# ---------------------------------------------------------------------------------------------------- closed rooms

ROOMS = closed_rooms.rooms()


def check_walk(room, events):
    found = walks.count(*room, events=events, bounces=1000)
    expected = {"events": events, "escapes": 0, "self-hits": 0, "inside a ball": 0, "not finite": 0}
    assert found == expected


@pytest.mark.parametrize("name", some_slow(ROOMS, {"sphere, uniform"}.__contains__, str))
def test_ten_million_events_in_a_closed_room(name):
    check_walk(ROOMS[name], 10_000_000)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["box, uniform", "sphere, uniform"])
def test_a_thousand_million_events_in_a_closed_room(name):
    check_walk(ROOMS[name], 1_000_000_000)


@pytest.mark.slow
def test_other_ways_to_leave_a_surface_are_found_out():
    scene, *rest = ROOMS["sphere, uniform"]
    found = walks.count(walks.bare(scene), *rest, next_hit=walks.exclusion, events=100_000, bounces=100)
    assert found["escapes"] == 1000 == found["events"]  # each path is out after its first event
    leaks, acne = (closed_rooms.rates(walks.Offset(1e-4), size, 100_000) for size in (1e-3, 1e4))
    assert leaks["escapes"] > 500 and acne["self-hits"] > 1000


@pytest.mark.slow
def test_a_sphere_loses_rays_that_lie_in_its_tangent_plane(monkeypatch):
    for module in (warps, bsdfs):
        monkeypatch.setattr(module, "grazing", lambda: 0.0)
    monkeypatch.setattr(walks, "sample_diffuse", lambda *args: bsdfs.sample_diffuse(*args))
    jax.clear_caches()
    scene, *rest = ROOMS["sphere, uniform"]
    assert walks.count(scene, *rest, events=300_000_000, bounces=1000)["escapes"] > 0
    jax.clear_caches()


@pytest.mark.slow
def test_surfaces_that_cut_each_other_lose_few_rays():
    found = walks.count(*closed_rooms.pierced_room(), events=10_000_000, bounces=1000)
    assert found["escapes"] + found["inside a ball"] <= 1e-5 * found["events"]


# ---------------------------------------------------------------------------------------------------- rays


def test_no_ray_slips_through_edges_and_corners():
    for aimed in strained_rays.edges(1 << 18):
        assert aimed.rays == 1 << 18 and aimed.slipped == 0, aimed


def test_walls_that_do_not_overlap_let_rays_through(monkeypatch):
    monkeypatch.setattr(geometry, "_rounding", lambda frame, grain: 0.0)
    assert sum(aimed.slipped for aimed in strained_rays.edges(1 << 18)) > 100


@pytest.mark.parametrize("sine", [1e-1, 1e-3, 1e-6])
def test_a_grazing_ray_is_as_exact_as_its_direction(sine):
    error = strained_rays.grazing(sine)
    assert error[False] <= strained_scenes.EPS / sine and error[True] <= 4.0 * 2.0**-52 / sine


def test_rays_in_the_plane_of_a_quad_neither_hit_nor_fail():
    quad = mc.Quad((-1, 0, -1), (0, 0, 2), (2, 0, 0))
    for turn in (np.eye(3), strained_scenes.TURN):
        tilted = mc.Quad(turn @ quad.corner, turn @ quad.edge_u, turn @ quad.edge_v)
        starts = np.array([[-3, 0, 0.2], [0.3, 0, 0.1], [-2, 0, -2], [-1, 1, -1], [-1, 1, 0]], float)
        toward = np.array([[1, 0, 0], [1, 0, 0.2], [1, 0, 1], [0, -1, 0], [0, -1, 0]], float)
        found = mc.intersect(mc.Scene([tilted]), starts @ turn.T, toward @ turn.T)
        assert not np.isnan(found.distance).any()
        assert (np.asarray(found.distance)[:3] > 1e-6).all()
        # A ray through a corner or an edge meets the quad or misses it; if it does, where it should.
        distance = np.asarray(found.distance)[3:]
        assert (np.isinf(distance) | (np.abs(distance - 1.0) < 1e-6)).all()


# ---------------------------------------------------------------------------------------------------- numbers


@pytest.mark.slow
def test_values_are_sound_at_the_ends_of_the_unit_interval():
    for name, (wrong, n) in strained_rays.at_limits().items():
        assert wrong == 0 and n > 20, name


@pytest.mark.parametrize("warp", [warps.sample_cosine_hemisphere, warps.sample_uniform_hemisphere])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.36, 0.48, -0.8), (1e-8, 0, -1)])
def test_no_direction_lies_below_its_surface(warp, normal):
    ends = np.array([0.0, 2.0**-33, 2.0**-24, 0.25, 0.5, 0.75, strained_rays.LAST], jnp.result_type(float))
    u1, u2 = (x.ravel() for x in np.meshgrid(ends, ends))
    n = Vec3(*(np.asarray(c, jnp.result_type(float)) for c in normal))
    kind = "cosine" if warp is warps.sample_cosine_hemisphere else "uniform"
    wi, pdf, weight = jax.jit(lambda a, b: bsdfs.sample_diffuse(kind, n, a, b))(u1, u2)
    cosine = np.asarray(vec.dot(wi, n))
    assert (cosine > 0.0).all() and np.isfinite(pdf).all() and np.isfinite(weight).all()
    np.testing.assert_allclose(vec.dot(wi, wi), 1.0, atol=2e-6)


def test_overflow_is_counted():
    found = strained_rays.overflow()
    assert 1000 < found["beyond float32"] < 1 << 14
    # A value that lies at the largest float32 to rounding may fall on either side.
    assert found["NaN"] == 0 and abs(found["infinite"] - found["beyond float32"]) <= 2
    assert found["reported"] == found["infinite"]


LAMP = mc.Sphere((0, 0, 3), 0.5, mc.Diffuse(0.0), emission=1.0)
LOST = [
    (lambda: mc.Sphere((0, 0, 0), 1e-300), "a Sphere has a length of 1e-300"),
    (lambda: mc.Sphere((1e300, 0, 0), 1.0), r"a Sphere has a length of 1e\+300"),
    (lambda: mc.Quad((0, 0, 0), (1e130, 0, 0), (0, 1, 0)), r"a Quad has a length of 1e\+130"),
    (lambda: dataclasses.replace(LAMP, emission=1e-310), "emission 1e-310 lies outside"),
]


@pytest.mark.parametrize(("make", "message"), LOST)
def test_numbers_that_the_kernel_would_lose_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        mc.Scene([make()])
    with pytest.raises(ValueError, match="sky 1e-310 lies outside"):
        mc.Scene([LAMP], sky=1e-310)


def test_what_float32_would_lose_is_held_in_float64():
    dim, small = dataclasses.replace(LAMP, emission=1e-40), mc.Quad((0, 0, 0), (1e-20, 0, 0), (0, 1e-20, 0))
    for primitive, message in ((dim, "emission 1e-40 lies outside float32"), (small, "a Quad has a length of 1e-20")):
        with jax.enable_x64(False), pytest.raises(ValueError, match=message):
            mc.Scene([primitive])
    with jax.enable_x64(True):
        seen = mc.irradiance(mc.Scene([dim]), (0, 0, 0), (0, 0, 1), bounces=0)
        assert seen.batch(np.full((1, seen.dim), 0.5))[0] == pytest.approx(1e-40 * np.pi / 36.0, rel=1e-2)


# ---------------------------------------------------------------------------------------------------- facts


def cube(turn=1.0, shift=0.0):
    turn = np.eye(3) * turn
    return [mc.Quad(turn @ c + shift, turn @ u, turn @ v) for c, u, v in strained_scenes.cube()]


def test_a_scene_far_from_the_origin_is_given_relative_to_its_middle():
    at = np.array([1e5, -3e4, 7.0])
    far, near = mc.Scene(cube(shift=at)), mc.Scene(cube())
    np.testing.assert_allclose(far.middle, at + 0.5, atol=0.01)
    assert not np.any(near.middle) and near.reach == pytest.approx(np.sqrt(3.0))
    np.testing.assert_array_equal(np.float32(far.middle), far.middle)
    found = mc.intersect(far, [at + 0.25], [[0.0, 0.0, 1.0]])
    assert found.distance[0] == pytest.approx(0.75, rel=1e-6)
    np.testing.assert_allclose(found.point[0], at + np.array([0.25, 0.25, 1.0]), rtol=1e-6)
    # Points of a replayed path are where the user put the scene.
    camera = mc.PinholeCamera(at + 0.5, at + np.array([0.5, 0.5, 0.0]), width=4, height=4)
    path = mc.replay(far, camera, 5, bounces=1)
    assert (np.abs(path.vertices[0].point - at - 0.5) <= 0.5 + 1e-6).all()


def test_a_ground_does_not_count_for_where_a_scene_lies():
    ball, ground = mc.Sphere((5, 1, 5), 1.0), mc.Sphere((5, -1e4, 5), 1e4)
    scene = mc.Scene([ball, ground])
    np.testing.assert_allclose(scene.middle, (5, 1, 5))
    assert scene.shapes[0].power is None and scene.shapes[1].power is not None
    assert mc.Scene([ball, mc.Sphere((5, -4, 5), 4.0)]).shapes[1].power is None
    assert mc.Scene([mc.Sphere((0, 0, 0), 1e4)]).shapes[0].power is None


def test_quads_overlap_where_they_touch_and_only_there():
    lamp = mc.Quad((0.3, 0.9, 0.3), (0.4, 0, 0), (0, 0, 0.4))
    limits = [q.limit for q in mc.Scene([*cube(), lamp]).shapes]
    assert all(1.0 < limit < 1.0 + 1e-5 for limit in limits[:6]) and limits[6] == 1.0
    standing = mc.Quad((0.3, 0.0, 0.3), (0.4, 0, 0), (0, 0.5, 0))
    assert mc.Scene([*cube(), standing]).shapes[6].limit > 1.0


@pytest.mark.parametrize("turn", [np.eye(3), strained_scenes.TURN])
def test_what_lies_on_one_plane_or_sphere_is_one_surface(turn):
    ceiling = mc.Quad(turn @ (-1, -1, 1), turn @ (2, 0, 0), turn @ (0, 2, 0))
    in_it = mc.Quad(turn @ (0.1, -0.2, 1), turn @ (0, 0.3, 0), turn @ (0.5, 0, 0))
    below = mc.Quad(turn @ (0.1, -0.2, 1 - 1e-5), turn @ (0, 0.3, 0), turn @ (0.5, 0, 0))
    ball, same = mc.Sphere((0, 0, 0), 0.3), mc.Sphere((0, 0, 0), 0.3)
    scene = mc.Scene([ceiling, in_it, below, ball, same, mc.Sphere((0, 0, 0), 0.31)])
    assert scene.twins == ((1,), (0,), (), (4,), (3,), ()) and scene.tight
    ray = rays.ray(Vec3(*map(jnp.asarray, turn @ (0.2, 0.0, 1.0))), Vec3(*map(jnp.asarray, turn @ (0.0, 0.6, -0.8))))
    assert hits.closest_hit(scene, ray, 0).face == 2 == hits.closest_hit(scene, ray, 1).face


def test_a_point_of_a_lamp_does_not_see_it():
    flat = mc.Quad(*(strained_scenes.TURN @ x for x in ((0, 0, 0), (1, 0, 0), (0, 1, 0))), mc.Diffuse(0.5), 1e6)
    ball = mc.Sphere((3, 0, 0), 0.5, mc.Diffuse(0.5), 1e6)
    on_flat, on_ball, up = strained_scenes.TURN @ (0.3, 0.3, 0.0), (3.5, 0, 0), strained_scenes.TURN @ (0, 0, 1)
    views = [(flat, on_flat, up), (flat, on_flat, -up), (ball, on_ball, up), (ball, on_ball, (-1, 0, 0))]
    for lamp, point, normal in views:
        seen = mc.irradiance(mc.Scene([lamp]), point, normal, bounces=0, lights="nee")
        assert (np.asarray(seen.batch(stress.common_points(4096, seen.dim))) == 0.0).all()


def test_the_middle_of_a_shining_sphere_sees_it():
    room = mc.Scene([mc.Sphere((0.1, 0.2, 0.3), 0.7, mc.Diffuse(0.0), 1.0, inward=True)])
    seen = mc.irradiance(room, (0.1, 0.2, 0.3), (0, 0, 1), bounces=0, lights="nee")
    values = np.asarray(seen.batch(stress.common_points(1 << 16, seen.dim)), np.float64)
    error = values.std() / 2**8
    assert abs(values.mean() - np.pi) < 5.0 * error < 0.1


# ---------------------------------------------------------------------------------------------------- the study


@pytest.mark.slow
def test_the_study_says_all_of_it(tmp_path):
    settings = stability.Settings(events=20_000, points=1024, bias_points=1024, spp=2, scenes="analytic_scenes:ALL")
    page = stability.run(tmp_path, dataclasses.replace(settings, progress=False))
    report = json.loads((tmp_path / "report.json").read_text())
    values = report["values"]
    assert values["cases"] == values["promises kept"] == len(CASES)
    assert values["closed rooms: escapes"] == values["closed rooms: self-hits"] == values["values not finite"] == 0
    assert values["overflow"]["reported"] == values["overflow"]["infinite"] > 0
    assert {p.stem for p in page.parent.glob("*.png")} == {"errors", "self_intersection", "pictures"}


def test_settings_of_the_study_are_checked(capsys):
    with pytest.raises(ValueError, match="1000 to 2\\^40 events"):
        stability.Settings(events=1)
    assert main(["study", "stability", "--scenes", "nothing:ALL", "--quiet", "--out", "/tmp"]) == 2
    assert "module:name" in capsys.readouterr().err
