"""The commands ``jaxmc render`` and ``jaxmc replay``: an image of a scene, views into it, and its paths one by one."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import live, pictures, plot
from .integration.driver import REPLICATES_EACH
from .integration.lattices import Lattice
from .integration.nets import Halton, Sobol
from .integration.samplers import Independent
from .integration.stratified import LatinHypercube, Stratified
from .scenes import SCENES
from .studies import mirror_box, sparkles
from .transport import views
from .transport.camera import Camera
from .transport.debug import replay, sample_index
from .transport.images import render, render_progressively
from .transport.scene import Scene
from .transport.scene_files import load_scene
from .transport.strategy import CHOICES, THROUGHPUT

SAMPLERS = {
    "independent": Independent(), "sobol": Sobol(), "lattice": Lattice(), "halton": Halton(),
    "latin-hypercube": LatinHypercube(), "stratified": Stratified(),
}  # fmt: skip
# Studies that sample a scene in their own way: name of the scene, path options, stream of random numbers.
STUDIES = {
    "mirror-box": ("mirror-box", mirror_box.PATHS, 0),
    "sparkles": ("sparkle-box", {"bounces": max(sparkles.LENGTHS), "directions": "uniform", "lights": "none"}, 2),
}
LABELS = {
    "depth": "distance from the eye",
    "bounces": "scattering events of a path, mean",
    "variance": "relative variance of one sample",
    "fireflies": "fireflies among the samples",
    "time": "nanoseconds per sample",
}


def add_commands(commands) -> None:
    """Add both commands to those of ``jaxmc``, the result of ``argparse``'s ``add_subparsers``."""
    image = commands.add_parser("render", help="render a scene, or look inside it")
    _add_scene(image)
    image.add_argument("--out", metavar="FILE.png", help="picture for display (default out/render/SCENE.png)")
    image.add_argument("--hdr", metavar="FILE", help="linear float32 values too, as .npy, .npz or .pfm")
    image.add_argument("--exposure", type=float, default=1.0, help="factor before values are cut off at 1 (default 1)")
    image.add_argument("--view", choices=["image", "normals", *LABELS], default="image", help="what to show")
    image.add_argument(
        "--threshold", type=float, default=views.FIREFLY, help="luminance of a firefly (default %(default)g)"
    )
    image.add_argument("--preview", action="store_true", help="refine the picture in passes; Ctrl-C keeps it and ends")
    image.add_argument("--checkpoint", metavar="FILE.npz", help="keep the sums here, and go on from them after a kill")
    image.add_argument("--part", metavar="I/N", help="the I-th of N parts of the rows; `jaxmc merge` joins their files")
    image.add_argument("--quiet", action="store_true", help="no progress")
    image.set_defaults(run=_render)

    again = commands.add_parser("replay", help="print one path of a render or of a study, vertex by vertex")
    _add_scene(again)
    again.add_argument("--sample", type=int, required=True, metavar="S", help="sample of the pixel, or of the image")
    again.add_argument("--pixel", type=int, nargs=2, metavar=("X", "Y"), help="column and row, from the top left")
    again.set_defaults(run=_replay)


def _add_scene(command):
    command.add_argument("scene", metavar="SCENE", help=f"a JSON file, or one of {', '.join(dict(SCENES, **STUDIES))}")
    command.add_argument("--spp", type=int, default=64, help="samples per pixel (default 64)")
    command.add_argument("--width", type=int, help="pixels; the height follows if it is not given")
    command.add_argument("--height", type=int, help="pixels; the width follows if it is not given")
    command.add_argument("--bounces", type=int, help="scattering events at most (default 5, or those of the study)")
    command.add_argument("--lights", choices=CHOICES["lights"], help="how light is found (default mis)")
    command.add_argument("--directions", choices=CHOICES["directions"], help="how directions are drawn (default bsdf)")
    command.add_argument("--roulette", metavar="P", help=f'probability to survive an event, or "{THROUGHPUT}"')
    command.add_argument("--sampler", choices=list(SAMPLERS), default="independent", help="default independent")
    command.add_argument("--seed", type=int, default=0, help="seed (default 0); the key of mc.render is 256 times it")


