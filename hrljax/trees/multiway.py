"""Multiway regression trees as Orange 2 grew them, fitted and evaluated inside JAX.

A test on a category has a branch for every category that has rows, one on a number cuts it at the middle between two
values (``<=`` goes first). The test is the one that reduces the squared error most, whatever its number of branches.
Every node keeps the mean of its rows: where a row's category has no branch, descent ends and that mean is the
prediction. Which of Orange's trees thesis 4.2.3 took is not said, so `READINGS` has four.

With several targets a tree reduces the sum of their squared errors, each in units of its variance within the tree
(Struyf and Dzeroski 2006).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import exact_product, opaque_zero, put_row, take, take_row
from hrljax.trees.growth import LEAF, LEFT_SHIFT
from hrljax.trees.multiway_growth import Level, Nodes, branch, grow
from hrljax.trees.multiway_splits import NUMBER, Limits, Sample, total
from hrljax.trees.rows import MAX_ROWS, check_categories, check_rows

MOST_CATEGORIES = 32
READINGS: Mapping[str, Mapping[str, Any]] = {
    "A": {},
    "B": {"min_branch": 2, "min_side": 5},
    "C": {"min_branch": 2, "min_side": 2, "min_variance": 1e-5, "max_depth": MAX_ROWS},
    "D": {"min_split": 20, "pruning": 2.0},
}
"""Options of `MultiwayTree`: Orange's Python class as it is (A), its learner in C++ (B), its simple learner (C), and
the call of its tutorial for regression (D)."""


class MultiwayTrees(NamedTuple):
    """Trees as arrays of C nodes; the nodes 0 to G - 1 are the roots, children of a node lie side by side."""

    words: Array  # [C] int32: first child, kind of the test, input; 0 is a leaf
    numbers: Array  # [C] int32: bits of the number to compare with, or of the categories that have a branch
    means: Array  # [C * K] float32: of the rows of every node


@dataclass(frozen=True)
class MultiwayTree:
    """How trees are grown.

    Attributes:
        categories: for every input its number of categories, 0 .. categories - 1, or 0 if it is a number.
        min_branch: weight of the rows in a branch of a category, at least; otherwise the test is not allowed.
        min_side: the same on either side of a cut of a number.
        min_split: a node of less weight is a leaf.
        min_variance: so is one in which no target varies so much.
        max_depth: tests on the way from the root to a leaf, at most.
        pruning: m of the m-estimate of a node's error, by which branches are cut off afterwards; 0 cuts nothing.

    Raises:
        TypeError, ValueError: an attribute is of the wrong kind or out of range.
    """

    categories: tuple[int, ...]
    min_branch: float = 0.0
    min_side: float = 0.0
    min_split: float = 2.0
    min_variance: float = 0.0
    max_depth: int = 100
    pruning: float = 0.0

    def __post_init__(self) -> None:
        check_categories(self.categories, MOST_CATEGORIES)
        for name in ("min_branch", "min_side", "min_split", "min_variance", "pruning"):
            checks.number(name, getattr(self, name), checks.NOT_NEGATIVE)
        checks.integer("max_depth", self.max_depth, 0, MAX_ROWS)

    @cached_property
    def _kinds(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Which inputs are categories and which are numbers."""
        is_symbol = np.array(self.categories) > 0
        symbols, numbers = np.flatnonzero(is_symbol), np.flatnonzero(~is_symbol)
        return tuple(map(int, symbols)), tuple(map(int, numbers))

    def _limits(self, num_targets: int) -> Limits:
        symbols, numbers = self._kinds
        kinds = max(2, *self.categories)
        least = (float(self.min_branch), float(self.min_side), float(self.min_split), float(self.min_variance))
        return Limits(symbols, numbers, kinds, num_targets, *least, self.max_depth)

    @staticmethod
    def capacity(num_rows: int, num_groups: int = 1) -> int:
        """C: how many nodes the trees of so many rows may have."""
        return 2 * num_rows + num_groups

    def unfitted(self, num_rows: int, num_targets: int, num_groups: int = 1) -> MultiwayTrees:
        """Trees that predict 0, in the shapes of those of so many rows."""
        nodes = self.capacity(num_rows, num_groups)
        return MultiwayTrees(
            jnp.zeros(nodes, jnp.int32), jnp.zeros(nodes, jnp.int32), jnp.zeros(nodes * num_targets, jnp.float32)
        )

    def fit(
        self,
        inputs: Array,
        targets: Array,
        weights: Array | None = None,
        group: Array | None = None,
        num_groups: int = 1,
        count: Array | int | None = None,
    ) -> MultiwayTrees:
        """Grows a tree for every group of rows, for all targets together.

        Args:
            inputs: ``[N, F]`` float32, categories as whole numbers.
            targets: ``[N, K]`` float32.
            weights: ``[N]`` float32 above 0; a row of weight 3 counts as three. 1 if not given.
            group: ``[N]`` int32 in ``0 .. num_groups - 1``, such as the action of a transition; 0 if not given.
            num_groups: G, static.
            count: int32 scalar: only the first so many rows are used; all if not given. A tree without
                rows predicts 0.

        Returns:
            `MultiwayTrees` of ``C = capacity(N, G)`` nodes.

        Raises:
            ValueError: a shape or a concrete value is wrong.
        """
        inputs, targets = map(jnp.asarray, (inputs, targets))
        rows = len(inputs) if inputs.ndim else 0
        group = jnp.zeros(rows, jnp.int32) if group is None else jnp.asarray(group)
        weights = jnp.ones(rows, jnp.float32) if weights is None else jnp.asarray(weights)
        given = jnp.int32(rows) if count is None else jnp.asarray(count)
        check_rows(self.categories, inputs, targets, group, num_groups, given, weights)
        used = given.astype(jnp.int32)
        limits = self._limits(targets.shape[1])
        sample = self._sample(inputs, targets, weights, group, num_groups, used)
        capacity = self.capacity(rows, num_groups)
        none, zeros = jnp.zeros(capacity, jnp.int32), jnp.zeros(capacity, jnp.float32)
        nodes = Nodes(none, none, jnp.zeros(capacity * limits.num_targets, jnp.float32), zeros, zeros)
        level = _roots(limits, sample, num_groups, used)
        nodes, num_nodes = grow(limits, sample, nodes, level)
        words = _pruned(limits, sample, nodes, num_nodes, self.pruning) if self.pruning else nodes.words
        return MultiwayTrees(words, nodes.numbers, nodes.means)

    def _sample(
        self, inputs: Array, targets: Array, weights: Array, group: Array, num_groups: int, count: Array
    ) -> Sample:
        symbols, numbers = self._kinds
        most = np.array([self.categories[i] for i in symbols], np.int32) - 1
        cells = jnp.clip(inputs[:, list(symbols)].astype(jnp.int32), 0, most[None])
        zero = opaque_zero(lax.bitcast_convert_type(targets[0, 0], jnp.uint32))
        return Sample(
            symbols=cells.reshape(-1) if symbols else jnp.zeros(1, jnp.int32),
            numbers=tuple(inputs[:, i] + np.float32(0) for i in numbers),  # minus zero becomes zero
            targets=targets.reshape(-1),
            weights=weights,
            group=group,
            importance=_importance(targets, weights, group, num_groups, count, zero),
            zero=zero,
        )


