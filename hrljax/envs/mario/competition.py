"""The step of the 2009 competition: five ticks, an observation, a reward.

Its rules are in docs/mario_engine.md, "The competition's step".
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import opaque_zero
from hrljax.envs.mario.engine.arithmetic import truncated
from hrljax.envs.mario.engine.course import Course, start
from hrljax.envs.mario.engine.sprite_list import has
from hrljax.envs.mario.engine.state import JUMP, LEFT, MAX_SPRITES, RIGHT, SPEED, WINGED, Player, World
from hrljax.envs.mario.engine.tick import tick
from hrljax.envs.mario.levels.level import SCREEN_WIDTH
from hrljax.envs.mario.levels.tiles import HEIGHT, SYMBOL_EXIT, SYMBOL_MARIO, SYMBOLS, TILE

TICKS = 5
"""Ticks in a step."""
ROWS, COLUMNS = 16, 21
"""Characters of the observed screen."""
MAX_OBJECTS = MAX_SPRITES + 1

PLAYING, ENDED, OBSERVED = range(3)
"""Phases of an episode: it goes on; it ended in the last tick of a step and the next step will say so; it is over."""


def keys_of(direction: int, jump: int, speed: int) -> int:
    """The keys of an action, as bits of `hrljax.envs.mario.engine.state`."""
    return {-1: LEFT, 0: 0, 1: RIGHT}[direction] | JUMP * jump | SPEED * speed


def held_keys(number: Array, last: Array, keys: Array) -> Array:
    """The keys held in tick `number` (0 to 4) of a step, after a step with the keys `last` (all int32)."""
    direction = keys & np.int32(LEFT | RIGHT)
    return lax.select(number == 0, last, lax.select(number == 1, direction, keys))


class Episode(NamedTuple):
    """An episode between two steps. Scalars."""

    world: World
    keys: Array  # int32: keys of the last action
    phase: Array  # int32: PLAYING, ENDED or OBSERVED
    camera: Array  # int32: left edge of the last picture drawn before the observation, in pixels
    time: Array  # int32: steps taken


def is_over(player: Player) -> Array:
    """Whether Mario has died or reached the exit."""
    return (player.death_time > 0) | (player.win_time > 0)


def _drawn_camera(course: Course, player: Player) -> Array:
    """Left edge (int32) of the picture drawn after a tick; it shows Mario where the tick left him."""
    shown = truncated(player.x_old + (player.x - player.x_old))
    return lax.clamp(jnp.int32(0), shown - SCREEN_WIDTH // 2, jnp.int32(course.num_columns * TILE - SCREEN_WIDTH))


def unbegun(course: Course, level: Array | int) -> Episode:
    """An episode before its first tick. One step without keys from here leads to what `begin` returns."""
    zero = jnp.int32(0)
    return Episode(start(course, level), zero, zero, zero, jnp.int32(-1))


def begin(course: Course, level: Array | int, quantum: int | None = None) -> Episode:
    """The first observed moment of an episode: five ticks without keys after the start of a level."""
    fresh = unbegun(course, level)._replace(time=jnp.int32(0))
    return _ticks(course, fresh, jnp.int32(0), jnp.bool_(False), quantum)


def advance(
    course: Course, episode: Episode, keys: Array, max_steps: Array | int, quantum: int | None = None
) -> Episode:
    """The episode one step later. An episode that is over stays as it is.

    Keys act one tick late, and jump and speed are released for one tick: with the last action A and
    the new one B, the ticks run with A, with B's direction alone, and three times with B.

    Args:
        course: the levels.
        episode: where it stands.
        keys: keys of the action (`keys_of`), int32.
        max_steps: the step with this number kills Mario in its first tick.
        quantum: see `hrljax.envs.mario.engine.quantum`.
    """
    time = episode.time + (episode.phase != OBSERVED).astype(jnp.int32)
    late = time >= jnp.asarray(max_steps, jnp.int32)
    return _ticks(course, episode._replace(time=time), keys, late, quantum)


def _ticks(course: Course, episode: Episode, keys: Array, late: Array, quantum: int | None) -> Episode:
    def one(carry: tuple[Array, World, Array]) -> tuple[Array, World, Array]:
        number, world, _ = carry
        camera = _drawn_camera(course, world.player)
        held = held_keys(number, episode.keys, keys)
        return number + 1, tick(course, world, held, late & (number == 0), quantum), camera

    def goes_on(carry: tuple[Array, World, Array]) -> Array:
        number, world, _ = carry
        return (number < TICKS) & ((number == 0) | ~is_over(world.player))

    first = lax.select(episode.phase == PLAYING, jnp.int32(0), jnp.int32(TICKS))
    number, world, camera = lax.while_loop(goes_on, one, (first, episode.world, episode.camera))
    playing = episode.phase == PLAYING
    unseen = playing & (number == TICKS) & is_over(world.player)
    phase = lax.select(unseen, jnp.int32(ENDED), jnp.int32(OBSERVED))
    phase = lax.select(is_over(world.player), phase, jnp.int32(PLAYING))
    return Episode(world, lax.select(playing, keys, episode.keys), phase, camera, episode.time)


class Objects(NamedTuple):
    """The observed objects: Mario, then the sprites, newest first; arrays of `MAX_OBJECTS`."""

    present: Array  # bool
    kind: Array  # int32: 0 small Mario, 10 large, 11 with fire, else the kind of the sprite
    winged: Array  # bool
    x: Array  # float32: in tiles
    y: Array  # in tiles, upwards: 16 - depth, which the program computes in float64
    depth: Array  # in tiles, downwards
    dx: Array  # a fifth of the last tick's displacement, in pixels
    dy: Array  # likewise, upwards


def objects(world: World) -> Objects:
    """The objects as the competition's program (build 638) describes them.

    Velocities times 25/16 are tiles a step.
    """
    player, sprites = world.player, world.sprites
    order = world.num_sprites - jnp.arange(MAX_OBJECTS, dtype=jnp.int32)
    present = order >= 0
    place = lax.clamp(jnp.zeros_like(order), order, jnp.full_like(order, MAX_SPRITES - 1))
    first = jnp.arange(MAX_OBJECTS, dtype=jnp.int32) == 0

    def listed(of_player: Array, of_sprites: Array) -> Array:
        return lax.select(first, jnp.broadcast_to(of_player, (MAX_OBJECTS,)), of_sprites[place])

    mario = lax.select(player.fire, jnp.int32(11), lax.select(player.large, jnp.int32(10), jnp.int32(0)))
    x, y = listed(player.x, sprites.x), listed(player.y, sprites.y)
    # Opaque, because XLA would multiply by the rounded reciprocal of a constant.
    ticks = (np.uint32(TICKS) + opaque_zero(world.active_ticks.astype(jnp.uint32))).astype(jnp.float32)
    return Objects(
        present=present,
        kind=listed(mario, sprites.kind),
        winged=listed(jnp.bool_(False), has(sprites.flags, WINGED)) & present,
        x=x * np.float32(1 / TILE),
        y=np.float32(16) - y * np.float32(1 / TILE),
        depth=y * np.float32(1 / TILE),
        dx=(x - listed(player.x_old, sprites.x_old)) / ticks,
        dy=-(y - listed(player.y_old, sprites.y_old)) / ticks,
    )


def screen(course: Course, episode: Episode) -> Array:
    """The observed screen, ``[16, 21]`` uint8, as ASCII characters; row 0 is the top."""
    world = episode.world
    left = camera_column(episode)
    columns = left + jnp.arange(COLUMNS, dtype=jnp.int32)
    rows = jnp.arange(ROWS, dtype=jnp.int32)
    inside = jnp.minimum(columns, course.num_columns - 1)
    places = inside[None, :] * HEIGHT + jnp.minimum(rows, HEIGHT - 1)[:, None]
    symbols = jnp.asarray(SYMBOLS)[world.tiles[places].astype(jnp.int32)]
    exit_column = lax.dynamic_index_in_dim(jnp.asarray(course.exit_column), world.level, keepdims=False)
    at_exit = jnp.broadcast_to(columns[None, :] == exit_column, symbols.shape)
    symbols = lax.select(at_exit, jnp.full_like(symbols, SYMBOL_EXIT), symbols)
    column = truncated(world.player.x * np.float32(1 / TILE))
    # Row 15 - trunc(16 - depth) in exact arithmetic; a foot point between two rows belongs to the upper one.
    depth = world.player.y * np.float32(1 / TILE)
    below = depth > np.float32(16)
    row = lax.select(below, truncated(depth), truncated(lax.ceil(depth))) - 1
    is_mario = (columns[None, :] == column) & (rows[:, None] == row)
    return lax.select(is_mario, jnp.full_like(symbols, SYMBOL_MARIO), symbols)


def camera_column(episode: Episode) -> Array:
    """Column of the level at the left edge of the observed screen (int32)."""
    return episode.camera // TILE
