"""The command line: ``jaxmc render | replay | study | bench``, and commands of other packages: ``jaxmc scenes``."""

import argparse
import sys
from importlib import metadata

from . import __version__, bench, render_command
from .known import COMMANDS, collection
from .render_command import seed as _seed
from .studies import calibration, caustic, flat_vs_nested, light_sampling, mirror_box, sparkles, stability


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

    render_command.add_commands(commands)
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
    flat = study.add_parser("flat-vs-nested", help="two nested integrals, or one flat one; recursion that branches")
    flat.add_argument("--rays", type=int, default=4096, help="rays of one estimate, a power of two (default 2^12)")
    flat.set_defaults(run=_study_flat_vs_nested)
    sampling = study.add_parser("light-sampling", help="how paths find light: every strategy beside exact values")
    sampling.add_argument("--samples", type=int, default=1 << 20, help="samples of one estimate (default 2^20)")
    sampling.set_defaults(run=_study_light_sampling)
    small_light = study.add_parser("caustic", help="a caustic of a small light, which no local sampler finds")
    small_light.add_argument("--spp", type=int, default=256, help="samples per pixel of the pictures (default 256)")
    small_light.add_argument("--samples", type=int, default=1 << 22, help="samples of one point (default 2^22)")
    small_light.set_defaults(run=_study_caustic)
    studies = {"mirror-box": mirror, "sparkles": sparkle, "calibration": calibrate, "stability": stable}
    studies |= {"flat-vs-nested": flat, "light-sampling": sampling, "caustic": small_light}
    for name, command in studies.items():
        command.add_argument("--out", default=f"out/{name}", help=f"folder of the report (default out/{name})")
        command.add_argument("--seed", type=int, default=0, help="seed (default 0)")
        command.add_argument("--quiet", action="store_true", help="no progress bar")

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


def _study_flat_vs_nested(options):
    settings = flat_vs_nested.Settings(rays=options.rays, seed=_seed(options), progress=not options.quiet)
    print(f"report: {flat_vs_nested.run(options.out, settings)}")
    return 0


def _study_light_sampling(options):
    settings = light_sampling.Settings(samples=options.samples, seed=_seed(options), progress=not options.quiet)
    print(f"report: {light_sampling.run(options.out, settings)}")
    return 0


def _study_caustic(options):
    settings = caustic.Settings(
        spp=options.spp, samples=options.samples, seed=_seed(options), progress=not options.quiet
    )
    print(f"report: {caustic.run(options.out, settings)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
