"""Levels as text that people can read and edit.

A text has a line with the type of the level, 15 lines of tiles, a blank line and 15 lines of
things: monsters and the exit. All 30 lines are of one length, one character a cell. Blank lines and
lines that begin with ``;`` may stand before the tiles.

======= ========================================= ======= ==========================
tiles                                             things
------------------------------------------------- ----------------------------------
``.``   empty                                     ``.``   nothing
``#``   ground                                    ``r``   red koopa
``%``   stair block                               ``g``   green koopa
``[]``  mouth of a pipe: left, right              ``o``   goomba
``{}``  body of a pipe: left, right               ``s``   spiky
``/-\\``  top of a hill: left, middle, right        ``p``   piranha plant (on the left mouth)
``<+>`` top of a hill where it joins another      ``RGOS`` the same with wings
``(:)`` body of a hill: left, middle, right       ``!``   exit, anywhere in its column
``b``   brick
``c``   brick with a coin                         first line
``q``   brick with a power-up                     ----------------------------------
``?``   question block with a coin                ``type: overground``
``Q``   question block with a power-up            ``type: underground``
``$``   coin                                      ``type: castle``
``u``   used block
======= ========================================= ======= ==========================

The ground's edges and corners are not written; they follow from where the ground is
(`hrljax.envs.mario.levels.ground.with_edges`).
"""

import numpy as np

from hrljax.envs.mario.levels.ground import level_type_of, with_edges, without_edges
from hrljax.envs.mario.levels.level import MIN_COLUMNS, PIRANHA, WINGED, Level, check_level
from hrljax.envs.mario.levels.tiles import (
    BRICK,
    BRICK_COIN,
    BRICK_POWER_UP,
    COIN,
    EMPTY,
    GROUND_INTERIOR,
    HEIGHT,
    HILL_BODIES,
    HILL_TOPS,
    HILL_TOPS_JOINED,
    LEVEL_TYPE_NAMES,
    PIPE_BODY,
    PIPE_MOUTH,
    QUESTION_COIN,
    QUESTION_POWER_UP,
    STAIR,
    USED_BLOCK,
)

TILE_CHARACTERS = {
    ".": EMPTY,
    "#": GROUND_INTERIOR,
    "%": STAIR,
    **dict(zip("[]", PIPE_MOUTH, strict=True)),
    **dict(zip("{}", PIPE_BODY, strict=True)),
    **dict(zip("/-\\", HILL_TOPS, strict=True)),
    **dict(zip("<+>", HILL_TOPS_JOINED, strict=True)),
    **dict(zip("(:)", HILL_BODIES, strict=True)),
    "b": BRICK,
    "c": BRICK_COIN,
    "q": BRICK_POWER_UP,
    "?": QUESTION_COIN,
    "Q": QUESTION_POWER_UP,
    "$": COIN,
    "u": USED_BLOCK,
}
_MONSTERS = {letter: kind for kind, letter in enumerate("rgosp", start=1)}
THING_CHARACTERS = {
    ".": 0,
    **_MONSTERS,
    **{letter.upper(): kind + WINGED for letter, kind in _MONSTERS.items() if kind != PIRANHA},
}
EXIT_CHARACTER = "!"
_COMMENT = ";"


class LevelTextError(ValueError):
    """A text that is no level; the message names the row and the column, counted from 1."""

    def __init__(self, row: int, column: int, problem: str):
        super().__init__(f"level text, row {row + 1}, column {column + 1}: {problem}")


def to_ascii(level: Level) -> str:
    """A level as text; `from_ascii` gives the same level back.

    Raises:
        ValueError: `level` does not pass `check_level`, its ground has other edges than follow from
            where the ground is, or its exit column is full of monsters.
    """
    level = check_level(level)
    level_type = level_type_of(level.tiles)
    plain = without_edges(level.tiles)
    odd = np.argwhere(with_edges(plain, level_type) != level.tiles)
    if len(odd):
        column, row = odd[0].tolist()
        raise ValueError(
            f"level.tiles at column {column}, row {row} is {int(level.tiles[column, row]):#04x}, which text cannot "
            f"say: the ground around asks for another edge in a level of type {LEVEL_TYPE_NAMES[level_type]}"
        )
    exit_column = int(level.exit_column)
    free = np.flatnonzero(level.spawns[exit_column] == 0)
    if not len(free):
        raise ValueError(f"level.spawns leaves no room for the exit's mark in column {exit_column}")
    tiles = _written(plain, TILE_CHARACTERS)
    things = _written(level.spawns, THING_CHARACTERS)
    things[exit_column, free[-1]] = EXIT_CHARACTER
    maps = ["\n".join("".join(row) for row in cells.T.tolist()) for cells in (tiles, things)]
    return f"type: {LEVEL_TYPE_NAMES[level_type]}\n{maps[0]}\n\n{maps[1]}\n"


