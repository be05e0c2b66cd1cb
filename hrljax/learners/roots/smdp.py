"""Roots that learn as flat learners do, with subtasks as their actions (a semi-Markov decision process)."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.flags import Flag
from hrljax.core.numerics import take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import tabulate
from hrljax.learners.base import Context, Transition
from hrljax.learners.roots.base import ChildValue, Decision, Question, SubtaskRoot

Model = TypeVar("Model")


@dataclass(frozen=True, eq=False)
class SMDPPrepared(Generic[Model]):
    """What a root needs of the environment; C subtasks."""

    model: Model  # what its model is made of
    invocable: np.ndarray  # [S * C] bool
    num_tasks: int  # C


class SMDPMemory(NamedTuple):
    """Where a root decided, and what happened since."""

    state: Array  # int32
    reward: Array  # float32: discounted sum of the rewards so far
    discount: Array  # float32: of the subtask's steps so far


class SMDPRoot(SubtaskRoot[SMDPPrepared[Any], Any, SMDPMemory]):
    """A root to which all that a subtask did is one step. Invokes the best subtask, or by `epsilon` any."""

    @abstractmethod
    def model_over(self, env: AnyTabularEnvironment, invocable: np.ndarray) -> Any:
        """What its model is made of, for subtasks that can be invoked where `invocable` (``[S, C]`` bool) says."""

    @abstractmethod
    def worth_of(self, model: Any, tables: Any, state: Array, context: Context) -> list[Array]:
        """The value of each subtask in a state, float32 scalars."""

    @abstractmethod
    def after(self, model: Any, tables: Any, step: Transition, discount: Array, context: Context) -> Any:
        """The tables after a subtask ended, the episode possibly with it; as they were where `context` does not learn.

        Args:
            model: what `model_over` made.
            tables: those before.
            step: from where it was invoked to where it ended; its action is the subtask, its reward the discounted sum.
            discount: float32, to the power of its steps; 0 if the episode terminated.
            context: when that is.
        """

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> SMDPPrepared[Any]:
        tables = tabulate(hierarchy, env)
        invocable = np.ascontiguousarray((tables.active & tables.root_invokes[:, None])[1:].T)
        return SMDPPrepared(self.model_over(env, invocable), invocable.ravel(), invocable.shape[1])

    def begin(
        self, prepared: SMDPPrepared[Any], tables: Any, asked: Question, context: Context
    ) -> Decision[SMDPMemory]:
        state, count = asked.state, prepared.num_tasks
        row = take_row(jnp.asarray(prepared.invocable), state * count, count)
        can_invoke = [row[task] for task in range(count)]
        never = jnp.float32(-np.inf)
        values = self.worth_of(prepared.model, tables, state, context)
        worth = [lax.select(can, value, never) for can, value in zip(can_invoke, values, strict=True)]
        explores = asked.word < threshold(asked.epsilon)
        task = lax.select(explores, choices.nth_allowed(can_invoke, asked.word), choices.greedy(worth)[0])
        return Decision(task, SMDPMemory(state, jnp.float32(0), jnp.float32(1)))

    def step(
        self,
        prepared: SMDPPrepared[Any],
        tables: Any,
        decision: Decision[SMDPMemory],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Question,
        context: Context,
    ) -> tuple[Any, Decision[SMDPMemory]]:
        before, ended = decision.memory, jnp.asarray(ended)
        earned = before.reward + context.product(before.discount, transition.reward)
        decision = decision._replace(memory=before._replace(reward=earned, discount=before.discount * discount))
        memory = decision.memory
        of_subtask = transition._replace(state=memory.state, action=decision.task, reward=memory.reward)
        follows = lax.select(transition.terminated, jnp.float32(0), memory.discount)
        tables = context.when(
            ended | transition.terminated,
            lambda tables, context: self.after(prepared.model, tables, of_subtask, follows, context),
            tables,
        )
        decides = ended & ~transition.terminated & context.learns
        return tables, lax.cond(decides, lambda: self.begin(prepared, tables, asked, context), lambda: decision)

    def probabilities(
        self, prepared: SMDPPrepared[Any], tables: Any, child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        task = self.begin(prepared, tables, Question(state, jnp.uint32(0), jnp.float32(0), child_value), context).task
        return (jnp.arange(prepared.num_tasks, dtype=jnp.int32) == task).astype(jnp.float32)
