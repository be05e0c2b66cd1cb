"""Leaf covers: what is added to make them total, and where Theorem 2's condition does not hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.hierarchy.leaf_cover import Inaccessible, accessible, inaccessible, total_leaf_cover
from hrljax.hierarchy.tables import tabulate
from tests.strategies import hierarchy_on

NAVIGATE = tuple(f"Navigate({depot})" for depot in "RGYB")


def graph(actions: str, **children: str) -> Hierarchy:
    tasks = {name: tuple(names.split()) for name, names in children.items()}
    active = np.ones((len(tasks), 1), np.bool_)
    return hierarchy_on(tuple(actions.split()), tasks, active, ~active)


def test_taxi_lets_navigate_pick_up_and_put_down():
    """As in the thesis, 3.1: then Get and Put can do everything through Navigate."""
    before = Taxi().hierarchy()
    total = total_leaf_cover(before)
    assert total.cover == ("Get", "Put", *NAVIGATE)
    assert total.added == dict.fromkeys(NAVIGATE, ("pickup", "putdown"))
    assert not before.is_total_leaf_cover()
    assert total.hierarchy.is_total_leaf_cover()
    for name in NAVIGATE:
        assert total.hierarchy[name].children == (*before[name].children, "pickup", "putdown")
        assert total.hierarchy[name].termination is before[name].termination
    assert total.hierarchy["Get"] is before["Get"]


@pytest.mark.parametrize("env", [Bus(), Maze()], ids=["Bus", "Maze"])
def test_what_is_total_stays_as_it_is(env):
    before = env.hierarchy()
    total = total_leaf_cover(before)
    assert total.added == {}
    assert total.hierarchy is before
    assert inaccessible(before, tabulate(before, env).active) == ()


def test_theorem_3_asks_for_every_action_as_a_child():
    total = total_leaf_cover(Taxi().hierarchy(), direct=True)
    moves = Taxi.action_names[:4]
    assert total.added["Get"] == (*moves, "putdown")
    assert total.added["Put"] == (*moves, "pickup")
    assert all(set(Taxi.action_names) <= set(total.hierarchy[name].children) for name in total.cover)


def test_a_larger_cover_is_completed_too():
    """Above A and B, C has no primitive child of its own and is in no smallest cover."""
    tasks = graph("x y", Root="C A", C="B", A="x", B="y")
    assert total_leaf_cover(tasks).added == {"A": ("y",), "B": ("x",)}
    total = total_leaf_cover(tasks, ["Root", "C", "A", "B"])
    assert total.cover == ("Root", "C", "A", "B")
    assert total.added == {"A": ("y",), "B": ("x",)}
    assert total.hierarchy.is_total_leaf_cover(["Root", "C", "A", "B"])


def test_actions_are_added_at_the_bottom_and_in_their_order():
    tasks = graph("x y z", Root="A", A="y B", B="C z", C="y")
    assert total_leaf_cover(tasks).added == {"C": ("x", "z")}


def test_bad_covers_are_refused_by_name():
    tasks = graph("x", Root="A", A="x")
    with pytest.raises(ValueError, match="cover names 'B', which is no subtask; subtasks are Root, A"):
        total_leaf_cover(tasks, ["A", "B"])
    with pytest.raises(ValueError, match="every subtask with a primitive child: 'A' is missing"):
        inaccessible(tasks, np.ones((2, 1), np.bool_), ["Root"])
    with pytest.raises(ValueError, match=r"active must be bools of shape \(2, any\), got shape \(3, 1\)"):
        accessible(tasks, np.ones((3, 1), np.bool_))
    with pytest.raises(TypeError, match=r"active must be bools of shape \(2, any\), got float64"):
        inaccessible(tasks, np.ones((2, 1)))
    with pytest.raises(TypeError, match="cover must be a sequence of names, got 'Root'"):
        total_leaf_cover(tasks, "Root")
    with pytest.raises(TypeError, match=r"hierarchy must be a Hierarchy such as env.hierarchy\(\), got 'x'"):
        total_leaf_cover("x")  # type: ignore[arg-type]


# Access in every active state


def example() -> tuple[Hierarchy, np.ndarray]:
    """Middle does x itself and y through Leaf, which is inactive in state 2 (of four)."""
    active = np.array([[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 1]], np.bool_)
    tasks = hierarchy_on(
        ("x", "y"), {"Root": ("Middle", "Leaf"), "Middle": ("x", "Leaf"), "Leaf": ("y",)}, active, active
    )
    return tasks, active


def test_access_by_state_by_hand():
    tasks, active = example()
    can = accessible(tasks, active)
    np.testing.assert_array_equal(can[2, :, 0], [0, 0, 0, 0])
    np.testing.assert_array_equal(can[2, :, 1], [1, 1, 0, 1])
    np.testing.assert_array_equal(can[1, :, 0], [1, 1, 1, 0])
    np.testing.assert_array_equal(can[1, :, 1], [1, 1, 0, 0])
    np.testing.assert_array_equal(can[0], [[1, 1], [1, 1], [1, 0], [0, 1]])
    assert inaccessible(tasks, active) == (Inaccessible("Middle", "y", 2, 1), Inaccessible("Leaf", "x", 0, 3))


def test_a_report_reads_as_a_sentence():
    tasks, active = example()
    assert str(inaccessible(tasks, active)[0]) == (
        "subtask 'Middle' cannot execute 'y' in 1 of its active states, for example in state 2"
    )


def test_an_action_behind_a_child_that_is_inactive_is_added_if_states_are_known():
    tasks, active = example()
    by_name = total_leaf_cover(tasks)
    assert by_name.added == {"Leaf": ("x",)}
    assert by_name.hierarchy.is_total_leaf_cover()
    assert [str(gap)[:37] for gap in inaccessible(by_name.hierarchy, active)] == [
        "subtask 'Middle' cannot execute 'y' i"
    ]
    by_state = total_leaf_cover(tasks, active=active)
    assert by_state.added == {"Middle": ("y",), "Leaf": ("x",)}
    assert inaccessible(by_state.hierarchy, active) == ()


@st.composite
def graphs(draw: st.DrawFn) -> tuple[Hierarchy, np.ndarray]:
    """Any task graph with any active states: tasks call later ones, every one is called by the one before."""
    actions = [f"a{i}" for i in range(draw(st.integers(1, 4)))]
    names = [f"T{i}" for i in range(draw(st.integers(1, 5)))]
    children = {}
    for i, name in enumerate(names):
        later = names[i + 1 :]
        called = draw(st.lists(st.sampled_from(actions + later), min_size=1, unique=True))
        children[name] = tuple(called if not later or later[0] in called else [later[0], *called])
    active = draw(st.lists(st.lists(st.booleans(), min_size=6, max_size=6), min_size=len(names), max_size=len(names)))
    table = np.array(active, np.bool_)
    return hierarchy_on(tuple(actions), children, table, ~table), table


@given(problem=graphs(), with_states=st.booleans(), direct=st.booleans())
@settings(deadline=None, max_examples=80)
def test_a_completed_cover_is_total_keeps_its_children_and_needs_nothing_more(problem, with_states: bool, direct: bool):
    before, active = problem
    total = total_leaf_cover(before, active=active if with_states else None, direct=direct)
    assert total.hierarchy.is_total_leaf_cover()
    assert total.hierarchy.leaf_cover() == before.leaf_cover() == total.cover
    for old, new in zip(before.subtasks, total.hierarchy.subtasks, strict=True):
        assert new.children == old.children + total.added.get(old.name, ())
        assert (new.name, new.termination, new.goal) == (old.name, old.termination, old.goal)
    assert total_leaf_cover(total.hierarchy, active=active if with_states else None, direct=direct).added == {}
    if with_states or direct:
        assert inaccessible(total.hierarchy, active) == ()


@given(problem=graphs())
@settings(deadline=None, max_examples=80)
def test_access_is_what_can_be_reached_by_calling_active_children(problem):
    hierarchy, active = problem
    can = accessible(hierarchy, active)

    def reach(name: str, state: int) -> set[str]:
        if hierarchy.is_primitive(name):
            return {name}
        if not active[hierarchy.index(name), state]:
            return set()
        return set().union(*(reach(child, state) for child in hierarchy[name].children))

    for number, task in enumerate(hierarchy.subtasks):
        for state in range(active.shape[1]):
            actual = {a for a, yes in zip(hierarchy.actions, can[number, state], strict=True) if yes}
            assert actual == reach(task.name, state)


def test_added_actions_do_not_change_what_a_hierarchy_is_made_of():
    tasks = Hierarchy(["x", "y"], [Subtask("Root", ("A",), bool), Subtask("A", ("x",), bool, goal=bool)])
    assert total_leaf_cover(tasks).hierarchy["A"] == Subtask("A", ("x", "y"), bool, goal=bool)
