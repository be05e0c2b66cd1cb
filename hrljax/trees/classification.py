"""Classification trees over small integers, grown from counts of classes (C4.5, Quinlan 1993), inside JAX.

A node tests an input, ``input == value`` or ``input <= value``, and a row that passes goes to the first child. The test
is the one with the greatest score (`hrljax.trees.scores`), of equally good ones that of the first input and value,
``==`` before ``<=``.

A row carries counts of every class, so that all the experience with a pair of state and action is one row. Nodes are
numbered in the order in which they are looked at, level by level.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row, take, take_row
from hrljax.core.random import threshold, words
from hrljax.trees.partition import CHUNK, parted
from hrljax.trees.scores import chi_squared, gain_ratio, gather, share_of

Score: TypeAlias = Literal["gain_ratio", "chi_squared"]
LEAF = -1
"""Test of a leaf."""


class Forest(NamedTuple):
    """T trees of at most N nodes for C classes."""

    tests: Array  # [T * N] int32: twice the cell of the value, and one more for ``<=``; `LEAF` for a leaf
    children: Array  # [T * N] int32: the number of the first of two children in its tree
    counts: Array  # [T * N * C] int32: rows of each class


class Data(NamedTuple):
    """What trees are grown from: P possible rows, each of which is a value for every input, and their counts."""

    cells: Array  # [P * F] int32: see `ClassificationTrees.cells`
    counts: Array  # [P * W + C] int32: a row of W counts, kind of tree after kind of tree; then C zeros
    rows: Array  # [P] int32: the rows that have counts come first
    num_rows: Array  # int32: how many these are


class Chance(NamedTuple):
    """Which inputs a node does not look at."""

    key: tuple[Array, Array]  # uint32 words of a Threefry key
    left_out: Array  # float32: probability of each input


class _Growing(NamedTuple):
    forest: Forest
    rows: Array  # [P + CHUNK] int32: the rows of a node lie side by side
    scratch: Array  # [P + CHUNK] int32
    starts: Array  # [N + 2] int32: of the nodes of one tree, the first of their rows
    ends: Array  # [N + 2] int32
    histogram: Array  # [S * C] int32: counts of classes for every value of an input
    num_nodes: Array  # int32


class _Test(NamedTuple):
    score: Array  # float32; -1 if there is none
    number: Array  # int32, as in `Forest.tests`


@dataclass(frozen=True)
class ClassificationTrees:
    """How trees are grown. There are trees of several kinds, one for each thing to predict, of the same rows.

    Attributes:
        sizes: of every input the number of its values, 0 .. size - 1.
        ordered: of every input whether there are tests ``<=`` of it too.
        num_classes: of every kind of tree.
        score: what the best test has most of.
        max_nodes: of one tree.
        num_trees: of each kind. Trees of one kind differ by chance alone.
    """

    sizes: tuple[int, ...]
    ordered: tuple[bool, ...]
    num_classes: tuple[int, ...]
    score: Score = "gain_ratio"
    max_nodes: int = 255
    num_trees: int = 1

    def __post_init__(self) -> None:
        for i, size in enumerate(self.sizes):
            checks.integer(f"sizes[{i}]", size, 1)
        for i, size in enumerate(self.num_classes):
            checks.integer(f"num_classes[{i}]", size, 1)
        if len(self.ordered) != len(self.sizes):
            raise ValueError(f"ordered must say it of each of {len(self.sizes)} inputs, got {len(self.ordered)}")
        checks.choice("score", self.score, Score)
        checks.integer("max_nodes", self.max_nodes, 1)
        checks.integer("num_trees", self.num_trees, 1)

    @property
    def num_kinds(self) -> int:
        return len(self.num_classes)

    @property
    def width(self) -> int:
        """W: counts in a row."""
        return sum(self.num_classes)

    @property
    def most_classes(self) -> int:
        """C."""
        return max(self.num_classes)

    @cached_property
    def first_class(self) -> tuple[int, ...]:
        """Of every kind of tree, where its counts begin in a row."""
        return tuple(np.cumsum([0, *self.num_classes[:-1]]).tolist())

    @cached_property
    def _first_cell(self) -> np.ndarray:
        return np.cumsum([0, *self.sizes[:-1]]).astype(np.int32)

    @cached_property
    def _input(self) -> np.ndarray:
        """``[S]`` int32: the input of a cell."""
        return np.repeat(np.arange(len(self.sizes), dtype=np.int32), self.sizes)

    def cells(self, values: np.ndarray) -> np.ndarray:
        """``[P * F]`` int32: a number for each value of each input (``[P, F]``), those of the first input first."""
        return (values + self._first_cell).astype(np.int32).ravel()

    def empty(self) -> Forest:
        """Trees that have seen nothing: leaves without counts."""
        nodes = self.num_kinds * self.num_trees * self.max_nodes
        return Forest(
            jnp.full(nodes, LEAF, jnp.int32),
            jnp.zeros(nodes, jnp.int32),
            jnp.zeros(nodes * self.most_classes, jnp.int32),
        )

    def tree(self, kind: Array | int, number: Array | int = 0) -> Array | int:
        """Which of the T trees: the kinds of the first number, then those of the next."""
        return number * self.num_kinds + kind

    def fit(self, data: Data, least_score: Array, zero: Array, chance: Chance | None = None) -> Forest:
        """Grows all trees.

        Args:
            data: the rows.
            least_score: float32: a test with a lower one, or that all rows pass, or none, is no test.
            zero: see `hrljax.core.numerics.opaque_zero`.
            chance: which inputs a node does not look at; it looks at all if not given.
        """
        spare = jnp.zeros(CHUNK, jnp.int32)
        nodes = jnp.zeros(self.max_nodes + 2, jnp.int32)
        growing = _Growing(
            self.empty(),
            jnp.concatenate([data.rows, spare]),
            jnp.zeros(len(data.rows) + CHUNK, jnp.int32),
            nodes,
            nodes,
            jnp.zeros(sum(self.sizes) * self.most_classes, jnp.int32),
            jnp.int32(0),
        )

        def one(tree: Array, growing: _Growing) -> _Growing:
            growing = growing._replace(
                starts=put_row(growing.starts, jnp.int32(0), jnp.zeros(1, jnp.int32)),
                ends=put_row(growing.ends, jnp.int32(0), data.num_rows[None]),
                num_nodes=jnp.int32(1),
            )

            def look(carry: tuple[Array, _Growing]) -> tuple[Array, _Growing]:
                node, growing = carry
                return node + 1, self._look(data, least_score, zero, chance, tree, node, growing)

            return lax.while_loop(lambda carry: carry[0] < carry[1].num_nodes, look, (jnp.int32(0), growing))[1]

        return lax.fori_loop(jnp.int32(0), jnp.int32(self.num_kinds * self.num_trees), one, growing).forest

    def _look(
        self,
        data: Data,
        least_score: Array,
        zero: Array,
        chance: Chance | None,
        tree: Array,
        node: Array,
        growing: _Growing,
    ) -> _Growing:
        """Counts the rows of a node and cuts them in two, if a test is good enough."""
        start, end = take(growing.starts, node), take(growing.ends, node)
        histogram, total = self._counted(data, tree % np.int32(self.num_kinds), growing, start, end)
        test = self._best_test(histogram, total, zero, self._looks_at(chance, tree, node))
        cell, is_range = test.number >> 1, (test.number & 1) == 1
        children = growing.num_nodes
        has_test = (test.score >= least_score) & (test.score > 0) & (children + 2 <= np.int32(self.max_nodes))
        which = take(jnp.asarray(self._input), cell)
        lowest = lax.select(is_range, take(jnp.asarray(self._first_cell), which), cell)

        def passes(row: Array) -> Array:
            value = take(data.cells, row * np.int32(len(self.sizes)) + which)
            return (value >= lowest) & (value <= cell)

        rows, scratch, middle = parted(growing.rows, growing.scratch, start, lax.select(has_test, end, start), passes)
        place = tree * np.int32(self.max_nodes) + node
        new = has_test.astype(jnp.int32)
        forest = Forest(
            put_row(growing.forest.tests, place, lax.select(has_test, test.number, jnp.int32(LEAF))[None]),
            put_row(growing.forest.children, place, (children * new)[None]),
            put_row(growing.forest.counts, place * np.int32(self.most_classes), total),
        )
        # Without a test what is written here lies beyond the last node, where the next children will be.
        starts, ends = jnp.stack([start, middle]), jnp.stack([middle, end])
        return _Growing(
            forest,
            rows,
            scratch,
            put_row(growing.starts, children, starts),
            put_row(growing.ends, children, ends),
            histogram,
            children + 2 * new,
        )

    def _counted(self, data: Data, kind: Array, growing: _Growing, start: Array, end: Array) -> tuple[Array, Array]:
        """The histogram ``[S * C]`` of the rows from `start` to `end`, and their counts ``[C]``."""
        width, classes = self.width, self.most_classes
        first = take(jnp.asarray(np.array(self.first_class, np.int32)), kind)
        is_class = np.arange(classes, dtype=np.int32) < take(jnp.asarray(np.array(self.num_classes, np.int32)), kind)

        def add(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            histogram, total = carry
            row = take(growing.rows, i)
            counts = take_row(data.counts, row * np.int32(width) + first, classes) * is_class.astype(jnp.int32)
            cells = take_row(data.cells, row * np.int32(len(self.sizes)), len(self.sizes))
            for f in range(len(self.sizes)):
                place = cells[f] * np.int32(classes)
                histogram = put_row(histogram, place, take_row(histogram, place, classes) + counts)
            return histogram, total + counts

        zeros = jnp.zeros(classes, jnp.int32)
        return lax.fori_loop(start, end, add, (jnp.zeros_like(growing.histogram), zeros))

    def _looks_at(self, chance: Chance | None, tree: Array, node: Array) -> Array | None:
        """``[S]`` bool: the cells whose inputs a node looks at; None if it looks at all."""
        if chance is None:
            return None
        number = (tree * np.int32(self.max_nodes) + node).astype(jnp.uint32)
        drawn = words(chance.key, number, len(self.sizes))
        kept = jnp.stack([word >= threshold(chance.left_out) for word in drawn])
        return jnp.repeat(kept, np.array(self.sizes), total_repeat_length=sum(self.sizes))

    def _best_test(self, histogram: Array, total: Array, zero: Array, looks_at: Array | None) -> _Test:
        classes, num_cells = self.most_classes, sum(self.sizes)
        ordered = jnp.asarray(np.repeat(np.array(self.ordered), self.sizes))
        is_first = jnp.asarray(np.isin(np.arange(num_cells), self._first_cell))
        score = self._score_of(total, zero)

        def better(best: _Test, passing: Array, allowed: Array, number: Array) -> _Test:
            new = lax.select(allowed, score(passing), jnp.float32(-1))
            wins = new > best.score
            return _Test(lax.select(wins, new, best.score), lax.select(wins, number, best.number))

        def look(cell: Array, carry: tuple[Array, _Test]) -> tuple[Array, _Test]:
            so_far, best = carry
            here = take_row(histogram, cell * np.int32(classes), classes)
            so_far = lax.select(take(is_first, cell), here, so_far + here)
            is_looked_at = jnp.bool_(True) if looks_at is None else take(looks_at, cell)
            best = better(best, here, is_looked_at, cell * 2)
            return so_far, better(best, so_far, is_looked_at & take(ordered, cell), cell * 2 + 1)

        start = jnp.zeros(classes, jnp.int32), _Test(jnp.float32(-1), jnp.int32(0))
        return lax.fori_loop(jnp.int32(0), jnp.int32(num_cells), look, start)[1]

    def _score_of(self, total: Array, zero: Array) -> Callable[[Array], Array]:
        """The score of a test as a function of the counts of the rows that pass it."""
        of_two = {"gain_ratio": gain_ratio, "chi_squared": chi_squared}[self.score]
        n = total.sum(dtype=jnp.int32)

        def score(passing: Array) -> Array:
            n_1 = passing.sum(dtype=jnp.int32)
            return lax.select((n_1 > 0) & (n_1 < n), of_two(passing, total, n_1, n, zero), jnp.float32(-1))

        return score

    def leaves(self, forest: Forest, tree: Array | int, cells: Array) -> Array:
        """Leaves to which rows of cells (``[R, F]`` int32) belong: nodes among those of all trees (``[R]`` int32)."""
        base = jnp.asarray(tree, jnp.int32) * np.int32(self.max_nodes)
        num_rows, num_inputs = cells.shape
        flat, offsets = cells.reshape(-1), jnp.arange(num_rows, dtype=jnp.int32) * np.int32(num_inputs)

        def descend(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            node, test = carry
            cell = test >> 1
            which = gather(jnp.asarray(self._input), lax.max(cell, jnp.int32(0)))
            value = gather(flat, offsets + which)
            lowest = lax.select((test & 1) == 1, gather(jnp.asarray(self._first_cell), which), cell)
            fails = ((value < lowest) | (value > cell)).astype(jnp.int32)
            child = base + gather(forest.children, node) + fails
            node = lax.select(test == LEAF, node, child)
            return node, gather(forest.tests, node)

        root = jnp.broadcast_to(base, (num_rows,))
        begin = root, gather(forest.tests, root)
        return lax.while_loop(lambda carry: (carry[1] != LEAF).any(), descend, begin)[0]

    def shares(self, forest: Forest, zero: Array) -> Array:
        """``[T * N * C]`` float32: the share of each class among the rows of a node, 0 where there are none.

        Args:
            forest: the trees.
            zero: see `hrljax.core.numerics.opaque_zero`.
        """
        counts = forest.counts.reshape(-1, self.most_classes)
        return share_of(counts, counts.sum(1, dtype=jnp.int32)[:, None], zero).reshape(-1)
