"""Scenes as plain data and as files: what was given, every number exactly.

A scene is a dictionary of lists, numbers and strings, as JSON has them::

    {"format": "jaxmc scene", "version": 1, "primitives": [...], "sky": ..., "camera": ...}

A primitive, a material, a ``GradientSky`` and a camera are dictionaries too: ``"type"`` is the name of what they are in
Python, the rest are its arguments by name. Arguments that have a default may be left out, and so may sky and camera.
"""

import inspect
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .camera import Camera, PinholeCamera
from .materials import Dielectric, Diffuse, Mirror, RoughConductor
from .primitives import Box, Disk, Quad, Sphere, Triangle, is_concrete
from .scene import Scene
from .sky import GradientSky

FORMAT, VERSION = "jaxmc scene", 1
DEPTH = 2  # of lists in lists: the axes of a box
PRIMITIVES = (Sphere, Quad, Triangle, Disk, Box)
MATERIALS = (Diffuse, Mirror, RoughConductor, Dielectric)


def scene_to_dict(scene: Scene, camera: Camera | None = None) -> dict:
    """Return a scene, and a camera if there is one, as plain data; see ``Scene.to_dict``."""
    primitives, sky = scene.as_given()
    found = {
        "format": FORMAT,
        "version": VERSION,
        "primitives": [_plain_value(f"primitives[{i}]", p) for i, p in enumerate(primitives)],
        "sky": _plain_value("sky", sky),
    }
    if camera is not None:
        found["camera"] = _plain("camera", PinholeCamera, camera_arguments(camera))
    return found


def camera_arguments(camera: Camera) -> dict:
    """Return what ``mc.PinholeCamera`` was called with."""
    if not isinstance(camera, Camera):
        raise ValueError(f"camera must be made by mc.PinholeCamera(...), got {camera!r}")
    if camera.given is None:
        raise ValueError(
            "this camera was changed after it was made and no longer knows its origin and target; "
            "take the one that mc.PinholeCamera(...) returned"
        )
    return camera.given


def scene_from_dict(data) -> tuple[Scene, Camera | None]:
    """Return the scene and the camera of plain data; see ``Scene.from_dict``."""
    if not isinstance(data, dict):
        raise ValueError(f"a scene is a dictionary, as scene.to_dict() returns, got {_short(data)}")
    if data.get("format") != FORMAT:
        raise ValueError(f'format: must be "{FORMAT}", got {_short(data.get("format"))}; is this another kind of file?')
    if isinstance(data.get("version"), bool) or data.get("version") != VERSION:
        raise ValueError(
            f"version: must be {VERSION}, got {_short(data.get('version'))}; files of a later jaxmc need that jaxmc"
        )
    _check_names("the scene", data, needed={"primitives"}, known={"format", "version", "primitives", "sky", "camera"})
    primitives = data["primitives"]
    if not isinstance(primitives, list):
        raise ValueError(f"primitives: must be a list of dictionaries, got {_short(primitives)}")
    primitives = [_object(f"primitives[{i}]", p, PRIMITIVES) for i, p in enumerate(primitives)]
    sky, camera = data.get("sky"), data.get("camera")
    sky = _object("sky", sky, (GradientSky,)) if isinstance(sky, dict) else _numbers("sky", sky, optional=True)
    if camera is not None:
        camera = _object("camera", camera, (PinholeCamera,))
    return Scene(primitives, sky), camera


def save_scene(path, scene: Scene, camera: Camera | None = None) -> None:
    """Write a scene, and a camera if there is one, as JSON.

    The file appears whole or not at all: another process never reads half of it.

    Raises:
        ValueError: a scene or camera that does not know what it was given, or values that JAX traces.
        OSError: the file cannot be written.
    """
    text = json.dumps(scene_to_dict(scene, camera), indent=1, allow_nan=False) + "\n"
    path = Path(path)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as folder:
        unfinished = Path(folder, path.name)
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, path)


