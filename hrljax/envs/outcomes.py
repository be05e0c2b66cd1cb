"""All outcomes of every action, computed by running an environment on one random word of every kind."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from hrljax.core import contract, random
from hrljax.core.environment import AnyTabularDynamics, Numbers, Params, State, TabularDynamics, Words
from hrljax.core.numerics import stage, take
from hrljax.envs.occurring import Outcomes, check_outcomes, check_range
from hrljax.envs.once import once_per_environment
from hrljax.envs.word_kinds import WordKinds

_MOST_CUTS = 64
"""With more cuts, comparing random words with them costs more than the table saves."""
_MOST_ENTRIES = 1 << 20
"""A larger table does not stay in a core's cache, and takes long to make."""
_RANDOM_BEGINNINGS = 1 << 14
"""Random first states that are looked at where the kinds of initial words are more than `_MOST_ENTRIES`."""


class Enumerated(NamedTuple):
    """All outcomes of an environment."""

    kinds: WordKinds
    outcomes: Outcomes
    occurs: np.ndarray  # [S] bool: states that can occur and in which the episode goes on


def enumerate_outcomes(env: AnyTabularDynamics, params: Numbers) -> Enumerated:
    """All outcomes of a tabular environment's `transition`; `params` as from `concrete_params`.

    If they are few they are cached, because both the table of steps and the exact model are made of them.

    Raises:
        ValueError: an outcome of a state that occurs makes no sense, see `check_outcomes`, or two words
            of one kind differ in what they lead to, so that `word_cuts` lacks a cut.
    """
    return (_cached_outcomes if few_outcomes(env, params) else _enumerate)(env, params)


def _enumerate(env: AnyTabularDynamics, params: Numbers) -> Enumerated:
    kinds = WordKinds(contract.word_cuts(env, params))
    steps = jax.jit(partial(_numbered_steps, env, kinds.count, params))
    ends = kinds.first_words(), kinds.last_words()
    with jax.ensure_compile_time_eval():
        outcomes, by_last = (Outcomes(*map(np.asarray, steps(*_pairs(env), words))) for words in ends)
    outcomes, occurs = check_outcomes(env, outcomes, _some_first_numbers(env, params), _renumbered(env))
    differs = np.any([one != other for one, other in zip(outcomes, by_last, strict=True)], axis=0)
    differs &= occurs[:, None, None]
    if differs.any():
        state, action, kind = (int(i) for i in np.argwhere(differs)[0])
        raise ValueError(
            f"{env.name}: word_cuts lacks a probability at which the meaning of a word changes: from state {state}, "
            f"action {env.action_names[action]!r} leads elsewhere {_words_of_kind(ends, kind)}"
        )
    return Enumerated(kinds, outcomes, occurs)


_cached_outcomes = once_per_environment(2)(_enumerate)


def check_computed_outcomes(env: AnyTabularDynamics, points: Sequence[Numbers]) -> None:
    """Raises for an outcome that makes no sense under any of several `params`, as `enumerate_outcomes` does.

    Compiles once for all of them. Words of one kind may differ in what they lead to: that only matters
    for steps that are looked up, and this is for steps that are computed.
    """
    kinds = [WordKinds(contract.word_cuts(env, params)) for params in points]
    initial_kinds = [WordKinds(contract.initial_word_cuts(env, params)) for params in points]
    most, most_initial = (max(of_point.count for of_point in of) for of in (kinds, initial_kinds))
    limit = points[0].max_steps

    @jax.jit
    def steps(numbers: Numbers, words: Words) -> tuple[Array, Array, Array]:
        return _numbered_steps(env, most, numbers._replace(max_steps=limit), *_pairs(env), words)

    @jax.jit
    def firsts(numbers: Numbers, words: Words) -> Array:
        return _numbered_firsts(env, most_initial, numbers._replace(max_steps=limit), words)

    renumbered = _renumbered(env)
    with jax.ensure_compile_time_eval():
        for params, of_step, of_initial in zip(points, kinds, initial_kinds, strict=True):
            outcomes = Outcomes(*map(np.asarray, steps(params, _padded(of_step.first_words(), most))))
            begins = np.asarray(firsts(params, _padded(of_initial.first_words(), most_initial)))
            check_outcomes(env, outcomes, begins, renumbered)


def first_numbers(env: AnyTabularDynamics, params: Numbers, kinds: WordKinds) -> np.ndarray:
    """``[N]`` int32: the number of the first state, for each kind of the words of `initial`.

    Raises:
        ValueError: a number is not that of a state, or `initial_word_cuts` lacks a cut.
    """
    firsts = jax.jit(partial(_numbered_firsts, env, kinds.count, params))
    ends = kinds.first_words(), kinds.last_words()
    with jax.ensure_compile_time_eval():
        numbers, by_last = (np.asarray(firsts(words)) for words in ends)
    differs = np.flatnonzero(numbers != by_last)
    if len(differs):
        raise ValueError(
            f"{env.name}: initial_word_cuts lacks a probability at which the meaning of a word changes: "
            f"initial leads elsewhere {_words_of_kind(ends, differs[0])}"
        )
    check_range(env, numbers)
    return numbers


