"""What came after a step: how much a death costs that followed it.

    worth(row) = max over its occurrences of  decay ** k * min(0, last reward)

where the episode ended with the reward k steps later; 0 if it went on for `REACH` steps, or ended well. A plan that is
cut off after a step has that on top: it cannot end just above a pit as if nothing came after it.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take

REACH = 16
"""Steps; what happened before them has nothing to do with a death."""
_UNKNOWN = np.float32(-np.inf)


class Aftermath(NamedTuple):
    """Of N kept rows; the place after the last is written to where nothing is to be kept."""

    worth: Array  # [N + 1] float32; -inf of what has just been met for the first time
    path: Array  # [REACH] int32: the rows of the last steps of this episode, in a ring; N for none
    steps: Array  # int32: of this episode


def nothing_came(rows: int) -> Aftermath:
    """Before the first step."""
    return Aftermath(jnp.full(rows + 1, _UNKNOWN), jnp.full(REACH, rows, jnp.int32), jnp.int32(0))


def after_step(
    known: Aftermath, row: Array, reward: Array, ended: Array, decay: float, learns: Array
) -> tuple[Aftermath, Array]:
    """What is known after one more step, and whether a worth has changed by it.

    Args:
        known: before the step.
        row: the number of the step's row, int32.
        reward: its reward.
        ended: whether the episode ended with it.
        decay: of a death, for every step before it.
        learns: nothing is changed where this is false.
    """
    none, learns = jnp.int32(len(known.worth) - 1), jnp.asarray(learns)
    at = known.steps % np.int32(REACH)
    left = lax.select(learns, take(known.path, at), none)
    is_new = (left < none) & (take(known.worth, left) != 0)
    # Read once, and before it is written (see `hrljax.engine.compiler`).
    worth, path = put_row(known.worth, left, jnp.zeros(1, jnp.float32)), known.path
    path = put_row(path, at, lax.select(learns, row, take(path, at))[None])

    def reckon(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        back, worth, loss, has_changed = carry
        place = take(path, (at + np.int32(REACH) - back) % np.int32(REACH))
        before = take(worth, place)
        after = lax.max(before, loss)
        has_changed = has_changed | ((after != before) & (place < none))
        return back + 1, put_row(worth, place, after[None]), loss * np.float32(decay), has_changed

    is_over = learns & ended
    turns = lax.select(is_over, jnp.int32(REACH), jnp.int32(0))
    begun = (jnp.int32(0), worth, lax.min(reward, jnp.float32(0)), is_new)
    _, worth, _, has_changed = lax.while_loop(lambda carry: carry[0] < turns, reckon, begun)
    path = lax.select(jnp.broadcast_to(is_over, path.shape), jnp.full_like(path, none), path)
    steps = lax.select(is_over, jnp.int32(0), known.steps + learns.astype(jnp.int32))
    return Aftermath(worth, path, steps), has_changed


def worth_of(known: Aftermath) -> Array:
    """``[N]`` float32; 0 of rows of which it is not known yet."""
    return _known(known.worth[:-1])


def worth_at(known: Aftermath, row: Array) -> Array:
    """The worth of one row."""
    return _known(take(known.worth, row))


def _known(worth: Array) -> Array:
    return jnp.where(worth == _UNKNOWN, np.float32(0), worth)
