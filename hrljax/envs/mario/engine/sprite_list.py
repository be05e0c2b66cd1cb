"""One sprite as scalars; reading, writing, adding and removing sprites; the world in the middle of a tick."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, take
from hrljax.envs.mario.engine.state import DEAD, FLYING, MAX_SPRITES, REMOVED, WINGED, Sprites, World
from hrljax.envs.mario.levels.level import PIRANHA

T = TypeVar("T")

FREE, PRESENT, KILLED = np.uint8(0), np.uint8(1), np.uint8(2)
"""Values of `World.template_states`."""

DYING_TIME = 100
"""`dead_time` of what flies out of the screen."""


class Tick(NamedTuple):
    """The world in the middle of a tick."""

    world: World
    num_new: Array  # int32: sprites that wait behind the list, in the order of their creation
    num_striking: Array  # int32: shells and fireballs that hit others in this tick
    removing: Array  # bool: some sprite leaves at the end of the tick


def when(condition: Array, function: Callable[[T], T], value: T) -> T:
    """``function(value)`` if `condition` holds, else `value`; large arrays are changed in place.

    A loop of one turn or none: `lax.cond` would copy the arrays.
    """

    def once(carry: tuple[Array, T]) -> tuple[Array, T]:
        return jnp.bool_(False), function(carry[1])

    return lax.while_loop(lambda carry: carry[0], once, (condition, value))[1]


def has(flags: Array, flag: int) -> Array:
    """Whether a bit of `flags` is set (bool)."""
    return (flags & np.int32(flag)) != 0


def with_flag(flags: Array, flag: int, condition: Array) -> Array:
    """`flags` with one bit set or cleared."""
    return (flags & np.int32(~flag)) | lax.select(condition, jnp.int32(flag), jnp.int32(0))


def read(sprites: Sprites, i: Array) -> Sprites:
    """The sprite in place `i`, as scalars."""
    return Sprites(*(take(values, i) for values in sprites))


def write(sprites: Sprites, i: Array, sprite: Sprites) -> Sprites:
    """`sprites` with place `i` (below `MAX_SPRITES`) replaced."""
    return Sprites(*(put_row(values, i, value[None]) for values, value in zip(sprites, sprite, strict=True)))


def new_sprite(kind: Array | int, x: Array, y: Array, **others: Array) -> Sprites:
    """A sprite at rest that faces right and has no template; its serial number is not set."""
    zero, none = jnp.float32(0), jnp.int32(0)
    sprite = Sprites(
        x=x, y=y, xa=zero, ya=zero, x_old=x, y_old=y, kind=jnp.int32(kind), facing=jnp.int32(1), flags=none,
        dead_time=none, aux=none, serial=none, template=jnp.int32(-1),
    )  # fmt: skip
    return sprite._replace(**others)


def add(tick: Tick, sprite: Sprites) -> Tick:
    """Puts a new sprite behind the list, where it waits for the end of the tick."""
    world = tick.world
    place = world.num_sprites + tick.num_new
    full = place >= MAX_SPRITES
    place = lax.select(full, jnp.int32(MAX_SPRITES - 1), place)
    sprite = sprite._replace(serial=world.num_created)
    occupant = read(world.sprites, place)
    sprite = Sprites(*(lax.select(full, a, b) for a, b in zip(occupant, sprite, strict=True)))
    world = world._replace(
        sprites=write(world.sprites, place, sprite),
        num_created=world.num_created + 1,
        overflow=world.overflow | full,
    )
    return tick._replace(world=world, num_new=tick.num_new + (~full).astype(jnp.int32))


def kill_template(states: Array, template: Array, condition: Array) -> Array:
    """Template states where a sprite's template, if it has one and `condition` holds, is dead for good."""
    place = lax.max(template, jnp.int32(0))
    dead = condition & (template >= 0)
    return put_row(states, place, lax.select(dead, jnp.uint8(KILLED), take(states, place))[None])


def fly_off(sprite: Sprites, xa: Array) -> Sprites:
    """An enemy hit by something: it loses its wings and falls out of the screen."""
    return sprite._replace(
        xa=xa,
        ya=jnp.float32(-5),
        flags=with_flag(sprite.flags, WINGED, jnp.bool_(False)) | np.int32(FLYING),
        dead_time=jnp.int32(DYING_TIME),
    )


def break_apart(sprite: Sprites) -> Sprites:
    """A shell or fireball that dies: it falls out of the screen, backwards."""
    return sprite._replace(
        xa=(-2 * sprite.facing).astype(jnp.float32),
        ya=jnp.float32(-5),
        flags=sprite.flags | np.int32(DEAD),
        dead_time=jnp.int32(DYING_TIME),
    )


def is_enemy(kind: Array) -> Array:
    """Whether a kind is one of the five monsters (bool)."""
    return kind <= PIRANHA


def choose(condition: Array, these: T, those: T) -> T:
    """Of two trees of scalars, the first if `condition` holds."""
    if isinstance(these, tuple):
        chosen = [choose(condition, a, b) for a, b in zip(these, those, strict=True)]  # type: ignore[arg-type]
        return type(these)(*chosen) if hasattr(these, "_fields") else tuple(chosen)  # type: ignore[return-value]
    return lax.select(condition, these, those)  # type: ignore[type-var]


def settle(tick: Tick) -> World:
    """The end of a tick: removed sprites leave, new ones enter the list at its front.

    The front of the list is the end of the arrays. Sprites that enter together are listed in the
    order of their creation, so the arrays hold them in reverse.
    """
    tick = when(tick.num_new > 1, _reverse_new, tick)
    world = tick.world._replace(num_sprites=tick.world.num_sprites + tick.num_new)
    return when(tick.removing, _compact, world)


def _reverse_new(tick: Tick) -> Tick:
    def swap(carry: tuple[Array, Array, Sprites]) -> tuple[Array, Array, Sprites]:
        i, j, sprites = carry
        a, b = read(sprites, i), read(sprites, j)
        return i + 1, j - 1, write(write(sprites, i, b), j, a)

    first = tick.world.num_sprites
    start = (first, first + tick.num_new - 1, tick.world.sprites)
    sprites = lax.while_loop(lambda carry: carry[0] < carry[1], swap, start)[2]
    return tick._replace(world=tick.world._replace(sprites=sprites))


def _compact(world: World) -> World:
    def look_at(carry: tuple[Array, Array, Sprites, Array]) -> tuple[Array, Array, Sprites, Array]:
        i, num_staying, sprites, states = carry
        sprite = read(sprites, i)
        stays = ~has(sprite.flags, REMOVED)
        place = lax.max(sprite.template, jnp.int32(0))
        state = take(states, place)
        frees = ~stays & (sprite.template >= 0) & (state == PRESENT)
        states = put_row(states, place, lax.select(frees, jnp.uint8(FREE), state)[None])
        # A sprite that leaves is written too; the next one that stays overwrites it.
        return i + 1, num_staying + stays.astype(jnp.int32), write(sprites, num_staying, sprite), states

    count = world.num_sprites
    start = (jnp.int32(0), jnp.int32(0), world.sprites, world.template_states)
    _, num_staying, sprites, states = lax.while_loop(lambda carry: carry[0] < count, look_at, start)
    return world._replace(num_sprites=num_staying, sprites=sprites, template_states=states)
