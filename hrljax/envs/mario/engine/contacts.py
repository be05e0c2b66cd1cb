"""Who meets whom: Mario and the sprites, shells and fireballs and the others (docs/mario_engine.md, "Contacts")."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.envs.mario.engine.arithmetic import decayed, factor, is_positive
from hrljax.envs.mario.engine.blocks import bump
from hrljax.envs.mario.engine.collision import Cell, Purse, ceiling_position, move_along
from hrljax.envs.mario.engine.player import bounce, down, hurt, take_item
from hrljax.envs.mario.engine.sprite_list import (
    Tick,
    add,
    break_apart,
    choose,
    fly_off,
    has,
    is_enemy,
    kill_template,
    new_sprite,
    read,
    when,
    with_flag,
    write,
)
from hrljax.envs.mario.engine.sprites import sprite_shape
from hrljax.envs.mario.engine.state import (
    CARRIED,
    DEAD,
    FIREBALL,
    FLOWER,
    MUSHROOM,
    REMOVED,
    SHELL,
    SPEED,
    STRIKING,
    WINGED,
    Sprites,
    player_height,
)
from hrljax.envs.mario.levels.level import RED_KOOPA, SPIKY

_NEAR = np.float32(64)
"""Farther away than this from where Mario was, no sprite can touch him: he moves by less than 24 pixels a tick."""
_REACH = np.float32(16)
_BODY_TIME = 10
"""Ticks that a stomped enemy stays."""
_SHELL_YA = np.float32(-5)
_DECAY, _GRAVITY = factor(np.float32(0.85)), np.float32(2)


class _Touch(NamedTuple):
    """The touch check in progress."""

    place: Array  # int32: the next sprite, downwards
    tick: Tick
    bumps: Array  # bool: Mario has just hit his head at `cell`
    cell: Cell
    shells: Array  # int32: bit i: the koopa in place i was stomped and leaves a shell


def touch_all(tick: Tick, keys: Array, bumps: Array, cell: Cell) -> Tick:
    """Bumps the tile that Mario's own move ran into, then lets him meet all sprites, newest first.

    Args:
        tick: after Mario's update.
        keys: the keys held (int32).
        bumps: whether Mario's move hit a tile above him (bool).
        cell: that tile's place.
    """
    world = tick.world
    player = world.player
    slots = jnp.arange(world.sprites.x.shape[0], dtype=jnp.int32)
    near = (lax.abs(world.sprites.x - player.x) < _NEAR) & (slots < world.num_sprites)
    last = lax.select(jnp.any(near), world.num_sprites - 1, jnp.int32(-1))

    def one(touch: _Touch) -> _Touch:
        breaks = touch.tick.world.player.large
        tick = bump(touch.tick, touch.cell, breaks, touch.bumps)
        touch = touch._replace(tick=tick, bumps=jnp.bool_(False))
        meets = (touch.place >= 0) & _touches(tick, touch.place)
        touch = when(meets, lambda touch: _meet(touch, keys), touch)
        return touch._replace(place=touch.place - 1)

    start = _Touch(last, tick, bumps, cell, jnp.int32(0))
    touch = lax.while_loop(lambda touch: (touch.place >= 0) | touch.bumps, one, start)
    return _leave_shells(touch.tick, touch.shells)


def _touches(tick: Tick, place: Array) -> Array:
    """Whether the boxes of Mario and of a sprite that can be touched overlap (bool)."""
    player, sprite = tick.world.player, read(tick.world.sprites, place)
    dx, dy = player.x - sprite.x, player.y - sprite.y
    shape = sprite_shape(sprite.kind)
    reach = lax.select(is_enemy(sprite.kind), 2 * shape.half_width + np.float32(4), jnp.float32(_REACH))
    overlap = (lax.abs(dx) < reach) & (dy > -shape.height) & (dy < player_height(player.large))
    alive = (sprite.dead_time == 0) & ~has(sprite.flags, CARRIED | DEAD) & (sprite.kind != FIREBALL)
    return overlap & alive


def _meet(touch: _Touch, keys: Array) -> _Touch:
    """Mario and the sprite at `place` touch."""
    tick, place = touch.tick, touch.place
    world = tick.world
    player, sprite = world.player, read(world.sprites, place)
    enemy, shell = is_enemy(sprite.kind), sprite.kind == SHELL
    item = (sprite.kind == MUSHROOM) | (sprite.kind == FLOWER)
    winged = has(sprite.flags, WINGED)
    inert = (player.death_time > 0) | world.paused
    above = is_positive(player.ya) & (player.y - sprite.y <= 0) & (~player.on_ground | ~player.was_on_ground)
    grabs = down(keys, SPEED)
    rests = sprite.facing == 0

    stomps = above & enemy & (sprite.kind != SPIKY)
    lands_on_shell = above & shell
    takes_shell = shell & rests & grabs & (above | ~inert)
    kicks = shell & rests & ~above & ~inert & ~grabs
    bounces = ~inert & (stomps | (lands_on_shell & ~(rests & grabs)))
    hurts = (enemy & ~stomps) | (shell & ~above & ~rests)

    touch = when(bounces, lambda touch: _bounce(touch, sprite), touch)
    tick = touch.tick
    world = tick.world
    player, paused = world.player, world.paused
    wounded, paused_by_wound = hurt(player, paused)
    player, paused = choose(hurts, (wounded, paused_by_wound), (player, paused))
    grown, paused_by_growth, coins = take_item(player, sprite.kind == FLOWER, paused)
    player, paused, coins = choose(item, (grown, paused_by_growth, coins), (player, paused, jnp.int32(0)))
    player = player._replace(
        invulnerable_time=lax.select(kicks, jnp.int32(1), player.invulnerable_time),
        carried=lax.select(takes_shell, sprite.serial, player.carried),
    )

    dies = stomps & ~winged
    stops = lands_on_shell & ~rests
    facing = lax.select(shell & (above | rests), player.facing, sprite.facing)
    flags = with_flag(sprite.flags, WINGED, winged & ~stomps)
    flags = flags | lax.select(takes_shell, jnp.int32(CARRIED), jnp.int32(0))
    flags = flags | lax.select(item, jnp.int32(REMOVED), jnp.int32(0))
    sprite = sprite._replace(
        xa=lax.select(stops, jnp.float32(0), sprite.xa),
        ya=lax.select(stomps & winged, jnp.float32(0), sprite.ya),
        facing=lax.select(stops, jnp.int32(0), facing),
        flags=flags,
        dead_time=lax.select(dies, jnp.int32(_BODY_TIME), sprite.dead_time),
    )
    world = world._replace(
        player=player,
        paused=paused,
        sprites=write(world.sprites, place, sprite),
        template_states=kill_template(world.template_states, sprite.template, dies),
        coins=world.coins + coins,
        kills=world.kills + (dies & ~inert).astype(jnp.int32),
    )
    leaves_shell = dies & (sprite.kind < RED_KOOPA + 2)
    return touch._replace(
        tick=tick._replace(world=world, removing=tick.removing | item),
        shells=touch.shells | lax.shift_left(leaves_shell.astype(jnp.int32), place),
    )


def _bounce(touch: _Touch, sprite: Sprites) -> _Touch:
    world = touch.tick.world
    top = sprite.y - sprite_shape(sprite.kind).middle
    moved = bounce(Purse(world.tiles, world.coins), world.player, top)
    world = world._replace(player=moved.player, tiles=moved.purse.tiles, coins=moved.purse.coins)
    tick = bump(touch.tick._replace(world=world), moved.cell, moved.player.large, moved.bumps)
    return touch._replace(tick=tick)


def _leave_shells(tick: Tick, koopas: Array) -> Tick:
    """Stomped koopas leave shells, newest koopa first; a new shell has already made its first move."""

    def one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
        koopas, tick = carry
        place = np.int32(31) - lax.clz(koopas)
        world = tick.world
        koopa = read(world.sprites, place)
        shape = sprite_shape(jnp.int32(SHELL))
        _, along = move_along(Purse(world.tiles, world.coins), koopa.x, koopa.y, jnp.float32(_SHELL_YA), shape)
        y = lax.select(along.blocked, ceiling_position(along.position, shape.height), along.position)
        ya = decayed(lax.select(along.blocked, jnp.float32(0), jnp.float32(_SHELL_YA)), _DECAY) + _GRAVITY
        color = koopa.kind - np.int32(RED_KOOPA)
        shell = new_sprite(SHELL, koopa.x, y, y_old=koopa.y, ya=ya, facing=jnp.int32(0), aux=color)
        return koopas ^ lax.shift_left(jnp.int32(1), place), add(tick, shell)

    return lax.while_loop(lambda carry: carry[0] != 0, one, (koopas, tick))[1]


def strike_all(tick: Tick) -> Tick:
    """Shells that move or are carried, then fireballs, hit the other sprites of the list.

    Those that strike take their turns in the order in which they were updated: the list from its
    front, then Mario's new fireball, the only one that strikes before it is in the list.
    """

    def rounds(tick: Tick) -> Tick:
        end = tick.world.num_sprites + tick.num_new

        def one(carry: tuple[Array, Array, Tick]) -> tuple[Array, Array, Tick]:
            kind, turn, tick = carry
            listed = tick.world.num_sprites
            place = lax.select(turn < listed, listed - 1 - turn, turn)
            striker = read(tick.world.sprites, place)
            strikes = (striker.kind == kind) & has(striker.flags, STRIKING)
            tick = when(strikes, lambda tick: _strike(tick, place), tick)
            last = turn + 1 >= end  # an empty list too: under vmap, idle games run along
            kind = lax.select(last, lax.select(kind == SHELL, jnp.int32(FIREBALL), jnp.int32(0)), kind)
            return kind, lax.select(last, jnp.int32(0), turn + 1), tick

        return lax.while_loop(lambda carry: carry[0] != 0, one, (jnp.int32(SHELL), jnp.int32(0), tick))[2]

    return when(tick.num_striking > 0, rounds, tick)


def _strike(tick: Tick, striker_place: Array) -> Tick:
    def one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
        place, tick = carry
        a, b = read(tick.world.sprites, striker_place), read(tick.world.sprites, place)
        dx, dy = a.x - b.x, a.y - b.y
        overlap = (lax.abs(dx) < _REACH) & (dy > -sprite_shape(b.kind).height) & (dy < sprite_shape(a.kind).height)
        target = (is_enemy(b.kind) | (b.kind == SHELL)) & (b.dead_time == 0)
        hits = overlap & target & (place != striker_place) & ~has(a.flags, DEAD)
        return place - 1, when(hits, lambda tick: _hit(tick, striker_place, place), tick)

    last = tick.world.num_sprites - 1
    return lax.while_loop(lambda carry: carry[0] >= 0, one, (last, tick))[1]


def _hit(tick: Tick, striker_place: Array, place: Array) -> Tick:
    """A shell or fireball hits an enemy or another shell."""
    world = tick.world
    a, b = read(world.sprites, striker_place), read(world.sprites, place)
    by_shell, enemy = a.kind == SHELL, is_enemy(b.kind)
    killed = enemy & (by_shell | (b.kind != SPIKY))
    thrown = (2 * a.facing).astype(jnp.float32)
    a_dies = ~by_shell | ~enemy | has(a.flags, CARRIED)
    b_dies = by_shell & ~enemy
    b_knocked = ~by_shell & ~enemy & (b.facing == 0)

    carried = world.player.carried
    let_go = ((carried == a.serial) & a_dies & by_shell) | ((carried == b.serial) & b_dies)
    knocked = b._replace(xa=thrown, ya=jnp.float32(-5), dead_time=jnp.int32(100))
    b = choose(killed, fly_off(b, thrown), choose(b_dies, _broken(b), choose(b_knocked, knocked, b)))
    a = choose(a_dies, _broken(a), a)
    world = world._replace(
        player=world.player._replace(carried=lax.select(let_go, jnp.int32(-1), carried)),
        sprites=write(write(world.sprites, striker_place, a), place, b),
        template_states=kill_template(world.template_states, b.template, killed),
        kills=world.kills + killed.astype(jnp.int32),
    )
    return tick._replace(world=world)


def _broken(sprite: Sprites) -> Sprites:
    broken = break_apart(sprite)
    return broken._replace(flags=with_flag(broken.flags, CARRIED, jnp.bool_(False)))
