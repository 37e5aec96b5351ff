"""Other renderers as processes that take a scene and render it on request; see ``mitsuba_cornell.py``."""

import contextlib
import json
import subprocess
from pathlib import Path

import numpy as np

import jaxmc as mc

SERVER = Path(__file__).with_name("mitsuba_cornell.py")


class Peer:
    """Mitsuba, or another ``server``, in a process of its own, which computes only between a request and its answer."""

    def __init__(self, python, variant, server=SERVER):
        self.variant, self.about = variant, {}
        command = [str(python), str(server), variant]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        with contextlib.suppress(BrokenPipeError):  # it may have ended before
            self._process.stdin.close()
        self._process.wait()

    def load(self, parts, width, height, bounces, **more):
        """Build a scene; returns what Mitsuba says about itself. ``more``: its sampler and integrator, if others."""
        self.about = self.ask({**describe(parts, width, height, bounces), **more})
        return self.about

    def render(self, spp, seed):
        """Return (seconds, image of shape (height, width, 3))."""
        answer = self.ask({"spp": spp, "seed": seed})
        return answer["seconds"], np.load(answer["file"])

    def ask(self, message):
        """Return the answer to a message, or raise ``RuntimeError`` with the one that its process gives."""
        with contextlib.suppress(BrokenPipeError):  # a process that has ended answers nothing, and said why on stderr
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": f"its process ended with status {self._process.wait()}"}
        if "error" in answer:
            raise RuntimeError(f"{self.variant}: {answer['error']}")
        return answer


def describe(parts, width, height, bounces):
    """Return a scene of ``jaxmc.scenes`` as the description that ``mitsuba_cornell.py`` reads."""
    quads = [_item(p, "corner", "edge_u", "edge_v") for p in parts.primitives if isinstance(p, mc.Quad)]
    spheres = [_item(p, "center", "radius") for p in parts.primitives if isinstance(p, mc.Sphere)]
    image = {"width": width, "height": height, "bounces": bounces}
    return {**parts.view, **image, "quads": quads, "spheres": spheres}


def _item(primitive, *names):
    if getattr(primitive, "inward", False):
        raise ValueError(f"Mitsuba's spheres shine outward only, got {primitive!r}")
    mirror = isinstance(primitive.material, mc.Mirror)
    albedo = primitive.material.reflectance if mirror else primitive.material.albedo
    return {
        **{name: np.asarray(getattr(primitive, name), float).tolist() for name in names},
        "albedo": _rgb(albedo),
        "mirror": mirror,
        "emission": None if primitive.emission is None else _rgb(primitive.emission),
    }


def _rgb(value):
    return np.broadcast_to(np.asarray(value, float), 3).tolist()
