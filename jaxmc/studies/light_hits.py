"""How much of the noise of a naive path tracer is the chance of meeting a light at all."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion

from ..transport.intersection import intersect
from ..transport.materials import luminance


def facts(terms):
    """Return what the study keeps of a path, from its radiance by number of events, shape (..., bounces + 1, 3).

    ``image`` is its radiance, ``luminance`` that of all; ``direct`` is the luminance after one event and ``hit``
    whether that is light; ``meets`` whether any event led to light.
    """
    y = luminance(terms)
    after = y[..., 1:] > 0.0
    return {
        "image": terms.sum(-2),
        "luminance": y.sum(-1),
        "direct": y[..., 1],
        "hit": after[..., 0].astype(y.dtype),
        "meets": after.any(-1).astype(y.dtype),
    }


class Part(NamedTuple):
    """Direct light from one light, for each pixel: the ``probability`` that a ray from the surface meets it, measured
    by ``n`` naive samples, and its ``mean``, with the variance of that mean.
    """

    probability: np.ndarray
    n: int
    mean: np.ndarray
    mean_variance: np.ndarray

    def without(self, other) -> "Part":
        """Return what the other lights give, if this is all light and ``other`` one light."""
        noise = self.mean_variance + other.mean_variance
        rest = np.maximum(self.probability - other.probability, 0.0)
        return Part(rest, self.n, self.mean - other.mean, noise)


def variance_from_hits(parts) -> np.ndarray:
    """Return the variance of a naive sample of direct light that follows from which light its ray meets, if any.

    Light i is met with probability p_i, and then worth v_i = L_i / p_i on average: the sum of p_i v_i^2, less the
    square of the sum of p_i v_i. Of one light this is v^2 p (1 - p). By the law of total variance the rest is where a
    light is met. The estimate of L^2 / p is unbiased where n p is well above 1, and too small elsewhere.
    """
    mean, noise = sum(part.mean for part in parts), sum(part.mean_variance for part in parts)
    # (n + 1) / (hits + 1) has the expectation (1 - (1 - p)^(n + 1)) / p.
    inverses = [(part.n + 1.0) / (part.n * part.probability + 1.0) for part in parts]
    squares = [(part.mean**2 - part.mean_variance) * inverse for part, inverse in zip(parts, inverses)]
    return sum(squares) - (mean**2 - noise)


def reflects(scene, camera) -> np.ndarray:
    """Return in which pixels, shape (height, width), the camera sees a surface that is no light, even next to them."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    s, t = 2.0 * x.ravel() / camera.width - 1.0, 2.0 * y.ravel() / camera.height - 1.0
    directions = camera.forward + camera.right * s + camera.down * t
    origins = np.broadcast_to(np.array(camera.origin), (s.size, 3))
    primitive = np.asarray(intersect(scene, origins, np.stack(directions, -1)).primitive)
    shining = [p.emission is not None for p in scene.given[0]]
    dull = np.where(primitive >= 0, ~np.take(shining, np.maximum(primitive, 0)), False)
    return binary_erosion(dull.reshape(y.shape), np.ones((3, 3)), border_value=1)


def blocks_of(values, mask, size=8):
    """Return the means of ``values`` over those blocks of ``size`` x ``size`` pixels that lie within the mask."""
    height, width = (n // size * size for n in values.shape)

    def mean(x):
        return x[:height, :width].reshape(height // size, size, width // size, size).mean((1, 3))

    return mean(values)[mean(mask.astype(float)) == 1.0]
