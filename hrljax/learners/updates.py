"""Targets that values are moved to, as pure scalar functions, and the one way in which tables move.

Targets are written in the manner of rlax: values of a next state are 0 where the episode
terminated, and a truncated episode keeps its bootstrap. ``gamma`` is a function that discounts,
`hrljax.learners.base.Context.discounted`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import chex
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.flags import Flag, both
from hrljax.core.numerics import exact_product, put_rows, stage, take_row
from hrljax.learners.base import Context, Discounted


def td_target(reward: Array, gamma: Discounted, q_next: Array) -> Array:
    """What a value is moved to after a step: ``Q(s, a) <- r + g Q(s', a')`` (thesis 2.3.1).

    Args:
        reward: float32 scalar.
        gamma: discounts a value.
        q_next: of Q-learning the greatest value in s', of SARSA the next action's; any shape.
    """
    chex.assert_rank(reward, 0)
    chex.assert_type([reward, q_next], float)
    return reward + gamma(q_next)


class Move(NamedTuple):
    """N numbers of a table, side by side, that are to move towards a target."""

    start: Array  # int32: where they begin in the table
    target: Array  # [N] float32
    learns: Flag  # bool, or [N]: where False, they stay as they are


def moved(table: Array, moves: Sequence[Move], step_size: Array, context: Context) -> Array:
    """``x + step_size * (target - x)`` for some rows of a table.

    All rows are read before the first is written, so that the table is changed in place. Where two
    moves have the same place, the first one's numbers stay.

    Args:
        table: ``[M]`` float32.
        moves: the rows and their targets.
        step_size: float32 scalar.
        context: where it does not learn, nothing moves.
    """

    def after(table: Array, moves: list[Move]) -> list[Array]:
        return [
            increment(take_row(table, start, len(target)), target, step_size, learns, context.zero)
            for start, target, learns in moves
        ]

    # All rows by one stage, for the compiler to see that each is read before any is written. With one row there is
    # nothing to keep apart.
    live = [move._replace(learns=jnp.asarray(both(move.learns, context.learns))) for move in moves]
    rows = (stage(after) if len(moves) > 1 else after)(table, live)
    return put_rows(table, [move.start for move in moves][::-1], rows[::-1])


def increment(old: Array, target: Array, step_size: Array, learns: Flag, zero: Array) -> Array:
    """``old + step_size * (target - old)`` where `learns`, else `old`; any shape."""
    change = exact_product(jnp.broadcast_to(step_size, old.shape), target - old, zero)
    return old + lax.select(jnp.broadcast_to(learns, old.shape), change, jnp.zeros_like(old))


def traced_increment(old: Array, change: Array, trace: Array, learns: Array, zero: Array) -> Array:
    """``old + trace * change`` where `learns`, else `old`: one pair's share of a TD error; any one shape.

    With a trace of 1 and ``change = step_size * (target - old)`` it is `increment`, bit for bit.
    """
    return old + lax.select(learns, exact_product(trace, change, zero), jnp.zeros_like(old))
