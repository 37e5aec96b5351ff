"""The studies as commands: ``jaxmc study NAME``."""

import contextlib
import os
import shutil
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import jax

from .integration import machines
from .integration.checkpoint import SECONDS
from .integration.folders import kept_in
from .known import collection
from .render_command import find_scene, seed
from .report import writable_folder
from .studies import (
    calibration,
    caustic,
    cures,
    diffuse_emissive,
    flat_vs_nested,
    gradients,
    light_sampling,
    mirror_box,
    primitives,
    regularization,
    sparkles,
    stability,
)


class Study(NamedTuple):
    """A study: what it is about, its module, and its settings by name, each with its default and what it means."""

    about: str
    module: ModuleType
    settings: dict[str, tuple[Any, str]]


STUDIES = {
    "mirror-box": Study(
        "why the mirror box sparkles, and what clamping costs",
        mirror_box,
        {
            "spp": (2048, "samples per pixel of the references (default 2048)"),
            "all": (False, "the figures of the source too: clamped, regularized and re-weighted images"),
        },
    ),
    "regularization": Study(
        "what regularization keeps of the mirror box's caustic, and clamping does not",
        regularization,
        {"spp": (8192, "samples per pixel of the reference (default 8192)")},
    ),
    "sparkles": Study(
        "uniform against cosine-weighted directions in a box with a gap",
        sparkles,
        {"paths": (1 << 24, "paths searched for the extreme one (default 2^24)")},
    ),
    "calibration": Study(
        "do intervals cover known integrals as often as they say?",
        calibration,
        {"replicates": (300, "estimates of each integral (default 300)")},
    ),
    "stability": Study(
        "what rounding does: scenes, rays and numbers at their limits",
        stability,
        {
            "events": (10**7, "scattering events in each closed room (default 10^7; 10^9 is a test)"),
            "scenes": (
                collection(),
                "scenes whose bias is measured, as module:name (default: those that `jaxmc scenes` lists)",
            ),
        },
    ),
    "diffuse-emissive": Study(
        "what naive paths hit: why a small light is noise",
        diffuse_emissive,
        {
            "spp": (256, "most samples per pixel (default 256)"),
            "size": (128, "width and height in pixels (default 128)"),
        },
    ),
    "primitives": Study(
        "what triangles, quads and boxes cost, and 1 to 1000 spheres",
        primitives,
        {
            "spp": (32, "samples per pixel (default 32; the source has 100)"),
            "size": (256, "width and height (default 256; the source has 512)"),
            "rounds": (3, "renders of each build, in turn (default 3)"),
        },
    ),
    "flat-vs-nested": Study(
        "two nested integrals, or one flat one; recursion that branches",
        flat_vs_nested,
        {"rays": (4096, "rays of one estimate, a power of two (default 2^12)")},
    ),
    "light-sampling": Study(
        "how paths find light: every strategy beside exact values",
        light_sampling,
        {"samples": (1 << 20, "samples of one estimate (default 2^20)")},
    ),
    "caustic": Study(
        "a caustic of a small light, which no local sampler finds",
        caustic,
        {
            "spp": (256, "samples per pixel of the pictures (default 256)"),
            "samples": (1 << 22, "samples of one point (default 2^22)"),
        },
    ),
    "gradients": Study(
        "estimators of derivatives beside exact ones: bias, noise and cost",
        gradients,
        {"samples": (1 << 20, "samples of each part of an estimate (default 2^20)")},
    ),
}


def add_commands(commands) -> None:
    """Add ``study`` and its studies to what argparse's ``add_subparsers`` returned."""
    studies = commands.add_parser("study", help="run a study and write its report").add_subparsers(
        required=True, metavar="STUDY"
    )
    for name, study in STUDIES.items():
        command = studies.add_parser(name, help=study.about)
        for setting, (default, meaning) in study.settings.items():
            kind = {"type": int} if isinstance(default, int) else {"type": str}
            kind = {"action": "store_true"} if isinstance(default, bool) else kind
            command.add_argument(f"--{setting}", default=default, help=meaning, **kind)
        _add_common(command, f"out/{name}")
        command.set_defaults(run=_run, study=study)
    _add_cures(studies)


