"""Names of scenes as they are typed on a command line."""

import difflib
import re
import unicodedata
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from analytic_scenes.scene import AnalyticScene

NEAR = 0.6  # likeness, of 1, from which a word is taken for another one misspelt


def slug(name: str) -> str:
    """Return ``name`` in lower case, with its words joined by hyphens: "Sphere light, n=3" is "sphere-light-n-3"."""
    plain = unicodedata.normalize("NFKD", name.lower()).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9.]+", "-", plain).strip("-.")


def find(name: str, scenes: "Sequence[AnalyticScene] | None" = None) -> "AnalyticScene":
    """Return the scene called ``name``: by its name or slug, or else the only one whose slug contains it.

    ``scenes`` are ``analytic_scenes.ALL`` by default. Raises ``ValueError`` with names to choose from where no scene
    fits, or several do.
    """
    if scenes is None:
        from analytic_scenes import ALL as scenes
    wanted = slug(name)
    fitting = [s for s in scenes if wanted == s.slug] or [s for s in scenes if wanted and wanted in s.slug]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise ValueError(f"{name!r} fits {len(fitting)} scenes; name one: {', '.join(s.slug for s in fitting)}")
    near = sorted((-_likeness(wanted, s.slug), s.slug) for s in scenes)
    some = [other for likeness, other in near if -likeness >= NEAR][:5]
    raise ValueError(f"no scene {name!r}; {'near are ' + ', '.join(some) if some else '`jaxmc scenes` lists them all'}")


def _likeness(wanted, other):
    """Return how well the words of ``wanted`` occur in ``other``, from 0 to 1."""
    words = wanted.split("-")
    return sum(max(difflib.SequenceMatcher(None, a, b).ratio() for b in other.split("-")) for a in words) / len(words)
