"""Scenes as Mitsuba describes them, without Mitsuba."""

import sys
import types

import jax
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.transport.mitsuba_objects import with_objects
from jaxmc.transport.mitsuba_scenes import describe

CAMERA = mc.PinholeCamera((1, 2, 5), (0, 0.5, 0), fov=35, width=12, height=8)
COLOR = {"type": "rgb", "value": [0.1, 0.2, 0.3]}


def primitive(p, sky=None):
    return describe(mc.Scene([p], sky), None, 4, 3)["primitive_0"]


def corners_of(matrix, points):
    return np.array([np.array(matrix) @ (*point, 1.0) for point in points])[:, :3]


def test_paths_have_as_many_bounces_and_no_roulette():
    found = describe(mc.Scene([]), None, 4, 0)
    assert found == {"type": "scene", "integrator": {"type": "path", "max_depth": 1, "rr_depth": 2**31 - 1}}
    assert describe(mc.Scene([]), None, 4, 7)["integrator"]["max_depth"] == 8


def test_the_camera_looks_the_same_way():
    sensor = describe(mc.Scene([mc.Sphere((0, 0, 0), 1)]), CAMERA, 4, 3)["sensor"]
    assert (sensor["fov_axis"], sensor["film"]["width"], sensor["film"]["height"]) == ("y", 12, 8)
    assert sensor["film"]["rfilter"] == {"type": "box"} and sensor["sampler"]["sample_count"] == 4
    assert sensor["fov"] == pytest.approx(35, rel=1e-12)
    # Mitsuba's camera looks along +z, +x to the left of the image.
    matrix = np.array(sensor["to_world"])
    tangent = np.tan(np.radians(sensor["fov"] / 2))
    for x, y in ((0, 0), (12, 0), (3, 8)):
        ours = CAMERA.ray(x, y).direction
        local = np.array([(1 - x / 6) * tangent * 1.5, (1 - y / 4) * tangent, 1.0])
        theirs = matrix[:3, :3] @ local / np.linalg.norm(local)
        np.testing.assert_allclose(theirs, [float(c) for c in ours], atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 5])
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert sensor["near_clip"] < 1e-2 and sensor["far_clip"] > 20.0


def test_spheres():
    found = primitive(mc.Sphere((1, 2, 3), 4, inward=True))
    assert found["type"] == "sphere" and found["center"] == [1.0, 2.0, 3.0] and found["radius"] == 4.0
    assert found["flip_normals"] is True and "emitter" not in found


def test_parallelograms_keep_their_corners_and_normal():
    quad = mc.Quad((1, 2, 3), (2, 0, 0), (1, 0, -3))
    found = primitive(quad)
    corner, u, v = (np.array(x, float) for x in (quad.corner, quad.edge_u, quad.edge_v))
    expected = [corner, corner + u, corner + v, corner + u + v]
    square = [(-1, -1, 0), (1, -1, 0), (-1, 1, 0), (1, 1, 0)]
    np.testing.assert_allclose(corners_of(found["to_world"], square), expected, atol=1e-12)
    # Normals go with the inverse transpose.
    normal = np.linalg.inv(np.array(found["to_world"])[:3, :3]).T @ (0, 0, 1)
    np.testing.assert_allclose(normal / np.linalg.norm(normal), np.cross(u, v) / np.linalg.norm(np.cross(u, v)))


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_boxes_keep_their_corners_and_are_never_inside_out(flip):
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    axes[0] *= flip
    found = primitive(mc.Box((1, 2, 3), (2, 4, 6), axes, inward=flip > 0))
    assert found["flip_normals"] is (flip > 0)
    assert np.linalg.det(np.array(found["to_world"])) == pytest.approx(6.0)
    cube = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    ours = [np.array([1, 2, 3]) + np.array(c) * (1, 2, 3) @ axes for c in cube]
    theirs = corners_of(found["to_world"], cube)
    distances = np.linalg.norm(np.array(ours)[:, None] - theirs, axis=-1)
    assert np.all(distances.min(0) < 1e-12) and np.all(distances.min(1) < 1e-12)


def test_disks_keep_their_rim_and_their_normal():
    center, normal, radius = np.array([1.0, 2.0, 3.0]), np.array([0.0, 3.0, -4.0]), 0.5
    found = primitive(mc.Disk(center, normal, radius))
    assert found["type"] == "disk"
    # Mitsuba's disk is that of radius 1 around the origin in the plane z = 0.
    turn = np.linspace(0.0, 2.0 * np.pi, 9)
    rim = corners_of(found["to_world"], np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], 1)) - center
    np.testing.assert_allclose(np.linalg.norm(rim, axis=1), radius, rtol=1e-12)
    np.testing.assert_allclose(rim @ normal, 0.0, atol=1e-12)
    assert np.linalg.det(np.array(found["to_world"])) == pytest.approx(radius**2)
    np.testing.assert_allclose(np.array(found["to_world"])[:3, 2], normal / 5.0)


def test_triangles():
    found = primitive(mc.Triangle((0, 0, 0), (1, 0, 0), np.array([0, 1, 0])))
    assert (found["type"], found["faces"]) == ("mesh", [[0, 1, 2]])
    assert found["vertices"] == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


