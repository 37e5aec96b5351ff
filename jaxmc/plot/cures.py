"""Cures of fireflies side by side: errors, energy, time, and where in the image light is lost."""

import numpy as np
from matplotlib.colors import SymLogNorm
from matplotlib.ticker import FixedLocator, NullLocator

from ..pictures import tone_map
from .figures import plt

COUNT_COLORS = ("#d95f02", "#7570b3", "#1b9e77", "#3b3b3b", "#a6761d", "#e7298a")
COUNT_MARKERS = "osD^v<"
MAPS = 5  # in a row
ENERGY_TICKS, TIME_TICKS = (-100, -30, -10, -5, -2, 0, 2, 5, 10, 30, 100), (0.5, 1, 2, 5, 10, 20, 50, 100)
MAP_COUNT = 128  # samples per pixel whose lost light is shown, or the next below


def cures(comparison):
    """Return a figure of a ``fireflies.Comparison``: RMS error over that without a cure, energy lost, time, and maps.

    Errors are drawn for each number of samples, with bars of one standard error. An error that is below its own
    uncertainty is drawn there, with an arrow to the left. Vertical lines show the best clamp.
    """
    rows = comparison.rows
    high, wide = comparison.reference.shape
    lines = -(-len(rows) // MAPS)
    above, width = 1.4 + 0.3 * len(rows), 14.0
    below = lines * (width / MAPS * high / wide + 0.3) + 0.3
    fig = plt.figure(figsize=(width, above + below), layout="constrained")
    upper, lower = fig.subfigures(2, 1, height_ratios=[above, below])
    axes = upper.subplots(1, 3, sharey=True, width_ratios=[3, 2.2, 1.3])
    _errors(axes[0], comparison)
    _energy(axes[1], comparison)
    _time(axes[2], rows)
    axes[0].set_yticks(range(len(rows)), [row.name for row in rows], fontsize=9)
    axes[0].set_ylim(len(rows) - 0.5, -0.5)
    for ax in axes:
        ax.grid(alpha=0.3, axis="x")
        for k in range(0, len(rows), 2):
            ax.axhspan(k - 0.5, k + 0.5, color="0.96", zorder=0)
    _maps(lower, lower.subplots(lines, MAPS, squeeze=False), comparison)
    return fig


def _places(counts):
    """Yield for each number of samples where its markers lie in a line, and how they look."""
    steps = np.linspace(-0.28, 0.28, len(counts)) if len(counts) > 1 else [0.0]
    for k, (N, step) in enumerate(zip(counts, steps)):
        yield N, step, {"color": COUNT_COLORS[k % 6], "marker": COUNT_MARKERS[k % 6], "ms": 4.5, "ls": "", "lw": 1}


def _errors(ax, comparison):
    for N, step, style in _places(comparison.counts):
        whole = comparison.rows[0].at[N].mse
        for k, row in enumerate(comparison.rows):
            if N not in row.at:
                continue
            mse, error = row.at[N].mse, row.at[N].mse_stderr
            if mse <= error:
                ax.plot(np.sqrt((max(mse, 0.0) + error) / whole), k + step, **style | {"marker": 8, "ms": 7})
                continue
            x = np.sqrt(mse / whole)
            # The error of a root: one standard error of the square to each side.
            ends = [[x - np.sqrt((mse - error) / whole)], [np.sqrt((mse + error) / whole) - x]]
            ax.errorbar(x, k + step, xerr=ends, **style)
        ax.axvline(np.sqrt(comparison.best[N].mse / whole), color=style["color"], lw=0.8, ls=":")
        ax.plot([], [], label=f"N = {N}", **style)
    ax.plot([], [], color="0.3", lw=0.8, ls=":", label="best clamp")
    ax.set(xscale="log", xlabel="RMS error of a pixel, over that without a cure")
    ax.legend(fontsize=8, loc="lower left", ncols=len(comparison.counts) + 1, bbox_to_anchor=(0.0, 1.0), frameon=False)


def _energy(ax, comparison):
    whole = comparison.reference.mean()
    for N, step, style in _places(comparison.counts):
        for k, row in enumerate(comparison.rows):
            if N in row.at:
                m = row.at[N]
                ax.errorbar(-100.0 * m.bias / whole, k + step, xerr=100.0 * m.bias_stderr / whole, **style)
    ax.axvline(0.0, color="0.3", lw=0.8)
    ax.set_xscale("symlog", linthresh=10.0)
    ax.xaxis.set_major_locator(FixedLocator(ENERGY_TICKS))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("energy lost, % of the image")


def _time(ax, rows):
    timed = [(k, row) for k, row in enumerate(rows) if np.isfinite(row.time)]
    for k, row in timed:
        error = row.time_stderr if np.isfinite(row.time_stderr) else 0.0
        ax.errorbar(row.time, k, xerr=error, color="#08519c", marker="o", ms=4.5, lw=1)
    ax.axvline(1.0, color="0.3", lw=0.8)
    if timed:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(TIME_TICKS))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("time of an image")


def _maps(figure, axes, comparison):
    """Draw the light that each cure takes away, mean of 3 x 3 pixels, beside the reference."""
    images = {}
    for row in comparison.rows[1:]:
        if row.lost:
            N = max([N for N in row.lost if N <= MAP_COUNT], default=min(row.lost))
            images[row.name] = (N, _smooth(row.lost[N]))
    most = max((np.quantile(np.abs(image), 0.999) for _, image in images.values()), default=1.0)
    norm = SymLogNorm(max(float(comparison.stderr.mean()), 1e-3 * most, 1e-12), vmin=-most, vmax=most)
    for ax in axes.flat:
        ax.axis("off")
    shown = None
    first, *rest = axes.flat
    first.imshow(tone_map(np.repeat(comparison.reference[..., None], 3, -1)), interpolation="nearest")
    first.set_title("the reference", fontsize=9)
    for ax, (name, (N, image)) in zip(rest, images.items()):
        shown = ax.imshow(image, cmap="RdBu_r", norm=norm, interpolation="nearest")
        ax.set_title(f"{name}, N = {N}" if not comparison[name].averages else name, fontsize=9)
    if shown is not None:
        figure.colorbar(shown, ax=axes, label="light lost (red) or added (blue)", shrink=0.8, pad=0.01)


def _smooth(image):
    """Return means over 3 x 3 pixels, of those that exist."""

    def total(x):
        x = np.pad(x, 1)
        x = x[:-2] + x[1:-1] + x[2:]
        return x[:, :-2] + x[:, 1:-1] + x[:, 2:]

    return total(np.asarray(image, float)) / total(np.ones(np.shape(image)))
