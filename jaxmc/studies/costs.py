"""What rays, paths and their compilation cost: operations, seconds of cores, nanoseconds for each ray and primitive."""

import math
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import backend
from ..integration.kernel import LANES
from ..scenes import many_spheres
from ..transport.hits import closest_hit, unoccluded
from ..transport.integrands import path_integrand
from ..transport.rays import ray
from ..transport.vec import Vec3

ROWS = 16  # of LANES rays each, one after the other, so that the state of a row stays in the cache
WORK = 1e8  # rays times primitives that are timed at least
MOVES = {  # what moves or names values, and computes none
    "broadcast_in_dim", "concatenate", "convert_element_type", "copy", "dynamic_slice", "gather", "iota", "reshape",
    "slice", "squeeze", "stack", "stop_gradient", "transpose",
}  # fmt: skip


class RayCost(NamedTuple):
    """Costs of rays in a scene of ``count`` primitives, on one core: seconds to compile the closest hit, the shadow
    test and a path, and nanoseconds for each ray and primitive of the first two."""

    count: int
    compile_closest: float
    compile_shadow: float
    compile_path: float
    ns_closest: float
    ns_shadow: float


def operations(integrand) -> float:
    """Return how many numbers are computed for each point of an integrand, as JAX has traced it: every round of a loop,
    both sides of a choice of values, the longest branch. What points share, counts once for a row of them. XLA may do
    with fewer.
    """
    u = np.zeros((LANES, integrand.dim), jnp.result_type(float))
    return _operations(jax.make_jaxpr(jax.vmap(integrand))(u).jaxpr) / LANES


def _operations(jaxpr):
    total = 0
    for equation in jaxpr.eqns:
        inner = [j for value in equation.params.values() for j in _jaxprs(value)]
        rounds = equation.params.get("length", 1) if equation.primitive.name == "scan" else 1
        if equation.primitive.name == "while":
            raise ValueError("the number of rounds of a while loop is not known")
        if equation.primitive.name == "cond":
            total += max(map(_operations, inner))
        elif inner:
            total += rounds * sum(map(_operations, inner))
        elif equation.primitive.name not in MOVES:
            total += sum(math.prod(v.aval.shape) for v in equation.outvars)
    return total


def _jaxprs(value):
    for one in value if isinstance(value, tuple | list) else (value,):
        inner = getattr(one, "jaxpr", one)
        if hasattr(inner, "eqns"):
            yield inner


def compiled(fn, *args):
    """Return ``fn``, compiled for arguments like ``args`` as kernels are, and the seconds of cores that it took to
    trace and compile it. A number that nobody needs keeps JAX from finding it among what was compiled before."""
    salt = time.time_ns() % (1 << 30)
    started = time.process_time()
    jitted = jax.jit(lambda *args: (fn(*args), jnp.int32(salt)), compiler_options=backend.KERNEL_OPTIONS)
    program = jitted.lower(*args).compile()
    return (lambda *args: program(*args)[0]), time.process_time() - started


def compile_seconds(integrand) -> float:
    """Return the seconds of cores that it takes to trace and compile one row of points of an integrand."""
    return compiled(lambda f, u: jax.vmap(f)(u), integrand, np.zeros((LANES, integrand.dim), jnp.result_type(float)))[1]


def ray_cost(count, seed=0, rows=ROWS, work=WORK) -> RayCost:
    """Measure rays from random points in random directions among ``count`` spheres, ``work`` rays times spheres."""
    scene, camera = many_spheres(count, seed=seed)
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(3, rows, LANES))
    origins = rng.uniform(size=(3, rows, LANES))
    rays = [x.astype(jnp.result_type(float)) for x in (origins, directions / np.linalg.norm(directions, axis=0))]

    def closest(scene, origin, direction):
        hit = closest_hit(scene, ray(origin, direction))
        return hit.distance, hit.face

    def shadow(scene, origin, direction):
        return unoccluded(scene, ray(origin, direction), 0.5, -1, None, anywhere=True)

    seconds, nanoseconds = [], []
    for question in (closest, shadow):

        def ask(scene, origins, directions, question=question):
            each = jax.vmap(lambda o, d: question(scene, Vec3(*o), Vec3(*d)))
            return lax.map(lambda row: each(*row), (Vec3(*origins), Vec3(*directions)))

        program, compiling = compiled(ask, scene, *rays)
        seconds.append(compiling)
        nanoseconds.append(1e9 * _core_seconds(program, (scene, *rays), work / (rows * LANES * count)))
    seconds.append(compile_seconds(path_integrand(scene, camera, bounces=5)))
    return RayCost(count, *seconds, *(float(ns / (rows * LANES * count)) for ns in nanoseconds))


def _core_seconds(program, args, calls):
    """Return the least seconds of cores of a call, in 5 series of calls."""
    args = jax.device_put(args)
    jax.block_until_ready(program(*args))
    calls, least = max(1, math.ceil(calls / 5)), math.inf
    for _ in range(5):
        started = time.process_time()
        for _ in range(calls):
            result = program(*args)
        jax.block_until_ready(result)
        least = min(least, (time.process_time() - started) / calls)
    return least
