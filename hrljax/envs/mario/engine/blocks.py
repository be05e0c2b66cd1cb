"""Bumping a tile: what it turns into, what comes out, and what happens to those who stand on it.

The rules are in docs/mario_engine.md, "Blocks and items".
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import take
from hrljax.envs.mario.engine.arithmetic import tile_of
from hrljax.envs.mario.engine.collision import Cell, behavior, cell_index, put_tile, tile_at
from hrljax.envs.mario.engine.sprite_list import (
    Tick,
    add,
    choose,
    fly_off,
    is_enemy,
    kill_template,
    new_sprite,
    read,
    when,
    write,
)
from hrljax.envs.mario.engine.state import FLOWER, MUSHROOM, SHELL
from hrljax.envs.mario.levels.level import PIRANHA
from hrljax.envs.mario.levels.tiles import BREAKABLE, BUMPABLE, EMPTY, PICK_UP, SPECIAL, TILE, USED_BLOCK


def bump(tick: Tick, cell: Cell, breaks: Array, condition: Array) -> Tick:
    """Bumps the tile in a cell from below or from the side, if `condition` holds.

    Args:
        tick: the tick.
        cell: where.
        breaks: whether bricks break (bool).
        condition: bool.
    """

    def do(tick: Tick) -> Tick:
        tiles = tick.world.tiles
        index = cell_index(cell, tiles.shape[0])
        bits = behavior(tile_at(tiles, cell))
        bumpable, special, breakable = ((bits & np.int32(bit)) != 0 for bit in (BUMPABLE, SPECIAL, BREAKABLE))
        tick = when(bumpable | breakable, lambda tick: _shake(tick, Cell(cell.column, cell.row - 1)), tick)
        world = tick.world
        tile = lax.select(bumpable, jnp.uint8(USED_BLOCK), tile_at(world.tiles, cell))
        tile = lax.select(breakable & breaks, jnp.uint8(EMPTY), tile)
        coins = world.coins + (bumpable & ~special).astype(jnp.int32)
        tick = tick._replace(world=world._replace(tiles=put_tile(world.tiles, index, tile), coins=coins))
        return when(bumpable & special, lambda tick: _add_item(tick, cell), tick)

    return when(condition, do, tick)


def _add_item(tick: Tick, cell: Cell) -> Tick:
    kind = lax.select(tick.world.player.large, jnp.int32(FLOWER), jnp.int32(MUSHROOM))
    x = (cell.column * TILE + np.int32(TILE // 2)).astype(jnp.float32)
    y = (cell.row * TILE + np.int32(TILE // 2)).astype(jnp.float32)
    # It has already risen once when it enters the list.
    item = new_sprite(kind, x, y - np.float32(1), y_old=y, aux=jnp.int32(1))
    return add(tick, item)


def _shake(tick: Tick, cell: Cell) -> Tick:
    """What lies in or stands on the cell above a bumped tile."""
    world = tick.world
    index = cell_index(cell, world.tiles.shape[0])
    tile = tile_at(world.tiles, cell)
    coin = (behavior(tile) & np.int32(PICK_UP)) != 0
    # A cell above the level holds no coin, so the tile at its clamped place stays.
    unchanged = lax.select(cell.row < 0, take(world.tiles, index), tile)
    world = world._replace(
        tiles=put_tile(world.tiles, index, lax.select(coin, jnp.uint8(EMPTY), unchanged)),
        coins=world.coins + coin.astype(jnp.int32),
    )
    left = (cell.column * TILE).astype(jnp.float32)
    facing = world.player.facing

    def shake_one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
        i, tick = carry
        world = tick.world
        sprite = read(world.sprites, i)
        half_width = lax.select(sprite.kind == PIRANHA, jnp.float32(2), jnp.float32(4))
        above = (sprite.x + half_width > left) & (sprite.x - half_width < left + np.float32(TILE))
        above = above & (tile_of(sprite.y - np.float32(1)) == cell.row)
        killed = above & is_enemy(sprite.kind) & (sprite.dead_time == 0)
        tossed = above & ((sprite.kind == SHELL) | (sprite.kind == MUSHROOM))
        flying = fly_off(sprite, (-2 * facing).astype(jnp.float32))
        sprite = choose(killed, flying, sprite)
        sprite = sprite._replace(
            facing=lax.select(tossed, -facing, sprite.facing),
            ya=lax.select(tossed, jnp.float32(-10), sprite.ya),
        )
        world = world._replace(
            sprites=write(world.sprites, i, sprite),
            template_states=kill_template(world.template_states, sprite.template, killed),
        )
        return i + 1, tick._replace(world=world)

    start = (jnp.int32(0), tick._replace(world=world))
    return lax.while_loop(lambda carry: carry[0] < carry[1].world.num_sprites, shake_one, start)[1]
