"""The study of primitives, in small: three builds are one scene, and costs are counted and compared rightly."""

import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.cli import main
from jaxmc.studies import costs, primitives
from jaxmc.testing import joint_sigmas

KINDS = {"triangles": [(mc.Triangle, 30)], "quads": [(mc.Quad, 15)], "boxes": [(mc.Quad, 5), (mc.Box, 2)]}


def test_three_builds_are_the_same_surfaces_and_the_same_light():
    rng = np.random.default_rng(0)
    origins = rng.uniform(-0.99, 0.99, (4000, 3))
    directions = rng.normal(size=(4000, 3))
    found = []
    for build, kinds in KINDS.items():
        scene, _ = scenes.cornell_blocks(True, build)
        given = scene.given[0]
        assert [(kind, sum(isinstance(p, kind) for p in given)) for kind, _ in kinds] == kinds
        assert len(given) == sum(count for _, count in kinds)
        hits = mc.intersect(scene, origins, directions)
        material = [given[i].material.albedo if i >= 0 else None for i in np.asarray(hits.primitive)]
        found.append((hits, material))
    # Rays from inside the blocks too: they meet the floor, or the bottom that only boxes have, which lies on it.
    boxes, materials = found[2]
    for hits, material in found[:2]:
        same = np.isclose(hits.distance, boxes.distance, rtol=1e-4, atol=1e-5)
        same &= np.array([a == b for a, b in zip(material, materials)])
        same &= np.isclose(hits.normal, boxes.normal, atol=1e-4).all(1) | np.isinf(boxes.distance)
        assert same.mean() > 0.999
    assert np.isfinite(boxes.distance).mean() > 0.7


def test_both_lights_of_the_box_have_the_same_power():
    def power(ceiling, build):
        lights = [p for p in scenes.cornell_blocks(ceiling, build)[0].given[0] if p.emission is not None]
        edges = [
            (p.edge_u, p.edge_v) if build == "quads" else (np.subtract(p.b, p.a), np.subtract(p.c, p.a)) for p in lights
        ]
        half = 1.0 if build == "quads" else 0.5
        return sum(half * np.linalg.norm(np.cross(*e)) * p.emission for e, p in zip(edges, lights))

    powers = [power(ceiling, build) for ceiling in (False, True) for build in ("quads", "triangles")]
    assert powers == pytest.approx([3.75] * 4)
    with pytest.raises(ValueError, match="triangles, quads, boxes"):
        scenes.cornell_blocks(build="cones")


def test_operations_are_counted_through_loops_and_branches():
    def fn(u, a):
        u = u[0] * a + 1.0  # 2
        u = jax.lax.fori_loop(0, 7, lambda k, x: x * x + x, u)  # 7 times 2 and the counter, which all points share
        return jax.lax.cond(a > 0.0, lambda x: jnp.sin(x) * x, lambda x: x, u)  # 2, and the question once

    assert costs.operations(mc.Integrand(fn, 1, (2.0,))) == pytest.approx(18.0, abs=0.02)
    # Two more bounces are two more rounds of the same loop.
    scene, camera = scenes.many_spheres(2, 8, 8)
    counts = [costs.operations(mc.path_integrand(scene, camera, bounces=n)) for n in (2, 4, 6)]
    assert counts[2] - counts[1] == pytest.approx(counts[1] - counts[0], rel=1e-3) and counts[1] > counts[0]


def test_what_is_compiled_computes_the_same_and_is_compiled_afresh():
    x = np.arange(8.0, dtype=np.float32)
    for _ in range(2):
        program, seconds = costs.compiled(lambda x: x * 2.0, x)
        assert np.asarray(program(x)).tolist() == (2.0 * x).tolist() and seconds > 0.0


def test_costs_of_rays_are_those_of_one_ray_and_sphere():
    few = costs.ray_cost(3, rows=2, work=1e6)
    assert few.count == 3 and 0.01 < few.ns_closest < 1000.0 and 0.01 < few.ns_shadow < 1000.0
    assert min(few.compile_closest, few.compile_shadow, few.compile_path) > 0.0


def image(mean, variance, n=100):
    shape = (16, 16, 3)
    return SimpleNamespace(mean=np.broadcast_to(mean, shape), variance=np.broadcast_to(variance, shape), n=n)


def test_agreement_tells_noise_from_a_difference():
    rng = np.random.default_rng(5)
    variance = np.linspace(0.5, 2.0, 768).reshape(16, 16, 3)
    noisy = [image(1.0 + rng.normal(size=(16, 16, 3)) * np.sqrt(variance / 100), variance) for _ in range(2)]
    z, difference, stderr = primitives.agreement(*noisy)
    assert z.shape == (8, 8, 3) and np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)
    assert np.abs(z).max() < joint_sigmas(z.size) and abs(difference) < 5 * stderr
    # Means over 4 pixels: each has the error of one, halved.
    exact = (noisy[0].mean - noisy[1].mean)[:2, :2, 0].mean() / np.sqrt(2 * variance[:2, :2, 0].mean() / 100 / 4)
    assert z[0, 0, 0] == pytest.approx(exact)
    # A build in which something is missing shows in its regions.
    wrong = np.array(noisy[1].mean)
    wrong[4:8, 4:8] *= 2.0
    z, *_ = primitives.agreement(noisy[0], image(wrong, variance))
    assert np.abs(z).max() > joint_sigmas(z.size)


@pytest.mark.parametrize(
    ("arguments", "cure"),
    [
        (["--size", "2"], "16 to 4096"),
        (["--spp", "1"], "4 to 2^16"),
        (["--rounds", "0"], "1 to 100"),
        (["--quiet", "--out", "/dev/null/x"], "Name another folder"),
    ],
)
def test_errors_are_one_line_with_the_cure(arguments, cure, capsys):
    assert main(["study", "primitives", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxmc: ") and error.count("\n") == 1 and cure in error
    with pytest.raises(ValueError, match="spheres"):
        primitives.Settings(counts=(0,))


@pytest.mark.slow
def test_the_study_leaves_a_report_whose_images_agree(tmp_path):
    settings = primitives.Settings(size=64, spp=64, rounds=2, counts=(1, 20), progress=False)
    page = primitives.run(tmp_path, settings)
    report = json.loads((tmp_path / "report.json").read_text())
    assert {p.stem for p in page.parent.glob("*.png")} == {"builds", "images", "spheres"}
    builds, agreement, rays = (table["rows"] for table in report["tables"])
    assert len(agreement) == 15 and all(row[-1] == "agree" and row[3] <= row[4] for row in agreement)
    # A mean error of 3 % would be seen in every pair.
    assert all(row[6] < 0.006 for row in agreement)
    for row in builds:
        assert row[7] == pytest.approx(row[3] / (64 * 64 * 64) * 1e9)
    assert builds[0][8] > 2 * builds[1][8] > 2 * builds[2][8]
    assert [row[0] for row in rays] == [1, 20]
