"""Mario's own update: keys, jumps, the death and growth animations; hurt, power-ups and the bounce."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, opaque_zero
from hrljax.envs.mario.engine.arithmetic import decayed, factor, is_positive
from hrljax.envs.mario.engine.collision import (
    Cell,
    Purse,
    Shape,
    bumped_cell,
    ceiling_position,
    floor_position,
    move_across,
    move_along,
    wall_position,
)
from hrljax.envs.mario.engine.sprite_list import choose
from hrljax.envs.mario.engine.state import JUMP, LEFT, RIGHT, SPEED, Player, player_height
from hrljax.envs.mario.levels.tiles import HEIGHT, TILE

WALK, RUN = np.float32(0.6), np.float32(1.2)
_JUMP_SPEED, _WALL_JUMP_SPEED = np.float32(-1.9), np.float32(-2)
_JUMP_TIME, _BOUNCE_TIME, _WALL_JUMP_TIME = 7, 8, -6
_WALL_JUMP_SPEED_ACROSS = 6
FRICTION, _GRAVITY = np.float32(0.89), np.float32(3)
_DECAY = factor(0.82)
_HALF_WIDTH = np.float32(4)
_GROWTH_TIME, _SHELTER_TIME = 18, 32
_MAX_FIREBALLS = 2


def down(keys: Array, key: int) -> Array:
    """Whether a key is held (bool)."""
    return (keys & np.int32(key)) != 0


def die(player: Player, condition: Array) -> Player:
    """Mario dies if `condition` holds; the caller pauses the game."""
    return player._replace(death_time=lax.select(condition, jnp.int32(1), player.death_time))


def steer(player: Player, keys: Array) -> Player:
    """The first half of an update: what the keys do to velocities and flags.

    These are points 1 to 9 of docs/mario_engine.md, "Mario's update".

    `can_shoot` is left as it was, see `shoots`.
    """
    p = player
    was_on_ground = p.on_ground
    facing = lax.select(p.xa > 2, jnp.int32(1), lax.select(p.xa < -2, jnp.int32(-1), p.facing))
    jump, speed = down(keys, JUMP), down(keys, SPEED)
    left, right = down(keys, LEFT), down(keys, RIGHT)

    jumps = jump | ((p.jump_time < 0) & ~p.on_ground & ~p.sliding)
    from_wall_before = jumps & (p.jump_time < 0)
    may_start = jumps & (p.jump_time >= 0) & p.may_jump
    from_ground = may_start & p.on_ground
    from_wall = may_start & ~p.on_ground & p.sliding
    starts = from_ground | from_wall
    boosted = jumps & (p.jump_time > 0) & ~starts

    away = (-_WALL_JUMP_SPEED_ACROSS * facing).astype(jnp.float32)
    across = lax.select(from_wall, away, lax.select(from_ground, jnp.float32(0), p.x_jump_speed))
    upward = lax.select(from_wall, _WALL_JUMP_SPEED, lax.select(from_ground, _JUMP_SPEED, p.y_jump_speed))
    time = lax.select(
        from_wall, jnp.int32(_WALL_JUMP_TIME), lax.select(from_ground, jnp.int32(_JUMP_TIME), p.jump_time)
    )
    strength = lax.select(from_wall | from_wall_before, -time, time).astype(jnp.float32)
    zero = opaque_zero(keys.astype(jnp.uint32))
    boost = exact_product(strength, upward, zero)
    ya = lax.select(from_wall_before | starts | boosted, boost, p.ya)
    xa = lax.select(boosted, p.xa + p.x_jump_speed, p.xa)
    xa = lax.select(from_wall_before | from_wall, across, xa)
    time = time + from_wall_before.astype(jnp.int32) - boosted.astype(jnp.int32)
    time = lax.select(jumps, time, jnp.int32(0))
    on_ground = p.on_ground & ~starts
    sliding = p.sliding & ~starts
    facing = lax.select(from_wall, -facing, facing)

    push = lax.select(speed, RUN, WALK)
    turns = time >= 0
    sliding = sliding & ~(left & (facing == 1))
    xa = lax.select(left, xa - push, xa)
    facing = lax.select(left & turns, jnp.int32(-1), facing)
    sliding = sliding & ~(right & (facing == -1))
    xa = lax.select(right, xa + push, xa)
    facing = lax.select(right & turns, jnp.int32(1), facing)
    sliding = sliding & (left | right) & (ya >= 0) & ~on_ground

    may_jump = (on_ground | sliding) & ~jump
    xa = lax.select(lax.abs(xa) < np.float32(0.5), jnp.float32(0), xa)
    ya = lax.select(sliding, ya * np.float32(0.5), ya)
    return p._replace(
        xa=xa, ya=ya, x_jump_speed=across, y_jump_speed=upward, jump_time=time, facing=facing,
        on_ground=on_ground, was_on_ground=was_on_ground, may_jump=may_jump, sliding=sliding,
        invulnerable_time=lax.max(p.invulnerable_time - 1, jnp.int32(0)), x_old=p.x, y_old=p.y,
    )  # fmt: skip


def shoots(player: Player, keys: Array, fireballs_on_screen: Array) -> Array:
    """Whether Mario shoots a fireball in this update (bool)."""
    return down(keys, SPEED) & player.can_shoot & player.fire & (fireballs_on_screen < _MAX_FIREBALLS)


def player_shape(player: Player) -> Shape:
    """Mario's box."""
    height = player_height(player.large)
    return Shape(_HALF_WIDTH, height, height * np.float32(0.5))


