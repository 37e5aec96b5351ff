"""Arithmetic whose derivative is 0 where its value is infinite or NaN.

A ray computes what it does not use: the distance to a plane that it runs along, the root of a sphere that it misses.
Such values lose every comparison, but the chain rule would multiply their infinite derivatives by 0 and get NaN.
Values are those of the plain operations, at no cost.
"""

import jax
import jax.numpy as jnp


@jax.custom_jvp
def root(x):
    """Return the square root of ``x``, NaN below 0."""
    return jnp.sqrt(x)


@root.defjvp
def _root(x, tangent):
    y = jnp.sqrt(x[0])
    return y, tangent[0] * _finite_or_zero(0.5 / y)


@jax.custom_jvp
def reciprocal(x):
    """Return 1 / ``x``, infinite at 0."""
    return jnp.divide(1.0, x)


@reciprocal.defjvp
def _reciprocal(x, tangent):
    y = jnp.divide(1.0, x[0])
    return y, -tangent[0] * _finite_or_zero(y * y)


@jax.custom_jvp
def product(x, y):
    """Return ``x`` times ``y``, which may be infinite."""
    return x * y


@product.defjvp
def _product(factors, tangents):
    x, y = factors
    return x * y, tangents[0] * _finite_or_zero(y) + tangents[1] * x


@jax.custom_jvp
def quotient(x, y):
    """Return ``x`` over ``y``, which may be 0."""
    return jnp.divide(x, y)


@quotient.defjvp
def _quotient(operands, tangents):
    x, y = operands
    slope = _finite_or_zero(jnp.divide(1.0, y))
    return jnp.divide(x, y), (tangents[0] - tangents[1] * (x * slope)) * slope


@jax.custom_jvp
def drawn_with(probability):
    """Return 1, with the logarithmic derivative of the probability of a choice that counts as made.

    What is worth ``share / probability`` where both are equal has this derivative once the choice stays as it is.
    """
    # A choice that the compiler takes: the result then has the batch axes of the probability.
    return jnp.where(True, 1.0, probability)


@drawn_with.defjvp
def _drawn_with(x, tangent):
    return drawn_with(x[0]), tangent[0] * _finite_or_zero(1.0 / x[0])


def _finite_or_zero(x):
    return jnp.where(jnp.isfinite(x), x, 0.0)
