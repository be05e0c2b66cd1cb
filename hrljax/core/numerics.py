"""Scalar building blocks of native loops: reads that never wrap, products that never fuse, stages.

Why they exist: XLA's CPU compiler contracts ``a * b + c`` to a fused multiply-add or not,
depending on how it cut the program into kernels. Two mappings of one function (a native loop, a
`vmap`) can then differ in a last bit, after which two runs take different paths.
"""

from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
T = TypeVar("T")
_IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS


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
        places = _places(table, start, length)[:, None]
        numbers = lax.GatherDimensionNumbers(offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,))
        return lax.gather(table.reshape(-1), places, numbers, (length,), mode=_IN_BOUNDS), True

    return read(table, start.astype(jnp.uint32))


def put_row(table: Array, start: Array, row: Array) -> Array:
    """`table` with ``table[start : start + len(row)]`` replaced by `row`."""
    return put_rows(table, [start], [row])


def put_rows(table: Array, starts: Sequence[Array], rows: Sequence[Array]) -> Array:
    """`table` with several rows replaced, one after the other."""

    @custom_vmap
    def write(table: Array, starts: list[Array], rows: list[Array]) -> Array:
        for start, row in zip(starts, rows, strict=True):
            table = lax.dynamic_update_slice(table, row, (start,))
        return table

    @write.def_vmap
    def write_each(
        size: int, batched: list[Any], table: Array, starts: list[Array], rows: list[Array]
    ) -> tuple[Array, bool]:
        table, starts, rows = jax.tree.map(partial(of_every_run, size), (table, starts, rows), tuple(batched))
        flat, lengths = table.reshape(-1), [row.shape[1] for row in rows]
        places = [_places(table, start, length) for start, length in zip(starts, lengths, strict=True)]

        def one_by_one() -> Array:
            def put(run: Array, flat: Array) -> Array:
                for place, row in zip(places, rows, strict=True):
                    start = lax.dynamic_index_in_dim(place, run, keepdims=False).astype(jnp.uint32)
                    flat = lax.dynamic_update_slice(flat, lax.dynamic_index_in_dim(row, run, keepdims=False), (start,))
                return flat

            return lax.fori_loop(0, size, put, flat)

        def all_at_once() -> Array:
            numbers, after = lax.ScatterDimensionNumbers((1,), (), (0,)), flat
            options = {"indices_are_sorted": True, "unique_indices": True, "mode": _IN_BOUNDS}
            for place, row in zip(places, rows, strict=True):
                after = lax.scatter(after, place[:, None], row, numbers, **options)
            return after

        # A loop that holds a scatter does not become a native function.
        written = lax.platform_dependent(cpu=one_by_one, default=all_at_once)
        return written.reshape(table.shape), True

    return write(table, [start.astype(jnp.uint32) for start in starts], list(rows))


def of_every_run(size: int, leaf: Array, is_batched: bool) -> Array:
    """What `vmap` gives a rule, with a leading axis of runs in any case."""
    return leaf if is_batched else jnp.broadcast_to(leaf, (size, *leaf.shape))


def _places(tables: Array, starts: Array, length: int) -> Array:
    """Where rows begin (``[N]`` int32) in one vector of the tables of N runs, or in the table that all have.

    What `vmap` would make of a slice, a gather with an axis of runs, takes much longer.
    """
    size = tables.shape[-1]
    places = lax.min(starts, np.uint32(size - length)).astype(jnp.int32)
    if tables.ndim == 2:
        places += np.arange(len(tables), dtype=np.int32) * np.int32(size)
    return places


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
