"""The multi-time model of a subtask's outcomes (thesis eq. 4.3-4.4; Precup and Sutton 1997).

For each decision point and subtask: the discounted probability ``sum_N gamma^N P(x', N)`` that the
subtask ends in the planning state x'. Only outcomes that can occur are stored, so that one row fits
a cache line; the last entry of a row counts the times that the subtask was tried.
"""

import jax.numpy as jnp
from jax import Array, lax

from hrljax.learners.td import increment
from hrljax.numerics import exact_product


def updated_row(
    row: Array, outcomes: Array, outcome: Array, weight: Array, step_size: Array, live: Array, zero: Array
) -> Array:
    """The row of a subtask that has just ended (eq. 4.4).

    The step size is ``max(step_size, 1 / n)`` at the n-th time: a constant one from an empty row
    would leave probabilities that sum to less than one for many trials, which looks like a reward.

    Args:
        row: ``[M + 1]`` float32, M probabilities and the count.
        outcomes: ``[M]`` int32 planning states, repeated ones never occur; unused ones negative.
        outcome: int32, where the subtask ended.
        weight: float32, discount to the power of its steps; 0 if the episode terminated.
        step_size: float32.
        live, zero: as in `hrljax.learners.td.increment`.
    """
    count = row[-1]
    size = lax.max(step_size, 1 / (count + 1))
    target = lax.select(outcomes == outcome, jnp.broadcast_to(weight, outcomes.shape), jnp.zeros_like(row[:-1]))
    probabilities = increment(row[:-1], target, size, live, zero)
    return jnp.concatenate([probabilities, (count + live.astype(jnp.float32))[None]])


def expectation(probabilities: list[Array], values: list[Array], zero: Array) -> Array:
    """``sum_m p_m v_m`` of M scalars (or arrays) each, added in order."""
    total = jnp.zeros_like(probabilities[0])
    for probability, value in zip(probabilities, values, strict=True):
        total = total + exact_product(probability, value, zero)
    return total
