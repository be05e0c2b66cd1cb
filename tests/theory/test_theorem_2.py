"""Theorem 2: with a total leaf cover, HORDQ's values are the optimal ones, whatever other subtasks do."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from hrljax.hierarchy.leaf_cover import inaccessible, total_leaf_cover
from hrljax.solvers import JointProcess, decompose, joint_process, optimise
from hrljax.solvers.joint_optima import Method, Optimum
from tests.strategies import Problem, hierarchy_on, random_policy, random_problem, random_process

PROBLEMS = 200
TOLERANCE = 1e-9
STRICTLY = 1e-6


class Learned(NamedTuple):
    """The fixed point of HORDQ: the leaf cover is greedy, everything else follows a given policy."""

    process: JointProcess
    best: Optimum
    loss: float  # greatest difference from the optimal values, over states and actions of the cover


def learned(problem: Problem, policy: np.ndarray, method: Method = "policy_iteration", **options: Any) -> Learned:
    hierarchy = problem.hierarchy
    process = joint_process(hierarchy, problem.active, problem.model, discount=problem.discount, **options)
    in_cover = np.array([task.name in hierarchy.leaf_cover() for task in hierarchy.subtasks])
    free = in_cover[process.contexts.task]
    best = optimise(process, process.weights(policy), free, method=method)
    covers = free[process.context]
    optimal = problem.optimal_q()
    action = actions_of_rows(process)
    rows = np.flatnonzero(covers[process.row_node] & (action >= 0))
    off = np.abs(best.q[rows] - optimal[process.state[process.row_node[rows]], action[rows]])
    short = np.abs(best.value - optimal.max(-1)[process.state])[covers]
    return Learned(process, best, float(max(off.max(), short.max())))


def actions_of_rows(process: JointProcess) -> np.ndarray:
    """``[R]`` int: the primitive action of each row, -1 for a composite child."""
    hierarchy = process.hierarchy
    width = process.contexts.called.shape[1]
    of_slot = np.full((len(hierarchy.subtasks), width), -1)
    for number, task in enumerate(hierarchy.subtasks):
        for slot, child in enumerate(task.children):
            of_slot[number, slot] = hierarchy.actions.index(child) if hierarchy.is_primitive(child) else -1
    return of_slot[process.contexts.task[process.context[process.row_node]], process.row_slot]


def sized_problem(generator: np.random.Generator, levels: int) -> Problem:
    return random_problem(
        generator,
        levels,
        num_states=int(generator.integers(5, 21)),
        num_actions=int(generator.integers(2, 6)),
        discount=float(generator.uniform(0.5, 0.98)),
        ending=float(generator.choice([0.0, 0.1])),
    )


@pytest.mark.parametrize("levels", [2, 3])
def test_policy_iteration_finds_the_optimal_values_under_any_root(levels: int):
    """100 random problems each; of their roots, half choose at random and half always the same."""
    generator = np.random.default_rng(levels)
    losses = []
    for number in range(PROBLEMS // 2):
        problem = sized_problem(generator, levels)
        assert problem.hierarchy.is_total_leaf_cover()
        assert not inaccessible(problem.hierarchy, problem.active)
        policy = random_policy(generator, problem, deterministic=number % 2 == 0)
        losses.append(learned(problem, policy).loss)
    assert max(losses) < TOLERANCE


@pytest.mark.parametrize("levels", [2, 3, 4])
def test_value_iteration_finds_them_too(levels: int):
    generator = np.random.default_rng(10 + levels)
    for number in range(10):
        problem = sized_problem(generator, levels)._replace(discount=0.9)
        policy = random_policy(generator, problem, deterministic=number % 2 == 0)
        assert learned(problem, policy, "value_iteration").loss < TOLERANCE


def test_it_makes_no_difference_when_a_termination_is_noticed():
    generator = np.random.default_rng(9)
    for levels in (2, 3, 3, 4):
        problem = sized_problem(generator, levels)
        policy = random_policy(generator, problem)
        assert learned(problem, policy, termination="on_return").loss < TOLERANCE


def test_the_optimal_values_of_a_subtask_do_not_depend_on_its_caller():
    """So that Q(i, s, a) of the theorem is well defined for tables by subtask."""
    generator = np.random.default_rng(5)
    problem = random_problem(generator, 3, num_states=10)
    actual = learned(problem, random_policy(generator, problem))
    assert actual.process.contexts.size > len(problem.hierarchy.subtasks)
    q = actual.process.spread(actual.best.q)
    common = actual.process.by_subtask(q)
    for number, task in enumerate(problem.hierarchy.subtasks):
        if task.name in problem.hierarchy.leaf_cover():
            somewhere = ~np.isnan(q[actual.process.contexts.task == number]).all(0)
            assert np.isfinite(common[number])[somewhere].all()


def test_the_parts_of_the_fixed_point_sum_to_the_optimal_values():
    generator = np.random.default_rng(4)
    problem = random_problem(generator, 3, num_states=10)
    actual = learned(problem, random_policy(generator, problem))
    values = decompose(actual.process, actual.best.weights)
    np.testing.assert_allclose(values.q, actual.process.spread(actual.best.q), atol=1e-10)
    parts = np.stack([values.reward, values.completion, values.exit])
    assert np.all(np.nanmax(np.abs(parts), axis=(1, 2, 3)) > 0.1)


# HORDQ's tables themselves, 200 problems at once: leaves that have all actions, under a random root.


class Batch(NamedTuple):
    transition: np.ndarray  # [B, S, A, S]
    reward: np.ndarray  # [B, S, A]
    active: np.ndarray  # [B, T, S]
    choice: np.ndarray  # [B, T, S] probability that the root invokes a leaf


DISCOUNT, STATES, ACTIONS, LEAVES = 0.9, 10, 3, 3


@pytest.fixture(scope="module")
def batch() -> Batch:
    generator = np.random.default_rng(0)
    transition = generator.dirichlet(np.full(STATES, 0.3), (PROBLEMS, STATES, ACTIONS))
    active = generator.random((PROBLEMS, LEAVES, STATES)) < 0.5
    active[:, 0] |= ~active.any(1)
    choice = active * generator.exponential(size=active.shape)
    choice[::2] = (choice == choice.max(1, keepdims=True))[::2]  # half of the roots are deterministic
    reward = generator.normal(size=(PROBLEMS, STATES, ACTIONS))
    return Batch(transition, reward, active, choice / choice.sum(1, keepdims=True))


def picked(table: np.ndarray, child: np.ndarray) -> np.ndarray:
    return np.take_along_axis(table, child[..., None], -1)[..., 0]


def fixed_point(batch: Batch, with_exit: bool) -> np.ndarray:
    """Parts ``[3, B, T, S, A]`` by sweeps of eq. 3.3, 3.4 and 3.6; without Q_e these are MAXQ's."""
    reward = np.broadcast_to(batch.reward[:, None], (PROBLEMS, LEAVES, STATES, ACTIONS))
    parts = np.stack([reward, np.zeros(reward.shape), np.zeros(reward.shape)])
    moves = batch.transition.reshape(PROBLEMS, STATES * ACTIONS, STATES)

    def expected(value: np.ndarray) -> np.ndarray:
        actual = np.einsum("bij,btj->bti", moves, value, optimize=True)
        return DISCOUNT * actual.reshape(PROBLEMS, LEAVES, STATES, ACTIONS)

    for _ in range(2000):
        best = parts.sum(0).argmax(-1)
        r, c, e = (picked(part, best) for part in parts)
        entered = (batch.choice * (r + c + e)).sum(1, keepdims=True)  # of the leaf that the root invokes
        completion = expected(np.where(batch.active, r + c, 0))
        exit = expected(np.where(batch.active, e, entered)) if with_exit else np.zeros(reward.shape)
        updated = np.stack([reward, completion, exit])
        if np.abs(updated - parts).max() < 1e-12:
            break
        parts = updated
    return parts


