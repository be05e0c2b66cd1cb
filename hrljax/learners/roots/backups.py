"""Planning on the multi-time model by dynamic programming over decision points (thesis 4.1.1).

A decision point is a pair of a planning part x, which the model predicts, and an environment part
y, which the plan holds fixed. The backup is eq. 4.1-4.2: the value of a subtask until it ends, plus
the expected value of the planning part that it ends in.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import expectation
from hrljax.learners.roots.decision_points import DecisionPoints


def backup(known: Array, until_end: Array, after_end: Array, can_invoke: Array, unknown_value: Array) -> Array:
    """Value of invoking a subtask: eq. 4.1, `unknown_value` if never tried, -inf if it cannot be."""
    value = lax.select(known, until_end + after_end, jnp.broadcast_to(unknown_value, until_end.shape))
    return lax.select(can_invoke, value, jnp.full_like(value, -jnp.inf))


def sweep(
    points: DecisionPoints, model: Array, until_end: Array, values: Array, unknown_value: Array, zero: Array
) -> Array:
    """One Jacobi sweep over all decision points.

    Args:
        points: the decision points.
        model: ``[X * K, M + 1, Y]`` float32, see `hrljax.learners.roots.multi_time_model`.
        until_end: ``[X * K, Y]`` float32, value of each subtask until it ends (Q_r + Q_c of it).
        values: ``[X, Y]`` float32.
        unknown_value: float32 scalar, of a subtask that was never tried.
        zero: see `hrljax.core.numerics.opaque_zero`.

    Returns:
        ``[X, Y]`` float32.
    """
    outcomes = np.maximum(points.outcomes, 0).reshape(-1, points.num_outcomes)
    *probabilities, count = (model[:, m] for m in range(points.num_outcomes + 1))
    after = [values.at[outcomes[:, m]].get(mode="promise_in_bounds") for m in range(points.num_outcomes)]
    can_invoke = jnp.asarray(points.can_invoke.reshape(until_end.shape))
    worth = backup(count > 0, until_end, expectation(probabilities, after, zero), can_invoke, unknown_value)
    by_slot = worth.reshape(points.can_invoke.shape)
    best = by_slot[:, 0]
    for slot in range(1, points.num_slots):
        best = lax.select(by_slot[:, slot] > best, by_slot[:, slot], best)
    return lax.select(jnp.asarray(points.can_invoke.any(1)), best, jnp.broadcast_to(unknown_value, best.shape))
