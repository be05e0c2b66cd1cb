"""What a learner sees of the game, quantised to the grid of tiles.

* `window`: the tiles around Mario with the sprites painted over them (thesis 4.2.3: 5 x 5). A
  planner that keeps the screen as it is while it looks ahead gives the cell of the window itself.
* `objects`: the moving things as (type, dx, dy) in whole tiles from Mario, with a mask (thesis 4.2.4).
* `own_state`: Mario's size, what he can do and his velocity.

Everything that the competition tells is used and nothing else: dead bodies stay visible until they
are gone. Coordinates are those of the competition's observation: tiles, x to the right and y up.
All functions are pure, for one game.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.numerics import put_row, take
from hrljax.envs.mario.engine.course import Course
from hrljax.envs.mario.engine.state import KIND_NAMES, MAX_SPRITES, WINGED, Player, Sprites, World
from hrljax.envs.mario.levels.tiles import EMPTY, HEIGHT, SYMBOL_EXIT, SYMBOLS, TILE

TILE_CHARACTERS = " $b?|1234567!"
SYMBOL_NAMES = (
    "empty", "coin", "brick", "question block", "pipe", *(f"blocking {i}" for i in range(1, 7)), "solid", "exit",
    *KIND_NAMES[1:],
)  # fmt: skip
"""Names of the symbols in a window, by number: the competition's tiles, the exit, the kinds of sprites."""
NUM_SYMBOLS = len(SYMBOL_NAMES)
SYMBOL_OF_KIND = len(TILE_CHARACTERS) - 1
"""What is added to a sprite's kind (1 to 9) to get its symbol."""
_EXIT = np.int32(TILE_CHARACTERS.index(chr(SYMBOL_EXIT)))
_SYMBOL_OF_TILE = np.array([TILE_CHARACTERS.index(chr(character)) for character in SYMBOLS], np.int32)

NUM_TYPES = len(KIND_NAMES) - 1
REACH = (21, 16)
"""Objects farther than so many tiles in x or y are masked: the screen's width and height."""
NUM_OBJECT_CELLS = NUM_TYPES * (2 * REACH[0] + 1) * (2 * REACH[1] + 1)
"""Distinct (type, dx, dy)."""

VELOCITY_UNIT = 5
"""Displacement in a tick, in pixels, that counts as a velocity of 1, as in the competition's observation."""
MAX_VELOCITY = 4
"""Velocities are cut off there; Mario falls with 3.2 at most."""


class Objects(NamedTuple):
    """The sprites as seen from Mario; each array ``[MAX_SPRITES]``, oldest first."""

    type: Array  # int32, 0 to 8: red koopa, ..., shell (KIND_NAMES without "none")
    winged: Array  # bool
    dx: Array  # int32, tiles to the right of Mario, rounded
    dy: Array  # int32, tiles above Mario, rounded
    mask: Array  # bool: there is such a sprite, and it is within reach


class OwnState(NamedTuple):
    """Mario himself; int32 and bool scalars."""

    size: Array  # 0 small, 1 large, 2 fire
    on_ground: Array
    may_jump: Array
    dx: Array  # velocity to the right, in units of 1 / per_unit
    dy: Array  # velocity upwards


def cell(x: Array, y: Array) -> tuple[Array, Array]:
    """Column and row of the tile that the competition says a thing is in; row 15 lies below the level.

    It holds the point (x, y), the middle of the thing's lower edge in pixels, but a thing that
    stands exactly on the border of two rows is in the upper one.
    """
    column = (x / np.float32(TILE)).astype(jnp.int32)
    return column, np.int32(HEIGHT) - (np.float32(HEIGHT + 1) - y / np.float32(TILE)).astype(jnp.int32)


