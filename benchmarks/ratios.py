"""Who reaches an error first, and how many times faster than the best on the other side."""

import math


def summary(curves, targets):
    """Print and return, for each target, who is first there and the ratio best peer / best of ours: above 1 we are
    faster. Once where both sides give an error bar, and once for all methods."""
    found = {}
    for target in targets:
        for group, chosen in (("with error bars", [c for c in curves if c.error_bar]), ("all", curves)):
            ours, theirs = ([c for c in chosen if c.own == own] for own in (True, False))
            found[f"{target:g}, {group}"] = row = {"ours": first(ours, target), "peer": first(theirs, target)}
            row["ratio"] = row["peer"][1] / row["ours"][1] if math.isfinite(row["ours"][1]) else math.nan
            (a, x), (b, y) = row["ours"], row["peer"]
            word = "neither gets there" if min(x, y) == math.inf else f"ratio {row['ratio']:.2f}"
            print(f"  to {target:g}, {group}: {a} {1e3 * x:.1f} ms, {b} {1e3 * y:.1f} ms, {word}")
    return found


def first(curves, target):
    """Return (name, seconds) of the curve that reaches a target first; infinite seconds if none does."""
    times = [(curve.seconds_to(target), curve.name) for curve in curves]
    seconds, name = min(times, default=(math.inf, "none"))
    return (name if math.isfinite(seconds) else "none", seconds)
