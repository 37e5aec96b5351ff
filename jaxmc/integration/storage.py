"""Files of sums and results: npz archives that appear whole or not at all, and that nothing in them can run.

A file holds one object: numbers, strings, arrays, and lists, tuples, dictionaries and ``storable`` classes of them. Its
arrays are members of the archive, the rest is JSON. Functions are kept by their names only. A checksum (SHA-256) covers
all of it, and is compared before anything is made of the content.
"""

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import re
import zipfile
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

FORMAT, VERSION = "jaxmc sums", 1
KINDS = "biuf"  # of arrays: bool, integers, floating point
Class = TypeVar("Class", bound=type)
_classes: dict[str, type] = {}


def storable(cls: Class) -> Class:
    """Let a NamedTuple, a dataclass or a class with plain attributes be part of files, under its own name."""
    _classes[cls.__name__] = cls
    return cls


class NotStored(NamedTuple):
    """What stands for a function, or another object that no file can hold: its name."""

    name: str

    def __call__(self, *args):
        raise ValueError(f"{self.name} is not part of a file; make the estimate anew to use it")


def save(path, value) -> None:
    """Write an object to a file: whole, or not at all.

    Raises:
        ValueError: something that no file can hold.
        OSError: the file cannot be written.
    """
    path = Path(path)
    # Always by the same name: what a kill leaves behind is written over by the next.
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        with unfinished.open("wb") as file:
            arrays = []
            head = {"format": FORMAT, "version": VERSION, "content": to_plain(value, arrays)}
            text = np.frombuffer(json.dumps(head).encode(), np.uint8)
            np.savez(file, head=text, checksum=_checksum(text, arrays), **{f"a{i}": x for i, x in enumerate(arrays)})
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def to_bytes(value) -> bytes:
    """Return an object as bytes for another process, without a checksum; ``from_bytes`` reads them."""
    arrays = []
    content = to_plain(value, arrays)
    head = json.dumps({"content": content, "arrays": [[x.dtype.str, x.shape] for x in arrays]}).encode()
    return b"".join([len(head).to_bytes(8, "little"), head, *(np.ascontiguousarray(x).data for x in arrays)])


def from_bytes(content: bytes) -> Any:
    """Return the object that ``to_bytes`` was given."""
    start = 8 + int.from_bytes(content[:8], "little")
    head, arrays, room = json.loads(content[8:start]), [], bytearray(content)
    for name, shape in head["arrays"]:
        dtype, count = np.dtype(name), math.prod(shape)
        arrays.append(np.frombuffer(room, dtype, count, start).reshape(shape))
        start += count * dtype.itemsize
    return from_plain(head["content"], arrays)


def is_storable(value) -> bool:
    """Return whether an object's class was made ``storable``, so that what it makes can be part of files."""
    return _classes.get(type(value).__name__) is type(value)


