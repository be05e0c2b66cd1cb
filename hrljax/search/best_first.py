"""Greedy best-first search of limited depth over any deterministic model (thesis 4.2.3).

From the current state the search expands, again and again, the open node with the greatest
predicted reward: the model is asked for all its children. It ends when it has counted enough
nodes, when a sequence of actions promises enough reward, or when nothing is left to expand.

Storage is allocated up front. The children of one expansion lie side by side, a *block*, and the
frontier has two levels: the rank of every open node, and the best rank of every block. Ranks are
integers that order as the priorities do, because maxima of integers are vectorised on a CPU.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import exact_product, opaque_zero, put_row, take, take_row
from hrljax.core.tracing_errors import explain_tracing

ModelFn = Callable[[Any, Array], tuple[Any, Array]]
Count = Literal["generated", "expanded"]
Priority = Literal["cumulative", "last_reward"]
Answer = Literal["any", "leaf"]
Loop = Literal["while", "scan"]

_CLOSED = np.int32(np.iinfo(np.int32).min)
"""The rank of what cannot be chosen; below that of every number."""


class Tree(NamedTuple):
    """The nodes in the order in which they were generated; node 0 is the root.

    Entries from `num_nodes` on are unused: states and rewards 0, values -inf, the rest -1.
    """

    state: Any  # pytree of [N, ...]
    value: Array  # [N] float32: discounted sum of the rewards on the way from the root
    reward: Array  # [N] float32: reward of the step that leads here, 0 for the root
    depth: Array  # [N] int32
    parent: Array  # [N] int32, -1 for the root
    action: Array  # [N] int32: the action that leads here, -1 for the root
    expansion: Array  # [N] int32: when this node was expanded, counted from 0, or -1 if it never was
    num_nodes: Array  # int32: the root and what was generated


class SearchResult(NamedTuple):
    """The best sequence of actions and the tree in which it was found."""

    actions: Array  # [depth] int32: the best sequence, then -1
    length: Array  # int32, at least 1
    action: Array  # int32: the first of `actions`
    value: Array  # float32: value of the best node
    node: Array  # int32: the best node
    tree: Tree


class _Search(NamedTuple):
    """A search under way: E blocks of A children; block 0 of what is counted from 0 to E is the root's."""

    state: Any  # pytree of [1 + E * A, ...]
    value: Array  # [1 + E * A] float32
    reward: Array  # [1 + E * A] float32
    ranks: Array  # [(E + 1) * A] int32: of every node, `_CLOSED` unless it is open
    best_ranks: Array  # [E + 1] int32: the greatest of every block
    parent: Array  # [E] int32: the node whose children a block holds
    depth: Array  # [E + 1] int32: of the nodes of a block
    weight: Array  # [E + 1] float32: discount ** depth of the nodes of a block
    num_expanded: Array  # int32
    best: Array  # int32: the best node so far
    best_rank: Array  # int32: the rank of its value


class _Expansion(NamedTuple):
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
class _Problem:
    model: ModelFn
    num_actions: int
    max_depth: int
    max_expansions: int
    priority: Priority
    answer: Answer
    stop_rank: Array
    discount: Array | None  # None: 1


