"""Views into an image beside closed forms."""

import numpy as np
import pytest

import jaxmc as mc
from jaxmc.transport.views import crop, resized

EYE = np.array((0.3, 0.2, 4.0))
CAMERA = mc.PinholeCamera(EYE, (0, 0, 0), fov=40, width=40, height=30)


def directions(camera, shift=0.5):
    """Return the unit directions through the middles of the pixels, shape (height, width, 3), in float64."""
    s = (np.arange(camera.width) + shift) / camera.width * 2 - 1
    t = (np.arange(camera.height) + shift) / camera.height * 2 - 1
    forward, right, down = (np.array(v, float) for v in (camera.forward, camera.right, camera.down))
    d = forward + s[None, :, None] * right + t[:, None, None] * down
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@pytest.mark.parametrize("center", [(0.0, 0.0, 0.0), (0.5, -0.3, 1.0)])
def test_normals_and_depth_of_a_sphere(center):
    scene, d = mc.Scene([mc.Sphere(center, 0.8)]), directions(CAMERA)
    b, c = d @ (EYE - center), np.sum((EYE - center) ** 2) - 0.8**2
    hit = b * b > c
    t = -b - np.sqrt(np.where(hit, b * b - c, 0.0))
    normal = (EYE + t[..., None] * d - center) / 0.8
    sure = np.abs(b * b - c) > 1e-3  # rounding may decide at the rim
    normals, depth = mc.view_normals(scene, CAMERA), mc.view_depth(scene, CAMERA)
    assert normals.shape == (30, 40, 3) and depth.shape == (30, 40) and (hit & sure).sum() > 100
    np.testing.assert_allclose(normals[hit & sure], normal[hit & sure], atol=2e-5)
    np.testing.assert_allclose(depth[hit & sure], t[hit & sure], rtol=2e-5)
    assert not normals[~hit & sure].any() and np.isinf(depth[~hit & sure]).all()


def test_depth_and_normals_of_a_plane_seen_from_both_sides():
    normal = np.array((0.0, 0.6, 0.8))
    across = np.array((0.0, 0.8, -0.6))
    corner = -50 * across - np.array((50.0, 0, 0))
    scene, d = mc.Scene([mc.Quad(corner, (100, 0, 0), 100 * across)]), directions(CAMERA)
    expected = -(EYE @ normal) / (d @ normal)
    np.testing.assert_allclose(mc.view_depth(scene, CAMERA), expected, rtol=1e-5)
    np.testing.assert_allclose(mc.view_normals(scene, CAMERA), np.broadcast_to(normal, d.shape), atol=1e-6)
    behind = mc.PinholeCamera(-EYE, (0, 0, 0), fov=40, width=40, height=30)
    np.testing.assert_allclose(mc.view_normals(scene, behind), np.broadcast_to(-normal, d.shape), atol=1e-6)


def test_views_of_a_scene_that_lies_far_away():
    far = np.array((3000.0, -2000.0, 5000.0))
    scene = mc.Scene([mc.Box(far, (0.5, 0.5, 0.5))])
    camera = mc.PinholeCamera(far + np.array((0, 0, 4)), far, fov=20, width=9, height=9)
    assert mc.view_depth(scene, camera)[4, 4] == pytest.approx(3.75, rel=1e-5)
    np.testing.assert_allclose(mc.view_normals(scene, camera)[4, 4], (0, 0, 1), atol=1e-6)


def test_pieces_of_a_large_image_fit_together(monkeypatch):
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0)])
    whole = mc.view_depth(scene, CAMERA)
    monkeypatch.setattr("jaxmc.transport.views.RAYS", 500)
    np.testing.assert_array_equal(mc.view_depth(scene, CAMERA), whole)


def test_bounces_of_a_furnace_that_absorbs():
    # Inside of a sphere of albedo a nothing escapes; roulette lets a path live with probability a after each event.
    a, most, spp = 0.6, 12, 400
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Diffuse(a), emission=1.0)])
    camera = mc.PinholeCamera((0.2, 0, 0), (1, 0, 0), width=12, height=8)
    found = mc.view_bounces(scene, camera, spp=spp, bounces=most, roulette=a, key=4)
    mean = (1 - a**most) / (1 - a)
    variance = sum((2 * k + 1) * a**k for k in range(most)) - mean**2  # E N^2 = sum of (2 k + 1) P(N > k)
    assert np.abs(found.mean() - mean) < 5 * np.sqrt(variance / (spp * found.size))


