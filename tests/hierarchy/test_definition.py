"""Task hierarchies: which graphs are allowed, what they cover, and the standard one of the Bus."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.envs.bus.env import Bus, BusState
from hrljax.hierarchy.definition import Abstraction, Hierarchy, Subtask
from hrljax.hierarchy.tables import tabulate
from hrljax.solvers import joint_process
from tests.strategies import Problem, ProblemEnvironment, hierarchy_on, problems

MOVES = ("north", "south", "east", "west")
TAXI_ACTIONS = (*MOVES, "pickup", "putdown")


def task(name: str, *children: str) -> Subtask:
    return Subtask(name, children, lambda state: jnp.bool_(False))


def taxi(*navigate_children: str) -> Hierarchy:
    """The task graph of the Taxi domain, with a given list of children for Navigate."""
    return Hierarchy(
        TAXI_ACTIONS,
        [
            task("Root", "Get", "Put"),
            task("Get", "pickup", "Navigate"),
            task("Put", "putdown", "Navigate"),
            task("Navigate", *navigate_children),
        ],
    )


def chain(length: int) -> Hierarchy:
    names = [f"T{i}" for i in range(length)] + ["go"]
    return Hierarchy(["go"], [task(a, b) for a, b in itertools.pairwise(names)])


@pytest.mark.parametrize(
    ("subtasks", "message"),
    [
        ([], "at least one subtask"),
        ([task("Root", "A", "go"), task("A", "go"), task("A", "go")], "name 'A' is used 2 times"),
        ([task("Root", "go"), task("go", "stop")], "name 'go' is used 2 times"),
        ([task("Root", "A"), task("A")], "subtask 'A' has no children"),
        ([task("Root", "A", "go"), task("A", "B")], "subtask 'A' has an unknown child 'B'"),
        ([task("Root", "A", "go", "A"), task("A", "go")], "subtask 'Root' names its child 'A' twice"),
        ([task("Root", "A"), task("A", "go", "A")], "subtask 'A' can invoke itself: Root -> A -> A"),
        (
            [task("Root", "A"), task("A", "go", "B"), task("B", "C"), task("C", "A", "stop")],
            "subtask 'A' can invoke itself: Root -> A -> B -> C -> A",
        ),
        ([task("Root", "go", "A"), task("A", "Root")], "subtask 'Root' can invoke itself: Root -> A -> Root"),
        ([task("Root", "go"), task("A", "stop")], "subtask 'A' cannot be reached from the root 'Root'"),
    ],
    ids=["empty", "twice", "like-an-action", "childless", "unknown", "slot", "direct", "indirect", "root", "orphan"],
)
def test_bad_graphs_are_refused_by_name(subtasks: list[Subtask], message: str):
    with pytest.raises(ValueError, match=message):
        Hierarchy(["go", "stop"], subtasks)


def anywhere(state: object) -> jax.Array:
    return jnp.bool_(False)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Subtask("A", ("go",), None), "subtask 'A': termination must be a function of a state, got None"),
        (lambda: Subtask("A", ("go",), lambda: True), r"subtask 'A': termination must be .*the arguments \(\)"),
        (
            lambda: Subtask("A", ("go",), anywhere, goal=5),
            "subtask 'A': goal must be a function of a state, or None, got 5",
        ),
        (lambda: Subtask("A", "go", anywhere), "subtask 'A': children must be a sequence of names, got 'go'"),
        (lambda: Subtask("A", (0,), anywhere), r"subtask 'A': children must be a sequence of names, got \(0,\)"),
        (lambda: Subtask(5, ("go",), anywhere), "name must be a string such as 'Root', got 5"),
        (
            lambda: Subtask("A", ("go",), anywhere, abstraction=5),
            "subtask 'A': abstraction must be an Abstraction or None",
        ),
        (
            lambda: Subtask("A", ("go",), anywhere, abstraction=Abstraction(None, anywhere)),
            "subtask 'A': abstraction.planning must be a function of a state, got None",
        ),
        (lambda: Hierarchy("go", [task("A", "go")]), "actions must be a sequence of names, got 'go'"),
        (lambda: Hierarchy(4, [task("A", "go")]), "actions must be a sequence of names, got 4"),
        (lambda: Hierarchy(("go",), task("A", "go")), r"subtasks must be a sequence of hrljax.Subtask, got Subtask\("),
        (lambda: Hierarchy(("go",), ["A"]), r"subtasks must be a sequence of hrljax.Subtask, got \['A'\]"),
    ],
)
def test_what_is_of_the_wrong_type_is_refused_by_name(make, message: str):
    with pytest.raises(TypeError, match=message):
        make()


def test_children_may_be_a_list():
    assert Subtask("A", ["go"], anywhere).children == ("go",)  # type: ignore[arg-type]


def test_actions_have_names_of_their_own():
    with pytest.raises(ValueError, match="name 'go' is used 2 times"):
        Hierarchy(["go", "go"], [task("Root", "go")])


def test_subtasks_are_found_by_name_and_position():
    graph = taxi(*MOVES)
    assert graph.root is graph["Root"] is graph.subtasks[0]
    assert [graph.index(t.name) for t in graph.subtasks] == [0, 1, 2, 3]
    assert graph.is_primitive("pickup")
    assert not graph.is_primitive("Navigate")
    assert graph.actions == TAXI_ACTIONS
    assert repr(graph).startswith("Hierarchy(Root -> Get, Put; Get -> pickup, Navigate;")
    with pytest.raises(KeyError, match="Nowhere"):
        graph["Nowhere"]


def test_depth_is_the_longest_path():
    assert [chain(n).depth for n in (1, 2, 5)] == [1, 2, 5]
    assert taxi(*MOVES).depth == 3
    lopsided = Hierarchy(["go"], [task("Root", "go", "A"), task("A", "B"), task("B", "go")])
    assert lopsided.depth == 3


def test_the_leaf_cover_of_taxi_is_not_total():
    graph = taxi(*MOVES)
    assert graph.leaf_cover() == ("Get", "Put", "Navigate")
    assert graph.reachable_actions("Navigate") == set(MOVES)
    assert graph.reachable_actions("Get") == {*MOVES, "pickup"}
    assert graph.reachable_actions("Root") == set(TAXI_ACTIONS)
    assert not graph.is_total_leaf_cover()


def test_the_leaf_cover_of_taxi_is_total_once_navigate_may_pick_up_and_put_down():
    graph = taxi(*MOVES, "pickup", "putdown")
    assert graph.leaf_cover() == ("Get", "Put", "Navigate")
    assert graph.is_total_leaf_cover()
    assert not taxi(*MOVES, "pickup").is_total_leaf_cover()


def test_a_total_leaf_cover_holds_every_leaf_and_may_hold_more():
    graph = taxi(*MOVES, "pickup", "putdown")
    assert graph.is_total_leaf_cover(["Root", "Get", "Put", "Navigate"])
    assert not graph.is_total_leaf_cover(["Get", "Put"])
    assert not graph.is_total_leaf_cover(["Root"])


def test_the_bus_has_a_root_over_one_move_for_each_area(bus: Bus):
    graph = bus.hierarchy()
    moves = tuple(f"Move({i})" for i in range(1, 7))
    assert graph.root.name == "Root"
    assert graph.root.children == moves
    assert all(graph[m].children == bus.action_names for m in moves)
    assert graph.depth == 2
    assert graph.leaf_cover() == moves
    assert graph.is_total_leaf_cover()
    assert bus.hierarchy() is graph


def test_a_move_of_the_bus_is_active_next_to_its_area_and_its_goal_is_the_area(bus: Bus):
    graph = bus.hierarchy()
    states = jax.vmap(bus.decode)(jnp.arange(bus.num_states, dtype=jnp.int32))
    row, column = np.divmod(np.asarray(states.cell), 6)
    area = 1 + 2 * (row // 2) + column // 3
    doors = {(1, 2), (1, 3), (3, 4), (3, 5), (2, 4), (4, 6), (5, 6)}
    for target in range(1, 7):
        move = graph[f"Move({target})"]
        near = [i for pair in doors if target in pair for i in pair if i != target]
        ended = jax.jit(jax.vmap(move.termination))(states)
        assert ended.dtype == jnp.bool_
        np.testing.assert_array_equal(~np.asarray(ended), np.isin(area, near))
        np.testing.assert_array_equal(jax.jit(jax.vmap(move.goal))(states), area == target)
    assert not jnp.any(jax.vmap(graph.root.termination)(states))


def test_the_root_of_the_bus_splits_the_state_into_where_and_how(bus: Bus):
    """Planning part: cell and passengers; environment part: damage and roads. Together, the state."""
    parts = bus.hierarchy().root.abstraction
    assert parts is not None

    def numbers(state: BusState) -> tuple[jax.Array, jax.Array]:
        return parts.planning(state), parts.environment(state)

    states = jax.vmap(bus.decode)(jnp.arange(bus.num_states, dtype=jnp.int32))
    planning, environment = map(np.asarray, jax.vmap(numbers)(states))
    assert planning.dtype == environment.dtype == np.int32
    assert set(planning) == set(range(288))
    assert set(environment) == set(range(8))
    assert len(set(zip(planning.tolist(), environment.tolist(), strict=True))) == bus.num_states
    np.testing.assert_array_equal(environment, np.asarray(states.damaged * 4 + states.road))


# Generated hierarchies: any valid one is accepted, and whatever is wrong with one subtask is told by its name


def subtasks_of(problem: Problem) -> dict[str, Subtask]:
    return {t.name: t for t in problem.hierarchy.subtasks}


def with_child(tasks: dict[str, Subtask], name: str, child: str) -> list[Subtask]:
    return [Subtask(t.name, (*t.children, child), t.termination) if t.name == name else t for t in tasks.values()]


def path_between(hierarchy: Hierarchy, start: str, end: str) -> bool:
    return start == end or any(
        path_between(hierarchy, child, end) for child in hierarchy[start].children if not hierarchy.is_primitive(child)
    )


GENERATED = {"deadline": None, "max_examples": 40}
any_problem = problems(levels=(2, 3, 4), max_states=6)


@given(problem=any_problem)
@settings(**GENERATED)
def test_a_valid_hierarchy_has_the_depth_cover_and_tables_of_its_parts(problem: Problem):
    hierarchy = problem.hierarchy
    assert hierarchy.depth == hierarchy.height("Root")
    for task in hierarchy.subtasks:
        assert hierarchy.height(task.name) == 1 + max(map(hierarchy.height, task.children))
        assert (task.name in hierarchy.leaf_cover()) == bool(set(task.children) & set(hierarchy.actions))
    tables = tabulate(hierarchy, ProblemEnvironment(problem))
    np.testing.assert_array_equal(tables.active, problem.active)
    np.testing.assert_array_equal(tables.goal, problem.goal)


@given(problem=any_problem, data=st.data())
@settings(**GENERATED)
def test_a_generated_cycle_is_refused_with_the_subtask_on_it(problem: Problem, data: st.DataObject):
    tasks, hierarchy = subtasks_of(problem), problem.hierarchy
    lower = data.draw(st.sampled_from(list(tasks)))
    upper = data.draw(st.sampled_from([name for name in tasks if path_between(hierarchy, name, lower)]))
    with pytest.raises(ValueError, match=r"subtask '(.+)' can invoke itself: Root -> .*\1$|Root -> Root") as caught:
        Hierarchy(hierarchy.actions, with_child(tasks, lower, upper))
    looped = str(caught.value).split(": ")[1].split(" -> ")
    assert {upper, lower} <= set(looped[looped.index(looped[-1]) :])


@given(problem=any_problem, data=st.data())
@settings(**GENERATED)
def test_a_generated_orphan_is_refused_by_name(problem: Problem, data: st.DataObject):
    tasks = list(problem.hierarchy.subtasks)
    child = data.draw(st.sampled_from([*problem.hierarchy.actions, *(t.name for t in tasks[1:])]))
    at = data.draw(st.integers(1, len(tasks)))
    with pytest.raises(ValueError, match="subtask 'Orphan' cannot be reached from the root 'Root'"):
        Hierarchy(problem.hierarchy.actions, [*tasks[:at], task("Orphan", child), *tasks[at:]])


@given(problem=any_problem, data=st.data())
@settings(**GENERATED)
def test_generated_bad_children_are_refused_by_name(problem: Problem, data: st.DataObject):
    tasks = subtasks_of(problem)
    name = data.draw(st.sampled_from(list(tasks)))
    again = data.draw(st.sampled_from(tasks[name].children))
    for child, message in ((again, f"names its child '{again}' twice"), ("Nowhere", "has an unknown child 'Nowhere'")):
        with pytest.raises(ValueError, match=f"subtask '{name}' {message}"):
            Hierarchy(problem.hierarchy.actions, with_child(tasks, name, child))


@given(problem=problems(levels=(2, 3), max_states=6), data=st.data())
@settings(deadline=None, max_examples=12)
def test_a_subtask_that_is_terminated_everywhere_is_refused_by_name(problem: Problem, data: st.DataObject):
    tasks = subtasks_of(problem)
    caller = data.draw(st.sampled_from(list(tasks)))
    action = data.draw(st.sampled_from(problem.hierarchy.actions))
    idle = Subtask("Idle", (action,), lambda state: jnp.bool_(True))
    tasks = Hierarchy(problem.hierarchy.actions, [*with_child(tasks, caller, "Idle"), idle])
    active = np.vstack([problem.active, np.zeros((1, problem.active.shape[1]), np.bool_)])
    broken = problem._replace(hierarchy=tasks, active=active)
    with pytest.raises(ValueError, match="subtask 'Idle' is terminated in every state"):
        tabulate(tasks, ProblemEnvironment(broken))
    with pytest.raises(ValueError, match="subtask 'Idle' is terminated in every state"):
        joint_process(tasks, active, broken.model)


@given(problem=problems(levels=(2, 3), max_states=6), data=st.data())
@settings(deadline=None, max_examples=12)
def test_a_subtask_without_an_applicable_child_is_refused_by_name_and_state(problem: Problem, data: st.DataObject):
    """Below a new root, Stuck goes on in a state in which nothing that it calls can be invoked."""
    hierarchy, size = problem.hierarchy, problem.active.shape[1]
    called = data.draw(st.sampled_from([t.name for t in hierarchy.subtasks[1:]]))
    state = data.draw(st.integers(0, size - 1))
    active = np.vstack([np.ones((2, size), np.bool_), problem.active[1:]])
    active[1 + hierarchy.index(called), state] = False
    if not active[1 + hierarchy.index(called)].any():
        return
    children = {"Top": ("Stuck", *hierarchy.root.children), "Stuck": (called,)}
    children |= {t.name: t.children for t in hierarchy.subtasks[1:]}
    tasks = hierarchy_on(hierarchy.actions, children, active, 0 * active)
    broken = problem._replace(hierarchy=tasks, active=active, goal=0 * active)
    with pytest.raises(ValueError, match=r"subtask 'Stuck' has no child to invoke in [0-9]+ states, for example"):
        tabulate(tasks, ProblemEnvironment(broken))
    with pytest.raises(ValueError, match=r"subtask 'Stuck' \(called by Top\) in state [0-9]+ has no child to invoke"):
        joint_process(tasks, active, broken.model)
