"""Roots of graded quality: what they choose how often, and what they are worth, against plain dynamic programming."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax as hrl
from hrljax.core.random import WORD_RANGE
from hrljax.experiments.graded_root import Advice, GradedRoot, choice_probabilities, obedience, worth
from hrljax.learners.roots.base import Question
from tests.contexts import learning
from tests.maps import SMALL

HIERARCHY = SMALL.hierarchy()
QUALITIES = [1.0, 0.5, 0.25, 0.0, -0.25, -0.5, -1.0]


@cache
def advice() -> Advice:
    return GradedRoot().prepare(HIERARCHY, SMALL)


class Plain(NamedTuple):
    """The domain as dense arrays, subtasks without the root: I of them, S states, A actions."""

    follows: np.ndarray  # [S, A, S] probabilities
    reward: np.ndarray  # [S, A]
    active: np.ndarray  # [I, S] bool
    goal: np.ndarray  # [I, S]
    policy: np.ndarray  # [I, S] actions of subtasks that obey strictly; -1 where they are terminated


@cache
def plain() -> Plain:
    model, tables = SMALL.model(), hrl.tabulate(HIERARCHY, SMALL)
    follows = np.zeros((model.num_states, model.num_actions, model.num_states))
    for (state, action, k), chance in np.ndenumerate(model.probability):
        if chance and not model.terminated[state, action, k]:
            follows[state, action, model.next_state[state, action, k]] += chance
    reward = (model.probability * model.reward).sum(-1)
    return Plain(follows, reward, tables.active[1:], tables.goal[1:], obedience(HIERARCHY, SMALL).slots[1:])


def best_totals(gain: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """``[S]``: greatest total of a gain ``[S, A]`` until one is not inside, by value iteration."""
    value = np.zeros(len(gain))
    for _ in range(5000):
        value = np.where(inside, (gain + plain().follows @ value).max(-1), 0.0)
    return value


def followed_totals(gain: np.ndarray, inside: np.ndarray, policy: np.ndarray) -> np.ndarray:
    """``[S]``: total of a gain ``[S, A]`` under a policy until one is not inside, by linear equations."""
    states = np.flatnonzero(inside)
    chain = plain().follows[states, policy[states]][:, states]
    totals = np.zeros(len(gain))
    totals[states] = np.linalg.solve(np.eye(len(states)) - chain, gain[states, policy[states]])
    return totals


def under_obedience(chances: np.ndarray) -> np.ndarray:
    """``[S, I]``: expected return from where the root invokes a subtask, under its chances ``[S, I]``."""
    follows, reward, active, _, policy = plain()
    num_tasks, num_states = active.shape
    system, gain = np.eye(num_tasks * num_states), np.zeros((num_tasks, num_states))
    for task in range(num_tasks):
        for state in np.flatnonzero(active[task]):
            row, after = task * num_states + state, follows[state, policy[task, state]]
            gain[task, state] = reward[state, policy[task, state]]
            for other in range(num_tasks):
                columns = slice(other * num_states, (other + 1) * num_states)
                system[row, columns] -= np.where(active[task], other == task, chances[:, other]) * after
    values = np.linalg.solve(system, gain.ravel()).reshape(num_tasks, num_states).T
    return np.where(active.T, values, np.nan)


def mean_return(chances: np.ndarray) -> float:
    """Of an episode, under the root's chances ``[S, I]``."""
    initial = SMALL.initial_distribution()
    return float(initial @ np.nansum(chances * under_obedience(chances), -1))


@pytest.mark.parametrize(
    "task", [0, *(pytest.param(task, marks=pytest.mark.slow) for task in range(1, len(HIERARCHY.subtasks) - 1))]
)
def test_a_subtask_that_obeys_strictly_is_the_likeliest_to_reach_its_goal(task: int):
    """Among those that are, it is the one that earns most."""
    follows, reward, active, goal, policy = plain()
    reaches = follows @ (goal[task] * ~active[task])
    likeliest = best_totals(reaches, active[task])
    np.testing.assert_allclose(followed_totals(reaches, active[task], policy[task]), likeliest, atol=1e-9)
    assert 0.1 < likeliest[active[task]].min() < likeliest.max() < 1
    gain = reward + 1e6 * reaches
    np.testing.assert_allclose(
        followed_totals(gain, active[task], policy[task]), best_totals(gain, active[task]), rtol=1e-9
    )


def chances_of(slots: np.ndarray) -> np.ndarray:
    """``[S, I]`` of a root that invokes one subtask in every state."""
    return np.eye(len(HIERARCHY.subtasks) - 1)[slots]


