"""What decides the values of the samples of a run, as plain data: two runs of one recipe give the same bits."""

import hashlib
from typing import Any

import jax
import numpy as np

from .kernel import LANES, ROWS, evaluate
from .samplers import index_words
from .storage import name_of, to_plain

PART = ("n", "rows", "lanes", "indices", "chosen")  # in which parts of one estimate differ
CURES = {"jax": "go on with that release", "float64": "set JAX_ENABLE_X64 as it was", "platform": "go on there"}


def recipe(run, n, target=None) -> dict[str, Any]:
    """Return the recipe of a ``Run`` for ``n`` samples, or for a target."""
    points = run.points(n) if n is not None and run.replicates else None
    given, static = run.kernel_arguments(points or 1)
    return {
        "integrand": _fingerprint(given, static), "sampler": name_of(run.sampler),
        "seed": np.asarray(run.seed).tolist(),
        "tallies": to_plain(run.sums.tallies), "n": n, "points": points, "replicates": run.replicates,
        "items": run.items, "rows": run.rows, "lanes": run.lanes,
        "together": run.integrand.together and run.lanes, "target": to_plain(target and vars(target)),
        "indices": run.part.about.get("indices"), "chosen": _digest([run.part.chosen]),
        "float64": bool(jax.config.jax_enable_x64), "platform": jax.default_backend(), "jax": jax.__version__,
    }  # fmt: skip


def difference(a: dict[str, Any], b: dict[str, Any], ignored=()) -> str | None:
    """Return in words in what recipe b differs from a; None if in nothing but what is ignored."""
    for name in (name for name in a if name not in ignored):
        if a[name] != b.get(name):
            if name in ("integrand", "tallies", "chosen"):
                what = {"integrand": "integrand, in its code or its parameters", "chosen": "tiles"}.get(name, name)
                return f"another {what}"
            cure = f"; {CURES[name]}" if name in CURES else ""
            return f"{name} {a[name]}, not {b.get(name)}{cure}"
    return None


def _fingerprint(given, static):
    """Return a digest of what the compiler gets for a block of samples, and of the values of all parameters."""
    base, offset = np.zeros((1, ROWS), np.uint64), np.zeros((1, LANES), np.uint32)
    lowered = evaluate.lower(*given, index_words(base), offset, np.zeros((1, LANES), np.int32), **static)
    return _digest([np.frombuffer(lowered.as_text().encode(), np.uint8), *jax.tree.leaves(given[0])])


def _digest(arrays):
    found = hashlib.sha256()
    for x in arrays:
        if isinstance(x, jax.Array) and jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
            x = jax.random.key_data(x)
        x = np.asarray([] if x is None else x)
        found.update(f"{x.dtype}{x.shape}".encode() + np.ascontiguousarray(x).tobytes())
    return found.hexdigest()[:32]
