"""An integrand whose value is a tree, for tests of what must hold for any value; all that use it share its kernels."""

import jax.numpy as jnp


def tree(u):
    """Two coordinates to a scalar with a heavy tail and an array of shape (3,)."""
    return {"a": u[0] / jnp.sqrt(u[1]), "b": jnp.stack([u[0], jnp.exp(u[1]), u[0] * u[1] - 7.0])}


def of_a(values):
    return values["a"]


def of_b(values):
    return values["b"]