class Moved(NamedTuple):
    """Mario after a move, and the tile that he bumped."""

    purse: Purse
    player: Player
    bumps: Array  # bool
    cell: Cell


def move_vertically(purse: Purse, player: Player, dy: Array) -> Moved:
    """Moves Mario by `dy` pixels, picking up coins; a tile above him is not yet bumped."""
    shape = player_shape(player)
    purse, along = move_along(purse, player.x, player.y, dy, shape, collects=True)
    fell = is_positive(dy)
    landed, bumps = along.blocked & fell, along.blocked & ~fell
    y = lax.select(landed, floor_position(along.position - np.float32(1)), along.position)
    y = lax.select(bumps, ceiling_position(along.position, shape.height), y)
    moved = player._replace(
        y=y,
        ya=lax.select(bumps, jnp.float32(0), player.ya),
        jump_time=lax.select(bumps, jnp.int32(0), player.jump_time),
        on_ground=player.on_ground | landed,
    )
    cell = bumped_cell(player.x, along.position, along.piece, shape, purse.tiles)
    return Moved(purse, moved, bumps, cell)


def move(purse: Purse, player: Player) -> Moved:
    """The second half of an update: moving (docs/mario_engine.md, "Mario's update", point 10)."""
    shape = player_shape(player)
    purse, across = move_across(purse, player.x, player.y, player.xa, shape, collects=True)
    blocked = across.blocked
    player = player._replace(
        x=lax.select(blocked, wall_position(across.position, across.piece, _HALF_WIDTH), across.position),
        xa=lax.select(blocked, jnp.float32(0), player.xa),
        sliding=lax.select(player.xa == 0, player.sliding, across.all_blocked),
        on_ground=jnp.bool_(False),
    )
    return move_vertically(purse, player, player.ya)


class Verdict(NamedTuple):
    """Mario after his update, and how the game goes on."""

    player: Player
    dies: Array  # bool
    wins: Array  # bool


