"""Runs that are killed go on where they stopped, with the same bits; files that are not theirs are refused."""

import dataclasses
import os
import signal
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trees import of_a, of_b, tree

import jaxmc as mc
from jaxmc.integration import storage
from jaxmc.integration.kernel import BLOCK

TALLIES = {
    "tail": mc.TailHistogram(of=of_a),
    "top": mc.TopSamples(100, of=of_a),
    "clamp": mc.ClampLadder((0.5, 2.0, 10.0), of=of_a),
    "b": mc.Moments(of=of_b, order=3),
    "buckets": mc.Buckets(11, of=of_b),
    "covariance": mc.Covariance(of=of_b),
}
N = 6 * BLOCK + 1234


def scaled(u, scale, item):
    c = scale * (1.0 + item) / jnp.sqrt(u[0])
    return jnp.stack([c, u[1] * c, 0.5 * c])


PIXELS = mc.Integrand(scaled, 2, (2.0,))
PIXEL_TALLIES = {
    "cascade": mc.Cascade(of=mc.luminance),
    "layers": mc.Layers(of=mc.luminance),
    "tails": mc.PixelTails(of=mc.luminance),
    "top": mc.TopSamples(50, of=mc.luminance),
    "buckets": mc.Buckets(5),
    "covariance": mc.Covariance(),
}


def same(a, b):
    """Whether two estimates are equal in all they say, bit for bit."""
    a, b = (jax.tree.flatten((e.moments, e.tallies, e.between, e.replicate_means, e.n, e.reached)) for e in (a, b))
    return a[1] == b[1] and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a[0], b[0], strict=True))


class Killed(Exception):
    pass


def killed_after(jobs):
    """Return a progress callback that ends a run after so many of its kernel calls."""
    left = [jobs]

    def progress(done, total):
        left[0] -= 1
        if left[0] <= 0:
            raise Killed

    return progress


def killed_again_and_again(make, path, jobs, **changes):
    """Return what ``make`` returns in the end, if it is killed every so many jobs and never but the last run ends."""
    for attempt in range(100):
        options = {"workers": 1 + attempt % 3, **changes}
        try:
            return make(checkpoint=mc.Checkpoint(path, seconds=0.0), progress=killed_after(jobs), **options), attempt
        except Killed:
            pass
    raise AssertionError("it never ended")


# Saving.


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Sobol(), marks=pytest.mark.slow)], ids=str)
def test_an_estimate_comes_back_as_it_was(tmp_path, sampler):
    made = mc.integrate(tree, dim=2, n=5000, tallies=TALLIES, key=3, sampler=sampler, chunk=BLOCK)
    made.save(tmp_path / "e.npz")
    read = mc.Estimate.load(tmp_path / "e.npz")
    assert same(read, made) and str(read) == str(made) and read.recipe == made.recipe
    assert read.seconds == made.seconds and str(read.interval()) == str(made.interval()) and read.status == made.status
    assert read.mean.keys() == made.mean.keys() and np.array_equal(read.mean["b"], made.mean["b"])
    assert os.listdir(tmp_path) == ["e.npz"]


def test_an_image_comes_back_as_it_was(tmp_path):
    f = mc.integrate_each(PIXELS, 4000, n=40, tallies=PIXEL_TALLIES, chunk=BLOCK)
    f.save(tmp_path / "e.npz")
    assert same(mc.Estimate.load(tmp_path / "e.npz"), f)
    f.save(tmp_path / "e.npz")  # over the old one
    assert same(mc.Estimate.load(str(tmp_path / "e.npz")), f)


def test_what_cannot_be_stored_is_named(tmp_path):
    made = mc.integrate(tree, dim=2, n=100, chunk=BLOCK)
    with pytest.raises(ValueError, match=r"type <U3 cannot be stored"):
        dataclasses.replace(made, recipe={"key": np.array(["one", "two"])}).save(tmp_path / "e.npz")
    assert os.listdir(tmp_path) == []
    with pytest.raises(OSError):
        made.save(tmp_path / "missing" / "e.npz")


