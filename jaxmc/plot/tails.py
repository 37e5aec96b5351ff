"""Tails: how often samples are large, and what clamping them costs."""

SAMPLE_COUNT_COLORS = {16: "#d95f02", 128: "#7570b3", 1024: "#1b9e77"}


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


def throughput_law(ax, curve, exact, label):
    """Draw a measured exceedance curve of throughput beside the exact law."""
    seen = (curve.fraction > 0.0) & (curve.edges > 0.0)
    (line,) = ax.plot(curve.edges[seen], curve.fraction[seen], lw=2.5, alpha=0.5, label=f"{label}, measured")
    ax.fill_between(curve.edges[seen], curve.lower[seen], curve.upper[seen], color=line.get_color(), alpha=0.15)
    ax.plot(curve.edges[seen], exact(curve.edges[seen]), color="k", lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlabel="throughput w", ylabel="fraction of paths above w")
    ax.grid(alpha=0.3)
