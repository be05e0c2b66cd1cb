"""What all hierarchical learners share: a stack of running subtasks that decides, runs and unwinds.

After a primitive step every subtask on the stack that is terminated in the new state leaves it, and
all that it had invoked (Dietterich 2000, section 3.2). The subtask on top then decides, what it
invokes decides, and so on down to a primitive action, all within the same step. The depth of the
stack is static, so a hierarchy of one level costs no more than a flat learner.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import checks, choices
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.layout import StackLayout, stack_layout
from hrljax.hierarchy.policy import HierarchicalPolicy
from hrljax.learners.base import Context, LearnerState, Transition, Words
from hrljax.learners.child_values import Known, Q
from hrljax.learners.fading import Seen
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option
from hrljax.learners.roots.base import AnySubtaskRoot, Decision, Question, SubtaskRoot
from hrljax.learners.stack import Greedy, LevelEnd, StackOfSubtasks, StackState, Step, empty_stack
from hrljax.learners.updates import Move, moved


class StackTables(NamedTuple):
    """What a hierarchical learner has learned."""

    q: Array  # [tasks * S * K * numbers] float32: values by subtask, state and child's slot
    root: chex.ArrayTree  # what the root has learned, if it has a policy of its own; else ()
    seen: Seen | None = None  # what a pseudo-reward that fades goes by


@dataclass(frozen=True, eq=False)
class Prepared:
    """Tables of the hierarchy and of its root."""

    layout: StackLayout
    root: Any


@dataclass(frozen=True)
class StackLearner(StackOfSubtasks[Prepared, StackTables, StackState, Q], Generic[Q]):
    """Executes a hierarchy; subclasses say what is learned.

    To what `hrljax.learners.child_values.ChildValues` asks for comes `moves`: what a step teaches.

    Attributes: see `hrljax.HORDQ`.
    """

    hierarchy: Hierarchy
    root: AnySubtaskRoot | None = None
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    ties: choices.Ties = later_option("first")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_choice("ties", choices.Ties)
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
    def has_loops(self) -> bool:  # type: ignore[override]
        return self.root is not None and self.root.has_loops

    @property
    def planning_interval(self) -> int:
        return 0 if self.root is None else self.root.planning_interval

    # What a subclass says.

    @abstractmethod
    def moves(self, known: Known, step: Step[Q]) -> list[Move]:
        """The rows of ``StackTables.q`` that a step moves, and where to. `known` is that before the step."""

    def nothing_seen(self, layout: StackLayout) -> Seen | None:
        """`StackTables.seen` before the first step."""
        return None

    def after_seeing(self, seen: Seen | None, transition: Transition, context: Context) -> Seen | None:
        """`StackTables.seen` after a step; as it was where `context` does not learn."""
        return seen

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
        root = () if self.root is None else self.root.init(prepared.root)
        q = self.initial_values(layout, self.root is None)
        return LearnerState(StackTables(q, root, self.nothing_seen(layout)), empty_stack(layout))

    def begin(
        self, prepared: Prepared, tables: StackTables, first: Array, words: Words, context: Context
    ) -> StackState:
        layout = prepared.layout
        known = Known(layout, tables.q, tables.seen, context)
        task, memory = jnp.int32(0), ()
        if self.root is not None:
            question = self._question(known, first, words[0])
            task, memory = self.root.begin(prepared.root, tables.root, question, context)
        ends = [LevelEnd(True, True, True)] * layout.num_levels
        stack, _ = self._descend(known, empty_stack(layout), ends, task, True, first, words)
        return stack._replace(memory=memory)

    def action(self, control: StackState) -> Array:
        return control.action

    def learn(
        self, prepared: Prepared, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        tables: StackTables = state.tables
        before: StackState = state.control
        layout, after = prepared.layout, transition.next_state
        # Choices go by what was seen before the step: to wait for what it adds takes long.
        known = Known(layout, tables.q, tables.seen, context)
        ends = self._ends(layout, before, transition)
        discount = jnp.asarray(at_episode(self.discount, context.episode))
        stack = before._replace(pending=tuple(p._replace(discount=p.discount * discount) for p in before.pending))
        task, memory, is_new = stack.tasks[0], (), False
        if self.root is not None:
            # The root chooses before the bootstrap, which is on the subtask that really runs next.
            is_new = ends[0].exited
            asked, decision = self._question(known, after, words[0]), Decision(task, before.memory)
            of_root, (task, memory) = self.root.step(
                prepared.root, tables.root, decision, transition, is_new, discount, asked, context
            )
            tables = tables._replace(root=of_root)
        goes_on = ~transition.terminated & context.learns

        def descend(known: Known, greedy: Greedy | None = None) -> tuple[StackState, Q]:
            return self._descend(known, stack, ends, task, is_new, after, words, goes_on, greedy)

        # An off-policy learner chooses with what it has just learned, an on-policy one learns from its choice.
        following, greedy = None, None
        if self.is_on_policy:
            following, q_next = descend(known)
        else:
            slot, q_next = self._greedy_next(known, before, ends, task, after)
            # To read a short row again takes less time than to ask whether it has changed.
            if layout.num_levels == 1 and self._size > 2:
                greedy = Greedy(slot, after != transition.state)
        q_next = jax.tree.map(lambda number: lax.select(transition.terminated, jnp.float32(0), number), q_next)
        moves = self.moves(known, Step(stack, transition, ends, q_next, following and following.action))
        q = moved(tables.q, moves, at_episode(self.step_size, context.episode), context)
        following = following or descend(known._replace(q=q), greedy)[0]
        seen = self.after_seeing(tables.seen, transition, context)
        return LearnerState(tables._replace(q=q, seen=seen), following._replace(memory=memory))

    def plan(self, prepared: Prepared, tables: StackTables, context: Context) -> StackTables:
        if self.root is None:
            return tables
        return tables._replace(root=self.root.plan(prepared.root, tables.root, context))

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: Prepared, tables: StackTables, context: Context
    ) -> HierarchicalPolicy:
        layout, root = prepared.layout, self.root
        known = Known(layout, tables.q, tables.seen, context)
        states = jnp.arange(env.num_states, dtype=jnp.int32)

        def slots(state: Array) -> Array:
            rows = [self._row(known, layout.children(task), jnp.int32(task), state) for task in range(layout.num_tasks)]
            return jnp.stack([row.best for row in rows])

        choice = None
        if root is not None:
            child_value = self._child_value(known)
            choice = jax.vmap(lambda s: root.probabilities(prepared.root, tables.root, child_value, s, context))(states)
        return HierarchicalPolicy(layout, jax.vmap(slots)(states).T, choice)

    def _question(self, known: Known, state: Array, word: Array) -> Question:
        """What the root may go by in a state."""
        epsilon = jnp.asarray(at_episode(self.epsilon, known.context.episode))
        return Question(state, word, epsilon, self._child_value(known))
