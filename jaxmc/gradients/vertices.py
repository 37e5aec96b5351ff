"""A surface that a path scatters at, at rest and in motion: what it reflects, and how directions move that keep the
coordinates they are drawn with.

Source of the latter, attached sampling: Zeltner et al. 2021, "Monte Carlo Estimators for Differential Light Transport".
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ..transport.bsdfs import BsdfSample, Kinds, bsdf_coordinates, evaluate_bsdf, sample_bsdf
from ..transport.hits import Hit, Surface
from ..transport.paths import emission_met
from ..transport.rays import ray
from ..transport.vec import Vec3, dot, where
from .flows import attach, carried, distance_to, still
from .world import World


class Vertex(NamedTuple):
    """A surface that a path scatters at, at rest and in motion; ``beta`` has the surface's reflectance."""

    surface: Surface
    kinds: Kinds
    moving: Surface
    moving_kinds: Kinds
    came: Vec3
    arriving: Vec3
    beta: Any


def evaluate(world: World, strategy, vertex: Vertex, wi: Vec3):
    """Return pi times BRDF times cosine of a direction in motion, reflectance left out."""
    cosine = dot(vertex.moving.normal, wi)
    return evaluate_bsdf(
        world.moving, strategy.directions, vertex.moving, vertex.moving_kinds, vertex.arriving, wi, cosine
    )[0]


def sample_in_motion(world: World, strategy, vertex: Vertex, coordinates) -> BsdfSample:
    """Return the direction that two coordinates draw, in motion, with its weight."""
    return sample_bsdf(
        world.moving, strategy.directions, vertex.moving, vertex.moving_kinds, vertex.arriving, *coordinates
    )


def with_same_coordinates(world: World, strategy, vertex: Vertex, wi: Vec3) -> Vec3:
    """Return a direction in motion that keeps the coordinates that draw it; the surface is not specular."""
    # What is not used must not turn derivatives to NaN.
    above = where(dot(vertex.surface.normal, wi) > 0.0, wi, vertex.surface.normal)
    found = bsdf_coordinates(world.rest, strategy.directions, vertex.surface, vertex.kinds, vertex.came, above)
    return attach(wi, sample_in_motion(world, strategy, vertex, still(found)).wi)


def share_of_emission(world: World, strategy, vertex: Vertex, wi: Vec3, hit: Hit):
    """Return the share of emission that counts where a drawn direction meets it; what is left of 1 counts where lights
    are sampled. All of the sky counts where it is met.

    The direction is in motion, all else at rest. That leaves no bias: at a fixed point the shares of both ways are
    fixed functions of the direction, and their sum is 1 wherever each of them moves it.
    """
    surface, cosine = vertex.surface, dot(vertex.surface.normal, wi)
    if not world.rest.lights:
        return jnp.ones(())
    # What is not used must not turn derivatives to NaN.
    counts = (hit.face >= 0) & (cosine > 0.0)
    toward, cosine = where(counts, wi, surface.normal), jnp.where(counts, cosine, 1.0)
    _, pdf = evaluate_bsdf(world.rest, strategy.directions, surface, vertex.kinds, vertex.came, toward, cosine)
    place = carried(still(world.values.faces).at(hit.face), surface.point, toward, distance_to(hit))
    met = hit._replace(distance=attach(distance_to(hit), dot(place - surface.point, still(toward))))
    onward = ray(surface.point, toward)
    share = emission_met(world.shares, strategy, onward, met, pdf, surface, vertex.kinds.specular)
    return jnp.where(counts, share, 1.0)
