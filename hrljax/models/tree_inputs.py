"""Inputs of regression trees as cells: every tile kind, and every bin of a number, has a number of its own.

A tree is grown from counts and sums per cell, so that a row is read once for all tests on an input.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

MAX_CATEGORIES = 256
MAX_BINS = 1024
MAX_INPUTS = 128


class Cells(NamedTuple):
    """What a cell stands for (NumPy arrays; S cells in the order of the inputs and their values)."""

    input: np.ndarray  # [S] int32: which input
    first: np.ndarray  # [S] int32: the first cell of that input
    end: np.ndarray  # [S] int32: the cell after its last one
    continuous: np.ndarray  # [S] bool

    @property
    def count(self) -> int:
        return len(self.input)


class Binned(NamedTuple):
    """Rows of inputs as cells."""

    cells: Array  # [N * F] uint16, row by row
    low: Array  # [S] float32: the smallest value in a cell; its category if it is one
    high: Array  # [S] float32: the greatest value


def make_cells(categories: tuple[int, ...], num_bins: int) -> Cells:
    """Numbers the cells; `categories` as in `hrljax.models.regression_tree.RegressionTree`."""
    sizes = np.array([size or num_bins for size in categories], np.int32)
    ends = np.cumsum(sizes, dtype=np.int32)
    which = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
    return Cells(which, (ends - sizes)[which], ends[which], np.array([not size for size in categories])[which])


def bin_inputs(inputs: Array, count: Array, categories: tuple[int, ...], num_bins: int) -> Binned:
    """Finds the bins of continuous inputs, from the valid rows, and the cell of every input of every row.

    Up to `num_bins` distinct values each have a bin of their own. More are cut by rank into bins of
    about as many rows; equal values stay together.

    Args:
        inputs: ``[N, F]`` float32.
        count: int32 scalar, the number of valid rows; they come first.
        categories, num_bins: as in `make_cells`.
    """
    columns, low, high = [], [], []
    start = 0
    for i, size in enumerate(categories):
        column = inputs[:, i]
        if size:
            own = jnp.clip(column.astype(jnp.int32), 0, size - 1)
            edges = (np.arange(size, dtype=np.float32),) * 2
        else:
            edges = _bins(column, count, num_bins)
            own = _bin_of(column, edges[0])
        columns.append((own + np.int32(start)).astype(jnp.uint16))
        low.append(edges[0])
        high.append(edges[1])
        start += size or num_bins
    return Binned(jnp.stack(columns, axis=1).reshape(-1), jnp.concatenate(low), jnp.concatenate(high))


def _bins(column: Array, count: Array, num_bins: int) -> tuple[Array, Array]:
    """Smallest and greatest value (float32 ``[num_bins]``) of every bin; unused ones have infinity."""
    position = jnp.arange(len(column), dtype=jnp.int32)
    values = jnp.sort(jnp.where(position < count, column, np.float32(np.inf)))
    unused = jnp.full(num_bins, np.inf, jnp.float32)

    def scan_values(by_rank: Array) -> tuple[Array, Array, Array]:
        def step(i: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            low, high, last, distinct, bin_ = carry
            value = lax.dynamic_slice(values, (i.astype(jnp.uint32),), (1,))
            is_new = (i == 0) | (value[0] != last)
            distinct = distinct + is_new.astype(jnp.int32)
            # i * num_bins / count without overflow is not needed: both are small (checked).
            wanted = lax.select(by_rank, i * np.int32(num_bins) // count, lax.min(distinct - 1, np.int32(num_bins - 1)))
            bin_ = lax.select(is_new, wanted, bin_)
            place = (bin_.astype(jnp.uint32),)
            low = lax.dynamic_update_slice(low, lax.min(lax.dynamic_slice(low, place, (1,)), value), place)
            return low, lax.dynamic_update_slice(high, value, place), value[0], distinct, bin_

        nothing = jnp.int32(0)
        low, high, _, distinct, _ = lax.fori_loop(
            jnp.int32(0), count, step, (unused, unused, jnp.float32(0), nothing, nothing)
        )
        return low, high, distinct

    low, high, distinct = scan_values(jnp.bool_(False))
    too_many = distinct > num_bins

    def again(_: tuple[Array, Array]) -> tuple[Array, Array]:
        return scan_values(jnp.bool_(True))[:2]

    low, high = lax.cond(too_many, again, lambda kept: kept, (low, high))
    return _without_gaps(low, high)


def _without_gaps(low: Array, high: Array) -> tuple[Array, Array]:
    """Bins that no value fell into go to the end."""
    return jnp.sort(low), jnp.sort(high)


def _bin_of(column: Array, low: Array) -> Array:
    """The last bin (int32) that starts at or below each value; the first if none does."""
    found = jnp.searchsorted(low, column, side="right").astype(jnp.int32)
    return jnp.maximum(found - 1, 0)
