"""XLA flags, threads and devices: the only module that looks at the machine.

Importing this module sets the XLA flags that make the kernels fast and correct, provided that JAX has not started its
backend yet. Both flags are read once, when the backend starts:

* ``xla_cpu_use_multi_output_fusion``: several results of one computation share one loop. Without it XLA:CPU recomputes
  the common part for every component of a vector, which makes path kernels 2.7 to 4 times slower.
* ``xla_cpu_experimental_ynn_fusion_type=`` (empty): turns off a fusion that computes wrong sums over short axes in
  jaxlib 0.10.2 on CPU (JAX issue 39103).
"""

import functools
import os
import warnings
from typing import NamedTuple

import jax
import jaxlib
import numpy as np
from jax._src import distributed, xla_bridge

FAST_FUSION = "xla_cpu_use_multi_output_fusion"
NO_YNN_FUSION = "--xla_cpu_experimental_ynn_fusion_type="
KERNEL_OPTIONS = {
    "xla_cpu_prefer_vector_width": "512",  # measured 1.1 times faster than 256 with AVX-512
    # Threads run whole kernels: with this pass XLA would also spread single loops over its own threads, at 4 times the
    # cost where a row has 512 lanes or more. The second pass makes three loops of every sum, and these would be half of
    # all loops of a small kernel: without it, that is compiled in three quarters of the time.
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner,tree_reduction_rewriter",
}


class Widths(NamedTuple):
    """How samples are cut: so many ``lanes`` side by side in a row, and ``chunk`` samples to a kernel call.

    A call is long against its own cost, and short against a progress bar.
    """

    lanes: int
    chunk: int


# A row stays in the cache; measured 10 % faster than 960. Of powers of two, arrays compete for the same cache sets.
CPU_WIDTHS = Widths(1920, 1 << 18)
# A row fills the device. Not measured yet.
GPU_WIDTHS = Widths(1 << 16, 1 << 23)

# For what runs once: compiled in a third of the time, and correct all the same.
QUICK_OPTIONS = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
EXTRA_OPTIONS = "--xla_backend_extra_options="


def configure() -> None:
    """Set the XLA flags, or warn once when the backend has already started without them."""
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = with_flags(flags, jaxlib.__version__)
    if wanted == flags:
        return
    if xla_bridge.backends_are_initialized():
        warnings.warn(
            "JAX was started before jaxmc was imported, so CPU kernels run 2 to 4 times slower than they could. "
            f"Import jaxmc before the first JAX computation, or set XLA_FLAGS='{wanted}'.",
            stacklevel=3,
        )
    else:
        os.environ["XLA_FLAGS"] = wanted


def with_flags(flags: str, jaxlib_version: str) -> str:
    """Return ``flags`` with the project's own added; flags that the user has set stay as they are."""
    words = flags.split()
    # A second --xla_backend_extra_options would replace the user's, so append to theirs.
    extra = next((i for i, word in enumerate(words) if word.startswith(EXTRA_OPTIONS)), None)
    if extra is None:
        words.append(EXTRA_OPTIONS + FAST_FUSION)
    elif FAST_FUSION not in words[extra]:
        words[extra] += "," + FAST_FUSION
    # XLA aborts the process on a flag that it does not know: name this one only to the release that needs it.
    if jaxlib_version.startswith("0.10.2") and "xla_cpu_experimental_ynn_fusion_type" not in flags:
        words.append(NO_YNN_FUSION)
    return " ".join(words)


def workers() -> int:
    """Return how many threads to run kernels on: one more than there are cores, so that none waits while results are
    folded, or 2 for a GPU."""
    if jax.default_backend() != "cpu":
        return 2
    return 1 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@functools.cache
def widths() -> Widths:
    """Return how samples are cut on the backend that JAX uses."""
    return CPU_WIDTHS if jax.default_backend() == "cpu" else GPU_WIDTHS


@functools.cache
def mesh() -> jax.sharding.Mesh | None:
    """Return all devices of this process in a row, among which blocks of samples are divided; None for a single one."""
    devices = jax.local_devices()
    return jax.sharding.Mesh(np.array(devices), ("blocks",)) if len(devices) > 1 else None


def processes():
    """Return the key-value store of ``jax.distributed``, or None, the number of this process, how many there are, and
    the address of the first one."""
    state = distributed.global_state
    return state.client, state.process_id, state.num_processes, state.coordinator_address


@functools.cache
def check_arithmetic() -> None:
    """Refuse to run where the backend adds wrongly over a short axis, as jaxlib 0.10.2 does on CPU by default.

    Raises:
        RuntimeError: a fused sum over an axis of length 3 is wrong.
    """
    rng = np.random.default_rng(0)
    n, o, d = (rng.random((rows, 3), np.float32) for rows in (32, 2048, 2048))
    got = jax.jit(lambda n, o, d: (n * o[:, None]).sum(-1) + (n * d[:, None]).sum(-1))(n, o, d)
    if not np.allclose(got, o @ n.T + d @ n.T, rtol=1e-5):
        raise RuntimeError(
            f"jaxlib {jaxlib.__version__} computes wrong sums on this machine (JAX issue 39103). "
            f"Import jaxmc before the first JAX computation, or set XLA_FLAGS='{NO_YNN_FUSION}', or upgrade jaxlib."
        )
