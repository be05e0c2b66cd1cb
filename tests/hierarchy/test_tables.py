"""Predicates of subtasks at every state: what they may return, and what is said of the others."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax import Abstraction, Hierarchy, Subtask
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.roots.decision_points import planning_points

MAZE = hrljax.make("Maze")
AT_GOAL = MAZE.hierarchy().root.termination


def with_go(termination: Any, goal: Any = None, abstraction: Abstraction | None = None) -> Hierarchy:
    root = Subtask("Root", ("Go",), AT_GOAL, abstraction=abstraction)
    return Hierarchy(MAZE.action_names, [root, Subtask("Go", MAZE.action_names, termination, goal)])


@pytest.mark.parametrize(
    ("predicate", "what"),
    [
        (lambda s: None, "not None"),
        (lambda s: jnp.zeros(3, bool), r"not bool\[3\]"),
        (lambda s: jnp.zeros(1, bool), r"not bool\[1\]"),
        (lambda s: "x", "not 'x'"),
        (lambda s: (True,), r"not \(True,\)"),
    ],
)
@pytest.mark.parametrize("of", ["termination", "goal"])
def test_a_predicate_returns_one_value(of: str, predicate: Any, what: str):
    hierarchy = with_go(predicate) if of == "termination" else with_go(AT_GOAL, predicate)
    with pytest.raises(TypeError, match=f"subtask 'Go': {of} must return one bool.* for a state, {what}"):
        tabulate(hierarchy, MAZE)


def test_a_termination_is_no_number():
    """The bits of an integer are not those of a flag: ``~1`` is true as well."""
    with pytest.raises(TypeError, match=r"subtask 'Go': termination must return one bool for a state, not int32\[\]"):
        tabulate(with_go(lambda s: AT_GOAL(s).astype(jnp.int32)), MAZE)


def test_a_goal_is_a_flag_or_a_number():
    flag = tabulate(with_go(AT_GOAL, AT_GOAL), MAZE).goal[1]
    number = tabulate(with_go(AT_GOAL, lambda s: 2 * AT_GOAL(s).astype(jnp.int32)), MAZE).goal[1]
    np.testing.assert_array_equal(number, 2 * flag)
    assert flag.sum() == 1
    np.testing.assert_array_equal(tabulate(with_go(AT_GOAL, lambda s: True), MAZE).goal[1], 1)
    with pytest.raises(
        ValueError, match=r"subtask 'Go': goal must return finite .*, got nan in state 0, CellState\(cell=0, "
    ):
        tabulate(with_go(AT_GOAL, lambda s: jnp.where(s.cell < 1, jnp.float32(jnp.nan), jnp.float32(0))), MAZE)


@pytest.mark.parametrize(
    "predicate",
    [lambda s: s.time == 0 if s.cell == 3 else s.time > 0, lambda s: s.cell == 3 and s.time == 0, lambda s: not s.cell],
)
def test_a_decision_in_python_is_told_what_to_write(predicate: Any):
    message = (
        r"subtask 'Go': termination decides in Python .*: use jnp.where in place of if, and &, \| and ~ in place of and"
    )
    with pytest.raises(TypeError, match=message) as refused:
        tabulate(with_go(predicate), MAZE)
    assert "Tracer" not in str(refused.value)


def test_a_part_of_the_state_is_an_integer():
    for part, what in ((lambda s: None, "None"), (lambda s: s.cell.astype(jnp.float32), r"float32\[\]")):
        abstraction = Abstraction(lambda s: s.cell, part)
        message = f"subtask 'Root': abstraction.environment must return one integer for a state, not {what}"
        with pytest.raises(TypeError, match=message):
            planning_points(with_go(AT_GOAL, None, abstraction), MAZE)


def test_other_arguments_are_refused():
    with pytest.raises(TypeError, match=r"hierarchy must be a Hierarchy such as env.hierarchy\(\), got None"):
        tabulate(None, MAZE)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"env must be a tabular environment such as hrljax.make\('Bus'\), got 'Maze'"):
        tabulate(MAZE.hierarchy(), "Maze")  # type: ignore[arg-type]


def test_a_state_without_a_child_is_told_by_its_numbers():
    """Also where a learner is prepared while JAX traces."""
    hierarchy = with_go(lambda s: s.cell != 3)
    with pytest.raises(
        ValueError, match=r"subtask 'Root' has no child .* for example in state 0, CellState\(cell=0, time=0\)"
    ):
        hrljax.sweep(MAZE, hrljax.HORDQ(hierarchy), seeds=1, num_episodes=1, progress=False)
