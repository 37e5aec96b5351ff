"""Light paths, drawn in their scene."""

import numpy as np

KIND_COLORS = {"diffuse": "#08519c", "mirror": "#d95f02", "glass": "#e7298a", "rough": "#1b9e77"}


def path_in_scene(ax, outlines, points, kinds, plane=(0, 1), title=None):
    """Draw a path from the eye to the light, seen along an axis.

    ``outlines``: closed lines (n, 2) of what is in the scene; ``points`` (m, 3): eye, scattering events, and the light
    where there is one more point than events; ``kinds``: of the events; ``plane``: the two axes that are drawn.
    """
    for line in outlines:
        ax.plot(*line.T, color="0.75", lw=0.8, zorder=1)
    flat = np.asarray(points)[:, list(plane)]
    ax.plot(*flat.T, color="0.2", lw=1.2, zorder=2)
    ax.plot(*flat[0], "s", color="0.2", ms=6, label="eye", zorder=3)
    events = flat[1 : len(kinds) + 1]
    for kind in dict.fromkeys(kinds):
        chosen = [k == kind for k in kinds[: len(events)]]
        ax.plot(*events[chosen].T, "o", color=KIND_COLORS.get(kind, "0.4"), ms=6, label=kind, zorder=3)
    for number, point in enumerate(events, 1):
        ax.annotate(str(number), point, (4, 4), textcoords="offset points", fontsize=8)
    if len(flat) > len(kinds) + 1:
        ax.plot(*flat[-1], "*", color="#e6ab02", ms=13, mec="0.3", label="light", zorder=3)
    ax.set(xlabel="xyz"[plane[0]], ylabel="xyz"[plane[1]], aspect="equal", title=title)
    ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
