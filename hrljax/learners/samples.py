"""A model that keeps what it saw: up to K outcomes of every (state, action) pair.

It needs no bound on the successors of a pair, and knows of the environment only what happened.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.core.counting import one_more
from hrljax.core.numerics import put_row, take
from hrljax.learners.base import Transition


class Samples(NamedTuple):
    """Outcomes seen, for P = S * A pairs ``state * A + action``; K slots, one after the other."""

    seen: Array  # [P] int32: outcomes seen so far (see `one_more`); more than K where old ones were overwritten
    after: Array  # [K * P] int32: next state, S where the episode terminated
    reward: Array  # [K * P] float32


def empty(num_states: int, num_actions: int, num_slots: int) -> Samples:
    """Nothing seen yet: every outcome would terminate without a reward."""
    pairs = num_states * num_actions
    return Samples(
        jnp.zeros(pairs, jnp.int32),
        jnp.full(num_slots * pairs, num_states, jnp.int32),
        jnp.zeros(num_slots * pairs, jnp.float32),
    )


def recorded(samples: Samples, pair: Array, transition: Transition, num_states: int, learns: Array) -> Samples:
    """The samples with one more, if `learns`; K later it is overwritten."""
    num_pairs = len(samples.seen)
    num_slots = len(samples.after) // num_pairs
    seen = take(samples.seen, pair)
    place = seen % num_slots * num_pairs + pair
    after = lax.select(transition.terminated, jnp.int32(num_states), transition.next_state)
    after = lax.select(learns, after, take(samples.after, place))
    reward = lax.select(learns, transition.reward, take(samples.reward, place))
    return Samples(
        put_row(samples.seen, pair, one_more(seen, num_slots, learns)[None]),
        put_row(samples.after, place, after[None]),
        put_row(samples.reward, place, reward[None]),
    )
