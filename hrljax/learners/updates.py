"""Update rules as pure scalar functions, in the manner of rlax.

The suffix ``_t`` marks what a step led to. Values of a next state are 0 where the episode
terminated; a truncated episode keeps its bootstrap.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product


class Parts(NamedTuple):
    """The decomposed value of one child in one state of one subtask (thesis eq. 3.2), scalars.

    Without its pseudo-reward, the value is ``reward + completion + exit``.
    """

    reward: Array  # Q_r: until the child ends
    completion: Array  # Q_c: from there until the subtask ends
    exit: Array  # Q_e: from there until the episode ends
    pseudo: Array  # Q_p: pseudo-reward on ending the subtask, kept apart from the real reward

    def __add__(self, other: object) -> "Parts":  # the tuple's concatenation would hide mistakes
        return NotImplemented


def increment(old: Array, target: Array, step_size: Array, live: Array, zero: Array) -> Array:
    """``old + step_size * (target - old)`` where `live`, else `old`; any shape."""
    change = exact_product(jnp.broadcast_to(step_size, old.shape), target - old, zero)
    return old + lax.select(jnp.broadcast_to(live, old.shape), change, jnp.zeros_like(old))


def traced_increment(old: Array, change: Array, trace: Array, live: Array, zero: Array) -> Array:
    """``old + trace * change`` where `live`, else `old`: one pair's share of a TD error; any one shape.

    With a trace of 1 and ``change = step_size * (target - old)`` it is `increment`, bit for bit.
    """
    return old + lax.select(live, exact_product(trace, change, zero), jnp.zeros_like(old))


def td_target(reward_t: Array, discount_t: Array | np.float32, value_t: Array, zero: Array) -> Array:
    """``r + discount * value``: of Q-learning with the greatest value, of SARSA with the next action's."""
    return reward_t + exact_product(discount_t, value_t, zero)


def hordq_targets(
    reward_t: Array, discount_t: Array | np.float32, exited: Array, pseudo_reward_t: Array, next_t: Parts, zero: Array
) -> Parts:
    """Targets of HORDQ (thesis eq. 3.10-3.12) for one child that has just ended in one subtask.

    Where the subtask goes on, each part bootstraps on the same part. Where it ended, nothing is
    left to complete, and the exit value bootstraps on the whole value of the next subtask of the
    leaf cover. (Read literally, eq. 3.11 would count the next subtask's reward twice there; eq. 3.4
    sums over active states only.) The pseudo-reward never enters the three real parts.

    Args:
        reward_t: reward since the child began.
        discount_t: discount to the power of the child's steps.
        exited: bool, the subtask ended.
        pseudo_reward_t: paid if `exited`; not discounted.
        next_t: values at the next state, of the child that the bootstrap picks: in the same
            subtask if it goes on, else in the next subtask of the leaf cover; 0 if the episode
            terminated.
        zero: see `hrljax.core.numerics.opaque_zero`.
    """
    nothing = jnp.zeros_like(reward_t)
    to_completion = next_t.reward + next_t.completion
    to_exit = lax.select(exited, to_completion + next_t.exit, next_t.exit)
    pseudo = lax.select(exited, nothing, exact_product(discount_t, next_t.pseudo, zero))
    return Parts(
        reward=reward_t,
        completion=lax.select(exited, nothing, exact_product(discount_t, to_completion, zero)),
        exit=exact_product(discount_t, to_exit, zero),
        pseudo=lax.select(exited, pseudo_reward_t, pseudo),
    )
