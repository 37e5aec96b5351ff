"""Pixel filters: their formulas, exact pixels, the film that shares samples, its error bars, and wrong films."""

import dataclasses
import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from analytic_scenes import coverage, pixels
from analytic_scenes.scene import value_and_derivatives
from jaxmc.integration.samplers import Independent, Index, index_words, seed_words
from jaxmc.testing import joint_sigmas
from jaxmc.transport.film import Film, Splat
from jaxmc.transport.film_sums import FilmSums

BOX, TENT, MITCHELL, GAUSSIAN = FILTERS = mc.BoxFilter(), mc.TentFilter(), mc.MitchellFilter(), mc.GaussianFilter()
OTHERS = mc.BoxFilter(1.3), mc.TentFilter(2.5), mc.MitchellFilter(0.0, 0.5, 1.7), mc.GaussianFilter(0.9, 2.0)


def some(*quick):
    """Return the four filters as parameters; all but ``quick`` are slow."""
    marks = [() if f in quick else pytest.mark.slow for f in FILTERS]
    cases = [pytest.param(f, id=type(f).__name__, marks=m) for f, m in zip(FILTERS, marks, strict=True)]
    return pytest.mark.parametrize("filter", cases)


SIZE, TILE = 24, 8
ANGLE, OFFSET = 0.7, 0.2


def half_plane(x, y):
    return jnp.where(x * math.cos(ANGLE) + y * math.sin(ANGLE) < OFFSET, 1.0, 0.0)


