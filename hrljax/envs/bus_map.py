"""Maps of the Bus domain, read from text."""

from collections import deque
from typing import NamedTuple

import numpy as np

KAO_V1 = """\
+---+---+---+---+---+---+
| 1   1   1 | 2   2   2 |
+           +           +
| 1   1   1   2   2   2P|
+---+---+   +---+---+   +
| 3   3   3 A 4   4P  4 |
+           +           +
| 3   3S  3 | 4   4   4 |
+   +---+---+---+---+ B +
| 5   5   5 | 6   6P  6 |
+           +           +
| 5   5   5   6   6   6 |
+---+---+---+---+---+---+
"""
"""The 6 x 6 map of six areas that the experiments use."""

_FREE, _WALL = 0, -1
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""(row, column) steps of the actions north, east, south, west."""


class MapError(ValueError):
    """A map that cannot be read; the message names the line and the column, counted from 1."""

    def __init__(self, line: int, column: int, problem: str):
        super().__init__(f"map, row {line + 1}, column {column + 1}: {problem}")


class BusMap(NamedTuple):
    """What the text says, as arrays. Cells are numbered row by row; areas and sites from 0."""

    height: int
    width: int
    neighbour: np.ndarray  # [cells, 4] int32: the cell that a move reaches (itself at a wall)
    site: np.ndarray  # [cells, 4] int32: the construction site that a move crosses, 1.. (0: none)
    area: np.ndarray  # [cells] int32
    passengers: tuple[int, ...]  # cells, in reading order
    start: int
    area_names: tuple[str, ...]
    site_names: tuple[str, ...]

    @property
    def num_cells(self) -> int:
        return self.height * self.width

    def adjacent_areas(self) -> np.ndarray:
        """``[areas, areas]`` bool: a move leads from one area into the other."""
        count = len(self.area_names)
        adjacent = np.zeros((count, count), np.bool_)
        adjacent[np.repeat(self.area, 4), self.area[self.neighbour.ravel()]] = True
        return adjacent & ~np.eye(count, dtype=np.bool_)

    def without_sites(self) -> "BusMap":
        """The same map with a wall in the place of every construction site."""
        own = np.arange(self.num_cells, dtype=np.int32)[:, None]
        return self._replace(neighbour=np.where(self.site > 0, own, self.neighbour), site=np.zeros_like(self.site))


def parse(text: str) -> BusMap:
    """Reads a map.

    Cells are three characters wide: a blank, the name of the cell's area (a digit or a small
    letter) and ``S`` (start), ``P`` (passenger) or a blank. Between two cells stands a wall (``|``
    or ``---``), a passage (blank) or a construction site (a capital letter). Corners are ``+`` or
    blank; the border is wall.

    Raises:
        MapError: with the row and column of the first thing that is wrong.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    height, width = _size(lines)
    area_names: list[str] = []
    site_names: list[str] = []
    area = np.zeros(height * width, np.int32)
    passengers: list[int] = []
    starts: list[int] = []
    for cell in range(height * width):
        line, column = 2 * (cell // width) + 1, 4 * (cell % width) + 1
        left, name, mark = lines[line][column : column + 3]
        if left != " ":
            raise MapError(line, column, f"unknown character {left!r}; a cell begins with a blank")
        if not (name.isascii() and (name.isdigit() or name.islower())):
            raise MapError(line, column + 1, f"unknown character {name!r}; an area is a digit or a small letter")
        if name not in area_names:
            area_names.append(name)
        if mark == "S" and starts:
            raise MapError(line, column + 2, "a second start S; a map has one")
        if mark not in " SP":
            raise MapError(line, column + 2, f"unknown character {mark!r}; a cell ends with S, P or a blank")
        starts += [cell] if mark == "S" else []
        passengers += [cell] if mark == "P" else []
        area[cell] = area_names.index(name)
    if not starts:
        raise MapError(0, 0, "no start; mark one cell with S")
    if not passengers:
        raise MapError(0, 0, "no passenger; mark at least one cell with P")
    order = sorted(area_names)
    area = np.array([order.index(area_names[a]) for a in area], np.int32)

    edge = np.full((height * width, 4), _WALL, np.int32)
    for cell in range(height * width):
        for move, (down, right) in enumerate(MOVES):
            line, column = 2 * (cell // width) + 1 + down, 4 * (cell % width) + 2 + 2 * right
            edge[cell, move] = _edge(lines, line, column, vertical=right != 0, names=site_names)
            outside = not (0 <= cell // width + down < height and 0 <= cell % width + right < width)
            if outside and edge[cell, move] != _WALL:
                raise MapError(line, column, "an opening in the border; the border is wall")
    sites = sorted(site_names)
    renumber = np.array([0, *(sites.index(name) + 1 for name in site_names)], np.int32)
    cells = np.arange(height * width, dtype=np.int32)
    offsets = np.array([down * width + right for down, right in MOVES], np.int32)
    neighbour = np.where(edge == _WALL, cells[:, None], cells[:, None] + offsets)
    site = np.where(edge > 0, renumber[np.maximum(edge, 0)], 0).astype(np.int32)
    bus_map = BusMap(
        height, width, neighbour.astype(np.int32), site, area, tuple(passengers), starts[0], tuple(order), tuple(sites)
    )
    _check_reachable(bus_map)
    return bus_map


def _size(lines: list[str]) -> tuple[int, int]:
    """Height and width in cells, after checking the shape, the corners and the ends of the lines."""
    if len(lines) < 3 or len(lines) % 2 == 0:
        raise MapError(max(len(lines) - 1, 0), 0, f"wrong size: {len(lines)} lines; a map of h rows has 2 h + 1")
    length = len(lines[0])
    if length < 5 or length % 4 != 1:
        raise MapError(0, max(length - 1, 0), f"wrong size: {length} characters; a map of w columns has 4 w + 1")
    for number, line in enumerate(lines):
        if len(line) != length:
            raise MapError(
                number, min(len(line), length), f"wrong size: {len(line)} characters; the first line has {length}"
            )
        if number % 2 == 0:
            for column in range(0, length, 4):
                if line[column] not in "+ ":
                    raise MapError(number, column, f"unknown character {line[column]!r}; a corner is + or blank")
    return len(lines) // 2, length // 4


def _edge(lines: list[str], line: int, column: int, vertical: bool, names: list[str]) -> int:
    """What stands between two cells: a wall, a free passage, or the number of a site (from 1)."""
    text = lines[line][column] if vertical else lines[line][column - 1 : column + 2]
    if text == ("|" if vertical else "---"):
        return _WALL
    name = text.strip(" ")
    if not name:
        return _FREE
    if len(name) > 1 or not (name.isascii() and name.isupper()) or (not vertical and text[1] != name):
        allowed = "|, a blank or a capital letter" if vertical else "---, blanks or a capital letter in the middle"
        at = column - (not vertical)
        raise MapError(line, at, f"unknown characters {text!r}; between two cells stands {allowed}")
    if name not in names:
        names.append(name)
    return names.index(name) + 1


def _check_reachable(bus_map: BusMap) -> None:
    seen = {bus_map.start}
    queue = deque(seen)
    while queue:
        for cell in bus_map.neighbour[queue.popleft()].tolist():
            if cell not in seen:
                seen.add(cell)
                queue.append(cell)
    for cell in bus_map.passengers:
        if cell not in seen:
            row, column = divmod(cell, bus_map.width)
            raise MapError(2 * row + 1, 4 * column + 3, "a passenger that cannot be reached from the start")
