"""Growing multiway regression trees, all trees of a fit together, one level of nodes after the other.

A level's rows lie node by node in one order for every number, sorted by it. Its nodes are looked at one after the
other, which reads these orders and writes the nodes alone; then every order is parted once into that of the next level.
So no array is both read and written inside of nested loops, which XLA would copy once for every node. In a native loop
that needs `hrljax.engine.compiler.NESTED_OPTIONS`.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, put_row, take, take_row
from hrljax.trees.growth import LEAF, LEFT_SHIFT
from hrljax.trees.multiway_splits import NUMBER, Centre, Limits, Sample, Split, best_split, total

_NEGLIGIBLE = np.float32(2.0**-20)
"""A test that explains less of a node's variance is none."""


class Nodes(NamedTuple):
    """Nodes of all trees, those of a level side by side, the roots first. Only written while trees grow."""

    words: Array  # [C] int32: first child, kind of the test, input; 0 is a leaf
    numbers: Array  # [C] int32: bits of the number that is compared with, or of the categories that have a child
    means: Array  # [C * K] float32
    weights: Array  # [C] float32: of the rows
    errors: Array  # [C] float32: sum of squared differences from the mean, each times its importance


class Level(NamedTuple):
    """The nodes of one depth and their rows."""

    first_node: Array  # int32
    num_nodes: Array  # int32
    starts: Array  # [N + categories + 1] int32: where rows of a node start; those of the last end at the next entry
    orders: tuple[Array, ...]  # [N + 1] int32 each: the rows, node by node; sorted by a number each


def grow(limits: Limits, sample: Sample, nodes: Nodes, level: Level) -> tuple[Nodes, Array]:
    """Grows all trees from the level of their roots; the nodes, and how many there are."""

    def deeper(carry: tuple[Array, Nodes, Level]) -> tuple[Array, Nodes, Level]:
        depth, nodes, level = carry
        nodes, starts, count = _look(limits, sample, nodes, level, depth < limits.max_depth)
        following = Level(level.first_node + level.num_nodes, count, starts, level.orders)
        orders = tuple(_parted(limits, sample, nodes, level, following, order) for order in level.orders)
        return depth + 1, nodes, following._replace(orders=orders)

    _, nodes, level = lax.while_loop(lambda carry: carry[2].num_nodes > 0, deeper, (jnp.int32(0), nodes, level))
    return nodes, level.first_node


def _look(limits: Limits, sample: Sample, nodes: Nodes, level: Level, may_split: Array) -> tuple[Nodes, Array, Array]:
    """Writes a level's nodes; gives the `Level.starts` of the next level and its number of nodes."""
    kinds, order = limits.num_categories, level.orders[0]
    children = level.first_node + level.num_nodes

    def look(carry: tuple[Array, Array, Array, Array, Nodes]) -> tuple[Array, Array, Array, Array, Nodes]:
        i, count, filled, starts, nodes = carry
        start = take(level.starts, i)
        n = take(level.starts, i + 1) - start
        tree = take(sample.group, take(order, start))
        importance = take_row(sample.importance, tree * limits.num_targets, limits.num_targets)
        weight, centre, error, varies = _summary(limits, sample, order, start, n, importance)
        goes_on = may_split & varies & (n > 1) & (weight >= np.float32(limits.min_split))

        def split(_: Split) -> Split:
            return best_split(limits, sample, level.orders, start, n, weight, centre, importance)

        none = jnp.int32(0)
        no_test = Split(jnp.float32(0), none, none, none, jnp.zeros(kinds + 1, jnp.int32))
        # A loop of at most one turn, for leaves are many and need none of it.
        test = lax.while_loop(lambda c: c[0], lambda c: (jnp.bool_(False), split(c[1])), (goes_on, no_test))[1]
        has_test = test.gain > exact_product(_NEGLIGIBLE, error, sample.zero)
        word = lax.select(has_test, test.word | ((children + count) << np.int32(LEFT_SHIFT)), jnp.int32(LEAF))
        node = level.first_node + i
        nodes = Nodes(
            words=put_row(nodes.words, node, word[None]),
            numbers=put_row(nodes.numbers, node, test.number[None]),
            means=put_row(nodes.means, node * limits.num_targets, centre[0] + centre[1]),
            weights=put_row(nodes.weights, node, weight[None]),
            errors=put_row(nodes.errors, node, error[None]),
        )
        starts = put_row(starts, count, filled + lax.select(has_test, test.starts, jnp.zeros_like(test.starts)))
        more = lax.select(has_test, test.num_children, none)
        return i + 1, count + more, filled + lax.select(has_test, n, none), starts, nodes

    zero = jnp.int32(0)
    begun = (zero, zero, zero, jnp.zeros_like(level.starts), nodes)
    _, count, _, starts, nodes = lax.while_loop(lambda carry: carry[0] < level.num_nodes, look, begun)
    return nodes, starts, count


