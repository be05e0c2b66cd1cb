"""Flat tabular learners: one table of action values, one step of lookahead."""

from dataclasses import dataclass
from typing import Any, Generic

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take, take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.policy import HierarchicalPolicy, flat_policy
from hrljax.learners.base import Context, Learner, LearnerState, Prepared, Reported, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option, report_option
from hrljax.learners.updates import Move, moved, td_target


class EpsilonGreedyLearner(Learner[Prepared, Any, Any], Generic[Prepared]):
    """A learner that acts epsilon-greedily in a table of action values; its control is the next action."""

    epsilon: Hyperparameter
    discount: Hyperparameter
    ties: choices.Ties = "first"

    num_words = 1
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("ties", choices.Ties)

    def action_values(self, tables: Any) -> Array:
        """``[S * A]`` float32, state by state."""
        return tables.values

    def action(self, control: Any) -> Array:
        return control

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: Prepared, tables: Any, context: Context
    ) -> HierarchicalPolicy:
        actions = jnp.argmax(self.action_values(tables).reshape(-1, env.num_actions), axis=-1).astype(jnp.int32)
        return flat_policy(env, actions)

    def choose(self, row: list[Array], word: Array, context: Context) -> Array:
        """The epsilon-greedy action (int32) for the action values of one state; uses one word.

        Which action a word means depends on whether it makes the learner explore: to each case it is a word of its own.
        """
        greedy = choices.greedy_by(self.ties, row, choices.greedy(row)[0], word)
        return choices.epsilon_greedy(greedy, len(row), word, at_episode(self.epsilon, context.episode))


class ActionValueLearner(EpsilonGreedyLearner[int]):
    """A learner that acts epsilon-greedily in one table of action values."""

    def prepare(self, env: AnyTabularEnvironment) -> int:
        return env.num_actions

    def begin(self, prepared: int, tables: Any, first: Array, words: Words, context: Context) -> Any:
        return self.choose(row_of(self.action_values(tables), first, prepared), words[0], context)

    def target(self, reward: Array, bootstrap: Array, terminated: Array, context: Context) -> Array:
        """What a value is moved to: ``reward + discount * bootstrap``, no bootstrap where the episode terminated."""
        bootstrap = lax.select(terminated, jnp.float32(0), bootstrap)
        return td_target(reward, context.discounted(at_episode(self.discount, context.episode)), bootstrap)


@dataclass(frozen=True)
class StepSizeLearner(ActionValueLearner):
    """An action-value learner that moves its values by a step size."""

    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    ties: choices.Ties = later_option("first")

    def initial_values(self, env: AnyTabularEnvironment) -> Array:
        """``[S * A]`` float32: a table of action values before the first episode."""
        return jnp.full(env.num_states * env.num_actions, jnp.asarray(self.initial_value, jnp.float32))

    def moved(self, values: Array, pair: Array, target: Array, context: Context) -> Array:
        """The values after that of one (state, action) pair has moved towards a target."""
        step_size = at_episode(self.step_size, context.episode)
        return moved(values, [Move(pair, target[None], True)], step_size, context)


@dataclass(frozen=True)
class _OneStep(StepSizeLearner):
    """Q-learning and SARSA(0) differ in the value that they bootstrap on, and in nothing else.

    The tables are the action values, the control is the next action.
    """

    report_td_error: bool = report_option()

    _on_policy = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_flag("report_td_error")

    @property
    def reports(self) -> tuple[str, ...]:
        return ("td_error",) if self.report_td_error else ()

    def action_values(self, tables: Array) -> Array:
        return tables

    def init(self, env: AnyTabularEnvironment, prepared: int) -> LearnerState:
        return LearnerState(self.initial_values(env), jnp.int32(0))

    def learn(
        self, prepared: int, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState | Reported:
        row = row_of(state.tables, transition.next_state, prepared)
        if self._on_policy:
            action = self.choose(row, words[0], context)
            bootstrap = take(state.tables, transition.next_state * prepared + action)
        else:
            action, bootstrap = choices.greedy(row)
        target = self.target(transition.reward, bootstrap, transition.terminated, context)
        pair = transition.state * prepared + transition.action
        report = (jnp.abs(target - take(state.tables, pair)),) if self.report_td_error else ()
        tables = self.moved(state.tables, pair, target, context)
        if not self._on_policy:
            action = self.choose(row_of(tables, transition.next_state, prepared), words[0], context)
        learned = LearnerState(tables, action)
        return Reported(learned, report) if report else learned


@dataclass(frozen=True)
class QLearning(_OneStep):
    """Q-learning (Watkins 1989; thesis 2.3.1) with epsilon-greedy behaviour.

    Attributes:
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a uniformly random action, or a schedule of the episode. Else it takes the best one.
        discount: in [0, 1].
        initial_value: of every state and action.
        ties: of equally good actions it takes the ``"first"``, or a ``"random"`` one, each as likely as the others.
            What is greedy without training (pictures, exact values) takes the first.
        report_td_error: whether results have the column ``td_error``, the mean absolute error of a step.
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
