"""Scenes as plain data and files: exact round trips, and what broken data are told."""

import json
import math
import os
import random

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import jaxmc as mc

coordinate = st.floats(-100.0, 100.0, allow_subnormal=False).map(lambda x: x if abs(x) > 1e-6 else 0.0)
length = st.floats(0.1, 10.0)
vector = st.tuples(coordinate, coordinate, coordinate)
share = st.floats(0.0, 1.0, allow_subnormal=False).map(lambda x: x if x > 1e-30 else 0.0)
fraction = st.one_of(share, st.tuples(share, share, share), st.lists(share, min_size=3, max_size=3).map(np.array))
radiance = st.one_of(st.none(), fraction)
material = st.one_of(
    st.builds(mc.Diffuse, fraction),
    st.builds(mc.Mirror, fraction),
    st.builds(mc.RoughConductor, st.floats(1e-4, 1.0), fraction),
    st.builds(mc.RoughConductor, st.floats(1e-4, 1.0), fraction, eta=fraction, k=fraction),
    st.builds(mc.Dielectric, st.floats(0.5, 3.0)),
)


@st.composite
def flat(draw):
    """A quad or a triangle that has an area."""
    corner, size, angle = np.array(draw(vector)), draw(length), draw(st.floats(0.2, 3.0))
    axes = draw(rotation)
    u, v = size * axes[0], draw(length) * (math.cos(angle) * axes[0] + math.sin(angle) * axes[1])
    surface = {"material": draw(material), "emission": draw(radiance), "two_sided": draw(st.booleans())}
    if draw(st.booleans()):
        return mc.Quad(corner, u, tuple(v.tolist()), **surface)
    return mc.Triangle(corner.tolist(), corner + u, corner + v, **surface)


@st.composite
def _rotation(draw):
    return np.linalg.qr(np.random.default_rng(draw(st.integers(0, 1000))).normal(size=(3, 3)))[0]


@st.composite
def _normal(draw):
    return draw(length) * draw(rotation)[0]


rotation = _rotation()
sides = {"material": material, "emission": radiance, "inward": st.booleans(), "two_sided": st.booleans()}
primitive = st.one_of(
    st.builds(mc.Sphere, vector, length, **sides),
    flat(),
    st.builds(mc.Disk, vector, _normal(), length, material, radiance, st.booleans()),
    st.builds(mc.Box, vector, st.tuples(length, length, length), axes=rotation, **sides),
)
gradient = st.builds(
    mc.GradientSky,
    st.one_of(st.tuples(fraction), st.tuples(st.floats(1.0, 2.0), share)),
    up=st.sampled_from([(0.0, 1.0, 0.0), np.array([1.0, 2.0, 2.0])]),
    ground=radiance,
)
scene = st.builds(mc.Scene, st.lists(primitive, max_size=4), st.one_of(radiance, gradient))
QUICK = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def rich_scene():
    return mc.Scene(
        [
            mc.Sphere((0.0, 0.1, 2.0), 1, mc.RoughConductor(0.2, eta=(1, 2, 3), k=np.ones(3)), emission=2.0),
            mc.Box((5, 0, 0), (1, 2, 3), inward=True, material=mc.Mirror((0.1, 0.2, 0.3)), two_sided=True),
            mc.Triangle((9, 0, 0), (9, 1, 0), (9, 0, 1), mc.Dielectric()),
            mc.Quad((-9, 0, 0), (0, 1, 0), (0, 0, 1 / 3), mc.Diffuse(0.1), emission=(1, 2, 3)),
        ],
        sky=mc.GradientSky((1, (0.1, 0.2, 0.3)), up=(1, 2, 3), ground=0.25),
    )


