"""Mitsuba 3 as a server of derivatives. Needs only mitsuba and NumPy.

    python mitsuba_gradients.py llvm_ad_rgb

Reads one JSON object per line from stdin and answers each with one JSON object on stdout. A request is a scene, as
``jaxmc.transport.mitsuba_scenes.describe`` writes it, and what moves:

    {"scene": {...}, "shape": "primitive_0", "direction": [0, 0, 1], "spp": 1024, "seed": 3}

with either ``"integrator"``, the dictionary of one of Mitsuba's that differentiates, or ``"step"``, half the distance
of a central difference with common random numbers by the integrator of the scene. The answer ``{"slope", "seconds",
"warnings", "mitsuba"}`` has the derivative of the mean of the image, over pixels and channels, as the shape moves along
``direction``, and what Mitsuba warned of. A request without a shape

    {"scene": {...}, "integrator": {...}, "all": true, "spp": 64, "seed": 3}

asks for the derivatives by all numbers in reverse mode: the answer ``{"gradient", "seconds", "value_seconds"}`` has
them by the names of their parameters, those of places as derivatives by translation, and the times of the sweep, which
renders too, and of the image alone. The scene of the last such request stays loaded if ``"scene"`` is left out. A line
that fails is answered ``{"error": ...}``.
"""

import json
import os
import sys
import time

import numpy as np
from mitsuba_cornell import find_llvm, with_objects


class Motion:
    """A scene of which one shape can move."""

    def __init__(self, mi, message):
        self.mi = mi
        self.scene = mi.load_dict(with_objects(mi, message["scene"]))
        self.direction = [float(x) for x in message["direction"]]
        self.name = f"{message['shape']}.to_world"
        self.params = mi.traverse(self.scene)
        self.params.keep([self.name])
        self.start = mi.Transform4f(self.params[self.name])

    def move(self, distance):
        self.params[self.name] = self.mi.Transform4f().translate([x * distance for x in self.direction]) @ self.start
        self.params.update()

    def difference(self, step, spp, seed):
        """Return the central difference of the mean of the image."""
        means = []
        for distance in (step, -step):
            self.move(self.mi.Float(distance))
            means.append(np.array(self.mi.render(self.scene, spp=spp, seed=seed), np.float64).mean())
        return (means[0] - means[1]) / (2.0 * step)

    def slope(self, integrator, spp, seed):
        """Return the derivative of the mean of the image by an integrator of Mitsuba, in forward mode."""
        import drjit as dr

        distance = self.mi.Float(0.0)
        dr.enable_grad(distance)
        self.move(distance)
        image = self.mi.render(self.scene, self.params, integrator=integrator, spp=spp, seed=seed)
        dr.forward(distance)
        return float(np.array(dr.grad(image), np.float64).mean())


class Everything:
    """A scene of which every colour and every place is differentiated by."""

    def __init__(self, mi, message):
        self.mi = mi
        # Unless told otherwise Mitsuba makes one material of those that are equal.
        self.scene = mi.load_dict(with_objects(mi, message["scene"]), optimize=False)
        self.params = mi.traverse(self.scene)
        self.params.keep([r".*\.reflectance\.value", r".*\.radiance\.value", r"primitive_\d+\.to_world"])

    def answer(self, message):
        import drjit as dr

        mi, spp, seed = self.mi, message["spp"], message["seed"]
        integrator = mi.load_dict(message["integrator"])
        start = time.perf_counter()
        np.array(mi.render(self.scene, integrator=integrator, spp=spp, seed=seed))
        alone = time.perf_counter() - start
        start = time.perf_counter()
        for name in self.params.keys():
            dr.enable_grad(self.params[name])
        self.params.update()
        image = mi.render(self.scene, self.params, integrator=integrator, spp=spp, seed=seed)
        dr.backward(dr.mean(image, axis=None))
        found = {name: self._gradient(name, dr.grad(self.params[name])) for name in self.params.keys()}
        seconds = time.perf_counter() - start
        for name in self.params.keys():
            dr.disable_grad(self.params[name])
        return {"gradient": found, "seconds": seconds, "value_seconds": alone, "mitsuba": mi.__version__}

    @staticmethod
    def _gradient(name, gradient):
        if name.endswith("to_world"):
            return np.array(gradient.matrix, np.float64).reshape(4, 4, -1)[:3, 3, 0].tolist()
        return np.array(gradient, np.float64).ravel().tolist()


LOADED = []


def answer(mi, message, warnings):
    if message.get("all"):
        LOADED[:] = [Everything(mi, message)] if "scene" in message else LOADED
        return LOADED[0].answer(message)
    motion = Motion(mi, message)
    integrator = mi.load_dict(message["integrator"]) if "integrator" in message else None
    warnings.clear()
    start = time.perf_counter()
    if integrator is None:
        slope = motion.difference(message["step"], message["spp"], message["seed"])
    else:
        slope = motion.slope(integrator, message["spp"], message["seed"])
    seconds = time.perf_counter() - start
    return {"slope": slope, "seconds": seconds, "warnings": sorted(set(warnings)), "mitsuba": mi.__version__}


def listen(mi):
    """Return the list that Mitsuba's warnings go to from now on."""
    found = []

    class Listener(mi.Appender):
        def append(self, level, text):
            if level >= mi.LogLevel.Warn:
                found.append(text[text.find("]") + 1 :].strip())

    mi.logger().clear_appenders()
    mi.logger().add_appender(Listener())
    return found


def main():
    if len(sys.argv) != 2:
        raise SystemExit("usage: mitsuba_gradients.py VARIANT  (for example llvm_ad_rgb)")
    # Keep the real stdout for answers and send everything else to stderr.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    if sys.argv[1].startswith("llvm"):
        os.environ["DRJIT_LIBLLVM_PATH"] = find_llvm()
    import mitsuba as mi

    mi.set_variant(sys.argv[1])
    warnings = listen(mi)
    for line in filter(str.strip, sys.stdin):
        try:
            reply = answer(mi, json.loads(line), warnings)
        except Exception as error:  # a server says what went wrong and takes the next line
            reply = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(reply), file=answers)


if __name__ == "__main__":
    main()
