"""Policies of the root, the subtask that is not in the leaf cover: random, or planned on a model."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy import Hierarchy
from hrljax.learners import td
from hrljax.learners.base import Hyperparameter, Moment, Settings, hyperparameter
from hrljax.learners.task_tables import TaskTables, planning_points, tabulate
from hrljax.models.multi_time import expectation, updated_row
from hrljax.numerics import put_row, take, take_row
from hrljax.planners.abstract_dp import DecisionPoints, backup, sweep
from hrljax.random import threshold

ChildValue = Callable[[Array, Array], Array]
"""Value of a subtask (int32, counted without the root) from a state (int32) until it ends."""


class Decision(NamedTuple):
    """A choice of the root; int32 scalars."""

    task: Array  # the subtask, counted without the root
    point: Array  # number of the decision point, of a root that plans
    slot: Array  # position of the subtask among those that can be invoked


class Root(Settings):
    """How the root chooses among the subtasks that can be invoked; scalar, as `Learner`."""

    name: str

    @property
    def planning_interval(self) -> int:
        """Episodes between two calls of `plan`; 0 if this root does not plan."""
        return 0

    @abstractmethod
    def prepare(self, hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> Any:
        """Tables that the root needs, made once on the host."""

    @abstractmethod
    def init(self, prepared: Any) -> Any:
        """What the root has learned before the first episode."""

    @abstractmethod
    def choose(
        self, prepared: Any, tables: Any, child_value: ChildValue, state: Array, word: Array, epsilon: Array, moment: Moment
    ) -> tuple[Any, Decision]:
        """A choice in a state, and the tables with what was found out while choosing."""

    def observe(
        self, prepared: Any, tables: Any, decision: Decision, after: Array, terminated: Array, discount: Array, moment: Moment
    ) -> Any:
        """Learns that the chosen subtask ended in state `after`, the episode possibly with it.

        `discount` is the discount factor to the power of the subtask's steps.
        """
        return tables

    def plan(self, prepared: Any, tables: Any, child_value: ChildValue, moment: Moment) -> Any:
        """Plans between two episodes."""
        return tables


@dataclass(frozen=True)
class RandomRoot(Root):
    """Chooses uniformly among the subtasks that can be invoked, and learns nothing (thesis Fig. 4.2(b))."""

    name = "random"

    def prepare(self, hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> TaskTables:
        return tabulate(hierarchy, env)

    def init(self, prepared: TaskTables) -> tuple[()]:
        return ()

    def choose(
        self, prepared: TaskTables, tables: Any, child_value: ChildValue, state: Array, word: Array, epsilon: Array, moment: Moment
    ) -> tuple[Any, Decision]:
        count = take(jnp.asarray(prepared.root_counts), state)
        slot = (word % count.astype(jnp.uint32)).astype(jnp.int32)
        width = prepared.root_children.shape[1]
        task = take(jnp.asarray(prepared.root_children.ravel()), state * width + slot) - 1
        return tables, Decision(task, jnp.int32(0), slot)


class ModelTables(NamedTuple):
    """What a `ModelRoot` has learned."""

    rows: Array  # [X * K * Y * (M + 2)] float32: the multi-time model and each subtask's last known Q_r
    values: Array  # [X * Y] float32: value of each decision point


@dataclass(frozen=True)
class ModelRoot(Root):
    """Plans on a learned multi-time model of its subtasks, holding part of the state fixed (thesis 4.1.1).

    At every decision the values of the subtasks are backed up from the model and the best is
    invoked, or with the learner's `epsilon` any. Every `interval` episodes, `sweeps` sweeps over all
    decision points carry what changed further.

    Attributes:
        step_size: least step size of the model, in (0, 1]; the n-th trial uses ``1 / n`` if greater.
        unknown_value: value of a subtask that was never tried in a decision point.
        interval: episodes between two plans, at least 1.
        sweeps: Jacobi sweeps of one plan, at least 0.
    """

    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True)
    unknown_value: Hyperparameter = hyperparameter(-30.0)
    interval: int = 25
    sweeps: int = 4

    name = "model"

    def __post_init__(self) -> None:
        super().__post_init__()
        for option, least in (("interval", 1), ("sweeps", 0)):
            value = getattr(self, option)
            if not isinstance(value, int) or value < least:
                raise ValueError(f"ModelRoot: {option} must be an integer of at least {least}, got {value!r}")

    @property
    def planning_interval(self) -> int:
        return self.interval

    def prepare(self, hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> DecisionPoints:
        return planning_points(hierarchy, env)

    def init(self, prepared: DecisionPoints) -> ModelTables:
        rows = prepared.can_invoke.size * (prepared.num_outcomes + 2)
        values = jnp.full(prepared.num_points, jnp.asarray(self.unknown_value, jnp.float32))
        return ModelTables(jnp.zeros(rows, jnp.float32), values)

    def choose(
        self, prepared: DecisionPoints, tables: ModelTables, child_value: ChildValue, state: Array, word: Array, epsilon: Array, moment: Moment
    ) -> tuple[Any, Decision]:
        points = prepared
        point = take(jnp.asarray(points.point), state)
        x, y = point // points.num_y, point % points.num_y
        tasks, worth, allowed, until_ends = [], [], [], []
        for slot in range(points.num_slots):
            row, outcomes = self._row(points, tables, x, y, jnp.int32(slot))
            task = take(jnp.asarray(points.tasks), x * points.num_slots + slot)
            can_invoke = take(jnp.asarray(points.can_invoke.ravel()), (x * points.num_slots + slot) * points.num_y + y)
            follows = [take(tables.values, lax.max(outcomes[m], jnp.int32(0)) * points.num_y + y) for m in range(points.num_outcomes)]
            expected = expectation([row[m] for m in range(points.num_outcomes)], follows, moment.zero)
            until_end = child_value(task, state)
            worth.append(backup(row[-2] > 0, until_end, expected, can_invoke, self._unknown()))
            tasks.append(task)
            allowed.append(can_invoke)
            until_ends.append(lax.select(moment.live, until_end, row[-1]))
        rows = tables.rows
        for slot, until_end in enumerate(until_ends):
            rows = put_row(rows, self._row_start(points, x, y, jnp.int32(slot)) + (points.num_outcomes + 1), until_end[None])
        best, value = td.greedy(worth)
        kept = lax.select(moment.live, value, take(tables.values, point))
        values = put_row(tables.values, point, kept[None])
        slot = lax.select(word < threshold(epsilon), _nth_allowed(allowed, word), best)
        return ModelTables(rows, values), Decision(td.pick(tasks, slot), point, slot)

    def observe(
        self, prepared: DecisionPoints, tables: ModelTables, decision: Decision, after: Array, terminated: Array, discount: Array, moment: Moment
    ) -> ModelTables:
        points = prepared
        x, y = decision.point // points.num_y, decision.point % points.num_y
        row, outcomes = self._row(points, tables, x, y, decision.slot)
        weight = lax.select(terminated, jnp.float32(0), discount)
        outcome = take(jnp.asarray(points.planning), after)
        step_size = jnp.asarray(self.step_size, jnp.float32)
        new = updated_row(row[:-1], outcomes, outcome, weight, step_size, moment.live, moment.zero)
        return tables._replace(rows=put_row(tables.rows, self._row_start(points, x, y, decision.slot), new))

    def plan(self, prepared: DecisionPoints, tables: ModelTables, child_value: ChildValue, moment: Moment) -> ModelTables:
        rows = tables.rows.reshape(-1, prepared.num_outcomes + 2)
        model, until_end = rows[:, :-1], rows[:, -1]
        values = lax.fori_loop(
            0, self.sweeps, lambda _, v: sweep(prepared, model, until_end, v, self._unknown(), moment.zero), tables.values
        )
        return tables._replace(values=values)

    def _unknown(self) -> Array:
        return jnp.asarray(self.unknown_value, jnp.float32)

    def _row_start(self, points: DecisionPoints, x: Array, y: Array, slot: Array) -> Array:
        return ((x * points.num_slots + slot) * points.num_y + y) * (points.num_outcomes + 2)

    def _row(self, points: DecisionPoints, tables: ModelTables, x: Array, y: Array, slot: Array) -> tuple[Array, Array]:
        """The model's row of a subtask and the planning parts that its entries stand for."""
        outcomes_at = (x * points.num_slots + slot) * points.num_outcomes
        outcomes = take_row(jnp.asarray(points.outcomes), outcomes_at, points.num_outcomes)
        return take_row(tables.rows, self._row_start(points, x, y, slot), points.num_outcomes + 2), outcomes


def _nth_allowed(allowed: list[Array], word: Array) -> Array:
    """A uniformly random one of the allowed slots (int32)."""
    count = sum((a.astype(jnp.uint32) for a in allowed), jnp.uint32(0))
    skip = word % lax.max(count, jnp.uint32(1))
    chosen, seen = jnp.int32(0), jnp.uint32(0)
    for slot, is_allowed in enumerate(allowed):
        chosen = lax.select(is_allowed & (seen == skip), jnp.int32(slot), chosen)
        seen = seen + is_allowed.astype(jnp.uint32)
    return chosen
