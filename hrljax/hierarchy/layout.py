"""A task hierarchy as numbers: which subtasks can run on which level of the stack, their slots, and their places.

All of it is known before compilation. Subtasks are numbered in the hierarchy's order, without a
root that has a policy of its own. A slot is the position of a child among a subtask's children.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.environment import AnyTabularDynamics
from hrljax.core.flags import Flag
from hrljax.core.numerics import take
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import tabulate

T = TypeVar("T")


@dataclass(frozen=True)
class ChildSet:
    """The children of a subtask, slot by slot, which subtasks may share.

    A slot holds an action or a subtask; the other number is -1.
    """

    actions: tuple[int, ...]  # [K] primitive action of each slot
    tasks: tuple[int, ...]  # [K] number of the subtask of each slot

    @property
    def num_slots(self) -> int:
        return len(self.actions)

    @property
    def is_primitive(self) -> bool:
        """All children are primitive actions."""
        return -1 not in self.actions

    @property
    def is_plain(self) -> bool:
        """A slot is the number of its action."""
        return self.actions == tuple(range(self.num_slots))


@dataclass(frozen=True, eq=False)
class StackLayout:
    """The learning subtasks of a hierarchy."""

    active: np.ndarray  # [tasks, S] bool: the subtask can be invoked and goes on
    goal: np.ndarray  # [tasks, S] float32: factor of the pseudo-reward on termination
    num_actions: int
    offset: int  # 1 if the root has a policy of its own, else 0
    child_sets: tuple[ChildSet, ...]
    child_set_of: tuple[int, ...]  # [tasks]
    levels: tuple[tuple[int, ...], ...]  # subtasks that can run on each level of the stack

    @property
    def num_tasks(self) -> int:
        return len(self.child_set_of)

    @property
    def num_states(self) -> int:
        return self.active.shape[1]

    @property
    def num_levels(self) -> int:
        return len(self.levels)

    @property
    def all_levels(self) -> range:
        return range(len(self.levels))

    @property
    def all_tasks(self) -> range:
        return range(self.num_tasks)

    # Where numbers lie in a flat table of `size` numbers for each child, ``[tasks * S * K * size]``.

    def start(self, task: Array, state: Array, size: int) -> Array:
        """Of a subtask's children in a state: a *row*, child by child."""
        return (task * self.num_states + state) * (self.num_slots * size)

    def start_of_child(self, task: Array, state: Array, slot: Array, size: int) -> Array:
        """Of the child in one slot of a row."""
        return ((task * self.num_states + state) * self.num_slots + slot) * size

    @property
    def num_slots(self) -> int:
        """Slots of the subtask that has most: K."""
        return max(children.num_slots for children in self.child_sets)

    def children(self, task: int) -> ChildSet:
        return self.child_sets[self.child_set_of[task]]

    def is_always_used(self, level: int) -> bool:
        """Whether some subtask runs on the level at every moment."""
        above = range(level)
        return all(max(self.children(task).actions) == -1 for upper in above for task in self.levels[upper])

    def is_active(self, task: Array, state: Array) -> Array:
        """Whether a subtask (int32, not negative) is not terminated in a state."""
        # XLA defines what a shift by more than 31 bits gives, at a cost wherever it may happen.
        bits, bit = take(jnp.asarray(self.active_bits), state), task.astype(jnp.uint32) & np.uint32(31)
        return ((bits >> bit) & np.uint32(1)) == 1

    @cached_property
    def active_bits(self) -> np.ndarray:
        """``[S]`` uint32: bit i is set where subtask i is active."""
        bits = self.active.astype(np.uint32) << np.arange(self.num_tasks, dtype=np.uint32)[:, None]
        return bits.sum(0, dtype=np.uint32)

    def goal_factor(self, task: Array, state: Array) -> Array:
        """Factor of a subtask's pseudo-reward where it ends in a state."""
        return take(jnp.asarray(self.goal.ravel()), task * self.num_states + state)

    def allowed(self, children: ChildSet, state: Array) -> list[Array | None]:
        """For each slot, whether its subtask can be invoked in a state; None for an action, which always can."""
        return [None if task < 0 else self.is_active(jnp.int32(task), state) for task in children.tasks]

    def slot_of_action(self, tasks: Sequence[int], task: Array, action: Array) -> Array:
        """The slot that holds a primitive action in a subtask (int32), which is one of some.

        Of an action that it does not have, the slot of one that it has: never that of a subtask.
        """
        if all(self.children(t).is_plain for t in tasks):
            return action
        return take(jnp.asarray(self._slot_table), task * self.num_actions + action)

    def has_action(self, tasks: Sequence[int], task: Array, action: Array) -> Flag:
        """Whether a primitive action is a child of a subtask (int32), which is one of some."""
        if all(set(self.children(t).actions) >= set(range(self.num_actions)) for t in tasks):
            return True
        has = [[a in self.children(t).actions for a in range(self.num_actions)] for t in self.all_tasks]
        return take(jnp.asarray(np.array(has).ravel()), task * self.num_actions + action)

    def active_tasks(self, without_root: bool) -> np.ndarray:
        """``[S, M]`` int32: the active subtasks with a primitive child, in order; -1 where there are less than M."""
        learn = [max(self.children(t).actions) >= 0 and not (without_root and t == 0) for t in self.all_tasks]
        active = self.active.T & np.array(learn)
        tasks = np.argsort(~active, axis=1, kind="stable")[:, : active.sum(1).max()]
        return np.where(np.take_along_axis(active, tasks, 1), tasks, -1).astype(np.int32)

    @cached_property
    def _slot_table(self) -> np.ndarray:
        """``[tasks * A]`` int32: see `slot_of_action`; 0 of a subtask that has no action."""
        table = np.zeros((self.num_tasks, self.num_actions), np.int32)
        for task in range(self.num_tasks):
            slots = [(slot, action) for slot, action in enumerate(self.children(task).actions) if action >= 0]
            table[task] = slots[0][0] if slots else 0
            for slot, action in slots:
                table[task, action] = slot
        return table.ravel()

    def by_child_set(self, tasks: Sequence[int], task: Array, function: Callable[[ChildSet], T]) -> T:
        """`function` of the children of a subtask (int32), which is one of some.

        Branches where these differ.
        """
        numbers = sorted({self.child_set_of[t] for t in tasks})
        if len(numbers) == 1:
            return function(self.child_sets[numbers[0]])
        place = np.array([numbers.index(k) if k in numbers else 0 for k in self.child_set_of], np.int32)
        branches = [lambda children=self.child_sets[number]: function(children) for number in numbers]
        return lax.switch(take(jnp.asarray(place), task), branches)

    def child_of(self, children: ChildSet, slot: Array) -> tuple[Array, Array]:
        """Action and subtask (int32) in a slot, one of them -1."""
        none = jnp.int32(-1)
        action = slot if children.is_plain else choices.pick([jnp.int32(a) for a in children.actions], slot)
        task = none if children.is_primitive else choices.pick([jnp.int32(t) for t in children.tasks], slot)
        return action, task


