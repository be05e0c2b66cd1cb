"""Gridworlds that the user draws, with goals, pits, slips and hallways."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hrljax.core import checks
from hrljax.envs.grid.cell_world import CellMap, CellWorld
from hrljax.envs.grid.map import FOUR_ROOMS, NAMED_MAPS, parse
from hrljax.hierarchy.definition import Hierarchy, Predicate, Subtask

_MOST_STARTS = 255


class GridParams(NamedTuple):
    """Numbers of a Gridworld; each may be swept as ``env.<name>``. Rewards are those of the whole step."""

    slip_probability: float = 0.0
    """A move turns to either side with half of this."""
    step_reward: float = -1.0
    goal_reward: float = -1.0
    pit_reward: float = -100.0
    max_steps: int = 1000


@dataclass(frozen=True)
class Gridworld(CellWorld[GridParams]):
    """A gridworld. Episodes begin in any start, equally likely, and end in a goal or in a pit.

    Attributes:
        map: the map as text (`hrljax.envs.grid.map.parse`), or the name of one:
            ``"four_rooms"``, ``"cliff"`` or ``"barrier"``.

    Raises:
        TypeError: the map is no string.
        MapError: the map cannot be read.
        ValueError: the name of the map is unknown, or the map has more than 255 starts.
    """

    map: str = FOUR_ROOMS

    name = "Gridworld"
    action_names = ("north", "east", "south", "west")
    directions = (0, 1, 2, 3)
    metrics = ("pit",)

    def __post_init__(self) -> None:
        checks.text("map", self.map, "'S.#\\n..G', or 'four_rooms'")
        if self.map.isidentifier() and self.map.islower():
            if self.map not in NAMED_MAPS:
                raise ValueError(
                    f"map must be a drawing or one of {', '.join(map(repr, NAMED_MAPS))}, got {self.map!r}"
                )
            object.__setattr__(self, "map", NAMED_MAPS[self.map])
        count = int(self.layout.starts.sum())
        if count > _MOST_STARTS:
            raise ValueError(f"map has {count} starts; at most {_MOST_STARTS} are allowed")

    @property
    def layout(self) -> CellMap:
        return _parsed(self.map)

    @property
    def default_params(self) -> GridParams:
        return GridParams()

    def end_rewards(self, params: GridParams) -> tuple[float, float]:
        return params.goal_reward, params.pit_reward

    def hierarchy(self) -> Hierarchy:
        """Root over Goto(n), Goto(e), ... for the hallways and Goto(G) for the goals (Sutton et al. 1999).

        Goto(t) can be invoked in the rooms next to t and in their other hallways, and terminates
        when these are left; its goal is t. A map without hallways has Goto(G) alone.
        """
        return _hallway_hierarchy(self.map)


_parsed = cache(parse)


@cache
def _hallway_hierarchy(text: str) -> Hierarchy:
    layout = _parsed(text)
    names = sorted(mark for mark in layout.marks.values() if mark.islower())
    num_rooms = int(layout.region.max()) + 1 - len(names)
    is_room = np.arange(num_rooms + len(names)) < num_rooms
    touches = _touching_regions(layout)

    def somewhere(cells: np.ndarray) -> Predicate:
        return lambda state: jnp.asarray(cells)[state.cell]

    subtasks, has_child = [], np.zeros(layout.num_cells, np.bool_)
    for target in [*range(num_rooms, num_rooms + len(names)), None]:
        if target is None:
            label, goal = "G", layout.goal
            near = np.isin(np.arange(len(is_room)), layout.region[layout.goal])
        else:
            label, goal, near = names[target - num_rooms], layout.region == target, touches[target]
        regions = near | (~is_room & touches[near & is_room].any(0))
        active = regions[layout.region] & ~goal & ~layout.ends
        has_child |= active
        subtasks.append(Subtask(f"Goto({label})", Gridworld.action_names, somewhere(~active), somewhere(goal)))
    root = Subtask("Root", tuple(task.name for task in subtasks), somewhere(~has_child))
    return Hierarchy(Gridworld.action_names, [root, *subtasks])


def _touching_regions(layout: CellMap) -> np.ndarray:
    """``[regions, regions]`` bool: a move leads from one room or hallway into the other."""
    count = int(layout.region.max()) + 1
    touches = np.zeros((count, count), np.bool_)
    free = ~layout.wall
    touches[np.repeat(layout.region[free], 4), layout.region[layout.neighbour[free].ravel()]] = True
    return touches & ~np.eye(count, dtype=np.bool_)