def _some_first_numbers(env: AnyTabularDynamics, params: Numbers) -> np.ndarray:
    """The numbers of all first states, or of `_RANDOM_BEGINNINGS` random ones if there are too many kinds."""
    kinds = WordKinds(contract.initial_word_cuts(env, params))
    if kinds.count <= _MOST_ENTRIES:
        return first_numbers(env, params, kinds)
    shape = env.num_initial_words, _RANDOM_BEGINNINGS
    words = tuple(np.random.default_rng(0).integers(random.WORD_RANGE, size=shape, dtype=np.uint32))
    with jax.ensure_compile_time_eval():
        return np.asarray(jax.jit(partial(_numbered_firsts, env, _RANDOM_BEGINNINGS, params))(words))


def _words_of_kind(ends: tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]], kind: int) -> str:
    low, high = ([int(word[kind]) for word in words] for words in ends)
    return f"with the words {low} than with {high}"


def _padded(words: tuple[np.ndarray, ...], count: int) -> tuple[np.ndarray, ...]:
    return tuple(np.resize(word, count) for word in words)


def _pairs(env: AnyTabularDynamics) -> tuple[Array, Array]:
    """All states ``[S]`` and all actions ``[A]``, int32."""
    return jnp.arange(env.num_states, dtype=jnp.int32), jnp.arange(env.num_actions, dtype=jnp.int32)


def _renumbered(env: AnyTabularDynamics) -> np.ndarray:
    """``[S]`` int32: ``encode(decode(i))`` of every number i."""
    again = jax.jit(jax.vmap(lambda number: contract.encode(env, contract.decode(env, number))))
    with jax.ensure_compile_time_eval():
        return np.asarray(again(_pairs(env)[0]))


def _numbered_firsts(env: AnyTabularDynamics, count: int, params: Numbers, words: Words) -> Array:
    """``[N]``: the numbers of the first states that words of `initial`, each ``[N]``, lead to."""

    def first(words: Words) -> Array:
        return contract.encode(env, contract.initial(env, words, params))

    return jax.vmap(first, axis_size=count)(words)


def _numbered_steps(
    env: AnyTabularDynamics, count: int, params: Numbers, states: Array, actions: Array, words: Words
) -> tuple[Array, Array, Array]:
    """`numbered_step` from states ``[S]`` by actions ``[A]`` with words, each ``[N]``: arrays ``[S, A, N]``."""
    over_words = jax.vmap(partial(numbered_step, env, params), (None, None, 0), axis_size=count)
    over_actions = jax.vmap(over_words, (None, 0, None))
    return jax.vmap(over_actions, (0, None, None))(states, actions, words)


def numbered_step(
    env: TabularDynamics[State, Params], params: Params, state: Array, action: Array, words: Words
) -> tuple[Array, Array, Array]:
    """One step of a tabular environment in the numbers of its states: next state, reward, flags as in `Outcomes`."""
    after, reward, flags = flagged_step(env, params, contract.decode(env, state), action, words)
    return contract.encode(env, after), reward, flags


def flagged_step(
    env: TabularDynamics[State, Params], params: Params, state: State, action: Array, words: Words
) -> tuple[State, Array, Array]:
    """One step of a tabular environment: next state, reward, flags as in `Outcomes`."""
    after, reward, terminated, info = contract.transition(env, state, action, words, params)
    flags = terminated.astype(jnp.int32)
    for i, name in enumerate(env.metrics, start=1):
        flags |= info[name].astype(jnp.int32) << i
    return after, reward, flags


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
        # With a power of two as its length, a mask keeps every index inside; a clamp would take longer.
        self.entries = np.pad(entries, (0, (1 << (len(entries) - 1).bit_length()) - len(entries)))
        self._entry = stage(self._read)

    def place(self, words: Words) -> Array:
        """Where the entries begin that hold for an environment's words (int32 of their shape)."""
        return self._kinds.number(words) * np.int32(self._num_pairs)

    def _read(self, place: Array, state: Array, action: Array) -> Array:
        index = place + state * np.int32(self._num_actions) + action
        return take(jnp.asarray(self.entries), index & np.int32(len(self.entries) - 1)).astype(jnp.int32)

    def look_up(self, place: Array, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Next state (int32), reward (float32), and flags as in `Outcomes`, of scalars."""
        entry = self._entry(place, state, action)
        flags, rest = entry & ((1 << self._flag_bits) - 1), entry >> self._flag_bits
        reward = take(jnp.asarray(self.rewards), rest & ((1 << self._reward_bits) - 1))
        return rest >> self._reward_bits, reward, flags


def outcome_table(env: AnyTabularDynamics, params: Numbers) -> OutcomeTable | None:
    """The steps of a tabular environment as a table; None if it would be large or its numbers are traced.

    Made once in a process for an environment and its numbers.
    """
    if any(isinstance(number, Tracer) for number in params):
        return None
    return _cached_table(env, params)


def _table(env: AnyTabularDynamics, params: Numbers) -> OutcomeTable | None:
    cuts = contract.word_cuts(env, params)
    if sum(map(len, cuts)) > _MOST_CUTS:
        return None
    kinds = WordKinds(cuts)
    if env.num_states * env.num_actions * kinds.count > _MOST_ENTRIES:
        return None
    table = OutcomeTable(kinds, enumerate_outcomes(env, params).outcomes, len(env.metrics))
    return table if table.fits else None


def few_outcomes(env: AnyTabularDynamics, params: Numbers) -> bool:
    """Whether a tabular environment has few enough outcomes and beginnings to look at each of them."""
    outcomes = env.num_states * env.num_actions * WordKinds(contract.word_cuts(env, params)).count
    return max(outcomes, WordKinds(contract.initial_word_cuts(env, params)).count) <= _MOST_ENTRIES


_cached_table = once_per_environment(32)(_table)
