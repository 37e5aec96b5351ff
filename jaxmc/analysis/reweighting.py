"""Images from layers of brightness: samples count by how many others, here and in pixels around, are as bright.

Both functions take the sums of all pixels, row by row, and ``width``, the number of pixels in a row; None makes each
pixel stand alone. Pixels beyond the border do not exist.
"""

from typing import NamedTuple

import numpy as np

from ..integration.layers import CascadeSums, LayerSums

ROUNDING = 1e-4  # of a soft count: that of a lone sample is 1, and must not be above 1 by rounding


def resolve_cascade(
    sums: CascadeSums, *, rule: str = "paper", kappa: float = 1.0, width: int | None = None, floor: float = 0.05,
    kappa_min: float = 1.0,
) -> np.ndarray:  # fmt: skip
    """Return the image in which layers of few samples count less, shape (items..., components...).

    From dark to bright, layer i of height b_i is added with a weight up to 1. N is the soft count of the layer and its
    two neighbours, and around the mean of that over 3 x 3 pixels; Y is the brightness of what was added so far.

    ``rule="paper"``: 0 unless around > kappa_min, else the larger of (N - kappa_min) / kappa and n Y / (kappa b_i),
    each up to 1. ``rule="glsl2020"``, that of the authors' later viewer: the mean of two reliabilities, from the counts
    (N - 1) / kappa, with the mean around in place of N where that is below 1, and from the colour
    n max(Y, floor) / (kappa b_i), times up to 1 + 0.6 (base - 1) where kappa > 1.

    A large ``kappa`` asks for more samples of a kind before it is believed. It must be far below n, or the lowest
    layer, the picture itself, is darkened too. Biased low, by less the more samples; consistent, but for the light
    above the top layer, which is left out: ``sums.value[-1]``. The plain mean is ``sums.value.sum(0)``.

    Source: Zirr, Hanika & Dachsbacher (2018), see ``Cascade``.
    Raises ValueError for another rule, a kappa that is not positive, or a width that does not divide the image.
    """
    if rule not in ("paper", "glsl2020"):
        raise ValueError(f'rule must be "paper" or "glsl2020", got {rule!r}')
    if not kappa > 0.0:
        raise ValueError(f"kappa must be positive, got {kappa}")
    soft, n = sums.soft_count, sums.n
    none = np.zeros_like(soft[:1])
    local = np.concatenate([none, soft[:-1]]) + soft + np.concatenate([soft[1:], none])
    around = _mean_around(local, width)
    lenience = 1.0 + 0.6 * (sums.base - 1.0) * (1.0 - min(1.0, 1.0 / kappa))
    result, brightness = np.zeros_like(sums.value[0]), np.zeros_like(soft[0])
    for i in range(len(soft)):
        height = sums.start * sums.base**i
        if rule == "paper":
            counted, shone = (local[i] - kappa_min) / kappa, n * brightness / (kappa * height)
            weight = np.where(around[i] > kappa_min + ROUNDING, np.maximum(counted, shone), 0.0)
        else:
            counted = np.where(around[i] >= 1.0 - ROUNDING, local[i] - 1.0, around[i] - 1.0) / kappa
            weight = 0.5 * (counted + n * np.maximum(brightness, floor) / (kappa * height) * lenience)
        weight = np.clip(weight, 0.0, 1.0)
        result = result + _each(weight, result) * sums.value[i]
        brightness = brightness + weight * soft[i] * height / n
    return result


class Rejection(NamedTuple):
    """An image without the samples that stand alone.

    ``mean``: of the samples that were kept, shape (items..., components...); 0 where none was. ``kept``: the fraction
    of them, shape (items...). ``lost``: what the others add to the plain mean, in the shape of ``mean``.
    """

    mean: np.ndarray
    kept: np.ndarray
    lost: np.ndarray


def reject_sparse(sums: LayerSums, *, k: int = 1, width: int | None = None, tile: int = 1) -> Rejection:
    """Return the mean of the samples that have at least ``k`` others of like brightness close by.

    Close by are 3 x 3 tiles, squares of ``tile`` pixels side, and 3 bins of brightness: a bin of a tile is kept where
    these 27 cells hold at least k + 1 samples. Unlike a rule that looks at samples one after the other, this does not
    depend on their order. Biased low: a firefly counts only where there are others, so the bias goes to 0 no sooner
    than fireflies come in pairs.

    Source: DeCoro, Weyrich & Rusinkiewicz, "Density-based outlier rejection in Monte Carlo rendering", Computer
    Graphics Forum 29(7), 2010, with cells in place of a search for neighbours.
    Raises ValueError for k or a tile below 1, a width that does not divide the image, or tiles without a width.
    """
    if k < 1 or tile < 1:
        raise ValueError(f"expected k >= 1 and tile >= 1, got k={k}, tile={tile}")
    if width is None and tile != 1:
        raise ValueError("tiles are squares of pixels: say how many pixels are in a row, width=...")
    count = _as_rows(sums.count, width)
    cells = _tile_sums(count, tile)
    padded = np.pad(cells, [(1, 1)] + [(0, 0)] * (cells.ndim - 1))
    close = padded[:-2] + padded[1:-1] + padded[2:]
    close = close if width is None else _sum_around(close)
    keep = np.repeat(np.repeat(close >= k + 1, tile, 1), tile, 2)[:, : count.shape[1], : count.shape[2]]
    keep = keep.reshape(sums.count.shape)
    number = np.where(keep, sums.count, 0).sum(0)
    kept = np.where(_each(keep, sums.value), sums.value, 0.0).sum(0)
    lost = np.where(_each(keep, sums.value), 0.0, sums.value).sum(0)
    size = _each(number, kept)
    mean = np.divide(kept * sums.n, size, out=np.zeros_like(kept), where=size > 0)
    return Rejection(mean, number / sums.n, lost)


def _each(weight, value):
    """Return one weight for all components of a value."""
    return weight.reshape(weight.shape + (1,) * (value.ndim - weight.ndim))


def _as_rows(x, width):
    """Return sums over pixels, shape (layers, pixels), as (layers, height, width); pixels that stand alone in none."""
    pixels = int(np.prod(x.shape[1:]))
    if width is None:
        return x.reshape(len(x), pixels, 1)
    if width < 1 or pixels % width:
        raise ValueError(f"width must divide the number of pixels, {pixels}, got {width}")
    return x.reshape(len(x), -1, width)


def _mean_around(x, width):
    """Return means over 3 x 3 pixels, of those that exist."""
    if width is None:
        return x
    rows = _as_rows(x, width)
    return (_sum_around(rows) / _sum_around(np.ones_like(rows[:1]))).reshape(x.shape)


def _sum_around(x):
    """Return sums over 3 x 3 neighbours on the last two axes."""
    for axis in (-2, -1):
        widths = [(0, 0)] * x.ndim
        widths[axis] = (1, 1)
        padded, size = np.pad(x, widths), x.shape[axis]
        x = sum(np.take(padded, np.arange(size) + shift, axis) for shift in range(3))
    return x


def _tile_sums(x, tile):
    """Return sums over squares of pixels; those at the border may be smaller."""
    height, width = x.shape[1:]
    x = np.pad(x, [(0, 0), (0, -height % tile), (0, -width % tile)])
    return x.reshape(len(x), x.shape[1] // tile, tile, x.shape[2] // tile, tile).sum((2, 4))
