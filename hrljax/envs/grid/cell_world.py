"""Environments whose state is a cell of a grid: what `Maze` and `Gridworld` share."""

from abc import abstractmethod
from typing import ClassVar, Generic, NamedTuple, Protocol, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.environment import Cuts, Events, Numbers, Words
from hrljax.core.numerics import take
from hrljax.core.random import uniform_cuts, uniform_index
from hrljax.envs.base import TabularEnvironment
from hrljax.envs.grid.ascii_map import reached
from hrljax.envs.grid.moves import move_table, moved, row_and_column, slip_cuts


class SlipperyNumbers(Numbers, Protocol):
    """Numbers of a world in which moves slip."""

    @property
    def slip_probability(self) -> Array | float: ...
    @property
    def step_reward(self) -> Array | float: ...


Params = TypeVar("Params", bound=SlipperyNumbers)

_GOES_ON, _GOAL, _PIT, _CLOSED = range(4)


class CellState(NamedTuple):
    """All fields are int32 scalars."""

    cell: Array  # row * width + column
    time: Array  # steps taken in this episode


class CellMap(NamedTuple):
    """A grid as arrays; cells are numbered row by row."""

    text: str
    """The map as it is drawn."""
    places: np.ndarray  # [cells, 2] int: line and column of a cell's mark in `text`
    height: int
    width: int
    neighbour: np.ndarray  # [cells, 4] int32: the cell that a move reaches (itself at a wall)
    wall: np.ndarray  # [cells] bool: cannot be entered
    goal: np.ndarray  # [cells] bool: the episode ends here
    pit: np.ndarray  # [cells] bool: the episode ends here, badly
    starts: np.ndarray  # [cells] bool: where an episode can begin
    region: np.ndarray  # [cells] int32: a number for each part of the map, such as a room
    marks: dict[int, str]
    """What pictures write into some cells."""

    @property
    def num_cells(self) -> int:
        return self.height * self.width

    @property
    def closed(self) -> np.ndarray:
        """``[cells]`` bool: walls and other cells to which no start leads."""
        return ~reached(self.neighbour, self.starts, stops=self.goal | self.pit)

    @property
    def ends(self) -> np.ndarray:
        """``[cells]`` bool: an episode that goes on is never here."""
        return self.goal | self.pit | self.closed


class CellWorld(TabularEnvironment[CellState, Params], Generic[Params]):
    """Moves on a `CellMap`. A move slips to either side with half of ``params.slip_probability`` each.

    An episode begins in one of the map's starts, all equally likely, and ends in a goal or in a pit.
    Closed cells have numbers too, but never occur. In the model, an action that leads to one ends the
    episode, so that values of closed cells are finite without discounting.
    """

    directions: ClassVar[tuple[int, ...]]
    """For each action the index of its move in `hrljax.envs.grid.ascii_map.MOVES`."""
    num_words = 1
    num_initial_words = 1
    renderer = "hrljax.envs.grid.cell_render"

    @property
    @abstractmethod
    def layout(self) -> CellMap:
        """The map as arrays."""

    @abstractmethod
    def end_rewards(self, params: Params) -> tuple[Array | float, Array | float]:
        """Whole rewards of the steps that reach a goal and a pit."""

    @property
    def num_states(self) -> int:
        return self.layout.num_cells

    def encode(self, state: CellState) -> Array:
        return state.cell

    def decode(self, index: Array) -> CellState:
        return CellState(cell=jnp.asarray(index, jnp.int32), time=jnp.int32(0))

    def variables(self, state: CellState) -> dict[str, Array]:
        """Row and column."""
        return row_and_column(state.cell, self.layout.width)

    def initial(self, words: Words, params: Params) -> CellState:
        starts = np.flatnonzero(self.layout.starts).astype(np.int32)
        number = uniform_index(words[0], jnp.int32(len(starts)))
        return CellState(cell=take(jnp.asarray(starts), number), time=jnp.int32(0))

    def initial_word_cuts(self, params: Params) -> Cuts:
        return (uniform_cuts(int(self.layout.starts.sum())),)

    def word_cuts(self, params: Params) -> Cuts:
        return (slip_cuts(params.slip_probability),)

    def transition(
        self, state: CellState, action: Array, words: Words, params: Params
    ) -> tuple[CellState, Array, Array, Events]:
        layout = self.layout
        table = jnp.asarray(move_table(layout.neighbour, self.directions, blocked_moves_slip=True))
        cell = moved(table, self.num_actions, state.cell, action, words[0], params.slip_probability)
        kind = take(jnp.asarray(_kinds(layout)), cell)
        at_goal, in_pit = kind == _GOAL, kind == _PIT
        goal_reward, pit_reward = self.end_rewards(params)
        reward = lax.select(at_goal, jnp.float32(goal_reward), jnp.float32(params.step_reward))
        reward = lax.select(in_pit, jnp.float32(pit_reward), reward)
        events = {"pit": in_pit} if "pit" in self.metrics else {}
        return CellState(cell, state.time + 1), reward, kind != _GOES_ON, events


def _kinds(layout: CellMap) -> np.ndarray:
    """``[cells]`` int32: what happens to an episode in a cell."""
    ends = [layout.goal, layout.pit, layout.closed]
    return np.select(ends, [np.int32(_GOAL), np.int32(_PIT), np.int32(_CLOSED)], np.int32(_GOES_ON))