def test_files_hold_what_they_say(tmp_path):
    plain = [1.5, float("inf"), None, True, 2**70, "word", (1, np.float32(0.1))]
    values = {"x": plain, "y": np.arange(6).reshape(2, 3).T}
    storage.save(tmp_path / "v", values)
    read = storage.load(tmp_path / "v")
    assert read["x"] == [1.5, float("inf"), None, True, 2**70, "word", (1, float(np.float32(0.1)))]
    assert np.array_equal(read["y"], values["y"]) and read["y"].flags.writeable
    empty = {"a": np.zeros((0, 3)), "b": np.float64(2.0), "c": np.array(7)}
    storage.save(tmp_path / "v", empty)
    assert storage.load(tmp_path / "v")["a"].shape == (0, 3)


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text", "version", "pickle", "compressed"])
def test_damaged_files_are_refused_and_left_alone(tmp_path, damage, monkeypatch):
    path = tmp_path / "e.npz"
    made = mc.integrate(tree, dim=2, n=5000, tallies=TALLIES, chunk=BLOCK)
    if damage == "version":
        monkeypatch.setattr(storage, "VERSION", 99)
    made.save(path)
    monkeypatch.undo()
    content = path.read_bytes()
    if damage == "pickle":
        np.savez(path, head=np.array([{}], object), checksum=np.zeros(32, np.uint8))
    elif damage == "compressed":
        with np.load(path) as file:
            np.savez_compressed(path, **file)
    elif damage != "version":
        changed = {"cut": content[: len(content) // 2], "empty": b"", "text": b"scene"}
        flipped = bytearray(content)
        flipped[len(content) // 3] ^= 1
        path.write_bytes({**changed, "flipped": bytes(flipped)}[damage])
    before = path.read_bytes()
    word = "version 99" if damage == "version" else "damaged"
    with pytest.raises(ValueError, match=word):
        mc.Estimate.load(path)
    with pytest.raises(ValueError, match=word):
        mc.integrate(tree, dim=2, n=5000, checkpoint=path)
    assert path.read_bytes() == before


# Checkpoints.

WAYS = {
    "independent": {"n": N, "chunk": BLOCK},
    "sobol": {"n": 1 << 18, "sampler": mc.Sobol(), "chunk": 1 << 14},
    "target": {"rtol": 4e-4, "chunk": 4 * BLOCK},
    "sobol target": {"rtol": 5e-6, "sampler": mc.Sobol(), "chunk": 1 << 14},
}


@pytest.mark.parametrize("way", [pytest.param(w, marks=pytest.mark.slow) if w == "sobol" else w for w in WAYS])
def test_a_run_that_is_killed_ends_with_the_same_bits(tmp_path, way):
    options = WAYS[way]
    tallies = TALLIES if "n" in options else None
    f = mc.Integrand(tree, 2) if "n" in options else mc.Integrand(lambda u: jnp.exp(u[0] * u[1]), 2)

    def make(**more):
        return mc.integrate(f, tallies=tallies, **{**options, **more})

    whole, path = make(), tmp_path / "run.npz"
    found, kills = killed_again_and_again(make, path, 3)
    assert kills >= 2 and same(found, whole)
    assert same(mc.Estimate.load(path), whole) and os.listdir(tmp_path) == ["run.npz"]
    # What is finished is read, not made again, and read it stays.
    assert same(make(checkpoint=path, progress=killed_after(1)), whole)


def test_going_on_with_other_chunks_keeps_the_bits(tmp_path):
    whole = mc.integrate(tree, dim=2, n=N, tallies=TALLIES, chunk=BLOCK)
    path = tmp_path / "run.npz"

    def make(**more):
        return mc.integrate(tree, dim=2, n=N, tallies=TALLIES, **more)

    with pytest.raises(Killed):
        make(checkpoint=mc.Checkpoint(path, 0.0), progress=killed_after(3), chunk=BLOCK)
    assert same(make(checkpoint=path, chunk=2 * BLOCK), whole)


@pytest.mark.parametrize("sampler", [mc.Independent(), pytest.param(mc.Lattice(), marks=pytest.mark.slow)], ids=str)
def test_a_family_that_is_killed_ends_with_the_same_bits(tmp_path, sampler):
    def make(**more):
        options = {"chunk": BLOCK, **more}
        return mc.integrate_each(PIXELS, 4000, n=80, tallies=PIXEL_TALLIES, sampler=sampler, **options)

    whole = make()
    found, kills = killed_again_and_again(make, tmp_path / "run.npz", 3, chunk=BLOCK)
    assert kills >= 1 and same(found, whole)


def test_an_unfinished_file_is_an_estimate_too(tmp_path):
    path = tmp_path / "run.npz"
    with pytest.raises(Killed):
        mc.integrate(tree, dim=2, n=N, checkpoint=mc.Checkpoint(path, 0.0), progress=killed_after(3), chunk=BLOCK)
    part = mc.Estimate.load(path)
    assert part.n == 2 * BLOCK and same(part, mc.integrate(tree, dim=2, n=2 * BLOCK, chunk=BLOCK))
    with pytest.raises(ValueError, match="unfinished"):
        mc.merge(part, part)


def test_pixels_that_are_one_pass_behind_have_means_of_their_own_samples(tmp_path):
    tallies = PIXEL_TALLIES | {"ladder": mc.ClampLadder((1.0, 8.0), mc.luminance)}

    def make(n, **more):
        return mc.integrate_each(PIXELS, 4000, n=n, tallies=tallies, chunk=BLOCK, **more)

    path, few, many = tmp_path / "run.npz", make(32), make(64)
    with pytest.raises(Killed):
        make(96, checkpoint=mc.Checkpoint(path, 0.0), progress=killed_after(6))
    part, ahead = mc.Estimate.load(path), 2 * 1344  # three rows are a pass, two more are in the file
    for name in ("clamped", "excess_square"):
        got, more, less = (getattr(e["ladder"], name) for e in (part, many, few))
        assert np.array_equal(got[:, :ahead], more[:, :ahead]) and np.array_equal(got[:, ahead:], less[:, ahead:])
    for name in ("cascade", "layers"):
        got, more, less = (e[name].value for e in (part, many, few))
        assert np.array_equal(got[:, :ahead], more[:, :ahead]) and np.array_equal(got[:, ahead:], less[:, ahead:])
        assert np.allclose(got.sum(0), part.mean, rtol=1e-5) and not np.array_equal(more, less)


@pytest.mark.slow
def test_an_unfinished_file_of_randomisations_has_the_complete_ones(tmp_path):
    path = tmp_path / "sobol.npz"
    options = {"n": 1 << 18, "sampler": mc.Sobol(), "chunk": 1 << 14}
    with pytest.raises(Killed):
        mc.integrate(tree, dim=2, checkpoint=mc.Checkpoint(path, 0.0), progress=killed_after(4), **options)
    part = mc.Estimate.load(path)
    assert 2 <= part.recipe["replicates"] < 16 and part.n == part.recipe["replicates"] << 14
    assert abs(part.mean["a"] - 1.0) < 0.1


@pytest.mark.parametrize(
    "change, word",
    [
        ({"n": 2 * BLOCK}, "n 61440, not 122880"),
        ({"key": 1}, "seed"),
        ({"sampler": mc.Sobol()}, "integrand"),
        ({"tallies": {"top": mc.TopSamples(of=of_a)}}, "integrand"),
        ({"indices": range(5)}, "indices"),
        ({"dim": 3}, "integrand"),
        (
            {"f": lambda u: {"a": u[0] / jnp.sqrt(u[1]), "b": jnp.stack([u[0], jnp.exp(u[1]), u[0] * u[1] - 6.0])}},
            "code",
        ),
    ],
)
def test_a_file_of_another_run_is_refused(tmp_path, change, word):
    path = tmp_path / "run.npz"
    mc.integrate(tree, dim=2, n=BLOCK, checkpoint=path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=word):
        mc.integrate(**{"f": tree, "dim": 2, "n": BLOCK, "checkpoint": path, **change})
    assert path.read_bytes() == before


def test_other_parameters_are_another_run(tmp_path):
    path = tmp_path / "run.npz"
    mc.integrate_each(PIXELS, 50, n=10, checkpoint=path)
    other = mc.Integrand(scaled, 2, (np.nextafter(np.float32(2.0), np.float32(3.0)),))
    with pytest.raises(ValueError, match="another integrand, in its code or its parameters"):
        mc.integrate_each(other, 50, n=10, checkpoint=path)


@pytest.mark.parametrize("path", ["", 3, "missing/run.npz", "."])
def test_paths_that_are_none(path):
    with pytest.raises(ValueError, match="checkpoint"):
        mc.integrate(tree, dim=2, n=10, checkpoint=path)
    with pytest.raises(ValueError, match="seconds"):
        mc.Checkpoint("run.npz", seconds=-1.0)


def test_a_tally_of_the_user_goes_on_with_the_user(tmp_path):
    @dataclasses.dataclass(frozen=True)
    class Count(mc.TailHistogram):
        pass

    path, tallies, n = tmp_path / "run.npz", {"mine": Count(of=of_a)}, 2 * BLOCK
    options = {"dim": 2, "n": n, "tallies": tallies, "chunk": BLOCK}
    whole = mc.integrate(tree, **options)
    with pytest.raises(Killed):
        mc.integrate(tree, **options, checkpoint=mc.Checkpoint(path, 0.0), progress=killed_after(2))
    with pytest.raises(ValueError, match="the tally 'mine'"):
        mc.Estimate.load(path)
    assert same(mc.integrate(tree, **options, checkpoint=path), whole)


def test_ctrl_c_keeps_what_is_done(tmp_path):
    path, done = tmp_path / "run.npz", []
    before = signal.getsignal(signal.SIGINT)  # in the background of a shell it is ignored

    def progress(samples, total):
        done.append(samples)
        if len(done) == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt, match=r"samples are done and kept in .*run.npz: 0.99"):
        mc.integrate(tree, dim=2, n=N, checkpoint=path, progress=progress, chunk=BLOCK)
    assert signal.getsignal(signal.SIGINT) is before
    assert mc.Estimate.load(path).n == done[-1]
    seen = []

    def see(n, total):
        seen.append((n, total))

    found = mc.integrate(tree, dim=2, n=N, checkpoint=path, progress=see, chunk=BLOCK)
    assert seen[0] == (done[-1] + BLOCK, N) and seen[-1] == (N, N)
    assert same(found, mc.integrate(tree, dim=2, n=N, chunk=BLOCK))


def test_checkpoints_work_in_threads(tmp_path):
    found = []

    def run():
        found.append(mc.integrate(tree, dim=2, n=N, chunk=BLOCK, checkpoint=tmp_path / "run.npz"))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert same(found[0], mc.integrate(tree, dim=2, n=N, chunk=BLOCK))
