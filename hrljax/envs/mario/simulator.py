"""The game itself as a planner's model: whole episodes as states, monsters included (Baumgarten 2009).

Costs are steps of the competition. With the speed key Mario's velocity grows by 1.2 pixels a tick before he moves and
is multiplied by 0.89 after it, so that his *reach*

    x + (xa - 0.89 * 1.2 / 0.11) / 0.11

grows by at most 1.2 / 0.11 = 10.9 pixels a tick, and by exactly that at every velocity as long as nothing is in his
way: his distance at top speed, the run-up taken off. The speed key is up in one tick of five, so that a step is worth
49.1 pixels.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, opaque_zero
from hrljax.envs.mario.competition import TICKS, Episode, advance
from hrljax.envs.mario.engine.player import FRICTION, RUN, WALK
from hrljax.envs.mario.engine.state import Player
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.tiles import HEIGHT, TILE

_LOSS = np.float32(1) - FRICTION
TOP_SPEED = np.float32(FRICTION * RUN / _LOSS)
"""Mario's greatest velocity between two moves, in pixels a tick."""
TOP_STEP = np.float32(((TICKS - 1) * RUN + WALK) / _LOSS)
"""By how many pixels his reach grows in a step at most."""
_CELL = 8
"""Pixels of a cell in which two positions at one time count as one."""
_ABOVE = 2 * TILE
"""Pixels above the level that have cells of their own."""
_ROWS = ((HEIGHT + 1) * TILE + _ABOVE) // _CELL
_BEHIND = 4 * TILE
"""Pixels to the left of the start of a look-ahead that have cells of their own."""


def reach(player: Player) -> Array:
    """How far Mario would be, had he run at top speed all the time (float32, pixels)."""
    zero = opaque_zero(lax.bitcast_convert_type(player.x, jnp.uint32))
    return player.x + exact_product(np.float32(1 / _LOSS), player.xa - TOP_SPEED, zero)


def power(player: Player) -> Array:
    """What hits Mario can take: 0 small, 1 large, 2 with fire (int32); what he will be where he is changing."""
    changes = player.power_up_time != 0
    large = lax.select(changes, player.large_after, player.large)
    fire = lax.select(changes, player.fire_after, player.fire)
    return large.astype(jnp.int32) + (large & fire).astype(jnp.int32)


class Simulator(NamedTuple):
    """The game from a moment on, as `hrljax.search.a_star` asks it.

    The goal is a reach of `horizon` tiles more than at this moment, or the exit.
    """

    env: Mario
    start: Episode
    max_steps: Array | int
    horizon: int
    damage_cost: Array | float  # in steps, for every hit that Mario survives

    def num_places(self, depth: int) -> int:
        """How many numbers `place` gives at depths up to `depth`."""
        return (depth + 1) * self._columns * _ROWS

    @property
    def _columns(self) -> int:
        return (self.horizon * TILE + _BEHIND) // _CELL

    def model(self, episode: Episode, action: Array) -> tuple[Episode, Array]:
        """The episode a step later, which costs 1, more after a hit, and infinity if Mario dies."""
        after = advance(self.env.course, episode, self.env.keys(action), self.max_steps, self.env.quantum)
        before, now = episode.world.player, after.world.player
        hurt = lax.max(power(before) - power(now), jnp.int32(0)).astype(jnp.float32)
        zero = opaque_zero(lax.bitcast_convert_type(now.x, jnp.uint32))
        cost = np.float32(1) + exact_product(jnp.asarray(self.damage_cost, jnp.float32), hurt, zero)
        return after, lax.select(now.death_time > 0, jnp.float32(np.inf), cost)

    def estimate(self, episode: Episode) -> Array:
        """Steps to the goal at top speed, the run-up included; 0 where Mario has won (float32)."""
        player = episode.world.player
        goal = reach(self.start.world.player) + np.float32(self.horizon * TILE)
        steps = (goal - reach(player)) * np.float32(1 / TOP_STEP)
        return lax.select(player.win_time > 0, jnp.float32(0), steps)

    def place(self, episode: Episode, depth: Array) -> Array:
        """The number of Mario's cell, of `_CELL` pixels, at a depth (int32)."""
        player = episode.world.player
        x = player.x - (self.start.world.player.x - np.float32(_BEHIND))
        column = lax.clamp(jnp.int32(0), (x / np.float32(_CELL)).astype(jnp.int32), jnp.int32(self._columns - 1))
        y = player.y + np.float32(_ABOVE)
        row = lax.clamp(jnp.int32(0), (y / np.float32(_CELL)).astype(jnp.int32), jnp.int32(_ROWS - 1))
        return (depth * np.int32(self._columns) + column) * np.int32(_ROWS) + row
