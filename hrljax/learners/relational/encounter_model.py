"""A given model of Mario alone, and what is learned of meeting the things that it leaves out.

An *encounter* is the first tick of a step in which a thing is close to Mario: its kind, whether it has wings and
whether it moves up or down; whether he falls; and where it is from him, in cells of six pixels. Things are taken to go
on as they moved in the last tick, and Mario moves as the given model says. What an encounter c is worth is the mean of
what the given model missed in the steps where it occurred,

    w(c) = (S(c) + m w'(c)) / (N(c) + m),        w'(c) = S'(c) / (N'(c) + 1)

with the sum S and the number N of those rewards less the promised ones, and S' and N' of all things at that place: what
is known of one kind is believed of another, m times, until that one was met itself. A step of a look-ahead that has
an encounter earns w(c) more. As a place is told from Mario, with his motion and the thing's, the numbers are of no
level, and are few.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take
from hrljax.envs.mario.competition import ENDED, TICKS, Episode, is_over
from hrljax.envs.mario.engine.sprite_list import has, read
from hrljax.envs.mario.engine.state import WINGED, Player, World
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.features import NUM_TYPES
from hrljax.learners.base import Transition
from hrljax.learners.hyperparameters import Hyperparameter, Settings, hyperparameter
from hrljax.learners.relational.given_model import Runner, promised, walked
from hrljax.search.best_first import ModelFn

CELL = 6
"""Pixels of a cell from left to right and from top to bottom."""
COLUMNS, ROWS = 6, 12
"""Cells around Mario's feet in which a thing is close: 18 pixels to each side, 36 up and down."""
_PLACES = COLUMNS * ROWS * 2
_KINDS = NUM_TYPES * 2 * 3
NUM_ENCOUNTERS = _KINDS * _PLACES
_MOVES = np.float32(0.5)
"""Pixels a tick; a thing that is slower does not move up or down."""
_NONE = np.int32(-1)


class Encounters(NamedTuple):
    """What was learned of encounters."""

    missed: Array  # [NUM_ENCOUNTERS] float32: S
    times: Array  # [NUM_ENCOUNTERS] float32: N
    missed_at: Array  # [places] float32: S'
    times_at: Array  # [places] float32: N'
    last: Array  # int32: the encounter of the last step, -1 without


class Walk(NamedTuple):
    """Where Mario is in a look-ahead, and when."""

    runner: Runner
    ticks: Array  # int32: since the moment of planning

    @property
    def player(self) -> Player:
        return self.runner.player

    @property
    def keys(self) -> Array:
        return self.runner.keys

    def at(self, player: Player) -> "Walk":
        """The same moment with another Mario."""
        return self._replace(runner=self.runner.at(player))

    @property
    def x(self) -> Array:
        """In pixels."""
        return self.runner.x

    @property
    def y(self) -> Array:
        """In pixels, downwards."""
        return self.runner.y


