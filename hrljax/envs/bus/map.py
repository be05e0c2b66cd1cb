"""Maps of the Bus domain, read from text."""

from typing import NamedTuple

import numpy as np

from hrljax.envs.grid.ascii_map import MOVES, WALL, MapError, neighbours, reached, read_boxes, read_edges

__all__ = ["KAO_V1", "MOVES", "BusMap", "MapError", "parse"]

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
        cells = np.arange(self.num_cells, dtype=np.int32)[:, None]
        return self._replace(neighbour=np.where(self.site > 0, cells, self.neighbour), site=np.zeros_like(self.site))


def parse(text: str) -> BusMap:
    """Reads a map.

    The map is boxed (`hrljax.envs.grid.ascii_map`). A cell is a blank, the name of the cell's area (a
    digit or a small letter) and ``S`` (start), ``P`` (passenger) or a blank. A capital letter
    between two cells is a construction site.

    Raises:
        MapError: with the row and column of the first thing that is wrong.
    """
    boxes = read_boxes(text)
    height, width = boxes.height, boxes.width
    area_names: list[str] = []
    area = np.zeros(height * width, np.int32)
    passengers: list[int] = []
    starts: list[int] = []
    for cell in range(height * width):
        line, column = boxes.place(cell)
        left, name, mark = boxes.cell(cell)
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

    edge, site_names = read_edges(boxes)
    neighbour, start = neighbours(edge == WALL, width), np.arange(height * width) == starts[0]
    can_reach = reached(neighbour, start)
    for cell in passengers:
        if not can_reach[cell]:
            line, column = boxes.place(cell)
            raise MapError(line, column + 2, "a passenger that cannot be reached from the start")
    site = np.maximum(edge, 0)
    return BusMap(height, width, neighbour, site, area, tuple(passengers), starts[0], tuple(order), site_names)
