"""Linear Dyna: a linear model of linear features, planned with by prioritized sweeping."""

from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.counting import count
from hrljax.core.random import word_block
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.policy import HierarchicalPolicy, flat_policy
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words, outside_of_training
from hrljax.learners.features import Features, features_for, one_each
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option
from hrljax.learners.linear_model import LinearModel, LinearTables, Outcome

Planning = Literal["mg", "random"]


@dataclass(frozen=True)
class LinearDyna(Learner[LinearModel, LinearTables, Array]):
    """Linear Dyna with MG prioritized sweeping (Sutton, Szepesvari, Geramifard and Bowling 2008, Algorithm 4).

    It takes ``argmax_a b_a^T phi + g theta^T F_a phi``, or any action, and learns from every step

        delta <- r + g theta^T phi' - theta^T phi,    theta <- theta + alpha delta phi
        F_a <- F_a + beta (phi' - F_a phi) phi^T,    b_a <- b_a + beta (r - b_a^T phi) phi

    Then `planning_steps` backups follow, see `hrljax.learners.linear_model.LinearModel.swept`. With ``"random"`` they
    are of features drawn uniformly (the paper's Dyna-random). With one action it evaluates a policy, the paper's
    Algorithm 3, and its limit is the solution of least-squares TD.

    The model takes ``n * n * A`` numbers for n features, and planning time in proportion.

    Attributes:
        features: of the environment's states, `hrljax.variable_features` and so on; one a state if None, with which
            values and models are tables.
        step_size: alpha in (0, 1], or a schedule of the episode; of values, from real steps and planned ones.
        model_step_size: beta in (0, 1], or a schedule of the episode.
        epsilon: probability of a uniformly random action, or a schedule of the episode. Else it takes the best one.
        discount: g in [0, 1].
        initial_value: of every state and every action, where the weights of features sum to the most that they do. All
            begin at 0 if they sum to 0 in every state.
        planning_steps: features swept from, or backed up, after every real step; at least 0.
        planning: ``"mg"`` or ``"random"``.
        ties: as of `QLearning`.
    """

    features: Features | None = None
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    model_step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    planning_steps: int = 1
    planning: Planning = "mg"
    ties: choices.Ties = later_option("first")

    name = "linear Dyna"
    num_begin_words = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.features is not None:
            what = "None or Features such as variable_features(env)"
            checks.instance("LinearDyna: features", self.features, Features, what)
        self._check_integer("planning_steps", 0)
        self._check_choice("planning", Planning)
        self._check_choice("ties", choices.Ties)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on fields)
        return 3 if self.planning == "random" and self.planning_steps else 1

    def prepare(self, env: AnyTabularEnvironment) -> LinearModel:
        """Raises ValueError if the features are not over the environment's states."""
        return LinearModel.of(features_for(env, self.features), env.num_actions)

    def init(self, env: AnyTabularEnvironment, prepared: LinearModel) -> LearnerState:
        return LearnerState(prepared.empty(jnp.asarray(self.initial_value, jnp.float32)), jnp.int32(0))

    def action_values(self, tables: LinearTables) -> Array:
        """``[S * A]`` float32, state by state."""
        size = len(tables.theta)
        features = one_each(size) if self.features is None else self.features
        model = LinearModel.of(features, len(tables.earned) // size)
        return model.all_action_values(tables, outside_of_training(jnp.uint32(0), 0)).ravel()

    def begin(self, prepared: LinearModel, tables: LinearTables, first: Array, words: Words, context: Context) -> Array:
        return self._chosen(prepared, tables, first, words[0], context)

    def action(self, control: Array) -> Array:
        return control

    def learn(
        self, prepared: LinearModel, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        model, tables = prepared, state.tables
        before, after = model.features.of(transition.state), model.features.of(transition.next_state)
        size, model_size, discount = (
            jnp.asarray(at_episode(number, context.episode), jnp.float32)
            for number in (self.step_size, self.model_step_size, self.discount)
        )
        discount = lax.select(transition.terminated, jnp.float32(0), discount)
        seen = Outcome(before, transition.action, transition.reward, after, discount)
        tables = model.learned(tables, seen, size, model_size, context)
        if self.planning_steps and self.planning == "mg":
            tables = model.swept(tables, self.planning_steps, size, context)
        elif self.planning_steps:
            drawn = word_block((words[1], words[2]), count(), self.planning_steps, 1)
            tables = model.replayed(tables, drawn, self.planning_steps, size, context)
        action = self._chosen(model, tables, transition.next_state, words[0], context)
        return LearnerState(tables, action)

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: LinearModel, tables: LinearTables, context: Context
    ) -> HierarchicalPolicy:
        actions = jnp.argmax(prepared.all_action_values(tables, context), axis=-1).astype(jnp.int32)
        return flat_policy(env, actions)

    def _chosen(self, model: LinearModel, tables: LinearTables, state: Array, word: Array, context: Context) -> Array:
        values = model.action_values(tables, model.features.of(state), context)
        epsilon = at_episode(self.epsilon, context.episode)
        greedy = choices.greedy_by(self.ties, values, choices.greedy(values)[0], word)
        return choices.epsilon_greedy(greedy, len(values), word, epsilon)