def load(path) -> Any:
    """Read what ``save`` wrote.

    Raises:
        ValueError: a file that is damaged, of another version, or none of ours; it is left as it is.
        OSError: the file cannot be read.
    """
    with open(path, "rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return _content(archive, os.fstat(file.fileno()).st_size)
        except Exception as error:  # a damaged archive fails in many ways
            raise ValueError(f"{path} is damaged, or no file of jaxmc: {str(error) or type(error).__name__}") from error


def _content(archive, room):
    members = {member.filename: member for member in archive.infolist()}
    if "head.npy" not in members:
        raise ValueError("it has no head")
    # Nothing of ours is compressed, so nothing grows while it is read.
    stored = all(m.compress_type == zipfile.ZIP_STORED and m.file_size == m.compress_size for m in members.values())
    if not stored or len(members) < len(archive.infolist()) or sum(m.file_size for m in members.values()) > room:
        raise ValueError("it was packed by another program")
    text = _array(archive, members["head.npy"])
    head = json.loads(text.tobytes())
    if head["format"] != FORMAT or head["version"] != VERSION:
        raise ValueError(f"it holds {head['format']!r}, version {head['version']!r}, and this is version {VERSION}")
    arrays = [_array(archive, members[f"a{i}.npy"]) for i in range(len(members) - 2)]
    if not np.array_equal(_array(archive, members["checksum.npy"]), _checksum(text, arrays)):
        raise ValueError("its checksum is another one")
    return from_plain(head["content"], arrays)


def _array(archive, member):
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{member.filename} is of another version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        if dtype.kind not in KINDS or math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise ValueError(f"{member.filename} has another size or type")
        # Arrays come back writable, for sums that go on.
        x = np.frombuffer(bytearray(file.read()), dtype)
        return x.reshape(shape[::-1]).T if fortran else x.reshape(shape)


def _checksum(text, arrays):
    found = hashlib.sha256(text.tobytes())
    for x in arrays:
        found.update(f"{x.dtype.str}{x.shape}".encode())
        found.update(np.ascontiguousarray(x).data)
    return np.frombuffer(found.digest(), np.uint8)


def _sync_folder(folder):
    """Make sure of a new name in a folder too, where folders can be synchronised."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def to_plain(value, arrays=None):
    """Return an object as JSON knows it. Arrays are appended to ``arrays``, or become lists if that is None."""

    def plain(x):
        if x is None or isinstance(x, bool | str):
            return x
        if isinstance(x, np.bool_ | np.integer):
            return x.item()
        if isinstance(x, float | np.floating):
            return {"float": float(x).hex()}
        if isinstance(x, int):
            return x
        if isinstance(x, np.ndarray):
            if x.dtype.kind not in KINDS:
                raise ValueError(f"arrays of type {x.dtype} cannot be stored")
            if arrays is None:
                return {"array": x.tolist()}
            arrays.append(x)
            return {"array": len(arrays) - 1}
        if isinstance(x, list):
            return [plain(one) for one in x]
        if isinstance(x, jax.tree_util.PyTreeDef):
            return {"tree": plain(_example(x))}
        if isinstance(x, dict):
            if not all(isinstance(key, str) for key in x):
                raise ValueError(f"a dictionary in a file has words as keys, got {list(x)}")
            return {"dict": {key: plain(one) for key, one in x.items()}}
        if is_storable(x):
            return {"class": type(x).__name__, "fields": {name: plain(one) for name, one in _fields(x).items()}}
        if isinstance(x, tuple):
            return {"tuple": [plain(one) for one in x]}
        return {"name": x.name if isinstance(x, NotStored) else name_of(x)}

    return plain(value)


def fits(value, like) -> bool:
    """Return whether an object has the types and shapes of another one inside.

    Where that has an empty list of numbers there may be a longer one, and where it has None, a whole number.
    """
    arrays, others = [], []
    plain, model = to_plain(value, arrays), to_plain(like, others)

    def same(a, b):
        if isinstance(b, dict) and "float" not in b:
            return isinstance(a, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in b)
        if isinstance(b, list):
            return isinstance(a, list) and len(a) == len(b) and all(map(same, a, b))
        if isinstance(b, dict):
            return isinstance(a, dict) and "float" in a
        return (b is None and isinstance(a, int)) or (type(a) is type(b) and (isinstance(b, int) or a == b))

    return same(plain, model) and all(
        x.dtype == y.dtype and (x.shape == y.shape or (x.ndim == 1 and y.shape == (0,)))
        for x, y in zip(arrays, others, strict=True)
    )


def name_of(x) -> str:
    """Return what an object prints as, without its place in memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", repr(x))


def _example(structure):
    """Return a tree of numbers of this structure; a list of them where the structure has classes of its own."""
    numbers = list(range(structure.num_leaves))
    tree = jax.tree.unflatten(structure, numbers)
    kept = from_plain(to_plain(tree), ())
    return kept if jax.tree.leaves(kept) == numbers else numbers


def _fields(x):
    if isinstance(x, tuple):
        return x._asdict()
    if dataclasses.is_dataclass(x):
        return {field.name: getattr(x, field.name) for field in dataclasses.fields(x)}
    return vars(x)


def from_plain(value, arrays):
    """Return the object that ``to_plain`` was given."""

    def made(x):
        if isinstance(x, list):
            return [made(one) for one in x]
        if not isinstance(x, dict):
            return x
        match x:
            case {"float": str(digits)}:
                return float.fromhex(digits)
            case {"array": int(index)} if 0 <= index < len(arrays):
                return arrays[index]
            case {"dict": dict(items)}:
                return {key: made(one) for key, one in items.items()}
            case {"tree": tree}:
                return jax.tree.structure(made(tree))
            case {"tuple": list(items)}:
                return tuple(made(one) for one in items)
            case {"name": str(name)}:
                return NotStored(name)
            case {"class": str(name), "fields": dict(fields)} if name in _classes:
                return _object(_classes[name], {key: made(one) for key, one in fields.items()})
        raise ValueError(f"it holds {str(x)[:80]}, which this jaxmc does not know")

    return made(value)


def _object(cls, fields):
    if issubclass(cls, tuple) or dataclasses.is_dataclass(cls):
        return cls(**fields)
    found = object.__new__(cls)
    vars(found).update(fields)
    return found
