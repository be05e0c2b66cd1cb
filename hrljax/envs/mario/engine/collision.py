"""How things meet tiles: what blocks, and moving in pieces of at most 8 pixels.

The rules are in docs/mario_engine.md, "Moving and collision".

A move probes the tiles at some points of the box that it would take the thing to. A probe of the
cell in which the thing's foot point lies already is free.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.numerics import put_row, stage, take
from hrljax.envs.mario.engine.arithmetic import is_positive, tile_of, truncated
from hrljax.envs.mario.levels.tiles import BEHAVIORS, BLOCKS, BLOCKS_FALLING, BLOCKS_RISING, EMPTY, HEIGHT, PICK_UP

_PIECE = 8
_COINS_SHIFT = 4


class Cell(NamedTuple):
    """A place in the grid of tiles, perhaps outside of the level; int32 scalars."""

    column: Array
    row: Array


class Shape(NamedTuple):
    """Box of a thing, float32 scalars: from x - half_width to x + half_width and from y - height to y."""

    half_width: Array | np.float32
    height: Array
    middle: Array  # height of the middle probe: height div 2


def cell_index(cell: Cell, num_cells: int) -> Array:
    """Index into `World.tiles`; columns and rows outside are moved to the nearest one inside."""
    column = lax.clamp(jnp.int32(0), cell.column, jnp.int32(num_cells // HEIGHT - 1))
    return column * np.int32(HEIGHT) + lax.clamp(jnp.int32(0), cell.row, jnp.int32(HEIGHT - 1))


def tile_at(tiles: Array, cell: Cell) -> Array:
    """The tile byte (uint8) that counts as lying in a cell: empty above the level."""
    tile = take(tiles, cell_index(cell, tiles.shape[0]))
    return lax.select(cell.row < 0, jnp.uint8(EMPTY), tile)


def behavior(tile: Array) -> Array:
    """Behaviour bits (`hrljax.envs.mario.levels.tiles`) of a tile byte, int32."""
    return take(jnp.asarray(BEHAVIORS), tile.astype(jnp.int32)).astype(jnp.int32)


def put_tile(tiles: Array, index: Array, tile: Array) -> Array:
    """`tiles` with one byte changed."""
    return put_row(tiles, index, tile[None])


class Purse(NamedTuple):
    """What Mario's moves change besides himself."""

    tiles: Array  # `World.tiles`
    coins: Array  # int32


class Outcome(NamedTuple):
    """Of a move along one axis."""

    position: Array  # float32: the coordinate after the last piece that was not blocked
    piece: Array  # float32: the last piece that was tried
    blocked: Array  # bool
    all_blocked: Array  # bool: all three probes of the last horizontal piece were


def _piece(rest: Array) -> Array:
    long = lax.abs(rest) > np.float32(_PIECE)
    return lax.select(long, lax.select(rest > 0, jnp.float32(_PIECE), jnp.float32(-_PIECE)), rest)


def _is_zero(value: Array) -> Array:
    """``value == 0``, false of subnormal numbers."""
    return (lax.bitcast_convert_type(value, jnp.uint32) << np.uint32(1)) == 0


def probes_across(x: Array, y: Array, dx: Array, shape: Shape) -> tuple[Cell, Cell, Cell]:
    """The cells that a horizontal piece probes: at the leading side, from the top down."""
    column = _leading_column(x, dx, shape)
    heights = (y - shape.height, y - shape.middle, y)
    return tuple(Cell(column, tile_of(height)) for height in heights)  # type: ignore[return-value]


def _leading_column(x: Array, dx: Array, shape: Shape) -> Array:
    near = x + dx
    side = jnp.float32(shape.half_width)
    return tile_of(lax.select(dx > 0, near + side, near - side))


def probes_along(x: Array, y: Array, dy: Array, shape: Shape) -> tuple[Cell, Cell, Cell, Cell]:
    """The cells that a vertical piece probes, in order; the last one only counts in going down."""
    down = is_positive(dy)
    near = y + dy
    left, right = tile_of(x - shape.half_width), tile_of(x + shape.half_width)
    row = tile_of(lax.select(down, near, near - shape.height))
    below = lax.select(down, tile_of(near + np.float32(1)), row)
    first = lax.select(down, left, tile_of(x))
    second = lax.select(down, right, left)
    third = lax.select(down, left, right)
    return Cell(first, row), Cell(second, row), Cell(third, below), Cell(lax.select(down, right, left), below)


