"""What one sample depends on: gradients and extents against closed forms, and fireflies of the mirror box."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import plot, scenes
from jaxmc.transport.autopsy import outlines


def peak(u, height):
    """Return a ridge that is narrow in u[0], a slope in u[1], and a plateau of width 0.25 in u[2]."""
    return height * jnp.exp(-20.0 * u[0]) * (1.0 + u[1]) * jnp.where(u[2] < 0.25, 1.0, 0.1)


INTEGRAND = mc.Integrand(peak, 3, (7.0,), labels=("ridge", "slope", "plateau"))


def first_on_the_plateau(sampler=None, points=None):
    drawn = mc.draw(INTEGRAND, n=64, **({} if sampler is None else {"sampler": sampler, "points": points}))
    chosen = (drawn.u[:, 2] < 0.25) & (drawn.u[:, 1] < 0.9) & (drawn.u[:, 0] < 0.9) & (drawn.u[:, 0] > 0.05)
    return int(drawn.index[np.flatnonzero(chosen)[0]])


def check_peak(spike):
    a, b, _ = spike.u
    # d log(e^(-20 a) (1 + b)) / da and / db; half the value is reached at a + ln 2 / 20, or at (1 + b) / 2 - 1 < 0.
    assert np.allclose(spike.gradient, [-20.0, 1.0 / (1.0 + b), 0.0], rtol=1e-6)
    assert np.allclose(spike.lower, 0.0, atol=1e-6)
    assert np.allclose(spike.upper, [min(a + np.log(2.0) / 20.0, 1.0), 1.0, 0.25], atol=2e-4)
    assert spike.value == pytest.approx(7.0 * np.exp(-20.0 * a) * (1.0 + b), rel=1e-4) and spike.precise


def test_gradient_and_extents_of_a_peak():
    spike = mc.spike(INTEGRAND, first_on_the_plateau())
    check_peak(spike)
    assert spike.labels[spike.order[-1]] == "slope" and spike.width[0] == pytest.approx(0.05)
    assert np.isinf(spike.width[2]) and spike.chance == pytest.approx(np.prod(spike.extent))
    assert "one sample in" in str(spike) and len(spike.rows()) == 3
    with pytest.raises(AssertionError):
        check_peak(spike._replace(gradient=spike.gradient / spike.value))  # of the value instead of its logarithm
    with pytest.raises(AssertionError):
        check_peak(spike._replace(upper=spike.u + (spike.upper - spike.u) / 2))


def test_points_of_other_samplers_and_families():
    sampler = mc.Sobol()
    check_peak(mc.spike(INTEGRAND, first_on_the_plateau(sampler, 64), sampler=sampler, points=64))
    f = mc.Integrand(lambda u, item: jnp.stack([item * u[0], u[1]]), 2)
    spike = mc.spike(f, 5, of=lambda v: v[0] + 0.0 * v[1], item=3)
    assert spike.value == pytest.approx(3.0 * spike.u[0]) and spike.gradient == pytest.approx([1 / spike.u[0], 0.0])
    assert spike.labels == ("u[0]", "u[1]")


def test_what_has_no_spike_is_refused():
    with pytest.raises(ValueError, match="value 0"):
        mc.spike(lambda u: 0.0 * u[0], 1, dim=1)
    with pytest.raises(ValueError, match="one number"):
        mc.spike(lambda u: u, 1, dim=2)
    with pytest.raises(ValueError, match="index"):
        mc.spike(lambda u: u[0], -1, dim=1)


@pytest.fixture(scope="module")
def firefly():
    scene, camera = scenes.mirror_box(width=48, height=32)
    options = {"bounces": 4, "hide_emitters": True}
    image = mc.render(scene, camera, spp=64, tallies={"top": mc.TopSamples(256, mc.luminance)}, **options)
    return scene, camera, options, image["top"]


@pytest.mark.slow
def test_a_firefly_of_the_mirror_box(firefly):
    scene, camera, options, top = firefly
    found = mc.autopsy(scene, camera, int(top.index[0]), **options)
    assert found.path.line.endswith("diffuse -> mirror -> light") and found.kinds[-2:] == ("diffuse", "mirror")
    assert found.spike.value == pytest.approx(top.value[0], rel=1e-5)
    # The value is flat where the light is hit: no gradient says how unlikely that is, but the extents do.
    event = len(found.kinds) - 1
    assert found.unlikely.startswith(f"event {event}, direction")
    narrow = [k for k, label in enumerate(found.spike.labels) if label.startswith(f"event {event}, direction")]
    assert np.all(found.spike.extent[narrow] < 0.1) and 1e-7 < found.spike.chance < 1e-3
    assert found.points.shape == (len(found.kinds) + 2, 3)
    light = scene.given[0][6]
    assert np.allclose(found.points[-1][1], light.corner[1], atol=1e-4)
    assert np.all(np.abs(found.points[-1][[0, 2]] - [0.0, 0.4]) <= 0.0601)
    assert found.unlikely in str(found)
    fig, axes = plot.panels(2)
    for ax, plane in zip(axes, ((0, 1), (0, 2)), strict=True):
        plot.path_in_scene(ax, outlines(scene, plane), found.points, found.kinds, plane)
    assert plot.png(fig)[:4] == b"\x89PNG"


@pytest.mark.slow
def test_the_gradient_of_a_calm_sample_is_its_difference_quotient(firefly):
    scene, camera, options, top = firefly
    index = int(top.index[-1])
    found = mc.autopsy(scene, camera, index, **options)
    pixel = np.uint32(found.path.pixel[1] * camera.width + found.path.pixel[0])
    with jax.enable_x64(True):
        wide, view = scenes.mirror_box(width=48, height=32)
        f = mc.path_integrand(wide, view, **options)
        value = jax.jit(jax.vmap(lambda u: jnp.log(mc.luminance(f.fn(u, *f.params, pixel)))))
        steps = 1e-6 * np.concatenate([np.eye(f.dim), -np.eye(f.dim)])
        up, down = np.split(np.asarray(value(found.spike.u + steps)), 2)
    quotient = (up - down) / 2e-6
    assert found.spike.precise and np.abs(quotient).max() > 0.1
    assert np.allclose(found.spike.gradient, quotient, rtol=1e-3, atol=1e-4)


def test_outlines_of_all_shapes():
    shapes = [
        mc.Sphere((1, 2, 3), 0.5),
        mc.Quad((0, 0, 0), (1, 0, 0), (0, 0, 2)),
        mc.Triangle((0, 0, 0), (1, 0, 0), (0, 1, 0)),
        mc.Disk((1, 2, 3), (0, 2, 0), 0.5),
        mc.Box((0, 0, 0), (2, 4, 6)),
    ]
    ball, quad, triangle, disk, *box = outlines(mc.Scene(shapes), (0, 2))
    assert np.allclose(np.hypot(*(ball - [1, 3]).T), 0.5) and np.allclose(quad.max(0), [1, 2])
    assert np.allclose(np.hypot(*(disk - [1, 3]).T), 0.5) and np.allclose(disk[0], disk[-1])
    assert len(triangle) == 4 and np.allclose(np.abs(np.concatenate(box)), [1, 3])
