"""Calling stacks of a task graph, and which of them has control after a step."""

from typing import Literal, NamedTuple

import numpy as np

from hrljax.hierarchy.definition import Hierarchy

MAX_CONTEXTS = 4096
Termination = Literal["immediate", "on_return"]


class Contexts(NamedTuple):
    """The calling stacks of a task graph, callers before the called; the first holds the top alone."""

    task: np.ndarray  # [C] int: the subtask that decides
    parent: np.ndarray  # [C] int: the context that called it; -1 for the top
    called: np.ndarray  # [C, K] int: the context of the child in each slot; -1 for actions and empty slots

    @property
    def size(self) -> int:
        return len(self.task)

    def under(self, context: int) -> np.ndarray:
        """``[C]`` bool: the context and everything that it calls, directly or not."""
        inside = np.zeros(self.size, np.bool_)
        inside[context] = True
        for later in range(context + 1, self.size):
            inside[later] = self.parent[later] >= 0 and inside[self.parent[later]]
        return inside


def contexts(hierarchy: Hierarchy, top: str | None = None) -> Contexts:
    """Every path from a subtask (the root if None) to a subtask below it.

    Raises:
        KeyError: there is no such subtask.
        ValueError: there are more than `MAX_CONTEXTS` of them.
    """
    width = max(len(task.children) for task in hierarchy.subtasks)
    stacks = [(hierarchy.index(top or hierarchy.root.name), -1)]
    called: list[np.ndarray] = []
    while len(called) < len(stacks):
        number = len(called)
        called.append(np.full(width, -1))
        for slot, child in enumerate(hierarchy.subtasks[stacks[number][0]].children):
            if not hierarchy.is_primitive(child):
                called[number][slot] = len(stacks)
                stacks.append((hierarchy.index(child), number))
        if len(stacks) > MAX_CONTEXTS:
            raise ValueError(f"the hierarchy has more than {MAX_CONTEXTS} calling stacks")
    task, parent = np.array(stacks).T
    return Contexts(task, parent, np.stack(called))


def control(stacks: Contexts, active: np.ndarray, termination: Termination) -> tuple[np.ndarray, np.ndarray]:
    """Where each context can have control ``[C, S]``, and which one has it after a step ``[C, S]``.

    A step's control goes to -1 where the top has terminated.
    """
    live = np.zeros((stacks.size, active.shape[1]), np.bool_)
    resumed = np.zeros(live.shape, np.int64)
    for number, (task, parent) in enumerate(zip(stacks.task, stacks.parent, strict=True)):
        interrupted = termination == "immediate" and parent >= 0
        live[number] = active[task] & live[parent] if interrupted else active[task]
        resumed[number] = np.where(live[number], number, resumed[parent] if parent >= 0 else -1)
    return live, resumed
