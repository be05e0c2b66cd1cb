"""The best-first search against plain Python with a heap, node by node; its options and limits."""

import heapq
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core.numerics import take
from hrljax.engine import batch
from hrljax.search.best_first import SearchResult, best_first_search
from hrljax.search.nodes import edges, to_nodes

F = np.float32
STATES = 15


class Table(NamedTuple):
    """A model as tables, and the numbers of a search on it."""

    next_state: Any  # [STATES * A] int32
    reward: Any  # [STATES * A] float32
    ended: Any  # [STATES * A] bool; for models that say so
    beyond: Any  # [STATES * A] float32; likewise
    start: Any  # int32
    stop_reward: Any  # float32
    discount: Any  # float32


def random_table(seed: int, num_actions: int) -> Table:
    """Few different rewards, so that most choices are ties; some forbidden actions, some infinite rewards."""
    generator = np.random.default_rng(seed)
    shape = STATES * num_actions
    rewards = [
        generator.integers(-2, 3, shape).astype(F),
        generator.choice(np.array([0, -0.0, 1], F), shape),
        generator.normal(size=shape).astype(F),
        np.zeros(shape, F),
        generator.choice(np.array([-np.inf, -1, 0.25, 1], F), shape, p=[0.3, 0.3, 0.2, 0.2]),
        generator.choice(np.array([np.nan, np.inf, -np.inf, 0, -1], F), shape, p=[0.1, 0.05, 0.1, 0.5, 0.25]),
    ][seed % 6]
    return Table(
        generator.integers(0, STATES, shape).astype(np.int32),
        rewards,
        np.random.default_rng([seed, 1]).random(shape) < [0.1, 0.5, 0.9][seed % 3],
        np.random.default_rng([seed, 2]).integers(-9, 3, shape).astype(F),
        np.int32(generator.integers(STATES)),
        generator.choice(np.array([np.inf, 6, 2, 0.5, -np.inf], F), p=[0.4, 0.2, 0.2, 0.1, 0.1]),
        generator.choice(np.array([1, 0.9, 0.5, 0], F), p=[0.3, 0.4, 0.2, 0.1]),
    )


def stacked(tables: list[Table]) -> Table:
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *tables)


def searched(
    table: Table, num_actions: int, may_end: bool = False, beyond: bool = False, **options: Any
) -> SearchResult:
    """Searches a table; the state is a pytree that holds more than the row of the table."""

    def model(state: dict[str, jax.Array], action: jax.Array) -> tuple[Any, ...]:
        entry = state["row"] * np.int32(num_actions) + action
        after = take(table.next_state, entry)
        trace = jnp.stack([after.astype(jnp.float32), state["trace"][0]])
        outcome = {"row": after, "trace": trace}, take(table.reward, entry)
        says = (take(table.ended, entry), take(table.beyond, entry))
        return (*outcome, *says[: may_end + beyond])

    start = {"row": table.start, "trace": jnp.zeros(2, jnp.float32)}
    return best_first_search(model, start, num_actions, **options)


def search_with_numbers(table: Table, num_actions: int, **options: Any) -> SearchResult:
    return searched(table, num_actions, stop_reward=table.stop_reward, discount=table.discount, **options)


class PythonNode(NamedTuple):
    row: int
    trace: tuple[float, float]
    value: np.float32
    reward: np.float32
    depth: int
    parent: int
    action: int
    weight: np.float32


def in_python(
    table: Table,
    num_actions: int,
    depth: int,
    max_nodes: int,
    count: str = "generated",
    priority: str = "cumulative",
    answer: str = "any",
    may_end: bool = False,
    beyond: bool = False,
) -> tuple[list[PythonNode], dict[int, int], int]:
    """The same search with a heap of Python objects: nodes, when each was expanded, the best node."""
    whole: list[int] = []
    nodes = [PythonNode(int(table.start), (0, 0), F(0), F(0), 0, -1, -1, F(1))]
    heap = [(-0.0, 0)]
    expansion: dict[int, int] = {}
    best = 0
    while heap and (len(expansion) if count == "expanded" else len(nodes) - 1) < max_nodes:
        counted = whole if answer == "sequence" else range(1, len(nodes))
        if any(nodes[i].value > table.stop_reward for i in counted):
            break
        _, index = heapq.heappop(heap)
        expansion[index] = len(expansion)
        parent = nodes[index]
        for action in range(num_actions):
            after = int(table.next_state[parent.row * num_actions + action])
            reward = table.reward[parent.row * num_actions + action]
            with np.errstate(invalid="ignore"):
                value = parent.value + parent.weight * reward
            weight = parent.weight * table.discount
            ends = may_end and bool(table.ended[parent.row * num_actions + action])
            if beyond and parent.depth + 1 == depth and not ends:
                value = value + weight * table.beyond[parent.row * num_actions + action]
            child = PythonNode(after, (after, parent.trace[0]), value, reward, parent.depth + 1, index, action, weight)
            nodes.append(child)
            whole += [len(nodes) - 1] if ends or child.depth == depth else []
            if child.depth < depth and value > -np.inf and not ends:
                heapq.heappush(heap, (-float(value if priority == "cumulative" else reward), len(nodes) - 1))
            if best == 0 or value > nodes[best].value or (np.isnan(nodes[best].value) and value > -np.inf):
                best = len(nodes) - 1
    leaves = [i for i, node in enumerate(nodes) if i and i not in expansion and node.value > -np.inf]
    plans = {"any": [], "leaf": leaves, "sequence": [i for i in whole if nodes[i].value > -np.inf]}[answer]
    if plans:
        best = max(plans, key=lambda i: nodes[i].value)
    return nodes, expansion, best


