"""Hierarchical tabular learners: HORDQ and MAXQ-Q under a root policy.

One mechanism serves both. Each subtask of the leaf cover keeps, for every state and child, the four
`td.Parts` of a value side by side in memory: one read and one write a step. MAXQ-Q is the same
without the value after the exit: its C~ is the completion plus the pseudo part.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.envs.base import TabularEnvironment
from hrljax.evaluate import HierarchicalPolicy, expected_return
from hrljax.hierarchy import Hierarchy
from hrljax.learners import td
from hrljax.learners.base import Experience, Hyperparameter, Learner, LearnerState, Moment, at_episode, hyperparameter
from hrljax.learners.roots import ChildValue, Decision, RandomRoot, Root
from hrljax.learners.task_tables import TaskTables, tabulate
from hrljax.numerics import put_row, take, take_row

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
    """Tables on the host; subtasks are counted without the root."""

    tasks: TaskTables
    num_states: int
    num_actions: int
    root: Any

    @property
    def row_length(self) -> int:
        return self.num_actions * _PARTS

    def row(self, parts: Array, task: Array, state: Array) -> list[td.Parts]:
        """The values of a subtask's children in a state."""
        row = take_row(parts, (task * self.num_states + state) * self.row_length, self.row_length)
        return [td.Parts(*(row[a * _PARTS + p] for p in range(_PARTS))) for a in range(self.num_actions)]

    def exited(self, task: Array, state: Array) -> Array:
        """Whether a subtask is terminated in a state."""
        bits = take(jnp.asarray(self.tasks.active_bits >> np.uint32(1)), state)
        return ((bits >> task.astype(jnp.uint32)) & np.uint32(1)) == 0

    def goal(self, task: Array, state: Array) -> Array:
        """Factor of the pseudo-reward."""
        return take(jnp.asarray(self.tasks.goal[1:].ravel()), task * self.num_states + state)


