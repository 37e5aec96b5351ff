"""Why one sample is large: what moves it, coordinate by coordinate, and how narrow the spike is on which it lies."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .draw import draw, is_index
from .integrand import Integrand, as_integrand
from .moments import apply
from .samplers import Independent

HALVINGS = 48  # of the way to the border of the cube, below which a spike counts as having no width
BISECTIONS = 12
AGREE = 0.01  # a value in float64 this close to that of the kernel, relatively, is of the same sample


class Spike(NamedTuple):
    """The surroundings of one sample.

    Attributes:
        index: of the sample.
        u: its point, shape (dim,).
        value: as the kernel gives it, one number.
        labels: what each coordinate decides.
        gradient: d log |value| / d u, shape (dim,). Its inverse is the width over which a smooth spike changes by a
            factor e; 0 on a plateau, where only ``extent`` tells how narrow it is.
        lower, upper: the interval of each coordinate around its own, all others as they are, in which the value stays
            at least half of what it is, shape (dim,).
        precise: whether gradient and interval are of float64.
    """

    index: int
    u: np.ndarray
    value: float
    labels: tuple[str, ...]
    gradient: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    precise: bool

    @property
    def extent(self) -> np.ndarray:
        """Width of each coordinate's interval: the probability to hit it, if all others are as they are."""
        return self.upper - self.lower

    @property
    def width(self) -> np.ndarray:
        """1 / |gradient|, infinite on a plateau."""
        with np.errstate(divide="ignore"):
            return 1.0 / np.abs(self.gradient)

    @property
    def chance(self) -> float:
        """Product of all extents: roughly how likely a sample on this spike is."""
        return float(np.prod(self.extent))

    @property
    def order(self) -> np.ndarray:
        """Coordinates from the narrowest extent to the widest: what should be drawn better comes first."""
        return np.lexsort((self.width, self.extent))

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return (coordinate, value, d log value / du, extent) for a table, narrowest first."""
        return [
            (self.labels[k], f"{self.u[k]:.6f}", f"{self.gradient[k]:.4g}", f"{self.extent[k]:.3g}") for k in self.order
        ]

    def __str__(self):
        narrow = [row for row in self.rows() if float(row[3]) < 0.5] or self.rows()[:3]
        head = f"{'coordinate':32} {'u':>9} {'d log c/du':>11} {'extent':>9}"
        rows = [f"{name:32} {u:>9} {slope:>11} {extent:>9}" for name, u, slope, extent in narrow]
        inverse = 1.0 / self.chance if self.chance > 0.0 else np.inf
        return "\n".join([head, *rows, f"about one sample in {inverse:,.3g} hits this spike"])


def spike(f, index: int, *, dim=None, key=0, sampler=Independent(), points=None, of=None, item=None) -> Spike:
    """Return what one sample of ``integrate`` depends on, from its index.

    The point is that of the kernel; gradient and extents are computed in float64, unless the value there is another
    one, as on an edge. The gradient is that of automatic differentiation along each coordinate; where the integrand
    jumps it does not see the jump, which the extent does.

    Args:
        f, dim, key, sampler: as in ``integrate``.
        index: of the sample, as ``TopSamples`` keeps it.
        points: ``estimate.recipe["points"]``, which ``LatinHypercube`` and ``Stratified`` must know.
        of: maps the value to one number, such as ``luminance``.
        item: the number of the integral, in a family of them.

    Raises:
        ValueError: an index out of [0, 2^64), a value that is no number, or a sample whose value is 0 or not finite.
    """
    if not is_index(index):
        raise ValueError(f"index must be an integer in [0, 2^64), got {index!r}")
    f = as_integrand(f, dim)
    items = () if item is None else (np.uint32(item),)
    f = Integrand(_Number(f.fn, of), f.dim, (*f.params, *items), f.lazy, f.labels)
    drawn = draw(f, indices=[int(index)], key=key, sampler=sampler, points=points)
    value, u = float(drawn.value[0]), drawn.u[0]
    if not (np.isfinite(value) and value != 0.0):
        raise ValueError(f"sample {index} has the value {value}: a spike needs one that is finite and not 0")
    wide = jax.tree.map(_widened, f)
    with jax.enable_x64(True):
        there, *found = _surroundings(wide, u.astype(np.float64))
    precise = abs(there - value) <= AGREE * abs(value)
    if not precise:
        _, *found = _surroundings(f, u)
    labels = f.labels or tuple(f"u[{k}]" for k in range(f.dim))
    return Spike(int(index), u.astype(np.float64), value, labels, *found, precise)


class _Number(NamedTuple):
    """A function of one point whose value is one number."""

    fn: Any
    of: Any

    def __call__(self, u, *params):
        value = apply(self.of, self.fn(u, *params))
        if jnp.shape(value):
            raise ValueError(f"a spike is of one number, got a value of shape {jnp.shape(value)}; pass of=mc.luminance")
        return value


def _widened(x):
    x = np.asarray(x)
    return x.astype(np.float64) if x.dtype.kind == "f" else x


@jax.jit
def _values(f, u):
    return jax.vmap(f)(u)


@jax.jit
def _gradient(f, u):
    # Forward mode goes through loops whose length is not known.
    value, slope = jax.vmap(partial(jax.jvp, f), in_axes=(None, 0))((u,), (jnp.eye(len(u), dtype=u.dtype),))
    return slope / value


def _surroundings(f, u):
    """Return value, gradient, lower and upper end of each coordinate's interval."""
    dim = len(u)
    value = float(_values(f, np.tile(u, (2 * dim, 1)))[0])
    least = 0.5 * value
    room = np.concatenate([u, 1.0 - u]) * (1.0 - 4.0 * np.finfo(u.dtype).eps)
    side = np.concatenate([-np.eye(dim), np.eye(dim)])

    def stays(steps):
        """Return whether the value stays where each coordinate goes down, then up, by ``steps``, shape (2 dim,)."""
        values = np.asarray(_values(f, (u + steps[:, None] * side).astype(u.dtype)))
        return values >= least if least > 0.0 else values <= least

    # Find the last halving of the way to the border that leads out, then the edge between it and the next one.
    inside, outside, seen_out = room.copy(), room.copy(), np.zeros(2 * dim, bool)
    for halving in range(HALVINGS):
        out = ~stays(room * 0.5**halving)
        outside = np.where(out, room * 0.5**halving, outside)
        inside = np.where(out, room * 0.5 ** (halving + 1), inside)
        seen_out |= out
    inside = np.where(stays(inside), inside, 0.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (inside + outside)
        stay = stays(middle)
        inside, outside = np.where(stay, middle, inside), np.where(stay, outside, middle)
    steps = np.where(seen_out, inside, np.concatenate([u, 1.0 - u]))
    return value, np.asarray(_gradient(f, u), np.float64), u - steps[:dim], u + steps[dim:]
