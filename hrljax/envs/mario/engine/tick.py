"""One tick of the game (docs/mario_engine.md, "The tick")."""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.lockstep import one_after_another
from hrljax.envs.mario.engine.collision import Purse
from hrljax.envs.mario.engine.contacts import strike_all, touch_all
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.player import animate, die, down, finish, move, shoots, steer
from hrljax.envs.mario.engine.quantum import snap
from hrljax.envs.mario.engine.sprite_list import Tick, has, read, settle, when, with_flag, write
from hrljax.envs.mario.engine.sprites import fireball_of, spawn_all, update_all
from hrljax.envs.mario.engine.state import CARRIED, FIREBALL, REMOVED, SPEED, World
from hrljax.envs.mario.levels.level import SCREEN_WIDTH
from hrljax.envs.mario.levels.tiles import TILE

_MARGIN = 64
"""A sprite farther than this outside of the screen leaves the game."""
_SCREEN_HEIGHT = 240


def tick(
    course: Course, world: World, keys: Array, out_of_time: Array | bool = False, quantum: int | None = None
) -> World:
    """The world one tick later. Pure, for one game.

    Args:
        course: the levels.
        world: the game.
        keys: the keys held, bits `hrljax.envs.mario.engine.state.LEFT` and so on (int32).
        out_of_time: the limit of steps is reached: Mario dies (bool).
        quantum: after the tick, positions and velocities are moved to the nearest multiple of
            1 / quantum pixels; None leaves them exact.
    """
    # Full of loops and rare parts, which a batch of games would all go through together.
    one = one_after_another(partial(_tick, quantum))
    return one(course, world, keys, jnp.asarray(out_of_time))


def _tick(quantum: int | None, course: Course, world: World, keys: Array, late: Array) -> World:
    world = world._replace(player=die(world.player, late), paused=world.paused | late)
    limit = np.float32(course.num_columns * TILE - SCREEN_WIDTH)
    camera = world.player.x - np.float32(SCREEN_WIDTH // 2)
    camera = lax.select(camera < 0, jnp.float32(0), camera)
    world = world._replace(camera=lax.select(camera > limit, jnp.float32(limit), camera))
    begun = _mark_gone(world)
    paused = world.paused
    ongoing = when(~paused, lambda tick: _play(course, tick, keys), begun)
    world = settle(when(paused, _pause, ongoing))
    return world if quantum is None else snap(world, quantum)


def _mark_gone(world: World) -> Tick:
    """Marks the sprites that are too far outside of the screen and counts the fireballs among the others."""
    sprites = world.sprites
    listed = jnp.arange(sprites.x.shape[0], dtype=jnp.int32) < world.num_sprites
    dx = sprites.x - world.camera
    across = (dx < -_MARGIN) | (dx > SCREEN_WIDTH + _MARGIN)
    along = (sprites.y < -_MARGIN) | (sprites.y > _SCREEN_HEIGHT + _MARGIN)
    gone = listed & (across | along)
    fireballs = listed & ~gone & (sprites.kind == FIREBALL)
    flags = sprites.flags | (gone.astype(jnp.int32) * REMOVED)
    world = world._replace(
        sprites=sprites._replace(flags=flags),
        fireballs_on_screen=jnp.sum(fireballs.astype(jnp.int32), dtype=jnp.int32),
    )
    return Tick(world, jnp.int32(0), jnp.int32(0), jnp.any(gone))


def _pause(tick: Tick) -> Tick:
    player, paused = animate(tick.world.player)
    sprites = tick.world.sprites
    sprites = sprites._replace(x_old=sprites.x, y_old=sprites.y)
    return tick._replace(world=tick.world._replace(player=player, paused=paused, sprites=sprites))


def _play(course: Course, tick: Tick, keys: Array) -> Tick:
    world = tick.world
    tick = tick._replace(world=world._replace(active_ticks=world.active_ticks + 1))
    tick = spawn_all(tick, course)
    # Sprites still see Mario as he was: he moves last.
    player = steer(world.player, keys)
    fires = shoots(player, keys, world.fireballs_on_screen)
    tick = update_all(tick, course, fires, fireball_of(player))

    world = tick.world
    moved = move(Purse(world.tiles, world.coins), player)
    verdict = finish(moved.player, keys, _exit_column(course, world.level), course.num_columns)
    player = verdict.player
    world = world._replace(
        player=player,
        tiles=moved.purse.tiles,
        coins=moved.purse.coins,
        paused=world.paused | verdict.dies | verdict.wins,
    )
    tick = tick._replace(world=world)
    tick = when(player.carried >= 0, lambda tick: _carry(tick, keys), tick)
    return strike_all(touch_all(tick, keys, moved.bumps, moved.cell))


def _exit_column(course: Course, level: Array) -> Array:
    return lax.dynamic_index_in_dim(jnp.asarray(course.exit_column), level, keepdims=False)


def _carry(tick: Tick, keys: Array) -> Tick:
    """Moves the shell that Mario carries, and lets it go when the speed key is up."""
    world = tick.world
    player = world.player
    lets_go = ~down(keys, SPEED)
    ahead = (8 * player.facing).astype(jnp.float32)

    def one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
        i, tick = carry
        sprite = read(tick.world.sprites, i)
        x = player.x + ahead
        held = sprite._replace(
            x=lax.select(lets_go, x + ahead, x),
            y=player.y - np.float32(2),
            facing=lax.select(lets_go, player.facing, sprite.facing),
            flags=with_flag(sprite.flags, CARRIED, has(sprite.flags, CARRIED) & ~lets_go),
        )
        mine = sprite.serial == player.carried
        sprites = when(mine, lambda sprites: write(sprites, i, held), tick.world.sprites)
        return i + 1, tick._replace(world=tick.world._replace(sprites=sprites))

    start = (jnp.int32(0), tick)
    tick = lax.while_loop(lambda carry: carry[0] < carry[1].world.num_sprites, one, start)[1]
    carried = lax.select(lets_go, jnp.int32(-1), player.carried)
    return tick._replace(world=tick.world._replace(player=player._replace(carried=carried)))