def optimal_q(batch: Batch) -> np.ndarray:
    q = batch.reward
    for _ in range(400):
        q = batch.reward + DISCOUNT * np.einsum("bsaj,bj->bsa", batch.transition, q.max(-1), optimize=True)
    return q


def value_of(batch: Batch, policy: np.ndarray) -> np.ndarray:
    """``[B, T, S]``: values of leaves' policies ``[B, T, S]`` under the root, by one linear system each."""
    eye = np.eye(LEAVES)[None, :, None, :, None]
    # [B, T, S', T']: who has control in a state that leaf T has led to
    control = np.where(batch.active[:, :, :, None], eye[..., 0], np.moveaxis(batch.choice, 1, 2)[:, None])
    numbers = np.arange(PROBLEMS)[:, None, None], np.arange(STATES)[None, None], policy
    moves = batch.transition[numbers]  # [B, T, S, S']
    chain = moves[..., None] * control[:, :, None]  # [B, T, S, S', T']
    chain = np.moveaxis(chain, -1, -2).reshape(PROBLEMS, LEAVES * STATES, LEAVES * STATES)
    gains = batch.reward[numbers].reshape(PROBLEMS, -1, 1)
    return np.linalg.solve(np.eye(LEAVES * STATES) - DISCOUNT * chain, gains).reshape(batch.active.shape)


