"""Tables addressed by a hash: which inputs have been met, and in which row of another table a key was written last.

Two inputs may share a place, so that one that was never met passes for met, rarely while few places are taken; whoever
looks up a row compares its key, and may keep equal rows twice.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take

_PLACE_BITS, _ROW_BITS = 21, 19
_SPARE = np.int32(1 << _PLACE_BITS)
"""Place that is written to where nothing is to be marked."""
_MIX = np.uint32(0x85EBCA6B)


def nothing_met() -> Array:
    """The empty table, bool."""
    return jnp.zeros((1 << _PLACE_BITS) + 1, jnp.bool_)


def mark(table: Array, inputs: Array, where: Array | bool) -> Array:
    """The table after `inputs` (int32 ``[F]``) have been met, if `where`."""
    place = lax.select(jnp.asarray(where), _mixed(inputs, _PLACE_BITS), jnp.int32(_SPARE))
    return put_row(table, place, jnp.ones(1, jnp.bool_))


def is_met(table: Array, inputs: Array) -> Array:
    """Whether `inputs` (int32 ``[F]``) have been met."""
    return take(table, _mixed(inputs, _PLACE_BITS))


def no_rows(spare: int) -> Array:
    """The table of rows before the first, int32: everywhere the row that keeps nothing."""
    return jnp.full(1 << _ROW_BITS, spare, jnp.int32)


def place_of(key: Array) -> Array:
    """Where the table of rows has that of a key (int32 ``[F]``)."""
    return _mixed(key, _ROW_BITS)


def _mixed(inputs: Array, bits: int) -> Array:
    """A number of so many bits: a multilinear hash of int32 numbers, and its higher half mixed into the lower."""
    odd = np.random.default_rng(0).integers(1 << 32, size=len(inputs), dtype=np.uint32) | np.uint32(1)
    word = jnp.sum(inputs.astype(jnp.uint32) * odd, dtype=jnp.uint32)
    word = (word ^ (word >> np.uint32(15))) * _MIX
    return (word >> np.uint32(32 - bits)).astype(jnp.int32)
