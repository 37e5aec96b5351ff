"""What a user builds scenes from: spheres, parallelograms, triangles, disks and boxes with a material and, for lights,
an emission.
"""

import dataclasses
from typing import Any

import jax
import numpy as np

from .materials import Diffuse, Material, colors_of
from .vec import Vec3

GREY = Diffuse()


@dataclasses.dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere.

    Attributes:
        center: three coordinates.
        radius: positive.
        material: ``Diffuse``, ``Mirror``, ``RoughConductor`` or ``Dielectric``.
        emission: radiance that leaves on the side of the normal: a number, an RGB triple or None.
        inward: the normal points to the centre, so a light shines inward.
        two_sided: it shines to both sides.

    Raises:
        ValueError: a value of the wrong shape or range, or one that is not finite.
    """

    center: Any
    radius: Any
    material: Any = GREY
    emission: Any = None
    inward: bool = False
    two_sided: bool = False

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
        material: ``Diffuse``, ``Mirror``, ``RoughConductor`` or ``Dielectric``.
        emission: radiance that leaves on the side of the normal: a number, an RGB triple or None.
        two_sided: it shines to both sides.

    Raises:
        ValueError: a value of the wrong shape or range, one that is not finite, or a parallelogram without area.
    """

    corner: Any
    edge_u: Any
    edge_v: Any
    material: Any = GREY
    emission: Any = None
    two_sided: bool = False

    def __post_init__(self):
        for name in ("corner", "edge_u", "edge_v"):
            _check_vector(f"Quad {name}", getattr(self, name))
        _check_surface("Quad", self.material, self.emission)
        _check_area("Quad", "edge_u", self.edge_u, "edge_v", self.edge_v)


@dataclasses.dataclass(frozen=True, eq=False)
class Triangle:
    """A triangle.

    Attributes:
        a, b, c: the corners, three coordinates each. The normal is along ``cross(b - a, c - a)``.
        material: ``Diffuse``, ``Mirror``, ``RoughConductor`` or ``Dielectric``.
        emission: radiance that leaves on the side of the normal: a number, an RGB triple or None.
        two_sided: it shines to both sides.

    Raises:
        ValueError: a value of the wrong shape or range, one that is not finite, or a triangle without area.
    """

    a: Any
    b: Any
    c: Any
    material: Any = GREY
    emission: Any = None
    two_sided: bool = False

    def __post_init__(self):
        for name in ("a", "b", "c"):
            _check_vector(f"Triangle {name}", getattr(self, name))
        _check_surface("Triangle", self.material, self.emission)
        if is_concrete((self.a, self.b, self.c)):
            a, b, c = (np.asarray(v, np.float64) for v in (self.a, self.b, self.c))
            with np.errstate(over="ignore"):
                u, v = b - a, c - a
            _check_area("Triangle", "b - a", u, "c - a", v)


@dataclasses.dataclass(frozen=True, eq=False)
class Disk:
    """A flat round disk.

    Attributes:
        center: three coordinates.
        normal: three numbers, not all 0; its length does not matter.
        radius: positive.
        material: ``Diffuse``, ``Mirror``, ``RoughConductor`` or ``Dielectric``.
        emission: radiance that leaves on the side of the normal: a number, an RGB triple or None.
        two_sided: it shines to both sides.

    Raises:
        ValueError: a value of the wrong shape or range, or one that is not finite.
    """

    center: Any
    normal: Any
    radius: Any
    material: Any = GREY
    emission: Any = None
    two_sided: bool = False

    def __post_init__(self):
        _check_vector("Disk center", self.center)
        _check_vector("Disk normal", self.normal)
        as_unit("Disk normal", self.normal)
        _check_number("Disk radius", self.radius, above=0.0)
        _check_surface("Disk", self.material, self.emission)


