"""What a hierarchy does, as numbers."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from hrljax.core.environment import AnyTabularDynamics
from hrljax.hierarchy.definition import Hierarchy, Subtask
from hrljax.hierarchy.layout import StackLayout, stack_layout


class HierarchicalPolicy(NamedTuple):
    """What every learning subtask does; T subtasks, S states."""

    layout: StackLayout
    slots: Array  # [T, S] int32: slot of the child that is invoked
    choice: Array | None  # [S, T] float32: probabilities that a root that does not learn invokes each subtask


def flat_policy(env: AnyTabularDynamics, actions: Array) -> HierarchicalPolicy:
    """The policy without subtasks that takes ``actions[s]`` (int32 ``[S]``) in state s."""
    root = Subtask("Root", env.action_names, lambda state: jnp.bool_(False))
    layout = stack_layout(Hierarchy(env.action_names, [root]), env, root_learns=True)
    return HierarchicalPolicy(layout, actions[None], None)
