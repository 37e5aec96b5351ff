"""Images and maps: a picture, a number for each pixel, normals."""

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize

from ..pictures import tone_map
from .figures import plt


def images(pictures, columns=2, exposure=1.0, width=4.2):
    """Return a figure of tone-mapped linear images, by title; ``width`` of each in inches."""
    rows = -(-len(pictures) // columns)
    high, wide = next(iter(pictures.values())).shape[:2]
    size = {"figsize": (width * columns, (width * high / wide + 0.35) * rows), "squeeze": False}
    fig, axes = plt.subplots(rows, columns, layout="constrained", **size)
    for ax in axes.flat:
        ax.axis("off")
    for ax, (title, image) in zip(axes.flat, pictures.items()):
        ax.imshow(tone_map(image, exposure), interpolation="nearest")
        ax.set_title(title, fontsize=10)
    return fig


def heat_map(ax, values, label, cmap="inferno", log=False, least=None):
    """Draw a map of one number for each pixel, with its scale, from ``least`` on; grey where it is not finite."""
    values = np.where(np.isfinite(values), values, np.nan)
    norm = LogNorm(clip=True) if log and (values > 0.0).any() else Normalize(vmin=least)
    shown = ax.imshow(values, cmap=cmap, interpolation="nearest", norm=norm)
    ax.set(xticks=[], yticks=[], facecolor="0.75")
    ax.figure.colorbar(shown, ax=ax, label=label, shrink=0.8)


def normals(ax, values):
    """Draw a map of unit normals: x, y and z as red, green and blue; black where there are none."""
    seen = np.any(values != 0.0, -1, keepdims=True)
    ax.imshow(np.clip(np.where(seen, 0.5 * values + 0.5, 0.0), 0.0, 1.0), interpolation="nearest")
    ax.set(xticks=[], yticks=[])
    for name, channel in (("z", 2), ("y", 1), ("x", 0)):
        colors = np.full((256, 3), 0.5)
        colors[:, channel] = np.linspace(0.0, 1.0, 256)
        scale = ScalarMappable(Normalize(-1.0, 1.0), ListedColormap(colors))
        ax.figure.colorbar(scale, ax=ax, label=f"{name} of the normal", shrink=0.8, pad=0.02)
