"""How far it is to a point ahead of Mario, in steps at top speed: what A* goes by (Baumgarten 2009).

With the speed key Mario's velocity grows by 1.2 pixels a tick before he moves and is multiplied by 0.89 after it, so
that his *reach*

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
from hrljax.envs.mario.competition import TICKS
from hrljax.envs.mario.engine.player import FRICTION, RUN, WALK
from hrljax.envs.mario.engine.state import Player
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


class Stretch(NamedTuple):
    """The way from where Mario is to a reach of `horizon` tiles more."""

    start: Player
    horizon: int

    def num_places(self, depth: int) -> int:
        """How many numbers `place` gives at depths up to `depth`."""
        return (depth + 1) * self._columns * _ROWS

    @property
    def _columns(self) -> int:
        return (self.horizon * TILE + _BEHIND) // _CELL

    def steps_left(self, player: Player) -> Array:
        """Steps to the goal at top speed, the run-up included; 0 where Mario has won (float32)."""
        goal = reach(self.start) + np.float32(self.horizon * TILE)
        steps = (goal - reach(player)) * np.float32(1 / TOP_STEP)
        return lax.select(player.win_time > 0, jnp.float32(0), steps)

    def place(self, player: Player, depth: Array) -> Array:
        """The number of Mario's cell, of `_CELL` pixels, at a depth (int32)."""
        x = player.x - (self.start.x - np.float32(_BEHIND))
        column = lax.clamp(jnp.int32(0), (x / np.float32(_CELL)).astype(jnp.int32), jnp.int32(self._columns - 1))
        y = player.y + np.float32(_ABOVE)
        row = lax.clamp(jnp.int32(0), (y / np.float32(_CELL)).astype(jnp.int32), jnp.int32(_ROWS - 1))
        return (depth * np.int32(self._columns) + column) * np.int32(_ROWS) + row
