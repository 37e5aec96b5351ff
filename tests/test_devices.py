"""Results are the same, bit for bit, on any number of devices; CPU devices of one machine stand for many."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmc as mc
from jaxmc.scenes import mirror_box

HERE = Path(__file__).parent


def function(u):
    return jnp.stack([u[0] / jnp.sqrt(u[1]), u[0] * u[2]])


def first(value):
    return value[..., 0]


def digest(estimate):
    """Return a digest of all bits of an estimate."""
    leaves = jax.tree.leaves((estimate.moments, estimate.between, estimate.tallies))
    return hashlib.sha256(b"".join(np.asarray(x).tobytes() for x in leaves)).hexdigest()


def integrals(chunk=None, workers=None):
    tallies = {"tail": mc.TailHistogram(of=first), "top": mc.TopSamples(100, of=first), "buckets": mc.Buckets(11)}
    one = mc.integrate(function, dim=3, n=700_001, tallies=tallies, chunk=chunk, workers=workers)
    few = mc.integrate(function, dim=3, n=3000, sampler=mc.Sobol(), chunk=chunk, workers=workers)
    return [digest(one), digest(few)]


def image(chunk=None, workers=None):
    scene, camera = mirror_box(True, 70, 50)
    options = {"bounces": 2, "chunk": chunk, "workers": workers}
    plain = mc.render(scene, camera, spp=70, tallies={"tail": mc.TailHistogram(mc.luminance)}, **options)
    return [digest(plain), digest(mc.render(scene, camera, spp=3, filter=mc.TentFilter(), **options))]


def elsewhere(devices, what, **options):
    """Return the digests that a process with so many devices finds."""
    code = f"import test_devices; assert len(test_devices.jax.devices()) == {devices}; "
    code += f"print('digests', *test_devices.{what}(**{options}))"
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": str(devices), "PYTHONPATH": f"{HERE.parent}:{HERE}"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("digests")[1].split()


def test_integrals_are_the_same_on_four_devices():
    assert elsewhere(4, "integrals") == integrals()


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 2, 4, 8])
def test_images_are_the_same_on_any_number_of_devices(devices):
    assert elsewhere(devices, "image") == image() and elsewhere(devices, "integrals") == integrals()


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [256, 4096, 65536])
@pytest.mark.parametrize("workers", [1, 2, 4])
def test_chunks_and_workers_change_nothing_on_two_devices(chunk, workers):
    assert elsewhere(2, "integrals", chunk=chunk, workers=workers) == integrals()
