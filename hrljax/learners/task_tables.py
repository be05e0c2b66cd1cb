"""A task hierarchy as arrays over the numbers of an environment's states."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hrljax import checks
from hrljax.envs import contract
from hrljax.envs.base import TabularEnvironment
from hrljax.hierarchy import Hierarchy, Predicate, Subtask
from hrljax.planners.abstract_dp import DecisionPoints
from hrljax.solvers.model import Model
from hrljax.tracing_errors import explain_tracing

_LANES = 8
"""float32 numbers in a vector register."""


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

    @property
    def active_bits(self) -> np.ndarray:
        """``[S]`` uint32: bit i is set where subtask i is active."""
        return (self.active.astype(np.uint32) << np.arange(self.num_tasks, dtype=np.uint32)[:, None]).sum(
            0, dtype=np.uint32
        )


def over_states(function: Predicate, env: TabularEnvironment[Any, Any], what: str, kinds: Any, kind: str) -> np.ndarray:
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


def _terminated(task: Subtask, env: TabularEnvironment[Any, Any]) -> np.ndarray:
    """``[S]`` bool: where a subtask is terminated."""
    return over_states(task.termination, env, f"subtask {task.name!r}: termination", (np.bool_,), "one bool")


def _goal(task: Subtask, env: TabularEnvironment[Any, Any]) -> np.ndarray:
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


def parts_of_states(task: Subtask, env: TabularEnvironment[Any, Any]) -> list[np.ndarray]:
    """Numbers of the two parts of every state, planning and environment, ``[S]`` each; none without an abstraction."""
    parts = {} if task.abstraction is None else task.abstraction._asdict()
    return [
        over_states(part, env, f"subtask {task.name!r}: abstraction.{name}", (np.bool_, np.integer), "one integer")
        for name, part in parts.items()
    ]


def state_in_words(env: TabularEnvironment[Any, Any], state: int) -> str:
    """A state with its number, for messages."""
    with jax.ensure_compile_time_eval():
        fields = jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), contract.decode(env, jnp.int32(state)))
        return f"state {state}, {fields}"


@lru_cache(maxsize=64)
def tabulate(hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> TaskTables:
    """Evaluates a hierarchy's predicates at every state.

    Raises:
        TypeError: an argument is of the wrong kind, or a predicate returns something of the wrong kind.
        ValueError: the actions differ from the environment's, there are more than 32 subtasks, or
            an active subtask has no child to invoke in some state. The message names the subtask.
    """
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy such as env.hierarchy()")
    checks.instance("env", env, TabularEnvironment, "a tabular environment such as hrljax.make('Bus')")
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


def decision_states(tables: TaskTables, model: Model, initial: np.ndarray) -> np.ndarray:
    """``[S]`` bool: states in which the root decides, at the start or because a subtask ended there."""
    successors = model.successors()
    follows = np.maximum(successors, 0)
    decides = initial > 0
    for active in tables.active[tables.root_invokes]:
        ended = (successors >= 0) & active[:, None, None] & ~active[follows]
        decides[follows[ended]] = True
    return decides


@lru_cache(maxsize=64)
def planning_points(hierarchy: Hierarchy, env: TabularEnvironment[Any, Any]) -> DecisionPoints:
    """The decision points of a root that plans, and the outcomes that each subtask can have there.

    Outcomes are those that are possible under the environment's default parameters.

    Raises:
        ValueError: the root has no abstraction, or it does not tell all states apart.
    """
    tables = tabulate(hierarchy, env)
    if hierarchy.root.abstraction is None:
        raise ValueError(f"a root that plans needs an abstraction; subtask {hierarchy.root.name!r} has none")
    model = env.model()
    decides = decision_states(tables, model, env.initial_distribution())
    planning, environment = parts_of_states(hierarchy.root, env)
    x_of, x_names = _numbered(planning, decides)
    y_of, y_names = _numbered(environment, decides)
    in_grid = (x_of >= 0) & (y_of >= 0)
    num_y = -(-len(y_names) // _LANES) * _LANES
    points = x_of * num_y + y_of
    state = np.zeros(len(x_names) * num_y, np.int32)
    state[points[in_grid]] = np.flatnonzero(in_grid)
    if len(np.unique(points[in_grid])) < in_grid.sum():
        raise ValueError(f"the abstraction of {hierarchy.root.name!r} gives two states the same two parts")
    exists = np.bincount(points[in_grid], minlength=len(state)).astype(np.bool_).reshape(len(x_names), -1)

    can_be = tables.active & tables.root_invokes[:, None]
    invocable: np.ndarray = (can_be[1:, state] & exists.ravel()).reshape(-1, len(x_names), num_y)
    somewhere = np.asarray(invocable.any(2))
    num_slots = max(int(somewhere.sum(0).max()), 1)
    tasks = np.zeros((len(x_names), num_slots), np.int32)
    can_invoke = np.zeros((len(x_names), num_slots, num_y), np.bool_)
    outcomes: list[list[int]] = []
    leaves = [_exits(active, model, planning) for active in tables.active[1:]]
    for x in range(len(x_names)):
        children = np.flatnonzero(somewhere[:, x])
        tasks[x, : len(children)] = children
        can_invoke[x, : len(children)] = invocable[children, x]
        for slot in range(num_slots):
            found = leaves[int(children[slot])](int(x_names[x])) if slot < len(children) else set()
            outcomes.append(sorted(np.searchsorted(x_names, sorted(found)).tolist()))
    widest = max(map(len, outcomes))
    padded = np.array([found + [-1] * (widest - len(found)) for found in outcomes], np.int32)
    return DecisionPoints(
        num_x=len(x_names),
        num_y=num_y,
        num_tasks=tables.num_tasks - 1,
        point=np.where(in_grid, points, 0).astype(np.int32),
        planning=x_of.astype(np.int32),
        state=state,
        tasks=tasks.ravel(),
        can_invoke=can_invoke,
        outcomes=padded.ravel(),
    )


def _numbered(part: np.ndarray, decides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Consecutive numbers for the values that a part takes where the root decides; -1 for others."""
    names = np.unique(part[decides])
    number = np.minimum(np.searchsorted(names, part), len(names) - 1)
    return np.where(names[number] == part, number, -1), names


def _exits(active: np.ndarray, model: Model, planning: np.ndarray) -> Callable[[int], set[int]]:
    """For one subtask: from a planning part to the planning parts in which it can end."""
    successors = model.successors()
    follows = np.maximum(successors, 0)
    inside = (successors >= 0) & active[:, None, None]
    edges: dict[int, set[int]] = {}
    ends: dict[int, set[int]] = {}
    for moves, table in ((inside & active[follows], edges), (inside & ~active[follows], ends)):
        states = np.broadcast_to(np.arange(len(planning))[:, None, None], moves.shape)[moves]
        pairs = np.unique(np.stack([planning[states], planning[follows[moves]]]), axis=1)
        for origin, target in pairs.T.tolist():
            table.setdefault(origin, set()).add(target)

    def from_part(origin: int) -> set[int]:
        seen, queue = {origin}, [origin]
        while queue:
            for target in edges.get(queue.pop(), set()) - seen:
                seen.add(target)
                queue.append(target)
        return set().union(*(ends.get(part, set()) for part in seen))

    return from_part
