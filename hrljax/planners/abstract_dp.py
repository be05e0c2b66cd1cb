"""Planning on the multi-time model by dynamic programming over decision points (thesis 4.1.1).

A decision point is a pair of a planning part x, which the model predicts, and an environment part
y, which the plan holds fixed. The backup is eq. 4.1-4.2: the value of a subtask until it ends, plus
the expected value of the planning part that it ends in.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.models.multi_time import expectation


@dataclass(frozen=True, eq=False)
class DecisionPoints:
    """X planning parts times Y environment parts; K subtasks at most in one, M outcomes each.

    Point ``x * Y + y``; model rows are in the order ``[X, K, Y]``.
    """

    num_x: int
    num_y: int
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


def backup(known: Array, until_end: Array, after_end: Array, can_invoke: Array, unknown_value: Array) -> Array:
    """Value of invoking a subtask: eq. 4.1, `unknown_value` if never tried, -inf if it cannot be."""
    value = lax.select(known, until_end + after_end, jnp.broadcast_to(unknown_value, until_end.shape))
    return lax.select(can_invoke, value, jnp.full_like(value, -jnp.inf))


def sweep(points: DecisionPoints, rows: Array, until_end: Array, values: Array, unknown_value: Array, zero: Array) -> Array:
    """One Jacobi sweep over all decision points.

    Args:
        points: the decision points.
        rows: ``[X * K * Y, M + 1]`` float32, rows of the multi-time model.
        until_end: ``[X * K * Y]`` float32, value of each subtask until it ends (Q_r + Q_c of it).
        values: ``[X * Y]`` float32.
        unknown_value: float32 scalar.
        zero: see `hrljax.numerics.opaque_zero`.

    Returns:
        ``[X * Y]`` float32.
    """
    shape = (points.num_x, points.num_slots, points.num_y)
    outcomes = np.maximum(points.outcomes, 0).reshape(*shape[:2], 1, points.num_outcomes)
    follows = (outcomes * shape[2] + np.arange(shape[2])[:, None]).reshape(-1, points.num_outcomes)
    probabilities = [rows[:, m] for m in range(points.num_outcomes)]
    after = [values.at[follows[:, m]].get(mode="promise_in_bounds") for m in range(points.num_outcomes)]
    expected = expectation(probabilities, after, zero)
    can_invoke = jnp.asarray(points.can_invoke.ravel())
    q = backup(rows[:, -1] > 0, until_end, expected, can_invoke, unknown_value).reshape(shape)
    best = q[:, 0]
    for slot in range(1, shape[1]):
        best = lax.max(best, q[:, slot])
    best = lax.select(jnp.asarray(points.can_invoke.any(1)), best, jnp.broadcast_to(unknown_value, best.shape))
    return best.ravel()