@dataclasses.dataclass(frozen=True, eq=False)
class Box:
    """A box of any orientation.

    Attributes:
        center: three coordinates.
        size: its three edge lengths, positive.
        axes: the directions of these edges, the rows of a rotation, shape (3, 3); by default x, y and z.
        material: ``Diffuse``, ``Mirror``, ``RoughConductor`` or ``Dielectric``.
        emission: radiance that leaves on the side of the normal: a number, an RGB triple or None.
        inward: normals point inside, so a light shines inward; by default they point outside.
        two_sided: it shines to both sides.

    Raises:
        ValueError: a value of the wrong shape or range, one that is not finite, or axes that are not at right angles
            and of unit length to 1e-6.
    """

    center: Any
    size: Any
    axes: Any = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    material: Any = GREY
    emission: Any = None
    inward: bool = False
    two_sided: bool = False

    def __post_init__(self):
        _check_vector("Box center", self.center)
        _check_vector("Box size", self.size)
        if is_concrete(self.size) and not np.all(np.asarray(self.size) > 0.0):
            raise ValueError(f"Box size must be three positive edge lengths, got {self.size!r}")
        if shape_of(self.axes) != (3, 3):
            raise ValueError(f"Box axes must be three directions, shape (3, 3), got {self.axes!r}")
        if is_concrete(self.axes):
            axes = _numbers("Box axes", self.axes)
            if not np.allclose(axes @ axes.T, np.eye(3), rtol=0.0, atol=1e-6):
                raise ValueError(
                    f"Box axes must have unit length and stand at right angles, got {self.axes!r}; "
                    "the rows of a rotation matrix do"
                )
        _check_surface("Box", self.material, self.emission)


Primitive = Sphere | Quad | Triangle | Disk | Box


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
    if is_concrete(v) and not 0.0 < sum(c * c for c in v) < np.inf:
        raise ValueError(f"{name} must not be zero, nor so long that its square is infinite, got {value!r}")
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
    # What overflows in the precision of kernels is infinite there.
    with np.errstate(over="ignore"):
        kept = color.astype(jax.dtypes.canonicalize_dtype(float))
    if not (np.isfinite(kept).all() and (signed or (color >= 0.0).all())):
        raise ValueError(f"{name} must be finite{'' if signed else ' and not negative'}, got {value!r}")
    return tuple(float(c) for c in color)


def _check_surface(name, material, emission):
    if not isinstance(material, Material):
        kinds = "mc.Diffuse(albedo), mc.Mirror(reflectance), mc.RoughConductor(...) or mc.Dielectric(ior)"
        raise ValueError(f"{name} material must be {kinds}, got {material!r}")
    for word, value in colors_of(material).items():
        color = as_color(f"{name} {word}", value)
        if is_concrete(value) and max(color) > 1.0:
            raise ValueError(f"{name} {word} must lie in [0, 1], got {value!r}: more light would leave than arrives")
    for word, least, most in material.ranges:
        value = getattr(material, word)
        _check_number(f"{name} {word}", value, above=least)
        if is_concrete(value) and value > most:
            raise ValueError(f"{name} {word} must be at most {most:g}, got {value!r}")
    if emission is not None:
        as_color(f"{name} emission", emission)


def _check_area(name, first, u, second, v):
    if not is_concrete((u, v)):
        return
    u, v = (np.asarray(e, np.float64) for e in (u, v))
    if not np.isfinite([u, v]).all():
        raise ValueError(f"{name} edges must be finite, got {first}={u.tolist()} and {second}={v.tolist()}")
    # The angle between edges does not depend on their lengths, whose squares may be beyond the range of numbers.
    along_u, along_v = (e / max(abs(e).max(), np.finfo(float).tiny) for e in (u, v))
    if not np.linalg.norm(np.cross(along_u, along_v)) > 1e-9 * np.linalg.norm(along_u) * np.linalg.norm(along_v):
        raise ValueError(
            f"{name} has no area: {first}={u.tolist()} and {second}={v.tolist()} are parallel or zero; "
            "give edges that span an area"
        )


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
