"""The Taxi domain (Dietterich 2000, sections 2.1 and 7.1), as he and as Gymnasium define it."""

from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple, TypeAlias, cast

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core.environment import Cuts, Events, Words
from hrljax.core.numerics import take
from hrljax.core.random import count_below, uniform_cuts, uniform_index
from hrljax.envs.base import TabularEnvironment, check_options
from hrljax.envs.grid.ascii_map import WALL, neighbours, read_boxes, read_edges
from hrljax.envs.grid.moves import move_table, moved, row_and_column, slip_cuts
from hrljax.hierarchy.definition import Hierarchy, Predicate, Subtask

MAP = """\
+---+---+---+---+---+
| R     |         G |
+   +   +   +   +   +
|       |           |
+   +   +   +   +   +
|                   |
+   +   +   +   +   +
|   |       |       |
+   +   +   +   +   +
| Y |       | B     |
+---+---+---+---+---+
"""
DEPOTS = "RGYB"
"""Names of the four depots, in the order of their numbers."""
ABOARD = 4
"""Where the passenger is, if in the taxi."""
SIZE = 5
DIRECTIONS = (2, 0, 1, 3, None, None)
"""For each action the index of its move in `hrljax.envs.grid.ascii_map.MOVES`."""

_PICKUP, _PUTDOWN = 4, 5
_OPTIONS = {"stochastic": (False, True), "fickle": (False, True), "rules": ("dietterich", "gymnasium")}


class TaxiState(NamedTuple):
    """All fields are int32 scalars."""

    cell: Array  # row * 5 + column
    passenger: Array  # 0 to 3: waits at that depot; 4: in the taxi
    destination: Array  # 0 to 3: a depot
    fickle: Array  # 1: the passenger may change the destination on the first move; else 0
    time: Array  # steps taken in this episode


class TaxiParams(NamedTuple):
    """Numbers of the Taxi domain; each may be swept as ``env.<name>``. Rewards are those of the whole step."""

    slip_probability: float = 0.0
    """A move turns to either side with half of this. 0.2 by default if the Taxi is stochastic."""
    step_reward: float = -1.0
    delivery_reward: float = 19.0
    """20 for the delivery and -1 for the step, as Dietterich counts; 20 by default with Gymnasium's rules."""
    illegal_reward: float = -10.0
    """For a pickup or a putdown that is not allowed."""
    max_steps: int = 1000


class FickleTaxiParams(NamedTuple):
    """`TaxiParams` and the probability of a change of mind; each may be swept as ``env.<name>``."""

    slip_probability: float = 0.0
    step_reward: float = -1.0
    delivery_reward: float = 19.0
    illegal_reward: float = -10.0
    fickle_probability: float = 0.3
    """That the passenger changes to one of the three other destinations, on the first move with the taxi."""
    max_steps: int = 1000


TaxiNumbers: TypeAlias = TaxiParams | FickleTaxiParams


