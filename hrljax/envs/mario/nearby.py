"""What is near Mario, in the words of agents that others have described: walls, pits, monsters.

Columns and rows are tiles; offsets lead from Mario to the right and up. All functions are pure, for one game.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import take
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.sprite_list import is_enemy
from hrljax.envs.mario.engine.state import MAX_SPRITES, World
from hrljax.envs.mario.features import cell
from hrljax.envs.mario.levels.tiles import BEHAVIORS, BLOCKS, EMPTY, HEIGHT, TILE

REACH_LEFT, REACH_RIGHT = 4, 12
"""Columns to the left and to the right of Mario in which things are looked for."""
_AHEAD = 4
"""Columns in which a wall or a monster is near; at full speed Mario covers three in a step."""
_PIT_AHEAD = 2
_MONSTER_ROWS = 2
_FAR = np.int32(1 << 20)


class Dangers(NamedTuple):
    """What a runner jumps over; bool scalars."""

    wall: Array  # something blocks at the height of Mario's feet
    pit: Array
    monster: Array

    @property
    def any(self) -> Array:
        return self.wall | self.pit | self.monster


class Things(NamedTuple):
    """Monsters and pits around Mario, the nearest first; arrays of one length."""

    is_pit: Array  # bool
    dx: Array  # int32, columns to the right
    dy: Array  # int32, rows above; of a pit, of the lowest row
    mask: Array  # bool: there is such a thing


def _tile(course: Course, world: World, column: Array, row: Array | int) -> Array:
    """The byte of a tile (int32); beyond its ends a level goes on as it ends there."""
    column = lax.clamp(jnp.int32(0), column, jnp.int32(course.num_columns - 1))
    row = lax.clamp(jnp.int32(0), jnp.asarray(row, jnp.int32), jnp.int32(HEIGHT - 1))
    return take(world.tiles, column * np.int32(HEIGHT) + row).astype(jnp.int32)


def _is_pit(course: Course, world: World, column: Array) -> Array:
    return _tile(course, world, column, HEIGHT - 1) == EMPTY


def pits(course: Course, world: World, first: int, last: int) -> Array:
    """Which of the columns from `first` to `last`, counted from Mario's, are of a pit: ``[last - first + 1]`` bool."""
    column, _ = cell(world.player.x, world.player.y)
    return jnp.stack([_is_pit(course, world, column + np.int32(ahead)) for ahead in range(first, last + 1)])


def dangers(course: Course, world: World) -> Dangers:
    """Whether a wall, a pit or a monster is ahead of Mario."""
    column, row = cell(world.player.x, world.player.y)
    blocks = jnp.asarray((BEHAVIORS & BLOCKS) != 0)
    wall, pit = jnp.bool_(False), pits(course, world, 0, _PIT_AHEAD).any()
    for ahead in range(1, _AHEAD):
        wall |= take(blocks, _tile(course, world, column + ahead, row))
    sprites = world.sprites
    listed = (np.arange(MAX_SPRITES, dtype=np.int32) < world.num_sprites) & is_enemy(sprites.kind)
    dx, dy = sprites.x - world.player.x, sprites.y - world.player.y
    ahead = (dx > 0) & (dx < np.float32(_AHEAD * TILE)) & (jnp.abs(dy) <= np.float32(_MONSTER_ROWS * TILE))
    return Dangers(wall, pit, jnp.any(listed & ahead))


def nearest(course: Course, world: World, count: int) -> Things:
    """The nearest of the monsters, and of the left ends of pits, by columns and rows together."""
    player, sprites = world.player, world.sprites
    _, row = cell(player.x, player.y)
    offsets = np.arange(-REACH_LEFT, REACH_RIGHT + 1, dtype=np.int32)
    open_below = pits(course, world, -REACH_LEFT - 1, REACH_RIGHT)
    begins = open_below[1:] & ~open_below[:-1]
    dx = jnp.concatenate([jnp.round((sprites.x - player.x) / np.float32(TILE)).astype(jnp.int32), offsets])
    dy = jnp.round((player.y - sprites.y) / np.float32(TILE)).astype(jnp.int32)
    below = jnp.full(len(offsets), row - np.int32(HEIGHT - 1), jnp.int32)
    dy = jnp.concatenate([dy, below])
    listed = (np.arange(MAX_SPRITES, dtype=np.int32) < world.num_sprites) & is_enemy(sprites.kind)
    seen = jnp.concatenate([listed, begins]) & (dx >= -REACH_LEFT) & (dx <= REACH_RIGHT)
    places = np.arange(len(offsets) + MAX_SPRITES, dtype=np.int32)
    distance = jnp.where(seen, jnp.abs(dx) + jnp.abs(dy), _FAR)
    chosen = []
    for _ in range(count):
        least = jnp.min(distance)
        place = jnp.min(jnp.where(distance == least, places, _FAR))
        chosen.append((place >= MAX_SPRITES, take(dx, place), take(dy, place), least < _FAR))
        distance = jnp.where(places == place, _FAR, distance)
    return Things(*(jnp.stack(values) for values in zip(*chosen, strict=True)))
