"""Triangles, disks, boxes and tables of many shapes: closest hits against float64, no self-hits, no gaps, lights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import analytic_scenes
import jaxmc as mc
from jaxmc.studies import walks
from jaxmc.testing import assert_unbiased
from jaxmc.transport import hits, rays, shape_tables
from jaxmc.transport.vec import Vec3

BLACK, WHITE = mc.Diffuse(0.0), mc.Diffuse(1.0)
SLOW = pytest.mark.slow
TURN = Rotation.from_euler("xyz", (0.3, -0.7, 1.1)).as_matrix()
CORNER, EDGE_U, EDGE_V = (-0.6, -0.5, 0.6), (0.0, 1.0, 0.2), (1.2, 0.0, 0.0)


def random_primitives(kind, count, seed=3):
    """Return primitives of one kind, scattered in a box of size 4."""
    rng = np.random.default_rng(seed)
    return [primitive(kind, rng.uniform(-2, 2, 3), rng.uniform(0.1, 0.5, 3), rng) for _ in range(count)]


def primitive(kind, place, size, rng):
    turn = Rotation.random(rng=rng).as_matrix()
    u, v = 2.0 * size[:2, None] * turn[:2]
    if kind == "sphere":
        return mc.Sphere(place, size[0])
    if kind == "box":
        return mc.Box(place, size, turn)
    if kind == "disk":
        return mc.Disk(place, 3.0 * turn[2], size[0])
    return mc.Quad(place, u, v + 0.1 * turn[0]) if kind == "quad" else mc.Triangle(place, place + u, place + v)


def random_rays(count, seed=5):
    rng = np.random.default_rng(seed)
    origin, target = rng.uniform(-3, 3, (count, 3)), rng.uniform(-2, 2, (count, 3))
    direction = target - origin
    return origin.astype(np.float32), (direction / np.linalg.norm(direction, axis=1)[:, None]).astype(np.float32)


# What a float64 calculation of a different kind finds: planes and their corners, the quadratic of a sphere.


def flat_distances(corner, u, v, triangle, origin, direction):
    matrix = np.stack([np.broadcast_to(u, direction.shape), np.broadcast_to(v, direction.shape), -direction], -1)
    s, t, distance = np.linalg.solve(matrix, (origin - corner)[..., None])[..., 0].T
    inside = (s >= 0) & (t >= 0) & (s + t <= 1 if triangle else (s <= 1) & (t <= 1))
    return np.where(inside & (distance > 0), distance, np.inf)


def distances(primitive, origin, direction):
    if isinstance(primitive, mc.Sphere):
        offset = origin - primitive.center
        half, rest = (offset * direction).sum(1), (offset * offset).sum(1) - primitive.radius**2
        with np.errstate(invalid="ignore"):
            root = np.sqrt(half * half - rest)
        near, far = -half - root, -half + root
        return np.where(near > 0, near, np.where(far > 0, far, np.inf))
    if isinstance(primitive, mc.Quad):
        return flat_distances(primitive.corner, primitive.edge_u, primitive.edge_v, False, origin, direction)
    if isinstance(primitive, mc.Triangle):
        a, b, c = primitive.a, primitive.b, primitive.c
        return flat_distances(a, b - a, c - a, True, origin, direction)
    if isinstance(primitive, mc.Disk):
        distance = (primitive.center - origin) @ primitive.normal / (direction @ primitive.normal)
        away = np.linalg.norm(origin + distance[:, None] * direction - primitive.center, axis=1)
        return np.where((away <= primitive.radius) & (distance > 0), distance, np.inf)
    center, edges = np.asarray(primitive.center), np.asarray(primitive.size)[:, None] * np.asarray(primitive.axes)
    sides = []
    for k in range(3):
        for sign in (-1.0, 1.0):
            u, v = edges[(k + 1) % 3], edges[(k + 2) % 3]
            sides.append(flat_distances(center + 0.5 * (sign * edges[k] - u - v), u, v, False, origin, direction))
    return np.min(sides, 0)


@pytest.mark.parametrize(
    ("kind", "count"),
    [
        ("triangle", 3),
        ("box", 40),
        ("disk", 40),
        *(
            pytest.param(*case, marks=SLOW)
            for case in [("box", 3), ("disk", 3), ("triangle", 40), ("sphere", 40), ("quad", 40)]
        ),
    ],
)
def test_closest_hits_are_those_of_float64(kind, count):
    primitives, (origin, direction) = random_primitives(kind, count), random_rays(20_000)
    scene = mc.Scene(primitives)
    assert bool(scene.tables) == (count > shape_tables.MANY)
    found = mc.intersect(scene, origin, direction)
    wide = origin.astype(np.float64), direction.astype(np.float64)
    every = np.stack([distances(p, *wide) for p in primitives])
    nearest = every.min(0)
    expected = np.where(np.isfinite(nearest), every.argmin(0), -1)
    same = np.asarray(found.primitive) == expected
    # Rays that pass an edge by rounding may go either way.
    assert same.mean() > 0.9995 and (expected >= 0).mean() > 0.004
    hit = same & (expected >= 0)
    error = np.abs(np.asarray(found.distance)[hit] - nearest[hit])
    assert np.quantile(error, 0.999) < 2e-5
    # The normal of a box belongs to the face that was hit.
    point = wide[0][hit] + nearest[hit, None] * wide[1][hit]
    assert np.abs(point - np.asarray(found.point)[hit]).max(1).mean() < 1e-5
    assert ((np.asarray(found.normal)[hit] * wide[1][hit]).sum(1) <= 1e-5).all()


def test_normals_of_a_box_are_its_axes():
    box = mc.Box((0.3, -0.2, 0.1), (1.0, 2.0, 3.0), TURN)
    directions = np.concatenate([TURN, -TURN])
    found = mc.intersect(mc.Scene([box]), np.asarray(box.center) + 10.0 * directions, -directions)
    np.testing.assert_allclose(found.normal, directions, atol=1e-6)
    np.testing.assert_allclose(found.distance, 10.0 - np.array([0.5, 1.0, 1.5] * 2), rtol=1e-6)
    inside = mc.intersect(mc.Scene([box]), np.tile(box.center, (6, 1)), directions)
    np.testing.assert_allclose(inside.distance, [0.5, 1.0, 1.5] * 2, rtol=1e-6)
    np.testing.assert_allclose(inside.normal, -directions, atol=1e-6)


def test_rays_along_an_axis_and_along_a_face_are_finite():
    scene = mc.Scene([mc.Box((0, 0, 0), (2, 2, 2))])
    origins = [(-3, 0, 0), (-3, 1, 0), (-3, -1, 0), (-3, 1, 1), (-3, 1.5, 0), (0, 0, 0), (1, 0, 0)]
    found = mc.intersect(scene, np.array(origins, float), np.tile((1.0, 0.0, 0.0), (len(origins), 1)))
    assert not np.isnan(found.distance).any()
    assert found.distance[0] == 2.0 and np.isinf(found.distance[4]) and found.distance[5] == 1.0


@pytest.mark.parametrize("inward", [False, True])
def test_a_ray_from_a_face_of_a_box_does_not_meet_that_face(inward):
    box = mc.Box((0.1, 0.2, -0.3), (1.0, 0.6, 0.8), TURN, inward=inward)
    scene = mc.Scene([box])
    rng = np.random.default_rng(1)
    n = 60_000
    face = rng.integers(0, 6, n)
    local = rng.uniform(-1, 1, (n, 3))
    local[::3] = np.sign(local[::3]) * (1.0 - 1e-6 * rng.uniform(size=local[::3].shape))  # near edges and corners
    local[np.arange(n), face // 2] = np.where(face % 2, 1.0, -1.0)
    origin = np.asarray(box.center) + 0.5 * (local * box.size) @ TURN
    normal = np.where(face % 2, 1.0, -1.0)[:, None] * TURN[face // 2]
    wi = rng.normal(size=(n, 3))
    wi /= np.linalg.norm(wi, axis=1)[:, None]
    outward = (wi * normal).sum(1) > 0

    @jax.jit
    @jax.vmap
    def follow(origin, direction, own):
        return hits.closest_hit(scene, rays.ray(Vec3(*origin), Vec3(*direction)), own)

    found = follow(*(jnp.asarray(x, float) for x in (origin, wi)), face)
    away = np.abs((wi * normal).sum(1)) > 1e-5
    assert np.isinf(found.distance[outward & away]).all()
    inside = ~outward & away
    assert np.isfinite(found.distance[inside]).all() and (np.asarray(found.face)[inside] != face[inside]).all()


def closed_room(kind):
    if kind == "box":
        return [mc.Box((0.1, 0.2, 0.3), (1.0, 1.2, 0.8), TURN, WHITE, inward=True)]
    corners = [0.5 * np.array([1.0, 1.2, 0.8]) * s for s in np.array(np.meshgrid(*[(-1, 1)] * 3)).T.reshape(-1, 3)]
    from scipy.spatial import ConvexHull

    points = np.array(corners) @ TURN
    return [mc.Triangle(*points[list(s)], WHITE) for s in ConvexHull(points).simplices]


@pytest.mark.parametrize("kind", ["box", pytest.param("triangles", marks=SLOW)])
def test_no_ray_leaves_a_closed_room(kind):
    primitives = closed_room(kind)
    scene = mc.Scene(primitives)
    start = np.array((0.1, 0.2, 0.3)) if kind == "box" else np.zeros(3)
    found = walks.count(scene, start, (0.3, 0.4, 0.5), "uniform", events=2_000_000, bounces=100)
    assert found["events"] == 2_000_000 and found["escapes"] == 0 and found["not finite"] == 0
    assert kind == "box" or found["self-hits"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["box", "triangles"])
def test_no_ray_leaves_a_closed_room_in_a_thousand_million_events(kind):
    start = np.array((0.1, 0.2, 0.3)) if kind == "box" else np.zeros(3)
    found = walks.count(mc.Scene(closed_room(kind)), start, (0.3, 0.4, 0.5), "uniform", events=10**9, bounces=1000)
    assert found["escapes"] == 0 and found["not finite"] == 0


def test_no_ray_slips_between_two_triangles_of_a_wall():
    a, b, c, d = (TURN @ p for p in [(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)])
    scene = mc.Scene([mc.Triangle(a, b, c), mc.Triangle(a, c, d)])
    rng = np.random.default_rng(2)
    s = rng.uniform(0.01, 0.99, 100_000)[:, None]
    target = a + s * (c - a)
    origin = rng.normal(size=(100_000, 3)) * 3.0
    assert (np.asarray(mc.intersect(scene, origin, target - origin).primitive) >= 0).all()


# ---------------------------------------------------------------------------------------- lights of these shapes


def irradiance(primitives, **options):
    return mc.irradiance(mc.Scene(primitives), (0, 0, 0), (0, 0, 1), bounces=0, **options)


def exact_quad():
    given = {"emission": 5.0, "corner": CORNER, "edge_u": EDGE_U, "edge_v": EDGE_V}
    return float(analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, **given)[0])


def halves(**options):
    a, u, v = map(np.array, (CORNER, EDGE_U, EDGE_V))
    return [mc.Triangle(a, a + u, a + v, **options), mc.Triangle(a + u + v, a + v, a + u, **options)]


@pytest.mark.parametrize("lights", ["mis", *(pytest.param(how, marks=SLOW) for how in ("nee", "none"))])
def test_two_triangles_shine_like_their_quad(lights):
    integrand = irradiance(halves(material=BLACK, emission=5.0), lights=lights)
    assert_unbiased(mc.integrate(integrand, n=1 << 22, key=1), exact_quad(), 2e-3)


@pytest.mark.parametrize("lights", ["nee", pytest.param("mis", marks=SLOW)])
def test_a_two_sided_light_shines_to_both_sides(lights):
    back = mc.Quad(CORNER, EDGE_V, EDGE_U, BLACK, 5.0)
    assert mc.integrate(irradiance([back], lights=lights), n=1 << 16, key=1).mean == 0.0
    for primitives in (
        [mc.Quad(CORNER, EDGE_V, EDGE_U, BLACK, 5.0, two_sided=True)],
        halves(material=BLACK, emission=5.0, two_sided=True),
    ):
        assert_unbiased(mc.integrate(irradiance(primitives, lights=lights), n=1 << 22, key=1), exact_quad(), 2e-3)


@pytest.mark.parametrize("lights", ["nee", pytest.param("mis", marks=SLOW)])
def test_a_box_shines_like_its_faces(lights):
    # What a receiver sees of a convex box are its faces that turn to it.
    box = mc.Box((0.2, 0.1, 1.5), (0.6, 0.8, 0.5), TURN, BLACK, 2.0)
    from jaxmc.transport.facts import faces_of

    exact = 0.0
    for face in faces_of(box):
        corner, u, v = (np.asarray(x) for x in (face.corner, face.edge_u, face.edge_v))
        if np.dot(np.cross(u, v), corner) < 0.0:
            given = {"emission": 2.0, "corner": corner, "edge_u": u, "edge_v": v}
            exact += float(analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, **given)[0])
    assert exact > 0.1
    assert_unbiased(mc.integrate(irradiance([box], lights=lights), n=1 << 22, key=1), exact, 2e-3)


@pytest.mark.parametrize("two_sided", [False, pytest.param(True, marks=SLOW)])
def test_inside_a_white_hot_box_everything_is_a_furnace(two_sided):
    # Radiance Le (1 + rho + ... + rho^n) wherever one looks.
    room = mc.Box((0.1, 0.2, 0.3), (1.0, 1.2, 0.8), TURN, mc.Diffuse(0.5), 1.0, inward=True, two_sided=two_sided)
    ball = mc.Sphere((0.1, 0.2, 0.3), 0.2, mc.Diffuse(0.5), 1.0)
    integrand = mc.radiance(mc.Scene([room, ball]), (0.4, 0.3, 0.3), (1.0, 0.2, -0.4), bounces=4, lights="mis")
    assert_unbiased(mc.integrate(integrand, n=1 << 20, key=2), 1.9375, 2e-3)


@SLOW
def test_shadows_of_a_table_are_those_of_its_shapes():
    balls = random_primitives("sphere", 40) + random_primitives("box", 20, 8) + random_primitives("triangle", 30, 9)
    lamp = mc.Sphere((0, 0, 4.0), 0.5, BLACK, 3.0)
    far = [mc.Sphere((100.0 + 3 * k, 0, 0), 1.0) for k in range(3)]
    few, rng = [mc.Scene([*balls, lamp, *far]), None], np.random.default_rng(4)
    points = rng.uniform(-2, 2, (8, 3))
    scene = few[0]
    assert len(scene.tables) == 3
    for point in points:
        f = mc.irradiance(scene, point, (0, 0, 1), bounces=0, lights="nee")
        u = rng.uniform(size=(2000, f.dim)).astype(np.float32)
        value = np.asarray(f.batch(u))
        toward = lamp.center - point
        assert value.shape == (2000,) and np.isfinite(toward).all()
        unblocked = mc.irradiance(mc.Scene([lamp]), point, (0, 0, 1), bounces=0, lights="nee")
        free = np.asarray(unblocked.batch(u))
        drawn = value > 0
        # The same samples, tested one by one in float64.
        wi, distance = light_rays(lamp, point, u)
        every = np.min([distances(p, np.tile(point, (2000, 1)), wi) for p in balls], 0)
        blocked = every < distance
        assert (drawn == (free > 0) & ~blocked).mean() > 0.998


def light_rays(lamp, point, u):
    from jaxmc.transport import spheres

    light = spheres.SphereLight(spheres.SphereShape(Vec3(*map(float, lamp.center)), lamp.radius), False)
    start = Vec3(*map(jnp.float32, point))
    drawn = jax.vmap(lambda a, b: spheres.sample(light, start, False, a, b))(u[:, 0], u[:, 1])
    return np.stack(drawn.wi, -1).astype(np.float64), np.asarray(drawn.distance, np.float64)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mc.Triangle((0, 0, 0), (1, 0, 0), (2, 0, 0)), "no area"),
        (lambda: mc.Triangle((0, 0), (1, 0, 0), (2, 0, 0)), "Triangle a must be three numbers"),
        (lambda: mc.Box((0, 0, 0), (1, -1, 1)), "positive edge lengths"),
        (lambda: mc.Box((0, 0, 0), (1, 1, 1), ((1, 0, 0), (0, 1, 0), (0, 1, 1))), "right angles"),
        (lambda: mc.Box((0, 0, 0), (1, 1, 1), (1, 0, 0)), r"shape \(3, 3\)"),
        (lambda: mc.Box((0, np.nan, 0), (1, 1, 1)), "finite"),
    ],
)
def test_bad_shapes_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
