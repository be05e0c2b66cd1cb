"""A root that plans on a linear model of its subtasks: linear Dyna over subtasks instead of actions."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.flags import Flag
from hrljax.core.numerics import take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import Context, Transition
from hrljax.learners.features import Features, features_for
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.linear_model import LinearModel, LinearTables, Outcome
from hrljax.learners.roots.base import ChildValue, Decision, Question, SubtaskRoot


@dataclass(frozen=True, eq=False)
class LinearRootTables:
    """What a `LinearRoot` needs of the environment; C subtasks."""

    model: LinearModel
    invocable: np.ndarray  # [S * C] bool


class LinearMemory(NamedTuple):
    """Where a `LinearRoot` decided, and what happened since."""

    state: Array  # int32
    reward: Array  # float32: discounted sum of the rewards so far
    discount: Array  # float32: of the subtask's steps so far


@dataclass(frozen=True)
class LinearRoot(SubtaskRoot[LinearRootTables, LinearTables, LinearMemory]):
    """Linear Dyna (Sutton, Szepesvari, Geramifard and Bowling 2008) whose actions are the subtasks.

    As `hrljax.LinearDyna`, with ``r`` the discounted reward of a subtask until it ends, and ``g`` the discount to
    the power of its steps. The model is as biased as the features are coarse; what they miss, the subtasks of HORDQ
    under it have to make good.

    Attributes:
        features: of states, `hrljax.variable_features` and so on; one a state if None.
        step_size: alpha in (0, 1], or a schedule of the episode; of values.
        model_step_size: beta in (0, 1], or a schedule of the episode.
        unknown_value: of every state, and of a subtask that was never tried.
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

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> LinearRootTables:
        features, tables = features_for(env, self.features), tabulate(hierarchy, env)
        invocable = (tables.active & tables.root_invokes[:, None])[1:].T
        allowed = features.dense().T != 0
        model = LinearModel(features, invocable.shape[1], (allowed @ invocable).ravel())
        return LinearRootTables(model, np.ascontiguousarray(invocable).ravel())

    def init(self, prepared: LinearRootTables) -> LinearTables:
        return prepared.model.empty(jnp.asarray(self.unknown_value, jnp.float32))

    def begin(
        self, prepared: LinearRootTables, tables: LinearTables, asked: Question, context: Context
    ) -> Decision[LinearMemory]:
        model, state = prepared.model, asked.state
        row = take_row(jnp.asarray(prepared.invocable), state * model.num_actions, model.num_actions)
        can_invoke = [row[task] for task in range(model.num_actions)]
        never = jnp.float32(-np.inf)
        values = model.action_values(tables, model.features.of(state), context)
        worth = [lax.select(can, value, never) for can, value in zip(can_invoke, values, strict=True)]
        explores = asked.word < threshold(asked.epsilon)
        task = lax.select(explores, choices.nth_allowed(can_invoke, asked.word), choices.greedy(worth)[0])
        return Decision(task, LinearMemory(state, jnp.float32(0), jnp.float32(1)))

    def step(
        self,
        prepared: LinearRootTables,
        tables: LinearTables,
        decision: Decision[LinearMemory],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Question,
        context: Context,
    ) -> tuple[LinearTables, Decision[LinearMemory]]:
        before, ended = decision.memory, jnp.asarray(ended)
        earned = before.reward + context.product(before.discount, transition.reward)
        decision = decision._replace(memory=before._replace(reward=earned, discount=before.discount * discount))
        tables = context.when(
            ended | transition.terminated,
            lambda tables, context: self._observed(prepared.model, tables, decision, transition, context),
            tables,
        )
        decides = ended & ~transition.terminated & context.learns
        return tables, lax.cond(decides, lambda: self.begin(prepared, tables, asked, context), lambda: decision)

    def probabilities(
        self, prepared: LinearRootTables, tables: LinearTables, child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        asked = Question(state, jnp.uint32(0), jnp.float32(0), child_value)
        task = self.begin(prepared, tables, asked, context).task
        return (jnp.arange(prepared.model.num_actions, dtype=jnp.int32) == task).astype(jnp.float32)

    def _observed(
        self,
        model: LinearModel,
        tables: LinearTables,
        decided: Decision[LinearMemory],
        transition: Transition,
        context: Context,
    ) -> LinearTables:
        """The tables after the subtask ended, the episode possibly with it."""
        memory = decided.memory
        discount = lax.select(transition.terminated, jnp.float32(0), memory.discount)
        size, model_size = (
            jnp.asarray(at_episode(number, context.episode), jnp.float32)
            for number in (self.step_size, self.model_step_size)
        )
        before, after = model.features.of(memory.state), model.features.of(transition.next_state)
        tables = model.learned(
            tables, Outcome(before, decided.task, memory.reward, after, discount), size, model_size, context
        )
        return model.swept(tables, self.planning_steps, size, context)
