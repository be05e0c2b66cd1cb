"""What a hierarchical learner's tables say of the children of a subtask.

The stored numbers of all children of a subtask in one state lie side by side, a *row*, and rows
lie state by state, subtask by subtask.
"""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take_row
from hrljax.hierarchy.layout import Kind, TaskGraph
from hrljax.learners.base import Learner
from hrljax.learners.roots.base import ChildValue

Values = Any
"""The values of one child: a tuple of float32 scalars."""


class ChildValues(Learner):
    """Reads the values of children from one array ``[tasks * S * K * numbers]``; subclasses say what they mean."""

    @abstractmethod
    def _worth(self, values: Values) -> Array:
        """What behaviour and bootstraps are greedy in (float32 scalar)."""

    @abstractmethod
    def _until_end(self, values: Values) -> Array:
        """The part of a value that a subtask's parent sees: until the subtask ends."""

    @abstractmethod
    def _initial(self, is_root: bool) -> tuple[Any, ...]:
        """Initial values of a child, of the root or of another subtask; the first is of what it earns itself."""

    def _row(self, graph: TaskGraph, parts: Array, kind: Kind, task: Array, state: Array) -> list[Values]:
        """The values of a subtask's children in a state, slot by slot.

        What a child that is a subtask earns is not stored, but read from its own values (thesis eq. 3.3).
        """
        size = self._size
        row = take_row(parts, self._start(graph, task, state), kind.num_slots * size)
        values = [tuple(row[slot * size + i] for i in range(size)) for slot in range(kind.num_slots)]
        for slot, child in enumerate(kind.tasks):
            if child >= 0:
                own = self._value(graph, parts, graph.kind(child), jnp.int32(child), state)
                values[slot] = (own, *values[slot][1:])
        return values

    def _values_of(
        self, graph: TaskGraph, parts: Array, kind: Kind, task: Array, state: Array, row: list[Values], slot: Array
    ) -> Values:
        """The values of the child in one slot of a row."""
        # Read again: to choose among values that are at hand takes longer.
        stored = take_row(parts, self._start(graph, task, state) + slot * self._size, self._size)
        own = stored[0] if kind.is_primitive else choices.pick([values[0] for values in row], slot)
        return (own, *(stored[i] for i in range(1, self._size)))

    @property
    def _size(self) -> int:
        """Stored numbers of a child."""
        return len(self._initial(is_root=False))

    def _start(self, graph: TaskGraph, task: Array, state: Array) -> Array:
        """Where the row of a subtask in a state begins."""
        return (task * graph.num_states + state) * (graph.num_slots * self._size)

    def _best(
        self, graph: TaskGraph, parts: Array, kind: Kind, task: Array, state: Array
    ) -> tuple[Array, list[Values], list[Array | None]]:
        """The greedy slot of a subtask, the values of its children, and which of them can be invoked."""
        row = self._row(graph, parts, kind, task, state)
        allowed = graph.allowed(kind, state)
        never = jnp.float32(-np.inf)
        worth = [
            self._worth(values) if can is None else lax.select(can, self._worth(values), never)
            for values, can in zip(row, allowed, strict=True)
        ]
        return choices.greedy(worth)[0], row, allowed

    def _value(self, graph: TaskGraph, parts: Array, kind: Kind, task: Array, state: Array) -> Array:
        """Value of a subtask until it ends, at what it would do itself (thesis eq. 3.3)."""
        best, row, _ = self._best(graph, parts, kind, task, state)
        return choices.pick([self._until_end(values) for values in row], best)

    def _child_value(self, graph: TaskGraph, parts: Array) -> ChildValue:
        def value(task: Array, state: Array) -> Array:
            return graph.by_kind([0], task, lambda kind: self._value(graph, parts, kind, task, state))

        return value
