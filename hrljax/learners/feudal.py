"""Feudal Q-learning: managers over a grid, each of which moves at its own scale."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from hrljax.core import choices
from hrljax.core.numerics import take, take_row
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.hierarchy.policy import HierarchicalPolicy, flat_policy
from hrljax.learners.base import Context, Learner, LearnerState, Transition, Words
from hrljax.learners.hyperparameters import Hyperparameter, at_episode, hyperparameter, later_option
from hrljax.learners.updates import Move, moved, td_target

SEARCH = 4
"""The command to search the region, after those to leave it."""
DIRECTIONS = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Rows and columns of the commands north, east, south and west."""


@dataclass(frozen=True, eq=False)
class Feud:
    """The regions of every scale, from the whole grid, scale 0, to single cells, scale L."""

    region: np.ndarray  # [(L + 1) * S] int32: the region of each state, scale after scale
    beside: np.ndarray  # [L * regions * 4] int32: the region north, east, south and west; -1 where there is none
    num_regions: tuple[int, ...]  # L + 1
    num_actions: int
    num_states: int

    @property
    def num_levels(self) -> int:
        """L: managers, one for each scale from 1 on."""
        return len(self.num_regions) - 1

    @property
    def width(self) -> int:
        """Numbers of a row of values: commands, or actions where there are more."""
        return max(SEARCH + 1, self.num_actions)

    def choices_of(self, level: int) -> int:
        """What the manager of a level chooses among: commands, and on the last level actions."""
        return self.num_actions if level == self.num_levels else SEARCH + 1

    def region_of(self, scale: int, state: Array) -> Array:
        return take(jnp.asarray(self.region), jnp.int32(scale * self.num_states) + state)

    def neighbour(self, scale: int, region: Array, direction: Array) -> Array:
        first = 4 * sum(self.num_regions[:scale])
        return take(jnp.asarray(self.beside), jnp.int32(first) + region * 4 + direction)

    def row(self, level: int, command: Array, region: Array) -> Array:
        """Where the values of a level's manager begin, under a command from above, in a region of its scale."""
        before = (SEARCH + 1) * sum(self.num_regions[1:level])
        return (jnp.int32(before) + command * self.num_regions[level] + region) * self.width


class Commands(NamedTuple):
    """What every manager has chosen."""

    chosen: tuple[Array, ...]  # L int32: commands to the level below, and at last the action