def window(
    course: Course, world: World, size: int = 5, column: Array | int | None = None, row: Array | int | None = None
) -> Array:
    """The tiles around Mario, or around another cell, with the sprites painted over them.

    Where several sprites are in a cell, the newest is seen. Beyond its left, right and lower end the
    level goes on as it ends there; above it is empty.

    Args:
        course: the levels.
        world: the game.
        size: cells from left to right and from top to bottom, an odd number.
        column: column of the cell in the middle; Mario's if not given (int32).
        row: its row from the top.

    Returns:
        ``[size, size]`` int32, numbers of `SYMBOL_NAMES`, ``[row, column]`` from the top left.

    Raises:
        ValueError: `size` is no odd number of at least 1.
    """
    checks.odd("size", size)
    own_column, own_row = cell(world.player.x, world.player.y)
    left = (own_column if column is None else jnp.asarray(column, jnp.int32)) - np.int32(size // 2)
    top = (own_row if row is None else jnp.asarray(row, jnp.int32)) - np.int32(size // 2)
    return painted(course, world, left, top, size, size)


def painted(course: Course, world: World, left: Array, top: Array, width: int, height: int) -> Array:
    """Any part of the level as `window` shows it.

    Args:
        course: the levels.
        world: the game.
        left: its first column (int32).
        top: its first row.
        width: cells from left to right.
        height: cells from top to bottom.

    Returns:
        ``[height, width]`` int32, numbers of `SYMBOL_NAMES`.
    """
    exit_column = take(jnp.asarray(course.exit_column), world.level)
    tiles = _tile_symbols(world.tiles, exit_column, left, top, width, height, course.num_columns)
    outside = np.int32(width * height)

    def paint(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        i, cells = carry
        sprites = world.sprites
        x, y = cell(take(sprites.x, i), take(sprites.y, i))
        x, y = x - left, y - top
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        place = lax.select(inside, y * np.int32(width) + x, outside)
        return i + 1, put_row(cells, place, (take(sprites.kind, i) + np.int32(SYMBOL_OF_KIND))[None])

    bin_included = jnp.concatenate([tiles, jnp.zeros(1, jnp.int32)])
    _, cells = lax.while_loop(lambda carry: carry[0] < world.num_sprites, paint, (jnp.int32(0), bin_included))
    return cells[: width * height].reshape(height, width)


def _tile_symbols(
    tiles: Array, exit_column: Array, left: Array, top: Array, width: int, height: int, num_columns: int
) -> Array:
    """``[height * width]`` int32: symbols without sprites, row by row."""
    down, right = np.divmod(np.arange(width * height, dtype=np.int32), np.int32(width))
    columns, rows = left + right, top + down
    inside_columns = jnp.clip(columns, 0, num_columns - 1)
    places = inside_columns * np.int32(HEIGHT) + jnp.clip(rows, 0, HEIGHT - 1)
    seen = jnp.where(rows < 0, np.uint8(EMPTY), tiles.at[places].get(mode="promise_in_bounds"))
    symbols = jnp.asarray(_SYMBOL_OF_TILE).at[seen.astype(jnp.int32)].get(mode="promise_in_bounds")
    return jnp.where(columns == exit_column, _EXIT, symbols)


def objects(player: Player, sprites: Sprites, num_sprites: Array) -> Objects:
    """The sprites as (type, dx, dy) in whole tiles from Mario, halves to the even number (thesis 4.2.4)."""
    dx = jnp.round((sprites.x - player.x) / np.float32(TILE)).astype(jnp.int32)
    dy = jnp.round((player.y - sprites.y) / np.float32(TILE)).astype(jnp.int32)
    listed = jnp.arange(MAX_SPRITES, dtype=jnp.int32) < num_sprites
    return Objects(
        type=jnp.where(listed, sprites.kind - 1, 0),
        winged=listed & ((sprites.flags & np.int32(WINGED)) != 0),
        dx=dx,
        dy=dy,
        mask=listed & (jnp.abs(dx) <= REACH[0]) & (jnp.abs(dy) <= REACH[1]),
    )


def object_cells(seen: Objects) -> Array:
    """Each object's number among the `NUM_OBJECT_CELLS` triples (type, dx, dy); 0 where it is masked.

    Returns:
        ``[MAX_SPRITES]`` int32: ``(type * 43 + dx + 21) * 33 + dy + 16``.
    """
    columns, rows = (np.int32(2 * reach + 1) for reach in REACH)
    number = (seen.type * columns + seen.dx + np.int32(REACH[0])) * rows + seen.dy + np.int32(REACH[1])
    return jnp.where(seen.mask, number, 0)


def own_state(player: Player, per_unit: int = 1) -> OwnState:
    """Mario's size, whether he stands and may jump, and his velocity in whole units of 1 / `per_unit`.

    A velocity of 1 is 5 pixels in the last tick. Velocities are rounded, halves to the even number,
    and cut off at `MAX_VELOCITY`.

    Raises:
        ValueError: `per_unit` is no whole number of at least 1.
    """
    checks.integer("per_unit", per_unit, 1)

    def quantised(displacement: Array) -> Array:
        steps = jnp.round(displacement * np.float32(per_unit) / np.float32(VELOCITY_UNIT)).astype(jnp.int32)
        return jnp.clip(steps, -MAX_VELOCITY * per_unit, MAX_VELOCITY * per_unit)

    return OwnState(
        size=player.large.astype(jnp.int32) + (player.large & player.fire).astype(jnp.int32),
        on_ground=player.on_ground,
        may_jump=player.may_jump,
        dx=quantised(player.x - player.x_old),
        dy=quantised(player.y_old - player.y),
    )


def num_own_states(per_unit: int = 1) -> int:
    """Size of the range of `own_number`."""
    return 12 * (2 * MAX_VELOCITY * per_unit + 1) ** 2


def own_number(state: OwnState, per_unit: int = 1) -> Array:
    """A number in ``[0, num_own_states(per_unit))`` for Mario's own state (int32 scalar)."""
    fastest = np.int32(MAX_VELOCITY * per_unit)
    flags = (state.size * 2 + state.on_ground.astype(jnp.int32)) * 2 + state.may_jump.astype(jnp.int32)
    return (flags * (2 * fastest + 1) + state.dx + fastest) * (2 * fastest + 1) + state.dy + fastest