@functools.cache
def samples_of(picture, width):
    """Return the samples of an image of ``picture(x, y, u)``, of film positions in pixels."""

    def sample(u, pixel):
        x, y = (pixel % width).astype(float) + u[0], (pixel // width).astype(float) + u[1]
        return Splat((picture(x, y, u),), u[0], u[1], pixel)

    return mc.Integrand(sample, 3, lazy=True)


def image(picture, filter, width, height, n, film=Film, **options):
    """Return the estimate of an image, its mean and its standard error."""
    estimate = mc.integrate_each(samples_of(picture, width), width * height, n=n, kept=film(filter, width), **options)
    error = (estimate.between or estimate.moments)[0]
    error = np.sqrt(error.variance / error.n)
    return estimate, estimate.moments[0].mean.reshape(height, width), error.reshape(height, width)


def tiled(x, y, u):
    """A half-plane in every tile of 8 x 8 pixels, through the pixel (4, 4) of it."""
    return half_plane((x % TILE) - 4.5, (y % TILE) - 4.5)


def noisy(x, y, u):
    return tiled(x, y, u) * jnp.where(u[2] < 0.2, 5.0, 0.0)


def huge(x, y, u):
    return noisy(x, y, u) * 1e30


def tiny(x, y, u):
    return noisy(x, y, u) * 1e-30


# ------------------------------------------------------------------------------------------------------- filters


@pytest.mark.parametrize("filter", [*FILTERS, *OTHERS], ids=str)
def test_a_filter_has_the_integral_and_support_that_it_says(filter):
    x = (np.arange(200_000) + 0.5) / 200_000 * 2.0 * filter.radius - filter.radius
    with jax.enable_x64(True):
        profile = np.asarray(filter.profile(x))
        outside = filter.profile(np.array([-1.001, 1.001]) * filter.radius)
        assert filter(0.3, -0.2) == filter.profile(0.3) * filter.profile(0.2)
        exact = coverage.profile(filter)
        density, mass = np.asarray(exact.density(x)), np.asarray(exact.cumulative(x))
    assert math.isclose((profile.mean() * 2.0 * filter.radius) ** 2, filter.integral, rel_tol=1e-8)
    assert np.all(np.asarray(outside) == 0.0) and np.allclose(profile, profile[::-1], atol=1e-12)
    # The exact pixels have formulas of their own.
    np.testing.assert_allclose(density, profile / math.sqrt(filter.integral), atol=1e-12)
    np.testing.assert_allclose(np.diff(mass) / np.diff(x), (density[1:] + density[:-1]) / 2.0, atol=2e-5)
    assert math.isclose(mass[-1], 1.0, abs_tol=1e-5)


def test_mitchell_has_the_values_of_the_paper():
    assert np.allclose(MITCHELL.profile(np.array([0.0, 1.0, 1.5, 2.0])), [8 / 9, 1 / 18, -5 / 144, 0.0], atol=1e-6)
    assert np.allclose(mc.MitchellFilter(1.0, 0.0).profile(np.array([0.0, 1.0])), [2 / 3, 1 / 6])  # a cubic B-spline


BAD = [
    ("box", lambda: mc.BoxFilter(0.4), "BoxFilter radius must be a number from 0.5 to 8, got 0.4"),
    ("wide", lambda: mc.TentFilter(9), "radius"),
    ("word", lambda: mc.TentFilter("1"), "radius"),
    ("nan", lambda: mc.MitchellFilter(math.nan), "MitchellFilter b"),
    ("c", lambda: mc.MitchellFilter(c=1.1), "MitchellFilter c"),
    ("sigma", lambda: mc.GaussianFilter(-1.0), "sigma"),
    ("narrow", lambda: mc.GaussianFilter(0.1), "GaussianFilter radius must be"),
    ("cut", lambda: mc.GaussianFilter(1.0, math.inf), "cut"),
    ("no filter", lambda: mc.render(*lit(), spp=1, filter="box"), "mc.TentFilter"),
    ("a class", lambda: mc.render(*lit(), spp=1, filter=mc.BoxFilter), "mc.TentFilter"),
    ("no anti-aliasing", lambda: mc.render(*lit(antialias=False), spp=1, filter=TENT), "antialias=False"),
    ("antialias", lambda: lit(antialias=1), "antialias must be True or False, got 1"),
    ("coverage", lambda: coverage.half_plane_coverage("box", 0.0, 0.0), "four|box, tent"),
]


@pytest.mark.parametrize(("make", "words"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


# -------------------------------------------------------------------------------------------------- exact pixels

# Figures with 40 digits, computed once from the formulas named, independently of this package.
SIXTH = math.pi / 6
REFERENCE = {  # filter, angle, offset, value, derivative with respect to the offset
    "box: 1/2 + s": (BOX, 0.0, 0.2, 0.7, 1.0),
    "tent: 1 - (1 - s)^2 / 2": (TENT, 0.0, 0.3, 0.755, 0.7),
    "Mitchell: integral of its cubics": (MITCHELL, 0.0, 0.5, 0.87934027777777777778, 0.53472222222222222222),
    "Mitchell above 1": (MITCHELL, 0.0, 1.3, 1.0147680555555555556, -0.029944444444444444444),
    "Gaussian, any angle: erfc": (mc.GaussianFilter(0.5, 9), 1.1, 0.4, 0.78814460141660331442, 0.57938310552296547623),
    "Gaussian cut at 3 sigma": (GAUSSIAN, 0.0, 0.4, 0.78892463901960732148, 0.58095155624746726865),
    "box at 30 degrees: truncated powers": (BOX, SIXTH, 0.25, 0.78349364905389033831, 1.0),
    "tent at 30 degrees: truncated powers": (TENT, SIXTH, 0.25, 0.72096680126147954892, 0.79358942726814041791),
    "Mitchell at 30 degrees": (MITCHELL, SIXTH, 0.25, 0.72461628210436448142, 0.81653921977036288793),
}


@pytest.mark.parametrize("name", REFERENCE)
def test_half_plane(name):
    filter, angle, offset, value, slope = REFERENCE[name]
    pixel = jax.jit(jax.vmap(jax.value_and_grad(lambda s, a: coverage.half_plane_coverage(filter, a, s)), (None, 0)))
    with jax.enable_x64(True):
        values, slopes = map(np.asarray, pixel(offset, np.array([angle, math.pi / 2 - angle, math.pi + angle])))
    np.testing.assert_allclose(values, value, rtol=1e-12)
    np.testing.assert_allclose(slopes, slope, rtol=1e-10, atol=1e-14)


def test_disk():
    def disk(cx, cy, r):
        return analytic_scenes.disk_coverage(BOX, cx - 0.5, cy - 0.5, r)

    value, slopes = value_and_derivatives(disk, cx=0.2, cy=0.3, r=0.6)
    assert math.isclose(value, 0.63267259096804041745, rel_tol=1e-12)  # circular segments
    assert math.isclose(slopes["r"], 1.4605392071083904576, rel_tol=1e-10)  # the arc inside
    assert math.isclose(slopes["cx"], 0.86568542494923801952, rel_tol=1e-10)


def test_outline_of_a_sphere():
    fov = 2.0 * math.degrees(math.atan(0.5))
    camera = mc.PinholeCamera((0, 0, 0), (0, 0, 1), up=(0, 1, 0), fov=fov, width=1, height=1)

    def area(z, radius):
        return analytic_scenes.sphere_outline(camera, (0.4, 0.1, z), radius).area

    value, slopes = value_and_derivatives(area, z=4.0, radius=0.5)
    assert math.isclose(value, 0.050134948814016711043, rel_tol=1e-12)  # section of a cone
    assert math.isclose(slopes["radius"], 0.20373996218503046171, rel_tol=1e-10)
    assert math.isclose(slopes["z"], -0.025601335431708940265, rel_tol=1e-10)
    with jax.enable_x64(True):
        inside = analytic_scenes.sphere_outline(camera, (0.4, 0.1, 4.0), 0.5).coverage(BOX, 0, 0)
    assert math.isclose(inside, value, rel_tol=1e-12)  # the window holds all of it


@some(BOX, MITCHELL)
def test_an_ellipse_agrees_with_a_sum_and_its_derivatives_with_differences(filter):
    shape = {"x": 0.3, "y": -0.2, "xx": 0.5, "xy": 0.2, "yy": 0.4}
    value, slopes = value_and_derivatives(lambda **s: coverage.ellipse_coverage(filter, **s), **shape)
    g = (np.arange(1000) + 0.5) / 1000 * 2.0 * filter.radius - filter.radius
    weight = np.outer(filter.profile(g), filter.profile(g))
    x, y = g[:, None] - shape["x"], g - shape["y"]
    inverse = np.linalg.inv([[shape["xx"], shape["xy"]], [shape["xy"], shape["yy"]]])
    inside = inverse[0, 0] * x * x + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y * y < 1.0
    assert math.isclose(value, (weight * inside).sum() / weight.sum(), abs_tol=5e-4)
    area = jax.jit(lambda shape: coverage.ellipse_coverage(filter, **shape))
    with jax.enable_x64(True):
        for name, slope in slopes.items():
            low, high = (float(area({**shape, name: shape[name] + h})) for h in (-1e-5, 1e-5))
            assert math.isclose(slope, (high - low) / 2e-5, abs_tol=1e-7)


# ------------------------------------------------------------------------------------------------------ the film


@some(MITCHELL)
def test_the_film_is_the_plain_sum_over_all_samples(filter):
    width, height, n = 11, 7, 70  # of more than one block
    picture = lambda x, y, u: x + 10.0 * y + u[2]  # noqa: E731
    _, mean, _ = image(picture, filter, width, height, n, key=5)
    index = np.arange(width * height * n)
    words, pixel = index_words(index), index % (width * height)
    seed = jnp.asarray(seed_words(5))
    u = np.asarray(jax.vmap(lambda w: Independent().point(seed, Index(w[0], w[1]))[jnp.arange(3)])(words), np.float64)
    x, y = pixel % width + u[:, 0], pixel // width + u[:, 1]
    light = np.asarray(picture(x, y, u.T))
    expected = np.empty((height, width))
    for row, column in np.ndindex(expected.shape):
        with jax.enable_x64(True):
            w = np.asarray(filter(x - column - 0.5, y - row - 0.5))
        expected[row, column] = w @ light / w.sum()
    np.testing.assert_allclose(mean, expected, rtol=2e-6, atol=2e-5)


@some(MITCHELL)
def test_a_film_is_the_same_for_any_chunk_and_number_of_workers(filter):
    runs = [image(noisy, filter, 61, 40, 70, chunk=chunk, workers=workers, sampler=sampler, replicates=r)
            for sampler, r in ((mc.Independent(), None), (mc.Sobol(), 3))
            for chunk, workers in ((None, 1), (1, 2))]  # fmt: skip
    for same in (runs[:2], runs[2:]):
        assert all(np.array_equal(same[0][k], run[k]) for run in same[1:] for k in (1, 2))


def errors_of(filter, film=Film, n=64, picture=tiled, side=16 * TILE, **options):
    """Return the errors of the pixels (4, 4) of all tiles and their standard errors, the edge of the image apart."""
    with jax.enable_x64(True):
        exact = float(coverage.half_plane_coverage(filter, ANGLE, OFFSET))
    _, mean, error = image(picture, filter, side, side, n, film, **options)
    return mean[4::TILE, 4::TILE].ravel() - exact, error[4::TILE, 4::TILE].ravel()


def assert_right(filter, film):
    """All pixels at once and their mean lie within five standard errors of the truth, which are small."""
    off, error = errors_of(filter, film)
    assert error.mean() < 0.06
    assert np.abs(off).max() <= joint_sigmas(len(off)) * error.mean()
    assert abs(off.mean()) <= 5.0 * off.std() / math.sqrt(len(off))


@some(MITCHELL)
def test_the_film_is_right(filter):
    assert_right(filter, Film)


class NotNormalised(Film):
    def result(self, state):
        moments = state[0].moments()
        weight = state[0].total[0][:, None] / (moments.n * math.sqrt(1.1 * self.filter.integral))
        return [moments._replace(mean=moments.mean * weight)]


class WrongSign(Film):
    def _weights(self, x):
        return super()._weights(x)[:, ::-1]


class WrongRow(Film):
    def _weights(self, x):
        return super()._weights(1.0 - x)


class OwnSamplesOnly(Film):
    def _weights(self, x):
        reach = self.filter.reach
        return super()._weights(x) * (jnp.arange(-reach, reach + 1) == 0)[None, :, None]


class TooNarrow(Film):
    def _weights(self, x):
        weights, x = super()._weights(x), x[:, None] - 0.5
        reach = self.filter.reach
        far = jnp.abs(x - jnp.arange(-reach, reach + 1, dtype=x.dtype)[None, :, None]) > 0.5 * self.filter.radius
        return jnp.where(far, 0.0, weights)


@pytest.mark.parametrize("film", [NotNormalised, WrongSign, WrongRow, OwnSamplesOnly, TooNarrow])
def test_a_wrong_film_is_found(film):
    with pytest.raises(AssertionError):
        assert_right(MITCHELL, film)


def test_the_border_has_no_samples_outside():
    _, mean, _ = image(lambda x, y, u: jnp.ones_like(x), MITCHELL, 9, 9, 4)
    assert np.array_equal(mean, np.ones((9, 9)))
    # Half of a tent on a slope: the mean of x from the border on, known in closed form.
    _, mean, error = image(lambda x, y, u: x, TENT, 16, 512, 64)
    assert abs(mean[:, 0].mean() - 25 / 42) < 5.0 * error[:, 0].mean() / math.sqrt(512 / 3)


# ---------------------------------------------------------------------------------------------------- error bars


@some(MITCHELL)
def test_error_bars_are_those_of_the_pixels(filter):
    for picture, (n, least) in itertools.product((tiled, noisy), ((4, 0.65), (16, 0.86), (64, 0.91))):
        off, error = errors_of(filter, n=n, picture=picture, side=32 * TILE, key=3)
        assert math.isclose(np.sqrt((error**2).mean()), off.std(), rel_tol=0.09)  # 1024 pixels tell 2.2 % or so
        assert abs(off.mean()) < 5.0 * off.std() / 32 and abs(off.mean()) < 0.15 * off.std()
        if filter is not BOX:
            assert least <= np.mean(np.abs(off) <= 1.96 * error) <= 0.98


@some(MITCHELL)
def test_error_bars_from_replicates(filter):
    off, error = errors_of(filter, n=64, side=24 * TILE, sampler=mc.Sobol(), replicates=8)
    assert math.isclose(np.sqrt((error**2).mean()), off.std(), rel_tol=0.15)
    assert np.abs(off).max() <= joint_sigmas(len(off), 7) * error.mean() * 2.0
    plain, _ = errors_of(filter, n=64, side=24 * TILE)
    assert off.std() < 0.7 * plain.std()


def test_the_default_box_is_the_pixel_itself():
    scene, camera = lit()
    plain, boxed = (mc.render(scene, camera, spp=12, bounces=2, filter=f) for f in (None, BOX))
    np.testing.assert_allclose(boxed.mean, plain.mean, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(boxed.variance, plain.variance, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(boxed.stderr, np.sqrt(boxed.variance / 12), rtol=1e-12)


def test_a_constant_has_no_error():
    estimate, mean, error = image(lambda x, y, u: jnp.full_like(x, 0.3), MITCHELL, 12, 9, 70)
    assert np.all(mean == float(jnp.asarray(0.3))) and np.all(error == 0.0) and estimate.status == "all samples equal"


def test_values_that_are_not_finite_spoil_what_they_reach_and_are_counted():
    bad = lambda x, y, u: jnp.where((x > 5) & (x < 6) & (y > 6) & (y < 7), jnp.inf, 1.0)  # noqa: E731
    estimate, mean, error = image(bad, TENT, 12, 12, 3)
    assert estimate.nonfinite == 3 and estimate.status == "non-finite values seen"
    spoilt = np.zeros((12, 12), bool)
    spoilt[5:8, 4:7] = True
    assert np.array_equal(~np.isfinite(mean), spoilt) and np.array_equal(~np.isfinite(error), spoilt)


@pytest.mark.slow
def test_huge_and_tiny_values_keep_their_error():
    _, mean_1, error_1 = image(noisy, MITCHELL, 16, 16, 16)
    for scale, picture in ((1e30, huge), (1e-30, tiny)):
        _, mean, error = image(picture, MITCHELL, 16, 16, 16)
        np.testing.assert_allclose(mean / scale, mean_1, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(error / scale, error_1, rtol=1e-3, atol=1e-5)


# -------------------------------------------------------------------------------------------------------- render


def lit(**camera):
    """Return a small lit scene and a camera."""
    ball = mc.Sphere((0.1, 0.1, 0), 0.6, mc.Diffuse((0.8, 0.6, 0.2)))
    lamp = mc.Quad((-0.5, 1.5, -0.5), (1, 0, 0), (0, 0, 1), mc.Diffuse(0.0), emission=4.0)
    view = mc.PinholeCamera((0, 0, 4), (0, 0, 0), fov=30, width=10, height=8, **camera)
    return mc.Scene([ball, lamp], sky=0.2), view


def pixels_of(filter, edge):
    """Return a scene, its camera, and the exact pixels of its image with a filter, away from the border."""
    camera = pixels.film_camera(float(SIZE), SIZE)
    middle = np.arange(3, SIZE - 3) + 0.5 - SIZE / 2
    with jax.enable_x64(True):
        x, y = (jnp.asarray(a) for a in np.meshgrid(middle, middle))
        if edge:
            scene = pixels.half_plane_scene(ANGLE, OFFSET)
            offset = OFFSET - x * math.cos(ANGLE) - y * math.sin(ANGLE)
            exact = jax.jit(jnp.vectorize(lambda s: coverage.half_plane_coverage(filter, ANGLE, s)))(offset)
        else:
            center, radius = (2.0, 1.0, -12.0), 6.0
            scene = mc.Scene([mc.Sphere(center, radius, mc.Diffuse(0.0), emission=1.0)])
            o = analytic_scenes.sphere_outline(camera, center, radius)
            x, y = x + SIZE / 2, y + SIZE / 2
            place = jnp.vectorize(lambda x, y: coverage.ellipse_coverage(filter, x, y, o.xx, o.xy, o.yy))
            exact = jax.jit(place)(o.x - x, o.y - y)
    return scene, camera, np.asarray(exact)


SOBOL = pytest.param(mc.Sobol(), 16, id="Sobol", marks=pytest.mark.slow)


@some(MITCHELL)
@pytest.mark.parametrize("edge", [True, False], ids=["half-plane", "sphere"])
@pytest.mark.parametrize("sampler, replicates", [pytest.param(mc.Independent(), None, id="Independent"), SOBOL])
def test_a_rendered_edge_is_exact(filter, edge, sampler, replicates):
    scene, camera, exact = pixels_of(filter, edge)
    estimate = mc.render(scene, camera, spp=128, bounces=0, filter=filter, sampler=sampler, replicates=replicates)
    inner = slice(3, SIZE - 3)
    mean, error = estimate.mean[inner, inner, 0], estimate.stderr[inner, inner, 0]
    at_edge = error > 1e-3
    assert at_edge.sum() >= SIZE and error.max() < 0.06
    assert estimate.recipe["filter"] == repr(filter) and estimate.mean.shape == (SIZE, SIZE, 3)
    freedom = np.inf if replicates is None else replicates - 1
    # An error below 1e-3 may be that of an edge that samples have hardly met. Under a box 8 points of a randomisation
    # may all miss what is covered in every one: then take the error of independent ones.
    floor = np.sqrt(np.clip(exact * (1.0 - exact), 0.0, None) / 128) if filter is BOX else 0.0
    bound = joint_sigmas(mean.size, freedom) * np.maximum(np.maximum(error, floor), 1e-3)
    assert np.all(np.abs(mean - exact) <= bound)
    z = (mean - exact)[at_edge] / error[at_edge]
    assert 0.7 < z.std() < 1.4


@pytest.mark.slow
def test_tallies_see_the_samples_themselves():
    scene, camera = lit()
    tallies = {"tail": mc.TailHistogram(of=mc.luminance), "top": mc.TopSamples(5, of=mc.luminance), "m": mc.Moments()}
    plain, wide = (mc.render(scene, camera, spp=8, bounces=2, tallies=tallies, filter=f) for f in (None, MITCHELL))
    assert np.array_equal(plain["tail"].count, wide["tail"].count)
    assert np.array_equal(plain["top"].index, wide["top"].index)
    assert wide["m"][0].mean.shape == (8, 10, 3)
    np.testing.assert_allclose(wide["m"][0].mean, plain["m"][0].mean, rtol=1e-5)
    with pytest.raises(ValueError, match="ratio"):
        wide.interval(bounds=(0.0, 10.0))
    assert np.all(wide.interval().upper >= wide.mean)


@pytest.mark.parametrize("filter", [mc.TentFilter(), MITCHELL, mc.GaussianFilter()], ids=lambda f: type(f).__name__)
def test_samples_at_the_border_of_a_filter_are_finite(filter):
    ends = np.array([2.0**-33, 1e-8, 0.5, 1.0 - 2.0**-24], np.float32)  # as far as coordinates go, and close to it
    u = np.stack(np.meshgrid(ends, ends), -1).reshape(-1, 2)
    values = np.asarray(pixels.half_plane_pixel(filter, offset=5.0).integrand.batch(jnp.asarray(u, float)))
    assert np.isfinite(values).all()
    # A tent is drawn as it is: before the sky alone each of its samples is 1.
    assert not isinstance(filter, mc.TentFilter) or np.allclose(values, 1.0, rtol=0.005)


# ------------------------------------------------------------------------------------------ without anti-aliasing


def test_a_camera_without_anti_aliasing_looks_through_the_middles():
    scene, camera = lit(antialias=False)
    estimate = mc.render(scene, camera, spp=3, bounces=0)
    assert np.all(estimate.variance == 0.0)
    x, y = np.meshgrid(np.arange(10) + 0.5, np.arange(8) + 0.5)
    rays = jax.vmap(camera.ray)(jnp.asarray(x.ravel(), float), jnp.asarray(y.ravel(), float))
    direct = [float(mc.integrate(mc.radiance(scene, (0, 0, 4), d, bounces=0), n=1).mean[0])
              for d in np.stack(rays.direction, -1)[:40:7]]  # fmt: skip
    np.testing.assert_allclose(estimate.mean[..., 0].ravel()[:40:7], direct, rtol=1e-6)


def test_its_samples_have_no_film_coordinates():
    scene, camera = lit(antialias=False)
    integrand = mc.path_integrand(scene, camera, bounces=2)
    with_film = mc.path_integrand(scene, dataclasses.replace(camera, antialias=True), bounces=2)
    assert integrand.labels[:2] == ("film: column", "film: row") and integrand.labels[2:] == with_film.labels[2:]
    assert integrand.fn.first(camera, 0) == 0 and with_film.fn.first(with_film.params[1], 0) == 2
    # The flat integral over the image is the mean of its pixels.
    pixels = mc.render(scene, camera, spp=4096, bounces=1)
    flat = mc.integrate(mc.path_integrand(scene, camera, bounces=1), n=1 << 18)
    error = np.hypot(flat.stderr, np.sqrt((pixels.stderr**2).sum((0, 1))) / 80)
    assert np.all(np.abs(flat.mean - pixels.mean.mean((0, 1))) < 5.0 * error) and np.all(error < 0.01 * flat.mean)


@pytest.mark.slow
def test_its_samples_can_be_replayed():
    scene, camera = lit(antialias=False)
    tallies = {"top": mc.TopSamples(3, of=mc.luminance)}
    top = mc.render(scene, camera, spp=16, bounces=2, tallies=tallies)["top"]
    for index, value in zip(top.index, top.value, strict=True):
        path = mc.replay(scene, camera, int(index), bounces=2)
        assert math.isclose(float(mc.luminance(path.value)), value, rel_tol=1e-5)


def test_film_sums_merge():
    rng = np.random.default_rng(0)
    shape = (2, 3, 1, 40)
    parts = [FilmSums(*shape[:1], *shape[1:]) for _ in range(3)]
    for k, part in enumerate(parts[:2]):
        part._accumulate(slice(None), rng.random((1, 40)), rng.random((5, 40)))
        part.n += k + 2
    for part in parts[:2]:
        parts[2].merge(part)
    assert np.all(parts[2].n == 5) and np.allclose(parts[2].total[0], parts[0].total[0] + parts[1].total[0])
