"""Derivatives of whole paths against closed forms: silhouettes on the film, shadows, other surfaces, mirrors, glass."""

import dataclasses
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import two_bounce_reference
from moving_scenes import SCENES

import jaxmc as mc
from jaxmc.gradients import boundary, jumps, mirrors, walks
from jaxmc.gradients.derivative import derivatives

TABLE = json.loads((Path(__file__).parent / "data" / "two_bounce.json").read_text())
KINDS = {"film": mc.moving_paths, "point": mc.moving_irradiance, "ray": mc.moving_radiance}
QUICK = {"sphere over the film's edge", "slab of glass", "sky over a ground"}
BY_NAME = {scene.name: scene for scene in SCENES}


def made(scene):
    def make(params):
        what = scene.make(params)
        return KINDS[scene.kind](*(what if isinstance(what, tuple) else (what,)), bounces=scene.bounces)

    return make


def check(found, exact, share=0.01, grain=1e-4):
    """Within 6 standard errors of 16 replicates, these below a share of the largest component.

    Points that fill a line evenly resolve the end of an edge to one of so many, 16384 with 2^18 samples; where that is
    nearly a whole number of them all replicates may be off by the same, which is ``grain``.
    """
    largest = max(np.max(np.abs(truth)) for truth in exact.values())
    for name, truth in exact.items():
        mean, error = np.asarray(found.mean[name]), np.asarray(found.stderr[name])
        assert np.all(error <= share * np.maximum(np.abs(truth), 0.3 * largest)), (name, error, truth)
        assert np.all(np.abs(mean - truth) <= 6.0 * error + grain * largest), (name, mean, truth, error)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in BY_NAME]
)
def test_every_closed_form(name):
    scene = BY_NAME[name]
    found = mc.grad_integrate(made(scene), scene.params, n=1 << 18, sampler=mc.Sobol())
    check(found, scene.truth()[1])
    assert found.nonfinite == 0


def two_bounces(params):
    return mc.moving_paths(*two_bounce_reference.make(params), bounces=2)


def one_bounce(params):
    return mc.moving_paths(*two_bounce_reference.make(params), bounces=1)


def derivatives_of(*parts):
    return {k: sum(TABLE[part]["derivatives"][k] for part in parts) for k in two_bounce_reference.PARAMS}


@pytest.mark.slow
@pytest.mark.parametrize("make, parts", [(one_bounce, ["direct"]), (two_bounces, ["direct", "indirect"])])
def test_light_that_comes_over_one_surface_or_two(make, parts):
    """Lamp, blocker, floor, wall and camera, by 13 numbers, against quadrature."""
    found = mc.grad_integrate(
        make, dict(two_bounce_reference.PARAMS), n=1 << 19, boundary_n=1 << 20, sampler=mc.Sobol(), mode="reverse"
    )
    check(found, derivatives_of(*parts), grain=2e-5)
    # Without the boundary a blocker does not matter at all but for what it reflects.
    assert found.interior.mean["blocker_x"] == 0.0


def unused(view):
    """A window in which no edge matters."""

    def view_of_none(*args):
        window = view(*args)
        return window._replace(give=lambda wi: window.give(wi)._replace(used=False))

    return view_of_none


def nothing(real):
    return lambda world, *args: walks.black(world.rest)


SPOILED = {
    "film": ("sphere over the film's edge", boundary, "of_film", unused),
    "shadows": (None, boundary, "shadows", nothing),
    "outlines": (None, boundary, "of_vertex", unused),
    "edges in a mirror": ("lamp that a mirror's rim cuts", boundary, "in_mirrors", unused),
    "edges of a mirror": (
        "lamp that a mirror's rim cuts", jumps, "_slips", lambda real: lambda world, window, hit: not window.pinned
    ),
    "mirrors behind edges": ("lamp that a mirror's rim cuts", jumps, "look_through", lambda real: lambda *args: ()),
    "samples in a mirror": ("lamp that a mirror's rim cuts", walks, "look_through", lambda real: lambda *args: ()),
    "the ground": ("sky over a ground", boundary, "horizon", nothing),
    "the second mirror": ("periscope", mirrors, "IN_A_ROW", lambda real: 1),
}  # fmt: skip
SOME = "radius", "zenith", "low_corner", "mirror_edge_v", "near_corner", "far_corner", "point"


@pytest.mark.slow
@pytest.mark.parametrize("part", SPOILED)
def test_every_part_is_needed(monkeypatch, part):
    name, where, function, spoil = SPOILED[part]
    monkeypatch.setattr(where, function, spoil(getattr(where, function)))
    if name is None:
        exact = {k: derivatives_of("direct", "indirect")[k] for k in ("blocker_x", "wall")}
        params, make = two_bounce_reference.PARAMS, two_bounces
    else:
        exact = {k: v for k, v in BY_NAME[name].truth()[1].items() if k in SOME}
        params, make = BY_NAME[name].params, made(BY_NAME[name])
    moved = {k: params[k] for k in exact}
    found = mc.grad_integrate(lambda p: make({**params, **p}), moved, n=1 << 18, sampler=mc.Sobol())
    with pytest.raises(AssertionError):
        check(found, exact, share=np.inf)


