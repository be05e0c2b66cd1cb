"""What a hierarchical learner's table says of the children of a subtask.

The numbers of all children of a subtask in one state lie side by side, a *row*, and rows lie state
by state, subtask by subtask (`hrljax.hierarchy.layout.StackLayout.start`).
"""

from abc import abstractmethod
from typing import Generic, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take_row
from hrljax.hierarchy.layout import ChildSet, StackLayout
from hrljax.learners.base import Control, Learner, Prepared, Tables
from hrljax.learners.roots.base import ChildValue

Q = TypeVar("Q", bound=tuple[Array, ...])
"""Type of the values of one child: a NamedTuple of float32 scalars; the first is what the child earns itself."""


class Row(NamedTuple, Generic[Q]):
    """The children of a subtask in a state."""

    values: list[Q]  # slot by slot
    allowed: list[Array | None]  # whether each can be invoked; None where it always can
    best: Array  # int32: the greedy slot


class ChildValues(Learner[Prepared, Tables, Control], Generic[Prepared, Tables, Control, Q]):
    """Reads the values of children from one array ``[tasks * S * K * numbers]``; subclasses say what they mean."""

    @abstractmethod
    def initial(self, is_root: bool) -> Q:
        """The values of a child before the first episode, of the root or of another subtask."""

    @abstractmethod
    def q_total(self, q: Q) -> Array:
        """What behaviour and bootstraps are greedy in (float32 scalar)."""

    @abstractmethod
    def value_until_end(self, q: Q) -> Array:
        """The part of a value that a subtask's parent sees: until the subtask ends."""

    @property
    def _size(self) -> int:
        """Stored numbers of a child."""
        return len(self.initial(is_root=False))

    def _row(self, layout: StackLayout, table: Array, children: ChildSet, task: Array, state: Array) -> Row[Q]:
        """The values of a subtask's children in a state.

        What a child that is a subtask earns is not stored, but read from its own values (thesis eq. 3.3).
        """
        size, make = self._size, type(self.initial(is_root=False))
        numbers = take_row(table, layout.start(task, state, size), children.num_slots * size)
        values = [make(*(numbers[slot * size + i] for i in range(size))) for slot in range(children.num_slots)]
        for slot, child in enumerate(children.tasks):
            if child >= 0:
                earned = self._value(layout, table, layout.children(child), jnp.int32(child), state)
                values[slot] = make(earned, *values[slot][1:])
        allowed, never = layout.allowed(children, state), jnp.float32(-np.inf)
        worth = [
            self.q_total(q) if can is None else lax.select(can, self.q_total(q), never)
            for q, can in zip(values, allowed, strict=True)
        ]
        return Row(values, allowed, choices.greedy(worth)[0])

    def _values_of(
        self, layout: StackLayout, table: Array, children: ChildSet, task: Array, state: Array, row: Row[Q], slot: Array
    ) -> Q:
        """The values of the child in one slot of a row."""
        # Read again: to choose among values that are at hand takes longer.
        size = self._size
        stored = take_row(table, layout.start_of_child(task, state, slot, size), size)
        earned = stored[0] if children.is_primitive else choices.pick([q[0] for q in row.values], slot)
        return type(row.values[0])(earned, *(stored[i] for i in range(1, size)))

    def _value(self, layout: StackLayout, table: Array, children: ChildSet, task: Array, state: Array) -> Array:
        """Value of a subtask until it ends, at what it would do itself (thesis eq. 3.3)."""
        row = self._row(layout, table, children, task, state)
        return choices.pick([self.value_until_end(q) for q in row.values], row.best)

    def _child_value(self, layout: StackLayout, table: Array) -> ChildValue:
        def value(task: Array, state: Array) -> Array:
            return layout.by_child_set([0], task, lambda children: self._value(layout, table, children, task, state))

        return value
