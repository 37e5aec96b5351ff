"""Estimators of one number beside each other: how far off they are, and how noisy."""

import numpy as np
from matplotlib.ticker import NullLocator

from .figures import LINE_COLORS, LINE_MARKERS

BIASED, SOUND = "#d95f02", "#08519c"
SIGMAS = 5.0


def relative_biases(ax, names, means, stderrs, exact, biased):
    """Draw (mean - exact) / |exact| of each estimator with bars of 5 standard errors, the first one on top.

    ``biased``: which are called so; those are orange, others blue. The axis is linear up to 1 %, logarithmic beyond.
    """
    rows, scale = np.arange(len(names)), abs(exact)
    off, bars = (np.asarray(means) - exact) / scale, SIGMAS * np.asarray(stderrs) / scale
    for flag, color in ((False, SOUND), (True, BIASED)):
        here = np.asarray(biased) == flag
        if here.any():
            ax.errorbar(off[here], rows[here], xerr=bars[here], fmt="o", ms=4, lw=1.2, color=color)
    ax.axvline(0.0, color="k", lw=0.8)
    ax.set_yticks(rows, names)
    ax.set_xscale("symlog", linthresh=0.01, linscale=0.6)
    ends = [-100.0, -1.0, -0.1, -0.01, 0.0, 0.01, 0.1, 1.0, 100.0]
    ax.set_xticks(ends, [f"{100.0 * x:g}%" for x in ends])
    ax.xaxis.set_minor_locator(NullLocator())
    widest = 1.5 * max(0.02, np.max(np.abs(off) + bars))
    ax.set(xlim=(-widest, widest), ylim=(len(names) - 0.4, -0.6), xlabel="mean less exact, and 5 errors; relative")
    ax.tick_params(labelsize=8)
    ax.grid(alpha=0.3, axis="x")


def noise_bars(ax, values, biased, xlabel):
    """Draw a positive number for each estimator, the first one on top; those of 0 have no bar and say so."""
    values, rows = np.asarray(values), np.arange(len(values))
    ax.barh(rows, values, height=0.7, color=np.where(biased, BIASED, SOUND))
    ax.set(xscale="log", xlabel=xlabel, yticks=rows, yticklabels=[], ylim=(len(values) - 0.4, -0.6))
    if (values > 0.0).any():
        least = 0.5 * values[values > 0.0].min()
        ax.set_xlim(left=least)
        for row in rows[values <= 0.0]:
            ax.annotate("none", (least, row), (3, -3), textcoords="offset points", fontsize=8, color="0.4")
    ax.tick_params(labelsize=8)
    ax.grid(alpha=0.3, axis="x")


def noise_by_roughness(ax, x, curves, title, ylabel):
    """Draw a number against roughness for each estimator; ``curves``: label -> (values, biased). Biased ones are
    dashed; ``shared_legend`` names them.
    """
    colors = (*LINE_COLORS, "0.5")
    for k, (label, (values, biased)) in enumerate(curves.items()):
        style = {"color": colors[k % len(colors)], "marker": LINE_MARKERS[k % len(LINE_MARKERS)]}
        ax.plot(x, values, ls="--" if biased else "-", ms=4, lw=1.2, label=label, **style)
    ax.set(xscale="log", yscale="log", xlabel="roughness", ylabel=ylabel)
    ax.set_title(title, fontsize=10)
    ax.set_xticks(x, [f"{value:g}" for value in x])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.grid(alpha=0.3)
