"""What rounding does to light: the stress test of the transport in float32 beside float64 and exact values.

Scenes are scaled and moved, spheres and lights grow and shrink by ten powers of ten, surfaces touch and coincide, rays
graze and aim at edges, paths take a thousand bounces. Each case says what is promised. Last, two common ways to keep a
ray from its own surface are held against ours.
"""

import dataclasses
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from .. import plot
from ..report import Report
from . import closed_rooms, strained_rays, strained_scenes, stress, walks
from .closed_rooms import EPSILON
from .strained_scenes import EPS

LONG = "1000 events"  # the group whose points are dear
SCALES = 10.0 ** np.arange(-6, 7)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Options of the study: events that walk through each closed room, points of each case and of each scene whose bias
    is measured, samples per pixel of the pictures. ``scenes`` names the collection of those scenes as ``module:name``.
    """

    events: int = 10_000_000
    points: int = 1 << 14
    bias_points: int = 1 << 17
    spp: int = 256
    scenes: str | None = None
    seed: int = 0
    progress: bool = True

    def __post_init__(self):
        for name, least in (("events", 1000), ("points", 256), ("bias_points", 256), ("spp", 1)):
            if not least <= getattr(self, name) <= 1 << 40:
                raise ValueError(f"the study wants {least} to 2^40 {name}, got {name}={getattr(self, name)}")


class Found(NamedTuple):
    """A case and what was measured of it."""

    case: stress.Case
    measured: Any

    @property
    def kept(self):
        return self.measured.keeps(self.case.promise)


def run(folder, settings: Settings = Settings()) -> Path:
    """Run the study and return the path of its ``report.html``.

    Raises ``ValueError`` for settings out of range and scenes that are not found.
    """
    report, started = Report(folder, "What rounding does to light", seed=settings.seed), time.perf_counter()
    cases = strained_scenes.all_cases()
    biases = stress.bias_cases(settings.scenes) if settings.scenes else []
    rooms = closed_rooms.rooms()
    total = (
        len(cases)
        + len(biases)
        + len(rooms)
        + len(closed_rooms.WAYS) * (len(SCALES) + 1)
        + len(closed_rooms.PICTURES)
        + 2
    )
    with tqdm(total=total, unit=" measurements", disable=not settings.progress) as bar:

        def step(title, function, *args, **options):
            bar.set_description(title)
            result = function(*args, **options)
            bar.update()
            return result

        # Two at a time: most of the time goes into compiling, on one core each.
        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(lambda c: step(c.name, _measure, c, settings), cases))
            bias = list(pool.map(lambda c: step(c.name, _measure, c, settings, settings.bias_points), biases))
        paths = {"events": settings.events, "bounces": 1000, "key": _key(settings, 1)}
        counts = {name: step(name, walks.count, *room, **paths) for name, room in rooms.items()}
        pierced = step("balls through walls", walks.count, *closed_rooms.pierced_room(), **paths)
        rays = step("rays at their limits", _rays, settings)
        events, key = max(10_000, settings.events // 5), _key(settings, 2)
        rates = {
            name: [step(name, closed_rooms.rates, way, size, events, key) for size in SCALES]
            for name, way in closed_rooms.WAYS.items()
        }
        dome = {name: step(name, closed_rooms.dome, way, events, key) for name, way in closed_rooms.WAYS.items()}
        pictures = {
            name: step(name, closed_rooms.picture, *picture, settings.spp, _key(settings, 3))
            for name, picture in closed_rooms.PICTURES.items()
        }
    _show_promises(report, found)
    _show_rooms(report, counts, pierced)
    _show_rays(report, rays)
    if bias:
        _show_bias(report, bias)
    _show_ways(report, rates, dome, pictures)
    report.value("seconds", time.perf_counter() - started)
    return report.save()


def _key(settings, stream):
    return (settings.seed << 8) + stream


def _measure(case, settings, points=None):
    n = 64 if case.group == LONG else points or settings.points
    return Found(case, stress.measure(case, n, settings.seed))


def _rays(settings):
    return {
        "edges": strained_rays.edges(1 << 18, settings.seed),
        "grazing": {s: strained_rays.grazing(s) for s in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)},
        "limits": strained_rays.at_limits(),
        "overflow": strained_rays.overflow(),
    }


# ------------------------------------------------------------------------------------------------ the report


def _show_promises(report, found):
    kept, bad = sum(f.kept for f in found), sum(f.measured.nonfinite for f in found)
    report.section("Promises")
    report.text(
        f"Of {len(found)} cases **{len(found) - kept} break their promise**, and {bad} values were not finite. An "
        "error in float32 is that of the mean against float64 **at the same points**: it holds rounding alone. The "
        "float64 mean is held against the exact value. Where a promise grows toward small things, it is the rounding "
        "of a coordinate or a direction over their size: whatever takes float32 numbers cannot know more."
    )
    rows = []
    for group, cases in _by_group(found).items():
        worst = max(cases, key=lambda f: abs(f.measured.rounding) / f.case.promise)
        z = max(abs(f.measured.wide) / f.measured.wide_error for f in cases if f.measured.wide_error > 0.0) if any(
            f.measured.wide_error > 1e-12 for f in cases
        ) else None  # fmt: skip
        rows.append(
            [
                group,
                len(cases),
                sum(f.kept for f in cases),
                worst.case.name,
                worst.measured.rounding,
                worst.case.promise,
                z,
            ]
        )
    headers = ["group", "cases", "kept", "nearest to its promise", "error", "promised", "largest z in float64"]
    report.table(headers, rows, "z: (float64 mean - exact) over its standard error.")
    _draw_errors(report, found)
    rows = [
        [c.name, c.promise, m.rounding, m.error, m.wide, m.wide_error, m.nonfinite, "yes" if f.kept else "**no**"]
        for f in found for c, m in [f]
    ]  # fmt: skip
    headers = ["case", "promised", "float32", "±", "float64", "± ", "not finite", "kept"]
    report.table(
        headers, rows, "Relative errors: of rounding in float32, and of the float64 mean against the exact value."
    )
    report.values({"cases": len(found), "promises kept": kept, "values not finite": bad})
    report.values({f"{f.case.group}: {f.case.name}": f.measured for f in found})


def _by_group(found):
    groups = {}
    for f in found:
        groups.setdefault(f.case.group, []).append(f)
    return groups


def _draw_errors(report, found):
    groups = _by_group(found)
    axes_of = {
        "scaled": "size of the scene", "moved": "distance from the origin, in scene sizes",
        "apart": "distance of two parts of a scene", "sphere": "radius of the sphere, in scene sizes",
        "small light": "size of the light over its distance", "edge-on": "height over the light's plane",
        "gap": "gap between lamp and ceiling",
    }  # fmt: skip
    fig, axes = plot.panels(len(axes_of), 3, (4.4, 3.3))
    for ax, (group, xlabel) in zip(axes, axes_of.items()):
        curves, promised = {}, {}
        for f in groups[group]:
            if f.case.x > 0.0:
                x, errors = curves.setdefault(f.case.name.partition(":")[0], ([], []))
                x.append(f.case.x)
                errors.append(f.measured.rounding)
                promised[f.case.x] = max(f.case.promise, promised.get(f.case.x, 0.0))
        plot.rounding_errors(ax, curves, xlabel, tuple(zip(*sorted(promised.items()))))
    report.figure(fig, "errors", "Error of a float32 mean; dotted: the rounding of one number, 6e-8.")


def _show_rooms(report, counts, pierced):
    report.section("Closed rooms")
    total = sum(c["events"] for c in counts.values())
    wrong = {name: sum(c[name] for c in counts.values()) for name in walks.COUNTS[1:]}
    report.text(
        f"Paths of 1000 scattering events in rooms from which no ray may escape: **{total:,} events**, of which "
        + ", ".join(f"{n} {name}" for name, n in wrong.items())
        + ". A self-hit is a ray that meets the plane it leaves, or a sphere from whose outside it leaves."
    )
    rows = [[room, *(c[name] for name in walks.COUNTS)] for room, c in counts.items()]
    report.table(["room", *walks.COUNTS], rows)
    report.text(
        "Where surfaces cut each other, a hit next to their common line may lie beyond the other surface by rounding, "
        f"and its path goes on there. In a box with two balls through its walls, of {pierced['events']:,} events "
        f"{pierced['escapes']} led outside and {pierced['inside a ball']} into a ball: that is what is left."
    )
    report.value("balls through walls", pierced)
    report.values({"events in closed rooms": total, **{f"closed rooms: {name}": n for name, n in wrong.items()}})


def _show_rays(report, rays):
    report.section("Rays and numbers at their limits")
    rows = [[f"aimed at edges and corners, {e.start}", e.rays, e.slipped] for e in rays["edges"]]
    rows += [[f"{name}, coordinates at 0 and 1 - 2^-24", n, wrong] for name, (wrong, n) in rays["limits"].items()]
    report.table(["what", "how many", "wrong"], rows, "Rays that slip through a closed box; values that are not sound.")
    rows = [[s, e[False], e[False] * s / EPS, e[True]] for s, e in rays["grazing"].items()]
    headers = ["sine of the angle", "float32", "times sine / 2^-23", "float64"]
    report.table(headers, rows, "Largest relative error of the distance at which a ray meets a plane that it grazes.")
    o = rays["overflow"]
    report.text(
        f"A lamp of radiance 3e38, near: {o['beyond float32']:,} values are larger than float32 holds. They come out "
        f"as {o['infinite']:,} infinities and {o['NaN']} NaN, and the estimate reports {o['reported']:,}. Radiances "
        "and lengths that float32 cannot hold, denormal ones among them, are refused when a scene is built."
    )
    report.values({"rays that slipped": sum(e.slipped for e in rays["edges"]), "overflow": o})


def _show_bias(report, bias):
    report.section("Bias of float32")
    rows = [[f.case.name, f.measured.rounding, f.measured.error, f.measured.wide / f.measured.wide_error
             if f.measured.wide_error > 1e-12 else None, "yes" if f.kept else "**no**"] for f in bias]  # fmt: skip
    headers = ["scene", "bias", "±", "z in float64", "below 1e-6"]
    report.table(headers, rows, f"(float32 - float64) / exact at {bias[0].measured.n:,} common points.")
    report.values({f"bias: {f.case.name}": f.measured for f in bias})


def _show_ways(report, rates, dome, pictures):
    report.section("Three ways to keep a ray from its own surface")
    report.text(
        f"Walks in a closed box with two balls on its floor, scaled. A **constant offset** of {EPSILON:g} is right at "
        "one scale: in a smaller room rays start beyond the next wall, in a larger one it drowns in rounding and they "
        "meet the surface that they leave. **Leaving out the primitive** that a ray comes from is exact for walls, "
        "though not at their common edges; of a sphere it also leaves out the far side. **Ours** knows the other root "
        "of the sphere, overlaps walls by the rounding error where they touch, and keeps directions off the tangent "
        "plane."
    )
    least = 0.3 / max(c["events"] for cs in rates.values() for c in cs)
    fig, axes = plot.panels(2, 2)
    leaks = {n: [(c["escapes"] + c["inside a ball"]) / c["events"] for c in cs] for n, cs in rates.items()}
    acne = {n: [c["self-hits"] / c["events"] for c in cs] for n, cs in rates.items()}
    plot.rates(axes[0], SCALES, leaks, least, "size of the room", "light leaks: escapes, entries into a ball")
    plot.rates(axes[1], SCALES, acne, least, "size of the room", "acne: rays that meet their own surface")
    report.figure(fig, "self_intersection", "How often a scattering event ends so; the path tracer's way has none.")
    rows = [[name, *(c[k] for k in walks.COUNTS)] for name, c in dome.items()]
    report.table(["way", *walks.COUNTS], rows, "Inside a closed sphere of radius 0.7.")
    rows = []
    for k, size in enumerate(SCALES):
        counts = [cs[k] for cs in rates.values()]
        rows.append(
            [size, *(x for c in counts for x in (c["escapes"] + c["inside a ball"], c["self-hits"], c["events"]))]
        )
    headers = ["size", *(f"{name}: {word}" for name in rates for word in ("leaks", "acne", "events"))]
    report.table(headers, rows, "Inside the box.")
    caption = "A ball and a lamp in a closed dome. Red: light that leaks in from the sky outside."
    report.figure(plot.images(pictures, 2), "pictures", caption)
