"""Scalar building blocks of native loops: reads that never wrap, products that never fuse, stages.

Why they exist: XLA's CPU compiler contracts ``a * b + c`` to a fused multiply-add or not,
depending on how it cut the program into kernels. Two mappings of one function (a native loop, a
`vmap`) can then differ in a last bit, after which two runs take different paths.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
T = TypeVar("T")


def take(table: Array, index: Array) -> Array:
    """``table[index]`` of a vector, without the arithmetic for negative indices.

    `index` is a non-negative int32 or uint32 scalar; one beyond the end reads the last entry.
    """
    return lax.dynamic_slice(table, (index.astype(jnp.uint32),), (1,))[0]


def take_row(table: Array, start: Array, length: int) -> Array:
    """``table[start : start + length]`` of a vector; `start` as in `take`."""
    return lax.dynamic_slice(table, (start.astype(jnp.uint32),), (length,))


def put_row(table: Array, start: Array, row: Array) -> Array:
    """`table` with ``table[start : start + len(row)]`` replaced by `row`."""
    return lax.dynamic_update_slice(table, row, (start.astype(jnp.uint32),))


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


def once_if(condition: Array, update: Callable[[Any], Any], tables: Any) -> Any:
    """``update(tables)`` where `condition` holds, else `tables`.

    A loop of at most one turn changes its tables in place; a branch would copy them. Under `vmap`
    it takes its turn, for all runs of a batch, when any of them needs it: suits what is rare.
    """
    return lax.while_loop(
        lambda carry: carry[0], lambda carry: (jnp.bool_(False), update(carry[1])), (condition, tables)
    )[1]


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
