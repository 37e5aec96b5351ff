"""How a point on a light is drawn changes no mean: by area and by solid angle, sampled, weighted and met by chance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from jaxmc.testing import SPHERE, assert_equivalent, assert_samples_pdf, assert_unbiased
from jaxmc.transport import rays, shapes, spheres
from jaxmc.transport.vec import Vec3

SLOW = pytest.mark.slow
BLACK, Z = mc.Diffuse(0.0), (0.0, 0.0, 1.0)
WAYS = ("automatic", "area", "solid angle")
PLACE = {"corner": (-0.2, -0.3, 0.4), "edge_u": (0.0, 0.9, 0.0), "edge_v": (0.7, 0.0, 0.0)}
SKEWED = {"corner": (-0.2, -0.3, 0.4), "edge_u": (0.3, 0.9, 0.0), "edge_v": (0.7, 0.0, 0.2)}
BALL = (0.4, -0.3, 1.2)


def lit(*lights, **options):
    return mc.irradiance(mc.Scene(lights), (0, 0, 0), Z, bounces=0, **options)


def of_quad(place):
    return float(
        analytic_scenes.value_and_derivatives(analytic_scenes.parallelogram_irradiance, emission=1.0, **place)[0]
    )


def of_ball(radius):
    """Irradiance under a ball of emission 1 that lies above the horizon."""
    distance2 = float(np.dot(BALL, BALL))
    return np.pi * radius**2 / distance2 * BALL[2] / np.sqrt(distance2)


@pytest.mark.parametrize("lights", ["nee", "mis"])
@pytest.mark.parametrize("way", WAYS)
def test_no_way_changes_the_irradiance(way, lights):
    things = [
        mc.Quad(**PLACE, material=BLACK, emission=1.0, two_sided=lights == "mis"),
        mc.Sphere(BALL, 0.3, BLACK, 2.0, two_sided=lights == "mis"),
    ]

    alone = [mc.integrate(lit(thing, lights=lights, light_points=way), n=1 << 19, key=3) for thing in things]
    for estimate, exact in zip(alone, (of_quad(PLACE), 2.0 * of_ball(0.3)), strict=True):
        assert_unbiased(estimate, exact, 4e-3)


@pytest.mark.parametrize("way", WAYS)
def test_a_room_is_as_bright_by_all(way):
    room = [mc.Sphere((0, 0, 0), 2.0, mc.Diffuse(0.5), 0.3, inward=True)]
    lamps = [
        mc.Quad(**PLACE, material=mc.Diffuse(0.4), emission=1.0), mc.Sphere(BALL, 0.3, BLACK, 2.0, two_sided=True),
        mc.Quad(**SKEWED, material=BLACK, emission=(1.5, 1.0, 0.5)),
        mc.Triangle((-1, -1, -0.5), (0, -1, -0.5), (0, 0, -0.5), BLACK, 1.0, two_sided=True),
        mc.Box((-0.8, 0.6, 0.0), (0.2, 0.3, 0.4), material=BLACK, emission=0.8),
    ]  # fmt: skip
    camera = mc.PinholeCamera((1.2, 0.3, 0.2), (0, 0, 0), up=Z, fov=70, width=8, height=8)
    waited, sampled = (
        mc.integrate(
            mc.path_integrand(mc.Scene(room + lamps), camera, bounces=2, pick="distance", **options), n=n, key=k
        )
        for options, n, k in (({"lights": "none"}, 1 << 20, 1), ({"light_points": way}, 1 << 18, 2))
    )
    assert_equivalent(waited, sampled, 1e-2)


@pytest.mark.parametrize("inward", [False, True])
def test_spheres_are_drawn_by_their_area(inward):
    light = spheres.SphereLight(spheres.SphereShape(Vec3(*map(jnp.float32, BALL)), jnp.float32(0.6)), inward)
    point = Vec3(*map(jnp.float32, (0.3, -0.1, 0.9) if inward else (0.0, 0.0, 0.0)))

    def draw(u):
        return shapes.sample_light(light, point, False, u[0], u[1], "area")

    def pdf(w):
        distance = spheres.intersect(light.sphere, rays.ray(point, w), False)
        inverse = shapes.inverse_pdf(light, point, w, distance, "area")
        return jnp.where((distance < jnp.inf) & (inverse > 0.0), 1.0 / inverse, 0.0)

    u = jnp.asarray(np.random.default_rng(5).random((20000, 2)), float)
    seen = jax.vmap(draw)(u)
    ahead = np.asarray(seen.inverse_pdf) > 0.0
    met = jax.vmap(pdf)(seen.wi)
    # At the rim rounding decides, where next to nothing is seen.
    clear = ahead & (np.asarray(seen.inverse_pdf) > 0.02 * np.asarray(seen.inverse_pdf).max())
    np.testing.assert_allclose((met * seen.inverse_pdf)[clear], 1.0, rtol=2e-2)
    assert clear.sum() > 0.9 * ahead.sum()
    if inward:
        assert ahead.all()
        assert_samples_pdf(lambda u: draw(u).wi, pdf, SPHERE)
    else:
        # The near side of a ball is seen: a share (1 - R / d) / 2 of its area.
        share = 0.5 * (1.0 - 0.6 / np.sqrt(float(np.dot(BALL, BALL))))
        assert ahead.mean() == pytest.approx(share, abs=5.0 * np.sqrt(share / len(u)))


def test_a_near_rectangle_wants_its_solid_angle():
    near = {"corner": (-0.5, -0.5, 0.05), "edge_u": (0.0, 1.0, 0.0), "edge_v": (1.0, 0.0, 0.0)}
    lamp = mc.Quad(**near, material=BLACK, emission=1.0)
    variance = {
        way: float(mc.integrate(lit(lamp, lights="nee", light_points=way), n=1 << 16, key=1).variance) for way in WAYS
    }
    assert variance["area"] == variance["automatic"] > 100.0 * variance["solid angle"]


def test_a_density_of_another_way_is_noticed(monkeypatch):
    def forgetful(light, point, wi, distance, by, given=shapes.inverse_pdf):
        return given(light, point, wi, distance, "area")

    monkeypatch.setattr(shapes, "inverse_pdf", forgetful)
    lamp = mc.Quad(**PLACE, material=BLACK, emission=1.0)
    with pytest.raises(AssertionError):
        assert_unbiased(mc.integrate(lit(lamp, light_points="solid angle"), n=1 << 19, key=3), of_quad(PLACE), 4e-3)


def test_bad_ways_are_refused():
    with pytest.raises(ValueError, match="light_points must be one of automatic, area, solid angle"):
        lit(light_points="volume")
