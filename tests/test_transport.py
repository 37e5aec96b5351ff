"""Rays, warps, lights, paths, images and derivatives, each against something computed in another way."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import analytic_scenes
import jaxmc as mc
from jaxmc import scenes
from jaxmc.testing import assert_unbiased
from jaxmc.transport import bsdfs, paths, rays, shapes, spheres, vec, warps
from jaxmc.transport.lights import sample_light
from jaxmc.transport.strategy import Strategy
from jaxmc.transport.vec import Vec3

X64 = jax.config.jax_enable_x64
EPS = float(jnp.finfo(jnp.result_type(float)).eps)
BLACK = mc.Diffuse(0.0)
UPRIGHT = np.eye(3)


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def unit_vectors(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def cube(turn=UPRIGHT, shift=(0.0, 0.0, 0.0), albedo=0.5, emission=None):
    """Return the unit cube of quads that look inward, turned (and scaled) and then moved."""
    o, x, y, z = np.zeros(3), *np.eye(3)
    faces = [(o, y, z), (o, z, x), (o, x, y), (x, z, y), (y, x, z), (z, y, x)]
    return [mc.Quad(turn @ c + shift, turn @ u, turn @ v, mc.Diffuse(albedo), emission) for c, u, v in faces]


# ---------------------------------------------------------------------------------------------------- closest hits


def tilted_scene(seed):
    """Return tilted quads and spheres in a space that they do not close; the last sphere holds many of the origins."""
    rng = np.random.default_rng(seed)
    quads = [mc.Quad(rng.uniform(-2, 2, 3), *rng.uniform(0.5, 2, (2, 1)) * unit_vectors(rng, 2)) for _ in range(6)]
    spheres = [mc.Sphere(rng.uniform(-2, 2, 3), rng.uniform(0.2, 0.9)) for _ in range(4)]
    return [*quads, *spheres, mc.Sphere(rng.uniform(-0.5, 0.5, 3), 1.5)]


def upright_scene(seed):
    """Return quads that are parallel to the axes in different ways, and a sphere."""
    rng = np.random.default_rng(seed)
    x, y, z = np.eye(3)
    edges = [(x, y), (2 * y, z), (z, -x), (x + y, y - x), (y, 2 * z - y), (-z, x + z)]
    return [*(mc.Quad(rng.uniform(-2, 1, 3), u, v) for u, v in edges), mc.Sphere((0.1, -0.2, 0.3), 0.6)]


def closest_in_float64(primitives, origins, directions):
    """Return distance, primitive, normal toward the origin, and how far a ray is from a case that rounding decides."""
    distances, normals, margins = [], [], []
    for p in primitives:
        if isinstance(p, mc.Quad):
            corner, u, v = (np.asarray(x, float) for x in (p.corner, p.edge_u, p.edge_v))
            # origin + t direction = corner + a u + b v
            system = np.stack([np.broadcast_to(u, origins.shape), np.broadcast_to(v, origins.shape), -directions], -1)
            a, b, t = np.linalg.solve(system, (origins - corner)[..., None])[..., 0].T
            inside = np.minimum.reduce([a, 1 - a, b, 1 - b])
            n = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
            distances.append(np.where((inside > 0) & (t > 0), t, np.inf))
            margins.append(np.minimum.reduce([np.abs(inside), np.abs(t), np.abs(directions @ n)]))
            normals.append(np.broadcast_to(n, origins.shape))
        else:
            offset = origins - np.asarray(p.center, float)
            b, c = np.sum(offset * directions, 1), np.sum(offset * offset, 1) - p.radius**2
            discriminant = b * b - c
            root = np.sqrt(np.maximum(discriminant, 0.0))
            t = np.where(-b - root > 0, -b - root, -b + root)
            distances.append(np.where((discriminant > 0) & (t > 0), t, np.inf))
            margins.append(np.minimum(np.abs(discriminant), np.abs(c)))
            normals.append((offset + np.where(np.isfinite(distances[-1]), t, 0.0)[:, None] * directions) / p.radius)
    distances = np.array(distances)
    first = distances.argmin(0)
    nearest, second = np.sort(distances, 0)[:2]
    normal = np.array(normals)[first, np.arange(len(first))]
    normal = -normal * np.sign(np.sum(normal * directions, 1))[:, None]
    missed = np.isinf(nearest)
    margins.append(np.where(np.isinf(second), np.inf, second - np.where(missed, 0.0, nearest)))
    return nearest, np.where(missed, -1, first), normal, np.min(margins, 0)


@pytest.mark.parametrize("make", [tilted_scene, upright_scene])
def test_closest_hits_against_float64(make):
    compared = hits = inside = 0
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        primitives = make(seed)
        origins, directions = rng.uniform(-2, 2, (20_000, 3)), unit_vectors(rng, 20_000)
        distance, primitive, normal, margin = closest_in_float64(primitives, origins, directions)
        # Directions may have any length; distances do not depend on it.
        found = mc.intersect(mc.Scene(primitives), origins, directions * rng.uniform(0.1, 10.0, (20_000, 1)))
        clear = margin > 1e-3
        np.testing.assert_array_equal(np.asarray(found.primitive)[clear], primitive[clear])
        hit = clear & (primitive >= 0)
        points = origins + np.where(hit, distance, 0.0)[:, None] * directions
        np.testing.assert_allclose(np.asarray(found.distance)[hit], distance[hit], rtol=1e3 * EPS, atol=1e2 * EPS)
        np.testing.assert_allclose(np.asarray(found.point)[hit], points[hit], atol=1e3 * EPS)
        np.testing.assert_allclose(np.asarray(found.normal)[hit], normal[hit], atol=1e3 * EPS)
        assert np.isinf(np.asarray(found.distance)[clear & (primitive < 0)]).all()
        last = primitives[-1]
        compared, hits = compared + clear.sum(), hits + hit.sum()
        inside += (hit & (np.linalg.norm(origins - last.center, axis=1) < last.radius)).sum()
    assert compared > 0.95 * 80_000
    assert 1_000 < inside < hits < compared - 1_000


def test_empty_scene_shows_the_sky():
    missed = mc.intersect(mc.Scene([]), np.zeros((3, 3)), np.eye(3))
    assert np.isinf(missed.distance).all() and (np.asarray(missed.primitive) == -1).all()
    camera = mc.PinholeCamera((0, 0, 1), (0, 0, 0), width=3, height=2)
    image = mc.render(mc.Scene([], sky=(0.1, 0.2, 0.3)), camera, spp=2, bounces=2)
    np.testing.assert_allclose(image.mean, np.broadcast_to([0.1, 0.2, 0.3], (2, 3, 3)), rtol=1e-6)
    received = mc.irradiance(mc.Scene([], sky=2.0), (0, 0, 0), (0, 0, 1), bounces=1)
    assert_unbiased(mc.integrate(received, n=64), 2 * math.pi, rel_precision=1e-6)


# ---------------------------------------------------------------------------------------------------- watertightness

MOVED = np.array([100.0, -37.3, 12.1])
CUBES = {
    "unit": (np.eye(3), np.zeros(3)),
    "small": (1e-3 * np.eye(3), np.zeros(3)),
    "large": (1e3 * np.eye(3), np.zeros(3)),
    "moved": (np.eye(3), MOVED),
    "turned": (rotation(1), np.zeros(3)),
    "turned and moved": (rotation(3), MOVED),
}
VIEW = np.array([0.36, 0.48, -0.8])


@pytest.mark.parametrize("name", CUBES)
@pytest.mark.slow
def test_no_ray_leaves_a_closed_cube(name):
    turn, shift = CUBES[name]
    scene = mc.Scene(cube(turn, shift, albedo=1.0), sky=1.0)
    rng = np.random.default_rng(11)
    n = 1 << 21
    found = mc.intersect(scene, rng.uniform(0.001, 0.999, (n, 3)) @ turn.T + shift, rng.normal(size=(n, 3)))
    assert (np.asarray(found.primitive) < 0).sum() == 0
    # Ten million rays from the walls themselves: nothing shines but the sky, and white walls would let it be seen.
    start = turn @ np.array([0.3, 0.6, 0.4]) + shift
    inside = mc.radiance(scene, start, turn @ VIEW, bounces=100, directions="uniform", lights="none")
    assert_unbiased(mc.integrate(inside, n=100_000, key=5), 0.0, rel_precision=0.0)


@pytest.mark.parametrize(("center", "radius"), [((0, 0, 0), 1.0), ((0, 0, 0), 1e-3), (MOVED, 1.0)])
@pytest.mark.slow
def test_no_ray_leaves_a_closed_sphere(center, radius):
    scene = mc.Scene([mc.Sphere(center, radius, mc.Diffuse(1.0), inward=True)], sky=1.0)
    start = np.asarray(center) + radius * np.array([0.3, -0.2, 0.1])
    inside = mc.radiance(scene, start, VIEW, bounces=100, lights="none")
    assert_unbiased(mc.integrate(inside, n=100_000, key=5), 0.0, rel_precision=0.0)
    inside = mc.radiance(scene, start, VIEW, bounces=100, directions="uniform", lights="none")
    assert_unbiased(mc.integrate(inside, n=100_000, key=5), 0.0, rel_precision=0.0)


@pytest.mark.parametrize("room", [pytest.param("cube", marks=pytest.mark.slow), "sphere"])
def test_a_thousand_events_stay_finite_and_exact(room):
    scene = getattr(analytic_scenes, f"{room}_furnace")(albedo=1.0, bounces=1000)
    assert_unbiased(mc.integrate(scene.integrand, n=2_000), 1001.0, rel_precision=1e-6)


# ---------------------------------------------------------------------------------------------------- warps


def test_sincos_error():
    u = np.concatenate([np.linspace(0.0, 1.0, 400_001), np.random.default_rng(0).uniform(0, 1, 400_000)])
    u = u.astype(jnp.result_type(float))
    sine, cosine = map(np.asarray, jax.jit(warps.sincos_2pi)(u))
    angle = 2.0 * np.pi * u.astype(np.longdouble)
    bound = 2e-15 if X64 else 3e-7
    assert np.abs(sine - np.sin(angle)).max() < bound and np.abs(cosine - np.cos(angle)).max() < bound


@pytest.mark.parametrize("name", ["cosine", "uniform"])
def test_hemisphere_directions_follow_their_density(name):
    sample = {"cosine": warps.sample_cosine_hemisphere, "uniform": warps.sample_uniform_hemisphere}[name]
    pdf = {"cosine": warps.pdf_cosine_hemisphere, "uniform": lambda z: warps.pdf_uniform_hemisphere() + 0.0 * z}[name]
    n = 1 << 20
    x, y, z = (np.asarray(c, np.float64) for c in jax.jit(sample)(*np.random.default_rng(2).uniform(size=(2, n))))
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-6)
    # Bins of equal solid angle; the density depends on z alone. Midpoints integrate a linear density exactly.
    rings, sectors = 16, 12
    edges = np.linspace(0.0, 1.0, rings + 1)
    expected = np.repeat(pdf((edges[1:] + edges[:-1]) / 2)[:, None], sectors, 1) * 2 * np.pi / (rings * sectors)
    assert expected.sum() == pytest.approx(1.0, rel=1e-12)
    observed, _, _ = np.histogram2d(z, np.arctan2(y, x) % (2 * np.pi), [edges, np.linspace(0, 2 * np.pi, sectors + 1)])
    assert observed.sum() == n
    assert stats.chisquare(observed.ravel(), n * expected.ravel()).pvalue > 1e-3


def test_frames_are_orthonormal_at_every_normal():
    rng = np.random.default_rng(3)
    near_pole = np.array([[s * 10.0**-k, 10.0**-k, p] for k in range(1, 12) for s in (-1, 1) for p in (-1, 1)])
    normals = np.concatenate([unit_vectors(rng, 100_000), near_pole, np.eye(3), -np.eye(3), [[1.0, 0.0, -0.0]]])
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(jnp.result_type(float))
    tangent, bitangent = (np.stack(np.broadcast_arrays(*v), -1) for v in jax.jit(vec.frame)(Vec3(*normals.T)))
    basis = np.stack([tangent, bitangent, normals], 1).astype(np.float64)
    np.testing.assert_allclose(basis @ np.swapaxes(basis, 1, 2), np.broadcast_to(np.eye(3), basis.shape), atol=10 * EPS)
    np.testing.assert_allclose(np.cross(basis[:, 0], basis[:, 1]), basis[:, 2], atol=10 * EPS)


# ---------------------------------------------------------------------------------------------------- sampling lights


def light_samples(primitive, point, n=200_000):
    """Return samples of a light from a point, the distance that a ray finds, and 1 / density of the direction."""
    scene = mc.Scene([primitive])
    (light, _), origin = scene.emitters[0], Vec3(*map(jnp.asarray, scene.local(np.asarray(point, float))))

    @jax.jit
    @jax.vmap
    def draw(u1, u2):
        drawn, _, _ = sample_light(scene, Strategy(1), origin, None, -1, u1, u2, None)
        ray = rays.ray(origin, drawn.wi)
        found = paths.closest_hit(scene, ray)
        return drawn, found.distance, shapes.inverse_pdf(light, origin, drawn.wi, drawn.distance, "automatic")

    drawn, distance, inverse_pdf = draw(*np.random.default_rng(4).uniform(size=(2, n)))
    wi = np.stack(drawn.wi, -1).astype(np.float64)
    return wi, *(np.asarray(x, np.float64) for x in (drawn.distance, drawn.inverse_pdf, distance, inverse_pdf))


def check_directions(wi, inverse_pdf, found, solid_angle, vector):
    """Check the integrals of 1 and of the direction over the solid angle of a light."""
    values = inverse_pdf[:, None] * np.isfinite(found)[:, None] * np.concatenate([np.ones((len(wi), 1)), wi], 1)
    error = values.std(0) / np.sqrt(len(wi)) + 1e-5 * solid_angle
    np.testing.assert_array_less(np.abs(values.mean(0) - [solid_angle, *vector]), 5 * error)
    assert (error < 0.01 * solid_angle).all()


@pytest.mark.parametrize(("radius", "distance"), [(0.5, 2.0), (0.01, 3.0), (1.0, 1.05)])
def test_sphere_light_is_sampled_by_its_solid_angle(radius, distance):
    toward = rotation(5)[0]
    point = np.array([0.3, -0.4, 0.2])
    light = mc.Sphere(point + distance * toward, radius, BLACK, emission=1.0)
    wi, length, inverse_pdf, found, again = light_samples(light, point)
    sine2 = (radius / distance) ** 2
    solid_angle = 2 * np.pi * sine2 / (1 + np.sqrt(1 - sine2))
    np.testing.assert_allclose(inverse_pdf, solid_angle, rtol=1e-4)
    hit = np.isfinite(found)
    assert hit.mean() > 0.999  # the rim is a matter of rounding
    np.testing.assert_allclose(again[hit], inverse_pdf[hit], rtol=1e-6)
    core = hit & (wi @ toward > np.sqrt(1 - 0.9 * sine2))  # away from the rim, where a root magnifies rounding
    np.testing.assert_allclose(length[core], found[core], rtol=1e-4)
    check_directions(wi, inverse_pdf, found, solid_angle, np.pi * sine2 * toward)


def test_sphere_light_that_shines_inward():
    light = mc.Sphere((0.0, 0.0, 2.0), 0.5, BLACK, emission=1.0, inward=True)
    wi, length, inverse_pdf, found, again = light_samples(light, (0.1, 0.2, 1.8))
    np.testing.assert_allclose(inverse_pdf, 4 * np.pi, rtol=1e-6)
    np.testing.assert_allclose(again, inverse_pdf, rtol=1e-6)
    np.testing.assert_allclose(length, found, rtol=1e-5)
    check_directions(wi, inverse_pdf, found, 4 * np.pi, np.zeros(3))
    *_, inverse_pdf, _, _ = light_samples(light, (0.0, 0.0, 0.0))
    assert (inverse_pdf == 0).all()  # from outside its bright side cannot be seen
    outside = mc.irradiance(mc.Scene([light]), (0, 0, 0), (0, 0, 1), bounces=0)
    assert_unbiased(mc.integrate(outside, n=10_000), 0.0, rel_precision=0.0)


def test_quad_light_is_sampled_by_area():
    light = mc.Quad((-1.0, -0.5, 1.5), (0.2, 1.3, 0.3), (1.8, 0.1, -0.2), BLACK, emission=1.0)
    point = np.array([0.2, 0.1, -0.3])
    wi, length, inverse_pdf, found, again = light_samples(light, point)
    np.testing.assert_allclose(again, inverse_pdf, rtol=1e-5)
    np.testing.assert_allclose(length, found, rtol=1e-5)
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.edge_u, light.edge_v))
    outline = np.stack([corner, corner + u, corner + u + v, corner + v]) - point
    # Solid angle: van Oosterom and Strackee 1983. Integral of the direction: Lambert's polygon formula.
    vector = sum(
        np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)) / 2 * np.cross(a, b) / np.linalg.norm(np.cross(a, b))
        for a, b in zip(outline, np.roll(outline, -1, 0))
    )
    solid_angle = sum(triangle(outline[0], outline[i], outline[i + 1]) for i in (1, 2))
    check_directions(wi, inverse_pdf, found, abs(solid_angle), vector * np.sign(vector @ (outline.mean(0))))
    *_, inverse_pdf, _, _ = light_samples(light, point + np.array([0, 0, 4.0]))
    assert (inverse_pdf == 0).all()  # it is dark from behind


def triangle(a, b, c):
    la, lb, lc = (np.linalg.norm(v) for v in (a, b, c))
    return 2 * np.arctan2(a @ np.cross(b, c), la * lb * lc + (a @ b) * lc + (b @ c) * la + (c @ a) * lb)


# ---------------------------------------------------------------------------------------------------- estimators agree


def gallery():
    """Return a tilted room under a coloured sky: two quads and a sphere that shine, and two mirrors."""
    turn = rotation(7)
    at = lambda *x: turn @ np.array(x, float)  # noqa: E731
    colors = [(0.7, 0.7, 0.7), (0.7, 0.2, 0.2)]
    walls = [mc.Quad(q.corner, q.edge_u, q.edge_v, mc.Diffuse(c)) for q, c in zip(cube(turn), colors)]
    lights = [
        mc.Quad(at(0.3, 0.95, 0.4), at(0, 0, 0.3), at(0.3, -0.1, 0), mc.Diffuse((0.3, 0.2, 0.1)), (4.0, 3.0, 2.0)),
        mc.Quad(at(0.05, 0.3, 0.3), at(0, 0.3, 0), at(0, 0, 0.3), BLACK, (1.0, 2.0, 6.0)),
        mc.Sphere(at(0.75, 0.25, 0.7), 0.1, mc.Diffuse(0.5), (5.0, 1.0, 2.0)),
    ]
    mirrors = [
        mc.Sphere(at(0.3, 0.25, 0.3), 0.2, mc.Mirror((0.9, 0.8, 0.7))),
        mc.Quad(at(0.97, 0.2, 0.1), at(0, 0, 0.6), at(0.01, 0.6, 0), mc.Mirror(0.8)),
    ]
    camera = mc.PinholeCamera(at(0.45, 0.55, 0.97), at(0.5, 0.4, 0), at(0, 1, 0), fov=70, width=32, height=24)
    return mc.Scene([*walls, *lights, *mirrors], sky=(0.2, 0.3, 0.5)), camera


VIEWS = {
    "gallery": gallery,
    "cornell": lambda: scenes.cornell_box(24, 16),
    "mirror box": lambda: scenes.mirror_box(width=24, height=16),
}
STRATEGIES = [(lights, directions) for lights in ("mis", "nee", "none") for directions in ("cosine", "uniform")]
BOUNCES = 3


@functools.cache
def image_mean(name, lights, directions, n):
    """Return mean and standard error of a whole image, every strategy with its own random numbers."""
    key = STRATEGIES.index((lights, directions))
    f = mc.path_integrand(*VIEWS[name](), bounces=BOUNCES, directions=directions, lights=lights)
    estimate = mc.integrate(f, n=n, key=key)
    assert estimate.status == "complete"
    return np.asarray(estimate.mean), np.asarray(estimate.stderr)


def check_agreement(name, strategies, n, rel_precision):
    means, errors = map(np.array, zip(*(image_mean(name, *strategy, n) for strategy in strategies)))
    assert (errors <= rel_precision * means).all(), errors / means
    for i in range(len(strategies)):
        for j in range(i):
            z = (means[i] - means[j]) / np.hypot(errors[i], errors[j])
            assert (np.abs(z) < 5).all(), (name, strategies[i], strategies[j], z)


@pytest.mark.parametrize(
    ("name", "strategies", "rel_precision"),
    [
        pytest.param("gallery", [STRATEGIES[0], STRATEGIES[3]], 2.5e-3, marks=pytest.mark.slow),
        ("cornell", [STRATEGIES[0], STRATEGIES[5]], 8e-3),
        ("mirror box", [STRATEGIES[0], STRATEGIES[4]], 3e-2),
    ],
)
@pytest.mark.slow
def test_strategies_agree(name, strategies, rel_precision):
    check_agreement(name, strategies, 1 << 21, rel_precision)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rel_precision"), [("gallery", 4e-4), ("cornell", 1.3e-3), ("mirror box", 7e-3)])
def test_all_strategies_agree_closely(name, rel_precision):
    check_agreement(name, STRATEGIES, 1 << 26, rel_precision)


def test_a_convex_body_under_a_white_sky():
    # Every direction that a sphere scatters to shows the sky: radiance albedo * sky, whatever the number of events.
    ball = mc.Sphere((0.3, 0.2, -0.1), 0.7, mc.Diffuse((0.2, 0.5, 0.8)))
    seen = mc.radiance(mc.Scene([ball], sky=2.0), (3, 1, 2), (-2.7, -0.8, -2.1), bounces=3, directions="uniform")
    assert_unbiased(mc.integrate(seen, n=1 << 20), [0.4, 1.0, 1.6], rel_precision=1e-3)


# ---------------------------------------------------------------------------------------------------- images


@pytest.mark.slow
def test_render_agrees_with_the_integral_over_its_film():
    scene, camera = VIEWS["mirror box"]()
    image = mc.render(scene, camera, spp=2048, bounces=BOUNCES, key=9)
    assert image.mean.shape == image.stderr.shape == (16, 24, 3)
    mean, error = image_mean("mirror box", "mis", "cosine", 1 << 21)
    image_error = np.sqrt((image.stderr**2).sum((0, 1))) / (16 * 24)
    assert (image_error < 0.03 * mean).all()
    assert (np.abs(image.mean.mean((0, 1)) - mean) < 5 * np.hypot(error, image_error)).all()


def test_pixels_run_row_by_row_from_the_top_left():
    # A quadrant of the film, seen from (0, 0, 4): x from the left edge to the middle, y from the middle to the top.
    half = 4 * math.tan(math.radians(20))
    bright = mc.Quad((-1.5 * half, 0, 0), (1.5 * half, 0, 0), (0, half, 0), BLACK, emission=(1.0, 2.0, 3.0))
    camera = mc.PinholeCamera((0, 0, 4), (0, 0, 0), fov=40, width=12, height=8)
    image = mc.render(mc.Scene([bright]), camera, spp=4, bounces=0).mean
    expected = np.zeros((8, 12, 3))
    expected[:4, :6] = [1, 2, 3]
    np.testing.assert_array_equal(image, expected)


def lamp_and_floor(color=1.0, extra=()):
    lamp = mc.Quad((-0.5, 1.0, -0.5), (1, 0, 0), (0, 0, 1), mc.Diffuse(0.3), emission=np.multiply(4.0, color))
    floor = mc.Quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), mc.Diffuse(0.5))
    return mc.Scene([lamp, floor, *extra]), mc.PinholeCamera((0, 0.5, 3), (0, 0.4, 0), width=8, height=6)


@pytest.mark.slow
def test_grey_and_coloured_code_give_the_same_grey():
    # A coloured ball inside a black one is never met, yet makes the scene a coloured one.
    shell, core = mc.Sphere((0, 0.3, 0), 0.2, BLACK), mc.Sphere((0, 0.3, 0), 0.1, mc.Diffuse((0.1, 0.2, 0.3)))
    (grey, camera), (coloured, _) = lamp_and_floor(extra=[shell]), lamp_and_floor(extra=[shell, core])
    assert (grey.channels, coloured.channels) == (1, 3)
    one, three = (mc.draw(mc.path_integrand(s, camera, bounces=2), n=2048).value for s in (grey, coloured))
    assert one.shape == (2048,) and (one > 0).mean() > 0.1
    np.testing.assert_allclose(three, np.stack([one] * 3, -1), rtol=1e-5)


@pytest.mark.slow
def test_clamp_scales_to_the_threshold():
    scene, camera = lamp_and_floor()
    options = {"bounces": 1, "directions": "uniform", "lights": "none"}
    plain = mc.draw(mc.path_integrand(scene, camera, **options), n=4096).value
    clamped = mc.draw(mc.path_integrand(scene, camera, **options, clamp=0.5), n=4096).value
    assert 0.01 < (plain > 0.5).mean() < 0.9
    np.testing.assert_allclose(clamped, np.minimum(plain, 0.5), rtol=1e-6)
    # A colour keeps its hue: all channels are scaled alike.
    colors = np.random.default_rng(6).uniform(0, 2, (1000, 3)) ** 3
    scaled, y = np.asarray(mc.clamp_luminance(jnp.asarray(colors), 0.5)), np.asarray(mc.luminance(colors))
    np.testing.assert_allclose(scaled, colors * np.minimum(0.5 / y, 1.0)[:, None], rtol=1e-5)
    assert np.asarray(mc.luminance(scaled)).max() <= 0.5 * (1 + 4 * EPS)


@pytest.mark.slow
def test_replay_shows_the_samples_of_an_image():
    scene, camera = VIEWS["mirror box"]()
    tallies = {"top": mc.TopSamples(32, of=mc.luminance)}
    # The light is worth 500; where no mirror shows it, its samples are worth less than 1.
    bright = mc.render(scene, camera, spp=512, bounces=BOUNCES, key=9, tallies=tallies)["top"]
    one_sample = mc.render(scene, camera, spp=1, bounces=BOUNCES, key=9, tallies=tallies).mean.reshape(-1, 3)
    pixels = np.arange(24 * 16)
    replayed = mc.replay(scene, camera, [*bright.index, *pixels], key=9, bounces=BOUNCES)
    for path, index, value in zip(replayed, bright.index, bright.value):
        assert path.index == index and path.pixel == (index % 24, index // 24 % 16)
        assert float(mc.luminance(np.asarray(path.value))) == pytest.approx(value, rel=1e-4)
        assert ("mirror -> light" in path.line) == (value > 100), path.line
        assert path.direct + sum(v.gained for v in path.vertices) == pytest.approx(value, rel=1e-4)
    assert 8 <= (bright.value > 100).sum() < 32
    values = np.array([path.value for path in replayed[32:]])
    np.testing.assert_allclose(values, one_sample, rtol=1e-4, atol=1e-6)


# ---------------------------------------------------------------------------------------------------- points and rays


@pytest.mark.parametrize("seed", range(4))
def test_a_receiver_on_a_wall_is_not_shadowed_by_it(seed):
    # A rectangle over a floor that the receiver lies on; half of these tilts round to a point below the floor.
    turn, shift = rotation(seed), np.array([0.3, -0.2, 0.1]) * (seed % 2)
    lamp = mc.Quad(turn @ (-0.5, -0.5, 2) + shift, turn @ (0, 1, 0), turn @ (1, 0, 0), BLACK, emission=5.0)
    floor = mc.Quad(turn @ (-3, -3, 0) + shift, turn @ (6, 0, 0), turn @ (0, 6, 0), mc.Mirror(0.5))
    corners = {"corner": (-0.8, -0.7, 2.0), "edge_u": (0.0, 1.0, 0.0), "edge_v": (1.0, 0.0, 0.0)}
    exact, _ = analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, emission=5.0, **corners)
    received = mc.irradiance(
        mc.Scene([lamp, floor]), turn @ (0.3, 0.2, 0) + shift, turn @ (0, 0, 2), bounces=0, lights="nee"
    )
    assert_unbiased(mc.integrate(received, n=1 << 17), exact, rel_precision=1e-3)


def test_a_receiver_on_a_sphere_sees_the_whole_sky():
    for seed in range(6):
        up = rotation(seed)[0]
        scene = mc.Scene([mc.Sphere((0.2, 0.1, 0.3), 0.7)], sky=1.0)
        seen = mc.irradiance(scene, np.array([0.2, 0.1, 0.3]) + 0.7 * up, up, bounces=0, lights="none")
        assert_unbiased(mc.integrate(seen, n=4096), math.pi, rel_precision=1e-6)


def test_irradiance_in_a_furnace():
    scene = mc.Scene([mc.Sphere((0, 0, 0), 2.0, mc.Diffuse(0.5), emission=1.0, inward=True)])
    up = rotation(2)[0]
    for point in (-2.0 * up, 0.7 * up):  # on the wall and in the middle
        received = mc.irradiance(scene, point, up, bounces=2, lights="none")
        assert_unbiased(mc.integrate(received, n=4096), math.pi * 1.75, rel_precision=1e-6)


def test_radiance_along_a_ray():
    scene, _ = lamp_and_floor()
    look = functools.partial(mc.radiance, scene, (0, 0.5, 0), bounces=0)
    assert look(direction=(0, 7.0, 0)).dim == 1  # nothing to sample, and one coordinate that nobody reads
    assert look(direction=(0, 7.0, 0)).batch([[0.5]]) == 4.0
    assert look(direction=(0, -1, 0)).batch([[0.5]]) == 0.0
    # Called as it stands, outside any jit, along an axis.
    assert look(direction=(0, 1, 0))(jnp.zeros(1)) == 4.0


# ---------------------------------------------------------------------------------------------------- facts


def forbidden(*args, **kwargs):
    raise AssertionError("code for something that the scene does not contain")


ABSENT = {  # what a floor under a lamp lacks -> the functions that only that needs
    "mirrors": (lambda: mc.path_integrand(*lamp_and_floor(), bounces=2), [(bsdfs, "reflect")]),
    "spheres": (
        lambda: mc.path_integrand(*lamp_and_floor(), bounces=2),
        [(spheres, "intersect"), (spheres, "blocks"), (spheres, "sample")],
    ),
    "light samples": (
        lambda: mc.path_integrand(*lamp_and_floor(), bounces=2, lights="none"),
        [(paths, "sample_light"), (paths, "unoccluded"), (paths, "weight_of_hit")],
    ),
    "lights": (
        lambda: mc.path_integrand(*lamp_and_floor(color=0.0), bounces=2),
        [(paths, "sample_light"), (paths, "emission_toward"), (paths, "unoccluded")],
    ),
}


@pytest.mark.parametrize("what", ABSENT)
def test_code_for_what_is_absent_does_not_run(what, monkeypatch):
    make, functions = ABSENT[what]
    for module, name in functions:
        monkeypatch.setattr(module, name, forbidden)
    integrand = make()
    jax.eval_shape(lambda u: integrand(u), jnp.zeros(integrand.dim))


# ---------------------------------------------------------------------------------------------------- derivatives


@jax.jit
def gradient_moments(integrand_of, arguments, u):
    """Return mean and standard error of the derivative of ``integrand_of(*arguments)`` at the points ``u``."""
    each = jax.vmap(jax.grad(lambda a, u: integrand_of.fn(u, *a)), (None, 0))(arguments, u)
    return jax.tree.map(lambda g: (g.mean(0), g.std(0) / np.sqrt(len(u))), each)


def derivative(make, arguments, dim, n):
    u = jnp.asarray(np.random.default_rng(8).uniform(size=(n, dim)), float)
    named = {name: jnp.asarray(value, float) for name, value in arguments.items()}
    integrand = mc.Integrand(lambda u, a: make(**a)(u), dim)
    result = jax.device_get(gradient_moments(integrand, (named,), u))[0]
    return {name: tuple(np.asarray(x, np.float64) for x in pair) for name, pair in result.items()}


def test_derivative_of_the_furnace_is_exact():
    furnace = analytic_scenes.sphere_furnace(albedo=0.5, emission=1.0)

    def make(albedo, emission):
        scene = mc.Scene([mc.Sphere((0, 0, 0), 2.0, mc.Diffuse(albedo), emission, inward=True)])
        return lambda u: mc.radiance(scene, (0.6, -0.4, 0.2), VIEW, bounces=3, lights="none")(u).mean()

    found = derivative(make, {"albedo": 0.5, "emission": 1.0}, furnace.integrand.dim, 256)
    for name, (mean, error) in found.items():
        assert mean == pytest.approx(furnace.derivatives[name], rel=1e-4) and error < 1e-5


def direct_light(primitive):
    scene = mc.Scene([primitive])
    return lambda u: mc.irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=0, lights="nee")(u).mean()


def test_derivatives_of_direct_light_in_full_view():
    # Light sampling moves its points with the light, and no edge is hidden: the interior derivative is the whole.
    corners = {"corner": (0.5, -0.3, 1.2), "edge_u": (-0.2, 0.7, 0.4), "edge_v": (0.8, 0.3, 0.1)}
    quad = analytic_scenes.rectangle_light(normal=(0, 0, 1), **corners)
    arguments = {"emission": 5.0, **corners}
    check_derivatives(quad, lambda **q: direct_light(mc.Quad(**q, material=BLACK)), arguments)
    ball = analytic_scenes.sphere_light()

    def make(emission, radius, distance, theta):
        center = (distance * jnp.sin(theta), 0.0, distance * jnp.cos(theta))  # traced and known numbers together
        return direct_light(mc.Sphere(center, radius, BLACK, emission))

    check_derivatives(ball, make, {"emission": 10.0, "radius": 0.5, "distance": 2.0, "theta": 0.6})


def check_derivatives(scene, make, arguments):
    for name, (mean, error) in derivative(make, arguments, scene.integrand.dim, 100_000).items():
        exact = np.asarray(scene.derivatives[name])
        assert (np.abs(mean - exact) < 5 * error + 1e-4 * np.abs(exact).max()).all(), (name, mean, exact, error)
        assert (error < 0.02 * np.abs(exact).max()).all()


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("lights", "ball"),
    [
        ("mis", mc.Diffuse(0.5)),
        pytest.param("mis", mc.Mirror(0.9), marks=SLOW),
        pytest.param("nee", mc.Mirror(0.9), marks=SLOW),
    ],
)
@pytest.mark.slow
def test_derivatives_of_paths_are_finite(lights, ball):
    def make(radius, corner, center, albedo):
        lamps = [
            mc.Quad(corner, (0, 0, 0.2), (0.2, 0, 0), mc.Diffuse(0.2), 5.0),
            mc.Sphere((0.8, 0.2, 0.8), radius, ball, 2.0),
        ]
        floor = cube()[2]  # the other sides are open: rays leave the scene
        scene = mc.Scene([floor, *lamps, mc.Sphere(center, radius, mc.Diffuse(albedo))])
        return lambda u: mc.radiance(scene, (0.3, 0.6, 0.4), VIEW, bounces=3, lights=lights)(u).mean()

    arguments = {"radius": 0.1, "corner": (0.4, 0.9, 0.4), "center": (0.5, 0.3, 0.5), "albedo": (0.5, 0.6, 0.7)}
    found = derivative(make, arguments, 15, 20_000)
    for name, (mean, error) in found.items():
        assert np.isfinite(mean).all() and (error > 0).all(), (name, mean, error)


# ---------------------------------------------------------------------------------------------------- bad input

BALL = mc.Sphere((0, 0, 0), 1.0)
SCENE, CAMERA = mc.Scene([BALL]), mc.PinholeCamera((0, 0, 3), (0, 0, 0), width=4, height=4)
BAD = {
    "text for a number": (lambda: mc.Sphere((0, 0, 0), "1.5"), "radius must be one number, got '1.5'"),
    "text for numbers": (lambda: mc.Quad(("0", "1", "2"), (1, 0, 0), (0, 1, 0)), "corner must be made of numbers"),
    "text for a colour": (lambda: mc.Sphere((0, 0, 0), 1.0, emission="1"), "emission must be made of numbers"),
    "no number": (lambda: mc.Sphere((0, 0, 0), None), "radius must be one number"),
    "rows of different length": (lambda: mc.Quad([0, [1, 2], 3], (1, 0, 0), (0, 1, 0)), "corner must be three numbers"),
    "ragged colour": (lambda: mc.Sphere((0, 0, 0), 1.0, emission=(1, (2, 3), 3)), "RGB triple"),
    "no scene": (lambda: mc.Scene(None), r"list of mc\.Sphere"),
    "no list": (lambda: mc.Scene(BALL), r"list of mc\.Sphere"),
    "text for an angle": (lambda: mc.PinholeCamera((0, 0, 3), (0, 0, 0), fov="40"), "fov must lie between"),
    "text for a clamp": (lambda: mc.render(SCENE, CAMERA, spp=1, clamp="1"), "clamp must be a positive"),
    "two clamps": (lambda: mc.render(SCENE, CAMERA, spp=1, clamp=np.array([1.0, 2.0])), "clamp must be a positive"),
    "array of directions": (lambda: mc.render(SCENE, CAMERA, spp=1, directions=np.zeros(3)), "cosine, uniform"),
    "rays without a scene": (lambda: mc.intersect([BALL], np.zeros((1, 3)), np.ones((1, 3))), r"mc\.Scene"),
    "index beyond the last": (lambda: mc.replay(SCENE, CAMERA, 1 << 64, bounces=1), "indices must be integers"),
    "one event": (lambda: mc.path_throughput(SCENE, CAMERA, events=5), "list of positive integers"),
    "throughput without a camera": (lambda: mc.path_throughput(SCENE, None, events=[5]), "PinholeCamera"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_refused(what):
    call, message = BAD[what]
    with pytest.raises(ValueError, match=message):
        call()
