"""Vectors of three scalars.

Per-ray code works on scalars and is made wide by ``jax.vmap``: each component becomes one contiguous array, which XLA
turns into full-width vector code. The same code on arrays of shape ``(3,)`` is some 50 times slower on a CPU.
Keep the vector on the left of a product: ``v * s``, not ``s * v``.
"""

from typing import NamedTuple

import jax.numpy as jnp


class Vec3(NamedTuple):
    """Three scalars (or three arrays of one shape): a point, a direction or a colour."""

    x: object
    y: object
    z: object

    def __add__(self, other):
        return Vec3(*(a + b for a, b in zip(self, _components(other))))

    def __sub__(self, other):
        return Vec3(*(a - b for a, b in zip(self, _components(other))))

    def __mul__(self, other):
        return Vec3(*(a * b for a, b in zip(self, _components(other))))

    def __truediv__(self, other):
        return self * (1.0 / other)

    def __neg__(self):
        return Vec3(-self.x, -self.y, -self.z)


def _components(other):
    return other if isinstance(other, Vec3) else (other, other, other)


def dot(a, b):
    """Return the scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a, b):
    """Return the vector product."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def normalize(a):
    """Return the unit vector along ``a``."""
    return a * jnp.sqrt(1.0 / dot(a, a))


def where(condition, a, b):
    """Choose ``a`` or ``b`` component by component."""
    if isinstance(a, Vec3):
        return Vec3(*(jnp.where(condition, p, q) for p, q in zip(a, _components(b))))
    return jnp.where(condition, a, b)


def smaller(a, b):
    """Return the smaller of two numbers; b where one is NaN, which makes it one instruction, not four as in NumPy."""
    return jnp.where(a < b, a, b)


def larger(a, b):
    """Return the larger of two numbers; b where one is NaN, see ``smaller``."""
    return jnp.where(a > b, a, b)


def frame(n, sign=None):
    """Return two unit tangents that make a right-handed frame with the unit normal ``n``; ``sign`` is that of n.z, 1 or
    -1, where it is known: then all is plain arithmetic, in float64 for Python's numbers.

    Source: Duff et al. 2017, "Building an Orthonormal Basis, Revisited" (no branch, no singular direction).
    """
    sign = jnp.where(n.z < 0.0, -1.0, 1.0) if sign is None else sign
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    return Vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3(b, sign + n.y * n.y * a, -n.y)
