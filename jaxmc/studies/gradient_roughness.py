"""Derivatives by roughness: a metal seen at 45 degrees under three lights, by two ways to draw a facet."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ..gradients.estimators import (
    Drawn,
    attached_integrand,
    derivative_parts,
    difference_integrand,
    score_control,
)
from ..gradients.paths import moving_radiance
from ..transport.integrands import radiance
from ..transport.materials import Diffuse, RoughConductor
from ..transport.microfacets import eval_ggx, ggx_density, pdf_ggx, sample_ggx
from ..transport.primitives import Quad, Sphere
from ..transport.scene import Scene
from ..transport.vec import Vec3, dot, normalize
from ..transport.warps import sincos_2pi
from .gradient_tasks import Estimator, Score, Task, family
from .scores import exact_function

LIGHTS = {"constant": "a constant sky", "lobe": "a smooth lobe of 20 degrees", "disk": "a disk of 5 degrees"}
ALPHAS = (0.05, 0.2, 0.5)
STEP = 0.04  # of a difference, relative: 2 % to either side
SOFT = (0.3, 0.03)  # widths of a softened disk's edge, relative to its radius
BY_DENSITY, BY_VIEW = "facets by density", "facets that are seen"
ATTACHED, SCORE, CONTROLLED, DIFFERENCE = "attached", "score", "score, with control", "difference of 4 %"
PILOT = 1 << 16


def roughness_tasks(seed=0, alphas=ALPHAS) -> list[Task]:
    """Return a task for each light and roughness."""
    return [roughness_task(light, alpha, seed) for light in LIGHTS for alpha in alphas]


def roughness_task(light, alpha, seed=0) -> Task:
    """Return all estimators of the derivative for one light and roughness."""
    known = exact_function("rough_metal_under")
    half = 0.5 * STEP * alpha
    quotient = (known(light, alpha + half).value - known(light, alpha - half).value) / (2.0 * half)
    found, smooth = [], light != "disk"
    for word, drawn in ((BY_DENSITY, by_density(light)), (BY_VIEW, by_view(light))):
        control = score_control(drawn, alpha, n=PILOT, key=seed)
        attached = Attached(drawn)
        found += [
            Estimator(f"{ATTACHED}, {word}", derivative_parts(attached, alpha), smooth),
            Estimator(f"{SCORE}, {word}", derivative_parts(Score(drawn), alpha), True),
            Estimator(f"{CONTROLLED}, {word}", derivative_parts(Score(drawn, control), alpha), True),
            Estimator(f"{DIFFERENCE}, {word}", (difference_integrand(attached, alpha, STEP * alpha),), False, quotient),
        ]
    if light == "disk":
        for width in SOFT:
            parts = derivative_parts(Attached(by_density(light, width)), alpha)
            found.append(Estimator(f"softened by {width:g} of the radius", parts, False))
        found.append(Estimator(f"{ATTACHED}, with the boundary", derivative_parts(_under_disk, alpha), True))
    return Task(f"roughness {alpha:g} under {LIGHTS[light]}", known(light, alpha).derivative, tuple(found))


def paths_task() -> Task:
    """Return estimators of a path tracer: a metal under a constant sky, seen from above."""
    known = family("rough metal")
    alpha = known.arguments["roughness"]
    half = 0.5 * STEP * alpha
    ends = (known._replace(arguments={"roughness": alpha + s * half}).exact for s in (1, -1))
    found = (
        Estimator("plain AD: attached", derivative_parts(_floor, alpha), True),
        Estimator("interior: detached", derivative_parts(_moving_floor, alpha), True),
        Estimator(
            DIFFERENCE, (difference_integrand(_floor, alpha, STEP * alpha),), False,
            float(np.subtract(*ends)) / (STEP * alpha),
        ),
    )  # fmt: skip
    return Task("roughness, by paths", known.derivatives["roughness"], found)


def _metal(alpha):
    floor = Quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], RoughConductor(alpha))
    return Scene([floor], 1.0), [0.1, 0.2, 1.0], [0.0, 0.0, -1.0]


SKY = {"bounces": 1, "directions": "bsdf"}


def _floor(alpha):
    return radiance(*_metal(alpha), **SKY)


def _moving_floor(alpha):
    return moving_radiance(*_metal(alpha), **SKY)


def _under_disk(alpha):
    """A path tracer for the disk, which is a sphere far away, with directions that keep their random numbers."""
    light, wo = radiance_of("disk"), viewer()
    floor = Quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], RoughConductor(alpha))
    lamp = Sphere(Vec3(*light.axis) * 8.0, 8.0 * np.sin(light.half_angle), Diffuse(0.0), emission=1.0)
    return moving_radiance(Scene([floor, lamp]), wo * 2.0, -wo, bounces=1, lights="none", sampling="attached")


@dataclasses.dataclass(frozen=True)
class Attached:
    """Makes the integrand whose draws move with roughness."""

    drawn: Drawn

    def __call__(self, alpha):
        return attached_integrand(self.drawn, alpha)


def by_density(light, soft=None) -> Drawn:
    """Return reflected radiance as an integral over the normals of facets, drawn by their density."""
    return Drawn(2, sample_facet, pdf_facet, Facets(radiance_of(light, soft)))


def by_view(light) -> Drawn:
    """Return reflected radiance as an integral over directions of light, by facets that the viewer sees."""
    return Drawn(2, sample_seen, pdf_seen, Directions(radiance_of(light)))


def viewer() -> Vec3:
    return Vec3(*map(float, exact_function("rough_lights").viewer()))


def sample_facet(u, alpha):
    """Return the normal of a facet, drawn by density times cosine (Walter et al. 2007)."""
    tangent = alpha * jnp.sqrt(u[0] / (1.0 - u[0]))
    sine, cosine = sincos_2pi(u[1])
    return normalize(Vec3(tangent * cosine, tangent * sine, jnp.ones(())))


def pdf_facet(h, alpha):
    return ggx_density(h, alpha) * h.z


def sample_seen(u, alpha):
    return sample_ggx(viewer(), alpha, u[0], u[1])[0]


def pdf_seen(wi, alpha):
    return pdf_ggx(viewer(), wi, alpha)


@dataclasses.dataclass(frozen=True)
class Facets:
    """Light that facets of one normal bring, per solid angle of the normals."""

    radiance: Callable

    def __call__(self, h, alpha):
        facing = dot(viewer(), h)
        wi = h * (2.0 * facing) - viewer()
        return eval_ggx(viewer(), wi, alpha) * self.radiance(wi) * (4.0 * jnp.maximum(facing, 0.0))


@dataclasses.dataclass(frozen=True)
class Directions:
    """Light from one direction that is reflected, per solid angle."""

    radiance: Callable

    def __call__(self, wi, alpha):
        return eval_ggx(viewer(), wi, alpha) * self.radiance(wi)


@dataclasses.dataclass(frozen=True)
class Light:
    """Radiance that arrives from a direction; ``soft``: the width of a disk's edge over its radius."""

    name: str
    axis: tuple[float, float, float]
    sharpness: float
    half_angle: float
    soft: float | None = None

    def __call__(self, wi):
        if self.name == "constant":
            return jnp.ones(())
        away = wi - Vec3(*self.axis)
        below = 0.5 * dot(away, away)  # 1 - cos, with all digits
        if self.name == "lobe":
            return jnp.exp(-self.sharpness * below)
        if self.soft is None:
            return jnp.where(below < 1.0 - np.cos(self.half_angle), 1.0, 0.0)
        distance = jnp.sqrt(2.0 * below + 1e-12) / (2.0 * np.sin(0.5 * self.half_angle))
        return jax.nn.sigmoid((1.0 - distance) / self.soft)


def radiance_of(name, soft=None) -> Light:
    known = exact_function("rough_lights")
    return Light(name, tuple(map(float, known.light_direction())), known.SHARPNESS, float(known.HALF_ANGLE), soft)
