"""How the derivatives of paths are sampled."""

import dataclasses
from typing import cast

from ..transport.strategy import PathOptions, Strategy

SAMPLING = "detached", "attached"


class MovingOptions(PathOptions, total=False):
    """Options of moving integrands: those of path integrands, and

    sampling: what stays of a direction that is drawn while the scene moves: "detached", what it has met; "attached",
        the random numbers that draw it, so that it turns with its surface and spreads with the roughness. Attached
        derivatives by the roughness of metals have less variance; most by places have more and heavier tails, since
        all edges count. "detached".
    """

    sampling: str


@dataclasses.dataclass(frozen=True)
class MovingStrategy(Strategy):
    """The static options of a moving integrand, see ``MovingOptions``."""

    sampling: str = "detached"

    def __post_init__(self):
        super().__post_init__()
        if self.sampling not in SAMPLING:
            raise ValueError(f"sampling must be one of {', '.join(SAMPLING)}, got {self.sampling!r}")

    @property
    def is_attached(self) -> bool:
        """Whether directions keep their random numbers."""
        return self.sampling == "attached"


def of_paths(options: MovingOptions) -> PathOptions:
    """Return the options of the path integrand that has the same value."""
    return cast(PathOptions, {name: value for name, value in options.items() if name != "sampling"})