def finish(player: Player, keys: Array, exit_column: Array, num_columns: int) -> Verdict:
    """The end of an update: borders, decay and gravity (docs/mario_engine.md, "Mario's update", points 11 and 12)."""
    dies = player.y > np.float32(HEIGHT * TILE + TILE)
    outside = player.x < 0
    x = lax.select(outside, jnp.float32(0), player.x)
    xa = lax.select(outside, jnp.float32(0), player.xa)
    wins = x > (exit_column * TILE).astype(jnp.float32)
    end = jnp.float32(num_columns * TILE)
    x = lax.select(x > end, end, x)
    slower = decayed(player.ya, _DECAY)
    zero = opaque_zero(keys.astype(jnp.uint32))
    player = player._replace(
        x=x,
        xa=exact_product(FRICTION, xa, zero),
        ya=lax.select(player.on_ground, slower, slower + _GRAVITY),
        win_time=lax.select(wins, jnp.int32(1), player.win_time),
        can_shoot=~down(keys, SPEED),
    )
    return Verdict(die(player, dies), dies, wins)


def animate(player: Player) -> tuple[Player, Array]:
    """One update while the game is paused; returns also whether the pause goes on (bool)."""
    p = player._replace(x_old=player.x, y_old=player.y)
    won, dead = p.win_time > 0, p.death_time > 0
    zero = jnp.float32(0)
    victorious = p._replace(win_time=p.win_time + 1, xa=zero, ya=zero)

    time = p.death_time + 1
    xa = lax.select(time < 11, zero, p.xa)
    ya = lax.select(time < 11, zero, lax.select(time == 11, jnp.float32(-15), p.ya + np.float32(2)))
    dying = p._replace(death_time=time, xa=xa, ya=ya, x=p.x + xa, y=p.y + ya)

    left = p.power_up_time - lax.sign(p.power_up_time)
    shows_new = (lax.div(lax.abs(left), jnp.int32(3)) & 1) == 0
    changing = p._replace(
        power_up_time=left,
        large=lax.select(shows_new, p.large_after, p.large_before),
        fire=lax.select(shows_new, p.fire_after, p.fire_before),
    )
    after = choose(won, victorious, choose(dead, dying, changing))
    return after, won | dead | (left != 0)


def _change(player: Player, large: Array, fire: Array, time: int) -> Player:
    return player._replace(
        large=large, fire=fire, large_before=player.large, fire_before=player.fire, large_after=large,
        fire_after=fire, power_up_time=jnp.int32(time),
    )  # fmt: skip


def hurt(player: Player, paused: Array) -> tuple[Player, Array]:
    """Mario is hurt; returns also `paused`."""
    immune = (player.death_time > 0) | paused | (player.invulnerable_time > 0)
    smaller = _change(player, player.fire, jnp.bool_(False), -_GROWTH_TIME)
    smaller = smaller._replace(invulnerable_time=jnp.int32(_SHELTER_TIME))
    dead = die(player, jnp.bool_(True))
    return choose(immune, player, choose(player.large, smaller, dead)), paused | ~immune


def take_item(player: Player, flower: Array, paused: Array) -> tuple[Player, Array, Array]:
    """Mario takes a mushroom or a fire flower; returns also `paused` and the coins that he gets for it."""
    ignored = (player.death_time > 0) | paused
    grows = ~ignored & lax.select(flower, ~player.fire, ~player.large)
    larger = _change(player, jnp.bool_(True), flower, _GROWTH_TIME)
    coin = (~ignored & ~grows).astype(jnp.int32)
    return choose(grows, larger, player), paused | grows, coin


def bounce(purse: Purse, player: Player, top: Array) -> Moved:
    """Mario jumps off something whose middle is at `top`.

    See docs/mario_engine.md, "Hurt, power-ups and the bounce".
    """
    moved = move_vertically(purse, player, top - player.y)
    off = jnp.bool_(False)
    player = moved.player._replace(
        x_jump_speed=jnp.float32(0),
        y_jump_speed=jnp.float32(_JUMP_SPEED),
        jump_time=jnp.int32(_BOUNCE_TIME),
        ya=jnp.float32(np.float32(_BOUNCE_TIME) * _JUMP_SPEED),
        on_ground=off,
        sliding=off,
        invulnerable_time=jnp.int32(1),
    )
    return moved._replace(player=player)
