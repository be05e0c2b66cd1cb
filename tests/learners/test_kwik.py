"""R-MAX by KWIK linear regression: against plain Python, and what its regression finds."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.envs.table import Table, TableEnvironment
from hrljax.learners.kwik import KnownEffects, KWIKRMax, least_squares_step
from hrljax.solvers.model import Model
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_under_every_mapping,
    choose,
    settled,
)
from tests.maps import SMALL, optimum

F = np.float32
STATES = SMALL.num_states


class Regressing:
    """Effects as those of the exact model's words, classes as lists, regressions in loops."""

    def __init__(self, learner: Any):
        self.learner, self.effects = learner, KnownEffects.of(SMALL)
        self.k = self.effects.num_effects
        self.q = np.full(PAIRS, learner.optimistic_value, F)
        self.matrices: list[Any] = [np.eye(self.k, dtype=F) for _ in range(4)]
        self.weights: list[Any] = [np.zeros(self.k, F) for _ in range(4)]
        self.learned = 0

    def begin(self, state: int, words: list[int]) -> int:
        return choose(self.q, state, words[0], self.learner.epsilon)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        pair, leads = state * 4 + action, STATES if terminated else after
        if not self.is_known(pair):
            self.learned += 1
            for members in self.classes(pair):
                first = pair, members[0]
                happened = self.effects.next_state[first] == leads and self.effects.reward[first] == reward
                self.step(action, members, F(happened))
            self.plan()
        return choose(self.q, after, words[0], self.learner.epsilon)

    def classes(self, pair: int) -> list[list[int]]:
        """Effects with the same next state and reward."""
        leads = list(zip(self.effects.next_state[pair].tolist(), self.effects.reward[pair].tolist(), strict=True))
        return [[k for k in range(self.k) if leads[k] == where] for where in dict.fromkeys(leads)]

    def is_known(self, pair: int) -> bool:
        matrix = self.matrices[pair % 4]
        for members in self.classes(pair):
            squared = F(0)
            for i in range(self.k):
                component = F(0)
                for j in members:
                    component += matrix[i, j]
                squared += component * component
            if squared >= F(self.learner.known_below) * F(self.learner.known_below):
                return False
        return True

    def step(self, action: int, members: list[int], y: F) -> None:
        matrix, weights, q = self.matrices[action], self.weights[action], np.zeros(self.k, F)
        along, predicted = F(1), F(0)
        for j in members:
            q += matrix[:, j]
        for j in members:
            along += q[j]
            predicted += weights[j]
        gain = q * (F(1) / along)
        self.weights[action] = weights + gain * (y - predicted)
        self.matrices[action] = matrix - q[:, None] * gain

    def plan(self) -> None:
        chances = []
        for weights in self.weights:
            positive, total = np.maximum(weights, F(0)), F(0)
            for number in positive:
                total += number
            chances.append(positive * (F(1) / total) if total > 0 else np.full(self.k, F(1 / self.k)))
        chance = np.tile(np.array(chances), (STATES, 1))
        known_of: dict[Any, bool] = {}
        known = np.zeros(PAIRS, bool)
        for pair in range(PAIRS):
            key = pair % 4, self.effects.vector[pair].tobytes()
            if key not in known_of:
                known_of[key] = self.is_known(pair)
            known[pair] = known_of[key]

        def sweep(q: np.ndarray) -> np.ndarray:
            value, total = np.append(q.reshape(-1, 4).max(1), F(0)), np.zeros(PAIRS, F)
            for k in range(self.k):
                worth = self.effects.reward[:, k] + F(self.learner.discount) * value[self.effects.next_state[:, k]]
                total += chance[:, k] * worth
            return np.where(known, total, F(self.learner.optimistic_value))

        self.q, _ = settled(self.learner, self.q, sweep)


