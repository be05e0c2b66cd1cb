"""Linear Dyna: bit for bit a program in plain Python, a table with one feature a state, and features by hand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hrljax.core import random
from hrljax.learners.base import outside_of_training
from hrljax.learners.features import Features, state_features
from hrljax.learners.linear_dyna import LinearDyna
from hrljax.learners.linear_model import LinearModel
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_under_every_mapping,
)
from tests.maps import SMALL

F = np.float32
STATES = PAIRS // 4


def random_features(size: int, active: int) -> Features:
    """Weights of any sign, some of them 0, of length one."""
    generator = np.random.default_rng(3)
    index = np.stack([generator.permutation(size)[:active] for _ in range(STATES)]).astype(np.int32)
    weight = generator.normal(size=index.shape) * (generator.random(index.shape) < 0.8)
    weight[:, 0] = 1
    return Features(index, weight / np.linalg.norm(weight, axis=1, keepdims=True), size)


class PlainModel:
    """Algorithm 4 in loops over features. Sums are taken from the first feature to the last."""

    def __init__(self, features: Features, value: float, allowed: np.ndarray):
        self.features, self.allowed = features, allowed  # [A, n]
        n, actions = features.size, len(allowed)
        share = F(value) / max(features.weight.sum(1), key=abs)
        self.theta, self.waits = np.full(n, share), np.zeros(n, F)
        self.follows, self.earned = np.zeros((actions, n, n), F), np.full((actions, n), share)  # F_a[k, j], b_a[j]

    def phi(self, state: int) -> list[tuple[int, F]]:
        return list(zip(self.features.index[state].tolist(), self.features.weight[state], strict=True))

    def value(self, state: int) -> F:
        total = F(0)
        for j, weight in self.phi(state):
            total += weight * self.theta[j]
        return total

    def backed_up(self, j: int) -> np.ndarray:
        terms = np.concatenate([self.earned[:, j, None], self.theta * self.follows[:, :, j]], axis=1)
        return np.cumsum(terms, axis=1)[:, -1]

    def action_values(self, state: int) -> np.ndarray:
        total = np.zeros(len(self.earned), F)
        for j, weight in self.phi(state):
            total += weight * self.backed_up(j)
        return total

    def learn(self, state: int, action: int, reward: F, after: int, discount: F, size: F, model_size: F) -> None:
        phi, n = self.phi(state), self.features.size
        delta = reward + discount * self.value(after) - self.value(state)
        for j, weight in phi:
            self.theta[j] += weight * (size * delta)
            self.waits[j] = max(self.waits[j], abs(weight * delta))
        predicted, earned, target = np.zeros(n, F), F(0), np.zeros(n, F)
        for j, weight in phi:
            predicted += weight * self.follows[action, :, j]
            earned += weight * self.earned[action, j]
        for k, weight in self.phi(after):
            target[k] = discount * weight
        for j, weight in phi:
            self.follows[action, :, j] += (model_size * weight) * (target - predicted)
            self.earned[action, j] += (model_size * weight) * (reward - earned)

    def sweep(self, size: F) -> None:
        if self.waits.max() == 0:
            return
        i = int(np.argmax(self.waits))
        self.waits[i] = 0
        for j in range(self.features.size):
            if self.follows[:, i, j].any():
                self.renew(j, size)

    def renew(self, j: int, size: F) -> None:
        if self.allowed[:, j].any():
            delta = self.backed_up(j)[self.allowed[:, j]].max() - self.theta[j]
            self.theta[j] += size * delta
            self.waits[j] = max(self.waits[j], abs(delta))


class PlainDyna:
    def __init__(self, learner: LinearDyna, features: Features):
        self.learner = learner
        self.model = PlainModel(features, learner.initial_value, np.ones((4, features.size), np.bool_))
        self.draw = jax.jit(self.drawn)

    def drawn(self, key: jax.Array) -> jax.Array:
        positions = jnp.arange(self.learner.planning_steps, dtype=jnp.uint32)
        return jax.vmap(lambda i: random.words((key[0], key[1]), i, 1)[0])(positions)

    @property
    def q(self) -> np.ndarray:
        return np.concatenate([self.model.action_values(state) for state in range(STATES)])

    def begin(self, state: int, words: list[int]) -> int:
        explores = words[0] < self.learner.epsilon * 2**24
        return words[0] % 4 if explores else int(np.argmax(self.model.action_values(state)))

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        size, discount = F(self.learner.step_size), F(0) if terminated else F(self.learner.discount)
        self.model.learn(state, action, reward, after, discount, size, F(self.learner.model_step_size))
        if self.learner.planning == "mg":
            for _ in range(self.learner.planning_steps):
                self.model.sweep(size)
        else:
            for word in np.asarray(self.draw(np.array(words[1:], np.uint32))).tolist():
                self.model.renew(word % self.model.features.size, size)
        return self.begin(after, words)


@pytest.mark.parametrize(
    ("features", "planning"),
    [
        pytest.param(random_features(9, 3), "mg", id="dense-mg"),
        pytest.param(random_features(50, 1), "mg", id="one active-mg", marks=pytest.mark.slow),
        pytest.param(random_features(9, 3), "random", id="dense-random", marks=pytest.mark.slow),
        pytest.param(random_features(50, 1), "random", id="one active-random", marks=pytest.mark.slow),
    ],
)
def test_a_run_gives_the_numbers_of_plain_python(features: Features, planning: Any):
    learner = LinearDyna(features, 0.25, 0.5, 0.5, 0.75, -4.0, planning_steps=3, planning=planning)
    program = PlainDyna(learner, features)
    assert_runs_as(program, learner)
    assert len(np.unique(program.model.theta)) > 5


def test_one_feature_a_state_is_a_table():
    learner = LinearDyna(None, 0.5, 0.5, 0.125, 0.97, -25.0)
    assert_runs_as(PlainDyna(learner, state_features(SMALL)), learner)


@pytest.mark.slow
@pytest.mark.parametrize("planning", ["mg", "random"])
def test_a_seed_has_one_result_under_every_mapping(planning: Any):
    learner = LinearDyna(random_features(9, 3), discount=0.75, planning_steps=2, planning=planning)
    assert_same_under_every_mapping(learner, {"step_size": [0.1, 0.3], "model_step_size": [0.2]})


def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(LinearDyna(random_features(9, 3), initial_value=2.0, planning_steps=2))


@pytest.mark.parametrize(
    ("weights", "value"),
    [
        pytest.param([-1.0, -0.5], -10.0, id="negative"),
        pytest.param([0.75, 0.5], -10.0, id="positive"),
        pytest.param([0.5, -0.5], 0.0, id="cancel"),
        pytest.param([0.1 + 0.2, -0.3], 0.0, id="cancel but for rounding"),
        pytest.param([0.0, 0.0], 0.0, id="none"),
    ],
)
def test_all_begins_at_the_initial_value_where_weights_sum_to_the_most(weights: list[float], value: float):
    model = LinearModel.of(Features.from_dense(np.array([weights, [0.5 * weight for weight in weights]])), 2)
    tables = model.empty(jnp.float32(-10))
    context = outside_of_training(jnp.uint32(0), 0)
    active = model.features.of(jnp.int32(0))
    np.testing.assert_allclose([model.value(tables, active, context)], value, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(model.action_values(tables, active, context), value, rtol=1e-6, atol=1e-6)
