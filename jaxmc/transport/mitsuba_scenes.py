"""Scenes for Mitsuba 3, as the dictionaries that its ``load_dict`` takes.

``describe`` returns them as plain data, without Mitsuba: transforms are lists of four rows, and a triangle is
``{"type": "mesh", "vertices": ..., "faces": ...}``. ``mitsuba_objects`` puts Mitsuba's own objects in their place.
"""

import math

import numpy as np

from ..integration.counts import positive
from .camera import Camera
from .facts import axes_of
from .materials import Dielectric, Diffuse, Mirror
from .primitives import Box, Disk, Quad, Sphere, as_color, is_concrete
from .scene import LEAST_ROUGHNESS, Scene
from .sky import GradientSky
from .strategy import Strategy

NEVER = 2**31 - 1  # depth at which Mitsuba's Russian roulette starts
NEAR, FAR = 1e-5, 10.0  # what a camera sees, times its distance from the far end of the scene


def describe(scene: Scene, camera: Camera | None, spp, bounces) -> dict:
    """Return a scene as Mitsuba's dictionary without Mitsuba's objects; see ``Scene.to_mitsuba``."""
    primitives, sky = scene.as_given()
    spp, bounces = positive("spp", spp), Strategy(bounces).bounces
    found = {
        "type": "scene",
        # Mitsuba counts the edges of a path: emission seen directly is depth 1.
        "integrator": {"type": "path", "max_depth": bounces + 1, "rr_depth": NEVER},
    }
    if camera is not None:
        found["sensor"] = _sensor(scene, camera, spp)
    for i, p in enumerate(primitives):
        place = f"primitives[{i}]"
        if not is_concrete(list(vars(p).values()) + list(vars(p.material).values())):
            raise ValueError(
                f"{place}: JAX traces its values, so they are not known; call this outside of jit and grad"
            )
        found[f"primitive_{i}"] = {**_shape(p), "bsdf": _bsdf(p.material), **_emitter(place, p)}
    if sky is not None:
        found["sky"] = {"type": "constant", "radiance": _rgb(_constant(sky))}
    return found


def _constant(sky):
    if isinstance(sky, GradientSky):
        raise ValueError(
            "Mitsuba has no sky that is a polynomial of the angle, so a GradientSky cannot be given to it; take a "
            "constant sky, or add an envmap of your own to the dictionary of the scene without a sky"
        )
    return sky


def _sensor(scene, camera, spp):
    if not isinstance(camera, Camera):
        raise ValueError(f"camera must be made by mc.PinholeCamera(...), got {camera!r}")
    if not camera.antialias:
        raise ValueError(
            "Mitsuba's samples lie anywhere in a pixel, so a camera with antialias=False cannot be given to it; "
            "make one with antialias=True"
        )
    origin, right, down, forward = (
        np.array([float(c) for c in v]) for v in (camera.origin, camera.right, camera.down, camera.forward)
    )
    columns = [-right / np.linalg.norm(right), -down / np.linalg.norm(down), forward, origin]
    distance = float(np.linalg.norm(origin - scene.middle)) + float(scene.reach)
    far = FAR * distance if 0.0 < distance < math.inf else 1e4
    return {
        "type": "perspective",
        "fov": 2.0 * math.degrees(math.atan(float(np.linalg.norm(down)))),
        "fov_axis": "y",
        "near_clip": NEAR * far,
        "far_clip": far,
        "to_world": _matrix(columns),
        "sampler": {"type": "independent", "sample_count": spp},
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


def _shape(p):
    """Return where a primitive is, its normals on the side that ours are on."""
    if isinstance(p, Sphere):
        return {"type": "sphere", "center": _list(p.center), "radius": float(p.radius), "flip_normals": bool(p.inward)}
    if isinstance(p, Quad):
        # Mitsuba's rectangle spans [-1, 1]^2 in x and y and looks along +z.
        corner, u, v = (np.asarray(x, np.float64) for x in (p.corner, p.edge_u, p.edge_v))
        normal = np.cross(u, v)
        columns = [0.5 * u, 0.5 * v, normal / np.linalg.norm(normal), corner + 0.5 * (u + v)]
        return {"type": "rectangle", "to_world": _matrix(columns)}
    if isinstance(p, Disk):
        # Mitsuba's disk has radius 1 around the origin and looks along +z.
        normal, u, v = map(np.array, axes_of(p))
        return {"type": "disk", "to_world": _matrix([u, v, normal, np.asarray(p.center, np.float64)])}
    if isinstance(p, Box):
        # Mitsuba's cube spans [-1, 1]^3. A reflection would turn it inside out, and a box is its own mirror image.
        axes = np.asarray(p.axes, np.float64)
        axes = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])[:, None]
        columns = [*(0.5 * np.asarray(p.size, np.float64)[:, None] * axes), np.asarray(p.center, np.float64)]
        return {"type": "cube", "to_world": _matrix(columns), "flip_normals": bool(p.inward)}
    return {"type": "mesh", "vertices": [_list(p.a), _list(p.b), _list(p.c)], "faces": [[0, 1, 2]]}


def _bsdf(material):
    if isinstance(material, Dielectric):
        return {"type": "dielectric", "int_ior": float(material.ior), "ext_ior": 1.0}
    if isinstance(material, Diffuse):
        return _two_sided({"type": "diffuse", "reflectance": _rgb(material.albedo)})
    reflectance = {"specular_reflectance": _rgb(material.reflectance)}
    if isinstance(material, Mirror):
        return _two_sided({"type": "conductor", "material": "none", **reflectance})
    metal = (
        {"material": "none"} if material.eta is None else {"eta": _rgb(material.eta), "k": _rgb(material.k)}
    )  # without a material facets reflect everything
    alpha = max(float(material.roughness), LEAST_ROUGHNESS)
    facets = {"type": "roughconductor", "distribution": "ggx", "alpha": alpha, "sample_visible": True}
    return _two_sided({**facets, **metal, **reflectance})


def _two_sided(bsdf):
    return {"type": "twosided", "bsdf": bsdf}


def _emitter(place, p):
    radiance = as_color("emission", 0.0 if p.emission is None else p.emission)
    if not any(radiance):
        return {}
    if p.two_sided:
        raise ValueError(
            f"{place}: Mitsuba's lights shine to one side, so one that is two_sided cannot be given to it; "
            "take two lights back to back a small distance apart, or a thin mc.Box"
        )
    return {"emitter": {"type": "area", "radiance": _rgb(radiance)}}


def _rgb(value):
    return {"type": "rgb", "value": list(as_color("color", value))}


def _list(value):
    return np.asarray(value, np.float64).tolist()


def _matrix(columns):
    """Return the affine map with these columns, the last one its translation, as four rows."""
    return [*np.stack(columns, axis=1).tolist(), [0.0, 0.0, 0.0, 1.0]]
