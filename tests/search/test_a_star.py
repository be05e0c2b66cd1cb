"""A* against plain Python with a heap, node by node; its options and limits."""

import heapq
import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core.numerics import take
from hrljax.engine import batch
from hrljax.search.a_star import AStarResult, a_star_search

F = np.float32
STATES = 24


class Problem(NamedTuple):
    """A model as tables, and where to start."""

    next_state: Any  # [STATES * A] int32
    cost: Any  # [STATES * A] float32
    estimate: Any  # [STATES] float32
    start: Any  # int32
    weight: Any  # float32


def random_problem(seed: int, num_actions: int) -> Problem:
    """Few different numbers, so that most choices are ties; some steps are forbidden, goals are rare."""
    generator = np.random.default_rng(seed)
    shape = STATES * num_actions
    costs = [
        generator.integers(1, 4, shape).astype(F),
        generator.choice(np.array([1, np.inf, 2], F), shape, p=[0.4, 0.4, 0.2]),
        generator.random(shape).astype(F),
        generator.choice(np.array([0, 1], F), shape),
        generator.choice(np.array([1, np.inf], F), shape, p=[0.1, 0.9]),
    ][seed % 5]
    estimates = [
        np.zeros(STATES, F) + generator.choice(np.array([1, 1, 1, 0], F), STATES),
        generator.integers(0, 6, STATES).astype(F),
        generator.random(STATES).astype(F) * 3,
    ][seed % 3]
    return Problem(
        generator.integers(0, STATES, shape).astype(np.int32),
        costs,
        estimates,
        np.int32(generator.integers(STATES)),
        generator.choice(np.array([1, 1.5, 0, 3], F), p=[0.5, 0.2, 0.1, 0.2]),
    )


