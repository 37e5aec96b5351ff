"""Scenes: primitives as tables of numbers, and the static facts that decide what a kernel contains.

What is known when a scene is built is decided then: which shapes, materials and lights there are, one colour channel or
three, which components of a plane are zero, which faces share a value, and which can cast a shadow at all. So what a
scene lacks costs nothing. Values are leaves of a pytree: the same facts with other values run the same kernel.

While JAX traces (a scene built inside a function under ``jax.grad``) values are unknown; the kernel assumes nothing.
"""

from collections import Counter
from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from . import facts, geometry, lights
from .lookups import lookup, lookups
from .materials import Dielectric, Mirror, RoughConductor, colors_of
from .primitives import Primitive, as_color, is_concrete
from .sky import GradientSky, table_of_sky
from .vec import Vec3

LEAST_ROUGHNESS = 1e-3
KINDS = "mc.Sphere, mc.Quad, mc.Triangle, mc.Disk and mc.Box"


@jax.tree_util.register_pytree_node_class
class Scene:
    """Primitives and a sky.

    A scene is made of faces: a box has six, every other primitive has one. Faces are numbered in the order of the
    primitives; without boxes these are the numbers of the primitives.

    Args:
        primitives: ``Sphere``, ``Quad``, ``Triangle``, ``Disk`` and ``Box`` objects. Those with an emission above 0 are
            lights.
        sky: radiance that arrives from outside, the same from everywhere: a number, an RGB triple or None for black; or
            a ``GradientSky``.

    Attributes:
        given: the primitives and the sky as they came; not part of the pytree, so a scene that went through a
            transformation of JAX has none.
        channels: 1 where every colour is known to be grey, else 3.
        owner: for each face the number of its primitive.
        lights: the face of each light; a sphere that shines to both sides is two lights.
        mirrors, rough, dielectrics: the faces of these materials; all others are diffuse.
        metals: the rough faces that reflect by Fresnel's equations.
        casters: the faces that can cast a shadow between two points of the scene. A flat one with the whole scene on
            one side of its plane cannot.
        empty: the spheres with no part of the scene inside.
        twins: for each face the others on the same plane or sphere.
        tight: whether two planes lie so close together that hits must be exactly on their own.
        middle: the point that the kernel's coordinates are relative to, shape (3,): 0 where the scene lies around it.
        blur: the amount of a ``Regularize``, put here by the integrands that have one; None: all is as sharp as it is.
        reach: the scene lies within this distance from ``middle``; infinite where that is not known.

    Facts hold for the values that the scene was built with: to move things, build a new scene.

    Raises:
        ValueError: something else in the list, a sky that is no radiance, or lengths and radiances outside the range of
            the kernel's numbers.
    """

    _data = (
        "shapes", "tables", "normal", "anchor", "inverse_radius", "inset", "reflectance", "alpha", "metal", "ior",
        "emitters", "powers", "sky", "present", "middle", "reach", "blur",
    )  # fmt: skip
    _static = (
        "channels", "owner", "first", "lights", "mirrors", "rough", "metals", "dielectrics", "casters", "empty",
        "twins", "tight",
    )  # fmt: skip

    def __init__(self, primitives, sky=None):
        primitives = _checked(primitives)
        self.given = tuple(primitives), sky
        if not isinstance(sky, GradientSky | None):
            sky = as_color("sky", sky)
        radiances = [as_color("emission", 0.0 if p.emission is None else p.emission) for p in primitives]
        facts.check_range(primitives)
        facts.check_radiances("emission", radiances)
        facts.check_radiances("sky", _colors_of(sky))
        place = geometry.build(primitives)
        for name in ("owner", "first", "twins", "casters", "empty", "tight", "middle"):
            setattr(self, name, getattr(place, name))
        for name in ("shapes", "tables", "normal", "anchor", "inverse_radius", "inset", "reach"):
            setattr(self, name, _numbers(getattr(place, name)))

        materials = [primitives[i].material for i in self.owner]
        colors = [as_color("reflectance", next(iter(colors_of(m).values()), 1.0)) for m in materials]
        metal = [(as_color("eta", m.eta), as_color("k", m.k)) if _is_metal(m) else None for m in materials]
        everything = [*colors, *radiances, *_colors_of(sky), *(c for pair in metal if pair for c in pair)]
        self.channels = 1 if all(map(_is_grey, everything)) else 3
        self._paint(materials, colors, metal)
        shining = [
            lights.Shining(i, primitives[p], place.outlines[i], radiances[p], self._color(radiances[p]))
            for i, p in enumerate(self.owner)
            if not (is_concrete(radiances[p]) and max(radiances[p]) == 0.0)
        ]
        self.lights, emitters, powers = lights.emitters(shining)
        self.emitters, self.powers = _numbers(emitters), _numbers(powers)
        self.sky = _numbers(table_of_sky(sky, self._color))
        self.blur = None
        self.present = _number(1.0)  # a 1 that the compiler does not know, see paths.apart

    def _paint(self, materials, colors, metal):
        """Set what is known of the materials of the faces."""

        def faces(kind):
            return tuple(i for i, m in enumerate(materials) if isinstance(m, kind))

        self.mirrors, self.rough, self.dielectrics = faces(Mirror), faces(RoughConductor), faces(Dielectric)
        self.metals = tuple(i for i, pair in enumerate(metal) if pair)
        self.reflectance = _numbers(lookups([self._color(c) for c in colors]))
        roughness = [m.roughness if isinstance(m, RoughConductor) else 1.0 for m in materials]
        least = [max(r, LEAST_ROUGHNESS) if is_concrete(r) else jnp.maximum(r, LEAST_ROUGHNESS) for r in roughness]
        self.alpha = _numbers(lookup(least)) if self.rough else None
        one = ((1.0,) * 3, (0.0,) * 3)
        pairs = [tuple(map(self._color, pair or one)) for pair in metal]
        self.metal = _numbers(tuple(map(lookups, zip(*pairs)))) if self.metals else None
        ior = [m.ior if isinstance(m, Dielectric) else 1.0 for m in materials]
        self.ior = _numbers(lookup(ior)) if self.dielectrics else None

    def _color(self, rgb):
        return rgb[0] if self.channels == 1 else Vec3(*rgb)

    @property
    def size(self) -> int:
        """Number of faces."""
        return len(self.owner)

    def is_same(self, own, face: int):
        """Return whether face ``own`` is ``face`` or lies on the same plane or sphere."""
        same = own == face
        for twin in self.twins[face]:
            same = same | (own == twin)
        return same

    def primitive_of(self, face):
        """Return the number of the primitive that a face belongs to, -1 for none."""
        if self.owner == tuple(range(self.size)):
            return face
        return jnp.where(face < 0, -1, jnp.asarray(self.owner).at[face].get(mode="clip"))

    def plane_of(self, face):
        """Return the number of the plane or sphere on which a face lies: that of the first face there."""
        planes = [min(i, *twins) if twins else i for i, twins in enumerate(self.twins)]
        if planes == list(range(self.size)):
            return face
        return jnp.where(face < 0, -1, jnp.asarray(planes).at[face].get(mode="fill", fill_value=self.size))

    def local(self, point):
        """Return a point, a ``Vec3`` or an array of shape (..., 3), in the coordinates of the kernel."""
        if is_concrete(self.middle) and not np.any(self.middle):
            return point
        if not isinstance(point, Vec3):
            return (np.asarray(point, np.float64) if is_concrete(point) else point) - self.middle
        # Subtract in float64 what is known, before the kernel's numbers round it.
        return Vec3(*((np.asarray(c, np.float64) if is_concrete(c) else c) - m for c, m in zip(point, self.middle)))

    def to_dict(self) -> dict:
        """Return the scene as plain data: lists, numbers and strings, as JSON has them; ``scene_files`` says how.

        Every number is exact, as float64: ``Scene.from_dict`` makes the same scene of it, bit for bit. Only that
        coordinates came in float32, and so are rounded, is forgotten.

        Raises:
            ValueError: a scene that went through a transformation of JAX, or values that JAX traces.
        """
        from .scene_files import scene_to_dict

        return scene_to_dict(self)

    @classmethod
    def from_dict(cls, data) -> "Scene":
        """Return the scene that ``to_dict`` wrote; a camera in the data is checked and left out.

        Raises:
            ValueError: data that are no scene; the message names the place in them.
        """
        from .scene_files import scene_from_dict

        return scene_from_dict(data)[0]

    def to_mitsuba(self, camera=None, *, spp=16, bounces=5) -> dict:
        """Return the scene as a dictionary for ``mitsuba.load_dict``; Mitsuba 3 must be installed, its variant set.

        Paths are those of ``render``: as many bounces, no Russian roulette, a box filter. With a camera there is a
        sensor that takes ``spp`` samples for each pixel. Mitsuba masks rough conductors without correlation of heights,
        so they are darker there, by a few percent where they are rough. Triangles are meshes of their own.

        Raises:
            ImportError: Mitsuba is missing.
            ValueError: no variant is set; or what Mitsuba cannot have: a ``GradientSky``, a light that is two_sided, a
                camera without anti-aliasing.
        """
        from .mitsuba_objects import with_objects
        from .mitsuba_scenes import describe

        found = describe(self, camera, spp, bounces)
        try:
            import mitsuba  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ImportError("scene.to_mitsuba() needs Mitsuba 3: pip install mitsuba") from error
        if mitsuba.variant() is None:
            raise ValueError('Mitsuba has no variant yet: call mitsuba.set_variant("llvm_ad_rgb") or another RGB one')
        return with_objects(mitsuba, found)

    def as_given(self) -> tuple:
        """Return the primitives and the sky as they came, or raise ``ValueError`` where they are no longer known."""
        if getattr(self, "given", None) is None:
            raise ValueError(
                "this scene went through a transformation of JAX and no longer knows its primitives; "
                "take the one that mc.Scene([...]) returned"
            )
        return self.given

    def tree_flatten(self):
        return [getattr(self, k) for k in self._data], tuple(getattr(self, k) for k in self._static)

    @classmethod
    def tree_unflatten(cls, static, data):
        scene = object.__new__(cls)
        scene.__dict__.update(zip(cls._data, data), **dict(zip(cls._static, static)))
        return scene

    def __repr__(self):
        kinds = Counter(type(shape).__name__.removesuffix("Shape").lower() for shape in self.shapes)
        for table in self.tables:
            kinds[type(table.shape).__name__.removesuffix("Shape").lower()] += len(table.first)
        materials = {name: len(getattr(self, name)) for name in ("mirrors", "rough", "dielectrics")}
        return f"Scene({dict(kinds)}, lights={len(self.lights)}, {materials}, channels={self.channels})"


def _checked(primitives) -> list[Primitive]:
    if not isinstance(primitives, Iterable):
        raise ValueError(f"a scene is made of a list of {KINDS}, got {primitives!r}")
    primitives = list(primitives)
    for p in primitives:
        if not isinstance(p, Primitive):
            raise ValueError(f"a scene is made of {KINDS} objects, got {p!r}")
    return primitives


def _is_grey(rgb):
    # One traced number for all channels is grey too, so tracing a grey scene changes no shape.
    return rgb[0] is rgb[1] is rgb[2] or (is_concrete(rgb) and rgb[0] == rgb[1] == rgb[2])


def _is_metal(material):
    return isinstance(material, RoughConductor) and material.eta is not None


def _colors_of(sky):
    return sky.colors() if isinstance(sky, GradientSky) else [] if sky is None else [sky]


def _number(x):
    return jnp.asarray(x, float) if not is_concrete(x) else np.asarray(x, jnp.result_type(float))


_numbers = partial(jax.tree.map, _number)