def actions_to(nodes: list[PythonNode], index: int) -> list[int]:
    return [*actions_to(nodes, nodes[index].parent), nodes[index].action] if index else []


def assert_equals_python(actual: SearchResult, table: Table, num_actions: int, depth: int, **options: Any) -> None:
    nodes, expansion, best = in_python(table, num_actions, depth, **options)
    n, tree = len(nodes), actual.tree
    assert tree.num_nodes == n
    np.testing.assert_array_equal(tree.value[:n], [node.value for node in nodes])
    np.testing.assert_array_equal(tree.reward[:n], [node.reward for node in nodes])
    np.testing.assert_array_equal(tree.state["row"][:n], [node.row for node in nodes])
    np.testing.assert_array_equal(tree.state["trace"][:n], [node.trace for node in nodes])
    np.testing.assert_array_equal(tree.depth[:n], [node.depth for node in nodes])
    np.testing.assert_array_equal(tree.parent[:n], [node.parent for node in nodes])
    np.testing.assert_array_equal(tree.action[:n], [node.action for node in nodes])
    np.testing.assert_array_equal(tree.expansion[:n], [expansion.get(i, -1) for i in range(n)])
    for unused in (tree.depth, tree.parent, tree.action, tree.expansion):
        assert np.all(unused[n:] == -1)
    assert np.all(tree.value[n:] == -np.inf)
    for blank in (tree.reward, tree.state["row"], tree.state["trace"]):
        assert not np.any(blank[n:])
    sequence = actions_to(nodes, best)
    assert actual.node == best
    assert actual.length == len(sequence)
    np.testing.assert_array_equal(actual.actions, sequence + [-1] * (depth - len(sequence)))
    assert actual.action == sequence[0]
    np.testing.assert_array_equal(actual.value, nodes[best].value)


SETTINGS: dict[str, tuple[int, dict[str, Any]]] = {
    "nine actions": (9, {"depth": 6, "max_nodes": 100}),
    "expanded": (3, {"depth": 5, "max_nodes": 40, "count": "expanded"}),
    "leaf": (3, {"depth": 4, "max_nodes": 60, "answer": "leaf"}),
    "last reward": (4, {"depth": 4, "max_nodes": 90, "priority": "last_reward"}),
    "last reward, expanded": (2, {"depth": 7, "max_nodes": 31, "count": "expanded", "priority": "last_reward"}),
    "whole tree": (3, {"depth": 3, "max_nodes": 60}),
    "one action": (1, {"depth": 8, "max_nodes": 5}),
    "one step": (5, {"depth": 1, "max_nodes": 20}),
    "ends": (4, {"depth": 6, "max_nodes": 100, "may_end": True}),
    "sequence": (3, {"depth": 4, "max_nodes": 60, "answer": "sequence"}),
    "sequence, ends": (4, {"depth": 5, "max_nodes": 120, "answer": "sequence", "may_end": True}),
    "beyond": (4, {"depth": 4, "max_nodes": 120, "answer": "sequence", "may_end": True, "beyond": True}),
    "beyond, any node": (3, {"depth": 2, "max_nodes": 40, "may_end": True, "beyond": True}),
    "sequence, ends, last reward": (
        9,
        {"depth": 3, "max_nodes": 90, "answer": "sequence", "may_end": True, "priority": "last_reward"},
    ),
    "leaf, ends, expanded": (3, {"depth": 5, "max_nodes": 20, "answer": "leaf", "may_end": True, "count": "expanded"}),
    "one node": (4, {"depth": 3, "max_nodes": 1}),
}
MODELS = 112  # more than 1,000 in all


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
def test_every_node_is_that_of_plain_python_under_both_mappings(name: str):
    num_actions, options = SETTINGS[name]
    tables = [random_table(seed, num_actions) for seed in range(MODELS)]
    for mapping, loop in (("native", "while"), ("vmap", "scan")):
        search = partial(search_with_numbers, num_actions=num_actions, loop=loop, **options)
        results = jax.tree.map(np.asarray, batch.compile_mapped(search, mapping)(stacked(tables)))
        for i, table in enumerate(tables):
            assert_equals_python(jax.tree.map(lambda x, i=i: x[i], results), table, num_actions, **options)