# --------------------------------------------------------------------------------------- what holds in every scene


ROOM = {
    "lamp": np.array([-0.4, -0.4, 1.95]),
    "crate": np.array([0.35, 0.1, 0.5]),
    "ball": np.array([-0.5, 0.2, 0.45]),
    "size": np.array(1.0),
    "eye": np.array([0.1, -3.0, 1.2]),
}


def room(p, turn=None, scale=1.0, offset=0.0):
    """A room with a mirror on a wall, a crate, a ball of metal and a lamp: everything turned, scaled and moved."""
    turn = np.eye(3) if turn is None else turn

    def there(x):
        return scale * (turn @ jnp.asarray(x, float)) + offset

    def along(x):
        return scale * (turn @ jnp.asarray(x, float))

    white, metal = mc.Diffuse(0.6), mc.RoughConductor(0.3, 0.8)
    c, s = np.cos(0.5), np.sin(0.5)
    axes = [turn @ jnp.asarray(a) for a in ([c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0])]
    scene = mc.Scene([
        mc.Quad(there([-1.5, -1.5, 0.0]), along([3.0, 0.0, 0.0]), along([0.0, 3.0, 0.0]), white),
        mc.Quad(there([-1.5, 1.5, 0.0]), along([3.0, 0.0, 0.0]), along([0.0, 0.0, 2.2]), mc.Mirror(0.9)),
        mc.Quad(there(p["lamp"]), along([0.0, 0.8, 0.0]), along([0.8, 0.0, 0.0]), white, emission=6.0),
        mc.Box(there(p["crate"]), scale * p["size"] * np.array([0.4, 0.3, 0.5]), jnp.stack(axes), white),
        mc.Sphere(there(p["ball"]), scale * 0.3, metal),
    ])  # fmt: skip
    camera = mc.PinholeCamera(there(p["eye"]), there([0.0, 0.0, 0.6]), turn @ np.array([0.0, 0.1, 1.0]), 50.0, 16, 16)
    return mc.moving_paths(scene, camera, bounces=2)


def moved(p):
    return room(ROOM, offset=p)


def scaled(p):
    return room(ROOM, scale=p)


def turned(p):
    x, y, z = p
    zero = 0.0 * x
    skew = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    return room(ROOM, turn=jnp.eye(3) + skew)


def test_colours_in_a_mirror_on_a_film():
    scene = BY_NAME["horizon in a mirror on a film"]
    colours = {"sky": (2.0, 1.0, 0.5), "ground": (0.5, 0.1, 0.9), "reflectance": (0.8, 0.5, 0.2)}

    def make(zenith):
        return mc.moving_paths(*scene.make({**scene.params, **colours, "zenith": zenith}), bounces=1)

    found = mc.grad_integrate(make, scene.params["zenith"], n=1 << 14, sampler=mc.Sobol())
    for k in range(3):
        alone = scene._replace(params=scene.params | {name: colour[k] for name, colour in colours.items()})
        exact = alone.truth()[1]["zenith"]
        assert np.all(np.abs(found.mean[k] - exact) <= 6.0 * found.stderr[k] + 1e-3 * np.abs(exact).max())


def test_a_scene_without_primitives_is_refused():
    with pytest.raises(ValueError, match="nothing that moves: add one"):
        mc.moving_irradiance(mc.Scene([], 1.0), (0, 0, 0), (0, 0, 1), bounces=0)


@pytest.mark.slow
def test_moving_everything_changes_nothing():
    parts = derivatives(moved, jnp.zeros(3), "forward")
    size = np.abs(
        mc.draw(derivatives(lambda x: room(ROOM | {"ball": x}), ROOM["ball"], "forward").boundary, n=4096).value
    )
    still = np.abs(mc.draw(parts.boundary, n=4096).value)
    assert size.max() > 0.01 and still.max() < 1e-4 * size.max()


def check_that_nothing_changes(make, at):
    found = mc.grad_integrate(make, at, n=1 << 18, mode="forward", key=5)
    one = mc.grad_integrate(lambda x: room(ROOM | {"eye": x}), ROOM["eye"], n=1 << 18, mode="forward", key=5)
    mean, error, size = np.asarray(found.mean), np.asarray(found.stderr), np.max(np.abs(one.mean))
    # Samples follow what is scaled: what is left of that is rounding.
    assert np.all(np.abs(mean) < 4.5 * error + 1e-4 * size)
    assert np.max(error) < 0.2 * size


