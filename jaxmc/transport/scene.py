"""Scenes: primitives as tables of numbers, and the static facts that decide what a kernel contains.

What is known when a scene is built is decided then: which shapes, materials and lights there are, one colour channel or
three, which components of a plane are zero, which primitives share a value, and which can cast a shadow at all. So what
a scene lacks costs nothing. Values are leaves of a pytree: the same facts with other values run the same kernel.

While JAX traces (a scene built inside a function under ``jax.grad``) values are unknown; the kernel assumes nothing.
"""

import dataclasses
from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from . import facts
from .materials import Mirror
from .primitives import Quad, Sphere, as_color, as_vec3, is_concrete, reflectance_of
from .shapes import QuadLight, QuadShape, SphereLight, SphereShape
from .sky import GradientSky, table_of_sky
from .vec import Vec3, cross, dot

SELECT_LIMIT = 24  # look a value up by comparing below this many primitives, by gathering above


@partial(jax.tree_util.register_dataclass, data_fields=["values"], meta_fields=["group"])
@dataclasses.dataclass(frozen=True)
class Lookup:
    """A value for each primitive; primitive i has ``values[group[i]]``, so equal values are looked up once."""

    values: tuple
    group: tuple[int, ...]

    def at(self, index):
        """Return the value of primitive ``index``; any value where there is no such primitive."""
        if len(self.values) == 1:
            return self.values[0]
        if len(self.group) > SELECT_LIMIT:
            table = jnp.stack([jnp.asarray(v) for v in self.values])
            return table[jnp.asarray(self.group)].at[index].get(mode="clip")
        # Start from the commonest value.
        common = max(set(self.group), key=self.group.count)
        value = self.values[common]
        for i, g in enumerate(self.group):
            if g != common:
                value = jnp.where(index == i, self.values[g], value)
        return value


def lookup(values) -> Lookup:
    """Return the table of one number for each primitive."""
    values = list(values) or [0.0]  # an empty scene has tables too
    if not is_concrete(values):
        return Lookup(tuple(values), tuple(range(len(values))))
    # Compare as the kernel will: rounding must not decide what a kernel contains.
    values = np.asarray(values, jnp.result_type(float)).tolist()
    distinct = list(dict.fromkeys(values))
    return Lookup(tuple(distinct), tuple(distinct.index(v) for v in values))


