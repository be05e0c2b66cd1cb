"""Pictures of the Maze and of Gridworlds: text, the map, and policies and values on it.

The drawing functions follow `hrljax.envs.grid.render`. Policies and values are drawn in the cells
where an episode can have a next step.

All functions raise ValueError where an argument has the wrong shape or type or is out of range.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike

from hrljax.envs.grid import render as grid
from hrljax.envs.grid.ascii_map import MOVES
from hrljax.envs.grid.cell_world import CellState, CellWorld

World = CellWorld[Any]


def text(env: World, state: CellState | None = None) -> str:
    """The map as text; with a state, the agent stands in it as ``@``."""
    marks = [] if state is None else [(*env.layout.places[_cell(env, state)].tolist(), "@")]
    return grid.text_with(env.layout.text, marks)


def draw_map(env: World, ax: Axes | None = None, state: CellState | None = None) -> Axes:
    """Draws the map and, with a `state`, the agent."""
    axes = _draw_ground(env, ax).axes
    if state is not None:
        grid.draw_disc(axes, *_ground(env).centre(_cell(env, state)), "@")
    return axes


def draw_policy(env: World, policy: ArrayLike, ax: Axes | None = None) -> Axes:
    """Draws the actions of an ``[S]`` policy as arrows."""
    actions = grid.policy_at(env, policy, np.arange(env.num_states))
    axes = _draw_ground(env, ax).axes
    signs = [MOVES[direction] for direction in env.directions]
    grid.draw_actions(axes, _ground(env), actions, ~env.layout.ends, signs)
    return axes


def draw_value(env: World, value: ArrayLike, ax: Axes | None = None) -> Axes:
    """Draws an ``[S]`` value function as a heat map with numbers, and a colour bar beside `ax`."""
    values, shown = grid.value_at(env, value, np.arange(env.num_states)), ~env.layout.ends
    image = _draw_ground(env, ax, grid.shown_values(values, shown))
    grid.draw_numbers(image, _ground(env), values, shown)
    return image.axes


def rgb_array(env: World, state: CellState) -> np.ndarray:
    """The picture of a state as ``[H, W, 3]`` uint8; its size depends on the map only."""
    return grid.pixels(draw_map(env, state=state))


def _cell(env: World, state: CellState) -> int:
    return grid.checked_integer("state.cell", state.cell, env.layout.num_cells - 1, "row * width + column")


def _ground(env: World) -> grid.Ground:
    layout = env.layout
    return grid.Ground(layout.height, layout.width, layout.neighbour, np.where(layout.wall, -1, layout.region))


def _draw_ground(env: World, ax: Axes | None, values: np.ndarray | None = None) -> AxesImage:
    layout, ground = env.layout, _ground(env)
    image = grid.draw_ground(ground, ax, values=values)
    for cell, mark in layout.marks.items():
        x, y = ground.centre(cell)
        if layout.ends[cell]:
            grid.write(image.axes, x, y, mark, 0.4, grid.ALARM if layout.pit[cell] else grid.INK, weight="bold")
        else:
            grid.write(image.axes, x - 0.34, y - 0.32, mark, 0.24, weight="bold")
    return image
