"""Flat tabular learners: one table of action values, one step of lookahead."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from hrljax.envs.base import TabularEnvironment
from hrljax.evaluate import HierarchicalPolicy, flat_policy
from hrljax.learners import td
from hrljax.learners.base import Experience, Hyperparameter, Learner, LearnerState, Moment, at_episode, hyperparameter
from hrljax.numerics import put_row, take_row


@dataclass(frozen=True)
class _OneStep(Learner):
    """Q-learning and SARSA(0) differ in the value that they bootstrap on, and in nothing else."""

    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)

    num_words = 1
    num_begin_words = 1
    _on_policy = False

    def prepare(self, env: TabularEnvironment[Any, Any]) -> int:
        return env.num_actions

    def init(self, env: TabularEnvironment[Any, Any], prepared: int) -> LearnerState:
        """Tables: ``[S * A]`` float32 action values, state by state. Control: the next action."""
        value = jnp.asarray(self.initial_value, jnp.float32)
        return LearnerState(jnp.full(env.num_states * prepared, value), jnp.int32(0))

    def begin(self, prepared: int, tables: Array, first: Array, words: tuple[Array, ...], moment: Moment) -> Array:
        return self._choose(_row(tables, first, prepared), words[0], moment)

    def action(self, control: Array) -> Array:
        return control

    def learn(
        self, prepared: int, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        row = _row(state.tables, step.next_state, prepared)
        if self._on_policy:
            action = self._choose(row, words[0], moment)
            bootstrap = td.pick(row, action)
        else:
            action, bootstrap = td.greedy(row)
        bootstrap = lax.select(step.terminated, jnp.float32(0), bootstrap)
        target = td.td_target(step.reward, at_episode(self.discount, moment.episode), bootstrap, moment.zero)
        at = step.state * prepared + step.action
        old = take_row(state.tables, at, 1)
        new = td.increment(old, target[None], at_episode(self.step_size, moment.episode), moment.live, moment.zero)
        tables = put_row(state.tables, at, new)
        if not self._on_policy:
            action = self._choose(_row(tables, step.next_state, prepared), words[0], moment)
        return LearnerState(tables, action)

    def greedy_policy(
        self, env: TabularEnvironment[Any, Any], prepared: int, tables: Array, zero: Array
    ) -> HierarchicalPolicy:
        actions = jnp.argmax(tables.reshape(-1, prepared), axis=-1).astype(jnp.int32)
        return flat_policy(env, actions)

    def _choose(self, row: list[Array], word: Array, moment: Moment) -> Array:
        return td.epsilon_greedy(td.greedy(row)[0], len(row), word, at_episode(self.epsilon, moment.episode))


@dataclass(frozen=True)
class QLearning(_OneStep):
    """Q-learning (Watkins 1989; thesis 2.3.1) with epsilon-greedy behaviour.

    Attributes:
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a uniformly random action, or a schedule of the episode.
        discount: in [0, 1].
        initial_value: of every state and action.
    """

    name = "Q-learning"


@dataclass(frozen=True)
class SARSA(_OneStep):
    """SARSA(0) (Rummery and Niranjan 1994; thesis 2.3.1): bootstraps on the action that it takes next.

    Attributes: as `QLearning`.
    """

    name = "SARSA(0)"
    _on_policy = True


def _row(q: Array, state: Array, num_actions: int) -> list[Array]:
    """The action values of one state as scalars."""
    row = take_row(q, state * num_actions, num_actions)
    return [row[a] for a in range(num_actions)]
