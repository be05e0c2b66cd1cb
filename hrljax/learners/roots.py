"""Policies of the root, the subtask that is not in the leaf cover: random, or planned on a model."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy import Hierarchy
from hrljax.learners.base import Moment, Settings
from hrljax.learners.task_tables import TaskTables
from hrljax.numerics import take


class Decision(NamedTuple):
    """A choice of the root; int32 scalars."""

    task: Array  # the subtask, counted without the root
    point: Array  # number of the state among those where the root decides, if the root counts them
    slot: Array  # position of the subtask among those that could be invoked


class Root(Settings):
    """How the root chooses among the subtasks that can be invoked."""

    @property
    def planning_interval(self) -> int:
        return 0

    @staticmethod
    @abstractmethod
    def prepare(hierarchy: Hierarchy, tasks: TaskTables, env: TabularEnvironment[Any, Any]) -> Any:
        """Tables that the root needs, on the host."""

    @abstractmethod
    def init(self, prepared: Any) -> Any: ...

    @abstractmethod
    def choose(self, prepared, tables, value, state, word, epsilon, moment) -> tuple[Decision, Array]: ...

    def observe(self, prepared, tables, decision, after, terminated, discount, moment):
        return tables

    def record(self, tables, decision, backup, moment):
        return tables


class _Children(NamedTuple):
    tasks: np.ndarray  # [S * K] int32, counted without the root
    counts: np.ndarray  # [S] int32
    width: int


@dataclass(frozen=True)
class RandomRoot(Root):
    """Chooses uniformly among the subtasks that can be invoked, and learns nothing."""

    @staticmethod
    def prepare(hierarchy: Hierarchy, tasks: TaskTables, env: TabularEnvironment[Any, Any]) -> _Children:
        return _Children((tasks.root_children - 1).ravel(), tasks.root_counts, tasks.root_children.shape[1])

    def init(self, prepared: _Children) -> tuple[()]:
        return ()

    def choose(self, prepared, tables, value, state, word, epsilon, moment):
        count = take(jnp.asarray(prepared.counts), state)
        slot = (word % count.astype(jnp.uint32)).astype(jnp.int32)
        task = take(jnp.asarray(prepared.tasks), state * prepared.width + slot)
        return Decision(task, jnp.int32(0), slot), jnp.float32(0)
