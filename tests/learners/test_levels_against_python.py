"""Learners over hierarchies of several levels against plain Python: equal numbers, not close ones."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.hierarchy import Hierarchy, Subtask
from tests.learners.python_levels import Decomposed, Graph, Machines, PythonEnv, train_in_python
from tests.words import KEY

EPISODES = 50

TAXI = hrljax.make("Taxi", stochastic=True, rules="gymnasium")
GRID = hrljax.make("Gridworld", map="S....P\n.S.#..\n..S...\nP....G\n")
"""Small, with slips, a goal and two pits."""


def grid_tasks() -> Graph:
    """Chains of one to four subtasks; Shared has three parents and one of them calls it on two levels."""
    row, column = np.divmod(np.arange(24), 6)
    north, east, south, west = range(4)
    children = {
        "Root": ["Outer", north, "Shared"],
        "Outer": ["Inner", "Shared", east],
        "Inner": ["Shared", south],
        "Shared": [west, east, north, south],
    }
    active = {
        "Root": row >= 0,
        "Outer": column < 4,
        "Inner": (row < 3) & (column < 5),
        "Shared": column % 3 != 2,
    }
    goal = {"Outer": column >= 4, "Inner": row == 3, "Shared": (column % 3 == 2) & (row >= 1), "Root": row < 0}
    return Graph(children, active, goal)


def grid_hierarchy() -> Hierarchy:
    graph = grid_tasks()

    def at(cells: np.ndarray) -> Callable[[Any], jax.Array]:
        return lambda state: jnp.asarray(cells)[state.cell]

    subtasks = []
    for name, children in graph.children.items():
        names = tuple(child if isinstance(child, str) else GRID.action_names[child] for child in children)
        subtasks.append(Subtask(name, names, at(~graph.active[name]), at(graph.goal[name])))
    return Hierarchy(GRID.action_names, subtasks)


def taxi_tasks() -> Graph:
    number = np.arange(500)
    row, column, passenger, destination = number // 100, number // 20 % 5, number // 4 % 5, number % 4
    moves, pickup, putdown = [0, 1, 2, 3], 4, 5
    depots = {"R": (0, 0), "G": (0, 4), "Y": (4, 0), "B": (4, 3)}
    at = {f"Navigate({name})": (row == r) & (column == c) for name, (r, c) in depots.items()}
    aboard = passenger == 4
    return Graph(
        children={"Root": ["Get", "Put"], "Get": [pickup, *at], "Put": [putdown, *at], **dict.fromkeys(at, moves)},
        active={"Root": number >= 0, "Get": ~aboard, "Put": aboard, **{name: ~there for name, there in at.items()}},
        goal={"Root": number < 0, "Get": aboard, "Put": passenger == destination, **at},
    )


@dataclass
class Domain:
    env: Any
    params: Any
    hierarchy: Hierarchy
    tasks: Graph


DOMAINS = {
    "taxi": Domain(TAXI, TAXI.default_params._replace(max_steps=150), TAXI.hierarchy(), taxi_tasks()),
    "grid": Domain(
        GRID, GRID.default_params._replace(slip_probability=0.4, max_steps=12), grid_hierarchy(), grid_tasks()
    ),
}
NUMBERS = {"step_size": 0.3, "epsilon": 0.5, "discount": 0.93, "initial_value": 1.5}
MAKERS = {
    "HORDQ": lambda hierarchy: hrljax.HORDQ(hierarchy, pseudo_reward=4.0, **NUMBERS),
    "HORDQ under a random root": lambda hierarchy: hrljax.HORDQ(
        hierarchy, hrljax.RandomRoot(), pseudo_reward=4.0, **NUMBERS
    ),
    "HORDQ on policy": lambda hierarchy: hrljax.HORDQ(
        hierarchy, pseudo_reward=4.0, bootstrap="on_policy", **NUMBERS
    ),
    "MAXQ": lambda hierarchy: hrljax.MAXQ(hierarchy, pseudo_reward=7.0, **NUMBERS),
    "MAXQ0": lambda hierarchy: hrljax.MAXQ0(hierarchy, **NUMBERS),
    "HAMQ": lambda hierarchy: hrljax.HAMQ(hierarchy, **NUMBERS),
}
CASES = [(domain, name) for domain in DOMAINS for name in MAKERS if (domain, name) != ("grid", "HORDQ under a random root")]


@cache
def outcomes(domain: str) -> PythonEnv:
    return PythonEnv(DOMAINS[domain].env, DOMAINS[domain].params)


@pytest.mark.parametrize(("domain", "name"), CASES)
def test_a_run_gives_the_numbers_of_plain_python(domain: str, name: str):
    where = DOMAINS[domain]
    learner = MAKERS[name](where.hierarchy)
    run = jax.jit(lambda key: hrljax.train(where.env, learner, key, EPISODES, params=where.params))(KEY)
    program = Machines if name == "HAMQ" else Decomposed
    python, steps, truncated = train_in_python(program, learner, where.tasks, outcomes(domain), EPISODES)
    assert int(run.steps) == steps
    assert 0 < truncated < EPISODES
    depths = {1, 2, 3, 4} if domain == "grid" else {2, 3} if learner.root is None else {1, 2}
    assert set(python.steps_by_depth) == depths  # learning subtasks on the stack
    python.compare(run.learned)
