"""A root that knows nothing."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core.numerics import take
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import TaskTables, tabulate
from hrljax.learners.base import Context
from hrljax.learners.roots.base import ChildValue, Decision, MemorylessRoot, Question


@dataclass(frozen=True)
class RandomRoot(MemorylessRoot[TaskTables]):
    """Chooses uniformly among the subtasks that can be invoked, and learns nothing (thesis Fig. 4.2(b))."""

    name = "random"

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> TaskTables:
        return tabulate(hierarchy, env)

    def begin(self, prepared: TaskTables, tables: tuple[()], asked: Question, context: Context) -> Decision[tuple[()]]:
        count = take(jnp.asarray(prepared.root_counts), asked.state)
        slot = (asked.word % count.astype(jnp.uint32)).astype(jnp.int32)
        width = prepared.root_children.shape[1]
        return Decision(take(jnp.asarray(prepared.root_children.ravel()), asked.state * width + slot) - 1, ())

    def probabilities(
        self, prepared: TaskTables, tables: tuple[()], child_value: ChildValue, state: Array, context: Context
    ) -> Array:
        invocable = np.zeros(prepared.active.shape, np.float32)
        for slot in range(prepared.root_children.shape[1]):
            where = np.flatnonzero(prepared.root_counts > slot)
            invocable[prepared.root_children[where, slot], where] = 1
        share = invocable[1:] / np.maximum(prepared.root_counts, 1)
        return jnp.asarray(share.T.astype(np.float32))[state]
