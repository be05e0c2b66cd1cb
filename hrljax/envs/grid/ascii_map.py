"""What maps that are drawn as text have in common: lines, boxes, walls, and errors that name the place.

A *boxed* map draws a cell as three characters with room for a wall on each side::

    +---+---+
    | a   b |     cells are three characters wide; between two of them stands a wall (| or ---),
    +   +---+     a passage (blank) or something with a name (a capital letter);
    | c   d |     corners are + or blank, the border is wall
    +---+---+

Cells are numbered row by row.
"""

from itertools import dropwhile
from typing import NamedTuple

import numpy as np

MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""(row, column) steps of the moves north, east, south, west."""

WALL, FREE = -1, 0


class MapError(ValueError):
    """A map that cannot be read; the message names the line and the column, counted from 1."""

    def __init__(self, line: int, column: int, problem: str):
        super().__init__(f"map, row {line + 1}, column {column + 1}: {problem}")


class Boxes(NamedTuple):
    """The text of a boxed map, its size and corners checked."""

    lines: tuple[str, ...]

    @property
    def height(self) -> int:
        return len(self.lines) // 2

    @property
    def width(self) -> int:
        return len(self.lines[0]) // 4

    def place(self, cell: int) -> tuple[int, int]:
        """Line and column of the first of a cell's three characters."""
        return 2 * (cell // self.width) + 1, 4 * (cell % self.width) + 1

    def cell(self, cell: int) -> str:
        """The three characters of a cell."""
        line, column = self.place(cell)
        return self.lines[line][column : column + 3]


def text_lines(text: str) -> tuple[str, ...]:
    """The lines of a map without blanks at their ends, and without blank lines before the first and after the last."""
    lines = [line.rstrip() for line in text.rstrip().splitlines()]
    return tuple(dropwhile(lambda line: not line, lines))


def check_rectangle(lines: tuple[str, ...]) -> None:
    """Raises MapError where a line is not as long as the first."""
    length = len(lines[0])
    for number, line in enumerate(lines):
        if len(line) != length:
            problem = f"wrong size: {len(line)} characters; the first line has {length}"
            raise MapError(number, min(len(line), length), problem)


def read_boxes(text: str) -> Boxes:
    """Checks the size and the corners of a boxed map; raises MapError."""
    lines = text_lines(text)
    if len(lines) < 3 or len(lines) % 2 == 0:
        raise MapError(max(len(lines) - 1, 0), 0, f"wrong size: {len(lines)} lines; a map of h rows has 2 h + 1")
    length = len(lines[0])
    if length < 5 or length % 4 != 1:
        raise MapError(0, max(length - 1, 0), f"wrong size: {length} characters; a map of w columns has 4 w + 1")
    check_rectangle(lines)
    for number in range(0, len(lines), 2):
        for column in range(0, length, 4):
            if lines[number][column] not in "+ ":
                problem = f"unknown character {lines[number][column]!r}; a corner is + or blank"
                raise MapError(number, column, problem)
    return Boxes(lines)


def read_edges(boxes: Boxes) -> tuple[np.ndarray, tuple[str, ...]]:
    """What stands on the four sides of every cell of a boxed map; raises MapError.

    Returns:
        ``[cells, 4]`` int32 in the order of `MOVES`: WALL, FREE or i for the i-th name (from 1); the names, sorted.
    """
    height, width = boxes.height, boxes.width
    names: list[str] = []
    edge = np.full((height * width, 4), WALL, np.int32)
    for cell in range(height * width):
        for move, (down, right) in enumerate(MOVES):
            line, column = boxes.place(cell)
            line, column = line + down, column + 1 + 2 * right
            edge[cell, move] = _edge(boxes.lines, line, column, vertical=right != 0, names=names)
            outside = not (0 <= cell // width + down < height and 0 <= cell % width + right < width)
            if outside and edge[cell, move] != WALL:
                raise MapError(line, column, "an opening in the border; the border is wall")
    renumber = np.array([FREE, *(sorted(names).index(name) + 1 for name in names)], np.int32)
    return np.where(edge > 0, renumber[np.maximum(edge, 0)], edge).astype(np.int32), tuple(sorted(names))


def _edge(lines: tuple[str, ...], line: int, column: int, vertical: bool, names: list[str]) -> int:
    """What stands between two cells: a wall, a free passage, or the number of a name (from 1)."""
    text = lines[line][column] if vertical else lines[line][column - 1 : column + 2]
    if text == ("|" if vertical else "---"):
        return WALL
    name = text.strip(" ")
    if not name:
        return FREE
    if len(name) > 1 or not (name.isascii() and name.isupper()) or (not vertical and text[1] != name):
        allowed = "|, a blank or a capital letter" if vertical else "---, blanks or a capital letter in the middle"
        at = column - (not vertical)
        raise MapError(line, at, f"unknown characters {text!r}; between two cells stands {allowed}")
    if name not in names:
        names.append(name)
    return names.index(name) + 1


def neighbours(is_wall: np.ndarray, width: int) -> np.ndarray:
    """``[cells, 4]`` int32: the cell that each of the `MOVES` reaches, itself at a wall (``[cells, 4]`` bool)."""
    cells = np.arange(len(is_wall), dtype=np.int32)[:, None]
    offsets = np.array([down * width + right for down, right in MOVES], np.int32)
    return np.where(is_wall, cells, cells + offsets).astype(np.int32)


def reached(neighbour: np.ndarray, start: np.ndarray, stops: np.ndarray | None = None) -> np.ndarray:
    """``[cells]`` bool: cells that moves lead to from the cells `start` (bool), themselves included.

    Args:
        neighbour: ``[cells, 4]``.
        start: ``[cells]`` bool.
        stops: ``[cells]`` bool, cells that are reached but not left; none if None.
    """
    inside, before = start.copy(), np.zeros_like(start)
    while (inside != before).any():
        before = inside.copy()
        inside[neighbour[before if stops is None else before & ~stops]] = True
    return inside
