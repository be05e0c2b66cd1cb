"""A root that plans on a learned model of its subtasks (thesis 4.1.1)."""

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.flags import Flag
from hrljax.core.numerics import expectation, put_row, put_rows, stage, take
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.learners.base import Context, Transition
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.roots.backups import backup, sweep
from hrljax.learners.roots.base import ChildValue, Decision, Question, SubtaskRoot
from hrljax.learners.roots.decision_points import DecisionPoints, planning_points
from hrljax.learners.roots.multi_time_model import updated


class ModelTables(NamedTuple):
    """What a `ModelRoot` has learned; X, K, M and Y as in `DecisionPoints`."""

    model: Array  # [X * K * (M + 1) * Y] float32, see `hrljax.learners.roots.multi_time_model`
    values: Array  # [X * Y] float32: value of each decision point
    until_end: Array  # [X * K * Y] float32: Q_r of each subtask when the root last decided there, episode starts aside


class Memory(NamedTuple):
    """Where a `ModelRoot` decided."""

    point: Array  # int32: number of the decision point
    slot: Array  # int32: position of the subtask among those that can be invoked
    discount: Array  # float32: of the subtask's steps so far


Values: TypeAlias = tuple[Array, ...]
"""Float32 scalars: the value of a decision point, then each of its subtasks' value until it ends."""


@dataclass(frozen=True)
class ModelRoot(SubtaskRoot[DecisionPoints, ModelTables, Memory]):
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
    interval: int = 5
    sweeps: int = 5

    name = "model"
    uses_child_values = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("interval", 1)
        self._check_integer("sweeps", 0)

    @property
    def planning_interval(self) -> int:
        return self.interval if self.sweeps else 0

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> DecisionPoints:
        return planning_points(hierarchy, env)

    def init(self, prepared: DecisionPoints) -> ModelTables:
        points = prepared
        entries = len(points.tasks) * (points.num_outcomes + 1) * points.num_y
        values = jnp.full(points.num_points, self._unknown())
        return ModelTables(jnp.zeros(entries, jnp.float32), values, jnp.zeros(points.can_invoke.size, jnp.float32))

    def begin(
        self, prepared: DecisionPoints, tables: ModelTables, asked: Question, context: Context
    ) -> Decision[Memory]:
        decision, _ = self._decided(prepared, tables, asked, context)
        return decision

    def step(
        self,
        prepared: DecisionPoints,
        tables: ModelTables,
        decision: Decision[Memory],
        transition: Transition,
        ended: Flag,
        discount: Array,
        asked: Question,
        context: Context,
    ) -> tuple[ModelTables, Decision[Memory]]:
        before = decision.memory
        before = before._replace(discount=before.discount * discount)
        decision, ended = decision._replace(memory=before), jnp.asarray(ended)
        tables = context.when(
            ended | transition.terminated,
            lambda tables, context: self._observed(prepared, tables, before, transition, context),
            tables,
        )
        decision, values = lax.cond(
            ended & ~transition.terminated & context.learns,
            lambda: self._decided(prepared, tables, asked, context),
            lambda: (decision, self._stored(prepared, tables, before)),
        )
        tables = self._recorded(prepared, tables, decision.memory, values)
        so_far = lax.select(ended, jnp.float32(1), before.discount)
        return tables, decision._replace(memory=decision.memory._replace(discount=so_far))

    def probabilities(
        self, prepared: DecisionPoints, tables: ModelTables, child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        asked = Question(state, jnp.uint32(0), jnp.float32(0), child_value)
        task = self.begin(prepared, tables, asked, context).task
        return (jnp.arange(prepared.num_tasks, dtype=jnp.int32) == task).astype(jnp.float32)

    def plan(self, prepared: DecisionPoints, tables: ModelTables, context: Context) -> ModelTables:
        points = prepared
        model = tables.model.reshape(-1, points.num_outcomes + 1, points.num_y)
        until_end = tables.until_end.reshape(-1, points.num_y)

        def again(_: Array, values: Array) -> Array:
            return sweep(points, model, until_end, values, self._unknown(), context.zero)

        values = lax.fori_loop(0, self.sweeps, again, tables.values.reshape(points.num_x, points.num_y)).ravel()
        return tables._replace(values=values)

    def _decided(
        self, points: DecisionPoints, tables: ModelTables, asked: Question, context: Context
    ) -> tuple[Decision[Memory], Values]:
        """The best subtask by the model, or any, and the values that were computed on the way (eq. 4.1)."""
        point = take(jnp.asarray(points.point), asked.state)
        tasks, worth, allowed, until_ends = [], [], [], []
        for slot in range(points.num_slots):
            pair = points.pair(point, slot)
            *model, count = (take(tables.model, entry) for entry in points.entries(pair, point))
            ends = points.outcomes_of(pair, unused=0)
            after = [take(tables.values, x * points.num_y + point % points.num_y) for x in ends]
            can_invoke = take(jnp.asarray(points.can_invoke.ravel()), points.at(pair, point))
            tasks.append(take(jnp.asarray(points.tasks), pair))
            until_ends.append(asked.child_value(tasks[-1], asked.state))
            value = expectation(model, after, context.zero)
            worth.append(backup(count > 0, until_ends[-1], value, can_invoke, self._unknown()))
            allowed.append(can_invoke)
        best, value = choices.greedy(worth)
        explores = asked.word < threshold(asked.epsilon)
        slot = lax.select(explores, choices.nth_allowed(allowed, asked.word), best)
        return Decision(choices.pick(tasks, slot), Memory(point, slot, jnp.float32(1))), (value, *until_ends)

    def _observed(
        self, points: DecisionPoints, tables: ModelTables, decided: Memory, transition: Transition, context: Context
    ) -> ModelTables:
        """The tables after the subtask ended, the episode possibly with it (eq. 4.4)."""
        pair = points.pair(decided.point, decided.slot)
        places = points.entries(pair, decided.point)
        new = stage(updated)(
            [take(tables.model, place) for place in places],
            points.outcomes_of(pair),
            take(jnp.asarray(points.planning), transition.next_state),
            lax.select(transition.terminated, jnp.float32(0), decided.discount),
            jnp.asarray(self.step_size, jnp.float32),
            context.learns,
            context.zero,
        )
        return tables._replace(model=put_rows(tables.model, places, [entry[None] for entry in new]))

    def _stored(self, points: DecisionPoints, tables: ModelTables, decided: Memory) -> Values:
        """What `_recorded` stored where a decision was taken."""
        until_ends = (take(tables.until_end, place) for place in self._places(points, decided.point))
        return (take(tables.values, decided.point), *until_ends)

    def _recorded(self, points: DecisionPoints, tables: ModelTables, decided: Memory, values: Values) -> ModelTables:
        """The tables with the values that a decision went by."""
        value, *until_ends = values
        rows = [until_end[None] for until_end in until_ends]
        stored = put_rows(tables.until_end, self._places(points, decided.point), rows)
        return tables._replace(values=put_row(tables.values, decided.point, value[None]), until_end=stored)

    def _places(self, points: DecisionPoints, point: Array) -> list[Array]:
        """Where `until_end` of a decision point's subtasks is stored."""
        return [points.at(points.pair(point, slot), point) for slot in range(points.num_slots)]

    def _unknown(self) -> Array:
        return jnp.asarray(self.unknown_value, jnp.float32)