@jax.tree_util.register_pytree_node_class
class Scene:
    """Primitives and a sky.

    Args:
        primitives: ``Sphere`` and ``Quad`` objects. Those with an emission above 0 are lights.
        sky: radiance that arrives from outside, the same from everywhere: a number, an RGB triple or None for black; or
            a ``GradientSky``.

    Attributes:
        channels: 1 where every colour is grey, else 3.
        lights: numbers of the primitives that shine.
        mirrors: numbers of the primitives that are mirrors.
        casters: numbers of the primitives that can cast a shadow between two points of the scene. A quad with the
            whole scene on one side of its plane cannot.
        empty: numbers of the spheres with no part of the scene inside.
        twins: for each primitive the others on the same plane or sphere.
        tight: whether two planes lie so close together that hits must be exactly on their own.
        middle: the point that the kernel's coordinates are relative to, shape (3,): 0 where the scene lies around it.
        reach: the scene lies within this distance from ``middle``; infinite where that is not known.

    Facts hold for the values that the scene was built with: to move things, build a new scene.

    Raises:
        ValueError: something else in the list, a sky that is no radiance, or lengths and radiances outside the range of
            the kernel's numbers.
    """

    _data = (
        "quads",
        "spheres",
        "normal",
        "anchor",
        "inverse_radius",
        "inset",
        "reflectance",
        "emitters",
        "sky",
        "present",
        "middle",
        "reach",
    )
    _static = ("channels", "shapes", "lights", "mirrors", "casters", "empty", "twins", "tight")

    def __init__(self, primitives, sky=None):
        if not isinstance(primitives, Iterable):
            raise ValueError(f"a scene is made of a list of mc.Sphere and mc.Quad objects, got {primitives!r}")
        primitives = list(primitives)
        for p in primitives:
            if not isinstance(p, Sphere | Quad):
                raise ValueError(f"a scene is made of mc.Sphere and mc.Quad objects, got {p!r}")
        number = partial(jax.tree.map, _number)
        colors = [as_color("reflectance", reflectance_of(p.material)[1]) for p in primitives]
        radiances = [as_color("emission", 0.0 if p.emission is None else p.emission) for p in primitives]
        if not isinstance(sky, GradientSky | None):
            sky = as_color("sky", sky)
        everything = [*colors, *radiances, *_colors_of(sky)]
        self.channels = 1 if all(is_concrete(c) and c[0] == c[1] == c[2] for c in everything) else 3
        self.shapes = tuple("quad" if isinstance(p, Quad) else "sphere" for p in primitives)
        self.lights = tuple(i for i, c in enumerate(radiances) if not (is_concrete(c) and max(c) == 0.0))
        self.mirrors = tuple(i for i, p in enumerate(primitives) if isinstance(p.material, Mirror))
        facts.check_range(primitives)
        facts.check_radiances("emission", radiances)
        facts.check_radiances("sky", _colors_of(sky))
        layout = facts.layout(primitives)
        self.middle, self.reach = layout.middle.astype(jnp.result_type(float)), number(layout.reach)
        if layout.middle.any():
            primitives = [facts.moved(p, -layout.middle) for p in primitives]
        frames = [_quad_frame(p) if isinstance(p, Quad) else None for p in primitives]
        touch = facts.touch(primitives, [f and f.normal for f in frames], layout)
        self.casters, self.empty, self.twins, self.tight = touch.casters, touch.empty, touch.twins, touch.tight

        # Quads that touch each other overlap by rounding, so that no ray slips between them. The edges of a large one
        # are far away.
        alone = [free or i in layout.large for i, free in enumerate(touch.free)]
        rounding = [0.0 if free else _rounding(f, layout.grain) for f, free in zip(frames, alone)]
        planes = [frames[min(i, *twins)] if twins else frames[i] for i, twins in enumerate(self.twins)]
        shape = [
            _quad_shape(f, planes[i], rounding[i]) if f else _sphere_shape(primitives[i], i in layout.large)
            for i, f in enumerate(frames)
        ]
        self.quads = tuple(number(s) if isinstance(s, QuadShape) else None for s in shape)
        self.spheres = tuple(number(s) if isinstance(s, SphereShape) else None for s in shape)
        nowhere = Vec3(0.0, 0.0, 0.0)
        flat = [f.normal if f else nowhere for f in frames] or [nowhere]
        center = [f.center if f else s.center for f, s in zip(frames, shape)] or [nowhere]
        self.normal = number(_lookups(flat))
        self.anchor = number(_lookups(center))
        curvature = [0.0 if f else _sign(p) / p.radius for p, f in zip(primitives, frames, strict=True)]
        self.inverse_radius = number(lookup(curvature)) if "sphere" in self.shapes else None
        self.inset = number(lookup([2.0 * r for r in rounding]))
        self.reflectance = number(_lookups([self._color(c) for c in colors]))
        lights = [frames[i] or SphereLight(shape[i], primitives[i].inward) for i in self.lights]
        self.emitters = number([(light, self._color(radiances[i])) for i, light in zip(self.lights, lights)])
        self.sky = number(table_of_sky(sky, self._color))

        self.present = number(1.0)  # a 1 that the compiler does not know, see paths.apart

    def _color(self, rgb):
        return rgb[0] if self.channels == 1 else Vec3(*rgb)

    @property
    def size(self) -> int:
        """Number of primitives."""
        return len(self.shapes)

    def local(self, point):
        """Return a point, a ``Vec3`` or an array of shape (..., 3), in the coordinates of the kernel."""
        if is_concrete(self.middle) and not np.any(self.middle):
            return point
        if not isinstance(point, Vec3):
            return (np.asarray(point, np.float64) if is_concrete(point) else point) - self.middle
        # Subtract in float64 what is known, before the kernel's numbers round it.
        return Vec3(*((np.asarray(c, np.float64) if is_concrete(c) else c) - m for c, m in zip(point, self.middle)))

    def tree_flatten(self):
        return [getattr(self, k) for k in self._data], tuple(getattr(self, k) for k in self._static)

    @classmethod
    def tree_unflatten(cls, static, data):
        scene = object.__new__(cls)
        scene.__dict__.update(zip(cls._data, data), **dict(zip(cls._static, static)))
        return scene

    def __repr__(self):
        count = {kind: self.shapes.count(kind) for kind in ("quad", "sphere")}
        return f"Scene({count}, lights={self.lights}, mirrors={self.mirrors}, channels={self.channels})"


