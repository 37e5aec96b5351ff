"""Bad input gets a ValueError that says what was passed or expected."""

import numpy as np
import pytest

import jaxmc as mc
from jaxmc import scenes
from jaxmc.integration.counts import is_count, positive

SCENE, CAMERA = scenes.cornell_box(8, 8)
NAN, INF = float("nan"), float("inf")


def quad(corner=(0, 0, 0), edge_u=(1, 0, 0), edge_v=(0, 1, 0), **surface):
    return mc.Quad(corner, edge_u, edge_v, **surface)


def sphere(center=(0, 0, 0), radius=1.0, **surface):
    return mc.Sphere(center, radius, **surface)


def paths(**options):
    return mc.path_integrand(SCENE, CAMERA, **{"bounces": 2, **options})


CASES = [
    ("vertex nan", lambda: quad(corner=(0, NAN, 0)), "corner must be finite"),
    ("vertex infinite", lambda: quad(edge_u=(INF, 0, 0)), "edge_u must be finite"),
    ("vertex of two", lambda: quad(corner=(0, 1)), "three numbers"),
    ("vertex of words", lambda: quad(corner=("a", "b", "c")), "numbers"),
    ("parallel edges", lambda: quad(edge_v=(2, 0, 0)), "no area"),
    ("zero edge", lambda: quad(edge_v=(0, 0, 0)), "no area"),
    (
        "quad too large",
        lambda: mc.Scene([quad(edge_u=(1e308, 0, 0), edge_v=(0, 1e308, 0))]),
        "a Quad has a length of 1e",
    ),
    ("quad too small", lambda: mc.Scene([quad(edge_u=(1e-200, 0, 0), edge_v=(0, 1, 0))]), "a Quad has a length of 1e"),
    ("triangle too large", lambda: mc.Triangle((-1e308, 0, 0), (1e308, 0, 0), (0, 1, 0)), "edges must be finite"),
    ("negative radius", lambda: sphere(radius=-1.0), "radius"),
    ("zero radius", lambda: sphere(radius=0.0), "radius"),
    ("nan radius", lambda: sphere(radius=NAN), "radius"),
    ("radius of two", lambda: sphere(radius=(1, 2)), "one number"),
    ("disk normal zero", lambda: mc.Disk((0, 0, 0), (0, 0, 0), 1.0), "Disk normal must not be zero"),
    ("disk normal too long", lambda: mc.Disk((0, 0, 0), (1e308, 1e308, 0), 1.0), "so long that its square"),
    ("disk normal of two", lambda: mc.Disk((0, 0, 0), (0, 1), 1.0), "Disk normal must be three numbers"),
    ("disk radius zero", lambda: mc.Disk((0, 0, 0), (0, 0, 1), 0.0), "Disk radius must be finite and greater than 0"),
    ("disk center nan", lambda: mc.Disk((0, 0, NAN), (0, 0, 1), 1.0), "Disk center must be finite"),
    ("disk albedo", lambda: mc.Disk((0, 0, 0), (0, 0, 1), 1.0, mc.Diffuse(1.1)), r"albedo must lie in \[0, 1\]"),
    ("disk too small", lambda: mc.Scene([mc.Disk((0, 0, 0), (0, 0, 1), 1e-200)]), "a Disk has a length of 1e-200"),
    ("center infinite", lambda: sphere(center=(0, 0, INF)), "center must be finite"),
    ("albedo above 1", lambda: quad(material=mc.Diffuse(1.1)), r"albedo must lie in \[0, 1\]"),
    ("negative albedo", lambda: quad(material=mc.Diffuse(-0.1)), "not negative"),
    ("albedo of two", lambda: quad(material=mc.Diffuse((0.1, 0.2))), "RGB triple"),
    ("nan albedo", lambda: sphere(material=mc.Diffuse(NAN)), "finite"),
    ("reflectance above 1", lambda: sphere(material=mc.Mirror((0.5, 0.5, 1.5))), "reflectance must lie"),
    ("negative emission", lambda: quad(emission=-1.0), "not negative"),
    ("nan emission", lambda: quad(emission=(1, NAN, 1)), "finite"),
    ("no material", lambda: quad(material="white"), r"mc.Diffuse\(albedo\)"),
    ("no primitive", lambda: mc.Scene([quad(), "sphere"]), "mc.Sphere, mc.Quad, mc.Triangle, mc.Disk and mc.Box"),
    ("negative sky", lambda: mc.Scene([], sky=-1.0), "not negative"),
    ("directions", lambda: paths(directions="best"), "cosine, uniform"),
    ("lights", lambda: paths(lights="all"), "mis, nee, none"),
    ("bounces negative", lambda: paths(bounces=-1), "bounces"),
    ("bounces fraction", lambda: paths(bounces=2.5), "bounces"),
    ("clamp zero", lambda: paths(clamp=0.0), "clamp"),
    ("clamp nan", lambda: paths(clamp=NAN), "clamp"),
    ("scene is a list", lambda: mc.path_integrand([quad()], CAMERA, bounces=1), "mc.Scene"),
    ("camera is none", lambda: mc.path_integrand(SCENE, None, bounces=1), "PinholeCamera"),
    ("fov 0", lambda: mc.PinholeCamera((0, 0, 1), (0, 0, 0), fov=0), "between 0 and 180"),
    ("fov 180", lambda: mc.PinholeCamera((0, 0, 1), (0, 0, 0), fov=180), "between 0 and 180"),
    ("camera on target", lambda: mc.PinholeCamera((0, 0, 0), (0, 0, 0)), "coincide"),
    ("camera along up", lambda: mc.PinholeCamera((0, 1, 0), (0, 0, 0), up=(0, 1, 0)), "up"),
    ("width 0", lambda: mc.PinholeCamera((0, 0, 1), (0, 0, 0), width=0), "width"),
    ("height fraction", lambda: mc.PinholeCamera((0, 0, 1), (0, 0, 0), height=1.5), "height"),
    ("spp 0", lambda: mc.render(SCENE, CAMERA, spp=0), "spp"),
    ("n 0", lambda: mc.integrate(paths(), n=0), "n must be"),
    ("dim mismatch", lambda: mc.integrate(paths(), dim=3, n=10), "contradicts"),
    ("no dim", lambda: mc.integrate(lambda u: u[0], n=10), "dim"),
    ("points of other dim", lambda: paths().batch(np.zeros((4, 3))), "shape"),
    ("direction zero", lambda: mc.radiance(SCENE, (0, 0, 0), (0, 0, 0), bounces=1), "zero"),
    ("normal zero", lambda: mc.irradiance(SCENE, (0, 0, 0), (0, 0, 0), bounces=1), "zero"),
    ("origin nan", lambda: mc.radiance(SCENE, (0, NAN, 0), (0, 0, 1), bounces=1), "finite"),
    ("rays of two shapes", lambda: mc.intersect(SCENE, np.zeros((2, 3)), np.zeros((3, 3))), r"\(n, 3\)"),
    ("rays of two numbers", lambda: mc.intersect(SCENE, np.zeros((2, 2)), np.zeros((2, 2))), r"\(n, 3\)"),
    ("negative index", lambda: mc.replay(SCENE, CAMERA, -1, bounces=1), "indices"),
    ("index of a word", lambda: mc.replay(SCENE, CAMERA, ["a"], bounces=1), "indices"),
    ("events", lambda: mc.path_throughput(SCENE, CAMERA, events=(0,)), "events"),
]


@pytest.mark.parametrize(("make", "words"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_bad_input_is_refused_with_the_cure(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize("value", [0, -1, 2.0, True, np.True_, np.float32(3), None, "4", 1 << 63, np.uint64(1 << 63)])
def test_what_is_no_count(value):
    assert not is_count(value)
    with pytest.raises(ValueError, match=r"spp must be a positive integer.*, got .*; take one or more"):
        positive("spp", value, cure="take one or more")


@pytest.mark.parametrize("value", [1, (1 << 63) - 1, np.int8(7), np.uint64(1 << 62)])
def test_counts_become_ints(value):
    count = positive("n", value)
    assert count == value and type(count) is int


def test_counts_have_limits():
    assert is_count(0, least=0) and is_count(9, most=9) and not is_count(10, most=9)
    with pytest.raises(ValueError, match=r"width must be a positive integer up to 9, got 10$"):
        positive("width", 10, most=9)
