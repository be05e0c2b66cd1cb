"""Dyna-Q and the outcomes that it keeps: against plain Python, and without planning."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hrljax
from hrljax.core import random
from hrljax.learners import samples
from hrljax.learners.base import Transition
from hrljax.learners.dyna import DynaQ
from tests.learners.python_run import (
    PAIRS,
    assert_learns_only_when_live,
    assert_runs_as,
    assert_same_run,
    assert_same_under_every_mapping,
    choose,
)

F = np.float32


class Dyna:
    """Outcomes in a list for each pair."""

    def __init__(self, learner: DynaQ):
        self.learner = learner
        self.q = np.full(PAIRS, learner.initial_value, F)
        self.outcomes: dict[int, list[tuple[F, int, bool]]] = {}  # in the order of first visits
        self.slots: dict[int, int] = {}
        self.draw = jax.jit(self.words_of_replays)

    def words_of_replays(self, key: jax.Array) -> jax.Array:
        """[planning_steps, 2]"""
        positions = jnp.arange(self.learner.planning_steps, dtype=jnp.uint32)
        return jax.vmap(lambda i: jnp.stack(random.words((key[0], key[1]), i, 2)))(positions)

    def begin(self, state: int, words: list[int]) -> int:
        return choose(self.q, state, words[0], self.learner.epsilon)

    def learn(self, state: int, action: int, reward: F, after: int, terminated: bool, words: list[int]) -> int:
        pair, kept = state * 4 + action, self.learner.outcomes_kept
        self.back_up(pair, reward, after, terminated)
        known, slot = self.outcomes.setdefault(pair, []), self.slots.get(pair, 0)
        known[slot : slot + 1] = [(reward, after, terminated)]
        self.slots[pair] = (slot + 1) % kept
        visited = list(self.outcomes)
        for which, outcome in np.asarray(self.draw(np.array(words[1:], np.uint32))).tolist():
            replayed = visited[which % len(visited)]
            known = self.outcomes[replayed]
            self.back_up(replayed, *known[outcome % len(known)])
        return choose(self.q, after, words[0], self.learner.epsilon)

    def back_up(self, pair: int, reward: F, after: int, terminated: bool) -> None:
        value = F(0) if terminated else self.q[after * 4 : after * 4 + 4].max()
        target = reward + F(self.learner.discount) * value
        self.q[pair] += F(self.learner.step_size) * (target - self.q[pair])


@pytest.mark.parametrize("kept", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_a_run_gives_the_numbers_of_plain_python(kept: int):
    learner = DynaQ(0.3, 0.125, 0.97, -25.0, planning_steps=4, outcomes_kept=kept)
    program = Dyna(learner)
    assert_runs_as(program, learner)
    assert max(map(len, program.outcomes.values())) == kept


@pytest.mark.parametrize("kept", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_without_planning_it_is_q_learning(kept: int):
    numbers = {"step_size": 0.3, "epsilon": 0.2, "discount": 0.97, "initial_value": -20.0}
    assert_same_run(DynaQ(**numbers, planning_steps=0, outcomes_kept=kept), hrljax.QLearning(**numbers))


@pytest.mark.slow
def test_a_seed_has_one_result_under_every_mapping():
    learner = DynaQ(planning_steps=3, outcomes_kept=2, discount=0.97, initial_value=-25.0)
    assert_same_under_every_mapping(learner, {"step_size": [0.1, 0.7]})


def test_the_latest_outcomes_are_kept():
    """Two slots for two states of two actions: pair 3 is seen three times, once not live."""
    steps = [(7.0, 0, False, True), (8.0, 1, False, True), (9.0, 1, False, False), (10.0, 1, True, True)]

    @jax.jit
    def run() -> samples.Samples:
        actual = samples.empty(2, 2, 2)
        for reward, after, terminated, live in steps:
            here, action = jnp.int32(1), jnp.int32(1)
            step = Transition(here, action, jnp.float32(reward), jnp.int32(after), jnp.bool_(terminated))
            actual = samples.recorded(actual, jnp.int32(3), step, 2, jnp.bool_(live))
        return actual

    seen, after, reward = run()
    assert seen.tolist() == [0, 0, 0, 3]
    assert after.reshape(2, 4).tolist() == [[2, 2, 2, 2], [2, 2, 2, 1]]  # 2: the end
    assert reward.reshape(2, 4).tolist() == [[0, 0, 0, 10], [0, 0, 0, 8]]


def test_a_step_that_is_not_live_changes_nothing():
    assert_learns_only_when_live(DynaQ(planning_steps=2, outcomes_kept=2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"planning_steps": -1}, "DynaQ: planning_steps must be an integer from 0 to 2147483647, got -1"),
        ({"planning_steps": 1.5}, r"DynaQ: planning_steps must be an integer from 0 to 2147483647, got 1\.5"),
        ({"outcomes_kept": 0}, "DynaQ: outcomes_kept must be an integer from 1 to 2147483647, got 0"),
        ({"step_size": 0.0}, r"DynaQ: step_size must be a finite number in \(0, 1\], got 0\.0"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str):
    with pytest.raises((TypeError, ValueError), match=message):
        DynaQ(**options)