@pytest.mark.slow
@pytest.mark.parametrize("make, at", [(scaled, 1.0), (turned, np.zeros(3))])
def test_scaling_and_turning_everything_changes_nothing(make, at):
    check_that_nothing_changes(make, at)


@pytest.mark.slow
def test_emission_is_linear_and_values_are_those_of_paths():
    def make(p):
        scene, camera = two_bounce_reference.make(two_bounce_reference.PARAMS)
        *others, lamp = scene.given[0]
        bright = dataclasses.replace(lamp, emission=p)
        return mc.moving_paths(mc.Scene([*others, bright]), camera, bounces=2)

    start = float(two_bounce_reference.make(two_bounce_reference.PARAMS)[0].given[0][-1].emission)
    slope = mc.draw(derivatives(make, start, "forward").interior, n=4096, key=2).value
    made = make(start)
    value = mc.draw(made.interior, n=4096, key=2).value
    assert np.allclose(slope * start, value, rtol=2e-4, atol=1e-5)
    scene, camera = two_bounce_reference.make(two_bounce_reference.PARAMS)
    plain = mc.draw(mc.path_integrand(scene, camera, bounces=2), n=4096, key=2).value
    assert np.allclose(plain, value, rtol=2e-4, atol=1e-5)
    assert np.all(mc.draw(made.boundary, n=4096, key=2).value == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_nothing_is_lost_to_rounding(mode):
    """A furnace of one albedo: no geometry matters, and no derivative is NaN."""

    def make(p):
        walls = mc.Box(p["center"], p["size"], material=mc.Diffuse(0.5), emission=1.0, two_sided=True)
        return mc.moving_paths(
            mc.Scene([walls, mc.Sphere(p["ball"], 0.3, mc.Diffuse(0.5), emission=1.0)]),
            mc.PinholeCamera((0.5, 0.4, 0.3), (-0.5, -0.2, 0.1), fov=60.0, width=8, height=8), bounces=12,
        )  # fmt: skip

    params = {"center": np.zeros(3), "size": np.array([2.0, 2.0, 2.0]), "ball": np.array([-0.4, -0.2, 0.2])}
    found = mc.grad_integrate(make, params, n=1 << 16, mode=mode, key=1)
    assert found.nonfinite == 0


@pytest.mark.slow
def test_long_bright_paths_know_their_error():
    """A furnace of 40 events that loses little light: its radiance does not depend on where anything is."""

    def make(p):
        white = mc.Diffuse(0.98)
        walls = mc.Box((0.0, 0.0, 0.0), p["size"], material=white, emission=1.0, two_sided=True)
        scene = mc.Scene([walls, mc.Sphere(p["ball"], 0.3, white, emission=1.0)])
        return mc.moving_radiance(scene, (0.5, 0.4, 0.3), (-0.6, -0.5, -0.2), bounces=40)

    params = {"size": np.array([2.0, 2.0, 2.0]), "ball": np.array([-0.4, -0.2, 0.2])}
    found = mc.grad_integrate(make, params, n=1 << 14, boundary_n=1 << 15, mode="forward", key=1)
    for name in params:
        assert np.all(np.abs(found.mean[name]) <= 4.5 * found.stderr[name])
    # Both parts matter, and are known well.
    assert np.all(np.abs(found.boundary.mean["size"]) > 10.0 * found.stderr["size"])


@pytest.mark.parametrize("make", [mc.radiance, mc.moving_radiance])
def test_light_behind_glass_by_its_index(make):
    """A share 1 - F of the light passes, and spreads: (1 - F) / n^2 with F = ((n - 1) / (n + 1))^2."""

    def seen(ior):
        glass = mc.Quad((-5, -5, 1), (0, 10, 0), (10, 0, 0), mc.Dielectric(ior))
        lamp = mc.Quad((-5, -5, 4), (0, 10, 0), (10, 0, 0), mc.Diffuse(0.0), emission=1.0)
        return make(mc.Scene([glass, lamp]), (0, 0, 0), (0, 0, 1), bounces=1)

    found = mc.grad_integrate(seen, 1.5, n=1 << 12, mode="forward", sampler=mc.Sobol())
    part = found.interior
    assert part.mean == pytest.approx(-0.128 / 2.25 - 2.0 * 0.96 / 1.5**3, abs=2e-3)
    assert part.stderr < 1e-3


@pytest.mark.slow
def test_images_of_derivatives_with_and_without_replicates():
    scene = BY_NAME["sphere over the film's edge"]
    params = {"radius": scene.params["radius"]}

    def make(p):
        return scene.make(scene.params | p)

    for sampler in (mc.Independent(), mc.Sobol()):
        image = mc.render_grad(make, params, spp=8, bounces=0, sampler=sampler)
        camera = make(params)[1]
        assert np.shape(image.mean["radius"]) == np.shape(image.stderr["radius"])
        assert np.shape(image.mean["radius"])[:2] == (camera.height, camera.width)