@dataclass(frozen=True)
class _Hierarchical(Learner):
    hierarchy: Hierarchy
    root: Root = field(default_factory=RandomRoot)
    pseudo_reward: Hyperparameter = hyperparameter(0.0, schedule=True)
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    bootstrap: Literal["greedy", "on_policy"] = "greedy"
    pseudo_reward_in: Literal["own_table", "backup"] = "own_table"

    num_words = 2
    num_begin_words = 2
    _has_exit_value: ClassVar[bool]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.hierarchy, Hierarchy):
            raise TypeError(
                f"{self.name}: hierarchy must be a Hierarchy such as env.hierarchy(), got {self.hierarchy!r}"
            )
        if not isinstance(self.root, Root):
            raise TypeError(f"{self.name}: root must be a root such as ModelRoot(), got {self.root!r}")
        for option, allowed in (("bootstrap", ("greedy", "on_policy")), ("pseudo_reward_in", ("own_table", "backup"))):
            if getattr(self, option) not in allowed:
                raise ValueError(f"{self.name}: {option} must be one of {allowed}, got {getattr(self, option)!r}")
        for task in self.hierarchy.subtasks[1:]:
            if task.children != self.hierarchy.actions:
                raise NotImplementedError(
                    f"{self.name}: subtask {task.name!r} must have all actions as children, in order"
                )
        if any(map(self.hierarchy.is_primitive, self.hierarchy.root.children)):
            raise NotImplementedError(
                f"{self.name}: the root {self.hierarchy.root.name!r} must have no primitive child"
            )

    @property
    def planning_interval(self) -> int:
        return self.root.planning_interval

    def prepare(self, env: TabularEnvironment[Any, Any]) -> Prepared:
        root = self.root.prepare(self.hierarchy, env)
        return Prepared(tabulate(self.hierarchy, env), env.num_states, env.num_actions, root)

    def init(self, env: TabularEnvironment[Any, Any], prepared: Prepared) -> LearnerState:
        nothing = jnp.float32(0)
        start = jnp.asarray(self.initial_value, jnp.float32)
        initial = td.Parts(nothing, *((nothing, start) if self._has_exit_value else (start, nothing)), nothing)
        cells = (prepared.tasks.num_tasks - 1) * env.num_states * env.num_actions
        none = jnp.int32(0)
        control = Control(none, Decision(none, none, none), jnp.float32(1))
        return LearnerState(Tables(jnp.tile(jnp.stack(initial), cells), self.root.init(prepared.root)), control)

    def begin(
        self, prepared: Prepared, tables: Tables, first: Array, words: tuple[Array, ...], moment: Moment
    ) -> Control:
        decision, _ = self._decide(prepared, tables, first, words[0], moment)
        action = self._act(prepared.row(tables.parts, decision.task, first), words[1], moment)
        return Control(action, decision, jnp.float32(1))

    def action(self, control: Control) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, step: Experience, words: tuple[Array, ...], moment: Moment
    ) -> LearnerState:
        tables, control = state
        task, after = control.decision.task, step.next_state
        exited = prepared.exited(task, after)
        discount = at_episode(self.discount, moment.episode)
        so_far = control.discount * discount
        tables = self._hand_back(prepared, tables, control.decision, step, exited, so_far, moment)
        # The root chooses before the bootstrap, which is on the subtask that really runs next.
        decision, found = lax.cond(
            exited & ~step.terminated & moment.live,
            lambda: self._decide(prepared, tables, after, words[0], moment),
            lambda: (control.decision, self.root.kept(prepared.root, tables.root, control.decision)),
        )
        tables = tables._replace(root=self.root.record(prepared.root, tables.root, decision, found))

        row = prepared.row(tables.parts, decision.task, after)
        action = self._act(row, words[1], moment)
        follows = self._follows(row, action, step.terminated)
        pseudo = at_episode(self.pseudo_reward, moment.episode) * prepared.goal(task, after)
        target = self._target(step.reward, discount, exited, pseudo, follows, moment.zero)
        at = ((task * prepared.num_states + step.state) * prepared.num_actions + step.action) * _PARTS
        old = take_row(tables.parts, at, _PARTS)
        new = td.increment(old, jnp.stack(target), at_episode(self.step_size, moment.episode), moment.live, moment.zero)
        tables = tables._replace(parts=put_row(tables.parts, at, new))
        if self.bootstrap == "greedy":
            action = self._act(prepared.row(tables.parts, decision.task, after), words[1], moment)
        so_far = lax.select(exited, jnp.float32(1), so_far)
        return LearnerState(tables, Control(action, decision, so_far))

    def plan(self, prepared: Prepared, tables: Tables, moment: Moment) -> Tables:
        return tables._replace(root=self.root.plan(prepared.root, tables.root, moment))

    def greedy_return(
        self, env: TabularEnvironment[Any, Any], prepared: Prepared, tables: Tables, params: Any, zero: Array
    ) -> Array:
        shape = (prepared.tasks.num_tasks - 1, prepared.num_states, prepared.num_actions)
        parts = td.Parts(*jnp.moveaxis(tables.parts.reshape(*shape, _PARTS), -1, 0))
        actions = jnp.argmax(self._worth(parts), axis=-1).astype(jnp.int32)
        child_value = self._child_value(prepared, tables)
        choice = jax.vmap(lambda s: self.root.probabilities(prepared.root, tables.root, child_value, s, zero))(
            jnp.arange(env.num_states, dtype=jnp.int32)
        )
        return expected_return(env, HierarchicalPolicy(actions, prepared.tasks.active[1:], choice), params, zero)

    def _hand_back(
        self,
        prepared: Prepared,
        tables: Tables,
        decision: Decision,
        step: Experience,
        exited: Array,
        discount: Array,
        moment: Moment,
    ) -> Tables:
        """Tells the root that its subtask has ended, if it has."""
        if not self.root.learns:
            return tables
        root = moment.when(
            exited | step.terminated,
            lambda root, now: self.root.observe(
                prepared.root, root, decision, step.next_state, step.terminated, discount, now
            ),
            tables.root,
        )
        return tables._replace(root=root)

    def _worth(self, values: td.Parts) -> Array:
        """What behaviour and bootstraps are greedy in: the value with the pseudo-reward."""
        inside = values.reward + values.completion
        return (inside + values.exit if self._has_exit_value else inside) + values.pseudo

    def _greedy(self, row: list[td.Parts]) -> Array:
        return td.greedy([self._worth(values) for values in row])[0]

    def _act(self, row: list[td.Parts], word: Array, moment: Moment) -> Array:
        return td.epsilon_greedy(self._greedy(row), len(row), word, at_episode(self.epsilon, moment.episode))

    def _follows(self, row: list[td.Parts], action: Array, terminated: Array) -> td.Parts:
        """The values that the targets bootstrap on."""
        child = action if self.bootstrap == "on_policy" else self._greedy(row)
        picked = (td.pick(list(values), child) for values in zip(*row, strict=True))
        return td.Parts(*(lax.select(terminated, jnp.float32(0), value) for value in picked))

    def _target(
        self, reward: Array, discount: Any, exited: Array, pseudo: Array, follows: td.Parts, zero: Array
    ) -> td.Parts:
        target = td.hordq_targets(reward, discount, exited, pseudo, follows, zero)
        if self.pseudo_reward_in == "own_table":
            return target
        return target._replace(completion=lax.select(exited, pseudo, target.completion), pseudo=jnp.float32(0))

    def _decide(
        self, prepared: Prepared, tables: Tables, state: Array, word: Array, moment: Moment
    ) -> tuple[Decision, Any]:
        child_value = self._child_value(prepared, tables)
        epsilon = at_episode(self.epsilon, moment.episode)
        return self.root.choose(prepared.root, tables.root, child_value, state, word, epsilon, moment.zero)

    def _child_value(self, prepared: Prepared, tables: Tables) -> ChildValue:
        """Q_r of a subtask for its parent, by recursion (thesis eq. 3.3): at what it would do itself."""

        def value(task: Array, state: Array) -> Array:
            row = prepared.row(tables.parts, task, state)
            return td.pick([v.reward + v.completion for v in row], self._greedy(row))

        return value


