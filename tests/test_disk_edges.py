"""Derivatives of direct light from disks and behind disks, against closed forms and integrals along their rims."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad as integral

import jaxmc as mc
from analytic_scenes import moving
from analytic_scenes.scene import value_and_derivatives
from jaxmc.gradients import disks

BLACK, UP, DOWN = mc.Diffuse(0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
FAMILIES = {family.name: family for family in moving.FAMILIES}
SLOW = pytest.mark.slow


def at_origin(*primitives, sky=None, point=(0.0, 0.0, 0.0), normal=UP):
    return mc.direct_irradiance(mc.Scene(primitives, sky), point, normal)


def disk(center, radius, emission=None, normal=DOWN):
    return mc.Disk(center, normal, radius, BLACK, emission)


def ball(center, radius, emission=None):
    return mc.Sphere(center, radius, BLACK, emission)


def derivatives(make, arguments, n=1 << 15, boundary_n=1 << 13):
    return mc.grad_integrate(make, dict(arguments), n=n, boundary_n=boundary_n, sampler=mc.Sobol())


def check(found, exact, precision=0.01):
    """Each component within 4 standard errors, and these below a share of it, or of a tenth of the largest."""
    largest = max(np.max(np.abs(x)) for x in exact.values())
    for name, truth in exact.items():
        mean, error = np.asarray(found.mean[name]), np.asarray(found.stderr[name])
        assert np.all(error <= precision * np.maximum(np.abs(truth), 0.1 * largest)), (
            f"{name} is not known well: {error}, {truth}"
        )
        assert np.all(np.abs(mean - truth) <= 4.0 * error + 1e-5 * largest), f"{name} is off: {mean}, {truth}, {error}"


# ---------------------------------------------------------------------------------------------------- closed forms


def disk_light(p):
    return at_origin(disk([p["offset"], 0.0, p["height"]], p["radius"], p["emission"]))


def coaxial_disk(p):
    return at_origin(disk([0.0, 0.0, p["height"]], p["radius"], p["emission"]))


def disk_behind_sphere(p):
    light = disk([0.0, 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, ball([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"]))


def disk_behind_disk(p):
    light = disk([0.0, 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, disk([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"]))


def sphere_behind_disk(p):
    light = ball([0.0, 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, disk([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"]))


def less_a_disk(light):
    def formula(emission, light_radius, light_height, blocker_radius, blocker_height, blocker_offset):
        hidden = moving.disk_over_receiver(emission, blocker_radius, blocker_height, blocker_offset)
        return light(emission, light_radius, light_height, 0.0) - hidden

    return formula


ECLIPSE = FAMILIES["annular eclipse"].arguments
CLOSED = {
    "disk light": (disk_light, None),
    "coaxial disk light": (coaxial_disk, None),
    "disk behind a sphere": (disk_behind_sphere, None),
    "disk behind a disk": (disk_behind_disk, less_a_disk(moving.disk_over_receiver)),
    "sphere behind a disk": (sphere_behind_disk, less_a_disk(moving.sphere_over_receiver)),
}


@pytest.mark.parametrize(
    "name", [name if name == "disk behind a disk" else pytest.param(name, marks=SLOW) for name in CLOSED]
)
def test_derivatives_by_everything_are_those_of_the_closed_form(name):
    make, formula = CLOSED[name]
    if formula is None:
        arguments, exact = FAMILIES[name].arguments, FAMILIES[name].derivatives
    else:
        arguments = ECLIPSE
        exact = value_and_derivatives(formula, **ECLIPSE)[1]
    found = derivatives(make, arguments)
    assert found.flags == ()
    check(found, exact)


# ------------------------------------------------------------------------------------------- disks at any angle


def along_the_rim(emission, center, normal, radius, point, facing, nodes=400):
    """Irradiance from a disk wholly above the horizon, or that it takes away: the integral along its rim (Lambert)."""
    n, facing = normal / jnp.linalg.norm(normal), facing / jnp.linalg.norm(facing)
    u = jnp.cross(n, jnp.array([0.0, 1.0, 0.0]))
    u = radius * u / jnp.linalg.norm(u)
    turn = 2.0 * jnp.pi * jnp.arange(nodes)[:, None] / nodes
    v = jnp.cross(n, u)
    to = center - point + u * jnp.cos(turn) + v * jnp.sin(turn)
    step = (v * jnp.cos(turn) - u * jnp.sin(turn)) * 2.0 * jnp.pi / nodes
    return emission / 2.0 * jnp.abs(jnp.sum(jnp.cross(to, step) @ facing / jnp.sum(to * to, 1)))


TILTED = {
    "emission": 2.0, "center": np.array([0.5, -0.3, 1.5]), "normal": np.array([-0.4, 0.9, -1.1]), "radius": 0.6,
    "point": np.array([0.1, 0.2, -0.1]), "facing": np.array([0.2, 0.1, 2.0]),
}  # fmt: skip


def before_the_sky(p):
    blocker = disk(p["center"], p["radius"], normal=p["normal"])
    return at_origin(blocker, sky=p["emission"], point=p["point"], normal=p["facing"])


def tilted_light(p):
    light = disk(p["center"], p["radius"], p["emission"], p["normal"])
    return at_origin(light, point=p["point"], normal=p["facing"])


@SLOW
@pytest.mark.parametrize("is_light", [True, False], ids=["light", "blocker"])
def test_a_tilted_disk_by_all_its_numbers_and_the_receivers(is_light):
    value, exact = value_and_derivatives(along_the_rim, **TILTED)
    assert value > 0.1
    exact, arguments = {name: np.asarray(x) for name, x in exact.items()}, dict(TILTED)
    if not is_light:
        exact = {name: (np.pi if name == "emission" else 0.0) - x for name, x in exact.items()}
        # By the receiver's normal the samples of the sky have a variance without bound.
        facing = arguments.pop("facing")
        del exact["facing"]
    found = derivatives(tilted_light if is_light else lambda p: before_the_sky({**p, "facing": facing}), arguments)
    check(found, exact)


# ---------------------------------------------------------------------------------------- disks that hide in part


def partly_hidden(emission, light_radius, light_height, light_offset, blocker_radius, blocker_height, blocker_offset):
    """Irradiance from a level disk of which a level disk hides a part: rings around the receiver's foot, whose centres
    lie on one side of it."""
    grow = light_height / blocker_height

    def angle(ring, center, radius):
        if ring <= abs(center - radius):
            return np.pi if center < radius else 0.0
        return np.arccos(np.clip((ring**2 + center**2 - radius**2) / (2.0 * ring * center), -1.0, 1.0))

    def ring(r):
        lit = angle(r, light_offset, light_radius) - angle(r, blocker_offset * grow, blocker_radius * grow)
        return 2.0 * max(lit, 0.0) * r * light_height**2 / (r * r + light_height**2) ** 2

    stops = [abs(c + s * r) for c, r in ((light_offset, light_radius), (blocker_offset * grow, blocker_radius * grow))
             for s in (-1.0, 1.0)]  # fmt: skip
    last = light_offset + light_radius
    return emission * integral(ring, 0.0, last, points=[s for s in stops if s < last], limit=400, epsabs=1e-12)[0]


PARTLY = {
    "emission": 5.0, "light_radius": 0.8, "light_height": 2.0, "light_offset": 0.5, "blocker_radius": 0.35,
    "blocker_height": 0.9, "blocker_offset": 0.55,
}  # fmt: skip


def disk_partly_behind_disk(p):
    light = disk([p["light_offset"], 0.0, p["light_height"]], p["light_radius"], p["emission"])
    return at_origin(light, disk([p["blocker_offset"], 0.0, p["blocker_height"]], p["blocker_radius"], normal=UP))


@SLOW
def test_a_disk_that_hides_a_part_of_another():
    def slope(name, step=1e-3):
        ends = (partly_hidden(**{**PARTLY, name: PARTLY[name] + s * step}) for s in (2.0, 1.0, -1.0, -2.0))
        a, b, c, d = ends
        return (-a + 8.0 * b - 8.0 * c + d) / (12.0 * step)

    check(derivatives(disk_partly_behind_disk, PARTLY), {name: slope(name) for name in PARTLY})


@SLOW
def test_a_quad_and_a_ball_before_a_disk_light():
    # By the disk's radius it is the ring of light that is seen; by the places of the blockers, their shadows.
    def make(p):
        light = disk([0.1, 0.0, 2.0], p["radius"], 5.0)
        sheet = mc.Quad([p["edge"], -1.0, 1.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], BLACK)
        return at_origin(light, sheet, ball([p["x"], -0.1, 1.0], 0.1))

    arguments = {"radius": 0.7, "edge": 0.2, "x": -0.1}

    def exact(radius, edge, x):
        # Strips of the light across the sheet's edge, up to its shadow, less the ball's.
        def strip(t):
            half = np.sqrt(max(radius**2 - (t - 0.1) ** 2, 0.0))
            far = t * t + 4.0
            return 4.0 * (half / (far * (far + half * half)) + np.arctan(half / np.sqrt(far)) / far**1.5)

        ball_hides = moving.sphere_over_receiver(5.0, 0.1, 1.0, np.hypot(x, 0.1))
        return 5.0 * integral(strip, 0.1 - radius, 2.0 * edge, limit=200, epsabs=1e-12)[0] - float(ball_hides)

    def slope(name, step=1e-3):
        ends = [exact(**{**arguments, name: arguments[name] + s * step}) for s in (1.0, -1.0)]
        return (ends[0] - ends[1]) / (2.0 * step)

    check(derivatives(make, arguments), {name: slope(name) for name in arguments})


# ------------------------------------------------------------------------------------------------------- mutants


def rim_by_angle_alone(right):
    return lambda disk, angle: right(disk, angle)._replace(stretch=1.0)


def half_of_the_rim(right):
    return lambda disk, angle: right(disk, 0.5 * angle)


@pytest.mark.parametrize("mutate", [rim_by_angle_alone, pytest.param(half_of_the_rim, marks=SLOW)])
def test_the_check_rejects_a_mutant(mutate, monkeypatch):
    from jaxmc.gradients import curves

    monkeypatch.setattr(curves, "rim_point", mutate(disks.rim_point))
    exact = {"radius": -np.asarray(value_and_derivatives(along_the_rim, **TILTED)[1]["radius"])}
    found = derivatives(lambda p: before_the_sky({**TILTED, **p}), {"radius": TILTED["radius"]})
    with pytest.raises(AssertionError, match=r"^radius is off"):
        check(found, exact)


# ------------------------------------------------------------------------------------------------ what is not covered


def flags(*primitives):
    return mc.direct_irradiance(mc.Scene([ball((0, 0, 50.0), 1.0, 1.0), *primitives]), (0, 0, -50.0), UP).flags


def test_disks_that_something_passes_through_are_flagged():
    level = disk((0, 0, 0), 1.0)
    assert flags(level, disk((0, 0, 0.5), 1.0), ball((0, 0, 1.5), 0.9), disk((1.6, 0, 0), 0.5, normal=(1, 0, 0))) == ()
    standing = {"normal": (1, 0, 0)}
    for other in (
        disk((0, 0, 0.2), 0.5, **standing),
        disk((0.9, 0, 0.2), 0.5, **standing),
        ball((0.0, 0.0, 0.8), 0.9),
        ball((1.2, 0.0, 0.1), 0.3),
        mc.Quad((-0.5, 0, -0.5), (0.2, 0, 0), (0, 0, 1.0), BLACK),
        mc.Quad((-2, 0.1, -2), (4, 0, 0), (0, 0, 4), BLACK),
        mc.Triangle((0, 0, -1), (0.1, 0, 1), (0.1, 0.1, 1), BLACK),
    ):
        assert any("(1 and 2)" in flag for flag in flags(level, other)), other
    # It stands on the other, or on its edge.
    assert flags(level, disk((0, 0, 0.5), 0.5, **standing)) == ()
    assert any("twice" in flag for flag in flags(level, disk((0, 0, 0), 1.0, normal=UP)))
