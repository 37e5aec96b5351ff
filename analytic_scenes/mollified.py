"""What cannot be hit made hittable: a delta function blurred over a disk, a mirror that reflects into a cone.

Both are regularised estimators whose bias and variance are known, so that what regularisation costs can be measured.
"""

import functools
import math

import jax.numpy as jnp

import jaxmc as mc
from analytic_scenes.caps import caps_overlap
from analytic_scenes.laws import Law, law_of_values
from analytic_scenes.scene import AnalyticScene, closed_form_scene, variance_and_kurtosis
from jaxmc.testing import DiskMollifier


@functools.cache
def default_scenes() -> tuple[AnalyticScene, ...]:
    """Return the default configurations, of relative variance below 4."""
    return disk_mollifier(), cone_mirror(), cone_mirror(offset=0.15, cone=0.25)


def disk_mollifier(a: float = 1.0, h: float = 0.5) -> AnalyticScene:
    """Return (1 + a |x|^2) / h^2 where |x| < h, for x uniform on the unit disk: an integral over [0,1)^2.

    Exact: mean 1 + a h^2 / 2, of which a h^2 / 2 is the bias against the value 1 at the middle, and
    E X^2 = (1 + a h^2 + a^2 h^4 / 3) / h^2. The derivative with respect to ``h`` comes from the edge too.
    Raises ``ValueError`` unless 0 < h <= 1 and a >= -1.
    """
    if not 0 < h <= 1 or not -1 <= a < math.inf:
        raise ValueError(f"0 < h <= 1 and a finite a >= -1 are needed; got h={h}, a={a}")
    moments = [DiskMollifier(a, h).moment(q) for q in (1, 2, 3, 4)]
    return closed_form_scene(
        f"delta blurred over a disk, a={a:g}, h={h:g}",
        _disk_mean,
        {"a": a, "h": h},
        mc.Integrand(lambda u, a, h: DiskMollifier(a, h).sample(u), 2, (float(a), float(h))),
        "elementary",
        geometry="No scene: a quadratic function near the middle of the unit disk.",
        law=lambda exact: Law(*variance_and_kurtosis(moments)),
        view=None,
    )


def cone_mirror(
    radiance: float = 10.0, reflectance: float = 0.9, cone: float = 0.3, light: float = 0.2, offset: float = 0.0
) -> AnalyticScene:
    """Return the radiance reflected by a mirror whose delta function is a constant over a cone about the mirrored ray.

    The light is a round one of angular radius ``light`` [rad]; its centre is ``offset`` [rad] from the mirrored
    direction. Directions are uniform in the cone of half angle ``cone`` [rad], so a sample is reflectance x radiance
    where it meets the light, else 0. Exact: the share of the cone that the light fills; for offset = 0 that is
    min(1, (1 - cos light) / (1 - cos cone)). A sharp mirror sees all of the light, or nothing.
    Every derivative but those of radiance and reflectance comes from the edge. Raises ``ValueError`` unless both angles
    are above 0 and at most pi/2, and 0 <= offset <= pi/2.
    """
    if not (0 < cone <= math.pi / 2 and 0 < light <= math.pi / 2 and 0 <= offset <= math.pi / 2):
        raise ValueError(f"angles up to pi/2 are needed, two of them not 0; got {cone=}, {light=}, {offset=}")
    arguments = {"radiance": radiance, "reflectance": reflectance, "cone": cone, "light": light, "offset": offset}
    peak = radiance * reflectance
    return closed_form_scene(
        f"cone mirror of {cone:g} and a round light of {light:g}, {offset:g} apart",
        _cone_mean,
        arguments,
        mc.Integrand(_cone_sample, 2, tuple(map(float, arguments.values()))),
        "solid angles of caps: Mazonka (2012)",
        geometry="A ray meets a mirror that reflects evenly into a cone; one round light stands in the sky.",
        law=lambda exact: law_of_values([exact / peak], [peak]) if peak else Law(0.0, None),
        view=None,
    )


def _disk_mean(a, h):
    return 1.0 + a * h**2 / 2.0


def _cone_sample(u, radiance, reflectance, cone, light, offset):
    depth = u[0] * (1.0 - jnp.cos(cone))
    across = jnp.sqrt(depth * (2.0 - depth)) * jnp.cos(2.0 * jnp.pi * u[1])
    met = jnp.cos(offset) * (1.0 - depth) + jnp.sin(offset) * across > jnp.cos(light)
    return jnp.where(met, radiance * reflectance, 0.0)


def _cone_mean(radiance, reflectance, cone, light, offset):
    axis = jnp.array([0.0, 0.0, 1.0])
    toward = jnp.sin(offset) * jnp.array([1.0, 0.0, 0.0]) + jnp.cos(offset) * axis
    caps = jnp.append(axis, jnp.cos(cone)), jnp.append(toward, jnp.cos(light))
    return radiance * reflectance * caps_overlap(*caps) / (2.0 * jnp.pi * (1.0 - jnp.cos(cone)))
