"""Figures: each function draws on the Axes that it is given. The only module that imports matplotlib."""

import matplotlib
import numpy as np

matplotlib.use("Agg", force=False)
import matplotlib.pyplot as plt

SAMPLE_COUNT_COLORS = {16: "#d95f02", 128: "#7570b3", 1024: "#1b9e77"}


def tone_map(image, exposure=1.0):
    """Return display values in [0, 1] of a linear image: clip, then gamma 1 / 2.2. NaN becomes magenta."""
    image = np.asarray(image, float) * exposure
    bad = ~np.isfinite(image).all(-1)
    shown = np.clip(np.nan_to_num(image), 0.0, 1.0) ** (1.0 / 2.2)
    shown[bad] = (1.0, 0.0, 1.0)
    return shown


def images(pictures, columns=2, exposure=1.0):
    """Return a figure of tone-mapped linear images, by title."""
    rows = -(-len(pictures) // columns)
    height, width = next(iter(pictures.values())).shape[:2]
    size = (4.2 * columns, (4.2 * height / width + 0.35) * rows)
    fig, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    for ax in axes.flat:
        ax.axis("off")
    for ax, (title, image) in zip(axes.flat, pictures.items()):
        ax.imshow(tone_map(image, exposure), interpolation="nearest")
        ax.set_title(title, fontsize=10)
    return fig


def heat_map(ax, values, label, cmap="inferno"):
    """Draw a map of one number for each pixel, with its scale."""
    shown = ax.imshow(values, cmap=cmap, interpolation="nearest")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.figure.colorbar(shown, ax=ax, label=label, shrink=0.8)


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
