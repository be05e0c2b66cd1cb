"""Where a root decides: the states, their two parts, and what can be invoked and can happen (thesis 4.1.1)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jax import Array

from hrljax.core.numerics import take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.definition import Hierarchy
from hrljax.hierarchy.tables import TaskTables, parts_of_states, tabulate
from hrljax.solvers.model import Model

_LANES = 8
"""float32 numbers in a vector register."""


@dataclass(frozen=True, eq=False)
class DecisionPoints:
    """X planning parts times Y environment parts; K subtasks at most in one, M outcomes each.

    Point ``x * Y + y``. Y is rounded up to whole vector registers: in a sweep, what is computed for
    one environment part is computed for all.
    """

    num_x: int
    num_y: int
    num_tasks: int  # subtasks without the root
    point: np.ndarray  # [S] int32: point of a state (0 where the root never decides)
    planning: np.ndarray  # [S] int32: x of a state, -1 where the root never decides
    state: np.ndarray  # [X * Y] int32
    tasks: np.ndarray  # [X * K] int32: subtasks, counted without the root
    can_invoke: np.ndarray  # [X, K, Y] bool
    outcomes: np.ndarray  # [X * K * M] int32: planning parts, unused ones -1

    @property
    def num_slots(self) -> int:
        return len(self.tasks) // self.num_x

    @property
    def num_outcomes(self) -> int:
        return len(self.outcomes) // len(self.tasks)

    @property
    def num_points(self) -> int:
        return self.num_x * self.num_y

    # Where numbers lie in flat tables. A pair is ``x * K + slot``: a planning part and a subtask.

    def pair(self, point: Array, slot: Array | int) -> Array:
        return point // self.num_y * self.num_slots + slot

    def at(self, pair: Array, point: Array) -> Array:
        """Of a pair and the environment part of a point, in ``[X * K * Y]``."""
        return pair * self.num_y + point % self.num_y

    def entries(self, pair: Array, point: Array) -> list[Array]:
        """Of a pair's M outcomes and its count, for the environment part of a point, in ``[X * K * (M + 1) * Y]``."""
        y = point % self.num_y
        return [(pair * (self.num_outcomes + 1) + m) * self.num_y + y for m in range(self.num_outcomes + 1)]

    def outcomes_of(self, pair: Array, unused: int = -1) -> list[Array]:
        """The M planning parts in which a pair's subtask can end, int32."""
        outcomes = np.where(self.outcomes < 0, np.int32(unused), self.outcomes)
        row = take_row(jnp.asarray(outcomes), pair * self.num_outcomes, self.num_outcomes)
        return [row[m] for m in range(self.num_outcomes)]


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
def planning_points(hierarchy: Hierarchy, env: AnyTabularEnvironment) -> DecisionPoints:
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
            ends = leaves[int(children[slot])](int(x_names[x])) if slot < len(children) else set()
            outcomes.append(sorted(np.searchsorted(x_names, sorted(ends)).tolist()))
    widest = max(map(len, outcomes))
    padded = np.array([ends + [-1] * (widest - len(ends)) for ends in outcomes], np.int32)
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