def load_scene(path) -> tuple[Scene, Camera | None]:
    """Read what ``save_scene`` wrote; the camera is None if the file has none.

    Raises:
        ValueError: a file that is no scene; the message names the place in it.
        OSError: the file cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        data = json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse)
        return scene_from_dict(data)
    except RecursionError:
        raise ValueError(f"{path}: lists or dictionaries are nested too deep for a scene") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _unique(pairs):
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f'"{twice}" stands twice in one dictionary; keep one')
    return found


def _refuse(name):
    raise ValueError(f"{name} is no number of JSON; numbers must be finite")


# ------------------------------------------------------------------------------------------------ objects to data


def _plain(place, kind, arguments):
    """Return the arguments of a kind of object as plain data."""
    found = {"type": kind.__name__}
    for name, parameter in inspect.signature(kind).parameters.items():
        value, default, where = arguments[name], parameter.default, f"{place}.{name}"
        if isinstance(default, int):
            found[name] = type(default)(value)
        else:
            found[name] = _plain_value(where, value)
    return found


def _plain_value(place, value):
    """Return a material, a sky, a number, an array or None as plain data."""
    if value is None:
        return None
    if isinstance(value, (*PRIMITIVES, *MATERIALS, GradientSky)):
        return _plain(place, type(value), vars(value))
    if not is_concrete(value):
        raise ValueError(f"{place}: JAX traces this value, so it is not known; write the scene outside of jit and grad")
    # Row by row: the coefficients of a sky may mix numbers and colours.
    if isinstance(value, list | tuple):
        return [_plain_value(place, one) for one in value]
    return np.asarray(value, np.float64).tolist()


# ------------------------------------------------------------------------------------------------ data to objects


def _object(place, data, kinds):
    """Return the object that a dictionary describes, one of ``kinds``."""
    names = [kind.__name__ for kind in kinds]
    expected = f'a dictionary with "type": {" or ".join(names)}'
    if not isinstance(data, dict):
        raise ValueError(f"{place}: must be {expected}, got {_short(data)}")
    if not isinstance(data.get("type"), str) or data["type"] not in names:
        raise ValueError(f"{place}.type: must be {' or '.join(names)}, got {_short(data.get('type'))}")
    kind = kinds[names.index(data["type"])]
    parameters = inspect.signature(kind).parameters
    needed = {name for name, p in parameters.items() if p.default is p.empty}
    _check_names(place, data, needed, {"type", *parameters})
    arguments = {
        name: _argument(f"{place}.{name}", value, parameters[name].default)
        for name, value in data.items()
        if name != "type"
    }
    try:
        # What overflows is infinite, and then out of range.
        with np.errstate(over="ignore", invalid="ignore"):
            return kind(**arguments)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


def _argument(place, value, default: Any):
    """Return an argument from plain data, of the kind that its default has."""
    if isinstance(default, MATERIALS):
        return _object(place, value, MATERIALS)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{place}: must be true or false, got {_short(value)}")
        return value
    if isinstance(default, int):
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"{place}: must be an integer, got {_short(value)}")
        return value
    return _numbers(place, value, optional=default is None)


def _numbers(place, value, optional=False, depth=DEPTH):
    """Return a number or nested lists of numbers, as floats, or None if that is allowed."""
    if value is None and optional:
        return None
    if isinstance(value, list) and depth:
        return [_numbers(f"{place}[{i}]", one, depth=depth - 1) for i, one in enumerate(value)]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{place}: must be made of numbers, got {_short(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{place}: must be finite, got {_short(value)}")
    return number


def _check_names(place, data, needed, known):
    if missing := sorted(needed - set(data)):
        raise ValueError(f"{place}: {', '.join(missing)} is missing; add it")
    if unknown := sorted(map(str, set(data) - known)):
        raise ValueError(f"{place}: unknown {', '.join(map(_short, unknown))}; known are {', '.join(sorted(known))}")


def _short(value):
    """Return a value as a message shows it."""
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # nested too deep, or an integer of thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."
