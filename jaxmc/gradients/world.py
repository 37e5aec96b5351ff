"""A scene at rest, in which paths are found, and the numbers by which it moves."""

import copy
import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..transport import geometry
from ..transport.lookups import Lookup
from ..transport.primitives import as_color
from ..transport.scene import Scene
from ..transport.vec import Vec3
from .flows import Faces, Table, attach, one_of, stacked, table, table_of_faces
from .mirrors import Mirrors


class Values(NamedTuple):
    """What a derivative can be taken by, an array over all faces in each number: where faces are, what they emit and
    how they reflect; the sky; and the place from which it is seen.
    """

    faces: Faces
    emission: Any
    reflectance: Any
    alpha: Any
    ior: Any
    metal: Any
    sky: Any
    place: Any


@partial(jax.tree_util.register_dataclass, data_fields=["values"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Material:
    """A number for each face, as ``transport.lookups.Lookup`` has it, of values that all differ."""

    values: Any
    group = None

    def at(self, face):
        return one_of(self.values, face)


class Row(NamedTuple):
    """What a face is, in motion."""

    face: Faces
    reflectance: Any


class LightRow(NamedTuple):
    """What a face that emits is, in motion."""

    face: Faces
    emission: Any


class World(NamedTuple):
    """A scene at rest with all that is known of it, its values in motion, and a scene that has these values where
    surfaces look up their materials; ``shares`` is the scene at rest with lights of radiance 1; the tables have
    ``Row`` of all faces, and ``LightRow`` and emission of those that emit, to look up those of one. ``mirrors`` are
    the plane ones.
    """

    rest: Scene
    values: Values
    moving: Scene
    shares: Scene
    rows: Table
    lights: Table
    emission: Table
    mirrors: Mirrors


def values_of(scene: Scene, place) -> Values:
    """Return the numbers of a scene, which must be as it was made."""
    primitives, _ = scene.as_given()
    given = [primitives[i].emission for i in scene.owner]
    emission = [as_color("emission", 0.0 if e is None else e) for e in given]
    return Values(
        table_of_faces(geometry.build(primitives).outlines),
        stacked([e[0] if scene.channels == 1 else Vec3(*e) for e in emission]),
        _rows(scene.reflectance),
        _rows(scene.alpha),
        _rows(scene.ior),
        _rows(scene.metal),
        scene.sky,
        place,
    )


def _rows(lookups):
    """Return tables of a scene with one entry for each face."""

    def rows(table):
        return table.values if table.group is None else stacked([table.values[i] for i in table.group])

    return jax.tree.map(rows, lookups, is_leaf=lambda x: isinstance(x, Lookup))


def world(rest: Scene, at_rest: Values, values: Values, mirrors: Mirrors) -> World:
    """Return the world whose values are those at rest, and whose derivatives are those of ``values``."""
    values = attach(jax.tree.map(lambda x: jnp.asarray(x, float), at_rest), values)
    moving, shares = copy.copy(rest), copy.copy(rest)
    if rest.rough:
        moving.alpha = Material(values.alpha)
    if rest.dielectrics:
        moving.ior = Material(values.ior)
    if rest.metals:
        moving.metal = jax.tree.map(Material, values.metal)
    one = jnp.ones(())
    if isinstance(rest.powers, tuple):
        shares.emitters = tuple((light, one) for light, _ in rest.emitters)
    else:
        shares.emitters = tuple(
            group._replace(radiance=jnp.ones_like(jax.tree.leaves(group.radiance)[0])) for group in rest.emitters
        )
    shares.channels = 1
    rows = table(Row(values.faces, values.reflectance))
    if not rest.lights:
        return World(rest, values, moving, shares, rows, None, None, mirrors)
    lights = table(LightRow(values.faces, values.emission), rest.lights)
    return World(rest, values, moving, shares, rows, lights, table(values.emission, rest.lights), mirrors)
