"""A scene at rest, in which paths are found, and the numbers by which it moves."""

import copy
import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..transport import geometry
from ..transport.lookups import Lookup
from ..transport.primitives import as_color
from ..transport.scene import Scene
from ..transport.vec import Vec3
from .flows import Faces, attach, one_of, stacked, table_of_faces


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


@dataclasses.dataclass(frozen=True)
class Row:
    """A number for each face, as ``transport.lookups.Lookup`` has it, of values that all differ."""

    values: Any
    group = None

    def at(self, face):
        return one_of(self.values, face)


class World(NamedTuple):
    """A scene at rest with all that is known of it, its values in motion, and a scene that has these values where
    surfaces look up their materials; ``shares`` is the scene at rest with lights of radiance 1.
    """

    rest: Scene
    values: Values
    moving: Scene
    shares: Scene


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


def world(rest: Scene, at_rest: Values, values: Values) -> World:
    """Return the world whose values are those at rest, and whose derivatives are those of ``values``."""
    values = attach(jax.tree.map(lambda x: jnp.asarray(x, float), at_rest), values)
    moving, shares = copy.copy(rest), copy.copy(rest)
    if rest.rough:
        moving.alpha = Row(values.alpha)
    if rest.dielectrics:
        moving.ior = Row(values.ior)
    if rest.metals:
        moving.metal = jax.tree.map(Row, values.metal)
    one = jnp.ones(())
    if isinstance(rest.powers, tuple):
        shares.emitters = tuple((light, one) for light, _ in rest.emitters)
    else:
        shares.emitters = tuple(
            group._replace(radiance=jnp.ones_like(jax.tree.leaves(group.radiance)[0])) for group in rest.emitters
        )
    shares.channels = 1
    return World(rest, values, moving, shares)
