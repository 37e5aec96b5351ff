"""Scenes of light that arrives at one point: a receiver at the origin that is no part of the scene.

It faces +z unless a scene says otherwise. Lights and blockers are black, so nothing else reflects. A view shows what
stands around, with a small plate where the receiver is.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

import jaxmc as mc
from analytic_scenes import laws
from analytic_scenes.scene import AnalyticScene, closed_form_scene

UP = (0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)
BLACK = mc.Diffuse(0.0)
SPHERE_SOURCE = "Snyder (1996); Lagarde and de Rousiers, Moving Frostbite to PBR (2014), section 4.7"
POLYGON_SOURCE = "Lambert, Photometria (1760), clipped at the horizon"


def receiver_scene(
    name: str,
    formula: Callable,
    arguments: Mapping,
    primitives,
    source: str,
    *,
    geometry: str,
    law: Callable[[float], laws.Law | None],
    strategy: Mapping,
    constants: Mapping | None = None,
    normal=UP,
    sky=None,
    view=None,
) -> AnalyticScene:
    """Return the irradiance at the origin; ``law(exact)`` is the law of one sample, ``view`` a function or None.

    ``constants`` are arguments of ``formula`` by which it is not differentiated.
    """
    integrand = mc.irradiance(mc.Scene(primitives, sky), ORIGIN, normal, **strategy)
    view = view or plate_view(primitives, normal)
    return closed_form_scene(
        name, formula, arguments, integrand, source, geometry=geometry, law=law, constants=constants, view=view
    )


def law_of_hits(*lights: tuple[float, float]) -> laws.Law:
    """Return the law by cosine-distributed directions of lights given as (irradiance, radiance).

    A sample is pi times the radiance that its ray meets.
    """
    met = [(irradiance / (math.pi * radiance), math.pi * radiance) for irradiance, radiance in lights if radiance > 0]
    return laws.law_of_values(*([column] for column in zip(*met))) if met else laws.Law(0.0, None)


def law_of_lamp(strategy: Mapping, exact: float, emission: float, nodes, normal=UP) -> laws.Law | None:
    """Return the law of one light of which all is seen, ``nodes`` being its directions.

    Without nodes, where the light is cut or hidden, only the law by cosine-distributed directions is known.
    """
    if strategy["lights"] == "none" and strategy["directions"] == "cosine":
        return law_of_hits((exact, emission))
    if nodes is None or strategy["lights"] == "mis":
        return None
    if strategy["lights"] == "nee":
        return laws.law_of_light(np.asarray(normal), nodes, emission)
    return laws.law_of_directions(strategy["directions"], np.asarray(normal), [(nodes, emission)])


def described(strategy: Mapping) -> str:
    """Return the words for a strategy that a scene's name ends with."""
    return f"lights={strategy['lights']}" if strategy["lights"] != "none" else f"{strategy['directions']} directions"


def plate_view(primitives, normal=UP, *, size: float = 3.0, sky=0.02, eye=(0.5, -2.0, 0.4)) -> Callable:
    """Return a view of primitives and a diffuse plate at the receiver, on which their light and shadow fall.

    ``size`` is about how far they reach, and the unit of ``eye``. The plate is small where a light is partly below it.
    """

    def view():
        n = unit(normal)
        side = 0.2 * size if any(_lowest(p, n) < 0 for p in primitives if p.emission) else 3.0 * size
        u = side * unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n))]))
        v = np.cross(n, u)
        plate = mc.Quad(-0.5 * (u + v), u, v, mc.Diffuse(0.7))
        camera = mc.PinholeCamera(np.multiply(size, eye), (0.0, 0.0, 0.3 * size), up=UP, fov=45.0, width=128, height=96)
        return mc.Scene([*primitives, plate], sky), camera

    return view


def _lowest(primitive, normal):
    if isinstance(primitive, mc.Sphere):
        return np.dot(primitive.center, normal) - primitive.radius
    if isinstance(primitive, mc.Disk):
        tilt = np.linalg.norm(np.cross(unit(primitive.normal), normal))
        return np.dot(primitive.center, normal) - primitive.radius * tilt
    return (vertices(primitive.corner, primitive.edge_u, primitive.edge_v) @ normal).min()


def unit(vector) -> np.ndarray:
    return np.asarray(vector, float) / np.linalg.norm(vector)


def vertices(corner, edge_u, edge_v) -> np.ndarray:
    """Return the outline of a parallelogram, shape (4, 3)."""
    corner, u, v = (np.asarray(vector, float) for vector in (corner, edge_u, edge_v))
    return np.stack([corner, corner + u, corner + u + v, corner + v])


def black_sphere(center, radius, emission=None) -> mc.Sphere:
    return mc.Sphere(center, radius, material=BLACK, emission=emission)


def black_disk(center, normal, radius, emission=None) -> mc.Disk:
    return mc.Disk(center, normal, radius, material=BLACK, emission=emission)


def black_quad(corner, edge_u, edge_v, emission=None) -> mc.Quad:
    return mc.Quad(corner, edge_u, edge_v, material=BLACK, emission=emission)
