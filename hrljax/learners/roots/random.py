"""A root that knows nothing."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core.numerics import take
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import TaskTables, tabulate
from hrljax.learners.roots.base import ChildValue, Decision, Root


@dataclass(frozen=True)
class RandomRoot(Root):
    """Chooses uniformly among the subtasks that can be invoked, and learns nothing (thesis Fig. 4.2(b))."""

    name = "random"

    def prepare(self, hierarchy: Hierarchy, env: AnyTabularEnvironment) -> TaskTables:
        return tabulate(hierarchy, env)

    def choose(
        self,
        prepared: TaskTables,
        tables: Any,
        child_value: ChildValue,
        state: Array,
        word: Array,
        epsilon: Any,
        zero: Array,
    ) -> tuple[Decision, Any]:
        count = take(jnp.asarray(prepared.root_counts), state)
        slot = (word % count.astype(jnp.uint32)).astype(jnp.int32)
        width = prepared.root_children.shape[1]
        task = take(jnp.asarray(prepared.root_children.ravel()), state * width + slot) - 1
        return Decision(task, jnp.int32(0), slot), ()

    def probabilities(
        self, prepared: TaskTables, tables: Any, child_value: ChildValue, state: Array, zero: Array
    ) -> Array:
        invocable = np.zeros(prepared.active.shape, np.float32)
        for slot in range(prepared.root_children.shape[1]):
            where = np.flatnonzero(prepared.root_counts > slot)
            invocable[prepared.root_children[where, slot], where] = 1
        share = invocable[1:] / np.maximum(prepared.root_counts, 1)
        return jnp.asarray(share.T.astype(np.float32))[state]
