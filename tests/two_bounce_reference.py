"""Light after one and after two bounces, without Monte Carlo: a lamp, a blocker, a floor and a wall, seen by a camera.

A rectangular lamp shines down on a floor and on a wall; a black rectangle below it hides part of the lamp from parts of
both, and parts of the wall from parts of the floor. All of them are axis-parallel; the floor and the wall are diffuse.
The camera stands lower than the blocker, looks down at an angle, and sees the floor alone. ``means`` returns the mean
radiance over its film, by the number of bounces:

* direct: camera, floor, lamp. At a point the visible part of the lamp is a polygon less a polygon, and its irradiance
  is Lambert's formula. That has kinks on the floor where the shadow of an edge meets a corner. These are straight
  lines; the film is cut along all of them, and Gauss and Legendre's rule integrates over the pieces, where all is
  smooth.
* indirect: camera, floor, wall, lamp. The same over the wall: for each of its points the irradiance, times an integral
  over what that point sees of the floor on the film, again a polygon less a polygon.

Derivatives are central differences of these numbers, extrapolated; ``tests/data/two_bounce.json`` holds them.
"""

import itertools
import json
import math
from pathlib import Path

import numpy as np
from cut_polygons import area, clip, event_lines, fan, over_polygons, over_triangles, split

import jaxmc as mc

TABLE = Path(__file__).with_name("data") / "two_bounce.json"
EMISSION, FLOOR_ALBEDO, WALL_ALBEDO = 20.0, 0.8, 0.9
LAMP, BLOCKER = (0.3, 0.25), (0.3, 0.35)  # half their sizes in x and y, before scaling
WALL_Y, WALL_Z = (-1.2, 1.2), (0.1, 1.8)
TARGET, FOV = (-0.2, 0.05, 0.0), 42.0
# The floor lies on z = floor, the wall on x = wall; sizes are scales.
PARAMS = {
    "floor": 0.0, "wall": 1.0,
    "blocker_x": 0.2, "blocker_y": 0.05, "blocker_z": 1.0, "blocker_size": 1.0,
    "lamp_x": -0.5, "lamp_y": 0.15, "lamp_z": 2.0, "lamp_size": 1.0,
    "camera_x": -0.4, "camera_y": -0.6, "camera_z": 0.9,
}  # fmt: skip
STEP = 0.005


def make(p):
    """Return (scene, camera) of jaxmc. Radiance with bounces=1 is the direct part, with bounces=2 the sum of both."""
    (a, b), (c, d) = ([half * p[f"{name}_size"] for half in halves] for name, halves in ROOFS.items())
    lamp = [p["lamp_x"] - a, p["lamp_y"] - b, p["lamp_z"]]
    blocker = [p["blocker_x"] - c, p["blocker_y"] - d, p["blocker_z"]]
    height, width = WALL_Z[1] - WALL_Z[0], WALL_Y[1] - WALL_Y[0]
    black = mc.Diffuse(0.0)
    primitives = [
        mc.Quad([-2.5, -2.0, p["floor"]], [3.4, 0.0, 0.0], [0.0, 4.0, 0.0], mc.Diffuse(FLOOR_ALBEDO)),
        mc.Quad([p["wall"], WALL_Y[0], WALL_Z[0]], [0.0, 0.0, height], [0.0, width, 0.0], mc.Diffuse(WALL_ALBEDO)),
        mc.Quad(blocker, [2.0 * c, 0.0, 0.0], [0.0, 2.0 * d, 0.0], black),
        mc.Quad(lamp, [0.0, 2.0 * b, 0.0], [2.0 * a, 0.0, 0.0], black, emission=EMISSION),
    ]
    origin = [p["camera_x"], p["camera_y"], p["camera_z"]]
    return mc.Scene(primitives), mc.PinholeCamera(origin, TARGET, (0.0, 0.0, 1.0), FOV, 16, 16)


ROOFS = {"lamp": LAMP, "blocker": BLOCKER}