@dataclass(frozen=True)
class FeudalQ(Learner[Feud, Array, Commands]):
    """Feudal Q-learning on a grid (Dayan and Hinton 1992).

    The grid is cut into regions at L scales, each twice as fine as the one before, down to cells. A manager at every
    scale sees in which region it is, and the command from above: to leave the coarser region around it to the
    north, east, south or west, or to search it. It commands the manager below in the same words; the lowest takes
    actions. Who stands above all has one command, to search.

    A command is over when its region is left, or the episode ends. It was carried out if the region was left to where
    it said, or if it was to search and the episode terminated. The manager that was given it earns 1 for that, loses
    `failure_cost` for any other end, and `move_cost` for every move of its own, long or short, whatever that was
    worth to those above (reward hiding). It learns the value of its choice u:

        Q(command, region, u) <- Q + alpha [ r + g max_v Q(command, region', v) - Q ]

    where what follows counts nothing once the command is over. The environment's rewards are not used: the grid is
    one whose end is the goal. The costs, and that every manager explores by itself, are choices of this library.

    Attributes:
        scales: L, from 1 to 12; the regions of scale 1 are squares with ``2 ** (L - 1)`` cells a side. With 1 there is
            one manager, of cells.
        step_size: in (0, 1], or a schedule of the episode.
        epsilon: probability of a random choice of a manager, or a schedule of the episode. Else the best one.
        discount: g in [0, 1], of a manager's own move.
        initial_value: of every choice.
        move_cost: at least 0. With 0 and no discount all ways to carry out a command are as good.
        failure_cost: at least 0. If it costs less than some moves, managers give up.
        ties: as of `QLearning`, of a manager's choices.
    """

    scales: int = 3
    step_size: Hyperparameter = hyperparameter(0.1, 0, 1, low_open=True, schedule=True)
    epsilon: Hyperparameter = hyperparameter(0.1, 0, 1, schedule=True)
    discount: Hyperparameter = hyperparameter(1.0, 0, 1)
    initial_value: Hyperparameter = hyperparameter(0.0)
    move_cost: Hyperparameter = hyperparameter(0.3, 0)
    failure_cost: Hyperparameter = hyperparameter(1.0, 0)
    ties: choices.Ties = later_option("first")

    name = "feudal Q-learning"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integer("scales", 1, 12)
        self._check_choice("ties", choices.Ties)

    @property
    def num_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        """One for every manager."""
        return self.scales

    @property
    def num_begin_words(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride] (depends on a field)
        return self.scales

    def prepare(self, env: AnyTabularEnvironment) -> Feud:
        """Raises ValueError unless the environment's variables are a row and a column."""
        return feud(env, self.scales)

    def init(self, env: AnyTabularEnvironment, prepared: Feud) -> LearnerState:
        """Tables: ``[numbers]`` float32, rows as `Feud.row` has them."""
        rows = (SEARCH + 1) * sum(prepared.num_regions[1:])
        values = jnp.full(rows * prepared.width, jnp.asarray(self.initial_value, jnp.float32))
        return LearnerState(values, Commands((jnp.int32(0),) * prepared.num_levels))

    def begin(self, prepared: Feud, tables: Array, first: Array, words: Words, context: Context) -> Commands:
        def choose(level: int, values: list[Array]) -> Array:
            return self._choice(values, words[level - 1], context)

        return self._commanded(prepared, tables, first, choose)

    def action(self, control: Commands) -> Array:
        return control.chosen[-1]

    def learn(
        self, prepared: Feud, state: LearnerState, transition: Transition, words: Words, context: Context
    ) -> LearnerState:
        before, after = transition.state, transition.next_state
        gamma = context.discounted(at_episode(self.discount, context.episode))
        old = [prepared.region_of(scale, before) for scale in range(prepared.num_levels + 1)]
        new = [prepared.region_of(scale, after) for scale in range(prepared.num_levels + 1)]
        left = [a != b for a, b in zip(old, new, strict=True)]
        commands = [jnp.int32(SEARCH), *state.control.chosen[:-1]]
        moves = []
        for level in range(1, prepared.num_levels + 1):
            command, region = commands[level - 1], new[level]
            is_move = left[level] | transition.terminated | jnp.bool_(level == prepared.num_levels)
            is_over = left[level - 1] | transition.terminated
            direction = lax.min(command, jnp.int32(SEARCH - 1))
            went_there = left[level - 1] & (prepared.neighbour(level - 1, old[level - 1], direction) == new[level - 1])
            is_carried_out = lax.select(command == SEARCH, transition.terminated, went_there)
            best = choices.greedy(self._values(prepared, state.tables, level, command, region))[1]
            follows = lax.select(is_over, jnp.float32(0), best)
            ends = lax.select(is_carried_out, jnp.float32(1), -jnp.asarray(self.failure_cost, jnp.float32))
            earned = lax.select(is_over, ends, jnp.float32(0)) - jnp.asarray(self.move_cost, jnp.float32)
            target = td_target(earned, gamma, follows)
            start = prepared.row(level, command, old[level]) + state.control.chosen[level - 1]
            moves.append(Move(start, target[None], is_move))
        tables = moved(state.tables, moves, at_episode(self.step_size, context.episode), context)
        move_is_over = [*left[1:-1], jnp.bool_(True)]

        def choose(level: int, values: list[Array]) -> Array:
            """Anew, or what was chosen before."""
            choice = self._choice(values, words[level - 1], context)
            return lax.select(move_is_over[level - 1], choice, state.control.chosen[level - 1])

        return LearnerState(tables, self._commanded(prepared, tables, after, choose))

    def greedy_policy(
        self, env: AnyTabularEnvironment, prepared: Feud, tables: Array, context: Context
    ) -> HierarchicalPolicy:
        """A flat one: while none explores, a manager chooses anew in every region that it comes to, and under every
        command, so that the state alone says what all have chosen."""

        def action(state: Array) -> Array:
            return self._commanded(prepared, tables, state, lambda _, values: choices.greedy(values)[0]).chosen[-1]

        return flat_policy(env, jax.vmap(action)(jnp.arange(env.num_states, dtype=jnp.int32)))

    def _values(self, feud: Feud, tables: Array, level: int, command: Array, region: Array) -> list[Array]:
        """Values of what the manager of a level can choose, scalars."""
        row = take_row(tables, feud.row(level, command, region), feud.width)
        return [row[u] for u in range(feud.choices_of(level))]

    def _choice(self, values: list[Array], word: Array, context: Context) -> Array:
        """What a manager chooses anew: the best, or by epsilon any; as `EpsilonGreedyLearner.choose`."""
        best = choices.greedy_by(self.ties, values, choices.greedy(values)[0], word)
        return choices.epsilon_greedy(best, len(values), word, at_episode(self.epsilon, context.episode))

    def _commanded(
        self, feud: Feud, tables: Array, state: Array, choose: Callable[[int, list[Array]], Array]
    ) -> Commands:
        """What every manager has chosen, from the top down, given a choice by its level and the values there."""
        command, chosen = jnp.int32(SEARCH), []
        for level in range(1, feud.num_levels + 1):
            command = choose(level, self._values(feud, tables, level, command, feud.region_of(level, state)))
            chosen.append(command)
        return Commands(tuple(chosen))


def feud(env: AnyTabularEnvironment, scales: int) -> Feud:
    """The regions of an environment's grid.

    Raises:
        ValueError: its variables are not a row and a column.
    """
    factored = env.factored()
    if set(factored.names) != {"row", "column"}:
        raise ValueError(
            f"feudal Q-learning needs a grid, with a row and a column; {env.name} has {', '.join(factored.names)}"
        )
    row, column = (factored.values[:, factored.names.index(name)] for name in ("row", "column"))
    regions, beside, counts = [], [], []
    for scale in range(scales + 1):
        side = 2 ** (scales - scale) if scale else 1 + int(max(row.max(), column.max()))
        rows, columns = row // side, column // side
        width, height = 1 + int(columns.max()), 1 + int(rows.max())
        regions.append(rows * width + columns)
        counts.append(width * height)
        y, x = np.divmod(np.arange(width * height), width)
        for dy, dx in DIRECTIONS:
            inside = (y + dy >= 0) & (y + dy < height) & (x + dx >= 0) & (x + dx < width)
            beside.append(np.where(inside, (y + dy) * width + x + dx, -1))
    # [scale][direction][region] to [scale][region][direction]
    tables = [np.stack(beside[4 * scale : 4 * scale + 4], 1).ravel() for scale in range(scales)]
    return Feud(
        np.concatenate(regions).astype(np.int32),
        np.concatenate(tables).astype(np.int32),
        tuple(counts),
        env.num_actions,
        env.num_states,
    )
