"""The command ``jaxmc scenes``: what is known exactly, listed, or one scene with its formula, a picture and a check.

``jaxmc`` does not import this package: it finds ``add_command`` by the entry point ``jaxmc.commands``.
"""

import inspect
import textwrap
import types
from pathlib import Path

import numpy as np

import jaxmc as mc
from analytic_scenes.checking import check
from analytic_scenes.names import find
from analytic_scenes.scene import AnalyticScene

WIDTH = 100
SPP, BOUNCES = 64, 4  # of a picture


def add_command(commands) -> None:
    """Add the command to those of ``jaxmc``, the result of ``argparse``'s ``add_subparsers``."""
    command = commands.add_parser("scenes", help="scenes of known answer: list them, or show and check one")
    command.add_argument("name", nargs="?", help="a scene, by its name or a part that no other has; all without it")
    command.add_argument("--out", default="out/scenes", help="folder of the picture (default out/scenes)")
    command.add_argument("--seed", type=int, default=0, help="seed of the check (default 0)")
    command.add_argument(
        "--rel-precision", type=float, default=1e-3, help="relative standard error of the check (default 0.001)"
    )
    command.set_defaults(run=_run)


def _run(options):
    if options.name is None:
        from analytic_scenes import ALL

        print(listing(ALL))
        return 0
    scene = find(options.name)
    print(description(scene))
    result = check(scenes=[scene], rel_precision=options.rel_precision, key=options.seed)
    print(f"\ncheck\n{textwrap.indent(str(result), '  ')}")
    print(f"\npicture   {picture(scene, options.out) if scene.view else 'none: there is nothing to see'}")
    return 0 if result.passed else 1


def listing(scenes) -> str:
    """Return a table of scenes: slug, exact value, exact variance of one sample, number of derivatives, source."""
    width = max(len(scene.slug) for scene in scenes)
    lines = [f"{'name':{width}s} {'exact':>14s} {'variance':>10s} {'derivatives':>11s}  source"]
    for scene in scenes:
        variance = "-" if scene.exact_variance is None else f"{scene.exact_variance:.4g}"
        lines.append(
            f"{scene.slug:{width}s} {scene.exact:14.10g} {variance:>10s} {len(scene.derivatives):11d}  {scene.source}"
        )
    return "\n".join(lines)


def description(scene: AnalyticScene) -> str:
    """Return all that a scene knows about itself, with the source text of its formula."""
    variance = "not known" if scene.exact_variance is None else f"{scene.exact_variance:.10g}"
    kurtosis = "" if scene.exact_kurtosis is None else f", kurtosis {scene.exact_kurtosis:.6g}"
    facts = {
        "name": scene.slug,
        "geometry": scene.geometry or "not described",
        "exact": f"{scene.exact:.15g}, relative accuracy {scene.tolerance:.1g}",
        "variance": f"{variance}{kurtosis}: of one sample",
        "source": scene.source,
        "arguments": _values(scene.arguments),
        "derivatives": _values(scene.derivatives),
    }
    lines = [scene.name, ""]
    for name, text in facts.items():
        first, *rest = [piece for line in text.split("\n") for piece in textwrap.wrap(line, WIDTH) or [""]]
        lines += [f"{name:12s}{first}", *(f"{'':12s}{line}" for line in rest)]
    formula = "none in code" if scene.formula is None else f"\n{textwrap.indent(source_text(scene.formula), '  ')}"
    return "\n".join([*lines, f"formula     {formula}"])


def _values(values):
    lines = [
        f"{name} = {np.array2string(np.asarray(value), precision=10, threshold=12)}" for name, value in values.items()
    ]
    return "\n".join(lines) or "none"


def source_text(formula) -> str:
    """Return the source of a function, and of those of this package that it calls."""
    found: dict[str, str] = {}

    def add(function):
        function = inspect.unwrap(getattr(function, "func", function))
        if not isinstance(function, types.FunctionType) or function.__qualname__ in found:
            return
        try:
            found[function.__qualname__] = textwrap.dedent(inspect.getsource(function)).rstrip()
        except OSError:
            found[function.__qualname__] = f"{function.__qualname__}: its source cannot be read"
        for name in _names(function.__code__):
            called = function.__globals__.get(name)
            if getattr(called, "__module__", "").split(".")[0] == "analytic_scenes":
                add(called)

    add(formula)
    return "\n\n".join(found.values()) or repr(formula)


def _names(code):
    """Yield the names that a function uses, and those that functions inside it use."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def picture(scene: AnalyticScene, folder) -> Path:
    """Render a scene that has a view into ``folder`` as PNG, its brightest parts just white; return the file.

    Raises ``ValueError`` where there is no view, or the folder cannot be written.
    """
    from PIL import Image

    from jaxmc.plot import tone_map

    if scene.view is None:
        raise ValueError(f"the scene {scene.name!r} has no view; give it a function that returns (scene, camera)")
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"the folder {str(folder)!r} cannot be written ({error.strerror}). Name another one"
        ) from error
    image = np.asarray(mc.render(*scene.view(), spp=SPP, bounces=BOUNCES).mean)
    bright = float(np.percentile(image, 99.5)) or 1.0
    file = folder / f"{scene.slug}.png"
    Image.fromarray(np.round(255.0 * tone_map(image, 1.0 / bright)).astype(np.uint8)).save(file)
    return file