def _same(a: Cell, b: Cell) -> Array:
    return (a.column == b.column) & (a.row == b.row)


@stage
def _look_across(tiles: Array, x: Array, y: Array, dx: Array, shape: Shape, avoids_cliffs: Array) -> Array:
    """Bits 0 to 2: blocked probes, bit 3: a cliff ahead; from bit 4 on: probes that meet something to pick up."""
    current = Cell(tile_of(x), tile_of(y))
    result = jnp.int32(0)
    for i, cell in enumerate(probes_across(x, y, dx, shape)):
        bits = behavior(tile_at(tiles, cell))
        bits = lax.select(_same(cell, current), jnp.int32(0), bits)
        result = result | (_flag(bits, BLOCKS) << np.int32(i)) | (_flag(bits, PICK_UP) << np.int32(_COINS_SHIFT + i))
    foot = Cell(_leading_column(x, dx, shape), truncated(y * np.float32(1 / 16) + np.float32(1)))
    floor = _flag(behavior(tile_at(tiles, foot)), BLOCKS | BLOCKS_FALLING)
    cliff = (floor == 0) & avoids_cliffs
    return result | (cliff.astype(jnp.int32) << np.int32(3))


@stage
def _look_along(tiles: Array, x: Array, y: Array, dy: Array, shape: Shape) -> Array:
    """Bits 0 to 3: the first blocked probe, bits from 4 on: probes up to it that meet something to pick up."""
    current = Cell(tile_of(x), tile_of(y))
    cells, down = probes_along(x, y, dy, shape), is_positive(dy)
    sides = lax.select(down, jnp.int32(BLOCKS), jnp.int32(BLOCKS | BLOCKS_RISING))
    lower = lax.select(down, jnp.int32(BLOCKS | BLOCKS_FALLING), jnp.int32(BLOCKS | BLOCKS_RISING))
    result = jnp.int32(0)
    for i, (cell, blocking) in enumerate(zip(cells, (sides, sides, lower, lower), strict=True)):
        bits = behavior(tile_at(tiles, cell))
        free = _same(cell, current) | ((result & np.int32(0xF)) != 0)
        bits = lax.select(free, jnp.int32(0), bits)
        hit = ((bits & blocking) != 0).astype(jnp.int32)
        result = result | (hit << np.int32(i)) | (_flag(bits, PICK_UP) << np.int32(_COINS_SHIFT + i))
    return result


def _flag(bits: Array, mask: int) -> Array:
    """1 if a bit of `mask` is set, else 0 (int32)."""
    return ((bits & np.int32(mask)) != 0).astype(jnp.int32)


def _collect(purse: Purse, cells: tuple[Cell, ...], which: Array) -> Purse:
    """Picks up what lies in those of `cells` whose bit in `which` is set, once each."""

    def one_round(carry: tuple[Array, Purse]) -> tuple[Array, Purse]:
        which, (tiles, coins) = carry
        for i, cell in enumerate(cells):
            tile = tile_at(tiles, cell)
            picked = (((which >> np.int32(i)) & 1) == 1) & (_flag(behavior(tile), PICK_UP) == 1)
            tiles, coins = clear_if(picked, tiles, cell), coins + picked.astype(jnp.int32)
        return jnp.int32(0), Purse(tiles, coins)

    return lax.while_loop(lambda carry: carry[0] != 0, one_round, (which, purse))[1]


def clear_if(condition: Array, tiles: Array, cell: Cell) -> Array:
    """`tiles` with a cell emptied if `condition` holds."""
    index = cell_index(cell, tiles.shape[0])
    return put_tile(tiles, index, lax.select(condition, jnp.uint8(EMPTY), take(tiles, index)))