class Shot(NamedTuple):
    """What the command line asks for: a scene with its camera, and the arguments of ``render``, ``spp`` aside."""

    name: str
    scene: Scene
    camera: Camera
    arguments: dict[str, Any]


def _shot(options) -> Shot:
    name, scene, camera, paths, stream = find_scene(options.scene)
    given = {key: getattr(options, key) for key in ("bounces", "lights", "directions")}
    given = {key: value for key, value in given.items() if value is not None}
    if options.roulette is not None:
        given["roulette"] = _roulette(options.roulette)
    if options.spp < 1:
        raise ValueError(f"--spp must be 1 or more, got {options.spp}")
    key, sampler = (seed(options) << 8) + stream, SAMPLERS[options.sampler]
    camera = _sized(camera, options.width, options.height)
    return Shot(name, scene, camera, {"bounces": 5, **paths, **given, "key": key, "sampler": sampler})


def find_scene(word) -> tuple[str, Scene, Camera, dict[str, Any], int]:
    """Return name, scene, camera, path options and stream of random numbers of a scene, a file, or a study.

    Raises ``ValueError`` for a name or a file that is none.
    """
    name, paths, stream = STUDIES.get(word, (word, {}, 0))
    return Path(name).stem, *_scene(name), paths, stream


def _scene(name) -> tuple[Scene, Camera]:
    """Return a scene by its name or from a file."""
    if name in SCENES:
        return SCENES[name]()
    if not (name.endswith(".json") or Path(name).exists()):
        known = ", ".join(dict(SCENES, **STUDIES))
        raise ValueError(f"no scene {name!r}: give the path of a JSON file, or one of {known}")
    try:
        scene, camera = load_scene(name)
    except OSError as error:
        raise ValueError(f"{name!r} cannot be read ({error.strerror}); name another file") from error
    if camera is None:
        raise ValueError(f"{name}: the file has no camera; add one")
    return scene, camera


def _sized(camera, width, height):
    if width is None and height is None:
        return camera
    aspect = camera.width / camera.height
    width = round(height * aspect) if width is None else width
    return views.resized(camera, width, round(width / aspect) if height is None else height)


def _roulette(word):
    try:
        return word if word == THROUGHPUT else float(word)
    except ValueError:
        raise ValueError(f'--roulette must be a probability or "{THROUGHPUT}", got {word!r}') from None


def seed(options) -> int:
    """Return the seed that was given; raises ``ValueError`` where it is out of range."""
    if not 0 <= options.seed < 1 << 32:
        raise ValueError(f"--seed must lie between 0 and 2^32 - 1, got {options.seed}")
    return options.seed


def _render(options):
    shot = _shot(options)
    name = shot.name if options.view == "image" else f"{shot.name}-{options.view}"
    out = pictures.writable(options.out or f"out/render/{name}.png", (".png",))
    hdr = options.hdr and pictures.writable(options.hdr, pictures.LINEAR)
    if not 0.0 < options.exposure < np.inf:
        raise ValueError(f"--exposure must be positive and finite, got {options.exposure}")
    if options.view != "image":
        if options.preview or options.checkpoint or options.part:
            raise ValueError("--preview, --checkpoint and --part are for the image; leave out --view")
        return _view(shot, options, out, hdr)
    if options.preview and (options.checkpoint or options.part):
        raise ValueError("--preview keeps no sums; leave out --checkpoint and --part")
    if options.preview:
        estimate, complete = _refine(shot, options, out)
    else:
        progress = None if options.quiet else shot.name
        kept = {"checkpoint": options.checkpoint, "tiles": _tiles(options.part, shot.camera), "progress": progress}
        estimate = render(shot.scene, shot.camera, spp=options.spp, **kept, **shot.arguments)
        complete = True
    pictures.write(out, pictures.png(estimate.mean, options.exposure))
    if hdr:
        values = pictures.linear(hdr.suffix.lower(), estimate.mean, stderr=estimate.stderr, variance=estimate.variance)
        pictures.write(hdr, values)
    print(f"{'image' if complete else 'interrupted; the image so far'}: {', '.join(str(p) for p in (out, hdr) if p)}")
    rate = estimate.n * shot.camera.width * shot.camera.height / estimate.seconds
    trouble = "" if estimate.status == "complete" else f"; {estimate.status}"
    print(f"{estimate.n:,} spp, compiling included {live.said(estimate, rate)}{trouble}")
    return 0 if complete else 130