def _add_common(command, out):
    command.add_argument("--out", default=out, help=f"folder of the report (default {out})")
    command.add_argument("--seed", type=int, default=0, help="seed (default 0)")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.add_argument("--resume", action="store_true", help="go on where a run with these options was stopped")
    command.add_argument("--distributed", action="store_true", help="share the work with other processes, as JAX does")
    command.add_argument("--address", help="HOST:PORT of process 0 (default JAX_COORDINATOR_ADDRESS, or the cluster's)")
    command.add_argument("--processes", type=int, help="how many there are (default JAX_NUM_PROCESSES)")
    command.add_argument("--rank", type=int, help="the number of this one, from 0 (default JAX_PROCESS_ID)")
    command.add_argument(
        "--every", type=float, default=SECONDS, help="seconds between checkpoints, in OUT/.unfinished (default 10)"
    )


def _add_cures(studies):
    """Add the study that takes a scene."""
    command = studies.add_parser("cures", help="what every cure of fireflies costs, on any scene")
    command.add_argument("scene", metavar="SCENE", help="a scene or a file, as for `jaxmc render`")
    command.add_argument("--spp", type=int, default=32768, help="samples per pixel of the reference (default 2^15)")
    command.add_argument("--width", type=int, default=96, help="pixels in a row (default 96)")
    command.add_argument("--bounces", type=int, help="scattering events at most (default 5, or those of the study)")
    _add_common(command, "out/cures")
    command.set_defaults(run=_run_cures)


def _run_cures(options) -> int:
    kept = _joined(options)
    name, scene, camera, paths, _ = find_scene(options.scene)
    paths = {"bounces": 5, **paths, **({} if options.bounces is None else {"bounces": options.bounces})}
    given = {"spp": options.spp, "width": options.width, "seed": seed(options), "progress": not options.quiet}
    settings = cures.Settings(scene, camera, name, paths, **given)
    about = {"study": "cures", "scene": options.scene, "bounces": paths["bounces"], **given}
    return _report(options, kept, about, lambda: cures.run(options.out, settings))


def _run(options) -> int:
    kept = _joined(options)
    study = options.study
    chosen = {setting: getattr(options, setting) for setting in study.settings}
    settings = study.module.Settings(**chosen, seed=seed(options), progress=not options.quiet)
    about = {"study": study.module.__name__, **chosen, "seed": options.seed}
    return _report(options, kept, about, lambda: study.module.run(options.out, settings))


def _joined(options) -> Path:
    """Return the folder of checkpoints; join the other processes, of which the first writes the report."""
    kept = Path(options.out, ".unfinished")
    if options.distributed:
        variables = {"num_processes": "JAX_NUM_PROCESSES", "process_id": "JAX_PROCESS_ID"}
        given = {name: os.environ.get(variable) for name, variable in variables.items()}
        given = {name: None if word is None else int(word) for name, word in given.items()}
        for name, value in (("num_processes", options.processes), ("process_id", options.rank)):
            given[name] = given[name] if value is None else value
        try:
            jax.distributed.initialize(options.address, **given)
        except (RuntimeError, ValueError) as error:
            raise ValueError(f"--distributed needs --address, --processes and --rank: {error}") from error
        team = machines.join_processes()
        if team and team.rank:
            options.quiet, options.out = True, tempfile.mkdtemp()
    return kept


def _report(options, kept, about, run) -> int:
    """Run a study, with its estimates kept until it has ended."""
    writable_folder(options.out)
    about = {key: value for key, value in about.items() if key != "progress"}
    try:
        with kept_in(kept, about, options.resume, options.every):
            print(f"report: {run()}", flush=True)
    except ValueError:
        # Leave nothing behind of a run that could not begin.
        if not any(kept.glob("*.npz")):
            shutil.rmtree(kept, ignore_errors=True)
            with contextlib.suppress(OSError):
                Path(options.out).rmdir()
        raise
    except machines.LostProcess as error:
        print(f"jaxmc: {error}", file=sys.stderr, flush=True)
        os._exit(3)  # the end of `jax.distributed` would wait for the process that is lost
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(*stop.args, "the same command with --resume goes on") from None
    return 0
