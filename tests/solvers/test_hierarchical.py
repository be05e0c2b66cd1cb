"""Hierarchical solvers: published figures of Maze, Taxi and Bus, and random problems against brute force."""

import itertools
import re
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrljax.engine.evaluate import expected_return
from hrljax.envs.bus.env import Bus
from hrljax.envs.grid.gridworld import Gridworld
from hrljax.envs.grid.maze import Maze
from hrljax.envs.taxi.env import Taxi
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.hierarchy.layout import stack_layout
from hrljax.hierarchy.leaf_cover import total_leaf_cover
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.hierarchy.tables import tabulate
from hrljax.solvers import (
    Model,
    NoBestPolicyError,
    Optima,
    decompose,
    greedy,
    joint_process,
    optimise,
    recursively_optimal,
    solve_hierarchy,
)
from tests.maps import SMALL
from tests.strategies import Problem, hierarchy_on, problems, random_policy, random_problem, random_process

METHODS = ("policy_iteration", "value_iteration")


class Tables(NamedTuple):
    active: np.ndarray
    goal: np.ndarray


def solved(env, hierarchy: Hierarchy | None = None, tables: Tables | None = None, **options) -> Optima:
    graph = hierarchy or env.hierarchy()
    return solve_hierarchy(graph, tables or tabulate(graph, env), env.model(), env.initial_distribution(), **options)


# Dietterich's maze: six columns, seven rows; the left room has four columns


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("ties", "recursive"), [("first", -198 / 28), ("last", -214 / 28)])
def test_the_maze_separates_the_three_criteria(method, ties, recursive: float):
    """Means over the left room: -6.7857, and -7.0714 where ties go north or -7.6429 where they go south."""
    optima = solved(Maze(), method=method, ties=ties)
    np.testing.assert_allclose([optima.optimal.mean, optima.hierarchical.mean], -190 / 28, atol=1e-6)
    assert optima.recursive.mean == pytest.approx(recursive, abs=1e-6)


@pytest.mark.parametrize(("ties", "row_3"), [("first", 0), ("last", 4)])
def test_a_recursively_optimal_exit_of_the_maze_is_wrong_in_the_shaded_row(ties, row_3: float):
    optima = solved(Maze(), ties=ties)
    loss = (optima.optimal.value - optima.recursive.value).reshape(7, 6)
    assert np.isnan(loss[0, 5])  # the root ends at the goal
    np.testing.assert_allclose(loss[:, :4], np.array([[0, 0, 0, row_3, 2, 0, 0]]).T * np.ones(4), atol=1e-9)
    np.testing.assert_allclose(loss[1:, 4:], 0, atol=1e-9)


def test_the_shaded_row_of_the_maze_as_arrows():
    """Figure 2.1 of the thesis: by the nearer door, or (optimally) always by the upper one."""
    optima = solved(Maze())
    north, south, east = range(3)
    left = optima.recursive.action.reshape(7, 6)[:, :4]
    np.testing.assert_array_equal(left[:, 0], [south, east, north, north, south, east, north])
    np.testing.assert_array_equal(left[[1, 5], 3], [east, east])
    assert optima.hierarchical.action.reshape(7, 6)[4, 3] == north
    np.testing.assert_array_equal(optima.hierarchical.action, optima.optimal.action)
    assert optima.optimal.action[5] == -1  # the goal


def test_with_the_exits_worth_as_pseudo_rewards_the_recursive_maze_is_optimal():
    """Dietterich's -2 for the upper door and -6 for the lower one."""
    env = Maze()
    tables = tabulate(env.hierarchy(), env)
    goal = np.zeros(tables.goal.shape)
    goal[1, [1 * 6 + 4, 5 * 6 + 4]] = -2, -6
    assert solved(env, tables=Tables(tables.active, goal), pseudo_reward=1.0).recursive.mean == pytest.approx(
        -190 / 28, abs=1e-6
    )


# Taxi: subtasks that do not know what comes after them lose only where that matters


@pytest.mark.parametrize(
    ("options", "optimal"),
    [
        ({}, 8.555),
        ({"stochastic": True, "rules": "gymnasium"}, 3.955),
    ],
)
def test_the_hierarchy_of_taxi_loses_nothing(options: dict, optimal: float):
    optima = solved(Taxi(**options))
    assert [c.mean for c in optima] == pytest.approx([optimal] * 3, abs=5e-4)


