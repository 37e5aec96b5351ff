"""A study as a folder: ``report.json`` for programs, ``report.html`` for readers, and the figures as PNG files.

The page needs nothing beside it, and the JSON is strict. A study that fails leaves an older report whole.
"""

import base64
import datetime
import io
import json
import math
import numbers
import os
import platform
import re
import tempfile
from html import escape
from importlib import metadata
from pathlib import Path

import jax
import numpy as np
from PIL import Image

STYLE = """:root { color-scheme: light dark }
body { max-width: 46rem; margin: 2.5rem auto; padding: 0 1rem; font: 1.05rem/1.55 Georgia, "Times New Roman", serif }
h1, h2, table, figcaption, footer { font-family: system-ui, sans-serif } h1 { line-height: 1.2 } h2 { margin-top: 2em }
figure { margin: 1.6rem 0; overflow-x: auto } img { max-width: 100%; background: white }
.pixels { image-rendering: pixelated; min-width: min(100%, 24rem) }
figcaption, footer { font-size: .88rem; line-height: 1.4; opacity: .8; margin-top: .4rem } footer { margin-top: 3rem }
table { border-collapse: collapse; font-size: .92rem } code { font-size: .9em }
th, td { padding: .25rem 1.2rem .25rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #8885 }
th.number, td.number { text-align: right; font-variant-numeric: tabular-nums }"""


