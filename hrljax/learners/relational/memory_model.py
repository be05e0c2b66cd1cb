"""A given model of Mario, and a memory of what really came of the steps that were taken.

What a step brings is remembered by all that is known of Mario before it, to the last bit, and by the keys. So on the
way of an earlier episode the memory says what the given model does not know, monsters included, and beside that way the
given model answers: in a deterministic game the same death is not died for ever.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row, take, take_row
from hrljax.envs.mario.competition import ENDED, Episode, is_over
from hrljax.envs.mario.engine.state import Player
from hrljax.envs.mario.env import Mario
from hrljax.learners.base import Transition
from hrljax.learners.hyperparameters import Settings
from hrljax.learners.relational.encounter_model import MarioEncounters
from hrljax.learners.relational.given_model import MarioDynamics, promised
from hrljax.learners.relational.visited import no_rows, place_of
from hrljax.search.best_first import ModelFn
from hrljax.trees.rows import MAX_ROWS

_PLAYER = len(Player._fields)
_KEY = _PLAYER + 2
_WIDTH = _KEY + _PLAYER + 1


class Memories(NamedTuple):
    """Steps, each met at least once; the row after the last is written to where nothing is kept."""

    model: Any  # what the given model has learned
    values: Array  # [(N + 1) * width] int32: bits of Mario, last keys, action, Mario a step later, reward
    places: Array  # [2^19] int32: by a hash of the first three, the row with them that was written last
    filled: Array  # int32: rows so far


@dataclass(frozen=True)
class MarioMemory(Settings):
    """A given model that knows of every step that was taken what came of it when it was taken last.

    Attributes:
        model: `MarioDynamics` or `MarioEncounters`, for all steps that were not.
        rows: N, different steps that are kept; those that come after them are forgotten.
    """

    model: MarioDynamics | MarioEncounters = MarioEncounters()
    rows: int = 60_000

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("rows", 1, MAX_ROWS)
        kinds = (MarioDynamics, MarioEncounters)
        checks.instance("MarioMemory: model", self.model, kinds, "a MarioDynamics or MarioEncounters")

    def init(self, env: Mario) -> Memories:
        values = jnp.zeros((self.rows + 1) * _WIDTH, jnp.int32)
        return Memories(self.model.init(env), values, no_rows(self.rows), jnp.int32(0))

    def observe(self, env: Mario, tables: Memories, transition: Transition, learns: Array) -> Memories:
        before: Episode = transition.state
        after: Player = transition.next_state.world.player
        # An end in the last tick of a step is told by the next step; in an end nothing but the given rewards counts.
        reward = lax.select(is_over(after), promised(env, before.world.player, after), transition.reward)
        key = _key(before.world.player, before.keys, transition.action)
        place, number, is_met = self._row(tables, key)
        keeps = jnp.asarray(learns) & (before.phase != ENDED)
        is_new = keeps & ~is_met & (tables.filled < self.rows)
        number = lax.select(keeps & is_met, number, lax.select(is_new, tables.filled, jnp.int32(self.rows)))
        row = jnp.concatenate([key, _bits(after), _bits_of(reward)[None]])
        kept = lax.select(number < self.rows, number, take(tables.places, place))
        return Memories(
            self.model.observe(env, tables.model, transition, learns),
            put_row(tables.values, number * np.int32(_WIDTH), row),
            put_row(tables.places, place, kept[None]),
            tables.filled + is_new.astype(jnp.int32),
        )

    def refit(self, env: Mario, tables: Memories) -> Memories:
        return tables._replace(model=self.model.refit(env, tables.model))

    def planned(self, env: Mario, tables: Memories, episode: Episode) -> tuple[ModelFn, Any]:
        """The model, which foresees ends, and the state to search from."""
        given, start = self.model.planned(env, tables.model, episode)

        def model(state: Any, action: Array) -> tuple[Any, Array, Array]:
            _, number, is_met = self._row(tables, _key(state.player, state.keys, action))
            row = take_row(tables.values, number * np.int32(_WIDTH), _WIDTH)
            after, reward, *ended = given(state, action)
            foreseen = ended[0] if ended else is_over(after.player)
            known = _player(row[_KEY : _KEY + _PLAYER], after.player)
            player = jax.tree.map(lambda one, other: lax.select(is_met, one, other), known, after.player)
            reward = lax.select(is_met, lax.bitcast_convert_type(row[-1], jnp.float32), reward)
            return after.at(player), reward, lax.select(is_met, is_over(known), foreseen)

        return model, start

    def _row(self, tables: Memories, key: Array) -> tuple[Array, Array, Array]:
        """The place of a key, the row there, and whether it is of this key."""
        place = place_of(key)
        number = take(tables.places, place)
        is_met = (number < self.rows) & jnp.all(take_row(tables.values, number * np.int32(_WIDTH), _KEY) == key)
        return place, number, is_met


def _key(player: Player, keys: Array, action: Array) -> Array:
    """By what a step is remembered, int32 ``[_KEY]``."""
    return jnp.concatenate([_bits(player), jnp.stack([keys, jnp.asarray(action, jnp.int32)])])


def _bits(player: Player) -> Array:
    """``[_PLAYER]`` int32."""
    return jnp.stack([_bits_of(jnp.asarray(value)) for value in player])


def _bits_of(value: Array) -> Array:
    if value.dtype == jnp.float32:
        return lax.bitcast_convert_type(value, jnp.int32)
    return value.astype(jnp.int32)


def _player(bits: Array, like: Player) -> Player:
    """What `_bits` was made of; types as of `like`."""
    values = []
    for i, value in enumerate(like):
        is_float = value.dtype == jnp.float32
        values.append(lax.bitcast_convert_type(bits[i], value.dtype) if is_float else bits[i].astype(value.dtype))
    return Player(*values)
