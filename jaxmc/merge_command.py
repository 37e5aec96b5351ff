"""The command ``jaxmc merge``: one estimate from files of parts."""

import glob

from . import pictures
from .integration.estimate import Estimate
from .integration.merging import merge


def add_command(commands) -> None:
    """Add the command to what ``argparse``'s ``add_subparsers`` returned."""
    command = commands.add_parser("merge", help="one estimate from the files of its parts")
    command.add_argument("files", nargs="+", metavar="PART.npz", help="checkpoints, or what Estimate.save wrote")
    command.add_argument("--out", default="merged.npz", metavar="FILE.npz", help="the whole (default merged.npz)")
    command.add_argument("--picture", metavar="FILE.png", help="the image, where it is one")
    command.set_defaults(run=_run)


def _run(options) -> int:
    out = pictures.writable(options.out, (".npz",))
    picture = options.picture and pictures.writable(options.picture, (".png",))
    # Not every shell puts names in the place of part-*.npz.
    files = [name for word in options.files for name in (sorted(glob.glob(word)) or [word])]
    whole = merge(*map(_loaded, files))
    whole.save(out)
    if picture:
        if getattr(whole.mean, "ndim", None) != 3 or whole.mean.shape[2] != 3:
            raise ValueError("--picture is for images; leave it out")
        pictures.write(picture, pictures.png(whole.mean))
    print(f"merged {len(files)} parts: {', '.join(str(p) for p in (out, picture) if p)}\n{whole.summary()}")
    return 0


def _loaded(name) -> Estimate:
    try:
        return Estimate.load(name)
    except OSError as error:
        raise ValueError(f"{name!r} cannot be read ({error.strerror}); name another file") from error
