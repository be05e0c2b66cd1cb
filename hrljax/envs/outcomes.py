"""Everything that may come of an action, by running an environment on one random word of every kind."""

import math
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax import random
from hrljax.numerics import stage, take

_MOST_CUTS = 64
"""More comparisons of random words than these cost what the table saves."""
_MOST_ENTRIES = 1 << 20
"""A larger table does not stay in a core's cache, and takes long to make."""


class WordKinds:
    """The kinds of words that an environment tells apart; a combination has a number, the last word's kind fastest."""

    def __init__(self, cuts: tuple[tuple[Any, ...], ...]):
        """Kinds of words with the given cuts, see `TabularEnvironment.word_cuts`."""
        thresholds = ([int(random.threshold(cut)) for cut in word_cuts] for word_cuts in cuts)
        # Where each word's kinds begin, and where the last one ends.
        self._edges = [np.unique([0, *word_thresholds, random.WORD_RANGE]) for word_thresholds in thresholds]

    @property
    def count(self) -> int:
        """N, the combinations."""
        return math.prod(len(edges) - 1 for edges in self._edges)

    def weights(self) -> np.ndarray:
        """``[N]`` float64: the probability of each combination."""
        weights = np.ones(1)
        for edges in self._edges:
            weights = np.outer(weights, np.diff(edges) / random.WORD_RANGE).ravel()
        return weights

    def first_words(self) -> tuple[np.ndarray, ...]:
        """For each word, the least of the kind that a combination has: ``[N]`` uint32."""
        return _combined([edges[:-1] for edges in self._edges])

    def last_words(self) -> tuple[np.ndarray, ...]:
        """The same for the greatest."""
        return _combined([edges[1:] - 1 for edges in self._edges])

    def number(self, words: tuple[Array, ...]) -> Array:
        """The number of the combination of kinds that the words have, int32 of their shape."""
        number = jnp.zeros_like(words[0], jnp.int32)
        for word, edges in zip(words, self._edges, strict=True):
            number = number * np.int32(len(edges) - 1)
            for first in edges[1:-1]:
                number += (word >= np.uint32(first)).astype(jnp.int32)
        return number


