"""Images as files: what a screen shows as PNG, and the linear values themselves, whose range is kept.

A file appears whole or not at all: who looks at it while it is written again sees the old one or the new one.
"""

import io
import os
import tempfile
from pathlib import Path

import numpy as np

LINEAR = (".npy", ".npz", ".pfm")


def tone_map(image, exposure=1.0):
    """Return display values in [0, 1] of a linear image: clip, then gamma 1 / 2.2. NaN becomes magenta."""
    image = np.asarray(image, float) * exposure
    bad = ~np.isfinite(image).all(-1)
    shown = np.clip(np.nan_to_num(image), 0.0, 1.0) ** (1.0 / 2.2)
    shown[bad] = (1.0, 0.0, 1.0)
    return shown


def png(image, exposure=1.0) -> bytes:
    """Return a linear image of shape ``(height, width, 3)`` as PNG, after ``tone_map``."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(np.round(255.0 * tone_map(image, exposure)).astype(np.uint8)).save(content, "PNG")
    return content.getvalue()


def linear(suffix: str, image, **further) -> bytes:
    """Return the values of an image, shape ``(height, width)`` or ``(height, width, 3)``, as float32 in a file.

    Args:
        suffix: ".npy", the array; ".npz", the array ``image`` and those of ``further`` by name; ".pfm", a portable
            float map (P. Debevec): rows from the bottom to the top, little-endian.
    """
    image, content = np.asarray(image, np.float32), io.BytesIO()
    if suffix == ".npz":
        np.savez(content, image=image, **{name: np.asarray(x, np.float32) for name, x in further.items()})
    elif suffix == ".npy":
        np.save(content, image)
    else:
        kind = "PF" if image.ndim == 3 else "Pf"
        content.write(f"{kind}\n{image.shape[1]} {image.shape[0]}\n-1.0\n".encode())
        content.write(image[::-1].astype("<f4").tobytes())
    return content.getvalue()


def writable(path, suffixes) -> Path:
    """Return the path of a file that is to be written, its folder made if need be.

    Raises:
        ValueError: another suffix than those, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"the name of the file must end in {' or '.join(suffixes)}, got {str(path)!r}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ValueError(f"{str(path)!r} cannot be written ({error.strerror}). Name another file") from error
    return path


def write(path: Path, content: bytes) -> None:
    """Write a file beside its place, then move it there."""
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as beside:
        unfinished = Path(beside, path.name)
        unfinished.write_bytes(content)
        os.replace(unfinished, path)