def means(p, order=8):
    """Return the mean radiance over the film after (one, two) bounces."""
    return direct_mean(p, order), indirect_mean(p, order)


def derivatives(value, p, step=STEP):
    """Return the derivative of ``value(p)`` with respect to each parameter: differences, extrapolated twice."""

    def difference(name, h):
        return (np.asarray(value({**p, name: p[name] + h})) - np.asarray(value({**p, name: p[name] - h}))) / (2.0 * h)

    def extrapolated(name):
        wide, middle, narrow = (difference(name, step / 2**k) for k in range(3))
        first, second = (4.0 * middle - wide) / 3.0, (4.0 * narrow - middle) / 3.0
        return (16.0 * second - first) / 15.0

    return {name: extrapolated(name) for name in p}


# ---------------------------------------------------------------------------------------------------------- direct


def direct_mean(p, order=8):
    """Return the mean radiance that the film gets from the lamp by way of the floor."""
    lamp, blocker = roof(p, "lamp"), roof(p, "blocker")
    plane = np.array([[0.0, 0.0, p["floor"]], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    view = View(p)
    cells = split([view.footprint], event_lines(lamp, blocker, plane))
    film, weight = over_polygons([view.to_film(cell) for cell in cells], order)
    points = view.to_floor(film)
    received = visible_irradiance(points, np.array([0.0, 0.0, 1.0]), lamp, blocker)
    return FLOOR_ALBEDO / math.pi * weight @ received / 4.0


def roof(p, name):
    """Return the corners of the lamp or of the blocker, shape (4, 3), in a circle."""
    a, b = (half * p[f"{name}_size"] for half in ROOFS[name])
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    flat = signs * [a, b] + [p[f"{name}_x"], p[f"{name}_y"]]
    return np.column_stack([flat, np.full(4, p[f"{name}_z"])])


def visible_irradiance(points, normal, lamp, blocker):
    """Return the irradiance at points of shape (n, 3), on the side of ``normal``, where the whole lamp lies."""
    whole = irradiance(np.broadcast_to(lamp, (len(points), 4, 3)), points, normal)
    below = points[:, 2] < blocker[0, 2]  # else the blocker is not on the way
    if not below.any():
        return whole
    near = points[below]
    scale = (lamp[0, 2] - near[:, 2]) / (blocker[0, 2] - near[:, 2])
    shadow = near[:, None, :2] + (blocker[:, :2] - near[:, None, :2]) * scale[:, None, None]
    low = np.clip(shadow[:, 0], lamp[0, :2], lamp[2, :2])
    high = np.clip(shadow[:, 2], lamp[0, :2], lamp[2, :2])
    hidden = np.empty((len(near), 4, 3))
    hidden[..., 2] = lamp[0, 2]
    for k, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        hidden[:, k, 0], hidden[:, k, 1] = (low, high)[i][:, 0], (low, high)[j][:, 1]
    whole[below] -= irradiance(hidden, near, normal)
    return whole


def irradiance(polygons, points, normal):
    """Return the irradiance from polygons, shape (n, k, 3), at points, shape (n, 3). Source: Lambert (1760)."""
    to = polygons - points[:, None]
    after = np.roll(to, -1, axis=1)
    across = np.cross(to, after)
    sine, cosine = np.linalg.norm(across, axis=-1), np.sum(to * after, axis=-1)
    ratio = np.where(sine > 0.0, np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0), 0.0)
    return EMISSION / 2.0 * np.abs((ratio * (across @ normal)).sum(axis=1))


# -------------------------------------------------------------------------------------------------------- indirect


def indirect_mean(p, order=8):
    """Return the mean radiance that the film gets from the lamp by way of the wall and then the floor."""
    lamp, blocker, view = roof(p, "lamp"), roof(p, "blocker"), View(p)
    plane = np.array([[p["wall"], 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    floor = np.column_stack([view.footprint, np.full(4, p["floor"])])
    total = 0.0
    # Below the height of the blocker it may hide the lamp, above it the floor.
    for z, other in (((WALL_Z[0], p["blocker_z"]), lamp), ((p["blocker_z"], WALL_Z[1]), floor)):
        part = np.array([[WALL_Y[0], z[0]], [WALL_Y[1], z[0]], [WALL_Y[1], z[1]], [WALL_Y[0], z[1]]])
        flat, weight = over_polygons(split([part], event_lines(other, blocker, plane)), order)
        points = np.column_stack([np.full(len(flat), p["wall"]), flat])
        light = visible_irradiance(points, np.array([-1.0, 0.0, 0.0]), lamp, blocker)
        total += weight @ (light * seen_floor(points, blocker, view, order))
    return WALL_ALBEDO / math.pi * FLOOR_ALBEDO * total


def seen_floor(points, blocker, view, order):
    """Return the mean over the film of the kernel cos cos / (pi r^2) between the floor there and points of the wall,
    0 where the blocker is between them.
    """
    film, weight = over_polygons([np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])], 2 * order)
    total = np.empty(len(points))
    for some in np.array_split(np.arange(len(points)), max(1, len(points) // 2000)):
        total[some] = kernel(view.to_floor(film), points[some, None]) @ weight
    above = np.flatnonzero(points[:, 2] > blocker[0, 2])
    if len(above) == 0:
        return total / 4.0
    height, far = points[above, 2] - view.floor, points[above, 2] - blocker[0, 2]
    at = points[above, None, :2]
    hidden = at + (blocker[:, :2] - at) * (height / far)[:, None, None]
    polygons = np.broadcast_to(view.footprint, (len(above), 4, 2))
    for axis, low in itertools.product((0, 1), (True, False)):
        limit = hidden[:, 0 if low else 2, axis]
        polygons = clip(polygons, np.eye(2)[axis] * (1.0 if low else -1.0), -limit if low else limit)
    dark = np.flatnonzero(area(polygons) > 0.0)
    for some in np.array_split(dark, max(1, len(dark) // 2000)):
        film, weight = over_triangles(fan(view.to_film(polygons[some])), order)
        values = kernel(view.to_floor(film), points[above[some], None])
        total[above[some]] -= np.sum(values * weight, axis=-1)
    return total / 4.0


def kernel(floor, wall):
    """Return cos cos / (pi r^2) between points of the floor, facing up, and of the wall, facing -x."""
    to = wall - floor
    return to[..., 0] * to[..., 2] / (math.pi * np.sum(to * to, axis=-1) ** 2)


class View:
    """A camera before the floor, whose film is [-1, 1]^2."""

    def __init__(self, p):
        self.floor, self.origin = p["floor"], np.array([p["camera_x"], p["camera_y"], p["camera_z"]])
        self.forward = _unit(np.array(TARGET) - self.origin)
        right = _unit(np.cross(self.forward, [0.0, 0.0, 1.0]))
        self.axes = np.array([right, np.cross(self.forward, right)])
        self.tangent = math.tan(math.radians(FOV) / 2.0)
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        self.footprint = self.to_floor(corners)[:, :2]

    def to_floor(self, film):
        toward = self.forward + film @ (self.axes * self.tangent)
        return self.origin + toward * ((self.floor - self.origin[2]) / toward[..., 2])[..., None]

    def to_film(self, flat):
        """Return where points (x, y) of the floor appear."""
        to = np.concatenate([flat, np.full((*flat.shape[:-1], 1), self.floor)], axis=-1) - self.origin
        return to @ self.axes.T / (to @ self.forward)[..., None] / self.tangent


def _unit(v):
    return v / np.linalg.norm(v)


def main():
    """Write the table."""
    direct, indirect = means(PARAMS)
    slopes = derivatives(means, PARAMS)
    parts = {
        name: {"value": value, "derivatives": {k: float(v[i]) for k, v in slopes.items()}}
        for i, (name, value) in enumerate((("direct", direct), ("indirect", indirect)))
    }
    TABLE.write_text(
        json.dumps({"source": "tests/two_bounce_reference.py", "params": PARAMS, **parts}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
