"""Estimators that send several rays from one point, for comparison with those that send one. Their cost is a power of
the depth, and most of it goes to the last event.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..integration.counts import positive
from ..integration.integrand import Integrand
from ..transport import rays
from ..transport.bsdfs import sample_diffuse
from ..transport.hits import closest_hit, surface_at, unoccluded
from ..transport.integrands import Film, through_film
from ..transport.lights import emission_toward
from ..transport.paths import apart
from ..transport.strategy import Strategy


def gathered_occlusion(scene, camera, directions) -> Integrand:
    """Return what ``mc.ambient_occlusion`` does, sample by sample, as a loop over the directions: any number of them
    compiles in the same time.
    """
    count = positive("directions", directions)
    labels = tuple(f"direction {k + 1}: {word}" for k in range(count) for word in ("polar", "azimuth"))
    return through_film(partial(_Gathered, directions=count), scene, camera, Strategy(0), labels)


@dataclasses.dataclass(frozen=True)
class _Gathered(Film):
    directions: int

    def __call__(self, u, scene, camera, pixel=None):
        start = self.start(u, scene, camera, pixel)
        hit = closest_hit(scene, start)
        surface = surface_at(scene, start, hit)

        def add(free, k):
            wi, _, _ = sample_diffuse("cosine", surface.normal, u[2 + 2 * k], u[3 + 2 * k])
            is_free = unoccluded(scene, rays.ray(surface.point, wi), jnp.inf, surface.face, None, anywhere=True)
            return free + jnp.where(is_free, 1.0 / self.directions, 0.0), None

        free, _ = lax.scan(add, jnp.zeros(()), jnp.arange(self.directions))
        return jnp.where(hit.face >= 0, free, 1.0)


def branching_terms(scene, camera, *, depth, branch, directions="cosine") -> Integrand:
    """Return the light after 0, 1, ..., ``depth`` scattering events, shape (depth + 1,), of a grey diffuse scene, where
    every hit sends ``branch`` rays that wait until they meet a light: 1 + b + b^2 + ... rays for each sample.

    Raises:
        ValueError: a scene that is not grey and diffuse, or numbers that are not positive integers.
    """
    if scene.channels != 1 or scene.mirrors or scene.rough or scene.dielectrics:
        raise ValueError("branching_terms needs a scene of grey diffuse surfaces")
    depth, branch = positive("depth", depth), positive("branch", branch)
    count = rays_of(depth, branch) - 1
    labels = tuple(f"ray {k + 1}: {word}" for k in range(count) for word in ("polar", "azimuth"))
    kind = partial(_Branching, depth=depth, branch=branch, directions=directions)
    return through_film(kind, scene, camera, Strategy(0), labels)


def rays_of(depth, branch) -> int:
    """Return how many rays a sample takes, the camera's among them: 1 + b + ... + b^depth."""
    return sum(branch**k for k in range(depth + 1))


@dataclasses.dataclass(frozen=True)
class _Branching(Film):
    depth: int
    branch: int
    directions: str

    def __call__(self, u, scene, camera, pixel=None):
        start = self.start(u, scene, camera, pixel)
        hit = apart(scene, partial(closest_hit, scene), start)
        paths = jax.tree.map(lambda x: jnp.asarray(x)[None], (start, hit, jnp.ones(())))
        first, terms = 2, [self._light(scene, paths)]
        for level in range(1, self.depth + 1):
            count = self.branch ** (level - 1)
            numbers = first + 2 * jnp.arange(count * self.branch).reshape(count, self.branch)
            paths = apart(scene, jax.vmap(partial(self._children, u, scene)), paths, numbers)
            paths = jax.tree.map(lambda x: x.reshape(-1), paths)
            first += 2 * count * self.branch
            terms.append(self._light(scene, paths))
        return jnp.stack(terms)

    def _light(self, scene, paths):
        """Return the mean over all rays of a level: each stands for as many as its siblings."""
        return jnp.mean(jax.vmap(lambda ray, hit, beta: beta * emission_toward(scene, ray, hit))(*paths))

    def _children(self, u, scene, parent, numbers):
        ray, hit, beta = parent
        surface = surface_at(scene, ray, hit)

        def child(k):
            wi, _, weight = sample_diffuse(self.directions, surface.normal, u[k], u[k + 1])
            onward = rays.ray(surface.point, wi)
            after = closest_hit(scene, onward, surface.face)
            worth = jnp.where(hit.face >= 0, beta * surface.reflectance * weight, 0.0)
            return onward, after, worth

        return jax.vmap(child)(numbers)


def furnace_law(albedo, depth, branch) -> tuple[float, float]:
    """Return mean and variance of a branching sample in a white furnace of emission 1 by uniform directions.

    Every ray of a level is worth X' = 1 + (rho / b) sum_i w_i X_i, with the independent weights w = 2 cos of uniform
    directions, E w = 1 and E w^2 = 4/3. So E X' = 1 + rho E X and Var X' = (rho^2 / b) (4/3 E X^2 - (E X)^2).
    """
    mean, variance = 1.0, 0.0
    for _ in range(depth):
        square = variance + mean**2
        mean, variance = 1.0 + albedo * mean, albedo**2 / branch * (4.0 / 3.0 * square - mean**2)
    return mean, variance


def split_variance(share, side, nodes=64) -> tuple[float, float]:
    """Return the variance between the points of a square and the mean variance within them, of samples that are 1 with
    probability ``share(x, y)`` and else 0; x and y run over [-side/2, side/2].
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    weights = np.outer(w, w) / 4.0
    p = share(*np.meshgrid(0.5 * side * x, 0.5 * side * x))
    mean = np.sum(weights * p)
    return float(np.sum(weights * (p - mean) ** 2)), float(np.sum(weights * p * (1.0 - p)))
