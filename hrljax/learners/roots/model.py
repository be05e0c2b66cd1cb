"""A root that plans on a learned model of its subtasks (thesis 4.1.1)."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import expectation, put_row, stage, take, take_row
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.learners.base import Moment
from hrljax.learners.hyperparameters import Hyperparameter, hyperparameter
from hrljax.learners.roots.backups import backup, sweep
from hrljax.learners.roots.base import ChildValue, Decision, Root
from hrljax.learners.roots.decision_points import DecisionPoints, planning_points
from hrljax.learners.roots.multi_time_model import updated


class ModelTables(NamedTuple):
    """What a `ModelRoot` has learned; X, K, M and Y as in `DecisionPoints`."""

    model: Array  # [X * K * (M + 1) * Y] float32, see `hrljax.learners.roots.multi_time_model`
    values: Array  # [X * Y] float32: value of each decision point
    until_end: Array  # [X * K * Y] float32: Q_r of each subtask when the root last decided there, episode starts aside


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
    interval: int = 5
    sweeps: int = 5

    name = "model"
    learns = True

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

    def choose(
        self,
        prepared: DecisionPoints,
        tables: ModelTables,
        child_value: ChildValue,
        state: Array,
        word: Array,
        epsilon: Any,
        zero: Array,
    ) -> tuple[Decision, Any]:
        points = prepared
        point = take(jnp.asarray(points.point), state)
        x, y = point // points.num_y, point % points.num_y
        tasks, worth, allowed, until_ends = [], [], [], []
        for slot in range(points.num_slots):
            pair = x * points.num_slots + slot
            first = pair * (points.num_outcomes + 1) * points.num_y + y
            *model, count = (take(tables.model, first + m * points.num_y) for m in range(points.num_outcomes + 1))
            outcomes = take_row(
                jnp.asarray(np.maximum(points.outcomes, 0)), pair * points.num_outcomes, points.num_outcomes
            )
            after = [take(tables.values, outcomes[m] * points.num_y + y) for m in range(points.num_outcomes)]
            can_invoke = take(jnp.asarray(points.can_invoke.ravel()), pair * points.num_y + y)
            tasks.append(take(jnp.asarray(points.tasks), pair))
            until_ends.append(child_value(tasks[-1], state))
            worth.append(
                backup(count > 0, until_ends[-1], expectation(model, after, zero), can_invoke, self._unknown())
            )
            allowed.append(can_invoke)
        best, value = choices.greedy(worth)
        slot = lax.select(word < threshold(epsilon), choices.nth_allowed(allowed, word), best)
        return Decision(choices.pick(tasks, slot), point, slot), (value, *until_ends)

    def probabilities(
        self, prepared: DecisionPoints, tables: ModelTables, child_value: ChildValue, state: Array, zero: Array
    ) -> Array:
        decision, _ = self.choose(prepared, tables, child_value, state, jnp.uint32(0), np.float32(0), zero)
        return (jnp.arange(prepared.num_tasks, dtype=jnp.int32) == decision.task).astype(jnp.float32)

    def observe(
        self,
        prepared: DecisionPoints,
        tables: ModelTables,
        decision: Decision,
        after: Array,
        terminated: Array,
        discount: Array,
        moment: Moment,
    ) -> ModelTables:
        points = prepared
        x, y = decision.point // points.num_y, decision.point % points.num_y
        pair = x * points.num_slots + decision.slot
        places = [(pair * (points.num_outcomes + 1) + m) * points.num_y + y for m in range(points.num_outcomes + 1)]
        outcomes = take_row(jnp.asarray(points.outcomes), pair * points.num_outcomes, points.num_outcomes)
        weight = lax.select(terminated, jnp.float32(0), discount)
        outcome = take(jnp.asarray(points.planning), after)
        step_size = jnp.asarray(self.step_size, jnp.float32)
        new = stage(updated)(
            [take(tables.model, place) for place in places],
            [outcomes[m] for m in range(points.num_outcomes)],
            outcome,
            weight,
            step_size,
            moment.live,
            moment.zero,
        )
        model = tables.model
        for place, entry in zip(places, new, strict=True):
            model = put_row(model, place, entry[None])
        return tables._replace(model=model)

    def kept(self, prepared: DecisionPoints, tables: ModelTables, decision: Decision) -> tuple[Array, ...]:
        until_ends = (take(tables.until_end, place) for place in self._places(prepared, decision))
        return (take(tables.values, decision.point), *until_ends)

    def record(
        self, prepared: DecisionPoints, tables: ModelTables, decision: Decision, found: tuple[Array, ...]
    ) -> ModelTables:
        value, *until_ends = found
        kept = tables.until_end
        for place, until_end in zip(self._places(prepared, decision), until_ends, strict=True):
            kept = put_row(kept, place, until_end[None])
        return tables._replace(values=put_row(tables.values, decision.point, value[None]), until_end=kept)

    def plan(self, prepared: DecisionPoints, tables: ModelTables, moment: Moment) -> ModelTables:
        points = prepared
        model = tables.model.reshape(-1, points.num_outcomes + 1, points.num_y)
        until_end = tables.until_end.reshape(-1, points.num_y)

        def again(_: Array, values: Array) -> Array:
            return sweep(points, model, until_end, values, self._unknown(), moment.zero)

        values = lax.fori_loop(0, self.sweeps, again, tables.values.reshape(points.num_x, points.num_y)).ravel()
        if moment.lockstep:
            values = lax.select(jnp.broadcast_to(moment.live, values.shape), values, tables.values)
        return tables._replace(values=values)

    def _places(self, points: DecisionPoints, decision: Decision) -> list[Array]:
        """Where `until_end` of the decision point's subtasks are kept."""
        x, y = decision.point // points.num_y, decision.point % points.num_y
        return [(x * points.num_slots + slot) * points.num_y + y for slot in range(points.num_slots)]

    def _unknown(self) -> Array:
        return jnp.asarray(self.unknown_value, jnp.float32)
