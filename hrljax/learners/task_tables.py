"""A task hierarchy as arrays over the numbers of an environment's states."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy import Hierarchy, Predicate
from hrljax.solvers.model import Model


@dataclass(frozen=True, eq=False)
class TaskTables:
    """What a tabular hierarchical learner reads of a hierarchy. Subtasks are numbered, the root is 0."""

    active: np.ndarray  # [tasks, S] bool: the subtask can be invoked and goes on
    goal: np.ndarray  # [tasks, S] float32: factor of the pseudo-reward on termination
    root_children: np.ndarray  # [S, K] int32: subtasks that the root may invoke, the first `root_counts`
    root_counts: np.ndarray  # [S] int32

    @property
    def num_tasks(self) -> int:
        return self.active.shape[0]

    @property
    def active_bits(self) -> np.ndarray:
        """``[S]`` uint32: bit i is set where subtask i is active."""
        return (self.active.astype(np.uint32) << np.arange(self.num_tasks, dtype=np.uint32)[:, None]).sum(0, dtype=np.uint32)


def over_states(predicate: Predicate, env: TabularEnvironment[Any, Any]) -> np.ndarray:
    """The value of a function of one state at every state number, ``[S]``."""
    with jax.ensure_compile_time_eval():
        numbers = jnp.arange(env.num_states, dtype=jnp.int32)
        return np.asarray(jax.vmap(lambda index: predicate(env.decode(index)))(numbers))


@lru_cache(maxsize=64)
def tabulate(hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> TaskTables:
    """Evaluates a hierarchy's predicates at every state.

    Raises:
        ValueError: the actions differ from the environment's, there are more than 32 subtasks, or
            an active subtask has no child to invoke in some state. The message names the subtask.
    """
    if hierarchy.actions != env.action_names:
        raise ValueError(f"the hierarchy is over actions {hierarchy.actions}, {env.name} has {env.action_names}")
    if len(hierarchy.subtasks) > 32:
        raise ValueError(f"a hierarchy has at most 32 subtasks, got {len(hierarchy.subtasks)}")
    active = np.stack([~over_states(task.termination, env).astype(np.bool_) for task in hierarchy.subtasks])
    nowhere = np.zeros(env.num_states, np.float32)
    goal = np.stack([nowhere if t.goal is None else over_states(t.goal, env).astype(np.float32) for t in hierarchy.subtasks])
    for number, task in enumerate(hierarchy.subtasks):
        if not active[number].any():
            raise ValueError(f"subtask {task.name!r} is terminated in every state")
        if any(map(hierarchy.is_primitive, task.children)):
            continue
        stuck = active[number] & ~active[[hierarchy.index(c) for c in task.children]].any(0)
        if stuck.any():
            where = env.decode(np.flatnonzero(stuck)[0])
            raise ValueError(f"subtask {task.name!r} has no child to invoke in {stuck.sum()} states, for example {where}")
    children = [hierarchy.index(c) for c in hierarchy.root.children if not hierarchy.is_primitive(c)]
    counts = active[children].sum(0).astype(np.int32)
    slots = np.zeros((env.num_states, max(int(counts.max(initial=0)), 1)), np.int32)
    for state, slot in zip(*np.nonzero(active[children].T), strict=True):
        slots[state, active[children[:slot], state].sum()] = children[slot]
    return TaskTables(active, goal, slots, counts)


def decision_states(tables: TaskTables, model: Model, initial: np.ndarray) -> np.ndarray:
    """``[S]`` bool: states in which the root decides, at the start or because a subtask ended there."""
    successors = model.successors()
    follows = np.maximum(successors, 0)
    decides = initial > 0
    for active in tables.active[1:]:
        ended = (successors >= 0) & active[:, None, None] & ~active[follows]
        decides[follows[ended]] = True
    return decides
