"""Closed forms of what moves: values against quadrature, derivatives against differences and 40-digit arithmetic."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from analytic_scenes import ggx_values, moving
from analytic_scenes.scene import value_of
from analytic_scenes.shadows import rectangle_behind_rectangle_irradiance, sphere_behind_sphere_irradiance

FAMILIES = {family.name: family for family in moving.FAMILIES}

# Values and derivatives by differentiation in arithmetic of 40 digits (mpmath).
TABLE = {
    "sphere light": (
        0.825506257903346,
        {"radius": 3.302025031613382, "height": -0.690373273591773, "offset": -0.386094240890206},
    ),
    "disk light": (
        0.750592517202789,
        {"radius": 2.890598765183369, "height": -0.573241105331723, "offset": -0.426881674183198},
    ),
    "coaxial disk light": (0.923997839291116, {"radius": 3.478580100860671, "height": -0.869645025215168}),
    "rectangle over its corner": (
        1.204737908734188,
        {"width": 0.756913153865592, "depth": 1.109133747081309, "height": -1.096146767687093},
    ),
    "shadow of a half plane": (
        0.376072107353098,
        {
            "edge": -2.012358060935695,
            "blocker_height": 0.335393010155949,
            "height": -0.345285164988537,
            "receiver": 0.009892154832588,
        },
    ),
    "annular eclipse": (
        1.467927966880767,
        {
            "blocker_radius": -2.774012851135624,
            "blocker_height": 0.367413501522093,
            "blocker_offset": 0.036823179439853,
            "light_radius": 3.490658503988659,
            "light_height": -1.163552834662886,
        },
    ),
    "disk behind a sphere": (
        1.293395041681334,
        {"blocker_radius": -2.774012851135624, "light_radius": 2.827433388230814, "light_height": -0.942477796076938},
    ),
    "disk over a pixel's edge": (0.227466702385687, {"x": -0.519615242270663, "radius": 1.256637061435917}),
    "sphere on the film": (
        0.132779992637018,
        {"radius": 0.461300944610936, "x": 0.005974352874556, "y": -0.004480764655917, "z": -0.093504845771053},
    ),
    "furnace": (2.0, {"albedo": 4.0, "emission": 2.0}),
    "short furnace": (1.9375, {"albedo": 3.25, "emission": 1.9375}),
    "sphere in a plane mirror": (
        0.105559696284580,
        {"mirror": -0.132471750000999, "x": 0.066235875000500, "z": 0.016976672466344},
    ),
    "slab of glass": (0.923076923076923, {"ior": -0.236686390532544}),
    "surface of glass": (0.04, {"ior": 0.128}),
    "rough metal": (0.877358415789, {"roughness": -0.826102326}),
}


# ------------------------------------------------------------------------------- the same by independent quadrature


def over_disk(emission, radius, height, offset=0.0):
    def point(angle, r):
        x, y = offset + r * math.cos(angle), r * math.sin(angle)
        return r * height**2 / (x * x + y * y + height**2) ** 2

    return emission * dblquad(point, 0.0, radius, 0.0, 2.0 * math.pi, epsabs=1e-12, epsrel=1e-11)[0]


def over_rectangle(emission, x0, x1, y0, y1, height):
    def point(y, x):
        return height**2 / (x * x + y * y + height**2) ** 2

    return emission * dblquad(point, x0, x1, y0, y1, epsabs=1e-12, epsrel=1e-11)[0]


def over_cone(emission, radius, height, offset):
    """The cosine over a cone of directions: its azimuth averages it to cos(theta) cos(gamma)."""
    distance = math.hypot(height, offset)
    edge = math.asin(radius / distance)
    return emission * height / distance * quad(lambda g: 2.0 * math.pi * math.cos(g) * math.sin(g), 0.0, edge)[0]


def shadow(emission, half_width, half_depth, height, blocker_height, edge, receiver):
    # Walk along the light: a point of it is seen where its line of sight passes right of the edge.
    far, near = height - receiver, blocker_height - receiver
    start = max(-half_width, edge * far / near)
    return over_rectangle(emission, start, half_width, -half_depth, half_depth, far)


def eclipse(emission, light_radius, light_height, blocker_radius, blocker_height, blocker_offset):
    light = over_cone(emission, light_radius, light_height, 0.0)
    return light - over_cone(emission, blocker_radius, blocker_height, blocker_offset)


def disk_eclipse(emission, light_radius, light_height, blocker_radius, blocker_height, blocker_offset):
    light = over_disk(emission, light_radius, light_height)
    return light - over_cone(emission, blocker_radius, blocker_height, blocker_offset)


def pixel(radius, x):
    chord = quad(
        lambda t: 2.0 * math.sqrt(max(radius**2 - (t - x) ** 2, 0.0)), x - radius, 1.0, epsabs=1e-13, limit=200
    )
    return chord[0]


def film(radius, x, y, z):
    # A ray (p, q, 1) meets the sphere where (p x + q y + z)^2 > (p^2 + q^2 + 1) (c^2 - radius^2), c the distance.
    k = x * x + y * y + z * z - radius**2
    a = y * y - k

    def root(p):  # of the discriminant in q, over 4
        b, c = y * (p * x + z), (p * x + z) ** 2 - k * (1.0 + p * p)
        return b * b - a * c

    # Ends of the silhouette in p: the discriminant is a (k - ...) quadratic in p.
    middle = np.polyfit([-1.0, 0.0, 1.0], [root(-1.0), root(0.0), root(1.0)], 2)
    low, high = sorted(np.roots(middle).real)
    half, center = (high - low) / 2.0, (high + low) / 2.0
    area = quad(
        lambda t: 2.0 * math.sqrt(max(root(center + half * math.sin(t)), 0.0)) / abs(a) * half * math.cos(t),
        -math.pi / 2, math.pi / 2, epsabs=1e-14,
    )  # fmt: skip
    return area[0]


def slab(ior):
    one = ((ior - 1.0) / (ior + 1.0)) ** 2
    return sum((1.0 - one) ** 2 * one ** (2 * k) for k in range(60))


QUADRATURE = {
    "sphere light": over_cone,
    "disk light": over_disk,
    "coaxial disk light": over_disk,
    "rectangle over its corner": lambda emission, width, depth, height: over_rectangle(
        emission, 0.0, width, 0.0, depth, height
    ),
    "shadow of a half plane": shadow,
    "annular eclipse": eclipse,
    "disk behind a sphere": disk_eclipse,
    "disk over a pixel's edge": pixel,
    "sphere on the film": film,
    "furnace": lambda emission, albedo: sum(emission * albedo**k for k in range(80)),
    "short furnace": lambda emission, albedo: sum(emission * albedo**k for k in range(5)),
    "sphere in a plane mirror": lambda emission, radius, mirror, x, z: over_cone(emission, radius, z, 2 * mirror - x),
    "slab of glass": slab,
    "surface of glass": lambda ior: ((1.0 - ior) / (1.0 + ior)) ** 2,
    "sphere under the sky": lambda sky, radius, distance, theta: (
        math.pi * sky - over_cone(sky, radius, distance * math.cos(theta), distance * math.sin(theta))
    ),
}


def test_every_family_is_checked():
    assert set(QUADRATURE) | {"rough metal"} == set(FAMILIES) == set(TABLE) | {"sphere under the sky"}


@pytest.mark.parametrize("name", TABLE)
def test_numbers_of_forty_digit_arithmetic(name):
    value, derivatives = TABLE[name]
    tolerance = 2e-9 if name == "rough metal" else 1e-13  # as many digits as are known
    assert FAMILIES[name].exact == pytest.approx(value, rel=max(tolerance, 1e-12))
    for key, exact in derivatives.items():
        assert FAMILIES[name].derivatives[key] == pytest.approx(exact, rel=2e-9 if name == "rough metal" else 1e-10)


@pytest.mark.parametrize("name", QUADRATURE)
def test_values_and_derivatives_by_quadrature(name):
    family, reference = FAMILIES[name], QUADRATURE[name]
    assert reference(**family.arguments) == pytest.approx(family.exact, rel=1e-9)
    for key, exact in family.derivatives.items():
        h = 1e-3
        ends = [reference(**family.arguments | {key: family.arguments[key] + s * h}) for s in (-2, -1, 1, 2)]
        # The rule of fourth order.
        slope = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * h)
        assert slope == pytest.approx(exact, rel=1e-6, abs=1e-8 * abs(family.exact))


def test_roughness_by_another_integral():
    with np.errstate(all="raise"):
        for alpha, value, slope in ((0.1, 0.988304056521, -0.250927426), (0.3, 0.877358415789, -0.826102326),
                                    (0.5, 0.687848515110, -0.988943349)):  # fmt: skip
            exact = value_of(moving.ggx_albedo, {"roughness": alpha})
            assert exact == pytest.approx(value, rel=1e-11)
            ends = [value_of(moving.ggx_albedo, {"roughness": alpha + h}) for h in (-1e-4, 1e-4)]
            assert (ends[1] - ends[0]) / 2e-4 == pytest.approx(slope, rel=1e-6)
            found = value_of(ggx_values.directional_albedo, {"alpha": alpha, "cosine": 1.0})
            assert found == pytest.approx(exact, rel=1e-8)


def test_shadows_by_general_closed_forms():
    a = moving.HALF_PLANE
    up = a["height"] - a["receiver"]
    quads = {
        "corner": (-1.0, -0.8, up), "edge_u": (0.0, 1.6, 0.0), "edge_v": (2.0, 0.0, 0.0),
        "blocker_corner": (-5.0, -5.0, 1.2), "blocker_edge_u": (5.2, 0.0, 0.0), "blocker_edge_v": (0.0, 10.0, 0.0),
    }  # fmt: skip
    general = value_of(rectangle_behind_rectangle_irradiance, {"emission": 5.0, **quads})
    assert general == pytest.approx(FAMILIES["shadow of a half plane"].exact, rel=1e-12)
    balls = {"center": (0.0, 0.0, 3.0), "radius": 1.0, "blocker_center": (0.1, 0.0, 1.5), "blocker_radius": 0.2}
    general = value_of(sphere_behind_sphere_irradiance, {"emission": 5.0, **balls})
    assert general == pytest.approx(FAMILIES["annular eclipse"].exact, rel=1e-12)


def test_moving_everything_changes_nothing():
    d = FAMILIES["shadow of a half plane"].derivatives
    assert d["height"] + d["blocker_height"] + d["receiver"] == pytest.approx(0.0, abs=1e-13)
    d = FAMILIES["sphere in a plane mirror"].derivatives
    assert d["mirror"] + 2.0 * d["x"] == pytest.approx(0.0, abs=1e-13)