def test_a_fickle_passenger_needs_a_total_leaf_cover():
    """Navigate goes on to where the passenger no longer wants to go; with putdown of its own it need not."""
    env = Taxi(stochastic=True, fickle=True)
    optima = solved(env)
    assert optima.optimal.mean == pytest.approx(5.614, abs=5e-4)
    assert optima.hierarchical.mean == pytest.approx(3.174, abs=5e-4)
    patched = solved(env, total_leaf_cover(env.hierarchy()).hierarchy)
    assert patched.hierarchical.mean == pytest.approx(optima.optimal.mean, abs=1e-9)


def test_taxi_has_a_calling_stack_for_each_caller_of_navigate():
    env = Taxi()
    process = joint_process(env.hierarchy(), tabulate(env.hierarchy(), env).active, env.model())
    assert process.contexts.size == 11
    assert [env.hierarchy().subtasks[t].name for t in process.contexts.task[:3]] == ["Root", "Get", "Put"]
    assert process.contexts.parent[3:].tolist() == [1] * 4 + [2] * 4
    assert "'Navigate(R)' (called by Put < Root) in state" in process.where(int(process.node[7].max()))


# Bus: the leaf cover is total


@pytest.mark.parametrize("method", METHODS)
def test_the_hierarchy_of_the_bus_loses_nothing_if_hierarchically_optimal(bus: Bus, method):
    optima = solved(bus, method=method, pseudo_reward=5.0)
    assert optima.optimal.mean == pytest.approx(-24.59, abs=0.01)
    assert optima.hierarchical.mean == pytest.approx(optima.optimal.mean, abs=1e-7)
    assert optima.recursive.mean < -60  # crosses the sites


def test_a_policy_has_the_value_that_the_learners_evaluation_gives_it():
    generator = np.random.default_rng(0)
    hierarchy, size = SMALL.hierarchy(), SMALL.num_states
    tables = tabulate(hierarchy, SMALL)
    actions = generator.integers(4, size=(4, size)).astype(np.int32)
    choice = tables.active[1:] * generator.exponential(size=(4, size))
    choice /= choice.sum(0)
    params = SMALL.default_params._replace(slip_probability=0.5, max_steps=100_000)
    policy = np.zeros((5, size, 4))
    policy[0] = choice.T
    policy[1:] = np.eye(4)[actions]
    process = joint_process(hierarchy, tables.active, SMALL.model(params))
    value = decompose(process, process.weights(policy)).value[0]
    by_learners = HierarchicalPolicy(
        stack_layout(hierarchy, SMALL, root_learns=False), jnp.asarray(actions), jnp.asarray(choice.T, jnp.float32)
    )
    evaluated = jax.jit(lambda: expected_return(SMALL, by_learners, params, jnp.uint32(0)))()
    assert float(SMALL.initial_distribution() @ value) == pytest.approx(float(evaluated), rel=1e-3)


# Random problems


@given(problem=problems(levels=(2, 3, 4)), kappa=st.sampled_from([0.0, 1.0]), ties=st.sampled_from(["first", "last"]))
@settings(deadline=None, max_examples=25)
def test_both_methods_agree_and_the_criteria_are_ordered(problem: Problem, kappa: float, ties):
    numbers = problem.hierarchy, problem, problem.model, problem.initial
    optima, other = (
        solve_hierarchy(*numbers, discount=problem.discount, pseudo_reward=kappa, ties=ties, method=method)
        for method in METHODS
    )
    for one, two in zip(optima, other, strict=True):
        np.testing.assert_allclose(one.value, two.value, atol=1e-8)
        np.testing.assert_array_equal(one.policy, two.policy)
    np.testing.assert_allclose(optima.optimal.value, problem.optimal_q().max(-1), atol=1e-9)
    np.testing.assert_allclose(optima.hierarchical.value, optima.optimal.value, atol=1e-9)  # a total leaf cover
    assert np.all(optima.recursive.value < optima.hierarchical.value + 1e-9)
    process = joint_process(problem.hierarchy, problem.active, problem.model, discount=problem.discount)
    for criterion in (optima.hierarchical, optima.recursive):
        values = decompose(process, process.weights(criterion.policy, by="stack"))
        np.testing.assert_allclose(values.value[0], criterion.value, atol=1e-9)


