"""Regression trees (CART, Breiman et al. 1984) over tile kinds and numbers, fitted and evaluated inside JAX.

A node tests a category, ``input == value``, or a number, ``input < threshold``, and sends rows that
pass to the left. The test is the one that reduces the variance of the target most; thresholds lie in
the middle between two values of the data. Thesis 4.2.3 learns Mario's movements and rewards with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row, take
from hrljax.trees.growth import (
    EQUALS,
    INPUT_BITS,
    LEAF,
    LEFT_SHIFT,
    Arrays,
    Growth,
    Sample,
    empty_arrays,
    grow,
    quantise,
)
from hrljax.trees.inputs import MAX_BINS, MAX_CATEGORIES, bin_inputs, make_cells
from hrljax.trees.rows import MAX_ROWS, check_categories, check_rows

MAX_DEPTH = 64


class Trees(NamedTuple):
    """Binary trees as arrays of C nodes; node 0 is the root, children come in pairs."""

    words: Array  # [..., C] int32: left child, kind of the test, input; 0 is a leaf
    numbers: Array  # [..., C] float32: what the test compares with, or the leaf's prediction


@dataclass(frozen=True)
class RegressionTree:
    """How trees are grown.

    Attributes:
        categories: for every input its number of categories, 0 .. categories - 1, or 0 if it is a number.
        max_depth: tests on the way from the root to a leaf, at most.
        min_leaf: rows in a leaf, at least.
        num_bins: numbers with more distinct values than this are cut into so many bins by rank.

    Raises:
        TypeError, ValueError: an attribute is no whole number or out of range.
    """

    categories: tuple[int, ...]
    max_depth: int = 12
    min_leaf: int = 5
    num_bins: int = 128

    def __post_init__(self) -> None:
        check_categories(self.categories, MAX_CATEGORIES)
        checks.integer("max_depth", self.max_depth, 0, MAX_DEPTH)
        checks.integer("min_leaf", self.min_leaf, 1, MAX_ROWS)
        checks.integer("num_bins", self.num_bins, 2, MAX_BINS)

    @property
    def num_inputs(self) -> int:
        return len(self.categories)

    @cached_property
    def _growth(self) -> Growth:
        return Growth(make_cells(self.categories, self.num_bins), self.max_depth, self.min_leaf, self.num_inputs)

    def capacity(self, num_rows: int) -> int:
        """C: how many nodes a tree of so many rows may have, and two in which growing writes in passing."""
        leaves = max(1, num_rows // self.min_leaf)
        return min(2 * leaves - 1, 2 ** (self.max_depth + 1) - 1) + 2

    def fit(self, inputs: Array, targets: Array, count: Array | int | None = None) -> Trees:
        """Grows one tree.

        Args:
            inputs: ``[N, F]`` float32, categories as whole numbers.
            targets: ``[N]`` float32. Fitted as multiples of a power of two, about 2^-15 of the
                greatest for 20,000 rows, and finer for fewer.
            count: int32 scalar: only the first so many rows are used; all if not given. Without any
                row the tree predicts 0.

        Returns:
            `Trees` of ``[C]``. A deterministic function of the set of the used rows.

        Raises:
            ValueError: a shape or a concrete value is wrong.
        """
        trees = self.fit_groups(inputs, targets[:, None], jnp.zeros(len(inputs), jnp.int32), 1, count)
        return Trees(trees.words[0, 0], trees.numbers[0, 0])

    def fit_groups(
        self, inputs: Array, targets: Array, group: Array, num_groups: int, count: Array | int | None = None
    ) -> Trees:
        """Grows a tree for every group of rows and every target; bins are found once, from all rows.

        Args:
            inputs, count: as in `fit`.
            targets: ``[N, K]`` float32.
            group: ``[N]`` int32 in ``0 .. num_groups - 1``, such as the action of a transition.
            num_groups: G, static.

        Returns:
            `Trees` of ``[G, K, C]``.

        Raises:
            ValueError: a shape or a concrete value is wrong.
        """
        inputs, targets, group = map(jnp.asarray, (inputs, targets, group))
        given = jnp.int32(len(inputs)) if count is None else jnp.asarray(count)
        check_rows(self.categories, inputs, targets, group, num_groups, given)
        num_rows, num_targets = targets.shape
        used = given.astype(jnp.int32)
        valid = jnp.arange(num_rows, dtype=jnp.int32) < used
        binned = bin_inputs(inputs, used, self.categories, self.num_bins)
        quanta = quantise(targets.T, valid)
        values = quanta.values.reshape(-1)
        rows, starts = _grouped(group, used, num_groups)
        capacity = self.capacity(num_rows)
        arrays = empty_arrays(self._growth, num_groups * num_targets * capacity, rows)

        def one(tree: Array, arrays: Arrays) -> Arrays:
            own_group, target = tree // np.int32(num_targets), tree % np.int32(num_targets)
            sample = Sample(
                binned, values, target * np.int32(num_rows), take(quanta.size, target), tree * np.int32(capacity)
            )
            start = take(starts, own_group)
            return grow(self._growth, sample, arrays, start, take(starts, own_group + 1) - start)

        arrays = lax.fori_loop(jnp.int32(0), jnp.int32(num_groups * num_targets), one, arrays)
        shape = (num_groups, num_targets, capacity)
        return Trees(arrays.words.reshape(shape), arrays.numbers.reshape(shape))


def predict(trees: Trees, inputs: Array, *index: Array | int) -> Array:
    """The prediction (float32 scalar) of a tree for one row of inputs.

    Args:
        trees: one tree, or an array of trees.
        inputs: ``[F]`` float32.
        index: which tree (int32 scalars, one for every leading axis of the arrays of `trees`).
    """
    return predict_all([Descent(trees, inputs, index)])[0]


class Descent(NamedTuple):
    """A prediction that is asked for: arguments as of `predict`."""

    trees: Trees
    inputs: Array
    which: tuple[Array | int, ...]  # see `index` there


_Places: TypeAlias = tuple[list[Array], list[Array]]
"""Of every descent the node that it is in, and the word there."""


def predict_all(descents: Sequence[Descent]) -> list[Array]:
    """Several predictions, float32 scalars.

    They are made side by side: a descent waits for memory at every node, and in the meantime the others go on.
    """
    tables = [tuple(values.reshape(-1) for values in descent.trees) for descent in descents]
    roots = [_root(descent) for descent in descents]

    def descend(carry: _Places) -> _Places:
        nodes, words = [], []
        for descent, (of_words, of_numbers), root, node, word in zip(descents, tables, roots, *carry, strict=True):
            value = take(descent.inputs, word & np.int32((1 << INPUT_BITS) - 1))
            number = take(of_numbers, node)
            passes = lax.select((word & np.int32(EQUALS)) != 0, value == number, value < number)
            child = root + (word >> np.int32(LEFT_SHIFT)) + 1 - passes.astype(jnp.int32)
            nodes.append(lax.select(word == LEAF, node, child))
            words.append(take(of_words, nodes[-1]))
        return nodes, words

    def is_inside(carry: _Places) -> Array:
        return reduce(jnp.logical_or, [word != LEAF for word in carry[1]])

    first = [take(of_words, root) for (of_words, _), root in zip(tables, roots, strict=True)]
    nodes, _ = lax.while_loop(is_inside, descend, (roots, first))
    return [take(of_numbers, node) for (_, of_numbers), node in zip(tables, nodes, strict=True)]


def _root(descent: Descent) -> Array:
    """The number of the root in the vector of all nodes."""
    shape, base = descent.trees.words.shape, jnp.int32(0)
    for i, size in zip(descent.which, shape, strict=False):
        base = base * np.int32(size) + jnp.asarray(i, jnp.int32)
    return base * np.int32(shape[-1])


def _grouped(group: Array, count: Array, num_groups: int) -> tuple[Array, Array]:
    """Valid rows sorted by group (int32 ``[N]``), and where each group starts (``[G + 1]``)."""
    num_rows = len(group)
    valid = jnp.arange(num_rows, dtype=jnp.int32) < count
    group_of_row = jnp.where(valid, group, np.int32(num_groups))
    sizes = jnp.sum(group_of_row[None, :] == jnp.arange(num_groups, dtype=jnp.int32)[:, None], axis=1, dtype=jnp.int32)
    starts = [jnp.int32(0)]
    for g in range(num_groups):
        starts.append(starts[-1] + sizes[g])
    starts = jnp.stack(starts)

    def place(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        rows, free = carry
        g = take(group, i)
        where = take(free, g)
        return put_row(rows, where, i[None]), put_row(free, g, (where + 1)[None])

    rows, _ = lax.fori_loop(jnp.int32(0), count, place, (jnp.zeros(num_rows, jnp.int32), starts))
    return rows, starts
