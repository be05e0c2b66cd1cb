"""Gridworlds read from text, one character a cell."""

import numpy as np

from hrljax.envs.grid.ascii_map import MOVES, MapError, check_rectangle, neighbours, reached, text_lines
from hrljax.envs.grid.cell_world import CellMap

FOUR_ROOMS = """\
#############
#S....#.....#
#.....#.....#
#.....n.....#
#.....#.....#
#.....#.....#
##w####.....#
#.....###e###
#.....#.....#
#.....#.....#
#.....s.....#
#.....#....G#
#############
"""
"""The four rooms of Sutton, Precup and Singh 1999, joined by the hallways n, e, s and w."""

CLIFF = """\
............
............
............
SPPPPPPPPPPG
"""
"""The cliff of Sutton and Barto 2018, Example 6.6, but a fall ends the episode."""

BARRIER = """\
S.......
........
..####..
.....#..
..G..#..
.....#..
..####..
........
"""
"""Eight by eight cells and a barrier around the goal, open on one side: a maze like that of Dayan and Hinton 1992."""

NAMED_MAPS = {"four_rooms": FOUR_ROOMS, "cliff": CLIFF, "barrier": BARRIER}

_ALLOWED = "a cell is # (wall), . (free), S (start), G (goal), P (pit) or a small letter (hallway)"


def parse(text: str) -> CellMap:
    """Reads a map.

    Every cell is one character: ``#`` a wall, ``.`` free, ``S`` a start, ``G`` a goal, ``P`` a pit
    or a small letter, the name of a hallway: a free cell between rooms. The map's border is wall
    whatever stands there. A room is a set of cells that moves join without hallways; rooms are
    numbered from 0 as `CellMap.region`, and hallways after them in the order of their names.

    Raises:
        MapError: with the row and column of the first thing that is wrong.
    """
    lines = text_lines(text)
    if not lines or not lines[0]:
        raise MapError(0, 0, "an empty map")
    check_rectangle(lines)
    height, width = len(lines), len(lines[0])
    mark = np.array([list(line) for line in lines]).ravel()
    hallways: dict[str, int] = {}
    for cell, character in enumerate(mark.tolist()):
        row, column = divmod(cell, width)
        if character in hallways:
            raise MapError(row, column, f"a second hallway {character!r}; a name is used once")
        if character.isascii() and character.islower():
            hallways[character] = cell
        elif character not in "#.SGP":
            raise MapError(row, column, f"unknown character {character!r}; {_ALLOWED}")
    wall, goal, pit, starts = (mark == character for character in "#GPS")
    for missing, sign, is_there in (("start", "S", starts), ("goal", "G", goal)):
        if not is_there.any():
            raise MapError(0, 0, f"no {missing}; mark at least one cell with {sign}")
    neighbour = neighbours(_walls(wall.reshape(height, width)), width)
    _check_reachable(neighbour, starts, goal, pit, width)
    return CellMap(
        text="\n".join(lines) + "\n",
        places=np.stack(np.divmod(np.arange(height * width), width), -1),
        height=height,
        width=width,
        neighbour=neighbour,
        wall=wall,
        goal=goal,
        pit=pit,
        starts=starts,
        region=_regions(neighbour, wall, [hallways[name] for name in sorted(hallways)]),
        marks={cell: character for cell, character in enumerate(mark.tolist()) if character not in "#."},
    )


def _walls(wall: np.ndarray) -> np.ndarray:
    """``[cells, 4]`` bool: a move stays where it is, from the cells that are walls."""
    padded = np.pad(wall, 1, constant_values=True)
    height, width = wall.shape
    sides = [padded[1 + down : 1 + down + height, 1 + right : 1 + right + width] for down, right in MOVES]
    return (np.stack(sides, -1) | wall[..., None]).reshape(-1, 4)


def _check_reachable(neighbour: np.ndarray, starts: np.ndarray, goal: np.ndarray, pit: np.ndarray, width: int) -> None:
    """Raises MapError where a start has no way to a goal, or a goal none from a start."""
    ends = goal | pit
    for cell in np.flatnonzero(starts):
        if not (reached(neighbour, np.arange(len(starts)) == cell, stops=ends) & goal).any():
            raise MapError(*divmod(int(cell), width), "a start from which no goal can be reached")
    for cell in np.flatnonzero(goal & ~reached(neighbour, starts, stops=ends)):
        raise MapError(*divmod(int(cell), width), "a goal that cannot be reached from any start")


def _regions(neighbour: np.ndarray, wall: np.ndarray, hallways: list[int]) -> np.ndarray:
    """``[cells]`` int32: number of the room or hallway of a cell, -1 in walls."""
    region = np.full(len(wall), -1, np.int32)
    is_hallway = np.zeros(len(wall), np.bool_)
    is_hallway[hallways] = True
    inside = np.where(is_hallway[neighbour], np.arange(len(wall))[:, None], neighbour)
    count = 0
    for cell in np.flatnonzero(~wall & ~is_hallway):
        if region[cell] < 0:
            region[reached(inside, np.arange(len(wall)) == cell)] = count
            count += 1
    region[hallways] = count + np.arange(len(hallways))
    return region
