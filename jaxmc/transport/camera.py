"""The pinhole camera."""

import dataclasses
import math
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..integration.counts import positive
from .primitives import as_vec3, is_concrete, is_number, shape_of
from .rays import Ray, ray
from .vec import Vec3, cross, dot, normalize


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["origin", "right", "down", "forward"],
    meta_fields=["width", "height", "antialias"],
)
@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera as the kernel uses it: the direction to film position (x, y) in [-1, 1]^2 is
    ``forward + right * x + down * y``, before normalisation. ``antialias``: rays lie anywhere in a pixel, not in its
    middle.

    ``given`` are the arguments of ``PinholeCamera``; not part of the pytree, so a camera that went through a
    transformation of JAX has none.
    """

    given: ClassVar[dict[str, Any] | None] = None

    origin: Vec3
    right: Vec3
    down: Vec3
    forward: Vec3
    width: int
    height: int
    antialias: bool = True

    def ray(self, x, y) -> Ray:
        """Return the ray through film position (x, y), in pixels from the top left corner."""
        s, t = x * (2.0 / self.width) - 1.0, y * (2.0 / self.height) - 1.0
        return ray(self.origin, normalize(self.forward + self.right * s + self.down * t))


def PinholeCamera(
    origin, target, up=(0.0, 1.0, 0.0), fov=40.0, width=256, height=256, antialias=True
) -> Camera:  # fmt: skip
    """Return a pinhole camera; the film is sampled uniformly within each pixel.

    Args:
        origin: where the eye is.
        target: a point in the middle of the image.
        up: a direction that points up in the image.
        fov: vertical field of view in degrees, between 0 and 180.
        width: pixels from left to right.
        height: pixels from top to bottom; pixel (0, 0) is top left.
        antialias: False sends every ray through the middle of its pixel. The samples of ``render`` then have no film
            coordinates, and its edges are jagged; the two of ``path_integrand`` only choose the pixel.

    Raises:
        ValueError: a size that is not a positive integer, a field of view out of range, an ``antialias`` that is
            neither True nor False, or a view along ``up``.
    """
    given = dict(locals())
    for name, value in (("width", width), ("height", height)):
        positive(f"PinholeCamera {name}", value, most=1 << 15)
    if not ((is_number(fov) and 0.0 < fov < 180.0) or (shape_of(fov) == () and not is_concrete(fov))):
        raise ValueError(f"PinholeCamera fov must lie between 0 and 180 degrees, got {fov!r}")
    if not isinstance(antialias, bool):
        raise ValueError(f"PinholeCamera antialias must be True or False, got {antialias!r}")
    origin, target, up = (
        as_vec3(f"PinholeCamera {k}", v) for k, v in (("origin", origin), ("target", target), ("up", up))
    )
    forward = target - origin
    right = cross(forward, up)
    if is_concrete((forward, right)) and not dot(right, right) > 1e-12 * dot(forward, forward) * dot(up, up):
        raise ValueError(
            "PinholeCamera looks along its up direction, or origin and target coincide; change up or target"
        )
    forward = forward / dot(forward, forward) ** 0.5
    right = right / dot(right, right) ** 0.5
    tangent = math.tan(math.radians(float(fov)) / 2.0) if is_number(fov) else jnp.tan(fov * (math.pi / 360.0))
    down = cross(forward, right) * tangent
    right = right * (tangent * width / height)
    vectors: Any = [
        Vec3(*(np.asarray(c, np.float64) if is_concrete(c) else c for c in v)) for v in (origin, right, down, forward)
    ]
    camera = Camera(*vectors, int(width), int(height), antialias)
    object.__setattr__(camera, "given", given)
    return camera
