"""The Bus domain (thesis 4.1): pick up every passenger and return, with roads under construction."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import checks
from hrljax.core.environment import Cuts, Events, Words
from hrljax.core.numerics import take
from hrljax.core.random import below, count_below, uniform_cuts, uniform_index
from hrljax.envs.base import TabularEnvironment, check_options
from hrljax.envs.bus.map import KAO_V1, BusMap, parse
from hrljax.envs.grid.moves import row_and_column
from hrljax.hierarchy.definition import Abstraction, Hierarchy, Subtask

_OPTIONS = {
    "site": ("edge", "cell"),
    "slip": ("any", "other"),
    "road_change": ("other", "any"),
    "breakdown": ("before", "after"),
}


class BusState(NamedTuple):
    """All fields are int32 scalars."""

    cell: Array  # row * width + column
    damaged: Array  # 0 or 1
    picked: Array  # bit i: passenger i is on board
    road: Array  # 0: no construction, i: site i is under construction
    time: Array  # steps taken in this episode


class BusParams(NamedTuple):
    """Numbers of the Bus domain; each may be swept as ``env.<name>``."""

    slip_probability: float = 0.1
    damage_probability: float = 1.0
    breakdown_probability: float = 0.25
    road_change_probability: float = 0.05
    step_reward: float = -1.0
    breakdown_reward: float = -51.0
    """Whole reward of the step on which the bus breaks down (-50 if that step shall cost nothing)."""
    max_steps: int = 1000


@dataclass(frozen=True)
class Bus(TabularEnvironment[BusState, BusParams]):
    """The Bus domain. The episode ends at the start cell with all passengers, or with a breakdown.

    Attributes:
        map: the map as text (`hrljax.envs.bus.map.parse`).
        site: a construction site damages the bus when it crosses the marked ``"edge"``, in either
            direction, or when it enters the ``"cell"`` east or south of that edge, from any side.
        slip: a slip replaces the direction by ``"any"`` of the four or by one of the three
            ``"other"`` ones.
        road_change: the road changes to one of the ``"other"`` statuses, or to ``"any"`` (a redraw
            that may leave it as it was).
        breakdown: a damaged bus may break down ``"before"`` it moves, and then does not move, or
            ``"after"``, the move that damaged it included.

    Raises:
        TypeError: the map is no string.
        MapError: the map cannot be read.
        ValueError: an option is unknown or the map is too large to number its states.
    """

    map: str = KAO_V1
    site: Literal["edge", "cell"] = "edge"
    slip: Literal["any", "other"] = "any"
    road_change: Literal["other", "any"] = "other"
    breakdown: Literal["before", "after"] = "before"

    name = "Bus"
    action_names = ("north", "east", "south", "west")
    metrics = ("damage", "breakdown")
    num_words = 3
    num_initial_words = 1
    renderer = "hrljax.envs.bus.render"

    def __post_init__(self) -> None:
        checks.text("map", self.map, "hrljax.envs.bus.map.KAO_V1")
        check_options(self, _OPTIONS)
        layout = self.layout
        for what, count, most in (
            ("cells", layout.num_cells, 4096),
            ("passengers", len(layout.passengers), 8),
            ("construction sites", self.num_sites, 4),
        ):
            if count > most:
                raise ValueError(f"map has {count} {what}; at most {most} are allowed")
        self._site_crossed  # noqa: B018  (two sites in one cell are an error now, not later)

    @cached_property
    def layout(self) -> BusMap:
        """The map as arrays."""
        return parse(self.map)

    @property
    def num_sites(self) -> int:
        return len(self.layout.site_names)

    @property
    def default_params(self) -> BusParams:
        return BusParams()

    @property
    def num_states(self) -> int:
        return self.layout.num_cells << self._flag_bits

    @cached_property
    def _flag_bits(self) -> int:
        return 1 + len(self.layout.passengers) + self.num_sites

    @cached_property
    def _site_crossed(self) -> np.ndarray:
        """``[cells, 4]``: the site that a move touches, for either meaning of a site."""
        layout = self.layout
        if self.site == "edge":
            return layout.site
        site_cell = np.zeros(layout.num_cells, np.int32)
        for origin, move in np.argwhere(layout.site > 0):
            if move not in (1, 2):
                continue
            cell, site = layout.neighbour[origin, move], layout.site[origin, move]
            if site_cell[cell] not in (0, site):
                names = layout.site_names[site_cell[cell] - 1], layout.site_names[site - 1]
                raise ValueError(f"with site='cell', sites {names[0]} and {names[1]} lie in the same cell")
            site_cell[cell] = site
        moves = layout.neighbour != np.arange(layout.num_cells)[:, None]
        return np.where(moves, site_cell[layout.neighbour], 0)

    @cached_property
    def _moves(self) -> np.ndarray:
        """``[cells * 4]`` int32: next cell, site touched (<< 12) and passengers met (<< 16), in one word."""
        layout = self.layout
        passenger = np.zeros(layout.num_cells, np.int32)
        for i, cell in enumerate(layout.passengers):
            passenger[cell] |= 1 << i
        packed = layout.neighbour | self._site_crossed << 12 | passenger[layout.neighbour] << 16
        return packed.astype(np.int32).ravel()

    def encode(self, state: BusState) -> Array:
        flags = (state.damaged << (self._flag_bits - 1)) | (state.picked << self.num_sites) | state.road
        return (state.cell << self._flag_bits) | flags

    def decode(self, index: Array) -> BusState:
        index = jnp.asarray(index, jnp.int32)
        return BusState(
            cell=index >> self._flag_bits,
            damaged=(index >> (self._flag_bits - 1)) & 1,
            picked=(index >> self.num_sites) & ((1 << len(self.layout.passengers)) - 1),
            road=index & ((1 << self.num_sites) - 1),
            time=jnp.int32(0),
        )

    def variables(self, state: BusState) -> dict[str, Array]:
        """Row and column of the bus, whether it is damaged, whether each passenger is on board, the road."""
        passengers = {f"passenger_{i + 1}": (state.picked >> i) & 1 for i in range(len(self.layout.passengers))}
        cell = row_and_column(state.cell, self.layout.width)
        return {**cell, "damaged": state.damaged, **passengers, "road": state.road}

    def initial(self, words: Words, params: BusParams) -> BusState:
        zero = jnp.int32(0)
        road = uniform_index(words[0], jnp.int32(self.num_sites + 1))
        return BusState(cell=jnp.int32(self.layout.start), damaged=zero, picked=zero, road=road, time=zero)

    def initial_word_cuts(self, params: BusParams) -> Cuts:
        return (uniform_cuts(self.num_sites + 1),)

    def word_cuts(self, params: BusParams) -> Cuts:
        damage, breakdown = params.damage_probability, params.breakdown_probability
        return self._slip_cuts(params), (damage, breakdown, damage * breakdown), self._road_cuts(params)

    def _slip_cuts(self, params: BusParams) -> tuple[float, ...]:
        share = params.slip_probability / (4 if self.slip == "any" else 3)
        return share, share * 2, share * 3

    def _road_cuts(self, params: BusParams) -> tuple[float, ...]:
        share = params.road_change_probability / max(self.num_sites + (self.road_change == "any"), 1)
        return tuple(share * (i + 1) for i in range(self.num_sites))

    def transition(
        self, state: BusState, action: Array, words: Words, params: BusParams
    ) -> tuple[BusState, Array, Array, Events]:
        slip_word, mishap_word, road_word = words
        direction = (action + count_below(slip_word, self._slip_cuts(params))) & 3
        move = take(jnp.asarray(self._moves), state.cell * 4 + direction)
        cell, site = move & 0xFFF, (move >> 12) & 0xF
        picked = state.picked | (move >> 16)

        # One word serves both mishaps: a bus is either damaged already or can still be damaged.
        was_damaged = state.damaged == 1
        hit = (site != 0) & (site == state.road) & ~was_damaged & below(mishap_word, params.damage_probability)
        broke = was_damaged & below(mishap_word, params.breakdown_probability)
        if self.breakdown == "after":
            broke |= hit & below(mishap_word, params.damage_probability * params.breakdown_probability)
        else:
            cell = lax.select(broke, state.cell, cell)
            picked = lax.select(broke, state.picked, picked)

        road = state.road + count_below(road_word, self._road_cuts(params))
        road = lax.select(road > self.num_sites, road - (self.num_sites + 1), road)
        delivered = (picked == (1 << len(self.layout.passengers)) - 1) & (cell == self.layout.start)
        after = BusState(cell, state.damaged | hit.astype(jnp.int32), picked, road, state.time + 1)
        reward = lax.select(broke, jnp.float32(params.breakdown_reward), jnp.float32(params.step_reward))
        info = {"damage": hit, "breakdown": broke}
        return after, reward, broke | delivered, info

    def hierarchy(self) -> Hierarchy:
        """Root over Move(1), Move(2), ...: one subtask for each area (thesis Figure 4.1(b)).

        Move(t) can be invoked in the areas next to t and terminates when the bus leaves them; its
        goal is area t.
        """
        return _bus_hierarchy(self)


@cache
def _bus_hierarchy(env: Bus) -> Hierarchy:
    layout = env.layout
    adjacent = layout.adjacent_areas()[layout.area]
    flags = env.num_sites

    def move_to(target: int) -> Subtask:
        return Subtask(
            name=f"Move({layout.area_names[target]})",
            children=env.action_names,
            termination=lambda state: ~jnp.asarray(adjacent)[state.cell, target],
            goal=lambda state: jnp.asarray(layout.area)[state.cell] == target,
        )

    abstraction = Abstraction(
        planning=lambda state: (state.cell << len(layout.passengers)) | state.picked,
        environment=lambda state: (state.damaged << flags) | state.road,
    )
    moves = [move_to(target) for target in range(len(layout.area_names))]
    root = Subtask("Root", tuple(m.name for m in moves), lambda state: jnp.bool_(False), abstraction=abstraction)
    return Hierarchy(env.action_names, [root, *moves])
