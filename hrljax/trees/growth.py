"""Growing one regression tree: the best test of a node, its rows cut in two, the next node.

Targets are whole multiples of a power of two, so that sums are exact: they do not depend on the
order of rows, and the histogram of a node's greater child is the node's minus the smaller child's
(as in LightGBM, Ke et al. 2017). Only the smaller child's rows are read.

The code is sequential. It is fast as a native loop (`hrljax.engine.compiler`), and gives the same tree under `vmap`.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take, take_row
from hrljax.trees.inputs import Binned, Cells
from hrljax.trees.partition import CHUNK, parted

LEAF = 0
"""Word of a leaf."""
INPUT_BITS = 7
EQUALS = 1 << INPUT_BITS
"""Bit of a word: the test is ``== number``; else ``< number``."""
LEFT_SHIFT = INPUT_BITS + 1
MAX_NODES = 1 << (31 - LEFT_SHIFT)

_NEGLIGIBLE = np.float32(2.0**-6)
"""Means, in quanta, that differ by less are equal: float32 holds those of equal targets to 2^-7."""


class Quanta(NamedTuple):
    """Targets as whole numbers."""

    values: Array  # [K, N] int32
    size: Array  # [K] float32, powers of two: what 1 means


class Sample(NamedTuple):
    """What a tree is grown from, and where."""

    binned: Binned
    values: Array  # [K * N] int32: whole-number targets of all trees
    offset: Array  # int32 scalar: where this tree's begin
    quantum: Array  # float32 scalar: what 1 means
    base: Array  # int32 scalar: the tree's root in the arrays of nodes


class Growth(NamedTuple):
    """Static limits."""

    cells: Cells
    max_depth: int
    min_leaf: int
    num_inputs: int


class Arrays(NamedTuple):
    """What growing changes."""

    words: Array  # [nodes] int32
    numbers: Array  # [nodes] float32
    rows: Array  # [N + CHUNK] int32: the rows of a node lie side by side
    sorted_rows: Array  # [N + CHUNK] int32: where they are sorted
    histograms: Array  # [slots * 2 * S] int32: counts and sums of the nodes that wait
    waiting: Array  # [slots * 5] int32: node, first of its rows, their number, their sum, depth


def num_slots(num_rows: int, max_depth: int) -> int:
    """How many nodes can wait: of two children, the smaller is grown first."""
    return min(max_depth, num_rows.bit_length()) + 1


def empty_arrays(growth: Growth, num_nodes: int, rows: Array) -> Arrays:
    """Arrays for so many nodes of all trees together, and rows sorted by tree."""
    slots = num_slots(len(rows), growth.max_depth)
    return Arrays(
        words=jnp.zeros(num_nodes, jnp.int32),
        numbers=jnp.zeros(num_nodes, jnp.float32),
        rows=jnp.concatenate([rows, jnp.zeros(CHUNK, jnp.int32)]),
        sorted_rows=jnp.zeros(len(rows) + CHUNK, jnp.int32),
        histograms=jnp.zeros(slots * 2 * growth.cells.num_cells, jnp.int32),
        waiting=jnp.zeros(slots * 5, jnp.int32),
    )


def quantise(targets: Array, valid: Array) -> Quanta:
    """Rounds targets to multiples of the smallest power of two with which sums of all rows fit an int32.

    Args:
        targets: ``[K, N]`` float32.
        valid: ``[N]`` bool; other rows count as 0.
    """
    targets = jnp.where(valid[None], targets, np.float32(0))
    largest = jnp.max(jnp.abs(targets), axis=1)
    exponent = (lax.bitcast_convert_type(largest, jnp.int32) >> np.int32(23)) - np.int32(127)
    room = ((2**31 - 1) // targets.shape[1]).bit_length() - 2
    up = jnp.clip(np.int32(room) - exponent, -126, 126)

    def power(of_two: Array) -> Array:
        return lax.bitcast_convert_type((of_two + np.int32(127)) << np.int32(23), jnp.float32)

    return Quanta(jnp.round(targets * power(up)[:, None]).astype(jnp.int32), power(-up))


def grow(growth: Growth, sample: Sample, arrays: Arrays, start: Array, n: Array) -> Arrays:
    """Grows the tree of the rows ``arrays.rows[start : start + n]`` into the nodes from `base` on."""
    size = np.int32(2 * growth.cells.num_cells)
    total = _sum_of_rows(sample, arrays.rows, start, n)
    arrays = _leaf(sample, arrays, jnp.int32(0), total, n)
    grows = (n >= np.int32(2 * growth.min_leaf)) & (growth.max_depth > 0)
    arrays = arrays._replace(histograms=put_row(arrays.histograms, jnp.int32(0), jnp.zeros(size, jnp.int32)))
    arrays = _count(growth, sample, arrays, jnp.int32(0), start, lax.select(grows, n, jnp.int32(0)))
    arrays = _wait(arrays, jnp.int32(0), jnp.int32(0), start, n, total, jnp.int32(0))

    def step(carry: tuple[Array, Array, Arrays]) -> tuple[Array, Array, Arrays]:
        return _split(growth, sample, *carry)

    carry = (grows.astype(jnp.int32), jnp.int32(1), arrays)
    return lax.while_loop(lambda carry: carry[0] > 0, step, carry)[2]


def _split(growth: Growth, sample: Sample, waiting: Array, nodes: Array, arrays: Arrays) -> tuple[Array, Array, Arrays]:
    """Splits the node that waits last, if a test reduces the variance."""
    slot = waiting - 1
    size = np.int32(2 * growth.cells.num_cells)
    node, start, n, total, depth = take_row(arrays.waiting, slot * 5, 5)
    histogram = take_row(arrays.histograms, slot * size, int(size))
    has_test, cell, n_left, sum_left, word, number = _best_test(growth, sample, histogram, n, total)
    word = word | (nodes << np.int32(LEFT_SHIFT))
    old = take(arrays.numbers, sample.base + node)
    arrays = arrays._replace(
        words=put_row(arrays.words, sample.base + node, lax.select(has_test, word, jnp.int32(LEAF))[None]),
        numbers=put_row(arrays.numbers, sample.base + node, lax.select(has_test, number, old)[None]),
    )
    # Without a test these two leaves lie beyond the last node, where the next ones will be.
    arrays = _leaf(sample, arrays, nodes, sum_left, n_left)
    arrays = _leaf(sample, arrays, nodes + 1, total - sum_left, n - n_left)

    left_smaller = n_left * 2 <= n
    n_small = lax.min(n_left, n - n_left)
    start_small = lax.select(left_smaller, start, start + n_left)
    start_large = lax.select(left_smaller, start + n_small, start)
    node_small = nodes + lax.select(left_smaller, jnp.int32(0), jnp.int32(1))
    sum_small = lax.select(left_smaller, sum_left, total - sum_left)
    deep = depth + 1 >= np.int32(growth.max_depth)
    large_waits = has_test & ~deep & (n - n_small >= np.int32(2 * growth.min_leaf))
    small_waits = large_waits & (n_small >= np.int32(2 * growth.min_leaf))

    arrays = _partition(growth, sample, arrays, cell, start, start + lax.select(large_waits, n, jnp.int32(0)))
    arrays = _wait(arrays, slot, nodes * 2 + 1 - node_small, start_large, n - n_small, total - sum_small, depth + 1)
    arrays = _wait(arrays, slot + 1, node_small, start_small, n_small, sum_small, depth + 1)
    arrays = _share(growth, sample, arrays, slot, start_small, n_small, large_waits)
    waiting = slot + large_waits.astype(jnp.int32) + small_waits.astype(jnp.int32)
    return waiting, nodes + lax.select(has_test, jnp.int32(2), jnp.int32(0)), arrays


def _best_test(growth: Growth, sample: Sample, histogram: Array, n: Array, total: Array) -> tuple[Array, ...]:
    """The test with the greatest reduction of variance; among equals the lowest input, then the lowest value.

    Returns:
        Whether there is one; the cell of its value; number and sum of the rows that pass; the
        node's word without its children; the number that the test compares with.
    """
    cells = growth.cells
    passing = _passing(growth, histogram)
    count, sums = passing[: cells.num_cells], passing[cells.num_cells :]
    n_left, n_right = count.astype(jnp.float32), (n - count).astype(jnp.float32)
    one = np.float32(1)
    difference = sums.astype(jnp.float32) / lax.max(n_left, one) - (total - sums).astype(jnp.float32) / lax.max(
        n_right, one
    )
    smaller = lax.min(count, n - count)
    allowed = (smaller >= np.int32(growth.min_leaf)) & (lax.abs(difference) > _NEGLIGIBLE)
    # The reduction times the number of rows squared. Non-negative floats are ordered as their bits are.
    reduction = jnp.where(allowed, (n_left * n_right) * (difference * difference), np.float32(0))
    bits = lax.bitcast_convert_type(reduction, jnp.int32)
    best = jnp.max(bits)
    cell = jnp.min(jnp.where(bits == best, np.arange(cells.num_cells, dtype=np.int32), np.int32(cells.num_cells)))
    has_test = best > 0
    continuous = take(jnp.asarray(cells.continuous), cell)
    equals = lax.select(continuous, jnp.int32(0), jnp.int32(EQUALS))
    low = take(sample.binned.low, _next_filled(histogram, cell))
    high = take(sample.binned.high, cell)
    middle = high * np.float32(0.5) + low * np.float32(0.5)
    number = lax.select(continuous, lax.select(middle > high, middle, low), high)
    n_passing = lax.select(has_test, take(count, cell), jnp.int32(0))
    return has_test, cell, n_passing, take(sums, cell), equals | take(jnp.asarray(cells.input), cell), number


def _passing(growth: Growth, histogram: Array) -> Array:
    """Counts and sums of the rows that pass the test of every cell: a category, or all bins up to one."""
    cells = growth.cells
    for start in np.flatnonzero(cells.continuous & (np.arange(cells.num_cells) == cells.first)):
        for part in (0, cells.num_cells):

            def add(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
                total, values = carry
                total = total + take(values, i)
                return total, put_row(values, i, total[None])

            low, high = int(start) + part, int(cells.end[start]) + part
            histogram = lax.fori_loop(jnp.int32(low), jnp.int32(high), add, (jnp.int32(0), histogram))[1]
    return histogram


def _next_filled(histogram: Array, cell: Array) -> Array:
    """The next cell with rows after a bin that is not the last with rows."""
    last = np.int32(len(histogram) // 2 - 1)
    return lax.while_loop(lambda i: (i < last) & (take(histogram, i) == 0), lambda i: i + 1, lax.min(cell + 1, last))


def _partition(growth: Growth, sample: Sample, arrays: Arrays, cell: Array, start: Array, end: Array) -> Arrays:
    """Rows that pass the test of a cell come first."""
    cells = growth.cells
    which = take(jnp.asarray(cells.input), cell)
    continuous = take(jnp.asarray(cells.continuous), cell)
    lowest = lax.select(continuous, take(jnp.asarray(cells.first), cell), cell)

    def passes(row: Array) -> Array:
        row_cell = take(sample.binned.cells, row * np.int32(growth.num_inputs) + which).astype(jnp.int32)
        return (row_cell >= lowest) & (row_cell <= cell)

    rows, sorted_rows, _ = parted(arrays.rows, arrays.sorted_rows, start, end, passes)
    return arrays._replace(rows=rows, sorted_rows=sorted_rows)


def _count(growth: Growth, sample: Sample, arrays: Arrays, slot: Array, start: Array, n: Array) -> Arrays:
    """Adds rows to the histogram in a slot."""
    f, s = growth.num_inputs, growth.cells.num_cells
    offset = slot * np.int32(2 * s)

    def row(i: Array, histograms: Array) -> Array:
        row = take(arrays.rows, i)
        quantum = take(sample.values, sample.offset + row)
        row_cells = take_row(sample.binned.cells, row * np.int32(f), f).astype(jnp.int32) + offset
        for k in range(f):
            for cell, amount in ((row_cells[k], np.int32(1)), (row_cells[k] + np.int32(s), quantum)):
                histograms = put_row(histograms, cell, take_row(histograms, cell, 1) + amount)
        return histograms

    return arrays._replace(histograms=lax.fori_loop(start, start + n, row, arrays.histograms))


def _share(
    growth: Growth, sample: Sample, arrays: Arrays, slot: Array, start: Array, n: Array, needed: Array
) -> Arrays:
    """The histogram of the smaller child goes to the next slot, that of the greater one stays."""
    size = 2 * growth.cells.num_cells
    small = (slot + 1) * np.int32(size)
    cleared = put_row(arrays.histograms, small, jnp.zeros(size, jnp.int32))
    arrays = arrays._replace(histograms=cleared)
    arrays = _count(growth, sample, arrays, slot + 1, start, lax.select(needed, n, jnp.int32(0)))
    part = take_row(arrays.histograms, small, size)
    whole = take_row(arrays.histograms, slot * np.int32(size), size)
    return arrays._replace(histograms=put_row(arrays.histograms, slot * np.int32(size), whole - part))


def _leaf(sample: Sample, arrays: Arrays, node: Array, total: Array, n: Array) -> Arrays:
    mean = total.astype(jnp.float32) / lax.max(n, jnp.int32(1)).astype(jnp.float32) * sample.quantum
    node = sample.base + node
    return arrays._replace(
        words=put_row(arrays.words, node, jnp.zeros(1, jnp.int32)),
        numbers=put_row(arrays.numbers, node, mean[None]),
    )


def _wait(arrays: Arrays, slot: Array, *entry: Array) -> Arrays:
    return arrays._replace(waiting=put_row(arrays.waiting, slot * 5, jnp.stack(entry)))


def _sum_of_rows(sample: Sample, rows: Array, start: Array, n: Array) -> Array:
    def add(i: Array, total: Array) -> Array:
        return total + take(sample.values, sample.offset + take(rows, i))

    return lax.fori_loop(start, start + n, add, jnp.int32(0))
