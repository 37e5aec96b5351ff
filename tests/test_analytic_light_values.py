"""Closed forms of direct, occluded and mirrored light against figures computed once with 40 digits, independently.

``data/light_values.json`` holds them: what is computed, the parameters, the value and its derivatives.
"""

import functools
import json
import math
from pathlib import Path

import numpy as np
import pytest

import analytic_scenes as scenes
from analytic_scenes import irradiance, lit_surfaces, mirror_balls, mirror_rooms, mirrors, shadows, skies, sky_shares
from analytic_scenes.laws import law_of_values
from analytic_scenes.scene import value_and_derivatives, value_of

RTOL = 1e-10
REFERENCE = {entry["id"]: entry for entry in json.loads((Path(__file__).parent / "data/light_values.json").read_text())}
DIFFERENCES = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}  # of order 8
UP = np.array([0.0, 0.0, 1.0])
TILTED = np.array([0.2, 0.1, 1.0]) / math.sqrt(1.05)
OTHER = np.array([-0.3, 0.2, 0.6]) / 0.7
WHITE = 1 / math.pi


def rectangle(x0, x1, y0, y1, z, **more):
    """Return a horizontal rectangle that shines downward."""
    return {"corner": (x0, y0, z), "edge_u": (0.0, y1 - y0, 0.0), "edge_v": (x1 - x0, 0.0, 0.0), **more}


def screen(edge, z):
    """Return a large horizontal blocker whose edge is at x = ``edge``."""
    corner = (edge, -50.0, z)
    return {"blocker_corner": corner, "blocker_edge_u": (100.0, 0, 0), "blocker_edge_v": (0, 100.0, 0)}


def polar(distance_x, height):
    return {"distance": math.hypot(distance_x, height), "theta": math.atan2(distance_x, height)}


def quad_light(emission, corner, edge_u, edge_v, normal=UP):
    return {"emission": emission, "corner": corner, "edge_u": edge_u, "edge_v": edge_v, "normal": normal}


def upright_mirror(distance, top, **light):
    mirror = {"mirror_corner": (-distance, -8.0, 0.0), "mirror_edge_u": (0, 16.0, 0), "mirror_edge_v": (0, 0, top)}
    return {**light, **mirror}


def eclipse(x, z, **more):
    light = {"center": (0.3, 0.2, 3.0), "radius": 0.6}
    return {**light, "blocker_center": (x, -0.05, z), "blocker_radius": 0.25, **more}


four_reflections = functools.partial(mirror_rooms.between_mirrors_irradiance, bounces=4)
small_mirror = mirrors.rectangle_in_small_mirror_irradiance

