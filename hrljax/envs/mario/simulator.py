"""The game itself as a planner's model: whole episodes as states, monsters included (Baumgarten 2009).

Costs are steps of the competition; what is left of the way is estimated as `hrljax.envs.mario.stretch` says.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, opaque_zero
from hrljax.envs.mario.competition import Episode, advance
from hrljax.envs.mario.engine.state import Player
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.stretch import Stretch


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

    @property
    def _stretch(self) -> Stretch:
        return Stretch(self.start.world.player, self.horizon)

    def num_places(self, depth: int) -> int:
        """How many numbers `place` gives at depths up to `depth`."""
        return self._stretch.num_places(depth)

    def model(self, episode: Episode, action: Array) -> tuple[Episode, Array]:
        """The episode a step later, which costs 1, more after a hit, and infinity if Mario dies."""
        after = advance(self.env.course, episode, self.env.keys(action), self.max_steps, self.env.quantum)
        before, now = episode.world.player, after.world.player
        hurt = lax.max(power(before) - power(now), jnp.int32(0)).astype(jnp.float32)
        zero = opaque_zero(lax.bitcast_convert_type(now.x, jnp.uint32))
        cost = np.float32(1) + exact_product(jnp.asarray(self.damage_cost, jnp.float32), hurt, zero)
        return after, lax.select(now.death_time > 0, jnp.float32(np.inf), cost)

    def estimate(self, episode: Episode) -> Array:
        """Steps to the goal at top speed; 0 where Mario has won (float32)."""
        return self._stretch.steps_left(episode.world.player)

    def place(self, episode: Episode, depth: Array) -> Array:
        """The number of Mario's cell at a depth (int32)."""
        return self._stretch.place(episode.world.player, depth)
