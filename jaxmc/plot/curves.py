"""Curves of one number against another: errors, rates, laws, costs."""

import numpy as np
from matplotlib.ticker import NullLocator


def convergence(ax, x, curves, xlabel, slopes=True):
    """Draw root mean squared error against samples or time; ``curves``: label -> (errors, predicted, rate)."""
    for (label, (errors, predicted, rate)), color in zip(curves.items(), ("#08519c", "#d95f02"), strict=True):
        if slopes:
            label = f"{label}: slope {rate.slope:.2f} +- {rate.stderr:.2f}"
        ax.plot(x, errors, "o", color=color, ms=4, label=label)
        ax.plot(x, predicted, color=color, lw=1, alpha=0.7)
    ax.plot([], [], color="0.4", lw=1, label="predicted from the one pass")
    ax.set(xscale="log", yscale="log", xlabel=xlabel, ylabel="RMS error of a pixel (luminance)")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3, which="both")


def rounding_errors(ax, curves, xlabel, promise=None):
    """Draw relative errors against what is varied; ``curves``: label -> (x, errors), ``promise``: (x, limit)."""
    for label, (x, errors) in curves.items():
        # An error of 0 is drawn at the bottom.
        ax.plot(x, np.maximum(np.abs(errors), 1e-9), ".-", lw=1, label=label)
    if promise is not None:
        ax.plot(*promise, color="k", lw=1, ls="--", label="promised")
    ax.axhline(2.0**-24, color="0.5", lw=0.8, ls=":")
    ax.set(xscale="log", yscale="log", xlabel=xlabel, ylabel="relative error, float32")
    ax.set_ylim(bottom=5e-10)
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def rates(ax, x, curves, least, xlabel, ylabel):
    """Draw how often something happens, by label; rates of 0 lie on the line at ``least``."""
    for (label, rate), marker in zip(curves.items(), "osD^vx+*"):
        ax.plot(x, np.maximum(rate, least), marker=marker, ms=4, lw=1, label=label)
    ax.axhline(least, color="0.5", lw=0.8, ls=":")
    ax.set(xscale="log", yscale="log", xlabel=xlabel, ylabel=ylabel)
    ax.annotate("none", (x[0], least), (0, 3), textcoords="offset points", fontsize=8, color="0.4")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def law(ax, x, curves, xlabel, ylabel, logx=True):
    """Draw what was measured (dots) beside what a law says (lines); ``curves``: label -> (measured, law or None)."""
    for label, (measured, exact) in curves.items():
        (dots,) = ax.plot(x, measured, "o", ms=4.5, label=label)
        if exact is None:
            ax.plot(x, measured, color=dots.get_color(), lw=0.8, alpha=0.7)
        else:
            ax.plot(x, exact, color=dots.get_color(), lw=1.2)
    ax.set(xscale="log" if logx else "linear", yscale="log", xlabel=xlabel, ylabel=ylabel)
    ax.set_xticks(x, [f"{value:g}" for value in x])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def bars(ax, labels, values, xlabel, log=True):
    """Draw a number for each label, the first one on top."""
    ax.barh(labels, values, color="#08519c", height=0.7)
    ax.invert_yaxis()
    ax.set(xscale="log" if log else "linear", xlabel=xlabel)
    ax.tick_params(axis="y", labelsize=8)
    ax.grid(alpha=0.3, axis="x")


OWN_COLORS = {
    "Independent": "#08519c", "Sobol": "#d95f02", "Lattice": "#1b9e77", "Halton": "#7570b3",
    "LatinHypercube": "#e7298a", "Stratified": "#a6761d",
}  # fmt: skip
OTHER_MARKERS = "osD^vx+*P<>1248p"


def time_to_error(ax, curves, title, targets=(), others=None):
    """Draw error against time: our methods in colour, others dashed in grey.

    Ours are dotted without an error bar, dash-dotted where they are a variant of another.
    ``curves`` are those of ``bench``; ``others`` names what is not ours in an order that all axes of a figure share.
    """
    others = others or [curve.name for curve in curves if not curve.own]
    for curve in sorted(curves, key=lambda c: c.own):
        x, y = [r.seconds for r in curve.rungs], [r.error for r in curve.rungs]
        if curve.own:
            sampler, _, variant = curve.name.partition(", ")
            line = ":" if not curve.error_bar else "-." if variant else "-"
            style = {"color": OWN_COLORS.get(sampler), "ls": line, "lw": 1.8, "ms": 5, "marker": "."}
        else:
            place = others.index(curve.name)
            grey, marker = str(0.2 + 0.08 * (place % 5)), OTHER_MARKERS[place % len(OTHER_MARKERS)]
            style = {"color": grey, "ls": "--", "lw": 0.9, "ms": 4.5, "marker": marker}
        ax.plot(x, y, label=curve.name, **style)
    for target in targets:
        ax.axhline(target, color="k", lw=0.6, alpha=0.5)
    ax.set(xscale="log", yscale="log", xlabel="time of one estimate (s)", ylabel="RMS relative error")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter("")
    ax.set_title(title, fontsize=10)
    ax.grid(alpha=0.25)


def mean_ranges(ax, n, means, truth):
    """Draw estimates of a mean against the number of samples: median, and the range of nine in ten.

    ``means``: label -> (counts, experiments).
    """
    for (label, found), color in zip(means.items(), ("#08519c", "#d95f02", "#1b9e77")):
        low, middle, high = np.quantile(found, (0.05, 0.5, 0.95), axis=1)
        ax.fill_between(n, low, high, color=color, alpha=0.2)
        ax.plot(n, middle, color=color, lw=1.3, label=label)
    ax.axhline(truth, color="k", lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlabel="random pixels n", ylabel="mean of them")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)