# The formula of each figure, and how its arguments follow from the parameters of the figure.
FORMULAS = {
    "S01": (irradiance.sphere_irradiance, lambda emission, radius, distance: {
        "emission": emission, "radius": radius, "distance": distance, "theta": 0.0}),
    "S02": (irradiance.sphere_irradiance, lambda emission, radius, height, offset: {
        "emission": emission, "radius": radius, **polar(offset, height)}),
    "S03a": (irradiance.sphere_irradiance, lambda emission, distance, angular_radius, theta: {
        "emission": emission, "radius": distance * math.sin(angular_radius), "distance": distance, "theta": theta}),
    "S04": (lit_surfaces.rectangle_under_sphere, dict),
    "S05d": (lit_surfaces.floor_under_orb, dict),
    "S05b": (lit_surfaces.floor_under_orb, dict),
    "S06": (lit_surfaces.ball_phase_law, dict),
    "Q01": (irradiance.corner_rectangle_irradiance, dict),
    "Q01c": (irradiance.parallelogram_irradiance, lambda emission, side, height, shift: quad_light(
        emission, **rectangle(-side / 2 - shift, side / 2 - shift, -side / 2, side / 2, height))),
    "Q02": (irradiance.standing_rectangle_irradiance, dict),
    "Q03": (irradiance.parallelogram_irradiance, lambda emission, shift: quad_light(
        emission, (0.5 + shift, -0.3, 1.2), (-0.2, 0.7, 0.4), (0.8, 0.3, 0.1), TILTED)),
    "Q04": (irradiance.parallelogram_irradiance, lambda emission, distance, left, right, bottom, top: quad_light(
        emission, (distance, left, bottom), (0.0, 0.0, top - bottom), (0.0, right - left, 0.0))),
    "Q04b": (irradiance.parallelogram_irradiance, lambda emission, lift: quad_light(
        emission, (1.0, -1.0, lift - 0.5), (-0.3, 0.4, 1.2), (0.5, 2.0, 0.2), OTHER)),
    "Q05": (irradiance.parallelogram_solid_angle, lambda half_width, half_depth, distance: rectangle(
        -half_width, half_width, -half_depth, half_depth, distance)),
    "Q06s": (lit_surfaces.floor_under_ceiling_lamp, dict),
    "Q06l": (lit_surfaces.floor_under_ceiling_lamp, dict),
    "A01": (sky_shares.beside_sphere, lambda radius, offset: {"radius": radius, **polar(offset, radius)}),
    "A02": (sky_shares.beside_sphere, lambda radius, height, offset: {"radius": radius, **polar(offset, height)}),
    "A03": (sky_shares.beside_sphere_within, lambda radius, height, offset, reach: {
        "radius": radius, **polar(offset, height), "max_distance": reach}),
    "A04": (sky_shares.pixel_under_sphere, dict),
    "A06": (sky_shares.under_parallelogram, lambda distance, height: {
        "corner": (distance, -1e7, 0.0), "edge_u": (0.0, 2e7, 0.0), "edge_v": (0.0, 0.0, height), "normal": UP}),
    "A07": (sky_shares.beside_wall_within, lambda distance, reach: {"distance": distance, "max_distance": reach}),
    "A08": (sky_shares.in_corner_within, lambda distance_a, distance_b, reach: {
        "distance_a": distance_a, "distance_b": distance_b, "max_distance": reach}),
    "A09": (sky_shares.under_parallelogram, lambda x0, x1, y0, y1, height: rectangle(
        x0, x1, y0, y1, height, normal=UP)),
    "A10": (sky_shares.under_two_spheres, lambda radius: {
        "center_1": (1.0, 0.0, 2.0), "radius_1": radius, "center_2": (-1.2, 0.0, 1.5), "radius_2": 0.6}),
    "K01": (skies.tilted_irradiance, lambda horizon, slope: {"horizon": horizon, "slope": slope, "tilt": 0.0}),
    "K01m": (skies.tilted_irradiance, lambda zenith: {"horizon": zenith / 3, "slope": 2.0, "tilt": 0.0}),
    "K02": (skies.tilted_irradiance, dict),
    "K03": (skies.zonal_radiance, lambda z, **sky: {**sky, "polar": math.acos(z)}),
    "K04": (skies.zonal_disk_radiance, lambda z, **sky: {**sky, "polar": math.acos(z)}),
    "K05": (skies.irradiance_beside_sphere, dict),
    "O01": (shadows.rectangle_behind_rectangle_irradiance, lambda emission, height, screen_height, edge: {
        **quad_light(emission, **rectangle(-0.5, 0.5, -0.4, 0.4, height)), **screen(edge, screen_height)}),
    "O02": (shadows.sphere_behind_sphere_irradiance, lambda emission, x, z: eclipse(
        x, z, emission=emission, normal=UP)),
    "O02s": (shadows.eclipsed_sphere_solid_angle, eclipse),
    "O03": (shadows.sphere_behind_rectangle_irradiance, lambda emission, screen_height, edge: {
        "emission": emission, "center": (0.2, 0.1, 2.0), "radius": 0.5, "normal": UP, **screen(edge, screen_height)}),
    "O04": (shadows.rectangle_behind_sphere_irradiance, lambda emission, radius, x, height: {
        **quad_light(emission, **rectangle(-0.5, 0.5, -0.4, 0.4, 2.0)),
        "blocker_center": (x, 0.0, height), "blocker_radius": radius}),
    "M03": (four_reflections, lambda **room: {**room, "offset": 0.0, "gap": 1.0}),
    "M04a": (mirror_balls.parallel_caustic_irradiance, dict),
    "M04b": (mirror_balls.parallel_caustic_irradiance, dict),
    "M04m": (mirror_balls.annulus_caustic_irradiance, dict),
    "M05": (mirror_balls.caustic_irradiance, lambda intensity, above, height, radius, distance: {
        "intensity": intensity, "light": (0.0, 0.0, height + above), "ball_center": (0.0, 0.0, height),
        "ball_radius": radius, "point": (distance, 0.0, 0.0)}),
    "M06": (mirror_balls.caustic_irradiance, lambda intensity, radius, x, y: {
        "intensity": intensity, "light": (1.5, 0.4, 3.2), "ball_center": (0.0, 0.0, 2.0), "ball_radius": radius,
        "point": (x, y, 0.0)}),
}  # fmt: skip
FORMULAS["S03b"] = FORMULAS["S03a"]

