"""A best-first search under way: its nodes, its frontier, and one expansion.

The children of one expansion lie side by side, a *block*, and the frontier has two levels: the rank
of every open node, and the best rank of every block. Ranks are integers that order as the
priorities do, because maxima of integers are vectorised on a CPU.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.flags import Flag, choose, opposite
from hrljax.core.numerics import exact_product, opaque_zero, put_row, take, take_row

ModelFn = Callable[[Any, Array], tuple[Any, ...]]
"""Of a state and an action: the next state, the reward and, if it says so, whether the way ends there, and what the
steps beyond are worth."""
Count = Literal["generated", "expanded"]
Priority = Literal["cumulative", "last_reward"]
Answer = Literal["any", "leaf", "sequence"]
Loop = Literal["while", "scan"]

CLOSED = np.int32(np.iinfo(np.int32).min)
"""The rank of what cannot be chosen; below that of every number."""


class Search(NamedTuple):
    """A search under way: E blocks of A children; block 0 of what is counted from 0 to E is the root's."""

    state: Any  # pytree of [1 + E * A, ...]
    value: Array  # [1 + E * A] float32
    reward: Array  # [1 + E * A] float32
    ranks: Array  # [(E + 1) * A] int32: of every node, `CLOSED` unless it is open
    best_ranks: Array  # [E + 1] int32: the greatest of every block
    parent: Array  # [E] int32: the node whose children a block holds
    depth: Array  # [E + 1] int32: of the nodes of a block
    weight: Array  # [E + 1] float32: discount ** depth of the nodes of a block
    num_expanded: Array  # int32
    best: Array  # int32: the best node so far of those that count
    best_rank: Array  # int32: the rank of its value; `CLOSED` while there is none


class Expansion(NamedTuple):
    """What one expansion writes."""

    from_block: Array  # int32: where the expanded node lies
    ranks_left: Array  # [A] int32: the ranks of that block without it
    parent: Array  # int32: the expanded node
    depth: Array  # int32: of its children
    weight: Array  # float32: of its children
    state: Any  # pytree of [A, ...]
    value: Array  # [A] float32
    reward: Array  # [A] float32
    ranks: Array  # [A] int32
    best: Array  # int32
    best_rank: Array  # int32
    num_expanded: Array  # int32


@dataclass(frozen=True)
class Problem:
    model: ModelFn
    num_actions: int
    max_depth: int
    max_expansions: int  # for so many there is room
    limit: Array | int  # int32: how many there may be
    priority: Priority
    answer: Answer
    stop_rank: Array
    discount: Array | None  # None: 1


def start(problem: Problem, state: Any) -> Search:
    """Only the root, open, in the last place of its block: node i has place i + A - 1."""
    blocks, width = problem.max_expansions, problem.num_actions
    nodes = 1 + blocks * width
    return Search(
        state=jax.tree.map(lambda leaf: jnp.zeros((nodes, *leaf.shape), leaf.dtype).at[0].set(leaf), state),
        value=jnp.full(nodes, -jnp.inf, jnp.float32).at[0].set(0),
        reward=jnp.zeros(nodes, jnp.float32),
        ranks=jnp.full((blocks + 1) * width, CLOSED).at[width - 1].set(rank_of(jnp.float32(0))),
        best_ranks=jnp.full(blocks + 1, CLOSED).at[0].set(rank_of(jnp.float32(0))),
        parent=jnp.full(blocks, -1, jnp.int32),
        depth=jnp.zeros(blocks + 1, jnp.int32),
        weight=jnp.ones(blocks + 1, jnp.float32),
        num_expanded=jnp.int32(0),
        best=jnp.int32(1),
        best_rank=jnp.asarray(CLOSED),
    )


def goes_on(problem: Problem, search: Search) -> Array:
    """Whether another node is to be expanded."""
    may_expand = search.num_expanded < problem.limit
    return may_expand & (search.best_rank <= problem.stop_rank) & (jnp.max(search.best_ranks) > CLOSED)


def turn(problem: Problem, search: Search) -> Search:
    """An expansion, or nothing if the search is over.

    A `lax.cond` would copy everything that the model closes over, once for every element of a `vmap`.
    """
    new = choose(goes_on(problem, search), expand(problem, search), _nothing_to_write(problem, search))
    return write(problem, search, new)


