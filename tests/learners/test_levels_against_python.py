"""Learners over hierarchies of several levels against plain Python: equal numbers, not close ones."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import hrljax
from hrljax.engine.evaluate import greedy_return
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.learners.hyperparameters import with_tabulated_schedules
from tests.learners.python_levels import Decomposed, Graph, Machines, PythonEnv, Walk, train_in_python
from tests.learners.python_shared import Shared
from tests.words import KEY

EPISODES = 40

TAXI = hrljax.make("Taxi", stochastic=True, rules="dietterich")
GRID = hrljax.make("Gridworld", map="S....P\n.S.#..\n..S...\nP....G\n")
"""Small, with slips, a goal and two pits."""


def grid_tasks(root_children: list[Any]) -> Graph:
    """Chains of one to four subtasks; Shared has three parents, and cannot be invoked everywhere."""
    row, column = np.divmod(np.arange(24), 6)
    north, east, south, west = range(4)
    children = {
        "Root": root_children,
        "Outer": ["Inner", "Shared", east],
        "Inner": ["Shared", south],
        "Shared": [west, east, north, south],
    }
    active = {
        "Root": row >= 0,
        "Outer": column < 4,
        "Inner": (row < 3) & (column < 5),
        "Shared": (column % 3 != 2) | (column == 5),
    }
    goal = {"Outer": column >= 4, "Inner": row == 3, "Shared": (column % 3 == 2) & (row >= 1), "Root": row < 0}
    return Graph(children, active, goal)


def grid_hierarchy(graph: Graph) -> Hierarchy:
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
        active={"Root": number >= 0, "Get": ~aboard, "Put": aboard, **{name: ~place for name, place in at.items()}},
        goal={"Root": number < 0, "Get": aboard, "Put": passenger == destination, **at},
    )


class Domain(NamedTuple):
    env: Any
    params: Any
    hierarchy: Hierarchy
    tasks: Graph
    depths: set[int]  # how many learning subtasks can be on the stack


def grid_domain(root_children: list[Any], depths: set[int]) -> Domain:
    tasks = grid_tasks(root_children)
    params = GRID.default_params._replace(slip_probability=0.4, max_steps=12)
    return Domain(GRID, params, grid_hierarchy(tasks), tasks, depths)


DOMAINS = {
    "taxi": Domain(TAXI, TAXI.default_params._replace(max_steps=150), TAXI.hierarchy(), taxi_tasks(), {2, 3}),
    "grid": grid_domain(["Outer", 0, "Shared"], {1, 2, 3, 4}),
    "grid under a random root": grid_domain(["Outer", "Inner", "Shared"], {1, 2, 3}),
}


def completed(domain: str) -> Domain:
    """With every action in every active state of the leaf cover."""
    where = DOMAINS[domain]
    active = hrljax.tabulate(where.hierarchy, where.env).active
    hierarchy = hrljax.total_leaf_cover(where.hierarchy, active=active).hierarchy
    numbers = {name: number for number, name in enumerate(where.env.action_names)}
    children = {task.name: [numbers.get(child, child) for child in task.children] for task in hierarchy.subtasks}
    return where._replace(hierarchy=hierarchy, tasks=where.tasks._replace(children=children))


def of_graph(graph: Graph, depths: set[int]) -> Domain:
    params = GRID.default_params._replace(slip_probability=0.4, max_steps=12)
    return Domain(GRID, params, grid_hierarchy(graph), graph, depths)


EVERYWHERE, EVEN = np.ones(24, np.bool_), np.arange(24) % 2 == 0
DOMAINS["flat"] = of_graph(Graph({"Root": [0, 1, 2, 3]}, {"Root": EVERYWHERE}, {"Root": ~EVERYWHERE}), {1})
DOMAINS["child first"] = of_graph(
    Graph(
        {"Root": ["Outer", 0, 1, 2, 3], "Outer": ["Inner", 1], "Inner": [0, 1, 2, 3]},
        {"Root": EVERYWHERE, "Outer": EVEN, "Inner": EVEN},
        {"Root": ~EVERYWHERE, "Outer": ~EVEN, "Inner": ~EVEN},
    ),
    {1, 2, 3},
)
"""Outer has one action itself, the others through Inner, which is in its first slot and often ends after one step."""
DOMAINS["halves"] = of_graph(
    Graph(
        {"Root": ["Even", "Odd"], "Even": [0, 1, 2, 3], "Odd": [0, 1, 2, 3]},
        {"Root": EVERYWHERE, "Even": EVEN, "Odd": ~EVEN},
        {"Root": ~EVERYWHERE, "Even": ~EVEN, "Odd": EVEN},
    ),
    {1},
)
"""One level of subtasks; a step into a wall teaches of the state in which the next is chosen."""
DOMAINS |= {f"completed {name}": completed(name) for name in DOMAINS}
NUMBERS = {"step_size": 0.5, "epsilon": 0.5, "discount": 0.93, "initial_value": -10.0}


def hordq(domain: str, **options: Any) -> hrljax.HORDQ:
    return hrljax.HORDQ(DOMAINS[domain].hierarchy, pseudo_reward=4.0, **options, **NUMBERS)


def shared(domain: str, **options: Any) -> hrljax.SharedHORDQ:
    return hrljax.SharedHORDQ(DOMAINS[domain].hierarchy, **options, **NUMBERS)


FADING = hrljax.Fading(worth=30.0, after=7.0)
CASES = {
    "HORDQ, taxi": hordq("taxi"),
    "HORDQ, grid": hordq("grid"),
    "HORDQ, grid under a random root": hordq("grid under a random root", root=hrljax.RandomRoot()),
    "HORDQ, halves": hordq("halves", root=hrljax.RandomRoot()),
    "HORDQ on policy, grid": hordq("grid", bootstrap="on_policy"),
    "HORDQ with random ties, grid": hordq("grid", ties="random"),
    "HORDQ with random ties, flat": hordq("flat", ties="random"),
    "MAXQ, taxi": hrljax.MAXQ(DOMAINS["taxi"].hierarchy, pseudo_reward=7.0, **NUMBERS),
    "MAXQ0, grid": hrljax.MAXQ0(DOMAINS["grid"].hierarchy, **NUMBERS),
    "HORDQ that fades, grid": hrljax.HORDQ(DOMAINS["grid"].hierarchy, pseudo_reward=FADING, **NUMBERS),
    "MAXQ that fades, taxi": hrljax.MAXQ(DOMAINS["taxi"].hierarchy, pseudo_reward=FADING, **NUMBERS),
    "shared, completed taxi": shared("completed taxi"),
    "shared that fades, completed grid": shared("completed grid", pseudo_reward=FADING, taught="active"),
    "shared, completed grid": shared("completed grid", pseudo_reward=4.0),
    "shared, flat": shared("flat", taught="active"),
    "shared, child first": shared("child first", pseudo_reward=4.0, taught="active"),
    "shared with random ties, completed grid": shared("completed grid", ties="random"),
    "shared on policy, completed grid": shared("completed grid", bootstrap="on_policy", taught="active"),
    "shared, completed grid under a random root": shared(
        "completed grid under a random root",
        root=hrljax.RandomRoot(),
        pseudo_reward=optax.linear_schedule(9.0, 1.0, EPISODES),
        bootstrap="on_policy",
    ),
    "HAMQ, taxi": hrljax.HAMQ(DOMAINS["taxi"].hierarchy, **NUMBERS),
    "HAMQ, grid": hrljax.HAMQ(DOMAINS["grid"].hierarchy, **NUMBERS),
}


@cache
def outcomes(domain: str) -> PythonEnv:
    return PythonEnv(DOMAINS[domain].env, DOMAINS[domain].params)


@cache
def both(name: str) -> tuple[hrljax.Run, Walk]:
    """A run, and what the plain program went through in the same run."""
    learner, domain = CASES[name], name.split(", ")[1]
    where = DOMAINS[domain]
    run = jax.jit(lambda key: hrljax.train(where.env, learner, key, EPISODES, params=where.params))(KEY)
    if isinstance(learner, hrljax.SharedHORDQ):
        program: Any = Shared(learner, where.tasks, where.env.num_actions)
    else:
        program = (Machines if isinstance(learner, hrljax.HAMQ) else Decomposed)(learner, where.tasks)
    return run, train_in_python(program, outcomes(domain), EPISODES)


QUICK = {"HORDQ, halves"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in CASES]
)
def test_a_run_gives_the_numbers_of_plain_python(name: str):
    run, walk = both(name)
    assert int(run.steps) == walk.steps
    assert 0 < walk.truncated < EPISODES
    assert set(walk.program.steps_by_depth) == DOMAINS[name.split(", ")[1]].depths
    walk.program.compare(run.learned)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "HORDQ, grid under a random root",
        "HAMQ, grid",
        "HORDQ, grid",
        "shared that fades, completed grid",
        "shared, completed grid under a random root",
    ],
)
def test_greedy_behaviour_has_the_value_that_plain_python_finds(name: str):
    learner, domain = with_tabulated_schedules(CASES[name], EPISODES), name.split(", ")[1]
    env, params = DOMAINS[domain].env, DOMAINS[domain].params
    run, walk = both(name)
    actual = greedy_return(learner, env, learner.prepare(env), run.learned, params, np.uint32(0), EPISODES)
    assert actual.dtype == jnp.float32
    assert float(actual) == pytest.approx(walk.program.greedy_return(outcomes(domain)), abs=1e-4)
    assert -90 < float(actual) < -3
