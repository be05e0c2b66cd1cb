"""A root that plans on a linear model of its subtasks: linear Dyna over subtasks instead of actions."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core import checks
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.learners.base import Context, Transition
from hrljax.learners.features import Features, features_for
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.linear_model import LinearModel, LinearTables, Outcome
from hrljax.learners.roots.smdp import SMDPPrepared, SMDPRoot


@dataclass(frozen=True)
class LinearRoot(SMDPRoot):
    """Linear Dyna (Sutton, Szepesvari, Geramifard and Bowling 2008) whose actions are the subtasks.

    As `hrljax.LinearDyna`, with ``r`` the discounted reward of a subtask until it ends, and ``g`` the discount to
    the power of its steps. The model is as biased as the features are coarse; what they miss, the subtasks of HORDQ
    under it have to make good.

    Attributes:
        features: of states, `hrljax.variable_features` and so on; one a state if None.
        step_size: alpha in (0, 1], or a schedule of the episode; of values.
        model_step_size: beta in (0, 1], or a schedule of the episode.
        unknown_value: of every state, and of a subtask that was never tried; as `hrljax.LinearDyna.initial_value`.
        planning_steps: features swept from after every subtask, at least 0.
    """

    features: Features | None = None
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    model_step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    unknown_value: Hyperparameter = hyperparameter(-30.0)
    planning_steps: int = 1

    name = "linear"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.features is not None:
            what = "None or Features such as variable_features(env)"
            checks.instance("LinearRoot: features", self.features, Features, what)
        self._check_integer("planning_steps", 0)

    def model_over(self, env: AnyTabularEnvironment, invocable: np.ndarray) -> LinearModel:
        features = features_for(env, self.features)
        has = features.dense().T != 0
        return LinearModel(features, invocable.shape[1], (has @ invocable).ravel())

    def init(self, prepared: SMDPPrepared[LinearModel]) -> LinearTables:
        return prepared.model.empty(jnp.asarray(self.unknown_value, jnp.float32))

    def worth_of(self, model: LinearModel, tables: LinearTables, state: Array, context: Context) -> list[Array]:
        return model.action_values(tables, model.features.of(state), context)

    def after(
        self, model: LinearModel, tables: LinearTables, step: Transition, discount: Array, context: Context
    ) -> LinearTables:
        size, model_size = (
            jnp.asarray(at_episode(number, context.episode), jnp.float32)
            for number in (self.step_size, self.model_step_size)
        )
        before, after = model.features.of(step.state), model.features.of(step.next_state)
        seen = Outcome(before, step.action, step.reward, after, discount)
        tables = model.learned(tables, seen, size, model_size, context)
        return model.swept(tables, self.planning_steps, size, context)
