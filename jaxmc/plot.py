"""Figures: each function draws on the Axes that it is given. The only module that imports matplotlib."""

import io

import matplotlib
import numpy as np
from scipy import stats

from .pictures import tone_map as tone_map

matplotlib.use("Agg", force=False)
import matplotlib.pyplot as plt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

SAMPLE_COUNT_COLORS = {16: "#d95f02", 128: "#7570b3", 1024: "#1b9e77"}


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


def png(fig) -> bytes:
    """Return a figure as PNG, and close it."""
    fig.savefig(content := io.BytesIO(), format="png", dpi=120)
    plt.close(fig)
    return content.getvalue()


def exceedance(ax, curve, threshold=None):
    """Draw the exceedance curve with its pointwise 95% band; ``curve`` from ``analysis.tails.exceedance``."""
    seen = (curve.fraction > 0.0) & (curve.edges > 0.0)
    edges = curve.edges[seen]
    ax.fill_between(edges, curve.lower[seen], curve.upper[seen], color="#9ecae1", label="95% Clopper-Pearson band")
    ax.plot(edges, curve.fraction[seen], color="#08519c", lw=1.2, label="measured")
    if threshold is not None:
        ax.axvline(threshold, color="#d95f02", ls="--", lw=1, label=f"firefly threshold {threshold:g}")
    ax.set(xscale="log", yscale="log", xlabel="luminance t of one sample", ylabel="fraction of samples above t")
    ax.set_xlim(edges.max() * 1e-6, edges.max() * 2.0)
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def clamp_bias(ax, curve, band, least=0.03):
    """Draw the energy that clamping at t takes away, with its simultaneous band."""
    t = curve.threshold
    shown = t > least
    note = "95% band, all t at once" if band.trusted else "95% band (not trusted: heavy tail)"
    ax.fill_between(t[shown], band.lower[shown], band.upper[shown], color="#c7e9c0", label=note)
    ax.plot(t[shown], curve.bias[shown], color="#006d2c", lw=1.2, label="bias B(t) = E max(c - t, 0)")
    ax.axhline(curve.unclamped_mean, color="0.4", ls=":", lw=1, label="unclamped mean")
    ax.set(xscale="log", xlabel="clamping threshold t (luminance)", ylabel="bias of the mean luminance")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def clamp_variance(ax, t, variance, unclamped):
    """Draw the variance of one clamped sample, mean over pixels."""
    ax.plot(t, variance, color="#54278f", marker=".", lw=1.2, label="clamped")
    ax.axhline(unclamped, color="0.4", ls=":", lw=1, label="unclamped")
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="clamping threshold t (luminance)",
        ylabel="variance of one sample, mean over pixels",
    )
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


def clamp_mse(ax, t, mse_by_n, unclamped_by_n, optimum_by_n, fixed):
    """Draw the mean squared error of an N-sample pixel against the threshold, with the best threshold for each N."""
    for n, mse in mse_by_n.items():
        color = SAMPLE_COUNT_COLORS.get(n)
        ax.plot(t, mse, color=color, lw=1.3, label=f"N = {n}")
        ax.axhline(unclamped_by_n[n], color=color, ls=":", lw=1)
        ax.plot(optimum_by_n[n].threshold, optimum_by_n[n].mse, "o", color=color, ms=7, mfc="none")
    ax.axvline(fixed, color="0.4", ls="--", lw=1, label=f"t = {fixed:g}")
    ax.plot([], [], "o", color="0.3", mfc="none", label="best t*(N)")
    ax.plot([], [], ":", color="0.3", label="unclamped")
    ax.set(
        xscale="log", yscale="log", xlabel="clamping threshold t (luminance)", ylabel="mean squared error of a pixel"
    )
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)


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


def throughput_law(ax, curve, exact, label):
    """Draw a measured exceedance curve of throughput beside the exact law."""
    seen = (curve.fraction > 0.0) & (curve.edges > 0.0)
    (line,) = ax.plot(curve.edges[seen], curve.fraction[seen], lw=2.5, alpha=0.5, label=f"{label}, measured")
    ax.fill_between(curve.edges[seen], curve.lower[seen], curve.upper[seen], color=line.get_color(), alpha=0.15)
    ax.plot(curve.edges[seen], exact(curve.edges[seen]), color="k", lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlabel="throughput w", ylabel="fraction of paths above w")
    ax.grid(alpha=0.3)


def panels(count, columns=2, size=(5.2, 3.8)):
    """Return a figure and its Axes."""
    rows = -(-count // columns)
    fig, axes = plt.subplots(
        rows, columns, figsize=(size[0] * columns, size[1] * rows), squeeze=False, layout="constrained"
    )
    for ax in axes.flat[count:]:
        ax.axis("off")
    return fig, axes.ravel()[:count]


LINE_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#bcbd22", "#17becf")
LINE_MARKERS = "os^D"


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


def shared_legend(fig):
    """Draw one legend for all axes of a figure, below it, in as many columns as fit; dashed lines come last."""
    handles = {}
    for ax in fig.axes:
        for handle, label in zip(*ax.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    order = sorted(handles, key=lambda label: handles[label].get_linestyle() == "--")
    for columns in range(len(order), 0, -1):
        style = {"loc": "outside lower center", "ncols": columns, "fontsize": 8, "frameon": False}
        legend = fig.legend([handles[k] for k in order], order, **style)
        if legend.get_window_extent().width <= fig.bbox.width or columns == 1:
            break
        legend.remove()