def test_bounces_of_a_furnace_that_lets_escape():
    # From the middle of the floor of a cube without lid, cosine-weighted directions leave with the form factor of the
    # opening: of a small element and a parallel square, with half sides A = B = 1 / 2 of the distance.
    walls = [
        mc.Quad((-1, -1, -1), (2, 0, 0), (0, 0, 2)),
        mc.Quad((-1, -1, -1), (2, 0, 0), (0, 2, 0)),
        mc.Quad((-1, -1, 1), (2, 0, 0), (0, 2, 0)),
        mc.Quad((-1, -1, -1), (0, 0, 2), (0, 2, 0)),
        mc.Quad((1, -1, -1), (0, 0, 2), (0, 2, 0)),
    ]
    camera = mc.PinholeCamera((0, 0.9, 0), (0, -1, 0), up=(0, 0, 1), fov=0.1, width=8, height=8)
    root = np.sqrt(1 + 0.25)
    escapes = 4 / (2 * np.pi) * 2 * (0.5 / root * np.arctan(0.5 / root))
    spp = 2000
    found = mc.view_bounces(mc.Scene(walls, sky=1.0), camera, spp=spp, bounces=2, lights="none")
    error = np.sqrt(escapes * (1 - escapes) / (spp * 64))
    assert abs(found.mean() - (2 - escapes)) < 5 * error < 0.01


def test_no_event_where_nothing_is_met_and_one_on_black():
    scene = mc.Scene([mc.Quad((-9, -9, 0), (9, 0, 0), (0, 18, 0), mc.Diffuse(0.0))])
    room = [mc.Quad((-9, -9, 9), (18, 0, 0), (0, 18, 0))]  # behind the camera, in the way of paths that go on
    camera = mc.PinholeCamera((0, 0, 4), (0, 0, 0), width=6, height=4)
    found = mc.view_bounces(mc.Scene([*scene.given[0], *room]), camera, bounces=5, spp=8)
    np.testing.assert_array_equal(found, np.tile([1, 1, 1, 0, 0, 0], (4, 1)))


@pytest.fixture(scope="module")
def half_lit():
    """A pixel that sees a light of radiance 20 with half of its area, and beside it one that sees nothing but it."""
    scene = mc.Scene([mc.Quad((-9, -9, 0), (9, 0, 0), (0, 18, 0), mc.Diffuse(0.0), emission=20.0)])
    return scene, mc.PinholeCamera((0, 0, 1), (0, 0, 0), width=3, height=1)


def test_relative_variance_of_a_coin(half_lit):
    spp = 4096
    found = mc.view_variance(*half_lit, spp=spp, bounces=0)
    # (1 - p) / p at p = 1 / 2 has derivative -4, and p has the error 1 / (2 sqrt(spp)).
    assert found.shape == (1, 3) and abs(found[0, 1] - 1) < 5 * 2 / np.sqrt(spp)
    assert found[0, 0] == 0.0 and np.isnan(found[0, 2])


def test_fireflies_are_counted(half_lit):
    spp = 200
    mean = mc.render(*half_lit, spp=spp, bounces=0).mean[..., 0]
    found = mc.view_fireflies(*half_lit, spp=spp, bounces=0)
    np.testing.assert_array_equal(found, np.rint(mean / 20.0 * spp))
    assert found[0, 0] == spp and 0 < found[0, 1] < spp and found[0, 2] == 0
    assert found.dtype.kind == "i"


@pytest.mark.slow
def test_there_are_no_fireflies_above_the_brightest_light(half_lit):
    assert not mc.view_fireflies(*half_lit, spp=64, bounces=0, threshold=20.5).any()


def test_time_is_that_of_tiles():
    scene = mc.Scene([mc.Sphere((0, 0, 0), 1.0, emission=1.0)])
    seconds = mc.view_time(scene, CAMERA, spp=16, tile=20, rounds=2, bounces=0)
    assert seconds.shape == (30, 40) and (seconds > 0.0).all() and (seconds < 1e-2).all()
    for rows in (slice(0, 20), slice(20, None)):
        for columns in (slice(0, 20), slice(20, None)):
            assert np.ptp(seconds[rows, columns]) == 0.0
    assert len(np.unique(seconds)) > 1


def test_parts_of_an_image_look_through_the_same_pixels():
    part = crop(CAMERA, 24, 10, 24, 8)
    assert (part.width, part.height) == (16, 8)
    np.testing.assert_allclose(directions(part), directions(CAMERA)[10:18, 24:], atol=1e-12)


@pytest.mark.parametrize("size", [(80, 60), (30, 30), (7, 50)])
def test_resized_cameras_keep_the_vertical_field_of_view(size):
    expected = mc.PinholeCamera(EYE, (0, 0, 0), fov=40, width=size[0], height=size[1])
    found = resized(CAMERA, *size)
    assert (found.width, found.height) == size
    np.testing.assert_allclose(directions(found), directions(expected), atol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s, c: mc.view_normals([s], c), "mc.Scene"),
        (lambda s, c: mc.view_depth(s, None), "mc.PinholeCamera"),
        (lambda s, c: mc.view_bounces(s, c, spp=0), "spp"),
        (lambda s, c: mc.view_bounces(s, c, bounces=-1), "bounces"),
        (lambda s, c: mc.view_variance(s, c, spp=2.5), "spp"),
        (lambda s, c: mc.view_fireflies(s, c, threshold=0), "threshold"),
        (lambda s, c: mc.view_time(s, c, tile=0), "tile"),
        (lambda s, c: mc.view_time(s, c, rounds=1), "rounds"),
        (lambda s, c: resized(c, 0, 5), "width"),
    ],
)
def test_bad_input_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call(mc.Scene([mc.Sphere((0, 0, 0), 1.0)]), CAMERA)
