"""How sprites come into the game and move: monsters, items, fireballs and shells.

The rules are in docs/mario_engine.md, "Sprites", and docs/mario_engine.md, "Coming and going".
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import exact_product, opaque_zero, take
from hrljax.envs.mario.engine.arithmetic import decayed, factor, is_positive, select_factor, tile_of, truncated
from hrljax.envs.mario.engine.blocks import bump
from hrljax.envs.mario.engine.collision import (
    Cell,
    Purse,
    Shape,
    behavior,
    ceiling_position,
    floor_position,
    move_across,
    move_along,
    probes_across,
    tile_at,
    wall_position,
)
from hrljax.envs.mario.engine.course import Course, template_word, templates_left_of, unpack_template
from hrljax.envs.mario.engine.sprite_list import (
    FREE,
    PRESENT,
    Tick,
    add,
    break_apart,
    choose,
    has,
    new_sprite,
    read,
    when,
    with_flag,
    write,
)
from hrljax.envs.mario.engine.state import (
    CARRIED,
    FIREBALL,
    FLOWER,
    FLYING,
    MUSHROOM,
    ON_GROUND,
    REMOVED,
    SHELL,
    STRIKING,
    WINGED,
    Player,
    Sprites,
)
from hrljax.envs.mario.levels.level import GOOMBA, KIND_MASK, PIRANHA, RED_KOOPA
from hrljax.envs.mario.levels.level import WINGED as SPAWNS_WINGED
from hrljax.envs.mario.levels.tiles import BLOCKS, HEIGHT, TILE

_WALK, _ROLL, _SHOOT = np.float32(1.75), np.float32(11), np.float32(8)
_FRICTION = np.float32(0.89)
_RISE = 9
"""Ticks in which an item comes out of its block."""
_PLANT_REST, _PLANT_DISTANCE = 40, 24
"""A plant leaves its pipe after so many ticks, if Mario is farther away than so many pixels."""
_PLANT_DECAY, _PLANT_GRAVITY = factor(0.9), np.float32(0.1)
_FALL_DECAY, _FALL_GRAVITY = factor(0.95), np.float32(1)
_LIGHT_DECAY, _DECAY = factor(np.float32(0.95)), factor(np.float32(0.85))


def _plant_home(row: int) -> np.float32:
    """y of a plant that has withdrawn into the pipe whose mouth is in a row."""
    return np.float32(row * TILE + 24)


def _new_plant(row: int) -> tuple[np.float32, np.float32]:
    """y and ya of a new plant, which makes four moves before its first update."""
    y, ya = _plant_home(row) - np.float32(1), np.float32(-8)
    for _ in range(4):
        y, ya = y + ya, np.float32(np.float64(ya) * 0.9) + _PLANT_GRAVITY
    return y, ya


# A table, because XLA would add up constants that are added one after the other.
_PLANT_Y = np.array([_new_plant(row)[0] for row in range(HEIGHT)], np.float32)
_PLANT_YA = _new_plant(0)[1]


def spawn_all(tick: Tick, course: Course) -> Tick:
    """Creates the monsters whose cells have come into the spawn window since the last active tick."""
    world = tick.world
    first = (truncated(world.camera) >> np.int32(4)) - 1
    last = (truncated(world.camera + np.float32(320)) >> np.int32(4)) + 1

    def index(column: Array) -> Array:
        return templates_left_of(course, world.level, column)

    def scan(tick: Tick) -> Tick:
        # Templates of columns that were in the window already are skipped.
        skip_from, skip_to = index(world.window_first), index(world.window_last + 1)
        end = index(last + 1)

        def one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
            k, tick = carry
            seen = (k >= skip_from) & (k < skip_to)
            free = take(tick.world.template_states, k) == FREE
            tick = when(~seen & free, lambda tick: _spawn(tick, course, k), tick)
            return lax.select(seen, skip_to, k + 1), tick

        tick = lax.while_loop(lambda carry: carry[0] < end, one, (index(first), tick))[1]
        return tick._replace(world=tick.world._replace(window_first=first, window_last=last))

    return when((first != world.window_first) | (last != world.window_last), scan, tick)


def _spawn(tick: Tick, course: Course, k: Array) -> Tick:
    world = tick.world
    template = unpack_template(template_word(course, world.level, k))
    kind, winged = template.spawn & np.int32(KIND_MASK), (template.spawn & np.int32(SPAWNS_WINGED)) != 0
    plant = kind == PIRANHA
    x = (template.column * TILE + np.int32(TILE // 2)).astype(jnp.float32)
    y = (template.row * TILE + np.int32(TILE - 1)).astype(jnp.float32)
    left = x > world.player.x + np.float32(TILE)
    sprite = new_sprite(
        kind,
        lax.select(plant, x + np.float32(7), x),
        lax.select(plant, take(jnp.asarray(_PLANT_Y), template.row), y),
        ya=lax.select(plant, jnp.float32(_PLANT_YA), jnp.float32(0)),
        facing=lax.select(left & ~plant, jnp.int32(-1), jnp.int32(1)),
        flags=lax.select(winged, jnp.int32(WINGED), jnp.int32(0)),
        template=k,
    )
    states = lax.dynamic_update_slice(world.template_states, jnp.full(1, PRESENT), (k,))
    return add(tick._replace(world=world._replace(template_states=states)), sprite)


def update_all(tick: Tick, course: Course, new_fireball: Array, fireball: Sprites) -> Tick:
    """Updates new monsters, then the list from its front, then the fireball that Mario shoots.

    Args:
        tick: after `spawn_all`.
        course: the levels.
        new_fireball: whether Mario shoots (bool).
        fireball: what he shoots.
    """
    num_old, num_spawned = tick.world.num_sprites, tick.num_new
    num_listed = num_old + num_spawned
    num_updates = num_listed + new_fireball.astype(jnp.int32)

    def one(carry: tuple[Array, Tick]) -> tuple[Array, Tick]:
        turn, tick = carry
        tick = when(turn == num_listed, lambda tick: add(tick, fireball), tick)
        listed = num_listed - 1 - turn
        place = lax.select(turn < num_spawned, num_old + turn, listed)
        place = lax.select(turn == num_listed, num_old + tick.num_new - 1, place)
        return turn + 1, _update(tick, course, place)

    return lax.while_loop(lambda carry: carry[0] < num_updates, one, (jnp.int32(0), tick))[1]


def _update(tick: Tick, course: Course, place: Array) -> Tick:
    world = tick.world
    before = read(world.sprites, place)
    kind, flags = before.kind, before.flags
    dead, carried = before.dead_time > 0, has(flags, CARRIED)
    fireball, shell, plant = kind == FIREBALL, kind == SHELL, kind == PIRANHA
    item = (kind == MUSHROOM) | (kind == FLOWER)
    rising = item & (before.aux < _RISE)
    moving = ~(dead | carried | rising | plant | (kind == FLOWER))

    facing = lax.select(before.xa > 2, jnp.int32(1), lax.select(before.xa < -2, jnp.int32(-1), before.facing))
    facing = lax.select(moving, facing, before.facing)
    speed = lax.select(shell, _ROLL, lax.select(fireball, _SHOOT, _WALK))
    xa = lax.select(moving, facing.astype(jnp.float32) * speed, before.xa)
    striking = (shell & carried) | (moving & ((shell & (facing != 0)) | fireball))

    shape = sprite_shape(kind)
    purse = Purse(world.tiles, world.coins)
    no_speed = jnp.float32(0)
    careful = (kind == RED_KOOPA) & has(flags, ON_GROUND)
    purse, across = move_across(purse, before.x, before.y, lax.select(moving, xa, no_speed), shape, careful)
    tick = tick._replace(world=world._replace(tiles=purse.tiles, coins=purse.coins))

    def bump_wall(carry: tuple[Tick, Array, Array]) -> tuple[Tick, Array, Array]:
        """The shell's probes bump what they hit, which may toss the shell itself."""
        tick, facing, _ = carry
        moved = before._replace(x=across.position, xa=xa, facing=facing)
        tick = tick._replace(world=tick.world._replace(sprites=write(tick.world.sprites, place, moved)))
        for cell in probes_across(across.position, before.y, across.piece, shape):
            tick = _bump_if_solid(tick, cell, across.position, before.y)
        tossed = read(tick.world.sprites, place)
        return tick, tossed.facing, tossed.ya

    tick, facing, ya = when(across.blocked & shell, bump_wall, (tick, facing, before.ya))
    x = lax.select(across.blocked, wall_position(across.position, across.piece, shape.half_width), across.position)
    xa = lax.select(across.blocked, no_speed, xa)
    sprite = before._replace(x=x, xa=xa, ya=ya, facing=lax.select(across.blocked & ~fireball, -facing, facing))
    sprite = choose(across.blocked & fireball, break_apart(sprite), sprite)

    world = tick.world
    purse = Purse(world.tiles, world.coins)
    purse, along = move_along(purse, x, before.y, lax.select(moving, sprite.ya, no_speed), shape)
    fell = is_positive(sprite.ya)
    hit_ceiling, landed = along.blocked & ~fell, along.blocked & fell
    y = lax.select(landed, floor_position(along.position), along.position)
    y = lax.select(hit_ceiling, ceiling_position(along.position, shape.height), y)
    ya = lax.select(hit_ceiling, no_speed, sprite.ya)

    # What does not meet tiles: the dead fall, plants go up and down, items rise.
    falls = dead & (has(flags, FLYING) | plant | shell)
    lives_in_pipe = plant & ~dead
    template = unpack_template(template_word(course, world.level, lax.max(before.template, jnp.int32(0))))
    home = (template.row * TILE + np.int32(24)).astype(jnp.float32)
    at_home = lives_in_pipe & (y >= home)
    rested = lax.select(at_home, before.aux + 1, lax.select(lives_in_pipe, jnp.int32(0), before.aux))
    mario_away = truncated(lax.abs(world.player.x - x)) > _PLANT_DISTANCE
    leaves = at_home & (rested > _PLANT_REST) & mario_away
    ya = lax.select(leaves, jnp.float32(-8), lax.select(at_home, no_speed, ya))
    y = lax.select(at_home, home, y)
    x = lax.select(falls, x + sprite.xa, x)
    y = lax.select(falls | lives_in_pipe, y + ya, lax.select(rising, y - np.float32(1), y))

    bounces = landed & (fireball | has(flags, WINGED))
    ya = lax.select(bounces & fireball, jnp.float32(-10), ya)
    light = has(flags, WINGED) | fireball
    by = select_factor(light, _LIGHT_DECAY, _DECAY)
    by = select_factor(plant, _PLANT_DECAY, by)
    by = select_factor(dead, _FALL_DECAY, by)
    gravity = lax.select(has(flags, WINGED), jnp.float32(0.6), jnp.float32(2))
    gravity = lax.select(fireball, jnp.float32(1.5), gravity)
    gravity = lax.select(landed, jnp.float32(0), gravity)
    gravity = lax.select(plant, _PLANT_GRAVITY, gravity)
    gravity = lax.select(dead, _FALL_GRAVITY, gravity)
    changes = moving | falls | lives_in_pipe
    slower = decayed(ya, by)
    # The sum would flush a subnormal number, also if nothing is added.
    ya = lax.select(changes, lax.select(gravity == 0, slower, slower + gravity), ya)
    ya = lax.select(bounces & ~fireball, jnp.float32(-10), ya)
    zero = opaque_zero(sprite.facing.astype(jnp.uint32))
    xa = lax.select(moving, exact_product(_FRICTION, sprite.xa, zero), sprite.xa)

    dead_time = sprite.dead_time - (dead & ~fireball).astype(jnp.int32)
    over = dead & (fireball | (dead_time == 0))
    dead_time = lax.select(dead & (dead_time == 0), jnp.int32(1), dead_time)
    flags = lax.select(moving, with_flag(sprite.flags, ON_GROUND, landed), sprite.flags)
    flags = with_flag(flags, STRIKING, striking)
    flags = flags | lax.select(over, jnp.int32(REMOVED), jnp.int32(0))
    sprite = sprite._replace(
        x=x, y=y, xa=xa, ya=ya, x_old=before.x, y_old=before.y, flags=flags, dead_time=dead_time,
        aux=lax.select(rising, before.aux + 1, rested),
    )  # fmt: skip
    return Tick(
        world=world._replace(sprites=write(world.sprites, place, sprite)),
        num_new=tick.num_new,
        num_striking=tick.num_striking + striking.astype(jnp.int32),
        removing=tick.removing | over,
    )


def _bump_if_solid(tick: Tick, cell: Cell, x: Array, y: Array) -> Tick:
    """A shell at (x, y) bumps the tile of a probe that is not free."""
    is_current = (cell.column == tile_of(x)) & (cell.row == tile_of(y))
    blocks = (behavior(tile_at(tick.world.tiles, cell)) & np.int32(BLOCKS)) != 0
    return bump(tick, cell, jnp.bool_(True), blocks & ~is_current)


def sprite_shape(kind: Array) -> Shape:
    """The box of a kind."""
    tall = kind < GOOMBA
    height = lax.select(kind == FIREBALL, jnp.float32(8), lax.select(tall, jnp.float32(24), jnp.float32(12)))
    return Shape(lax.select(kind == PIRANHA, jnp.float32(2), jnp.float32(4)), height, height * np.float32(0.5))


def fireball_of(player: Player) -> Sprites:
    """The fireball that Mario shoots, before its first update."""
    ahead = (6 * player.facing).astype(jnp.float32)
    return new_sprite(FIREBALL, player.x + ahead, player.y - np.float32(20), ya=jnp.float32(4), facing=player.facing)