def best_first_search(
    model: ModelFn,
    state: Any,
    num_actions: int,
    *,
    depth: int = 6,
    max_nodes: int = 300,
    count: Count = "generated",
    priority: Priority = "cumulative",
    answer: Answer = "any",
    stop_reward: Array | float = 6.0,
    discount: Array | float = 1.0,
    loop: Loop = "while",
) -> SearchResult:
    """Searches for the sequence of at most `depth` actions with the greatest predicted reward.

    The best node is the one of greatest value (see `answer`) at a depth of at least 1. Ties, here and in the
    frontier, go to the node that was generated first, so among siblings to the lowest action. A
    value or priority of -inf or nan is never preferred to any number and never expanded; if all
    are such, the best sequence is action 0.

    Args:
        model: ``model(state, action) -> next_state, reward`` for one state and one action (int32
            scalar): a state of the same structure, shapes and types, and a float32 scalar. Pure;
            it may close over traced arrays.
        state: where to start, a pytree of arrays.
        num_actions: A.
        depth: greatest depth of a node.
        max_nodes: no expansion starts once so many nodes have been counted.
        count: counts the nodes that were ``"generated"`` (without the root; an expansion that has
            started is completed, so 300 means 34 expansions of 9 children) or ``"expanded"``.
        priority: the frontier's order: ``"cumulative"`` value, or ``"last_reward"``, the reward of
            the step that leads to a node.
        answer: the best node may be ``"any"``, or only a ``"leaf"``, a node that was not expanded: then
            a promising node whose children are all bad is no answer.
        stop_reward: the search ends after an expansion with a child of greater value.
        discount: in [0, 1]; the reward of a step from depth d counts ``discount ** d`` times.
        loop: ``"while"`` leaves early, best in native loops; ``"scan"`` runs the greatest number of
            expansions, best under `vmap`. The result is the same bit for bit.

    Raises:
        TypeError, ValueError: an argument is not as described.
    """
    _check_options(num_actions, depth, max_nodes, count, priority, answer, loop)
    discount = checks.number("discount", discount, checks.SHARE, may_be_traced=True)
    stop_reward = checks.number("stop_reward", stop_reward, checks.Interval(-np.inf, np.inf), may_be_traced=True)
    problem = _Problem(
        model,
        num_actions,
        depth,
        max_expansions=max_nodes if count == "expanded" else -(-max_nodes // num_actions),
        priority=priority,
        answer=answer,
        stop_rank=_rank(_single(stop_reward)),
        discount=None if isinstance(discount, int | float) and discount == 1 else _single(discount),
    )
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(jnp.asarray(leaf).dtype), state)
    _check_model(model, state)

    search = _start(problem, state)
    if loop == "while":
        search = lax.while_loop(
            lambda search: _goes_on(problem, search),
            lambda search: _write(problem, search, _expand(problem, search)),
            search,
        )
    else:
        search, _ = lax.scan(lambda search, _: (_turn(problem, search), None), search, None, problem.max_expansions)
    return _result(problem, search)


def _start(problem: _Problem, state: Any) -> _Search:
    """Only the root, open, in the last place of its block: node i has place i + A - 1."""
    blocks, width = problem.max_expansions, problem.num_actions
    nodes = 1 + blocks * width
    return _Search(
        state=jax.tree.map(lambda leaf: jnp.zeros((nodes, *leaf.shape), leaf.dtype).at[0].set(leaf), state),
        value=jnp.full(nodes, -jnp.inf, jnp.float32).at[0].set(0),
        reward=jnp.zeros(nodes, jnp.float32),
        ranks=jnp.full((blocks + 1) * width, _CLOSED).at[width - 1].set(_rank(jnp.float32(0))),
        best_ranks=jnp.full(blocks + 1, _CLOSED).at[0].set(_rank(jnp.float32(0))),
        parent=jnp.full(blocks, -1, jnp.int32),
        depth=jnp.zeros(blocks + 1, jnp.int32),
        weight=jnp.ones(blocks + 1, jnp.float32),
        num_expanded=jnp.int32(0),
        best=jnp.int32(1),
        best_rank=jnp.asarray(_CLOSED),
    )


def _goes_on(problem: _Problem, search: _Search) -> Array:
    """Whether another node is to be expanded."""
    may_expand = search.num_expanded < problem.max_expansions
    return may_expand & (search.best_rank <= problem.stop_rank) & (jnp.max(search.best_ranks) > _CLOSED)


def _turn(problem: _Problem, search: _Search) -> _Search:
    """An expansion, or nothing if the search is over.

    A `lax.cond` would copy everything that the model closes over, once for every element of a `vmap`.
    """
    goes_on = _goes_on(problem, search)
    new = jax.tree.map(partial(jnp.where, goes_on), _expand(problem, search), _nothing_to_write(problem, search))
    return _write(problem, search, new)