# What a mirror adds: the whole irradiance less the direct one.
M_LIGHT = rectangle(0.2, 0.8, -0.3, 0.3, 2.0)
BY_MIRROR = {
    "M01": (small_mirror, lambda emission, reflectance, distance, height: upright_mirror(
        distance, 5.0, emission=emission, reflectance=reflectance, **M_LIGHT)),
    "M02": (small_mirror, lambda emission, reflectance, distance, height, top: upright_mirror(
        distance, top, emission=emission, reflectance=reflectance, **M_LIGHT)),
    "M07": (mirror_balls.in_mirror_ball_irradiance, lambda emission, radius: {
        "emission": emission, "reflectance": 1.0, "center": (1.5, 0.0, 0.8), "radius": radius,
        "ball_center": (0.0, 0.0, 2.0), "ball_radius": 0.7}),
}  # fmt: skip


def orb(**options):
    return lambda **parameters: scenes.orb_over_floor(**parameters, **options).exact_variance


def lamp(**options):
    return lambda **parameters: scenes.ceiling_lamp(**parameters, **options).exact_variance


# Figures of the law of one sample, which are no closed forms in JAX.
LAWS = {
    "S05dvc": orb(lights="none"),
    "S05bvc": orb(lights="none"),
    "S05dvu": orb(lights="none", directions="uniform"),
    "S05bvu": orb(lights="none", directions="uniform"),
    "S05dvl": orb(lights="nee"),
    "S05k": lambda share: law_of_values([[share]], [[1.0]]).kurtosis - 3.0,
    "Q06sv": lamp(lights="none"),
    "Q06lv": lamp(lights="none"),
    "Q06sa": lamp(lights="nee"),
    "Q06la": lamp(lights="nee"),
}


def close(value, reference):
    assert value == pytest.approx(float(reference), rel=RTOL, abs=1e-12 if float(reference) == 0 else 0)


def slope(function, parameters, name, step=None):
    """Return the derivative of ``function(**parameters)``, which may be an array, by differences of order 8."""
    step = step or 5e-3 * (abs(parameters[name]) or 1.0)

    def at(k):
        return np.asarray(function(**{**parameters, name: parameters[name] + k * step}), float)

    return sum(c * (at(k) - at(-k)) for k, c in DIFFERENCES.items()) / step


def chain_rule(arguments, parameters, name, gradient):
    """Return the derivative with respect to a parameter, from the gradient in the arguments that follow from it."""
    changes = {key: slope(lambda key=key, **p: arguments(**p)[key], parameters, name) for key in gradient}
    return sum(np.sum(gradient[key] * change) for key, change in changes.items())


def test_every_figure_is_checked():
    assert set(REFERENCE) == {*FORMULAS, *BY_MIRROR, *LAWS, "A02u", "A08i"}