def _tiles(part, camera):
    """Return the tiles of a part "I/N" of the rows of an image, or None for all of it."""
    if part is None:
        return None
    number, _, count = part.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count) <= camera.height):
        raise ValueError(f"--part must be I/N with I from 1 to N, and N at most {camera.height} rows, got {part!r}")
    first, last = ((int(number) - k) * camera.height // int(count) for k in (1, 0))
    return [(0, first, camera.width, last - first)]


def _refine(shot, options, out):
    """Render in passes, with the picture and a line of progress written after each of them."""
    terminal = live.Terminal()

    def show(estimate, line):
        pictures.write(out, pictures.png(estimate.mean, options.exposure))
        if not options.quiet:
            terminal.say(f"{shot.name}: {line}")

    passes = render_progressively(shot.scene, shot.camera, spp=options.spp, **shot.arguments)
    try:
        return live.refine(passes, show, options.spp)
    finally:
        terminal.end()


def _view(shot, options, out, hdr):
    """Write a view as a figure with its scale, and its values where asked."""
    scene, camera = shot.scene, shot.camera
    width, height = camera.width, camera.height
    figure, (ax,) = plot.panels(1, 1, (7.0 if options.view != "normals" else 8.5, 0.6 + 5.6 * height / width))
    if options.view == "normals":
        values = views.view_normals(scene, camera)
        plot.normals(ax, values)
    else:
        values = _values(shot, options)
        shown = values * 1e9 if options.view == "time" else values
        least = None if options.view in ("depth", "variance") else 0.0
        plot.heat_map(ax, shown, LABELS[options.view], log=options.view == "variance", least=least)
    ax.set_title(f"{shot.name}, {width} x {height}", fontsize=10)
    pictures.write(out, plot.png(figure))
    if hdr:
        pictures.write(hdr, pictures.linear(hdr.suffix.lower(), values))
    print(f"{options.view}: {', '.join(str(p) for p in (out, hdr) if p)}")
    if values.ndim == 2:
        known = values[np.isfinite(values)]
        span = f"{known.min():.4g} to {known.max():.4g}, mean {known.mean():.4g}" if known.size else "nothing to see"
        print(f"{LABELS[options.view].replace('nano', '')}: {span}")
    return 0


def _values(shot, options):
    scene, camera = shot.scene, shot.camera
    sampled = {"spp": options.spp, **shot.arguments}
    match options.view:
        case "depth":
            return views.view_depth(scene, camera)
        case "bounces":
            return views.view_bounces(scene, camera, **sampled)
        case "variance":
            return views.view_variance(scene, camera, **sampled)
        case "fireflies":
            return views.view_fireflies(scene, camera, threshold=options.threshold, **sampled)
        case _:
            return views.view_time(scene, camera, **sampled)


def _replay(options):
    shot = _shot(options)
    sampler, index = shot.arguments["sampler"], options.sample
    points = None if sampler.independent else sampler.points(-(-options.spp // REPLICATES_EACH))
    if options.pixel is not None:
        index = sample_index(shot.camera, tuple(options.pixel), options.sample, sampler=sampler, points=points)
    print(replay(shot.scene, shot.camera, index, points=points, **shot.arguments))
    return 0