@pytest.mark.parametrize(
    "material, bsdf",
    [
        (mc.Diffuse((0.1, 0.2, 0.3)), {"type": "diffuse", "reflectance": COLOR}),
        (mc.Mirror((0.1, 0.2, 0.3)), {"type": "conductor", "material": "none", "specular_reflectance": COLOR}),
        (
            mc.RoughConductor(0.3, (0.1, 0.2, 0.3)),
            {
                "type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "sample_visible": True,
                "material": "none", "specular_reflectance": COLOR,
            },
        ),
        (
            mc.RoughConductor(1e-5, (0.1, 0.2, 0.3), eta=1.5, k=(2, 3, 4)),
            {
                "type": "roughconductor", "distribution": "ggx", "alpha": 1e-3, "sample_visible": True,
                "eta": {"type": "rgb", "value": [1.5] * 3}, "k": {"type": "rgb", "value": [2.0, 3.0, 4.0]},
                "specular_reflectance": COLOR,
            },
        ),
    ],
)  # fmt: skip
def test_opaque_materials_reflect_on_both_sides(material, bsdf):
    assert primitive(mc.Sphere((0, 0, 0), 1, material))["bsdf"] == {"type": "twosided", "bsdf": bsdf}


def test_glass_lights_and_sky():
    glass = primitive(mc.Sphere((0, 0, 0), 1, mc.Dielectric(1.4)))
    assert glass["bsdf"] == {"type": "dielectric", "int_ior": 1.4, "ext_ior": 1.0}
    light = primitive(mc.Sphere((0, 0, 0), 1, emission=(0.1, 0.2, 0.3)))
    assert light["emitter"] == {"type": "area", "radiance": COLOR}
    assert "emitter" not in primitive(mc.Sphere((0, 0, 0), 1, emission=0.0, two_sided=True))
    assert describe(mc.Scene([], (0.1, 0.2, 0.3)), None, 1, 1)["sky"] == {"type": "constant", "radiance": COLOR}


def test_what_mitsuba_cannot_have_is_refused():
    with pytest.raises(ValueError, match=r"primitives\[1\]: Mitsuba's lights shine to one side.*back to back"):
        grey = mc.Sphere((3, 0, 0), 1)
        describe(mc.Scene([grey, mc.Sphere((0, 0, 0), 1, emission=1, two_sided=True)]), None, 1, 1)
    with pytest.raises(ValueError, match=r"GradientSky.*envmap"):
        describe(mc.Scene([], mc.GradientSky((1, 1))), None, 1, 1)
    with pytest.raises(ValueError, match="antialias=False"):
        describe(mc.Scene([]), mc.PinholeCamera((0, 0, 5), (0, 0, 0), antialias=False), 1, 1)
    with pytest.raises(ValueError, match="bounces must be"):
        describe(mc.Scene([]), None, 1, -1)
    with pytest.raises(ValueError, match="spp must be"):
        describe(mc.Scene([]), CAMERA, 0, 1)
    with pytest.raises(ValueError, match=r"mc.PinholeCamera\(...\)"):
        describe(mc.Scene([]), "camera", 1, 1)
    with pytest.raises(ValueError, match="transformation of JAX"):
        jax.tree.map(lambda x: x, mc.Scene([])).to_mitsuba()

    def traced(radius):
        mc.Scene([mc.Sphere((0, 0, 0), radius)]).to_mitsuba()
        return radius

    with pytest.raises(ValueError, match=r"primitives\[0\]: JAX traces"):
        jax.grad(traced)(1.0)


class Recorder(dict):
    """What stands for Mitsuba's parameters of a mesh."""

    def update(self):
        self.updated = True


def stand_in(variant="scalar_rgb"):
    """Return a module with the few names of Mitsuba that are used."""
    mitsuba: types.ModuleType = types.ModuleType("mitsuba")
    mitsuba.variant = lambda: variant
    mitsuba.ScalarTransform4f = lambda rows: ("transform", rows)
    mitsuba.Properties = dict
    mitsuba.load_dict = lambda data: ("loaded", data)
    mitsuba.Mesh = lambda name, vertices, faces, props: types.SimpleNamespace(
        count=(vertices, faces), props=props, parameters=Recorder()
    )
    mitsuba.traverse = lambda mesh: mesh.parameters
    return mitsuba


def test_the_dictionary_holds_objects_of_mitsuba(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", stand_in())
    scene = mc.Scene(
        [mc.Triangle((0, 0, 0), (1, 0, 0), (0, 1, 0), emission=2.0), mc.Quad((5, 0, 0), (1, 0, 0), (0, 1, 0))]
    )
    plain, found = describe(scene, CAMERA, 16, 5), scene.to_mitsuba(CAMERA)
    assert found["sensor"]["to_world"] == ("transform", plain["sensor"]["to_world"])
    assert found["primitive_1"]["to_world"] == ("transform", plain["primitive_1"]["to_world"])
    assert found["primitive_1"]["bsdf"] == plain["primitive_1"]["bsdf"] and found["integrator"] == plain["integrator"]
    mesh = found["primitive_0"]
    assert mesh.count == (3, 1) and mesh.parameters["vertex_positions"] == [0, 0, 0, 1, 0, 0, 0, 1, 0]
    assert mesh.parameters["faces"] == [0, 1, 2] and mesh.parameters.updated
    assert mesh.props == {key: ("loaded", plain["primitive_0"][key]) for key in ("bsdf", "emitter")}
    assert with_objects(stand_in(), {"type": "scene"}) == {"type": "scene"}


def test_mitsuba_must_be_there_with_a_variant(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(ImportError, match="pip install mitsuba"):
        mc.Scene([]).to_mitsuba()
    monkeypatch.setitem(sys.modules, "mitsuba", stand_in(variant=None))
    with pytest.raises(ValueError, match="set_variant"):
        mc.Scene([]).to_mitsuba()