def partial_problem(generator: np.random.Generator) -> Problem:
    """Two leaves without some of the actions and one caller each, small enough to try all policies."""
    actions, active = ("a0", "a1", "a2"), np.ones((3, 4), np.bool_)
    active[1], active[2] = [True, True, True, False], [False, True, True, True]
    goal = ~active * generator.integers(0, 3, active.shape)
    children = {"Root": ("Left", "Right"), "Left": ("a0", "a1"), "Right": ("a2", "a1")}
    outcomes, reward = random_process(generator, 4, 3, 0.1)
    hierarchy = hierarchy_on(actions, children, active, goal.astype(np.float32))
    return Problem(hierarchy, active, goal, outcomes, reward, 0.9)


@pytest.mark.parametrize("seed", range(4))
def test_no_policy_of_the_hierarchy_is_better_than_the_hierarchically_optimal_one(seed: int):
    problem = partial_problem(np.random.default_rng(seed))
    optima = solve_hierarchy(problem.hierarchy, problem, problem.model, problem.initial, discount=0.9)
    process = joint_process(problem.hierarchy, problem.active, problem.model, discount=0.9)
    fixed = np.zeros(3, np.bool_)
    best = np.full(4, -np.inf)
    for both, left, right in itertools.product(*(itertools.product((0, 1), repeat=n) for n in (2, 3, 3))):
        policy = np.array([[0, *both, 1], [*left, -1], [-1, *right]])
        value = process.spread_nodes(optimise(process, process.weights(policy), fixed).value)[0]
        best = np.maximum(best, value)
    np.testing.assert_allclose(optima.hierarchical.value, best, atol=1e-9)
    assert np.all(optima.hierarchical.value > optima.recursive.value - 1e-9)


@pytest.mark.parametrize("kappa", [0.0, 2.0])
def test_a_recursively_optimal_subtask_earns_most_until_it_ends(kappa: float):
    """By trying every policy of one leaf, on reward until the leaf's end and pseudo-reward at it."""
    for seed in range(4):
        problem = partial_problem(np.random.default_rng(seed))
        policy = recursively_optimal(problem.hierarchy, problem, problem.model, discount=0.9, pseudo_reward=kappa)
        outcomes, reward = problem.outcomes, problem.reward.astype(np.float64)

        def until_end(choice: np.ndarray) -> np.ndarray:
            """Of Left, whose children are actions 0 and 1 and whose end is state 3."""
            chain, gains = np.zeros((3, 3)), np.zeros(3)
            for state, action in enumerate(choice):
                for after in outcomes[state, action]:  # noqa: B023
                    gains[state] += reward[state, action] / 16  # noqa: B023
                    if after == 3:
                        gains[state] += kappa * problem.goal[1, 3] / 16  # noqa: B023
                    elif after >= 0:
                        chain[state, after] += 0.9 / 16
            return np.linalg.solve(np.eye(3) - chain, gains)

        best = np.max([until_end(np.array(c)) for c in itertools.product((0, 1), repeat=3)], axis=0)
        np.testing.assert_allclose(until_end(policy[1, :3]), best, atol=1e-9)


def test_a_pseudo_reward_stays_out_of_what_callers_see():
    """Dietterich's C~ and C: Leaf prefers the costly way to its goal; Root then avoids Leaf."""
    active = np.array([[1, 1, 1], [1, 0, 0]], np.bool_)
    goal = np.array([[0, 0, 0], [0, 0, 1]], np.float32)
    hierarchy = hierarchy_on(("a", "b"), {"Root": ("Leaf", "b"), "Leaf": ("a", "b")}, active, goal)
    follows = np.array([[[2], [1]], [[0], [0]], [[0], [0]]])
    ended = np.array([[[False], [False]], [[True], [True]], [[True], [True]]])
    model = Model(follows, np.ones(follows.shape), np.array([[[-5.0], [-1]], [[-1], [-1]], [[-1], [-1]]]), ended)
    for kappa, leaf, root, value in ((0.0, 1, 0, -2.0), (3.0, 1, 0, -2.0), (5.0, 0, 1, -2.0)):
        tables = Tables(active, goal)
        policy = recursively_optimal(hierarchy, tables, model, pseudo_reward=kappa)
        assert (policy[1, 0], policy[0, 0]) == (leaf, root)
        optima = solve_hierarchy(hierarchy, tables, model, np.array([1.0, 0, 0]), pseudo_reward=kappa)
        assert optima.recursive.mean == value