def searched(problem: Problem, num_actions: int, has_places: bool = False, **options: Any) -> AStarResult:
    def model(state: dict[str, jax.Array], action: jax.Array) -> tuple[Any, jax.Array]:
        entry = state["row"] * np.int32(num_actions) + action
        after = take(problem.next_state, entry)
        trace = jnp.stack([after.astype(jnp.float32), state["trace"][0]])
        return {"row": after, "trace": trace}, take(problem.cost, entry)

    def place(state: dict[str, jax.Array], depth: jax.Array) -> jax.Array:
        return state["row"] // 2 * 3 + depth % 3

    if has_places:
        options |= {"place": place, "num_places": STATES // 2 * 3}
    start = {"row": problem.start, "trace": jnp.zeros(2, jnp.float32)}
    return a_star_search(
        model, start, num_actions, lambda state: take(problem.estimate, state["row"]), weight=problem.weight, **options
    )


class PythonNode(NamedTuple):
    row: int
    trace: tuple[float, float]
    cost: np.float32
    depth: int
    way: tuple[int, ...]
    parent: int  # number of the expansion that generated it


def in_python(
    problem: Problem, num_actions: int, depth: int, max_expansions: int, has_places: bool = False
) -> tuple[list[PythonNode], PythonNode | None]:
    """The same search with a heap of Python objects: the expanded nodes, and the node whose turn is next."""
    node: PythonNode | None = PythonNode(int(problem.start), (0, 0), F(0), 0, (), -1)
    expanded: list[PythonNode] = []
    heap: list[tuple[float, int, PythonNode]] = []
    passed = set()
    generated = 0
    while node is not None and len(expanded) < max_expansions:
        if node.way and (problem.estimate[node.row] <= 0 or node.depth == depth):
            break
        for action in range(num_actions):
            entry = node.row * num_actions + action
            after, cost = int(problem.next_state[entry]), node.cost + problem.cost[entry]
            f = cost + problem.weight * problem.estimate[after]
            child = PythonNode(after, (after, node.trace[0]), cost, node.depth + 1, (*node.way, action), len(expanded))
            if f < math.inf:
                heapq.heappush(heap, (float(f), generated, child))
            generated += 1
        expanded.append(node)
        node = None
        while heap and node is None:
            _, _, node = heapq.heappop(heap)
            place = node.row // 2, node.depth % 3
            if has_places and place in passed:
                node = None
            else:
                passed.add(place)
    return expanded, node


def assert_equals_python(actual: AStarResult, problem: Problem, num_actions: int, depth: int, **options: Any) -> None:
    expanded, end = in_python(problem, num_actions, depth, **options)
    count = len(expanded)
    assert actual.num_expanded == count
    nodes = actual.nodes
    np.testing.assert_array_equal(nodes.state["row"][:count], [node.row for node in expanded])
    np.testing.assert_array_equal(nodes.state["trace"][:count], [node.trace for node in expanded])
    np.testing.assert_array_equal(nodes.cost[:count], [node.cost for node in expanded])
    np.testing.assert_array_equal(nodes.depth[:count], [node.depth for node in expanded])
    np.testing.assert_array_equal(nodes.parent[:count], [node.parent for node in expanded])
    np.testing.assert_array_equal(nodes.action[:count], [node.way[-1] if node.way else -1 for node in expanded])
    end = end or max(expanded, key=lambda node: node.depth)
    assert actual.length == len(end.way)
    np.testing.assert_array_equal(actual.actions, [*end.way, *[-1] * (depth - len(end.way))])
    assert actual.action == (end.way[0] if end.way else 0)
    assert actual.cost == end.cost
    assert actual.estimate == problem.estimate[end.row]


SETTINGS: dict[str, tuple[int, dict[str, Any]]] = {
    "plain": (3, {"depth": 20, "max_expansions": 60}),
    "small budget": (4, {"depth": 20, "max_expansions": 5}),
    "one expansion": (4, {"depth": 6, "max_expansions": 1}),
    "short ways": (3, {"depth": 2, "max_expansions": 40}),
    "one step": (3, {"depth": 1, "max_expansions": 40}),
    "places": (3, {"depth": 20, "max_expansions": 60, "has_places": True}),
    "one action": (1, {"depth": 9, "max_expansions": 20, "has_places": True}),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_every_node_is_that_of_plain_python(name: str):
    num_actions, options = SETTINGS[name]
    problems = [random_problem(seed, num_actions) for seed in range(60)]
    search = batch.compile_mapped(partial(searched, num_actions=num_actions, **options), "native", nested=True)
    results = jax.tree.map(np.asarray, search(jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *problems)))
    for i, problem in enumerate(problems):
        assert_equals_python(jax.tree.map(lambda x, i=i: x[i], results), problem, num_actions, **options)


@pytest.mark.slow
def test_vmap_gives_the_same():
    num_actions, options = SETTINGS["places"]
    problems = [random_problem(seed, num_actions) for seed in range(20)]
    search = batch.compile_mapped(partial(searched, num_actions=num_actions, **options), "vmap")
    results = jax.tree.map(np.asarray, search(jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *problems)))
    for i, problem in enumerate(problems):
        assert_equals_python(jax.tree.map(lambda x, i=i: x[i], results), problem, num_actions, **options)


