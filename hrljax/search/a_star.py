"""A* of limited size over any deterministic model (Hart, Nilsson and Raphael 1968).

The open node of the least

    f(n) = g(n) + w h(n)

is expanded, again and again: g is the cost of the way to n, h an estimate of what is left, and a weight w above 1
hurries towards the goal (Pohl 1970). The search ends when the node whose turn it is has reached the goal. Where the
budget ends first, that node is the answer all the same, as in real-time search (Korf 1990): the agent sets out for the
most promising end of what it has seen, and searches again on the way.

States may be large, a whole game for example: only expanded nodes keep theirs. A child is known by its parent and its
action, and its state is made once more when its turn comes. Storage is allocated up front.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.flags import choose
from hrljax.core.numerics import exact_product, opaque_zero, put_row, take, take_row
from hrljax.core.tracing_errors import explain_tracing
from hrljax.search.frontier import CLOSED, first_max, rank_of

Model = Callable[[Any, Array], tuple[Any, Array]]
"""Of a state and an action: the next state, and the cost of the step (float32; infinite: there is no such step)."""
Estimate = Callable[[Any], Array]
"""Of a state: what the rest of the way costs, as far as one can tell (float32); 0 or less at a goal."""
Place = Callable[[Any, Array], Array]
"""Of a state and its depth: a number (int32). Of nodes with one number only the first whose turn comes is expanded."""

_ROOT, _NONE = np.int32(-1), np.int32(-2)


class Nodes(NamedTuple):
    """The expanded nodes in their order, the root first; entries from `AStarResult.num_expanded` on are unused."""

    state: Any  # pytree of [E, ...]
    cost: Array  # [E] float32: g
    depth: Array  # [E] int32
    parent: Array  # [E] int32, -1 for the root
    action: Array  # [E] int32: the action that leads here, -1 for the root


class AStarResult(NamedTuple):
    """The best way, and the nodes that were expanded to get it."""

    actions: Array  # [depth] int32: the actions of the way, then -1
    length: Array  # int32: how many they are
    action: Array  # int32: the first of them; 0 if there is none
    cost: Array  # float32: of the way
    estimate: Array  # float32: of what is left at its end
    num_expanded: Array  # int32
    nodes: Nodes


class _Search(NamedTuple):
    """A search under way: E expansions with a block of A children each, child a of node i at i * A + a."""

    nodes: Nodes
    cost: Array  # [E * A] float32
    estimate: Array  # [E * A] float32
    place: Array  # [E * A] int32
    ranks: Array  # [E * A] int32: of -f; `CLOSED` unless it is open
    best_ranks: Array  # [E] int32: the greatest of every block
    passed: Array  # [K] bool: places of which a node was expanded
    num_expanded: Array  # int32
    turn: Array  # int32: the child whose turn it is, `_ROOT` or `_NONE`


@dataclass(frozen=True)
class _Problem:
    model: Model
    estimate: Estimate
    place: Place
    num_actions: int
    depth: int
    max_expansions: int
    weight: Array


def a_star_search(
    model: Model,
    state: Any,
    num_actions: int,
    estimate: Estimate,
    *,
    depth: int = 32,
    max_expansions: int = 256,
    weight: Array | float = 1.0,
    place: Place | None = None,
    num_places: int = 1,
) -> AStarResult:
    """Searches for a cheap way to a goal.

    Ties go to the node that was generated first, among siblings to the lowest action. If every way ends in a
    step of infinite cost, the answer is the deepest node that was expanded, the first of several.

    Args:
        model: `Model`, for one state and one action (int32 scalar): a state of the same structure, shapes and types.
            Pure; it may close over traced arrays.
        state: where to start, a pytree of arrays.
        num_actions: A.
        estimate: `Estimate`. With w = 1, and where it never promises too little, the way to a goal is a cheapest one.
        depth: greatest length of a way; a node at its end ends the search as a goal does.
        max_expansions: E, the greatest number of nodes that are expanded, the root included.
        weight: w, at least 0.
        place: `Place`; None: no two nodes share one.
        num_places: K, one more than the greatest number that `place` gives.

    Raises:
        TypeError, ValueError: an argument is not as described.
    """
    for name, value in (("num_actions", num_actions), ("depth", depth), ("max_expansions", max_expansions)):
        checks.integer(name, value, 1)
    checks.integer("num_places", num_places, 1)
    weight = checks.number("weight", weight, checks.Interval(0, np.inf), may_be_traced=True)
    checks.function("estimate", estimate, "of a state")
    if place is not None:
        checks.function("place", place, "of a state and its depth", num_arguments=2)
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(jnp.asarray(leaf).dtype), state)
    _check_model(model, estimate, state)
    problem = _Problem(
        model,
        estimate,
        place or (lambda state, depth: jnp.int32(0)),
        num_actions,
        depth,
        max_expansions,
        jnp.asarray(weight).astype(jnp.float32),
    )
    search = lax.while_loop(
        lambda search: _goes_on(problem, search),
        lambda search: _next_turn(place is not None, _expanded(problem, search)),
        _start(problem, state, num_places),
    )
    return _result(problem, search)


def _start(problem: _Problem, state: Any, num_places: int) -> _Search:
    nodes, children = problem.max_expansions, problem.max_expansions * problem.num_actions
    none = jnp.full(nodes, -1, jnp.int32)
    return _Search(
        nodes=Nodes(
            state=jax.tree.map(lambda leaf: jnp.zeros((nodes, *leaf.shape), leaf.dtype).at[0].set(leaf), state),
            cost=jnp.zeros(nodes, jnp.float32),
            depth=jnp.zeros(nodes, jnp.int32),
            parent=none,
            action=none,
        ),
        cost=jnp.zeros(children, jnp.float32),
        estimate=jnp.zeros(children, jnp.float32),
        place=jnp.zeros(children, jnp.int32),
        ranks=jnp.full(children, CLOSED),
        best_ranks=jnp.full(nodes, CLOSED),
        passed=jnp.zeros(num_places, bool),
        num_expanded=jnp.int32(0),
        turn=jnp.asarray(_ROOT),
    )


def _goes_on(problem: _Problem, search: _Search) -> Array:
    """Whether the node whose turn it is is to be expanded."""
    parent, _ = _parent_and_action(problem.num_actions, search.turn)
    arrived = (search.turn >= 0) & (
        (take(search.estimate, lax.max(search.turn, jnp.int32(0))) <= 0)
        | (take(search.nodes.depth, lax.max(parent, jnp.int32(0))) + 1 >= problem.depth)
    )
    return (search.turn > _NONE) & ~arrived & (search.num_expanded < problem.max_expansions)


def _parent_and_action(num_actions: int, child: Array) -> tuple[Array, Array]:
    """The expansion that generated a child and the action that led to it; -1 and -1 for the root."""
    is_child = child >= 0
    one = jnp.int32(-1)
    return (
        lax.select(is_child, lax.div(child, np.int32(num_actions)), one),
        lax.select(is_child, lax.rem(child, np.int32(num_actions)), one),
    )


class _Children(NamedTuple):
    cost: Array  # [A] float32: g
    estimate: Array  # [A] float32
    place: Array  # [A] int32
    ranks: Array  # [A] int32


def _expanded(problem: _Problem, search: _Search) -> _Search:
    """The search after the node whose turn it is has been expanded."""
    nodes, number, width = search.nodes, search.num_expanded, problem.num_actions
    parent, action = _parent_and_action(width, search.turn)
    is_root = search.turn < 0
    above, child = lax.max(parent, jnp.int32(0)), lax.max(search.turn, jnp.int32(0))
    depth = lax.select(is_root, jnp.int32(0), take(nodes.depth, above) + 1)
    cost = lax.select(is_root, jnp.float32(0), take(search.cost, child))
    source = lax.optimization_barrier(
        jax.tree.map(lambda rows: lax.dynamic_index_in_dim(rows, above.astype(jnp.uint32), keepdims=False), nodes.state)
    )
    state, children = _generated(problem, source, action, cost, depth)
    first = number * width
    return search._replace(
        nodes=Nodes(
            state=jax.tree.map(
                lambda rows, row: lax.dynamic_update_index_in_dim(rows, row, number.astype(jnp.uint32), 0),
                nodes.state,
                state,
            ),
            cost=put_row(nodes.cost, number, cost[None]),
            depth=put_row(nodes.depth, number, depth[None]),
            parent=put_row(nodes.parent, number, parent[None]),
            action=put_row(nodes.action, number, action[None]),
        ),
        cost=put_row(search.cost, first, children.cost),
        estimate=put_row(search.estimate, first, children.estimate),
        place=put_row(search.place, first, children.place),
        ranks=put_row(search.ranks, first, children.ranks),
        best_ranks=put_row(search.best_ranks, number, jnp.max(children.ranks)[None]),
        num_expanded=number + 1,
    )


def _generated(problem: _Problem, source: Any, action: Array, cost: Array, depth: Array) -> tuple[Any, _Children]:
    """The state of a node, made from that of its parent, and its children.

    One loop for both, so that the model is compiled once: its first turn takes the action that leads to the node,
    which is the node's own state already if it is the root, and the others take each action from there.
    """
    width, zero = problem.num_actions, jnp.int32(0)

    def take_step(carry: tuple[Array, Any, _Children]) -> tuple[Array, Any, _Children]:
        number, state, children = carry
        leads_here = number < 0
        after, step_cost = problem.model(state, lax.select(leads_here, action, number))
        total = cost + step_cost
        left = problem.estimate(after)
        word = opaque_zero(lax.bitcast_convert_type(left, jnp.uint32))
        rank = rank_of(-(total + exact_product(problem.weight, left, word)))
        row = _Children(total, left, problem.place(after, depth + 1), rank)
        at = lax.max(number, zero)  # what the first turn writes, the second overwrites
        children = jax.tree.map(lambda values, value: put_row(values, at, value[None]), children, row)
        return number + 1, choose(leads_here, after, state), children

    floats, integers = jnp.zeros(width, jnp.float32), jnp.zeros(width, jnp.int32)
    first = lax.select(action < 0, zero, jnp.int32(-1))
    start = (first, source, _Children(floats, floats, integers, integers))
    _, state, children = lax.while_loop(lambda carry: carry[0] < width, take_step, start)
    return state, children


def _next_turn(has_places: bool, search: _Search) -> _Search:
    """Takes the best open node off the frontier; with places, the best one of a place that was not passed."""

    def pop(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        ranks, best_ranks, _, _ = carry
        width = len(ranks) // len(best_ranks)
        block, _ = first_max(best_ranks)
        row = take_row(ranks, block * width, width)
        within, best = first_max(row)
        child = block * width + within
        row = lax.select(np.arange(width, dtype=np.int32) == within, jnp.full(width, CLOSED), row)
        ranks = put_row(ranks, block * width, row)
        best_ranks = put_row(best_ranks, block, jnp.max(row)[None])
        is_open = best > CLOSED
        closed = is_open & take(passed, take(search.place, child)) if has_places else jnp.bool_(False)
        return ranks, best_ranks, lax.select(is_open, child, jnp.asarray(_NONE)), closed

    passed = search.passed
    start = search.ranks, search.best_ranks, jnp.asarray(_NONE), jnp.bool_(True)
    ranks, best_ranks, turn, _ = lax.while_loop(lambda carry: carry[3], pop, start)
    if has_places:
        place = take(search.place, lax.max(turn, jnp.int32(0)))
        now = (take(passed, place) | (turn >= 0))[None]
        passed = put_row(passed, place, now)
    return search._replace(ranks=ranks, best_ranks=best_ranks, turn=turn, passed=passed)


def _result(problem: _Problem, search: _Search) -> AStarResult:
    nodes, has_end = search.nodes, search.turn >= 0
    parent, action = _parent_and_action(problem.num_actions, search.turn)
    child = lax.max(search.turn, jnp.int32(0))
    used = np.arange(problem.max_expansions, dtype=np.int32) < search.num_expanded
    deepest, _ = first_max(jnp.where(used, nodes.depth, -1))
    # The way to the end: its last action, and those to its parent before it.
    node = lax.select(has_end, parent, deepest)
    last = jnp.full(problem.depth, -1, jnp.int32).at[0].set(lax.select(has_end, action, jnp.int32(-1)))
    places = np.arange(problem.depth, dtype=np.int32)

    def to_parent(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        node, actions = carry
        return take(nodes.parent, node), jnp.where(places == 0, take(nodes.action, node), jnp.roll(actions, 1))

    _, actions = lax.while_loop(lambda carry: carry[0] > 0, to_parent, (node, last))
    return AStarResult(
        actions=actions,
        length=jnp.sum((actions >= 0).astype(jnp.int32)),
        action=lax.max(actions[0], jnp.int32(0)),
        cost=lax.select(has_end, take(search.cost, child), take(nodes.cost, deepest)),
        estimate=lax.select(
            has_end,
            take(search.estimate, child),
            problem.estimate(jax.tree.map(lambda rows: rows[deepest], nodes.state)),
        ),
        num_expanded=search.num_expanded,
        nodes=nodes,
    )


def _check_model(model: Model, estimate: Estimate, state: Any) -> None:
    """Raises TypeError unless the model gives a state like `state` and a float32 scalar, and `estimate` a float32."""
    checks.function("model", model, "of a state and an action", num_arguments=2)
    given = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)
    number = jax.ShapeDtypeStruct((), jnp.float32)
    with explain_tracing("model"):
        output = jax.eval_shape(model, given, jax.ShapeDtypeStruct((), jnp.int32))
        left = jax.eval_shape(estimate, given)
    returned = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), (output, left))
    expected = ((given, number), number)
    if returned != expected:
        raise TypeError(f"model and estimate must return {expected}, of the structure of the state, and got {returned}")
