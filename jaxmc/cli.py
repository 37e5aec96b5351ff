"""The command line: ``jaxmc render | replay | merge | study | bench``, and those of other packages: ``scenes``."""

import argparse
import sys
from importlib import metadata

from . import __version__, bench, merge_command, render_command, study_commands
from .known import COMMANDS


def main(arguments=None) -> int:
    """Run the command line; return 0, or 2 after a one-line error that says what to change."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except ValueError as error:
        print(f"jaxmc: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print("jaxmc: interrupted" + "".join(f"; {word}" for word in stop.args), file=sys.stderr)
        return 130


def _parser():
    parser = argparse.ArgumentParser(prog="jaxmc", description="Monte Carlo light transport, with error bars.")
    parser.add_argument("--version", action="version", version=f"jaxmc {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    render_command.add_commands(commands)
    merge_command.add_command(commands)
    study_commands.add_commands(commands)
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


if __name__ == "__main__":
    sys.exit(main())