@pytest.mark.parametrize(("termination", "by_child"), [("immediate", 1.0), ("on_return", 0.25)])
def test_the_pseudo_reward_is_paid_once_when_the_subtask_ends_with_the_episode_or_without(termination, by_child):
    """From state 0, Top or its child Leaf goes to 1, in 3/4 of cases; in 1/4 the episode ends in 1.

    Top is terminated in 1, and its goal; Leaf goes on there. State 0 is a goal too, but not an end.
    """
    active = np.array([[1, 1], [1, 0], [1, 1]], np.bool_)
    goal = np.array([[0, 0], [2, 1], [5, 5]], np.float32)
    hierarchy = hierarchy_on(("go",), {"Root": ("Top", "Leaf"), "Top": ("go", "Leaf"), "Leaf": ("go",)}, active, goal)
    follows = np.ones((2, 1, 2), np.int32)
    probability = np.broadcast_to([0.75, 0.25], follows.shape)
    model = Model(follows, probability, 0.0 * follows, np.broadcast_to([False, True], follows.shape))
    process = joint_process(hierarchy, active, model, goal=goal, top="Top", termination=termination)
    paid = process.spread(process.goal)
    np.testing.assert_array_equal(paid[0, 0], [1.0, 0.0])  # go; Leaf, which takes no time
    assert paid[1, 0, 0] == by_child
    if termination == "on_return":  # Leaf still has control in state 1
        assert paid[1, 1, 0] == 0.25
    np.testing.assert_array_equal(process.spread(process.leaves)[0, 0], [0.75, 0.0])


def corridor(reward: float) -> tuple[Hierarchy, Tables, Model]:
    """Five cells, an end at the right; every action costs nothing and the end pays."""
    active = np.ones((2, 5), np.bool_)
    hierarchy = hierarchy_on(("stay", "right"), {"Root": ("Walk",), "Walk": ("stay", "right")}, active, 0 * active)
    states = np.arange(5)
    follows = np.stack([states, np.minimum(states + 1, 4)], -1)[..., None]
    ended = (states[:, None, None] == 4) & np.array([False, True])[:, None]
    return hierarchy, Tables(active, 0 * active), Model(follows, np.ones(follows.shape), ended * reward, ended)


@pytest.mark.parametrize("method", METHODS)
def test_where_staying_for_ever_ties_with_ending_the_greedy_policy_ends(method):
    hierarchy, tables, model = corridor(3.0)
    optima = solve_hierarchy(hierarchy, tables, model, np.full(5, 0.2), method=method)
    for criterion in optima:
        np.testing.assert_allclose(criterion.value, 3.0)
    np.testing.assert_array_equal(optima.hierarchical.policy[1], 1)
    np.testing.assert_array_equal(optima.recursive.policy[1], 1)
    process = joint_process(hierarchy, tables.active, model, discount=0.5)
    np.testing.assert_array_equal(greedy(process, optimise(process))[1], 1)


# Errors


def test_a_policy_that_never_ends_has_no_value_without_discounting():
    hierarchy, tables, model = corridor(3.0)
    process = joint_process(hierarchy, tables.active, model)
    staying = np.zeros((2, 5), np.int64)
    with pytest.raises(ValueError, match="must be able to end: it cannot from subtask 'Root' in state 0"):
        decompose(process, process.weights(staying))
    discounted = joint_process(hierarchy, tables.active, model, discount=0.5)
    np.testing.assert_array_equal(decompose(discounted, discounted.weights(staying)).value, 0)


def two_rooms_with_a_dear_exit() -> tuple[Hierarchy, Tables, Model]:
    """Rooms 0 and 1, and the outside, 2. A subtask a room ends with the room: next door for 1, outside for 5."""
    hierarchy = Hierarchy(
        ("next door", "outside"),
        [
            Subtask("Root", ("Left", "Right"), lambda state: state == 2),
            *(Subtask(name, ("next door", "outside"), lambda state: state == 2) for name in ("Left", "Right")),
        ],
    )
    active = np.array([[True, True, False], [True, False, False], [False, True, False]])
    goal = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 1]], np.float32)
    shape = 3, 2, 1
    next_state = np.array([[1, 2], [0, 2], [2, 2]]).reshape(shape)
    reward = np.array([[-1.0, -5.0], [-1.0, -5.0], [0.0, 0.0]]).reshape(shape)
    return hierarchy, Tables(active, goal), Model(next_state, np.ones(shape), reward, next_state == 2)


