"""The context of a step that counts, in the first episode."""

import jax.numpy as jnp

from hrljax.learners.base import Context


def learning() -> Context:
    return Context(jnp.int32(0), jnp.bool_(True), jnp.uint32(0))