def test_sweeps_over_the_three_tables_end_at_the_optimal_values(batch: Batch):
    parts = fixed_point(batch, with_exit=True)
    off = np.abs(parts.sum(0) - optimal_q(batch)[:, None])[batch.active]
    assert off.max() < TOLERANCE
    value = value_of(batch, parts.sum(0).argmax(-1))
    assert np.abs(value - optimal_q(batch).max(-1)[:, None])[batch.active].max() < TOLERANCE


# Counter-examples


def test_without_exit_values_most_policies_are_suboptimal(batch: Batch):
    """MAXQ with the same total leaf cover: a subtask that ends does not see what follows."""
    value = value_of(batch, fixed_point(batch, with_exit=False).sum(0).argmax(-1))
    loss = np.where(batch.active, optimal_q(batch).max(-1)[:, None] - value, 0).max((1, 2))
    assert loss.min() > -TOLERANCE
    assert np.mean(loss > STRICTLY) > 0.9
    assert np.median(loss) > 0.2


def lacking_one_action(generator: np.random.Generator) -> Problem:
    """A root that always invokes a leaf which has all actions but one."""
    num_states, num_actions = int(generator.integers(5, 21)), int(generator.integers(2, 6))
    actions = tuple(f"a{i}" for i in range(num_actions))
    active = np.ones((2, num_states), np.bool_)
    hierarchy = hierarchy_on(actions, {"Root": ("Leaf",), "Leaf": actions[1:]}, active, 0 * active)
    outcomes, reward = random_process(generator, num_states, num_actions, 0.0)
    return Problem(hierarchy, active, 0 * active, outcomes, reward, float(generator.uniform(0.5, 0.98)))


def test_without_a_total_leaf_cover_most_policies_are_suboptimal():
    generator = np.random.default_rng(7)
    losses, healed = [], []
    for number in range(PROBLEMS):
        problem = lacking_one_action(generator)
        assert not problem.hierarchy.is_total_leaf_cover()
        policy = random_policy(generator, problem)
        losses.append(learned(problem, policy).loss)
        if number % 10:
            continue
        patched = total_leaf_cover(problem.hierarchy)
        assert patched.added == {"Leaf": ("a0",)}
        problem = problem._replace(hierarchy=patched.hierarchy)
        healed.append(learned(problem, random_policy(generator, problem)).loss)
    assert np.mean(np.array(losses) > STRICTLY) > 0.9
    assert np.median(losses) > 1
    assert max(healed) < TOLERANCE


def through_a_child(generator: np.random.Generator, share: float) -> Problem:
    """Middle has one action itself and the others through Leaf, active in a share of the states."""
    num_states, actions = 12, ("a0", "a1", "a2")
    active = np.ones((3, num_states), np.bool_)
    active[2] = generator.random(num_states) < share
    active[2, 0] = True
    children = {"Root": ("Middle",), "Middle": ("Leaf", "a0"), "Leaf": actions}
    hierarchy = hierarchy_on(actions, children, active, 0 * active)
    outcomes, reward = random_process(generator, num_states, 3, 0.0)
    return Problem(hierarchy, active, 0 * active, outcomes, reward, 0.9)


def test_a_child_that_is_inactive_in_part_of_its_callers_states_breaks_theorem_2():
    """By names alone the leaf cover is total; the actions are not accessible in every active state."""
    generator = np.random.default_rng(8)
    losses, sound, healed = [], [], []
    for number in range(PROBLEMS):
        problem = through_a_child(generator, 0.5)
        assert problem.hierarchy.is_total_leaf_cover()
        gaps = inaccessible(problem.hierarchy, problem.active)
        if not gaps:
            continue
        assert {(gap.subtask, gap.action) for gap in gaps} == {("Middle", "a1"), ("Middle", "a2")}
        assert all(gap.num_states == np.sum(~problem.active[2]) for gap in gaps)
        losses.append(learned(problem, random_policy(generator, problem)).loss)
        if number % 10:
            continue
        patched = total_leaf_cover(problem.hierarchy, active=problem.active)
        assert patched.added == {"Middle": ("a1", "a2")}
        problem = problem._replace(hierarchy=patched.hierarchy)
        assert not inaccessible(problem.hierarchy, problem.active)
        healed.append(learned(problem, random_policy(generator, problem)).loss)
        everywhere = through_a_child(generator, 1.0)
        assert not inaccessible(everywhere.hierarchy, everywhere.active)
        sound.append(learned(everywhere, random_policy(generator, everywhere)).loss)
    assert len(losses) > 0.9 * PROBLEMS
    assert np.mean(np.array(losses) > STRICTLY) > 0.9
    assert np.median(losses) > 0.5
    assert max(healed) < TOLERANCE
    assert max(sound) < TOLERANCE
