"""Attached sampling of whole paths: drawn directions keep their random numbers, and all edges count."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import two_bounce_reference
from test_moving_paths import (
    BY_NAME,
    KINDS,
    check,
    check_that_nothing_changes,
    derivatives_of,
    turned,
)

import jaxmc as mc
from analytic_scenes.irradiance import corner_rectangle_irradiance
from analytic_scenes.rough_lights import HALF_ANGLE, light_direction, rough_metal_under, viewer
from analytic_scenes.scene import value_and_derivatives
from jaxmc.gradients import boundary, jumps, shadows, walks, windows
from jaxmc.transport import microfacets, warps
from jaxmc.transport.vec import Vec3

# Between them: lights by both ways, shadows, a sphere's rim, mirrors, a camera, glass, roughness; the quick ones first.
POINTS = ["annular eclipse", "shadow of a half plane on a floor"]
OTHERS = ["sphere light", "rectangle over its corner", "shadow of a half plane", "sphere under the sky"]
OTHERS += ["sphere beside a plane mirror", "lamp that a mirror's rim cuts", "blocker before a wall in a mirror"]
OTHERS += ["sky over a ground", "floor under a sky and a ground", "horizon in a mirror over a point"]
OTHERS += ["sphere over a mirror's rim", "through a periscope", "short furnace", "slab of glass", "rough metal"]


def attached(name, **options):
    scene = BY_NAME[name]

    def make(params):
        what = scene.make(params)
        what = what if isinstance(what, tuple) else (what,)
        return KINDS[scene.kind](*what, bounces=scene.bounces, sampling="attached", **options)

    return scene, make


@pytest.mark.parametrize("name", [*POINTS, *[pytest.param(name, marks=pytest.mark.slow) for name in OTHERS]])
def test_closed_forms(name):
    scene, make = attached(name)
    found = mc.grad_integrate(make, scene.params, n=1 << 18, sampler=mc.Sobol())
    check(found, scene.truth()[1])
    assert found.nonfinite == 0


@pytest.mark.slow
@pytest.mark.parametrize("lights", ["nee", "none"])
@pytest.mark.parametrize("name", [*POINTS, "lamp that a mirror's rim cuts"])
def test_closed_forms_where_lights_are_found_in_one_way(name, lights):
    scene, make = attached(name, lights=lights)
    found = mc.grad_integrate(make, scene.params, n=1 << 18, sampler=mc.Sobol())
    check(found, scene.truth()[1])


def two_bounces(params):
    return mc.moving_paths(*two_bounce_reference.make(params), bounces=2, sampling="attached")


@pytest.mark.slow
def test_light_that_comes_over_two_surfaces():
    """Lamp, blocker, floor, wall and camera, by 13 numbers, against quadrature."""
    params = dict(two_bounce_reference.PARAMS)
    found = mc.grad_integrate(two_bounces, params, n=1 << 19, sampler=mc.Sobol(), mode="reverse")
    check(found, derivatives_of("direct", "indirect"), grain=2e-5)
    # Other than where samples stay in place, the wall moves what reaches it: neither part is the whole.
    assert abs(found.boundary.mean["wall"]) > 20.0 * found.stderr["wall"]


def metal(params, sampling="attached", lights="mis"):
    """A rough metal that shows a ball and a lamp, over whose edges directions pass as it turns and as it gets rough."""
    tilt, rough = params["tilt"], params["roughness"]
    edge = jnp.stack([jnp.cos(tilt), jnp.zeros_like(tilt), jnp.sin(tilt)])
    scene = mc.Scene([
        mc.Quad(-edge - jnp.array([0.0, 1.0, 0.0]), 2.0 * edge, (0.0, 2.0, 0.0), mc.RoughConductor(rough, 0.9)),
        mc.Quad((0.3, -0.5, 1.6), (0.0, 0.8, 0.0), (0.8, 0.0, 0.0), mc.Diffuse(0.2), emission=4.0),
        mc.Sphere((0.5, 0.1, 0.8), 0.25, mc.Diffuse(0.6)),
    ], sky=0.3)  # fmt: skip
    return mc.moving_radiance(scene, (-1.0, 0.0, 1.2), (1.0, 0.0, -1.2), bounces=2, sampling=sampling, lights=lights)


METAL = {"tilt": np.array(0.05), "roughness": np.array(0.3)}


@pytest.mark.slow
@pytest.mark.parametrize("lights", ["mis", "none"])
def test_metal_agrees_with_detached_sampling(lights):
    both = [
        mc.grad_integrate(lambda p, word=word: metal(p, word, lights), METAL, n=1 << 20, sampler=mc.Sobol())
        for word in ("attached", "detached")
    ]
    for name in METAL:
        error = np.hypot(*[found.stderr[name] for found in both])
        assert error < 0.02 * abs(both[1].mean[name])
        assert abs(both[0].mean[name] - both[1].mean[name]) <= 5.0 * error
    # Roughness moves directions over edges only where they keep their random numbers.
    assert both[1].boundary.mean["roughness"] == 0.0
    assert abs(both[0].boundary.mean["roughness"]) > 20.0 * both[0].stderr["roughness"]


def under(light, roughness, **options):
    """A white metal that shows a constant sky or a small lamp."""
    wo, to = viewer(), light_direction()
    primitives = [mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.RoughConductor(roughness, 1.0))]
    if light == "disk":
        primitives.append(mc.Sphere(8.0 * to, 8.0 * np.sin(HALF_ANGLE), mc.Diffuse(0.0), emission=1.0))
    scene = mc.Scene(primitives, sky=1.0 if light == "constant" else None)
    return mc.moving_radiance(scene, 2.0 * wo, -wo, bounces=1, **options)


@pytest.mark.parametrize("light", ["constant", "disk"])
def test_roughness_under_smooth_light_and_under_a_small_lamp(light):
    """Attached sampling has the smaller error under smooth light; a lamp it only finds right by its edge."""
    exact, found = rough_metal_under(light, 0.2).derivative, {}
    for word in ("attached", "detached"):
        found[word] = mc.grad_integrate(
            lambda r, word=word: under(light, r, sampling=word, lights="none"), 0.2, n=1 << 17, key=1
        )
        assert abs(found[word].mean - exact) <= 5.0 * found[word].stderr
        assert found[word].stderr < 0.02 * abs(exact)
    if light == "constant":
        assert found["attached"].stderr < 0.8 * found["detached"].stderr
    else:
        inside = found["attached"].interior
        assert abs(inside.mean - exact) > 20.0 * inside.stderr


# ------------------------------------------------------------------------------------------- beside detached sampling


def studio(params, **options):
    """A coloured metal under a sheet, a ball, and three lamps: a flat one, a ball and a box."""
    copper = mc.RoughConductor(params["roughness"], (0.9, 0.6, 0.4))
    scene = mc.Scene([
        mc.Quad((-1.5, -1.5, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0), copper),
        mc.Quad((-1.2, 0.2, 1.3), (0.0, 0.7, 0.1), (0.7, 0.0, 0.2), mc.Diffuse(0.1), emission=3.0, two_sided=True),
        mc.Sphere((0.8, -0.3, 1.1), 0.2, mc.Diffuse(0.2), emission=(2.0, 4.0, 6.0)),
        mc.Quad((-0.2, -0.6, 0.7), (0.0, 0.6, 0.0), (0.5, 0.1, 0.2), mc.Diffuse(0.5)),
        mc.Sphere((-0.5, -0.4, 0.4), 0.25, mc.Diffuse((0.7, 0.5, 0.3))),
        mc.Box((0.3, 0.7, 0.3), (0.3, 0.2, 0.3), material=mc.Diffuse(0.3), emission=1.5, two_sided=True),
    ], sky=0.2)  # fmt: skip
    return mc.moving_radiance(
        scene, (params["eye"], -1.6, 1.0), (0.05 - params["eye"], 1.5, -1.0), bounces=2, **options
    )


STUDIO = {"roughness": np.array(0.35), "eye": np.array(0.1)}
OPTIONS = (
    {"pick": "power"},
    {"pick": "distance", "light_points": "solid angle"},
    {"light_points": "area", "roulette": 0.7},
    {"directions": "cosine"},
    {"directions": "uniform", "lights": "nee"},
)


@pytest.mark.slow
@pytest.mark.parametrize("options", OPTIONS)
def test_every_option_agrees_with_detached_sampling(options):
    both = [
        mc.grad_integrate(lambda p, word=word: studio(p, sampling=word, **options), STUDIO, n=1 << 19, key=1)
        for word in ("attached", "detached")
    ]
    for name in STUDIO:
        error = np.hypot(*[found.stderr[name] for found in both])
        assert np.all(np.abs(both[0].mean[name] - both[1].mean[name]) <= 5.0 * error)
        assert np.all(error < 0.1 * np.max(np.abs(both[1].mean[name])))


@pytest.mark.slow
def test_turning_a_room_changes_nothing(monkeypatch):
    """Directions are drawn in frames that do not turn along with it."""
    monkeypatch.setattr(mc, "moving_paths", partial(mc.moving_paths, sampling="attached"))
    check_that_nothing_changes(turned, np.zeros(3))


def test_values_are_those_of_paths():
    made = two_bounces(two_bounce_reference.PARAMS)
    plain = mc.path_integrand(*two_bounce_reference.make(two_bounce_reference.PARAMS), bounces=2)
    value, same = (mc.draw(integrand, n=1024, key=2).value for integrand in (made.interior, plain))
    assert np.allclose(value, same, rtol=2e-4, atol=1e-5)
    assert np.all(mc.draw(made.boundary, n=1024, key=2).value == 0.0)


@pytest.mark.slow
def test_long_paths_in_reverse_mode():
    """Past 8 events what is on the way is found again."""

    def make(p):
        walls = mc.Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), material=mc.Diffuse(p), emission=1.0, two_sided=True)
        return mc.moving_radiance(
            mc.Scene([walls]), (0.5, 0.4, 0.3), (-0.6, -0.5, -0.2), bounces=12, sampling="attached"
        )

    found = mc.grad_integrate(make, 0.5, n=1 << 14, mode="reverse", key=1)
    exact = sum(k * 0.5 ** (k - 1) for k in range(1, 13))
    assert abs(found.mean - exact) <= 5.0 * found.stderr + 1e-4 and found.nonfinite == 0


# ------------------------------------------------------------------------------------------------------ what is needed


def two_lamps(params):
    """Two lamps with a common edge, found by drawn directions."""
    edge, height = params["edge"], params["height"]
    scene = mc.Scene([
        mc.Quad([0.0, 0.0, height], [0.0, 0.8, 0.0], [edge, 0.0, 0.0], mc.Diffuse(0.0), emission=5.0),
        mc.Quad([edge, 0.0, height], [0.0, 0.8, 0.0], [1.0, 0.0, 0.0], mc.Diffuse(0.0), emission=1.0),
    ])  # fmt: skip
    return mc.moving_irradiance(scene, (0, 0, 0), (0, 0, 1), bounces=0, sampling="attached", lights="none")


def of_two_lamps(edge, height):
    """Return their irradiance: of rectangles from the corner below which the point lies."""
    near, whole = (corner_rectangle_irradiance(1.0, width, 0.8, height) for width in (edge, edge + 1.0))
    return 4.0 * near + whole


def closed_forms(part):
    """Return (make, params, exact) of what shows that a part is needed."""
    if part == "creases":
        params = {"edge": 0.6, "height": 0.9}
        # A function of its own, or the kernel of another test would stand in.
        return lambda p: two_lamps(p), params, value_and_derivatives(of_two_lamps, **params)[1]
    if part == "turning":
        exact = {"roughness": rough_metal_under("disk", 0.2).derivative}
        how = {"sampling": "attached", "lights": "none"}
        return lambda p: under("disk", p["roughness"], **how), {"roughness": 0.2}, exact
    if part == "shares":
        scene, make = attached("rectangle over its corner")
        return make, scene.params, scene.truth()[1]
    exact = {k: v for k, v in derivatives_of("direct", "indirect").items() if k in ("floor", "wall")}
    params = {k: two_bounce_reference.PARAMS[k] for k in exact}
    return lambda p: two_bounces({**two_bounce_reference.PARAMS, **p}), params, exact


def test_lamps_that_share_an_edge():
    make, params, exact = closed_forms("creases")
    check(mc.grad_integrate(make, params, n=1 << 18, sampler=mc.Sobol()), exact)


def held(real):
    """A direction that does not move."""
    return lambda world, strategy, vertex, wi: wi


def constant(real):
    return lambda *args: jax.lax.stop_gradient(real(*args))


SPOILED = {
    "directions at edges": ("turning", windows, "with_same_coordinates", held),
    "edges where one face goes on into another": (
        "creases", jumps, "pieces", lambda real: lambda *args, creases, own: real(*args, creases=False, own=own)
    ),
    "shares of lights": ("shares", walks, "share_of_emission", constant),
    "shares of what is met at edges": ("shares", boundary, "share_of_emission", lambda real: lambda *args: 1.0),
    "shares of lights at edges": (
        "two bounces", shadows, "share_of_emission", lambda real: lambda *args: real(*args) * 0.0 + 1.0
    ),
    # Only a camera's window has a known ``own``.
    "edges in front": ("two bounces", jumps, "_slips", lambda real: lambda world, view, hit: isinstance(view.own, int)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("part", SPOILED)
def test_every_part_is_needed(monkeypatch, part):
    case, where, function, spoil = SPOILED[part]
    make, params, exact = closed_forms(case)
    monkeypatch.setattr(where, function, spoil(getattr(where, function)))
    found = mc.grad_integrate(make, params, n=1 << 18, sampler=mc.Sobol())
    with pytest.raises(AssertionError):
        check(found, exact, share=np.inf)


# ------------------------------------------------------------------------------------------------- which random numbers


def points(n, seed):
    return jnp.asarray(np.random.default_rng(seed).uniform(0.001, 0.999, (n, 2)), float)


@pytest.mark.parametrize("kind", ["cosine", "uniform"])
def test_coordinates_of_a_hemisphere(kind):
    sample, back = (getattr(warps, name.format(kind)) for name in ("sample_{}_hemisphere", "{}_hemisphere_coordinates"))
    u = points(1000, 1)
    again = jnp.stack(jax.vmap(lambda u: back(sample(*u)))(u), 1)
    assert np.max(np.abs(again - u)) < 5e-6


@pytest.mark.parametrize("alpha", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("degrees", [0.0, 45.0, 85.0])
def test_coordinates_of_a_facet(alpha, degrees):
    """The direction that they draw is the one that was asked for; their own digits are lost where it is narrow."""
    angle = np.radians(degrees)
    wo = Vec3(*(jnp.asarray(x, float) for x in (0.6 * np.sin(angle), 0.8 * np.sin(angle), np.cos(angle))))

    def both(u):
        wi = microfacets.sample_ggx(wo, alpha, *u)[0]
        return jnp.stack(wi), jnp.stack(
            microfacets.sample_ggx(wo, alpha, *microfacets.ggx_coordinates(wo, wi, alpha))[0]
        )

    drawn, again = jax.vmap(both)(points(1000, 2))
    above = drawn[:, 2] > 1e-3
    assert np.sum(above) > 300
    assert np.max(np.abs(again - drawn)[above]) < 2e-3 * alpha


def test_a_wrong_word_is_refused():
    scene = mc.Scene([mc.Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), mc.Diffuse(0.5))])
    with pytest.raises(ValueError, match="sampling must be one of detached, attached, got 'score'"):
        mc.moving_irradiance(scene, (0, 0, 1), (0, 0, -1), bounces=1, sampling="score")
    with pytest.raises(TypeError, match="sampling"):
        mc.irradiance(scene, (0, 0, 1), (0, 0, -1), bounces=1, sampling="attached")
