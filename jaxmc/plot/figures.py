"""Figures as a whole: panels, one legend for all, and PNG."""

import io

import matplotlib

matplotlib.use("Agg", force=False)
import matplotlib.pyplot as plt

LINE_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#bcbd22", "#17becf")
LINE_MARKERS = "os^D"


def panels(count, columns=2, size=(5.2, 3.8)):
    """Return a figure and its Axes."""
    rows = -(-count // columns)
    fig, axes = plt.subplots(
        rows, columns, figsize=(size[0] * columns, size[1] * rows), squeeze=False, layout="constrained"
    )
    for ax in axes.flat[count:]:
        ax.axis("off")
    return fig, axes.ravel()[:count]


def png(fig) -> bytes:
    """Return a figure as PNG, and close it."""
    fig.savefig(content := io.BytesIO(), format="png", dpi=120)
    plt.close(fig)
    return content.getvalue()


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
