"""What a user builds scenes from: spheres and parallelograms with a material and, for lights, an emission."""

import dataclasses
from typing import Any

import jax
import numpy as np

from .materials import Diffuse, Mirror
from .vec import Vec3

GREY = Diffuse()


@dataclasses.dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere.

    Attributes:
        center: three coordinates.
        radius: positive.
        material: ``Diffuse`` or ``Mirror``.
        emission: radiance that leaves on the side of the normal, none on the back: a number, an RGB triple or None.
        inward: the normal points to the centre, so a light shines inward.

    Raises:
        ValueError: a value of the wrong shape or range, or one that is not finite.
    """

    center: Any
    radius: Any
    material: Any = GREY
    emission: Any = None
    inward: bool = False

    def __post_init__(self):
        _check_vector("Sphere center", self.center)
        _check_number("Sphere radius", self.radius, above=0.0)
        _check_surface("Sphere", self.material, self.emission)


@dataclasses.dataclass(frozen=True, eq=False)
class Quad:
    """A parallelogram: ``corner``, ``corner + edge_u``, ``corner + edge_v`` and the fourth corner.

    Attributes:
        corner: three coordinates.
        edge_u: from the corner to its neighbour.
        edge_v: from the corner to its other neighbour. The normal is along ``cross(edge_u, edge_v)``.
        material: ``Diffuse`` or ``Mirror``.
        emission: radiance that leaves on the side of the normal, none on the back: a number, an RGB triple or None.

    Raises:
        ValueError: a value of the wrong shape or range, one that is not finite, or a parallelogram without area.
    """

    corner: Any
    edge_u: Any
    edge_v: Any
    material: Any = GREY
    emission: Any = None

    def __post_init__(self):
        for name in ("corner", "edge_u", "edge_v"):
            _check_vector(f"Quad {name}", getattr(self, name))
        _check_surface("Quad", self.material, self.emission)
        if is_concrete((self.edge_u, self.edge_v)):
            u, v = (np.asarray(e, np.float64) for e in (self.edge_u, self.edge_v))
            if not np.linalg.norm(np.cross(u, v)) > 1e-9 * np.linalg.norm(u) * np.linalg.norm(v):
                raise ValueError(
                    f"Quad has no area: edge_u={u.tolist()} and edge_v={v.tolist()} are parallel or zero; "
                    "give two edges that span a parallelogram"
                )


def is_concrete(tree) -> bool:
    """Return whether values are known, so that facts can be drawn from them: not while JAX differentiates or traces."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def is_number(value) -> bool:
    """Return whether ``value`` is one known real number."""
    return shape_of(value) == () and is_concrete(value) and np.asarray(value).dtype.kind in "iuf"


def shape_of(value):
    """Return the shape of an array, or of a list in which there may be traced numbers; None where rows differ."""
    if not isinstance(value, list | tuple):
        return np.shape(value)
    shapes = {shape_of(v) for v in value}
    return (len(value), *shapes.pop()) if len(shapes) == 1 and None not in shapes else None


def as_vec3(name: str, value) -> Vec3:
    """Return three numbers as a ``Vec3``, or raise ``ValueError``."""
    _check_vector(name, value)
    return Vec3(*(value[k] if not is_concrete(value) else float(np.asarray(value)[k]) for k in range(3)))


def as_unit(name: str, value) -> Vec3:
    """Return three numbers as a ``Vec3`` of unit length, or raise ``ValueError``."""
    v = as_vec3(name, value)
    if is_concrete(v) and not sum(c * c for c in v) > 0.0:
        raise ValueError(f"{name} must not be zero, got {value!r}")
    length = (v.x * v.x + v.y * v.y + v.z * v.z) ** 0.5
    return v / length


def as_color(name: str, value, signed: bool = False) -> tuple:
    """Return a radiance or reflectance as (r, g, b), or raise ``ValueError`` naming ``name``; ``signed``: any sign."""
    shape = shape_of(value)
    if shape not in ((), (3,)):
        raise ValueError(f"{name} must be a number or an RGB triple, got {value!r}")
    if not is_concrete(value):
        return (value,) * 3 if shape == () else tuple(value[k] for k in range(3))
    color = np.broadcast_to(_numbers(name, value), 3)
    if not (np.isfinite(color).all() and (signed or (color >= 0.0).all())):
        raise ValueError(f"{name} must be finite{'' if signed else ' and not negative'}, got {value!r}")
    return tuple(float(c) for c in color)


def _check_surface(name, material, emission):
    if not isinstance(material, Diffuse | Mirror):
        raise ValueError(f"{name} material must be mc.Diffuse(albedo) or mc.Mirror(reflectance), got {material!r}")
    word, value = reflectance_of(material)
    color = as_color(f"{name} {word}", value)
    if is_concrete(value) and max(color) > 1.0:
        raise ValueError(f"{name} {word} must lie in [0, 1], got {value!r}: more light would leave than arrives")
    if emission is not None:
        as_color(f"{name} emission", emission)


def reflectance_of(material):
    """Return the name and the value of the fraction of light that a material reflects."""
    return ("albedo", material.albedo) if isinstance(material, Diffuse) else ("reflectance", material.reflectance)


def _check_vector(name, value):
    if shape_of(value) != (3,):
        raise ValueError(f"{name} must be three numbers (x, y, z), got {value!r}")
    if is_concrete(value) and not np.isfinite(_numbers(name, value)).all():
        raise ValueError(f"{name} must be finite, got {value!r}")


def _check_number(name, value, above):
    if shape_of(value) != () or (is_concrete(value) and not is_number(value)):
        raise ValueError(f"{name} must be one number, got {value!r}")
    if is_concrete(value) and not (np.isfinite(value) and value > above):
        raise ValueError(f"{name} must be finite and greater than {above:g}, got {value!r}")


def _numbers(name, value):
    try:
        if np.asarray(value).dtype.kind == "U":
            raise TypeError("text, not numbers")
        return np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be made of numbers, got {value!r}") from error
