"""Pictures of any environment whose variables say where the agent is, drawn from its exact model.

``renderer = "hrljax.envs.grid.variable_render"`` gives them to an environment whose
`hrljax.TabularEnvironment.variables` have a ``column`` and, unless all is in one row, a ``row``.
Cells where the agent never is are solid. Between two cells stands a wall if no step leads from one
to the other. *end* marks cells where episodes end and never go on, with the reward of getting there
if it is one number. Actions with the name of a direction (`DIRECTIONS`) are arrows, others are
written.

A policy or a value is drawn for all cells at once, with the other variables given by name (0 if
they are not).

All functions raise ValueError where an argument has the wrong shape or type or is out of range, and
TypeError where there is no such variable.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike

from hrljax.core import contract
from hrljax.envs.base import AnyTabularEnvironment
from hrljax.envs.factored import FactoredStates
from hrljax.envs.grid import render as grid
from hrljax.envs.grid.ascii_map import MOVES, neighbours

DIRECTIONS: Mapping[str, tuple[int, int]] = dict(
    zip(["north", "east", "south", "west", "up", "right", "down", "left"], MOVES * 2, strict=True)
)
"""Names of actions that are arrows, in small letters, and their (row, column) steps."""


class _Plan(NamedTuple):
    """What the model and the variables tell of the cells, which are numbered row by row."""

    states: FactoredStates
    ground: grid.Ground
    cell: np.ndarray  # [S] int32: of every state
    goes_on: np.ndarray  # [S] bool: an episode can have a next step there
    ends: dict[int, str]  # by cell in which an episode can end and never goes on: what is written there


def text(env: AnyTabularEnvironment, state: Any = None) -> str:
    """The cells: ``#`` is solid, in ``E`` episodes end, ``@`` is the agent; a last line tells the rest of a `state`."""
    plan = _plan(env)
    marks = np.where(plan.ground.region < 0, "#", ".")
    marks[list(plan.ends)] = "E"
    if state is None:
        return _lines(plan, marks)
    number = _number(env, state)
    marks[plan.cell[number]] = "@"
    rest = _rest(plan, number)
    return _lines(plan, marks) + (f"{_title(rest)}\n" if rest else "")


def draw_map(env: AnyTabularEnvironment, ax: Axes | None = None, state: Any = None) -> Axes:
    """Draws the cells and, with a `state`, the agent, and the rest of the state above."""
    plan = _plan(env)
    if state is None:
        return _draw_ground(plan, ax).axes
    number = _number(env, state)
    axes = _draw_ground(plan, ax, _rest(plan, number)).axes
    grid.draw_disc(axes, *plan.ground.centre(int(plan.cell[number])), "@")
    return axes


def draw_policy(env: AnyTabularEnvironment, policy: ArrayLike, ax: Axes | None = None, **rest: int) -> Axes:
    """Draws the actions of an ``[S]`` policy."""
    plan = _plan(env)
    states, given = _states(plan, rest)
    actions = grid.policy_at(env, policy, states)
    axes = _draw_ground(plan, ax, given).axes
    signs = [DIRECTIONS.get(name.lower(), name) for name in env.action_names]
    grid.draw_actions(axes, plan.ground, actions, _shown(plan, states), signs)
    return axes


def draw_value(env: AnyTabularEnvironment, value: ArrayLike, ax: Axes | None = None, **rest: int) -> Axes:
    """Draws an ``[S]`` value function as a heat map with numbers, and a colour bar beside `ax`."""
    plan = _plan(env)
    states, given = _states(plan, rest)
    values, shown = grid.value_at(env, value, states), _shown(plan, states)
    image = _draw_ground(plan, ax, given, grid.shown_values(values, shown))
    grid.draw_numbers(image, plan.ground, values, shown)
    return image.axes


def rgb_array(env: AnyTabularEnvironment, state: Any) -> np.ndarray:
    """The picture of a state as ``[H, W, 3]`` uint8, always of one size."""
    return grid.pixels(draw_map(env, state=state))


