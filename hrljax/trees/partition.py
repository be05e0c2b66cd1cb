"""Rows of a node cut in two, in place."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take, take_row

CHUNK = 16
"""Rows that are copied at once: arrays of rows have so many places more than rows."""


def parted(
    rows: Array, scratch: Array, start: Array, end: Array, passes: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """`rows` after those from `start` to `end` that pass a test were put first; `scratch`; the end of those that pass.

    Args:
        rows, scratch: ``[N + CHUNK]`` int32.
        start, end: int32 scalars.
        passes: whether a row (int32) passes.
    """

    # Into another array and back, because a swap in place would be copied with the whole array.
    def step(i: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        left, right, scratch = carry
        row = take(rows, i)
        goes_left = passes(row)
        scratch = put_row(scratch, lax.select(goes_left, left, right), row[None])
        moved = goes_left.astype(jnp.int32)
        return left + moved, right - (1 - moved), scratch

    middle, _, scratch = lax.fori_loop(start, end, step, (start, end - 1, scratch))

    def copy_back(chunk: Array, rows: Array) -> Array:
        first = start + chunk * np.int32(CHUNK)
        inside = first + np.arange(CHUNK, dtype=np.int32) < end
        return put_row(rows, first, jnp.where(inside, take_row(scratch, first, CHUNK), take_row(rows, first, CHUNK)))

    chunks = (end - start + np.int32(CHUNK - 1)) // np.int32(CHUNK)
    return lax.fori_loop(jnp.int32(0), chunks, copy_back, rows), scratch, middle
