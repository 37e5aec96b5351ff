"""Everything that draws a direction or a point, against its density: by counting and by the Jacobian of the map."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.testing import HEMISPHERE, SPHERE, Domain, assert_jacobian, assert_samples_pdf, directions
from jaxmc.transport import bsdfs, flats, hits, rays, shapes, warps
from jaxmc.transport.vec import Vec3, dot, normalize

BLACK = mc.Diffuse(0.0)
POINT = Vec3(0.2, 0.1, -0.3)
QUAD = {"corner": (-1.0, -0.5, 1.5), "edge_u": (0.2, 1.3, 0.3), "edge_v": (1.8, 0.1, -0.2)}


def cosine_hemisphere():
    return (
        lambda u: warps.sample_cosine_hemisphere(u[0], u[1]),
        lambda w: warps.pdf_cosine_hemisphere(w.z),
        HEMISPHERE,
    )


def uniform_hemisphere():
    return lambda u: warps.sample_uniform_hemisphere(u[0], u[1]), lambda w: warps.pdf_uniform_hemisphere(), HEMISPHERE


def diffuse(kind, normal):
    normal = Vec3(*(np.asarray(normal) / np.linalg.norm(normal)))
    return (
        lambda u: bsdfs.sample_diffuse(kind, normal, u[0], u[1])[0],
        lambda w: bsdfs.pdf_diffuse(kind, dot(normal, w)),
        directions(normal, math.pi / 2),
    )


def light_of(primitive):
    scene = mc.Scene([primitive])
    return scene.emitters[0][0], scene


def quad_by_area():
    """Return points on a parallelogram, in its own coordinates, of a density 1 / area."""
    light, scene = light_of(mc.Quad(**QUAD, material=BLACK, emission=1.0))
    receiver = scene.local(POINT)
    corner, u, v = (np.array(QUAD[name]) for name in ("corner", "edge_u", "edge_v"))
    inverse = np.linalg.pinv(np.stack([u, v], 1))
    domain = Domain(
        low=(0.0, 0.0),
        high=(1.0, 1.0),
        point=lambda q: corner + q[0] * u + q[1] * v,
        coordinates=lambda x: jnp.asarray(inverse, x.dtype) @ (x - jnp.asarray(corner, x.dtype)),
        bins=(20, 20),
    )

    def sample(u):
        drawn = flats.sample(light, receiver, False, u[0], u[1])
        return POINT + drawn.wi * drawn.distance

    def pdf(x):
        # What the light's density per solid angle is per area: cos / distance^2 of it.
        to_light = x - POINT
        distance = jnp.sqrt(dot(to_light, to_light))
        wi = to_light / distance
        inverse_pdf = flats.inverse_pdf(light, receiver, wi, distance)
        return -dot(light.normal, wi) / distance**2 / inverse_pdf

    return sample, pdf, domain


def disk_by_area():
    """Return points on a disk; the domain counts by their squared distance from its centre, and their azimuth."""
    disk = mc.Disk((0.1, -0.2, 1.7), (0.3, -0.2, -0.9), 1.2, BLACK, emission=1.0)
    light, _ = light_of(disk)
    center, u, v = (np.array(x, float) for x in (light.center, light.half_u, light.half_v))
    inverse = np.linalg.pinv(np.stack([u, v], 1))

    def coordinates(x):
        x, y = jnp.asarray(inverse, x.dtype) @ (x - jnp.asarray(center, x.dtype))
        return jnp.stack([x * x + y * y, jnp.arctan2(y, x)])

    def point(q):
        return center + jnp.sqrt(q[0]) * (jnp.cos(q[1]) * u + jnp.sin(q[1]) * v)

    domain = Domain((0.0, -math.pi), (1.0, math.pi), point, coordinates, (16, 32), lambda q: 0.5 * 1.2**2)
    return lambda u: flats.point_on(light, u[0], u[1]), lambda x: 1.0 / light.area, domain


def light_by_solid_angle(primitive, domain=SPHERE, point=POINT):
    """Return directions toward a light, and the density that a hit of it is given; 0 where the light is missed."""
    light, scene = light_of(primitive)
    point = scene.local(point)

    def pdf(w):
        found = hits.closest_hit(scene, rays.ray(point, w))
        inverse = shapes.inverse_pdf(light, point, w, found.distance, "automatic")
        hit = jnp.isfinite(found.distance) & (inverse > 0.0)
        return jnp.where(hit, 1.0 / jnp.where(hit, inverse, 1.0), 0.0)

    return lambda u: shapes.sample_light(light, point, False, u[0], u[1], "automatic").wi, pdf, domain


def sphere_light(radius, distance):
    toward = np.array([0.48, -0.6, 0.64])
    sphere = mc.Sphere(np.array(POINT) + distance * toward, radius, BLACK, emission=1.0)
    return light_by_solid_angle(sphere, directions(toward, math.asin(radius / distance)))


def film():
    """Return camera rays through points of the film drawn uniformly: cos^-3 / area per solid angle."""
    eye = mc.PinholeCamera((1.0, 2.0, 3.0), (0.0, 0.5, 0.0), fov=70.0, width=48, height=32)
    area = 4.0 * math.sqrt(float(dot(eye.right, eye.right) * dot(eye.down, eye.down)))

    def pdf(w):
        cosine = dot(eye.forward, w)
        x, y = (dot(side, w) / (dot(side, side) * cosine) for side in (eye.right, eye.down))
        return jnp.where((cosine > 0.0) & (jnp.maximum(jnp.abs(x), jnp.abs(y)) <= 1.0), 1.0 / (area * cosine**3), 0.0)

    return lambda u: eye.ray(48.0 * u[0], 32.0 * u[1]).direction, pdf, directions(eye.forward, 1.0)


def rough_metal():
    """Return directions that a rough metal scatters into, and the density that a direction toward a light is given."""
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.RoughConductor(0.5))])
    surface = hits.Surface(Vec3(0.0, 0.0, 0.0), Vec3(0.0, 0.0, 1.0), 1.0, jnp.zeros((), jnp.int32))
    # Facets seen edge-on reflect into the viewer's opposite, a point where the map has no derivative. From this side it
    # comes from a point inside of an edge of the unit square, not from a corner.
    kinds, arriving = bsdfs.kinds_of(scene, surface), Vec3(*map(jnp.asarray, (0.48, 0.36, -0.8)))

    def sample(u):
        return bsdfs.sample_bsdf(scene, "bsdf", surface, kinds, arriving, u[0], u[1]).wi

    def pdf(w):
        return bsdfs.evaluate_bsdf(scene, "bsdf", surface, kinds, arriving, w, w.z)[1]

    return sample, pdf, SPHERE


def cone():
    """Return directions in a cone that is cut off a little before its rim, where rounding decides what is inside."""
    axis, half_angle = Vec3(0.48, -0.6, 0.64), 0.4

    def pdf(w):
        return jnp.where(warps.is_in_cone(w, axis, half_angle), warps.pdf_cone(half_angle), 0.0)

    return lambda u: warps.sample_cone(axis, half_angle, u[0], u[1]), pdf, directions(tuple(axis), half_angle)


PAIRS = {
    "sample_bsdf of rough metal": rough_metal,
    "sample_cosine_hemisphere": cosine_hemisphere,
    "sample_uniform_hemisphere": uniform_hemisphere,
    "sample_cone": cone,
    "sample_diffuse, cosine, tilted": lambda: diffuse("cosine", (0.3, -0.8, 0.4)),
    "sample_diffuse, uniform, downward": lambda: diffuse("uniform", (0.1, 0.2, -0.9)),
    "sample_diffuse, cosine, -z": lambda: diffuse("cosine", (0.0, 0.0, -1.0)),
    "sample_light of a quad, per area": quad_by_area,
    "sample_light of a quad, per solid angle": lambda: light_by_solid_angle(
        mc.Quad(**QUAD, material=BLACK, emission=1.0), directions((0.0, 0.1, 1.0), 0.7)
    ),
    "sample_light of a disk, per area": disk_by_area,
    "sample_light of a disk, per solid angle": lambda: light_by_solid_angle(
        mc.Disk((0.1, -0.2, 1.7), (0.3, -0.2, -0.9), 1.2, BLACK, emission=1.0), directions((0.0, 0.0, 1.0), 0.8)
    ),
    "sample_light of a sphere, large": lambda: sphere_light(1.0, 1.05),
    "sample_light of a sphere, small": lambda: sphere_light(0.01, 3.0),
    "sample_light of a sphere, inside": lambda: light_by_solid_angle(
        mc.Sphere((0.3, 0.1, -0.2), 0.5, BLACK, emission=1.0, inward=True)
    ),
    "Camera.ray": film,
}


QUICK = {"sample_cosine_hemisphere", "sample_uniform_hemisphere", "sample_light of a quad, per area", "Camera.ray"}
QUICK |= {"sample_light of a disk, per area"}


def all_but_slow(names, quick):
    return [name if name in quick else pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("name", all_but_slow(PAIRS, QUICK))
def test_samples_follow_the_density(name):
    result = assert_samples_pdf(*PAIRS[name]())
    assert result.cells >= 200


@pytest.mark.parametrize("name", all_but_slow(PAIRS, QUICK))
def test_the_density_is_that_of_the_map(name):
    sample, pdf, _ = PAIRS[name]()
    assert assert_jacobian(sample, pdf) < 1e-4


def normal_and_sphere(u):
    """Return the normal (0, 0, 1) plus a uniform point of the unit sphere, normalised."""
    z, turn = 1.0 - 2.0 * u[0], 2.0 * jnp.pi * u[1]
    side = jnp.sqrt(4.0 * u[0] * (1.0 - u[0]))
    return normalize(Vec3(side * jnp.cos(turn), side * jnp.sin(turn), 1.0 + z))


@pytest.mark.slow
def test_a_unit_sphere_and_the_normal_make_the_cosine():
    assert assert_samples_pdf(normal_and_sphere, lambda w: warps.pdf_cosine_hemisphere(w.z), HEMISPHERE).cells >= 200
    with pytest.raises(AssertionError):
        assert_samples_pdf(normal_and_sphere, lambda w: warps.pdf_uniform_hemisphere(), HEMISPHERE)


def test_nothing_that_draws_is_left_out():
    drawn = {
        name
        for room in (warps, shapes, bsdfs)
        for name, function in vars(room).items()
        if name.startswith("sample_") and function.__module__ == room.__name__
    }
    missing = {name for name in drawn if not any(key.startswith(name) for key in PAIRS)}
    assert not missing, f"add {missing} to PAIRS"


# ---------------------------------------------------------------------------------------------------- mutants
#
# Each is a pair of which one half has a known mistake. Both tests must find it, except where a map folds: that keeps
# the Jacobian, and only counting finds it.


def polar(cosine, azimuth, sine=None):
    sine = jnp.sqrt(1.0 - cosine * cosine) if sine is None else sine
    return Vec3(sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), cosine)


cosine_sample, cosine_pdf, _ = cosine_hemisphere()
uniform_sample, uniform_pdf, _ = uniform_hemisphere()
area_sample, area_pdf, parallelogram = quad_by_area()
disk_sample, disk_pdf, round_domain = disk_by_area()
MUTANTS = {
    "missing cosine": (cosine_sample, uniform_pdf, HEMISPHERE),
    "sine of another measure": (uniform_sample, lambda w: uniform_pdf(w) * jnp.sqrt(1.0 - w.z * w.z), HEMISPHERE),
    "per solid angle, not per area": (
        area_sample,
        lambda x: area_pdf(x) * dot(x - POINT, x - POINT),
        parallelogram,
    ),
    "a disk's radius drawn uniformly": (lambda u: disk_sample((u[0] ** 2, u[1])), disk_pdf, round_domain),
    "factor 1.02": (cosine_sample, lambda w: 1.02 * cosine_pdf(w), HEMISPHERE),
    "a coordinate used twice": (lambda u: cosine_sample((u[0], u[0])), cosine_pdf, HEMISPHERE),
    "square root forgotten": (lambda u: cosine_sample((u[0] ** 2, u[1])), cosine_pdf, HEMISPHERE),
    "not of unit length": (
        lambda u: polar(jnp.sqrt(1.0 - u[0]), 2.0 * math.pi * u[1], sine=u[0]),
        cosine_pdf,
        HEMISPHERE,
    ),
    "half never drawn": (lambda u: cosine_sample((u[0], 0.5 * u[1])), cosine_pdf, HEMISPHERE),
    "half never drawn, the other half twice": (
        lambda u: cosine_sample((u[0], jnp.abs(u[1] - 0.5))),
        cosine_pdf,
        HEMISPHERE,
    ),
    "below the horizon": (lambda u: -uniform_sample(u), uniform_pdf, HEMISPHERE),
    "density NaN where it is drawn": (
        uniform_sample,
        lambda w: jnp.sqrt(w.z - 1e-3) * 0.0 + uniform_pdf(w),
        HEMISPHERE,
    ),
    "sample NaN": (
        lambda u: polar(jnp.where(u[0] < 0.01, jnp.nan, u[0]), 2.0 * math.pi * u[1]),
        uniform_pdf,
        HEMISPHERE,
    ),
}
SLOW = {"sine of another measure", "not of unit length", "below the horizon", "sample NaN"}
ONLY_COUNTING = {"half never drawn, the other half twice", "below the horizon"}


@pytest.mark.parametrize("name", all_but_slow(MUTANTS, MUTANTS.keys() - SLOW))
def test_counting_finds_a_mutant(name):
    with pytest.raises(AssertionError, match=r"n = "):
        assert_samples_pdf(*MUTANTS[name], n=1 << 16)


@pytest.mark.parametrize("name", all_but_slow(MUTANTS, MUTANTS.keys() - SLOW))
def test_the_jacobian_finds_a_mutant(name):
    sample, pdf, _ = MUTANTS[name]
    if name in ONLY_COUNTING:
        assert_jacobian(sample, pdf)
    else:
        with pytest.raises(AssertionError, match="density times Jacobian"):
            assert_jacobian(sample, pdf)
