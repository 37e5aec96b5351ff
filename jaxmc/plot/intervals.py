"""How often intervals cover, and the laws of errors beside those they should have."""

import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from scipy import stats

from .figures import LINE_COLORS, LINE_MARKERS


def reliability(ax, measured, level=0.95):
    """Draw the share of intervals that cover against their nominal level; ``measured``: label -> ``Coverage``.

    Grey: where the share of a right interval lies with probability ``level``, for the fewest claims among them. Those
    without any claim have no line. Colours follow the order of ``measured``; ``shared_legend`` names them.
    """
    claims = min(c.claims for c in measured.values() if c.claims)
    nominal = np.linspace(0.3, 0.997, 400)
    edges = [stats.binom.ppf(side, claims, nominal) / claims for side in (0.5 - 0.5 * level, 0.5 + 0.5 * level)]
    least, most = 0.1, 1.0 - 0.5 / claims
    ax.fill_between(nominal, *np.clip(edges, least, most), color="0.85", label=f"right, {level:.0%} band")
    ax.plot(nominal, nominal, color="k", lw=0.6, ls="--")
    for k, (label, c) in enumerate(measured.items()):
        turn, place = divmod(k, len(LINE_COLORS))
        style = {"color": LINE_COLORS[place], "marker": LINE_MARKERS[turn % len(LINE_MARKERS)], "lw": 0.9, "ms": 3.5}
        if c.claims:
            ax.plot(c.levels, np.clip(c.covered[0], least, most), label=label, **style)
    ax.set(xscale="logit", yscale="logit", xlim=(0.4, 0.995), ylim=(0.9 * least, 0.9995))
    for axis, ticks in ((ax.xaxis, (0.5, 0.9, 0.95, 0.99)), (ax.yaxis, (0.1, 0.5, 0.9, 0.95, 0.99, 0.999))):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
    ax.set(xlabel="nominal level", ylabel="share of intervals that cover")
    ax.grid(alpha=0.3)


def z_scores(ax, z, dof):
    """Draw the histogram of (mean - exact) / stderr beside its law, Student's; the outer bins hold all beyond."""
    z = z[~np.isnan(z)]
    edges = np.linspace(-5.0, 5.0, 41)
    ax.hist(np.clip(z, -4.99, 4.99), edges, density=True, color="#9ecae1", label=f"{z.size:,} runs")
    x = np.linspace(-5.0, 5.0, 300)
    ax.plot(x, stats.t.pdf(x, dof), color="k", lw=1, label="normal law" if np.isinf(dof) else f"Student's, {dof:g} dof")
    ax.set(xlabel="(mean - exact) / stderr", ylabel="density", ylim=(0.0, 1.25 * ax.get_ylim()[1]))  # room for a legend
    ax.legend(fontsize=8, loc="upper right")


def histograms(ax, samples, edges, truth, xlabel):
    """Draw histograms of samples by label, and where the truth lies; the outer bins hold all beyond."""
    for (label, values), color in zip(samples.items(), ("#08519c", "#d95f02")):
        ax.hist(np.clip(values, edges[0], edges[-1]), edges, color=color, alpha=0.6, label=label)
    ax.axvline(truth, color="k", lw=1, label="truth")
    ax.set(xlabel=xlabel, ylabel="runs")
    ax.yaxis.get_major_locator().set_params(integer=True)
    ax.legend(fontsize=8, loc="upper right")