@lru_cache(maxsize=16)
def _plan(env: AnyTabularEnvironment) -> _Plan:
    states, model = env.factored(), env.model()
    if "column" not in states.names:
        wanted = "a 'column' and, if there are several, a 'row'"
        raise TypeError(f"{env.name}: variables must have {wanted} to be drawn; there are {', '.join(states.names)}")
    of_all = dict(zip(states.names, states.values.T, strict=True))
    column, row = of_all["column"], of_all.get("row", np.zeros(env.num_states, np.int32))
    height, width = int(row.max()) + 1, int(column.max()) + 1
    cell = row * np.int32(width) + column
    goes_on = grid.occurring_states(model, env.initial_distribution())
    start, action, outcome = np.nonzero((model.probability > 0) & goes_on[:, None, None])
    after = model.next_state[start, action, outcome]
    left, entered = np.zeros((2, height * width), np.bool_)
    left[cell[goes_on]] = True
    entered[cell[after]] = True
    is_end = entered & ~left
    is_wall = _walls(height, width, cell[start], cell[after], is_end)
    ground = grid.Ground(height, width, neighbours(is_wall, width), np.where(left | entered, 0, -1))
    reward = model.reward[start, action, outcome]
    ends = {end: _label(np.unique(reward[cell[after] == end])) for end in np.flatnonzero(is_end).tolist()}
    return _Plan(states, ground, cell, goes_on, ends)


def _label(rewards: np.ndarray) -> str:
    return f"end\n{rewards[0]:.4g}" if len(rewards) == 1 else "end"


def _walls(height: int, width: int, before: np.ndarray, after: np.ndarray, is_end: np.ndarray) -> np.ndarray:
    """``[cells, 4]`` bool: what stands in the way of each of the `MOVES`.

    A wall, unless a step leads from cell `before` to cell `after` or the other way; nothing between two ends, which no
    step leaves.
    """
    row, column = np.divmod(np.arange(height * width), width)
    is_wall = np.ones((height * width, 4), np.bool_)
    for move, (down, right) in enumerate(MOVES):
        leads = (row[after] - row[before] == down) & (column[after] - column[before] == right)
        is_wall[before[leads], move] = False
        is_wall[after[leads], (move + 2) % 4] = False
        inside = (row + down >= 0) & (row + down < height) & (column + right >= 0) & (column + right < width)
        ends = np.flatnonzero(is_end & inside)
        is_wall[ends[is_end[ends + down * width + right]], move] = False
    return is_wall


def _states(plan: _Plan, rest: dict[str, int]) -> tuple[np.ndarray, list[tuple[str, int]]]:
    """``[cells]``: the state of each cell with the `rest` of the variables, -1 where there is none; all of the rest."""
    states, height, width = plan.states, plan.ground.height, plan.ground.width
    others = [name for name in states.names if name not in ("row", "column")]
    for name in rest:
        if name not in others:
            known = ", ".join(map(repr, others)) or "none"
            raise TypeError(f"{name!r} is no variable beside the cell, only {known}")
    given = {
        name: grid.checked_integer(name, rest.get(name, 0), size - 1, f"a value of {name}")
        for name, size in zip(states.names, states.sizes, strict=True)
        if name in others
    }
    row, column = np.divmod(np.arange(height * width), width)
    cells = {"row": row, "column": column} | {name: np.full_like(row, value) for name, value in given.items()}
    return states.number[states.place([cells[name] for name in states.names])], list(given.items())


def _shown(plan: _Plan, states: np.ndarray) -> np.ndarray:
    return (states >= 0) & plan.goes_on[states]


def _number(env: AnyTabularEnvironment, state: Any) -> int:
    return grid.checked_integer("encode(state)", np.asarray(contract.encode(env, state)), env.num_states - 1, "a state")


def _rest(plan: _Plan, number: int) -> list[tuple[str, int]]:
    """Names and values of the variables of a state beside its cell."""
    of_state = zip(plan.states.names, plan.states.values[number].tolist(), strict=True)
    return [(name, value) for name, value in of_state if name not in ("row", "column")]


def _title(rest: list[tuple[str, int]]) -> str:
    return ", ".join(f"{name} {value}" for name, value in rest)


def _lines(plan: _Plan, marks: np.ndarray) -> str:
    return "".join("".join(row) + "\n" for row in marks.reshape(plan.ground.height, plan.ground.width))


def _draw_ground(
    plan: _Plan, ax: Axes | None, rest: list[tuple[str, int]] | None = None, values: np.ndarray | None = None
) -> AxesImage:
    image = grid.draw_ground(plan.ground, ax, _title(rest or []), values)
    for cell, label in plan.ends.items():
        grid.write(image.axes, *plan.ground.centre(cell), label, 0.2, grid.FAINT, weight="bold")
    return image
