"""Flat tabular learners: one table of action values, one step of lookahead."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import put_row, take, take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.policy import HierarchicalPolicy, flat_policy
from hrljax.learners import updates
from hrljax.learners.base import Experience, Learner, LearnerState, Moment
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter


class ActionValueLearner(Learner):
    """A learner that acts epsilon-greedily in one table of action values."""

    epsilon: Hyperparameter
    discount: Hyperparameter

    num_words = 1
    num_begin_words = 1

    def action_values(self, tables: Any) -> Array:
        """``[S * A]`` float32, state by state."""
        return tables.values

    def prepare(self, env: AnyTabularEnvironment) -> int:
        return env.num_actions

    def begin(self, prepared: int, tables: Any, first: Array, words: tuple[Array, ...], moment: Moment) -> Any:
        return self.choose(row_of(self.action_values(tables), first, prepared), words[0], moment)

    def action(self, control: Any) -> Array:
        return control

    def greedy_policy(self, env: AnyTabularEnvironment, prepared: int, tables: Any, zero: Array) -> HierarchicalPolicy:
        actions = jnp.argmax(self.action_values(tables).reshape(-1, prepared), axis=-1).astype(jnp.int32)
        return flat_policy(env, actions)

    def choose(self, row: list[Array], word: Array, moment: Moment) -> Array:
        """The epsilon-greedy action (int32) for the action values of one state; uses one word."""
        return choices.epsilon_greedy(choices.greedy(row)[0], len(row), word, at_episode(self.epsilon, moment.episode))

    def target(self, reward: Array, bootstrap: Array, terminated: Array, moment: Moment) -> Array:
        """What a value is moved to: ``reward + discount * bootstrap``, no bootstrap where the episode terminated."""
        bootstrap = lax.select(terminated, jnp.float32(0), bootstrap)
        return updates.td_target(reward, at_episode(self.discount, moment.episode), bootstrap, moment.zero)


@dataclass(frozen=True)
class StepSizeLearner(ActionValueLearner):
    """An action-value learner that moves its values by a step size."""

    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)

    def initial_values(self, env: AnyTabularEnvironment) -> Array:
        """``[S * A]`` float32: a table of action values before the first episode."""
        return jnp.full(env.num_states * env.num_actions, jnp.asarray(self.initial_value, jnp.float32))

    def moved(self, values: Array, pair: Array, target: Array, moment: Moment) -> Array:
        """The values after that of one (state, action) pair has moved towards a target."""
        old, step_size = take_row(values, pair, 1), at_episode(self.step_size, moment.episode)
        return put_row(values, pair, updates.increment(old, target[None], step_size, moment.live, moment.zero))


@dataclass(frozen=True)
class _OneStep(StepSizeLearner):
    """Q-learning and SARSA(0) differ in the value that they bootstrap on, and in nothing else.

    The tables are the action values, the control is the next action.
    """

    _on_policy = False

    def action_values(self, tables: Array) -> Array:
        return tables

    def init(self, env: AnyTabularEnvironment, prepared: int) -> LearnerState:
        return LearnerState(self.initial_values(env), jnp.int32(0))

    def learn(
        self, prepared: int, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        row = row_of(state.tables, step.next_state, prepared)
        if self._on_policy:
            action = self.choose(row, words[0], moment)
            bootstrap = take(state.tables, step.next_state * prepared + action)
        else:
            action, bootstrap = choices.greedy(row)
        target = self.target(step.reward, bootstrap, step.terminated, moment)
        tables = self.moved(state.tables, step.state * prepared + step.action, target, moment)
        if not self._on_policy:
            action = self.choose(row_of(tables, step.next_state, prepared), words[0], moment)
        return LearnerState(tables, action)


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


def row_of(values: Array, state: Array, num_actions: int) -> list[Array]:
    """The action values of one state as scalars."""
    row = take_row(values, state * num_actions, num_actions)
    return [row[a] for a in range(num_actions)]
