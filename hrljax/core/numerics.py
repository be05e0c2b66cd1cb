"""Scalar building blocks of native loops: reads that never wrap, products that never fuse, stages.

Why they exist: XLA's CPU compiler contracts ``a * b + c`` to a fused multiply-add or not,
depending on how it cut the program into kernels. Two mappings of one function (a native loop, a
`vmap`) can then differ in a last bit, after which two runs take different paths.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
T = TypeVar("T")


def take(table: Array, index: Array) -> Array:
    """``table[index]`` of a vector, without the arithmetic for negative indices.

    `index` is a non-negative int32 or uint32 scalar; one beyond the end reads the last entry.
    """
    return take_row(table, index, 1)[0]


def take_row(table: Array, start: Array, length: int) -> Array:
    """``table[start : start + length]`` of a vector; `start` as in `take`."""

    @custom_vmap
    def read(table: Array, start: Array) -> Array:
        return lax.dynamic_slice(table, (start,), (length,))

    @read.def_vmap
    def read_each(size: int, batched: list[bool], table: Array, start: Array) -> tuple[Array, bool]:
        if not batched[1]:
            return lax.dynamic_slice_in_dim(table, start, length, axis=1), True
        flat, places = _in_one_vector(table, start, length)
        numbers = lax.GatherDimensionNumbers(offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,))
        return lax.gather(flat, places, numbers, (length,), mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS), True

    return read(table, start.astype(jnp.uint32))


def put_row(table: Array, start: Array, row: Array) -> Array:
    """`table` with ``table[start : start + len(row)]`` replaced by `row`."""

    @custom_vmap
    def write(table: Array, start: Array, row: Array) -> Array:
        return lax.dynamic_update_slice(table, row, (start,))

    @write.def_vmap
    def write_each(size: int, batched: list[bool], *arguments: Array) -> tuple[Array, bool]:
        table, start, row = (
            leaf if is_batched else jnp.broadcast_to(leaf, (size, *leaf.shape))
            for leaf, is_batched in zip(arguments, batched, strict=True)
        )
        flat, places = _in_one_vector(table, start, row.shape[1])
        numbers = lax.ScatterDimensionNumbers((1,), (), (0,))
        mode = lax.GatherScatterMode.PROMISE_IN_BOUNDS
        flat = lax.scatter(flat, places, row, numbers, indices_are_sorted=True, unique_indices=True, mode=mode)
        return flat.reshape(table.shape), True

    return write(table, start.astype(jnp.uint32), row)


def _in_one_vector(tables: Array, starts: Array, length: int) -> tuple[Array, Array]:
    """The tables of N runs, or the one that all have, as one vector, and where in it rows begin (``[N, 1]`` int32).

    What `vmap` would make of a slice, a gather with an axis of runs, takes much longer.
    """
    size = tables.shape[-1]
    places = lax.min(starts, np.uint32(size - length)).astype(jnp.int32)
    if tables.ndim == 2:
        places += np.arange(len(tables), dtype=np.int32) * np.int32(size)
    return tables.reshape(-1), places[:, None]


def opaque_zero(word: Array) -> Array:
    """Zero (uint32), computed from any uint32 `word` in a way that no compiler folds.

    Squares are 0, 1, 4 or 9 modulo 16, so their bits 2 and 3 are never both set. Of single bits
    that never change LLVM knows (bit 2 of the square of an odd number is one), of pairs it does not.
    A word that is a constant is folded all the same: give it data, not the counter of a loop.
    """
    square = word * word
    return square & (square >> np.uint32(1)) & np.uint32(4)


def exact_product(a: Array | np.float32, b: Array, zero: Array) -> Array:
    """``a * b``, rounded by itself: never contracted with an addition into a fused multiply-add.

    Args:
        a: float32 or float64 array, or a constant.
        b: array of the same dtype, broadcastable with `a`.
        zero: what `opaque_zero` returned (uint32 scalar).
    """
    if isinstance(a, np.floating) and a == 1:
        return b
    product = a * b
    bits_type = jnp.uint32 if product.dtype == jnp.float32 else jnp.uint64
    bits = lax.bitcast_convert_type(product, bits_type) ^ lax.convert_element_type(zero, bits_type)
    return lax.bitcast_convert_type(bits, product.dtype)


def expectation(probabilities: list[Array], values: list[Array], zero: Array) -> Array:
    """``sum_m p_m v_m`` of M scalars (or arrays) each, added in order."""
    total = jnp.zeros_like(probabilities[0])
    for probability, value in zip(probabilities, values, strict=True):
        total = total + exact_product(probability, value, zero)
    return total


def stage(function: Callable[P, T]) -> Callable[P, T]:
    """A part of a loop's body whose results are computed once, not again in each consumer.

    XLA's fusion copies cheap operations into every kernel that uses them; a call that it may not
    inline stops that. Changes speed only, never a result.
    """
    compiled = jax.jit(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return call