def stack_layout(hierarchy: Hierarchy, env: AnyTabularDynamics, root_learns: bool) -> StackLayout:
    """The graph of the subtasks that learn: all, or all but the root.

    Raises:
        ValueError: as `hrljax.hierarchy.tables.tabulate`.
    """
    tables = tabulate(hierarchy, env)
    offset = 0 if root_learns else 1
    child_sets: list[ChildSet] = []
    child_set_of: list[int] = []
    for task in hierarchy.subtasks[offset:]:
        children = ChildSet(
            tuple(hierarchy.actions.index(c) if hierarchy.is_primitive(c) else -1 for c in task.children),
            tuple(-1 if hierarchy.is_primitive(c) else hierarchy.index(c) - offset for c in task.children),
        )
        if children not in child_sets:
            child_sets.append(children)
        child_set_of.append(child_sets.index(children))
    first = [hierarchy.root.name] if root_learns else list(hierarchy.root.children)
    level = [hierarchy.index(name) - offset for name in first]
    levels = []
    while level:
        levels.append(tuple(sorted(set(level))))
        level = [t for task in levels[-1] for t in child_sets[child_set_of[task]].tasks if t >= 0]
    return StackLayout(
        active=tables.active[offset:],
        goal=tables.goal[offset:],
        num_actions=env.num_actions,
        offset=offset,
        child_sets=tuple(child_sets),
        child_set_of=tuple(child_set_of),
        levels=tuple(levels),
    )