def predict(trees: MultiwayTrees, inputs: Array, group: Array | int = 0) -> Array:
    """The prediction (float32 ``[K]``) of one group's tree for one row of inputs (float32 ``[F]``)."""

    def children(node: Array) -> tuple[Array, Array]:
        word = take(trees.words, node)
        value = take(inputs, word & np.int32(NUMBER - 1))
        child, has_child = branch(word, take(trees.numbers, node), value.astype(jnp.int32), value)
        return (word >> np.int32(LEFT_SHIFT)) + child, has_child & (word != LEAF)

    def descend(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        _, child, _ = carry
        return child, *children(child)

    root = jnp.asarray(group, jnp.int32)
    node = lax.while_loop(lambda carry: carry[2], descend, (root, *children(root)))[0]
    k = len(trees.means) // len(trees.words)
    return take_row(trees.means, node * np.int32(k), k)


def _roots(limits: Limits, sample: Sample, num_groups: int, count: Array) -> Level:
    """The level of the roots; a root's rows are those of a group."""
    rows = len(sample.weights)
    number = jnp.arange(rows, dtype=jnp.int32)
    group = jnp.where(number < count, sample.group, np.int32(num_groups))
    groups = np.arange(num_groups + 1, dtype=np.int32)
    starts = jnp.sum(group[None, :] < groups[:, None], axis=1, dtype=jnp.int32)
    more = max(rows, num_groups) + limits.num_categories - num_groups
    orders = tuple(
        jnp.append(lax.sort((group, values, number), num_keys=3)[2], 0)
        for values in sample.numbers or (jnp.zeros(rows, jnp.float32),)
    )
    return Level(jnp.int32(0), jnp.int32(num_groups), jnp.append(starts, jnp.repeat(starts[-1], more)), orders)


def _importance(targets: Array, weights: Array, group: Array, num_groups: int, count: Array, zero: Array) -> Array:
    """``[G * K]`` float32: 1 over the variance of a target within a group; 0 of one that does not vary; 1 if alone."""
    k = targets.shape[1]
    if k == 1:
        return jnp.ones(num_groups, jnp.float32)
    flat, places = targets.reshape(-1), num_groups * k

    def sums(values_of: Any) -> Array:
        """Of every group and target the sum over its rows."""

        def add(row: Array, totals: Array) -> Array:
            place = take(group, row) * np.int32(k)
            values = exact_product(take(weights, row), values_of(row, place), zero)
            return put_row(totals, place, take_row(totals, place, k) + values)

        return lax.fori_loop(jnp.int32(0), count, add, jnp.zeros(places, jnp.float32))

    weight = lax.max(sums(lambda row, place: jnp.ones(k, jnp.float32)), np.float32(1e-30))
    means = sums(lambda row, place: take_row(flat, row * np.int32(k), k)) / weight

    def squares(row: Array, place: Array) -> Array:
        difference = take_row(flat, row * np.int32(k), k) - take_row(means, place, k)
        return difference * difference

    spread = sums(squares)
    return jnp.where(spread > 0, weight / jnp.where(spread > 0, spread, np.float32(1)), np.float32(0))


def _pruned(limits: Limits, sample: Sample, nodes: Nodes, num_nodes: Array, pruning: float) -> Array:
    """Words after cutting off branches whose error is no smaller, from the leaves up (m-error pruning).

    A node's error is ``(w se + m se_root) / (w + m)``, w its weight and se the standard error of its mean; that of its
    branches is their mean, by weight.
    """
    kinds, m = limits.num_categories, np.float32(pruning)
    degrees = lax.max(nodes.weights - np.float32(1), np.float32(1e-30))
    standard = jnp.sqrt(nodes.errors / degrees / lax.max(nodes.weights, np.float32(1e-30)))
    standard = jnp.where(nodes.weights > 1, standard, np.float32(0))
    padding = jnp.zeros(kinds, jnp.float32)

    def hand_down(node: Array, of_root: Array) -> Array:
        word = take(nodes.words, node)
        first = lax.select(word != LEAF, word >> np.int32(LEFT_SHIFT), jnp.int32(len(of_root) - kinds))
        return put_row(of_root, first, jnp.broadcast_to(take(of_root, node), (kinds,)))

    of_root = jnp.concatenate([standard, padding])
    of_root = lax.fori_loop(jnp.int32(0), num_nodes, hand_down, of_root)[: len(standard)]
    weights = jnp.concatenate([nodes.weights, padding])
    alone = exact_product(nodes.weights, standard, sample.zero) + exact_product(m, of_root, sample.zero)
    alone = alone / (nodes.weights + m)

    def decide(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        words, errors = carry
        node = num_nodes - 1 - i
        word, as_leaf = take(words, node), take(alone, node)
        first = word >> np.int32(LEFT_SHIFT)
        is_number = (word & np.int32(NUMBER)) != 0
        bits = lax.bitcast_convert_type(take(nodes.numbers, node), jnp.uint32)
        children = lax.select(is_number, jnp.int32(2), lax.population_count(bits).astype(jnp.int32))
        is_child = np.arange(kinds, dtype=np.int32) < children
        of_children = exact_product(take_row(weights, first, kinds), take_row(errors, first, kinds), sample.zero)
        backed_up = total(jnp.where(is_child, of_children, np.float32(0)), kinds) / take(weights, node)
        is_leaf = (word == LEAF) | (as_leaf < backed_up)
        words = put_row(words, node, lax.select(is_leaf, jnp.int32(LEAF), word)[None])
        return words, put_row(errors, node, lax.select(is_leaf, as_leaf, backed_up)[None])

    start = (nodes.words, jnp.concatenate([alone, padding]))
    return lax.fori_loop(jnp.int32(0), num_nodes, decide, start)[0]
