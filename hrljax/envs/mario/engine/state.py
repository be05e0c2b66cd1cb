"""The state of the game: Mario, the other sprites, the level as it is being changed.

Units are those of the original: pixels, x to the right, y down, origin top left; a tile is 16 pixels;
one tick is a 24th of a second. A thing's (x, y) is the middle of its lower edge. More is in
docs/mario_engine.md, "Coordinates and units". Everything is for one game; a batch of games is a batch
of these trees (`jax.vmap`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from hrljax.envs.mario.levels.level import MONSTERS, PIRANHA

MAX_SPRITES = 32
"""Places for sprites; at most 32, as sets of places are bits of one word. No recorded game has more than 14 at once."""

MUSHROOM, FLOWER, FIREBALL, SHELL = range(PIRANHA + 1, PIRANHA + 5)
"""Kinds of sprites besides the monsters of `hrljax.envs.mario.levels.level`, whose numbers 1 to 5 are theirs too."""
KIND_NAMES = ("none", *MONSTERS, "mushroom", "fire flower", "fireball", "shell")

ON_GROUND, WINGED, FLYING, CARRIED, DEAD, REMOVED, STRIKING = (1 << i for i in range(7))
"""Bits of `Sprites.flags`.

Flying: an enemy that was hit and falls out of the screen. Dead: a shell or fireball that does so.
Striking (shells, fireballs): hits others in this tick. Removed: leaves at the end of this tick.
"""

LEFT, RIGHT, DOWN, UP, JUMP, SPEED = 1, 2, 4, 8, 16, 32
"""Bits of the keys; the engine looks at left, right, jump and speed."""


class Player(NamedTuple):
    """Mario. Scalars: float32, then int32, then bool."""

    x: Array
    y: Array
    xa: Array  # velocity, pixels a tick
    ya: Array
    x_old: Array  # position before the last tick
    y_old: Array
    x_jump_speed: Array
    y_jump_speed: Array
    facing: Array  # 1 right, -1 left
    jump_time: Array  # ticks of boost left; negative in a wall jump
    power_up_time: Array  # ticks left of the pause in which he grows (> 0) or shrinks (< 0)
    invulnerable_time: Array
    death_time: Array  # ticks since death; 0: alive
    win_time: Array  # ticks since the exit was reached; 0: not yet
    carried: Array  # serial number of the shell he carries, or -1
    on_ground: Array
    was_on_ground: Array
    may_jump: Array
    sliding: Array  # down a wall
    can_shoot: Array
    large: Array  # flickers while he grows or shrinks
    fire: Array
    large_before: Array  # what `large` and `fire` were before the last change, and are after it
    fire_before: Array
    large_after: Array
    fire_after: Array


class Sprites(NamedTuple):
    """All sprites but Mario, each array ``[MAX_SPRITES]``; the first `World.num_sprites` places are in use.

    Places are from the oldest to the newest sprite: the reverse of the order in which the engine
    goes through them.
    """

    x: Array  # float32
    y: Array
    xa: Array
    ya: Array
    x_old: Array
    y_old: Array
    kind: Array  # int32, 1 to 9
    facing: Array  # 1 right, -1 left, 0 a shell at rest
    flags: Array  # ON_GROUND, WINGED, FLYING, CARRIED, DEAD
    dead_time: Array  # ticks that a dead one stays; 0: alive
    aux: Array  # plant: ticks of rest; shell: 0 red, 1 green; mushroom, flower: ticks since it began to rise
    serial: Array  # number of this sprite, by creation in this game
    template: Array  # index of its spawn template, or -1


class World(NamedTuple):
    """The whole state of one game. All scalars are int32 unless noted."""

    player: Player
    sprites: Sprites
    num_sprites: Array
    tiles: Array  # [W * 15] uint8: tile of column x and row y (0 top) at x * 15 + y
    template_states: Array  # [K] uint8: 0 free, 1 its sprite is there, 2 killed for good
    window_first: Array  # first and last column of the spawn window of the last active tick
    window_last: Array
    camera: Array  # float32: x of the left edge of the screen
    paused: Array  # bool
    active_ticks: Array  # ticks in which the game was not paused
    coins: Array
    kills: Array
    fireballs_on_screen: Array
    num_created: Array  # sprites created so far
    overflow: Array  # bool: a sprite was lost because all places were taken
    level: Array  # index into the `Course`


_FLOATS = ("x", "y", "xa", "ya", "x_old", "y_old")


def no_sprites() -> Sprites:
    """Sprites of an empty list."""
    numbers, counts = jnp.zeros(MAX_SPRITES, jnp.float32), jnp.zeros(MAX_SPRITES, jnp.int32)
    return Sprites(**{name: numbers if name in _FLOATS else counts for name in Sprites._fields})


def new_player(large: Array | bool = False, fire: Array | bool = False) -> Player:
    """Mario at the start of a level: 32 pixels from its left end, falling from the top."""
    zero, off = jnp.float32(0), jnp.bool_(False)
    large, fire = jnp.asarray(large, bool), jnp.asarray(fire, bool)
    count = jnp.int32(0)
    return Player(
        x=jnp.float32(32), y=zero, xa=zero, ya=zero, x_old=jnp.float32(32), y_old=zero,
        x_jump_speed=zero, y_jump_speed=zero, facing=jnp.int32(1), jump_time=count, power_up_time=count,
        invulnerable_time=count, death_time=count, win_time=count, carried=jnp.int32(-1), on_ground=off,
        was_on_ground=off, may_jump=off, sliding=off, can_shoot=off, large=large, fire=fire,
        large_before=large, fire_before=fire, large_after=large, fire_after=fire,
    )  # fmt: skip


def player_height(large: Array) -> Array:
    """Mario's height in pixels (float32)."""
    return lax.select(large, jnp.float32(24), jnp.float32(12))
