"""A level: its tiles, where monsters appear and where it ends."""

from typing import NamedTuple

import numpy as np

from hrljax.envs.mario.levels.tiles import EMPTY, HEIGHT, TILE, TILES

SCREEN_WIDTH = 320
"""Pixels of a screen from left to right."""
MIN_COLUMNS = SCREEN_WIDTH // TILE
"""Columns of the narrowest level: one screen."""
MONSTERS = ("red koopa", "green koopa", "goomba", "spiky", "piranha")
"""Kinds of monster; kind k of `Level.spawns` is ``MONSTERS[k - 1]``."""
RED_KOOPA, GREEN_KOOPA, GOOMBA, SPIKY, PIRANHA = range(1, 6)
WINGED = 16
KIND_MASK = 15
SPAWNS = (0, *range(RED_KOOPA, PIRANHA + 1), *range(RED_KOOPA + WINGED, PIRANHA + WINGED))
"""What a cell of `Level.spawns` can hold; plants have no wings."""


class Level(NamedTuple):
    """One level of `W` columns, or a batch of them with leading axes.

    Arrays are addressed ``[x, y]`` with y = 0 at the top, in tiles of 16 x 16 pixels.
    """

    tiles: np.ndarray  # [W, 15] uint8: tile bytes (hrljax.envs.mario.levels.tiles)
    spawns: np.ndarray  # [W, 15] uint8: 0 nothing, else the kind of monster in the low 4 bits, + 16 winged
    exit_column: np.ndarray | np.int32 | int  # int32 scalar: Mario wins to the right of this column's left border

    @property
    def num_columns(self) -> int:
        """Columns of tiles."""
        return self.tiles.shape[-2]

    @property
    def exit_row(self) -> int:
        """Top row of the ground at the exit (15 over a pit); of one level, not of a batch."""
        solid = np.asarray(self.tiles)[int(self.exit_column)] != EMPTY
        return HEIGHT - int(np.argmin(np.append(solid[::-1], False)))


def check_level(level: Level) -> Level:
    """The level with its arrays in the types that `Level` promises, after checking it.

    Args:
        level: one level (no leading axes).

    Raises:
        ValueError: an array has another shape or type, a tile or a monster is unknown (the message names its
            column and row), or the exit lies outside.
    """
    tiles, spawns = np.asarray(level.tiles), np.asarray(level.spawns)
    if tiles.ndim != 2 or tiles.shape[1] != HEIGHT or tiles.shape[0] < MIN_COLUMNS:
        raise ValueError(f"level.tiles must have shape [W >= {MIN_COLUMNS}, {HEIGHT}], got {list(tiles.shape)}")
    if spawns.shape != tiles.shape:
        raise ValueError(f"level.spawns must have the shape of tiles, {list(tiles.shape)}, got {list(spawns.shape)}")
    for name, array in (("tiles", tiles), ("spawns", spawns)):
        if not np.issubdtype(array.dtype, np.integer):
            raise ValueError(f"level.{name} must hold integers, got {array.dtype}")
    _check_cells("tiles", tiles, np.isin(tiles, TILES), "a tile byte of hrljax.envs.mario.levels.tiles.TILES")
    _check_cells("spawns", spawns, np.isin(spawns, SPAWNS), f"one of {SPAWNS}: a kind, + {WINGED} with wings")
    exit_column = int(level.exit_column)
    if not 0 < exit_column < len(tiles):
        raise ValueError(f"level.exit_column must lie in 1..{len(tiles) - 1}, got {exit_column}")
    return Level(tiles.astype(np.uint8), spawns.astype(np.uint8), np.int32(exit_column))


def _check_cells(name: str, array: np.ndarray, good: np.ndarray, allowed: str) -> None:
    if not good.all():
        column, row = np.argwhere(~good)[0].tolist()
        raise ValueError(
            f"level.{name} at column {column}, row {row} is {int(array[column, row]):#04x}; it must be {allowed}"
        )


def stack_levels(levels: list[Level]) -> Level:
    """Levels of one width as one `Level` with a leading axis.

    Raises:
        ValueError: no levels, or levels of different widths.
    """
    widths = sorted({level.num_columns for level in levels})
    if len(widths) != 1:
        raise ValueError(f"levels must be of one width and at least one, got {len(levels)} levels of widths {widths}")
    return Level(
        np.stack([level.tiles for level in levels]),
        np.stack([level.spawns for level in levels]),
        np.array([level.exit_column for level in levels], np.int32),
    )
