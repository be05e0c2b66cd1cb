"""A stack of running subtasks: what a step ends on it, and how it is filled again down to a primitive action."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.flags import Flag, both, choose, either, opposite
from hrljax.core.random import threshold
from hrljax.hierarchy.layout import ChildSet, StackLayout
from hrljax.learners.base import Control, Discounted, Prepared, Tables, Transition, Words
from hrljax.learners.child_values import ChildValues, Known, Q, Row
from hrljax.learners.hyperparameters import Hyperparameter, at_episode
from hrljax.learners.roots.base import AnySubtaskRoot


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
    memory: chex.ArrayTree  # what the root remembers of its decision; () if it learns as the others do


class RunningChild(NamedTuple):
    """The child that a subtask on a level has invoked, at the end of a step."""

    parent: Array  # int32: the subtask on the level
    state: Array  # int32: where the child was invoked
    slot: Array  # int32
    reward: Array  # float32: of the step if the child is an action, else 0: a subtask's is in its own values
    gamma: Discounted  # discounts by all of its steps


class Choice(NamedTuple, Generic[Q]):
    """What a subtask decides."""

    action: Array  # int32: primitive action, or -1
    task: Array  # int32: subtask, or -1
    slot: Array  # int32
    q: Q  # of the child that is invoked


@dataclass(frozen=True)
class LevelEnd:
    """What a step ended on one level; the flags are Python constants where they are always the same."""

    used: Flag  # a subtask runs here
    child: Flag  # its child ended
    exited: Flag  # it ended itself


class Greedy(NamedTuple):
    """The greedy slot of the subtask that decides next, as it was before the step was learned from."""

    slot: Array  # int32
    still: Array  # bool: the step has taught nothing of the state in which the subtask decides

    def slot_or(self, read: Callable[[], Array]) -> Array:
        """The greedy slot after the step; `read` where that may be another one."""
        return lax.cond(self.still, lambda: self.slot, read)


class Step(NamedTuple, Generic[Q]):
    """A primitive step, and what learning from it needs."""

    stack: StackState  # before the step, its pending discounts with the step in them
    transition: Transition
    ends: list[LevelEnd]  # what the step ended on each level
    q_next: Q  # values that bootstraps use, of the child that is chosen in the next state; 0 after the last step
    next_action: Array | None  # int32: the action that is taken next; None of a learner that is off-policy


def readable(task: Array, used: Flag) -> Array:
    """The number of the subtask on a level; 0 where none runs, to read something."""
    return task if used is True else lax.max(task, jnp.int32(0))


def empty_stack(layout: StackLayout) -> StackState:
    """The stack of a hierarchy in which nothing runs."""
    none = jnp.int32(-1)
    idle = Pending(jnp.int32(0), jnp.int32(0), jnp.float32(1))
    return StackState(none, (none,) * layout.num_levels, (idle,) * (layout.num_levels - 1), ())


class StackOfSubtasks(ChildValues[Prepared, Tables, Control, Q], Generic[Prepared, Tables, Control, Q]):
    """Decides on every level of a stack by the values of children."""

    root: AnySubtaskRoot | None
    epsilon: Hyperparameter
    discount: Hyperparameter
    ties: choices.Ties

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

    def running_child(self, known: Known, level: int, step: Step[Q]) -> RunningChild:
        """What ran on a level in a step."""
        layout, context, stack = known.layout, known.context, step.stack
        parent, reward = readable(stack.tasks[level], step.ends[level].used), step.transition.reward
        if level == layout.num_levels - 1:
            state, slot = step.transition.state, layout.slot_of_action(layout.levels[level], parent, stack.action)
            discount = at_episode(self.discount, context.episode)
        else:
            state, slot, discount = stack.pending[level]
            reward = lax.select(stack.tasks[level + 1] < 0, reward, jnp.float32(0))
        return RunningChild(parent, state, slot, reward, context.discounted(discount))

    def _greedy_next(
        self, known: Known, stack: StackState, ends: list[LevelEnd], task: Array, state: Array
    ) -> tuple[Array, Q]:
        """The greedy child of the first learning subtask that takes control after a step: its slot, its values.

        Args:
            known: what it goes by.
            stack: before the step.
            ends: what the step ended.
            task: the subtask on the first level after it.
            state: after the step.
        """
        for running, end in zip(stack.tasks[1:], ends[1:], strict=True):
            task = choose(both(end.used, opposite(end.exited)), running, task)

        def of_children(children: ChildSet) -> tuple[Array, Q]:
            row = self._row(known, children, task, state)
            return row.best, row.of_best

        return known.layout.by_child_set(known.layout.all_tasks, task, of_children)

    def _descend(
        self,
        known: Known,
        stack: StackState,
        ends: list[LevelEnd],
        task: Array,
        is_new: Flag,
        state: Array,
        words: Words,
        goes_on: Flag = True,
        greedy: Greedy | None = None,
    ) -> tuple[StackState, Q]:
        """Fills the stack down to a primitive action.

        Args:
            known: what subtasks go by.
            stack: before the last step.
            ends: what that step ended.
            task: the subtask on the first level, which has just been invoked if `is_new`.
            is_new: see `task`.
            state: after that step.
            words: one for each level, after the root's.
            goes_on: whether decisions have an effect.
            greedy: what the subtask on the only level would choose, if that is known.

        Returns:
            The stack, without the root's memory; and the values of what the first subtask to decide invokes.
        """
        layout = known.layout
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
                return self._decide(known, level, asked, state, words[level + layout.offset], greedy)

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
        self, known: Known, level: int, task: Array, state: Array, word: Array, greedy: Greedy | None = None
    ) -> Choice[Q]:
        """The child that a subtask on a level invokes: the greedy one, or with probability epsilon any."""
        epsilon = at_episode(self.epsilon, known.context.episode)

        def of_children(children: ChildSet) -> Choice[Q]:
            def row() -> Row[Q]:
                return self._row(known, children, task, state)

            def best(now: Row[Q]) -> Array:
                return choices.greedy_by(self.ties, now.worth, now.best, word)

            if children.is_primitive:
                asks = greedy is None or self.ties == "random"
                slot = best(row()) if asks else greedy.slot_or(lambda: row().best)  # type: ignore[union-attr]
                slot = choices.epsilon_greedy(slot, children.num_slots, word, epsilon)
                q = self._stored_in(known, children, task, state, slot)
            else:
                now = row()
                can = [jnp.bool_(True) if allowed is None else allowed for allowed in now.allowed]
                slot = lax.select(word < threshold(epsilon), choices.nth_allowed(can, word), best(now))
                q = choices.pick(now.values, slot)
            return Choice(*known.layout.child_of(children, slot), slot, q)

        return known.layout.by_child_set(known.layout.levels[level], task, of_children)
