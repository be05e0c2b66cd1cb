"""Shared values: the one table is Q-learning's, whatever subtasks, root and pseudo-reward make of behaviour."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array, lax

import hrljax as hrl
from hrljax.experiments.graded_root import GradedRoot
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.child_values import Known
from tests.maps import SMALL
from tests.strategies import (
    Problem,
    ProblemEnvironment,
    hierarchy_on,
    problems,
    random_problem,
    random_process,
)
from tests.words import KEY

NUMBERS: dict[str, Any] = {"step_size": 0.3, "epsilon": 0.25, "discount": 0.95, "initial_value": -10.0}
EPISODES = 80


def of_all(learned: Any, env: Any) -> np.ndarray:
    """Q(s, a) of a shared learner, ``[S * A]``."""
    return np.asarray(learned.q)[: env.num_states * env.num_actions]


@dataclass(frozen=True)
class WithRootsWord(hrl.QLearning):
    """Q-learning that leaves the first of two words to a root, as a learner over two levels does."""

    num_words = 2
    num_begin_words = 2

    def begin(self, prepared: int, tables: Any, first: Any, words: Words, context: Context) -> Any:
        return super().begin(prepared, tables, first, words[1:], context)

    def learn(self, prepared: int, state: Any, transition: Transition, words: Words, context: Context) -> Any:
        return super().learn(prepared, state, transition, words[1:], context)


@pytest.mark.slow
@pytest.mark.parametrize("root", [hrl.RandomRoot(), hrl.ModelRoot(interval=3, sweeps=2), GradedRoot(-0.5)], ids=str)
@pytest.mark.parametrize("taught", ["running", "active"])
def test_without_a_pseudo_reward_it_is_flat_q_learning_on_the_same_words(root: Any, taught: Any):
    params = SMALL.default_params._replace(max_steps=60)
    learner = hrl.SharedHORDQ(SMALL.hierarchy(), root, pseudo_reward=0.0, taught=taught, **NUMBERS)
    shared, flat = (
        jax.jit(lambda key, it=it: hrl.train(SMALL, it, key, EPISODES, params=params, bin_size=1))(KEY)
        for it in (learner, WithRootsWord(**NUMBERS))
    )
    for name, curve in flat.metrics.items():
        np.testing.assert_array_equal(shared.metrics[name], curve, err_msg=name)
    np.testing.assert_array_equal(of_all(shared.learned, SMALL), flat.learned)
    assert len(np.unique(flat.learned)) > 100


def side_by_side(env: Any, learner: Any, flat: Any, key: Array, num_steps: int) -> tuple[Any, Any]:
    """Tables of a hierarchical learner that acts for ever, and of a flat one that sees the same transitions."""
    params, prepared = env.default_params, learner.prepare(env)
    context = Context(jnp.int32(0), jnp.bool_(True), jnp.uint32(0))
    of_env, of_first = env.num_words, env.num_initial_words

    def first(words: Any) -> Array:
        return env.encode(env.initial(words[:of_first], params))

    def step(carry: Any, key: Array) -> tuple[Any, None]:
        state, of_learner, of_flat = carry
        of_step, of_beginning = jax.random.randint(key, (2, 12), 0, 1 << 24).astype(jnp.uint32)
        words, first_words = tuple(of_step), tuple(of_beginning)
        action = learner.action(of_learner.control)
        after, reward, terminated, _ = env.transition(env.decode(state), action, words[:of_env], params)
        transition = Transition(state, action, reward, env.encode(after), terminated)
        of_learner = learner.learn(prepared, of_learner, transition, words[of_env:], context)
        of_flat = flat.learn(env.num_actions, of_flat, transition, words[of_env:], context)
        begins = first(first_words)
        fresh = learner.begin(prepared, of_learner.tables, begins, first_words[of_first:], context)
        control = jax.tree.map(lambda a, b: jnp.where(terminated, a, b), fresh, of_learner.control)
        state = jnp.where(terminated, begins, transition.next_state)
        return (state, LearnerState(of_learner.tables, control), of_flat), None

    of_learner = learner.init(env, prepared)
    words = (jnp.uint32(1 << 20),) * 12
    control = learner.begin(prepared, of_learner.tables, first(words), words, context)
    start = first(words), LearnerState(of_learner.tables, control), flat.init(env, env.num_actions)
    (_, of_learner, of_flat), _ = lax.scan(step, start, jax.random.split(key, num_steps))
    return of_learner.tables, of_flat.tables


ROOTS = {"random": hrl.RandomRoot(), "adversary": GradedRoot(-1.0), "planner": hrl.ModelRoot(sweeps=0), "none": None}
PSEUDO_REWARDS = {"3": 3.0, "-7": -7.0, "1000": 1000.0, "fading": hrl.Fading(worth=50.0, after=3.0)}


@pytest.mark.slow
@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.parametrize("pseudo_reward", PSEUDO_REWARDS)
def test_with_any_pseudo_reward_it_is_q_learning_on_the_same_transitions(root: str, pseudo_reward: str):
    learner = hrl.SharedHORDQ(SMALL.hierarchy(), ROOTS[root], pseudo_reward=PSEUDO_REWARDS[pseudo_reward], **NUMBERS)
    tables, flat = jax.jit(lambda key: side_by_side(SMALL, learner, hrl.QLearning(**NUMBERS), key, 4000))(KEY)
    np.testing.assert_array_equal(of_all(tables, SMALL), flat)
    assert np.asarray(tables.q)[flat.size :].any()
    assert len(np.unique(flat)) > 100


@pytest.mark.slow
@given(problem=problems(levels=(2, 3, 4), discounts=(0.9, 1.0)), seed=st.integers(0, 2**31 - 1), taught=st.booleans())
@settings(deadline=None, max_examples=8)
def test_on_random_hierarchies_too(problem: Problem, seed: int, taught: bool):
    env = ProblemEnvironment(problem)
    hierarchy = hrl.total_leaf_cover(problem.hierarchy, active=problem.active).hierarchy
    numbers = NUMBERS | {"discount": problem.discount}
    learner = hrl.SharedHORDQ(hierarchy, pseudo_reward=5.0, taught="active" if taught else "running", **numbers)
    run = jax.jit(lambda key: side_by_side(env, learner, hrl.QLearning(**numbers), key, 500))
    tables, flat = run(jax.random.key(seed))
    np.testing.assert_array_equal(of_all(tables, env), flat)


@pytest.mark.slow
def test_a_subtask_is_worth_what_its_own_choice_is():
    """Theorem 1: Q(i, s, c) of a subtask c is Q(c, s, a) of what c would do, down to an action."""
    problem = random_problem(np.random.default_rng(4), 4, num_states=10)
    env = ProblemEnvironment(problem)
    learner = hrl.SharedHORDQ(problem.hierarchy, pseudo_reward=4.0, **NUMBERS)
    prepared, run = learner.prepare(env), jax.jit(lambda key: hrl.train(env, learner, key, 300))(KEY)
    layout, q = prepared.layout, of_all(run.learned, env).reshape(env.num_states, -1)
    known = Known(layout, run.learned.q, None, Context(jnp.int32(0), jnp.bool_(False), jnp.uint32(0)))
    policy = learner.greedy_policy(env, prepared, run.learned, known.context)
    composites = 0
    for state in range(env.num_states):
        for task in np.flatnonzero(layout.active[:, state]):
            children = layout.children(int(task))
            row = learner._row(known, children, jnp.int32(task), jnp.int32(state))
            assert int(row.best) == policy.slots[task, state]
            for slot, child in enumerate(children.tasks):
                if child >= 0 and layout.active[child, state]:
                    action = -1
                    while action < 0:
                        best = int(policy.slots[child, state])
                        action, child = layout.children(child).actions[best], layout.children(child).tasks[best]
                    assert float(row.values[slot].q) == q[state, action]
                    composites += 1
    assert composites > 50


@pytest.mark.slow
@pytest.mark.parametrize("quality", [-1.0, 1.0])
def test_it_converges_to_the_optimal_values_under_an_adversary_and_a_planner(quality: float):
    problem = random_problem(np.random.default_rng(8), 2, num_states=6, num_actions=3, discount=0.7, ending=0.1)
    env = ProblemEnvironment(problem)
    learner = hrl.SharedHORDQ(
        problem.hierarchy,
        GradedRoot(quality),
        pseudo_reward=20.0,
        discount=0.7,
        epsilon=0.5,
        step_size=lambda episode: (1.0 + episode / 20) ** -0.85,
    )
    run = jax.jit(lambda key: hrl.train(env, learner, key, 20_000))(KEY)
    off = np.abs(of_all(run.learned, env).reshape(-1, 3) - problem.optimal_q())
    early = jax.jit(lambda key: hrl.train(env, learner, key, 20))(KEY)
    off_at_first = np.abs(of_all(early.learned, env).reshape(-1, 3) - problem.optimal_q())
    assert off.max() < 0.1
    assert off_at_first.max() > 3 * off.max()


def test_without_a_total_leaf_cover_it_is_refused():
    taxi = hrl.make("Taxi")
    with pytest.raises(ValueError, match=r"'Get' lacks 'putdown'.*hrljax.total_leaf_cover"):
        hrl.SharedHORDQ(taxi.hierarchy())


@pytest.mark.slow
def test_what_makes_a_cover_total_gives_a_hierarchy_that_runs():
    taxi = hrl.make("Taxi")
    complete = hrl.total_leaf_cover(taxi.hierarchy(), active=hrl.tabulate(taxi.hierarchy(), taxi).active).hierarchy
    run = hrl.train(taxi, hrl.SharedHORDQ(complete), KEY, 1, params=taxi.default_params._replace(max_steps=5))
    assert int(run.steps) == 5


def test_what_is_total_by_names_alone_is_refused_on_the_environment():
    """Middle reaches two of its actions through Leaf only, which is not active everywhere."""
    actions, active = ("a0", "a1", "a2"), np.ones((3, 5), np.bool_)
    active[2, 3:] = False
    children = {"Root": ("Middle",), "Middle": ("Leaf", "a0"), "Leaf": actions}
    hierarchy = hierarchy_on(actions, children, active, 0.0 * active)
    outcomes, reward = random_process(np.random.default_rng(0), 5, 3, 0.1)
    env = ProblemEnvironment(Problem(hierarchy, active, 0 * active, outcomes, reward, 0.9))
    assert hierarchy.is_total_leaf_cover()
    with pytest.raises(ValueError, match=r"'Middle' cannot execute 'a1' in 2 of its active states.*total_leaf_cover"):
        hrl.train(env, hrl.SharedHORDQ(hierarchy), KEY, 1)