@dataclass(frozen=True)
class MarioEncounters(Settings):
    """`MarioDynamics`, which sees the things around Mario too, and learns what it is to meet them.

    Attributes:
        trust: m, how many times what is known of other kinds of things counts.
        fatal: a look-ahead ends with an encounter that is worth no more than this.
    """

    trust: Hyperparameter = hyperparameter(1.0, 0, low_open=True)
    fatal: Hyperparameter = hyperparameter(-20.0)

    def init(self, env: Mario) -> Encounters:
        kinds, places = jnp.zeros(NUM_ENCOUNTERS, jnp.float32), jnp.zeros(_PLACES, jnp.float32)
        return Encounters(kinds, kinds, places, places, jnp.asarray(_NONE))

    def observe(self, env: Mario, tables: Encounters, transition: Transition, learns: Array) -> Encounters:
        """Counts what the given model missed in a step, if there was an encounter in it."""
        before: Episode = transition.state
        start = Walk(Runner(before.world.player, before.keys), jnp.int32(0))
        after, met = _step(env, before.world, start, transition.action)
        # A death in the last tick of a step is told by the next.
        met = lax.select(before.phase == ENDED, tables.last, met)
        missed = transition.reward - promised(env, before.world.player, after.runner.player)
        once = jnp.asarray(learns) & (met >= 0)
        number = lax.max(met, jnp.int32(0))

        def added(values: Array, place: Array, value: Array) -> Array:
            return put_row(values, place, (take(values, place) + lax.select(once, value, jnp.float32(0)))[None])

        at, one = lax.rem(number, np.int32(_PLACES)), jnp.float32(1)
        return Encounters(
            missed=added(tables.missed, number, missed),
            times=added(tables.times, number, one),
            missed_at=added(tables.missed_at, at, missed),
            times_at=added(tables.times_at, at, one),
            last=lax.select(jnp.asarray(learns), met, tables.last),
        )

    def refit(self, env: Mario, tables: Encounters) -> Encounters:
        return tables

    def worth(self, tables: Encounters, met: Array) -> Array:
        """w of an encounter, 0 where there is none (float32)."""
        number = lax.max(met, jnp.int32(0))
        at = lax.rem(number, np.int32(_PLACES))
        trust = jnp.asarray(self.trust, jnp.float32)
        of_any = take(tables.missed_at, at) / (take(tables.times_at, at) + np.float32(1))
        of_kind = (take(tables.missed, number) + trust * of_any) / (take(tables.times, number) + trust)
        return lax.select(met >= 0, of_kind, jnp.float32(0))

    def planned(self, env: Mario, tables: Encounters, episode: Episode) -> tuple[ModelFn, Any]:
        """The model, which foresees the end of what is fatal, and the state to search from."""

        def model(state: Walk, action: Array) -> tuple[Walk, Array, Array]:
            after, met = _step(env, episode.world, state, action)
            worth = self.worth(tables, met)
            reward = promised(env, state.runner.player, after.runner.player) + worth
            ended = is_over(after.runner.player) | (worth <= jnp.asarray(self.fatal, jnp.float32))
            return after, reward, ended

        return model, Walk(Runner(episode.world.player, episode.keys), jnp.int32(0))


def _step(env: Mario, world: World, state: Walk, action: Array) -> tuple[Walk, Array]:
    """A step of Mario alone, and the number of the encounter in it, -1 without one."""

    def look(met: Array, player: Player, number: Array) -> Array:
        ticks = (state.ticks + number + 1).astype(jnp.float32)
        return lax.cond(met >= 0, lambda: met, lambda: encounter(world, player, ticks))

    runner, met = walked(env, world, state.runner, action, jnp.asarray(_NONE), look)
    return Walk(runner, state.ticks + TICKS), met


def encounter(world: World, player: Player, ticks: Array) -> Array:
    """The number of the encounter of Mario with the thing that is closest of those that are close; -1 without one.

    Args:
        world: the game, with the things as they are now.
        player: Mario as he will be.
        ticks: when that is, in ticks from now (float32).
    """
    falls = (player.y > player.y_old) & ~player.on_ground

    def closer(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        i, distance, met = carry
        thing = read(world.sprites, i)
        dx = thing.x + (thing.x - thing.x_old) * ticks - player.x
        rise = thing.y - thing.y_old
        dy = thing.y + rise * ticks - player.y
        column = jnp.floor(dx * np.float32(1 / CELL)).astype(jnp.int32) + np.int32(COLUMNS // 2)
        row = jnp.floor(dy * np.float32(1 / CELL)).astype(jnp.int32) + np.int32(ROWS // 2)
        close = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
        away = lax.abs(dx) + lax.abs(dy)
        moves = (rise < -_MOVES).astype(jnp.int32) + np.int32(2) * (rise > _MOVES).astype(jnp.int32)
        kind = ((thing.kind - 1) * 2 + has(thing.flags, WINGED).astype(jnp.int32)) * 3 + moves
        place = (falls.astype(jnp.int32) * np.int32(ROWS) + row) * np.int32(COLUMNS) + column
        is_better = close & (away < distance)
        number = kind * np.int32(_PLACES) + place
        return i + 1, lax.select(is_better, away, distance), lax.select(is_better, number, met)

    start = (jnp.int32(0), jnp.float32(np.inf), jnp.asarray(_NONE))
    return lax.while_loop(lambda carry: carry[0] < world.num_sprites, closer, start)[2]
