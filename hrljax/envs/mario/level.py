"""A level: its tiles, where monsters appear and where it ends."""

from typing import NamedTuple

import numpy as np

from hrljax.envs.mario.tiles import HEIGHT, TILE, TILES

SCREEN_WIDTH = 320
"""Pixels of a screen from left to right."""
MONSTERS = ("red koopa", "green koopa", "goomba", "spiky", "piranha")
"""Kinds of monster; kind k of `Level.spawns` is ``MONSTERS[k - 1]``."""
RED_KOOPA, GREEN_KOOPA, GOOMBA, SPIKY, PIRANHA = range(1, 6)
WINGED = 16
KIND_MASK = 15


class Level(NamedTuple):
    """One level of `W` columns, or a batch of them with leading axes.

    Arrays are addressed ``[x, y]`` with y = 0 at the top, in tiles of 16 x 16 pixels.
    """

    tiles: np.ndarray  # [W, 15] uint8: tile bytes (hrljax.envs.mario.tiles)
    spawns: np.ndarray  # [W, 15] uint8: 0 nothing, else the kind of monster in the low 4 bits, + 16 winged
    exit_column: np.ndarray | np.int32 | int  # int32 scalar: Mario wins to the right of this column's left border

    @property
    def num_columns(self) -> int:
        """Columns of tiles."""
        return self.tiles.shape[-2]


def check_level(level: Level) -> Level:
    """The level with its arrays in the types that `Level` promises, after checking it.

    Args:
        level: one level (no leading axes).

    Raises:
        ValueError: an array has another shape, a tile or a monster is unknown, monsters stand in the
            wrong way (a winged piranha), or the exit lies outside; names the column and row.
    """
    tiles, spawns = np.asarray(level.tiles), np.asarray(level.spawns)
    fewest = SCREEN_WIDTH // TILE
    if tiles.ndim != 2 or tiles.shape[1] != HEIGHT or tiles.shape[0] < fewest:
        raise ValueError(f"level.tiles must have shape [W >= {fewest}, {HEIGHT}], got {list(tiles.shape)}")
    if spawns.shape != tiles.shape:
        raise ValueError(f"level.spawns must have the shape of tiles, {list(tiles.shape)}, got {list(spawns.shape)}")
    for name, array in (("tiles", tiles), ("spawns", spawns)):
        if not np.issubdtype(array.dtype, np.integer):
            raise ValueError(f"level.{name} must hold integers, got {array.dtype}")
    _check_cells("tiles", tiles, np.isin(tiles, TILES), "a tile byte of hrljax.envs.mario.tiles.TILES")
    kind, wings = spawns & KIND_MASK, spawns & ~KIND_MASK
    known = (spawns == 0) | ((kind >= RED_KOOPA) & (kind <= PIRANHA) & ((wings == 0) | (wings == WINGED)))
    _check_cells("spawns", spawns, known, f"0, a kind 1..{len(MONSTERS)}, or that + {WINGED} for a winged one")
    _check_cells("spawns", spawns, spawns != PIRANHA + WINGED, "no winged piranha")
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