def assert_same(a, b):
    """The kernels are the same: equal facts, and leaves that are equal to the bit."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b)):
        assert np.asarray(x).dtype == np.asarray(y).dtype and np.asarray(x).tobytes() == np.asarray(y).tobytes()


@QUICK
@given(scene)
def test_a_scene_comes_back_from_its_data_to_the_bit(one):
    data = one.to_dict()
    again = mc.Scene.from_dict(json.loads(json.dumps(data, allow_nan=False)))
    assert again.to_dict() == data
    assert_same(one, again)


def places(data, path=()):
    """Yield the path of every value inside of plain data."""
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in children:
        yield (*path, key)
        yield from places(value, (*path, key))


WRONG = [
    None, True, -1, 0, 0.0, 1e308, -1e308, 1e-320, 10**400, math.nan, math.inf, "", "Sphere", "1.0", [], {}, [1, 2],
    [[]], [1, 2, 3], [None] * 3, ["a"] * 3, [[1.0] * 3] * 3, [[1e308] * 3] * 3, [1e200, 1e200, 1e200], [[[[1.0]]]],
    {"type": "Sphere"}, {"type": "Diffuse", "albedo": 2}, {"type": ["Sphere"]}, {"type": "GradientSky"},
]  # fmt: skip


@settings(QUICK, max_examples=250)
@given(st.integers(0, 10**9), st.integers(1, 3))
@example(28587, 1)  # a metal whose index overflows in float32
def test_broken_data_are_a_scene_or_a_value_error(seed, faults):
    choose = random.Random(seed)
    camera = mc.PinholeCamera((0, 0, 9), (0, 0, 0), fov=30.5, width=7, height=5)
    data = json.loads(json.dumps(rich_scene().to_dict() | {"camera": camera_data(camera)}))
    for _ in range(faults):
        *path, last = choose.choice(list(places(data)))
        inside = data
        for key in path:
            inside = inside[key]
        fault = choose.choice(["delete", "replace", "nest", "rename"])
        if fault == "replace":
            inside[last] = choose.choice(WRONG)
        elif fault == "nest":
            inside[last] = [inside[last]]
        else:
            value = inside.pop(last)
            if fault == "rename" and isinstance(inside, dict):
                inside[str(last) + "_"] = value
    try:
        found = mc.Scene.from_dict(data)
    except ValueError as error:
        assert str(error)
    else:
        assert_same(found, mc.Scene.from_dict(found.to_dict()))


def camera_data(camera):
    from jaxmc.transport.scene_files import scene_to_dict

    return scene_to_dict(mc.Scene([]), camera)["camera"]


def test_nesting_without_end_is_a_value_error():
    deep = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(ValueError, match="sky"):
        mc.Scene.from_dict({"format": "jaxmc scene", "version": 1, "primitives": [], "sky": deep})
    while deep:
        deep = deep.pop()


def changed(path, value):
    data = rich_scene().to_dict()
    inside = data
    for key in path[:-1]:
        inside = inside[key]
    inside[path[-1]] = value
    return data


@pytest.mark.parametrize(
    "path, value, message",
    [
        (["format"], "obj", 'format: must be "jaxmc scene"'),
        (["version"], 2, "version: must be 1, got 2; files of a later jaxmc"),
        (["version"], True, "version: must be 1"),
        (["extra"], 1, "the scene: unknown 'extra'; known are"),
        (["primitives"], {}, "primitives: must be a list"),
        (["primitives", 3], [], r'primitives\[3\]: must be a dictionary with "type": Sphere or Quad'),
        (["primitives", 3, "type"], "Quadric", r"primitives\[3\].type: must be Sphere or Quad.*got 'Quadric'"),
        (["primitives", 0, "radius"], -1, r"primitives\[0\]: Sphere radius must be finite and greater than 0"),
        (["primitives", 0, "radius"], math.nan, r"primitives\[0\].radius: must be finite, got nan"),
        (["primitives", 0, "center"], [0, "x", 0], r"primitives\[0\].center\[1\]: must be made of numbers, got 'x'"),
        (["primitives", 0, "inward"], 1, r"primitives\[0\].inward: must be true or false, got 1"),
        (["primitives", 0, "colour"], 1, r"primitives\[0\]: unknown 'colour'; known are center, emission"),
        (["primitives", 3, "material"], None, r"primitives\[3\].material: must be a dictionary"),
        (["primitives", 3, "material", "type"], "Velvet", r"primitives\[3\].material.type: must be Diffuse or Mirror"),
        (["primitives", 3, "material", "ior"], 1.5, r"primitives\[3\].material: unknown 'ior'; known are albedo, type"),
        (["primitives", 3, "material", "albedo"], 1.5, r"primitives\[3\]: Quad albedo must lie in \[0, 1\]"),
        (["primitives", 2, "material", "ior"], "glass", r"primitives\[2\].material.ior: must be made of numbers"),
        (["sky"], "blue", "sky: must be made of numbers"),
        (["sky", "ground"], -1, "sky: GradientSky ground must be finite and not negative"),
        (["sky", "coefficients"], [None], r"sky.coefficients\[0\]: must be made of numbers"),
        (["camera"], {"type": "PinholeCamera"}, "camera: origin, target is missing"),
        (
            ["camera"],
            {"type": "PinholeCamera", "origin": [0, 0, 1], "target": [0, 0, 0], "width": 2.5},
            "camera.width: must be an integer, got 2.5",
        ),
    ],
)
def test_errors_name_the_place_and_what_was_expected(path, value, message):
    with pytest.raises(ValueError, match=message):
        mc.Scene.from_dict(changed(path, value))


def test_arguments_with_a_default_may_be_left_out():
    short = {
        "format": "jaxmc scene",
        "version": 1,
        "primitives": [{"type": "Sphere", "center": [0, 0, 0], "radius": 2}],
    }
    assert_same(mc.Scene.from_dict(short), mc.Scene([mc.Sphere((0, 0, 0), 2)]))


def test_a_file_keeps_scene_and_camera(tmp_path):
    camera = mc.PinholeCamera((0.1, 0, 9), np.array([0, 1 / 3, 0]), fov=30.5, width=np.int64(7), height=5)
    path = tmp_path / "scene.json"
    path.write_text("an older file")
    mc.save_scene(path, rich_scene(), camera)
    scene, again = mc.load_scene(path)
    assert_same(scene, rich_scene())
    assert_same(again, camera)
    assert again.given == {
        "origin": [0.1, 0.0, 9.0], "target": [0.0, 1 / 3, 0.0], "up": [0.0, 1.0, 0.0], "fov": 30.5, "width": 7,
        "height": 5,
    } | {k: v for k, v in camera.given.items() if k == "antialias"}  # fmt: skip
    mc.save_scene(path, scene)
    assert mc.load_scene(path)[1] is None
    assert os.listdir(tmp_path) == ["scene.json"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "scene.json"
    mc.save_scene(path, mc.Scene([]))
    before = path.read_text()

    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="no space"):
        mc.save_scene(path, rich_scene())
    assert path.read_text() == before and os.listdir(tmp_path) == ["scene.json"]


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "Expecting value"),
        ("[", "Expecting value: line 1"),
        ('{"format": "jaxmc scene", "version": 1, "primitives": [], "sky": NaN}', "NaN is no number of JSON"),
        ('{"format": "jaxmc scene", "version": 1, "primitives": [], "sky": -Infinity}', "-Infinity is no number"),
        ('{"format": "jaxmc scene", "version": 1, "primitives": [], "sky": 1e999}', "sky: must be finite"),
        ('{"format": "jaxmc scene", "format": 1}', '"format" stands twice'),
        ("[" * 200_000, "nested too deep"),
        ("\udcff", "decode"),
        ("1" * 5000, "integer string conversion|dictionary"),
    ],
)
def test_files_that_are_no_scene(tmp_path, text, message):
    path = tmp_path / "scene.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=message) as caught:
        mc.load_scene(path)
    assert str(path) in str(caught.value)


def test_what_is_not_known_cannot_be_written():
    scene, camera = rich_scene(), mc.PinholeCamera((0, 0, 9), (0, 0, 0))
    with pytest.raises(ValueError, match="transformation of JAX"):
        jax.tree.map(lambda x: x, scene).to_dict()
    with pytest.raises(ValueError, match="changed after it was made"):
        mc.save_scene("never.json", scene, jax.tree.map(lambda x: x, camera))
    with pytest.raises(ValueError, match=r"mc.PinholeCamera\(...\)"):
        mc.save_scene("never.json", scene, "camera")

    def traced(albedo):
        mc.Scene([mc.Sphere((0, 0, 0), 1.0, mc.Diffuse(albedo))]).to_dict()
        return albedo

    with pytest.raises(ValueError, match=r"primitives\[0\].material.albedo: JAX traces"):
        jax.grad(traced)(0.5)
