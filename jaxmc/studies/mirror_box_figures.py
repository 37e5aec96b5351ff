"""The figures of the source of the study ``mirror-box``, one by one: its images 17-1 to 17-4, what it says of shadows
without fireflies and of random pixels, and the re-weighting that it names.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from .. import plot
from ..analysis import convergence
from ..analysis.reweighting import resolve_cascade
from ..integration.layers import Cascade
from ..scenes import mirror_box_parts
from ..transport.images import render
from ..transport.intersection import intersect
from ..transport.materials import luminance
from ..transport.views import view_depth

REGULARIZED, REWEIGHTED = (16, 128), (16, 128)  # samples per pixel
LEFT, RIGHT = -2, -1  # the green sphere and the mirror, among the primitives
TARGETS = 64  # points of the mirror sphere that a place may see
BRIGHT, RARE, EXPERIMENTS = 500.0, 1e-3, 4000  # of the thought experiment: a pixel in a thousand is as bright as this


def show_all(report, settings, scene, camera, paths, reference, few, calm, calm16, ladder):
    """Add the figures of the source; ``ladder``: renders of the mirror box by samples per pixel."""

    def shoot(spp, stream, title, **options):
        key, progress = (settings.seed << 8) + stream, title if settings.progress else None
        return render(scene, camera, spp=spp, **paths, **options, key=key, progress=progress)

    cascade = {"cascade": Cascade(of=luminance)}
    regularized = {n: shoot(n, 5 + k, f"regularized, {n} spp", regularize="pbrt") for k, n in enumerate(REGULARIZED)}
    layers = {n: shoot(n, 7 + k, f"re-weighted, {n} spp", tallies=cascade) for k, n in enumerate(REWEIGHTED)}
    reweighted = {n: resolve_cascade(e["cascade"], width=camera.width) for n, e in layers.items()}
    shape, many = reference.mean.shape, ladder[max(ladder)][0]
    clamped = {16: few["clamped"][0].mean, many.n: many["clamped"][0].mean}
    figures = {
        "figure_17_1": {
            f"diffuse sphere, {calm.n} spp": calm.mean, f"mirror sphere, {reference.n} spp": reference.mean
        },
        "figure_17_2": {"diffuse sphere, 16 spp": calm16.mean, "mirror sphere, 16 spp": few.mean},
        "figure_17_3": {f"clamped at 3, {n} spp": image for n, image in clamped.items()},
        "figure_17_4": {f"regularized, {n} spp": e.mean for n, e in regularized.items()},
        "reweighted": {f"re-weighted, {n} spp": x.reshape(shape) for n, x in reweighted.items()},
    }  # fmt: skip
    captions = {
        "figure_17_1": "As the source's figure 17-1: converged images, a white sphere and a mirror on the right.",
        "figure_17_2": "Figure 17-2: 16 samples per pixel. One image is calm, the other is not.",
        "figure_17_3": "Figure 17-3: every sample clamped at 3. Calm, and without the caustic, however many there are.",
        "figure_17_4": "Figure 17-4: mirrors are rough to paths that have scattered. The caustic is there.",
        "reweighted": "Re-weighted by how many other samples are as bright (Zirr et al. 2018), in six layers.",
    }
    report.section("The figures of the source, one by one")
    for name, pictures in figures.items():
        report.figure(plot.images(pictures), name, captions[name])
    cured = {title: x for name in list(figures)[2:] for title, x in figures[name].items()}
    rows = [_errors("diffuse sphere, 16 spp", calm16.mean, calm)]
    rows += [_errors(title, x, reference) for title, x in ({"mirror sphere, 16 spp": few.mean} | cured).items()]
    caption = "Of luminance, against the long render of the same scene, whose noise is taken off. For error bars: "
    headers = ["image", "mean over the reference's", "MSE of a pixel"]
    report.table(headers, rows, caption + "`jaxmc study cures mirror-box`.")
    report.value("images of the source", [dict(zip(("image", "mean", "mse"), row)) for row in rows])
    _shadow(report, scene, camera, reference)
    _random_pixels(report, luminance(calm.mean).ravel(), settings.seed)


def _errors(title, image, reference):
    truth, noise = luminance(reference.mean), luminance(reference.stderr) ** 2
    image = luminance(image)
    return [title, image.mean() / truth.mean(), convergence.image_error(image, truth, noise)]


def mirror_seen(scene, camera) -> np.ndarray:
    """Return which share of the mirror sphere's near half is seen from what each pixel shows, shape (height, width).

    NaN for pixels that show one of the spheres themselves.
    """
    mirror = mirror_box_parts().primitives[RIGHT]
    rows, columns = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    s, t = (columns + 0.5) / camera.width, (rows + 0.5) / camera.height
    ahead = np.array(camera.forward) + np.outer(2 * s - 1, camera.right) + np.outer(2 * t - 1, camera.down)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    first = intersect(scene, np.broadcast_to(np.array(camera.origin, float), ahead.shape), ahead)
    # Start a little before the surface.
    points = np.array(camera.origin) + 0.9999 * view_depth(scene, camera).ravel()[:, None] * ahead
    number = len(mirror_box_parts().primitives) + RIGHT
    seen = np.zeros(len(points))
    for direction in np.random.default_rng(0).normal(size=(TARGETS, 3)):
        toward = np.array(mirror.center) - points
        side = direction - toward * (toward @ direction / (toward**2).sum(1))[:, None]
        target = np.array(mirror.center) + 0.9 * mirror.radius * side / np.linalg.norm(side, axis=1, keepdims=True)
        seen += np.asarray(intersect(scene, points, target - points).primitive) == number
    sphere = np.asarray(first.primitive) >= number - 1
    return np.where(sphere, np.nan, seen / TARGETS).reshape(camera.height, camera.width)


def _shadow(report, scene, camera, reference):
    rate, seen = reference["firefly"][0].mean[..., 0], mirror_seen(scene, camera)
    count, rows, values = reference.n, [], []
    for name, region in {"all of it": seen == 1.0, "half or less": seen <= 0.5, "nothing": seen == 0.0}.items():
        found = float(rate[region].sum() * count)
        samples = int(region.sum()) * count
        values.append({"seen": name, "pixels": int(region.sum()), "fireflies": found, "samples": samples})
        error = 1e6 * np.sqrt(found) / max(samples, 1)
        rows.append([name, int(region.sum()), round(found), 1e6 * found / max(samples, 1), error])
    report.section("The shadow without fireflies")
    fig, axes = plot.panels(2, 2, (6.2, 4.4))
    plot.heat_map(axes[0], seen, "share of the mirror sphere that is seen from there", cmap="cividis")
    plot.heat_map(axes[1], 1e6 * gaussian_filter(rate, 3.0), "fireflies in a million samples, smoothed")
    caption = (
        "Left: how much of the mirror sphere a place sees; behind the green sphere lies its shadow. Right: how often a "
        "sample that starts there is a firefly, smoothed over 3 pixels: the shadow is no hole, as paths that scatter "
        "twice before they meet the mirror start in it too."
    )
    report.figure(fig, "shadow", caption)
    headers = ["of the mirror sphere seen", "pixels", "fireflies", "in a million samples", "stderr"]
    report.table(headers, rows, "Fireflies by how much of the mirror sphere the place sees; both spheres left out.")
    report.value("fireflies by view of the mirror", values)


def _random_pixels(report, pixels, seed):
    """Show how the mean of an image is found from random pixels, one in a thousand of which is far too bright."""
    draw = np.random.default_rng(seed)
    n = np.unique(np.geomspace(1, 1 << 14, 57).astype(int))
    mean = (1.0 - RARE) * pixels.mean() + RARE * BRIGHT
    calm, spoilt = np.zeros((2, len(n), EXPERIMENTS))
    sums, rare, before = np.zeros(EXPERIMENTS), np.zeros(EXPERIMENTS), 0
    for k, count in enumerate(n):
        # Add up a few more pixels in each experiment; how many of them are bright has a binomial law.
        more = draw.choice(pixels, (count - before, EXPERIMENTS))
        bright = draw.random(more.shape) < RARE
        sums, rare, before = sums + np.where(bright, 0.0, more).sum(0), rare + bright.sum(0), count
        spoilt[k] = (sums + BRIGHT * rare) / count
        calm[k] = (sums + pixels.mean() * rare) / count
    wrong = (np.abs(spoilt - mean) > 1.0).mean(1)
    fig, axes = plot.panels(2)
    plot.mean_ranges(axes[0], n, {"the image": calm, "one pixel in 1000 is 500": spoilt}, mean)
    plot.rates(axes[1], n, {"off by more than 1": wrong}, 0.5 / EXPERIMENTS, "random pixels n", "share of experiments")
    report.section("The thought experiment")
    report.text(
        "What is the mean of a converged image, from n of its pixels at random? A few do. Then let one pixel in a "
        "thousand be worth 500: most small samples miss it and are calm and wrong; each one that has it is far off. "
        f"More pixels make it worse for a while: {wrong.max():.0%} of the experiments are off by more than 1 at n = "
        f"{n[np.argmax(wrong)]}, against {wrong[0]:.1%} with one pixel. "
    )
    caption = (
        f"Medians of {EXPERIMENTS} experiments with the range of nine in ten; the dashed line is the mean, {mean:.3f}."
    )
    report.figure(fig, "random_pixels", caption)
    report.value("random pixels", {"n": n, "off by more than 1": wrong, "mean": mean})
