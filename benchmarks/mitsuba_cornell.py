"""Mitsuba 3 as a render server for the benchmarks. Needs only mitsuba and NumPy.

    python mitsuba_cornell.py llvm_ad_rgb        (or scalar_rgb, or any other RGB variant)

Reads one JSON object per line from stdin and answers each with one JSON object on stdout:

* a scene ``{"width", "height", "fov", "origin", "target", "up", "bounces", "quads", "spheres"}``
  -> ``{"ready": true, "variant", "mitsuba", "threads"}``;
* a request ``{"spp": 64, "seed": 3}`` -> ``{"seconds", "first", "file"}``, the image as a .npy file of shape (height,
  width, 3), linear radiance. ``seconds`` covers the rendering and the copy to NumPy, and nothing else: the first
  request for a scene and a number of samples renders twice and times the second, because Mitsuba compiles when either
  changes. ``first`` is the time of the latest render that compiled.

A line that fails is answered ``{"error": ...}``. The images live until stdin closes. In a description ``fov`` is
vertical, in degrees, and ``bounces`` counts scattering events. A quad ``{"corner", "edge_u", "edge_v"}`` reflects on
both sides and emits where ``cross(edge_u, edge_v)`` points; a sphere has ``{"center", "radius"}``. Both have
``{"albedo", "mirror", "emission"}``: RGB, true or false, and RGB or null. A scene may also name a ``"sampler"`` of
Mitsuba, and hold an ``"integrator"`` as Mitsuba describes it. ``peers.py`` writes descriptions. Or a scene is Mitsuba's
own dictionary, ``{"type": "scene", ...}``, as ``jaxmc.transport.mitsuba_scenes.describe`` returns it.
"""

import json
import os
import re
import runpy
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mitsuba_masking import register

# By its path: this environment has no JAX, and the file needs none.
OBJECTS = Path(__file__).parents[1] / "jaxmc" / "transport" / "mitsuba_objects.py"
with_objects = runpy.run_path(str(OBJECTS))["with_objects"]


def find_llvm(oldest=19):
    """Return the path of the LLVM library: DRJIT_LIBLLVM_PATH, or version ``oldest`` or newer in the usual folders."""
    if path := os.environ.get("DRJIT_LIBLLVM_PATH"):
        return path
    found = {}
    roots = ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/opt", "/opt/homebrew/lib", "/opt/homebrew/opt")
    for root in map(Path, roots):
        for folder in (root, *root.glob("*-linux-gnu"), *root.glob("llvm*/lib"), *root.glob("llvm*/lib64")):
            for file in folder.glob("libLLVM*"):
                # libLLVM-19.so, libLLVM.so.19.1, libLLVM.19.dylib, or the version in .../llvm-19/lib/libLLVM.so
                name = re.fullmatch(r"libLLVM(?:-|\.so\.|\.)?([\d.]*?)(?:\.so[.\d]*|\.dylib)?", file.name)
                version = name and (re.match(r"\d+", name[1]) or re.search(r"(?<=llvm[-@])\d+", str(folder)))
                if version and int(version[0]) >= oldest:
                    found.setdefault(int(version[0]), str(file))
    if not found:
        raise SystemExit(
            f"No LLVM library of version {oldest} or newer was found: install it (Debian and Ubuntu: libllvm{oldest}) "
            "or set DRJIT_LIBLLVM_PATH to the library file."
        )
    return found[min(found)]


def rgb(values):
    return {"type": "rgb", "value": [float(value) for value in values]}


def surface(item):
    """The part of a Mitsuba shape that every primitive shares: how it reflects and whether it emits."""
    if item.get("mirror"):
        bsdf = {"type": "conductor", "material": "none", "specular_reflectance": rgb(item["albedo"])}
    else:
        bsdf = {"type": "diffuse", "reflectance": rgb(item["albedo"])}
    shape = {"bsdf": {"type": "twosided", "side": bsdf}}
    if item.get("emission") is not None:
        shape["emitter"] = {"type": "area", "radiance": rgb(item["emission"])}
    return shape


def build(mi, description):
    """Return the Mitsuba scene of a description."""
    if description.get("type") == "scene":
        return mi.load_dict(with_objects(mi, description))
    transform = mi.ScalarTransform4f
    scene = {
        "type": "scene",
        # Mitsuba counts edges, so emission seen directly is depth 1. rr_depth keeps Russian roulette out.
        "integrator": description.get("integrator")
        or {"type": "path", "max_depth": description["bounces"] + 1, "rr_depth": 1000},
        "sensor": {
            "type": "perspective",
            "fov": description["fov"],
            "fov_axis": "y",
            "to_world": transform().look_at(*(list(description[key]) for key in ("origin", "target", "up"))),
            "sampler": {"type": description.get("sampler", "independent")},
            "film": {
                "type": "hdrfilm",
                "width": description["width"],
                "height": description["height"],
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
        },
    }
    for i, item in enumerate(description.get("quads", [])):
        # Mitsuba's rectangle spans [-1, 1]^2 in x and y and looks along +z.
        u, v = (np.asarray(item[key], np.float64) / 2 for key in ("edge_u", "edge_v"))
        normal = np.cross(u, v)
        matrix = np.eye(4)
        matrix[:3] = np.stack([u, v, normal / np.linalg.norm(normal), item["corner"] + u + v], axis=1)
        scene[f"quad{i}"] = {"type": "rectangle", "to_world": transform(matrix), **surface(item)}
    for i, item in enumerate(description.get("spheres", [])):
        place = {"center": list(item["center"]), "radius": float(item["radius"])}
        scene[f"sphere{i}"] = {"type": "sphere", **place, **surface(item)}
    return mi.load_dict(scene)


def timed_render(mi, scene, spp, seed):
    start = time.perf_counter()
    image = np.array(mi.render(scene, spp=spp, seed=seed))
    return time.perf_counter() - start, image


def serve(variant, requests, reply, folder):
    """Answer every line of ``requests`` through ``reply``; images go to ``folder``."""
    if variant.startswith("llvm"):
        os.environ["DRJIT_LIBLLVM_PATH"] = find_llvm()
    import drjit
    import mitsuba as mi

    mi.set_variant(variant)
    register(mi, drjit)
    scene, warm, first = None, set(), None
    for count, line in enumerate(filter(str.strip, requests)):
        try:
            message = json.loads(line)
            if "spp" not in message:
                scene, warm = build(mi, message), set()
                about = {"variant": variant, "mitsuba": mi.__version__, "threads": drjit.thread_count()}
                reply({"ready": True, **about})
                continue
            if scene is None:
                raise ValueError("a scene must come before the first request")
            spp, seed = int(message["spp"]), int(message.get("seed", 0))
            if spp not in warm:
                first = timed_render(mi, scene, spp, seed)[0]
                warm.add(spp)
            seconds, image = timed_render(mi, scene, spp, seed)
            file = Path(folder) / f"{count}.npy"
            np.save(file, image)
            reply({"seconds": seconds, "first": first, "file": str(file)})
        except Exception as error:  # a server says what went wrong and takes the next line
            reply({"error": f"{type(error).__name__}: {error}"})


def main():
    if len(sys.argv) != 2:
        raise SystemExit("usage: mitsuba_cornell.py VARIANT  (for example llvm_ad_rgb or scalar_rgb)")
    # Mitsuba logs to stdout: keep the real one for answers and send everything else to stderr.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    with tempfile.TemporaryDirectory(prefix="mitsuba-") as folder:
        serve(sys.argv[1], sys.stdin, lambda message: print(json.dumps(message), file=answers), folder)


if __name__ == "__main__":
    main()
