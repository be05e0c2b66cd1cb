"""Random words: those of a run, for programs that repeat it outside of JAX, and one to choose."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core import random

KEY = jax.random.key(11)
CALM = random.WORD_RANGE - 1
"""The word on which nothing unlikely happens: no slip, no breakdown, no new road, no change of mind."""


@cache
def drawn(count: int, num_words: int, stream: int) -> list[list[int]]:
    """Random words of successive positions of a stream of `KEY`."""
    key = random.key_words(KEY)
    at_position = jax.vmap(lambda i: jnp.stack(random.words(key, i, num_words, stream)))
    return np.asarray(jax.jit(at_position)(jnp.arange(count, dtype=jnp.uint32))).tolist()