@pytest.mark.slow
@pytest.mark.parametrize(("epsilon", "discount"), [(0.125, 0.97), (0.75, 1.0)])
def test_a_run_gives_the_numbers_of_plain_python(epsilon: float, discount: float):
    learner = KWIKRMax(epsilon=epsilon, discount=discount, known_below=0.25, planning_sweeps=15, planning_tolerance=0.5)
    program = Regressing(learner)
    assert_runs_as(program, learner)
    assert program.learned > 20
    assert len(np.unique(program.q)) > 50


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    learner = KWIKRMax(epsilon=0.25, planning_sweeps=20, discount=0.97)
    assert_same_under_every_mapping(learner, {"known_below": [0.1, 0.3]})


@pytest.mark.slow
def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(KWIKRMax(known_below=0.45, planning_sweeps=5, optimistic_value=5.0, discount=0.5))


def test_the_regression_is_the_ridge_of_all_samples():
    generator = np.random.default_rng(0)
    x = (generator.random((40, 4)) < 0.5).astype(F)
    y = generator.random(40).astype(F)
    matrix, weights = jnp.eye(4), jnp.zeros(4)
    for row, target in zip(x, y, strict=True):
        matrix, weights = least_squares_step(matrix, weights, jnp.asarray(row), jnp.asarray(target), jnp.uint32(0))
    inverse = np.linalg.inv(np.eye(4) + x.T.astype(float) @ x)
    np.testing.assert_allclose(matrix, inverse, atol=1e-5)
    np.testing.assert_allclose(weights, inverse @ x.T @ y, atol=1e-5)


def test_effects_of_the_taxi_are_where_its_slips_lead():
    """To the left, to the right, straight on. To the north of a corner two of them end against walls: one class."""
    env = hrljax.make("Taxi", stochastic=True)
    effects = KnownEffects.of(env)
    assert effects.num_effects == 3
    corner = int(env.encode(env.decode(jnp.int32(0))))
    leads = [[int(s) // 20 for s in effects.next_state[corner * 6 + a]] for a in range(4)]
    assert leads == [[1, 0, 5], [0, 1, 0], [0, 5, 1], [5, 0, 0]]
    assert effects.first[corner * 6 + 1].tolist() == [0, 1, 0]
    assert effects.vectors[effects.vector[corner * 6 + 1, 2]].tolist() == [1, 0, 1]
    assert set(map(tuple, effects.vectors[effects.vector[corner * 6 + 4]])) == {(1, 1, 1)}


def test_what_is_learned_in_one_place_is_known_everywhere():
    env = hrljax.make("Taxi", stochastic=True)
    learner = KWIKRMax(optimistic_value=20.0, known_below=0.1)
    run = jax.jit(lambda key: hrljax.train(env, learner, key, 60, bin_size=20, evaluate_every=1))(jax.random.key(0))
    weights = np.asarray(run.learned.regression.weights).reshape(6, 3)
    np.testing.assert_allclose(weights[:4].sum(1), 1, atol=0.15)
    assert run.greedy_return is not None
    assert float(run.greedy_return[-1]) > optimum(env) - 1


def test_effects_with_one_next_state_and_two_rewards_are_told_apart():
    """A lottery that costs 10 nine times in ten is worse than to pay 6."""
    reward = np.array([[[-10.0, 0.0], [-6.0, -6.0]]])
    model = Model.merged(np.zeros((1, 2, 2), int), reward, np.ones((1, 2, 2), np.bool_), np.array([0.9, 0.1]))
    env = TableEnvironment(Table(model, np.ones(1)), name="lottery", max_steps=5, action_names=("lottery", "pay"))
    run = hrljax.train(env, KWIKRMax(known_below=0.01), jax.random.key(0), 500, bin_size=100)
    np.testing.assert_allclose(run.learned.values, [-9, -6], atol=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"known_below": 0.0}, r"KWIKRMax: known_below must be a finite number in \(0"),
        ({"planning_sweeps": 0}, "KWIKRMax: planning_sweeps must be an integer from 1"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        KWIKRMax(**options)
