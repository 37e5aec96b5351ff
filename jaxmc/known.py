"""Integrals of known value that installed packages offer by name: entry points of the group ``jaxmc.integrands``.

Each leads to a function; what that returns has a ``name``, an ``integrand`` and its ``exact`` integral. Those of
analytic_scenes, which comes with jaxmc, are found in this way only: nothing in jaxmc imports that package.
"""

import importlib
from collections.abc import Callable
from importlib import metadata

GROUP = "jaxmc.integrands"
COMMANDS = "jaxmc.commands"  # functions that add a command of another package to those of argparse


def offered() -> dict[str, str]:
    """Return where each integral on offer is made, ``module:function``, by name."""
    return {point.name: point.value for point in metadata.entry_points(group=GROUP)}


def maker(name: str) -> Callable:
    """Return the function behind a name on offer, or behind ``module:function``; raises ``ValueError`` without one."""
    points = offered()
    module, _, function = points.get(name, name).partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        known = f"one of {', '.join(sorted(points))}" if points else "install jaxmc again to use its names"
        cure = "install the package again" if name in points else f"name a module:function, or {known}"
        raise ValueError(f"no integrand {name!r} ({error}): {cure}") from error


def collection() -> str | None:
    """Return where the scenes of ``jaxmc scenes`` are, ``module:name``; None where no package has that command."""
    points = [point for point in metadata.entry_points(group=COMMANDS) if point.name == "scenes"]
    return f"{points[0].module.partition('.')[0]}:ALL" if points else None
