"""What a hierarchical learner's table says of the children of a subtask.

The numbers of all children of a subtask in one state lie side by side, a *row*, and rows lie state
by state, subtask by subtask (`hrljax.hierarchy.layout.StackLayout.start`).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take_row
from hrljax.hierarchy.layout import ChildSet, StackLayout
from hrljax.learners.base import Context, Control, Learner, Prepared, Tables
from hrljax.learners.fading import Seen
from hrljax.learners.roots.base import ChildValue

Q = TypeVar("Q", bound=tuple[Array, ...])
"""Type of the values of one child: a NamedTuple of float32 scalars."""


class Known(NamedTuple):
    """What is known when a subtask decides."""

    layout: StackLayout
    q: Array  # values of children
    seen: Seen | None  # what a pseudo-reward that fades goes by
    context: Context


class Row(NamedTuple, Generic[Q]):
    """The children of a subtask in a state."""

    values: list[Q]  # slot by slot
    allowed: list[Array | None]  # whether each can be invoked; None where it always can
    best: Array  # int32: the greedy slot, the first of equally good ones
    of_best: Q  # the values of the child in it
    worth: list[Array]  # what is greedily chosen by, slot by slot


class ChildValues(Learner[Prepared, Tables, Control], Generic[Prepared, Tables, Control, Q]):
    """Reads the values of children from one array ``[tasks * S * K * numbers]``; subclasses say what they mean."""

    @abstractmethod
    def initial(self, is_root: bool) -> Q:
        """The values of a child before the first episode, of the root or of another subtask."""

    @abstractmethod
    def q_total(self, q: Q) -> Array:
        """What a child is worth (float32 scalar)."""

    @abstractmethod
    def value_until_end(self, q: Q) -> Array:
        """The part of a value that a subtask's parent sees: until the subtask ends."""

    @abstractmethod
    def of_subtask(self, stored: Q, best: Q) -> Q:
        """The values of a child that is a subtask.

        Args:
            stored: what its parent has learned of it.
            best: the values of its own greedy child.
        """

    def preference(self, known: Known, state: Array) -> Callable[[Q], Array]:
        """What choices in a state are greedy in (float32 scalar)."""
        return self.q_total

    def initial_values(self, layout: StackLayout, root_learns: bool) -> Array:
        """The table before the first episode."""
        cells = layout.num_states * layout.num_slots

        def tiled(q: Q, times: int) -> Array:
            return jnp.tile(jnp.stack([jnp.asarray(number, jnp.float32) for number in q]), times)

        values = tiled(self.initial(is_root=False), layout.num_tasks * cells)
        if not root_learns:
            return values
        of_root = tiled(self.initial(is_root=True), cells)
        return jnp.concatenate([of_root, values[len(of_root) :]])

    @property
    def _size(self) -> int:
        """Stored numbers of a child."""
        return len(self.initial(is_root=False))

    def _stored(self, known: Known, children: ChildSet, task: Array, state: Array) -> list[Q]:
        """What is stored of a subtask's children in a state, slot by slot."""
        size, make = self._size, type(self.initial(is_root=False))
        numbers = take_row(known.q, known.layout.start(task, state, size), children.num_slots * size)
        return [make(*(numbers[slot * size + i] for i in range(size))) for slot in range(children.num_slots)]

    def _stored_in(self, known: Known, children: ChildSet, task: Array, state: Array, slot: Array) -> Q:
        """What is stored of the child in one slot."""
        size, make = self._size, type(self.initial(is_root=False))
        numbers = take_row(known.q, known.layout.start_of_child(task, state, slot, size), size)
        return make(*(numbers[i] for i in range(size)))

    def _row(self, known: Known, children: ChildSet, task: Array, state: Array) -> Row[Q]:
        """The values of a subtask's children in a state."""
        values = self._stored(known, children, task, state)
        for slot, child in enumerate(children.tasks):
            if child >= 0:
                best = self._best(known, known.layout.children(child), jnp.int32(child), state)
                values[slot] = self.of_subtask(values[slot], best)
        allowed, never = known.layout.allowed(children, state), jnp.float32(-np.inf)
        preference = self.preference(known, state)
        worth = [
            preference(q) if can is None else lax.select(can, preference(q), never)
            for q, can in zip(values, allowed, strict=True)
        ]
        return Row(values, allowed, *choices.greedy_of(worth, values), worth)

    def _best(self, known: Known, children: ChildSet, task: Array, state: Array) -> Q:
        """The values of a subtask's greedy child."""
        return self._row(known, children, task, state).of_best

    def _child_value(self, known: Known) -> ChildValue:
        """A subtask's value until it ends, at what it would do itself (thesis eq. 3.3)."""

        def value(task: Array, state: Array) -> Array:
            best = known.layout.by_child_set(
                known.layout.levels[0], task, lambda children: self._best(known, children, task, state)
            )
            return self.value_until_end(best)

        return value
