"""A given model of Mario: his own dynamics as the engine has them, in a level without things (thesis 5.1).

It is exact about running, jumping and pits and knows nothing of monsters, coins and items: the
structural bias of thesis 4.2.3 without the errors of learning.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, opaque_zero, take
from hrljax.envs.mario.competition import TICKS, Episode, held_keys, is_over
from hrljax.envs.mario.engine.collision import Purse
from hrljax.envs.mario.engine.player import finish, move, steer
from hrljax.envs.mario.engine.state import Player, World
from hrljax.envs.mario.env import Mario
from hrljax.envs.mario.levels.tiles import TILE
from hrljax.learners.base import Transition
from hrljax.search.best_first import ModelFn

T = TypeVar("T")


class Runner(NamedTuple):
    """Where Mario stands in a look-ahead."""

    player: Player
    keys: Array  # int32: keys of the last action, which hold for one more tick

    @property
    def x(self) -> Array:
        """In pixels."""
        return self.player.x

    @property
    def y(self) -> Array:
        """In pixels, downwards."""
        return self.player.y

    def at(self, player: Player) -> "Runner":
        """The same moment with another Mario."""
        return self._replace(player=player)


@dataclass(frozen=True)
class MarioDynamics:
    """Mario's dynamics, with the rewards of the environment's preset; there is nothing to fit.

    The level is seen beyond the edge of the screen, and stays as it is at the moment of planning.
    """

    def init(self, env: Mario) -> tuple[()]:
        return ()

    def observe(self, env: Mario, tables: tuple[()], transition: Transition, learns: Array) -> tuple[()]:
        return ()

    def refit(self, env: Mario, tables: tuple[()]) -> tuple[()]:
        return ()

    def planned(self, env: Mario, tables: tuple[()], episode: Episode) -> tuple[ModelFn, Runner]:
        """What a planner searches from a moment of an episode: the model, and the state to start in."""

        def model(state: Runner, action: Array) -> tuple[Runner, Array]:
            after, _ = walked(env, episode.world, state, action, (), lambda nothing, *_: nothing)
            return after, promised(env, state.player, after.player)

        return model, Runner(episode.world.player, episode.keys)


def walked(
    env: Mario, world: World, state: Runner, action: Array, seen: T, look: Callable[[T, Player, Array], T]
) -> tuple[Runner, T]:
    """A step of Mario alone in the tiles of a world, and what was seen on the way.

    Args:
        env: the levels, and what the actions are.
        world: whose tiles count; they stay as they are.
        state: where he begins.
        action: int32.
        seen: what is known before the step.
        look: of what is known, Mario after a tick of the step, and its number from 0 (int32): what is known then.
    """
    exit_column = take(jnp.asarray(env.course.exit_column), world.level)
    purse, keys = Purse(world.tiles, world.coins), env.keys(action)

    def tick(carry: tuple[Array, Player, T]) -> tuple[Array, Player, T]:
        number, player, seen = carry
        held = held_keys(number, state.keys, keys)
        moved = move(purse, steer(player, held)).player
        player = finish(moved, held, exit_column, env.course.num_columns).player
        return number + 1, player, look(seen, player, number)

    first = lax.select(is_over(state.player), jnp.int32(TICKS), jnp.int32(0))
    _, after, seen = lax.while_loop(
        lambda carry: (carry[0] < TICKS) & ~is_over(carry[1]), tick, (first, state.player, seen)
    )
    return Runner(after, keys), seen


def promised(env: Mario, before: Player, after: Player) -> Array:
    """The reward of a step of Mario alone, by the rules of the environment's preset."""
    params = env.default_params
    zero = opaque_zero(lax.bitcast_convert_type(after.x, jnp.uint32))
    distance = (after.x - before.x) * np.float32(1 / TILE)
    moved = exact_product(jnp.float32(params.displacement_reward), distance, zero)
    dies = (after.death_time > 0) & (before.death_time == 0)
    wins = (after.win_time > 0) & (before.win_time == 0)
    usual = lax.select(is_over(before), jnp.float32(0), jnp.float32(params.step_reward))
    last = lax.select(wins, jnp.float32(params.goal_reward), jnp.float32(params.death_reward))
    return lax.select(dies | wins, last, usual) + moved