@pytest.mark.parametrize("method", METHODS)
def test_where_no_recursively_optimal_policy_exists_the_other_two_do(method):
    """Each subtask takes the cheap door, and both send one back to each other for ever."""
    problem = *two_rooms_with_a_dear_exit(), np.array([0.5, 0.5, 0.0])
    why = r"with discount 1 the episode must be able to end: it cannot from subtask 'Root' in state 0"
    with pytest.warns(RuntimeWarning, match=f"no recursively optimal policy with a pseudo-reward of 0: {why}"):
        optima = solve_hierarchy(*problem, method=method)
    assert (optima.optimal.mean, optima.hierarchical.mean) == (-5, -5)
    assert np.isnan(optima.recursive.mean)
    assert np.isnan(optima.recursive.value).all()
    assert optima.recursive.value.shape == optima.optimal.value.shape
    assert optima.recursive.policy.shape == optima.hierarchical.policy.shape
    assert (optima.recursive.policy == -1).all()
    assert (optima.recursive.action == -1).all()
    assert re.fullmatch(why, str(optima.recursive.why_missing))
    with pytest.raises(NoBestPolicyError, match=why):
        recursively_optimal(*problem[:3], method=method)
    for options in ({"pseudo_reward": 10.0}, {"discount": 0.5}):
        other = solve_hierarchy(*problem, method=method, **options)
        assert other.recursive.why_missing is None
        assert np.isfinite(other.recursive.mean)
    assert solve_hierarchy(*problem, method=method, pseudo_reward=10.0).recursive.mean == -5


def test_four_rooms_have_no_recursively_optimal_policy_without_a_pseudo_reward():
    """The nearest hallway is as good as any to leave a room by."""
    env = Gridworld()
    with pytest.warns(RuntimeWarning, match="no recursively optimal policy"):
        optima = solved(env)
    assert (optima.optimal.mean, optima.hierarchical.mean) == pytest.approx((-20, -20))
    assert np.isnan(optima.recursive.mean)
    assert solved(env, pseudo_reward=10.0).recursive.mean == pytest.approx(-20)


def test_a_policy_that_earns_for_ever_is_told_of():
    hierarchy, tables, model = two_rooms_with_a_dear_exit()
    with pytest.raises(NoBestPolicyError, match="a policy that never ends earns more than any that does"):
        solve_hierarchy(hierarchy, tables, model._replace(reward=model.reward + 3), np.array([1.0, 0, 0]))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"initial": np.array([1.0, 1, 0])},
            ValueError,
            "initial must have no negative entry and sum to one, got a sum of 2",
        ),
        ({"initial": np.ones(1)}, ValueError, r"initial must be probabilities of shape \(3,\), got shape \(1,\)"),
        ({"pseudo_reward": None}, TypeError, "pseudo_reward must be a number, got None"),
        ({"pseudo_reward": np.inf}, ValueError, "pseudo_reward must be a finite number in .*, got inf"),
        ({"discount": "1"}, TypeError, "discount must be a number, got '1'"),
        (
            {"tasks": np.ones((3, 3), bool)},
            TypeError,
            "tasks must be a hierarchy's predicates at every state, .*got array",
        ),
        ({"model": Maze()}, TypeError, r"model must be a hrljax.solvers.Model such as env.model\(\), got Maze\(\)"),
        ({"hierarchy": "Maze"}, TypeError, r"hierarchy must be a Hierarchy such as env.hierarchy\(\), got 'Maze'"),
    ],
)
def test_bad_arguments_of_a_solution_are_refused(change: dict, error: type[Exception], message: str):
    hierarchy, tables, model = two_rooms_with_a_dear_exit()
    arguments = {"hierarchy": hierarchy, "tasks": tables, "model": model, "initial": np.array([1.0, 0, 0])} | change
    with pytest.raises(error, match=message):
        solve_hierarchy(**arguments)


def test_a_discount_that_is_traced_is_refused_without_showing_the_tracer():
    hierarchy, tables, model = two_rooms_with_a_dear_exit()
    with pytest.raises(TypeError, match=r"discount must be a number, got a traced float32\[\]"):
        jax.eval_shape(lambda x: joint_process(hierarchy, tables.active, model, discount=x).reward, 0.5)


def test_too_few_sweeps_are_an_error_that_says_where():
    hierarchy, tables, model = corridor(3.0)
    process = joint_process(hierarchy, tables.active, model._replace(reward=model.reward - 1))
    for method in METHODS:
        with pytest.raises(RuntimeError, match=r"1 (sweeps|improvements) were not enough; .* in subtask"):
            optimise(process, method=method, max_sweeps=1)


