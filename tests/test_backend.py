"""XLA flags and the self-test against wrong sums."""

import os
import subprocess
import sys

import jax.numpy as jnp
import jaxlib
import numpy as np
import pytest

import jaxmc as mc
from jaxmc import backend
from jaxmc.backend import EXTRA_OPTIONS, FAST_FUSION, NO_YNN_FUSION, check_arithmetic, with_flags, workers
from jaxmc.scenes import mirror_box


def test_flags_are_added_to_nothing():
    assert with_flags("", "0.12.0").split() == [EXTRA_OPTIONS + FAST_FUSION]


def test_only_the_release_that_needs_it_gets_the_flag_that_others_do_not_know():
    assert NO_YNN_FUSION in with_flags("", "0.10.2").split()
    assert NO_YNN_FUSION not in with_flags("", "0.10.1").split()


def test_the_user_keeps_their_flags():
    flags = "--xla_cpu_max_isa=AVX2 --xla_backend_extra_options=mine=1"
    assert with_flags(flags, "0.12.0") == f"--xla_cpu_max_isa=AVX2 --xla_backend_extra_options=mine=1,{FAST_FUSION}"


@pytest.mark.parametrize("version", ["0.10.2", "0.12.0"])
def test_setting_flags_twice_changes_nothing(version):
    once = with_flags("", version)
    assert with_flags(once, version) == once


def test_arithmetic_is_right_here():
    check_arithmetic()
    assert workers() >= 1


def _run(code, **environment):
    clean = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=clean | environment)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_importing_first_is_silent_and_late_warns_once():
    assert "Warning" not in _run("import jaxmc, jax.numpy as jnp; jnp.zeros(1)")
    late = _run("import jax.numpy as jnp; jnp.zeros(1); import jaxmc; from jaxmc import backend")
    assert late.count("UserWarning") == 1 and "Import jaxmc before" in late


@pytest.mark.skipif(
    not jaxlib.__version__.startswith("0.10.2"), reason="the wrong sums are those of jaxlib 0.10.2 on CPU"
)
def test_the_self_test_refuses_a_backend_that_adds_wrongly():
    code = "import jax.numpy as jnp; jnp.zeros(1); import jaxmc\ntry: jaxmc.integrate(lambda u: u[0], dim=1, n=1)"
    assert "JAX issue 39103" in _run(code + "\nexcept RuntimeError as e: print(e)")


@pytest.mark.slow
def test_wide_rows_as_on_a_gpu_find_the_same(monkeypatch):
    tallies = {"tail": mc.TailHistogram(), "top": mc.TopSamples(50)}
    scene, camera = mirror_box(True, 30, 20)

    def found():
        options = {"tallies": tallies, "workers": 2}
        one = mc.integrate(lambda u: u[0] / jnp.sqrt(u[1]), dim=2, n=300_000, **options)
        few = mc.integrate(lambda u: u[0] * u[1], dim=2, n=3000, sampler=mc.Sobol(), **options)
        return one, few, mc.render(scene, camera, spp=5, bounces=1)

    narrow = found()
    monkeypatch.setattr(backend, "widths", lambda: backend.GPU_WIDTHS)
    wide = found()
    for a, b in zip(narrow, wide, strict=True):
        assert np.allclose(a.mean, b.mean, rtol=1e-6) and np.allclose(a.stderr, b.stderr, rtol=1e-4) and a.n == b.n
    for a, b in zip(narrow[:2], wide[:2], strict=True):
        assert all(np.array_equal(x, y) for name in tallies for x, y in zip(a[name], b[name], strict=True))
