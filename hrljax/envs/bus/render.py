"""Pictures of the Bus domain: text, the map, and policies and values on it.

The drawing functions follow `hrljax.envs.grid.render`. Passengers are numbered from 0 in the map's reading order.

A policy or a value is drawn for all cells at once, with the rest of the state given: `picked` (bit
i: passenger i is on board), `road` (0: no construction, i: the i-th site is under construction) and
`damaged` (0 or 1). Cells where no such state occurs stay empty: those of waiting passengers, those
that cannot be reached past them and, with every passenger on board, the start.

All functions raise ValueError where an argument has the wrong shape or type or is out of range.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Rectangle
from numpy.typing import ArrayLike

from hrljax.envs.bus.env import Bus, BusState
from hrljax.envs.bus.map import BusMap
from hrljax.envs.grid import render as grid
from hrljax.envs.grid.ascii_map import MOVES, reached


class _Scene(NamedTuple):
    """What a picture shows, in integers that have been checked."""

    damaged: int = 0
    picked: int = 0
    road: int = 0
    cell: int = -1  # of the bus; -1: no bus


def text(env: Bus, state: BusState | None = None) -> str:
    """The map as text, which `hrljax.envs.bus.map.parse` reads if there is no `state`.

    With a state, the bus stands in front of the area's name, as ``@`` or, if damaged, ``!``;
    passengers on board are gone from the map, and a last line tells the rest of the state.
    """
    if state is None:
        return grid.text_with(env.map, [])
    layout, scene = env.layout, _scene_of(env, state)
    on_board = set(layout.passengers) - set(_waiting(layout, scene).values())
    marks = [*((cell, 3, " ") for cell in on_board), (scene.cell, 1, "!" if scene.damaged else "@")]
    places = ((2 * (cell // layout.width) + 1, 4 * (cell % layout.width) + offset, m) for cell, offset, m in marks)
    return grid.text_with(env.map, places, _status(layout, scene))


def draw_map(env: Bus, ax: Axes | None = None, state: BusState | None = None) -> Axes:
    """Draws the map and, with a `state`, the bus, the waiting passengers and the construction."""
    scene = _Scene() if state is None else _scene_of(env, state)
    axes = _draw_ground(env, ax, scene).axes
    axes.title.set_text("" if state is None else _status(env.layout, scene))
    return axes


def draw_policy(
    env: Bus, policy: ArrayLike, ax: Axes | None = None, *, picked: int = 0, road: int = 0, damaged: int = 0
) -> Axes:
    """Draws the actions of an ``[S]`` policy as arrows, one in each cell where such a state occurs."""
    scene = _scene(env, damaged, picked, road)
    actions = grid.policy_at(env, policy, _states(env, scene))
    axes = _draw_ground(env, ax, scene).axes
    grid.draw_actions(axes, _ground(env.layout), actions, _occurs(env.layout, scene), MOVES)
    return axes


def draw_value(
    env: Bus, value: ArrayLike, ax: Axes | None = None, *, picked: int = 0, road: int = 0, damaged: int = 0
) -> Axes:
    """Draws an ``[S]`` value function as a heat map with numbers, and a colour bar beside `ax`."""
    scene = _scene(env, damaged, picked, road)
    values, occurs = grid.value_at(env, value, _states(env, scene)), _occurs(env.layout, scene)
    image = _draw_ground(env, ax, scene, grid.shown_values(values, occurs))
    grid.draw_numbers(image, _ground(env.layout), values, occurs)
    return image.axes


def rgb_array(env: Bus, state: BusState) -> np.ndarray:
    """The picture of a state as ``[H, W, 3]`` uint8; its size depends on the map only."""
    return grid.pixels(draw_map(env, state=state))


def _scene(env: Bus, damaged: ArrayLike, picked: ArrayLike, road: ArrayLike, prefix: str = "") -> _Scene:
    roads = ", ".join(f"{i}: {name}" for i, name in enumerate(("no construction", *env.layout.site_names)))
    count = len(env.layout.passengers)
    return _Scene(
        damaged=grid.checked_integer(f"{prefix}damaged", damaged, 1, "0: sound, 1: damaged"),
        picked=grid.checked_integer(f"{prefix}picked", picked, 2**count - 1, "bit i: passenger i is on board"),
        road=grid.checked_integer(f"{prefix}road", road, env.num_sites, roads),
    )


def _scene_of(env: Bus, state: BusState) -> _Scene:
    scene = _scene(env, state.damaged, state.picked, state.road, "state.")
    return scene._replace(
        cell=grid.checked_integer("state.cell", state.cell, env.layout.num_cells - 1, "row * width + column")
    )


def _states(env: Bus, scene: _Scene) -> np.ndarray:
    """``[cells]``: numbers of the states of all cells with the flags of a scene."""
    damaged, picked, road, time = map(jnp.int32, (scene.damaged, scene.picked, scene.road, 0))
    cells = jnp.arange(env.layout.num_cells, dtype=jnp.int32)
    return np.asarray(env.encode(BusState(cells, damaged, picked, road, time)))


def _ground(layout: BusMap) -> grid.Ground:
    return grid.Ground(layout.height, layout.width, layout.neighbour, layout.area)


def _waiting(layout: BusMap, scene: _Scene) -> dict[int, int]:
    """The cells of the passengers that are not on board, by their numbers."""
    return {i: cell for i, cell in enumerate(layout.passengers) if not scene.picked >> i & 1}


def _occurs(layout: BusMap, scene: _Scene) -> np.ndarray:
    """``[cells]`` bool: an episode that goes on can have the bus here, with these passengers on board."""
    waits = np.isin(np.arange(layout.num_cells), list(_waiting(layout, scene).values()))
    is_start = np.arange(layout.num_cells) == layout.start
    return reached(layout.neighbour, is_start, stops=waits) & ~waits & (waits.any() | ~is_start)


def _status(layout: BusMap, scene: _Scene) -> str:
    picked = ", ".join(str(i) for i in range(len(layout.passengers)) if i not in _waiting(layout, scene))
    bus, road = ("sound", "damaged")[scene.damaged], ("none", *layout.site_names)[scene.road]
    return f"construction: {road} | bus: {bus} | picked: {picked or 'none'}"


def _draw_ground(env: Bus, ax: Axes | None, scene: _Scene, values: np.ndarray | None = None) -> AxesImage:
    """Draws all but arrows and numbers; colours the cells by ``[cells]`` `values` or else by area."""
    layout, ground = env.layout, _ground(env.layout)
    image = grid.draw_ground(ground, ax, _status(layout, scene), values)
    ax = image.axes
    for area, name in enumerate(layout.area_names):
        x, y = ground.centre(int(np.argmax(layout.area == area)))
        grid.write(ax, x - 0.34, y - 0.32, name, 0.24, weight="bold")
    x, y = ground.centre(layout.start)
    grid.write(ax, x + 0.34, y + 0.32, "S", 0.24, weight="bold")
    for cell, move in np.argwhere(layout.site * (0, 1, 1, 0)).tolist():
        _draw_site(env, ax, cell, move, is_closed=layout.site[cell, move] == scene.road)
    for i, cell in _waiting(layout, scene).items():
        grid.draw_disc(ax, *ground.centre(cell), f"P{i}")
    if scene.cell >= 0:
        x, y = ground.centre(scene.cell)
        grid.draw_vehicle(ax, x, y, grid.ALARM if scene.damaged else grid.VEHICLE)
        if scene.damaged:
            grid.write(ax, x + 0.39, y - 0.2, "!", 0.4, grid.ALARM, weight="bold")
    return image


def _draw_site(env: Bus, ax: Axes, cell: int, move: int, is_closed: bool) -> None:
    """Draws the site on an edge and, hatched, what damages the bus when the site is under construction."""
    (x, y), (down, right) = _ground(env.layout).centre(cell), MOVES[move]
    if is_closed:
        reach, width, height = (1.0, 1.0, 1.0) if env.site == "cell" else (0.5, 0.16 + 0.7 * down, 0.16 + 0.7 * right)
        corner = x + reach * right - width / 2, y + reach * down - height / 2
        ax.add_patch(
            Rectangle(corner, width, height, facecolor="#FFF9", edgecolor=grid.ALARM, hatch="////", zorder=2.5)
        )
    middle, colour = (x + right / 2, y + down / 2), grid.ALARM if is_closed else grid.FAINT
    ax.add_patch(
        Circle(middle, 0.15, facecolor="white", edgecolor=colour, linewidth=0.03 * grid.cell_points(ax), zorder=3)
    )
    grid.write(ax, *middle, env.layout.site_names[env.layout.site[cell, move] - 1], 0.2, colour, weight="bold")