def test_a_root_must_not_end_before_the_episode():
    hierarchy, tables, model = corridor(3.0)
    active = tables.active.copy()
    active[0, 3] = False
    with pytest.raises(ValueError, match="root 'Root' can terminate before the episode, after a step of subtask"):
        solve_hierarchy(hierarchy, Tables(active, tables.goal), model, np.full(5, 0.2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"active": np.ones((2, 4), np.bool_)}, r"active must be bools of shape \(2, 5\), got shape \(2, 4\)"),
        ({"active": np.zeros((2, 5), np.bool_)}, "subtask 'Root' is terminated in every state"),
        ({"active": np.eye(2, 5, dtype=np.bool_) | [[True], [False]]}, "subtask 'Root' in state 0 has no child"),
        ({"discount": 1.5}, r"discount must be a finite number in \[0, 1\], got 1.5"),
        ({"termination": "late"}, "termination must be one of 'immediate', 'on_return', got 'late'"),
        ({"hierarchy": Hierarchy(["a"], [Subtask("Root", ("a",), bool)])}, "active must be bools of shape"),
        ({"goal": np.zeros(3)}, r"goal must be numbers of shape \(2, 5\), got shape \(3,\)"),
    ],
)
def test_bad_arguments_of_a_process_are_refused(change: dict, message: str):
    hierarchy, tables, model = corridor(1.0)
    arguments = {"hierarchy": hierarchy, "active": tables.active, "model": model} | change
    with pytest.raises(ValueError, match=message):
        joint_process(**arguments)


def test_bad_policies_and_methods_are_refused():
    hierarchy, tables, model = corridor(1.0)
    process = joint_process(hierarchy, tables.active, model)
    with pytest.raises(ValueError, match=r"policy by subtask must have shape \(2, 5\) of ints or \(2, 5, 2\), got"):
        process.weights(np.zeros((2, 5)))
    with pytest.raises(ValueError, match="do not sum to one: subtask 'Walk'"):
        process.weights(np.array([[0] * 5, [2] * 5]))
    with pytest.raises(ValueError, match="method must be one of 'policy_iteration', 'value_iteration', got 'magic'"):
        optimise(process, method="magic")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="weights are needed for the contexts that are not free"):
        optimise(process, free=np.array([True, False]))
    with pytest.raises(ValueError, match="ties must be one of 'first', 'last', got 'middle'"):
        greedy(process, optimise(process), "middle")  # type: ignore[arg-type]


def test_too_many_calling_stacks_are_refused():
    names = [f"T{i}" for i in range(14)]
    children = {name: (*names[i + 1 :], "a") for i, name in enumerate(names)}
    hierarchy = hierarchy_on(("a",), children, np.ones((14, 1), np.bool_), np.zeros((14, 1)))
    model = Model.from_dense(np.zeros((1, 1, 1)), np.zeros((1, 1)))
    with pytest.raises(ValueError, match="more than 4096 calling stacks"):
        joint_process(hierarchy, np.ones((14, 1), np.bool_), model)


def test_values_by_subtask_are_those_that_all_callers_agree_on():
    """Navigate's reward until it arrives is the same for Get and Put; what follows is not."""
    env = Taxi()
    hierarchy, tables = env.hierarchy(), tabulate(env.hierarchy(), env)
    process = joint_process(hierarchy, tables.active, env.model(), discount=0.9)
    values = decompose(process, process.uniform())
    common = process.by_subtask(values.q)
    np.testing.assert_array_equal(common[:3], values.q[:3])  # one caller each
    named = process.hierarchy.index("Navigate(R)")
    np.testing.assert_array_equal(common[named], np.fmax(values.q[3], values.q[7]))  # by one caller in each state
    clash = values.q.copy()
    clash[7] = values.q[3] + 1
    assert np.isnan(process.by_subtask(clash)[named]).all()
    np.testing.assert_array_equal(process.by_subtask(clash, tolerance=2.0)[named], values.q[3])


def test_larger_random_problems_are_solved_in_the_same_way():
    generator = np.random.default_rng(3)
    problem = random_problem(generator, 4, num_states=60, num_actions=4, width=3)
    process = joint_process(problem.hierarchy, problem.active, problem.model, discount=0.9)
    values = decompose(process, process.weights(random_policy(generator, problem)))
    chosen = process.sums(process.weights(random_policy(generator, problem)))
    np.testing.assert_allclose(chosen, 1)
    assert np.isfinite(values.value[process.node >= 0]).all()