@dataclass(frozen=True)
class HORDQ(_Hierarchical):
    """Hierarchically optimal recursive Q-learning (thesis 3.1-3.2, eq. 3.10-3.12; Andre and Russell 2002).

    Every subtask below the root learns Q_r, Q_c and Q_e; their sum is the value of the whole
    problem, so that a subtask disobeys the root where obeying costs more than the pseudo-reward.
    The hierarchy has two levels: a root over subtasks that have all primitive actions.

    Attributes:
        hierarchy: the task hierarchy.
        root: how the root chooses, `RandomRoot` or `ModelRoot`.
        pseudo_reward: paid to a subtask that ends in its goal, or a schedule of the episode.
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a random primitive action at every step, and of a random choice of a
            root that chooses greedily; or a schedule of the episode.
        discount: in [0, 1].
        initial_value: of Q_e (of Q_c in MAXQ); the other parts begin at 0.
        bootstrap: ``"greedy"`` bootstraps on the greedy action (thesis 3.12), ``"on_policy"`` on the
            action that is taken next.
        pseudo_reward_in: ``"own_table"`` keeps the pseudo-reward apart, so that it biases choices
            only. ``"backup"`` writes it into Q_c, from where it spreads into every bootstrap: an
            agent without discounting then earns it for ever. Only there to show that.
    """

    name = "HORDQ"
    _has_exit_value = True


@dataclass(frozen=True)
class MAXQ(_Hierarchical):
    """MAXQ-Q (Dietterich 2000, Table 4; thesis 2.5.1): a subtask ignores what follows its end.

    Its completion function C is Q_c here, and C~ is Q_c + Q_p. The pseudo-reward is paid in full at
    the end, as any reward of that step. With a pseudo-reward of 0 a subtask has no reason to reach
    its goal.

    Attributes: as `HORDQ`.
    """

    name = "MAXQ-Q"
    _has_exit_value = False
