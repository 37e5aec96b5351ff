"""Path regularization: surfaces are less sharp to a path that has scattered before, so that light sampling reaches over
mirrors. What a camera sees by itself or over mirrors alone stays sharp.

The integral is another one, of a scene whose mirrors are blurred for light that comes by diffuse surfaces: there is a
bias, which moves light about and does not lose it, apart from what lobes lose below the horizon.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from .bsdfs import Kinds
from .primitives import is_number
from .vec import larger, smaller

LEAST_ROUGHNESS = 1e-3
# What ``amount`` is, where none is given, and its bounds: above, at most.
AMOUNTS = {
    "pbrt": (None, 0.0, 0.0),
    "cone": (0.05, 0.0, 1.5),
    "opsr": (0.5, 0.0, 1.0),
    "max_prev": (1.0, 0.0, 1.0),
}


@dataclasses.dataclass(frozen=True)
class Shrinking:
    """An amount ``first * i ** -power`` that falls with the number i of a sample, from 1: for ``render_progressively``.

    What blurs a mirror by the angle h has a bias of the order of h^2 and, where paths cannot find the light otherwise,
    a variance of the order of 1 / h^2. The mean of all samples is then consistent for a power between 0 and 1/2, and
    its squared error falls fastest, as n^(-2/3), for the default 1/6 (Kaplanyan and Dachsbacher 2013); see
    ``integrate_progressively``.

    Raises:
        ValueError: numbers that are not positive, or a power of 1/2 or more, whose error does not fall.
    """

    first: float
    power: float = 1.0 / 6.0

    def __post_init__(self):
        if not (is_number(self.first) and 0.0 < self.first < float("inf")):
            raise ValueError(f"first must be a positive amount, got {self.first!r}")
        if not (is_number(self.power) and 0.0 <= self.power < 0.5):
            raise ValueError(f"power must be in [0, 1/2), got {self.power!r}: from there on the variance does not fall")

    def __call__(self, i) -> float:
        """Return the amount of sample number ``i`` >= 1."""
        return self.first * float(i) ** -self.power


@partial(jax.tree_util.register_dataclass, data_fields=["amount"], meta_fields=["rule", "always"])
@dataclasses.dataclass(frozen=True)
class Regularize:
    """How mirrors and rough metals become less sharp once a path has met a surface that is neither mirror nor glass.

    A mirror that this makes a rough metal, or a cone, takes part in light sampling from then on. Glass stays as it is:
    there is no rough refraction here, so caustics that glass casts stay as noisy as they are. Diffuse surfaces have
    nothing to blur. ``directions`` must be "bsdf".

    =============  ============================================================================================
    ``rule``       what becomes of roughness alpha (GGX's; 0 for a mirror), and what ``amount`` is
    =============  ============================================================================================
    ``"pbrt"``     alpha below 0.3 becomes 2 alpha, kept within 0.1 and 0.3; no amount
    ``"cone"``     a mirror reflects evenly into the cone about the mirror direction whose half-angle is ``amount``
                   radians, in (0, 1.5], 0.05 by default: f cos = R / (2 pi (1 - cos amount)); metals stay as they are
    ``"opsr"``     1 - (1 - alpha) times the product of 1 - ``amount`` alpha_i over all earlier vertices, whose alpha_i
                   are those before the rule, 1 for a diffuse surface and 0 for glass; amount in [0, 1], 0.5 by default
    ``"max_prev"`` the larger of alpha and what the rule made of the vertex before, 1 for a diffuse surface; of that no
                   more than ``amount``, in (0, 1], 1 by default; glass passes on what came before it
    =============  ============================================================================================

    Roughness is kept at 1e-3 or more, so "opsr" with amount 0 is close to the mirror, not equal. All rules but "cone"
    lose the light that facets would reflect more than once.

    ``amount`` is a value: other amounts run the same kernel, and it may be traced. Derivatives with respect to the
    amount of "opsr" and "max_prev" are those of the integral: directions are held where they were drawn, and what they
    are worth changes. Those for "cone" lack the rim of the cone: use differences.

    Attributes:
        rule: one of the above.
        amount: see there; None for the default; a ``Shrinking`` in ``render_progressively``.
        always: from the first vertex on, also for what the camera sees over mirrors alone.

    Sources: "pbrt": Pharr, Ray Tracing Gems (2019), chapter 17, with the numbers of pbrt-v4; "cone": Kaplanyan and
    Dachsbacher, Path Space Regularization for Holistic and Robust Light Transport, CGF 32(2) (2013); "opsr": Weier et
    al., Optimised Path Space Regularisation, CGF 40(4) (2021), whose attenuation is a table, here one number, and whose
    paths go on from the surface as it was, here from the blurred one; "max_prev": Langlands and Fascione 2014.

    Raises:
        ValueError: an unknown rule, or an amount out of range.
    """

    rule: str = "pbrt"
    amount: Any = None
    always: bool = False

    def __post_init__(self):
        if not isinstance(self.rule, str) or self.rule not in AMOUNTS:
            raise ValueError(f"rule must be one of {', '.join(AMOUNTS)}, got {self.rule!r}")
        if not isinstance(self.always, bool):
            raise ValueError(f"always must be True or False, got {self.always!r}")
        if not is_number(self.amount):
            # None, or what JAX traces or takes apart.
            return
        default, above, most = AMOUNTS[self.rule]
        if default is None:
            raise ValueError(f"the rule {self.rule!r} has no amount, got {self.amount!r}; leave it out")
        if not above <= self.amount <= most or (self.amount == 0.0 and self.rule != "opsr"):
            raise ValueError(f"amount of {self.rule!r} must be above {above} and at most {most}, got {self.amount!r}")


def as_regularize(given) -> Regularize | None:
    """Return a ``Regularize`` as it is, or the one of a rule's name."""
    if given is None or isinstance(given, Regularize):
        return given
    if not isinstance(given, str):
        raise ValueError(f'regularize must be an mc.Regularize, a rule such as "pbrt", or None, got {given!r}')
    return Regularize(given)


def amount_of(regularize: Regularize):
    """Return the amount as a number for the kernel; 0 for a rule that has none."""
    default = AMOUNTS[regularize.rule][0]
    given = default if regularize.amount is None else regularize.amount
    if isinstance(given, Shrinking):
        raise ValueError(f"the amount {given!r} changes with the samples: use render_progressively, or given(i) of one")
    return jnp.asarray(0.0 if given is None else given, float)


def memory_at_start(regularize: Regularize | None):
    """Return what a rule remembers of a path that has met nothing: None where it remembers nothing."""
    starts = {"opsr": 1.0, "max_prev": 0.0}
    rule = regularize and regularize.rule
    return jnp.asarray(starts[rule], float) if rule in starts else None


def soften(scene, regularize: Regularize, kinds: Kinds, scattered, memory) -> tuple[Kinds, Any]:
    """Return what a surface is to a path, and what the rule remembers of it.

    ``scattered`` says whether the path has scattered before; ``memory`` is what the rule remembers.
    """
    mirror = kinds.mirror
    applies = jnp.ones((), bool) if regularize.always else scattered
    sharp = 1.0 if kinds.alpha is None else kinds.alpha
    if mirror is not None:
        sharp = jnp.where(mirror, 0.0, sharp)
    if kinds.dielectric is not None:
        sharp = jnp.where(kinds.dielectric, 0.0, sharp)
    blurred = blur(regularize.rule, sharp, scene.blur, memory)
    if regularize.rule == "max_prev":
        memory = jnp.where(applies | (sharp > 0.0), jnp.where(applies, blurred, sharp), memory)
    elif regularize.rule == "opsr":
        memory = memory * (1.0 - scene.blur * sharp)
    left = None if mirror is None or regularize.always else mirror & ~applies
    if regularize.rule == "cone":
        return kinds._replace(mirror=left, cone=None if mirror is None else mirror & applies), memory
    if mirror is None and kinds.rough is None:
        return kinds, memory
    rough = [flag for flag in (kinds.rough, None if mirror is None else mirror & applies) if flag is not None]
    alpha = larger(jnp.where(applies, blurred, sharp), LEAST_ROUGHNESS)
    return kinds._replace(mirror=left, rough=rough[0] | rough[-1], alpha=alpha), memory


def blur(rule: str, alpha, amount=None, memory=None):
    """Return the roughness that a rule makes of ``alpha``; ``memory`` as ``memory_at_start`` and ``soften`` give it."""
    if rule == "pbrt":
        return jnp.where(alpha < 0.3, jnp.clip(2.0 * alpha, 0.1, 0.3), alpha)
    if rule == "opsr":
        return 1.0 - (1.0 - alpha) * memory
    if rule == "max_prev":
        return larger(alpha, smaller(memory, amount))
    return alpha