def _expand(problem: _Problem, search: _Search) -> _Expansion:
    """Takes the best open node off the frontier and generates its children."""
    width = problem.num_actions
    block, _ = _first_max(search.best_ranks)
    ranks = take_row(search.ranks, block * width, width)
    place, _ = _first_max(ranks)
    node = block * width + place - (width - 1)
    depth = take(search.depth, block) + 1
    weight = take(search.weight, block)

    parent_state = jax.tree.map(lambda rows: _row(rows, node), search.state)
    states, rewards = _children(problem, parent_state)
    values = take(search.value, node) + _discounted(problem, weight, rewards, search.num_expanded)
    first, value_rank = _first_max(_rank(values))
    is_better = value_rank > search.best_rank
    order = _rank(values if problem.priority == "cumulative" else rewards)
    return _Expansion(
        from_block=block,
        ranks_left=lax.select(np.arange(width, dtype=np.int32) == place, jnp.full(width, _CLOSED), ranks),
        parent=node,
        depth=depth,
        weight=weight if problem.discount is None else weight * problem.discount,
        state=states,
        value=values,
        reward=rewards,
        ranks=jnp.where((depth < problem.max_depth) & (_rank(values) > _CLOSED), order, _CLOSED),
        best=lax.select(is_better, 1 + search.num_expanded * width + first, search.best),
        best_rank=lax.max(value_rank, search.best_rank),
        num_expanded=search.num_expanded + 1,
    )


def _nothing_to_write(problem: _Problem, search: _Search) -> _Expansion:
    """What leaves a search as it is: the next block is written as it was allocated."""
    width = problem.num_actions
    return _Expansion(
        from_block=jnp.int32(0),
        ranks_left=search.ranks[:width],
        parent=jnp.int32(-1),
        depth=jnp.int32(0),
        weight=jnp.float32(1),
        state=jax.tree.map(lambda rows: jnp.zeros((width, *rows.shape[1:]), rows.dtype), search.state),
        value=jnp.full(width, -jnp.inf, jnp.float32),
        reward=jnp.zeros(width, jnp.float32),
        ranks=jnp.full(width, _CLOSED),
        best=search.best,
        best_rank=search.best_rank,
        num_expanded=search.num_expanded,
    )


