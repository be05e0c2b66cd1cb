"""Hierarchical tabular learners: HORDQ and MAXQ-Q under a root policy.

One mechanism serves both. Each subtask of the leaf cover keeps, for every state and child, the four
`td.Parts` of a value side by side in memory: one read and one write a step.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy import Hierarchy
from hrljax.learners import td
from hrljax.learners.base import Experience, Hyperparameter, Learner, LearnerState, Moment, at_episode, hyperparameter
from hrljax.learners.roots import ChildValue, Decision, RandomRoot, Root
from hrljax.learners.task_tables import TaskTables, tabulate
from hrljax.numerics import put_row, stage, take, take_row

_PARTS = len(td.Parts._fields)


class Tables(NamedTuple):
    """What a hierarchical learner has learned."""

    parts: Array  # [tasks * S * A * 4] float32: `td.Parts` by subtask (without the root), state, child
    root: Any  # what the root has learned


class Control(NamedTuple):
    """Where the hierarchy is in its execution."""

    action: Array  # int32: next primitive action
    decision: Decision  # the root's choice: the running subtask
    discount: Array  # float32: discount of the running subtask's steps so far


@dataclass(frozen=True, eq=False)
class Prepared:
    """Tables on the host."""

    tasks: TaskTables
    num_states: int
    num_actions: int
    active_bits: np.ndarray  # [S] uint32, without the root
    goal: np.ndarray  # [tasks * S] float32, without the root
    root: Any

    @property
    def row_length(self) -> int:
        return self.num_actions * _PARTS

    def row(self, parts: Array, task: Array, state: Array) -> list[td.Parts]:
        """The values of a subtask's children in a state."""
        row = take_row(parts, (task * self.num_states + state) * self.row_length, self.row_length)
        return [td.Parts(*(row[a * _PARTS + p] for p in range(_PARTS))) for a in range(self.num_actions)]


