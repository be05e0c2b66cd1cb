"""Greedy policies in plain NumPy, for use where nothing else of hrljax runs."""

from dataclasses import dataclass, field
from operator import index
from typing import Any

import numpy as np

Stack = tuple[int, ...]
"""Numbers of the subtasks that run, from the first that was invoked to the last."""


@dataclass(eq=False)
class Policy:
    """What a learner does without exploration. A flat one is a single subtask that never ends.

    Call it with the numbers of the states that are visited, one after the other; `reset` it before
    every episode. T subtasks, S states, K slots.

    Attributes:
        slots: ``[T, S]`` int32: slot of the child that a subtask invokes.
        actions: ``[T, K]`` int32: primitive action in a slot, -1 where there is a subtask.
        tasks: ``[T, K]`` int32: subtask in a slot, -1 where there is an action.
        active: ``[T, S]`` bool: whether a subtask goes on in a state.
        choice: ``[S, T]`` float: probabilities that a root which is no subtask here invokes each
            subtask; None if subtask 0 is the root.
        generator: draws the choices of a root that chooses at random.
    """

    slots: np.ndarray
    actions: np.ndarray
    tasks: np.ndarray
    active: np.ndarray
    choice: np.ndarray | None = None
    generator: np.random.Generator = field(default_factory=np.random.default_rng)
    stack: Stack = ()

    def reset(self) -> None:
        """Begins an episode."""
        self.stack = ()

    def __call__(self, state: int) -> int:
        """The primitive action in a state (its number).

        Raises:
            TypeError: the state is no integer.
            ValueError: the state has no such number.
        """
        try:
            state = index(state)
        except TypeError:
            raise TypeError(f"state must be the number of a state, an integer, got {state!r}") from None
        if not 0 <= state < self.slots.shape[1]:
            raise ValueError(f"state must be a number in [0, {self.slots.shape[1]}), got {state!r}")
        stack = self.left(self.stack, state)
        self.stack, action = self.decide(stack or (self._first(state),), state)
        return action

    def left(self, stack: Stack, state: int) -> Stack:
        """What is left of a stack: a subtask that ends takes all with it that it had invoked."""
        for level, task in enumerate(stack):
            is_root = level == 0 and self.choice is None
            if not is_root and not self.active[task, state]:
                return stack[:level]
        return stack

    def decide(self, stack: Stack, state: int) -> tuple[Stack, int]:
        """The stack and the primitive action after the last subtask of a stack, not empty, decides."""
        while True:
            task = stack[-1]
            slot = self.slots[task, state]
            if self.actions[task, slot] >= 0:
                return stack, int(self.actions[task, slot])
            stack = (*stack, int(self.tasks[task, slot]))

    def _first(self, state: int) -> int:
        if self.choice is None:
            return 0
        chances = np.asarray(self.choice[state], np.float64)
        if chances.max() == 1:
            return int(chances.argmax())
        return int(self.generator.choice(len(chances), p=chances / chances.sum()))


def from_hierarchical(policy: Any, generator: np.random.Generator) -> Policy:
    """The same as a `hrljax.hierarchy.policy.HierarchicalPolicy`."""
    layout = policy.layout
    children = [layout.children(task) for task in range(layout.num_tasks)]

    def padded(rows: list[tuple[int, ...]]) -> np.ndarray:
        return np.array([(*row, *[-1] * (layout.num_slots - len(row))) for row in rows], np.int32)

    return Policy(
        slots=np.asarray(policy.slots),
        actions=padded([of_task.actions for of_task in children]),
        tasks=padded([of_task.tasks for of_task in children]),
        active=layout.active,
        choice=None if policy.choice is None else np.asarray(policy.choice),
        generator=generator,
    )