@pytest.mark.parametrize(
    ("mapping", "loop"), [("native", "while"), pytest.param("vmap", "scan", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("count", ["generated", "expanded"])
def test_a_number_of_nodes_that_is_known_late_gives_the_same(mapping: Any, loop: str, count: Any):
    num_actions, options = 4, {"depth": 5, "count": count, "answer": "sequence"}
    counts = np.array([1, 2, 7, 8, 9, 13, 30, 31], np.float32)
    table = random_table(3, num_actions)

    def search(max_nodes: Any) -> SearchResult:
        return search_with_numbers(table, num_actions, max_nodes=max_nodes, room=31, loop=loop, **options)

    results = jax.tree.map(np.asarray, batch.compile_mapped(search, mapping)(jnp.asarray(counts)))
    sizes = set()
    for i, max_nodes in enumerate(counts.astype(int)):
        result = jax.tree.map(lambda x, i=i: x[i], results)
        assert_equals_python(result, table, num_actions, max_nodes=max_nodes, **options)
        sizes.add(int(result.tree.num_nodes))
    assert len(sizes) >= 5


@pytest.mark.slow
@pytest.mark.parametrize(("mapping", "loop"), [("native", "scan"), ("vmap", "while")])
def test_the_other_pairs_of_loop_and_mapping_give_the_same(mapping: Any, loop: str):
    num_actions, options = SETTINGS["nine actions"]
    tables = [random_table(seed, num_actions) for seed in range(24)]
    search = partial(search_with_numbers, num_actions=num_actions, loop=loop, **options)
    results = jax.tree.map(np.asarray, batch.compile_mapped(search, mapping)(stacked(tables)))
    for i, table in enumerate(tables):
        assert_equals_python(jax.tree.map(lambda x, i=i: x[i], results), table, num_actions, **options)


@pytest.mark.parametrize("loop", ["while", "scan"])
def test_a_search_alone_gives_the_same_with_constant_numbers(loop: str):
    """A discount of 1 that is known beforehand is compiled without products."""
    num_actions, options = SETTINGS["expanded"]
    search = jax.jit(partial(searched, num_actions=num_actions, stop_reward=2.0, loop=loop, **options))
    for seed in range(12):
        table = random_table(seed, num_actions)._replace(stop_reward=F(2), discount=F(1))
        result = jax.tree.map(np.asarray, search(jax.tree.map(jnp.asarray, table)))
        assert_equals_python(result, table, num_actions, **options)


def line(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A walk on a line: action 0, 1, 2 moves by -1, 0, 1 and earns that."""
    step = (action - 1).astype(jnp.float32)
    return state + step, step


def test_the_thesis_numbers_are_34_expansions_of_9_children():
    def empty(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state, -action.astype(jnp.float32)

    result = jax.jit(lambda x: best_first_search(empty, x, 9))(jnp.int32(0))
    assert result.tree.num_nodes == 1 + 34 * 9
    assert result.actions.shape == (6,)
    expanded = jax.jit(lambda x: best_first_search(empty, x, 9, count="expanded"))(jnp.int32(0))
    assert expanded.tree.num_nodes == 1 + 300 * 9
    assert np.max(expanded.tree.depth) == 6


def test_the_search_ends_with_the_first_expansion_beyond_the_stop_reward():
    search = jax.jit(lambda stop: best_first_search(line, jnp.float32(10), 3, stop_reward=stop))
    for stop, expansions in ((-0.5, 1), (0.5, 1), (1, 2), (2, 3), (2.5, 3)):
        result = search(F(stop))
        assert result.tree.num_nodes == 1 + 3 * expansions
        assert result.value == expansions
        assert result.tree.state[result.node] == 10 + expansions
        np.testing.assert_array_equal(result.actions, [2] * expansions + [-1] * (6 - expansions))


def test_a_node_at_the_greatest_depth_is_never_expanded_and_the_frontier_runs_empty():
    search = jax.jit(lambda x: best_first_search(line, x, 3, depth=2, max_nodes=1000, stop_reward=np.inf))
    result = search(jnp.float32(0))
    assert result.tree.num_nodes == 1 + 3 + 9
    assert np.max(result.tree.depth) == 2
    assert np.all(np.asarray(result.tree.expansion)[np.asarray(result.tree.depth) == 2] == -1)
    np.testing.assert_array_equal(result.actions, [2, 2])


def test_where_every_action_is_forbidden_the_first_is_returned():
    def forbidden(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state, jnp.float32(-np.inf)

    result = jax.jit(lambda x: best_first_search(forbidden, x, 3))(jnp.float32(0))
    assert result.tree.num_nodes == 4
    assert (result.action, result.length, result.value) == (0, 1, -np.inf)


def test_ties_go_to_the_earliest_node():
    def same(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        return state, jnp.float32(0)

    result = jax.jit(lambda x: best_first_search(same, x, 2, depth=10, max_nodes=14))(jnp.int32(0))
    np.testing.assert_array_equal(result.tree.expansion[:7], np.arange(7))
    assert result.node == 1


def test_the_last_reward_orders_otherwise_than_the_sum():
    """After 2 and then -1 the sum is 1, ahead of 0; the last reward is behind it."""
    rewards = jnp.asarray(np.array([[2, 0], [-1, -1], [0.25, 0.5]], F))

    def model(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        after = state * 2 + action + 1
        return jnp.where(after > 2, 0, after), rewards[state, action]

    orders = {}
    for priority in ("cumulative", "last_reward"):
        search = jax.jit(partial(best_first_search, model, num_actions=2, depth=3, max_nodes=6, priority=priority))
        tree = search(jnp.int32(0)).tree
        orders[priority] = [int(np.argmax(np.asarray(tree.expansion) == turn)) for turn in range(3)]
    assert orders == {"cumulative": [0, 1, 3], "last_reward": [0, 1, 2]}


def before_a_pit(state: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Cells with a pit at 3: a walk to the next (0) earns 3, a jump over it (1) 1; the fall costs 50 and is the end."""
    after = state + 1 + action
    falls = after == 3
    reward = jnp.where(falls, jnp.float32(-50), jnp.where(action == 0, jnp.float32(3), jnp.float32(1)))
    return after, reward, falls


def test_a_plan_is_whole_or_ends():
    """By hand: nodes 1 (cell 1, 3) and 2 (cell 2, 1), of node 1 then 3 (cell 2, 6) and 4 (the pit, -47), of node 3 then
    5 (the pit, -44) and 6 (cell 4, 7), which has three steps.
    """

    def plan(max_nodes: int, **options: Any) -> tuple[list[int], float, int]:
        search = partial(best_first_search, before_a_pit, num_actions=2, depth=3, max_nodes=max_nodes, **options)
        result = jax.jit(search)(jnp.int32(0))
        actions = [int(action) for action in result.actions if action >= 0]
        return actions, float(result.value), int(result.tree.num_nodes)

    whole: dict[str, Any] = {"answer": "sequence"}
    # After two expansions only node 4 is whole, because it has ended.
    assert plan(4, stop_reward=99.0) == ([0, 0], 6.0, 5)
    assert plan(4, stop_reward=99.0, **whole) == ([0, 1], -47.0, 5)
    assert plan(6, stop_reward=99.0, **whole) == ([0, 0, 1], 7.0, 7)
    # Node 3 passes a stop at 5 before it is known what comes after it.
    assert plan(99, stop_reward=5.0) == ([0, 0], 6.0, 5)
    assert plan(99, stop_reward=5.0, **whole) == ([0, 0, 1], 7.0, 7)
    # Nothing is whole yet.
    assert plan(2, stop_reward=99.0, **whole) == ([0], 3.0, 3)


def test_a_number_of_nodes_that_is_known_late_needs_room():
    search = jax.jit(lambda nodes: best_first_search(line, jnp.float32(0), 3, max_nodes=nodes))
    with pytest.raises(TypeError, match="room must say how many nodes there are at most"):
        search(5)


def test_what_has_ended_is_never_expanded():
    result = jax.jit(partial(best_first_search, before_a_pit, num_actions=2, depth=5, max_nodes=999))(jnp.int32(0))
    fallen = np.asarray(result.tree.reward) == -50
    assert fallen.sum() >= 2
    assert np.all(np.asarray(result.tree.expansion)[fallen] == -1)


def test_without_jit_a_python_number_is_a_state_and_results_have_strong_types():
    result = best_first_search(line, 1.5, 3)
    for leaf in jax.tree.leaves(result):
        assert leaf.dtype in (jnp.int32, jnp.float32)
        assert not leaf.weak_type


def test_a_tree_becomes_python_nodes_and_edges():
    result = jax.jit(lambda x: best_first_search(line, x, 3, stop_reward=1.0))(jnp.float32(0))
    nodes = to_nodes(result.tree)
    assert [node.index for node in nodes] == list(range(7))
    assert [node.value for node in nodes] == [0, -1, 0, 1, 0, 1, 2]
    assert [node.expansion for node in nodes] == [0, -1, -1, 1, -1, -1, -1]
    assert nodes[3].children == nodes[4:]
    assert nodes[0].parent is None
    assert (nodes[0].action, nodes[6].action, nodes[6].depth, nodes[6].reward) == (-1, 2, 2, 1)
    assert nodes[6].path() == [nodes[0], nodes[3], nodes[6]]
    assert float(nodes[6].state) == 2
    np.testing.assert_array_equal(edges(result.tree), [[0, 1], [0, 2], [0, 3], [3, 4], [3, 5], [3, 6]])


def test_a_batch_of_trees_is_refused_on_the_host():
    batch_of_trees = jax.vmap(lambda x: best_first_search(line, x, 3, max_nodes=3).tree)(jnp.zeros(2))
    for function in (to_nodes, edges):
        with pytest.raises(ValueError, match=r"tree must be of one search, got a batch of shape \(2,\)"):
            function(batch_of_trees)


@pytest.mark.parametrize(
    ("argument", "value", "error", "message"),
    [
        ("num_actions", 0, ValueError, "num_actions must be an integer from 1 to 2147483647, got 0"),
        ("num_actions", 2.0, TypeError, "num_actions must be an integer from 1 to .*, got 2.0"),
        ("depth", 0, ValueError, "depth must be an integer from 1 to 2147483647, got 0"),
        ("depth", True, TypeError, "depth must be an integer from 1 to .*, got True"),
        ("max_nodes", -3, ValueError, "max_nodes must be an integer from 1 to 2147483647, got -3"),
        ("count", "all", ValueError, "count must be one of 'generated', 'expanded', got 'all'"),
        ("answer", "last", ValueError, "answer must be one of 'any', 'leaf', 'sequence', got 'last'"),
        ("room", 0, ValueError, "room must be an integer from 1 to 2147483647, got 0"),
        ("room", 20, ValueError, "max_nodes must be an integer from 1 to 20, got 300"),
        ("priority", "best", ValueError, "priority must be one of 'cumulative', 'last_reward', got 'best'"),
        ("loop", "for", ValueError, "loop must be one of 'while', 'scan', got 'for'"),
        ("stop_reward", np.nan, ValueError, "stop_reward must be a number in"),
        ("stop_reward", np.zeros(2), TypeError, "stop_reward must be a number, got array"),
        ("stop_reward", "6", TypeError, "stop_reward must be a number, got '6'"),
        ("discount", True, TypeError, "discount must be a number, got True"),
        ("model", None, TypeError, "model must be a function of a state and an action, got None"),
        ("model", lambda s, a: (s, 1.0 if a > 0 else 0.0), TypeError, "model decides in Python .*use jnp.where"),
        ("discount", 1.5, ValueError, r"discount must be a finite number in \[0, 1\], got 1.5"),
        ("discount", -0.1, ValueError, "discount must be a finite number in"),
    ],
)
def test_bad_options_are_refused(argument: str, value: Any, error: type[Exception], message: str):
    options = {"model": line, "num_actions": 3, argument: value}
    with pytest.raises(error, match=message):
        best_first_search(state=jnp.float32(0), **options)


@pytest.mark.parametrize(
    "model",
    [
        lambda state, action: state,
        lambda state, action: (state, jnp.int32(0)),
        lambda state, action: (state, jnp.zeros(1)),
        lambda state, action: (state.astype(jnp.int32), jnp.float32(0)),
        lambda state, action: ((state, state), jnp.float32(0)),
        lambda state, action: (jnp.stack([state, state]), jnp.float32(0)),
        lambda state, action: (state, jnp.float32(0), jnp.int32(0)),
        lambda state, action: (state, jnp.float32(0), jnp.bool_(False), jnp.bool_(False)),
    ],
)
def test_a_model_that_returns_something_else_is_refused(model: Any):
    with pytest.raises(TypeError, match="model must return"):
        best_first_search(model, jnp.float32(0), 3)
