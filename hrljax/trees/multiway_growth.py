"""Growing multiway regression trees, all trees of a fit together, one level of nodes after the other.

A level's rows lie node by node in one order for every number, sorted by it. Its nodes are looked at one after the
other, which reads these orders and writes the nodes alone; then every order is parted once into that of the next level.
So no array is both read and written inside of nested loops, which XLA would copy once for every node. In a native loop
that needs `hrljax.engine.compiler.NESTED_OPTIONS`.

Sums are of differences from a node's mean, which are exactly 0 where all targets are equal.
"""

from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, put_row, take, take_row
from hrljax.trees.growth import INPUT_BITS, LEAF, LEFT_SHIFT

NUMBER = 1 << INPUT_BITS
"""Bit of a word: the test is ``<= number``; else there is a child for each of some categories."""
_NEGLIGIBLE = np.float32(2.0**-20)
"""A test that explains less of a node's variance is none."""
_AS_GOOD = np.float32(1 - 2.0**-14)
"""A test that explains this share of what another does is as good: rounding does not decide between them."""


class Limits(NamedTuple):
    """What is known of trees before compilation."""

    symbols: tuple[int, ...]  # which inputs are categories
    numbers: tuple[int, ...]  # which are numbers
    num_categories: int  # the most that an input has
    num_targets: int
    min_branch: float
    min_side: float
    min_split: float
    min_variance: float
    max_depth: int


class Sample(NamedTuple):
    """What trees are grown from."""

    symbols: Array  # [N * inputs that are categories] int32, row by row
    numbers: tuple[Array, ...]  # [N] float32 each
    targets: Array  # [N * K] float32, row by row
    weights: Array  # [N] float32
    group: Array  # [N] int32: which tree
    importance: Array  # [trees * K] float32: what a squared difference counts
    zero: Array  # uint32, for `exact_product`


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


Centre: TypeAlias = tuple[Array, Array]
"""A node's mean as the targets of its first row and what the mean is above them (float32 ``[K]`` each)."""


class Split(NamedTuple):
    """A test of a node."""

    gain: Array  # float32: by how much it reduces the error; 0 if there is no test
    word: Array  # int32, without the child
    number: Array  # int32
    num_children: Array  # int32
    starts: Array  # [categories + 1] int32: where rows of each child start, counted from the node's; then its end


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
            return _best_split(limits, sample, level.orders, start, n, weight, centre, importance)

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


def _difference(sample: Sample, row: Array, centre: Centre) -> Array:
    """How much a row's targets are above a node's mean: exact to a few bits of the node's own spread."""
    k = len(centre[0])
    return (take_row(sample.targets, row * k, k) - centre[0]) - centre[1]


def total(values: Array, count: int) -> Array:
    """The sum over the last axis, in its order."""
    return sum((values[..., i] for i in range(1, count)), start=values[..., 0])


def _best_split(
    limits: Limits,
    sample: Sample,
    orders: tuple[Array, ...],
    start: Array,
    n: Array,
    weight: Array,
    centre: Centre,
    importance: Array,
) -> Split:
    """The test that reduces the error most; among equals that of the first input, and there the lowest number."""
    scores: list[tuple[int, Array]] = []
    histogram = _histogram(limits, sample, orders[0], start, n, centre)
    if limits.symbols:
        of_symbols = _category_scores(limits, histogram, importance)
        scores += [(which, of_symbols[i]) for i, which in enumerate(limits.symbols)]
    cuts = [
        _best_cut(limits, sample, values, order, start, n, weight, centre, importance)
        for values, order in zip(sample.numbers, orders, strict=False)
    ]
    scores += [(which, cut[0]) for which, cut in zip(limits.numbers, cuts, strict=True)]
    in_order = jnp.stack([score for _, score in sorted(scores, key=lambda pair: pair[0])])
    gain = jnp.max(in_order)
    places = np.arange(len(scores), dtype=np.int32)
    which = jnp.min(jnp.where(in_order >= gain * _AS_GOOD, places, np.int32(len(scores))))
    chosen = _category_split(limits, histogram, which, gain) if limits.symbols else None
    for number, (_, threshold, n_left) in zip(limits.numbers, cuts, strict=True):
        ends = jnp.where(np.arange(limits.num_categories + 1) < 2, n_left, n)
        starts = jnp.where(np.arange(limits.num_categories + 1) == 0, 0, ends)
        bits = lax.bitcast_convert_type(threshold, jnp.int32)
        cut = Split(gain, jnp.int32(NUMBER | number), bits, jnp.int32(2), starts)
        chosen = _either(which == number, cut, chosen) if chosen else cut
    assert chosen is not None
    return chosen


def _either(condition: Array, these: Split, those: Split) -> Split:
    return Split(*(jnp.where(condition, a, b) for a, b in zip(these, those, strict=True)))


def _histogram(limits: Limits, sample: Sample, order: Array, start: Array, n: Array, centre: Centre) -> Array:
    """Flat ``[inputs, categories, 2 + K]`` float32: rows, weight, sums of differences from the mean."""
    width = 2 + limits.num_targets
    inputs, kinds = len(limits.symbols), limits.num_categories

    def add(p: Array, histogram: Array) -> Array:
        row = take(order, p)
        once = take(sample.weights, row)
        difference = _difference(sample, row, centre)
        amounts = jnp.concatenate([jnp.stack([jnp.float32(1), once]), exact_product(once, difference, sample.zero)])
        for i in range(inputs):
            cell = (take(sample.symbols, row * inputs + i) + np.int32(i * kinds)) * np.int32(width)
            histogram = put_row(histogram, cell, take_row(histogram, cell, width) + amounts)
        return histogram

    return lax.fori_loop(start, start + n, add, jnp.zeros(max(1, inputs * kinds * width), jnp.float32))