@dataclass(frozen=True)
class _Hierarchical(Learner):
    hierarchy: Hierarchy
    root: Root = field(default_factory=RandomRoot)
    pseudo_reward: Hyperparameter = hyperparameter(0.0, schedule=True)
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)

    num_words = 2
    num_begin_words = 2
    _has_exit_value = True

    def __post_init__(self) -> None:
        super().__post_init__()
        hierarchy = self.hierarchy
        for task in hierarchy.subtasks[1:]:
            if task.children != hierarchy.actions:
                raise NotImplementedError(f"subtask {task.name!r}: learners need every subtask below the root to have all actions, in order")
        if any(map(hierarchy.is_primitive, hierarchy.root.children)):
            raise NotImplementedError(f"the root {hierarchy.root.name!r} has primitive children; learners need subtasks there")

    @property
    def planning_interval(self) -> int:
        return self.root.planning_interval

    def prepare(self, env: TabularEnvironment[Any, Any]) -> Prepared:
        return _prepare(self.hierarchy, env, self.root.prepare(self.hierarchy, env))

    def init(self, env: TabularEnvironment[Any, Any], prepared: Prepared) -> LearnerState:
        cells = (prepared.tasks.num_tasks - 1) * env.num_states * env.num_actions
        parts = jnp.tile(jnp.stack(self._initial_parts()), cells)
        nothing = jnp.int32(0)
        control = Control(nothing, Decision(nothing, nothing, nothing), jnp.float32(1))
        return LearnerState(Tables(parts, self.root.init(prepared.root)), control)

    def _initial_parts(self) -> td.Parts:
        raise NotImplementedError

    def begin(self, prepared: Prepared, tables: Tables, first: Array, words: tuple[Array, ...], moment: Moment) -> Control:
        decision, _ = self._decide(prepared, tables, first, words[0], moment)
        return self._proceed(prepared, tables, first, decision, jnp.float32(1), words[1], moment)

    def action(self, control: Control) -> Array:
        return control.action

    def learn(self, prepared: Prepared, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment) -> LearnerState:
        tables, control = state
        task, after = control.decision.task, step.next_state
        still_active = take(jnp.asarray(prepared.active_bits), after) >> task.astype(jnp.uint32)
        exited = (still_active & np.uint32(1)) == 0
        discount = at_episode(self.discount, moment.episode)
        so_far = control.discount * discount

        if self.root.learns:
            root = moment.when(
                exited | step.terminated,
                lambda root, now: self.root.observe(
                    prepared.root, root, control.decision, after, step.terminated, so_far, now
                ),
                tables.root,
            )
            tables = tables._replace(root=root)
        decision, found = lax.cond(
            exited & ~step.terminated & moment.live,
            lambda: self._decide(prepared, tables, after, words[0], moment),
            lambda: (control.decision, self.root.kept(prepared.root, tables.root, control.decision)),
        )
        tables = tables._replace(root=self.root.record(prepared.root, tables.root, decision, found))

        row = prepared.row(tables.parts, decision.task, after)
        child = td.greedy(self._worth(row))[0]
        nothing = jnp.float32(0)
        follows = td.Parts(*(lax.select(step.terminated, nothing, td.pick(list(v), child)) for v in zip(*row, strict=True)))
        pseudo = at_episode(self.pseudo_reward, moment.episode) * take(jnp.asarray(prepared.goal), task * prepared.num_states + after)
        target = td.hordq_targets(step.reward, discount, exited, pseudo, follows, moment.zero)
        at = ((task * prepared.num_states + step.state) * prepared.num_actions + step.action) * _PARTS
        old = take_row(tables.parts, at, _PARTS)
        new = td.increment(old, jnp.stack(target), at_episode(self.step_size, moment.episode), moment.live, moment.zero)
        tables = tables._replace(parts=put_row(tables.parts, at, new))
        so_far = lax.select(exited, jnp.float32(1), so_far)
        return LearnerState(tables, self._proceed(prepared, tables, after, decision, so_far, words[1], moment))

    def _worth(self, row: list[td.Parts]) -> list[Array]:
        """What behaviour and bootstraps are greedy in: the value with the pseudo-reward."""
        if self._has_exit_value:
            return [v.reward + v.completion + v.exit + v.pseudo for v in row]
        return [v.reward + v.completion + v.pseudo for v in row]

    def _decide(
        self, prepared: Prepared, tables: Tables, state: Array, word: Array, moment: Moment
    ) -> tuple[Decision, Any]:
        epsilon = at_episode(self.epsilon, moment.episode)
        return self.root.choose(
            prepared.root, tables.root, self._child_value(prepared, tables), state, word, epsilon, moment.zero
        )

    def plan(self, prepared: Prepared, tables: Tables, moment: Moment) -> Tables:
        return tables._replace(root=self.root.plan(prepared.root, tables.root, moment))

    def _child_value(self, prepared: Prepared, tables: Tables) -> ChildValue:
        """Q_r of a subtask for its parent, by recursion (thesis eq. 3.3): at what it would do itself."""

        def value(task: Array, state: Array) -> Array:
            row = prepared.row(tables.parts, task, state)
            child = td.greedy(self._worth(row))[0]
            return td.pick([v.reward + v.completion for v in row], child)

        return value

    def _proceed(self, prepared, tables, state, decision, discount, word, moment) -> Control:
        row = prepared.row(tables.parts, decision.task, state)
        best = td.greedy(self._worth(row))[0]
        action = td.epsilon_greedy(best, prepared.num_actions, word, at_episode(self.epsilon, moment.episode))
        return Control(action, decision, discount)


@lru_cache(maxsize=64)
def _prepare(hierarchy: Hierarchy, env: TabularEnvironment[Any, Any], root: Any) -> Prepared:
    tasks = tabulate(hierarchy, env)
    active_bits = tasks.active_bits >> np.uint32(1)
    goal = np.ascontiguousarray(tasks.goal[1:]).ravel()
    return Prepared(tasks, env.num_states, env.num_actions, active_bits, goal, root)


@dataclass(frozen=True)
class HORDQ(_Hierarchical):
    initial_value: Hyperparameter = hyperparameter(0.0)
    name = "HORDQ"

    def _initial_parts(self) -> td.Parts:
        nothing = jnp.float32(0)
        return td.Parts(nothing, nothing, jnp.asarray(self.initial_value, jnp.float32), nothing)
