"""The look of the ground: edges, corners and inside follow from where there is ground."""

import numpy as np

from hrljax.envs.mario.levels.tiles import GROUND_INTERIOR, GROUND_OFFSETS, LEVEL_TYPES, ground_tiles

_EDGES = {
    "1111": 0x91, "0011": 0x81, "1100": 0xA1, "0101": 0x90, "1010": 0x92, "1001": 0x91, "0110": 0x91,
    "0001": 0x80, "0010": 0x82, "0100": 0xA0, "1000": 0xA2,
    "0111": 0x83, "1011": 0x93, "1110": 0xA3, "1101": 0xB3,
}  # fmt: skip
"""Overground byte by which corners of the tile lie inside the ground: NW, NE, SW, SE."""
_EDGE_TABLE = np.array([_EDGES.get(f"{corners:04b}", 0) for corners in range(16)], np.uint8)


def with_edges(tiles: np.ndarray, level_type: int) -> np.ndarray:
    """Replaces plain ground by edges, corners and inside in the look of a type of level.

    A corner of the grid lies inside the ground if the four tiles around it are ground; beyond the
    border the level goes on as it ends there. Ground without such a corner stays plain.

    Args:
        tiles: ``[W, 15]`` uint8, ground as ``GROUND_INTERIOR``.
        level_type: 0 overground, 1 underground, 2 castle.
    """
    ground = np.pad(tiles == GROUND_INTERIOR, 1, mode="edge")
    inside = ground[:-1, :-1] & ground[1:, :-1] & ground[:-1, 1:] & ground[1:, 1:]  # [W + 1, 16] grid points
    corners = 8 * inside[:-1, :-1] + 4 * inside[1:, :-1] + 2 * inside[:-1, 1:] + inside[1:, 1:]
    return np.where(corners > 0, _EDGE_TABLE[corners] + np.uint8(GROUND_OFFSETS[level_type]), tiles)


def without_edges(tiles: np.ndarray) -> np.ndarray:
    """The inverse of `with_edges`: all ground of all looks becomes ``GROUND_INTERIOR``."""
    looks = [tile for offset in GROUND_OFFSETS for tile in ground_tiles(offset)]
    return np.where(np.isin(tiles, looks), np.uint8(GROUND_INTERIOR), tiles)


def level_type_of(tiles: np.ndarray) -> int:
    """The type of level (0, 1 or 2) whose look most of the ground has; 0 without any ground.

    Plain ground is left out: it stands in levels of every type.
    """
    votes = [
        np.isin(tiles, [tile for tile in ground_tiles(GROUND_OFFSETS[kind]) if tile != GROUND_INTERIOR]).sum()
        for kind in LEVEL_TYPES
    ]
    return int(np.argmax(votes))