def on_a_grid(walls: frozenset[tuple[int, int]], size: int, goal: tuple[int, int]) -> Any:
    """Four moves on a grid; walls are forbidden; the estimate is the Manhattan distance."""
    blocked = np.zeros((size, size), bool)
    for x, y in walls:
        blocked[y, x] = True
    moves = jnp.asarray([[1, 0], [-1, 0], [0, 1], [0, -1]], jnp.int32)

    def model(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        after = state + moves[action]
        inside = jnp.all((after >= 0) & (after < size))
        x, y = jnp.clip(after, 0, size - 1)
        free = inside & ~jnp.asarray(blocked)[y, x]
        return jnp.where(free, after, state), jnp.where(free, jnp.float32(1), jnp.float32(jnp.inf))

    def estimate(state: jax.Array) -> jax.Array:
        return jnp.abs(state - jnp.asarray(goal, jnp.int32)).sum(dtype=jnp.int32).astype(jnp.float32)

    return model, estimate


def test_a_shortest_way_around_a_wall_is_the_answer():
    """A wall x = 2, y = 0..3 on a 5 x 5 grid: from (0, 0) to (4, 0) it takes 4 steps down, 4 right, 4 up."""
    model, estimate = on_a_grid(frozenset((2, y) for y in range(4)), 5, (4, 0))
    search = partial(
        a_star_search, num_actions=4, estimate=estimate, place=lambda at, depth: at[1] * 5 + at[0], num_places=25
    )
    result = jax.jit(lambda at: search(model, at, depth=20))(jnp.asarray([0, 0], jnp.int32))
    assert (result.length, result.cost, result.estimate) == (12, 12, 0)
    at = jnp.asarray([0, 0], jnp.int32)
    for action in result.actions[:12]:
        at, cost = model(at, action)
        assert cost == 1
    np.testing.assert_array_equal(at, [4, 0])
    # Every cell is expanded once at most, because a cell is a place.
    assert result.num_expanded <= 21


def test_a_greater_weight_expands_less_and_may_pay_for_it():
    model, estimate = on_a_grid(frozenset((4, y) for y in range(8)), 9, (8, 0))

    def expansions(weight: float) -> tuple[int, float]:
        search = partial(a_star_search, place=lambda at, depth: at[1] * 9 + at[0], num_places=81, weight=weight)
        result = jax.jit(lambda at: search(model, at, 4, estimate))(jnp.asarray([0, 0], jnp.int32))
        assert result.estimate == 0
        return int(result.num_expanded), float(result.cost)

    (plain, least), (hurried, cost) = expansions(0.0), expansions(2.0)
    assert hurried < plain
    assert least == 24 <= cost


def test_where_every_way_ends_the_deepest_node_is_the_answer():
    """A corridor of three cells with a pit at its end: action 1 walks, action 0 falls at once."""

    def corridor(cell: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        falls = (action == 0) | (cell >= 3)
        return cell + 1, jnp.where(falls, jnp.float32(jnp.inf), jnp.float32(1))

    result = jax.jit(lambda cell: a_star_search(corridor, cell, 2, lambda cell: jnp.float32(9), depth=8))(jnp.int32(0))
    np.testing.assert_array_equal(result.actions, [1, 1, 1, -1, -1, -1, -1, -1])
    assert (result.length, result.cost, result.num_expanded) == (3, 3, 4)


@pytest.mark.parametrize(
    ("argument", "value", "error", "message"),
    [
        ("num_actions", 0, ValueError, "num_actions must be an integer from 1 to 2147483647, got 0"),
        ("depth", 0, ValueError, "depth must be an integer from 1 to 2147483647, got 0"),
        ("max_expansions", 2.0, TypeError, "max_expansions must be an integer from 1 to .*, got 2.0"),
        ("num_places", -1, ValueError, "num_places must be an integer from 1 to 2147483647, got -1"),
        ("weight", -0.5, ValueError, r"weight must be a number in \[0, inf\], got -0.5"),
        ("model", None, TypeError, "model must be a function of a state and an action, got None"),
        ("model", lambda s, a: s, TypeError, "model and estimate must return"),
        ("model", lambda s, a: (s, jnp.int32(1)), TypeError, "model and estimate must return"),
        ("estimate", lambda s: jnp.zeros(1), TypeError, "model and estimate must return"),
        ("estimate", 3, TypeError, "estimate must be a function of a state, got 3"),
        ("place", lambda s: s, TypeError, "place must be a function of a state and its depth"),
    ],
)
def test_bad_options_are_refused(argument: str, value: Any, error: type[Exception], message: str):
    options = {
        "model": lambda state, action: (state, jnp.float32(1)),
        "num_actions": 2,
        "estimate": lambda state: jnp.float32(1),
        argument: value,
    }
    with pytest.raises(error, match=message):
        a_star_search(state=jnp.float32(0), **options)
