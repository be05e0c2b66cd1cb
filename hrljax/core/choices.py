"""Choosing among a few scalars: the greatest, the one at an index, a random one."""

from collections.abc import Sequence
from typing import Literal, TypeAlias, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.flags import choose
from hrljax.core.random import threshold

T = TypeVar("T")

Ties: TypeAlias = Literal["first", "random"]
"""Which of equally good ones is taken: the first, or any, each as likely as the others."""


def greedy(values: list[Array]) -> tuple[Array, Array]:
    """Index (int32) and value of the greatest of a few scalars; ties go to the first."""
    return greedy_of(values, values)


def greedy_of(values: list[Array], of_each: Sequence[T]) -> tuple[Array, T]:
    """Index (int32) of the greatest of a few scalars, and what belongs to it (a pytree); ties go to the first.

    A tournament: its rounds are fewer than values, and the index goes by bits, because selects of it would become
    branches, which a learning agent makes unpredictable.
    """
    numbered = enumerate(zip(values, of_each, strict=True))
    players = [(value, jnp.int32(i), belongings) for i, (value, belongings) in numbered]
    while len(players) > 1:
        winners = [_winner(*pair) for pair in zip(players[::2], players[1::2], strict=False)]
        players = winners + players[2 * len(winners) :]
    return players[0][1:]


def _winner(left: tuple[Array, Array, T], right: tuple[Array, Array, T]) -> tuple[Array, Array, T]:
    right_wins = right[0] > left[0]
    mask = -right_wins.astype(jnp.int32)
    index = left[1] ^ ((left[1] ^ right[1]) & mask)
    value, belongings = choose(right_wins, (right[0], right[2]), (left[0], left[2]))
    return value, index, belongings


def greedy_by(ties: Ties, values: list[Array], first: Array, word: Array) -> Array:
    """Index (int32) of the greatest of a few scalars, of which `first` is the first; uses one word for a random one."""
    if ties == "first":
        return first
    return nth_allowed([value == pick(values, first) for value in values], word)


def pick(values: Sequence[T], index: Array) -> T:
    """``values[index]`` for a few pytrees of scalars."""
    chosen = values[0]
    for i, value in enumerate(values[1:], start=1):
        chosen = choose(index == i, value, chosen)
    return chosen


def epsilon_greedy(greedy_action: Array, num_actions: int, word: Array, epsilon: Array) -> Array:
    """The greedy action, or with probability `epsilon` a uniformly random one; uses one word."""
    anything = (word % np.uint32(num_actions)).astype(jnp.int32)
    return lax.select(word < threshold(epsilon), anything, greedy_action)


def nth_allowed(allowed: list[Array], word: Array) -> Array:
    """A uniformly random one of the allowed slots (int32)."""
    count = sum((a.astype(jnp.uint32) for a in allowed), jnp.uint32(0))
    skip = word % lax.max(count, jnp.uint32(1))
    chosen, seen = jnp.int32(0), jnp.uint32(0)
    for slot, is_allowed in enumerate(allowed):
        chosen = lax.select(is_allowed & (seen == skip), jnp.int32(slot), chosen)
        seen = seen + is_allowed.astype(jnp.uint32)
    return chosen
