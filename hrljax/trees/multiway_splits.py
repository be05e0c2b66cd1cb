"""Which test parts a node of a multiway tree best: a branch for each category, or a cut of a number.

Sums are of differences from a node's mean, which are exactly 0 where all targets are equal.
"""

from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, put_row, take, take_row
from hrljax.trees.growth import INPUT_BITS

NUMBER = 1 << INPUT_BITS
"""Bit of a word: the test is ``<= number``; else there is a child for each of some categories."""
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


Centre: TypeAlias = tuple[Array, Array]
"""A node's mean as the targets of its first row and what the mean is above them (float32 ``[K]`` each)."""


class Split(NamedTuple):
    """A test of a node."""

    gain: Array  # float32: by how much it reduces the error; 0 if there is no test
    word: Array  # int32, without the child
    number: Array  # int32
    num_children: Array  # int32
    starts: Array  # [categories + 1] int32: where rows of each child start, counted from the node's; then its end


def best_split(
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


def _difference(sample: Sample, row: Array, centre: Centre) -> Array:
    """How much a row's targets are above a node's mean: exact to a few bits of the node's own spread."""
    k = len(centre[0])
    return (take_row(sample.targets, row * k, k) - centre[0]) - centre[1]


def total(values: Array, count: int) -> Array:
    """The sum over the last axis, in its order."""
    return sum((values[..., i] for i in range(1, count)), start=values[..., 0])