@dataclass(frozen=True)
class Taxi(TabularEnvironment[TaxiState, TaxiNumbers]):
    """The Taxi domain. The episode ends when the passenger is put down at the destination.

    State numbers are those of Gymnasium's Taxi-v4, and so are the actions. A fickle Taxi has
    another 500, from 500 on: those in which the passenger may still have a change of mind.

    Attributes:
        stochastic: moves slip to either side (``params.slip_probability``, 0.2 by default).
        fickle: when the taxi first leaves a cell with the passenger, the passenger changes to
            another destination (``params.fickle_probability``, 0.3 by default), once in an episode.
        rules: those of ``"dietterich"`` or of ``"gymnasium"``, which differ in four things. In
            Gymnasium, the passenger never waits at the destination when an episode starts; the step
            that delivers earns 20, not 19; putting the passenger down at any other depot is
            allowed; and a move against a wall never slips.

    Raises:
        ValueError: an option is unknown.
    """

    stochastic: bool = False
    fickle: bool = False
    rules: Literal["dietterich", "gymnasium"] = "dietterich"

    name = "Taxi"
    action_names = ("south", "north", "east", "west", "pickup", "putdown")
    metrics = ("illegal",)
    num_words = 2
    num_initial_words = 3
    renderer = "hrljax.envs.taxi.render"

    def __post_init__(self) -> None:
        check_options(self, _OPTIONS)

    @property
    def default_params(self) -> TaxiParams | FickleTaxiParams:
        return (FickleTaxiParams if self.fickle else TaxiParams)(
            slip_probability=0.2 if self.stochastic else 0.0,
            delivery_reward=20.0 if self.rules == "gymnasium" else 19.0,
        )

    @property
    def num_states(self) -> int:
        return 1000 if self.fickle else 500

    def encode(self, state: TaxiState) -> Array:
        number = (state.cell * 5 + state.passenger) * 4 + state.destination
        return number + 500 * state.fickle if self.fickle else number

    def decode(self, index: Array) -> TaxiState:
        index = jnp.asarray(index, jnp.int32)
        fickle, number = (index // 500, index % 500) if self.fickle else (jnp.int32(0), index)
        return TaxiState(number // 20, number // 4 % 5, number % 4, fickle, jnp.int32(0))

    def variables(self, state: TaxiState) -> dict[str, Array]:
        """Row and column of the taxi, where the passenger is, the destination; of a fickle Taxi also `fickle`."""
        more = {"fickle": state.fickle} if self.fickle else {}
        cell = row_and_column(state.cell, SIZE)
        return {**cell, "passenger": state.passenger, "destination": state.destination, **more}

    def initial(self, words: Words, params: TaxiNumbers) -> TaxiState:
        cell, passenger = (uniform_index(w, jnp.int32(n)) for w, n in zip(words, (SIZE * SIZE, 4), strict=False))
        destination = uniform_index(words[2], jnp.int32(self._num_destinations))
        if self.rules == "gymnasium":
            destination = (passenger + destination + 1) & 3
        return TaxiState(cell, passenger, destination, jnp.int32(self.fickle), jnp.int32(0))

    @property
    def _num_destinations(self) -> int:
        return 3 if self.rules == "gymnasium" else 4

    def initial_word_cuts(self, params: TaxiNumbers) -> Cuts:
        return uniform_cuts(SIZE * SIZE), uniform_cuts(4), uniform_cuts(self._num_destinations)

    def word_cuts(self, params: TaxiNumbers) -> Cuts:
        return slip_cuts(params.slip_probability), self._fickle_cuts(params)

    def _fickle_cuts(self, params: TaxiNumbers) -> tuple[Array | float, ...]:
        if not self.fickle:
            return ()
        probability = cast(FickleTaxiParams, params).fickle_probability
        return tuple(probability * (i / 3) for i in (1, 2, 3))

    def transition(
        self, state: TaxiState, action: Array, words: Words, params: TaxiNumbers
    ) -> tuple[TaxiState, Array, Array, Events]:
        layout = taxi_layout()
        table = jnp.asarray(_move_table(self.rules))
        cell = moved(table, self.num_actions, state.cell, action, words[0], params.slip_probability)
        depot = take(jnp.asarray(layout.depot_of), state.cell)
        aboard = state.passenger == ABOARD

        picks_up = (action == _PICKUP) & (depot == state.passenger)
        delivers = (action == _PUTDOWN) & aboard & (depot == state.destination)
        puts_down = (action == _PUTDOWN) & aboard & (depot >= 0) if self.rules == "gymnasium" else delivers
        illegal = (action >= _PICKUP) & ~picks_up & ~puts_down
        passenger = lax.select(picks_up, jnp.int32(ABOARD), lax.select(puts_down, depot, state.passenger))

        destination, fickle = state.destination, state.fickle
        if self.fickle:
            departs = aboard & (cell != state.cell) & (fickle == 1)
            changed = (destination + count_below(words[1], self._fickle_cuts(params))) & 3
            destination = lax.select(departs, changed, destination)
            fickle = lax.select(departs, jnp.int32(0), fickle)

        reward = lax.select(illegal, jnp.float32(params.illegal_reward), jnp.float32(params.step_reward))
        reward = lax.select(delivers, jnp.float32(params.delivery_reward), reward)
        after = TaxiState(cell, passenger, destination, fickle, state.time + 1)
        return after, reward, delivers, {"illegal": illegal}

    def hierarchy(self) -> Hierarchy:
        """Root{Get, Put}, Get{pickup, Navigate(t)}, Put{putdown, Navigate(t)}, Navigate(t){the four moves}.

        Dietterich 2000, Figure 2; thesis Figure 3.2. There are four subtasks Navigate(t), one for
        each depot t. Get can be invoked while the passenger is not in the taxi and ends when he is;
        Put the other way round, its goal being the destination; Navigate(t) ends at t.
        """
        return _taxi_hierarchy()


class TaxiLayout(NamedTuple):
    """The map as arrays."""

    neighbour: np.ndarray  # [25, 4] int32: the cell that a move reaches (itself at a wall)
    depots: tuple[int, ...]  # cells
    depot_of: np.ndarray  # [25] int32: the depot in a cell, -1 if none


@cache
def taxi_layout() -> TaxiLayout:
    """The map of the Taxi domain as arrays."""
    boxes = read_boxes(MAP)
    depot_of = np.array([DEPOTS.find(boxes.cell(cell)[1]) for cell in range(SIZE * SIZE)], np.int32)
    depots = tuple(int(np.argmax(depot_of == depot)) for depot in range(len(DEPOTS)))
    return TaxiLayout(neighbours(read_edges(boxes)[0] == WALL, SIZE), depots, depot_of)


@cache
def _move_table(rules: str) -> np.ndarray:
    return move_table(taxi_layout().neighbour, DIRECTIONS, blocked_moves_slip=rules == "dietterich")


@cache
def _taxi_hierarchy() -> Hierarchy:
    def at(cell: int) -> Predicate:
        return lambda state: state.cell == cell

    moves = Taxi.action_names[:_PICKUP]
    navigate = [
        Subtask(f"Navigate({name})", moves, at(cell), goal=at(cell))
        for name, cell in zip(DEPOTS, taxi_layout().depots, strict=True)
    ]
    names = tuple(task.name for task in navigate)

    def aboard(state: TaxiState) -> Array:
        return state.passenger == ABOARD

    return Hierarchy(
        Taxi.action_names,
        [
            Subtask("Root", ("Get", "Put"), lambda state: jnp.bool_(False)),
            Subtask("Get", ("pickup", *names), aboard, goal=aboard),
            Subtask("Put", ("putdown", *names), lambda s: ~aboard(s), goal=lambda s: s.passenger == s.destination),
            *navigate,
        ],
    )