def _summary(
    limits: Limits, sample: Sample, order: Array, start: Array, n: Array, importance: Array
) -> tuple[Array, Centre, Array, Array]:
    """Of a node's rows: weight, centre, error, and whether they vary enough to be parted."""
    k = limits.num_targets
    origin = take_row(sample.targets, take(order, start) * k, k)

    def add(p: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        weight, sums, squares = carry
        row = take(order, p)
        once = take(sample.weights, row)
        difference = take_row(sample.targets, row * k, k) - origin
        weighted = exact_product(once, difference, sample.zero)
        return weight + once, sums + weighted, squares + exact_product(weighted, difference, sample.zero)

    zeros = jnp.zeros(k, jnp.float32)
    weight, sums, squares = lax.fori_loop(start, start + n, add, (jnp.float32(0), zeros, zeros))
    divisor = lax.max(weight, np.float32(1e-30))
    # One by one, because XLA multiplies a vector by the reciprocal of a number that divides it.
    shift = jnp.stack([sums[i] / divisor for i in range(k)])
    centre = lax.select(n > 0, origin, zeros), lax.select(n > 0, shift, zeros)
    spread = lax.max(squares - exact_product(sums, shift, sample.zero), zeros)
    varies = jnp.any(spread >= divisor * np.float32(max(limits.min_variance, 1e-30)))
    return weight, centre, total(exact_product(spread, importance, sample.zero), k), varies


def _parted(limits: Limits, sample: Sample, nodes: Nodes, level: Level, following: Level, order: Array) -> Array:
    """The rows of the next level's nodes in the same order; rows of leaves are dropped."""
    spare = np.int32(len(order) - 1)
    inputs = len(limits.symbols)
    inputs_in_order = range(len(limits.symbols) + len(limits.numbers))
    place_of_symbol, place_of_number = (
        jnp.asarray(np.array([places.index(i) if i in places else 0 for i in inputs_in_order], np.int32))
        for places in (limits.symbols, limits.numbers)
    )
    numbers = jnp.concatenate(sample.numbers) if sample.numbers else jnp.zeros(1, jnp.float32)

    def place(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        """Puts a row in its place, or goes on to the next node: a loop in here would be given copies."""
        i, p, free, parted = carry
        is_row = p < take(level.starts, i + 1)
        row, node = take(order, p), level.first_node + i
        word, number = take(nodes.words, node), take(nodes.numbers, node)
        which = word & np.int32(NUMBER - 1)
        symbol = take(sample.symbols, row * np.int32(inputs) + take(place_of_symbol, which))
        value = take(numbers, take(place_of_number, which) * spare + row)
        child = (word >> np.int32(LEFT_SHIFT)) + branch(word, number, symbol, value)[0] - following.first_node
        is_kept = is_row & (word != LEAF)
        child = lax.select(is_kept, child, jnp.int32(len(free) - 1))
        # Read once: read again for each of two writes, the whole array would be copied for every row.
        where = lax.optimization_barrier(take(free, child))
        parted = put_row(parted, lax.select(is_kept, where, jnp.int32(spare)), row[None])
        free = put_row(free, child, where[None] + 1)
        return lax.select(is_row, i, i + 1), p + is_row.astype(jnp.int32), free, parted

    begun = (jnp.int32(0), jnp.int32(0), following.starts, jnp.zeros_like(order))
    return lax.while_loop(lambda carry: carry[0] < level.num_nodes, place, begun)[3]


def branch(word: Array, number: Array, symbol: Array, value: Array) -> tuple[Array, Array]:
    """Which of a node's children a row belongs to, and whether it has one."""
    threshold = lax.bitcast_convert_type(number, jnp.float32)
    bit = np.uint32(1) << symbol.astype(jnp.uint32)
    filled = lax.bitcast_convert_type(number, jnp.uint32)
    rank = lax.population_count(filled & (bit - np.uint32(1))).astype(jnp.int32)
    is_number = (word & np.int32(NUMBER)) != 0
    child = lax.select(is_number, (value > threshold).astype(jnp.int32), rank)
    return child, is_number | ((filled & bit) != 0)