def test_the_best_advice_is_the_best_that_there_is_and_the_worst_is_worst_before_it():
    values = under_obedience(chances_of(advice().best))
    states = np.arange(SMALL.num_states)
    at_root = advice().allowed.any(-1)
    greatest, least = (choose(values[at_root], axis=-1) for choose in (np.nanmax, np.nanmin))
    np.testing.assert_allclose(values[states, advice().best][at_root], greatest, atol=1e-8)
    np.testing.assert_allclose(values[states, advice().worst][at_root], least, atol=1e-8)
    np.testing.assert_allclose(obedience(HIERARCHY, SMALL).values[at_root], values[at_root], atol=1e-8)
    assert (greatest > least + 1).mean() > 0.2


@pytest.mark.parametrize("quality", QUALITIES)
def test_worth_is_that_of_plain_dynamic_programming(quality: float):
    chances = (1 - abs(quality)) * advice().allowed / advice().allowed.sum(-1, keepdims=True)
    chances += abs(quality) * chances_of(advice().best if quality > 0 else advice().worst)
    assert worth(HIERARCHY, SMALL, quality) == pytest.approx(mean_return(chances), rel=1e-9)


def test_better_advice_is_worth_more():
    worths = [worth(HIERARCHY, SMALL, quality) for quality in QUALITIES]
    assert worths == sorted(worths, reverse=True)
    assert worths[0] > worths[-1] + 100


@pytest.mark.parametrize("quality", QUALITIES)
def test_probabilities_sum_to_one_over_what_may_be_invoked(quality: float):
    chances = choice_probabilities(advice(), quality)
    np.testing.assert_allclose(chances.sum(-1), 1, rtol=1e-12)
    assert (chances[~advice().allowed] == 0).all()
    assert (chances[advice().allowed] > 0).all() == (abs(quality) < 1)
    traced = jax.jit(
        jax.vmap(
            lambda state, quality: GradedRoot(quality).probabilities(advice(), (), _worthless, state, learning()),
            (0, None),
        )
    )(jnp.arange(SMALL.num_states, dtype=jnp.int32), jnp.float32(quality))
    np.testing.assert_allclose(traced, chances, atol=1e-7)


def _worthless(task: jax.Array, state: jax.Array) -> jax.Array:
    return jnp.float32(0)


@pytest.mark.parametrize("quality", QUALITIES)
def test_it_chooses_as_often_as_its_probabilities_say(quality: float):
    root = GradedRoot(quality)
    words = jnp.arange(0, WORD_RANGE, 1013, dtype=jnp.uint32)  # evenly over all words

    def chosen(state: jax.Array, word: jax.Array) -> jax.Array:
        asked = Question(state, word, jnp.float32(0.5), _worthless)
        return root.begin(advice(), (), asked, learning()).task

    states = np.arange(0, SMALL.num_states, 3)
    by_state = jax.vmap(jax.vmap(chosen, (None, 0)), (0, None))
    tasks = np.asarray(jax.jit(by_state)(jnp.asarray(states, jnp.int32), words))
    shares = np.stack([(tasks == task).mean(-1) for task in range(advice().allowed.shape[1])], -1)
    np.testing.assert_allclose(shares, choice_probabilities(advice(), quality)[states], atol=2e-3)


@pytest.mark.slow
def test_qualities_are_an_axis_of_a_sweep_and_of_its_exact_evaluation():
    learner = hrl.HORDQ(HIERARCHY, GradedRoot(), pseudo_reward=5.0, initial_value=-25.0)
    options = {"seeds": 2, "num_episodes": 40, "bin_size": 20, "evaluate_every": 1, "progress": False, "cores": 1}
    swept = hrl.sweep(SMALL, learner, axes={"root.quality": [0.5, -0.5]}, **options)
    single = hrl.sweep(SMALL, learner.replaced({"root.quality": -0.5}), **options)
    for name in ("return", "greedy_return"):
        np.testing.assert_array_equal(swept[name].sel({"root.quality": -0.5}), single[name], err_msg=name)


@pytest.mark.parametrize("quality", [1.01, -1.5, float("nan")])
def test_a_wrong_quality_is_refused(quality: float):
    with pytest.raises(ValueError, match=r"GradedRoot: quality must be a finite number in \[-1, 1\]"):
        GradedRoot(quality)
    with pytest.raises(ValueError, match=r"GradedRoot: quality must be a finite number in \[-1, 1\]"):
        worth(HIERARCHY, SMALL, quality)