def _colors_of(sky):
    return sky.colors() if isinstance(sky, GradientSky) else [] if sky is None else [sky]


def _number(x):
    return jnp.asarray(x, float) if not is_concrete(x) else np.asarray(x, jnp.result_type(float))


def _lookups(vectors):
    if not isinstance(vectors[0] if vectors else 0.0, Vec3):
        return lookup(vectors)
    return Vec3(*(lookup([v[k] for v in vectors]) for k in range(3)))


def _sign(sphere):
    return -1.0 if sphere.inward else 1.0


def _quad_frame(quad: Quad) -> QuadLight:
    corner = as_vec3("corner", quad.corner)
    half_u, half_v = as_vec3("edge_u", quad.edge_u) * 0.5, as_vec3("edge_v", quad.edge_v) * 0.5
    n = cross(half_u, half_v)
    length = dot(n, n) ** 0.5
    return QuadLight(corner + half_u + half_v, half_u, half_v, n / length, 4.0 * length)


def _quad_shape(frame: QuadLight, plane: QuadLight, rounding) -> QuadShape:
    """Return a parallelogram; twins share the numbers of one ``plane``, so that none is in front of another."""
    row_u, row_v = cross(frame.half_v, frame.normal), cross(frame.normal, frame.half_u)
    row_u, row_v = row_u / dot(row_u, frame.half_u), row_v / dot(row_v, frame.half_v)
    normal, offset = _without_zeros(plane.normal), dot(plane.normal, plane.center)
    present = [k for k in range(3) if normal[k] is not None]
    axis = present[0] if len(present) == 1 else None
    if axis is not None:
        normal, offset = None, plane.center[axis]
    rows = [(_without_zeros(r), _none_if_zero(dot(r, frame.center))) for r in (row_u, row_v)]
    return QuadShape(normal, offset, *rows[0], *rows[1], 1.0 + rounding, axis)


def _none_if_zero(x):
    return None if is_concrete(x) and x == 0.0 else x


def _without_zeros(v):
    return Vec3(*map(_none_if_zero, v))


def _sphere_shape(sphere: Sphere, large) -> SphereShape:
    radius = float(sphere.radius) if is_concrete(sphere.radius) else sphere.radius
    center = as_vec3("center", sphere.center)
    return SphereShape(center, radius, dot(center, center) - radius * radius if large else None)


def _rounding(frame, grain):
    """Return the rounding error of a hit in a quad's own coordinates, which run from -1 to 1; 0 for a sphere."""
    if frame is None:
        return 0.0
    shorter = jnp.minimum if not is_concrete(frame) else min
    half = shorter(dot(frame.half_u, frame.half_u) ** 0.5, dot(frame.half_v, frame.half_v) ** 0.5)
    return 4.0 * (float(jnp.finfo(jnp.result_type(float)).eps) + grain / half)
