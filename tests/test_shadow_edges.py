"""Derivatives of direct light against closed forms: moving lights, blockers and receivers, and their shadows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import analytic_scenes
import jaxmc as mc
from analytic_scenes import moving
from analytic_scenes.irradiance import polygon_irradiance
from analytic_scenes.scene import value_and_derivatives

BLACK = mc.Diffuse(0.0)
UP = (0.0, 0.0, 1.0)
FAMILIES = {family.name: family for family in moving.FAMILIES}


def quad(corner, edge_u, edge_v, emission=None):
    return mc.Quad(corner, edge_u, edge_v, BLACK, emission=emission)


def ball(center, radius, emission=None):
    return mc.Sphere(center, radius, BLACK, emission=emission)


def at_origin(*primitives, sky=None, point=(0.0, 0.0, 0.0), normal=UP):
    return mc.direct_irradiance(mc.Scene(primitives, sky), point, normal)


# ----------------------------------------------------------------------------- scenes of the closed forms, in motion


def sphere_light(p):
    return at_origin(ball([p["offset"], 0.0, p["height"]], p["radius"], p["emission"]))


def corner_rectangle(p):
    return at_origin(quad([0.0, 0.0, p["height"]], [0.0, p["depth"], 0.0], [p["width"], 0.0, 0.0], p["emission"]))


def half_plane(p):
    a, b, s = p["half_width"], p["half_depth"], p["edge"]
    light = quad([-a, -b, p["height"]], [0.0, 2.0 * b, 0.0], [2.0 * a, 0.0, 0.0], p["emission"])
    blocker = quad([s - 5.0, -5.0, p["blocker_height"]], [5.0, 0.0, 0.0], [0.0, 10.0, 0.0])
    return at_origin(light, blocker, point=[0.0, 0.0, p["receiver"]])


def annular_eclipse(p):
    light = ball([0.0, 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, ball([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"]))


def sphere_under_sky(p):
    sine, cosine = jnp.sin(p["theta"]), jnp.cos(p["theta"])
    return at_origin(ball([p["distance"] * sine, 0.0, p["distance"] * cosine], p["radius"]), sky=p["sky"])


IN_MOTION = {
    "sphere light": sphere_light,
    "rectangle over its corner": corner_rectangle,
    "shadow of a half plane": half_plane,
    "annular eclipse": annular_eclipse,
    "sphere under the sky": sphere_under_sky,
}


def rectangle_behind_rectangle(p):
    light = quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])
    return at_origin(light, quad(p["blocker_corner"], p["blocker_edge_u"], p["blocker_edge_v"]))


def sphere_behind_rectangle(p):
    light = ball(p["center"], p["radius"], p["emission"])
    return at_origin(light, quad(p["blocker_corner"], p["blocker_edge_u"], p["blocker_edge_v"]))


def rectangle_behind_sphere(p):
    light = quad(p["corner"], p["edge_u"], p["edge_v"], p["emission"])
    return at_origin(light, ball(p["blocker_center"], p["blocker_radius"]))


def sphere_behind_sphere(p):
    light = ball(p["center"], p["radius"], p["emission"])
    return at_origin(light, ball(p["blocker_center"], p["blocker_radius"]))


GENERAL = [rectangle_behind_rectangle, sphere_behind_rectangle, rectangle_behind_sphere, sphere_behind_sphere]


def check(found, exact, norm_share, name=""):
    """Each component within 4 standard errors (of 16 replicates), which are below a share of the largest one."""
    largest = max(np.max(np.abs(x)) for x in exact.values())
    for key, truth in exact.items():
        mean, error = np.asarray(found.mean[key]), np.asarray(found.stderr[key])
        assert np.all(error <= norm_share * np.maximum(np.abs(truth), 0.1 * largest)), (name, key, error, truth)
        off = np.abs(mean - truth)
        assert np.all(off <= 6.0 * error + 1e-5 * largest), (name, key, mean, truth, error)


def run(make, arguments, n=1 << 15, boundary_n=1 << 13):
    return mc.grad_integrate(make, dict(arguments), n=n, boundary_n=boundary_n, sampler=mc.Sobol())


def test_a_receiver_under_a_static_blocker():
    family = FAMILIES["shadow of a half plane"]

    def make(p):
        return half_plane({**family.arguments, **p})

    found = run(make, {key: family.arguments[key] for key in ("receiver", "edge")})
    check(found, {key: family.derivatives[key] for key in ("receiver", "edge")}, 0.01)
    # The case in which automatic differentiation alone is 21 times too large.
    assert found.mean["receiver"] == pytest.approx(0.009892154832588, abs=6 * found.stderr["receiver"])
    assert found.stderr["receiver"] < 0.01 * 0.0099
    assert found.interior.mean["receiver"] == pytest.approx(0.211127960926, rel=1e-3)
    assert found.boundary.mean["receiver"] == pytest.approx(-0.201235806094, rel=1e-3)
    assert found.interior.mean["edge"] == 0.0


def receiver_under_half_plane(p):
    """A receiver of some extent, a face of the scene, that moves along its normal and turns about y."""
    light = quad([-1.0, -0.8, 3.0], [0.0, 1.6, 0.0], [2.0, 0.0, 0.0], 5.0)
    blocker = quad([-4.8, -5.0, 1.2], [5.0, 0.0, 0.0], [0.0, 10.0, 0.0])
    corner, edge_u, edge_v = [-0.1, -0.2, p["height"]], [0.3, 0.0, p["tilt"]], [0.0, 0.4, 0.0]
    scene = mc.Scene([light, blocker, quad(corner, edge_u, edge_v)])
    return mc.mean_direct_irradiance(scene, corner, edge_u, edge_v)


def mean_under_half_plane(height, tilt):
    """The same by quadrature of the closed form at a point."""
    nodes, weights = np.polynomial.legendre.leggauss(12)

    def at(s, t):
        x, y, z = -0.1 + 0.3 * s, -0.2 + 0.4 * t, height + tilt * s
        start = x + (0.2 - x) * (3.0 - z) / (1.2 - z)
        corners = jnp.stack([jnp.stack([a - x, b - y, 3.0 - z]) for a, b in
                             ((start, -0.8), (1.0, -0.8), (1.0, 0.8), (start, 0.8))])  # fmt: skip
        return polygon_irradiance(5.0, corners, jnp.stack([-tilt, 0.0 * tilt, 0.3 + 0.0 * tilt]))

    s, t = (0.5 * (g.ravel() + 1.0) for g in np.meshgrid(nodes, nodes))
    return jnp.sum(jax.vmap(at)(s, t) * np.outer(weights, weights).ravel()) / 4.0


@pytest.mark.slow
def test_receivers_of_some_extent():
    params = {"height": 0.1, "tilt": 0.05}
    value, exact = value_and_derivatives(mean_under_half_plane, **params)
    found = run(receiver_under_half_plane, params, n=1 << 18, boundary_n=1 << 16)
    check(found, exact, 0.01)
    assert abs(float(found.interior.mean["height"]) - exact["height"]) > 0.5 * abs(exact["height"])
    interior = mc.integrate(receiver_under_half_plane(params).interior, n=1 << 16, sampler=mc.Sobol())
    assert interior.mean == pytest.approx(value, rel=2e-3)


@pytest.mark.slow
def test_values_of_both_parts():
    family = FAMILIES["shadow of a half plane"]
    made = half_plane(family.arguments)
    assert mc.integrate(made.boundary, n=1000).mean == 0.0 == mc.integrate(made.boundary, n=1000).variance
    assert mc.integrate(made.interior, n=1 << 15, sampler=mc.Sobol()).mean == pytest.approx(family.exact, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_MOTION)
def test_every_closed_form(name):
    found = run(IN_MOTION[name], FAMILIES[name].arguments, n=1 << 18)
    check(found, FAMILIES[name].derivatives, 0.01, name)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_inside_of_a_shining_sphere(mode):
    """A room that shines is a sky; the receiver is at its centre, where no direction leads to the centre."""

    def make(p):
        sine, cosine = jnp.sin(p["theta"]), jnp.cos(p["theta"])
        room = mc.Sphere((0.0, 0.0, 0.0), 9.0, BLACK, emission=p["sky"], inward=True)
        return at_origin(ball([p["distance"] * sine, 0.0, p["distance"] * cosine], p["radius"]), room)

    family = FAMILIES["sphere under the sky"]
    found = mc.grad_integrate(
        make, dict(family.arguments), n=1 << 18, boundary_n=1 << 13, sampler=mc.Sobol(), mode=mode
    )
    assert found.nonfinite == 0
    check(found, family.derivatives, 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("make", GENERAL, ids=lambda make: make.__name__)
def test_shadows_in_general_position(make):
    scene = getattr(analytic_scenes, make.__name__)()
    arguments = {k: v for k, v in scene.arguments.items() if k != "normal"}
    found = run(make, arguments, n=1 << 18, boundary_n=1 << 14)
    check(found, {k: scene.derivatives[k] for k in arguments}, 0.01, make.__name__)


# --------------------------------------------------------------------------------------- what holds in every scene


LIGHTS = {
    "lamp": [0.2, -0.4, 2.5],
    "orb": [-0.9, 0.3, 2.0],
    "crate": [0.35, 0.1, 1.1],
    "sheet": [-0.9, -0.2, 0.9],
    "point": [0.0, 0.1, 0.0],
}


def room(p):
    """Two lights, a turned box, a triangle and a sky, all at places of their own."""
    lamp, orb, crate, sheet, point = (jnp.asarray(p[key]) for key in ("lamp", "orb", "crate", "sheet", "point"))
    c, s = np.cos(0.5), np.sin(0.5)
    primitives = [
        quad(lamp, [0.0, 0.9, 0.1], [1.1, 0.0, 0.0], 4.0),
        ball(orb, 0.35, 6.0),
        mc.Box(crate, [0.5, 0.4, 0.6], [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], BLACK),
        mc.Triangle(sheet, sheet + jnp.array([0.6, 0.1, 0.2]), sheet + jnp.array([-0.1, 0.7, 0.1]), BLACK),
    ]
    return at_origin(*primitives, sky=1.5, point=point, normal=(0.1, -0.2, 1.0))


def moved(p):
    """The same with everything shifted together."""
    return room({key: jnp.asarray(value) + p for key, value in LIGHTS.items()})


@pytest.mark.slow
def test_moving_everything_changes_nothing():
    found = mc.draw(_boundary_of_motion(), n=4096)
    size = np.abs(mc.draw(_boundary_of_lamp(), n=4096).value).max()
    assert size > 0.1
    assert np.abs(found.value).max() < 2e-5 * size


def _boundary_of_motion():
    from jaxmc.gradients.derivative import derivatives

    return derivatives(moved, jnp.zeros(3)).boundary


def _boundary_of_lamp():
    from jaxmc.gradients.derivative import derivatives

    return derivatives(lambda x: room(LIGHTS | {"crate": x}), jnp.asarray(LIGHTS["crate"])).boundary


@pytest.mark.slow
def test_a_whole_scene_against_differences():
    assert room(LIGHTS).flags == ()
    how = {"n": 1 << 19, "boundary_n": 1 << 16, "sampler": mc.Sobol(), "steps": (0.03, 0.01), "scale": 1.0}
    report = mc.gradcheck(room, LIGHTS, tolerance=0.1, **how)
    assert report.verdict == "consistent", str(report)
    plain = mc.gradcheck(interior_of_room, LIGHTS, **{**how, "n": 1 << 17})
    moving = [f for f in plain.findings if "crate" in f.name or "sheet" in f.name]
    assert all(f.gradient == 0.0 and f.jumps for f in moving)
    biased = [f for f in moving if f.verdict == "biased"]
    assert plain.verdict == "biased" and min(f.p for f in biased) < 1e-10, str(plain)


def interior_of_room(p):
    return room(p).interior


def sheet_in_parts(parts, width):
    """A blocker divided into strips that share edges."""
    light = quad([-1.0, -0.8, 3.0], [0.0, 1.6, 0.0], [2.0, 0.0, 0.0], 5.0)
    strips = [
        quad([-0.5 + width * k / parts, -0.3, 1.2], [width / parts, 0.0, 0.0], [0.0, 0.5, 0.0]) for k in range(parts)
    ]
    return at_origin(light, *strips)


@pytest.mark.slow
def test_shared_edges_count_once():
    one, three = (
        mc.grad_integrate(lambda w, k=k: sheet_in_parts(k, w), 0.7, n=64, boundary_n=1 << 13, sampler=mc.Sobol())
        for k in (1, 3)
    )
    assert one.boundary.mean < -0.1
    assert three.boundary.mean == pytest.approx(
        one.boundary.mean, abs=8 * (one.boundary.stderr + three.boundary.stderr)
    )
    assert three.boundary.stderr < 0.01 * abs(one.boundary.mean)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["edges counted twice", "the light's motion left out"])
def test_known_mistakes_are_found(monkeypatch, wrong):
    from jaxmc.gradients import shadows, silhouettes
    from jaxmc.gradients.flows import Flowed

    if wrong == "edges counted twice":
        monkeypatch.setattr(silhouettes, "_is_same", lambda *_: False)

        def make(p):
            return sheet_in_parts(3, p["width"])

        found = mc.grad_integrate(make, {"width": 0.7}, n=64, boundary_n=1 << 13, sampler=mc.Sobol())
        exact = mc.grad_integrate(
            lambda p: sheet_in_parts(1, p["width"]), {"width": 0.7}, n=64, boundary_n=1 << 13, sampler=mc.Sobol()
        ).boundary.mean
        assert abs(found.boundary.mean["width"] - exact["width"]) > 0.02 * abs(exact["width"])
    else:
        monkeypatch.setattr(shadows, "flow", lambda face, point, wi, distance, own: Flowed(wi, wi, 1.0))
        family = FAMILIES["shadow of a half plane"]
        with pytest.raises(AssertionError):
            # A function of its own, or a kernel without the mistake is found again.
            check(run(lambda p: half_plane(p), family.arguments), family.derivatives, 0.01)


def test_what_is_not_covered_is_said():
    light = quad([-1.0, -1.0, 3.0], [0.0, 2.0, 0.0], [2.0, 0.0, 0.0], 5.0)
    assert at_origin(light, ball((0.0, 0.0, 1.0), 0.3), ball((1.0, 0.0, 1.0), 0.3)).flags == ()
    assert at_origin(light, mc.Box((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))).flags == ()
    crossing = at_origin(light, ball((0.0, 0.0, 1.0), 0.3), ball((0.4, 0.0, 1.0), 0.3)).flags
    assert len(crossing) == 1 and "pass through each other (1 and 2)" in crossing[0]
    sheet = quad([-0.5, -0.5, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    assert "pass through" in at_origin(light, sheet, ball((0.0, 0.0, 1.1), 0.3)).flags[0]
    upright = quad([0.0, -0.2, 0.5], [0.0, 0.4, 0.0], [0.0, 0.0, 1.0])
    assert "pass through" in at_origin(light, sheet, upright).flags[0]
    beside = quad([0.5, -0.2, 1.0], [0.5, 0.0, 0.0], [0.0, 0.4, 0.0])
    assert "overlap" in at_origin(light, sheet, beside).flags[0]


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="Scene"):
        mc.direct_irradiance([], (0, 0, 0), UP)
    with pytest.raises(ValueError, match=r"mc\.grad_integrate"):
        jax.grad(
            lambda s: half_plane(FAMILIES["shadow of a half plane"].arguments | {"edge": s}).boundary(jnp.ones(1))
        )(0.2)
