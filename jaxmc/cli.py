"""The command line: ``jaxmc study | replay | bench``, and the commands of other packages, such as ``jaxmc scenes``."""

import argparse
import sys
from importlib import metadata

from . import __version__, bench, scenes
from .known import COMMANDS, collection
from .studies import calibration, diffuse_emissive, mirror_box, primitives, sparkles, stability
from .transport.debug import replay


def main(arguments=None) -> int:
    """Run the command line; return 0, or 2 after a one-line error that says what to change."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except ValueError as error:
        print(f"jaxmc: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("jaxmc: interrupted", file=sys.stderr)
        return 130


def _parser():
    parser = argparse.ArgumentParser(prog="jaxmc", description="Monte Carlo light transport, with error bars.")
    parser.add_argument("--version", action="version", version=f"jaxmc {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    study = commands.add_parser("study", help="run a study and write its report").add_subparsers(
        required=True, metavar="STUDY"
    )
    mirror = study.add_parser("mirror-box", help="why the mirror box sparkles, and what clamping costs")
    mirror.add_argument("--spp", type=int, default=2048, help="samples per pixel of the references (default 2048)")
    mirror.set_defaults(run=_study_mirror_box)
    sparkle = study.add_parser("sparkles", help="uniform against cosine-weighted directions in a box with a gap")
    sparkle.add_argument("--paths", type=int, default=1 << 24, help="paths searched for the extreme one (default 2^24)")
    sparkle.set_defaults(run=_study_sparkles)
    calibrate = study.add_parser("calibration", help="do intervals cover known integrals as often as they say?")
    calibrate.add_argument("--replicates", type=int, default=300, help="estimates of each integral (default 300)")
    calibrate.set_defaults(run=_study_calibration)
    stable = study.add_parser("stability", help="what rounding does: scenes, rays and numbers at their limits")
    stable.add_argument(
        "--events", type=int, default=10**7, help="scattering events in each closed room (default 10^7; 10^9 is a test)"
    )
    stable.add_argument(
        "--scenes",
        default=collection(),
        help="scenes whose bias is measured, as module:name (default: those that `jaxmc scenes` lists)",
    )
    stable.set_defaults(run=_study_stability)
    diffuse = study.add_parser("diffuse-emissive", help="what naive paths hit: why a small light is noise")
    diffuse.add_argument("--spp", type=int, default=256, help="most samples per pixel (default 256)")
    diffuse.add_argument("--size", type=int, default=128, help="width and height in pixels (default 128)")
    diffuse.set_defaults(run=_study_diffuse_emissive)
    kinds = study.add_parser("primitives", help="what triangles, quads and boxes cost, and 1 to 1000 spheres")
    kinds.add_argument("--spp", type=int, default=32, help="samples per pixel (default 32; the source has 100)")
    kinds.add_argument("--size", type=int, default=256, help="width and height (default 256; the source has 512)")
    kinds.add_argument("--rounds", type=int, default=3, help="renders of each build, in turn (default 3)")
    kinds.set_defaults(run=_study_primitives)
    studies = {"mirror-box": mirror, "sparkles": sparkle, "calibration": calibrate, "stability": stable}
    studies |= {"diffuse-emissive": diffuse, "primitives": kinds}
    for name, command in studies.items():
        command.add_argument("--out", default=f"out/{name}", help=f"folder of the report (default out/{name})")
        command.add_argument("--seed", type=int, default=0, help="seed (default 0)")
        command.add_argument("--quiet", action="store_true", help="no progress bar")

    again = commands.add_parser("replay", help="print one path of a study, vertex by vertex")
    replays = again.add_subparsers(required=True, metavar="STUDY")
    for name, run in (("mirror-box", _replay_mirror_box), ("sparkles", _replay_sparkles)):
        one = replays.add_parser(name)
        one.add_argument("--sample", type=int, required=True, metavar="INDEX", help="sample index, from the report")
        one.add_argument("--seed", type=int, default=0, help="seed of the study (default 0)")
        one.set_defaults(run=run)
    race = commands.add_parser("bench", help="error against run time of every sampler, and of other integrators")
    race.add_argument("name", nargs="?", default="oscillatory", help="integrand: a known name or module:function")
    race.add_argument("--dim", type=int, help="dimensions, where the integrand comes in any (most are made for 8)")
    race.add_argument("--max-seconds", type=float, default=30.0, help="time to measure, besides compiling (default 30)")
    race.add_argument("--out", default="out/bench", help="folder of figure and numbers (default out/bench)")
    race.set_defaults(run=_bench)
    for point in metadata.entry_points(group=COMMANDS):
        try:
            point.load()(commands)
        except (ImportError, AttributeError) as error:
            print(f"jaxmc: the command {point.name} of {point.value} is missing: {error}", file=sys.stderr)
    return parser


def _bench(options):
    if not options.max_seconds > 0:
        raise ValueError(f"--max-seconds must be positive, got {options.max_seconds}")
    bench.run(options.name, options.dim, options.max_seconds, options.out)
    return 0


def _study_mirror_box(options):
    settings = mirror_box.Settings(spp=options.spp, seed=_seed(options), progress=not options.quiet)
    print(f"report: {mirror_box.run(options.out, settings)}")
    return 0


def _study_sparkles(options):
    settings = sparkles.Settings(paths=options.paths, seed=_seed(options), progress=not options.quiet)
    print(f"report: {sparkles.run(options.out, settings)}")
    return 0


def _study_calibration(options):
    settings = calibration.Settings(replicates=options.replicates, seed=_seed(options), progress=not options.quiet)
    print(f"report: {calibration.run(options.out, settings)}")
    return 0


def _study_stability(options):
    settings = stability.Settings(
        events=options.events, scenes=options.scenes, seed=_seed(options), progress=not options.quiet
    )
    print(f"report: {stability.run(options.out, settings)}")
    return 0


def _study_diffuse_emissive(options):
    settings = diffuse_emissive.Settings(
        spp=options.spp, size=options.size, seed=_seed(options), progress=not options.quiet
    )
    print(f"report: {diffuse_emissive.run(options.out, settings)}")
    return 0


def _study_primitives(options):
    settings = primitives.Settings(
        size=options.size, spp=options.spp, rounds=options.rounds, seed=_seed(options), progress=not options.quiet
    )
    print(f"report: {primitives.run(options.out, settings)}")
    return 0


def _replay_mirror_box(options):
    scene, camera = scenes.mirror_box()
    print(replay(scene, camera, options.sample, key=_seed(options) << 8, **mirror_box.PATHS))
    return 0


def _replay_sparkles(options):
    print(sparkles.extreme_path(options.sample, _seed(options)))
    return 0


def _seed(options):
    if not 0 <= options.seed < 1 << 32:
        raise ValueError(f"--seed must lie between 0 and 2^32 - 1, got {options.seed}")
    return options.seed


if __name__ == "__main__":
    sys.exit(main())
