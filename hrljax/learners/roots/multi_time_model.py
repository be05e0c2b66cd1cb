"""The multi-time model of a subtask's outcomes (thesis eq. 4.3-4.4; Precup and Sutton 1997).

For each decision point and subtask: the discounted probability ``sum_N gamma^N P(x', N)`` that the
subtask ends in the planning state x'. Only the M outcomes that can occur are stored, and after them
how often the subtask was tried. The entries of all environment parts lie side by side.
"""

import jax.numpy as jnp
from jax import Array, lax

from hrljax.learners.updates import increment


def updated(
    entries: list[Array],
    outcomes: list[Array],
    outcome: Array,
    weight: Array,
    step_size: Array,
    learns: Array,
    zero: Array,
) -> list[Array]:
    """The entries of a subtask that has just ended (eq. 4.4).

    The step size is ``max(step_size, 1 / n)`` at the n-th time: a constant one from empty entries
    would leave probabilities that sum to less than one for many trials, which looks like a reward.

    Args:
        entries: float32 scalars, M probabilities and the count.
        outcomes: M int32 planning parts, no two alike; unused ones negative.
        outcome: int32, where the subtask ended.
        weight: float32, discount to the power of its steps; 0 if the episode terminated.
        step_size: float32.
        learns, zero: as in `hrljax.learners.updates.increment`.
    """
    *probabilities, count = entries
    size = lax.max(step_size, 1 / (count + 1))
    targets = [lax.select(reached == outcome, weight, jnp.zeros_like(weight)) for reached in outcomes]
    new = [increment(old, target, size, learns, zero) for old, target in zip(probabilities, targets, strict=True)]
    return [*new, count + learns.astype(jnp.float32)]