def from_ascii(text: str) -> Level:
    """Reads a level.

    Raises:
        LevelTextError: the first thing that is wrong, with its row and column: no or an unknown
            type, an unknown character, lines of different length, too few or too many lines, a level
            under one screen (20 columns), no exit, two exits, or an exit in the first column.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    first = next((i for i, line in enumerate(lines) if line and not line.startswith(_COMMENT)), len(lines))
    level_type = _read_type(lines, first)
    start = next(
        (i for i in range(first + 1, len(lines)) if lines[i] and not lines[i].startswith(_COMMENT)), len(lines)
    )
    _check_lines(lines, start)
    things_start = start + HEIGHT + 1
    plain = _read(lines, start, TILE_CHARACTERS, "a tile")
    exits = [
        (row, column)
        for row in range(things_start, things_start + HEIGHT)
        for column, character in enumerate(lines[row])
        if character == EXIT_CHARACTER
    ]
    spawns = _read(lines, things_start, {**THING_CHARACTERS, EXIT_CHARACTER: 0}, "a thing")
    if not exits:
        raise LevelTextError(things_start, 0, f"no exit; mark one cell of the things with {EXIT_CHARACTER}")
    if len(exits) > 1:
        raise LevelTextError(*exits[1], f"a second exit {EXIT_CHARACTER}; a level has one")
    if exits[0][1] == 0:
        raise LevelTextError(*exits[0], "the exit is in the first column; it must be right of it")
    return check_level(Level(with_edges(plain, level_type), spawns, np.int32(exits[0][1])))


def _written(cells: np.ndarray, characters: dict[str, int]) -> np.ndarray:
    table = np.full(256, "\0", "<U1")
    for character, value in characters.items():
        table[value] = character
    return table[cells]


def _read_type(lines: list[str], row: int) -> int:
    names = ", ".join(LEVEL_TYPE_NAMES)
    word, _, name = lines[row].partition(":") if row < len(lines) else ("", "", "")
    if word.strip() != "type":
        raise LevelTextError(row, 0, f"no type; the first line is 'type: NAME' with a name of {names}")
    if name.strip() not in LEVEL_TYPE_NAMES:
        column = lines[row].index(":") + 1 + len(name) - len(name.lstrip())
        raise LevelTextError(row, column, f"unknown type {name.strip()!r}; known are {names}")
    return LEVEL_TYPE_NAMES.index(name.strip())


def _check_lines(lines: list[str], start: int) -> None:
    """Checks the shape: 15 lines, a blank one, 15 lines, all of one length."""
    shape = f"a level has {HEIGHT} lines of tiles, a blank line and {HEIGHT} lines of things"
    width = len(lines[start]) if start < len(lines) else 0
    for offset in range(2 * HEIGHT + 1):
        row = start + offset
        if row >= len(lines):
            raise LevelTextError(row, 0, f"the text ends here; {shape}")
        length = len(lines[row])
        if offset == HEIGHT:
            if length:
                raise LevelTextError(row, 0, f"a blank line must stand here; {shape}")
        elif not length:
            raise LevelTextError(row, 0, f"a blank line; {shape}")
        elif length != width:
            raise LevelTextError(row, min(length, width), f"{length} characters; the first line of tiles has {width}")
    if len(lines) > start + 2 * HEIGHT + 1:
        raise LevelTextError(start + 2 * HEIGHT + 1, 0, f"a line too many; {shape}")
    if width < MIN_COLUMNS:
        raise LevelTextError(start, width, f"{width} columns; a level has at least one screen, {MIN_COLUMNS}")


def _read(lines: list[str], start: int, characters: dict[str, int], what: str) -> np.ndarray:
    """``[W, 15]`` uint8 of the 15 lines from `start`."""
    for row in range(start, start + HEIGHT):
        for column, character in enumerate(lines[row]):
            if character not in characters:
                known = " ".join(characters)
                raise LevelTextError(row, column, f"unknown character {character!r}; {what} is one of {known}")
    return np.array([[characters[c] for c in line] for line in lines[start : start + HEIGHT]], np.uint8).T.copy()