def _combined(words: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    return tuple(grid.ravel().astype(np.uint32) for grid in np.meshgrid(*words, indexing="ij"))


class Outcomes(NamedTuple):
    """What every action leads to in every state, for each of N kinds of random words."""

    next_state: np.ndarray  # [S, A, N] int32
    reward: np.ndarray  # [S, A, N] float32
    flags: np.ndarray  # [S, A, N] int32: bit 0, the episode terminates; bit i, event i - 1 happens


def enumerate_outcomes(env: Any, params: Any, kinds: WordKinds) -> Outcomes:
    """The outcomes of a tabular environment, by its own `transition`; `params` as from `concrete_params`.

    Raises:
        ValueError: two words of one kind differ in what they lead to, so that `word_cuts` lacks a cut.
    """

    over_words = jax.vmap(partial(numbered_step, env, params), (None, None, 0), axis_size=kinds.count)
    over_actions = jax.vmap(over_words, (None, 0, None))
    over_states = jax.jit(jax.vmap(over_actions, (0, None, None)))
    with jax.ensure_compile_time_eval():
        states = jnp.arange(env.num_states, dtype=jnp.int32)
        actions = jnp.arange(env.num_actions, dtype=jnp.int32)
        ends = kinds.first_words(), kinds.last_words()
        found, by_last = (Outcomes(*map(np.asarray, over_states(states, actions, words))) for words in ends)
    differs = np.any([one != other for one, other in zip(found, by_last, strict=True)], axis=0)
    if differs.any():
        state, action, kind = (int(i) for i in np.argwhere(differs)[0])
        low, high = ([int(word[kind]) for word in words] for words in ends)
        raise ValueError(
            f"{env.name}: word_cuts lacks a probability at which the meaning of a word changes: from state {state}, "
            f"action {env.action_names[action]!r} leads elsewhere with the words {low} than with {high}"
        )
    return found


def numbered_step(
    env: Any, params: Any, state: Array, action: Array, words: tuple[Array, ...]
) -> tuple[Array, Array, Array]:
    """One step of a tabular environment in the numbers of its states: next state, reward, flags as in `Outcomes`."""
    after, reward, terminated, info = env.transition(env.decode(state), action, words, params)
    flags = terminated.astype(jnp.int32)
    for i, name in enumerate(env.metrics, start=1):
        flags |= info[name].astype(jnp.int32) << i
    return env.encode(after), reward, flags


class OutcomeTable:
    """The steps of a tabular environment, looked up instead of computed: the same results, bit for bit.

    An entry is one number that holds the next state, which of the rewards it is, and the flags.
    Entries of one kind of random words lie together, because few kinds make up most steps.

    Attributes:
        entries: ``[N * S * A]`` and more, uint16 or int32.
        rewards: all different rewards, float32.
    """

    def __init__(self, kinds: WordKinds, outcomes: Outcomes, num_events: int):
        self._kinds = kinds
        self._num_actions = outcomes.reward.shape[1]
        self._num_pairs = outcomes.reward[..., 0].size
        bits, which = np.unique(outcomes.reward.view(np.uint32), return_inverse=True)
        self.rewards = bits.view(np.float32)
        self._flag_bits, self._reward_bits = 1 + num_events, (len(bits) - 1).bit_length()
        packed = outcomes.next_state.astype(np.int64) << self._reward_bits | which.reshape(outcomes.reward.shape)
        packed = packed << self._flag_bits | outcomes.flags
        self.fits = packed.max() < 1 << 31
        smallest = np.uint16 if packed.max() < 1 << 16 else np.int32
        entries = np.moveaxis(packed, -1, 0).astype(smallest).ravel()
        # Of a table as long as a power of two, a mask keeps every index inside; a clamp takes longer.
        self.entries = np.pad(entries, (0, (1 << (len(entries) - 1).bit_length()) - len(entries)))
        self._entry = stage(self._read)

    def place(self, words: tuple[Array, ...]) -> Array:
        """Where the entries begin that hold for an environment's words (int32 of their shape)."""
        return self._kinds.number(words) * np.int32(self._num_pairs)

    def _read(self, index: Array) -> Array:
        return take(jnp.asarray(self.entries), index & np.int32(len(self.entries) - 1)).astype(jnp.int32)

    def look_up(self, place: Array, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Next state (int32), reward (float32), and flags as in `Outcomes`, of scalars."""
        entry = self._entry(place + state * np.int32(self._num_actions) + action)
        flags, rest = entry & ((1 << self._flag_bits) - 1), entry >> self._flag_bits
        reward = take(jnp.asarray(self.rewards), rest & ((1 << self._reward_bits) - 1))
        return rest >> self._reward_bits, reward, flags


def outcome_table(env: Any, params: Any) -> OutcomeTable | None:
    """The steps of a tabular environment as a table; None if it would be large or its numbers are traced.

    Made once in a process for an environment and its numbers.
    """
    numbers = params._replace(max_steps=0)
    if any(isinstance(number, Tracer) for number in numbers):
        return None
    try:
        hash(env)
    except TypeError:
        return _table(env, numbers)
    return _cached_table(env, numbers)


def _table(env: Any, params: Any) -> OutcomeTable | None:
    cuts = env.word_cuts(params)
    if sum(map(len, cuts)) > _MOST_CUTS:
        return None
    kinds = WordKinds(cuts)
    if env.num_states * env.num_actions * kinds.count > _MOST_ENTRIES:
        return None
    table = OutcomeTable(kinds, enumerate_outcomes(env, params, kinds), len(env.metrics))
    return table if table.fits else None


_cached_table = lru_cache(maxsize=32)(_table)