def expand(problem: Problem, search: Search) -> Expansion:
    """Takes the best open node off the frontier and generates its children."""
    width = problem.num_actions
    block, _ = first_max(search.best_ranks)
    ranks = take_row(search.ranks, block * width, width)
    place, _ = first_max(ranks)
    node = block * width + place - (width - 1)
    depth = take(search.depth, block) + 1
    weight = take(search.weight, block)

    parent_state = jax.tree.map(lambda rows: _row(rows, node), search.state)
    states, rewards, ended, beyond = _children(problem, parent_state)
    values = take(search.value, node) + _discounted(problem, weight, rewards)
    next_weight = weight if problem.discount is None else weight * problem.discount
    if beyond is not None:
        is_cut_off = (depth >= problem.max_depth) & opposite(ended)
        values = jnp.where(is_cut_off, values + _discounted(problem, next_weight, beyond), values)
    value_ranks = rank_of(values)
    goes_deeper = (depth < problem.max_depth) & opposite(ended)
    counts = value_ranks if problem.answer != "sequence" else jnp.where(goes_deeper, CLOSED, value_ranks)
    first, value_rank = first_max(counts)
    is_better = value_rank > search.best_rank
    order = rank_of(values if problem.priority == "cumulative" else rewards)
    return Expansion(
        from_block=block,
        ranks_left=lax.select(np.arange(width, dtype=np.int32) == place, jnp.full(width, CLOSED), ranks),
        parent=node,
        depth=depth,
        weight=next_weight,
        state=states,
        value=values,
        reward=rewards,
        ranks=jnp.where(goes_deeper & (value_ranks > CLOSED), order, CLOSED),
        best=lax.select(is_better, 1 + search.num_expanded * width + first, search.best),
        best_rank=lax.max(value_rank, search.best_rank),
        num_expanded=search.num_expanded + 1,
    )


def _nothing_to_write(problem: Problem, search: Search) -> Expansion:
    """What leaves a search as it is: the next block is written as it was allocated."""
    width = problem.num_actions
    return Expansion(
        from_block=jnp.int32(0),
        ranks_left=search.ranks[:width],
        parent=jnp.int32(-1),
        depth=jnp.int32(0),
        weight=jnp.float32(1),
        state=jax.tree.map(lambda rows: jnp.zeros((width, *rows.shape[1:]), rows.dtype), search.state),
        value=jnp.full(width, -jnp.inf, jnp.float32),
        reward=jnp.zeros(width, jnp.float32),
        ranks=jnp.full(width, CLOSED),
        best=search.best,
        best_rank=search.best_rank,
        num_expanded=search.num_expanded,
    )


def write(problem: Problem, search: Search, new: Expansion) -> Search:
    """Puts an expansion into the next block."""
    width, block = problem.num_actions, search.num_expanded
    first_node = 1 + block * width
    ranks = put_row(search.ranks, new.from_block * width, new.ranks_left)
    best_ranks = put_row(search.best_ranks, new.from_block, jnp.max(new.ranks_left)[None])
    return Search(
        state=jax.tree.map(lambda old, rows: _put_rows(old, first_node, rows), search.state, new.state),
        value=put_row(search.value, first_node, new.value),
        reward=put_row(search.reward, first_node, new.reward),
        ranks=put_row(ranks, (block + 1) * width, new.ranks),
        best_ranks=put_row(best_ranks, block + 1, jnp.max(new.ranks)[None]),
        parent=put_row(search.parent, block, new.parent[None]),
        depth=put_row(search.depth, block + 1, new.depth[None]),
        weight=put_row(search.weight, block + 1, new.weight[None]),
        num_expanded=new.num_expanded,
        best=new.best,
        best_rank=new.best_rank,
    )


def _children(problem: Problem, state: Any) -> tuple[Any, Array, Flag, Array | None]:
    """What all actions lead to: a small loop, which compiles once whatever the model is."""
    actions = jnp.arange(problem.num_actions, dtype=jnp.int32)
    states, rewards, *more = lax.map(lambda action: problem.model(state, action), actions)
    return states, rewards, more[0] if more else False, more[1] if len(more) > 1 else None


def _discounted(problem: Problem, weight: Array, rewards: Array) -> Array:
    if problem.discount is None:
        return rewards
    return exact_product(weight, rewards, opaque_zero(lax.bitcast_convert_type(rewards, jnp.uint32)))


def rank_of(number: Array) -> Array:
    """An int32 that orders as float32 numbers do; nan and -inf are closed, -0 equals 0."""
    bits = lax.bitcast_convert_type(jnp.where(number == 0, np.float32(0), number), jnp.int32)
    ordered = bits ^ ((bits >> np.int32(31)) & np.int32(0x7FFFFFFF))
    return jnp.where(number > -np.inf, ordered, CLOSED)


def first_max(ranks: Array) -> tuple[Array, Array]:
    """Index and value of the greatest rank, the first of equals."""
    greatest, length = jnp.max(ranks), len(ranks)
    places = jnp.where(ranks == greatest, np.arange(length, dtype=np.int32), np.int32(length))
    return jnp.min(places), greatest


def _row(rows: Array, index: Array) -> Array:
    return lax.dynamic_index_in_dim(rows, index.astype(jnp.uint32), keepdims=False)


def _put_rows(rows: Array, start: Array, new: Array) -> Array:
    return lax.dynamic_update_slice_in_dim(rows, new, start.astype(jnp.uint32), 0)
