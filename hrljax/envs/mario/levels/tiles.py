"""Tile bytes of the platformer: their names, how they behave and how the competition draws them.

Their table is in docs/mario_engine.md, "Tiles".

A level is an array of tile bytes. Ground comes in three looks, one for each type of level; their
bytes differ by `GROUND_OFFSETS`. The second hexadecimal digit of a ground or hill tile is its place
from left to right, the first its place from top to bottom.
"""

import numpy as np

TILE = 16
"""Width and height of a tile in pixels."""
HEIGHT = 15
"""Rows of tiles of a level."""

EMPTY = 0x00
USED_BLOCK = 0x04
STAIR = 0x09
PIPE_MOUTH = (0x0A, 0x0B)
PIPE_BODY = (0x1A, 0x1B)
BRICK = 0x10
BRICK_COIN = 0x11
BRICK_POWER_UP = 0x12
QUESTION_COIN = 0x15
QUESTION_POWER_UP = 0x16
COIN = 0x22

OVERGROUND, UNDERGROUND, CASTLE = LEVEL_TYPES = range(3)
LEVEL_TYPE_NAMES = ("overground", "underground", "castle")
GROUND_OFFSETS = (0, 12, 8)
"""What is added to an overground ground byte in levels of each type."""
GROUND_EDGES = (0x80, 0x81, 0x82, 0x90, 0x92, 0xA0, 0xA1, 0xA2)
GROUND_INTERIOR = 0x91
GROUND_INNER_CORNERS = (0x83, 0x93, 0xA3, 0xB3)

HILL_TOPS = (0x84, 0x85, 0x86)
HILL_TOPS_JOINED = (0xB4, 0xB5, 0xB6)
HILL_BODIES = (0x94, 0x95, 0x96)

BLOCKS_FALLING = 1
"""One-way platform: blocks what moves down onto it."""
BLOCKS = 2
BLOCKS_RISING = 4
"""Blocks what moves up into it; no tile has this bit."""
SPECIAL = 8
"""Holds a power-up."""
BUMPABLE = 16
"""Turns into a used block when it is hit from below."""
BREAKABLE = 32
PICK_UP = 64
ANIMATED = 128
"""Cosmetic, no rule reads it."""


def ground_tiles(offset: int) -> tuple[int, ...]:
    """All ground bytes of one look: edges, interior and inner corners."""
    return tuple(tile + offset for tile in (*GROUND_EDGES, GROUND_INTERIOR, *GROUND_INNER_CORNERS))


def _behaviors() -> np.ndarray:
    table = np.zeros(256, np.uint8)
    table[[STAIR, *PIPE_MOUTH, *PIPE_BODY]] = BLOCKS
    table[USED_BLOCK] = BLOCKS | ANIMATED
    table[BRICK] = BLOCKS | BREAKABLE | ANIMATED
    table[[BRICK_COIN, QUESTION_COIN]] = BLOCKS | BUMPABLE | ANIMATED
    table[[BRICK_POWER_UP, QUESTION_POWER_UP]] = BLOCKS | SPECIAL | BUMPABLE | ANIMATED
    table[COIN] = PICK_UP | ANIMATED
    table[[*HILL_TOPS, *HILL_TOPS_JOINED]] = BLOCKS_FALLING
    for offset in GROUND_OFFSETS:
        table[[tile + offset for tile in GROUND_EDGES]] = BLOCKS
    # Overground, and only there, the inside of the ground stops nothing.
    table[[GROUND_INTERIOR + offset for offset in GROUND_OFFSETS if offset]] = BLOCKS
    table.setflags(write=False)
    return table


BEHAVIORS = _behaviors()
"""[256] uint8: the sum of the bits above for every tile byte; unknown bytes behave like nothing."""

TILES = tuple(
    sorted(
        {
            *(EMPTY, USED_BLOCK, STAIR, *PIPE_MOUTH, *PIPE_BODY),
            *(BRICK, BRICK_COIN, BRICK_POWER_UP, QUESTION_COIN, QUESTION_POWER_UP, COIN),
            *(*HILL_TOPS, *HILL_TOPS_JOINED, *HILL_BODIES),
            *(tile for offset in GROUND_OFFSETS for tile in ground_tiles(offset)),
        }
    )
)
"""Every byte that a generated level can hold or that arises in play, in ascending order."""


def _symbols() -> np.ndarray:
    one_way = (BEHAVIORS & BLOCKS_FALLING > 0) * 1 + (BEHAVIORS & BLOCKS_RISING > 0) * 2
    digit = np.where(BEHAVIORS & BLOCKS > 0, 7, one_way)
    table = np.where(digit == 0, ord(" "), ord("0") + digit).astype(np.uint8)
    table[COIN] = ord("$")
    table[[BRICK, BRICK_COIN]] = ord("b")
    table[[QUESTION_COIN, QUESTION_POWER_UP]] = ord("?")
    table[[*PIPE_MOUTH, *PIPE_BODY]] = ord("|")
    table.setflags(write=False)
    return table


SYMBOLS = _symbols()
"""[256] uint8: the character (ASCII) of each tile byte in the competition's observation."""
SYMBOL_MARIO = ord("M")
SYMBOL_EXIT = ord("!")