def _write(problem: _Problem, search: _Search, new: _Expansion) -> _Search:
    """Puts an expansion into the next block."""
    width, block = problem.num_actions, search.num_expanded
    first_node = 1 + block * width
    ranks = put_row(search.ranks, new.from_block * width, new.ranks_left)
    best_ranks = put_row(search.best_ranks, new.from_block, jnp.max(new.ranks_left)[None])
    return _Search(
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


def _children(problem: _Problem, state: Any) -> tuple[Any, Array]:
    """States and rewards of all actions: a small loop, which compiles once whatever the model is."""
    return lax.map(lambda action: problem.model(state, action), jnp.arange(problem.num_actions, dtype=jnp.int32))


def _discounted(problem: _Problem, weight: Array, rewards: Array, word: Array) -> Array:
    if problem.discount is None:
        return rewards
    return exact_product(weight, rewards, opaque_zero(lax.bitcast_convert_type(rewards, jnp.uint32)))


def _rank(number: Array) -> Array:
    """An int32 that orders as float32 numbers do; nan and -inf are closed, -0 equals 0."""
    bits = lax.bitcast_convert_type(jnp.where(number == 0, np.float32(0), number), jnp.int32)
    ordered = bits ^ ((bits >> np.int32(31)) & np.int32(0x7FFFFFFF))
    return jnp.where(number > -np.inf, ordered, _CLOSED)


def _first_max(ranks: Array) -> tuple[Array, Array]:
    """Index and value of the greatest rank, the first of equals."""
    greatest, length = jnp.max(ranks), len(ranks)
    places = jnp.where(ranks == greatest, np.arange(length, dtype=np.int32), np.int32(length))
    return jnp.min(places), greatest


def _row(rows: Array, index: Array) -> Array:
    return lax.dynamic_index_in_dim(rows, index.astype(jnp.uint32), keepdims=False)


def _put_rows(rows: Array, start: Array, new: Array) -> Array:
    return lax.dynamic_update_slice_in_dim(rows, new, start.astype(jnp.uint32), 0)


def _result(problem: _Problem, search: _Search) -> SearchResult:
    tree = _tree(problem, search)
    best = search.best if problem.answer == "any" else _best_leaf(tree, search.best)
    actions = _actions_to(problem, search, best)
    length = jnp.sum((actions >= 0).astype(jnp.int32))
    return SearchResult(actions, length, actions[0], take(search.value, best), best, tree)


def _best_leaf(tree: Tree, otherwise: Array) -> Array:
    """The first of the nodes of greatest value that were not expanded."""
    numbers = np.arange(len(tree.value), dtype=np.int32)
    is_leaf = (tree.expansion < 0) & (numbers > 0) & (numbers < tree.num_nodes)
    node, rank = _first_max(jnp.where(is_leaf, _rank(tree.value), _CLOSED))
    return lax.select(rank > _CLOSED, node, otherwise)


def _tree(problem: _Problem, search: _Search) -> Tree:
    """The entries of every node, from those of its block."""
    width, blocks = problem.num_actions, problem.max_expansions
    is_expanded = np.arange(blocks, dtype=np.int32) < search.num_expanded
    num_nodes = 1 + search.num_expanded * width

    def of_children(values: Array) -> Array:
        return jnp.repeat(jnp.where(is_expanded, values, -1), width)

    def with_root(root: int, children: Array) -> Array:
        return jnp.concatenate([jnp.full(1, root, jnp.int32), children])

    actions = np.tile(np.arange(width, dtype=np.int32), blocks)
    turns = jnp.arange(blocks, dtype=jnp.int32)
    unused = jnp.full(1 + blocks * width, -1, jnp.int32)
    return Tree(
        state=search.state,
        value=search.value,
        reward=search.reward,
        depth=with_root(0, of_children(search.depth[1:])),
        parent=with_root(-1, of_children(search.parent)),
        action=with_root(-1, jnp.where(np.arange(len(actions)) < num_nodes - 1, actions, -1)),
        expansion=unused.at[jnp.where(is_expanded, search.parent, len(unused))].set(turns, mode="drop"),
        num_nodes=num_nodes,
    )


def _actions_to(problem: _Problem, search: _Search, node: Array) -> Array:
    """The actions from the root to a node, filled up with -1."""
    width = problem.num_actions
    places = np.arange(problem.max_depth, dtype=np.int32)

    def to_parent(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        node, actions = carry
        block, action = lax.div(node - 1, np.int32(width)), lax.rem(node - 1, np.int32(width))
        shifted = jnp.where(places == 0, action, jnp.roll(actions, 1))
        parent = take(search.parent, lax.max(block, np.int32(0)))
        return lax.select(node > 0, parent, node), jnp.where(node > 0, shifted, actions)

    longest = min(problem.max_depth, problem.max_expansions)
    return lax.fori_loop(0, longest, to_parent, (node, jnp.full(problem.max_depth, -1, jnp.int32)))[1]


def _check_options(
    num_actions: int, depth: int, max_nodes: int, count: str, priority: str, answer: str, loop: str
) -> None:
    for name, value in (("num_actions", num_actions), ("depth", depth), ("max_nodes", max_nodes)):
        checks.integer(name, value, 1)
    choices = (
        ("count", count, Count),
        ("priority", priority, Priority),
        ("answer", answer, Answer),
        ("loop", loop, Loop),
    )
    for name, value, allowed in choices:
        checks.choice(name, value, allowed)


def _single(value: Array | float) -> Array:
    """A number as float32."""
    return jnp.asarray(value).astype(jnp.float32)


def _check_model(model: ModelFn, state: Any) -> None:
    """Raises TypeError unless the model gives a state like `state` and a float32 scalar."""
    checks.function("model", model, "of a state and an action", num_arguments=2)
    given = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)
    with explain_tracing("model"):
        output = jax.eval_shape(model, given, jax.ShapeDtypeStruct((), jnp.int32))
    if not (isinstance(output, tuple) and len(output) == 2):
        raise TypeError(f"model must return a tuple (next_state, reward), got {output!r}")
    returned = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), output)
    expected = (given, jax.ShapeDtypeStruct((), jnp.float32))
    if returned != expected:
        raise TypeError(f"model must return {expected}, of the structure of its state, and got {returned}")
