"""Numbers that count something: samples, coordinates, pixels."""

import math

import numpy as np

MOST = (1 << 63) - 1


def is_count(value, least: int = 1, most: float = MOST) -> bool:
    """Return whether ``value`` is an integer, Python's or NumPy's, from ``least`` to ``most``; a bool is none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and least <= int(value) <= most


def positive(name: str, value, most: int = MOST, cure: str = "") -> int:
    """Return ``value`` as an int; raises ``ValueError``, with the ``cure``, if it is no integer from 1 to ``most``."""
    if not is_count(value, most=most):
        limit = f" up to {most}" if is_count(value, most=math.inf) else ""
        raise ValueError(f"{name} must be a positive integer{limit}, got {value!r}" + (f"; {cure}" if cure else ""))
    return int(value)
