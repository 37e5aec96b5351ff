"""Light transport as it moves with the scene: integrands whose derivative is whole, interior and boundary."""

import dataclasses
from typing import Any, Unpack

from ..integration.integrand import Integrand
from ..transport import integrands
from ..transport.camera import Camera
from ..transport.primitives import as_vec3
from ..transport.scene import Scene
from .boundary import Boundary
from .derivative import WithBoundary
from .mirrors import Mirrors, mirrors_of
from .options import MovingOptions, MovingStrategy, of_paths
from .receivers import AlongRay, AtPoint, OnFilm, OverFace
from .shadows import SKY, lamps_of
from .silhouettes import silhouettes_of
from .walks import follow, scatter_at
from .world import values_of, world

UNFIT = ("clamp", "regularize", "hide_emitters", "sample_sky")


def moving_paths(scene: Scene, camera: Camera, *, bounces, **options: Unpack[MovingOptions]) -> WithBoundary:
    """Return the mean radiance of a camera's image, with all that its derivative needs.

    The value is that of ``mc.path_integrand``. Its derivative in ``mc.grad_integrate`` holds with respect to whatever
    the scene and the camera are made of: colours, roughness, indices of refraction, places, sizes, orientations, the
    camera itself. The interior keeps every drawn direction on what it has met, or on what a plane mirror shows there,
    or with ``sampling="attached"`` the random numbers that drew it; the boundary has all edges that move: on the film,
    before lights, before surfaces that reflect, those of mirrors, where the sky meets its ground, and each of them seen
    in plane mirrors.

    What is not covered is said in ``flags``: edges seen in curved mirrors, through glass or in more than two mirrors,
    primitives that pass through each other, edges that overlap in part. Primitives that share an edge count as one
    surface, and must move together. Derivatives of second order are wrong. Where a surface that is seen meets another
    one, derivatives by its place have heavy tails, of one over the distance: look at ``kurtosis``.

    Args:
        scene: what is there.
        camera: where it is seen from.
        bounces: largest number of scattering events; 0 is emission seen directly.
        options: ``sampling`` as in ``MovingOptions``; ``directions``, ``lights``, ``pick``, ``light_points``,
            ``roulette`` as in ``PathOptions``.

    Raises:
        ValueError: an option out of range, or one that makes another integral of it; a scene or a camera that is none.
        TypeError: an unknown option.
    """
    return moving_film(OnFilm, scene, camera, bounces, options)


def moving_film(receiver, scene, camera, bounces, options) -> WithBoundary:
    """Return ``moving_paths`` for a class of receivers on a film."""
    integrand = integrands.path_integrand(scene, camera, bounces=bounces, **of_paths(options))
    if not camera.antialias:
        raise ValueError(
            "a camera with antialias=False sees points of its film, whose radiance jumps where an edge passes: it has "
            "no derivative; leave antialias=True"
        )
    return _moving(scene, receiver(integrand.fn.far), integrand.params[1], bounces, options)


def moving_radiance(scene: Scene, origin, direction, *, bounces, **options: Unpack[MovingOptions]) -> WithBoundary:
    """Return the radiance that arrives at ``origin`` from ``direction``, with all that its derivative needs; all else
    as in ``moving_paths``. The value is that of ``mc.radiance``. No edge matters on a single ray itself.
    """
    integrand = integrands.radiance(scene, origin, direction, bounces=bounces, **of_paths(options))
    return _moving(scene, AlongRay(), integrand.params[1:], bounces, options)


def moving_irradiance(scene: Scene, point, normal, *, bounces, **options: Unpack[MovingOptions]) -> WithBoundary:
    """Return the irradiance at a point, with all that its derivative needs, also by ``point`` and ``normal``; all else
    as in ``moving_paths``. The value is that of ``mc.irradiance``.
    """
    integrand = integrands.irradiance(scene, point, normal, bounces=bounces, **of_paths(options))
    return _moving(scene, AtPoint(), integrand.params[1:], bounces, options)


def mean_moving_irradiance(
    scene: Scene, corner, edge_u, edge_v, *, bounces, **options: Unpack[MovingOptions]
) -> WithBoundary:  # fmt: skip
    """Return the mean of ``moving_irradiance`` over a parallelogram that receives light on the side of
    cross(edge_u, edge_v).

    It may lie on a face of the scene; its own outline is no edge, since the mean is over all of it.
    """
    _check_scene(scene)
    place = scene.local(as_vec3("corner", corner)), as_vec3("edge_u", edge_u), as_vec3("edge_v", edge_v)
    return _moving(scene, OverFace(), place, bounces, options)


def direct_irradiance(scene: Scene, point, normal, **options: Unpack[MovingOptions]) -> WithBoundary:
    """Return the irradiance at a point that comes from lights and sky directly, as ``moving_irradiance`` with 0
    bounces, where lights are sampled alone.
    """
    return moving_irradiance(scene, point, normal, bounces=0, **{"lights": "nee", **options})


def mean_direct_irradiance(scene: Scene, corner, edge_u, edge_v, **options: Unpack[MovingOptions]) -> WithBoundary:
    """Return the mean of ``direct_irradiance`` over a parallelogram, as ``mean_moving_irradiance``."""
    return mean_moving_irradiance(scene, corner, edge_u, edge_v, bounces=0, **{"lights": "nee", **options})


def _check_scene(scene):
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, made by mc.Scene([...]), got {scene!r}")


def _moving(scene, receiver, place, bounces, options):
    unfit = [name for name in UNFIT if options.get(name)]
    if unfit:
        raise ValueError(f"moving integrands have no {', '.join(unfit)}: leave it out")
    if not scene.size:
        raise ValueError("a scene without primitives has nothing that moves: add one, if only far behind the viewer")
    strategy = MovingStrategy(bounces, **options)
    values = values_of(scene, place)
    events = bounces + receiver.is_surface
    words = [f"event {k + 1}, {word}" for k in range(events) for word in strategy.coordinates(scene)]
    labels = (*receiver.labels, *words) or ("unused",)
    params = scene, values, values
    mirrors = mirrors_of(scene, bounces)
    interior = Integrand(Interior(strategy, receiver, mirrors), len(labels), params, True, labels)
    found, flags = silhouettes_of(scene, bounces)
    lamps = lamps_of(scene)
    if strategy.is_attached:
        # What is found by drawn directions alone counts with all else that they meet.
        lamps = tuple(lamp for lamp in lamps if lamp.face != SKY and strategy.lights != "none")
    around = Boundary(strategy, receiver, found, lamps, mirrors)
    if not (around.choices):
        return WithBoundary(interior, None, flags, held=2)
    labels = around.labels(scene)
    return WithBoundary(interior, Integrand(around, len(labels), params, True, labels), flags, held=2)


@dataclasses.dataclass(frozen=True)
class Interior:
    """Light transport, found with the scene at rest and evaluated again with the scene in motion."""

    strategy: MovingStrategy
    receiver: Any
    mirrors: Mirrors

    def __call__(self, u, rest, at_rest, values, *pixel):
        moving = world(rest, at_rest, values, self.mirrors)
        begun = self.receiver.begin(u, moving, *pixel)
        walk, total, first = begun.walk, begun.met, begun.first
        if begun.vertex is not None:
            walk, total = scatter_at(moving, self.strategy, u, first, begun.vertex, 0, anywhere=True)
            first += len(self.strategy.coordinates(rest))
        total = total + follow(moving, self.strategy, u, first, walk, self.strategy.bounces)
        return self.receiver.finish(self.strategy, total * begun.weight)
