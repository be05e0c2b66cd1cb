"""A task hierarchy as numbers: which subtasks can run on which level of the stack, and their slots.

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
from hrljax.core.numerics import take
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import NumberedStates, TaskTables, tabulate

T = TypeVar("T")


@dataclass(frozen=True)
class Kind:
    """Subtasks with the same children; -1 where a slot holds the other sort of child."""

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
class TaskGraph:
    """The learning subtasks of a hierarchy."""

    tables: TaskTables
    num_states: int
    num_actions: int
    offset: int  # 1 if the root has a policy of its own, else 0
    kinds: tuple[Kind, ...]
    kind_of: tuple[int, ...]  # [tasks]
    levels: tuple[tuple[int, ...], ...]  # subtasks that can run on each level of the stack

    @property
    def num_tasks(self) -> int:
        return len(self.kind_of)

    @property
    def num_levels(self) -> int:
        return len(self.levels)

    @property
    def all_levels(self) -> range:
        return range(len(self.levels))

    @property
    def num_slots(self) -> int:
        """Slots of the subtask that has most."""
        return max(kind.num_slots for kind in self.kinds)

    def kind(self, task: int) -> Kind:
        return self.kinds[self.kind_of[task]]

    def is_always_used(self, level: int) -> bool:
        """Whether some subtask runs on the level at every moment."""
        above = range(level)
        return all(max(self.kind(task).actions) == -1 for upper in above for task in self.levels[upper])

    def active(self, task: Array, state: Array) -> Array:
        """Whether a subtask (int32, not negative) is not terminated in a state."""
        bits = take(jnp.asarray(self.tables.active_bits >> np.uint32(self.offset)), state)
        return ((bits >> task.astype(jnp.uint32)) & np.uint32(1)) == 1

    def goal(self, task: Array, state: Array) -> Array:
        """Factor of the pseudo-reward."""
        return take(jnp.asarray(self.tables.goal[self.offset :].ravel()), task * self.num_states + state)

    def allowed(self, kind: Kind, state: Array) -> list[Array | None]:
        """For each slot, whether its subtask can be invoked in a state; None for an action, which always can."""
        return [None if task < 0 else self.active(jnp.int32(task), state) for task in kind.tasks]

    def slot_of_action(self, level: int, task: Array, action: Array) -> Array:
        """The slot that holds a primitive action in the subtask that runs on a level."""
        if all(self.kind(t).is_plain for t in self.levels[level]):
            return action
        return take(jnp.asarray(self._slot_table), task * self.num_actions + action)

    @cached_property
    def _slot_table(self) -> np.ndarray:
        """``[tasks * A]`` int32: slot of an action, 0 where a subtask does not have it."""
        table = np.zeros((self.num_tasks, self.num_actions), np.int32)
        for task in range(self.num_tasks):
            for slot, action in enumerate(self.kind(task).actions):
                if action >= 0:
                    table[task, action] = slot
        return table.ravel()

    def by_kind(self, levels: Sequence[int], task: Array, function: Callable[[Kind], T]) -> T:
        """`function` of the kind of a subtask (int32) that runs on one of some levels.

        Branches where there are several kinds.
        """
        numbers = sorted({self.kind_of[t] for level in levels for t in self.levels[level]})
        if len(numbers) == 1:
            return function(self.kinds[numbers[0]])
        place = np.array([numbers.index(k) if k in numbers else 0 for k in self.kind_of], np.int32)
        branches = [lambda kind=self.kinds[number]: function(kind) for number in numbers]
        return lax.switch(take(jnp.asarray(place), task), branches)

    def child_of(self, kind: Kind, slot: Array) -> tuple[Array, Array]:
        """Action and subtask (int32) in a slot, one of them -1."""
        none = jnp.int32(-1)
        action = slot if kind.is_plain else choices.pick([jnp.int32(a) for a in kind.actions], slot)
        task = none if kind.is_primitive else choices.pick([jnp.int32(t) for t in kind.tasks], slot)
        return action, task


def task_graph(hierarchy: Hierarchy, env: NumberedStates, root_learns: bool) -> TaskGraph:
    """The graph of the subtasks that learn: all, or all but the root.

    Raises:
        ValueError: as `hrljax.hierarchy.tables.tabulate`.
    """
    tables = tabulate(hierarchy, env)
    offset = 0 if root_learns else 1
    kinds: list[Kind] = []
    kind_of: list[int] = []
    for task in hierarchy.subtasks[offset:]:
        kind = Kind(
            tuple(hierarchy.actions.index(c) if hierarchy.is_primitive(c) else -1 for c in task.children),
            tuple(-1 if hierarchy.is_primitive(c) else hierarchy.index(c) - offset for c in task.children),
        )
        if kind not in kinds:
            kinds.append(kind)
        kind_of.append(kinds.index(kind))
    first = [hierarchy.root.name] if root_learns else list(hierarchy.root.children)
    level = [hierarchy.index(name) - offset for name in first]
    levels = []
    while level:
        levels.append(tuple(sorted(set(level))))
        level = [t for task in levels[-1] for t in kinds[kind_of[task]].tasks if t >= 0]
    return TaskGraph(tables, env.num_states, env.num_actions, offset, tuple(kinds), tuple(kind_of), tuple(levels))