def move_across(
    purse: Purse,
    x: Array,
    y: Array,
    dx: Array,
    shape: Shape,
    avoids_cliffs: Array | None = None,
    collects: bool = False,
) -> tuple[Purse, Outcome]:
    """Moves a thing horizontally.

    Args:
        purse: the tiles, and the coins counted so far.
        x, y, dx: float32 scalars.
        shape: its box.
        avoids_cliffs: does not step where there is no floor (bool).
        collects: picks up what the probes meet.
    """
    careful = jnp.bool_(False) if avoids_cliffs is None else avoids_cliffs

    def look(tiles: Array, x: Array, dx: Array) -> Array:
        return _look_across(tiles, x, y, dx, shape, careful)

    def cells(x: Array, dx: Array) -> tuple[Cell, ...]:
        return probes_across(x, y, dx, shape)

    return _move(purse, x, dx, look, cells if collects else None)


def move_along(
    purse: Purse, x: Array, y: Array, dy: Array, shape: Shape, collects: bool = False
) -> tuple[Purse, Outcome]:
    """Moves a thing vertically; arguments as of `move_across`."""

    def look(tiles: Array, y: Array, dy: Array) -> Array:
        return _look_along(tiles, x, y, dy, shape)

    def cells(y: Array, dy: Array) -> tuple[Cell, ...]:
        return probes_along(x, y, dy, shape)

    return _move(purse, y, dy, look, cells if collects else None)


def _move(
    purse: Purse,
    position: Array,
    distance: Array,
    look: Callable[[Array, Array, Array], Array],
    cells: Callable[[Array, Array], tuple[Cell, ...]] | None,
) -> tuple[Purse, Outcome]:
    def advance(carry: tuple[Purse, Array, Array, Array, Array]) -> tuple[Purse, Array, Array, Array, Array]:
        purse, position, rest, _, _ = carry
        piece = _piece(rest)
        seen = look(purse.tiles, position, piece)
        if cells is not None:
            purse = _collect(purse, cells(position, piece), seen >> np.int32(_COINS_SHIFT))
        blocked = (seen & np.int32(0xF)) != 0
        rest = lax.select(blocked, jnp.float32(0), rest - piece)
        return purse, lax.select(blocked, position, position + piece), rest, piece, seen

    start = (purse, position, distance, jnp.float32(0), jnp.int32(0))
    purse, position, _, piece, seen = lax.while_loop(lambda carry: ~_is_zero(carry[2]), advance, start)
    blocked = (seen & np.int32(0xF)) != 0
    return purse, Outcome(position, piece, blocked, (seen & np.int32(7)) == 7)


def bumped_cell(x: Array, y: Array, dy: Array, shape: Shape, tiles: Array) -> Cell:
    """The cell against which a rising piece ran: that of its first blocked probe.

    Args:
        x, y: the position before that piece.
        dy: the piece (negative).
        shape: the box.
        tiles: `World.tiles`.
    """
    seen = _look_along(tiles, x, y, dy, shape)
    first, second, third, _ = probes_along(x, y, dy, shape)
    column = lax.select((seen & 1) != 0, first.column, lax.select((seen & 2) != 0, second.column, third.column))
    return Cell(column, first.row)


def wall_position(x: Array, dx: Array, half_width: Array | np.float32) -> Array:
    """Where a thing blocked in moving by `dx` from `x` comes to stand."""
    side = jnp.float32(half_width)
    left = _pixels(tile_of(x - side)) + side
    right = _pixels(truncated((x + side) * np.float32(1 / 16) + np.float32(1))) - side - np.float32(1)
    return lax.select(dx < 0, left, right)


def ceiling_position(y: Array, height: Array) -> Array:
    """Where a thing blocked in rising from `y` comes to hang."""
    return _pixels(tile_of(y - height)) + height


def floor_position(y: Array) -> Array:
    """Where a thing blocked in falling from `y` comes to stand (for Mario, of ``y - 1``)."""
    return _pixels(truncated(y * np.float32(1 / 16) + np.float32(1))) - np.float32(1)


def _pixels(tiles: Array) -> Array:
    return tiles.astype(jnp.float32) * np.float32(16)