def _category_scores(limits: Limits, histogram: Array, importance: Array) -> Array:
    """``[inputs]`` float32: by how much a child for every category reduces the error; 0 where that is not allowed."""
    kinds, width = limits.num_categories, 2 + limits.num_targets
    cells = histogram.reshape(len(limits.symbols), kinds, width)
    weight, sums = cells[..., 1], cells[..., 2:]
    filled = weight > 0
    explained = total((sums * sums) * importance[None, None], limits.num_targets)
    scores = total(explained / jnp.where(filled, weight, np.float32(1)), kinds)
    enough = jnp.all(~filled | (weight >= np.float32(limits.min_branch)), axis=1)
    return jnp.where(enough & (jnp.sum(filled, axis=1) > 1), scores, np.float32(0))


def _category_split(limits: Limits, histogram: Array, which: Array, gain: Array) -> Split:
    """The test that has a child for every category of an input that has rows."""
    kinds, width = limits.num_categories, 2 + limits.num_targets
    place = sum(((which > symbol).astype(jnp.int32) for symbol in limits.symbols), start=jnp.int32(0))
    place = lax.min(place, jnp.int32(len(limits.symbols) - 1))
    cells = take_row(histogram, place * np.int32(kinds * width), kinds * width).reshape(kinds, width)
    rows = cells[:, 0].astype(jnp.int32)
    filled = rows > 0
    number, ends = np.arange(kinds, dtype=np.int32), np.arange(kinds + 1, dtype=np.int32)
    before = number[:, None] > number[None, :]
    child = jnp.sum(before & filled[None, :], axis=1, dtype=jnp.int32)
    start = jnp.sum(jnp.where(before, rows[None, :], 0), axis=1, dtype=jnp.int32)
    is_start = filled[None, :] & (child[None, :] == ends[:, None])
    starts = jnp.sum(jnp.where(is_start, start[None, :], 0), axis=1, dtype=jnp.int32)
    count = jnp.sum(filled, dtype=jnp.int32)
    bits = jnp.sum(jnp.where(filled, np.uint32(1) << number.astype(np.uint32), np.uint32(0)), dtype=jnp.uint32)
    starts = jnp.where(ends < count, starts, jnp.sum(rows, dtype=jnp.int32))
    return Split(gain, which, lax.bitcast_convert_type(bits, jnp.int32), count, starts)


def _best_cut(
    limits: Limits,
    sample: Sample,
    values: Array,
    order: Array,
    start: Array,
    n: Array,
    weight: Array,
    centre: Centre,
    importance: Array,
) -> tuple[Array, Array, Array]:
    """Of a number, by how much its best cut reduces the error, where it is, and how many rows are below."""
    k, least = limits.num_targets, np.float32(limits.min_side)
    end = start + n

    def pass_row(p: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        below, sums, value, best, cut = carry
        row = take(order, p)
        once = take(sample.weights, row)
        difference = _difference(sample, row, centre)
        below, sums = below + once, sums + exact_product(once, difference, sample.zero)
        # What is above differs from the mean by as much to the other side.
        above = weight - below
        weighted = (sums * sums) * importance
        score = total(weighted, k) / below + total(weighted, k) / above
        following = take(values, take(order, p + 1))
        is_better = (following > value) & (below >= least) & (above >= least) & (above > 0) & (score * _AS_GOOD > best)
        return below, sums, following, lax.select(is_better, score, best), lax.select(is_better, p, cut)

    begun = (
        jnp.float32(0),
        jnp.zeros(k, jnp.float32),
        take(values, take(order, start)),
        jnp.float32(0),
        start,
    )
    _, _, _, best, cut = lax.fori_loop(start, end - 1, pass_row, begun)
    low, high = take(values, take(order, cut)), take(values, take(order, cut + 1))
    middle = low * np.float32(0.5) + high * np.float32(0.5)
    return best, lax.select((middle >= low) & (middle < high), middle, low), cut + 1 - start


def _parted(limits: Limits, sample: Sample, nodes: Nodes, level: Level, following: Level, order: Array) -> Array:
    """The rows of the next level's nodes in the same order; rows of leaves are dropped."""
    spare = np.int32(len(order) - 1)
    inputs = len(limits.symbols)
    place_of_symbol, place_of_number = (
        jnp.asarray(np.array([places.index(i) if i in places else 0 for i in range(_num_inputs(limits))], np.int32))
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


def _num_inputs(limits: Limits) -> int:
    return len(limits.symbols) + len(limits.numbers)


def branch(word: Array, number: Array, symbol: Array, value: Array) -> tuple[Array, Array]:
    """Which of a node's children a row belongs to, and whether it has one."""
    threshold = lax.bitcast_convert_type(number, jnp.float32)
    bit = np.uint32(1) << symbol.astype(jnp.uint32)
    filled = lax.bitcast_convert_type(number, jnp.uint32)
    rank = lax.population_count(filled & (bit - np.uint32(1))).astype(jnp.int32)
    is_number = (word & np.int32(NUMBER)) != 0
    child = lax.select(is_number, (value > threshold).astype(jnp.int32), rank)
    return child, is_number | ((filled & bit) != 0)
