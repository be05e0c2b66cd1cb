"""Dietterich's maze of two rooms: where recursively optimal and optimal policies differ."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hrljax.envs.grid.ascii_map import WALL, neighbours, read_boxes, read_edges
from hrljax.envs.grid.cell_world import CellMap, CellState, CellWorld
from hrljax.hierarchy.definition import Hierarchy, Subtask

TWO_ROOMS = """\
+---+---+---+---+---+---+
| S   S   S   S |     G |
+   +   +   +   +   +   +
| S   S   S   S         |
+   +   +   +   +   +   +
| S   S   S   S |       |
+   +   +   +   +   +   +
| S   S   S   S |       |
+   +   +   +   +   +   +
| S   S   S   S |       |
+   +   +   +   +   +   +
| S   S   S   S         |
+   +   +   +   +   +   +
| S   S   S   S |       |
+---+---+---+---+---+---+
"""
"""The maze of Dietterich 2000, Figure 6. The left room is where episodes start."""


class MazeParams(NamedTuple):
    """Numbers of the Maze; each may be swept as ``env.<name>``."""

    slip_probability: float = 0.0
    """A move turns to either side with half of this; west, which is no action, included."""
    step_reward: float = -1.0
    max_steps: int = 1000


@dataclass(frozen=True)
class Maze(CellWorld[MazeParams]):
    """Two rooms with two doors and the goal in a corner (Dietterich 2000, Figure 6; thesis Figure 2.1).

    Episodes start in one of the 28 cells of the left room, all equally likely, and end at the goal.
    Every move costs 1, a bump into a wall too.
    """

    name = "Maze"
    action_names = ("north", "south", "east")
    directions = (0, 2, 1)

    @property
    def layout(self) -> CellMap:
        return _two_rooms()

    @property
    def default_params(self) -> MazeParams:
        return MazeParams()

    def end_rewards(self, params: MazeParams) -> tuple[float, float]:
        return params.step_reward, params.step_reward

    def hierarchy(self) -> Hierarchy:
        """Root over Exit and GotoGoal (thesis Figure 2.2).

        Exit can be invoked in the left room and ends in the right one. GotoGoal can be invoked in
        the right room only, so that Root has to leave the left one by Exit, and ends at the goal
        (or back in the left room, after a slip).
        """
        return _two_room_hierarchy()


@cache
def _two_rooms() -> CellMap:
    boxes = read_boxes(TWO_ROOMS)
    cells = range(boxes.height * boxes.width)
    mark = np.array([boxes.cell(cell)[1] for cell in cells])
    nowhere = np.zeros(len(cells), np.bool_)
    return CellMap(
        text=TWO_ROOMS.replace("S", " "),
        places=np.array([boxes.place(cell) for cell in cells]) + np.array([0, 1]),
        height=boxes.height,
        width=boxes.width,
        neighbour=neighbours(read_edges(boxes)[0] == WALL, boxes.width),
        wall=nowhere,
        goal=mark == "G",
        pit=nowhere,
        starts=mark == "S",
        region=(mark != "S").astype(np.int32),
        marks={int(np.argmax(mark == "G")): "G"},
    )


@cache
def _two_room_hierarchy() -> Hierarchy:
    layout = _two_rooms()

    def left(state: CellState):
        return jnp.asarray(layout.starts)[state.cell]

    def at_goal(state: CellState):
        return jnp.asarray(layout.goal)[state.cell]

    return Hierarchy(
        Maze.action_names,
        [
            Subtask("Root", ("Exit", "GotoGoal"), at_goal),
            Subtask("Exit", Maze.action_names, lambda state: ~left(state), goal=lambda state: ~left(state)),
            Subtask("GotoGoal", Maze.action_names, lambda state: left(state) | at_goal(state), goal=at_goal),
        ],
    )