class Report:
    """A folder in the making: each method adds to the end of the page, and ``save`` writes it."""

    def __init__(self, folder, title, seed=None):
        self.folder, self.title, self.seed = writable_folder(folder), str(title), seed
        self._body, self._values, self._tables, self._figures = [], {}, [], []

    def section(self, title):
        """Start a section."""
        self._body.append(f"<h2>{escape(str(title))}</h2>")

    def text(self, text):
        """Add paragraphs, separated by empty lines, with ``**bold**``, ``*emphasis*`` and `` `code` ``."""
        self._body += [f"<p>{_inline(paragraph)}</p>" for paragraph in re.split(r"\n\s*\n", str(text).strip())]

    def value(self, key, value):
        """Record a number, string, array, or a list, dict or NamedTuple of them; ``key`` keeps its latest value."""
        self._values[str(key)] = _plain(value, str(key))

    def values(self, mapping):
        """Record every item of a dict."""
        self._values.update(_plain(dict(mapping), "values"))

    def table(self, headers, rows, caption=""):
        """Add a table. The page shows six digits and aligns numbers right; ``report.json`` keeps every digit."""
        headers, rows = [str(header) for header in headers], [_plain(list(row), f"table {caption!r}") for row in rows]
        if wrong := [row for row in rows if len(row) != len(headers)]:
            raise ValueError(f"A row of a table needs one cell for each of the headers {headers}, but {wrong[0]} came.")
        self._tables.append({"caption": str(caption), "headers": headers, "rows": rows})
        self._body.append(_table(headers, rows, caption))

    def figure(self, fig, name, caption=""):
        """Save a matplotlib figure as ``name.png`` and show it; returns the file's path."""
        buffer = io.BytesIO()
        fig.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
        return self._picture(buffer.getvalue(), name, caption, "figure")

    def image(self, pixels, name, caption=""):
        """Save an array of pixels, one for one, as ``name.png`` and show it; returns the file's path.

        ``pixels`` has shape ``(height, width)`` or ``(height, width, 3)`` and is ready to be displayed: ``uint8``, or
        numbers where 0 is black and 1 is white. Others are clipped, and a pixel that is not finite is magenta.
        """
        return self._picture(_png(np.asarray(pixels)), name, caption, "pixels")

    def save(self):
        """Write ``report.json`` and ``report.html``; returns the path of the page."""
        about = {"date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), "seed": self.seed}
        about = _plain({**about, "versions": versions(), "machine": machine()}, "report")
        facts = {"title": self.title, "values": self._values, "tables": self._tables, "figures": self._figures, **about}
        _write(self.folder, {"report.json": _json(facts), "report.html": self._page(about).encode()})
        return self.folder / "report.html"

    def _picture(self, png, name, caption, kind):
        if not re.fullmatch(r"\w[\w.-]*", name) or any(name == figure["name"] for figure in self._figures):
            raise ValueError(f"A figure needs a new name of letters, digits, '-', '_' and '.', but {name!r} came.")
        _write(self.folder, {f"{name}.png": png})
        self._figures.append({"name": name, "file": f"{name}.png", "caption": str(caption)})
        image = f'<img class="{kind}" alt="{name}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
        self._body.append(_figure(image, caption))
        return self.folder / f"{name}.png"

    def _page(self, about):
        values = ["<h2>Values</h2>", _table(["name", "value"], self._values.items(), "")] if self._values else []
        facts = about["versions"] | about["machine"] | {"date": about["date"], "seed": about["seed"]}
        footer = " · ".join(f"{key}: {_cell(value)}" for key, value in facts.items() if value is not None)
        body = [f"<h1>{escape(self.title)}</h1>", *self._body, *values, f"<footer>{escape(footer)}</footer>"]
        head = f'<meta charset="utf-8"><title>{escape(self.title)}</title><style>\n{STYLE}\n</style>'
        return "\n".join(['<!doctype html><html lang="en">', f"<head>{head}</head><body>", *body, "</body></html>"])


def writable_folder(path) -> Path:
    """Make a folder, or raise ``ValueError`` where that is impossible or nothing can be written there."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        problem = f"The folder {str(folder)!r} cannot be written ({error.strerror})."
        raise ValueError(f"{problem} Name another folder, or change the permissions of this one.") from error
    return folder


def write_json(file, value):
    """Write a number, string, array, or a list, dict or NamedTuple of them as strict JSON: all of it or nothing.

    NaN becomes null, infinities the strings "inf" and "-inf". Raises ``ValueError`` for other values, and where the
    folder of the file cannot be written.
    """
    file = Path(file)
    _write(writable_folder(file.parent), {file.name: _json(_plain(value, file.stem))})


def machine():
    """Return what timings depend on: processor, usable cores, platform, JAX's devices, and whether float64 is on."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*:\s*(.+)", info.read_text() if info.exists() else "")
    return {
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "platform": platform.platform(),
        "devices": [device.device_kind for device in jax.devices()],
        "float64": bool(jax.config.jax_enable_x64),
    }


def versions():
    """Return the versions of Python and of the packages that decide the results."""
    first = {name: next(iter(metadata.distributions(name=name)), None) for name in ("jaxmc", "jax", "jaxlib", "numpy")}
    return {"python": platform.python_version()} | {name: copy and copy.version for name, copy in first.items()}


def _plain(value, where):
    """Return ``value`` as strict JSON knows it: NaN becomes null, infinities the strings "inf" and "-inf"."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(float(value))
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _plain(np.asarray(value).tolist(), where)
    if isinstance(value, dict) or hasattr(value, "_asdict"):
        items = value.items() if isinstance(value, dict) else value._asdict().items()
        return {str(key): _plain(item, f"{where}.{key}") for key, item in items}
    if isinstance(value, list | tuple):
        return [_plain(item, where) for item in value]
    raise ValueError(f"{where}: a report holds numbers, strings, arrays, lists and dicts; {type(value).__name__} came.")


def _json(value):
    return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def _cell(value):
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        value = [f"{key}: {_cell(item)}" for key, item in value.items()]
    if isinstance(value, list):
        return ", ".join(map(_cell, value)) if len(value) <= 8 else f"{len(value)} entries, in report.json"
    return "–" if value is None else str(value)


def _table(headers, rows, caption):
    html = [[] for _ in range(len(rows) + 1)]
    for column in zip(headers, *(map(_cell, row) for row in rows)):
        # A column holds numbers if every cell starts like one: 12, -0.5, 0.26612(8), <1e-3.
        number = ' class="number"' if all(re.match(r"[-+±<>~]?\.?\d|–|inf|-inf", cell) for cell in column[1:]) else ""
        for i, cell in enumerate(column):
            html[i].append(f"<td{number}>{escape(cell)}</td>" if i else f"<th{number}>{escape(cell)}</th>")
    return _figure("<table>" + "\n".join("<tr>" + "".join(row) for row in html) + "</table>", caption)


def _figure(content, caption):
    return f"<figure>{content}<figcaption>{_inline(str(caption))}</figcaption></figure>"


def _inline(text):
    parts = escape(text).split("`")
    for i, part in enumerate(parts):
        strong = re.sub(r"\*\*(\S.*?)\*\*", r"<strong>\1</strong>", part)
        parts[i] = f"<code>{part}</code>" if i % 2 else re.sub(r"\*(\S[^*]*)\*", r"<em>\1</em>", strong)
    return "".join(parts)


def _png(pixels):
    if pixels.ndim not in (2, 3) or pixels.shape[2:] not in ((), (3,)):
        raise ValueError(f"An image needs the shape (height, width) or (height, width, 3), but {pixels.shape} came.")
    pixels = np.broadcast_to(pixels.reshape(*pixels.shape[:2], -1), (*pixels.shape[:2], 3))
    if pixels.dtype != np.uint8:
        finite = np.isfinite(pixels).all(axis=2, keepdims=True)
        pixels = np.round(255 * np.clip(np.where(finite, pixels, (1, 0, 1)), 0, 1)).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "png")
    return buffer.getvalue()


def _write(folder, files):
    """Write every file of a dict name -> bytes beside its place, and only then move them there."""
    with tempfile.TemporaryDirectory(prefix=".writing-", dir=folder) as beside:
        for name, content in files.items():
            Path(beside, name).write_bytes(content)
        for name in files:
            os.replace(Path(beside, name), folder / name)
