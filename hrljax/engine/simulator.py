"""An environment inside a training loop: the next step and the random words for it, at the least cost."""

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

from hrljax.core import contract, random
from hrljax.core.counting import Count
from hrljax.core.environment import Numbers
from hrljax.core.numerics import stage, take
from hrljax.core.random import WordBlock
from hrljax.engine.counters import BLOCK, Amounts, Flags, Tally
from hrljax.envs.base import AnyEnvironment, AnyTabularEnvironment, TabularEnvironment
from hrljax.envs.outcomes import OutcomeTable, numbered_step, outcome_table

Env = AnyEnvironment
Counter = TypeVar("Counter", Flags, Amounts)


class Step(NamedTuple):
    """What one step led to, as scalars."""

    next_state: Any  # its number (int32) if the environment is tabular
    reward: Array  # float32
    terminated: Array  # bool
    change: Tally


class Simulator(ABC, Generic[Counter]):
    """The steps of one run, and its learner's random words."""

    counter: Counter
    """How the tally is started and read."""

    def __init__(self, env: Env, params: Numbers, num_learner_words: int):
        self.env, self.params = env, params
        self._num_words = env.num_words + num_learner_words

    def block(self, key: tuple[Array, Array], start: Count) -> Any:
        """What `BLOCK` steps need of random words, from position `start` on."""
        return random.word_block(key, start, BLOCK, self._num_words)

    def positions(self, block: Any) -> Any:
        """Blocks of one position each, on a leading axis [BLOCK], for a loop that comes to all of them in turn."""
        return block.positions()

    def learner_words(self, block: Any, position: Array) -> tuple[Array, ...]:
        """The words of a block's position (int32) that are the learner's."""
        return block[position][self.env.num_words :]

    @abstractmethod
    def step(self, state: Any, action: Array, block: Any, position: Array) -> Step:
        """One step with the words of a block's position."""


class _Computed(Simulator[Amounts]):
    """Any environment."""

    def __init__(self, env: Env, params: Numbers, num_learner_words: int):
        super().__init__(env, params, num_learner_words)
        self.counter = Amounts()

    def step(self, state: Any, action: Array, block: WordBlock, position: Array) -> Step:
        words = block[position][: self.env.num_words]
        after, reward, terminated, info = contract.transition(self.env, state, action, words, self.params)
        change = self.counter.change(terminated, [info[name] for name in self.env.metrics])
        return Step(after, reward, terminated, change)


class _Tabular(Simulator[Flags]):
    """A tabular environment: states are numbers, events are flags."""

    env: AnyTabularEnvironment

    def __init__(self, env: AnyTabularEnvironment, params: Numbers, num_learner_words: int):
        super().__init__(env, params, num_learner_words)
        self.counter = Flags(len(env.metrics))
        self._computed = stage(self._compute)

    def step(self, state: Array, action: Array, block: Any, position: Array) -> Step:
        after, reward, flags = self._outcome(state, action, block, position)
        return Step(after, reward, (flags & 1) != 0, self.counter.change(flags))

    def _outcome(self, state: Array, action: Array, block: Any, position: Array) -> tuple[Array, Array, Array]:
        """Next state, reward, and the flags: bit 0, it terminated; bit i, event i - 1 happened."""
        reward, packed = self._computed(state, action, block, position)
        bits = 1 + len(self.env.metrics)
        return packed >> bits, lax.bitcast_convert_type(reward, jnp.float32), packed & ((1 << bits) - 1)

    def _compute(self, state: Array, action: Array, block: WordBlock, position: Array) -> Array:
        """The bits of the reward, then state and flags in one: what is one result is computed once."""
        words = block[position][: self.env.num_words]
        after, reward, flags = numbered_step(self.env, self.params, state, action, words)
        packed = after << (1 + len(self.env.metrics)) | flags
        return jnp.stack([lax.bitcast_convert_type(reward, jnp.int32), packed])


class _LookedUp(_Tabular):
    """A tabular environment whose steps are looked up."""

    def __init__(self, env: AnyTabularEnvironment, params: Numbers, num_learner_words: int, table: OutcomeTable):
        super().__init__(env, params, num_learner_words)
        self._table = table

    def block(self, key: tuple[Array, Array], start: Count) -> tuple[Array, tuple[Array, ...]]:
        """``[BLOCK]`` places in the table, and as many of each of the learner's words."""
        words = stage(super().block)(key, start).columns()
        of_env, of_learner = words[: self.env.num_words], words[self.env.num_words :]
        place = self._table.place(of_env) if of_env else jnp.zeros(BLOCK, jnp.int32)
        return place, of_learner

    def positions(self, block: tuple[Array, tuple[Array, ...]]) -> tuple[Array, tuple[Array, ...]]:
        return jax.tree.map(lambda words: words[:, None], block)

    def learner_words(self, block: tuple[Array, tuple[Array, ...]], position: Array) -> tuple[Array, ...]:
        return tuple(take(words, position) for words in block[1])

    def _outcome(self, state: Array, action: Array, block: Any, position: Array) -> tuple[Array, Array, Array]:
        return self._table.look_up(take(block[0], position), state, action)


def simulator(env: Env, params: Numbers, num_learner_words: int) -> Simulator[Any]:
    """The simulator that suits an environment and its numbers; all give the same steps."""
    if not isinstance(env, TabularEnvironment):
        return _Computed(env, params, num_learner_words)
    table = outcome_table(env, params)
    if table is None:
        return _Tabular(env, params, num_learner_words)
    return _LookedUp(env, params, num_learner_words, table)
