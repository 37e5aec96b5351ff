"""A comparison of cures as text: one line for each."""

import math
from typing import NamedTuple

from ..integration.estimate import with_error

LOST, SQUARED_BIAS, VARIANCE, MSE = "energy lost, %", "bias^2", "variance", "MSE"
MISSING = "–"


class Table(NamedTuple):
    """``headers`` and ``rows`` of text; numbers have the error of their last digits in brackets."""

    headers: list[str]
    rows: list[list[str]]

    @classmethod
    def of(cls, comparison) -> "Table":
        """Return the table of a ``Comparison``, the best clamp in its last line."""
        whole, counts = comparison.reference.mean(), comparison.counts
        headers = ["cure", "MSE from", "time"]
        headers += [f"{what}, N = {N}" for what in (MSE, LOST, SQUARED_BIAS, VARIANCE) for N in counts]
        rows = [_line(row, counts, whole) for row in comparison.rows]
        best = [short(b.mse, b.mse_stderr) for b in comparison.best.values()]
        words = ", ".join(f"{b.threshold:.3g}" for b in comparison.best.values())
        rows.append(
            [f"best clamp, t* = {words}", "bias^2 + variance / N", MISSING, *best, *[MISSING] * (3 * len(best))]
        )
        return cls(headers, rows)

    def short(self) -> "Table":
        """Return the columns that tell most: time, squared errors and the energy lost."""
        kept = [k for k, word in enumerate(self.headers) if not word.startswith((SQUARED_BIAS, VARIANCE))]
        return Table([self.headers[k] for k in kept], [[row[k] for k in kept] for row in self.rows])

    def __str__(self):
        widths = [max(map(len, column)) for column in zip(self.headers, *self.rows)]
        lines = [[word.ljust(w) for word, w in zip(line, widths)] for line in (self.headers, *self.rows)]
        return "\n".join("  ".join(line).rstrip() for line in lines)


def _line(row, counts, whole):
    at = [row.at.get(N) for N in counts]
    lost = [(-100.0 * m.bias / whole + 0.0, 100.0 * m.bias_stderr / whole) if m else None for m in at]
    pairs = [(m.mse, m.mse_stderr) if m else None for m in at] + lost
    pairs += [(m.squared_bias, m.squared_bias_stderr) if m else None for m in at]
    pairs += [(m.variance, m.variance_stderr) if m else None for m in at]
    how = "bias^2 + variance / N" if row.averages else "images"
    time = short(row.time, row.time_stderr) if math.isfinite(row.time) else MISSING
    return [row.name, how, time, *(MISSING if pair is None else short(*pair) for pair in pairs)]


def short(value: float, error: float) -> str:
    """Return ``4.51(3)e-4``: a number with the error of its last digits, a power of ten where it is small."""
    if not (math.isfinite(value) and math.isfinite(error)) or error == 0.0:
        return f"{value + 0.0:.3g}"
    size = max(abs(value), error)
    place = math.floor(math.log10(size))
    if -2 <= place < 4:
        return with_error(value, error)
    return f"{with_error(value * 10.0**-place, error * 10.0**-place)}e{place}"
