"""Greedy best-first search of limited depth over any deterministic model (thesis 4.2.3).

From the current state the search expands, again and again, the open node with the greatest
predicted reward: the model is asked for all its children. It ends when it has counted enough
nodes, when a sequence of actions promises enough reward, or when nothing is left to expand.

Storage is allocated up front; `hrljax.search.frontier` has it.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from hrljax.core import checks
from hrljax.core.numerics import take
from hrljax.core.tracing_errors import explain_tracing
from hrljax.search.frontier import (
    CLOSED,
    Answer,
    Count,
    Loop,
    ModelFn,
    Priority,
    Problem,
    Search,
    expand,
    first_max,
    goes_on,
    rank_of,
    start,
    turn,
    write,
)


class Tree(NamedTuple):
    """The nodes in the order in which they were generated; node 0 is the root.

    Entries from `num_nodes` on are unused: states and rewards 0, values -inf, the rest -1.
    """

    state: Any  # pytree of [N, ...]
    value: (
        Array  # [N] float32: discounted sum of the rewards on the way from the root, and what is beyond (see `model`)
    )
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


def best_first_search(
    model: ModelFn,
    state: Any,
    num_actions: int,
    *,
    depth: int = 6,
    max_nodes: Any = 300,
    room: int | None = None,
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
        model: ``model(state, action) -> next_state, reward``, ``next_state, reward, ended`` or ``next_state, reward,
            ended, beyond`` for one state and one action (int32 scalar): a state of the same structure, shapes and
            types, a float32 scalar, whether this step is the last one (bool scalar): such a node is never expanded,
            and what the steps after it are worth (float32 scalar), which the value of a node has on top if only
            `depth` keeps it from being expanded. Pure; it may close over traced arrays.
        state: where to start, a pytree of arrays.
        num_actions: A.
        depth: greatest depth of a node.
        max_nodes: no expansion starts once so many nodes have been counted. May be a traced number (int32 or
            float32), if there is `room`.
        room: the greatest `max_nodes` that storage is made for; `max_nodes` itself if not given.
        count: counts the nodes that were ``"generated"`` (without the root; an expansion that has
            started is completed, so 300 means 34 expansions of 9 children) or ``"expanded"``.
        priority: the frontier's order: ``"cumulative"`` value, or ``"last_reward"``, the reward of
            the step that leads to a node.
        answer: the best node may be ``"any"``, or only a ``"leaf"``, a node that was not expanded: then
            a promising node whose children are all bad is no answer. With ``"sequence"`` only whole plans
            count, those of `depth` steps and those that have ended; without any, any node.
        stop_reward: the search ends after an expansion with a child of greater value that counts (see `answer`).
        discount: in [0, 1]; the reward of a step from depth d counts ``discount ** d`` times.
        loop: ``"while"`` leaves early, best in native loops; ``"scan"`` runs the greatest number of
            expansions, best under `vmap`. The result is the same bit for bit.

    Raises:
        TypeError, ValueError: an argument is not as described.
    """
    _check_options(num_actions, depth, count, priority, answer, loop)
    most, max_nodes = check_room(max_nodes, room)
    discount = checks.number("discount", discount, checks.SHARE, may_be_traced=True)
    stop_reward = checks.number("stop_reward", stop_reward, checks.Interval(-np.inf, np.inf), may_be_traced=True)
    problem = Problem(
        model,
        num_actions,
        depth,
        max_expansions=_expansions(most, num_actions, count),
        limit=_expansions(max_nodes, num_actions, count),
        priority=priority,
        answer=answer,
        stop_rank=rank_of(_single(stop_reward)),
        discount=None if isinstance(discount, int | float) and discount == 1 else _single(discount),
    )
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(jnp.asarray(leaf).dtype), state)
    _check_model(model, state)

    search = start(problem, state)
    if loop == "while":
        search = lax.while_loop(
            lambda search: goes_on(problem, search),
            lambda search: write(problem, search, expand(problem, search)),
            search,
        )
    else:
        search, _ = lax.scan(lambda search, _: (turn(problem, search), None), search, None, problem.max_expansions)
    return _result(problem, search)


def _result(problem: Problem, search: Search) -> SearchResult:
    tree = _tree(problem, search)
    best = search.best
    if problem.answer == "leaf":
        best = _best_of(tree, tree.expansion < 0, otherwise=best)
    elif problem.answer == "sequence":
        best = lax.select(search.best_rank > CLOSED, best, _best_of(tree, True, otherwise=best))
    actions = _actions_to(problem, search, best)
    length = jnp.sum((actions >= 0).astype(jnp.int32))
    return SearchResult(actions, length, actions[0], take(search.value, best), best, tree)


def _best_of(tree: Tree, which: Array | bool, otherwise: Array) -> Array:
    """The first of the nodes of greatest value, the root apart."""
    numbers = np.arange(len(tree.value), dtype=np.int32)
    is_one = which & (numbers > 0) & (numbers < tree.num_nodes)
    node, rank = first_max(jnp.where(is_one, rank_of(tree.value), CLOSED))
    return lax.select(rank > CLOSED, node, otherwise)


def _tree(problem: Problem, search: Search) -> Tree:
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


def _actions_to(problem: Problem, search: Search, node: Array) -> Array:
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


def check_room(max_nodes: Any, room: int | None, of: str = "") -> tuple[int, Any]:
    """The room for nodes and how many there may be (int32), if it is enough; messages begin with `of`.

    Raises:
        TypeError, ValueError: it is not enough, or a traced number is given without it.
    """
    if room is not None:
        room = checks.integer(f"{of}room", room, 1)
    if not isinstance(max_nodes, Tracer):
        max_nodes = checks.integer(f"{of}max_nodes", max_nodes, 1, room or checks.LARGEST_INTEGER)
        return room or max_nodes, max_nodes
    if room is None:
        raise TypeError(f"{of}room must say how many nodes there are at most, because max_nodes is a traced number")
    nodes = checks.number(f"{of}max_nodes", max_nodes, may_be_traced=True)
    return room, lax.clamp(jnp.int32(1), jnp.asarray(nodes).astype(jnp.int32), jnp.int32(room))


def _expansions(nodes: Any, num_actions: int, count: Count) -> Any:
    """How many expansions count so many nodes."""
    return nodes if count == "expanded" else -(-nodes // num_actions)


def _check_options(num_actions: int, depth: int, count: str, priority: str, answer: str, loop: str) -> None:
    for name, value in (("num_actions", num_actions), ("depth", depth)):
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
    if not (isinstance(output, tuple) and len(output) in (2, 3, 4)):
        what = "a tuple (next_state, reward), one with ended or one with ended and beyond"
        raise TypeError(f"model must return {what}, got {output!r}")
    returned = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), output)
    number, flag = (jax.ShapeDtypeStruct((), kind) for kind in (jnp.float32, jnp.bool_))
    numbers = (number, flag, number)
    expected = (given, *numbers[: len(output) - 1])
    if returned != expected:
        raise TypeError(f"model must return {expected}, of the structure of its state, and got {returned}")
