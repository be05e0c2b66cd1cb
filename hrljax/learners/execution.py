"""What all hierarchical learners share: a stack of running subtasks that decides, runs and unwinds.

After a primitive step every subtask on the stack that is terminated in the new state leaves it, and
all that it had invoked (Dietterich 2000, section 3.2). The subtask on top then decides, what it
invokes decides, and so on down to a primitive action, all within the same step. The depth of the
stack is static, so a hierarchy of one level costs no more than a flat learner.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.core.flags import Flag, both, choose, either, opposite
from hrljax.core.random import threshold
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.layout import ChildSet, StackLayout, stack_layout
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.child_values import ChildValues, Q
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter
from hrljax.learners.roots.base import AnySubtaskRoot, Decision, Question, SubtaskRoot
from hrljax.learners.updates import Move, moved


class Pending(NamedTuple):
    """A child that runs: when it ends, the choice of it is learned from."""

    state: Array  # int32: where it was invoked
    slot: Array  # int32
    discount: Array  # float32: discount of its steps so far


class StackState(NamedTuple):
    """Where the hierarchy is in its execution."""

    action: Array  # int32: next primitive action
    tasks: tuple[Array, ...]  # int32: subtask that runs on each level, -1 if none
    pending: tuple[Pending, ...]  # on each level but the last, whose children are primitive
    memory: Any  # what the root remembers of its decision; () if it learns as the others do


class StackTables(NamedTuple):
    """What a hierarchical learner has learned."""

    q: Array  # [tasks * S * K * numbers] float32: values by subtask, state and child's slot
    root: Any  # what the root has learned, if it has a policy of its own; else ()


class Choice(NamedTuple, Generic[Q]):
    """What a subtask decides."""

    action: Array  # int32: primitive action, or -1
    task: Array  # int32: subtask, or -1
    slot: Array  # int32
    q: Q  # of the child that is invoked


@dataclass(frozen=True, eq=False)
class Prepared:
    """Tables of the hierarchy and of its root."""

    layout: StackLayout
    root: Any


@dataclass(frozen=True)
class LevelEnd:
    """What a step ended on one level; the flags are Python constants where they are always the same."""

    used: Flag  # a subtask runs here
    child: Flag  # its child ended
    exited: Flag  # it ended itself


def readable(task: Array, used: Flag) -> Array:
    """The number of the subtask on a level; 0 where none runs, to read something."""
    return task if used is True else lax.max(task, jnp.int32(0))


@dataclass(frozen=True)
class StackLearner(ChildValues[Prepared, StackTables, StackState, Q], Generic[Q]):
    """Executes a hierarchy; subclasses say what is learned.

    To `initial`, `q_total` and `value_until_end` comes `moves`: what a step teaches.

    Attributes: see `hrljax.HORDQ`.
    """

    hierarchy: Hierarchy
    root: AnySubtaskRoot | None = None
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        owner = type(self).__name__
        checks.instance(f"{owner}: hierarchy", self.hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
        if self.root is None:
            return
        checks.instance(f"{owner}: root", self.root, SubtaskRoot, "None or a root such as ModelRoot()")
        if any(map(self.hierarchy.is_primitive, self.hierarchy.root.children)):
            raise ValueError(
                f"{owner}: the root {self.hierarchy.root.name!r} has a primitive child, so it must learn: root=None"
            )

    @property
    def num_words(self) -> int:  # type: ignore[override]
        """One for each decision between the root and a primitive action."""
        return self.hierarchy.depth

    @property
    def num_begin_words(self) -> int:  # type: ignore[override]
        return self.hierarchy.depth

    @property
    def planning_interval(self) -> int:
        return 0 if self.root is None else self.root.planning_interval

    # What a subclass says.

    @abstractmethod
    def moves(
        self,
        layout: StackLayout,
        stack: StackState,
        transition: Transition,
        ends: list[LevelEnd],
        q_next: Q,
        context: Context,
    ) -> list[Move]:
        """The rows of ``StackTables.q`` that a step moves, and where to.

        Args:
            layout: where the rows lie.
            stack: before the step, its pending discounts with the step in them.
            transition: the step.
            ends: what it ended on each level.
            q_next: values that bootstraps use, of the child that is chosen in the next state; 0 after the last step.
            context: the episode.
        """

    @property
    def is_on_policy(self) -> bool:
        """Whether bootstraps use the child that is invoked next instead of the greedy one."""
        return False

    # What a training loop calls.

    def prepare(self, env: AnyTabularEnvironment) -> Prepared:
        root = None if self.root is None else self.root.prepare(self.hierarchy, env)
        return Prepared(stack_layout(self.hierarchy, env, self.root is None), root)

    def init(self, env: AnyTabularEnvironment, prepared: Prepared) -> LearnerState:
        layout = prepared.layout
        cells = layout.num_states * layout.num_slots

        def tiled(q: Q, times: int) -> Array:
            return jnp.tile(jnp.stack([jnp.asarray(number, jnp.float32) for number in q]), times)

        q, root = tiled(self.initial(is_root=False), layout.num_tasks * cells), ()
        if self.root is None:
            of_root = tiled(self.initial(is_root=True), cells)
            q = jnp.concatenate([of_root, q[len(of_root) :]])
        else:
            root = self.root.init(prepared.root)
        return LearnerState(StackTables(q, root), _empty(layout))

    def begin(
        self, prepared: Prepared, tables: StackTables, first: Array, words: Words, context: Context
    ) -> StackState:
        layout = prepared.layout
        task, memory = jnp.int32(0), ()
        if self.root is not None:
            question = self._question(prepared, tables, first, words[0], context)
            task, memory = self.root.begin(prepared.root, tables.root, question, context)
        ends = [LevelEnd(True, True, True)] * layout.num_levels
        stack, _ = self._descend(layout, tables.q, _empty(layout), ends, task, True, first, words, context)
        return stack._replace(memory=memory)

    def action(self, control: StackState) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: StackTables = state.tables
        before: StackState = state.control
        layout, after = prepared.layout, transition.next_state
        ends = self._ends(layout, before, transition)
        discount = jnp.asarray(at_episode(self.discount, context.episode))
        stack = before._replace(pending=tuple(p._replace(discount=p.discount * discount) for p in before.pending))
        task, memory, is_new = stack.tasks[0], (), False
        if self.root is not None:
            # The root chooses before the bootstrap, which is on the subtask that really runs next.
            is_new = ends[0].exited
            asked, decision = self._question(prepared, tables, after, words[0], context), Decision(task, before.memory)
            of_root, (task, memory) = self.root.step(
                prepared.root, tables.root, decision, transition, is_new, discount, asked, context
            )
            tables = tables._replace(root=of_root)
        goes_on = ~transition.terminated & context.learns

        def descend(table: Array) -> tuple[StackState, Q]:
            return self._descend(layout, table, stack, ends, task, is_new, after, words, context, goes_on)

        # An off-policy learner chooses with what it has just learned, an on-policy one learns from its choice.
        following = None
        if self.is_on_policy:
            following, q_next = descend(tables.q)
        else:
            q_next = self._greedy_next(layout, tables.q, before, ends, task, after)
        q_next = jax.tree.map(lambda number: lax.select(transition.terminated, jnp.float32(0), number), q_next)
        moves = self.moves(layout, stack, transition, ends, q_next, context)
        q = moved(tables.q, moves, at_episode(self.step_size, context.episode), context)
        following = following or descend(q)[0]
        return LearnerState(tables._replace(q=q), following._replace(memory=memory))

    def plan(self, prepared: Prepared, tables: StackTables, context: Context) -> StackTables:
        if self.root is None:
            return tables
        return tables._replace(root=self.root.plan(prepared.root, tables.root, context))

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: Prepared, tables: StackTables, context: Context
    ) -> HierarchicalPolicy:
        layout, root = prepared.layout, self.root
        states = jnp.arange(env.num_states, dtype=jnp.int32)

        def slots(state: Array) -> Array:
            rows = [
                self._row(layout, tables.q, layout.children(task), jnp.int32(task), state)
                for task in range(layout.num_tasks)
            ]
            return jnp.stack([row.best for row in rows])

        choice = None
        if root is not None:
            child_value = self._child_value(layout, tables.q)
            choice = jax.vmap(lambda s: root.probabilities(prepared.root, tables.root, child_value, s, context))(states)
        return HierarchicalPolicy(layout, jax.vmap(slots)(states).T, choice)

    # How the stack moves.

    def _question(
        self, prepared: Prepared, tables: StackTables, state: Array, word: Array, context: Context
    ) -> Question:
        """What the root may go by in a state."""
        epsilon = jnp.asarray(at_episode(self.epsilon, context.episode))
        return Question(state, word, epsilon, self._child_value(prepared.layout, tables.q))

    def _ends(self, layout: StackLayout, stack: StackState, transition: Transition) -> list[LevelEnd]:
        """What a step ended on each level, from the first to the last."""
        exits: list[Flag] = []
        used: list[Flag] = []
        for level, task in enumerate(stack.tasks):
            used.append(True if layout.is_always_used(level) else task >= 0)
            if self.root is None and level == 0:
                exits.append(False)  # its end is the episode's
                continue
            over: Flag = ~layout.is_active(readable(task, used[-1]), transition.next_state)
            over = either(over, exits[-1]) if level else over
            exits.append(both(used[-1], over))
        children: list[Flag] = []
        for level in range(layout.num_levels):
            if level == layout.num_levels - 1:
                children.append(True)
                continue
            below = level + 1
            acts_itself = both(used[level], True if used[below] is False else opposite(used[below]))
            children.append(either(either(exits[below], acts_itself), transition.terminated))
        return [LevelEnd(*flags) for flags in zip(used, children, exits, strict=True)]

    def _greedy_next(
        self, layout: StackLayout, table: Array, stack: StackState, ends: list[LevelEnd], task: Array, state: Array
    ) -> Q:
        """Values of the greedy child of the first learning subtask that takes control after a step.

        Args:
            layout: where values lie.
            table: the values.
            stack: before the step.
            ends: what the step ended.
            task: the subtask on the first level after it.
            state: after the step.
        """
        for running, end in zip(stack.tasks[1:], ends[1:], strict=True):
            task = choose(both(end.used, opposite(end.exited)), running, task)

        def of_children(children: ChildSet) -> Q:
            row = self._row(layout, table, children, task, state)
            return self._values_of(layout, table, children, task, state, row, row.best)

        return layout.by_child_set(layout.all_levels, task, of_children)

    def _descend(
        self,
        layout: StackLayout,
        table: Array,
        stack: StackState,
        ends: list[LevelEnd],
        task: Array,
        is_new: Flag,
        state: Array,
        words: Words,
        context: Context,
        goes_on: Flag = True,
    ) -> tuple[StackState, Q]:
        """Fills the stack down to a primitive action.

        Args:
            layout: where values lie.
            table: the values.
            stack: before the last step.
            ends: what that step ended.
            task: the subtask on the first level, which has just been invoked if `is_new`.
            is_new: see `task`.
            state: after that step.
            words: one for each level, after the root's.
            context: the episode.
            goes_on: whether decisions have an effect.

        Returns:
            The stack, without the root's memory; and the values of what the first subtask to decide invokes.
        """
        action, has_decided, q_next = stack.action, False, None
        tasks: list[Array] = []
        pending: list[Pending] = []
        for level in range(layout.num_levels):
            is_last = level == layout.num_levels - 1
            used: Flag = True if layout.is_always_used(level) else task >= 0
            decides = both(used, True if is_last else either(is_new, ends[level].child))
            below = jnp.int32(-1) if is_last else stack.tasks[level + 1]
            running = Pending(state, jnp.int32(0), jnp.float32(1)) if is_last else stack.pending[level]
            asked = readable(task, used)

            def decide(level: int = level, asked: Array = asked) -> Choice[Q]:
                return self._decide(layout, table, level, asked, state, words[level + layout.offset], context)

            if isinstance(decides, bool):
                choice = decide()
            else:
                shape = jax.eval_shape(decide)
                nowhere = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape.q)
                stays = Choice(action, below, running.slot, nowhere)
                choice = lax.cond(both(decides, goes_on), decide, lambda stays=stays: stays)
            q_next = choice.q if q_next is None else choose(has_decided, q_next, choice.q)
            has_decided = either(has_decided, decides)
            tasks.append(task)
            action = choose(both(decides, True if is_last else choice.action >= 0), choice.action, action)
            if not is_last:
                pending.append(choose(decides, Pending(state, choice.slot, jnp.float32(1)), running))
                task = choose(used, choose(decides, choice.task, below), jnp.int32(-1))
                is_new = decides
        assert q_next is not None  # there is a level
        return StackState(action, tuple(tasks), tuple(pending), ()), q_next

    def _decide(
        self, layout: StackLayout, table: Array, level: int, task: Array, state: Array, word: Array, context: Context
    ) -> Choice[Q]:
        """The child that a subtask on a level invokes: the greedy one, or with probability epsilon any."""
        epsilon = at_episode(self.epsilon, context.episode)

        def of_children(children: ChildSet) -> Choice[Q]:
            row = self._row(layout, table, children, task, state)
            if children.is_primitive:
                slot = choices.epsilon_greedy(row.best, children.num_slots, word, epsilon)
            else:
                can = [jnp.bool_(True) if allowed is None else allowed for allowed in row.allowed]
                slot = lax.select(word < threshold(epsilon), choices.nth_allowed(can, word), row.best)
            q = self._values_of(layout, table, children, task, state, row, slot)
            return Choice(*layout.child_of(children, slot), slot, q)

        return layout.by_child_set([level], task, of_children)


def _empty(layout: StackLayout) -> StackState:
    """The stack of a hierarchy in which nothing runs."""
    none = jnp.int32(-1)
    idle = Pending(jnp.int32(0), jnp.int32(0), jnp.float32(1))
    return StackState(none, (none,) * layout.num_levels, (idle,) * (layout.num_levels - 1), ())
