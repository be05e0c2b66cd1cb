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
    def num_cells(self) -> int:
        return len(self.input)


class Binned(NamedTuple):
    """Rows of inputs as cells."""

    cells: Array  # [N * F] uint16, row by row
    low: Array  # [S] float32: the smallest value in a cell; its category if it is one
    high: Array  # [S] float32: the greatest value


def make_cells(categories: tuple[int, ...], num_bins: int) -> Cells:
    """Numbers the cells; `categories` as in `hrljax.trees.regression_tree.RegressionTree`."""
    sizes = np.array([size or num_bins for size in categories], np.int32)
    ends = np.cumsum(sizes, dtype=np.int32)
    which = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
    return Cells(which, (ends - sizes)[which], ends[which], np.array([not size for size in categories])[which])


def bin_inputs(inputs: Array, count: Array, categories: tuple[int, ...], num_bins: int) -> Binned:
    """Finds the bins of continuous inputs, from the valid rows, and the cell of every input of every row.

    Up to `num_bins` distinct values each have a bin of their own. More are cut by rank into bins of
    about as many rows; equal values stay together. A value below all others counts to the lowest.

    Args:
        inputs: ``[N, F]`` float32.
        count: int32 scalar, the number of valid rows; they come first.
        categories, num_bins: as in `make_cells`.
    """
    sizes = np.array([size or num_bins for size in categories], np.int32)
    cells = jnp.clip(inputs.astype(jnp.int32), 0, sizes[None] - 1)
    low = [jnp.arange(size, dtype=jnp.float32) for size in sizes]
    high = list(low)
    for i in np.flatnonzero(np.array(categories) == 0):
        low[i], high[i] = _bins(inputs[:, i], count, num_bins)
        bins = jnp.searchsorted(low[i], inputs[:, i], side="right").astype(jnp.int32) - 1
        cells = cells.at[:, i].set(jnp.maximum(bins, 0))
    starts = np.cumsum(sizes, dtype=np.int32) - sizes
    return Binned((cells + starts[None]).astype(jnp.uint16).reshape(-1), jnp.concatenate(low), jnp.concatenate(high))


def _bins(column: Array, count: Array, num_bins: int) -> tuple[Array, Array]:
    """Smallest and greatest value (float32 ``[num_bins]``) of every bin; unused ones begin at infinity.

    A value is in the last bin that begins at or below it; before that one, bins may be empty.
    """
    position = jnp.arange(len(column), dtype=jnp.int32)
    values = _sorted(jnp.where(position < count, column, np.float32(np.inf)))
    is_new = (position == 0) | (values != jnp.roll(values, 1))
    distinct = jnp.cumsum((is_new & (position < count)).astype(jnp.int32))
    bins = jnp.arange(num_bins, dtype=jnp.int32)
    of_values = jnp.searchsorted(distinct, bins + 1).astype(jnp.int32)
    by_rank = (bins * count + np.int32(num_bins - 1)) // np.int32(num_bins)
    first = jnp.where(distinct[-1] <= num_bins, of_values, by_rank)
    low = jnp.where(first < count, values[jnp.minimum(first, len(column) - 1)], np.float32(np.inf))
    after = jnp.searchsorted(values, jnp.append(low[1:], np.float32(np.inf))).astype(jnp.int32)
    return low, values[jnp.maximum(after - 1, 0)]


def _sorted(values: Array) -> Array:
    """Values in ascending order, through their bits: XLA sorts integers four times as fast on a CPU."""

    def flipped(bits: Array) -> Array:
        return bits ^ ((bits >> np.int32(31)) & np.int32(0x7FFFFFFF))

    # Adding zero makes minus zero zero.
    bits = flipped(lax.bitcast_convert_type(values + np.float32(0), jnp.int32))
    return lax.bitcast_convert_type(flipped(jnp.sort(bits)), jnp.float32)
