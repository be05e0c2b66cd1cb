"""A lattice for positions and velocities, so that the game has finitely many states."""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.envs.mario.engine.state import World

QUANTA = (1, 2, 4, 8, 16, 32, 64)
"""Allowed values of `quantum`: powers of two, so that every point of the lattice is a float32."""


def check_quantum(quantum: int | None) -> None:
    """Raises unless `quantum` is None or one of `QUANTA`."""
    if quantum is not None:
        checks.choice("quantum", checks.integer("quantum", quantum, 1, QUANTA[-1]), (None, *QUANTA))


def snapped(values: Array, quantum: int) -> Array:
    """float32 values moved to the nearest multiple of 1 / quantum, in the middle between two to the even one."""
    scaled = lax.round(values * np.float32(quantum), lax.RoundingMethod.TO_NEAREST_EVEN)
    # Adding 0 turns -0 into 0, so that a point of the lattice has one form.
    return scaled * np.float32(1 / quantum) + np.float32(0)


def snap(world: World, quantum: int) -> World:
    """The world with positions and velocities of Mario and the sprites on the lattice.

    Mario's ya, which stays positive as long as he stands, is not rounded down to 0 while he is on
    the ground: 0 would let him leave it for a tick (docs/mario_engine.md, "Exact arithmetic"). The
    same goes for sprites.
    """

    def body(x: Array, y: Array, xa: Array, ya: Array, on_ground: Array) -> tuple[Array, Array, Array, Array]:
        least = jnp.full_like(ya, 1 / quantum)
        rounded = snapped(ya, quantum)
        stands = on_ground & (ya > 0) & (rounded < least)
        return snapped(x, quantum), snapped(y, quantum), snapped(xa, quantum), lax.select(stands, least, rounded)

    p, s = world.player, world.sprites
    x, y, xa, ya = body(p.x, p.y, p.xa, p.ya, p.on_ground)
    player = p._replace(
        x=x, y=y, xa=xa, ya=ya, x_old=snapped(p.x_old, quantum), y_old=snapped(p.y_old, quantum),
        x_jump_speed=snapped(p.x_jump_speed, quantum), y_jump_speed=p.y_jump_speed,
    )  # fmt: skip
    x, y, xa, ya = body(s.x, s.y, s.xa, s.ya, (s.flags & 1) != 0)
    sprites = s._replace(
        x=x, y=y, xa=xa, ya=ya, x_old=snapped(s.x_old, quantum), y_old=snapped(s.y_old, quantum)
    )  # fmt: skip
    return world._replace(player=player, sprites=sprites)