@pytest.mark.parametrize("name", FORMULAS)
def test_value_and_derivatives(name):
    formula, arguments = FORMULAS[name]
    entry = REFERENCE[name]
    value, gradient = value_and_derivatives(formula, **arguments(**entry["parameters"]))
    close(value, entry["value"])
    for parameter, reference in entry["derivatives"].items():
        close(chain_rule(arguments, entry["parameters"], parameter, gradient), reference)


@pytest.mark.parametrize("name", BY_MIRROR)
def test_what_a_mirror_adds(name):
    formula, arguments = BY_MIRROR[name]
    entry = REFERENCE[name]
    whole = value_and_derivatives(formula, **arguments(**entry["parameters"]))
    # Without reflectance only the direct light is left.
    direct = value_and_derivatives(formula, **{**arguments(**entry["parameters"]), "reflectance": 0.0})
    close(whole[0] - direct[0], entry["value"])
    gradient = {key: whole[1][key] - direct[1][key] for key in whole[1]}
    for parameter, reference in entry["derivatives"].items():
        close(chain_rule(arguments, entry["parameters"], parameter, gradient), reference)


@pytest.mark.parametrize("name", LAWS)
def test_law_of_one_sample(name):
    entry = REFERENCE[name]
    close(LAWS[name](**entry["parameters"]), entry["value"])
    for parameter, reference in entry["derivatives"].items():
        close(slope(LAWS[name], entry["parameters"], parameter), reference)


def test_kurtosis_of_an_orb_is_that_of_its_share():
    for sky in (0.0, 0.5):
        kurtosis = scenes.orb_over_floor(sky=sky, lights="none").exact_kurtosis
        close(kurtosis - 3.0, REFERENCE["S05k"]["value"])


def test_solid_angle_and_endless_corner():
    entry = REFERENCE["A02u"]
    height, offset, radius = (entry["parameters"][k] for k in ("height", "offset", "radius"))
    value, gradient = value_and_derivatives(
        sky_shares.solid_angle_beside_sphere, radius=radius, distance=math.hypot(height, offset)
    )
    close(value / (2 * math.pi), entry["value"])
    close(gradient["radius"] / (2 * math.pi), entry["derivatives"]["radius"])
    endless = {**REFERENCE["A08i"]["parameters"], "max_distance": 1e12}
    value, gradient = value_and_derivatives(sky_shares.in_corner_within, **endless)
    close(value, REFERENCE["A08i"]["value"])
    assert abs(gradient["distance_a"]) < 1e-10


def test_mirror_light_is_dark_from_behind():
    """The image of a light that faces away from the mirror is its dark back."""
    _, arguments = BY_MIRROR["M01"]
    light = arguments(**REFERENCE["M01"]["parameters"])
    light["edge_u"], light["edge_v"] = light["edge_v"], light["edge_u"]
    assert value_of(small_mirror, light) == 0.0


FAMILIES = (
    scenes.lights, scenes.lit_surfaces, scenes.occlusion, scenes.skies, scenes.shadows, scenes.mirrors,
    scenes.mirror_rooms, scenes.mirror_balls,
)  # fmt: skip
DEFAULTS = [scene for family in FAMILIES for scene in family.default_scenes()]


@pytest.mark.slow
@pytest.mark.parametrize("scene", DEFAULTS, ids=lambda scene: scene.name)
def test_every_derivative_against_differences(scene):
    """``formula(**arguments)`` is the exact value, and the derivatives are those of the formula, in every component."""
    assert value_of(scene.formula, scene.arguments) == pytest.approx(scene.exact, rel=1e-14)
    assert set(scene.derivatives) <= set(scene.arguments)
    for name, gradient in scene.derivatives.items():
        start = np.asarray(scene.arguments[name], float)
        for index in np.ndindex(start.shape):

            def moved(shift, name=name, start=start, index=index):
                changed = start.copy()
                changed[index] += shift
                return value_of(scene.formula, {**scene.arguments, name: changed})

            difference = slope(moved, {"shift": 0.0}, "shift", step=5e-4)
            assert np.asarray(gradient)[index] == pytest.approx(difference, rel=1e-7, abs=1e-8 * abs(scene.exact))
