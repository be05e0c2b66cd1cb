"""A task hierarchy as arrays over the numbers of an environment's states."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hrljax.core import checks, contract
from hrljax.core.environment import AnyTabularDynamics, TabularDynamics
from hrljax.core.tracing_errors import explain_tracing
from hrljax.hierarchy.definition import Hierarchy, Predicate, Subtask


@dataclass(frozen=True, eq=False)
class TaskTables:
    """What a tabular hierarchical learner reads of a hierarchy. Subtasks are numbered, the root is 0."""

    active: np.ndarray  # [tasks, S] bool: the subtask can be invoked and goes on
    goal: np.ndarray  # [tasks, S] float32: factor of the pseudo-reward on termination
    root_invokes: np.ndarray  # [tasks] bool: the root has it as a child
    root_children: np.ndarray  # [S, K] int32: subtasks that the root may invoke, the first `root_counts`
    root_counts: np.ndarray  # [S] int32

    @property
    def num_tasks(self) -> int:
        return self.active.shape[0]


def over_states(function: Predicate, env: AnyTabularDynamics, what: str, kinds: Any, kind: str) -> np.ndarray:
    """The value of a function of one state at every state number, ``[S]``.

    Args:
        function: of a state.
        env: whose states.
        what: the function's name in messages.
        kinds: what it may return, as a tuple of NumPy's kinds of scalars.
        kind: what messages call that.

    Raises:
        TypeError: the function returns something else, or cannot be traced by JAX.
    """

    def at(index: jax.Array) -> jax.Array:
        value = function(contract.decode(env, index))
        dtype = checks.dtype_of_scalar(value)
        if dtype is None or not any(jnp.issubdtype(dtype, allowed) for allowed in kinds):
            raise TypeError(f"{what} must return {kind} for a state, not {checks.returned(value)}")
        return jnp.asarray(value)

    with explain_tracing(what), jax.ensure_compile_time_eval():
        return np.asarray(jax.vmap(at)(jnp.arange(env.num_states, dtype=jnp.int32)))


def _terminated(task: Subtask, env: AnyTabularDynamics) -> np.ndarray:
    """``[S]`` bool: where a subtask is terminated."""
    return over_states(task.termination, env, f"subtask {task.name!r}: termination", (np.bool_,), "one bool")


def _goal(task: Subtask, env: AnyTabularDynamics) -> np.ndarray:
    """``[S]`` float32: the factor of a subtask's pseudo-reward."""
    if task.goal is None:
        return np.zeros(env.num_states, np.float32)
    what = f"subtask {task.name!r}: goal"
    goal = over_states(task.goal, env, what, (np.bool_, np.integer, np.floating), "one bool or number")
    goal = goal.astype(np.float32)
    if not np.isfinite(goal).all():
        state = int(np.argmin(np.isfinite(goal)))
        raise ValueError(f"{what} must return finite numbers, got {goal[state]} in {state_in_words(env, state)}")
    return goal


def parts_of_states(task: Subtask, env: AnyTabularDynamics) -> list[np.ndarray]:
    """Numbers of the two parts of every state, planning and environment, ``[S]`` each; none without an abstraction."""
    parts = {} if task.abstraction is None else task.abstraction._asdict()
    return [
        over_states(part, env, f"subtask {task.name!r}: abstraction.{name}", (np.bool_, np.integer), "one integer")
        for name, part in parts.items()
    ]


def state_in_words(env: AnyTabularDynamics, state: int) -> str:
    """A state with its number, for messages."""
    with jax.ensure_compile_time_eval():
        fields = jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), contract.decode(env, jnp.int32(state)))
        return f"state {state}, {fields}"


@lru_cache(maxsize=64)
def tabulate(hierarchy: Hierarchy, env: AnyTabularDynamics) -> TaskTables:
    """Evaluates a hierarchy's predicates at every state.

    Raises:
        TypeError: an argument is of the wrong kind, or a predicate returns something of the wrong kind.
        ValueError: the actions differ from the environment's, there are more than 32 subtasks, or
            an active subtask has no child to invoke in some state. The message names the subtask.
    """
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
    checks.instance("env", env, TabularDynamics, "a tabular environment such as hrljax.make('Bus')")
    if hierarchy.actions != env.action_names:
        raise ValueError(f"the hierarchy is over actions {hierarchy.actions}, {env.name} has {env.action_names}")
    if len(hierarchy.subtasks) > 32:
        raise ValueError(f"a hierarchy has at most 32 subtasks, got {len(hierarchy.subtasks)}")
    active = np.stack([~_terminated(task, env) for task in hierarchy.subtasks])
    goal = np.stack([_goal(task, env) for task in hierarchy.subtasks])
    for number, task in enumerate(hierarchy.subtasks):
        if not active[number].any():
            raise ValueError(f"subtask {task.name!r} is terminated in every state")
        if any(map(hierarchy.is_primitive, task.children)):
            continue
        stuck = active[number] & ~active[[hierarchy.index(c) for c in task.children]].any(0)
        if stuck.any():
            where = state_in_words(env, int(np.flatnonzero(stuck)[0]))
            raise ValueError(
                f"subtask {task.name!r} has no child to invoke in {stuck.sum()} states, for example in {where}"
            )
    children = [hierarchy.index(c) for c in hierarchy.root.children if not hierarchy.is_primitive(c)]
    invokes = np.isin(np.arange(len(hierarchy.subtasks)), children)
    counts = active[children].sum(0).astype(np.int32)
    slots = np.zeros((env.num_states, max(int(counts.max(initial=0)), 1)), np.int32)
    for state, slot in zip(*np.nonzero(active[children].T), strict=True):
        slots[state, int(np.sum(active[children[:slot]][:, state]))] = children[slot]
    return TaskTables(active, goal, invokes, slots, counts)
